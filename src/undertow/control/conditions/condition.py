"""The contract of a condition on gains: one statement, from which its checks of every kind follow."""

from __future__ import annotations

import abc
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
import sympy as sm

from .interval import block, least_eigenvalue

FORMS = {
    "printed": "as the mini-AUV paper prints them",
    "units": "the printed ones with units that fit (ι in 1/s)",
    "derived": "derived from the model itself",
}
"""Where a condition comes from."""


class Signs:
    """What a condition may use: gains by name, M, D and iota, as symbols, numbers, matrices or intervals.

    Parameters
    ----------
    quantities : mapping
        Value by name.
    """

    def __init__(self, quantities: Mapping[str, Any]) -> None:
        self._quantities = dict(quantities)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name not in self._quantities:
            raise AttributeError(f"no condition can use '{name}'")
        return self._quantities[name]

    def block(self, rows: Sequence[Sequence[Any]]) -> Any:
        """A matrix of blocks."""
        if any(isinstance(cell, sm.Basic) for row in rows for cell in row):
            return sm.Matrix([list(row) for row in rows])
        return block(rows)

    def root(self, value: Any) -> Any:
        """Square root of a number or symbol that is not negative."""
        return sm.sqrt(value) if isinstance(value, sm.Basic) else np.sqrt(np.maximum(value, 0.0))

    def transposed(self, value: Any) -> Any:
        """The transpose of a matrix; a scalar is its own."""
        if isinstance(value, sm.Basic):
            return value
        return np.swapaxes(value, -1, -2) if isinstance(value, np.ndarray) else value.T


class Condition(abc.ABC):
    """A demand `left > right` on gains.

    For a given iota the left side is concave and the right side convex in M and D together, so that over
    a box or a polytope of parameters the margin is least at a corner; it is concave in every single gain and
    in iota, too, so that the values that satisfy it are an interval.

    Attributes
    ----------
    id : str
        Short name.
    form : str
        One of `FORMS`.
    statement : str
        The demand on one channel, as text.
    matrices : str
        The demand on matrices in the paper's notation: eigenvalues that are compared (λmin, λmax), or a
        matrix that is positive definite (≻ 0); nothing where it is stated for one channel only.
    about : str
        What it is for, one sentence.
    source : str
        Where it is from.
    eigenvalues : bool
        Whether it compares the smallest eigenvalue of the left with the largest of the right side; otherwise
        the difference has to be positive definite.
    uses_iota : bool
        Whether it contains iota.
    per_channel_only : bool
        Whether it is stated for one channel (a scalar) and not for matrices.
    matrix_only : bool
        Whether a channel by itself adds nothing to what the matrices say.
    uses : tuple of str
        Which of M and D it contains.
    """

    id: ClassVar[str]
    form: ClassVar[str]
    statement: ClassVar[str]
    matrices: ClassVar[str] = ""
    about: ClassVar[str]
    source: ClassVar[str]
    eigenvalues: ClassVar[bool] = False
    uses_iota: ClassVar[bool] = False
    per_channel_only: ClassVar[bool] = False
    matrix_only: ClassVar[bool] = False
    uses: ClassVar[tuple[str, ...]] = ()

    @abc.abstractmethod
    def left(self, s: Signs) -> Any:
        """What has to be the larger side."""

    def right(self, s: Signs) -> Any:
        """What has to be the smaller side; zero unless stated."""
        return 0.0 * self.left(s)

    def margin(self, s: Signs) -> Any:
        """How far the condition is from failing; a lower bound of it where the quantities are intervals."""
        left, right = self.left(s), self.right(s)
        if self.eigenvalues:
            return least_eigenvalue(left) + least_eigenvalue(-right)
        return least_eigenvalue(left - right)

    def sides(self, s: Signs) -> tuple[float, float]:
        """Smallest eigenvalue of the left and largest of the right side."""
        return float(least_eigenvalue(self.left(s))), -float(least_eigenvalue(-self.right(s)))
