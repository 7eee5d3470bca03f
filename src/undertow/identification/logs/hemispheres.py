"""Latitude and longitude that state their hemisphere by a letter, in their cells or in a column beside."""

from __future__ import annotations

from collections.abc import Sequence

import polars as pl

from .guess_names import Name, is_on_globe, kind_on_globe

_LETTER = r"^([0-9]+\.?[0-9]*)\s*°?\s*[{}]$"
_LETTERS = ("NS", "EW")
# Words for a column of such letters: "N/S", "ew", "lat_hemisphere".
_CALLED = ({"ns", "n", "hemisphere", "hemi"}, {"ew", "e", "hemisphere", "hemi"})


def with_signs(cells: pl.Series) -> pl.Series:
    """The cells of a column with a sign in place of the letter, "33.5 S" as -33.5; others as they are.

    In a column of another name the same letters are units: newtons, siemens, watts.
    """
    if not is_on_globe(cells.name):
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
    texts = [n for n in table.columns if table.schema[n] == pl.String]
    letters = {n: kind for n in texts for kind in (0, 1) if _are_letters(table[n], kind)}
    places = {n: kind for n in table.columns if (kind := kind_on_globe(n)) is not None and n not in letters}
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
    known = cells.drop_nulls().str.strip_chars()
    return len(known) > 0 and known.str.to_uppercase().is_in([*_LETTERS[kind]]).all()


def _is_called_so(name: str, kind: int) -> bool:
    return bool({*Name.of(name).words} & _CALLED[kind]) or kind_on_globe(name) == kind


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
