"""Polynomials fitted to the samples around each instant of a signal."""

from __future__ import annotations

import numpy as np

from undertow.typing import Array, Index

from .noise import white_noise

# Half-widths in samples of the fits that a rate is taken from, from narrow to wide.
_WIDTHS = (3, 5, 8, 13, 20, 32)
_DEGREE = 3
# Samples at which the widths are tried.
_LOOKS = 300
# Square of what a fit leaves, relative to what noise leaves, from which it bends the signal.
_BENT = 1.2


def around(at: Index, width: int, count: int) -> Index:
    """Indices of the 2 width + 1 samples around each instant, moved inwards at the ends of the signal."""
    first = np.clip(at - width, 0, count - 2 * width - 1)
    return np.asarray(first[:, None] + np.arange(2 * width + 1))


def local_polynomial(t: Array, y: Array, at: Index, width: int, degree: int) -> tuple[Array, Array, Array]:
    """Least squares fit of a polynomial to the 2 width + 1 samples around some samples of a signal.

    Parameters
    ----------
    t : (N,) array
        Time, s; N at least 2 width + 1.
    y : (N, c) array
        Signals, without gaps.
    at : (k,) array of int
        Samples to evaluate at.

    Returns
    -------
    value, rate, misfit : (k, c) arrays
        The polynomials there, in the units of y, their derivatives, per s, and their sums of squared errors.
    """
    near = around(at, width, len(t))
    span = t[near[:, -1]] - t[near[:, 0]]
    place = (t[near] - t[at][:, None]) / span[:, None]
    design = place[:, :, None] ** np.arange(degree + 1)
    across = np.swapaxes(design, 1, 2)
    # Around the sample itself, so that a large offset (a position) costs no digits.
    samples = y[near] - y[at][:, None]
    coefficients = np.linalg.solve(across @ design, across @ samples)
    misfit = np.sum((samples - design @ coefficients) ** 2, axis=1)
    return y[at] + coefficients[:, 0], coefficients[:, 1] / span[:, None], misfit


def smooth_rate(t: Array, y: Array) -> Array:
    """Derivative of noisy signals, per s, from cubics over as many samples as they fit within the noise.

    Parameters
    ----------
    t : (N,) array
        Time, s.
    y : (N, c) array
        Signals, without gaps.

    Returns
    -------
    (N, c) array
    """
    if len(t) <= 2 * _WIDTHS[0]:
        return np.gradient(y, t, axis=0)
    rate, every = np.empty_like(y), np.arange(len(t))
    width = _widest(t, y)
    for chosen in np.unique(width).tolist():
        columns = np.flatnonzero(width == chosen)
        rate[:, columns] = local_polynomial(t, y[:, columns], every, chosen, _DEGREE)[1]
    return rate


def _widest(t: Array, y: Array) -> Index:
    """Half-width of the widest fits that leave no more than noise at most instants, by signal."""
    noise = np.array([white_noise(t, column) for column in y.T])
    some = np.unique(np.linspace(0, len(t) - 1, _LOOKS).astype(np.intp))
    found = np.full(y.shape[1], _WIDTHS[0])
    for width in (w for w in _WIDTHS if 2 * w < len(t)):
        misfit = local_polynomial(t, y, some, width, _DEGREE)[2]
        found[np.median(misfit, axis=0) <= _BENT * noise**2 * (2 * width - _DEGREE)] = width
    return found
