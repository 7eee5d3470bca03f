"""Output error: parameters from simulations of many windows, with the start of each estimated, too."""

from .fit import OutputErrorFit, fit_output_error

__all__ = ["OutputErrorFit", "fit_output_error"]
