"""Which of several estimates is taken."""

from __future__ import annotations

from collections.abc import Sequence

from .chain import Estimation

RULE = "of the cases whose estimates are all physical, the one with the least residual variance"


def selected(found: Sequence[Estimation]) -> Estimation | None:
    """The estimate that `RULE` takes; None where no case is physical."""
    return min((e for e in found if e.valid), key=lambda e: e.residual_variance, default=None)
