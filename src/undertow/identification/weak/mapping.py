"""CasADi functions at many samples."""

from undertow.codegen.tape import at_samples as nonzeros
from undertow.codegen.tape import call, mapped

__all__ = ["call", "mapped", "nonzeros"]
