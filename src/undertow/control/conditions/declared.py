"""Which conditions belong to which law."""

from __future__ import annotations

from . import pd, pid, sliding
from .condition import Condition

CONDITIONS: dict[str, tuple[Condition, ...]] = {
    "pd": (pd.PositiveSpring(), pd.PositiveDamper(), pd.Spring(), pd.DampedMotion()),
    "pid": (
        *(pid.PrintedDamper(), pid.PrintedIntegral(), pid.PrintedSpring(), pid.PrintedLast()),
        *(pid.MendedDamper(), pid.MendedIntegral(), pid.MendedSpring(), pid.MendedLast()),
        *(pid.Integral(), pid.PositiveCandidate(), pid.FallingCandidate(), pid.SomeIota(), pid.Routh()),
    ),
    "sliding-mode": (
        *(sliding.Reaches(), sliding.Slides()),
        *(sliding.DerivedReaches(), sliding.DerivedSlides()),
    ),
    "sliding-mode-boundary-layer": (sliding.DerivedReaches(), sliding.DerivedSlides(), sliding.HasWidth()),
    "super-twisting": (sliding.Root(), sliding.Twist(), sliding.DerivedSlides()),
}
"""Conditions by the id of the law, in the order in which they are shown."""
