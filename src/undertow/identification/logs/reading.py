"""From a file to a run: columns to channels, units and frames to the inside conventions, checks."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from undertow.errors import UndertowError, nearest
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
    elapsed,
    file_bytes,
    is_dates,
    numbers,
    read_table,
    seconds,
)
from undertow.model.catalogue import catalogue, logged_quantities
from undertow.model.symbols import FORCE, FORCE_UNITS, MOTION_UNITS, VELOCITY
from undertow.model.units import magnitude, scale_offset, si_unit
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Progress

from . import checks
from .mapping import Channel, Column, CommandPolicy, LogMapping
from .pose_velocity import velocities_from_pose
from .run import FORCES, UNITS, Run, unwrapped

if TYPE_CHECKING:
    import polars as pl


from math import comb

Commands = dict[str, float]


def read_log(
    path: str | Path,
    mapping: LogMapping | None = None,
    channels: Iterable[str] = (),
    *,
    window: tuple[float | None, float | None] = (None, None),
    missing_commands: CommandPolicy | None = None,
    also: Iterable[str] = (),
    limits: LogLimits = WHOLE,
) -> Run:
    """Read a log: in SI, NED and forward-starboard-down axes; gaps are NaN and nothing is interpolated.

    `channels` are commands that must be in the log, `also` those that are read where it has them. Without a
    mapping, columns must have the channel names and SI units of undertow. The window, in s, is on the clock
    of the run (None: no limit). What is larger than the limits is refused before it is held in memory.
    """
    path, mapping = Path(path), mapping or LogMapping()
    data = file_bytes(path, limits)
    table = read_table(data, mapping, f"log {path}", path, limits)
    run = run_of_table(table, path, mapping, channels, window, missing_commands, also)
    return replace(run, sha256=hashlib.sha256(data).hexdigest())


def read_logs(
    paths: Sequence[Path],
    vehicle: Vehicle,
    mapping: LogMapping,
    *,
    window: tuple[float | None, float | None] = (None, None),
    missing_commands: CommandPolicy | None = None,
    to_fit: bool = False,
    one_motion: bool = False,
    progress: Progress = lambda done, words: None,
) -> list[Run]:
    """Read the logs of a vehicle, each with a name of its own, and with velocities, if need be from its pose.

    Parameters
    ----------
    paths : sequence of Path
        CSV, CSV.gz or Parquet files.
    vehicle : Vehicle
        The model, whose commands the logs must have.
    mapping, window, missing_commands
        As for `read_log`.
    to_fit : bool
        Refuse more samples than a fit takes as soon as they are read.
    one_motion : bool
        Whether a log may hold some of the motions and commands only, as one of a towing tank does.
    progress : callable
        Told how many logs are read.

    Raises
    ------
    UndertowError
        If a file cannot be read or does not fit the vehicle, or a log is given twice.
    """
    needed, also = ((), vehicle.command_names) if one_motion else (vehicle.command_names, ())
    limits = WHOLE
    if to_fit and window == (None, None) and mapping.time.disorder != "drop":
        most = checks.MEASURABLE
        limits = replace(WHOLE, rows=most.rows_per_sample * mapping.time.every * most.samples)
    runs: list[Run] = []
    for done, path in enumerate(paths):
        progress(done, f"reading {path.name}")
        run = read_log(
            path, mapping, needed, also=also, window=window, missing_commands=missing_commands, limits=limits
        )
        if to_fit:
            checks.refuse_too_many(sum(len(r.t) for r in (*runs, run)), path)
        runs.append(run if one_motion else velocities_from_pose(run, vehicle.degrees_of_freedom))
    checks.refuse_twins(runs)
    return checks.with_distinct_names(runs)


def run_of_table(
    table: pl.DataFrame,
    path: Path,
    mapping: LogMapping,
    channels: Iterable[str] = (),
    window: tuple[float | None, float | None] = (None, None),
    missing_commands: CommandPolicy | None = None,
    also: Iterable[str] = (),
    origin: Origin | None = None,
    before: Commands | None = None,
) -> Run:
    """A run from the rows of a log, or of a part of it; the other arguments are those of `read_log`.

    For parts of one log, `origin` is the time in the file that counts as zero, and `before` has the last
    values of commands before the rows, which may then lack all values of a channel.
    """
    where = f"log {path}"
    table = table.gather_every(mapping.time.every)
    there = {c.channel for n, c in mapping.columns.items() if n in table.columns}
    there |= {*mapping.channels, *table.columns}
    commands = list(dict.fromkeys([*channels, *(name for name in also if name in there)]))
    sources, rows = _sources(table.columns, mapping, commands, where), table.height
    stated_disturbance(mapping, where)  # refuses a unit that does not fit
    table, t, notes = _time(table, mapping, where, origin)
    with np.errstate(over="ignore", invalid="ignore"):  # what is infinite is refused by its name, below
        begins = not before
        read = {
            c.channel: _values(table, name, c, mapping, where, begins=begins) for name, c in sources.items()
        }
        read |= {name: _computed(table, name, c, mapping, where) for name, c in mapping.channels.items()}
        channels = _turned(read, mapping, where)
    run = Run(
        name=path.name.split(".")[0],
        t=t,
        channels=channels,
        source=str(path),
        notes=(*notes, *_conversions(sources, mapping, where), *_unused(table.columns, sources, mapping)),
        sigma=_stated_noise(sources, mapping, where),
        mapping=mapping,
        dropped=rows - table.height,
    ).slice(*window)
    run = _unwrapped(run, list(sources.values()))
    slow = [column.channel for column in sources.values() if column.fresh is not None]
    run = on_the_clock(run, [turned_name(name, mapping.frames.position) for name in slow], before is not None)
    return _checked(run, [*commands, *FORCES], missing_commands or mapping.missing_commands, where, before)


def _sources(names: Sequence[str], mapping: LogMapping, commands: list[str], where: str) -> dict[str, Column]:
    """Say which columns are read, as what."""
    must_have(mapping.time.column, names, where, "time column")
    for name, column in mapping.columns.items():
        if not column.optional or column.channel in commands:
            must_have(name, names, where, f"column for channel {column.channel!r},")
        if column.fresh is not None and name in names:
            must_have(column.fresh, names, where, f"column, named as `fresh` of {name!r},")
    found = {name: column for name, column in mapping.columns.items() if name in names}
    for channel in mapping.channels.values():
        for name in channel.formula.columns:
            must_have(name, names, where, f"column of expression {channel.expression!r},")
    taken = {column.channel for column in found.values()} | {*mapping.channels}
    for name in names:
        by_name = (name in UNITS or name in commands) and name not in taken and name not in mapping.ignore
        if by_name and name not in found and name != mapping.time.column:
            found[name] = Column(channel=name)
    known = [*(column.channel for column in found.values()), *mapping.channels]
    for name in commands:
        must_have(name, known, where, "command channel", names)
    return found


def must_have(
    name: str, names: Iterable[str], where: str, what: str, columns: Sequence[str] | None = None
) -> None:
    """Refuse a table without a column, with those that it has."""
    names = list(names)
    if name not in names:
        have = list(names if columns is None else columns)
        hint = nearest(name, have)
        more = _delimiter_hint(have)
        raise UndertowError(f"{where} has no {what} {name!r}{hint}: its columns are {', '.join(have)}{more}")


def _delimiter_hint(columns: Sequence[str]) -> str:
    other = next((sign for sign in ";\t|" if len(columns) == 1 and sign in columns[0]), None)
    return (
        f" (one column: set delimiter = {other!r} in a mapping file)"
        if other
        else "; say in a mapping file which is meant"
    )


def _time(
    table: pl.DataFrame, mapping: LogMapping, where: str, origin: Origin | None
) -> tuple[pl.DataFrame, Array, list[str]]:
    """Return the rows that are used, their times and notes."""
    spec, notes = mapping.time, []
    if spec.unit == "iso" or is_dates(table, spec.column):
        t, first, _ = seconds(table, spec.column, where, origin)
        notes += [f"time counts from {first}"] if first else []
    else:
        scale, offset = scale_offset(spec.unit, "s", of=f"time unit {spec.unit!r}")
        since, start = elapsed(table, mapping, scale, where, origin)
        t = scale * since + offset
        notes += (
            [f"time counts from the first sample, {_shown(start)} {spec.unit} in the file"] if start else []
        )
    t = t + spec.offset
    if spec.disorder == "drop":
        later = checks.in_order(t)
        notes += checks.disorder(t, later)
        table, t = table.filter(later), t[later]
    notes += [f"one row in {spec.every} used"] if spec.every > 1 else []
    checks.check_time(t, spec.column, where)
    return table, t, notes


def _shown(number: Origin) -> str:
    return f"{number:.17g}" if isinstance(number, float) else f"{number:f}".rstrip("0").rstrip(".")


def _values(
    table: pl.DataFrame, name: str, column: Column, mapping: LogMapping, where: str, *, begins: bool
) -> Array:
    """Values of a channel; `begins`: whether its first row is that of the log, with none before it."""
    scale, offset = _to_si(name, column, where)
    cells = numbers(table, name, mapping, where)
    if column.power != 1.0:
        cells = np.sign(cells) * np.abs(cells) ** column.power
    if column.fresh is not None:
        if column.fresh == name:  # a value that differs from that of the row before is new
            new = np.concatenate([[begins], cells[1:] != cells[:-1]])
        else:
            flag = numbers(table, column.fresh, mapping, where)
            new = np.isfinite(flag) & (flag != 0)
        cells = np.where(new, cells, np.nan)
    return scale * cells + offset


def _computed(table: pl.DataFrame, name: str, channel: Channel, mapping: LogMapping, where: str) -> Array:
    """Values of a channel that is a formula in columns."""
    formula = channel.formula
    values = formula.of({n: numbers(table, n, mapping, where) for n in formula.columns})
    scale, offset = 1.0, 0.0
    if channel.unit is not None:
        wanted = UNITS.get(name) or si_unit(channel.unit)
        scale, offset = scale_offset(channel.unit, wanted, of=f"{where}: unit of channel {name!r}")
    shape = np.full(table.height, 1.0)  # a formula without columns is the same in every row
    return scale * values * shape + offset


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
            unit = UNITS.get(column.channel) or si_unit(column.unit or "1")
            given = (
                f"{column.noise} {column.unit or unit}" if isinstance(column.noise, float) else column.noise
            )
            sigma = magnitude(given, unit, f"{where}: noise of column {name!r}")
            found[turned_name(column.channel, mapping.frames.position)] = sigma
    return found


def stated_disturbance(mapping: LogMapping, where: str = "mapping file") -> dict[str, float]:
    """Disturbance, rms in N or N m, that a mapping file states, by force (X, Y, Z, K, M, N)."""
    units = dict(zip(FORCE, FORCE_UNITS, strict=True))
    return {n: magnitude(v, units[n], f"{where}: disturbance {n}") for n, v in mapping.disturbance.items()}


def _turned(channels: Channels, mapping: LogMapping, where: str) -> Channels:
    """Bring channels from the frames of the log to NED and forward-starboard-down."""
    spec, given = mapping.frames, channels
    if spec.position == "ENU":
        channels = swap_position(channels)
    if spec.body == "FLU":
        channels = swap_body(channels)
    if _attitude(mapping) == "ENU":
        channels = swap_attitude(channels)
    if spec.velocity != "body":
        must_have("psi", channels, where, f"channel, which velocities in {spec.velocity} need,")
        linear = {name: data for name, data in given.items() if name in VELOCITY[:3]}
        channels = velocity_to_body({**channels, **linear}, spec.velocity)
    return channels if mapping.water is None else over_ground(channels, mapping.water.velocity)


def _attitude(mapping: LogMapping) -> str:
    spec = mapping.frames
    if spec.attitude is None and (spec.position == "ENU") != (spec.body == "FLU"):
        raise UndertowError(
            f"frames: position {spec.position} with body {spec.body} does not say how angles count: add "
            "attitude = "
            '"NED" (heading from north, clockwise) or attitude = "ENU" (heading from east, anticlockwise)'
        )
    return spec.attitude or spec.position


def _unwrapped(run: Run, columns: Iterable[Column]) -> Run:
    asked = {column.channel: column.wrapped for column in columns}
    angles = [
        name for name in run.channels if asked.get(name) or (name == "psi" and asked.get(name) is not False)
    ]
    whole = {name: unwrapped(run.channels[name]) for name in angles}
    jumping = {n: run.channels[n] for n, a in whole.items() if not np.array_equal(a, run.channels[n], True)}
    return replace(run, channels={**run.channels, **whole}, wrapped=jumping)


def _conversions(sources: dict[str, Column], mapping: LogMapping, where: str) -> list[str]:
    factors = {name: _to_si(name, column, where) for name, column in sources.items()}
    changed = [
        f"{sources[name].channel} = {scale:.9g} {_term(name, sources[name].power)}"
        + (f" + {offset:.9g}" if offset else "")
        for name, (scale, offset) in factors.items()
        if (scale, offset, sources[name].power) != (1.0, 0.0, 1.0)
    ]
    changed += [f"{n} = {c.expression} {c.unit or ''}".rstrip() for n, c in mapping.channels.items()]
    notes = [f"converted: {', '.join(changed)}"] if changed else []
    spec = mapping.frames
    if "ENU" in (spec.position, _attitude(mapping)) or spec.body == "FLU":
        notes.append(
            f"turned to NED/FRD from position {spec.position}, attitude {_attitude(mapping)}, body "
            f"{spec.body}"
        )
    if spec.velocity != "body":
        notes.append(f"u, v, w turned to body axes from {spec.velocity}")
    if mapping.water is not None:
        text = ", ".join(f"{speed:g}" for speed in mapping.water.velocity)
        notes.append(f"velocity of the water, {text} m/s north, east, down, added to u, v, w")
    return notes


def _term(name: str, power: float) -> str:
    return name if power == 1.0 else f"{name} |{name}|" + ("" if power == 2.0 else f"^{power - 1.0:g}")


def _unused(names: Sequence[str], sources: dict[str, Column], mapping: LogMapping) -> list[str]:
    flags = {column.fresh for column in sources.values()}
    used = {*sources, *mapping.ignore, mapping.time.column, *flags}
    used.update(n for channel in mapping.channels.values() for n in channel.formula.columns)
    left = [name for name in names if name not in used]
    return [f"columns not used: {', '.join(left)}"] if left else []


def _checked(
    run: Run, commands: Iterable[str], policy: str, where: str, before: Commands | None = None
) -> Run:
    if len(run.t) < 2:
        raise UndertowError(f"{where} has one sample in the time window, at least 2 are needed: widen it")
    if before is not None:
        where = f"{where}, part from t = {run.t[0]:g} to {run.t[-1]:g} s"
    check = checks.check_channel if before is None else checks.check_finite
    for name, data in run.channels.items():
        check(name, run.t, data, where)
    notes, filled, known = [], dict(run.channels), before or {}
    sensed = {*logged_quantities(catalogue()), *MOTION_UNITS}
    for name in commands:
        if run.has(name):
            data, rule, earlier = filled[name], policy, known.get(name, np.nan)
            if name in sensed:  # a sensor reports now and then: its first report holds from the start
                first = data[np.isfinite(data)][:1]
                rule, earlier = "hold", known.get(name, float(first.sum()) if first.size else np.nan)
            filled[name], note = checks.fill_commands(name, run.t, data, rule, where, earlier)
            notes += [note] if note else []
    constant = checks.constant_channels(run)
    if constant:
        text = ", ".join(f"{name} = {value:g}" for name, value in constant.items())
        notes.append(f"constant channels (not used, or a dead sensor): {text}")
    return replace(run, channels=filled).with_notes(*notes)


# --- sensors slower than their log ----------------------------------------------------------------
# Such a table repeats the last report until the next comes, so that most of its rows are late by up to a
# report. The mapping file names the column that tells new reports from repeated ones; the rows between two
# new reports then lie on the straight line between them.
_FEWEST = 10  # reports of a channel
_LOST = 3.0  # usual times between reports without one: what happened meanwhile is unknown
_ORDER = 3  # a difference of this order leaves little of a smooth motion
_NORMAL = 1.4826  # standard deviation of a normal distribution over its median absolute deviation


def on_the_clock(run: Run, names: Iterable[str], part: bool = False) -> Run:
    """Give channels with few samples a value in every row of the log.

    Rows between two reports lie on a straight line; where no report came for three usual times they stay
    missing. The standard deviation in `sigma` is that of white noise in every row which blurs means over
    seconds as much as the noise of the few reports does: the values in between are no news.
    """
    channels, sigma, notes = dict(run.channels), dict(run.sigma), []
    for name in names:
        t, reports = _reports(run, name)
        noise = sigma.get(name) or _noise(reports)
        channels[name] = _between(run.t, t, reports)
        sigma[name] = noise * float(np.sqrt(len(run.t) / len(t)))
        notes.append(
            f"{name}: {len(t)} reports in {len(run.t)} rows, straight lines in between; noise of a report "
            f"{noise:.2g} {UNITS.get(name, '')}".rstrip()
        )
    return replace(run, channels=channels, sigma=sigma).with_notes(*notes)


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
