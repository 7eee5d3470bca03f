"""A time column in another unit: the pose then moves a thousand times as slowly as the velocities say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..logs import Mapping, Run
from .kinematics import Kinematics
from .mending import Edit
from .mistake import Mistake

_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
# Share by which the ratio of pose rate to velocity may differ from that of two units.
_NEAR = 0.3


def other_time_unit(kinematics: Kinematics, runs: Sequence[Run], mapping: Mapping) -> Mistake | None:
    """The unit of the time column in which pose rates and velocities have the same size.

    Parameters
    ----------
    kinematics : Kinematics
        What pose rates are held against.
    runs : sequence of Run
        Logs with velocities that were measured, not derived from the pose.
    mapping : Mapping
        How they were read.
    """
    unit = mapping.time.unit
    if not kinematics or unit not in _SECONDS or any(run.derived for run in runs):
        return None
    ratio = _pose_rate_over_velocity(kinematics, runs)
    for other, seconds in _SECONDS.items():
        factor = seconds / _SECONDS[unit]
        if other != unit and abs(ratio / factor - 1.0) < _NEAR:
            return Mistake(
                "time_unit",
                f"the times are in {other}, read as {unit}",
                lambda run, factor=factor: replace(run, t=factor * run.t),  # type: ignore[misc]
                lambda m, other=other: (Edit("time", "unit", other),),  # type: ignore[misc]
            )
    return None


def _pose_rate_over_velocity(kinematics: Kinematics, runs: Sequence[Run]) -> float:
    """Ratio of the rms of both, the same for every pose rate; NaN where they differ in it."""
    rates = kinematics.rates(runs)
    pose, velocity = (np.sqrt(np.mean(a**2, axis=0)) for a in (rates.pose, rates.velocity))
    ratios = pose / np.maximum(velocity, 1e-30)
    middle = float(np.median(ratios))
    return middle if np.all(np.abs(ratios / middle - 1.0) < _NEAR) else float("nan")
