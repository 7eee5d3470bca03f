"""From the symbolic model to CasADi functions, C source and compiled libraries."""

from .functions import Functions
from .library import Compiled
from .simulate import Simulator

__all__ = ["Compiled", "Functions", "Simulator"]
