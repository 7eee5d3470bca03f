"""Bytes of a log file to a table of named columns; the only place that knows about polars.

CSV cells are read as text and turned into numbers column by column, so that a word in a numeric column is
told with its row instead of making the whole column text.
"""

from __future__ import annotations

import gzip
import io
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from undertow.errors import UndertowError
from undertow.identification.logs.mapping import Mapping

_ALWAYS_MISSING = ("", "NaN", "nan", "NAN", "NA", "N/A", "null", "None")
_GZIP, _PARQUET = b"\x1f\x8b", b"PAR1"


def file_bytes(path: Path) -> bytes:
    """Return the bytes of a log file.

    Raises
    ------
    UndertowError
        If there is no such file, or it cannot be read.
    """
    if not path.is_file():
        found = "is a folder, not a log file" if path.is_dir() else "does not exist or is not a file"
        raise UndertowError(f"log {path} {found}: give the path of a CSV, CSV.gz or Parquet file")
    try:
        return path.read_bytes()
    except OSError as error:
        raise UndertowError(f"log {path} cannot be read: {error.strerror}") from error


def read_table(data: bytes, mapping: Mapping, where: str) -> pl.DataFrame:
    """Turn the bytes of a CSV, CSV.gz or Parquet file into a table with clean column names.

    Raises
    ------
    UndertowError
        If the file is empty, damaged, not UTF-8, or names a column twice.
    """
    if not data:
        raise UndertowError(f"{where} is empty (0 bytes): check that the log was written to its end")
    return _tidy(
        lambda: pl.read_parquet(io.BytesIO(data)) if is_parquet(data) else _csv(data, mapping, where), where
    )


def read_rows(path: Path, first: int, count: int, where: str) -> pl.DataFrame:
    """Some rows of a Parquet file; no more of it is held in memory than the row groups they are in."""
    return _tidy(lambda: pl.scan_parquet(path, glob=False).slice(first, count).collect(), where)


def is_parquet(data: bytes) -> bool:
    """Tell whether a file that begins so is a Parquet file."""
    return data.startswith(_PARQUET)


def is_gzip(data: bytes) -> bool:
    """Tell whether a file that begins so is packed by gzip."""
    return data.startswith(_GZIP)


def _tidy(read: Callable[[], pl.DataFrame], where: str) -> pl.DataFrame:
    try:
        table = read()
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError) as error:
        reason = str(error).split("\n")[0].strip()
        raise UndertowError(
            f"{where} cannot be read as a table: {reason}: check the delimiter, or export it again"
        ) from error
    table = table.rename({name: name.strip() for name in table.columns})
    return table.filter(~pl.all_horizontal(pl.all().is_null())) if table.height else table


def _csv(data: bytes, mapping: Mapping, where: str) -> pl.DataFrame:
    text = _unpacked(data, where) if is_gzip(data) else data
    try:
        header = text.decode("utf-8").lstrip("\ufeff \r\n")
    except UnicodeDecodeError as error:
        raise UndertowError(
            f"{where} is not UTF-8 text (byte {error.start} is 0x{text[error.start]:02x}): save it as UTF-8"
        ) from error
    if not header:
        raise UndertowError(f"{where} is empty (no header): check that the log was written to its end")
    table = pl.read_csv(
        text,
        infer_schema=False,
        separator=mapping.delimiter,
        comment_prefix=mapping.comment,
        null_values=[*_ALWAYS_MISSING, *(value for value in mapping.missing if isinstance(value, str))],
    )
    _refuse_doubled(table.columns, where)
    return table


def _unpacked(data: bytes, where: str) -> bytes:
    try:
        return gzip.decompress(data)
    except (OSError, EOFError, zlib.error) as error:
        raise UndertowError(f"{where} is a damaged gzip file ({error}): copy it again") from error


def _refuse_doubled(columns: Sequence[str], where: str) -> None:
    doubled = [name for name in columns if name.rsplit("_duplicated_", 1)[0] != name]
    if doubled:
        name = doubled[0].rsplit("_duplicated_", 1)[0]
        raise UndertowError(f"{where} has column {name!r} more than once: rename one of them in the header")


def numbers(table: pl.DataFrame, name: str, mapping: Mapping, where: str) -> NDArray[np.float64]:
    """Return one column as numbers, NaN where a cell is missing.

    Parameters
    ----------
    table : DataFrame
        The table.
    name : str
        Name of a column in it.
    mapping : Mapping
        Says the decimal sign and which values stand for missing.
    where : str
        The file, for the message.

    Raises
    ------
    UndertowError
        If a cell is not a number; the first one is named with its row.
    """
    column = table[name]
    cells = _text_to_number(column, mapping.decimal, where) if column.dtype == pl.String else column
    if not (cells.dtype.is_numeric() or cells.dtype in (pl.Boolean, pl.Null)):
        raise UndertowError(
            f"{where}: column {name!r} holds {cells.dtype}, not numbers: convert or ignore it"
        )
    values = cells.cast(pl.Float64).fill_null(np.nan).to_numpy().copy()
    sentinels = [float(value) for value in mapping.missing if _is_number(value)]
    values[np.isin(values, sentinels)] = np.nan
    return values


def _text_to_number(column: pl.Series, decimal: str, where: str) -> pl.Series:
    cells = column.str.replace(",", ".", literal=True) if decimal == "," else column
    cast = cells.cast(pl.Float64, strict=False)
    if (cast.is_null() & column.is_not_null()).any():  # the slow way only where it is needed
        cells = cells.str.strip_chars()
        cells = cells.set(cells.is_in(_ALWAYS_MISSING), None)
        cast = cells.cast(pl.Float64, strict=False)
        odd = (cast.is_null() & cells.is_not_null()).arg_true()
        if len(odd):
            raise UndertowError(
                f"{where}: column {column.name!r} has the text {cells[odd[0]][:40]!r} in row {odd[0] + 1} "
                f"({len(odd)} such "
                "rows): name it under `missing` in a mapping file, or leave the column out"
            )
    return cast


def _is_number(value: float | str) -> bool:
    try:
        float(value)
    except ValueError:
        return False
    return True


def seconds(table: pl.DataFrame, name: str, where: str) -> tuple[NDArray[np.float64], str]:
    """Return a column of dates and times (or ISO 8601 texts) as seconds from its first entry, and that entry.

    Raises
    ------
    UndertowError
        If a text is not an ISO 8601 time stamp.
    """
    stamps = table[name]
    if stamps.dtype == pl.String:
        try:
            parsed = stamps.str.strip_chars().str.to_datetime(time_unit="ns", strict=False)
        except pl.exceptions.ComputeError:  # polars found no date at all
            parsed = pl.Series([None] * len(stamps), dtype=pl.Datetime("ns"))
        odd = (parsed.is_null() & stamps.is_not_null()).arg_true()
        if len(odd):
            raise UndertowError(
                f"{where}: time {stamps[odd[0]][:40]!r} in row {odd[0] + 1} is no ISO 8601 time stamp such "
                "as "
                "2024-05-01T12:00:00.250Z: rewrite it, or give the unit of a numeric time column"
            )
        stamps = parsed
    first = stamps.drop_nulls().first()
    if first is None:
        return np.full(table.height, np.nan), ""
    elapsed = (
        stamps.cast(pl.Datetime("ns")) - stamps.cast(pl.Datetime("ns")).drop_nulls()[0]
    ).dt.total_nanoseconds()
    return elapsed.cast(pl.Float64).fill_null(np.nan).to_numpy() * 1e-9, str(first)


def is_dates(table: pl.DataFrame, name: str) -> bool:
    """Tell whether a column holds dates or times of their own type (Parquet)."""
    return table[name].dtype.is_temporal()
