"""A long log in parts that overlap, so that it is never in memory as a whole."""

from __future__ import annotations

import gzip
import hashlib
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from os import SEEK_END
from pathlib import Path
from typing import IO, TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from undertow.errors import UndertowError
from undertow.model.units import scale_offset

from .checks import empty
from .mapping import CommandPolicy, LogMapping
from .reading import must_have, run_of_table
from .run import Run
from .table import (
    DAMAGED,
    WHOLE,
    Origin,
    elapsed,
    flat_table,
    is_dates,
    is_gzip,
    is_header,
    is_parquet,
    read_rows,
    read_table,
)

if TYPE_CHECKING:
    import polars as pl

_HASHED = 1 << 20
_LEAST_GZIP = 18


class NeedsWhole(UndertowError):
    """What is asked of a log cannot be done in parts."""


class LogPart(NamedTuple):
    """LogPart of a long log."""

    run: Run  # its samples within the window
    # Time in the middle of the rows that it shares with the part after it, s; told by the rows of the file,
    # those outside the window too, so that either part reaches beyond it as far as the window does.
    border: float


@dataclass(frozen=True)
class LongLog:
    """A log that is read in parts."""

    path: Path  # CSV, CSV.gz or Parquet file
    mapping: LogMapping
    commands: tuple[str, ...]  # names of commands that are read where the log has them
    window: tuple[float | None, float | None] = (None, None)  # part that is used, s; None: no limit
    missing_commands: CommandPolicy | None = None  # what to do where a command has no sample

    def parts(self, rows: int, overlap: int) -> Iterator[LogPart]:
        """Parts of `rows` rows, each beginning with the last `overlap` rows of the one before."""
        self._refuse()
        origin: Origin | None = None
        last: Run | None = None
        low, high = (w if w is not None else e * np.inf for w, e in zip(self.window, (-1, 1), strict=True))
        for table in self._tables(rows, overlap):
            if origin is None:
                origin = self._origin(table)
            t = self._times(table, origin)
            inside = t[(t >= low) & (t <= high)]
            if len(inside) > 1:
                last = self._run(table, origin, _commands_before(float(inside[0]), last))
                shared = min(max(overlap // 2, 1), len(t))
                yield LogPart(last, float(np.fmax.accumulate(t)[-shared]))

    def _times(self, table: pl.DataFrame, origin: Origin) -> NDArray[np.float64]:
        """Times of all rows of a table, s."""
        where = f"log {self.path}"
        scale, offset = scale_offset(self.mapping.time.unit, "s", of=where)
        since, _ = elapsed(table, self.mapping, scale, where, origin)
        return np.asarray(scale * since + offset + self.mapping.time.offset)

    def _run(self, table: pl.DataFrame, origin: Origin, before: dict[str, float]) -> Run:
        also, fill = self.commands, self.missing_commands
        return run_of_table(table, self.path, self.mapping, (), self.window, fill, also, origin, before)

    def _origin(self, table: pl.DataFrame) -> Origin:
        spec, where = self.mapping.time, f"log {self.path}"
        must_have(spec.column, table.columns, where, "time column")
        if is_dates(table, spec.column):
            raise NeedsWhole(f"{where}: {_DATES}")
        scale, _ = scale_offset(spec.unit, "s", of=f"time unit {spec.unit!r}")
        return elapsed(table.head(1), self.mapping, scale, where)[1]

    def _refuse(self) -> None:
        if not self.path.is_file():
            raise UndertowError(f"log {self.path} does not exist or is not a file: give the path of a log")
        if self.mapping.time.unit == "iso":
            raise NeedsWhole(f"log {self.path}: {_DATES}")
        if self.mapping.time.every > 1 or any(c.fresh for c in self.mapping.columns.values()):
            raise NeedsWhole(
                f"log {self.path}: `every` and `fresh` in a mapping file need the whole log: leave them "
                "out, or leave out --stream"
            )

    def _tables(self, rows: int, overlap: int) -> Iterator[pl.DataFrame]:
        with self.path.open("rb") as file:
            begin = file.read(4)
        if not is_parquet(begin):
            yield from self._text_tables(rows, overlap, packed=is_gzip(begin))
            return
        first, where = 0, f"log {self.path}"
        whole = flat_table(self.path, where)
        while True:
            table = read_rows(whole, first, rows, where)
            if first and table.height <= overlap:
                return
            yield table
            first += rows - overlap

    def _text_tables(self, rows: int, overlap: int, *, packed: bool) -> Iterator[pl.DataFrame]:
        where = f"log {self.path}"
        with _opened(self.path, where, packed=packed) as file:
            stream = _lines(file, where)
            header = self._header(stream)
            kept: list[bytes] = []
            while fresh := list(islice(stream, rows - len(kept))):
                lines = kept + fresh
                yield read_table(header + b"".join(lines), self.mapping, where)
                kept = lines[-overlap:] if overlap else []

    def _header(self, lines: Iterator[bytes]) -> bytes:
        comment = (self.mapping.comment or "\0").encode()
        for line in lines:
            if is_header(line, comment):
                return line
        raise UndertowError(f"log {self.path} is empty (no header): check that it was written to its end")


def _commands_before(t: float, run: Run | None) -> dict[str, float]:
    """Last values of all channels of a run before some time; none where it begins no earlier."""
    count = 0 if run is None else int(np.searchsorted(run.t, t))
    return {} if run is None or not count else {n: float(a[count - 1]) for n, a in run.channels.items()}


_DATES = (
    "its time is a date, which parts of a log cannot be counted from: give the time as a number, or leave "
    "out --stream"
)


@contextmanager
def _opened(path: Path, where: str, *, packed: bool) -> Iterator[IO[bytes]]:
    try:
        with gzip.open(path, "rb") if packed else path.open("rb") as file:
            yield file  # type: ignore[misc]
    except DAMAGED as error:
        raise UndertowError(f"{where} cannot be read to its end ({error}): copy it again") from error


def _lines(file: IO[bytes], where: str) -> Iterator[bytes]:
    """Lines of a file; one that does not end is not read to its end."""
    while line := file.readline(WHOLE.line + 1):
        if len(line) > WHOLE.line:
            raise UndertowError(
                f"{where} has a line of more than {WHOLE.line} bytes: check that it is a table of text"
            )
        yield line


def size_of(path: Path) -> int:
    """Bytes of a log, unpacked; zero where there is no file."""
    if not path.is_file():
        return 0
    packed = path.stat().st_size
    with path.open("rb") as file:
        if not is_gzip(file.read(2)) or packed < _LEAST_GZIP:
            return packed
        file.seek(-4, SEEK_END)
        # A gzip file ends with its size, of which it keeps 32 bits.
        return max(packed, int.from_bytes(file.read(4), "little"))


def hash_of(path: Path) -> str:
    """SHA-256 of a file, read in pieces."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while piece := file.read(_HASHED):
            digest.update(piece)
    return digest.hexdigest()


def outline(parts: Iterable[Run], name: str, sha256: str) -> Run:
    """Two samples that stand for a long log where it is asked what moves in it, and which way.

    Of every channel they have the sum of what is positive and the sum of what is negative; a channel that
    never changes has its value.
    """
    found: dict[str, list[float]] = {}
    there: Counter[str] = Counter()
    for run in parts:
        for channel, values in run.channels.items():
            there[channel] += len(values)
            known = values[np.isfinite(values)]
            if not len(known):
                continue
            low, high, up, down = found.get(channel, [np.inf, -np.inf, 0.0, 0.0])
            more = [float(np.sum(np.maximum(s * known, 0.0))) for s in (1.0, -1.0)]
            ends = min(low, float(known.min())), max(high, float(known.max()))
            found[channel] = [*ends, up + more[0], down + more[1]]
    for channel in there.keys() - found.keys():
        raise UndertowError(empty(channel, there[channel], f"log {name}"))
    channels = {n: [a, a] if a == b else [up, -down] for n, (a, b, up, down) in found.items()}
    return Run(name, np.array([0.0, 1.0]), {n: np.array(v) for n, v in channels.items()}, sha256=sha256)
