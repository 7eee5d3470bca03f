"""Logs of several series, each with times of its own, on the rows of one clock."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from undertow.errors import UndertowError
from undertow.typing import Array, Flags, Index

from .run import GAPS, MEASURED, UNITS, Run


@dataclass(frozen=True)
class SeriesSettings:
    """Numbers by which a table is known to hold several series, and by which these get common rows."""

    # Share of its rows that a channel must lack, in spells as short as it usually has, to be a series of its
    # own: samples that get lost are fewer. How many of its samples it takes to tell, and to know the noise.
    blank: float = 0.1
    telling: int = 24
    fewest: int = 10
    # Usual times between reports without one: what happened meanwhile is unknown.
    lost: float = 3.0
    # Share of the noise of a report that the motion makes in the time by which the report is moved to a row
    # that is there already, at most: the variance of its error grows by 3 % at most.
    moved: float = 0.3
    # Share of the clock's step that stamps of one time may differ by: they were rounded.
    together: float = 1e-3
    # Share of the reports of the rarest column of a formula that may lack another one beside them: one clock
    # loses fewer, and reports of two clocks meet by chance in fewer.
    apart: float = 0.5
    order: int = 3  # a difference of this order leaves little of a smooth motion
    places: int = 100_000  # reports at which it is taken: they know the noise to half a per cent
    gaussian_mad: float = 1.4826  # standard deviation over median magnitude, of a Gaussian
    # Standard deviations from which a difference is not noise, and the variance of a Gaussian cut off there.
    outlying: float = 3.5
    variance_within: float = 0.9939


SETTINGS = SeriesSettings()


@dataclass(frozen=True)
class Series:
    """Reports of a channel, in order of time."""

    t: Array  # (k,) when what they report was true, s
    y: Array  # (k,) in the unit of the channel
    noise: float | None = None  # standard deviation, where it is stated

    @classmethod
    def of(cls, t: Array, column: Array, noise: float | None) -> Series:
        """Reports of a column (n,) with blanks."""
        there = ~np.isnan(column)
        return cls(t[there], column[there], noise)

    def usual(self) -> float:
        """Usual time between reports, s; none of a single one."""
        return float(np.median(np.diff(self.t))) if len(self.t) > 1 else np.inf

    def movable(self) -> float:
        """Time, s, in which the motion changes the channel by less than can be seen in a report."""
        noise = report_noise(self.t, self.y) if self.noise is None else self.noise
        change = np.diff(self.y)
        own = np.sqrt(max(float(np.mean(change**2)) - 2 * noise**2, 0.0)) if len(change) else 0.0
        return SETTINGS.moved * noise * self.usual() / own if own > 0 else self.usual()


@dataclass(frozen=True)
class OneClock:
    """Series on common rows."""

    t: Array  # (n,) s
    channels: dict[str, Array]  # (n,) each, NaN where a channel was not known
    reported: dict[str, Flags]  # (n,) rows with a report, of measured channels that do not report in all
    several: bool = True  # whether there was more than one
    wrapped: dict[str, Array] = field(default_factory=dict)  # (n,) reports of angles that jump, as logged

    def in_rows(self, name: str, column: Array) -> Array:
        """Cells of a column (with blanks) in the rows of its reports, NaN in the others."""
        found = np.full(len(self.t), np.nan)
        found[self.reported.get(name, slice(None))] = column[~np.isnan(column)]
        return found


def are_several(t: Array, table: Mapping[str, Array]) -> bool:
    """Tell whether columns (n,) with blanks hold several series: one of them is blank in a regular way."""
    return any(_regularly_blank(t, column) for column in table.values())


def _regularly_blank(t: Array, column: Array) -> bool:
    at = np.flatnonzero(~np.isnan(column))
    if len(at) < SETTINGS.telling or len(at) == len(t):
        return False
    apart = np.diff(t[at])
    rows = np.diff(at)[apart <= SETTINGS.lost * np.median(apart)]
    return bool(np.sum(rows - 1) > SETTINGS.blank * np.sum(rows))


def on_one_clock(
    series: Mapping[str, Series], before: Mapping[str, float], clock: Array | None = None
) -> OneClock:
    """Bring series to common rows: those of the measured channel that reports most often, and few others.

    A report moves to a row that is there if the motion between the two times cannot be seen in it; else it
    gets a row. A row without a report of a measured channel has what the curve through the reports says, or
    nothing where these are further apart than usual. All others are held: a row has the mean of what was held
    until the next, so that no row is needed for a command and its impulse is kept; `before` says what was
    held before the first. Where a `clock` (n,) is given, its rows are the first.
    """
    some = {n: s for n, s in series.items() if len(s.t)}
    measured = {n: s for n, s in some.items() if n in MEASURED}
    t, places = _rows(list((measured or some).values()), clock)
    channels, reported = {}, {}
    for name in series.keys() - measured.keys():
        known = np.nan if name in MEASURED else before.get(name, np.nan)
        channels[name] = _held(t, series[name], known)
    for (name, one), at in zip(measured.items(), places, strict=False):
        there = np.zeros(len(t), dtype=bool)
        there[at] = True
        channels[name] = between(t, one.t, one.y)
        channels[name][at] = one.y
        if not there.all():
            reported[name] = there
    return OneClock(t, {n: channels[n] for n in series}, reported)


def _rows(series: list[Series], clock: Array | None) -> tuple[Array, list[Index]]:
    """Times of the common rows, and in which of them each series reports."""
    stamps: dict[bytes, list[Series]] = {}
    for one in series:
        stamps.setdefault(one.t.tobytes(), []).append(one)
    groups = sorted(stamps.items(), key=lambda item: -len(item[1][0].t))
    fastest = groups[0][1][0]
    t, taken = fastest.t if clock is None else clock, {}
    for key, group in groups:
        reach = max(SETTINGS.together * fastest.usual(), min(one.movable() for one in group))
        taken[key] = _taken(t, group[0].t, reach)
        t = np.union1d(t, taken[key])
    place = {key: np.searchsorted(t, times) for key, times in taken.items()}
    return t, [place[one.t.tobytes()] for one in series]


def _taken(rows: Array, t: Array, reach: float) -> Array:
    """Times of the rows that reports go to: of those that are there if near enough, or their own."""
    after = np.clip(np.searchsorted(rows, t), min(1, len(rows) - 1), len(rows) - 1)
    before = np.maximum(after - 1, 0)
    near = rows[np.where(t - rows[before] <= rows[after] - t, before, after)]
    apart = np.abs(near - t)
    order = np.lexsort((apart, near))
    first = np.empty(len(t), dtype=bool)  # of the reports that are nearest to the same row
    first[order] = np.diff(near[order], prepend=-np.inf) > 0
    return np.where((apart <= reach) & first, near, t)


def between(t: Array, known: Array, reports: Array) -> Array:
    """What a curve through reports says at times t (n,); NaN outside of them and where reports are lost.

    The curve is monotone from one report to the next (Fritsch and Butland, 1984): it never goes beyond them,
    also where a burst of reports came at once, and misses far less of a smooth motion than a straight line.
    """
    from scipy.interpolate import PchipInterpolator  # slow to import, and few logs come this far

    if len(known) < 2:
        return np.full(len(t), np.nan)
    return np.where(in_gaps(known, t), np.nan, PchipInterpolator(known, reports, extrapolate=False)(t))


def in_gaps(clock: Array, t: Array) -> Flags:
    """Which of the times t (n,) lie where a clock (k,), of at least two times, has lost some."""
    after = np.clip(np.searchsorted(clock, t), 1, len(clock) - 1)
    apart = clock[after] - clock[after - 1]
    return (apart > _longest(np.median(np.diff(clock)))) & (t > clock[after - 1]) & (t < clock[after])


def _longest(usual: float) -> float:
    """Longest time between reports, s, between which something is known, where so much is usual."""
    return max(SETTINGS.lost * usual, GAPS.harmless)


def _held(t: Array, one: Series, before: float) -> Array:
    """Mean from each row to the next of what was held; NaN where that is not known, or older than usual."""
    first = min(t[0], one.t[0]) if len(one.t) else t[0]
    times, values = np.concatenate([[first], one.t]), np.concatenate([[before], one.y])
    at = np.searchsorted(times, t, side="right") - 1
    held = values[at]
    last = np.searchsorted(times, t[1:], side="left") - 1
    new = np.flatnonzero((last > at[:-1]) & np.isfinite(held[:-1]))
    total = np.append(0.0, np.cumsum(np.nan_to_num(values[:-1]) * np.diff(times)))
    until = [total[i] + np.nan_to_num(values[i]) * (x - times[i]) for i, x in ((at, t), (last, t[1:]))]
    held[new] = (until[1][new] - until[0][new]) / np.diff(t)[new]
    old = (at > 0) & (t - times[at] > _longest(one.usual()))
    return np.where(old, np.nan, held)


def report_noise(t: Array, y: Array) -> float:
    """Standard deviation of the white noise of reports (k,) at times that need not be even.

    From divided differences: the combination of neighbours in which a parabola vanishes.
    """
    count = SETTINGS.order + 1
    if len(t) <= count:
        return 0.0
    first = np.linspace(0, len(t) - count, min(len(t) - SETTINGS.order, SETTINGS.places)).astype(np.intp)
    index = first[:, None] + np.arange(count)
    apart = t[index][:, :, None] - t[index][:, None, :]
    weight = 1.0 / np.prod(apart + np.eye(count), axis=2)
    wild = np.sum(weight * y[index], axis=1) / np.linalg.norm(weight, axis=1)
    return float(np.sqrt(noise_variance(wild)))


def noise_variance(wild: Array) -> float:
    """Variance of noise (k,) that may have a few kinks and jumps of a motion in it.

    Of what is no kink or jump the mean square is known twice as well as the median.
    """
    rough = robust_scale(wild)
    within = wild[np.abs(wild) <= SETTINGS.outlying * rough]
    return float(np.mean(within**2)) / SETTINGS.variance_within if len(within) else 0.0


def robust_scale(errors: Array) -> float:
    """Standard deviation by the median magnitude, of which up to half may be anything; 1 of none."""
    return SETTINGS.gaussian_mad * float(np.median(np.abs(errors))) if len(errors) else 1.0


def with_report_noise(run: Run, must: Collection[str] = (), *, part: bool = False) -> Run:
    """Estimate the noise of channels that do not report in every row, where it is not stated.

    Differences from row to row would not show it: in between lie smooth curves. A channel with hardly a
    report is left out, or refused if it is among those that `must` be there; a `part` of a log may have one.
    """
    sigma, notes, few = dict(run.sigma), [], []
    for name, there in run.reported.items():
        t, reports = run.t[there], run.channels[name][there]
        if len(t) >= SETTINGS.fewest:
            sigma[name] = sigma.get(name) or report_noise(t, reports)
            notes.append(
                f"{name}: {len(t)} reports in {len(run.t)} rows; noise of a report {sigma[name]:.2g} "
                f"{UNITS.get(name, '')}".rstrip()
            )
        elif name in must and not part:
            raise UndertowError(
                f"run {run.name!r}: channel {name!r} has {len(t)} new reports, at least {SETTINGS.fewest} "
                "are needed: give a longer log, or leave out the column (`ignore` in the mapping file)"
            )
        elif not part:
            few.append(name)
            notes.append(f"{name}: left out, as it has {len(t)} reports; {SETTINGS.fewest} are needed")
    channels = {n: data for n, data in run.channels.items() if n not in few}
    reported = {n: there for n, there in run.reported.items() if n not in few}
    return replace(run, channels=channels, reported=reported, sigma=sigma).with_notes(*notes)


def with_reports(run: Run, values: Mapping[str, Array]) -> Run:
    """A run with other reports of some channels (n,), NaN where there is none; curves in between."""
    channels, reported = dict(run.channels), dict(run.reported)
    for name, data in values.items():
        channels[name] = data
        if name in reported:
            there = np.isfinite(data)
            channels[name] = np.where(there, data, between(run.t, run.t[there], data[there]))
            reported[name] = there
    return replace(run, channels=channels, reported=reported)


def shared_rows(columns: Mapping[str, Array]) -> float:
    """Share of the reports of the rarest column that the others have in the same row; 1 without reports."""
    there = [np.isfinite(column) for column in columns.values()]
    fewest = min(map(np.count_nonzero, there), default=0)
    return float(np.count_nonzero(np.all(there, axis=0)) / fewest) if fewest else 1.0


def held_together(columns: Mapping[str, Array]) -> dict[str, Array]:
    """Columns that are held until their next report, in the rows where one of them reports."""
    reports = np.any([np.isfinite(column) for column in columns.values()], axis=0)
    return {name: np.where(reports, last_known(column), np.nan) for name, column in columns.items()}


def last_known(column: Array) -> Array:
    """A column, or several side by side, whose reports are held until the next; NaN before the first."""
    row = np.arange(len(column)).reshape(-1, *(1,) * (column.ndim - 1))
    last = np.maximum.accumulate(np.where(np.isfinite(column), row, 0), axis=0)
    held = np.take_along_axis(column, last, axis=0)
    return np.where(np.isfinite(held), held, np.nan)
