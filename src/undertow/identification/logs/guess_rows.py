"""Which column of a table counts the time, in what unit, and what the cells of others are."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import polars as pl

from undertow.errors import UndertowError
from undertow.typing import Array, Flags

from .cells import DIGITS_OF_DAY, with_points
from .guess_frames import Guess
from .guess_names import Name, is_clock, stated_unit, unit_of_clock
from .mapping import SECONDS, LogMapping, metres_per_degree, spacing_of
from .run import MEASURABLE, far_from_usual, later_than_before
from .table import has_dates, is_dates, numbers, seconds, texts_in, unit_of_cells


@dataclass(frozen=True)
class ClockSettings:
    """Settings for choosing the clock column."""

    # Share of rows of an increasing clock, or of stamps of messages, that may be no later than earlier ones.
    late: float = 0.05
    # Seconds since 1970 at which a clock without a unit may begin, from 2001 on, and counts that are beyond.
    since: tuple[float, float] = (1e9, 1e10)
    counts: float = 1e11
    # Rows over which changes of position are taken, as many as are needed for small noise: over twice as
    # many, the speed is then about the same.
    spans: tuple[int, ...] = (10, 20, 40, 80, 160, 320)
    steady: float = 1.2
    same: float = 1.5  # factor within which they and the speed are the same
    # Usual speed of a whole log, m/s, that is too much: a unit is wrong, and asked about. `FASTEST` of the
    # model is larger, since a single speed beyond it is refused.
    fastest: float = 50.0
    # Share of the log by which times of too few digits may be off evenly spaced rows: the interval is then
    # known to one percent.
    even: float = 0.01
    fewest: int = 30  # different times of such a clock from which the first row of each makes a log
    slowest: float = 0.01  # m/s that a logged vehicle exceeds
    # Of a position in m, changes from step to step differ by more: no tracking system is finer than this, m.
    finest: float = 1e-4
    apart: float = 10.0  # distance of latitude and longitude from zero over their change in a log, at least


SETTINGS = ClockSettings()


@dataclass(frozen=True)
class TurnSettings:
    """Settings for recognising several things whose rows take turns."""

    turns: float = 0.5  # share of rows that are of another thing than the row before
    things: int = 16  # how many there may be


TURNS = TurnSettings()


def times_of_rows(table: pl.DataFrame, data: Mapping[str, Array], time: Guess, where: str) -> Array:
    """Times of the rows, s."""
    if "interval" in time.entry:
        return spacing_of(str(time.entry["interval"])) * np.arange(float(table.height))
    if _is_dated(time, data):
        return seconds(table, time.column, where)[0]
    return _clock_seconds(data, time)


def _is_dated(time: Guess, data: Mapping[str, Array]) -> bool:
    """Whether a clock has dates or times of day; the latter may be numbers, too."""
    return time.column not in data or time.entry.get("unit") == "iso"


def columns_of(time: Guess) -> tuple[str, ...]:
    """The columns of a clock: one, or those of seconds and nanoseconds."""
    rest = time.entry.get("nanoseconds")
    return (time.column,) if rest is None else (time.column, str(rest))


def _clock_seconds(data: Mapping[str, Array], time: Guess) -> Array:
    """Times, s, of a clock of numbers."""
    name, *rest = columns_of(time)
    halves = {name: rest[0]} if rest else {}
    return with_nanoseconds(data, halves)[name] * SECONDS[str(time.entry["unit"])]


def halves_of_stamps(names: Iterable[str]) -> dict[str, str]:
    """Columns of seconds with those of their nanoseconds: the same names but for these words."""
    names = [*names]
    stems = {name: found[1] for name in names if (found := re.fullmatch(r"(.*?)(?:secs?|seconds)", name))}
    ends = ("nanosec", "nsec", "nsecs", "nanosecs", "nanoseconds")
    return {
        name: other
        for name, stem in stems.items()
        if (other := next((stem + end for end in ends if stem + end in names), ""))
    }


def with_nanoseconds(data: Mapping[str, Array], halves: Mapping[str, str]) -> dict[str, Array]:
    """The columns, with the nanoseconds added to those of seconds, and removed."""
    whole = {name: data[name] + 1e-9 * data[other] for name, other in halves.items()}
    return {n: whole.get(n, column) for n, column in data.items() if n not in halves.values()}


def clock_of(table: pl.DataFrame, data: Mapping[str, Array], where: str) -> Guess:
    halves = halves_of_stamps(data)
    data = with_nanoseconds(data, halves)
    found = _clock(table, data, where)
    if isinstance(found, Guess):
        return found
    digits = found in data and table[found].dtype == pl.String and _are_six_digits(table[found])
    dated = digits or found not in data
    times = seconds(table, found, where)[0] if dated else data[found]
    sampled = _sampled(data, found, len(times))
    kept = times[sampled & np.isfinite(times)]
    stated, step = (
        unit_of_clock(found) or _unit_below(table, found),
        float(np.median(np.diff(kept[later_than_before(kept)]))),
    )
    stated = "s" if found in halves else stated
    unit = "iso" if dated else stated or unit_by_steps(times, step)
    rate = 1.0 / max(step * SECONDS.get(unit, 1.0), 1e-12)
    one = "row" if np.all(sampled) else "sample"
    said = "" if stated or dated else _unit_question(step, unit, one)
    said = "read as hours, minutes and seconds side by side (hhmmss): is that right?" if digits else said
    entry, asked = {"column": found, "unit": unit}, [said] if said else []
    entry |= {"nanoseconds": halves[found]} if found in halves else {}
    if rate > MEASURABLE.fast and np.all(sampled):
        asked.append(f"{rate:.3g} rows a second: every = {round(rate / MEASURABLE.enough)} would do at first")
    late = _share_out_of_order(times)
    if late:
        entry["disorder"] = "drop"
        asked.append((_LATE if late < SETTINGS.late else _COARSE).format(late))
    return Guess(found, entry, " ".join(asked))


def _unit_below(table: pl.DataFrame, name: str) -> str:
    """The unit of a clock that stands in a line below the names; "" for none."""
    first = str(table[name][0]).strip(" []()") if table[name].dtype == pl.String else ""
    return unit_of_clock(f"t ({first})")


def _are_six_digits(column: pl.Series) -> bool:
    """Whether texts are times of day, written as digits side by side."""
    texts = with_points(column.drop_nulls().str.strip_chars())
    numbers = texts.cast(pl.Float64, strict=False).to_numpy()
    return bool(texts.str.contains(DIGITS_OF_DAY).all()) and is_time_of_day(numbers)


def is_time_of_day(numbers: Array) -> bool:
    """Whether numbers are hours, minutes and seconds side by side, which 172900 after 172859 shows."""
    sound = (numbers >= 0.0) & (numbers < 240000.0) & (numbers % 10000.0 < 6000.0) & (numbers % 100.0 < 60.0)
    if len(numbers) < 2 or not sound.all():
        return False
    return bool(np.max(np.diff(seconds_of_day(numbers))) < np.max(np.diff(numbers)))


def seconds_of_day(numbers: Array) -> Array:
    """Seconds since midnight of hours, minutes and seconds side by side."""
    hours, minutes = numbers // 10000.0, numbers % 10000.0 // 100.0
    return 3600.0 * hours + 60.0 * minutes + numbers % 100.0


def absolute_times(table: pl.DataFrame, data: Mapping[str, Array], time: Guess, where: str) -> Array:
    """Times of the rows, s, those of dates since 1970."""
    if "interval" in time.entry:
        rounded = data[time.column]
        first = rounded[0] * SECONDS[_unit(time.column, rounded)]
        return np.asarray(first + times_of_rows(table, data, time, where))
    if not _is_dated(time, data):
        return _clock_seconds(data, time)
    if table[time.column].dtype in (pl.Datetime, pl.Date):
        table = table.with_columns(pl.col(time.column).cast(pl.Datetime("ns")))
    t, first, origin = seconds(table, time.column, where)
    return t + float(origin) * 1e-9 if first else t


def clock_by_motion(time: Guess, t: Array, moved: Mapping[str, Array]) -> tuple[Guess, Array]:
    """The clock, and times in s, in the unit in which the change of position agrees with the speed."""
    # Minutes, hours and days are tried where no name states a unit: one in which position and speed (m, m/s)
    # agree, or in which the speed of the vehicle is possible where none was logged.
    unit = str(time.entry.get("unit", "iso"))
    if unit == "iso" or unit_of_clock(time.column):
        return time, t
    pace = _pace(t, moved)
    speed = np.hypot(moved.get("u", np.nan * t), moved.get("v", 0.0 * t)) if "u" in moved else t * np.nan
    logged = float(np.nanmedian(speed)) if np.isfinite(speed).any() else np.nan
    others = {u: pace * SECONDS[unit] / SECONDS[u] for u in ("min", "h", "day") if u != unit}

    def fits(pace: float) -> bool:
        if np.isfinite(logged):
            return 1.0 / SETTINGS.same < pace / max(logged, 1e-12) < SETTINGS.same
        return SETTINGS.slowest < pace < SETTINGS.fastest

    if not pace > 0 or fits(pace) or are_degrees(t, moved):
        return time, t
    known = f"the speed column says {logged:.3g}" if np.isfinite(logged) else "no vehicle is as fast or slow"
    asked = f"in {unit}, the position would change by {pace:.3g} m/s, and {known}"
    better = next((u for u, p in others.items() if fits(p)), "")
    if not better:
        either = " or the speed" if np.isfinite(logged) else ""
        doubt = f"{time.doubt} {asked}: is the time, the position{either} in another unit?"
        return replace(time, doubt=doubt), t
    asked += f": read in {better}, in which it changes by {others[better]:.3g} m/s: is it?"
    scale = SECONDS[better] / SECONDS[unit]
    return Guess(time.column, {**time.entry, "unit": better}, asked), t * scale


def are_degrees(t: Array, moved: Mapping[str, Array]) -> bool:
    """Whether x and y, read in m, change too slowly for a vehicle, and are a place in degrees."""
    pace, place = _pace(t, moved), [moved[n][np.isfinite(moved[n])] for n in "xy" if n in moved]
    if not SETTINGS.slowest < metres_per_degree(0.0)[0] * pace < SETTINGS.fastest or pace > SETTINGS.slowest:
        return False
    apart = all(abs(np.median(a)) > SETTINGS.apart * np.ptp(a) for a in place)
    fine = all(np.median(np.abs(np.diff(a, 2))) < SETTINGS.finest for a in place)
    return apart and fine and bool(max(np.abs(a).max() for a in place) <= 360.0)


def _pace(t: Array, moved: Mapping[str, Array]) -> float:
    """Change of position by time, m/s, its median; 0 where there is no position, or only its noise."""
    if not {"x", "y"} <= moved.keys():
        return 0.0
    there = np.isfinite(t) & np.isfinite(moved["x"]) & np.isfinite(moved["y"])
    x, y, t = moved["x"][there], moved["y"][there], t[there]
    paces = [_pace_over(step, x, y, t) for step in SETTINGS.spans if len(t) > 2 * step]
    return next((a for a, b in pairwise(paces) if a < SETTINGS.steady * b), 0.0)


def _pace_over(step: int, x: Array, y: Array, t: Array) -> float:
    far, long = np.hypot(x[step:] - x[:-step], y[step:] - y[:-step]), t[step:] - t[:-step]
    return float(np.median(far / np.maximum(long, 1e-12)))


def _clock(table: pl.DataFrame, data: Mapping[str, Array], where: str) -> str | Guess:
    """The column that counts the time: one of that name that rises or has dates, else one that rises."""
    # A clock of too few digits is better than a column of another name: its rows are evenly spaced.
    late = {n: _share_out_of_order(column) for n, column in data.items()}
    rising = [n for n, share in late.items() if share == 0.0]
    rising += [n for n, share in late.items() if is_clock(n) and 0.0 < share < SETTINGS.late]
    rising += [n for n in late if n not in rising and is_clock(n) and _is_coarse(data[n])]
    texts = [n for n in table.columns if n not in data and (is_clock(n) or _has_times(table[n]))]
    dated = [n for n in texts if not _no_dates(table, n, where)]
    named = [n for n in table.columns if (n in rising and is_clock(n)) or n in dated]
    fine = [n for n in named if n in dated or not _is_coarse(data[n])]
    if not fine and (even := next(filter(None, map(_rounded, data, data.values())), None)):
        return even
    # Of a table of several clocks only one has the time of every row. A count of the rows is none, beside
    # what is evenly spaced as well.
    counts = [n for n in rising if _are_even(data[n]) and data[n][1] - data[n][0] == 1.0]
    others = [n for n in rising if _are_even(data[n]) and n not in counts]
    found = min(
        [*named, *rising],
        key=lambda n: (
            *(n not in named, n not in fine, table[n].null_count(), not is_clock(n)),
            bool(others) and n in counts,
        ),
        default=None,
    )
    if found is None and table.height < 2:
        count = f"{table.height} row" if table.height == 1 else "no row"
        raise UndertowError(f"{where} has {count} below its header: check that the log is complete")
    if found is None:
        reason = next((_no_dates(table, n, where) for n in texts), f"{where}: {_no_time(data)}")
        raise UndertowError(f"{reason}: its columns are {', '.join(table.columns)}")
    return found


def _has_times(column: pl.Series) -> bool:
    """Whether the first text of a column is a date with the time of day, in whatever order, or that alone."""
    first = column.drop_nulls().first() if column.dtype == pl.String else None
    return has_dates(column) or bool(re.search(r"(?<!\d)\d{1,2}:\d{2}:\d{2}(?!\d)", str(first)))


def _is_coarse(times: Array) -> bool:
    """Whether many rows have the same time, though many times are different: a clock of too few digits."""
    steps = np.diff(times)
    if not np.isfinite(times).all() or np.any(steps < 0.0) or np.sum(steps > 0.0) < SETTINGS.fewest:
        return False
    return bool(np.mean(steps == 0.0) >= SETTINGS.late)


def _are_even(times: Array) -> bool:
    """Whether a column grows by the same in every row."""
    steps = np.diff(times)
    return len(steps) > 1 and bool(np.ptp(steps) < SETTINGS.even * abs(steps[0]))


def _rounded(name: str, times: Array) -> Guess | None:
    """A clock of too few digits, if evenly spaced rows agree with it to these digits."""
    steps = np.diff(times)
    if not is_clock(name) or not np.isfinite(times).all() or not len(steps) or np.any(steps < 0.0):
        return None
    row = np.arange(len(times))
    interval, start = np.polyfit(row, times, 1)
    off = float(np.max(np.abs(times - start - interval * row)))
    digit = float(np.quantile(steps[steps > 0.0], 1.0 - SETTINGS.late)) if np.any(steps > 0.0) else 0.0
    if not 0.0 < off <= min(digit, SETTINGS.even * (times[-1] - times[0])):
        return None
    scale = SECONDS[_unit(name, times)]
    said = (
        f"{np.mean(steps == 0.0):.0%} of its times repeat the one before: it has too few digits; rows "
        f"{interval * scale:.5g} s apart are within {off * scale:.2g} s of it: is that the sampling interval?"
    )
    return Guess(name, {"column": name, "interval": f"{interval * scale:.6g} s"}, said)


def _unit(name: str, times: Array) -> str:
    """The unit of a clock of too few digits."""
    return unit_of_clock(name) or unit_by_steps(times, (times[-1] - times[0]) / (len(times) - 1))


def _share_out_of_order(times: Array) -> float:
    """Share of the times that are no later than one before; rows without one end a log that was cut off."""
    there = times[np.isfinite(times)]
    return 1.0 - float(np.mean(later_than_before(there))) if len(there) > 1 else 1.0


def _no_dates(table: pl.DataFrame, name: str, where: str) -> str:
    """Why a column of texts has no dates; empty where it has."""
    try:
        return "" if np.isfinite(seconds(table, name, where)[0]).any() else f"{where}: {name!r} is empty"
    except UndertowError as error:
        return str(error)


def _no_time(data: Mapping[str, Array]) -> str:
    """Why no column is the time, and what to do where one of its name is too coarse, or jumps back."""
    for name, column in data.items():
        still = np.flatnonzero(np.diff(column) <= 0.0)
        if is_clock(name) and len(still):
            row = int(still[0])
            return (
                f"column {name!r} does not increase in {len(still)} of {len(column)} rows, first from "
                f"{column[row]:.15g} to {column[row + 1]:.15g} in row {row + 2}: write the times with more "
                f"digits, or {_EVEN}"
            )
    return (
        "no column contains the time, since none increases from row to row: write the log with the time of "
        f"each row, or {_EVEN}"
    )


def _sampled(data: Mapping[str, Array], time: str, rows: int) -> Flags:
    """Rows of the column with most samples: in a table of several clocks none has one in every row."""
    there = [np.isfinite(column) for name, column in data.items() if name != time]
    most = max(there, key=np.count_nonzero, default=np.ones(rows, dtype=bool))
    return most if np.count_nonzero(most) > 1 else np.ones_like(most)


def unit_by_steps(t: Array, step: float) -> str:
    """The unit in which a clock counts from 1970, or else the step from row to row is usual."""
    low, high = SETTINGS.since
    for unit in ("ns", "us", "ms"):
        if low < float(t[0]) * SECONDS[unit] < high and float(t[0]) > SETTINGS.counts:
            return unit
    return min(_GUESSED, key=lambda unit: far_from_usual(step * SECONDS[unit]))


_LATE = "{:.2%} of the rows are not later than an earlier one: leave them out?"
_COARSE = (
    "{:.0%} of its times repeat the one before: it has too few digits, and only the first row of each time "
    "is read: is that enough? If rows are evenly spaced, without a gap, all are read with interval instead"
)
_EVEN = 'state the sampling interval, if it is constant: --interval "0.1 s", or interval under [time]'
# Units that are assumed for a clock without one; minutes, hours and days are asked about.
_GUESSED = ("s", "ms", "us", "ns")


def _unit_question(step: float, unit: str, one: str) -> str:
    """Question on a unit that is not stated, with the rate in it, and in rarer ones if these are likelier."""
    as_guessed = far_from_usual(step * SECONDS[unit])
    better = [u for u in SECONDS if far_from_usual(step * SECONDS[u]) < as_guessed]
    here, *others = (f"{1.0 / (step * SECONDS[u]):.3g}" for u in (unit, *better))
    rates = [f"{here} {one}s a second if it is in {unit}"]
    rates += [f"{x} in {u}" for x, u in zip(others, better, strict=True)]
    return f"{step:.4g} from {one} to {one}: that is {', '.join(rates)}; {'which' if better else 'is it'}?"


# --- texts in cells -----------------------------------------------------------------------------
def numbers_of(table: pl.DataFrame, name: str, reading: LogMapping) -> Array | None:
    """The numbers of a column; None where it is one of dates, or has more texts than numbers."""
    if is_dates(table, name):
        return None
    try:
        values = numbers(table, name, reading.model_copy(update={"not_numbers": "missing"}), "log")
    except UndertowError:
        return None
    return values if len(texts_in(table, name, reading)) <= np.count_nonzero(np.isfinite(values)) else None


def unit_in(table: pl.DataFrame, name: str, reading: LogMapping) -> str:
    """The unit that the cells of a column state, or a line of units below the names; "" for none."""
    below = texts_in(table, name, reading)[:1]
    stated = (unit_of_cells(table, name, reading), *(text.strip().strip("[]()") for text in below))
    return next(filter(None, map(stated_unit, stated)), "")


_NUMBERS = {"id", "index", "idx", "instance", "channel", "number", "no", "motor", "thruster", "servo", "fin"}


def number_of_things(data: Mapping[str, Array]) -> str:
    """The column with the number of one of several things whose rows take turns; "" for none."""
    for name, column in data.items():
        there, words = column[np.isfinite(column)], {*Name.of(name).words}
        if not words or not words <= _NUMBERS or len(there) < 2 or np.any(there != np.round(there)):
            continue
        if np.mean(np.diff(there) != 0) > TURNS.turns and 1 < len(np.unique(there)) <= TURNS.things:
            return name
    return ""
