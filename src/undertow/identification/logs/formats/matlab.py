"""MATLAB: .mat of all versions, with tables, timetables and timeseries, by mat-io.

The workspace and every struct in it are series: vectors as long as a vector of time are their columns. A
struct without its own time uses that of its parent. Columns of matrices are numbered from one as in MATLAB
(``u1``), or named by axis where they are three or six (``pos_x``, ``eta_psi``). What they mean is guessed
from their names.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from undertow.errors import UndertowError, listed
from undertow.identification.logs.guess_names import Name, is_time, unit_of_clock
from undertow.identification.logs.guess_rows import unit_by_steps
from undertow.identification.logs.mapping import SECONDS
from undertow.identification.logs.table import has_dates, seconds
from undertow.typing import Array

from .by_name import LINEAR, SIX, TURNED, guessed, names_of_columns, one_after_the_other
from .fieldlog import SETTINGS as UNION
from .fieldlog import FieldLog, Format, Series, from_one_begin, library, on_clocks

_WORKSPACE = "workspace"
_ITSELF = {"values", "value", "data"}  # a member that is what its struct is called


@dataclass(frozen=True)
class MatlabSettings:
    """Numbers that decide what of a file is read."""

    # Share of the samples of the shortest clock from which a variable is a measurement, not a setting.
    run: float = 0.5
    # Numbers of days that are dates (datenum): from 1970 to 2100.
    dates: tuple[float, float] = (719_529.0, 767_011.0)
    longest: float = 366.0  # days that a log with such numbers may last


SETTINGS = MatlabSettings()


def _read(path: Path, messages: Path | None) -> FieldLog:
    matio = library("matio", "a file of MATLAB")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what it cannot read is reported below
        raw = matio.load_from_mat(str(path), spmatrix=False)
    objects: list[str] = []
    content = {n: _to_python(value, n, objects) for n, value in raw.items() if not n.startswith("__")}
    notes = _on_objects(objects)
    untimed: list[str] = []
    found = list(_series(_WORKSPACE, content, {}, untimed))
    if not found:
        texts = [n for n, v in content.items() if is_time(n) and isinstance(v, list) and not _is_run(v[0])]
        notes += [f"{n} holds texts that are no dates: save it as numbers, in s" for n in texts]
        what = f" {notes[0]}" if notes else ""
        names = ", ".join(content) or "nothing"
        raise UndertowError(
            f"log {path} has no time vector with other vectors of the same length (it has {names}): call "
            f"one of them time or t.{what}"
        )
    notes += on_clocks(found)
    found, parts, runs = one_after_the_other(from_one_begin(found))
    mapping, actuators, questions = guessed(path, found, intervals=parts)
    series = {one.name: one for one in found}
    if untimed:
        were = "was" if len(untimed) == 1 else "were"
        notes.append(f"no time has as many samples as {listed(untimed)}, which {were} left out")
    about, asked = (*notes, *runs), tuple(questions)
    return FieldLog(path, FORMAT.name, series, mapping, actuators, {}, parts, about, asked, by_name=True)


def _on_objects(names: Sequence[str]) -> list[str]:
    """One note on objects that only MATLAB can read."""
    if not names:
        return []
    them, one = ("it as a struct", "is an object") if len(names) == 1 else ("them as structs", "are objects")
    how = f"a table or timetable by S = table2struct(timetable2table({names[0]}), 'ToScalar', true)"
    return [f"{listed(names)} {one} of MATLAB: save {them}, {how}"]


# --- from the file to names and arrays ------------------------------------------------------------
def _to_python(value: Any, name: str, objects: list[str]) -> Any:
    """Structs and tables as dictionaries, cells as lists, vectors flat; objects are `objects` by name."""
    if hasattr(value, "columns"):
        return _members(value)
    if getattr(value, "classname", "") == "timeseries":
        return _of_timeseries(value.properties)
    if not isinstance(value, np.ndarray):
        objects.append(name)
        return None
    cells = value.ravel(order="F")
    label = name if value.size == 1 else f"{name}({{}})"
    if value.dtype.names:
        fields = value.dtype.names
        found: list[Any] = [
            {f: _to_python(e, f"{label.format(k)}.{f}", objects) for f, e in zip(fields, one, strict=True)}
            for k, one in enumerate(cells, 1)
        ]
    elif value.dtype.kind == "O":
        found = [_to_python(one, label.format(k), objects) for k, one in enumerate(cells, 1)]
    else:
        found = [*cells] if value.dtype.kind == "U" else [np.squeeze(value)]
    dates = _in_seconds_since_1970(name.rsplit(".", 1)[-1], found)
    return dates if dates is not None else found[0] if len(found) == 1 else found


def _in_seconds_since_1970(name: str, cells: Sequence[Any]) -> Array | None:
    """Dates with the time of day, as texts, by a name for times; None for others."""
    texts = [str(cell) for cell in cells if np.ndim(cell) == 0 and np.asarray(cell).dtype.kind == "U"]
    if len(texts) != len(cells) or len(texts) < 2 or not is_time(name):
        return None
    stamps = pl.DataFrame({name: texts})
    try:
        return seconds(stamps, name, name, Decimal(0))[0] if has_dates(stamps[name]) else None
    except UndertowError:  # the log may have another time
        return None


def _members(frame: Any) -> dict[str, Any]:
    """Columns of a table of pandas; the time of its rows, or its only column of times, is called time."""
    columns = {"time": frame.index.to_numpy()} if frame.index.dtype.kind in "mM" else {}
    columns |= {str(name): frame[name].to_numpy() for name in frame}
    stamped = [name for name, cells in columns.items() if cells.dtype.kind in "mM"]
    if len(stamped) == 1 and not any(map(is_time, columns)):
        columns["time"] = columns.pop(stamped.pop())
        stamped.append("time")
    columns |= {name: _in_seconds(columns[name]) for name in stamped}
    return _joined(columns)


def _of_timeseries(parts: Mapping[str, Any]) -> dict[str, Any]:
    """Time and data of a timeseries, as Simulink and the toolbox for ROS make them."""
    # The latter keeps the names of fields of messages as `UserData`.
    clock = parts["TimeInfo"].properties
    t = np.ravel(clock["Time_"])
    if not t.size:
        t = _first(clock["Start_"], 0.0) + _first(clock["Increment_"], 1.0) * np.arange(
            _first(clock["Length"], 0.0)
        )
    unit = unit_of_clock(f"time ({_first(clock['Units'], 'seconds')})") or "s"
    data = np.asarray(parts["Data_"])
    data = data if _first(parts["IsTimeFirst_"], True) else np.moveaxis(data, -1, 0)
    flat = data.reshape(len(data), -1)
    cells = parts["DataInfo"].properties.get("UserData", np.zeros(0))
    names = [str(_first(cell, "")) for cell in cells.ravel()] if cells.dtype.kind == "O" else []
    named = (
        dict(zip(names, flat.T, strict=True)) if len(names) == flat.shape[1] else {"data": np.squeeze(flat)}
    )
    return {"time (s)": SECONDS[unit] * t, **named}


def _first(value: Any, otherwise: Any) -> Any:
    """The first element of an array, if there is one."""
    cells = np.ravel(value)
    return cells[0] if cells.size else otherwise


def _joined(columns: dict[str, Any]) -> dict[str, Any]:
    """Variables of several columns put together again, which mat-io numbers (``eta_1`` …)."""
    for first in [name for name in columns if name.endswith("_1")]:
        base = first[:-2]
        width = 6 if base.lower() in SIX else 3 if {*Name.of(base).words} & (TURNED | LINEAR) else 0
        parts = [f"{base}_{k}" for k in range(1, width + 1)]
        if parts and all(part in columns for part in parts):
            columns[base] = np.column_stack([columns.pop(part) for part in parts])
    return columns


def _in_seconds(times: Any) -> Array:
    """Durations, or dates since 1970, s; NaN for none."""
    ns = times.astype(f"{times.dtype.kind}8[ns]")
    return np.where(np.isnat(ns), np.nan, ns.astype(np.int64) * 1e-9)


# --- from names and arrays to series --------------------------------------------------------------
def _series(
    name: str, members: Mapping[str, Any], clocks: Mapping[int, Array], untimed: list[str]
) -> Iterator[Series]:
    """Series of a struct and of those in it; `clocks` are the times of what it is in, by their number."""
    # Variables as long as a run that have no such time are added to `untimed`, with their samples.
    arrays = {n: a for n, value in members.items() if (a := _numbers(value)) is not None}
    times = {n: t for n, a in arrays.items() if is_time(n) and (t := _seconds(n, a)) is not None}
    own = {len(t): t for t in reversed(times.values())}
    known = {**clocks, **own}
    by_length: dict[int, dict[str, Array]] = {}
    for field, array in arrays.items():
        if field not in times:
            called = name.rsplit(".", 1)[-1] if field.lower() in _ITSELF and name != _WORKSPACE else field
            length, columns = _columns(called, array, known)
            by_length.setdefault(length, {}).update(columns)
    several = sum(length in known for length in by_length) > 1
    shortest = SETTINGS.run * min(known, default=np.inf)
    untimed += [
        f"{n} ({k})" for k, columns in by_length.items() if k not in known and k > shortest for n in columns
    ]
    for length, columns in by_length.items():
        if length in known and columns:
            yield Series(f"{name}[{length}]" if several else name, known[length], columns)
    inside = name if name != _WORKSPACE else ""
    structs = [one for field, value in members.items() for one in _structs(field, value)]
    for label, struct in (*structs, *_cells(members)):
        yield from _series(f"{inside}.{label}" if inside else label, struct, known, untimed)


def _structs(name: str, value: Any) -> list[tuple[str, dict[str, Any]]]:
    """Structs in a member: itself, or the elements of an array of structs, counted from one."""
    if isinstance(value, dict):
        return [(name, value)]
    if isinstance(value, list):
        return [(f"{name}({k})", one) for k, one in enumerate(value, 1) if isinstance(one, dict)]
    return []


def _cells(members: Mapping[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    """Runs whose vectors are elements of cell arrays, as structs, counted from one."""
    lists = {n: v for n, v in members.items() if isinstance(v, list) and all(map(_is_run, v))}
    counts = Counter(len(v) for v in lists.values())
    most = max(counts, key=lambda count: counts[count], default=0)
    return [(f"run({k + 1})", {n: v[k] for n, v in lists.items() if len(v) == most}) for k in range(most)]


def _is_run(value: Any) -> bool:
    """Whether it may be what was measured in a run: more numbers than a name has."""
    return isinstance(value, np.ndarray) and value.dtype.kind in "biuf" and value.size > 1


def _numbers(value: Any) -> Array | None:
    """Vectors and matrices of real numbers."""
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "biuf" or value.ndim not in (1, 2):
        return None
    return value.astype(np.float64) if value.size > 1 else None


def _seconds(name: str, values: Array) -> Array | None:
    """A vector of time, s; None for what does not rise."""
    t = np.squeeze(values)
    there = t[np.isfinite(t)] if t.ndim == 1 else t[:0]  # a sample without a time is left out later
    if len(there) < 2 or np.any(np.diff(there) < 0) or there[-1] <= there[0]:
        return None
    if SETTINGS.dates[0] < there[0] < SETTINGS.dates[1] and there[-1] - there[0] < SETTINGS.longest:
        return (t - there[0]) * 86400.0
    return t * SECONDS[unit_of_clock(name) or unit_by_steps(there, float(np.median(np.diff(there))))]


def _columns(name: str, array: Array, clocks: Mapping[int, Array]) -> tuple[int, dict[str, Array]]:
    """Columns of a vector or matrix, which may lie on its side, and how many samples they have."""
    if array.ndim == 1:
        return len(array), {name: array}
    upright = array if array.shape[0] in clocks or array.shape[1] not in clocks else array.T
    rows, width = upright.shape
    if width > UNION.widest:
        return rows, {}
    return rows, dict(zip(names_of_columns(name, width), upright.T, strict=True))


def _accepts(path: Path, head: bytes) -> bool:
    return head.startswith(b"MATLAB ") or (path.suffix == ".mat" and bool(head))


FORMAT = Format("MATLAB", (".mat",), _accepts, _read, hangs=True)
