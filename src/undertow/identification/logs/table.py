"""Bytes of a log file to a table of named columns; Parquet files are decoded in another process first."""

from __future__ import annotations

import atexit
import csv
import gzip
import io
import json
import os
import re
import subprocess
import sys
import threading
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from os import SEEK_END
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import polars as pl
import polars.selectors as cs
from numpy.typing import NDArray

from undertow.errors import UndertowError, nearest
from undertow.files import files_beside
from undertow.model.units import is_unit, same_unit

from .cells import DATE, as_iso, as_utf8, below, plain_text, with_signs, with_signs_beside, without_units
from .mapping import Column, LogMapping

# --- a helper process for decoders that may crash -------------------------------------------------
_LIMITED = """
import sys
try:
    import resource
    resource.setrlimit(resource.RLIMIT_AS, 2 * (int(sys.argv[1]),))
except (ImportError, ValueError, OSError):
    pass
"""


@dataclass
class Helper:
    """A process that answers one question after another, and is started again after a crash."""

    program: str  # Python that answers every line of JSON with a line of JSON
    memory: int = 6_000_000_000  # limit of its address space, bytes: a table of the most cells, three times
    _process: subprocess.Popen[str] | None = None
    _owner: int = 0
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def __post_init__(self) -> None:
        atexit.register(self.close)

    def answer(self, question: Any, unavailable: Any, crashed: Any) -> Any:
        """The answer; `unavailable` where no helper can be started, `crashed` where the question ended it."""
        with self._lock:
            try:
                process = self._started()
                assert process.stdin is not None
                assert process.stdout is not None
                process.stdin.write(json.dumps(question) + "\n")
                process.stdin.flush()
                answer = process.stdout.readline()
            except OSError:
                return unavailable
            if not answer:
                process.communicate()
                return crashed
            return json.loads(answer)

    def _started(self) -> subprocess.Popen[str]:
        # A forked process must not use the helper of its parent.
        if self._process is None or self._process.poll() is not None or self._owner != os.getpid():
            self._owner = os.getpid()
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-c", f"{_LIMITED}{self.program}", str(self.memory)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
                encoding="utf-8",
                # Threads reserve address space, on a large machine more than the limit.
                env={**os.environ, "POLARS_MAX_THREADS": "2", "PYTHONIOENCODING": "utf-8"},
            )
        return self._process

    def close(self) -> None:
        """End the process that this one has started, if there is one."""
        if self._process is not None and self._owner == os.getpid():
            self._process.terminate()
            self._process.communicate()


# --- tables ---------------------------------------------------------------------------------------
# Only a hash of every column is kept; columns of lists are never read.
_DECODE = """
import json, sys
import polars as pl
for line in sys.stdin:
    try:
        table = pl.scan_parquet(json.loads(line), glob=False, hive_partitioning=False)
        flat = [name for name, kind in table.collect_schema().items() if not kind.is_nested()]
        table.select(pl.col(flat).hash().max()).collect(engine="streaming")
        text = ""
    except BaseException as error:
        text = (str(error).split("\\n")[0] or type(error).__name__).strip()
    print(json.dumps(text), flush=True)
"""
_UNREADABLE = (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError)


def flat_table(path: Path, where: str, most_cells: int | None = None) -> pl.LazyFrame:
    """A Parquet file that can be decoded, not yet read; nested columns have no value in it."""
    rows, kinds = parquet_size(path, where)
    if most_cells is not None and rows * len(kinds) > most_cells:
        raise UndertowError(too_many_cells(where, rows, len(kinds), most_cells))
    table = _scanned(path)
    text = _HELPER.answer(str(path.absolute()), "", _CRASHED)
    if text:
        raise UndertowError(_unreadable(where, text))
    return table.with_columns(
        pl.lit(None).cast(kind).alias(n) for n, kind in kinds.items() if kind.is_nested()
    )


def parquet_size(path: Path, where: str) -> tuple[int, pl.Schema]:
    """Rows and columns of a Parquet file by its last bytes; nothing else of it is read."""
    try:
        table = _scanned(path)
        return int(table.select(pl.len()).collect().item()), table.collect_schema()
    except _UNREADABLE as error:
        raise UndertowError(_unreadable(where, str(error))) from error


def _scanned(path: Path) -> pl.LazyFrame:
    return pl.scan_parquet(path, glob=False, hive_partitioning=False)


def too_many_cells(where: str, rows: int, columns: int, most: int) -> str:
    """The message on a table that is too large for memory."""
    return (
        f"{where} has {rows} rows of {columns} columns or more, at most {most // max(columns, 1)} such rows "
        f"can be read as a whole: {_SMALLER}"
    )


def _unreadable(where: str, reason: str) -> str:
    line = reason.split("\n")[0].strip() or "the reader fails"
    return f"{where} cannot be read as a table: {line}: check that it is whole, or export it again"


_HELPER = Helper(_DECODE)
_CRASHED = "the reader fails: the file is damaged or needs too much memory"
_SMALLER = (
    "take a part of it with --from and --to, decimate it with `every` in a mapping file, or leave out columns"
)
_ALWAYS_MISSING = ("", "NaN", "nan", "NAN", "NA", "N/A", "null", "None")
_WITH_UNIT = r"^([-+]?[0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?)\s*([A-Za-z%°µ][A-Za-z0-9%°µ/^*]*)$"
_FRACTION = r"^(.*:\d\d\.)(\d+)(\D.*|)$"
_LEAST_GZIP = 18
_GZIP, _PARQUET = b"\x1f\x8b", b"PAR1"
# Polars would unpack some of these without being asked, and as a whole.
_PACKED = {
    b"PK\x03\x04": "zip",
    b"BZh": "bzip2",
    b"\xfd7zXZ": "xz",
    b"\x28\xb5\x2f\xfd": "zstd",
    b"x\x01": "zlib",
    b"x\x9c": "zlib",
    b"x\xda": "zlib",
    b"7z\xbc\xaf": "7z",
}
# Names of parts of a spreadsheet, which its zip archive states unpacked: Excel, OpenDocument.
_SPREADSHEET = (b"xl/workbook.", b"application/vnd.oasis.opendocument.spreadsheet")
DAMAGED = (OSError, EOFError, zlib.error)
"""What reading a damaged gzip file raises, whole or in parts."""
# Decimals of an exact time: nanoseconds of seconds since 1970, with digits to spare before the point.
_EXACT = pl.Decimal(38, 9)
_ROW = "number of the row"
_DAY = 86_400.0  # s
Frame = TypeVar("Frame", pl.DataFrame, pl.LazyFrame)
Origin = Decimal | float


@dataclass(frozen=True)
class LogLimits:
    """Limits on the size of a log, and on the times of its own clock."""

    # Bytes of text, unpacked, that are held at once. A day at 20 Hz with 20 columns has 350 MB.
    text: int = 500_000_000
    # Rows times columns that are held at once: a cell of text takes 16 bytes, its number 8 more.
    cells: int = 50_000_000
    columns: int = 5_000  # columns
    line: int = 1_000_000  # bytes of one line
    piece: int = 1 << 20  # bytes that are unpacked, or searched for a header, at a time
    # Times beyond it, three years in s, are dates counted from some epoch, and count from the first sample: a
    # log on its own clock does not last so long.
    own_clock: float = 1e8
    # Rows that the operation on the log can take, blank ones and comments included.
    rows: int | None = None

    def check(self, size: int, rows: int, columns: int, where: str) -> None:
        """Refuse a text of so many bytes, rows and columns."""
        if columns > self.columns:
            raise UndertowError(
                f"{where} has {columns} columns, at most {self.columns} are allowed: leave some out, or "
                "check the delimiter"
            )
        if self.rows is not None and rows > self.rows:
            raise UndertowError(
                f"{where} has more than {self.rows} rows, more than can be used: take a part of it with "
                "--from and --to, or decimate it with `every` in a mapping file (10 to 20 samples per "
                "second are enough)"
            )
        if rows * columns > self.cells:
            raise UndertowError(too_many_cells(where, rows, columns, self.cells))
        if size > self.text:
            raise UndertowError(
                f"{where} has more than {self.text / 1e6:g} MB unpacked, too much to read as a whole: "
                f"{_SMALLER}"
            )


WHOLE = LogLimits()


def file_bytes(path: Path, limits: LogLimits = WHOLE) -> bytes:
    """Return the bytes of a log file; one that is too large is refused before they are read."""
    refuse_no_file(path)
    where = f"log {path}"
    try:
        with path.open("rb") as stream:
            if is_parquet(stream.read(len(_PARQUET))):
                rows, kinds = parquet_size(path, where)
                limits.check(0, rows, len(kinds), where)
            limits.check(path.stat().st_size, 0, 0, where)
            stream.seek(0)
            return stream.read(limits.text + 1)
    except OSError as error:
        raise UndertowError(f"{where} cannot be read: {error.strerror}") from error


def refuse_no_file(path: Path) -> None:
    """Refuse what is no file, and a file without a byte."""
    if path.is_dir():
        raise UndertowError(f"log {path} is a folder without tables: give the path of a log in it")
    if not path.is_file():
        alike = nearest(path.name, files_beside(path))
        raise UndertowError(f"log {path} does not exist or is not a file{alike}: give the path of a log")
    if not path.stat().st_size:
        raise UndertowError(f"log {path} is empty (0 bytes): check that the log is complete")


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


class NotTextError(UndertowError):
    """A file that is no table."""


def read_table(
    data: bytes, mapping: LogMapping, where: str, path: Path | None = None, limits: LogLimits = WHOLE
) -> pl.DataFrame:
    """Turn the bytes of a CSV, CSV.gz or Parquet file into a table with clean column names."""
    if not data:
        raise UndertowError(f"{where} is empty (0 bytes): check that the log is complete")
    if path is not None and is_parquet(data):
        return _tidy(lambda: flat_table(path, where, limits.cells).collect(), where)
    return _tidy(lambda: _csv(data, mapping, where, limits), where)


def read_rows(table: pl.LazyFrame, first: int, count: int, where: str) -> pl.DataFrame:
    """Some rows of a Parquet file; no more of it is held in memory than the row groups they are in."""
    return _tidy(lambda: table.slice(first, count).collect(), where)


def joined_rows(table: pl.DataFrame, clock: Sequence[str]) -> pl.DataFrame:
    """A table whose consecutive rows of one time are one row, where no column has two values in them.

    Tables made of several topics often have one row for each message.
    """
    flat = [n for n, kind in table.schema.items() if not kind.is_nested()]
    others = [n for n in flat if n not in clock]
    if not others or not {*clock} <= {*flat}:
        return table
    same = pl.all_horizontal(pl.col(n) == pl.col(n).shift() for n in clock).fill_null(value=False)
    if not table.select(same.any()).item():
        return table
    values = pl.col(others).drop_nulls()
    blank = table.with_columns(cs.float().fill_nan(None)).with_columns((~same).cum_sum().alias(_ROW))
    several = pl.max_horizontal(values.n_unique().over(_ROW)) > 1
    group = (~same | blank.select(several).to_series()).cum_sum().alias(_ROW)
    found = blank.with_columns(group).group_by(_ROW, maintain_order=True)
    return found.agg(pl.exclude(others).first(), values.first()).select(table.columns)


def with_even_times(table: Frame, mapping: LogMapping, first: int = 0) -> Frame:
    """The table with the times of rows that are a stated interval apart; as it is where times are read.

    `first`: number of its first row in the log.
    """
    spec = mapping.time
    if spec.interval is None:
        return table
    counted = table.with_row_index(_ROW, offset=first)
    return counted.with_columns((pl.col(_ROW) * spec.spacing).alias(spec.column)).drop(_ROW)


def is_parquet(data: bytes) -> bool:
    """Tell whether a file that begins so is a Parquet file."""
    return data.startswith(_PARQUET)


def is_gzip(data: bytes) -> bool:
    """Tell whether a file that begins so is packed by gzip."""
    return data.startswith(_GZIP)


def _tidy(read: Callable[[], pl.DataFrame], where: str) -> pl.DataFrame:
    try:
        table = read()
    except _UNREADABLE as error:
        reason = str(error).split("\n")[0].strip()
        raise UndertowError(
            f"{where} cannot be read as a table: {reason}: check the delimiter, or export it again"
        ) from error
    _refuse_doubled(table.columns, where)
    table = table.rename({name: name.strip() for name in table.columns})
    return with_signs_beside(table.filter(~pl.all_horizontal(pl.all().is_null()))) if table.height else table


def _csv(data: bytes, mapping: LogMapping, where: str, limits: LogLimits) -> pl.DataFrame:
    text = _unpacked(data, mapping, where, limits) if is_gzip(data) else data
    _refuse_packed(text, where)
    try:
        text = plain_text(as_utf8(below(text, mapping.skip)), mapping.delimiter, mapping.comment)
    except UnicodeDecodeError as error:
        byte = f"byte {error.start} is 0x{error.object[error.start]:02x}"
        raise NotTextError(
            f"{where} is not UTF-8 text ({byte}): save it as UTF-8, if it is a table"
        ) from error
    header = header_of(text, mapping)
    limits.check(len(text), text.count(b"\n"), columns_of(header, mapping), where)
    if not header:
        raise UndertowError(f"{where} is empty (no header): check that the log is complete")
    names = next(csv.reader([header.decode("utf-8-sig")], delimiter=mapping.delimiter))
    after = _row_after(header, text, mapping)
    _refuse_no_names(names, after, where, mapping)
    if len(after) == len(names) + 1 and not after[-1].strip():  # each row ends with a delimiter
        text = re.sub(rb"(?m)%b(?=\r?$)" % re.escape(mapping.delimiter.encode()), b"", text)
    # Polars would give the second of two columns of one name another one, and a blank line below comments is
    # a header to it.
    _refuse_doubled(names, where)
    above = 0 if text.startswith(header) else text.find(b"\n" + header) + 1
    try:
        table = pl.read_csv(
            text[above:],
            infer_schema=False,
            separator=mapping.delimiter,
            comment_prefix=mapping.comment,
            null_values=[*_ALWAYS_MISSING, *(value for value in mapping.missing if isinstance(value, str))],
        )
    except _UNREADABLE as error:
        raise (_too_many_cells(text, mapping, where) or error) from error
    if len(table.columns) != len(names):
        raise UndertowError(f"{where} has a header with a quote that does not end: write its names anew")
    # Spreadsheets leave several without a name behind a table: only the first, an index, can be meant.
    table = without_units(table) if mapping.not_numbers == "missing" else table
    return table.drop(n for n, name in zip(table.columns, names, strict=True) if n and not name.strip())


def _refuse_packed(text: bytes, where: str) -> None:
    packed = next((how for magic, how in _PACKED.items() if text.startswith(magic)), None)
    if packed == "zip" and any(part in text for part in _SPREADSHEET):
        raise UndertowError(f"{where} is a spreadsheet: save the sheet with the log as CSV")
    if packed is not None:
        raise UndertowError(f"{where} is packed by {packed}: unpack it, or pack it with gzip")


def _row_after(header: bytes, text: bytes, mapping: LogMapping) -> list[str]:
    """The cells of the line after a header."""
    begin = text.find(header) + len(header)
    line = header_of(text[begin : begin + WHOLE.piece], mapping).decode(errors="replace")
    return next(csv.reader([line], delimiter=mapping.delimiter), [])


def _refuse_no_names(names: list[str], after: list[str], where: str, mapping: LogMapping) -> None:
    """Refuse a first line with numbers or dates where the line after it has them: that is no header."""
    if mapping.delimiter == " " and 0 < len(after) < len(names):
        raise UndertowError(
            f"{where} has {len(names)} names ({' '.join(names)[:60]}), but {len(after)} cells in its first "
            "row: write names with blanks in double quotes"
        )
    dated = re.compile(DATE)
    numeric, later = ([is_number(c) or bool(dated.match(c)) for c in row] for row in (names, after))
    counted = [[str(k + first) for k in range(len(names))] for first in (0, 1)]
    decimals = sum("." in name for name in names if is_number(name))  # hardly names, whatever is below them
    alike = all(numeric) or (any(numeric) and numeric == later) or 2 * decimals > len(names)
    if len(names) > 1 and alike and names not in counted:
        begins = f"has numbers in line {mapping.skip + 1}" if mapping.skip else "begins with numbers"
        raise UndertowError(
            f"{where} {begins} ({', '.join(names[:3])} …): write a line with the names of its {len(names)} "
            f"columns {'right above it' if mapping.skip else 'on top'}"
        )


def _too_many_cells(text: bytes, mapping: LogMapping, where: str) -> UndertowError | None:
    """The error where a line has more cells than the header names; None where none has."""
    rows, known = csv.reader(io.StringIO(text.decode("utf-8-sig")), delimiter=mapping.delimiter), 0
    for row in rows:
        if not row or (mapping.comment and row[0].startswith(mapping.comment)):
            continue
        if len(row) > (known := known or len(row)):
            line = rows.line_num + mapping.skip
            return UndertowError(
                f"{where} cannot be read as a table: line {line} has {len(row)} cells, the header {known}: "
                "delete lines that are neither header nor data, or state delimiter, comment and skip (lines "
                "above the header) in a mapping file, which undertow map new tries to find"
            )
    return None


def header_of(text: bytes, mapping: LogMapping) -> bytes:
    """The line of a text that names the columns; empty where there is none, or it is incomplete."""
    comment, place = (mapping.comment or "\0").encode(), 0
    while place < len(text):
        end = text.find(b"\n", place) + 1 or len(text)
        line = text[place:end]
        if line.strip(b"\xef\xbb\xbf \r\n") and not line.startswith(comment):
            return line
        place = end
    return b""


def columns_of(header: bytes, mapping: LogMapping) -> int:
    """How many columns a header names."""
    blanks = mapping.delimiter == " "
    return len(header.split()) if blanks else header.count(mapping.delimiter.encode()) + 1


def _unpacked(data: bytes, mapping: LogMapping, where: str, limits: LogLimits) -> bytes:
    """The text of a gzip file; refused as soon as it is too much."""
    pieces: list[bytes] = []
    size = rows = columns = 0
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(data)) as stream:
            while piece := stream.read(WHOLE.piece):
                pieces.append(piece)
                size, rows = size + len(piece), rows + piece.count(b"\n")
                columns = columns or columns_of(header_of(below(piece, mapping.skip), mapping), mapping)
                limits.check(size, rows, columns, where)
    except DAMAGED as error:
        raise UndertowError(f"{where} is a damaged gzip file ({error}): copy it again") from error
    return b"".join(pieces)


def _refuse_doubled(columns: Iterable[str], where: str) -> None:
    known = Counter(name.strip() for name in columns)
    doubled = [name for name, count in known.items() if count > 1 and name]
    if doubled:
        raise UndertowError(
            f"{where} has column {doubled[0]!r} more than once: rename one of them in the header"
        )


def numbers(table: pl.DataFrame, name: str, mapping: LogMapping, where: str) -> NDArray[np.float64]:
    """Return one column as numbers, NaN where a cell is missing."""
    column = _as_text(table[name])
    cells = _text_to_number(column, mapping, where) if column.dtype == pl.String else column
    if not (cells.dtype.is_numeric() or cells.dtype in (pl.Boolean, pl.Null)):
        raise UndertowError(
            f"{where}: column {name!r} holds {cells.dtype}, not numbers: convert or ignore it"
        )
    values = cells.cast(pl.Float64).fill_null(np.nan).to_numpy().copy()
    sentinels = [float(value) for value in mapping.missing if is_number(value)]
    values[np.isin(values, sentinels)] = np.nan
    return values


def _text_to_number(column: pl.Series, mapping: LogMapping, where: str) -> pl.Series:
    cast, odd = _cast(column, mapping)
    if len(odd) and mapping.not_numbers == "refuse":
        raise UndertowError(
            f"{where}: column {column.name!r} has the text {str(column[odd[0]]).strip()[:40]!r} in row "
            f"{odd[0] + 1} ({len(odd)} such rows): name it under `missing` in a mapping file, treat all such "
            'cells as missing there with not_numbers = "missing", or leave the column out'
        )
    return cast


def _cast(column: pl.Series, mapping: LogMapping) -> tuple[pl.Series, pl.Series]:
    """A column of texts as numbers, and the rows whose cells are none."""
    cells = _with_points(column, mapping)
    cast = cells.cast(pl.Float64, strict=False)
    if not (cast.is_null() & column.is_not_null()).any():
        return cast, pl.Series(dtype=pl.UInt32)
    cells = with_signs(_stripped(cells))  # the slow way only where it is needed
    bare = cells.str.extract(_WITH_UNIT, 1) if _unit_of(cells) else cells
    bare = bare.str.replace("(?i)^true$", "1").str.replace("(?i)^false$", "0")
    cast = bare.cast(pl.Float64, strict=False)
    return cast, (cast.is_null() & cells.is_not_null()).arg_true()


def texts_in(table: pl.DataFrame, name: str, mapping: LogMapping) -> list[str]:
    """The cells of a column that are no numbers, and not known to be missing."""
    column = _as_text(table[name])
    if column.dtype != pl.String:
        return []
    return [str(cell).strip() for cell in column.gather(_cast(column, mapping)[1])]


def _with_points(column: pl.Series, mapping: LogMapping) -> pl.Series:
    return column.str.replace(",", ".", literal=True) if mapping.decimal == "," else column


def _stripped(cells: pl.Series) -> pl.Series:
    cells = cells.str.strip_chars()
    return cells.set(cells.is_in(_ALWAYS_MISSING), None)


def unit_of_cells(table: pl.DataFrame, name: str, mapping: LogMapping) -> str:
    """The unit that every cell of a column states behind its number ("1.76V"); "" where none does."""
    column = _as_text(table[name])
    if column.dtype != pl.String:
        return ""
    return _unit_of(with_signs(_stripped(_with_points(column, mapping))))


def in_unit_of_cells(unit: str, name: str, column: Column, where: str) -> Column:
    """The column in the `unit` that its cells state; another one in the mapping file is refused."""
    if not unit or column.unit is None:
        return column.model_copy(update={"unit": unit}) if unit else column
    if not same_unit(unit, column.unit):
        raise UndertowError(
            f"{where}: cells of column {name!r} state {unit}, but the mapping file {column.unit}: write unit "
            f'= "{unit}" there'
        )
    return column


def taken_as_missing(table: pl.DataFrame, names: Iterable[str], mapping: LogMapping) -> list[str]:
    """One note for each column with cells that are no numbers, where these are taken as missing."""
    if mapping.not_numbers == "refuse":
        return []
    texts = {name: texts_in(table, name, mapping) for name in names}
    return [f"column {n!r}: {len(t)} cells such as {t[0][:40]!r} are missing" for n, t in texts.items() if t]


def _unit_of(cells: pl.Series) -> str:
    first = next((cell for cell in cells if cell is not None), "")
    found = re.fullmatch(_WITH_UNIT, first)
    if found is None or not is_unit(found[2]):
        return ""
    same = (cells.str.extract(_WITH_UNIT, 2) == found[2]).fill_null(cells.is_null())
    return found[2] if same.all() else ""


def is_number(value: float | str) -> bool:
    """Whether a cell is a number."""
    try:
        float(value)
    except ValueError:
        return False
    return True


def elapsed(
    table: pl.DataFrame, mapping: LogMapping, scale: float, where: str, origin: Origin | None = None
) -> tuple[NDArray[np.float64], Origin]:
    """Return the time column as numbers from an origin, in its own unit, and the origin."""
    # Whole numbers and texts are subtracted before they become floats, which resolve nanoseconds since 1970
    # to 256 only.
    name = mapping.time.column
    raw = numbers(table, name, mapping, where)
    if origin is None and not (len(raw) and abs(scale * raw[0]) > WHOLE.own_clock):
        origin = 0.0
    exact = _as_decimals(table[name], mapping) if origin != 0.0 else None
    if origin is None:
        origin = float(raw[0]) if exact is None else exact.item(0)
    rest: NDArray[np.float64] | float = 0.0
    if mapping.time.nanoseconds is not None:
        rest = 1e-9 * numbers(table, mapping.time.nanoseconds, mapping, where)
    if exact is None or not isinstance(origin, Decimal):
        return raw - float(origin) + rest, origin
    return np.where(np.isnan(raw), np.nan, _counts_since(exact, origin)) + rest, origin


def _as_decimals(column: pl.Series, mapping: LogMapping) -> pl.Series | None:
    """A column of numbers as decimals; None where they are floats, or not all of them can be."""
    cells = _as_text(column)
    if cells.dtype == pl.String:
        cells = _with_points(cells.str.strip_chars(), mapping)
    elif not (cells.dtype.is_integer() or cells.dtype.is_decimal()):
        return None
    exact = cells.cast(_EXACT, strict=False)
    return None if exact.is_null().any() else exact


def _counts_since(exact: pl.Series, origin: Decimal) -> NDArray[np.float64]:
    return (exact - origin).cast(pl.Float64).fill_null(np.nan).to_numpy()


def _as_text(column: pl.Series) -> pl.Series:
    """A column of categories as texts."""
    return column.cast(pl.String) if column.dtype in (pl.Categorical, pl.Enum) else column


def seconds(
    table: pl.DataFrame, name: str, where: str, origin: Origin | None = None
) -> tuple[NDArray[np.float64], str, Origin]:
    """Return a column of dates or times (or ISO 8601 texts) as seconds, the entry at zero, and its count.

    Zero is the first entry, or that of another part of the log, given by its count `origin`. Durations are
    seconds already: they have no origin, and the entry is empty.
    """
    stamps = _as_text(table[name])
    if stamps.dtype == pl.String:
        stamps = _parsed(stamps, where)
    if not stamps.dtype.is_temporal():
        raise UndertowError(
            f"{where}: time column {name!r} holds {stamps.dtype}, not ISO 8601 time stamps: give its unit in "
            'the mapping file, such as unit = "ns"'
        )
    first = stamps.drop_nulls().first()
    if first is None:
        return np.full(table.height, np.nan), "", Decimal(0) if origin is None else origin
    ticks, tick = stamps.to_physical().cast(_EXACT), _tick(stamps.dtype)
    if stamps.dtype == pl.Duration:
        return tick * _counts_since(ticks, Decimal(0)), "", Decimal(0)
    zero = Decimal(origin) if origin is not None else ticks.drop_nulls().item(0)
    t = tick * _counts_since(ticks, zero)
    without_date = tick * float(stamps.to_physical().cast(pl.Float64).max() or 0.0) < _DAY  # type: ignore[arg-type]
    return through_midnight(t) if without_date else t, str(first).removeprefix("1970-01-01 "), zero


def through_midnight(t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Times of day, s since the one that counts as zero, that go on after midnight."""
    there = np.isfinite(t)
    step = np.diff(t[there], prepend=0.0)
    days = np.cumsum(1.0 * (step < -_DAY / 2) - 1.0 * (step > _DAY / 2))  # a late row is of the day before
    whole = t.copy()
    whole[there] += _DAY * (days - np.minimum.accumulate(np.minimum(days, 0.0)))
    return whole


def padded(stamps: pl.Series) -> pl.Series:
    """Texts of dates with zeros before the fraction of a second, where time then goes back less often."""
    # Some loggers write 93 ms and 992 ms as ".93" and ".992".
    stamps = as_iso(stamps)
    parts = stamps.str.extract_groups(_FRACTION).struct
    digits = parts.field("2").str.len_chars()
    if digits.null_count() or digits.min() == digits.max():
        return stamps
    texts = parts.field("1") + parts.field("2").str.zfill(int(str(digits.max()))) + parts.field("3")
    as_written, whole = (s.str.to_datetime(time_unit="ns", strict=False) for s in (stamps, texts))
    return texts if _steps_back(whole) < _steps_back(as_written) else stamps


def _steps_back(times: pl.Series) -> int:
    """How often a time is earlier than the one before it; every one that cannot be read counts."""
    return int((times.diff().dt.total_nanoseconds() < 0).sum() or 0) + times.null_count()


def has_dates(column: pl.Series) -> bool:
    """Tell whether the first text of a column is a date with the time of day."""
    first = column.drop_nulls().first() if column.dtype == pl.String else None
    return first is not None and bool(as_iso(pl.Series([str(first)])).str.contains(DATE)[0])


def lacking_zeros(table: pl.DataFrame, name: str) -> list[str]:
    """A note on fractions of a second that were read with zeros before them, none where there are none."""
    stamps = _as_text(table[name])
    if stamps.dtype != pl.String:
        return []
    changed = (padded(stamps) != as_iso(stamps)).arg_true()
    if not len(changed):
        return []
    return [
        f"{len(changed)} times such as {stamps[changed[0]]!r} lack zeros before the fraction of a second: "
        f"read as {padded(stamps)[changed[0]]}"
    ]


def _tick(kind: pl.DataType) -> float:
    """Seconds in one count of a column of dates or times."""
    if isinstance(kind, pl.Datetime | pl.Duration):
        return {"ns": 1e-9, "us": 1e-6, "ms": 1e-3}[kind.time_unit]
    return 86400.0 if kind == pl.Date else 1e-9


def _parsed(stamps: pl.Series, where: str) -> pl.Series:
    try:
        parsed = padded(stamps).str.to_datetime(time_unit="ns", strict=False)
    except pl.exceptions.ComputeError:  # polars found no date at all
        parsed = pl.Series([None] * len(stamps), dtype=pl.Datetime("ns"))
    odd = (parsed.is_null() & stamps.is_not_null()).arg_true()
    if len(odd):
        raise UndertowError(
            f"{where}: time {stamps[odd[0]][:40]!r} in row {odd[0] + 1} is not an ISO 8601 time stamp such "
            "as 2024-05-01T12:00:00.250Z: rewrite it, or give the unit of a numeric time column"
        )
    return parsed


def is_dates(table: pl.DataFrame, name: str) -> bool:
    """Tell whether a column holds dates or times of their own type (Parquet)."""
    return table[name].dtype.is_temporal()
