"""Texts in cells, in the form in which everything else reads them.

Dates and times of day, as loggers and spreadsheets write them, become ISO 8601; latitude and longitude that
state their hemisphere by a letter, in their cells or in a column beside, get a sign.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl


@dataclass(frozen=True)
class CellSettings:
    """Settings for telling texts from numbers."""

    rows_of_units: int = 3  # lines between names and numbers, at most: units, descriptions


SETTINGS = CellSettings()

# The names of a file of Tecplot, and lines that describe its rows.
_VARIABLES = re.compile(
    rb"(?im)\A(?:\s*title\s*=.*\n)?\s*variables\s*=\s*(.*(?:\n\s*\".*)*)\n(?:\s*zone\b.*\n)?"
)


# Bytes that are in no text.
_NO_TEXT = re.compile(rb"[\x00-\x08\x0e-\x1f\x7f\x81\x8d\x8f\x90\x9d]")


def below(text: bytes, lines: int) -> bytes:
    """A text without so many of its lines."""
    if lines == 0:  # a long one is not copied
        return text
    parts = text.split(b"\n", lines)
    return parts[lines] if len(parts) > lines else b""


def as_utf8(text: bytes) -> bytes:
    """A text in UTF-8; one of Windows, in which a degree sign is one byte, is converted."""
    if text.isascii():
        return text
    try:
        text.decode("utf-8")
    except UnicodeDecodeError:
        if _NO_TEXT.search(text):
            raise
        return text.decode("cp1252").encode("utf-8")
    return text


def plain_text(text: bytes, delimiter: str, comment: str | None = None) -> bytes:
    """A text without what a file system leaves behind where power was lost, and with one end of each line.

    Blanks that are the delimiter are single, and where a sign of comments stands before the names, which is
    not the `comment` of the text, it is none of them. Of a Tecplot file the names are the header.
    """
    text = re.sub(rb"\r\r+\n", b"\n", text.rstrip(b"\0"))
    found, sign = _VARIABLES.match(text), delimiter.encode()
    if not found and delimiter != " ":
        return text
    # Several blanks in a row are one, as in columns that stand below each other.
    rows = re.sub(rb"(?m)^[ \t]+|[ \t]+(?=\r?$)", b"", text[found.end() if found else 0 :])
    rows = rows if found or comment else re.sub(rb"\A\s*[#%!*][ \t]+", b"", rows)
    rows = re.sub(rb"[ \t,]+" if found else rb"[ \t]+", sign, rows)
    names = re.findall(rb'"([^"]*)"|([^\s,"]+)', found[1]) if found else []
    return sign.join(b'"%b"' % (a or b).strip() for a, b in names) + b"\n" * bool(found) + rows


def without_units(table: pl.DataFrame) -> pl.DataFrame:
    """A table of texts without rows below its names in which no cell begins with a number: units, remarks."""
    if any(kind != pl.String for kind in table.schema.values()):
        return table
    begins = pl.all().str.contains(r"^\s*[-+]?\.?\d") & ~pl.all().str.contains(r"^\s*1/[A-Za-z]")  # "1/min"
    numbered = table.head(SETTINGS.rows_of_units + 1).select(pl.any_horizontal(begins.fill_null(value=False)))
    first = numbered.to_series().arg_true()
    return table.slice(first.item(0)) if len(first) else table


# A date whose year comes first means the same whatever is between its numbers.
DATE = r"^(\d{4})[-/._](\d{2})[-/._](\d{2})[T_ ]+(\d{2}:\d{2})"
_YEAR_LAST = r"^(\d{1,2})[-/. ](\d{1,2})[-/. ](\d{4})[T_, ]+(\d{1,2})(:\d{2}\S*)\s*([AaPp][Mm])?\s*(.*)$"
_OF_DAY, _THREE = r"^(\d{1,2}):(\d{2}:\d{2}(?:\.\d+)?)$", r"T0(\d{2}):"
DIGITS_OF_DAY = r"^(\d{1,2})(\d{2})(\d{2}(?:\.\d+)?)$"
"""Hours, minutes and seconds side by side, as GPS receivers write them."""
_WITH_MILLISECONDS = r"^(\d{1,2}\d{2}\d{2})(\d{3})$"
_AFTER_SECONDS = r"^(\d{4}-\d{2}-\d{2}T\d{2}:\d{2}:\d{2})[,:](\d+)"
_MONTHS = ("Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec")
_MONTH = rf"(?i)^(\d{{1,2}}[-/. ])({'|'.join(_MONTHS)})[a-z]*([-/. ])"


def as_iso(stamps: pl.Series) -> pl.Series:
    """Texts of dates with the signs of ISO 8601 between their numbers."""
    stamps = _with_year_first(_with_numbered_months(stamps.str.strip_chars()))
    stamps = stamps.str.replace(DATE, "$1-$2-${3}T$4")
    stamps = with_points(stamps).str.replace(DIGITS_OF_DAY, "$1:$2:$3")
    # The time of day alone counts from midnight.
    stamps = stamps.str.replace(_OF_DAY, "1970-01-01T0$1:$2").str.replace(_THREE, "T$1:")
    return stamps.str.replace(_AFTER_SECONDS, "$1.$2")


def with_points(stamps: pl.Series) -> pl.Series:
    """Digits of times of day with a point before the milliseconds: "122237.104" for "122237104"."""
    return stamps.str.replace(_WITH_MILLISECONDS, "$1.$2")


def _with_numbered_months(stamps: pl.Series) -> pl.Series:
    """The texts with the number of the month in place of its English name."""
    name = stamps.str.extract(_MONTH, 2).str.to_titlecase()
    if name.null_count() == len(name):
        return stamps
    number = name.replace_strict({m: str(k) for k, m in enumerate(_MONTHS, 1)}, default=None)
    return stamps.str.extract(_MONTH, 1) + number + stamps.str.replace(_MONTH, "$3")


def _with_year_first(stamps: pl.Series) -> pl.Series:
    """Dates whose year comes last, day or month before it, in the order of ISO 8601."""
    parts = stamps.str.extract_groups(_YEAR_LAST).struct.unnest()
    if parts["3"].null_count() == len(stamps) or (parts["3"].is_null() & stamps.is_not_null()).any():
        return stamps
    one, other, year, hour = (parts[n].cast(pl.Int64) for n in "1234")
    afternoon = parts["6"].str.to_lowercase()
    hour = (hour % 12 + 12 * (afternoon == "pm").cast(pl.Int64)).zip_with(afternoon.is_not_null(), hour)
    # A number beyond 12 is a day. Where there is none, a log lasts days rather than months; within one day
    # the order makes no difference to the times.
    a, b, years = (column.drop_nulls().to_numpy() for column in (one, other, year))
    days_first, months_first = (np.ptp(372 * years + 31 * m + d) for d, m in ((a, b), (b, a)))
    month_first = b.max() > 12 or (a.max() <= 12 and months_first < days_first)
    day, month = (other, one) if month_first else (one, other)
    numbers = [_digits(n) for n in (month, day, hour)]
    return parts["3"] + "-" + numbers[0] + "-" + numbers[1] + "T" + numbers[2] + parts["5"] + parts["7"]


def _digits(number: pl.Series) -> pl.Series:
    return number.cast(pl.String).str.zfill(2)


# --- hemispheres ----------------------------------------------------------------------------------
# English and French, Italian, Spanish, Portuguese, German.
GLOBE = (
    {"lat", "latitude", "latitudine", "latitud", "breite", "breitengrad"},
    {"lon", "lng", "long", "longitude", "longitudine", "longitud", "laenge", "laengengrad"},
)
_ACCENTS = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "Ä": "Ae", "Ö": "Oe", "Ü": "Ue"})
_LETTER = r"^([0-9]+\.?[0-9]*)\s*°?\s*[{}]$"
_LETTERS = ("NS", "EW")
# Words for a column of such letters: "N/S", "ew", "lat_hemisphere".
_CALLED = ({"ns", "n", "hemisphere", "hemi"}, {"ew", "e", "hemisphere", "hemi"})


# Of water and of units, in which a small letter is no motion: "pH", "uS/cm".
_SYMBOLS = re.compile(r"(?<![A-Za-z])(pH|pC?O2|u[SMVA])(?![a-z])")


def words_of(name: str) -> list[str]:
    """The words of the name of a column, in small letters: "yawRate" is "yaw" and "rate"."""
    whole = _SYMBOLS.sub(lambda symbol: symbol[0].lower(), name.translate(_ACCENTS))
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", whole)
    return [w.lower() for w in re.split(r"[^A-Za-z0-9%]+|%(?=\w)", spaced) if w]  # %time of rostopic


def kind_on_globe(name: str) -> int | None:
    """0 for a column that is called a latitude, 1 for a longitude, None for any other."""
    words = {*words_of(name)}
    return next((kind for kind, called in enumerate(GLOBE) if words & called), None)


def with_signs(cells: pl.Series) -> pl.Series:
    """The cells of a column with a sign in place of the letter, "33.5 S" as -33.5; others as they are.

    In a column of another name the same letters are units: newtons, siemens, watts.
    """
    if kind_on_globe(cells.name) is None:
        return cells
    positive = cells.str.replace(_LETTER.format("NEne"), "${1}")
    return positive.str.replace(_LETTER.format("SWsw"), "-${1}")


def with_signs_beside(table: pl.DataFrame) -> pl.DataFrame:
    """The table with a sign at every latitude and longitude whose letter stands in a column of its own.

    A number that has its sign already keeps it.
    """
    return table.with_columns(
        _signed(table[place], table[letters]) for place, letters in letters_beside(table).items()
    )


def letters_beside(table: pl.DataFrame) -> dict[str, str]:
    """The column with the letters of the hemisphere, by that of the latitude or longitude."""
    called = {n: kind for n in table.columns if (kind := kind_on_globe(n)) is not None}
    if not called:  # as in most tables: no cell needs to be looked at
        return {}
    texts = [n for n in table.columns if table.schema[n] == pl.String]
    letters = {n: kind for n in texts for kind in (0, 1) if _are_letters(table[n], kind)}
    places = {n: kind for n, kind in called.items() if n not in letters}
    found = {
        place: name
        for name, kind in letters.items()
        if (place := _place_of(name, [n for n in places if places[n] == kind], table.columns))
    }
    behind = {p: n for p, n in found.items() if _is_called_so(n, letters[n])}
    # Where no name says what they are, one of them may be a state, but hardly one behind either.
    return found if {places[p] for p in found} == {0, 1} else behind


def signed_by_letters(table: pl.DataFrame) -> list[str]:
    """A note on columns whose sign is that of a letter beside them."""
    found = letters_beside(table)
    return [f"signs of {', '.join(found)} by the letters in {', '.join(found.values())}"] if found else []


def _are_letters(cells: pl.Series, kind: int) -> bool:
    """Whether every cell that is not blank is a letter of a hemisphere, as for a latitude or a longitude."""
    known = cells.drop_nulls()
    # The first cell decides about most columns.
    parts = (part.str.strip_chars().str.to_uppercase() for part in (known.head(1), known))
    return len(known) > 0 and all(part.is_in([*_LETTERS[kind]]).all() for part in parts)


def _is_called_so(name: str, kind: int) -> bool:
    return bool({*words_of(name)} & _CALLED[kind]) or kind_on_globe(name) == kind


def _place_of(letters: str, places: Sequence[str], columns: Sequence[str]) -> str:
    """The place of a column of letters: that just before it, for one that is called so the nearest before."""
    at = {name: k for k, name in enumerate(columns)}
    before = [n for n in places if at[n] < at[letters]]
    nearest = max(before, key=lambda n: at[n], default=places[0] if places else "")
    kind = kind_on_globe(nearest)
    called = kind is not None and _is_called_so(letters, kind)
    return nearest if called or (before and at[letters] == at[nearest] + 1) else ""


def _signed(cells: pl.Series, letters: pl.Series) -> pl.Series:
    """Numbers, or texts of numbers, negative where their letter says south or west."""
    negative = letters.str.strip_chars().str.to_uppercase().is_in(["S", "W"]).fill_null(value=False)
    if cells.dtype == pl.String:
        bare = cells.str.strip_chars()
        turned = pl.Series(bare).str.replace(r"^\+?(\d)", "-${1}")
    elif cells.dtype.is_numeric():
        turned = -cells.abs()
    else:
        return cells
    return cells.zip_with(~negative, turned)
