"""Choosing among mistakes that make pose rates and velocities agree alike, by how the model then fits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from undertow.model.vehicle import Vehicle

from ..logs import Run
from .dynamics import dynamics_of
from .kinematic_search import Explained
from .mistake import Mistake

_TRIED = 4
# Factor between what the model leaves beyond the noise after one and after another that decides.
_DECIDES = 2.0


def decided(vehicle: Vehicle, runs: Sequence[Run], found: Explained) -> tuple[Mistake, list[Mistake]]:
    """The mistake that the model speaks for, and those that it does not speak against.

    Parameters
    ----------
    vehicle : Vehicle
        The model.
    runs : sequence of Run
        Logs with the mistake.
    found : Explained
        What kinematics says.
    """
    tied = [found.mistake, *found.rivals][:_TRIED]
    if len(tied) == 1:
        return found.mistake, []
    left = [_left(vehicle, runs, m) for m in tied]
    best = min(left)
    good = [m for m, value in zip(tied, left, strict=True) if not value > _DECIDES * best]
    return good[0], good[1:]


def _left(vehicle: Vehicle, runs: Sequence[Run], mistake: Mistake) -> float:
    """What the refitted model leaves beyond the noise, geometric mean over its equations of motion."""
    at = dynamics_of(vehicle, [mistake.undo(run) for run in runs])
    return np.inf if at is None else float(np.exp(np.mean(np.log(np.maximum(at.quiet, 1.0)))))
