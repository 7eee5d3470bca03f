"""A run in several tables, CSV or Parquet, as a vehicle writes one for each topic: a folder of them.

Every file is a series on its own clock, called by what its name does not share with the others. What columns
mean is guessed from the names of file and column. A clock is the stamp of the messages, also where seconds
and nanoseconds stand in two columns (``header.stamp.sec``), else the column that counts the time.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from undertow.errors import UndertowError, listed
from undertow.identification.logs.guess import guess_table, numbers_of, whole_table
from undertow.identification.logs.guess_clock import absolute_times, clock_of, unit_by_steps
from undertow.identification.logs.guess_names import Name, unit_of_clock
from undertow.identification.logs.mapping import SECONDS, Column
from undertow.identification.logs.run import UNITS, later_than_before
from undertow.identification.logs.table import refuse_no_file
from undertow.typing import Array

from .by_name import numbered
from .fieldlog import (
    CLOCK,
    HELD,
    FieldLog,
    Format,
    Series,
    format_of,
    from_one_begin,
    in_order,
    read_field_log,
)

ENDS = (".csv", ".csv.gz", ".parquet")
"""Ends of the names of tables."""


@dataclass(frozen=True)
class TableSettings:
    """Numbers that decide how the tables of a run are read."""

    late: float = 0.05  # share of stamps that may be no later than one before
    since: float = 1e8  # s since 1970; stamps of messages are later
    apart: float = (
        10.0  # s by which stamps may differ from the time of recording: else another clock made them
    )


SETTINGS = TableSettings()


def read_tables(files: Sequence[Path], path: Path | None = None) -> FieldLog:
    """The tables of one run; `path` is their folder.

    Raises
    ------
    UndertowError
        If none of them has a time, or all have the same columns of motions, as several runs have.
    """
    path, files = path or files[0].parent, sorted(files, key=lambda file: file.name)
    found: list[Series] = []
    reasons: list[str] = []
    for file, name in zip(files, _names(files), strict=True):
        try:
            found.append(_series(file, name))
        except UndertowError as error:
            reasons.append(f"{file.name} ({str(error).removeprefix(f'log {file}').lstrip(': ')})")
    if not found:
        raise UndertowError(f"log {path} has no table with a time: {reasons[0]}")
    _refuse_runs(path, files, found)
    series = {one.name: one for one in from_one_begin(found)}
    notes = (f"left out: {'; '.join(reasons)}",) if reasons else ()
    log = FieldLog(path, FORMAT.name, series, notes=notes, files=tuple(files), by_name=True)
    return in_order(_guessed(log))


def one_run(paths: Sequence[Path], messages: Path | None = None) -> FieldLog:
    """The log of one run, which may be several tables.

    Raises
    ------
    UndertowError
        If one of several is no table, or a single one is: that is no vehicle's own log.
    """
    if len(paths) == 1:
        return read_field_log(paths[0], messages)
    for path in paths:
        refuse_no_file(path)
        if (known := format_of(path)) is not None:
            raise UndertowError(
                f"log {path} is {known.name}, and only tables can be several files of one run: give it alone"
            )
    return read_tables(paths)


def _guessed(log: FieldLog) -> FieldLog:
    """The log with what its columns mean by their names, commands apart from motions."""
    guess = guess_table(log.beginning(), log.path, None, HELD, CLOCK)
    meaning = guess.meaning
    driving = [n for n, column in meaning.columns.items() if column.channel not in UNITS]
    columns = {n: column for n, column in meaning.columns.items() if n not in driving}
    known = {n: _plain(meaning.columns[n]) for n in driving}
    mapping = meaning.model_copy(update={"columns": columns, "ignore": ()})
    return replace(
        log, mapping=mapping, actuators=numbered(driving, columns, known), remarks=tuple(guess.asked)
    )


def _plain(column: Column) -> Column:
    return column.model_copy(update={"unit": None})


def _names(files: Sequence[Path]) -> list[str]:
    """Names of files, less the words that all of them begin or end with."""
    stems = [file.name.split(".")[0] for file in files]
    words = [re.split(r"[ _-]+", stem) for stem in stems]
    for end in (0, -1):
        while len(words) > 1 and min(map(len, words)) > 1 and len({w[end] for w in words}) == 1:
            words = [w[1:] if end == 0 else w[:-1] for w in words]
    short = ["_".join(w) for w in words]
    return short if len({*short}) == len(short) else stems


def _series(file: Path, name: str) -> Series:
    table, reading = whole_table(file)
    data = {c: values for c in table.columns if (values := numbers_of(table, c, reading)) is not None}
    stamps, parts = _stamps(data)
    try:
        clock = clock_of(table, data, f"log {file}")
    except UndertowError:
        if stamps is None:
            raise
        return Series(name, stamps, _without(data, parts))
    t = absolute_times(table, data, clock, f"log {file}")
    if stamps is not None and abs(float(np.nanmedian(stamps - t))) < SETTINGS.apart:
        return Series(name, stamps, _without(data, {*parts, clock.column}))
    return Series(name, t, _without(data, {clock.column}))


def _without(data: Mapping[str, Array], names: Iterable[str]) -> dict[str, Array]:
    left = {*names}
    return {name: values for name, values in data.items() if name not in left}


def _stamps(data: Mapping[str, Array]) -> tuple[Array | None, tuple[str, ...]]:
    """Times, s, of stamps of messages, since 1970, and the columns that they are in; None without any."""
    for columns in (*_seconds_and_nanoseconds(data), *((n,) for n in data if "stamp" in Name.of(n).words)):
        whole, *parts = (data[n] for n in columns)
        t = whole + 1e-9 * parts[0] if parts else whole * SECONDS[_unit(columns[0], whole)]
        there = t[np.isfinite(t)]
        rises = len(there) > 1 and np.mean(later_than_before(there)) > 1.0 - SETTINGS.late
        if rises and there[0] > SETTINGS.since:
            return t, columns
    return None, ()


def _seconds_and_nanoseconds(data: Mapping[str, Array]) -> Iterator[tuple[str, str]]:
    """Columns that are alike but for these words."""
    for name in data:
        if found := re.fullmatch(r"(.*?)(?:secs?|seconds)", name):
            others = (found[1] + end for end in ("nanosec", "nsec", "nsecs", "nanosecs", "nanoseconds"))
            yield from ((name, other) for other in others if other in data)


def _unit(name: str, stamps: Array) -> str:
    return unit_of_clock(name) or unit_by_steps(stamps, float(np.nanmedian(np.diff(stamps))))


def _refuse_runs(path: Path, files: Sequence[Path], found: Sequence[Series]) -> None:
    """Refuse tables that are runs of their own: all with the same columns, and motions among them."""
    alike = all({*a.columns} == {*b.columns} for a, b in pairwise(found))
    moving = [column for column in found[0].columns if Name.of(column).motion()]
    if len(found) > 1 and alike and moving:
        raise UndertowError(
            f"log {path}: {listed([file.name for file in files])} have the same columns ({listed(moving)}), "
            "as several runs have: give each of them as a log, or only the files of one run"
        )


def tables_in(folder: Path) -> list[Path]:
    """The tables of a folder, in the order of their names."""
    return sorted(file for file in folder.iterdir() if file.is_file() and file.name.lower().endswith(ENDS))


def _read(path: Path, messages: Path | None) -> FieldLog:
    return read_tables(tables_in(path), path)


def _accepts(path: Path, head: bytes) -> bool:
    return not head and path.is_dir() and bool(tables_in(path))


FORMAT = Format("tables of one run", ("folder of .csv or .parquet",), _accepts, _read)
