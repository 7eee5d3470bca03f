"""The samples that each test function sees, as dense windows of one width."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from undertow.typing import Array, Index


@dataclass(frozen=True)
class Windows:
    """Windows of one width W for K test functions.

    Attributes
    ----------
    first : (K,) array of int
        First sample of each window; none begins before the one in front of it.
    samples : int
        Number of samples; a window may reach beyond the last one, with weights of zero.
    weights : (kinds, K, W) array
        Weights of every kind.
    """

    first: Index
    samples: int
    weights: Array

    @classmethod
    def of(cls, kinds: Sequence[csr_array]) -> Windows:
        """Windows around what every test function sees with any kind of weights (K, N)."""
        parts = [w.tocoo() for w in kinds]
        count, samples = kinds[0].shape
        first, last = np.full(count, samples - 1), np.zeros(count, dtype=np.intp)
        for part in parts:
            np.minimum.at(first, part.row, part.col)
            np.maximum.at(last, part.row, part.col)
        first = np.ascontiguousarray(np.minimum.accumulate(first[::-1])[::-1])
        width = max(int(np.max(last - first)), 0) + 1
        weights = np.zeros((len(parts), count, width))
        for kind, part in zip(weights, parts, strict=True):
            kind[part.row, part.col - first[part.row]] = part.data
        return cls(first, samples, weights)

    def part(self, which: slice) -> Windows:
        """Some of the windows."""
        return Windows(self.first[which], self.samples, self.weights[:, which])

    @property
    def index(self) -> Index:
        """Sample at each place of each window, shape (K, W); beyond the last one, that one again."""
        return np.minimum(self.first[:, None] + np.arange(self.weights.shape[2]), self.samples - 1)
