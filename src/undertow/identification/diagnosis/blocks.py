"""Linearised models reduced to one small table for each block of data: what resampling needs, and no more."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from undertow.typing import Array


@dataclass(frozen=True)
class Blocks:
    """Products of the columns of a linearised model, block by block.

    The whitened residual of the model is r + shift + J delta: r is that of the model without the candidate,
    shift what the candidate changes at the point of linearisation, J its derivative there.

    Attributes
    ----------
    table : (B, k + 2, k + 2) array
        Gram matrices of the columns of J (k of them), shift and r, one for each block.
    rows : int
        Entries of the residual in all blocks.
    """

    table: Array
    rows: int

    @classmethod
    def of(cls, J: Array, shift: Array, r: Array, block: NDArray[np.intp]) -> Blocks:
        """Tables from the whitened columns and the block of every row."""
        columns = np.column_stack([J, shift, r])
        order = np.argsort(block, kind="stable")
        edges = np.flatnonzero(np.diff(block[order])) + 1
        parts = np.split(columns[order], edges)
        return cls(np.stack([part.T @ part for part in parts]), len(r))

    @property
    def count(self) -> int:
        """Number of blocks."""
        return len(self.table)

    @cached_property
    def gram(self) -> Array:
        """J' J over all blocks, shape (k, k)."""
        return np.asarray(self.table[:, :-2, :-2].sum(axis=0))

    def slope(self, signs: Array) -> Array:
        """J' (signs r + shift), shape (draws, k), for signs of the blocks of shape (draws, B)."""
        return np.asarray(signs @ self.table[:, :-2, -1] + self.table[:, :-2, -2].sum(axis=0))

    def squares(self, signs: Array, delta: Array) -> Array:
        """|signs r + shift + J delta|^2, shape (draws,), for delta of shape (draws, k)."""
        own = self.table[:, -2:, -2:].sum(axis=0)
        constant = own[0, 0] + own[1, 1] + 2 * signs @ self.table[:, -2, -1]
        return np.asarray(
            constant
            + 2 * np.einsum("dk,dk->d", delta, self.slope(signs))
            + np.einsum("dk,kl,dl->d", delta, self.gram, delta)
        )

    def without(self, dropped: int) -> Blocks:
        """The model without the shift and the last `dropped` columns of J: the one without the candidate."""
        size = self.table.shape[1]
        kept = [*range(size - 2 - dropped), size - 2, size - 1]
        table = self.table[:, kept][:, :, kept].copy()
        table[:, -2, :] = table[:, :, -2] = 0.0
        return Blocks(table, self.rows)
