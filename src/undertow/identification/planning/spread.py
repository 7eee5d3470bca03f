"""How far off the predicted depth may be, by what is not known of the parameters."""

from __future__ import annotations

import numpy as np

from undertow.typing import Array

from ..weak.step import inverse_of
from .flight import Airspace, Flight, Plant
from .information import Knowledge

# What a value without a stated error may be off by, as a share of it.
_LOOSE = 0.3
# Step of the differences, as a share of a parameter's size.
_STEP = 1e-2


def depth_spread(space: Airspace, plant: Plant, known: Knowledge, flight: Flight) -> float | None:
    """Two standard deviations of the largest error of the predicted depth, m; None without a depth.

    A parameter without a stated error counts as known to 30 %.
    """
    if "z" not in space.names or not known.free:
        return None
    stated = known.prior + known.logs
    silent = np.diag(stated) <= 0
    covariance = inverse_of(stated + np.diag(silent * (_LOOSE * known.scale) ** -2.0))
    table = np.array(
        [_slope(space, plant, flight, n, s) for n, s in zip(known.free, known.scale, strict=True)]
    )
    variance = np.einsum("it,ij,jt->t", table, covariance, table)
    return float(2 * np.sqrt(np.max(np.nan_to_num(variance, nan=0.0))))


def _slope(space: Airspace, plant: Plant, flight: Flight, name: str, scale: float) -> Array:
    """Derivative of the depth along a flight, shape (n,)."""
    place, column = plant.functions.parameter_names.index(name), space.names.index("z")
    ends = []
    for sign in (1.0, -1.0):
        p = plant.p.copy()
        p[place] += sign * _STEP * scale
        ends.append(space.predicted(plant, flight.t, [flight.u], p)[0][:, column])
    return np.asarray((ends[0] - ends[1]) / (2 * _STEP * scale))
