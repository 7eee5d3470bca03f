"""A long log in parts that overlap, so that it is never in memory as a whole."""

from __future__ import annotations

import gzip
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice, takewhile
from pathlib import Path
from typing import IO, NamedTuple

import numpy as np
import polars as pl
from numpy.typing import NDArray

from undertow.errors import UndertowError
from undertow.files import file_hash

from . import opening
from .cells import below
from .formats.fieldlog import Window
from .mapping import CommandPolicy, LogMapping, name_of_log
from .opening import FieldLogs
from .reading import decimated, run_of_table
from .run import Run, later_than_before
from .table import (
    DAMAGED,
    WHOLE,
    Origin,
    columns_of,
    flat_table,
    header_of,
    is_gzip,
    is_parquet,
    joined_rows,
    parquet_size,
    read_rows,
    read_table,
    refuse_no_file,
    size_of,
    with_even_times,
)


@dataclass(frozen=True)
class ExcerptSettings:
    """How much of a file is read to estimate its size, and for an excerpt."""

    line_sample: int = 1 << 18  # bytes from which the length of a line is estimated
    most_skipped_rows: int = 100  # between two rows of an excerpt (`every`)


EXCERPTS = ExcerptSettings()


class NeedsWhole(UndertowError):
    """The requested operation cannot be done in parts."""


class LogPart(NamedTuple):
    """Part of a long log."""

    run: Run  # its samples within the window
    # Time in the middle of the rows that it shares with the next part, s; also of those outside the window,
    # so that both parts extend beyond it as far as the window does.
    border: float


@dataclass(frozen=True)
class LongLog:
    """A log, or one of its segments, that is read in parts."""

    path: Path  # the file
    mapping: LogMapping
    commands: tuple[str, ...]  # names of commands that are read where the log has them
    window: Window = (None, None)  # part that is used, s; None: no limit
    missing_commands: CommandPolicy | None = None  # what to do where a command has no sample
    required: bool = False  # whether a log without one of the commands is refused
    # Its rows, where they are not those of the file: a segment, or the table of a vehicle's own log.
    table: pl.LazyFrame | None = None
    stretch: int = 0  # which segment it is, counted from one; 0 for a whole log
    reader_notes: tuple[str, ...] = ()  # as of a run: empty for a table

    @property
    def name(self) -> str:
        """Name of the log, with the number of the segment."""
        return name_of_log(self.path) + (f"-{self.stretch}" if self.stretch else "")

    @cached_property
    def sha256(self) -> str:
        """SHA-256 of the bytes of the file."""
        return file_hash(self.path)

    @property
    def in_memory(self) -> bool:
        """Whether its rows are in memory: a native vehicle log is read as a whole."""
        return bool(self.reader_notes)

    @property
    def _where(self) -> str:
        return f"log {self.path}"

    def parts(self, rows: int, overlap: int) -> Iterator[LogPart]:
        """Parts of `rows` rows, each beginning with the last `overlap` rows of the one before."""
        self._refuse_no_file()
        origin: Origin | None = None
        last: Run | None = None
        low, high = (w if w is not None else e * np.inf for w, e in zip(self.window, (-1, 1), strict=True))
        latest = -np.inf
        tables, every = self._all_rows(rows, overlap), self.mapping.time.every
        if every > 1 or not overlap:
            joined = _joined(self._all_rows(rows, 0), self.mapping.time.columns)
            tables = _overlapping(decimated(joined, every), rows, overlap) if every > 1 else joined
        for table in tables:
            if origin is None:
                origin = self._origin(table)
            t, lost = opening.times_of(table, self.mapping, self._where, origin)[0], 0
            if not overlap:
                later = self._later(t, latest)
                table, t, lost = table.filter(later), t[later], int(np.sum(~later))
                latest = float(np.fmax(latest, np.fmax.reduce(t, initial=-np.inf)))
            elif len(t):  # day and month of dates may be read in another order than before
                self._later(t, latest)
                latest = float(t[0])
            inside = t[(t >= low) & (t <= high)]
            if len(inside) > 1:
                before: dict[str, float] = {}  # last values of all channels before these rows
                if last is not None and (count := int(np.searchsorted(last.t, float(inside[0])))):
                    before = {name: float(data[count - 1]) for name, data in last.channels.items()}
                last = self._run(table, origin, before)
                last = replace(last, dropped=last.dropped + lost)
                shared = min(max(overlap // 2, 1), len(t))
                yield LogPart(last, float(np.fmax.accumulate(t)[-shared]))

    @cached_property
    def size(self) -> tuple[int, int]:
        """Rows, before `every`, and columns: known of a Parquet file, estimated from the lines of a text.

        Only the first lines or last bytes of the log are read.
        """
        self._refuse_no_file()
        if self.table is not None:
            count = self.table.select(pl.len()).collect(engine="streaming").item()
            return int(count), len(self.table.collect_schema())
        begin = self._first_bytes
        if is_parquet(begin):
            rows, kinds = parquet_size(self.path, self._where)
            return rows, len(kinds)
        with _opened(self.path, self._where, packed=is_gzip(begin)) as file:
            text = file.read(EXCERPTS.line_sample)
        if b"\0" in text:
            raise UndertowError(f"{self._where} is not text: give a CSV, CSV.gz or Parquet file")
        lines = text.split(b"\n")
        whole = size_of(self.path)
        length = np.mean([len(line) + 1 for line in lines[:-1]] or [max(whole, 1)])
        return int(whole / length), columns_of(
            header_of(below(text, self.mapping.skip), self.mapping), self.mapping
        )

    def segments(self, column: str) -> list[pl.LazyFrame]:
        """The segments of its file: lazily of a Parquet file, in memory of a text."""
        if not is_parquet(self._first_bytes):
            parts = opening.segments_in(
                opening.opened_table(self.path, self.mapping).table, column, self._where
            )
            return [part.lazy() for part in parts]
        opening.must_have(column, self._flat.collect_schema().names(), self._where, "column of segments,")
        row = pl.col("row")
        ranges = (
            self._flat.select(column).with_row_index("row").drop_nulls().group_by(column)
            .agg(row.min().alias("first"), (row.max() + 1).alias("stop"), pl.len().alias("rows"))
            .sort("first").collect(engine="streaming")
        )  # fmt: skip
        if not ranges.height:
            raise UndertowError(opening.no_segment(column, self._where))
        found = []
        for number, first, stop, rows in ranges.iter_rows():
            # Where the rows of a segment are contiguous, no others are read.
            between = self._flat.slice(first, stop - first)
            own = between if rows == stop - first else between.filter(pl.col(column) == number)
            found.append(own.drop(column))
        return found

    def excerpts(self, count: int, rows: int) -> Iterator[Run]:
        """Some rows from several places along the log; those that cannot be read are left out."""
        rows *= min(self.mapping.time.every, EXCERPTS.most_skipped_rows)
        for table in self._excerpt_tables(count, rows):
            try:
                origin = self._origin(table)
                yield run_of_table(
                    table, self.path, self.mapping, (), (None, None), "gap", self.commands, origin, {}
                )
            except UndertowError:
                continue

    def _excerpt_tables(self, count: int, rows: int) -> Iterator[pl.DataFrame]:
        if self._random_access:
            for first in np.unique(np.linspace(0, max(self.size[0] - rows, 0), count).astype(int)):
                yield read_rows(self._flat, int(first), rows, self._where)
            return
        with _opened(self.path, self._where, packed=is_gzip(self._first_bytes)) as file:
            header, size = self._header(_lines(file, self._where)), size_of(self.path)
            for place in np.linspace(file.tell(), size, count, endpoint=False).astype(int).tolist():
                if place > file.tell():
                    file.seek(place - 1)
                    file.readline(WHOLE.line)
                lines = list(islice(_lines(file, self._where), rows))
                if lines:
                    table = read_table(header + b"".join(lines), self._of_rows, self._where)
                    yield with_even_times(table, self.mapping)

    def _later(self, t: NDArray[np.float64], latest: float) -> NDArray[np.bool_]:
        """Which rows are in order, also with those of the parts before; others are refused, or left out."""
        if self.mapping.time.disorder == "drop":
            return later_than_before(t) & ~(t <= latest)
        if len(t) and t[0] <= latest:
            raise UndertowError(
                f"{self._where}: time column {self.mapping.time.column!r} goes back from {latest:.9g} to "
                f"{t[0]:.9g} s: sort the file by time, or split it where the clock was restarted"
            )
        return np.ones(len(t), dtype=bool)

    def _run(self, table: pl.DataFrame, origin: Origin, before: dict[str, float]) -> Run:
        every = self.mapping.time.every
        mapping = self.mapping.model_copy(update={"time": self.mapping.time.model_copy(update={"every": 1})})
        needed, also = (self.commands, ()) if self.required else ((), self.commands)
        fill = self.missing_commands
        run = run_of_table(table, self.path, mapping, needed, self.window, fill, also, origin, before)
        if self.stretch:
            run = replace(run, name=self.name, part_of=run.name)
        run = replace(run, mapping=self.mapping, reader_notes=self.reader_notes)
        return run.with_notes(f"one row in {every} used") if every > 1 else run

    def _origin(self, table: pl.DataFrame) -> Origin:
        for name in self.mapping.time.columns:
            opening.must_have(name, table.columns, self._where, "time column")
        rows = table if opening.is_dated(table, self.mapping) else table.head(1)
        return opening.times_of(rows, self.mapping, self._where)[1]

    def _refuse_no_file(self) -> None:
        if self.table is None:
            refuse_no_file(self.path)

    def _all_rows(self, rows: int, overlap: int) -> Iterator[pl.DataFrame]:
        """Tables of all rows, whatever `every` says."""
        if not self._random_access:
            yield from self._text_tables(rows, overlap, packed=is_gzip(self._first_bytes))
            return
        first = 0
        while True:
            table = read_rows(self._flat, first, rows, self._where)
            if first and table.height <= overlap:
                return
            yield table
            first += rows - overlap

    @cached_property
    def _first_bytes(self) -> bytes:
        with self.path.open("rb") as file:
            return file.read(4)

    @property
    def _random_access(self) -> bool:
        """Whether rows can be read without those before."""
        return self.table is not None or is_parquet(self._first_bytes)

    @cached_property
    def _flat(self) -> pl.LazyFrame:
        if self.table is not None:
            return self.table
        return with_even_times(flat_table(self.path, self._where), self.mapping)

    def _text_tables(self, rows: int, overlap: int, *, packed: bool) -> Iterator[pl.DataFrame]:
        with _opened(self.path, self._where, packed=packed) as file:
            stream = _lines(file, self._where)
            header = self._header(stream)
            kept: list[bytes] = []
            first = 0
            while new := list(islice(stream, rows - len(kept))):
                lines = kept + new
                table = read_table(header + b"".join(lines), self._of_rows, self._where)
                yield with_even_times(table, self.mapping, first)
                kept = lines[-overlap:] if overlap else []
                first += table.height - len(kept)

    @property
    def _of_rows(self) -> LogMapping:
        """The mapping of rows with the header, without the lines above it."""
        return self.mapping.model_copy(update={"skip": 0})

    def _header(self, lines: Iterator[bytes]) -> bytes:
        rest = islice(lines, self.mapping.skip, None)
        if header := next((line for line in rest if header_of(line, self.mapping)), b""):
            return header
        raise UndertowError(f"{self._where} is empty (no header): check that it is complete")


def long_logs(
    path: Path,
    mapping: LogMapping | None,
    commands: Sequence[str] = (),
    window: Window = (None, None),
    missing_commands: CommandPolicy | None = None,
    *,
    required: bool = False,
    field_logs: FieldLogs | None = None,
) -> list[LongLog]:
    """A log of any format to be read in parts: one `LongLog` for each of its segments.

    Tables stay on the disk, except for texts of several segments; of a vehicle's own log the columns that
    are read are held. `field_logs` has those that are open already; others are added.
    """
    names = tuple(commands)
    log = opening.field_log(path, mapping, field_logs)
    if log is not None:
        needed, also = (names, ()) if required else ((), names)
        found = opening.opened_field_log(log, mapping, needed, also, window)
        whole = LongLog(path, found.mapping, names, window, missing_commands, required)
        parts = opening.segments_in(found.table, found.mapping.time.stretch, f"log {path}")
        return _numbered(replace(whole, reader_notes=found.notes), [part.lazy() for part in parts])
    whole = LongLog(path, mapping or LogMapping(), names, window, missing_commands, required)
    column = whole.mapping.time.stretch
    if column is None or not path.is_file():
        return [whole]
    return _numbered(whole, whole.segments(column))


def _numbered(whole: LongLog, parts: Sequence[pl.LazyFrame]) -> list[LongLog]:
    if len(parts) == 1:
        return [replace(whole, table=parts[0])]
    return [replace(whole, table=part, stretch=k) for k, part in enumerate(parts, 1)]


def _joined(tables: Iterable[pl.DataFrame], clock: Sequence[str]) -> Iterator[pl.DataFrame]:
    """Consecutive tables, with the rows of one time as one (`joined_rows`), also across their borders."""
    last: pl.DataFrame | None = None
    for part in tables:
        count = 0 if last is None else _rows_at_end_of(last, part, clock)
        if last is not None:
            last = pl.concat([last, part.head(count)])
            if count == part.height:
                continue
            yield joined_rows(last, clock)
        last = part.slice(count)
    if last is not None:
        yield joined_rows(last, clock)


def _rows_at_end_of(table: pl.DataFrame, after: pl.DataFrame, clock: Sequence[str]) -> int:
    """How many rows at the beginning of the next table have the time of the last one of this."""
    if not {*clock} <= {*table.columns} or not table.height:
        return 0
    end = table.select(clock).row(-1)
    return sum(1 for _ in takewhile(end.__eq__, after.select(clock).iter_rows()))


def _overlapping(tables: Iterable[pl.DataFrame], rows: int, overlap: int) -> Iterator[pl.DataFrame]:
    """The same rows in tables of so many rows that overlap."""
    buffer: pl.DataFrame | None = None
    new = False  # whether there are rows that were not yielded yet
    for table in tables:
        buffer, new = table if buffer is None else pl.concat([buffer, table]), new or table.height > 0
        while buffer.height >= rows:
            yield buffer.head(rows)
            buffer = buffer.slice(rows - overlap)
            new = buffer.height > overlap
    if buffer is not None and new:
        yield buffer


@contextmanager
def _opened(path: Path, where: str, *, packed: bool) -> Iterator[IO[bytes]]:
    try:
        with gzip.open(path, "rb") if packed else path.open("rb") as file:
            yield file  # type: ignore[misc]
    except DAMAGED as error:
        found = "is a damaged gzip file" if packed else "cannot be read completely"
        raise UndertowError(f"{where} {found} ({error}): copy it again") from error


def _lines(file: IO[bytes], where: str) -> Iterator[bytes]:
    """Lines of a file; one that is too long is refused before it is read to its end."""
    while line := file.readline(WHOLE.line + 1):
        if len(line) > WHOLE.line:
            raise UndertowError(
                f"{where} has a line of more than {WHOLE.line} bytes: check that it is a table of text"
            )
        yield line


def outline(parts: Iterable[Run], name: str, sha256: str) -> Run:
    """Two samples that represent a long log when checking which channels change, and in which direction.

    They hold the sums of the positive and of the negative values of every channel; a constant channel keeps
    its value.
    """
    found: dict[str, list[float]] = {}
    counts: Counter[str] = Counter()
    for run in parts:
        for channel, values in run.channels.items():
            counts[channel] += len(values)
            known = values[np.isfinite(values)]
            if not len(known):
                continue
            low, high, up, down = found.get(channel, [np.inf, -np.inf, 0.0, 0.0])
            more = [float(np.sum(np.maximum(s * known, 0.0))) for s in (1.0, -1.0)]
            ends = min(low, float(known.min())), max(high, float(known.max()))
            found[channel] = [*ends, up + more[0], down + more[1]]
    for channel in counts.keys() - found.keys():
        raise UndertowError(opening.empty(channel, counts[channel], f"log {name}"))
    channels = {n: [a, a] if a == b else [up, -down] for n, (a, b, up, down) in found.items()}
    return Run(name, np.array([0.0, 1.0]), {n: np.array(v) for n, v in channels.items()}, sha256=sha256)
