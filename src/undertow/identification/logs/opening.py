"""A log file: its table, the meaning of its columns, and checks before use."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np
import polars as pl
from numpy.typing import NDArray

from undertow.errors import UndertowError, listed, nearest
from undertow.files import together, write_whole
from undertow.model.tables import TURNS
from undertow.model.units import scale_offset, si_unit
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .formats.fieldlog import FieldLog, Window, open_field_log, readable
from .mapping import Channel, Column, Held, LogMapping, mapping_text, name_of_log, place_beside, turned_name
from .run import MEASURABLE, SERIES, UNITS, Run, held_together, last_known, shared_rows
from .table import (
    WHOLE,
    LogLimits,
    NotTextError,
    Origin,
    elapsed,
    file_bytes,
    in_unit_of_cells,
    is_dates,
    lacking_zeros,
    numbers,
    read_table,
    seconds,
    with_even_times,
)

# --- checks before anything is computed from a log ------------------------------------------------


def check_time(t: Array, column: str, where: str) -> None:
    """Refuse times that are missing, infinite, too few, doubled or out of order."""
    thing = f"{where}: time column {column!r}"
    if len(t) < 2:
        found = "no sample" if len(t) == 0 else f"one sample (t = {t[0]:g} s)"
        raise UndertowError(f"{where} has {found}, at least 2 are needed: check that the log is complete")
    bad = np.flatnonzero(~np.isfinite(t))
    if len(bad):
        value = "missing" if np.isnan(t[bad[0]]) else "infinite"
        raise UndertowError(
            f"{thing} is {value} in {len(bad)} of {len(t)} rows, first in row {bad[0] + 1}: remove them"
        )
    late = np.flatnonzero(np.abs(t) > MEASURABLE.largest)
    if len(late):
        raise UndertowError(
            f"{thing} is {t[late[0]]:g} s in row {late[0] + 1}, beyond {MEASURABLE.largest:g} s: check its "
            "unit and offset in the mapping file"
        )
    step = np.diff(t)
    back, same = np.flatnonzero(step < 0), np.flatnonzero(step == 0)
    if len(back):
        at = back[0]
        raise UndertowError(
            f"{thing} goes back from {t[at]:.9g} to {t[at + 1]:.9g} s at row {at + 2} ({len(back)} times in "
            "all): "
            "sort the file by time, or split it where the clock was restarted"
        )
    if len(same):
        at = same[0]
        raise UndertowError(
            f"{thing} has {len(same)} duplicate stamps, first {t[at]:.9g} s at row {at + 2}: keep one row "
            "per time, or state `interval` under [time] in the mapping file if the rows are evenly spaced"
        )


def disorder(t: Array, later: NDArray[np.bool_]) -> list[str]:
    """One note on rows that are not in order, none where all are."""
    at = np.flatnonzero(~later)
    if not len(at):
        return []
    return [
        f"{len(at)} rows left out, not later than an earlier row: first t = {t[at[0]]:.9g} s, row {at[0] + 1}"
    ]


def check_channel(name: str, t: Array, data: Array, where: str) -> None:
    """Refuse a channel with an infinite value or without any value."""
    check_finite(name, t, data, where)
    if np.isnan(data).all():
        raise UndertowError(empty(name, len(data), where))


def check_finite(name: str, t: Array, data: Array, where: str) -> None:
    """Refuse a channel with an infinite value, or one that no sensor of any unit reports."""
    infinite = np.flatnonzero(np.isinf(data))
    if len(infinite):
        raise UndertowError(
            f"{where}: channel {name!r} is infinite in {len(infinite)} of {len(data)} samples, first at t = "
            f"{t[infinite[0]]:g} s: leave such cells empty, or name the value under `missing` in a mapping "
            "file"
        )
    beyond = np.flatnonzero(np.abs(data) > MEASURABLE.largest)
    if len(beyond):
        raise UndertowError(
            f"{where}: channel {name!r} is {data[beyond[0]]:g} at t = {t[beyond[0]]:g} s and beyond "
            f"{MEASURABLE.largest:g} in {len(beyond)} of {len(data)} samples, which is impossible: name the "
            "value under `missing` in a mapping file, or correct unit, scale and power there"
        )


def empty(name: str, samples: int, where: str) -> str:
    """The message on a channel without any value."""
    return (
        f"{where}: channel {name!r} has no value in any of {samples} samples: remove the column, or name it "
        "under `ignore` in a mapping file"
    )


def fill_commands(
    name: str, t: Array, data: Array, policy: str, where: str, before: float = np.nan
) -> tuple[Array, str]:
    """Fill missing samples of a command; return the command and a note, empty where none was missing.

    The policy is "refuse", "hold" (the last value is held; before the first sample it is `before`) or "gap"
    (left missing).
    """
    missing = np.flatnonzero(np.isnan(data))
    if not len(missing):
        return data, ""
    spell = f"t = {t[missing[0]]:g} to {t[missing[-1]]:g} s"
    text = f"command {name!r} is missing in {len(missing)} of {len(t)} rows ({spell})"
    remedy = (
        'set missing_commands = "hold" or "gap" in the mapping file, or take a part of the log without them '
        "(--from, --to)"
    )
    if policy == "refuse":
        raise UndertowError(f"{where}: {text}: {remedy}")
    if policy == "gap":
        return data, f"{text}; left missing"
    data = np.concatenate([[before if np.isnan(data[0]) else data[0]], data[1:]])
    held = last_known(data)
    if np.isnan(held[0]):
        raise UndertowError(
            f"{where}: {text}, and there is none before t = {t[0]:g} s to hold: begin later (--from)"
        )
    return held, f"{text}; the last value was held"


def constant_channels(run: Run, names: Iterable[str] | None = None) -> dict[str, float]:
    """Return the channels (of `names`, or all) that never change, with their value."""
    asked = run.channels if names is None else {name: run.channels[name] for name in names if run.has(name)}
    present = {name: data[np.isfinite(data)] for name, data in asked.items()}
    return {name: float(data[0]) for name, data in present.items() if len(data) > 1 and np.ptp(data) == 0}


def refuse_constant(run: Run, names: Iterable[str]) -> None:
    """Refuse a run in which one of the channels never changes."""
    dead = constant_channels(run, names)
    if dead:
        text = ", ".join(f"{name} = {value:g}" for name, value in dead.items())
        raise UndertowError(
            f"run {run.name!r}: {text} over all {len(run.t)} samples (dead sensor, or motion not excited): "
            "leave the channel out of the log, or the degree of freedom out of the vehicle"
        )


def refuse_duplicates(runs: Iterable[Run]) -> None:
    """Refuse duplicate data: they would be validated on training data, or count twice."""
    seen: dict[tuple[str, float], str] = {}
    for run in runs:
        what = run.sha256, float(run.t[0])  # several segments of a log are not the same data
        if run.sha256 and what in seen:
            raise UndertowError(
                f"logs {seen[what]} and {run.source} have the same content: give each only once, for "
                "fitting or for validation"
            )
        seen[what] = run.source


def refuse_too_many(samples: int, log: str | Path) -> None:
    """Refuse more samples than a fit takes; `log` is the one with which they are too many."""
    if samples > MEASURABLE.samples:
        raise UndertowError(
            f"log {log}: with it there are {samples} samples, a fit takes at most {MEASURABLE.samples}: take "
            "a part of the logs with --from and --to, or decimate them (10 to 20 samples per second are "
            "enough)"
        )


def refuse_other_speeds(run: Run, vehicle: Vehicle) -> None:
    """Refuse speeds of propellers that were read in rad/s where the vehicle counts them otherwise."""
    counted = {t.name: t.unit for t in vehicle.thrusters if t.unit in TURNS and t.unit != "rad/s"}
    mapping = run.mapping or LogMapping()
    stated = [(name, column.channel, column.unit) for name, column in mapping.columns.items()]
    stated += [(name, name, formula.unit) for name, formula in mapping.channels.items()]
    for name, command, unit in stated:
        if command in counted and unit is not None:
            raise UndertowError(
                f"log {run.source or run.name}: column {name!r} was read in rad/s, since its mapping states "
                f"the unit {unit!r}, and the vehicle counts command {command!r} in "
                f"{counted[command]}: give read_log the vehicle (vehicle=...), or write a scale in place of "
                "the unit into the mapping"
            )


def check_fit(runs: Sequence[Run], validation: Sequence[Run], vehicle: Vehicle) -> None:
    """Refuse logs that cannot be fitted: given twice, too long, with a velocity that never changes."""
    # A fit to such a velocity would make the vehicle heavy or its motion stiff.
    total = 0
    for run in (*runs, *validation):
        total += len(run.t)
        refuse_too_many(total, run.source or run.name)
        refuse_other_speeds(run, vehicle)
    refuse_duplicates([*runs, *validation])
    dead = [constant_channels(run, vehicle.velocity_names) for run in runs]
    if dead:
        refuse_constant(runs[0], [name for name in dead[0] if all(name in found for found in dead)])


def with_distinct_names(runs: list[Run]) -> list[Run]:
    """Runs with distinct names: ending or folder are added where file names are the same."""
    count = Counter(run.name for run in runs)
    ended = Counter((run.name, _ending(run)) for run in runs)

    def longer_name(run: Run) -> Run:
        if ended[run.name, _ending(run)] == 1:
            return replace(run, name=f"{run.name} ({_ending(run)})")
        return replace(run, name=f"{Path(run.source).resolve().parent.name}/{run.name}")

    longer = [longer_name(run) if count[run.name] > 1 else run for run in runs]
    again = Counter(run.name for run in longer)
    return [
        replace(r, name=f"{r.name} ({i})") if again[r.name] > 1 else r for i, r in enumerate(longer, start=1)
    ]


def _ending(run: Run) -> str:
    path = Path(run.source)
    return path.name.removeprefix(name_of_log(path))


# --- opening --------------------------------------------------------------------------------------
FieldLogs = dict[Path, FieldLog]
"""Vehicles' own logs that were opened already, by path: opening one twice takes twice as long."""


@dataclass(frozen=True)
class Opened:
    """Rows of a log, and their mapping."""

    table: pl.DataFrame  # a row for every time; of a vehicle's own log the columns that are read
    mapping: LogMapping  # the one that was given, or that of the format of the log
    sha256: str  # of the bytes of the file
    notes: tuple[str, ...] = ()  # of the reader of a vehicle's own log, its format first; empty for a table


def field_log(path: Path, mapping: LogMapping | None, known: FieldLogs | None = None) -> FieldLog | None:
    """A log as its vehicle wrote it; None for a table. A log that is opened is added to `known`."""
    if known is not None and path in known:
        return known[path]
    log = open_field_log(path, mapping.messages if mapping else None)
    if log is not None and known is not None:
        known[path] = log
    return log


def opened_field_log(
    log: FieldLog,
    mapping: LogMapping | None,
    commands: Sequence[str],
    also: Sequence[str] = (),
    window: Window = (None, None),
) -> Opened:
    """The table of a vehicle's own log, by a mapping or by that of its format.

    It must have the `commands`; those in `also` are read where it has them. The window is in s of the run's
    clock.
    """
    meaning = mapping or log.mapping_for([*commands, *also])
    if meaning.time.interval is not None:
        raise UndertowError(
            f"log {log.path} is a vehicle log with its own clock: remove interval = "
            f"{meaning.time.interval!r} from [time] in the mapping file"
        )
    if mapping is None:
        _refuse_unmatched_motors(log, meaning, commands)
    low, high = (None if edge is None else edge - meaning.time.offset for edge in window)
    stated, where = log.units if log.by_name else {}, f"log {log.path}"
    columns = {n: in_unit_of_cells(stated.get(n, ""), n, c, where) for n, c in meaning.columns.items()}
    meaning = meaning.model_copy(update={"columns": columns})
    required = meaning.required(commands)
    there = {name: column for name, column in meaning.columns.items() if name in required or log.has(name)}
    table = log.table(columns_read(meaning.model_copy(update={"columns": there})), (low, high))
    asked = () if mapping else (*log.remarks, *_by_number(log, meaning, [*commands, *also]))
    notes = (f"read as {log.format}", *log.notes, *asked)
    return Opened(table, meaning, log.sha256, notes)


def opened_table(path: Path, mapping: LogMapping | None, limits: LogLimits = WHOLE) -> Opened:
    """A CSV, CSV.gz or Parquet file as a whole; one that is larger than the limits is refused unread."""
    meaning, data = mapping or LogMapping(), file_bytes(path, limits)
    try:
        table = read_table(data, meaning, f"log {path}", path, limits)
    except NotTextError as error:
        raise UndertowError(f"{error}; {readable()}") from error
    return Opened(with_even_times(table, meaning), meaning, hashlib.sha256(data).hexdigest())


def _refuse_unmatched_motors(log: FieldLog, meaning: LogMapping, commands: Iterable[str]) -> None:
    """Refuse a log whose motors cannot be the commands of a vehicle."""
    known = {*(column.channel for column in meaning.columns.values())}
    lacking = [name for name in commands if name not in known]
    if lacking:
        motors = f"{len(log.actuators)} motors ({', '.join(n for n, _ in log.actuators)})"
        why = f" ({'; '.join(log.notes)})" if log.notes else ""
        unknown = f"no recognised motors{why}"
        raise UndertowError(
            f"log {log.path} has {motors if log.actuators else unknown}, but the vehicle has commands "
            f"{', '.join(lacking)}: undertow map new {log.path} --vehicle VEHICLE writes a mapping file that "
            "assigns them, or asks which columns they are"
        )


def _by_number(log: FieldLog, meaning: LogMapping, commands: Sequence[str]) -> list[str]:
    """A question on commands that are columns of a log whose numbers alone say which; none where names do."""
    motors = dict(log.actuators) if log.by_name else {}
    taken = {n: c.channel for n, c in meaning.columns.items() if n in motors and c.channel in commands}
    taken = {n: command for n, command in taken.items() if command not in n.split(".")}
    asked = (
        f"{', '.join(taken)} are taken for {', '.join(taken.values())} by their numbers alone: are they, in "
    )
    asked += f"this order? undertow map new {log.path} --vehicle VEHICLE writes a mapping file for other ones"
    return [asked] if taken else []


def is_dated(table: pl.DataFrame, mapping: LogMapping) -> bool:
    """Whether times are dates, or durations of their own type."""
    return mapping.time.unit == "iso" or is_dates(table, mapping.time.column)


def times_of(
    table: pl.DataFrame, mapping: LogMapping, where: str, origin: Origin | None = None
) -> tuple[Array, Origin, list[str]]:
    """Times of all rows, s, the time in the file that counts as zero, and notes on it."""
    spec = mapping.time
    if is_dated(table, mapping):
        t, first, origin = seconds(table, spec.column, where, origin)
        notes = [f"time starts at {first}"] if first else []
        return t + spec.offset, origin, [*notes, *lacking_zeros(table, spec.column)]
    scale, offset = scale_offset(spec.unit, "s", of=f"time unit {spec.unit!r}")
    since, origin = elapsed(table, mapping, scale, where, origin)
    start = f"{origin:.17g}" if isinstance(origin, float) else f"{origin:f}".rstrip("0").rstrip(".")
    notes = [f"time starts at the first sample, {start} {spec.unit} in the file"] if origin else []
    notes += [f"rows taken as {spec.spacing:g} s apart, as stated"] if spec.interval is not None else []
    return scale * since + offset + spec.offset, origin, notes


def segments_in(table: pl.DataFrame, column: str | None, where: str) -> list[pl.DataFrame]:
    """The segments of a table that are numbered in a column, in the order of time; all of it without one."""
    if column is None:
        return [table]
    must_have(column, table.columns, where, "column of segments,")
    parts = table.filter(pl.col(column).is_not_null()).partition_by(
        column, maintain_order=True, include_key=False
    )
    if not parts:
        raise UndertowError(no_segment(column, where))
    return parts


def no_segment(column: str, where: str) -> str:
    """The message on a log none of whose rows is in a segment."""
    return (
        f"{where}: no row has a number in column {column!r}, so nothing is left: remove `stretch` "
        "from [time] in the mapping file to use all of it"
    )


def dropping_disorder(mapping: LogMapping) -> LogMapping:
    """The mapping with which rows are left out whose time is not later than that of all before."""
    return mapping.model_copy(update={"time": mapping.time.model_copy(update={"disorder": "drop"})})


def columns_read(mapping: LogMapping) -> list[str]:
    """Columns of a log that a mapping reads, without those of its clock."""
    formulas = [name for channel in mapping.channels.values() for name in channel.formula.columns]
    return list(dict.fromkeys([*mapping.columns, *mapping.flags, *formulas]))


def must_have(
    name: str,
    names: Iterable[str],
    where: str,
    what: str,
    columns: Sequence[str] | None = None,
    instead: str = "",
) -> None:
    """Refuse a table without a column, with those that it has."""
    names = list(names)
    if name not in names:
        # A separator at the end of every line makes a column without a name.
        have = list(filter(None, names if columns is None else columns))
        hint, remedy = nearest(name, have), "; name the right one in a mapping file"
        if len(have) == 1 and (other := next((sign for sign in ";\t|" if sign in have[0]), "")):
            remedy = f" (one column: set delimiter = {other!r} in a mapping file)"
        raise UndertowError(
            f"{where} has no {what} {name!r}{hint}: its columns are {', '.join(have)}{remedy}{instead}"
        )


# --- saving --------------------------------------------------------------------------------------------
def save_log(run: Run, out: Path) -> Path | None:
    """Write a run as CSV with the channel names and SI units of undertow; the path of its mapping file.

    Of a channel that does not report in every row only the reports are written, and channels derived from
    others are left out, as they are derived again when the file is read. Stated noise of sensors and
    disturbance go into a mapping file of the same name next to it.
    """
    measured = {name: run.reports(name) for name in run.channels if name not in run.derived}
    table = pl.DataFrame({"t": run.t, **measured}).fill_nan(None)
    stated, beside = _stated_mapping(run), place_beside(out)
    with together():
        write_whole(out, table.write_csv())
        if stated is not None:
            write_whole(beside, mapping_text(stated))
    return beside if stated is not None else None


def stated_noise(run: Run) -> set[str]:
    """Channels whose noise was stated: that of slow ones is estimated where it is not."""
    if run.mapping is None:
        return set(run.sigma)
    stated = (c.channel for c in run.mapping.columns.values() if c.noise is not None)
    return {turned_name(channel, run.mapping.frames.position) for channel in stated}


def _stated_mapping(run: Run) -> LogMapping | None:
    """The mapping with the stated noise, disturbance and rig of a run; None where none is stated."""
    given, named = run.mapping or LogMapping(), stated_noise(run)
    noise = {name: sigma for name, sigma in run.sigma.items() if name in named and run.has(name)}
    if not (noise or given.disturbance or run.held):
        return None
    columns = {name: Column(channel=name, noise=sigma, optional=True) for name, sigma in noise.items()}
    held = cast("Held", run.held)
    return LogMapping(columns=columns, disturbance=given.disturbance, held=held)


def computed(
    table: pl.DataFrame, name: str, channel: Channel, mapping: LogMapping, where: str, commands: Sequence[str]
) -> Array:
    """Values of a channel that is a formula in columns; commands of two clocks are held until they change."""
    formula = channel.formula
    cells = {n: numbers(table, n, mapping, where) for n in formula.columns}
    shared = shared_rows(cells)
    if name in commands and shared < SERIES.shared:
        cells = held_together(cells)
    elif not shared:
        raise UndertowError(
            f"{where}: the columns of channel {name!r}, {listed([*cells])}, have no row in common: write "
            "them into the same rows"
        )
    values = formula.of(cells)
    scale, offset = 1.0, 0.0
    if channel.unit is not None:
        wanted = UNITS.get(name) or si_unit(channel.unit)
        scale, offset = scale_offset(channel.unit, wanted, of=f"{where}: unit of channel {name!r}")
    shape = np.full(table.height, 1.0)  # a formula without columns is the same in every row
    return scale * values * shape + offset
