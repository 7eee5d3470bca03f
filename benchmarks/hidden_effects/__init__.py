"""Logs of simulated vehicles with an effect that their model does not have.

An own program on purpose: plain NumPy, equations written down a second time, nothing imported from
undertow. A test that uses these logs is therefore no mirror of the product.
"""

from __future__ import annotations

from .cases import Case, make_case
from .files import write_case
from .registry import EFFECTS

__all__ = ["EFFECTS", "Case", "make_case", "write_case"]
