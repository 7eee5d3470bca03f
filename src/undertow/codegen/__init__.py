"""From the symbolic model to CasADi functions, C source and compiled libraries."""

from .compiler import Compiled
from .functions import Functions
from .simulate import Simulator

__all__ = ["Compiled", "Functions", "Simulator"]
