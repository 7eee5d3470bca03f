"""Control laws, each declared once as expressions of a vehicle's M, C, D, g and J."""

from .law import GainMatrix, Law, LawSignals
from .pd import PD
from .pid import PID
from .sliding_mode import BoundaryLayer, SlidingMode, SuperTwisting

LAWS: dict[str, type[Law]] = {cls.id: cls for cls in (PD, PID, SlidingMode, BoundaryLayer, SuperTwisting)}

__all__ = ["LAWS", "GainMatrix", "Law", "LawSignals"]
