"""The state at the beginning of logs by how they go on: a few Gauss-Newton steps for several logs at once."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from undertow.typing import Array

_ROUNDS = 12
_SECANT = 1e-6
_SHARES = np.array([1.0, 0.3, 0.1, 0.03, 0.0])
# Fall of the sum of squares below which the search ends.
_ENOUGH = 1e-6
_LOST = 1e300


def best_start(report: Callable[[Array], Array], measured: Array, start: Array, width: Array) -> Array:
    """Starts that explain best what follows, drawn to the given ones by a prior.

    Parameters
    ----------
    report : callable
        What follows, in units of the noise, shape (b r, k, c), of b r starts: r trials for each log in turn.
    measured : (b, k, c) array
        What was measured, in units of the noise; NaN where nothing was.
    start : (b, m) array
        Where the search begins, and the centre of the prior.
    width : (m,) array
        Standard deviation of the prior.

    Returns
    -------
    (b, m) array
    """
    used = np.isfinite(measured)[:, None]
    known = np.where(used, measured[:, None], 0.0)

    def residual(moved: Array) -> Array:
        """Measured minus reported for trials of shape (b, r, m), shape (b, r, k c)."""
        b, r, m = moved.shape
        y = report((start[:, None] + moved * width).reshape(b * r, m))
        return np.where(used, known - y.reshape(b, r, *y.shape[1:]), 0.0).reshape(b, r, -1)

    moved = np.zeros_like(start)
    for _ in range(_ROUNDS):
        step = _gauss_newton(residual, moved)
        trials = moved[:, None] + _SHARES[:, None] * step[:, None]
        with np.errstate(over="ignore"):
            cost = np.sum(residual(trials) ** 2, axis=2) + np.sum(trials**2, axis=2)
        cost = np.nan_to_num(cost, nan=_LOST, posinf=_LOST)
        best = np.argmin(cost, axis=1)
        moved = trials[np.arange(len(best)), best]
        gained = cost[:, -1] - cost[np.arange(len(best)), best]
        if not np.any(gained > _ENOUGH):
            break
    return start + moved * width


def _gauss_newton(residual: Callable[[Array], Array], moved: Array) -> Array:
    """Step in units of the prior, shape (b, m); zero where a simulation diverged."""
    m = moved.shape[1]
    r = residual(moved[:, None] + np.vstack([np.zeros(m), _SECANT * np.eye(m)]))
    slope = (r[:, :1] - r[:, 1:]) / _SECANT
    gram = slope @ np.swapaxes(slope, 1, 2) + np.eye(m)
    right = (slope @ r[:, 0, :, None])[:, :, 0] - moved
    good = np.isfinite(right).all(axis=1) & np.isfinite(gram).all(axis=(1, 2))
    step = np.zeros_like(moved)
    step[good] = np.linalg.solve(gram[good], right[good][:, :, None])[:, :, 0]
    return step
