"""Every so many-th row of a table, without losing what reports more rarely than that."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
import polars as pl
from numpy.typing import NDArray

Rows = NDArray[np.intp]


def decimated(tables: Iterable[pl.DataFrame], every: int) -> Iterator[pl.DataFrame]:
    """Every so many-th row of tables that follow each other.

    In a table of sensors with clocks of their own, what reports more rarely would be lost with the rows in
    between, and a command would be held beyond its next one. So a row in between is kept if it has a report
    of a column of which none was kept for so many rows.
    """
    before, last = 0, dict[str, int]()
    for table in tables:
        place = before + np.arange(table.height)
        kept = place % every == 0
        for name in table.columns:
            reports = place[_there(table[name])]
            late = _late(reports, every, last.get(name, -every))
            kept[late - before] = True
            last[name] = max((last.get(name, -every), *late[-1:], *reports[reports % every == 0][-1:]))
        yield table.filter(kept)
        before += table.height


def _late(reports: Rows, every: int, last: int) -> Rows:
    """Those of the reports that come so many rows, or more, after the last that is kept."""
    regular = np.where(reports % every == 0, reports, last)
    since = np.maximum.accumulate(regular) if len(regular) else regular
    between = reports - since >= every
    found: list[int] = []
    for report, regularly in zip(reports[between], since[between], strict=True):
        if report - max((regularly, *found[-1:])) >= every:
            found.append(int(report))
    return np.array(found, dtype=np.intp)


def _there(column: pl.Series) -> NDArray[np.bool_]:
    there = column.is_not_null()
    if column.dtype.is_float():
        there &= column.is_not_nan().fill_null(value=False)
    return there.to_numpy()
