"""Latitude and longitude that state their hemisphere by a letter."""

from __future__ import annotations

import polars as pl

from .guess_names import is_on_globe

_LETTER = r"^([0-9]+\.?[0-9]*)\s*°?\s*[{}]$"


def with_signs(cells: pl.Series) -> pl.Series:
    """The cells of a column with a sign in place of the letter, "33.5 S" as -33.5; others as they are.

    In a column of another name the same letters are units: newtons, siemens, watts.
    """
    if not is_on_globe(cells.name):
        return cells
    positive = cells.str.replace(_LETTER.format("NEne"), "${1}")
    return positive.str.replace(_LETTER.format("SWsw"), "-${1}")
