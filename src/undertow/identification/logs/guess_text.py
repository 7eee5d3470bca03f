"""How the text of a table is written: delimiter, lines above the header, cells that are numbers."""

from __future__ import annotations

import io
from contextlib import suppress
from dataclasses import dataclass
from gzip import GzipFile
from pathlib import Path

import numpy as np
import polars as pl

from undertow.errors import UndertowError
from undertow.typing import Array

from .mapping import LogMapping
from .table import (
    DAMAGED,
    file_bytes,
    is_dates,
    is_gzip,
    is_number,
    is_parquet,
    numbers,
    read_table,
    texts_in,
)


@dataclass(frozen=True)
class TextSettings:
    """Settings for recognising how a text is written."""

    lines: int = 50  # lines by which the delimiter of cells is recognised
    begin: int = 100_000  # bytes in which lines above the header are looked for
    signs: str = "#%!*"  # with which comments begin, and no row
    longest: int = 5  # characters of `comment` in a mapping file


SETTINGS = TextSettings()


def whole_table(path: Path) -> tuple[pl.DataFrame, LogMapping]:
    """The rows of a log, and the format of its text."""
    data, where = file_bytes(path), f"log {path}"
    reading = LogMapping(comment=None if is_parquet(data) else _comment(data))
    table = read_table(data, reading, where, path)
    sign = _delimiter(table) if len(table.columns) == 1 else None
    if sign is not None:
        reading = reading.model_copy(update={"delimiter": sign})
        table = read_table(data, reading, where, path)
    return table, reading


def _comment(data: bytes) -> str | None:
    """With what the lines above the header of a text begin: a sign, or a title alone; None without any."""
    begin = b""
    with suppress(*DAMAGED):  # which is said where the whole is read
        begin = GzipFile(fileobj=io.BytesIO(data)).read(SETTINGS.begin) if is_gzip(data) else data
    lines = begin[: SETTINGS.begin].decode("utf-8-sig", "replace").splitlines()
    first, *below = [line.strip() for line in lines if line.strip()] or [""]
    sign = first[:1] if first[:1] in SETTINGS.signs else ""
    begins = sign or first[: SETTINGS.longest].rstrip()
    above = [first, *(line for line in below if line.startswith(begins))]
    rest = [line for line in below if line not in above]
    alone = len(above) == 1 and not is_number(first)
    if len(rest) < 2 or not (sign or alone):
        return None
    return begins if any(_is_header(rest[0], rest[1], above, delimiter) for delimiter in ",;\t|") else None


def _is_header(line: str, row: str, above: list[str], delimiter: str) -> bool:
    """Whether a line has names for as many cells as the row below it, and more than any line above."""
    names, cells = line.split(delimiter), row.split(delimiter)
    most = max(len(title.split(delimiter)) for title in above)
    named = len(names) - len(cells) in (0, -1) and not any(is_number(name) for name in names)
    return named and most < len(names) and any(is_number(cell.replace(",", ".")) for cell in cells)


def _delimiter(table: pl.DataFrame) -> str | None:
    """The delimiter of the cells of a table read as one column: the sign that most of its lines have."""
    (name,) = table.columns
    lines = [line.strip() for line in (name, *table[name].head(SETTINGS.lines).drop_nulls().cast(pl.String))]
    return next((s for s in ";\t| " if 2 * sum(s in line for line in lines) > len(lines)), None)


def numbers_of(table: pl.DataFrame, name: str, reading: LogMapping) -> Array | None:
    """The numbers of a column; None where it is one of dates, or has more texts than numbers."""
    if is_dates(table, name):
        return None
    try:
        values = numbers(table, name, reading.model_copy(update={"not_numbers": "missing"}), "log")
    except UndertowError:
        return None
    return values if len(texts_in(table, name, reading)) <= np.count_nonzero(np.isfinite(values)) else None
