"""The measured motion at one instant, from the samples around it, without asking any model."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

Array = NDArray[np.float64]
Index = NDArray[np.intp]
# Half-widths in samples of the quadratic fits that are tried, from narrow to wide.
WIDTHS = (2, 3, 5)
_DEGREE = 2
# A quadratic that misses its samples by more than noise does in one of a hundred cases is not used.
_REFUSED = 0.01
# A sample further off than this many ranges of its neighbours is an outlier.
_LONE = 3.0


def local_value(t: Array, y: Array, at: Index, sigma: float) -> Array:
    """Value of a noisy signal at some of its samples.

    A quadratic is fitted to the samples around each instant: to five samples, then to more as long as it
    fits them within the noise. So a kink or a jump narrows the fit instead of biasing it, down to the sample
    itself.

    Parameters
    ----------
    t, y : (N,) array
        Time in s and signal, without gaps.
    at : (k,) array of int
        Samples to evaluate at.
    sigma : float
        Standard deviation of the white noise, in the unit of y.

    Returns
    -------
    (k,) array
        In the unit of y.
    """
    value = _without_outlier(y, at, sigma)
    open_ = np.ones(len(at), dtype=bool)
    for width in WIDTHS:
        if len(t) < 2 * width + 1:
            break
        fitted, misfit = _quadratic(t, y, at, width)
        limit = sigma**2 * chdtri(2 * width - _DEGREE, _REFUSED)
        open_ &= misfit <= limit
        value = np.where(open_, fitted, value)
    return value


def _around(at: Index, width: int, count: int) -> Index:
    """Indices of the 2 width + 1 samples around each instant, moved inwards at the ends of the signal."""
    first = np.clip(at - width, 0, count - 2 * width - 1)
    return first[:, None] + np.arange(2 * width + 1)


def _quadratic(t: Array, y: Array, at: Index, width: int) -> tuple[Array, Array]:
    """Value at each instant of the quadratic through the samples around it, and its squared misfit."""
    near = _around(at, width, len(t))
    span = t[near[:, -1]] - t[near[:, 0]]
    place = (t[near] - t[at][:, None]) / span[:, None]
    design = place[:, :, None] ** np.arange(_DEGREE + 1)
    gram = np.swapaxes(design, 1, 2) @ design
    # Around the sample itself, so that a large offset (a position) costs no digits.
    samples = y[near] - y[at][:, None]
    coefficients = np.linalg.solve(gram, np.swapaxes(design, 1, 2) @ samples[:, :, None])
    misfit = samples - (design @ coefficients)[:, :, 0]
    return y[at] + coefficients[:, 0, 0], np.sum(misfit**2, axis=1)


def _without_outlier(y: Array, at: Index, sigma: float) -> Array:
    """The samples themselves; one that stands far off all of its neighbours is replaced by their median."""
    if len(y) < 2 * WIDTHS[0] + 1:
        return y[at]
    near = _around(at, WIDTHS[0], len(y))
    neighbours = np.where(near == at[:, None], np.nan, y[near])
    low, high = np.nanmin(neighbours, axis=1), np.nanmax(neighbours, axis=1)
    margin = _LONE * (high - low + 2 * sigma)
    lone = (y[at] < low - margin) | (y[at] > high + margin)
    return np.where(lone, np.nanmedian(neighbours, axis=1), y[at])
