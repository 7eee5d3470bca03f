"""Oscillations that last: limit cycles, and those that grow or die away."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

# Part of the run that is looked at, and of its greatest swing that a crossing must leave behind to count.
_TAIL, _HYSTERESIS = 0.6, 0.1
_FEWEST = 3
# Change of the amplitude from cycle to cycle that counts as none, and scatter of a period that still is one.
_STEADY, _REGULAR = 0.01, 0.1


@dataclass(frozen=True)
class Cycle:
    """An oscillation.

    Attributes
    ----------
    kind : str
        "limit cycle" where the amplitude stays, else "growing" or "decaying".
    amplitude : float
        Half the distance between the extremes, of the last cycles, m or rad.
    period : float
        Mean period, s.
    spread : float
        Standard deviation of the period from cycle to cycle, s.
    cycles : int
        How many cycles were seen.
    """

    kind: Literal["limit cycle", "growing", "decaying"]
    amplitude: float
    period: float
    spread: float
    cycles: int


def find_cycle(t: np.ndarray, error: np.ndarray, least: float) -> Cycle | None:
    """The oscillation in the last three fifths of a run, if there is one of this amplitude at least."""
    tail = t >= t[-1] - _TAIL * (t[-1] - t[0])
    t, error = t[tail], error[tail]
    if len(t) < 8 or not np.isfinite(error).all():
        return None
    middle = 0.5 * (error.max() + error.min())
    swing = error - middle
    rising = _rising(swing, _HYSTERESIS * np.abs(swing).max())
    if len(rising) <= _FEWEST:
        return None
    times = t[rising] - swing[rising] * (t[rising + 1] - t[rising]) / (swing[rising + 1] - swing[rising])
    heights = np.array([np.ptp(swing[a:b]) / 2 for a, b in pairwise(rising)])
    return _judged(np.diff(times), heights, least)


def _judged(periods: np.ndarray, heights: np.ndarray, least: float) -> Cycle | None:
    spread = float(periods.std())
    if heights[-1] < least or spread > _REGULAR * periods.mean():
        return None
    growth = (heights[-1] / heights[0]) ** (1 / (len(heights) - 1)) - 1
    kind: Literal["limit cycle", "growing", "decaying"] = "growing" if growth > 0 else "decaying"
    if abs(growth) < _STEADY:
        kind = "limit cycle"
    return Cycle(kind, float(heights[-2:].mean()), float(periods.mean()), spread, len(periods))


def _rising(swing: np.ndarray, dead: float) -> np.ndarray:
    """Last samples before zero is crossed upwards, once for every time the swing has been well below it."""
    side = np.where(swing > dead, 1, np.where(swing < -dead, -1, 0))
    marks = np.flatnonzero(side)
    turns = marks[1:][(side[marks[1:]] > 0) & (side[marks[:-1]] < 0)]
    below = np.flatnonzero((swing[:-1] <= 0) & (swing[1:] > 0))
    places = np.searchsorted(below, turns, side="left") - 1
    return np.unique(below[places[places >= 0]])
