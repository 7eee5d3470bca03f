"""Kalman filter and Rauch-Tung-Striebel smoother of scalar signals, many at a time.

A signal is an integrated Wiener process (its third derivative, the jerk, is white noise) seen through white
noise. Stretches of samples are filtered side by side ("lanes"), so that the loop over samples in Python is
short and each turn of it works on all lanes at once. Everything is in units of the lane: time in steps,
values in standard deviations of the noise. What is left is one number, `ratio` = jerk intensity * step^5 /
noise variance, found by maximum likelihood.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial

import numpy as np
from numpy.typing import NDArray

from undertow.typing import Array

ORDER = 3  # position, velocity, acceleration
_DIFFUSE = 1e10  # variance of the state before the first sample, in squared standard deviations of the noise
_OUTLYING = 100.0
_BURN_IN = 2 * ORDER  # samples at the start of a lane that say more about _DIFFUSE than about the ratio
# Decades of ratio that are searched. Above the last the noise is lost in the motion of one step anyway.
_GRID = np.arange(-13.0, 4.0)


@dataclass(frozen=True)
class Lanes:
    """Stretches of samples side by side, the short ones filled up with missing samples.

    Attributes
    ----------
    y : (n, lanes) array
        Measured values, NaN where there is none.
    step : (n, lanes) array
        Time since the sample before, in units of the usual step.
    jump : (n, lanes) bool array
        Where the value may have been shifted, by any amount, since the sample before (its derivatives carry
        on).
    """

    y: Array
    step: Array
    jump: NDArray[np.bool_]


@dataclass(frozen=True)
class States:
    """Value and its first two derivatives per step.

    Attributes
    ----------
    mean : (n, lanes, 3) array
        Estimates.
    covariance : (n, lanes, 3, 3) array
        Covariance of `mean`, divided by the noise variance.
    """

    mean: Array
    covariance: Array


def _transition(step: Array) -> Array:
    """Return the (..., 3, 3) transition over `step`."""
    result = np.zeros((*step.shape, ORDER, ORDER))
    for row in range(ORDER):
        for column in range(row, ORDER):
            result[..., row, column] = step ** (column - row) / factorial(column - row)
    return result


def _process(step: Array, ratio: Array) -> Array:
    """Return the (..., 3, 3) covariance that white jerk adds over `step`."""
    result = np.empty((*step.shape, ORDER, ORDER))
    for row in range(ORDER):
        for column in range(ORDER):
            power = 2 * ORDER - 1 - row - column
            size = power * factorial(ORDER - 1 - row) * factorial(ORDER - 1 - column)
            result[..., row, column] = ratio * step**power / size
    return result


@dataclass(frozen=True)
class _Filtered:
    """The filter's state after each sample and before it, its innovations and their variances."""

    after: States
    before: States
    innovation: Array
    variance: Array


def _filter(lanes: Lanes, ratio: Array) -> _Filtered:
    n, count = lanes.y.shape
    there = np.isfinite(lanes.y)
    measured = np.where(there, lanes.y, 0.0)
    before, after = (
        States(np.empty((n, count, ORDER)), np.empty((n, count, ORDER, ORDER))) for _ in range(2)
    )
    mean = np.zeros((count, ORDER))
    mean[:, 0] = measured[np.argmax(there, axis=0), np.arange(count)]
    covariance = np.broadcast_to(_DIFFUSE * np.eye(ORDER), (count, ORDER, ORDER))
    transition, process = _transition(lanes.step), _process(lanes.step, ratio)
    process[..., 0, 0] += np.where(lanes.jump, _DIFFUSE, 0.0)
    for k in range(n):
        if k:
            mean = (transition[k] @ mean[..., None])[..., 0]
            covariance = transition[k] @ covariance @ transition[k].swapaxes(-1, -2) + process[k]
        before.mean[k], before.covariance[k] = mean, covariance
        variance = covariance[:, 0, 0] + 1.0
        gain = covariance[:, :, 0] * (there[k] / variance)[:, None]
        mean = mean + gain * (measured[k] - mean[:, 0])[:, None]
        seen = covariance[:, 0] * np.where(there[k], 1.0 / variance, 1.0)[:, None]
        covariance = covariance - gain[:, :, None] * gain[:, None, :] * variance[:, None, None]
        # The same numbers without cancellation: after a jump the difference of two 1e10 would be left.
        covariance[:, 0], covariance[:, :, 0] = seen, seen
        after.mean[k], after.covariance[k] = mean, covariance
    return _Filtered(after, before, lanes.y - before.mean[..., 0], before.covariance[..., 0, 0] + 1.0)


def smooth(lanes: Lanes, ratio: Array) -> tuple[States, Array]:
    """Return the states given all samples of their lane, and how badly a jump is missed at each.

    Parameters
    ----------
    lanes : Lanes
        Samples.
    ratio : (lanes,) array
        Jerk intensity * step^5 / noise variance of each lane.

    Returns
    -------
    States, (n, lanes) array
        The array is what a jump between a sample and the one before would be, in its standard deviations,
        times the standard deviation of the noise (de Jong and Penzer, J. Am. Stat. Assoc. 93, 1998, 796-806).
    """
    filtered = _filter(lanes, ratio)
    after, before = filtered.after, filtered.before
    transition = _transition(lanes.step)[1:]
    # gain = P F' inv(P before next); solved for its transpose because both covariances are symmetric
    gain = np.linalg.solve(before.covariance[1:], transition @ after.covariance[:-1]).swapaxes(-1, -2)
    mean, covariance = after.mean.copy(), after.covariance.copy()
    for k in range(len(mean) - 2, -1, -1):
        mean[k] += (gain[k] @ (mean[k + 1] - before.mean[k + 1])[..., None])[..., 0]
        covariance[k] += gain[k] @ (covariance[k + 1] - before.covariance[k + 1]) @ gain[k].swapaxes(-1, -2)
    smoothed = States(mean, covariance)
    return smoothed, _missed_jumps(before, smoothed)


def _missed_jumps(before: States, smoothed: States) -> Array:
    pull = np.linalg.solve(before.covariance, np.eye(ORDER)[:, :1])[..., 0]
    shock = (pull * (smoothed.mean - before.mean)).sum(axis=-1)
    variance = pull[..., 0] - (pull * (smoothed.covariance @ pull[..., None])[..., 0]).sum(axis=-1)
    known = variance > 1e-6 * pull[..., 0]  # the rest is rounding: nothing was learnt since the sample before
    return np.divide(shock, np.sqrt(np.where(known, variance, 1.0)), where=known, out=np.zeros_like(shock))


def most_likely_ratio(lanes: Lanes) -> tuple[float, float]:
    """Return the ratio most likely for lanes of one signal, and the noise variance that goes with it."""
    coarse = _profile(lanes, _GRID)
    best = _GRID[np.argmin(coarse[0])]
    fine = np.linspace(best - 1.0, best + 1.0, 17)
    cost, variance = _profile(lanes, np.minimum(fine, _GRID[-1]))
    at = int(np.argmin(cost))
    return float(10.0 ** min(fine[at], _GRID[-1])), float(variance[at])


def _profile(lanes: Lanes, decades: Array) -> tuple[Array, Array]:
    """Return -2 log likelihood, and the noise variance, at each ratio, all ratios filtered side by side."""
    grid, count = len(decades), lanes.y.shape[1]
    tiled = Lanes(np.tile(lanes.y, grid), np.tile(lanes.step, grid), np.tile(lanes.jump, grid))
    filtered = _filter(tiled, np.repeat(10.0**decades, count))
    seen = np.cumsum(np.isfinite(tiled.y), axis=0)
    use = np.isfinite(tiled.y) & (seen > _BURN_IN)
    square = np.where(use, filtered.innovation**2 / filtered.variance, np.nan).reshape(-1, grid, count)
    typical = np.nanmedian(square, axis=(0, 2)) / 0.455
    square = np.nansum(np.minimum(square, _OUTLYING * typical[:, None]), axis=(0, 2))
    spread = np.where(use, np.log(filtered.variance), 0.0).reshape(-1, grid, count).sum(axis=(0, 2))
    number = max(int(use[:, :count].sum()), 1)
    variance = np.maximum(square / number, np.finfo(float).tiny)
    return number * np.log(variance) + spread, variance
