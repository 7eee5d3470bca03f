"""The smallest change of gains that satisfies concave demands, by cutting planes."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls

from undertow.typing import Array

_ROUNDS = 80
_LEAST = 1e-3


class Cut(NamedTuple):
    """A demand `slope . x + offset >= 0` that follows from a concave one."""

    slope: Array
    offset: float


Cuts = Callable[[Array], Iterable[Cut]]
"""Cuts at a point x of relative changes; at least one of them is violated where a demand is."""


def least_change(cuts: Cuts, size: int, slack: float) -> Array | None:
    """The relative changes x with the least sum of squares that satisfy all demands, or None.

    Every gain keeps at least a thousandth of itself.

    Parameters
    ----------
    cuts : callable
        The demands.
    size : int
        Number of variables.
    slack : float
        How far inside every demand x lies, as a distance.
    """
    x = np.zeros(size)
    slopes, floors = [*np.eye(size)], [_LEAST - 1.0] * size
    for _ in range(_ROUNDS):
        violated = [c for c in map(_scaled, cuts(x)) if c.slope @ x + c.offset < 0.5 * slack]
        if not violated:
            return x
        slopes += [c.slope for c in violated]
        floors += [slack - c.offset for c in violated]
        found = _least_distance(np.array(slopes), np.array(floors))
        if found is None:
            return None
        x = found
    return None


def _scaled(cut: Cut) -> Cut:
    size = max(float(np.linalg.norm(cut.slope)), 1e-300)
    return Cut(cut.slope / size, cut.offset / size)


def _least_distance(slopes: Array, floors: Array) -> Array | None:
    """The x of least length with slopes x >= floors.

    Lawson and Hanson (1974), Solving Least Squares Problems: least-distance programming by nnls.
    """
    scale = max(1.0, float(floors.max()))
    matrix = np.vstack([slopes.T, floors / scale])
    target = np.zeros(matrix.shape[0])
    target[-1] = 1.0
    multipliers, distance = nnls(matrix, target, maxiter=50 * matrix.shape[1])
    if distance < 1e-9:
        return None
    rest = matrix @ multipliers - target
    return -rest[:-1] / rest[-1] * scale
