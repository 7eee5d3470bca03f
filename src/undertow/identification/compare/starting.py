"""The measured motion at one instant, from the samples around it, without asking any model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import chdtri

from undertow.typing import Array, Index

from ..weak.polynomial import around, local_polynomial

# Half-widths in samples of the fits that are tried, from narrow to wide.
_WIDTHS = (2, 3, 5)
# What is left of an angle once its rate is integrated is a line over a long time.
_WIDE = (2, 3, 5, 10, 20, 40)
# A fit that misses its samples by more than noise does in one of a hundred cases is not used.
_REFUSED = 0.01
# A sample further off than this many ranges of its neighbours is an outlier.
_LONE = 3.0


def start_values(t: Array, measured: Array, names: Sequence[str], sigma: Array, at: Index) -> Array:
    """Pose and velocity at some samples of a stretch without gaps.

    Velocities and positions are smoothed over a few samples. Angles are smoothed over more, as what
    differs from the integral of the measured angular rates: that is kinematics and holds for every model.

    Parameters
    ----------
    t : (N,) array
        Time, s.
    measured : (N, 2n) array
        Channels; NaN throughout for one that is not measured.
    names : sequence of str
        Names of the channels.
    sigma : (2n,) array
        Noise of the channels, in their units.
    at : (k,) array of int
        Samples to evaluate at.

    Returns
    -------
    (k, 2n) array
        In the units of the channels; zero for a channel that is not measured.
    """
    value = np.zeros((len(at), len(names)))
    there = np.isfinite(measured).all(axis=0)
    turned = _angles_turned(t, dict(zip(names, measured.T, strict=True)))
    for i in np.flatnonzero(there).tolist():
        known = turned.get(names[i], np.zeros(len(t)))
        widths, degree = (_WIDTHS, 2) if names[i] not in turned else (_WIDE, 1)
        rest = local_value(t, measured[:, i] - known, at, float(sigma[i]), widths, degree)
        value[:, i] = rest + known[at]
    return value


def _angles_turned(t: Array, channels: dict[str, Array]) -> dict[str, Array]:
    """Integral of the measured Euler rates along a stretch, for the angles whose rates are measured."""
    zero = np.zeros(len(t))
    phi, theta, p, q, r = (np.nan_to_num(channels.get(n, zero)) for n in ("phi", "theta", "p", "q", "r"))
    around = np.sin(phi) * q + np.cos(phi) * r
    rates = {
        "phi": p + np.tan(theta) * around,
        "theta": np.cos(phi) * q - np.sin(phi) * r,
        "psi": around / np.cos(theta),
    }
    step = np.diff(t)
    return {n: np.append(0.0, np.cumsum(0.5 * step * (x[1:] + x[:-1]))) for n, x in rates.items()}


def local_value(
    t: Array, y: Array, at: Index, sigma: float, widths: Sequence[int] = _WIDTHS, degree: int = 2
) -> Array:
    """Value of a noisy signal at some of its samples.

    A polynomial is fitted to the samples around each instant, to as many of them as it fits within the noise.
    So a kink or a jump narrows the fit instead of biasing it, down to the sample itself.

    Parameters
    ----------
    t, y : (N,) array
        Time in s and signal, without gaps.
    at : (k,) array of int
        Samples to evaluate at.
    sigma : float
        Standard deviation of the white noise, in the unit of y.
    widths : sequence of int
        Half-widths in samples of the fits that are tried, from narrow to wide.
    degree : int
        Of the polynomial.

    Returns
    -------
    (k,) array
        In the unit of y.
    """
    value = _without_outlier(y, at, sigma)
    for width in widths:
        if len(t) < 2 * width + 1:
            break
        fitted, _, misfit = local_polynomial(t, y[:, None], at, width, degree)
        good = misfit[:, 0] <= sigma**2 * chdtri(2 * width - degree, _REFUSED)
        value = np.where(good, fitted[:, 0], value)
    return value


def _without_outlier(y: Array, at: Index, sigma: float) -> Array:
    """The samples themselves; one that stands far off all of its neighbours is replaced by their median."""
    if len(y) < 2 * _WIDTHS[0] + 1:
        return np.asarray(y[at])
    near = around(at, _WIDTHS[0], len(y))
    neighbours = np.where(near == at[:, None], np.nan, y[near])
    low, high = np.nanmin(neighbours, axis=1), np.nanmax(neighbours, axis=1)
    margin = _LONE * (high - low + 2 * sigma)
    lone = (y[at] < low - margin) | (y[at] > high + margin)
    return np.where(lone, np.nanmedian(neighbours, axis=1), y[at])
