"""When and in which log the entries of a residual were taken."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from undertow.typing import Array, Index

from ...weak.data import WeakData
from .spectrum import Series


@dataclass(frozen=True)
class Clock:
    """Time and log of each test function.

    Attributes
    ----------
    t : (K,) array
        Middle of the test function, s.
    log : (K,) array of int
        Place of the log in `names`; pieces of one log count as one.
    start : (K,) array
        First time in the piece, s.
    names : tuple of str
        What the logs are called.
    """

    t: Array
    log: Index
    start: Array
    names: tuple[str, ...]

    @classmethod
    def of(cls, data: WeakData) -> Clock:
        """Clock of the rows of one force equation."""
        row = data.equation == data.rows[0]
        run = data.run_of[row]
        sources = [r.source or r.name for r in data.runs]
        known = list(dict.fromkeys(sources))
        names = [data.runs[sources.index(s)].name.partition(" [")[0] for s in known]
        log = np.array([known.index(s) for s in sources], dtype=np.intp)
        first = np.array([r.t[0] for r in data.runs])
        return cls(data.time[row], log[run], first[run], tuple(names))

    @property
    def step(self) -> float:
        """Time from one test function to the next, s."""
        return float(np.median(np.diff(self.t)))

    def blocks(self, seconds: float) -> Index:
        """Number of the block of time of each entry; blocks never span two pieces."""
        within = (self.t - self.start) // seconds
        pieces = np.column_stack([self.log, self.start, within])
        return np.unique(pieces, axis=0, return_inverse=True)[1].ravel()

    def series(self, r: Array) -> Series:
        """A residual on this clock."""
        return Series(self.t, r, self.log)
