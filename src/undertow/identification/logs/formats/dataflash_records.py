"""Messages of ArduPilot's DataFlash files: fixed lengths, described by FMT messages in the file itself."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from undertow.errors import UndertowError
from undertow.typing import Array, Flags, Index

from .fieldlog import Series, steady

Bytes = NDArray[np.uint8]

# --- records --------------------------------------------------------------------------------------
HEAD = (0xA3, 0x95)
FMT, _LENGTH = 0x80, 89
_PART = 1 << 20  # bytes that are searched for heads at a time: they stay in the cache of a processor
_MAPPED = 1 << 28  # bytes from which on a file is mapped instead of read
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
        """Type of the cells of a column, and how far they stand from the begin of a message."""
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
        """Cells of a column as they stand in the file."""
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
    """Columns that are made when they are asked for, and kept; readers add what is computed from others."""

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
    for first in range(0, len(data) - 2, _PART):
        part = data[first : first + _PART + 2]
        at = np.flatnonzero(part[:-2] == HEAD[0])
        at = at[part[at + 1] == HEAD[1]]
        found.append(at[lengths[part[at + 2]] > 0] + first)
    return np.concatenate(found)


def _chained(data: Bytes, lengths: NDArray[np.int64]) -> tuple[Index, int]:
    """Begins of messages after which another begins, or the file ends, and how many stretches are damaged.

    Bytes that look like a head inside a message are none: the message before leads past them.
    """
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
        elif _is_end(data, int(ends[last])):
            keep[last + 1 :], at = False, len(heads)
        else:
            keep[last], at = False, last + 1
            damaged += 1
    return heads[keep], damaged


def _is_end(data: Bytes, place: int) -> bool:
    """Whether nothing but padding follows; memory is written in pages."""
    return place <= len(data) and len(np.unique(data[place:])) <= 1


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
    data = _bytes(path)
    kinds = _kinds(data)
    lengths = np.zeros(256, dtype=np.int64)
    lengths[list(kinds)] = [kind.length for kind in kinds.values()]
    places, damaged = _chained(data, lengths)
    skipped = len(data) - int(lengths[data[places + 2]].sum())
    notes = [f"{damaged} damaged stretches, {skipped} bytes, are left out"] if damaged else []
    rows = _rows_of(data[places + 2])
    there = {kinds[k].name: _Messages(kinds[k], places[own], data) for k, own in rows.items()}
    clocks = {
        name: _clock(m) for name, m in there.items() if m.kind.columns[:1] and m.kind.columns[0] in _CLOCKS
    }
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


def _bytes(path: Path) -> Bytes:
    """The bytes of a file; those of a large one stay on the disk until they are looked at."""
    if path.stat().st_size < _MAPPED:  # a file that is mapped must not be replaced meanwhile
        return np.fromfile(path, dtype=np.uint8)
    return np.asarray(np.memmap(path, dtype=np.uint8, mode="r"))


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


def _clock(messages: _Messages) -> Array:
    column = messages.kind.columns[0]
    return messages.numbers(column) * _CLOCKS[column]


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
    fields, units, by_number = messages.get("FMTU"), _letters(messages, "UNIT", "Label"), _numbers(messages)
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


def _numbers(messages: dict[str, _Messages]) -> dict[int, str]:
    """Names of the kinds by their number."""
    return {int(m.data[m.places[0] + 2]): name for name, m in messages.items()}


def _unit(label: str, factor: float) -> str:
    plain = _UNITS.get(label, label)
    prefix = next((p for f, p in _PREFIXES.items() if abs(factor / f - 1) < 1e-9), "")
    return f"{prefix}{plain}" if plain else ""
