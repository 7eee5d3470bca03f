"""What a simulation needs and fills, whoever runs it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

from undertow.typing import Array, Integers


@dataclass
class Problem:
    """Arrays of a simulation; where runs share t, u or p, its leading size is one.

    Attributes
    ----------
    t : ndarray, shape (b or 1, n)
        Times of the samples, s.
    steps : ndarray of int64, shape (b or 1, n - 1)
        Runge-Kutta steps from sample to sample.
    u : ndarray, shape (b or 1, n, nu)
        Inputs, held from their sample to the next.
    p : ndarray, shape (b or 1, np)
        Parameters.
    x : ndarray, shape (b, n, nx)
        States; the first sample is given, the others are written.
    wrt : ndarray of int64, shape (m,)
        Parameter of every sensitivity column, -1 for columns of an initial state.
    s : ndarray, shape (b, n, nx, m)
        Sensitivities; the first sample is given, the others are written. No column where none are wanted.
    """

    t: Array
    steps: Integers
    u: Array
    p: Array
    x: Array
    wrt: Integers
    s: Array

    def part(self, runs: slice) -> Problem:
        """Some of the runs, in the same memory."""
        names = ("t", "steps", "u", "p", "x", "s")
        arrays = {n: getattr(self, n) for n in names}
        own = len(self.x)
        return replace(self, **{n: a[runs] if len(a) == own else a for n, a in arrays.items()})


class Stepper(Protocol):
    """Advances a problem from sample `first` to sample `last`."""

    def advance(self, problem: Problem, first: int, last: int) -> None: ...
