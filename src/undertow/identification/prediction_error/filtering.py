"""Kalman filter and smoother over linearised windows, for the motion and its derivatives at the same time.

The gains do not depend on the parameters once the windows are linearised, so that one pass takes innovations
and their derivatives through the filter side by side. Their whitened sum of squares is that of least squares
over the parameters and all states together (multiple shooting), with the states eliminated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from undertow.typing import Array

from ..weak.step import inverse_of
from .linear import LinearWindows


@dataclass(frozen=True)
class Noise:
    """What is random in the model.

    Attributes
    ----------
    variance : (2n,) array
        Of the noise of the channels, in the square of their units.
    intensity : (3n,) array
        Of what changes each state beside the model, its square per second: zero for a pose, the strength of
        the white disturbance of an acceleration for a velocity, the wander of its slow part at last.
    vague : (3n,) array
        Standard deviation of the state at the start of a stretch before anything is measured.
    """

    variance: Array
    intensity: Array
    vague: Array


@dataclass(frozen=True)
class Filtered:
    """What a pass leaves.

    Attributes
    ----------
    table : (m, 1 + n_free) array
        Whitened innovations with their derivatives.
    window, channel : (m,) array
        Where each of them is from.
    log_determinant : float
        Sum of the logarithms of the innovations' variances.
    predicted, seen : list of (array, array)
        State (3n, 1 + n_free) and its covariance, before and after each window's samples are seen.
    """

    table: Array
    window: NDArray[np.intp]
    channel: NDArray[np.intp]
    log_determinant: float
    predicted: list[tuple[Array, Array]]
    seen: list[tuple[Array, Array]]


def filtered(linear: LinearWindows, last: NDArray[np.bool_], seconds: Array, noise: Noise) -> Filtered:
    """One pass over all windows in order of time.

    Parameters
    ----------
    linear : LinearWindows
        The windows.
    last : (b,) array of bool
        Windows with which a stretch ends.
    seconds : (b,) array
        Their length, s.
    noise : Noise
        Of the channels and of the motion.
    """
    columns, size = linear.defect.shape[2], linear.defect.shape[1]
    rows, windows, channels, predicted, seen = [], [], [], [], []
    logarithm, fresh = 0.0, True
    mean, spread = np.zeros((size, columns)), np.diag(noise.vague**2)
    for j in range(len(linear.defect)):
        if fresh:
            mean, spread = np.zeros((size, columns)), np.diag(noise.vague**2)
        predicted.append((mean, spread))
        used = linear.used[j].ravel()
        H = linear.by_start[j].reshape(-1, size)[used]
        channel = np.tile(np.arange(linear.used.shape[2]), linear.used.shape[1])[used]
        innovation = linear.error[j].reshape(-1, columns)[used] + H @ mean
        across = H @ spread
        factor = np.linalg.cholesky(across @ H.T + np.diag(noise.variance[channel]))
        white = np.linalg.solve(factor, np.column_stack([innovation, across]))
        mean = mean - white[:, columns:].T @ white[:, :columns]
        spread = _symmetric(spread - white[:, columns:].T @ white[:, columns:])
        logarithm += 2.0 * float(np.sum(np.log(np.diag(factor))))
        seen.append((mean, spread))
        rows.append(white[:, :columns])
        windows.append(np.full(len(channel), j))
        channels.append(channel)
        fresh = bool(last[j])
        F = linear.by_end[j]
        mean = linear.defect[j] + F @ mean
        spread = _symmetric(F @ spread @ F.T) + np.diag(noise.intensity * seconds[j])
    table, window, channel = (np.concatenate(part) for part in (rows, windows, channels))
    return Filtered(table, window, channel, logarithm, predicted, seen)


def _symmetric(matrix: Array) -> Array:
    return np.asarray((matrix + matrix.T) / 2)


@dataclass(frozen=True)
class Smoothed:
    """The motion given all that is measured, and the noise that explains it.

    Attributes
    ----------
    motion : (b, 3n, 1 + n_free) array
        Change of every state, and its derivative in the free parameters.
    disturbance : (3n, 2) array
        Sum of the squared disturbances over their length, and how many of them the data tell, by state.
    errors : (2n, 2) array
        Sum of the squared errors of the channels, and how many are left to tell their noise.
    """

    motion: Array
    disturbance: Array
    errors: Array


def smoothed(
    linear: LinearWindows, last: NDArray[np.bool_], seconds: Array, noise: Noise, passed: Filtered
) -> Smoothed:
    """The way back, from the last window to the first (Rauch, Tung and Striebel)."""
    count, size, columns = linear.defect.shape
    motion = np.zeros((count, size, columns))
    disturbance, errors = np.zeros((size, 2)), np.zeros((len(noise.variance), 2))
    later = np.zeros((size, size))
    for j in reversed(range(count)):
        mean, spread = passed.seen[j]
        if not last[j]:
            ahead, cover = passed.predicted[j + 1]
            inverse = inverse_of(cover)
            change, shrink = motion[j + 1] - ahead, later - cover
            disturbance += _told(noise.intensity * seconds[j], seconds[j], inverse, change, shrink)
            gain = spread @ linear.by_end[j].T @ inverse
            mean, spread = mean + gain @ change, _symmetric(spread + gain @ shrink @ gain.T)
        motion[j], later = mean, spread
        errors += _left(linear, j, mean, spread, noise.variance)
    return Smoothed(motion, disturbance, errors)


def _told(intensity: Array, seconds: float, inverse: Array, change: Array, shrink: Array) -> Array:
    """Squared disturbance of one window over its length, and the share of it that the data tell, by state."""
    size = intensity * (inverse @ change[:, 0])
    share = -intensity * np.diag(inverse @ shrink @ inverse)
    return np.column_stack([size**2 / max(seconds, 1e-12), share])


def _left(linear: LinearWindows, j: int, mean: Array, spread: Array, variance: Array) -> Array:
    """Squared errors of one window's samples after smoothing, and how many of them are free, by channel."""
    H = linear.by_start[j]
    error = linear.error[j][..., 0] + H @ mean[:, 0]
    taken = np.einsum("kci,ij,kcj->kc", H, spread, H) / variance
    used = linear.used[j]
    return np.column_stack([np.sum(error**2 * used, axis=0), np.sum((1.0 - taken) * used, axis=0)])
