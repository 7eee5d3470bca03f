"""A native vehicle log: series with their own clocks, their meaning, and its format."""

from __future__ import annotations

import json
import pkgutil
import signal
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from types import ModuleType

import numpy as np
import polars as pl
from numpy.typing import NDArray

from undertow.errors import UndertowError, listed, nearest
from undertow.files import file_hash, hash_of
from undertow.identification.logs.mapping import Column, LogMapping, Time
from undertow.identification.logs.run import later_than_before
from undertow.identification.logs.table import Helper, file_bytes, read_table, refuse_no_file
from undertow.typing import Array, Flags

Places = NDArray[np.intp]
Interval = tuple[float, float]
"""First and last time of a part of a log, s."""
Window = tuple[float | None, float | None]
"""First and last time of what is used, s; None for no limit."""

TIME, STRETCH = "t", "stretch"
"""Columns of the table of a log: its time, s, and the number of the stretch that a row belongs to."""


@dataclass(frozen=True)
class UnionSettings:
    """How clocks are read, and how several series are merged into the rows of one table."""

    # Samples closer than this share of the shortest usual step of a series are in one row: drivers stamp
    # simultaneous samples a few microseconds apart.
    same_row: float = 0.05
    # s by which one time in a file may differ from its neighbours, and largest time between the first two and
    # the last two: other times are damaged.
    jump: float = 1.0
    pause: float = 3600.0
    # Rows times columns of a table that are held at once: 8 bytes each, three times over while they are
    # merged. Ten hours of ArduSub have as many.
    cells: int = 50_000_000
    # s that are read on either side of a part of a log: commands that are held there were sent before.
    margin: float = 10.0
    guess_rows: int = 20_000  # samples from which the meaning of columns is guessed; more change no guess
    # s; a clock that begins later does not begin with the log: its times count from the first one of all such
    # clocks. `LogLimits.own_clock`, by which times are dates, is larger: here a vehicle that has been on for
    # two weeks is enough, whose other series may begin with the log.
    since: float = 1e6
    # s by which the stamps of a series may differ from the times at which it was recorded, in the median:
    # beyond it they are of another clock.
    apart: float = 10.0
    # Elements of a list, or columns of a matrix, that are measurements of their own, at most: commands and
    # beams, but no covariances of six by six.
    widest: int = 16


SETTINGS = UnionSettings()


@dataclass(frozen=True, eq=False)
class Series:
    """Messages of one kind: a topic, a table, one instance of a sensor."""

    name: str  # as in the file; with an instance in brackets where there are several, such as ``XKF1[0]``
    t: Array  # times in s from the start of the log, in the order of the file, (n,)
    # values as logged, (n,), by name; they may be decoded when first used
    columns: Mapping[str, Array]
    # units that the file states, by name of the column; those that it does not state are missing
    units: Mapping[str, str] = field(default_factory=dict)


def named(series: str, channels: Mapping[str, str], **known: str | float) -> dict[str, Column]:
    """Columns of a series by the channels that they are, all of one unit and scale."""
    return {
        f"{series}.{name}": Column.model_validate({"channel": channel, **known})
        for name, channel in channels.items()
    }


@dataclass(frozen=True, eq=False)
class FieldLog:
    """A log as its vehicle wrote it."""

    path: Path  # the file or, of some formats, the folder
    format: str  # name of its format
    series: Mapping[str, Series]  # by name
    # what the format defines: columns, called ``series.column``, and frames; without commands, since their
    # names are those of the vehicle file
    mapping: LogMapping = field(default_factory=LogMapping)
    # columns that drive the vehicle in the order of their motors, each with what is known of its unit
    actuators: tuple[tuple[str, Column], ...] = ()
    # settings of the autopilot that the log holds
    parameters: Mapping[str, float | str] = field(default_factory=dict)
    # parts to be used, s: armed, and on one side of a reset of the estimator; empty for the whole log
    intervals: tuple[Interval, ...] = ()
    notes: tuple[str, ...] = ()  # data that were left out, repaired or unusual, one line each
    remarks: tuple[str, ...] = ()  # choices and doubts in `mapping`: irrelevant where another one is given
    files: tuple[Path, ...] = ()  # files of the log, if not those at its path
    by_name: bool = False  # whether all of `mapping` was guessed from names

    @property
    def read_as(self) -> tuple[str, ...]:
        """What is to be known of a log that is read by `mapping`; questions on names are asked elsewhere."""
        return self.notes if self.by_name else (*self.notes, *self.remarks)

    def mapping_for(self, commands: Sequence[str] = ()) -> LogMapping:
        """The known mapping, with the commands of a vehicle as its columns.

        A column that has the name of a command is that command. Where none has, the motors of the log are the
        commands in their order, if there are as many of one as of the other.
        """
        taken = {column.channel for column in self.mapping.columns.values()}
        wanted = [name for name in commands if name not in taken]
        driven = self._columns_named(wanted)
        called = wanted or [column.channel for _, column in self.actuators]
        if not driven and len(called) == len(self.actuators):
            driven = {
                name: column.model_copy(update={"channel": command})
                for command, (name, column) in zip(called, self.actuators, strict=True)
            }
        time = Time(column=TIME, stretch=STRETCH if self.intervals else None)
        policy = "hold" if driven else self.mapping.missing_commands
        known = {**self.mapping.columns, **driven}
        return self.mapping.model_copy(update={"time": time, "columns": known, "missing_commands": policy})

    def _columns_named(self, commands: Sequence[str]) -> dict[str, Column]:
        """Columns that have the names of commands, and those of series with a single one that have."""
        found = {
            s.name: f"{s.name}.{next(iter(s.columns))}"
            for s in self.series.values()
            if s.name in commands and len(s.columns) == 1
        }
        found |= {c: f"{s.name}.{c}" for s in self.series.values() for c in s.columns if c in commands}
        known = dict(self.actuators)
        return {
            found[c]: known.get(found[c], Column(channel=c)).model_copy(update={"channel": c})
            for c in commands
            if c in found
        }

    def table(self, columns: Iterable[str], window: Window = (None, None)) -> pl.DataFrame:
        """The series of some columns side by side: a row for every time, blank where a series has no sample.

        It has `TIME`, `STRETCH` where the log has segments, and columns ``series.column``. Only the part in
        the window, s, is used: of a table too large for memory no other is held.
        """
        wanted: dict[str, list[str]] = {}
        for name in dict.fromkeys(columns):
            series, column = self.series_and_column(name)
            wanted.setdefault(series, []).append(column)
        if not wanted:
            raise UndertowError(
                f"log {self.path}: none of its series is recognised as a motion; undertow import {self.path} "
                "--out NEW.parquet writes all of it as a table, with a mapping file that asks what it means"
            )
        kept, t, places = self._rows(wanted, window)
        times = [self.series[name].t[rows] for name, rows in kept.items()]
        table = {TIME: t}
        if self.intervals:  # the segment of each row: that of the latest of its samples which is in one
            table[STRETCH] = np.full(len(t), np.nan)
            for k, (first, last) in enumerate(self.intervals, start=1):
                for own, place in zip(times, places, strict=True):
                    table[STRETCH][place[(own >= first) & (own <= last)]] = k
        for (name, fields), place in zip(wanted.items(), places, strict=True):
            for column in fields:
                cells = np.full(len(t), np.nan)
                cells[place] = self.series[name].columns[column][kept[name]]
                table[f"{name}.{column}"] = cells
        return pl.DataFrame(table, nan_to_null=True)

    def beginning(self) -> pl.DataFrame:
        """Rows of all columns, enough to guess their meaning: the first in which most of them report."""
        times = [t for one in self.series.values() if len(t := one.t[rising(one.t)])]
        if self.intervals:
            times = [t[(t >= a) & (t <= b)] for t in times for a, b in [longest(self.intervals)]]
            times = [t for t in times if len(t)]
        begins = np.unique([t[0] for t in times])
        reporting = sum(((t[0] <= begins) & (begins < t[-1])).astype(int) for t in times)
        begin = float(begins[np.argmax(reporting)])
        every = np.sort(np.concatenate([t[t >= begin] for t in times]))
        end = float(every[min(SETTINGS.guess_rows, len(every)) - 1])
        rows = self.table(self.columns, (begin, end)).drop(STRETCH, strict=False)
        return rows.filter(pl.col(TIME).is_between(begin, end))

    @property
    def sha256(self) -> str:
        """Of the bytes of its files."""
        return hash_of(self.files) if self.files else file_hash(self.path)

    def _rows(
        self, wanted: Mapping[str, Sequence[str]], window: Window
    ) -> tuple[dict[str, Places], Array, list[Places]]:
        """Samples that go into a table, its times, and their rows; of a part only where all are too many."""
        low, high = (e if w is None else w for w, e in zip(window, (-np.inf, np.inf), strict=True))
        every = {name: rising(self.series[name].t) for name in wanted}
        width = 2 + sum(map(len, wanted.values()))
        t, places = union([self.series[name].t[rows] for name, rows in every.items()])
        if len(t) * width <= SETTINGS.cells:
            return every, t, places
        low, high = low - SETTINGS.margin, high + SETTINGS.margin
        inside = {}
        for name, rows in every.items():
            own = self.series[name].t[rows]
            inside[name] = rows[(own >= low) & (own <= high)]
        t, places = union([self.series[name].t[rows] for name, rows in inside.items()])
        if not len(t):
            raise UndertowError(f"log {self.path} has no sample in the time window: change it")
        if len(t) * width > SETTINGS.cells:
            raise UndertowError(
                f"log {self.path} makes a table of {len(t)} rows of {width} columns, at most "
                f"{SETTINGS.cells // width} such rows are allowed: use a part of it with --from and --to, "
                "or leave columns out of a mapping file (--map; undertow import writes one)"
            )
        return inside, t, places

    def has(self, name: str) -> bool:
        """Whether it has a column of this name; series are decoded only as far as it is looked for."""
        return any(name == f"{s.name}.{column}" for s in self.series.values() for column in s.columns)

    @property
    def columns(self) -> list[str]:
        """Names of all columns, which join those of a series and of its column."""
        return [f"{s.name}.{column}" for s in self.series.values() for column in s.columns]

    @property
    def units(self) -> dict[str, str]:
        """Units that the file states, by name of the column."""
        every = self.series.values()
        return {f"{s.name}.{c}": unit for s in every for c, unit in s.units.items() if c in s.columns}

    def series_and_column(self, name: str) -> tuple[str, str]:
        """Name of the series and of its column, of a name that joins them."""
        for series in self.series:  # either may have points in it
            if name.startswith(f"{series}.") and name[len(series) + 1 :] in self.series[series].columns:
                return series, name[len(series) + 1 :]
        hint = nearest(name, self.columns)
        raise UndertowError(
            f"log {self.path} has no {name!r}{hint}: undertow import {self.path} --list shows what it has; "
            "optional = true in the mapping file leaves it out of logs that lack it"
        )

    def drive(self) -> tuple[Array, Array] | None:
        """Times, s, (n,), and commands, (n, motors), of motors."""
        return outputs_of(self.series, self.actuators)


HELD = LogMapping(missing_commands="hold")
"""For commands in rows of their own."""


def from_one_begin(found: Sequence[Series]) -> list[Series]:
    """Series with one origin: the first time of clocks since 1970, the start of the log of other clocks."""
    firsts = [float(np.nanmin(one.t)) for one in found]
    late = [first for first in firsts if abs(first) > SETTINGS.since]
    begins = [min(late) if abs(first) > SETTINGS.since else 0.0 for first in firsts]
    return [replace(one, t=one.t - begin) for one, begin in zip(found, begins, strict=True)]


def on_clocks(found: Sequence[Series]) -> list[str]:
    """A note on what `from_one_begin` takes for one moment, where only some clocks count since 1970."""
    firsts = {one.name: float(np.nanmin(one.t)) for one in found}
    own = {name: first for name, first in firsts.items() if abs(first) <= SETTINGS.since}
    if len(own) in (0, len(firsts)):
        return []
    begins = listed(f"{name} (first at {first:.4g} s)" for name, first in own.items())
    others = listed(name for name in firsts if name not in own)
    return [
        f"only the clock of {others} counts since 1970: its first time is taken for 0 s of {begins}; if it "
        "is not, a delay of their columns puts that right"
    ]


def in_order(log: FieldLog) -> FieldLog:
    """A log with notes on clocks that jump back, cut where one does so permanently."""
    columns = [*log.mapping.columns, *(name for name, _ in log.actuators)]
    clocks = {name.rpartition(".")[0] for name in columns} & {*log.series}
    counts, seams = list[str](), list[float]()
    for name in sorted(clocks):
        lost, back = _out_of_order(log.series[name].t)
        seams += back
        counts += [f"{lost} of {name}"] if lost else []
    if not counts:
        return log
    ends = [log.series[name].t[rising(log.series[name].t)][[0, -1]] for name in sorted(clocks)]
    whole = (float(np.min(ends)), float(np.max(ends)))
    notes = [f"samples that are not later than earlier ones are left out: {', '.join(counts)}"]
    notes += [f"cut at {min(seams):.1f} s, where the clock goes back"] if seams else []
    intervals = long_enough(cut_at(log.intervals or [whole], seams)) if seams else log.intervals
    return replace(log, intervals=tuple(intervals), notes=(*log.notes, *notes))


def _out_of_order(t: Array) -> tuple[int, list[float]]:
    """How many samples are not later than all before, and times, s, at which a clock was set back for good.

    Messages that arrive out of order are no such clock, nor are a few damaged times.
    """
    kept = rising(t)
    lost = np.setdiff1d(np.flatnonzero(np.isfinite(t)), kept)
    blocks = np.split(lost, np.flatnonzero(np.diff(lost) > 1) + 1) if len(lost) else []
    back = [kept[kept > block[-1]][:1] for block in blocks if np.ptp(t[block]) > SETTINGS.jump]
    return len(lost), [float(t[next_]) for places in back for next_ in places]


def outputs_of(
    series: Mapping[str, Series], actuators: Sequence[tuple[str, Column]]
) -> tuple[Array, Array] | None:
    """Times, s, (n,), and commands, (n, motors), of those in the series of the first; None without any."""
    home = actuators[0][0].rpartition(".")[0] if actuators else ""
    if home not in series:
        return None
    here = [(name.rpartition(".")[2], c) for name, c in actuators if name.startswith(f"{home}.")]
    cells = [c.scaled(series[home].columns[name], c.scale, c.offset) for name, c in here]
    return series[home].t, np.column_stack(cells)


OFF = 0.0  # width of the pulse of an output that is switched off, microseconds


def switched_off(pulses: Iterable[Array]) -> list[str]:
    """Note on outputs that give no pulse at times."""
    most = max((float(np.mean(p == OFF)) for p in pulses), default=0.0)
    return [f"motor outputs give no pulse (0 µs) in up to {most:.1%} of their samples: no thrust"] * (
        most > 0
    )


@dataclass(frozen=True)
class Format:
    """A format of logs."""

    name: str  # what it is called
    suffixes: tuple[str, ...]  # ends of the names of such files, for messages and for `accepts`
    # whether a file of this path, which begins with these bytes (b"" for a folder), is of the format
    accepts: Callable[[Path, bytes], bool]
    # the log at a path. The second argument is the folder with definitions of messages, or None.
    read: Callable[[Path, Path | None], FieldLog]
    # bytes of a file that can be read in 1.5 GB of memory; a larger one is refused unread
    largest: int = 400_000_000
    shorter: str = "save it in shorter files, or with fewer variables"  # how a file is made smaller
    # whether its library hangs or crashes with some damaged files, so that another process tries first
    hangs: bool = False
    # the log of several files of one run, in the one format that has such logs
    together: Callable[[Sequence[Path]], FieldLog] | None = None


def library(name: str, what: str, extra: str = "field") -> ModuleType:
    """Import an optional library, or refuse with the command that installs it."""
    try:
        return import_module(name)
    except ImportError as error:
        package = name.split(".")[0]
        raise UndertowError(f'{what} needs the library {package}: pip install "undertow[{extra}]"') from error


def rising(t: Array) -> Places:
    """Places of the samples that are later than all before them, (m,)."""
    there = np.isfinite(t)
    return np.flatnonzero(later_than_before(np.where(there, t, np.nan)) & there)


def steady(times: Array) -> Flags:
    """Which times lie between their neighbours in the file: after a damaged one all others would be dropped.

    Those of messages without a time, NaN, are accepted.
    """
    timed = np.flatnonzero(np.isfinite(times))
    t, sound = times[timed], np.ones(len(times), dtype=bool)
    if len(t) > 2:
        one, two, three = t[:-2], t[1:-1], t[2:]
        middle = np.maximum(np.minimum(one, two), np.minimum(np.maximum(one, two), three))
        sound[timed[1:-1]] = np.abs(two - middle) <= SETTINGS.jump
        sound[timed[[0, -1]]] = [
            -SETTINGS.pause <= t[0] - t[1] <= SETTINGS.jump,
            -SETTINGS.jump <= t[-1] - t[-2] <= SETTINGS.pause,
        ]
    return sound


def union(times: Sequence[Array]) -> tuple[Array, list[Places]]:
    """Rows for several strictly rising clocks: their times, s, and the row of every sample of each.

    Samples that belong together have the time of the first of them.
    """
    every, where = np.unique(np.concatenate([*times, np.zeros(0)]), return_inverse=True)
    own = np.split(where, np.cumsum([len(t) for t in times])[:-1])
    steps = [float(np.median(np.diff(t))) for t in times if len(t) > 1]
    apart = np.diff(every) > SETTINGS.same_row * min(steps, default=0.0)
    row = np.concatenate([np.zeros(min(len(every), 1), dtype=np.intp), np.cumsum(apart)])
    if any(np.any(np.diff(row[place]) == 0) for place in own):  # two samples of one clock in a row: all apart
        return every, own
    return every[np.unique(row, return_index=True)[1]], [row[place] for place in own]


# --- the segments that are used: armed and moving, cut where the estimator was reset ----------------------
@dataclass(frozen=True)
class MotionSettings:
    """Settings for when a vehicle moves under its own power."""

    # Share of full output by which a motor leaves its rest: the dead band of a T200 with its speed controller
    # reaches to 0.07 at 16 V and 0.09 at 12 V, and pilots' sticks rest within half of that.
    off_rest: float = 0.04
    coast: float = 5.0  # s that are kept after the last motor stopped: drag without thrust is informative
    shortest: float = 2.0  # s; a shorter segment has no information
    reported: float = 0.1  # s; a shorter part that is left out is not mentioned


MOTION = MotionSettings()


def armed_intervals(events: Iterable[tuple[float, bool]], span: Interval) -> list[Interval]:
    """Parts of a span in which the vehicle is armed, by the times at which that changed.

    Before the first event it was in the opposite state; without events it is taken to be armed.
    """
    ordered = sorted(events)
    if not ordered:
        return [span]
    states = [(span[0], not ordered[0][1]), *ordered, (span[1], False)]
    parts = [(a[0], b[0]) for a, b in pairwise(states) if a[1] and b[0] > a[0]]
    joined: list[Interval] = []
    for first, last in parts:
        if joined and joined[-1][1] == first:
            first = joined.pop()[0]
        joined.append((first, last))
    return joined


def used_intervals(
    span: Interval,
    armed: Sequence[Interval],
    outputs: tuple[Array, Array] | None,
    resets: Iterable[float],
    held: Sequence[Interval] = (),
) -> tuple[tuple[Interval, ...], list[str]]:
    """The parts of a log to be used, cut where the estimator was reset, and notes on the others.

    All times in s; `outputs` are times and commands of motors from -1 to 1; `held` is when the estimator held
    its position for lack of aiding.
    """
    moving = [part for stretch in armed for part in _moving(stretch, outputs)]
    notes = []
    if not armed:
        notes.append("the vehicle is never armed: all of the log is used")
    elif not moving:
        notes.append("armed, but no motor leaves neutral: all of the armed time is used")
    # No command is known before the first message on them.
    begin = float(outputs[0][0]) if outputs is not None and len(outputs[0]) else span[0]
    kept = long_enough((max(a, begin), b) for a, b in moving or armed or [span])
    inside = [r for r in resets if any(a < r < b for a, b in kept)]
    if inside:
        notes.append(f"cut at {', '.join(f'{t:.1f}' for t in inside)} s, where the estimator was reset")
    pieces = long_enough(cut_at(kept, [*inside, *(edge for stretch in held for edge in stretch)]))
    aided = [p for p in pieces if not _within(sum(p) / 2, held)]
    if len(aided) < len(pieces) and aided:
        notes.append("left out where the estimator held its position without an aid")
    pieces = aided or long_enough(cut_at(kept, inside))
    return tuple(pieces), [*notes, *_left_out(span, pieces, armed)]


def long_enough(intervals: Iterable[Interval]) -> list[Interval]:
    """Those long enough to be useful."""
    return [s for s in intervals if s[1] - s[0] >= MOTION.shortest]


def _moving(stretch: Interval, outputs: tuple[Array, Array] | None) -> list[Interval]:
    if outputs is None:
        return [stretch]
    t, commands = outputs
    off = np.any(np.abs(commands) > MOTION.off_rest, axis=1) & (t >= stretch[0]) & (t <= stretch[1])
    if not off.any():
        return []
    return [(float(t[off][0]), min(float(t[off][-1]) + MOTION.coast, stretch[1]))]


def longest(intervals: Iterable[Interval]) -> Interval:
    """The longest of some intervals."""
    return max(intervals, key=lambda s: s[1] - s[0])


def _within(t: float, intervals: Iterable[Interval]) -> bool:
    return any(a <= t <= b for a, b in intervals)


def _left_out(span: Interval, used: Sequence[Interval], armed: Sequence[Interval]) -> list[str]:
    """One line on the parts of a span that are not used."""
    edges = [span[0], *(edge for stretch in used for edge in stretch), span[1]]
    parts = []
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        switched = [edge for stretch in armed for edge in stretch if first < edge < last]
        for a, b in pairwise([first, *switched, last]):
            why = "motors at rest, or estimator without an aid" if _within((a + b) / 2, armed) else "disarmed"
            parts += [f"{a:.1f} to {b:.1f} s ({why})"] if b - a >= MOTION.reported else []
    return [f"left out: {', '.join(parts)}"] if parts else []


def runs_of(t: Array, flags: Flags) -> list[Interval]:
    """Intervals in which flags of samples are set, s."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(int)))
    return [(float(t[a]), float(t[min(b, len(t) - 1)])) for a, b in edges.reshape(-1, 2)]


def cut_at(intervals: Iterable[Interval], resets: Iterable[float]) -> tuple[Interval, ...]:
    """Cut segments where an estimator was reset; the sample of the reset begins a new one."""
    cuts = sorted(set(resets))
    pieces: list[Interval] = []
    for first, last in intervals:
        inside = [c for c in cuts if first < c <= last]
        ends = [*(float(np.nextafter(c, first)) for c in inside), last]
        pieces += zip([first, *inside], ends, strict=True)
    return tuple(piece for piece in pieces if piece[1] > piece[0])


# --- which format a log is of, and reading it -----------------------------------------------------
_HEAD_BYTES = 512  # at the start of a file, which show its format
TABLES = ("CSV (.csv, .csv.gz)", "Parquet (.parquet)")
"""Formats that are tables already."""


@dataclass(frozen=True)
class TrialSettings:
    """Limits on the time, s, for reading a file that could hang its reader."""

    # Importing the libraries takes two, and unpacking a megabyte of numbers 0.05.
    least: float = 20.0
    per_megabyte: float = 1.0
    subprocess: float = 600  # in which a program of its own, as for dbdreader, has to be done


TRIAL = TrialSettings()


@cache
def formats() -> tuple[Format, ...]:
    """All formats that vehicles write, one from every module of this package that declares one."""
    folder = Path(__file__).parent
    modules = (import_module(f"{__package__}.{m.name}") for m in pkgutil.iter_modules([str(folder)]))
    return tuple(m.FORMAT for m in modules if hasattr(m, "FORMAT"))


def format_of(path: Path) -> Format | None:
    """The format that a vehicle wrote a log in; None for tables, and for what is not there."""
    try:
        with path.open("rb") as stream:
            head = stream.read(_HEAD_BYTES)
    except IsADirectoryError:
        head = b""
    except OSError:
        return None
    return next((one for one in formats() if one.accepts(path, head)), None)


def open_field_log(path: Path, messages: Path | None = None) -> FieldLog | None:
    """Read a log as its vehicle wrote it; None for tables, and for what is not there.

    `messages` is a folder with definitions of messages, for formats that need them.
    """
    found = format_of(path)
    if found is None:
        return None
    size = path.stat().st_size if path.is_file() else 0
    seconds = TRIAL.least + TRIAL.per_megabyte * size / 1e6
    if size > found.largest:
        raise UndertowError(
            f"log {path} has {size / 1e6:.0f} MB, at most {found.largest / 1e6:.0f} MB of {found.name} can "
            f"be read: {found.shorter}"
        )
    if found.hangs and not _TRIES.answer([str(path.absolute()), seconds], True, False):
        raise UndertowError(
            f"log {path} cannot be read as {found.name}: its reader fails, or takes more than "
            f"{seconds:.0f} s: copy it again"
        )
    try:
        return in_order(found.read(path, messages))
    except (UndertowError, MemoryError):
        raise
    except Exception as error:  # whatever a library raises for a damaged file
        words = str(error).split("\n")[0] or type(error).__name__
        raise UndertowError(f"log {path} cannot be read as {found.name}: {words}: copy it again") from error


def answer_whether_files_can_be_read() -> None:
    """Read files one after the other, in a separate process that may crash or be killed."""
    for line in sys.stdin:
        path, seconds = json.loads(line)
        if hasattr(signal, "setitimer"):  # it ends a process that hangs in a library, too
            signal.setitimer(signal.ITIMER_PROF, seconds)
        with suppress(Exception):  # the same error is raised again when the file is read
            found = format_of(Path(path))
            log = found.read(Path(path), None) if found else None
            for series in log.series.values() if log else ():
                list(series.columns.values())
        print(json.dumps(True), flush=True)


_TRIES = Helper(f"from {__name__} import answer_whether_files_can_be_read as answer\nanswer()")


def read_field_log(path: Path, messages: Path | None = None) -> FieldLog:
    """The same for a file that has to be such a log."""
    found = open_field_log(path, messages)
    if found is None:
        refuse_no_file(path)
    if found is None and (path.suffix in (".csv", ".gz", ".parquet") or _is_table(path)):
        raise UndertowError(
            f"log {path} is a table, which every command reads directly; undertow map new {path} writes a "
            "first mapping file for its columns"
        )
    if found is None:
        raise UndertowError(f"log {path} has an unknown format: {readable()}")
    return found


def _is_table(path: Path) -> bool:
    """Whether a file of another name is read as a table of several columns."""
    try:
        content = file_bytes(path)
    except UndertowError:
        return False
    for delimiter in ",;\t":
        with suppress(UndertowError):
            table = read_table(content, LogMapping(delimiter=delimiter), f"log {path}", path)
            if len(table.columns) > 1:
                return True
    return False


def one_run(paths: Sequence[Path], messages: Path | None = None) -> FieldLog:
    """The log of one run: a vehicle's own, or several tables; a single table is refused."""
    if not paths:
        raise UndertowError("no log is given: give the path of at least one file")
    if len(paths) == 1:
        return read_field_log(paths[0], messages)
    for path in paths:
        if path.is_dir():
            raise UndertowError(
                f"log {path} is a folder, and beside other logs only files can be given: give it alone, or "
                "list its files"
            )
        refuse_no_file(path)
        if (known := format_of(path)) is not None:
            raise UndertowError(
                f"log {path} is {known.name}, and only tables can be given as several files: give it alone, "
                f"or make a table of each (undertow import {path} --out NEW.parquet)"
            )
    return in_order(next(one.together for one in formats() if one.together)(paths))


def readable() -> str:
    """The formats that can be read, in words."""
    known = [f"{one.name} ({', '.join(one.suffixes)})" for one in formats()]
    return f"undertow reads {', '.join([*TABLES, *known])}"
