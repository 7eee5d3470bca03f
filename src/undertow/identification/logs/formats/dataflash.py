"""ArduPilot DataFlash: .bin, messages of fixed length each, described by the FMT messages in the file.

Columns that this reader adds, with what they come from:

- ``phi, theta, psi`` (rad) of ``XKQ``/``NKQ``: the quaternion, turned by AHRS_TRIM from the axes of the
  autopilot to those of the vehicle, as XKF1 and ATT are (which have hundredths of a degree only);
- ``p, q, r`` (rad/s) of ``IMU``: gyros less the biases of the estimator, turned likewise;
- ``u, v, w`` (m/s) of ``VISO``: steps over their time;
- ``altitude`` (m) of ``RFND``: where the range finder looks down and calls its range good.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from undertow.errors import UndertowError
from undertow.identification.logs.mapping import ANGLES, Column, Frames, LogMapping, has_unit_length
from undertow.typing import Array, Flags, Index

from .ardupilot import SETTINGS, Parameters, actuators, outputs, shorter_by_pymavlink
from .fieldlog import (
    FieldLog,
    Format,
    Interval,
    Series,
    armed_intervals,
    named,
    outputs_of,
    runs_of,
    steady,
    used_intervals,
)

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation


Bytes = NDArray[np.uint8]


@dataclass(frozen=True)
class RecordSettings:
    """How much of a file is held and searched at once, bytes, and how its messages are understood."""

    searched: int = 1 << 20  # for heads at a time: they stay in the cache of a processor
    mapped_size: int = 1 << 28  # size from which on a file is mapped instead of read
    # Share of the time in which an estimator holds its place, from which it is not used.
    held: float = 0.95
    # Usual step of vision odometry beyond which it is in microseconds, not in seconds.
    microseconds: float = 100.0


RECORDS = RecordSettings()

# --- records --------------------------------------------------------------------------------------
HEAD = (0xA3, 0x95)
FMT, _LENGTH = 0x80, 89
# What the letters of a format mean: type of the cell, and what its number is divided by.
_CELLS = {
    "a": "V64", "b": "<i1", "B": "<u1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4", "f": "<f4",
    "d": "<f8", "g": "<f2", "n": "S4", "N": "S16", "Z": "S64", "c": "<i2", "C": "<u2", "e": "<i4",
    "E": "<u4", "L": "<i4", "M": "<u1", "q": "<i8", "Q": "<u8",
}  # fmt: skip
_DIVISORS = {"c": 100.0, "C": 100.0, "e": 100.0, "E": 100.0, "L": 1e7}
_TEXTS = "anNZ"
# Columns that tell instances apart where a log has no FMTU.
_INSTANCES = {"I", "C", "Core", "Instance", "Inst"}
# Prefixes of units for the multipliers of MULT; a cell stays as it was logged.
_PREFIXES = {1e-1: "d", 1e-2: "c", 1e-3: "m", 1e-6: "u", 1e-9: "n"}
_UNITS = {
    "degheading": "deg", "deglatitude": "deg", "deglongitude": "deg", "m/s/s": "m/s^2", "Ohm": "ohm",
    "deg/s/s": "deg/s^2", "rad/s/s": "rad/s^2", "W.h": "W h", "W.s": "W s", "A.s": "A s", "Watt": "W",
    "UNKNOWN": "", "instance": "", "satellites": "", "%": "percent",
}  # fmt: skip


@dataclass(frozen=True)
class _Kind:
    """Messages of one type."""

    name: str
    length: int
    cells: str
    columns: tuple[str, ...]

    def cell(self, column: str) -> tuple[np.dtype[np.generic], int]:
        """Type of the cells of a column, and their offset in a message."""
        if column not in self.columns:
            raise UndertowError(
                f"messages {self.name} of the log have no {column!r}: it is damaged, copy it again"
            )
        place = self.columns.index(column)
        before = sum(np.dtype(_CELLS[c]).itemsize for c in self.cells[:place])
        return np.dtype(_CELLS[self.cells[place]]), 3 + before


@dataclass(frozen=True, eq=False)
class _Messages:
    """All messages of a kind: where they begin in the bytes of the file."""

    kind: _Kind
    places: Index
    data: Bytes

    def cells(self, column: str) -> NDArray[np.generic]:
        """Cells of a column as stored in the file."""
        cell, offset = self.kind.cell(column)
        # A cell may begin at any byte: a view in which every byte begins one.
        count = max(len(self.data) - cell.itemsize + 1, 0)
        at_any = np.ndarray((count,), cell, buffer=self.data, strides=(1,))
        return at_any[self.places + offset]

    def numbers(self, column: str) -> Array:
        """Cells of a column as numbers."""
        values = self.cells(column).astype(np.float64)
        letter = self.kind.cells[self.kind.columns.index(column)]
        return values / _DIVISORS[letter] if letter in _DIVISORS else values

    @property
    def columns(self) -> Columns:
        """Those that hold numbers."""
        cells = zip(self.kind.columns, self.kind.cells, strict=True)
        return Columns({n: partial(self.numbers, n) for n, cell in cells if cell not in _TEXTS})

    def texts(self, column: str) -> list[str]:
        """Cells of a column as texts, up to the first zero."""
        cells = self.cells(column).tolist()
        return [cell.split(b"\0")[0].decode("utf-8", errors="replace") for cell in cells]

    def taken(self, rows: Flags) -> _Messages:
        """Some of the messages."""
        return _Messages(self.kind, self.places[rows], self.data)


class Columns(Mapping[str, Array]):
    """Columns that are computed when first used, and cached; readers add those computed from others."""

    def __init__(self, makers: Mapping[str, Callable[[], Array]]) -> None:
        self.makers, self._made = dict(makers), dict[str, Array]()

    def __getitem__(self, name: str) -> Array:
        if name not in self._made:
            self._made[name] = self.makers[name]()
        return self._made[name]

    def __contains__(self, name: object) -> bool:  # that of a Mapping makes the column
        return name in self.makers

    def __iter__(self) -> Iterator[str]:
        return iter(self.makers)

    def __len__(self) -> int:
        return len(self.makers)


def _kinds(data: Bytes) -> dict[int, _Kind]:
    """The types of messages that a file describes, by number; of several descriptions the first."""
    found: dict[int, _Kind] = {FMT: _Kind("FMT", _LENGTH, "BBnNZ", ("Type", "Length", "Name", "F", "C"))}
    only = np.zeros(256, dtype=np.int64)
    only[FMT] = _LENGTH
    for place in _heads(data, only):
        if place + _LENGTH <= len(data):
            _add_kind(found, bytes(data[place : place + _LENGTH]))
    return found


def _add_kind(found: dict[int, _Kind], record: bytes) -> None:
    number, length = record[3], record[4]
    texts = (record[5:9], record[9:25], record[25:89])
    name, cells, columns = (text.split(b"\0")[0].decode("ascii", errors="replace") for text in texts)
    named = tuple(columns.split(",")) if columns else ()
    sound = re.fullmatch(r"\w{1,4}", name) and set(cells) <= set(_CELLS) and len(set(named)) == len(cells)
    if sound and number not in found:
        unique = f"{name}_{number}" if any(kind.name == name for kind in found.values()) else name
        kind = _Kind(unique, length, cells, named)
        if 3 + sum(np.dtype(_CELLS[c]).itemsize for c in cells) == length:
            found[number] = kind


def _heads(data: Bytes, lengths: NDArray[np.int64]) -> Index:
    """Places that look like the begin of a message of a known type."""
    found = [np.zeros(0, dtype=np.intp)]
    for first in range(0, len(data) - 2, RECORDS.searched):
        part = data[first : first + RECORDS.searched + 2]
        at = np.flatnonzero(part[:-2] == HEAD[0])
        at = at[part[at + 1] == HEAD[1]]
        found.append(at[lengths[part[at + 2]] > 0] + first)
    return np.concatenate(found)


def _chained(data: Bytes, lengths: NDArray[np.int64]) -> tuple[Index, int]:
    """Begins of messages after which another begins, or the file ends, and how many segments are damaged."""
    # Bytes inside a message that look like a header are skipped: the message before leads past them.
    heads = _heads(data, lengths)
    ends = heads + lengths[data[heads + 2]]
    breaks = np.flatnonzero(np.append(heads[1:] != ends[:-1], True)) if len(heads) else heads
    keep, damaged = np.ones(len(heads), dtype=bool), int(len(heads) > 0 and heads[0] > 0)
    at = 0
    for last in breaks.tolist():
        if last < at:  # within a message that was passed over
            continue
        keep[at : last + 1] = True
        after = int(np.searchsorted(heads, ends[last]))
        if after < len(heads) and heads[after] == ends[last]:
            keep[last + 1 : after], at = False, after
        elif ends[last] <= len(data) and len(np.unique(data[int(ends[last]) :])) <= 1:  # nothing but padding
            keep[last + 1 :], at = False, len(heads)
        else:
            keep[last], at = False, last + 1
            damaged += 1
    return heads[keep], damaged


# --- series ---------------------------------------------------------------------------------------


@dataclass(eq=False)
class Records:
    """The messages of a file, by name of their kind."""

    messages: dict[str, _Messages]
    series: dict[str, Series]
    notes: list[str] = field(default_factory=list)

    def rows(self, name: str, *columns: str) -> list[Array] | None:
        """Times, s, and columns of the series of a name; None if the file lacks them."""
        series = self.series.get(name)
        if series is None or not set(columns) <= {*series.columns}:
            return None
        return [series.t, *(series.columns[column] for column in columns)]

    def texts(self, name: str, column: str) -> list[str]:
        """Texts of the messages of a name, none where there are none."""
        found = self.messages.get(name)
        return found.texts(column) if found and column in found.kind.columns else []


def open_records(path: Path) -> Records:
    if path.stat().st_size < RECORDS.mapped_size:  # a file that is mapped must not be replaced meanwhile
        data = np.fromfile(path, dtype=np.uint8)
    else:
        data = np.asarray(np.memmap(path, dtype=np.uint8, mode="r"))
    kinds = _kinds(data)
    lengths = np.zeros(256, dtype=np.int64)
    lengths[list(kinds)] = [kind.length for kind in kinds.values()]
    places, damaged = _chained(data, lengths)
    skipped = len(data) - int(lengths[data[places + 2]].sum())
    notes = [f"{damaged} damaged segments, {skipped} bytes, are left out"] if damaged else []
    rows = _rows_of(data[places + 2])
    there = {kinds[k].name: _Messages(kinds[k], places[own], data) for k, own in rows.items()}
    clocks = {}
    for name, messages in there.items():
        column = next(iter(messages.kind.columns), "")
        if column in _CLOCKS:
            clocks[name] = messages.numbers(column) * _CLOCKS[column]
    if not clocks:
        raise UndertowError(f"log {path} has no message with a time: check that it is complete")
    t = np.full(len(places), np.nan)
    for number, own in rows.items():
        t[own] = clocks.get(kinds[number].name, np.nan)
    sound = steady(t)
    lost = int(np.sum(~sound))
    notes += [f"{lost} messages with an impossible time are left out"] if lost else []
    for number, own in rows.items():
        if lost and (name := kinds[number].name) in clocks:
            there[name], clocks[name] = there[name].taken(sound[own]), clocks[name][sound[own]]
    return Records(there, _series(there, clocks), notes)


def _rows_of(types: Bytes) -> dict[int, Index]:
    """Where in the file the messages of each type are."""
    order = np.argsort(types, kind="stable")
    counts = np.bincount(types, minlength=256)
    parts = np.split(order, np.cumsum(counts)[:-1])
    return {number: part for number, part in enumerate(parts) if len(part)}


def _series(messages: dict[str, _Messages], clocks: dict[str, Array]) -> dict[str, Series]:
    units, instances = _units(messages)
    start, series = min(float(t.min()) for t in clocks.values() if len(t)), {}
    for name, t in clocks.items():
        for called, rows in _by_instance(messages[name], instances.get(name)):
            columns = messages[name].taken(rows).columns
            stated = {n: u for n, u in units.get(name, {}).items() if n in columns}
            series[called] = Series(called, t[rows] - start, columns, stated)
    return series


_CLOCKS = {"TimeUS": 1e-6, "TimeMS": 1e-3}


def _by_instance(messages: _Messages, column: str | None) -> Iterator[tuple[str, Flags]]:
    """Names of the series of a kind, with their messages: one for each instance where there are several."""
    name, whole = messages.kind.name, np.ones(len(messages.places), dtype=bool)
    numbers = messages.numbers(column) if column else whole
    several = np.unique(numbers)
    if len(several) == 1:
        yield name, whole
        return
    for number in several:
        yield f"{name}[{number:g}]", np.asarray(numbers == number)


def _units(messages: dict[str, _Messages]) -> tuple[dict[str, dict[str, str]], dict[str, str]]:
    """Units of columns, and the column of instances, by name of the kind."""
    fields, units = messages.get("FMTU"), _letters(messages, "UNIT", "Label")
    by_number = {int(m.data[m.places[0] + 2]): name for name, m in messages.items()}
    kinds = {n: m.kind for n, m in messages.items()}
    marked = {n: k.columns[1] for n, k in kinds.items() if k.columns[1:2] and k.columns[1] in _INSTANCES}
    if fields is None or "UNIT" not in messages:
        return {}, marked
    factors = dict(zip(_chars(messages, "MULT"), messages["MULT"].numbers("Mult"), strict=True)) \
        if "MULT" in messages else {}  # fmt: skip
    stated: dict[str, dict[str, str]] = {}
    rows = zip(fields.numbers("FmtType"), fields.texts("UnitIds"), fields.texts("MultIds"), strict=True)
    for number, unit_ids, factor_ids in rows:
        kind = kinds.get(by_number.get(int(number), ""))
        if kind is None:
            continue
        if "#" in unit_ids[: len(kind.columns)]:
            marked[kind.name] = kind.columns[unit_ids.index("#")]
        own = zip(kind.columns, kind.cells, unit_ids, factor_ids.ljust(len(unit_ids), "-"), strict=False)
        named = {c: _unit(units.get(u, ""), 1.0 if cell in _DIVISORS else factors.get(f, 1.0))
                 for c, cell, u, f in own}  # fmt: skip
        stated[kind.name] = {column: unit for column, unit in named.items() if unit}
    return stated, marked


def _letters(messages: dict[str, _Messages], name: str, column: str) -> dict[str, str]:
    if name not in messages or column not in messages[name].kind.columns:
        return {}
    return dict(zip(_chars(messages, name), messages[name].texts(column), strict=True))


def _chars(messages: dict[str, _Messages], name: str) -> list[str]:
    return [chr(int(code) & 0xFF) for code in messages[name].numbers("Id")]


def _unit(label: str, factor: float) -> str:
    plain = _UNITS.get(label, label)
    prefix = next((p for f, p in _PREFIXES.items() if abs(factor / f - 1) < 1e-9), "")
    return f"{prefix}{plain}" if plain else ""


# --- what they mean -------------------------------------------------------------------------------
def _read(path: Path, messages: Path | None) -> FieldLog:
    with warnings.catch_warnings():  # casts of damaged numbers
        warnings.simplefilter("ignore", RuntimeWarning)
        return _interpreted(path, open_records(path))


def _interpreted(path: Path, file: Records) -> FieldLog:
    stated = file.messages.get("PARM")
    parameters: Parameters = {}
    if stated is not None:
        parameters = dict(zip(stated.texts("Name"), stated.numbers("Value").tolist(), strict=True))
    firmware = next((text for text in file.texts("MSG", "Message") if re.match(r"Ardu\w+ V", text)), "")
    known = _Navigation(file, parameters)
    columns = known.columns()
    columns |= _sensors(file, known)
    driven, more = actuators(parameters, outputs(file.series, _OUTPUTS, r"C(\d+)"), firmware)
    intervals, left_out = _intervals(file, known, outputs_of(file.series, driven))
    mapping = LogMapping(columns=columns, frames=Frames(velocity=known.velocity_axes))
    notes = (*([firmware] if firmware else []), *file.notes, *known.notes, *more, *left_out)
    return FieldLog(path, FORMAT.name, file.series, mapping, driven, parameters, intervals, notes)


_OUTPUTS = ("RCOU", "RCO2", "RCO3")


class _Navigation:
    """Which estimator, of which core, gives the position, and which of its channels are valid."""

    def __init__(self, file: Records, parameters: Mapping[str, float | str]) -> None:
        self._file, self._parameters = file, parameters
        self.notes: list[str] = []
        families = ("NKF", "XKF") if parameters.get("AHRS_EKF_TYPE") == 2.0 else ("XKF", "NKF")
        there = [f for f in families if self._cores(f"{f}1")]
        self.family = there[0] if there else ""
        self.core = self._primary() if there else 0
        self.held: list[Interval] = []  # when the estimator held its position for lack of aiding
        if (status := self._rows("4", "SS")) is not None:
            self.held = runs_of(status[0], status[1].astype(np.int64) & SETTINGS.held != 0)
        self.velocity_axes: Literal["NED", "body"] = "NED" if self._moves() else "body"

    def _cores(self, name: str) -> list[int]:
        numbered = re.compile(rf"{name}(?:\[(\d+)\])?")
        found = (numbered.fullmatch(series) for series in self._file.series)
        return sorted(int(match[1] or 0) for match in found if match)

    def series(self, name: str, instance: int | None = None) -> str:
        """Name of the series of a kind for an instance, by default for the core; "" if none is there."""
        number = self.core if instance is None else instance
        return next((n for n in (f"{name}[{number}]", name) if n in self._file.series), "")

    def _rows(self, part: str, *columns: str) -> list[Array] | None:
        """Rows of a kind of messages of the estimator, as of `Records`; None without an estimator."""
        return self._file.rows(self.series(f"{self.family}{part}"), *columns) if self.family else None

    def _primary(self) -> int:
        """The core that was primary for most of the log."""
        cores = self._cores(f"{self.family}1")
        for name in (f"{self.family}4[{cores[0]}]", f"{self.family}4"):
            rows = self._file.rows(name, "PI")
            if rows is not None and len(cores) > 1:
                most = max(cores, key=lambda core: int(np.sum(rows[1] == core)))
                self.notes.append(f"core {most} of {self.family}1 is read, the primary one")
                return most
        return cores[0]

    def _moves(self) -> bool:
        """Whether the estimator has places and velocities, and did not hold its place all the time."""
        rows = self._rows("1", "PN", "PE", "PD", "VN", "VE", "VD")
        if rows is None:
            return False
        still = all(np.ptp(place) == 0.0 for place in rows[1:3])
        return not still and sum(b - a for a, b in self.held) < RECORDS.held * float(np.ptp(rows[0]))

    def columns(self) -> dict[str, Column]:
        """Position, velocity, attitude and rates."""
        return {**self._position(), **self._attitude(), **self._rates()}

    def _position(self) -> dict[str, Column]:
        name = self.series(f"{self.family}1") if self.family else ""
        if self.velocity_axes == "NED":
            return named(name, {"PN": "x", "PE": "y", "PD": "z", "VN": "u", "VE": "v", "VD": "w"})
        found = named(name, {"PD": "z"}) if name and "PD" in self._file.series[name].columns else {}
        if name:
            self.notes.append(f"{name} has no horizontal aid: its position and velocity are not used")
        return {**found, **self._by_vision(bool(found))}

    def _by_vision(self, has_depth: bool) -> dict[str, Column]:
        """Place and velocity that were sent to the autopilot, where its estimator has none."""
        found: dict[str, Column] = {}
        if self._file.rows("VISP", "PX", "PY", "PZ") is not None:
            found |= named("VISP", {"PX": "x", "PY": "y"} | ({} if has_depth else {"PZ": "z"}))
        rows = self._file.rows("VISO", "dt", "PosDX", "PosDY", "PosDZ")
        if rows is not None:
            # Firmware says seconds, units of some versions say microseconds.
            step = rows[1] * (1e-6 if np.median(rows[1]) > RECORDS.microseconds else 1.0)
            step = np.where(step > 0, step, np.nan)
            columns = self._file.series["VISO"].columns
            _computed(columns, "uvw", lambda: [moved / step for moved in rows[2:]])
            found |= named("VISO", {"u": "u", "v": "v", "w": "w"})
        return found

    def _trim(self) -> Rotation:
        """From the axes of the autopilot to those of the vehicle (AHRS_TRIM)."""
        from scipy.spatial.transform import Rotation  # slow to import, and every log is tested for its format

        angles = [self._parameters.get(f"AHRS_TRIM_{axis}", 0.0) for axis in "ZYX"]
        return Rotation.from_euler("ZYX", [a if isinstance(a, float) else 0.0 for a in angles])

    def _attitude(self) -> dict[str, Column]:
        name = self.series(f"{self.family[:2]}Q") if self.family else ""
        rows = self._file.rows(name, "Q1", "Q2", "Q3", "Q4")
        if rows is not None:
            return self._by_quaternion(name, rows)
        angles = {"Roll": "phi", "Pitch": "theta", "Yaw": "psi"}
        one = self.series(f"{self.family}1") if self.family else ""
        name = next((n for n in (one, "ATT", "AHR2") if self._file.rows(n, *angles) is not None), "")
        return named(name, angles, unit="deg") if name else {}

    def _by_quaternion(self, name: str, rows: list[Array]) -> dict[str, Column]:
        from scipy.spatial.transform import Rotation

        def angles() -> Array:
            q = np.column_stack(rows[1:])
            sound = has_unit_length(q.T)
            turned = Rotation.from_quat(np.where(sound[:, None], q, [1.0, 0, 0, 0]), scalar_first=True)
            euler = (turned * self._trim().inv()).as_euler("ZYX")[:, ::-1]
            return np.where(sound[:, None], euler, np.nan).T

        _computed(self._file.series[name].columns, ANGLES, angles)
        return named(name, {"phi": "phi", "theta": "theta", "psi": "psi"})

    def _rates(self) -> dict[str, Column]:
        chosen = self._rows("FS", "GI")
        number = int(np.median(chosen[1])) if chosen is not None and len(chosen[1]) else 0
        name = self.series("IMU", number) or self.series("IMU", 0)
        rows = self._file.rows(name, "GyrX", "GyrY", "GyrZ")
        if rows is None:
            return {}

        def rates() -> Array:
            gyros = np.column_stack(rows[1:])
            if self._file.series[name].units.get("GyrX") == "deg/s":
                gyros = np.radians(gyros)
            return self._trim().apply(gyros - self._bias(rows[0])).T

        _computed(self._file.series[name].columns, "pqr", rates)
        return named(name, {"p": "p", "q": "q", "r": "r"})

    def _bias(self, t: Array) -> Array:
        """Bias of the gyros, rad/s, (n, 3): the last estimates."""
        rows = self._rows("1", "GX", "GY", "GZ")
        if rows is None:
            return np.zeros((len(t), 3))
        latest = np.clip(np.searchsorted(rows[0], t, side="right") - 1, 0, len(rows[0]) - 1)
        return np.radians(np.column_stack(rows[1:])[latest])

    def resets(self) -> list[float]:
        """Times, s, at which the estimator was reset or another one took over."""
        found: list[float] = []
        rows = self._rows("4", "OFN", "OFE", "PI")
        if rows is not None:
            changed = np.any([np.diff(column) != 0 for column in rows[1:]], axis=0)
            found += rows[0][1:][changed].tolist()
        events = self._file.rows("EV", "Id")
        found += events[0][np.isin(events[1], _RESET_EVENTS)].tolist() if events else []
        times, texts = self._file.rows("MSG"), self._file.texts("MSG", "Message")
        if times is not None and len(times[0]) == len(texts):
            found += [float(t) for t, text in zip(times[0], texts, strict=True) if _RESET.search(text)]
        return found


_RESET_EVENTS = (60, 62)  # of altitude and of yaw
_RESET = re.compile(
    r"EKF[23] (IMU\d+ (forced reset|.*yaw (re-?)?align|.*reset|is using|stopped aiding|started)|lane switch)"
    r"|EKF primary changed"
)


def _computed(
    columns: Mapping[str, Array], names: Sequence[str], make: Callable[[], Sequence[Array] | Array]
) -> None:
    """Add columns that are computed together when one of them is first used."""
    assert isinstance(columns, Columns)
    made = cache(make)
    for k, name in enumerate(names):
        columns.makers[name] = partial(lambda k: made()[k], k)


_DOWN, _GOOD = 25, 4  # orientation of a range finder, and its status


def _sensors(file: Records, known: _Navigation) -> dict[str, Column]:
    """Voltage of the battery and height above ground."""
    battery = known.series("BAT", 0) or known.series("CURR", 0)
    measured = file.rows(battery, "Volt") is not None
    return (named(battery, {"Volt": "voltage"}, unit="V") if measured else {}) | _height(file)


def _height(file: Records) -> dict[str, Column]:
    """Height above ground, by the first range finder that looks down."""
    for name in file.series:
        rows = file.rows(name, "Dist") if re.match(r"RFND\b", name) else None
        if rows is None:
            continue
        columns, every = file.series[name].columns, np.ones(len(rows[1]))
        looks = columns.get("Orient", _DOWN * every) == _DOWN
        if looks.any():
            good = looks & (columns.get("Stat", columns.get("Status", _GOOD * every)) == _GOOD)
            _computed(columns, ("altitude",), partial(_where, good, rows[1]))
            return named(name, {"altitude": "altitude"})
    return {}


def _where(good: Flags, values: Array) -> list[Array]:
    return [np.where(good, values, np.nan)]


_ARMED_EVENT, _DISARMED_EVENT = 10, 11


def _intervals(
    file: Records, known: _Navigation, outputs: tuple[Array, Array] | None
) -> tuple[tuple[Interval, ...], list[str]]:
    end = max(float(series.t.max()) for series in file.series.values() if len(series.t))
    span = (0.0, end)
    events: list[tuple[float, bool]] = []
    states, marks = file.rows("ARM", "ArmState"), file.rows("EV", "Id")
    if states is not None:
        events += [(float(t), bool(on)) for t, on in zip(*states, strict=True)]
    elif marks is not None:
        armed_by = {_ARMED_EVENT: True, _DISARMED_EVENT: False}
        events += [(float(t), armed_by[int(k)]) for t, k in zip(*marks, strict=True) if int(k) in armed_by]
    return used_intervals(span, armed_intervals(events, span), outputs, known.resets(), known.held)


def _accepts(path: Path, head: bytes) -> bool:
    begins = head.startswith(bytes([*HEAD, FMT]))
    return begins or (path.suffix.lower() == ".bin" and bytes(HEAD) in head)


FORMAT = Format("ArduPilot DataFlash", (".bin",), _accepts, _read, shorter=shorter_by_pymavlink(".bin"))
