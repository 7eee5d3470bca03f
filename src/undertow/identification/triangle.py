"""Any number of rows of a regression as one triangular factor."""

from __future__ import annotations

import numpy as np

from undertow.typing import Array


class Triangle:
    """Any number of rows of a regression as the triangular factor of their QR decomposition.

    Rows are added in blocks and not kept: what is held are (k + 1)^2 numbers for k parameters. The solution
    is that of all rows together, with the precision of a QR decomposition (not that of normal equations).

    Parameters
    ----------
    parameters : int
        How many there are.
    """

    def __init__(self, parameters: int) -> None:
        self.factor, self.count = np.zeros((0, parameters + 1)), 0

    def add(self, rows: Array, count: int) -> None:
        """Take in rows, target in the last column, or few rows with the products of `count` samples."""
        self.factor = np.asarray(np.linalg.qr(np.vstack([self.factor, rows]), mode="r"), dtype=float)
        self.count += count

    def split(self) -> tuple[Array, Array]:
        """Regressor and target with few rows that have the same products as all."""
        return self.factor[:, :-1], self.factor[:, -1]
