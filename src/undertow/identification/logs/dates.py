"""Texts of dates and times of day, as loggers and spreadsheets write them, in the form of ISO 8601."""

from __future__ import annotations

import numpy as np
import polars as pl

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
