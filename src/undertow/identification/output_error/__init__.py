"""Output error: parameters from simulations of many windows, with the start of each estimated, too."""

from .descent import OutputErrorFit
from .fit import fit_output_error

__all__ = ["OutputErrorFit", "fit_output_error"]
