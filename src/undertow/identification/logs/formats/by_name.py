"""Meaning of series not defined by their format: guesses from column names."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
import polars as pl

from undertow.errors import UndertowError, listed
from undertow.identification.logs.guess import SETTINGS, guess_table, in_axes, no_column, without_motion
from undertow.identification.logs.guess_frames import Axes, Guess, GuessedMapping
from undertow.identification.logs.guess_names import DISTANCES, Name, rows_by_number, with_axes
from undertow.identification.logs.mapping import Channel, Column, Frames, LogMapping
from undertow.identification.logs.run import FORCES, MEASURED, UNITS
from undertow.model.catalogue import catalogue, logged_quantities
from undertow.model.symbols import POSE, VELOCITY
from undertow.model.units import scale_offset
from undertow.model.vehicle import Vehicle

from .fieldlog import HELD, STRETCH, TIME, FieldLog, Interval, Series, longest
from .offsets import questions_on_clocks

CLOCK = Guess(TIME, {"column": TIME, "unit": "s"})
"""The clock of the table of a log."""


@dataclass(frozen=True)
class RunSettings:
    """What tells runs in one file from sensors, and how they are joined."""

    as_long: float = 0.95  # runs that differ in length by more than the rest are no sensors of one run
    alike: float = 0.5  # what differs in a motion that two sensors measure, over that motion, at most
    pause: float = 10.0  # s between runs that are put one after the other


RUNS = RunSettings()

ANGULAR = ("rad", "deg")
"""Units of rudders and fins, which are no motors."""
_TIME = "time [s]"
# Names of matrices, and of their columns; MSS (Fossen) calls pose eta and velocity nu.
_SIX_MOVES = ("surge", "sway", "heave", "p", "q", "r")
SIX = {"eta": POSE, "pose": POSE, "nu": _SIX_MOVES, "tau": tuple(name[4:] for name in FORCES)}
TURNED = {"euler", "rpy", "angles", "attitude", "orientation", "theta_nb", "eul"}
LINEAR = {"pos", "position", "vel", "velocity", "acc", "acceleration", "gyro", "omega", "rates"}
Meaning = tuple[LogMapping, tuple[tuple[str, Column], ...], list[str]]


def guessed(
    path: Path,
    series: Sequence[Series],
    known: Mapping[str, Column] | None = None,
    intervals: Sequence[Interval] = (),
) -> Meaning:
    """Guess a mapping and the commands of series, with questions, by the longest of the intervals.

    Series with most of the motion take precedence. No channel is guessed that is known already (`known`, by
    ``series.column``).
    """
    columns, notes, frames = dict(known or {}), [], Frames()
    taken = {column.channel for column in columns.values()}
    driving: list[str] = []
    found = [(one, _guess(path, _within(one, intervals))) for one in series if len(one.t) > 1]
    found.sort(key=lambda pair: -sum(guess.channel in UNITS for guess in pair[1].columns))
    same = [o.name for o, _ in found[1:] if has_motion(o) and {*o.columns} == {*found[0][0].columns}]
    if same:
        notes.append(f"{found[0][0].name} is read, not {listed(same)} of the same columns: are they sensors?")
    for number, (one, guess) in enumerate((o, g) for o, g in found if o.name not in same):
        direct = [g for g in guess.columns if not g.is_formula]
        new = [g for g in direct if g.channel in UNITS and g.channel not in taken]
        new = [g for g in new if fits(one.units.get(_name_in_series(one, g)), g.channel)]
        if frames.position == "ENU" and guess.axes.entry["position"] == "NED":  # those of the first series
            new = [in_axes(g, found[0][1].axes) for g in new]
        columns |= {f"{one.name}.{_name_in_series(one, g)}": _column(one, g) for g in new}
        taken |= {g.channel for g in new}
        motors = [g for g in direct if g.channel not in UNITS and g.entry.get("unit") not in ANGULAR]
        driving += [f"{one.name}.{_name_in_series(one, g)}" for g in motors]
        doubtful = [g for g in new if g.doubt and _name_in_series(one, g) not in one.units]
        doubts = [f"{one.name}.{_name_in_series(one, g)}: {g.doubt}" for g in doubtful]
        notes += [*doubts, *(guess.axes.questions if number == 0 and new else ())]
        if number == 0 and not known:
            frames = Frames.model_validate(guess.axes.entry)
    return LogMapping(columns=columns, frames=frames), numbered(driving, columns), notes


def _within(one: Series, intervals: Sequence[Interval]) -> Series:
    """The samples in the longest of the intervals: motions do not go on from one to the next."""
    if not intervals:
        return one
    first, last = longest(intervals)
    inside = (one.t >= first) & (one.t <= last)
    return replace(one, t=one.t[inside], columns={n: c[inside] for n, c in one.columns.items()})


def has_motion(one: Series) -> bool:
    """Whether a series has a motion among its columns, by their names."""
    return any(Name.of(f"{one.name}.{c}").motion() for c in one.columns)


# --- several runs in one file -----------------------------------------------------------------------
_Run = dict[tuple[str, frozenset[str]], Series]  # by what its name has beside that of the run, and columns


def one_after_the_other(series: Sequence[Series]) -> tuple[list[Series], tuple[Interval, ...], list[str]]:
    """Separate runs as one log that is cut between them: its series, where each run is, and a note.

    They are what has the same columns, a motion among them, at different times; or at the same times another
    motion, where that begins with each of them and their names differ in a number, or how long they are.
    """
    for depth in range(1, 1 + max(one.name.count(".") + 1 for one in series)):
        runs = _alike(series, depth)
        if len(runs) > 1 and _are_runs(runs):
            return _joined(runs, [one.name for one in series if not one.name.startswith((*runs,))])
    return [*series], (), []


def _alike(series: Sequence[Series], depth: int) -> dict[str, _Run]:
    """The largest group of structs with the same columns, a motion among them, by the beginning of names."""
    runs: dict[str, _Run] = {}
    for one in series:
        words = re.sub(r"\[\d+\]$", "", one.name).split(".")
        head, rest = ".".join(words[:depth]), ".".join(words[depth:])
        runs.setdefault(head, {})[rest, frozenset(one.columns)] = one
    moving = {head: run for head, run in runs.items() if any(map(has_motion, run.values()))}
    groups = [{h: r for h, r in moving.items() if r.keys() == other.keys()} for other in moving.values()]
    return max(groups, key=len, default={})


def _span(run: _Run) -> Interval:
    times = [one.t for one in run.values()]
    return float(min(map(np.nanmin, times))), float(max(map(np.nanmax, times)))


def _are_runs(runs: Mapping[str, _Run]) -> bool:
    spans = [_span(run) for run in runs.values()]
    if all(a[1] < b[0] for a, b in pairwise(sorted(spans))):
        return True
    lengths = [last - first for first, last in spans]
    begin = max(first for first, _ in spans) - min(first for first, _ in spans)
    numbered = len(max(rows_by_number(runs), key=len, default=[])) == len(runs)
    differ = numbered or min(lengths) < RUNS.as_long * max(lengths)
    again = begin < (1.0 - RUNS.as_long) * min(lengths)
    return differ and again and not any(_move_alike(a, b) for a, b in combinations(runs.values(), 2))


def _move_alike(one: _Run, other: _Run) -> bool:
    """Whether all motions are the same at the same times, as two sensors measure them."""
    moving = [
        (values, np.interp(series.t, other[key].t, other[key].columns[column], np.nan, np.nan))
        for key, series in one.items()
        for column, values in series.columns.items()
        if Name.of(f"{series.name}.{column}").motion() and np.nanstd(values) > 0
    ]
    return all(np.nanstd(theirs - own) < RUNS.alike * np.nanstd(own) for own, theirs in moving)


def _joined(
    runs: Mapping[str, _Run], others: Sequence[str]
) -> tuple[list[Series], tuple[Interval, ...], list[str]]:
    """The series of runs, each after the one before."""
    ordered = sorted(runs.items(), key=lambda pair: _span(pair[1])[0])
    begins, parts, free = [], list[Interval](), -np.inf
    for _, run in ordered:
        first, last = _span(run)
        begins.append(max(0.0, free - first))
        parts.append((first + begins[-1], last + begins[-1]))
        free = np.ceil(parts[-1][1] + RUNS.pause)
    found = []
    for k, key in enumerate(ordered[0][1]):
        each = [run[key] for _, run in ordered]
        name = key[0] or (f"run[{k}]" if k else "run")
        t = np.concatenate([one.t + begin for one, begin in zip(each, begins, strict=True)])
        columns = {c: np.concatenate([one.columns[c] for one in each]) for c in each[0].columns}
        found.append(Series(name, t, columns, each[0].units))
    where = ", ".join(
        f"{head} from {first:.4g} s" for (head, _), (first, _) in zip(ordered, parts, strict=True)
    )
    notes = [f"runs with the same columns, each used as a log of its own: {where}"]
    return found, tuple(parts), notes + [f"left out beside them: {', '.join(others)}"] * bool(others)


def first_mapping(log: FieldLog, vehicle: Vehicle | None = None) -> GuessedMapping:
    """A mapping file of a native vehicle log: what its format defines, and guesses and questions on the rest.

    Commands that are not known in the log are searched by name among its columns. If no motion of the vehicle
    is known, everything is guessed.
    """
    meaning = log.mapping_for(vehicle.command_names if vehicle else ())
    known = [*_as_guesses(meaning.columns), *_as_guesses(meaning.channels)]
    moves = {*vehicle.pose_names, *vehicle.velocity_names} if vehicle else MEASURED
    if log.by_name or not MEASURED & moves & {guess.channel for guess in known}:
        clock = replace(CLOCK, entry={**CLOCK.entry, "stretch": STRETCH}) if log.intervals else CLOCK
        guess = guess_table(log.beginning(), log.path, vehicle, HELD, clock, log.units)
        clocks = questions_on_clocks(log, guess.meaning)
        return replace(guess, questions=(*guess.questions, *clocks))
    moving = _possible_velocities(log, {guess.channel for guess in known}, vehicle)
    commands = vehicle.command_names if vehicle else ()
    lacking = [c for c in commands if c not in {guess.channel for guess in known}]
    left = [n for n in log.columns if n not in meaning.columns and _may_drive(n, lacking, vehicle)]
    if lacking and log.actuators:  # they are as many as the vehicle has not
        left = [name for name, _ in log.actuators]
    guessed = guess_table(log.table(left), log.path, vehicle, HELD, CLOCK).columns if left else ()
    found = [guess for guess in guessed if guess.channel in lacking]
    unknown = [c for c in lacking if c not in {guess.channel for guess in found}]
    others = tuple(n for n in left if unknown and n not in {guess.column for guess in found})
    other_motors = bool(log.actuators and unknown)
    return GuessedMapping(
        log.path.name,
        Guess(meaning.time.column, meaning.time.model_dump(exclude_defaults=True) or {"column": TIME}),
        (*known, *found),
        Axes(meaning.frames.model_dump(exclude_none=True, exclude_defaults=True)),
        {reason: left for reason, left in (("? may drive the vehicle", others), (_MOVES, moving)) if left},
        HELD if found else meaning,
        (
            *([] if moving else without_motion(vehicle, {guess.channel for guess in known})),
            *([_MOTORS.format(len(log.actuators), len(unknown), ", ".join(unknown))] if other_motors else []),
            *([] if log.actuators else no_column(unknown)),
            *([_VELOCITIES.format(", ".join(moving))] if moving else []),
        ),
    )


_MOTORS = (
    "the log has {} motors, the vehicle has {} commands without a column ({}): is it the vehicle of this "
    "log? If so, which motor is which command?"
)
_MOVES = "? judging by its name, a velocity that no other column provides"
_VELOCITIES = (
    "{}: judging by their names, velocities that no other column provides: are they, in what unit and along "
    'which axes? Then give each its channel ("u", "v", "w", "p", "q", "r") under [columns]'
)


def _possible_velocities(log: FieldLog, known: Set[str], vehicle: Vehicle | None) -> tuple[str, ...]:
    """Columns whose names mean a velocity of the vehicle that is not `known`, and that change."""
    wanted = {*(vehicle.velocity_names if vehicle else VELOCITY)} - known
    every = {f"{one.name}.{column}": (one, column) for one in log.series.values() for column in one.columns}
    found = []
    for name in with_axes([*map(Name.of, every)]):
        if name.motion() in wanted and not name.along_earth:
            one, column = every[name.column]
            values = one.columns[column]
            found += [name.column] if np.any(values[1:] != values[:1]) else []
    return tuple(found)


def _may_drive(column: str, lacking: Sequence[str], vehicle: Vehicle | None) -> bool:
    """Whether a column may be a command, or a logged quantity, that the vehicle lacks."""
    name, inputs = Name.of(column), dict(vehicle.inputs) if vehicle else {}
    commands = [c for c in lacking if c not in inputs]
    if commands and (name.is_command or any(name.drives(c, {}) < DISTANCES.no_fit for c in commands)):
        return True
    sensed = (name.senses(c, inputs[c])[0] < DISTANCES.no_fit for c in lacking if c in inputs)
    return any(sensed) or ("B_net" in lacking and name.is_pumped_volume)


def _as_guesses(known: Mapping[str, Column] | Mapping[str, Channel]) -> list[Guess]:
    """Known columns, and channels that are computed from several, as guesses without a doubt."""
    return [
        Guess(name, {"channel": name, **one.model_dump(exclude_defaults=True, mode="json", by_alias=True)})
        for name, one in known.items()
    ]


def _guess(path: Path, one: Series) -> GuessedMapping:
    """The guess for a series, whose columns have the units that are known in their names."""
    rows = slice(None, SETTINGS.rows)
    table = {_TIME: one.t[rows]} | {_with_unit(one, n): column[rows] for n, column in one.columns.items()}
    return guess_table(pl.DataFrame(table, nan_to_null=True), path)


def _with_unit(one: Series, name: str) -> str:
    return f"{name} [{one.units[name]}]" if name in one.units else name


def _name_in_series(one: Series, guess: Guess) -> str:
    return next(name for name in one.columns if _with_unit(one, name) == guess.column)


def fits(unit: str | None, channel: str) -> bool:
    """Whether a unit is one of a channel; none is."""
    wanted = UNITS.get(channel) or logged_quantities(catalogue()).get(channel, "1")
    try:
        scale_offset(unit or wanted, wanted, of="unit")
    except UndertowError:
        return False
    return True


def _column(one: Series, guess: Guess) -> Column:
    name, entry = _name_in_series(one, guess), dict(guess.entry)
    entry["unit"] = one.units.get(name, entry["unit"])
    flag = next((n for n in one.columns if _with_unit(one, n) == entry.get("fresh")), "")
    # Blank samples show already which ones are new.
    entry["fresh"] = f"{one.name}.{flag}" if flag and not np.isnan(one.columns[name]).any() else None
    return Column.model_validate(entry)


def numbered(
    names: Sequence[str], columns: Mapping[str, Column], known: Mapping[str, Column] | None = None
) -> tuple[tuple[str, Column], ...]:
    """The largest group of columns whose names differ in their last number, in its order, as motors."""
    most = max(rows_by_number(n for n in names if n not in columns), key=len, default=[])
    known = known or {}
    return tuple(
        (name, known.get(name, Column(channel=name)).model_copy(update={"channel": f"motor{k}"}))
        for k, name in enumerate(most, 1)
    )


def names_of_columns(name: str, width: int) -> list[str]:
    """Names of the columns of a matrix: by axis where they are three or six, else by number."""
    if width == 6 and name.lower() in SIX:
        return [f"{name}_{axis}" for axis in SIX[name.lower()]]
    if width == 3:
        axes = ("phi", "theta", "psi") if set(Name.of(name).words) & TURNED else ("x", "y", "z")
        return [f"{name}_{axis}" for axis in axes]
    return [name] if width == 1 else [f"{name}{k}" for k in range(1, width + 1)]
