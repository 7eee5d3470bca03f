"""A run: one segment of measurement on one clock, in SI, with its gaps left open; series of other clocks."""

from __future__ import annotations

import builtins
from collections.abc import Collection, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from undertow.errors import UndertowError
from undertow.model.symbols import FORCE_UNITS, MOTION_UNITS, POSE, VELOCITY
from undertow.notebook import html
from undertow.typing import Array, Flags, Index

if TYPE_CHECKING:
    from .mapping import LogMapping


FORCES = ("tau_X", "tau_Y", "tau_Z", "tau_K", "tau_M", "tau_N")
ACCELERATION = tuple(f"{name}_dot" for name in VELOCITY)
UNITS = {
    **MOTION_UNITS,
    **dict(zip(FORCES, FORCE_UNITS, strict=True)),
    **{name: f"{MOTION_UNITS[name.removesuffix('_dot')]}^2" for name in ACCELERATION},
}
MEASURED = frozenset(POSE + VELOCITY + ACCELERATION)
"""Channels that a sensor of the motion reports; all others are held until they change."""


@dataclass(frozen=True)
class GapSettings:
    """Limits on gaps."""

    steps: float = 5.0  # times the usual step: a longer step ends a segment
    # Longest gap, s, over which a simulation continues: the shortest time constants of vehicles that carry a
    # computer are three times as long and more.
    harmless: float = 0.1


GAPS = GapSettings()


@dataclass(frozen=True, eq=False, repr=False)
class Run:
    """One log on one clock.

    Attributes
    ----------
    name : str
        Name of the run in reports.
    t : (n,) array
        Time in s, strictly increasing, in general not evenly spaced.
    channels : dict of (n,) arrays
        SI values by channel name (``x y z phi theta psi u v w p q r``, ``u_dot`` …, thruster names,
        ``tau_X`` …);
        NED and forward-starboard-down axes; NaN where a sample is missing. Arrays are read-only.
    reported : dict of (n,) bool arrays
        Rows in which a channel was measured, for channels that do not report in all of them. In the other
        rows `channels` has interpolated values: regressors may use them, errors are never computed from them.
    source, sha256 : str
        The file the run was read from, and the hash of its bytes.
    notes : tuple of str
        Conversions, dropped data and anomalies, one line each.
    reader_notes : tuple of str
        Notes of the reader of a vehicle log, beginning with the name of the format; empty for a table.
    sigma : dict of float
        Known standard deviations of the noise of a report, in the unit of the channel.
    derived : frozenset of str
        Names of channels computed from others (velocities from pose).
    resolution : float
        Time constant in s of the smoother of the `derived` channels; faster changes are smoothed out.
    mapping : Mapping, optional
        How the columns of the file were read; None where the run was not read from a file.
    wrapped : dict of (n,) arrays
        Angles that jump by full turns in the log, as logged; in `channels` they are unwrapped.
    held : tuple of str
        Motions held at rest, or moved as logged, by a rig.
    part_of : str
        Name of the run that this is a segment of; empty for a whole run.
    outliers : dict of int
        Samples of the pose that were removed because the others contradict them.
    shifts : dict of (k, 2) arrays
        Steps of the pose that were taken for shifts of its origin: their size, and the seconds since the
        sample before.
    dropped : int
        Rows of the file that were left out because their time was not later than that of an earlier row.
    """

    name: str
    t: NDArray[np.float64]
    channels: Mapping[str, NDArray[np.float64]]
    source: str = ""
    sha256: str = ""
    notes: tuple[str, ...] = ()
    sigma: Mapping[str, float] = field(default_factory=dict)
    derived: frozenset[str] = frozenset()
    resolution: float = 0.0
    mapping: LogMapping | None = None
    wrapped: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    outliers: Mapping[str, int] = field(default_factory=dict)
    shifts: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    dropped: int = 0
    part_of: str = ""
    reported: Mapping[str, Flags] = field(default_factory=dict)
    reader_notes: tuple[str, ...] = ()
    held: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        try:
            object.__setattr__(self, "t", _frozen(self.t))
            for field_name in ("channels", "wrapped"):
                tables = {name: _frozen(data) for name, data in getattr(self, field_name).items()}
                object.__setattr__(self, field_name, tables)
        except (AttributeError, TypeError, ValueError) as error:
            raise UndertowError(
                f"run {self.name!r:.60}: {error}: give t as an array of numbers, channels as arrays by name"
            ) from error
        if self.t.ndim != 1:
            raise UndertowError(f"run {self.name!r:.60}: t has shape {self.t.shape}: give one time a sample")
        for name, data in (*self.channels.items(), *self.reported.items()):
            if data.shape != self.t.shape:
                raise UndertowError(
                    f"run {self.name!r}: channel {name!r} has shape {data.shape}, t has {self.t.shape}: "
                    "give one sample per time"
                )

    def __repr__(self) -> str:
        span = f"{self.t[0]:g} to {self.t[-1]:g} s" if len(self.t) else "no time"
        return (
            f"Run {self.name}: {len(self.t)} samples, {span}; channels {', '.join(self.channels) or 'none'}"
        )

    def _repr_html_(self) -> str:
        head = ("channel", "unit", "samples", "least", "mean", "greatest")
        return html(repr(self), head, (_channel_row(name, data) for name, data in self.channels.items()))

    @property
    def origin(self) -> str:
        """Name of the run that this is, or is a segment of: what differs between runs is the same in it."""
        return self.part_of or self.name

    def has(self, name: str) -> bool:
        """Tell whether the run has a channel of this name."""
        return name in self.channels

    def matrix(self, names: Iterable[str]) -> NDArray[np.float64]:
        """Return channels side by side.

        Parameters
        ----------
        names : iterable of str
            k channel names.

        Returns
        -------
        (n, k) array

        Raises
        ------
        UndertowError
            If the run lacks one of them.
        """
        wanted = list(names)
        for name in wanted:
            if not self.has(name):
                have = ", ".join(self.channels) or "no channel"
                raise UndertowError(f"run {self.name!r} has no channel {name!r}: it has {have}")
        return self.known(wanted)

    def known(self, names: Sequence[str]) -> NDArray[np.float64]:
        """Return channels side by side, shape (n, k); zero for one that the run lacks."""
        zero = np.zeros(len(self.t))
        columns = [self.channels.get(name, zero) for name in names]
        return np.column_stack(columns) if columns else np.empty((len(self.t), 0))

    def reports(self, name: str) -> NDArray[np.float64]:
        """Return a channel with NaN in the rows in which it was not measured, shape (n,)."""
        there = self.reported.get(name)
        return self.channels[name] if there is None else np.where(there, self.channels[name], np.nan)

    def rows_per_report(self, name: str) -> float:
        """Return how many rows there are for each report of a channel; 1 where every row is one."""
        there = self.reported.get(name)
        return 1.0 if there is None else len(self.t) / max(int(np.count_nonzero(there)), 1)

    def period(self, name: str) -> float:
        """Return the usual time, s, between reports of a channel."""
        there = self.reported.get(name)
        few = there is None or np.count_nonzero(there) < 2
        return float(np.median(np.diff(self.t if few else self.t[there])))

    @property
    def clock(self) -> NDArray[np.float64]:
        """Times, s, of the measured channel that reports most often: all rows unless each lacks some."""
        every = np.ones(len(self.t), dtype=bool)
        most = max(self.reported.values(), key=np.count_nonzero, default=every)
        # Velocities derived from the pose have a value in rows of other sensors, too.
        whole = not {*self.reported} >= MEASURED.intersection(self.channels) - self.derived
        return self.t if whole or np.count_nonzero(most) < 2 else self.t[most]

    @cached_property
    def step(self) -> float:
        """Usual time between rows of the clock, s."""
        return float(np.median(np.diff(self.clock)))

    def slice(self, t_min: float | None = None, t_max: float | None = None) -> Run:
        """Return the samples with ``t_min <= t <= t_max`` as a run of its own (None: no limit).

        Raises
        ------
        UndertowError
            If no sample is left.
        """
        low, high = (-np.inf if t_min is None else t_min), (np.inf if t_max is None else t_max)
        keep = (self.t >= low) & (self.t <= high)
        if not keep.any():
            raise UndertowError(
                f"run {self.name!r} has no sample in the time window {low:g} to {high:g} s: "
                f"it lasts from {self.t[0]:g} to {self.t[-1]:g} s"
            )
        return self._rows(keep)

    def head(self, count: int) -> Run:
        """Return the first samples as a run of its own."""
        return self._rows(builtins.slice(count))

    def without(self, names: Collection[str]) -> Run:
        """Return the run without some channels."""
        channels = {n: data for n, data in self.channels.items() if n not in names}
        reported = {n: there for n, there in self.reported.items() if n not in names}
        return replace(self, channels=channels, reported=reported)

    def _rows(self, rows: Flags | builtins.slice) -> Run:
        channels, wrapped = (
            {name: data[rows] for name, data in table.items()} for table in (self.channels, self.wrapped)
        )
        reported = {name: there[rows] for name, there in self.reported.items()}
        return replace(self, t=self.t[rows], channels=channels, wrapped=wrapped, reported=reported)

    def segments(self, names: Iterable[str] = (), *, across: float = 0.0) -> list[builtins.slice]:
        """Return index slices without a time step longer than five usual steps.

        Parameters
        ----------
        names : iterable of str
            If given, a sample where one of these channels is missing also ends a segment.
        across : float
            Time step, s, that ends none, however many usual steps it is.

        Returns
        -------
        list of slice
            In order of time; each holds at least one sample.
        """
        whole = np.asarray(np.isfinite(self.matrix(names)).all(axis=1))
        step = np.diff(self.t)
        usual = max(float(np.median(step)), self.step) if len(step) else 0.0
        no_gap = step <= max(GAPS.steps * usual, across)
        joined = np.concatenate([[False], no_gap & whole[1:] & whole[:-1], [False]])
        starts, stops = np.flatnonzero(whole & ~joined[:-1]), np.flatnonzero(whole & ~joined[1:]) + 1
        return [builtins.slice(int(start), int(stop)) for start, stop in zip(starts, stops, strict=True)]

    def with_notes(self, *notes: str) -> Run:
        """Return the run with lines added to its notes."""
        return replace(self, notes=(*self.notes, *notes))


def _channel_row(name: str, data: NDArray[np.float64]) -> tuple[object, ...]:
    """Row of a channel for a notebook."""
    there = data[np.isfinite(data)]
    span = tuple(float(x) for x in (there.min(), there.mean(), there.max())) if len(there) else (None,) * 3
    return name, UNITS.get(name, ""), len(there), *span


@dataclass(frozen=True)
class JumpSettings:
    """When an angle was interpolated or averaged across its jump by a turn."""

    fastest: float = np.pi  # rate that no vehicle turns at, rad/s
    # The same relative to the rate below which this vehicle is in such a share of the samples where it turns.
    times_usual: float = 5.0
    usual: float = 0.95
    tolerance: float = 0.3  # rad that the vehicle itself turns meanwhile
    least: float = np.pi / 2  # of the turn, rad, in steps that are faster than that


JUMPS = JumpSettings()


# Of a damaged number, 1e308 rad, and of a clock that stands still.
@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def across_jump(t: NDArray[np.float64], angle: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Samples of an angle on its way from one end of its range to the other, which no vehicle has turned.

    A heading that is resampled before it is unwrapped passes through 180 degrees between 359 and 1.
    """
    found = np.zeros(len(angle), dtype=bool)
    there = np.flatnonzero(np.isfinite(angle))
    step = np.diff(angle[there])
    if not np.any(step):
        return found
    rate = step / np.diff(t[there])
    usual = float(np.quantile(np.abs(rate[rate != 0.0]), JUMPS.usual))
    fast = np.sign(step) * (np.abs(rate) > min(JUMPS.fastest, JUMPS.times_usual * usual))
    begins = np.flatnonzero(np.diff(fast, prepend=0.0))
    ends = np.append(begins[1:], len(step)).astype(int)
    whole = np.concatenate([[0.0], np.cumsum(step)])
    far = np.abs(whole[ends] - whole[begins]) > JUMPS.least  # noise of quick sensors makes many short ones
    for begin, end in zip(begins[far], ends[far], strict=True):
        around = fast[max(begin - 1, 0) : end + 1]
        if fast[begin] and np.count_nonzero(around) == end - begin:  # else a vehicle that spins
            first, last = _way_across(step, begin, end)
            found[there[first + 1 : last]] = True
    return found


def _way_across(step: NDArray[np.float64], begin: int, end: int) -> tuple[int, int]:
    """The longest range of steps, up to one more on each side, that make a turn; an empty one if none."""
    ranges = [(a, b) for a in (begin - 1, begin) for b in (end + 1, end) if a >= 0 and b <= len(step)]
    return next(((a, b) for a, b in ranges if _is_turn_in_parts(step[a:b])), (begin, begin))


def _is_turn_in_parts(steps: NDArray[np.float64]) -> bool:
    """Whether steps of one sign add up to a turn, none of them being the jump itself."""
    turn, short = 2 * np.pi - JUMPS.tolerance, 2 * np.pi - 2 * JUMPS.tolerance
    whole = turn < abs(float(steps.sum())) < 2 * np.pi + JUMPS.tolerance
    return bool(whole and np.ptp(np.sign(steps)) == 0 and np.max(np.abs(steps)) < short)


def without_jumps(t: NDArray[np.float64], angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """An angle without jumps by turns; samples on the way across a jump are missing."""
    return unwrapped(np.where(across_jump(t, angle), np.nan, angle))


def unwrapped(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """An angle without jumps by turns; missing samples stay missing."""
    result, there = angle.copy(), np.isfinite(angle)
    result[there] = np.unwrap(angle[there])
    return result


def upright(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """A roll or pitch without whole turns: -2 degrees where a sensor that counts from 0 to 360 has 358."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


def _frozen(data: object) -> NDArray[np.float64]:
    array = np.array(data, dtype=float)
    array.setflags(write=False)
    return array


# --- several series, each with times of its own, on the rows of one clock -------------------------
@dataclass(frozen=True)
class SeriesSettings:
    """When a table holds several series, and how these get common rows."""

    # Share of its rows that a channel must lack, in intervals as short as is usual for it, to be a series of
    # its own: lost samples are fewer. Fewest samples to decide this, and to estimate the noise.
    blank: float = 0.1
    fewest_to_decide: int = 24
    fewest: int = 10
    lost: float = 3.0  # usual intervals between reports without one, after which the value is unknown
    # A report is moved to an existing row if the motion in between is at most this share of its noise: the
    # variance of its error then grows by 3% at most.
    noise_share: float = 0.3
    same_time: float = 1e-3  # share of the clock's step by which stamps of one time may differ: rounding
    # Share of the reports of the rarest column of a formula that may lack another one in their row: one clock
    # loses fewer, and reports of two clocks coincide by chance in fewer.
    shared: float = 0.5
    order: int = 3  # of the difference, which leaves little of a smooth motion
    places: int = 100_000  # reports at which it is taken: enough for the noise to half a per cent
    gaussian_mad: float = 1.4826  # standard deviation over median magnitude, of a Gaussian
    # Standard deviations from which a difference is not noise, and the variance of a Gaussian cut off there.
    outlying: float = 3.5
    variance_within: float = 0.9939


SERIES = SeriesSettings()


@dataclass(frozen=True)
class Series:
    """Reports of a channel, in order of time."""

    t: Array  # (k,) times at which they were valid, s
    y: Array  # (k,) in the unit of the channel
    noise: float | None = None  # standard deviation, where it is stated

    @classmethod
    def of(cls, t: Array, column: Array, noise: float | None) -> Series:
        """Reports of a column (n,) with blanks."""
        there = ~np.isnan(column)
        return cls(t[there], column[there], noise)

    def period(self) -> float:
        """Usual time between reports, s; infinite for a single one."""
        return float(np.median(np.diff(self.t))) if len(self.t) > 1 else np.inf

    def time_tolerance(self) -> float:
        """Time, s, in which the motion changes the channel by less than is visible in a report."""
        noise = report_noise(self.t, self.y) if self.noise is None else self.noise
        change = np.diff(self.y)
        motion = np.sqrt(max(float(np.mean(change**2)) - 2 * noise**2, 0.0)) if len(change) else 0.0
        return SERIES.noise_share * noise * self.period() / motion if motion > 0 else self.period()


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
    """Tell whether columns (n,) with blanks hold several series: one is blank at regular intervals."""
    return any(_blank_regularly(t, column) for column in table.values())


def _blank_regularly(t: Array, column: Array) -> bool:
    at = np.flatnonzero(~np.isnan(column))
    if len(at) < SERIES.fewest_to_decide or len(at) == len(t):
        return False
    apart = np.diff(t[at])
    rows = np.diff(at)[apart <= SERIES.lost * np.median(apart)]
    return bool(np.sum(rows - 1) > SERIES.blank * np.sum(rows))


def on_one_clock(
    series: Mapping[str, Series],
    before: Mapping[str, float],
    clock: Array | None = None,
    interpolated: Container[str] = (),
) -> OneClock:
    """Bring series to common rows: those of the measured channel that reports most often, and few others.

    A report moves to an existing row if the motion between the two times is not visible in it; else it gets a
    row. In a row without a report a measured channel is interpolated, or NaN where reports are further apart
    than usual. All others are held: a row has the mean of the held values until the next, so that a command
    needs no row and keeps its impulse; `before` has those held before the first. The channels in
    `interpolated` move from one report to the next instead. Where a `clock` (n,) is given, its rows are used
    first.
    """
    some = {n: s for n, s in series.items() if len(s.t)}
    measured = {n: s for n, s in some.items() if n in MEASURED}
    t, places = _rows(list((measured or some).values()), clock)
    channels, reported = {}, {}
    for name in series.keys() - measured.keys():
        known = np.nan if name in MEASURED else before.get(name, np.nan)
        one = series[name]
        channels[name] = interpolated_mean(t, one) if name in interpolated else _held(t, one, known)
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
        reach = max(SERIES.same_time * fastest.period(), min(one.time_tolerance() for one in group))
        taken[key] = _assigned_rows(t, group[0].t, reach)
        t = np.union1d(t, taken[key])
    place = {key: np.searchsorted(t, times) for key, times in taken.items()}
    return t, [place[one.t.tobytes()] for one in series]


def _assigned_rows(rows: Array, t: Array, reach: float) -> Array:
    """Times of the rows of reports: those of the nearest rows if these are near enough, or their own."""
    after = np.clip(np.searchsorted(rows, t), min(1, len(rows) - 1), len(rows) - 1)
    before = np.maximum(after - 1, 0)
    near = rows[np.where(t - rows[before] <= rows[after] - t, before, after)]
    apart = np.abs(near - t)
    order = np.lexsort((apart, near))
    first = np.empty(len(t), dtype=bool)  # of the reports that are nearest to the same row
    first[order] = np.diff(near[order], prepend=-np.inf) > 0
    return np.where((apart <= reach) & first, near, t)


def between(t: Array, known: Array, reports: Array) -> Array:
    """Interpolation of reports at times t (n,); NaN outside of them and where reports are lost."""
    # The curve is monotone from one report to the next (Fritsch and Butland, 1984): it never goes beyond
    # them, not even in a burst of reports, and is far closer to a smooth motion than a straight line.
    from scipy.interpolate import PchipInterpolator  # slow to import, and few logs come this far

    if len(known) < 2:
        return np.full(len(t), np.nan)
    return np.where(in_gaps(known, t), np.nan, PchipInterpolator(known, reports, extrapolate=False)(t))


def in_gaps(clock: Array, t: Array) -> Flags:
    """Which of the times t (n,) lie in gaps of a clock (k,) of at least two times."""
    after = np.clip(np.searchsorted(clock, t), 1, len(clock) - 1)
    apart = clock[after] - clock[after - 1]
    return (apart > _longest(np.median(np.diff(clock)))) & (t > clock[after - 1]) & (t < clock[after])


def _longest(period: float) -> float:
    """Longest interval between reports, s, over which a value is known, by the usual one."""
    return max(SERIES.lost * period, GAPS.harmless)


def _held(t: Array, one: Series, before: float) -> Array:
    """Mean of the held values from each row to the next; NaN where unknown, or older than usual."""
    first = min(t[0], one.t[0]) if len(one.t) else t[0]
    times, values = np.concatenate([[first], one.t]), np.concatenate([[before], one.y])
    at = np.searchsorted(times, t, side="right") - 1
    held = values[at]
    last = np.searchsorted(times, t[1:], side="left") - 1
    new = np.flatnonzero((last > at[:-1]) & np.isfinite(held[:-1]))
    total = np.append(0.0, np.cumsum(np.nan_to_num(values[:-1]) * np.diff(times)))
    until = [total[i] + np.nan_to_num(values[i]) * (x - times[i]) for i, x in ((at, t), (last, t[1:]))]
    held[new] = (until[1][new] - until[0][new]) / np.diff(t)[new]
    old = (at > 0) & (t - times[at] > _longest(one.period()))
    return np.where(old, np.nan, held)


def interpolated_mean(t: Array, one: Series) -> Array:
    """Mean from each row to the next, times t (n,), of the straight lines between reports.

    NaN outside of them and where reports are lost; the last row has the value there.
    """
    if not len(one.t):
        return np.full(len(t), np.nan)
    knots = np.union1d(t, one.t)
    y = np.interp(knots, one.t, one.y)
    integral = np.append(0.0, np.cumsum(0.5 * (y[1:] + y[:-1]) * np.diff(knots)))
    rows = np.searchsorted(knots, t)
    mean = np.append(np.diff(integral[rows]) / np.diff(t), y[rows[-1]])
    lost = in_gaps(one.t, t) if len(one.t) > 1 else False
    return np.where((t < one.t[0]) | (t > one.t[-1]) | lost, np.nan, mean)


def report_noise(t: Array, y: Array, order: int = SERIES.order) -> float:
    """Standard deviation of the white noise of reports (k,) at times that need not be even."""
    # From divided differences: the combination of neighbours in which a polynomial below the order vanishes.
    count = order + 1
    if len(t) <= count:
        return 0.0
    first = np.linspace(0, len(t) - count, min(len(t) - order, SERIES.places)).astype(np.intp)
    index = first[:, None] + np.arange(count)
    apart = t[index][:, :, None] - t[index][:, None, :]
    weight = 1.0 / np.prod(apart + np.eye(count), axis=2)
    change = y[index] - y[index[:, :1]]  # exactly zero at rest: the weights add up to zero but for rounding
    differences = np.sum(weight * change, axis=1) / np.linalg.norm(weight, axis=1)
    return float(np.sqrt(noise_variance(differences)))


def noise_variance(differences: Array) -> float:
    """Variance of noise in differences (k,), some of which may contain kinks and jumps of a motion."""
    # The mean square of the others is more accurate than an estimate by the median. Where most of them are
    # zero, as of a sensor with few digits at rest, only the rest count.
    if not robust_scale(differences):
        differences = differences[differences != 0.0]
    rough = robust_scale(differences)
    within = differences[np.abs(differences) <= SERIES.outlying * rough]
    return float(np.mean(within**2)) / SERIES.variance_within if len(within) else 0.0


def robust_scale(errors: Array) -> float:
    """Standard deviation by the median magnitude, with up to half outliers; 1 without errors."""
    return SERIES.gaussian_mad * float(np.median(np.abs(errors))) if len(errors) else 1.0


def with_report_noise(run: Run, must: Collection[str] = (), *, part: bool = False) -> Run:
    """Estimate the noise of channels that do not report in every row, where it is not stated.

    Differences between rows would not show it: interpolated rows are smooth. A channel with too few reports
    is left out, or refused if it is among those that `must` be there; a `part` of a log may have one.
    """
    sigma, notes, few = dict(run.sigma), [], []
    for name, there in run.reported.items():
        t, reports = run.t[there], run.channels[name][there]
        if len(t) >= SERIES.fewest:
            sigma[name] = sigma.get(name) or report_noise(t, reports)
            notes.append(
                f"{name}: {len(t)} reports in {len(run.t)} rows; noise of a report {sigma[name]:.2g} "
                f"{UNITS.get(name, '')}".rstrip()
            )
        elif name in must and not part:
            raise UndertowError(
                f"run {run.name!r}: channel {name!r} has {len(t)} new reports, at least {SERIES.fewest} "
                "are needed: give a longer log, or leave out the column (`ignore` in the mapping file)"
            )
        elif not part:
            few.append(name)
            notes.append(f"{name}: left out, as it has {len(t)} reports; {SERIES.fewest} are needed")
    return replace(run.without(few), sigma=sigma).with_notes(*notes)


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
    """Share of the reports of the rarest column with one of all others in the same row; 1 without reports."""
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


def later_than_before(t: Array) -> NDArray[np.bool_]:
    """Tell which times are later than all before them; a missing one counts as in order."""
    latest = np.fmax.accumulate(np.concatenate([[-np.inf], t]))
    return np.asarray((t > latest[:-1]) | np.isnan(t))


# --- bounds on a log ------------------------------------------------------------------------------
@dataclass(frozen=True)
class Measurable:
    """Bounds on values, sizes and rates of a log."""

    # Largest magnitude of a value or time, SI. Values that mark a missing one (1e20, 9.97e36, 1e308) are
    # larger, distances on Earth in nm are not; its powers up to the tenth are finite.
    largest: float = 1e15
    # Samples that a fit takes: four hours at 20 Hz. In surge alone, 10^6 take five minutes and 1.4 GB.
    samples: int = 300_000
    # Lines of a file per sample, at most: some are blank or comments. Only used to stop reading early.
    rows_per_sample: int = 2
    # Samples a second beyond which a log is faster than the motion of any vehicle, and as many as suffice.
    fast: float = 50.0
    enough: float = 20.0
    # quick, slow: range of the usual steps of logs, s: 0.2 to 250 Hz. Of two units of a clock the one in
    # which its steps are nearer to this range is more likely.
    quick: float = 0.004
    slow: float = 5.0


MEASURABLE = Measurable()


def far_from_usual(step: float) -> float:
    """Factor, as a logarithm, by which a step, s, is shorter or longer than those of vehicles; 0 if usual."""
    return float(max(0.0, np.log(MEASURABLE.quick) - np.log(step), np.log(step) - np.log(MEASURABLE.slow)))


# --- deviation of a compass -------------------------------------------------------------------------
Deviation = tuple[float, float, float]
"""A, B and C, rad: constant, and the semicircular deviation of hard iron, A + B sin psi + C cos psi."""


def with_heading_corrected(
    channels: Mapping[str, Array], deviation: Deviation, *, velocities: bool
) -> dict[str, Array]:
    """Channels with the deviation added to the heading.

    With `velocities`, u and v were turned into body axes by the heading of the compass, and are turned on.
    """
    if "psi" not in channels:
        return dict(channels)
    (a, b, c), psi = deviation, channels["psi"]
    more = a + b * np.sin(psi) + c * np.cos(psi)  # Bowditch
    found = {**channels, "psi": psi + more}
    if velocities:
        zero = np.zeros_like(more)
        u, v = channels.get("u", zero), channels.get("v", zero)
        turned = {"u": u * np.cos(more) + v * np.sin(more), "v": v * np.cos(more) - u * np.sin(more)}
        found |= {n: turned[n] for n in turned if n in channels}
    return found


def without_deviation(run: Run, deviation: Deviation, *, velocities: bool) -> Run:
    """A run with the deviation of its compass added to the heading."""
    channels = with_heading_corrected(run.channels, deviation, velocities=velocities)
    given = with_heading_corrected(run.wrapped, deviation, velocities=False)
    channels |= {"psi": unwrapped(channels["psi"])} if "psi" in run.wrapped else {}
    return replace(run, channels=channels, wrapped=given)
