"""From the symbolic model to CasADi functions, C source and compiled libraries."""

from .functions import Functions
from .simulate import Simulator

__all__ = ["Functions", "Simulator"]
