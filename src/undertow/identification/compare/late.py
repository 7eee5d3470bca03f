"""Reports that come late, along simulations that begin with a window."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from undertow.typing import Array


def reported_late(values: Array, t: Array, seconds: Array, before: Array) -> Array:
    """What is reported at each sample where every channel comes late by a time of its own.

    A window knows nothing of what was before it but what was reported at its start: from there a late channel
    goes in a straight line to the first value of the simulation, where its own time reaches the window.

    Parameters
    ----------
    values : (b, k, c, ...) array
        What would be reported at once, or derivatives of that.
    t : (b, k) array
        Time, s; not decreasing.
    seconds : (c,) array
        Delay of each channel, s.
    before : (b, c, ...) array
        What is reported at the start.

    Returns
    -------
    (b, k, c, ...) array
    """
    late = values.copy()
    rest = (1,) * (values.ndim - 3)
    for delay in np.unique(seconds[seconds > 0]):
        columns = np.flatnonzero(seconds == delay)
        index, share = _places(t, t - delay)
        old = values[:, :, columns]
        at, after = (np.take_along_axis(old, i.reshape(*t.shape, 1, *rest), 1) for i in (index, index + 1))
        with np.errstate(over="ignore", invalid="ignore"):  # a simulation on its way to infinity
            inside = at + share.reshape(*t.shape, 1, *rest) * (after - at)
        line = np.clip((t - t[:, :1]) / delay, 0.0, 1.0).reshape(*t.shape, 1, *rest)
        start = before[:, None, columns]
        early = (t - t[:, :1] < delay).reshape(*t.shape, 1, *rest)
        late[:, :, columns] = np.where(early, start + line * (old[:, :1] - start), inside)
    return late


def _places(t: Array, when: Array) -> tuple[NDArray[np.intp], Array]:
    """Interval of each row of t that an instant lies in, and the share of it that is over."""
    last = t.shape[1] - 2
    pairs = zip(t, when, strict=True)
    index = np.clip([np.searchsorted(own, w, side="right") - 1 for own, w in pairs], 0, last)
    begin, end = (np.take_along_axis(t, i, 1) for i in (index, index + 1))
    length = np.where(end > begin, end - begin, 1.0)
    return index, np.clip((when - begin) / length, 0.0, 1.0)
