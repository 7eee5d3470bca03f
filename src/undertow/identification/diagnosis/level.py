"""Whether a simulation error is the noise of the sensors: in single samples, and in means over a second.

A slow error that hides among single samples shows in means: there the noise of twenty samples has a twentieth
of its variance.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..output_error.shooting import Shooting

Array = NDArray[np.float64]
# Mean square, in units of the noise, that still counts as noise: in the worst channel and over all of them.
# The noise of a channel is known to a few per cent.
_ANY_CHANNEL, _ALL_CHANNELS = 1.3, 1.1
# Standard errors by which the mean square of a few means may exceed that.
_BY_CHANCE = 4.0
_SLOW = 1.0  # s


def simulates_to_noise(shooting: Shooting, p: Array, starts: Array) -> bool:
    """Whether the error of a simulation is noise, quick or slow.

    Parameters
    ----------
    shooting : Shooting
        Windows of logs and the model that simulates them.
    p : (n_parameters,) array
        Parameters.
    starts : (b, 2n) array
        The best start of every window.
    """
    errors = shooting.errors(p, starts)
    known = np.isfinite(shooting.windows.measured) & (shooting.weight > 0)
    if not np.any(known) or not np.all(np.isfinite(errors[known])):
        return False
    errors = errors[:, :, np.any(known, axis=(0, 1))]
    means = means_over(errors, _samples(shooting.windows.t, _SLOW))
    return _is_noise(errors, starts.size, 0.0) and _is_noise(means, starts.size, _BY_CHANCE)


def means_over(errors: Array, samples: int) -> Array:
    """Means over so many samples, times the square root of the number of those that are there.

    Parameters
    ----------
    errors : (b, k, c) array
        Errors by window, sample and channel, in units of the noise.
    samples : int
        Samples of a mean.

    Returns
    -------
    (b, k // samples, c) array
        Of unit variance where the errors are white noise; NaN where no sample is there.
    """
    whole = errors.shape[1] // samples
    parts = errors[:, : whole * samples].reshape(len(errors), whole, samples, -1)
    there = np.count_nonzero(np.isfinite(parts), axis=2)
    total = np.nansum(parts, axis=2)
    return np.divide(total, np.sqrt(there), out=np.full(total.shape, np.nan), where=there > 0)


def _samples(t: Array, seconds: float) -> int:
    """Samples in so many seconds, fewer where the windows are short."""
    step = float(np.median(np.diff(t, axis=1)))
    return int(np.clip(round(seconds / step), 1, max(t.shape[1] // 2, 1)))


def _is_noise(errors: Array, starts: int, by_chance: float) -> bool:
    """Whether the mean squares by channel and of all are those of noise; estimated starts take some up."""
    count = np.maximum(np.count_nonzero(np.isfinite(errors), axis=(0, 1)), 1)
    left = 1.0 - starts / float(count.sum())
    level = np.nansum(errors**2, axis=(0, 1)) / count / max(left, 0.1)
    any_one = _ANY_CHANNEL + by_chance * np.sqrt(2.0 / count)
    over_all = _ALL_CHANNELS + by_chance * np.sqrt(2.0 / count.sum())
    return bool(np.all(level < any_one) and np.average(level, weights=count) < over_all)
