"""How the text of a table is written: its delimiter, decimal sign, and the lines above its header."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from gzip import GzipFile
from pathlib import Path

import polars as pl

from .cells import SETTINGS as CELLS
from .mapping import LogMapping
from .table import DAMAGED, file_bytes, is_gzip, is_number, is_parquet, read_table

Rows = Sequence[list[str]]  # cells of lines


@dataclass(frozen=True)
class TextSettings:
    """Settings for recognising how a text is written."""

    begin: int = 100_000  # bytes of the text that are looked at
    lines: int = 300  # and lines: above a header there are fewer
    signs: str = "#%!*"  # with which comments begin, and no row
    delimiters: str = ";\t|, "  # in this order: a comma may be the decimal sign, a blank part of a name
    delimited: int = 50  # rows by which a delimiter is recognised where no line is a header


TEXT = TextSettings()
_DECIMAL_COMMA = re.compile(r"\s*[-+]?\d+,\d+(?:[eE][-+]?\d+)?\s*")


def whole_table(path: Path) -> tuple[pl.DataFrame, LogMapping]:
    """The rows of a log, and the format of its text."""
    data, where = file_bytes(path), f"log {path}"
    reading = LogMapping() if is_parquet(data) else _written(data)
    table = read_table(data, reading, where, path)
    sign = _delimiter(table) if len(table.columns) == 1 else None
    if sign is not None:  # of a text whose rows show no header
        reading = reading.model_copy(update={"delimiter": sign})
        table = read_table(data, reading, where, path)
    return table, reading


def _written(data: bytes) -> LogMapping:
    """How a text is written, by its first lines; as usual where these show no header above numbers."""
    begin = b""
    with suppress(*DAMAGED):  # which is said where the whole is read
        begin = GzipFile(fileobj=io.BytesIO(data)).read(TEXT.begin) if is_gzip(data) else data
    lines = begin[: TEXT.begin].decode("utf-8-sig", "replace").split("\n")
    lines = lines[: min(TEXT.lines, max(len(lines) - 1, 2))]  # the last may be cut off
    first = next((line.strip() for line in lines if line.strip()), "")
    # A header may begin with such a sign, too.
    comments = [sign for sign in first[:1] if sign in TEXT.signs]
    ways = [(c, d, _is_header) for c in (*comments, None) for d in TEXT.delimiters]
    # Rows without names below several lines are refused as what they are.
    ways += [(None, d, _are_numbers) for d in TEXT.delimiters.rstrip(" ")]
    return next(filter(None, (_written_so(lines, *way) for way in ways)), LogMapping())


def _written_so(
    lines: Sequence[str], comment: str | None, delimiter: str, begins: Callable[[Rows], bool]
) -> LogMapping | None:
    """The format of a text with comments and cells of this kind; None where no row begins a table."""
    empty = [not line.strip() or bool(comment and line.startswith(comment)) for line in lines]
    rows = [(k, _cells(line, delimiter)) for k, line in enumerate(lines) if not empty[k]]
    header = next((k for k in range(len(rows)) if begins([row for _, row in rows[k:]])), None)
    if header is None:
        return None
    commas = _has_decimal_commas([row for _, row in rows[header + 1 :]])
    above = rows[header][0]
    return LogMapping(
        delimiter=delimiter,
        decimal="," if commas else ".",
        comment=comment,
        skip=0 if all(empty[:above]) else above,
    )


def _cells(line: str, delimiter: str) -> list[str]:
    line = " ".join(line.split()) if delimiter == " " else line.replace("\r", "")
    return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter), [])]


def _is_header(rows: Rows) -> bool:
    """Whether the first row names the columns: all below have as many cells, and numbers soon."""
    names, *others = rows
    if names[0] in [*TEXT.signs]:  # such a sign and a blank before the names
        names = names[1:]
    if len(names) < 2 or not others or any(map(_is_number, names)):
        return False
    # Each row may end with a delimiter.
    if any(len(names) != len(row) - (len(row) > len(names) and not row[-1]) for row in others):
        return False
    begin = others[: 1 + CELLS.rows_of_units]
    first = next((k for k, row in enumerate(begin) if any(map(_is_number, row))), None)
    if first is None:
        return False
    numeric = [k for k, cell in enumerate(others[first]) if _is_number(cell)]
    # Settings, each beside its name, have the header below them; rows have numbers to the end.
    ends = any(any(row[k] for k in numeric) and not any(map(_is_number, row)) for row in others[first:])
    return not ends and all(names[k] for k in numeric if k)  # an index may have no name


def _are_numbers(rows: Rows) -> bool:
    """Whether all rows have as many cells, all of them numbers."""
    return len(rows) > 2 and all(len(row) == len(rows[0]) > 1 and all(map(_is_number, row)) for row in rows)


def _is_number(cell: str) -> bool:
    return is_number(cell.replace(",", "."))


def _has_decimal_commas(rows: Rows) -> bool:
    """Whether numbers are written with commas, and none with a point."""
    cells = [cell for row in rows for cell in row]
    return any(map(_DECIMAL_COMMA.fullmatch, cells)) and not any("." in c and is_number(c) for c in cells)


def _delimiter(table: pl.DataFrame) -> str | None:
    """The delimiter of the cells of a table read as one column: the sign that most of its lines have."""
    (name,) = table.columns
    lines = [line.strip() for line in (name, *table[name].head(TEXT.delimited).drop_nulls().cast(pl.String))]
    return next((s for s in ";\t| " if 2 * sum(s in line for line in lines) > len(lines)), None)
