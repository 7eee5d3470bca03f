"""From a file to a run: columns to channels, units and frames to internal conventions, checks."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
import polars as pl

from undertow.errors import UndertowError
from undertow.identification.logs.mapping import (
    Channels,
    over_ground,
    swap_attitude,
    swap_body,
    swap_position,
    turned_name,
    velocity_to_body,
)
from undertow.identification.logs.table import (
    WHOLE,
    LogLimits,
    Origin,
    in_unit_of_cells,
    joined_rows,
    numbers,
    taken_as_missing,
    unit_of_cells,
)
from undertow.model.catalogue import catalogue, logged_quantities
from undertow.model.symbols import DOFS, FORCE, FORCE_UNITS, MOTION_UNITS, POSE, VELOCITY
from undertow.model.tables import TURNS
from undertow.model.units import magnitude, scale_offset, si_of, si_unit
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Flags, Index, Progress

from . import opening
from .cells import letters_beside, signed_by_letters
from .formats.fieldlog import Window, one_run
from .mapping import (
    Channel,
    Column,
    CommandPolicy,
    Held,
    LogMapping,
    attitude_of,
    mapping_beside,
    name_of_log,
)
from .opening import FieldLogs
from .pose_velocity import velocities_from_pose
from .run import (
    FORCES,
    MEASURABLE,
    MEASURED,
    UNITS,
    OneClock,
    Run,
    Series,
    are_several,
    in_gaps,
    interpolated_mean,
    later_than_before,
    on_one_clock,
    upright,
    with_heading_corrected,
    with_report_noise,
    without_jumps,
)

Commands = dict[str, float]
Mapped = TypeVar("Mapped", Column, Channel)


def read_log(
    path: str | Path | Sequence[str | Path],
    mapping: LogMapping | None = None,
    channels: Iterable[str] = (),
    *,
    window: Window = (None, None),
    missing_commands: CommandPolicy | None = None,
    also: Iterable[str] = (),
    limits: LogLimits = WHOLE,
) -> Run:
    """Read a log: in SI, NED and forward-starboard-down axes; gaps are NaN.

    A table with blanks in a regular pattern is read as several series (see `on_one_clock`).
    Of other logs nothing is interpolated.

    `channels` are commands that must be in the log, `also` those that are read where it has them. Without a
    mapping a vehicle's own log means what its format says, and the columns of a table must have the channel
    names and SI units of undertow. The window, in s, is on the clock of the run (None: no limit). What is
    larger than the limits is refused before it is held in memory. Of a log of several segments the longest
    is used, and its notes say so. Several paths are tables of one run, each on its own clock.
    """
    request = _Request(mapping, tuple(channels), window, missing_commands, tuple(also), limits)
    if not isinstance(path, str | Path):
        log = one_run([Path(file) for file in path])
        path, request = log.path, replace(request, field_logs={log.path: log})
    runs = _runs_of(Path(path), request)
    longest = max(runs, key=lambda run: float(run.t[-1] - run.t[0]))
    others = len(runs) - 1
    note = f"{others} shorter segments of the log left out: read_logs reads all of them"
    return longest.with_notes(note) if others else longest


@dataclass(frozen=True)
class _Request:
    """How a log is to be read; see `read_log` and `read_logs`."""

    mapping: LogMapping | None
    channels: tuple[str, ...]
    window: Window
    missing_commands: CommandPolicy | None
    also: tuple[str, ...]
    limits: LogLimits
    in_any_order: bool = False
    field_logs: FieldLogs | None = None


def _runs_of(path: Path, request: _Request) -> list[Run]:
    """The segments of a log, each as a run."""
    log = opening.field_log(path, request.mapping, request.field_logs)
    if log is None:
        found = opening.opened_table(path, request.mapping, request.limits)
    else:
        found = opening.opened_field_log(log, request.mapping, request.channels, request.also, request.window)
    mapping = opening.dropping_disorder(found.mapping) if request.in_any_order else found.mapping
    options = (path, mapping, request.channels, request.window, request.missing_commands, request.also)
    parts = opening.segments_in(found.table, mapping.time.stretch, f"log {path}")
    runs = [run_of_table(part, *options) for part in parts]
    runs = [replace(r, mapping=found.mapping, sha256=found.sha256, reader_notes=found.notes) for r in runs]
    if len(runs) == 1:
        return runs
    return [replace(r, name=f"{r.name}-{k}", part_of=r.name) for k, r in enumerate(runs, 1)]


def read_logs(
    paths: Sequence[Path],
    vehicle: Vehicle,
    mapping: LogMapping | None = None,
    *,
    window: Window = (None, None),
    missing_commands: CommandPolicy | None = None,
    held: Held = (),
    to_fit: bool = False,
    one_motion: bool = False,
    in_any_order: bool = False,
    field_logs: FieldLogs | None = None,
    progress: Progress = lambda done, words: None,
) -> list[Run]:
    """Read the logs of a vehicle, each with a name of its own, and with velocities, if need be from its pose.

    Without a mapping, a mapping file of the same name next to a log is used. A rig holds the motions in
    `held`, whatever the mappings say: such a log needs no column for them, nor for commands, and a log of
    `one_motion` may lack motions and commands, too. `to_fit` refuses more samples than a fit takes as soon
    as they are read; `in_any_order` leaves out rows whose time is not later than that of all before.
    `field_logs` are native vehicle logs that are open already; others are added. Of a log of several
    segments, each is a run.
    """
    runs: list[Run] = []
    for done, path in enumerate(paths):
        progress(done, f"reading {path.name}")
        meaning = mapping_for(path, mapping, vehicle, held)
        part = one_motion or bool(meaning and meaning.held)
        needed, also = ((), vehicle.command_names) if part else (vehicle.command_names, ())
        limits, time = WHOLE, (meaning or LogMapping()).time
        if to_fit and window == (None, None) and time.disorder != "drop":
            most = MEASURABLE
            limits = replace(WHOLE, rows=most.rows_per_sample * time.every * most.samples)
        request = _Request(meaning, needed, window, missing_commands, also, limits, in_any_order, field_logs)
        read = [_with_note_on_newtons(run, vehicle) for run in _runs_of(path, request)]
        if to_fit:
            opening.refuse_too_many(sum(len(r.t) for r in (*runs, *read)), path)
        runs += read if part else [_with_velocities(run, vehicle) for run in read]
    opening.refuse_duplicates(runs)
    return opening.with_distinct_names(runs)


def mapping_for(
    path: Path, mapping: LogMapping | None, vehicle: Vehicle, held: Held = ()
) -> LogMapping | None:
    """The mapping that is given, or that of the file beside a log, with the motions that a rig holds.

    Speeds of propellers are converted to the unit of the vehicle.
    """
    meaning = mapping or mapping_beside(path)
    if meaning is not None:
        meaning = in_vehicle_units(meaning, vehicle, f"log {path}")
    return (meaning or LogMapping()).model_copy(update={"held": held}) if held else meaning


def in_vehicle_units(mapping: LogMapping, vehicle: Vehicle, where: str) -> LogMapping:
    """The mapping with speeds of propellers in the unit of the vehicle file (`revolutions`), not in rad/s.

    A stated unit that is of another kind than the command, such as rev/s for newtons, is refused.
    """
    counted = {t.name: TURNS[t.unit] for t in vehicle.thrusters if t.unit in TURNS}
    units = {n: unit for n, unit in vehicle.input_units.items() if n not in counted and unit != "command"}
    moments = {t.name for t in vehicle.thrusters if t.is_moment and units.get(t.name) == "N"}

    def converted(name: str, command: str, part: Mapped) -> Mapped:
        of = f"{where}: unit {part.unit!r} of {name!r},"
        if part.unit is not None and command in counted:
            speed = scale_offset(part.unit, "rad/s", of=f"{of} speed of a propeller,")[0]
            return part.in_units_of(speed * TURNS["rad/s"] / counted[command])
        if part.unit is not None and command in units:
            others = ("N m",) if command in moments else ()
            _require_kind(part.unit, units[command], *others, of=f"{of} a command,")
        return part

    columns = {n: converted(n, column.channel, column) for n, column in mapping.columns.items()}
    channels = {n: converted(n, n, channel) for n, channel in mapping.channels.items()}
    return mapping.model_copy(update={"columns": columns, "channels": channels})


def _require_kind(unit: str, wanted: str, *others: str, of: str) -> None:
    """Refuse a unit of a command that is of another kind than those which the vehicle takes."""
    for other in others:
        with suppress(UndertowError):
            scale_offset(unit, other)
            return
    try:
        scale_offset(unit, wanted, of=of)
    except UndertowError as error:
        if wanted != "N":
            raise
        remedy = "a propeller with its diameter and K_T0, a curve, or thrust_per_command"
        raise UndertowError(f"{error}, or give the thruster in the vehicle file {remedy}") from error


def _with_velocities(run: Run, vehicle: Vehicle) -> Run:
    """The run with velocities; where there are none, the error has the notes of the reader of the log."""
    try:
        return velocities_from_pose(run, vehicle.degrees_of_freedom)
    except UndertowError as error:
        notes = "; ".join(run.reader_notes)
        raise UndertowError(f"{error} ({notes})" if notes else str(error)) from error


def _with_note_on_newtons(run: Run, vehicle: Vehicle) -> Run:
    """The run, with a note on commands from -1 to 1 that a vehicle expects in newtons."""
    # Commands of a table only if they reach exactly 1 and its mapping file states no unit. A thruster whose
    # limit is one newton may well be commanded by as much, and a thrust that is estimated has any unit.
    fixed = (t for t in vehicle.thrusters if t.unit == "N" and not t.thrust_per_command.estimate)
    plain = [t.name for t in fixed if run.has(t.name) and (t.limit is None or t.limit > 1.0)]
    largest = max((float(np.nanmax(np.abs(run.channels[name]), initial=0.0)) for name in plain), default=0.0)
    columns = run.mapping.columns.values() if run.mapping is not None else ()
    stated = any(column.channel in plain and column.unit for column in columns)
    is_share = 0.0 < largest <= 1.0 if run.reader_notes else largest == 1.0 and not stated
    if not plain or not is_share:
        return run
    remark = (
        f"commands {', '.join(plain)} lie between -1 and 1, but the vehicle takes them as newtons: give its "
        'thrusters thrust_per_command = { value = (newtons at 1), estimate = true } or a curve ("t200-16v")'
    )
    if not run.reader_notes:
        remark += '; if they are in newtons, write unit = "N" into the mapping file'
    return replace(run, reader_notes=(*run.reader_notes, remark))


def run_of_table(
    table: pl.DataFrame,
    path: Path,
    mapping: LogMapping,
    channels: Iterable[str] = (),
    window: Window = (None, None),
    missing_commands: CommandPolicy | None = None,
    also: Iterable[str] = (),
    origin: Origin | None = None,
    before: Commands | None = None,
) -> Run:
    """A run from the rows of a log, or of a part of it; the other arguments are those of `read_log`.

    For parts of one log, `origin` is the time in the file that counts as zero, and `before` has the last
    values of commands before the rows, which may then lack all values of a channel.
    """
    where, frames = f"log {path}", mapping.frames
    joined = joined_rows(table, mapping.time.columns)
    same = table.height - joined.height
    (table,) = decimated([joined], mapping.time.every)
    there = {c.channel for n, c in mapping.columns.items() if n in table.columns}
    there.update(mapping.channels, table.columns)
    commands = list(dict.fromkeys([*channels, *(name for name in also if name in there)]))
    policy = missing_commands or mapping.missing_commands
    sources, rows = _sources(table.columns, mapping, commands, where), table.height
    stated = {n: unit_of_cells(table, n, mapping) for n in sources}
    sources = {n: in_unit_of_cells(stated[n], n, c, where) for n, c in sources.items()}
    stated_disturbance(mapping, where)  # refuses a unit that does not fit
    lost = [*taken_as_missing(table, sources, mapping), *signed_by_letters(table)]
    table, t, notes = _time(table, mapping, where, origin)
    notes += [f"{same} rows joined with the one before, of the same time"] if same else []
    notes += lost
    with np.errstate(over="ignore", invalid="ignore"):  # what is infinite is refused by its name, below
        begins = not before
        read = {
            c.channel: _values(table, name, c, mapping, where, begins=begins) for name, c in sources.items()
        }
        for n, c in mapping.channels.items():
            cells = opening.computed(table, n, c, mapping, where, commands)
            flag = None if c.fresh is None else numbers(table, c.fresh, mapping, where)
            read[n] = _where_new(cells, flag, own=c.fresh in c.formula.columns, begins=begins)
        read |= {n: upright(read[n]) for n in ("phi", "theta") if n in read and mapping.jumps(n)}
        common = _on_rows(t, read, sources, mapping, where, before or {})
        channels = _in_ned_frd(common.channels, mapping, where)
    run = Run(
        name=name_of_log(path),
        t=common.t,
        channels=channels,
        reported=_reported(common.reported, mapping, channels),
        wrapped=_angles_in_ned_frd(common.wrapped, mapping),
        source=str(path),
        notes=(*notes, *_conversions(sources, mapping, where), *_unused(table, sources, mapping)),
        sigma=_stated_noise(sources, mapping, where),
        mapping=mapping,
        dropped=rows - table.height,
    ).slice(*window)
    whole = {n: without_jumps(run.t, data) for n, data in run.channels.items() if mapping.jumps(n)}
    jumping = {n: run.channels[n] for n, a in whole.items() if not np.array_equal(a, run.channels[n], True)}
    run = replace(run, channels={**run.channels, **whole}, wrapped={**run.wrapped, **jumping})
    slow = {turned_name(n, frames.position) for n in _slow(sources, mapping)}
    run = with_report_noise(run, slow, part=before is not None)
    columns = zip(DOFS, POSE, VELOCITY, strict=True)
    unlogged = tuple(motion for motion, *names in columns if not any(map(run.has, names)))
    run = replace(run, held=unlogged if mapping.held == "unlogged" else mapping.held)
    if common.several or policy == "hold":
        run = _between_commands(run, [*commands, *FORCES], policy, before)
    return _checked(run, [*commands, *FORCES], policy, where, before)


def _sources(names: Sequence[str], mapping: LogMapping, commands: list[str], where: str) -> dict[str, Column]:
    """The columns that are read, by name, with their channels."""
    for name in mapping.time.columns:
        opening.must_have(name, names, where, "time column")
    required = mapping.required(commands)
    for name, column in mapping.columns.items():
        if name in required:
            opening.must_have(name, names, where, f"column for channel {column.channel!r},")
        if column.fresh is not None and name in names:
            opening.must_have(column.fresh, names, where, f"column, named as `fresh` of {name!r},")
    found = {name: column for name, column in mapping.columns.items() if name in names}
    for channel in mapping.channels.values():
        for name in (*channel.formula.columns, *filter(None, [channel.fresh])):
            opening.must_have(name, names, where, f"column of expression {channel.expression!r},")
    taken = {column.channel for column in found.values()} | {*mapping.channels}
    for name in names:
        by_name = (name in UNITS or name in commands) and name not in taken and name not in mapping.ignore
        if by_name and name not in found and name != mapping.time.column:
            found[name] = Column(channel=name)
    known = [*(column.channel for column in found.values()), *mapping.channels]
    for name in commands:
        constant = f', or a constant under [channels], such as {name} = "0", for one that was never used'
        opening.must_have(name, known, where, "command channel", names, constant)
    return found


def _time(
    table: pl.DataFrame, mapping: LogMapping, where: str, origin: Origin | None
) -> tuple[pl.DataFrame, Array, list[str]]:
    """Return the rows that are used, their times and notes."""
    spec = mapping.time
    t, _, notes = opening.times_of(table, mapping, where, origin)
    if spec.disorder == "drop":
        later = later_than_before(t)
        notes += opening.disorder(t, later)
        table, t = table.filter(later), t[later]
    notes += [f"one row in {spec.every} used"] if spec.every > 1 else []
    opening.check_time(t, spec.column, where)
    return table, t, notes


def _values(
    table: pl.DataFrame, name: str, column: Column, mapping: LogMapping, where: str, *, begins: bool
) -> Array:
    """Values of a channel; `begins`: whether its first row is that of the log, with none before it."""
    scale, offset = _to_si(name, column, where)
    cells = numbers(table, name, mapping, where)
    flag = None if column.fresh is None else numbers(table, column.fresh, mapping, where)
    cells = _where_new(cells, flag, own=column.fresh == name, begins=begins)
    return column.scaled(cells, scale, offset)


def _where_new(cells: Array, flag: Array | None, *, own: bool, begins: bool) -> Array:
    """Cells of the rows with a new sample: where the flag is not zero, or, if it is their `own`, changes."""
    if flag is None:
        return cells
    there = np.isfinite(flag)
    new = there & (flag != 0)
    if own and there.any():
        new[there] = np.concatenate([[begins], np.diff(flag[there]) != 0.0])
    return np.where(new, cells, np.nan)


def _slow(sources: Mapping[str, Column], mapping: LogMapping) -> set[str]:
    """Channels of which only some rows have a new sample."""
    columns = {c.channel for c in sources.values() if c.fresh is not None}
    return columns | {n for n, c in mapping.channels.items() if c.fresh is not None}


def _on_rows(
    t: Array, read: Channels, sources: dict[str, Column], mapping: LogMapping, where: str, before: Commands
) -> OneClock:
    """The rows of a table; where it holds several series, the rows that these share."""
    late = {c.channel: si_of(f"{where}: delay of column {n!r}", c.delay, "s") for n, c in sources.items()}
    late |= {n: si_of(f"{where}: delay of channel {n!r}", c.delay, "s") for n, c in mapping.channels.items()}
    slow = _slow(sources, mapping)
    interpolated = _interpolated(sources, mapping, where)
    table = np.abs(list(read.values()))
    unreadable = np.isnan(table).all() or (table > MEASURABLE.largest).any()  # refused by name, later
    if unreadable or not (slow or any(late.values()) or are_several(t, read)):
        means = {n: interpolated_mean(t, Series.of(t, read[n], None)) for n in interpolated}
        return OneClock(t, read | means, {}, several=False)
    in_gap = {n: _in_gap_of_others(n, t, read, late) for n in read if late[n]}
    read |= {n: np.where(lost, np.nan, read[n]) for n, lost in in_gap.items()}
    noise = _stated_noise(sources, mapping, where)
    series, angles = {}, {n: without_jumps(t, column) for n, column in read.items() if mapping.jumps(n)}
    for name, column in {**read, **angles}.items():
        stated = noise.get(turned_name(name, mapping.frames.position))
        series[name] = Series.of(t - late[name], column, stated)
    common = on_one_clock(series, before, t if slow else None, interpolated)
    jumping = {n: read[n] for n, whole in angles.items() if not np.array_equal(whole, read[n], True)}
    return replace(common, wrapped={n: common.in_rows(n, column) for n, column in jumping.items()})


def _in_gap_of_others(name: str, t: Array, read: Channels, late: Mapping[str, float]) -> Flags:
    """Reports of a channel that its delay moves to where no other channel is known."""
    # Each by its own clock: the rows of a table are as close as the reports of its fastest series come.
    clocks = [t[~np.isnan(column)] - late[n] for n, column in read.items() if late[n] != late[name]]
    clocks = [clock for clock in clocks if len(clock) > 1]
    lost = ~np.isnan(read[name]) & bool(clocks)
    for clock in clocks:
        lost[lost] = in_gaps(clock, t[lost] - late[name])
    return lost


def _interpolated(sources: dict[str, Column], mapping: LogMapping, where: str) -> set[str]:
    """Channels that are interpolated between samples, as the mapping file states."""
    stated = {c.channel for c in sources.values() if c.interpolate}
    stated |= {n for n, c in mapping.channels.items() if c.interpolate}
    for name in sorted(stated & MEASURED):
        raise UndertowError(
            f"{where}: interpolate = true is for the measured position of an actuator, but {name} is a "
            "motion of the vehicle, which is never held between samples: remove it"
        )
    return stated


def _reported(found: Mapping[str, Flags], mapping: LogMapping, channels: Channels) -> dict[str, Flags]:
    """Rows with reports by the names of channels in the axes of undertow."""
    # A velocity over ground before the first heading, or after the last, says nothing of those along the
    # body.
    reported = {turned_name(n, mapping.frames.position): there for n, there in found.items()}
    linear = [n for n in VELOCITY[:3] if n in reported]
    if mapping.frames.velocity != "body" and linear:  # each is made of all three
        known = [np.isfinite(channels[n]) for n in linear]
        all_three = np.logical_and.reduce([*(reported[n] for n in linear), *known])
        reported |= {n: all_three for n in linear}
    return reported


def _between_commands(run: Run, names: Iterable[str], policy: str, before: Commands | None) -> Run:
    """The run from its first command to its last, which may be held: series begin and end at other times."""
    sensed = _sensor_quantities()
    needed = [n for n in names if run.has(n) and n not in sensed and n not in (before or {})]
    known = np.flatnonzero(np.isfinite(run.matrix(needed)).all(axis=1))
    if not len(known):
        return run
    last = -1 if policy == "hold" or before is not None else known[-1]
    begin, end = float(run.t[known[0]]), float(run.t[last])
    lost = begin - float(run.t[0]), float(run.t[-1]) - end
    note = f"{lost[0]:.3g} s at the beginning and {lost[1]:.3g} s at the end left out for lack of a command"
    return run.slice(begin, end).with_notes(*([note] if any(lost) else []))


def _to_si(name: str, column: Column, where: str) -> tuple[float, float]:
    """Return scale and offset from the cell to the channel."""
    scale, offset = 1.0, 0.0
    if column.unit is not None:
        wanted = UNITS.get(column.channel) or si_unit(column.unit)
        scale, offset = scale_offset(
            column.unit, wanted, of=f"{where}: unit {column.unit!r} of column {name!r}"
        )
    return scale * column.scale, scale * column.offset + offset


def _stated_noise(sources: dict[str, Column], mapping: LogMapping, where: str) -> dict[str, float]:
    """Standard deviations that the mapping file states, by channel."""
    found = {}
    for name, column in sources.items():
        if column.noise is not None:
            unit, given = UNITS.get(column.channel) or si_unit(column.unit or "1"), column.noise
            if isinstance(given, float):
                given = f"{given} {column.unit or unit}"
            sigma = magnitude(given, unit, f"{where}: noise of column {name!r}")
            found[turned_name(column.channel, mapping.frames.position)] = sigma
    return found


def stated_disturbance(mapping: LogMapping, where: str = "mapping file") -> dict[str, float]:
    """Disturbance, rms in N or N m, that a mapping file states, by force (X, Y, Z, K, M, N)."""
    units = dict(zip(FORCE, FORCE_UNITS, strict=True))
    return {n: magnitude(v, units[n], f"{where}: disturbance {n}") for n, v in mapping.disturbance.items()}


def _in_ned_frd(channels: Channels, mapping: LogMapping, where: str) -> Channels:
    """Bring channels from the frames of the log to NED and forward-starboard-down."""
    spec, given = mapping.frames, channels
    if spec.position == "ENU":
        channels = swap_position(channels)
    if spec.body == "FLU":
        channels = swap_body(channels)
    if _attitude(mapping) == "ENU":
        channels = swap_attitude(channels)
    if mapping.compass is not None:
        opening.must_have("psi", channels, where, "channel, which [compass] corrects,")
        turned = mapping.compass.velocities and spec.velocity == "body"
        channels = with_heading_corrected(channels, mapping.compass.coefficients, velocities=turned)
    if spec.velocity != "body":
        opening.must_have("psi", channels, where, f"channel, which velocities in {spec.velocity} need,")
        linear = {name: data for name, data in given.items() if name in VELOCITY[:3]}
        channels = velocity_to_body({**channels, **linear}, spec.velocity)
    return channels if mapping.water is None else over_ground(channels, mapping.water.velocity)


def _angles_in_ned_frd(wrapped: Channels, mapping: LogMapping) -> Channels:
    """The same for angles as logged."""
    turned = swap_attitude(wrapped) if _attitude(mapping) == "ENU" else wrapped
    if mapping.compass is None:
        return turned
    return with_heading_corrected(turned, mapping.compass.coefficients, velocities=False)


def _attitude(mapping: LogMapping) -> str:
    spec = mapping.frames
    if spec.attitude is None and (spec.position == "ENU") != (spec.body == "FLU"):
        raise UndertowError(
            f"frames: position {spec.position} with body {spec.body} does not define the angles: add "
            "attitude = "
            '"NED" (heading from north, clockwise) or attitude = "ENU" (heading from east, anticlockwise)'
        )
    return attitude_of(mapping)


def _conversions(sources: dict[str, Column], mapping: LogMapping, where: str) -> list[str]:
    changed = []
    for name, column in sources.items():
        (scale, offset), power = _to_si(name, column, where), column.power
        magnified = "" if power == 1.0 else f" |{name}|" if power == 2.0 else f" |{name}|^{power - 1.0:g}"
        if (scale, offset, power) != (1.0, 0.0, 1.0):
            added = f" + {offset:.9g}" if offset else ""
            changed.append(f"{column.channel} = {scale:.9g} {name}{magnified}{added}")
    changed += [f"{n} = {c.expression} {c.unit or ''}".rstrip() for n, c in mapping.channels.items()]
    notes = [f"converted: {', '.join(changed)}"] if changed else []
    late = {n: c.delay for n, c in mapping.channels.items()} | {c.channel: c.delay for c in sources.values()}
    delays = {n: si_of(n, delay, "s") for n, delay in late.items()}
    shifted = [f"{n} by {seconds:g} s" for n, seconds in delays.items() if seconds]
    notes += [f"delays removed: {', '.join(shifted)}"] if shifted else []
    spec = mapping.frames
    if "ENU" in (spec.position, _attitude(mapping)) or spec.body == "FLU":
        notes.append(
            f"converted to NED/FRD from position {spec.position}, attitude {_attitude(mapping)}, body "
            f"{spec.body}"
        )
    if spec.velocity != "body":
        notes.append(f"u, v, w converted to body axes from {spec.velocity}")
    if mapping.compass is not None:
        a, b, c = np.degrees(mapping.compass.coefficients)
        notes.append(f"deviation of the compass, {a:.3g} + {b:.3g} sin psi + {c:.3g} cos psi deg, added")
    if mapping.water is not None:
        text = ", ".join(f"{speed:g}" for speed in mapping.water.velocity)
        notes.append(f"velocity of the water, {text} m/s north, east, down, added to u, v, w")
    return notes


def _unused(table: pl.DataFrame, sources: dict[str, Column], mapping: LogMapping) -> list[str]:
    names, letters = table.columns, letters_beside(table).values()
    used = {*sources, *letters, *mapping.ignore, *mapping.time.columns, *mapping.flags}
    used.update(n for channel in mapping.channels.values() for n in channel.formula.columns)
    left = [name or f"(column {k} has no name)" for k, name in enumerate(names, 1) if name not in used]
    return [f"columns not used: {', '.join(left)}"] if left else []


def _sensor_quantities() -> set[str]:
    """Names of inputs that a sensor reports."""
    return {*logged_quantities(catalogue()), *MOTION_UNITS}


def _checked(
    run: Run, commands: Iterable[str], policy: str, where: str, before: Commands | None = None
) -> Run:
    if len(run.t) < 2:
        raise UndertowError(f"{where} has one sample in the time window, at least 2 are needed: widen it")
    if before is not None:
        where = f"{where}, part from t = {run.t[0]:g} to {run.t[-1]:g} s"
    check = opening.check_channel if before is None else opening.check_finite
    for name, data in run.channels.items():
        check(name, run.t, data, where)
    notes, filled, known = [], dict(run.channels), before or {}
    sensed = _sensor_quantities()
    for name in commands:
        if run.has(name):
            data, rule, earlier = filled[name], policy, known.get(name, np.nan)
            if name in sensed:  # the first report of a slow sensor holds from the start
                first = data[np.isfinite(data)][:1]
                rule, earlier = "hold", known.get(name, float(first.sum()) if first.size else np.nan)
            filled[name], note = opening.fill_commands(name, run.t, data, rule, where, earlier)
            notes += [note] if note else []
    constant = opening.constant_channels(run)
    if constant:
        text = ", ".join(f"{name} = {value:g}" for name, value in constant.items())
        notes.append(f"constant channels (unused, or a dead sensor): {text}")
    return replace(run, channels=filled).with_notes(*notes)


# --- decimation that keeps the reports of slow sensors --------------------------------------------
def decimated(tables: Iterable[pl.DataFrame], every: int) -> Iterator[pl.DataFrame]:
    """Every n-th row of consecutive tables, n = `every`."""
    # In a table of sensors with clocks of their own, rare reports would be lost with the other rows, and a
    # command would be held beyond its next one. So another row is kept if it has a report of a column of
    # which none was kept for n rows.
    before, last = 0, dict[str, int]()
    for table in tables:
        place = before + np.arange(table.height)
        kept = place % every == 0
        for name in table.columns:
            cells = table[name]
            there = cells.is_not_null()
            if cells.dtype.is_float():
                there &= cells.is_not_nan().fill_null(value=False)
            reports = place[there.to_numpy()]
            late = _overdue(reports, every, last.get(name, -every))
            kept[late - before] = True
            last[name] = max((last.get(name, -every), *late[-1:], *reports[reports % every == 0][-1:]))
        yield table.filter(kept)
        before += table.height


def _overdue(reports: Index, every: int, last: int) -> Index:
    """Reports that come at least `every` rows after the last that is kept."""
    regular = np.where(reports % every == 0, reports, last)
    since = np.maximum.accumulate(regular) if len(regular) else regular
    between = reports - since >= every
    found: list[int] = []
    for report, regularly in zip(reports[between], since[between], strict=True):
        if report - max((regularly, *found[-1:])) >= every:
            found.append(int(report))
    return np.array(found, dtype=np.intp)
