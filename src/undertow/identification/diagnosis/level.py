"""Whether a simulation error is the noise of the sensors: in single samples, and in means over a second.

A slow error that hides among single samples shows in means: there the noise of twenty samples has a twentieth
of its variance.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from undertow.typing import Array

from ..output_error.shooting import Shooting

# Mean square, in units of the noise, that still counts as noise: in the worst channel and over all of them.
# The noise of a channel is known to a few per cent.
_ANY_CHANNEL, _ALL_CHANNELS = 1.3, 1.1
# Standard errors of a mean square of as many values by which it may exceed that.
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
    used = shooting.used
    if not np.any(used) or not np.all(np.isfinite(errors[used])):
        return False
    errors = errors[:, :, np.any(used, axis=(0, 1))]
    means = means_over(errors, _seconds(shooting.windows.t))
    return _is_noise(errors, starts.size) and _is_noise(means, starts.size)


def means_over(errors: Array, part: NDArray[np.intp]) -> Array:
    """Means over parts of windows, times the square root of the number of samples that are there.

    Parameters
    ----------
    errors : (b, k, c) array
        Errors by window, sample and channel, in units of the noise; NaN where there is none.
    part : (b, k) array of int
        Part of its window that a sample belongs to.

    Returns
    -------
    (b, parts, c) array
        Of unit variance where the errors are white noise; NaN where no sample is there.
    """
    windows, _, channels = errors.shape
    shape = windows, int(part.max(initial=0)) + 1, channels
    place = np.broadcast_to(np.arange(windows)[:, None], part.shape), part
    total, there = np.zeros(shape), np.zeros(shape)
    np.add.at(total, place, np.nan_to_num(errors))
    np.add.at(there, place, np.isfinite(errors).astype(float))
    return np.divide(total, np.sqrt(there), out=np.full(shape, np.nan), where=there > 0)


def _seconds(t: Array) -> NDArray[np.intp]:
    """Second of its window that a sample falls in; halves of windows that are shorter than two seconds."""
    since = t - t[:, :1]
    return np.asarray(since // min(_SLOW, max(float(since.max()) / 2.0, 1e-9)), dtype=np.intp)


def _is_noise(errors: Array, starts: int) -> bool:
    """Whether the mean squares by channel and of all are those of noise; estimated starts take some up."""
    count = np.maximum(np.count_nonzero(np.isfinite(errors), axis=(0, 1)), 1)
    left = 1.0 - starts / float(count.sum())
    level = np.nansum(errors**2, axis=(0, 1)) / count / max(left, 0.1)
    any_one = _ANY_CHANNEL + _BY_CHANCE * np.sqrt(2.0 / count)
    over_all = _ALL_CHANNELS + _BY_CHANCE * np.sqrt(2.0 / count.sum())
    return bool(np.all(level < any_one) and np.average(level, weights=count) < over_all)
