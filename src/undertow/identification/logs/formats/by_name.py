"""Meaning of series not defined by their format: guesses from column names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from itertools import pairwise
from pathlib import Path

import numpy as np
import polars as pl

from undertow.errors import UndertowError
from undertow.identification.logs.guess import SETTINGS, guess_table, in_axes, no_column, without_motion
from undertow.identification.logs.guess_frames import Axes, Guess, GuessedMapping
from undertow.identification.logs.guess_names import DISTANCES, Name, rows_by_number, with_axes
from undertow.identification.logs.mapping import Channel, Column, Frames, LogMapping
from undertow.identification.logs.run import FORCES, MEASURED, UNITS
from undertow.model.catalogue import catalogue, logged_quantities
from undertow.model.symbols import POSE, VELOCITY
from undertow.model.units import scale_offset
from undertow.model.vehicle import Vehicle

from .fieldlog import HELD, TIME, FieldLog, Series

CLOCK = Guess(TIME, {"column": TIME, "unit": "s"})
"""The clock of the table of a log."""

_TIME = "time [s]"
# Names of matrices, and of their columns; MSS (Fossen) calls pose eta and velocity nu.
_SIX_MOVES = ("surge", "sway", "heave", "p", "q", "r")
SIX = {"eta": POSE, "pose": POSE, "nu": _SIX_MOVES, "tau": tuple(name[4:] for name in FORCES)}
TURNED = {"euler", "rpy", "angles", "attitude", "orientation", "theta_nb", "eul"}
LINEAR = {"pos", "position", "vel", "velocity", "acc", "acceleration", "gyro", "omega", "rates"}
Meaning = tuple[LogMapping, tuple[tuple[str, Column], ...], list[str]]


def guessed(path: Path, series: Sequence[Series], known: Mapping[str, Column] | None = None) -> Meaning:
    """Guess a mapping and the commands of series, with questions.

    Series with most of the motion take precedence. No channel is guessed that is known already (`known`, by
    ``series.column``).
    """
    columns, notes, frames = dict(known or {}), [], Frames()
    taken = {column.channel for column in columns.values()}
    driving: list[str] = []
    found = [(one, _guess(path, one)) for one in series if len(one.t) > 1]
    found.sort(key=lambda pair: -sum(guess.channel in UNITS for guess in pair[1].columns))
    for number, (one, guess) in enumerate(found):
        direct = [g for g in guess.columns if not g.is_formula]
        new = [g for g in direct if g.channel in UNITS and g.channel not in taken]
        new = [g for g in new if fits(one.units.get(_name_in_series(one, g)), g.channel)]
        if frames.position == "ENU" and guess.axes.entry["position"] == "NED":  # those of the first series
            new = [in_axes(g, found[0][1].axes) for g in new]
        columns |= {f"{one.name}.{_name_in_series(one, g)}": _column(one, g) for g in new}
        taken |= {g.channel for g in new}
        driving += [f"{one.name}.{_name_in_series(one, g)}" for g in direct if g.channel not in UNITS]
        doubtful = [g for g in new if g.doubt and _name_in_series(one, g) not in one.units]
        doubts = [f"{one.name}.{_name_in_series(one, g)}: {g.doubt}" for g in doubtful]
        notes += [*doubts, *(guess.axes.questions if number == 0 and new else ())]
        if number == 0 and not known:
            frames = Frames.model_validate(guess.axes.entry)
    return LogMapping(columns=columns, frames=frames), numbered(driving, columns), notes


def has_motion(one: Series) -> bool:
    """Whether a series has a motion among its columns, by their names."""
    return any(Name.of(f"{one.name}.{c}").motion() for c in one.columns)


def on_separate_runs(series: Sequence[Series]) -> list[str]:
    """Notes on series whose names differ in a number alone, with the same motions at different times."""
    by_name, notes = {one.name: one for one in series}, list[str]()
    for row in rows_by_number(by_name):
        members = sorted((by_name[name] for name in row), key=lambda one: float(np.nanmin(one.t)))
        alike = all(
            {*a.columns} == {*b.columns} and np.nanmax(a.t) < np.nanmin(b.t) for a, b in pairwise(members)
        )
        if len(members) > 1 and has_motion(members[0]) and alike:
            notes.append(
                f"{row[0]} to {row[-1]} have the same columns at different times: separate runs, of which "
                "only one is read: save each in a file of its own"
            )
    return notes


def first_mapping(log: FieldLog, vehicle: Vehicle | None = None) -> GuessedMapping:
    """A mapping file of a native vehicle log: what its format defines, and guesses and questions on the rest.

    Commands that are not known in the log are searched by name among its columns. If no motion of the vehicle
    is known, everything is guessed.
    """
    meaning = log.mapping_for(vehicle.command_names if vehicle else ())
    known = [*_as_guesses(meaning.columns), *_as_guesses(meaning.channels)]
    moves = {*vehicle.pose_names, *vehicle.velocity_names} if vehicle else MEASURED
    if log.by_name or not MEASURED & moves & {guess.channel for guess in known}:
        return guess_table(log.beginning(), log.path, vehicle, HELD, CLOCK, log.units)
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
