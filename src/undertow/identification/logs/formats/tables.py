"""A run in several tables, CSV or Parquet, one for each topic: a folder of them.

Every file is a series on its own clock, named by the part of its name that the others do not share. The
meaning of columns is guessed from the names of file and column. The clock is the stamp of the messages, also
with seconds and nanoseconds in two columns (``header.stamp.sec``), else the time column.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from os.path import commonpath
from pathlib import Path

import numpy as np

from undertow.errors import UndertowError, listed
from undertow.identification.logs.guess import guess_table
from undertow.identification.logs.guess_names import Name, unit_of_clock
from undertow.identification.logs.guess_rows import SETTINGS as CLOCKS
from undertow.identification.logs.guess_rows import (
    absolute_times,
    clock_of,
    columns_of,
    halves_of_stamps,
    number_of_things,
    numbers_of,
    unit_by_steps,
    unit_in,
    with_nanoseconds,
)
from undertow.identification.logs.guess_text import whole_table
from undertow.identification.logs.mapping import SECONDS, name_of_log
from undertow.identification.logs.run import UNITS, later_than_before
from undertow.identification.logs.table import WHOLE, lacking_zeros
from undertow.typing import Array

from .by_name import ANGULAR, CLOCK, has_motion, numbered
from .fieldlog import HELD, FieldLog, Format, Series, from_one_begin, on_clocks
from .fieldlog import SETTINGS as UNION
from .offsets import questions_on_clocks

ENDS = (".csv", ".csv.gz", ".parquet")
"""Ends of the names of tables."""


@dataclass(frozen=True)
class TableSettings:
    """Limits on the tables of a run."""

    quarter: float = 900.0  # s; clocks of two time zones differ by a multiple of it
    named: int = 3  # how many of the files left out are named
    deep: int = 4  # depth of nested folders that is searched


SETTINGS = TableSettings()


def read_tables(files: Sequence[Path], path: Path | None = None) -> FieldLog:
    """The tables of one run; `path` is their folder. Those of several runs are refused."""
    path, files = path or Path(commonpath([file.parent for file in files])), sorted(files)
    found: list[Series] = []
    reasons: list[str] = []
    lacking: list[str] = []
    for file, name in zip(files, _names(files, path), strict=True):
        try:
            series, notes = _series(file, name)
            found.append(series)
            lacking += notes
        except UndertowError as error:
            said = str(error).removeprefix(f"log {file}").lstrip(": ")
            reason = re.split(r": |; ", said)[0].removeprefix("is ")
            reasons.append(f"{file.relative_to(path)} ({reason})")
    if not found:
        raise UndertowError(f"log {path} has no table with a time: {reasons[0]}")
    _refuse_runs(path, files, found)
    found = [part for one in found for part in _instances(one)]
    clocks, found = on_clocks(found), from_one_begin(found)
    _refuse_apart(path, found)
    by_name = {one.name: one for one in found}
    more = len(reasons) - SETTINGS.named
    named = reasons[: SETTINGS.named] + [f"and {more} more"] * (more > 0)
    remarks = (*clocks, *_beside(found), *((f"left out: {', '.join(named)}",) if reasons else ()))
    if lacking:
        others = f"; so do {len(lacking) - 1} more tables" if len(lacking) > 1 else ""
        remarks = (f"{lacking[0]}{others}", *remarks)
    log = FieldLog(path, FORMAT.name, by_name, notes=remarks, files=tuple(files), by_name=True)
    return _guessed(log)


def _guessed(log: FieldLog) -> FieldLog:
    """The log with the meaning of its columns guessed from their names, commands apart from motions."""
    guess = guess_table(log.beginning(), log.path, None, HELD, CLOCK, log.units)
    meaning = guess.meaning
    driving = [n for n, column in meaning.columns.items() if column.channel not in UNITS]
    columns = {n: column for n, column in meaning.columns.items() if n not in driving}
    motors = [n for n in driving if meaning.columns[n].unit not in ANGULAR]
    known = {n: meaning.columns[n].model_copy(update={"unit": None}) for n in motors}
    mapping = meaning.model_copy(update={"columns": columns, "ignore": ()})
    return replace(
        log,
        mapping=mapping,
        actuators=numbered(motors, columns, known),
        remarks=(*guess.asked, *questions_on_clocks(log, mapping)),
    )


def _names(files: Sequence[Path], folder: Path) -> list[str]:
    """Names of files with their folders, or without the words that all names begin or end with."""
    inside = [file.relative_to(folder) for file in files]
    stems = [".".join((*one.parts[:-1], name_of_log(one))) for one in inside]
    words = [re.split(r"[ _-]+", stem) for stem in stems]
    for end in (0, -1):
        while len(words) > 1 and min(map(len, words)) > 1 and len({w[end] for w in words}) == 1:
            words = [w[1:] if end == 0 else w[:-1] for w in words]
    short = ["_".join(w) for w in words]
    flat = all(len(one.parts) == 1 for one in inside)
    return short if flat and len({*short}) == len(short) else stems


def _series(file: Path, name: str) -> tuple[Series, list[str]]:
    """A table on its own clock, and notes on time stamps that are read otherwise than written."""
    table, reading = whole_table(file)
    data = {c: values for c in table.columns if (values := numbers_of(table, c, reading)) is not None}
    units = {c: unit for c in data if (unit := unit_in(table, c, reading))}
    stamps, parts = _stamps(data)
    try:
        clock = clock_of(table, data, f"log {file}")
    except UndertowError:
        if stamps is None:
            raise
        return Series(name, stamps, _without(data, parts), units), []
    t = absolute_times(table, data, clock, f"log {file}")
    if stamps is not None:
        # The recording may count in local time, as the other tables of the run do.
        late = float(np.nanmedian(t - stamps))
        zone = SETTINGS.quarter * round(late / SETTINGS.quarter)
        if abs(late - zone) < UNION.apart:
            return Series(name, stamps + zone, _without(data, {*parts, *columns_of(clock)}), units), []
    return Series(name, t, _without(data, columns_of(clock)), units), lacking_zeros(table, clock.column)


def _without(data: Mapping[str, Array], names: Iterable[str]) -> dict[str, Array]:
    left = {*names}
    return {name: values for name, values in data.items() if name not in left}


def _stamps(data: Mapping[str, Array]) -> tuple[Array | None, tuple[str, ...]]:
    """Times of message stamps, s since 1970, and the columns that they are in; None without any."""
    halves = halves_of_stamps(data)
    for name, counted in with_nanoseconds(data, halves).items():
        if name not in halves and "stamp" not in Name.of(name).words:
            continue
        there = counted[np.isfinite(counted)]
        if len(there) < 2 or np.mean(later_than_before(there)) <= 1.0 - CLOCKS.late:
            continue
        unit = "s" if name in halves else unit_of_clock(name)
        unit = unit or unit_by_steps(there, float(np.nanmedian(np.diff(there))))
        t = counted * SECONDS[unit]
        if np.nanmin(t) > WHOLE.own_clock:
            return t, (name, halves[name]) if name in halves else (name,)
    return None, ()


def _refuse_runs(path: Path, files: Sequence[Path], found: Sequence[Series]) -> None:
    """Refuse tables that are separate runs: all with the same columns, and motions among them."""
    alike = all({*a.columns} == {*b.columns} for a, b in pairwise(found))
    moving = [column for column in found[0].columns if Name.of(column).motion()]
    if len(found) > 1 and alike and moving:
        raise UndertowError(
            f"log {path}: {listed([file.name for file in files])} have the same columns ({listed(moving)}), "
            "so they are separate runs: give each as a log, or only the files of one run"
        )


def _refuse_apart(path: Path, found: Sequence[Series]) -> None:
    """Refuse tables with motions that do not overlap in time: they are separate runs."""
    moving = filter(has_motion, found)
    spans = sorted((float(np.nanmin(one.t)), float(np.nanmax(one.t)), one.name) for one in moving)
    for place, (begin, _, after) in enumerate(spans[1:], start=1):
        _, end, before = max(spans[:place], key=lambda span: span[1])
        if begin > end:
            raise UndertowError(
                f"log {path}: table {before!r} ends {begin - end:.3g} s before {after!r} begins: they are "
                "separate runs, or on clocks that do not begin together; give the tables of each as one log"
            )


def _instances(one: Series) -> list[Series]:
    """A series for each of several things whose rows take turns in a table, by the number of each."""
    name = number_of_things(one.columns)
    if not name:
        return [one]
    numbers = one.columns[name]
    rows = {f"{one.name}[{k:g}]": numbers == k for k in np.unique(numbers[np.isfinite(numbers)])}
    columns = {n: values for n, values in one.columns.items() if n != name}
    return [
        replace(one, name=each, t=one.t[own], columns={n: c[own] for n, c in columns.items()})
        for each, own in rows.items()
    ]


def _beside(found: Sequence[Series]) -> list[str]:
    """Notes on tables that have no time in common with the motions."""
    spans = [(float(np.nanmin(one.t)), float(np.nanmax(one.t))) for one in found if has_motion(one)]
    if not spans:
        return []
    first, last = min(a for a, _ in spans), max(b for _, b in spans)
    late = {one.name: float(np.nanmin(one.t)) - last for one in found}
    early = {one.name: first - float(np.nanmax(one.t)) for one in found}
    notes = [f"{name} begins {by:.3g} s after the motions end" for name, by in late.items() if by > 0]
    notes += [f"{name} ends {by:.3g} s before the motions begin" for name, by in early.items() if by > 0]
    return [
        f"{note}: is it of this run? If so, a delay of its columns puts its clock right" for note in notes
    ]


def tables_in(folder: Path, deep: int = SETTINGS.deep) -> list[Path]:
    """The tables of a folder and of those in it, in the order of their names."""
    inside = sorted(folder.iterdir())
    found = [file for file in inside if file.name.lower().endswith(ENDS) and file.is_file()]
    folders = [one for one in inside if deep > 1 and one.is_dir() and not one.name.startswith(".")]
    return sorted([*found, *(file for one in folders for file in tables_in(one, deep - 1))])


def _read(path: Path, messages: Path | None) -> FieldLog:
    files = tables_in(path)
    _refuse_folders(path, files)
    return read_tables(files, path)


def _refuse_folders(path: Path, files: Sequence[Path]) -> None:
    """Refuse a folder of folders with files of the same names: each is a separate run."""
    inside = [file.relative_to(path) for file in files]
    names: dict[str, set[Path]] = {}
    for one in inside:
        names.setdefault(one.parts[0], set()).add(Path(*one.parts[1:]))
    apart = all(len(one.parts) > 1 for one in inside) and len(names) > 1
    if apart and len(set.union(*names.values())) < 2 * min(map(len, names.values())):
        raise UndertowError(
            f"log {path}: its folders {listed(sorted(names))} have files of the same names, so they are "
            "separate runs: give each as a log"
        )


def _accepts(path: Path, head: bytes) -> bool:
    return not head and path.is_dir() and bool(tables_in(path))


FORMAT = Format("tables of one run", ("folder of .csv or .parquet",), _accepts, _read, together=read_tables)
