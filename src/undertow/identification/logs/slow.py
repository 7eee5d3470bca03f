"""Sensors slower than their log: a Doppler log that reports once a second in a table with six rows a second.

Such a table repeats the last report until the next comes, so that most of its rows are late by up to a
report. The mapping file names the column that tells new reports from repeated ones; the rows between two new
reports then lie on the straight line between them.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from math import comb

import numpy as np

from undertow.errors import UndertowError
from undertow.identification.logs.run import UNITS, Run
from undertow.typing import Array

_FEWEST = 10  # reports of a channel
_LOST = 3.0  # usual times between reports without one: what happened meanwhile is unknown
_ORDER = 3  # a difference of this order leaves little of a smooth motion
_NORMAL = 1.4826  # standard deviation of a normal distribution over its median absolute deviation


def changed(values: Array) -> Array:
    """Return 1 where a value differs from that of the row before, and in the first row, 0 elsewhere."""
    return np.concatenate([[1.0], values[1:] != values[:-1]])


def new_only(values: Array, flag: Array) -> Array:
    """Return the values where the flag is set, NaN where it is zero or missing."""
    return np.where(np.isfinite(flag) & (flag != 0), values, np.nan)


def on_the_clock(run: Run, names: Iterable[str]) -> Run:
    """Give channels with few samples a value in every row of the log.

    Rows between two reports lie on a straight line; where no report came for three usual times they stay
    missing. The standard deviation in `sigma` is that of white noise in every row which blurs means over
    seconds as much as the noise of the few reports does: the values in between are no news.

    Parameters
    ----------
    run : Run
        With NaN where a channel has no report.
    names : iterable of str
        Channels to deal with.

    Raises
    ------
    UndertowError
        If a channel has too few reports.
    """
    channels, sigma, notes = dict(run.channels), dict(run.sigma), []
    for name in names:
        t, reports = _reports(run, name)
        noise = _noise(reports)
        channels[name] = _between(run.t, t, reports)
        sigma[name] = noise * float(np.sqrt(len(run.t) / len(t)))
        notes.append(
            f"{name}: {len(t)} reports in {len(run.t)} rows, straight lines in between; noise of a report "
            f"{noise:.2g} {UNITS.get(name, '')}".rstrip()
        )
    return replace(run, channels=channels, sigma=sigma).noted(*notes)


def _reports(run: Run, name: str) -> tuple[Array, Array]:
    there = np.isfinite(run.channels[name])
    if there.sum() < _FEWEST:
        raise UndertowError(
            f"run {run.name!r}: channel {name!r} has {there.sum()} new reports, at least {_FEWEST} are "
            "needed: give a longer log, or remove `fresh` from the column in the mapping file"
        )
    return run.t[there], run.channels[name][there]


def _noise(reports: Array) -> float:
    wild = np.abs(np.diff(reports, n=_ORDER)) / np.sqrt(comb(2 * _ORDER, _ORDER))
    return float(_NORMAL * np.median(wild))


def _between(t: Array, known: Array, reports: Array) -> Array:
    values = np.interp(t, known, reports, left=np.nan, right=np.nan)
    after = np.clip(np.searchsorted(known, t), 1, len(known) - 1)
    apart = known[after] - known[after - 1]
    lost = (apart > _LOST * np.median(np.diff(known))) & (t > known[after - 1]) & (t < known[after])
    return np.where(lost, np.nan, values)
