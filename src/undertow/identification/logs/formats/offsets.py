"""By how much the clocks of two series seem to differ, where one has a place or heading and one its rate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from undertow.identification.logs.mapping import Channel, Column, LogMapping
from undertow.identification.logs.run import UNITS
from undertow.model.units import scale_offset
from undertow.typing import Array

from .fieldlog import FieldLog


@dataclass(frozen=True)
class OffsetSettings:
    """When clocks are asked about. The doctor finds and corrects offsets of a second or two."""

    fits: float = 0.8  # correlation of the two rates that shows an offset
    apart: float = 0.7  # share of it that they have as the clocks are, and at all other offsets, at most
    shared: float = 0.4  # share of the shorter series that has to overlap
    window: float = 2.0  # s over which places and headings are differentiated, and by which offsets differ
    rows: int = 20_000  # of the common grid, at most
    least: int = 200  # of each series on it


SETTINGS = OffsetSettings()
_Signal = tuple[Array, Array]  # times, s, and values


def questions_on_clocks(log: FieldLog, meaning: LogMapping) -> list[str]:
    """A question for each series whose rates fit the pose of another at another time."""
    known: dict[str, Column | Channel] = {c.channel: c for c in meaning.columns.values()}
    sources: dict[str, tuple[str, ...]] = {
        column.channel: (name,) for name, column in meaning.columns.items()
    }
    for channel, entry in meaning.channels.items():  # such as a place by latitude and longitude
        known[channel], sources[channel] = entry, entry.formula.columns
    signals = {c: _signal(log, c, known[c], names) for c, names in sources.items() if c in UNITS}
    asked: dict[str, str] = {}
    for pose, rates in ((("psi",), ("r",)), (("x", "y"), ("u", "v"))):
        found = {channel: one for channel in (*pose, *rates) if (one := signals.get(channel)) is not None}
        if not {*pose, rates[0]} <= found.keys() or len({len(found[c][0]) for c in pose}) > 1:
            continue
        at, by = (log.series_and_column(sources[channel][0])[0] for channel in (pose[0], rates[0]))
        moving = [found[c] for c in rates if c in found and len(found[c][0]) == len(found[rates[0]][0])]
        late = None if at == by else _late(_size([_rate(*found[c]) for c in pose]), _size(moving))
        if late is not None:
            asked.setdefault(
                by,
                f"{by} fits the change of {', '.join(pose)} in {at} if its times are {late:.4g} s late, and "
                f'not as they are: are they? Then its columns need delay = "{late:.4g} s"',
            )
    return [*asked.values()]


def _signal(log: FieldLog, channel: str, entry: Column | Channel, names: Sequence[str]) -> _Signal | None:
    """Times and values, in SI units, of a channel where it has any; None for one of several series."""
    if not all(map(log.has, names)):
        return None
    places = {name: log.series_and_column(name) for name in names}
    if len({series for series, _ in places.values()}) != 1:
        return None
    cells = {name: log.series[series].columns[column] for name, (series, column) in places.items()}
    values = entry.formula.of(cells) if isinstance(entry, Channel) else cells[names[0]]
    t, unit = log.series[places[names[0]][0]].t, UNITS[channel]
    there = np.isfinite(t) & np.isfinite(values)
    return t[there], scale_offset(entry.unit or unit, unit)[0] * values[there]


def _rate(t: Array, values: Array) -> _Signal:
    """The rate of a place or an unwrapped angle over a window."""
    turned = np.unwrap(values) if np.ptp(values) < 3.0 * np.pi else values
    half = SETTINGS.window / 2
    return t, (np.interp(t + half, t, turned) - np.interp(t - half, t, turned)) / SETTINGS.window


def _size(signals: list[_Signal]) -> _Signal:
    """One signal as it is, of several the length of the vector."""
    (t, first), *others = signals
    return t, np.hypot(first, others[0][1]) if others else first


def _late(pose: _Signal, rate: _Signal) -> float | None:
    """By how many s the times of the rate are late, where the two fit then, and only then."""
    from scipy.signal import fftconvolve  # slow to import

    step = max(SETTINGS.window / 4, (np.ptp(pose[0]) + np.ptp(rate[0])) / SETTINGS.rows)
    a, b = (np.interp(np.arange(t[0], t[-1], step), t, values) for t, values in (pose, rate))
    if min(len(a), len(b)) < SETTINGS.least:
        return None
    a, b = a - np.mean(a), b - np.mean(b)
    product, mine, theirs, shared = (
        fftconvolve(one, other[::-1]) for one, other in ((a, b), (a**2, b**0), (a**0, b**2), (a**0, b**0))
    )
    enough = shared > SETTINGS.shared * min(len(a), len(b))
    size = np.sqrt(np.maximum(mine, 1e-12) * np.maximum(theirs, 1e-12))
    correlation = np.where(enough, np.abs(product) / size, 0.0)
    lates = rate[0][0] - pose[0][0] - step * (np.arange(len(correlation)) - (len(b) - 1))
    best = int(np.argmax(correlation))
    others = np.abs(lates - lates[best]) > 5.0 * SETTINGS.window
    rest = max(np.max(correlation[others], initial=0.0), correlation[np.argmin(np.abs(lates))])
    certain = correlation[best] > SETTINGS.fits and rest < SETTINGS.apart * correlation[best]
    return float(lates[best]) if certain else None
