"""Sparse tables of what varies from sample to sample: one column of values for each structural nonzero."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from undertow.typing import Array, Index


@dataclass(frozen=True)
class Entries:
    """Entries of a matrix at N samples.

    Attributes
    ----------
    row, column : (E,) array
        Place of every entry; the same place may occur more than once, its entries add up.
    data : (N, E) array
        Values at the samples.
    width : int
        Columns of the whole matrix.
    """

    row: Index
    column: Index
    data: Array
    width: int

    @classmethod
    def of(cls, data: Array, pattern: ca.Sparsity, first: int) -> Entries:
        """Nonzeros of a CasADi matrix, its first column at `first`."""
        row, column = _places(pattern)
        return cls(row, first + column, data, first + pattern.size2())

    @classmethod
    def chained(cls, data: Array, pattern: ca.Sparsity, slope: Array, first: int) -> Entries:
        """Chain rule: nonzeros (rows by k) times `slope` (N, k, m), its first column at `first`."""
        row, through = _places(pattern)
        width = slope.shape[2]
        felt = np.argwhere(np.any(slope, axis=0)) if slope.size else np.zeros((0, 2), dtype=np.intp)
        pairs = [(e, j) for i, j in felt for e in np.flatnonzero(through == i)]
        table = np.empty((len(data), len(pairs)))
        for k, (e, j) in enumerate(pairs):
            np.multiply(data[:, e], slope[:, through[e], j], out=table[:, k])
        places = np.array(pairs, dtype=np.intp).reshape(-1, 2)
        return cls(row[places[:, 0]], first + places[:, 1], table, first + width)

    def averaged(self, other: Entries, rows: slice) -> Entries:
        """Mean with another table of the same places, in some rows."""
        data = self.data.copy()
        chosen = (self.row >= rows.start) & (self.row < rows.stop)
        data[:, chosen] = 0.5 * (data[:, chosen] + other.data[:, chosen])
        return Entries(self.row, self.column, data, self.width)


def _places(pattern: ca.Sparsity) -> tuple[Index, Index]:
    return np.array(pattern.row(), dtype=np.intp), np.array(pattern.get_col(), dtype=np.intp)
