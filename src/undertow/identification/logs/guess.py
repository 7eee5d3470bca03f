"""A draft mapping file for a log: guesses from names, units and ranges of its columns, and questions."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path

import numpy as np
import polars as pl

from undertow.model.catalogue import catalogue
from undertow.model.parameter import logged
from undertow.model.symbols import DOFS, MOTION_UNITS, POSE, VELOCITY
from undertow.model.tables import TURNS
from undertow.model.units import PULSES, scale_offset
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .cells import letters_beside, without_units
from .guess_frames import (
    Axes,
    Guess,
    GuessedMapping,
    axes_of,
    formulas,
    in_formula,
    is_flag,
    place_of,
    quaternions_in,
    unit_of_heading,
    unit_of_place,
    unnamed_quaternion,
)
from .guess_names import (
    ANGLES,
    DISTANCES,
    WANTED,
    Name,
    attitude_beside,
    is_clock,
    is_force,
    latitude_and_longitude,
    part_of_quaternion,
    rows_by_number,
    with_axes,
    with_azimuths,
    with_sides,
)
from .guess_places import fixes_in, no_degrees, two_places
from .guess_rates import SETTINGS as RATES
from .guess_rates import UPSIDE_DOWN, with_common_units, with_rates
from .guess_rows import (
    clock_by_motion,
    clock_of,
    columns_of,
    number_of_things,
    numbers_of,
    times_of_rows,
    unit_in,
)
from .guess_text import whole_table
from .mapping import LogMapping, angles
from .run import FORCES, UNITS, without_jumps
from .table import joined_rows, texts_in


@dataclass(frozen=True)
class GuessSettings:
    """Settings for guesses."""

    rows: int = 20_000  # rows that are examined; more change no guess
    turn: float = 7.0  # an angle beyond this is in degrees: a full turn plus noise
    # Roll and pitch beyond this in radians that never jump by a turn are in degrees.
    upright: Mapping[str, float] = field(default_factory=lambda: {"phi": 3.5, "theta": 1.8})
    small: float = 0.7  # an angle that never gets beyond this may be in radians or a small one in degrees
    spin: float = 6.0  # a turning rate beyond this is in degrees: one turn a second is the most in water
    repeated: float = 0.6  # share of rows that repeat the one before, from which a sensor is slower
    flagged: float = 0.9  # share of new values that a flag must announce
    beyond: float = 1.5  # largest normalised command that may be one of the thruster's curve
    pulse: tuple[float, float] = (900.0, 2100.0)  # widths that servos and speed controllers take, us
    above: float = 0.3  # above the surface by this, m, no vehicle in water is for half of its log
    named_flags: int = 6  # that a question names
    full: float = 1.2  # a command within this is a share of its largest, and its unit needs no question


SETTINGS = GuessSettings()


# --- from a table -----------------------------------------------------------------------------------
def guess_mapping(path: Path, vehicle: Vehicle | None = None, interval: str | None = None) -> GuessedMapping:
    """Guess what the columns of a log (CSV, CSV.gz or Parquet) mean; `interval` is that of its rows."""
    table, reading = whole_table(path)
    clock = None if interval is None else Guess("t", {"interval": interval})
    return guess_table(_examined_rows(table), path, vehicle, reading, clock)


def _examined_rows(table: pl.DataFrame) -> pl.DataFrame:
    """As many rows as are examined: the first, or later ones if the first lack what other columns have."""
    begins = [int(c.is_not_null().arg_max() or 0) for c in table if c.null_count() < table.height]
    late = max(begins, default=0) >= SETTINGS.rows
    return table.slice(max(begins) - SETTINGS.rows // 2 if late else 0, SETTINGS.rows)


def guess_table(
    table: pl.DataFrame,
    path: Path,
    vehicle: Vehicle | None = None,
    reading: LogMapping | None = None,
    clock: Guess | None = None,
    units: Mapping[str, str] | None = None,
) -> GuessedMapping:
    """Guess what the columns of a table, or of its first rows, mean.

    Columns are assigned to the motions, commands and inputs of the vehicle; without one to all motions, and
    those that look like a command keep their names. `reading` is the format of the text of the table, `clock`
    its time and `units` those of columns where they are known.
    """
    reading, table = reading or LogMapping(), table if clock else _with_one_row_per_time(table)
    data = {
        name: column for name in table.columns if (column := numbers_of(table, name, reading)) is not None
    }
    time = clock or clock_of(table, data, f"log {path}")
    t = times_of_rows(table, data, time, f"log {path}")
    if not clock and (moved := _in_si(data, time.column)):
        time, t = clock_by_motion(time, t, moved)
    named = quaternions_in(data)
    unnamed = () if named else unnamed_quaternion({n: c for n, c in data.items() if n != time.column})
    rotation = {time.column, *chain(*named, unnamed), *(c for c in data if part_of_quaternion(c, data))}
    plain = [_name(table, c, reading, units or {}) for c in data if c not in rotation]
    names = with_azimuths(with_sides(with_axes(plain)))
    only = vehicle.dof_indices[0] if vehicle and len(vehicle.dof_indices) == 1 else None
    dead = {n.column for n in names if _is_dead(data[n.column])}
    full = [n for n in names if np.isfinite(data[n.column]).any()]
    free = [n for n in full if not _is_called_like_a_command(n, full, vehicle)]
    motion = _best_columns([n for n in free if n.column not in dead or n.motion(only) not in _MOVED], only)
    motion = _planar(motion)
    motion |= _speed_ahead(vehicle, [n for n in free if n.column not in dead and "u" not in motion])
    driving = _commands([n for n in full if n not in motion.values()], vehicle, dead)
    flags = {name: column for name, column in data.items() if name not in rotation and is_flag(column)}
    motion, globe, place = fixes_in(motion, data, dead, t)
    lost = {*globe} if vehicle is not None and "psi" not in vehicle.pose_names else set()
    globe, place = ((), {}) if lost else (globe, place)  # without a heading north is not ahead
    fixed = {channel: values for channel, (_, values) in place.items()}
    read = _motions(motion, names, data, flags, (t, fixed))
    beside = motion["x"].column if "x" in motion else "".join(globe[:1])
    turned = () if {*motion} & {*POSE[3:]} else attitude_beside(beside, named) or unnamed
    attitude = angles(*(data[n] for n in turned)) if turned else {}
    along_earth = all(c in motion and motion[c].along_earth for c in ("u", "v"))
    known = {g.channel: data[g.column] * _factor(g) for g in read}
    known |= {"psi": without_jumps(t, known["psi"])} if "psi" in known else {}
    to_north = bool(globe) or ("x" in motion and motion["x"].is_to_north)
    axes = axes_of(known | fixed | attitude, t, along_earth=along_earth, to_north=to_north)
    read = with_rates(read, names, data, (t, known | attitude), axes)
    read += _computed(turned, formulas(turned) if turned else {}, "rad", _UNNAMED if unnamed else "")
    read += _by_fixes(globe, place, data, flags, letters_beside(table))
    read = [in_axes(g, axes) for g in read if vehicle is None or g.channel in _channels(vehicle, axes)]
    read += _driven(driving, data, vehicle)
    engine = _buoyancy_engine([n for n in full if n.column not in dead], vehicle)
    read += engine if "B_net" not in driving else []
    used = {*columns_of(time), *turned, *globe, *(g.column for g in read)}
    used |= {str(g.entry.get("fresh", "")) for g in read}
    questions = _questions(vehicle, read, [n for n in full if n.column not in used | dead])
    questions += [_THINGS.format(things, path)] if (things := number_of_things(data)) else []
    questions += two_places((known, motion, globe), data, dead) + _on_flags([*flags], used | dead)
    reading, gaps = _with_gaps(
        reading, table, used & {*data}, {n.column: data[n.column] for n in driving.values()}
    )
    foreign = {*motion, *lost} - {g.channel for g in read}
    return GuessedMapping(
        path.name,
        time,
        tuple(read),
        axes,
        _ignored(table, used, names, dead, only, foreign, (no_degrees(data), rotation)),
        reading,
        (*questions, *gaps),
    )


def _with_one_row_per_time(table: pl.DataFrame) -> pl.DataFrame:
    """The table as it is read by a clock whose rows of one time complement each other; itself without one."""
    for name in filter(is_clock, table.columns):
        joined = joined_rows(table, [name])
        if joined.height < table.height and not (joined[name] == joined[name].shift()).any():
            return joined
    return table


def _channels(vehicle: Vehicle, axes: Axes) -> set[str]:
    """Channels that a vehicle has, and those without which axes cannot be turned."""
    turning = () if axes.entry == Axes().entry else ("x", "y", "psi", "u", "v")
    both = ("x", "y") if {"surge", "yaw"} <= {*vehicle.degrees_of_freedom} else ()
    return {*vehicle.pose_names, *vehicle.velocity_names, *vehicle.inputs, *turning, *both}


def _in_si(data: Mapping[str, Array], time: str) -> dict[str, Array]:
    """Position and horizontal speeds, m and m/s, as far as names and units of columns show them."""
    names = with_sides(with_axes([Name.of(c) for c in data if c != time]))
    globe = latitude_and_longitude(data)
    found = {c: v for c, (_, v) in place_of(*((n, data[n]) for n in globe)).items()} if globe else {}
    for channel, name in _best_columns([n for n in names if not _is_dead(data[n.column])], None).items():
        if channel in ("x", "y", "u", "v"):
            factor = scale_offset(name.unit or UNITS[channel], UNITS[channel])[0]
            found[channel] = data[name.column] * (-factor if name.is_leftward else factor)
    return found


def _with_gaps(
    reading: LogMapping, table: pl.DataFrame, used: set[str], commands: Mapping[str, Array]
) -> tuple[LogMapping, list[str]]:
    """The mapping of a table whose columns have cells without a number, and questions on these."""
    lost = {c: texts for c in table.columns if c in used and (texts := texts_in(table, c, reading))}
    rows = without_units(table) if lost else table
    doubted = {c: texts for c in lost if (texts := texts_in(rows, c, reading))}
    asked = [_TEXTS.format(c, texts[0][:40], len(texts)) for c, texts in doubted.items()]
    above = table.height - rows.height
    blank = [name for name, values in commands.items() if np.isnan(values[above:]).any()]
    changes: dict[str, str] = {"not_numbers": "missing"} if lost else {}
    if blank and reading.missing_commands == "refuse":
        changes["missing_commands"] = "hold"
        asked.append(_BLANK.format(", ".join(blank)))
    return reading.model_copy(update=changes), asked


def without_motion(vehicle: Vehicle | None, channels: Container[str]) -> list[str]:
    """Ask for the motions of a vehicle of which no channel is known."""
    dofs = vehicle.dof_indices if vehicle else ()
    lacking = [i for i in dofs if POSE[i] not in channels and VELOCITY[i] not in channels]
    return no_column([f"{DOFS[i]} ({VELOCITY[i]} or {POSE[i]})" for i in lacking])


def no_column(lacking: Sequence[str]) -> list[str]:
    """Ask for channels of a vehicle that no column resembles."""
    which = "which one is it" if len(lacking) == 1 else "which ones are they"
    asked = f"no column looks like {', '.join(lacking)} of the vehicle: {which}, in what unit?"
    return [asked] if lacking else []


def _questions(vehicle: Vehicle | None, read: Sequence[Guess], left: Sequence[Name]) -> list[str]:
    """Questions on what has no column, and on forces among the columns that are `left`."""
    commands = vehicle.command_names if vehicle else ()
    lacking = [c for c in commands if c not in {g.channel for g in read}]
    wrench, axes = [n for n in left if n.force], _axes(vehicle)
    asked = without_motion(vehicle, {g.channel for g in read}) + no_column(lacking)
    if lacking and wrench:
        return [*asked, _WRENCH.format(", ".join(n.column for n in wrench))]
    taken = {axes[g.channel] for g in read if g.channel in axes}
    same = [n.column for n in wrench if n.force in taken and not WANTED & {*n.words}]
    return [*asked, _SAME_FORCE.format(", ".join(same))] if same else asked


def _on_flags(flags: Sequence[str], known: Container[str]) -> list[str]:
    """Ask what columns of 0 and 1 are that are not known, if there are any."""
    names, most = [f"'{flag}'" for flag in flags if flag not in known], SETTINGS.named_flags
    more = [f"{len(names) - most} more"] if len(names) > most else []
    return [_FLAG.format(", ".join(names[:most] + more))] if names else []


_WRENCH = (
    "{} may be the force on the whole vehicle. Where it was computed or measured, state generalised_forces "
    "in the vehicle file; if a controller asked for it, state a thruster with a wrench for each, whose "
    "gain can then be estimated"
)
_SAME_FORCE = (
    "{} may be the force on the vehicle, too: which columns have what acted on it? What a controller demands "
    "acts only while it is in charge"
)
_TEXTS = (
    "'{}' has cells that are not numbers, such as '{}' ({} of them): is it right to take them as missing?"
)
_THINGS = (
    "'{}' numbers several things whose rows take turns, so that every other column mixes them: do they? As a "
    "table in a folder of its own, {} is read with a series for each"
)
_BLANK = (
    "commands without a value in some rows ({}) keep their previous value, by missing_commands = "
    '"hold" above: do they?'
)
_FLAG = (
    "{} 0 or 1: does it flag the values of a sensor that are new, or valid? Then give the columns of that "
    "sensor fresh = its name"
)


_BETTER = "another column looks more like the measurement"
_UNNAMED = "squares sum to one: read as quaternion w, x, y, z in the order written here: is that right?"
_PUMPED = "B_net: weight of the water displaced, if this is in cm^3 and grows to rise: is it, and does it?"
_FIXES = "x and y: metres from the first fix of this log, if these are {}: are they?"


def _computed(columns: Sequence[str], by_channel: Mapping[str, str], unit: str, doubt: str) -> list[Guess]:
    """Channels that are formulas in several columns; the doubt stands at the first of them."""
    entries = [{"channel": c, "expression": text, "unit": unit} for c, text in by_channel.items()]
    doubts = [doubt, *[""] * len(entries)]
    return [Guess(", ".join(columns), entry, d) for entry, d in zip(entries, doubts, strict=False)]


def _buoyancy_engine(names: Sequence[Name], vehicle: Vehicle | None) -> list[Guess]:
    """The net buoyancy of a vehicle that takes it from the log, from the volume that a glider pumps."""
    if vehicle is None or "B_net" not in vehicle.inputs:
        return []
    column = next((n.column for n in names if n.is_pumped_volume), None)
    if column is None:
        return []
    force = 1e-6 * vehicle.environment["rho"] * vehicle.environment["g"]  # N per cm^3
    return _computed([column], {"B_net": f"{force:.6g} * {in_formula(column)}"}, "N", _PUMPED)


def _by_fixes(
    globe: Sequence[str],
    place: Mapping[str, tuple[str, Array]],
    data: Mapping[str, Array],
    flags: Mapping[str, Array],
    letters: Mapping[str, str],
) -> list[Guess]:
    """Entries of the place that latitude and longitude give, signed by columns of `letters`."""
    unit = unit_of_place(*(data[n] for n in globe)) if globe else ""
    signed = [f"'{letters[n]}'" for n in globe if n in letters]
    unit += f", south and west by the letters in {' and '.join(signed)}" if signed else ""
    unit += "" if not globe or latitude_and_longitude(globe) else f", '{globe[0]}' the latitude"
    doubt = _FIXES.format(unit) if globe else ""
    fixes = _computed(globe, {channel: formula for channel, (formula, _) in place.items()}, "m", doubt)
    new = [_fresh(Name.of(column), data[column], flags) for column in globe]
    entries = [{**fix.entry, "fresh": n} if n else fix.entry for fix, n in zip(fixes, new, strict=True)]
    return [replace(fix, entry=entry) for fix, entry in zip(fixes, entries, strict=True)]


def _heading(
    motion: Mapping[str, Name], data: Mapping[str, Array], t: Array, place: Mapping[str, Array]
) -> str:
    """Unit of the heading: as its name states, else by jumps of a full turn, the position or its range."""
    name = motion.get("psi")
    if name is None or name.unit:
        return name.unit if name else ""
    plain = {c: data[n.column] for c, n in motion.items() if c in ("x", "y", "u", "v")}
    return unit_of_heading(data[name.column], {**place, **plain}, t) or _unit("psi", data[name.column])[0]


def _name(table: pl.DataFrame, column: str, reading: LogMapping, units: Mapping[str, str]) -> Name:
    """The name of a column, with the unit known or stated by its cells if it states none itself."""
    name = Name.of(column)
    return name if name.unit else replace(name, unit=units.get(column) or unit_in(table, column, reading))


# Attitude and depth of a vehicle may be constant; another motion that is constant was not measured.
_MOVED = ("x", "y", *VELOCITY)


def _is_dead(values: Array) -> bool:
    there = values[np.isfinite(values)]
    return len(values) > 1 and (len(there) == 0 or float(np.ptp(there)) == 0.0)


def _best_columns(names: Iterable[Name], only: int | None) -> dict[str, Name]:
    """The column of each channel: the one with the best rank of those whose names mean it."""
    found: dict[str, Name] = {}
    names = list(names)
    body = any(n.motion(only) in VELOCITY[:2] and not n.along_earth for n in names)
    for name in names:
        channel = "" if body and name.along_earth else name.motion(only)  # never one of each
        if channel and (channel not in found or name.rank < found[channel].rank):
            found[channel] = name
    return {channel: found[channel] for channel in (*POSE, *VELOCITY) if channel in found}


def _planar(motion: Mapping[str, Name]) -> dict[str, Name]:
    """The columns of channels, with "theta" beside x and y alone as the heading, as in a plane."""
    theta, place = motion.get("theta"), [motion[c] for c in ("x", "y") if c in motion]
    alone = theta is not None and "theta" in theta.words and not {"z", "phi", "psi"} & motion.keys()
    alone = alone and len(place) == 2 and all(name.stem == theta.stem for name in place if theta)
    return {"psi" if alone and c == "theta" else c: name for c, name in motion.items()}


def _speed_ahead(vehicle: Vehicle | None, names: Iterable[Name]) -> dict[str, Name]:
    """The best column with a speed, of a vehicle that has surge and no sway."""
    moves = {"surge", "sway"} & {*vehicle.degrees_of_freedom} if vehicle else set()
    speeds = [n for n in names if n.is_speed] if moves == {"surge"} else []
    return {"u": min(speeds, key=lambda n: (n.is_through_water, n.rank))} if speeds else {}


def _commands(names: Sequence[Name], vehicle: Vehicle | None, dead: set[str]) -> dict[str, Name]:
    """The column of each command and input of the vehicle, else of all columns that look like a command."""
    # `dead` columns are constant: they are used for a thruster of the vehicle that was never used, and in a
    # group of columns that differ in a number.
    if vehicle is None:
        driving = [n for n in names if (n.is_command or n.force) and not set(n.words) & WANTED]
        rows = rows_by_number(n.column for n in driving)
        beside = {column for row in rows if not dead.issuperset(row) for column in row}
        likely = sorted(driving, key=lambda n: n.rank, reverse=True)  # the best of one force is the last
        kept = {n.force or n.column: n for n in likely if n.column not in dead or n.column in beside}
        return {c: kept[c] for c in dict.fromkeys(n.force or n.column for n in driving) if c in kept}
    names = sorted(names, key=lambda n: n.column in dead)
    found: dict[str, Name] = {}
    axes = _axes(vehicle)
    for command, unit in vehicle.input_units.items():
        known = [n for n in names if n not in found.values() and command not in MOTION_UNITS]
        fits = sorted(
            (*(n.senses(command, unit) if command in vehicle.inputs else n.fits(command, unit, axes)), k)
            for k, n in enumerate(known)
        )
        if fits and fits[0][0] < DISTANCES.no_fit:
            found[command] = known[fits[0][2]]
    if found.keys().isdisjoint(vehicle.actuator_names):
        found |= _by_number(names, vehicle.actuator_names)
    return found


def _is_called_like_a_command(name: Name, names: Sequence[Name], vehicle: Vehicle | None) -> bool:
    """Whether a column has the name of a thruster that no other column looks like a command of."""
    called = name.column.lower()
    if vehicle is None or called not in map(str.lower, vehicle.actuator_names):
        return False
    axes = _axes(vehicle)
    return not any(n != name and n.is_command and n.drives(called, axes) < DISTANCES.no_fit for n in names)


def _axes(vehicle: Vehicle | None) -> dict[str, str]:
    """The only force or moment of commands that are named like one."""
    thrusters = vehicle.thrusters if vehicle else ()
    alone = {t.name: np.flatnonzero(t.wrench) for t in thrusters if is_force(t.name)}
    return {f: f for f in FORCES} | {n: FORCES[at[0]] for n, at in alone.items() if len(at) == 1}


def _by_number(names: Sequence[Name], commands: Sequence[str]) -> dict[str, Name]:
    """Columns that differ only in a number, as many as there are commands, in the order of that number."""
    known = {name.column: name for name in names if name.is_command}
    fitting = (row for row in rows_by_number(known) if len(row) == len(commands) > 1)
    return {command: known[name] for command, name in zip(commands, next(fitting, []), strict=False)}


def _motions(
    motion: Mapping[str, Name],
    names: Sequence[Name],
    data: Mapping[str, Array],
    flags: Mapping[str, Array],
    fixes: tuple[Array, Mapping[str, Array]],
) -> list[Guess]:
    """Entries of pose and velocity, by the columns that mean them; `fixes` are times and places by these."""
    t, place = fixes
    heading = _heading(motion, data, t, place)
    read = [_motion(channel, name, data, flags) for channel, name in motion.items()]
    read = [replace(g, entry={**g.entry, "unit": heading}) if g.channel == "psi" else g for g in read]
    return with_common_units(read, names)


def _motion(channel: str, name: Name, data: Mapping[str, Array], flags: Mapping[str, Array]) -> Guess:
    values, unit, doubts = data[name.column], name.unit, list[str]()
    if not unit:
        unit, doubt = _unit(channel, values)
        in_minutes = unit == "deg/s" and "rot" in name.words
        if channel in POSE[:3] and name.rank[1]:  # a letter beside unknown words may be of any vector
            doubt = doubt.replace("is it", f"is it the position {channel},")
        doubts.append("degrees a second, or a minute, as in sentences of NMEA 0183?" if in_minutes else doubt)
    elif name.is_motion_by_unit:
        doubts.append(f"its unit is that of a velocity: is it {channel}?")
    if unit == "rev/s":
        unit = "rad/s"
        doubts.append("rps: radians a second, or revolutions?")
    entry: dict[str, object] = {"channel": channel, "unit": unit}
    half = scale_offset("rad", unit)[0] * np.pi if channel in ("phi", "theta") else np.inf
    if channel == "psi" or float(np.nanmax(values, initial=0.0)) > half:
        entry["wrapped"] = True
    if channel == "psi" and "theta" in name.words:
        doubts.append("beside x and y alone, read as the heading: is it?")
    fresh = _fresh(name, values, flags)
    if fresh:
        entry["fresh"] = fresh
        if fresh == name.column:
            doubts.append("most rows repeat the one before: is the sensor slower than the log?")
    if name.is_upward and channel in ("z", "w"):
        entry["scale"] = -1
        if name.is_height:
            doubts.append("read as a height above a fixed level (z = -height): is it?")
    elif name.is_leftward and channel == "v":
        entry["scale"] = -1
    elif name.is_speed and channel == "u":
        doubts.append("read as the speed ahead: does the vehicle hardly drift or go astern?")
        if name.is_through_water:
            doubts.append("[water] with the velocity of the water makes it one over ground")
    elif "depth" in name.words and np.nanmedian(values) * scale_offset(unit, "m")[0] < -SETTINGS.above:
        entry["scale"] = -1
        doubts.append("mostly negative, as no depth is: read as growing upwards: does it?")
    elif channel == "z" and not set(name.words) & {"d", "down", "depth"}:
        doubts.append("does it grow with depth? If it grows upwards: scale = -1")
    return Guess(name.column, entry, " ".join(filter(None, doubts)))


def in_axes(guess: Guess, axes: Axes) -> Guess:
    """The entry of a depth or a height with the sign of z in these axes; any other as it is."""
    name = Name.of(guess.column)
    signed = name.is_upward or bool({*name.words} & {"d", "down", "depth"})
    if guess.channel != "z" or not signed or axes.entry["position"] != "ENU":
        return guess
    entry = {k: v for k, v in guess.entry.items() if k != "scale"}
    return replace(guess, entry=entry if "scale" in guess.entry else {**entry, "scale": -1})


def _unit(channel: str, values: Array) -> tuple[str, str]:
    """Unit of a column that does not state it, and the doubt about it."""
    most = float(np.nanmax(np.abs(values), initial=0.0))
    if most == 0.0:
        return UNITS[channel], ""
    if channel in POSE[3:]:
        if most > SETTINGS.turn:
            return "deg", ""
        over = channel in SETTINGS.upright and most > SETTINGS.upright[channel]
        if over and not np.any(np.abs(np.diff(values)) > np.pi):  # as an angle of 0 to 2 pi has them
            return "deg", UPSIDE_DOWN
        certain = channel == "psi" and most > SETTINGS.small
        return "rad", "" if certain else f"never beyond {most:.2g}: radians, or small angles in degrees?"
    if channel in VELOCITY[3:]:
        if most > SETTINGS.spin:
            return "deg/s", ""
        still = "less than the earth's rotation; if it measures nothing, leave it out"
        doubt = still if most < RATES.still else "rad/s, or slow turns in deg/s?"
        return "rad/s", f"never beyond {most:.2g}: {doubt}"
    unit = UNITS[channel]
    return unit, f"no unit in the name: is it in {unit}?"


def _fresh(name: Name, values: Array, flags: Mapping[str, Array]) -> str:
    """The column that flags new values of a sensor slower than its log; the column itself without one."""
    # If a sensor has rows of its own, only these are considered.
    there = np.isfinite(values)
    values, flags = values[there], {flag: column[there] for flag, column in flags.items()}
    new = np.concatenate([[False], np.diff(values) != 0])
    if len(values) < 2 or not 0 < np.mean(new) < 1.0 - SETTINGS.repeated:
        return ""
    for flag, column in flags.items():
        up = column > 0
        announces = up.any() and np.mean(up[new]) > SETTINGS.flagged
        if announces and np.mean(up) < SETTINGS.repeated:
            return flag
    gaps = np.diff(np.flatnonzero(new))
    if not len(gaps):
        return ""
    usual = np.median(gaps)
    # Values of low resolution change at irregular intervals.
    return name.column if np.mean(np.abs(gaps - usual) <= 1) > SETTINGS.flagged and usual > 1 else ""


def _factor(guess: Guess) -> float:
    """SI units in one unit of a column of pose or velocity, negative where its sign is reversed."""
    sign = -1.0 if guess.entry.get("scale") == -1 else 1.0
    return sign * scale_offset(str(guess.entry["unit"]), UNITS[guess.channel])[0]


def _driven(driving: Mapping[str, Name], data: Mapping[str, Array], vehicle: Vehicle | None) -> list[Guess]:
    """Guesses of the columns of commands and inputs."""
    units, axes = (vehicle.input_units, _axes(vehicle)) if vehicle else ({}, {})
    normalised_by = {t.name: t.normalised_by for t in vehicle.thrusters} if vehicle else {}
    return [
        _command(command, name, data[name.column], units, axes, normalised_by.get(command))
        for command, name in driving.items()
    ]


def _command(
    command: str,
    name: Name,
    values: Array,
    units: Mapping[str, str],
    axes: Mapping[str, str],
    normalised_by: tuple[float, float] | None = None,
) -> Guess:
    """A command: forces and angles with their unit, pulses as -1 ... 1, revolutions squared."""
    # `units`, `axes`: those of the commands and inputs of the vehicle, by name; none without a vehicle.
    # `normalised_by`: neutral and span of the thruster's curve, as of `Thruster`.
    entry: dict[str, object] = {"channel": command}
    most, least = float(np.nanmax(values, initial=0.0)), float(np.nanmin(values, initial=0.0))
    unit, quantity = units.get(command, ""), _quantities().get(command, "")
    certain = not axes or command == name.column or name.is_surely(command, axes)
    doubt, asked = "", "" if certain else f"is it command '{command}'? "
    low, high = SETTINGS.pulse
    pulses = values[(values != 0.0) & np.isfinite(values)]  # 0 where an output is switched off
    if command in FORCES:
        entry["unit"] = UNITS[command]
    elif quantity:
        entry["unit"] = name.unit or unit
        asked = "" if name.column.lower() == command else f"is it {command}: {quantity}? "
        doubt = "" if name.unit else f"no unit in the name: is it in {unit}?"
    elif unit in TURNS:
        stated = TURNS.get(name.unit)
        entry |= {} if stated in (None, TURNS[unit]) else {"scale": stated / TURNS[unit]}
        doubt = "" if stated else f"from {least:.3g} to {most:.3g}: is it in {unit}?"
    elif unit == "N" == name.counts and not name.unit:
        entry["unit"], doubt = "N", "no unit in the name: is it in N?"
    elif name.force and name.force == axes.get(command) and not name.unit:
        entry["unit"], doubt = (u := UNITS[name.force]), f"no unit in the name: is it in {u}?"
    elif name.unit in ("N", "kN", "deg", "rad", "V"):
        entry["unit"] = name.unit
        doubt = "in volts: what was commanded, or what was measured?" if name.unit == "V" else ""
    elif name.counts == "rev/s":
        entry["power"] = 2
        turn = f"1 {name.unit}" if name.unit in TURNS else "n = 1"
        doubt = f"revolutions, read as n |n|: what thrust in N does {turn} give? Write it as scale, or state "
        doubt += "[thrusters.propeller] in the vehicle file"
    elif normalised_by and len(pulses) and _are_within(pulses, *normalised_by):
        entry |= _normalisation(*normalised_by, values)
        about = f"read as -1 ... 1 about {normalised_by[0]:g}, as its curve: is that right?"
        doubt = f"from {np.min(pulses):.4g} to {most:.4g}, {about}"
    elif len(pulses) and low <= np.min(pulses) and most <= high:
        entry |= _normalisation(PULSES.neutral, PULSES.span, values)
        expected = " The vehicle file expects N: a curve there, or scale and offset times the force of a "
        expected += "full command"
        doubt = f"pulses from {np.min(pulses):.4g} to {most:.4g} us, read as -1 ... 1 about 1500: "
        doubt += f"is that right?{expected if unit == 'N' else ''}"
    elif unit == "rad":  # no rudder or fin turns by more than a right angle
        entry["unit"], doubt = ("deg", "") if max(most, -least) > np.pi / 2 else _unit("phi", values)
    elif unit == "N" or max(most, -least) > SETTINGS.full:
        expected = " The vehicle file expects N: else give the force of a command of 1 as scale"
        likely = "degrees" if {*name.unnumbered} & ANGLES else "newtons"
        doubt = f"from {least:.3g} to {most:.3g}: {likely}, per cent or something else?"
        doubt += expected if unit == "N" else ""
        if unit == "N" and name.unit == "%":
            doubt = (
                f"up to {most:.3g} per cent, but the vehicle file expects N: give the force of 1% as scale"
            )
    return Guess(name.column, entry, f"{asked}{doubt}".strip())


def _are_within(commands: Array, neutral: float, span: float) -> bool:
    """Whether commands may be those of a curve with this neutral command and span."""
    return bool(np.all(np.abs(commands - neutral) <= SETTINGS.beyond * span))


def _normalisation(neutral: float, span: float, values: Array) -> dict[str, float]:
    """What makes of a column commands of -1 ... 1 about neutral; 0 far outside means switched off."""
    off = {"off": 0.0} if np.any(values == 0.0) and neutral > span else {}
    return {"scale": 1.0 / span, "offset": -neutral / span} | off


def _quantities() -> dict[str, str]:
    """Descriptions of the quantities that effects take from logs, by name."""
    return {d.name: d.about for cls in catalogue().values() for d in logged(cls)}


def _ignored(
    table: pl.DataFrame,
    used: set[str],
    names: Sequence[Name],
    dead: set[str],
    only: int | None,
    foreign: set[str],
    other: tuple[Sequence[str], set[str]],
) -> dict[str, tuple[str, ...]]:
    """Columns that are left out, by the reason."""
    # `foreign` are channels that the vehicle does not have, and columns of such; `other` columns of places
    # that are not in degrees, and of quaternions.
    no_degrees, rotation = other
    columns, letters = table.columns, letters_beside(table).values()
    found: dict[str, list[str]] = {}
    by_column = {name.column: name for name in names}
    for column in columns:
        if column in used or column in letters:
            continue
        name = by_column.get(column, Name.of(column))
        if column not in by_column and column not in rotation:
            reason = "not numbers"
        elif column in dead:
            reason = "never changes: measured by nothing, or held"
        elif set(name.words) & WANTED and not name.motion(only):
            reason = "a set-point, or something else"
        elif column in rotation:
            reason = _BETTER
        elif {name.motion(only), column} & foreign:
            reason = "a motion that the vehicle does not have"
        elif name.force:
            reason = "a force on the vehicle, which its thrusters make"
        elif column in no_degrees:
            reason = "? a latitude or longitude that is not in degrees"
        elif name.motion(only) or column in latitude_and_longitude(columns):
            reason = _BETTER
        else:
            reason = "? meaning unknown"
        found.setdefault(reason, []).append(column)
    return {reason: tuple(names) for reason, names in found.items()}
