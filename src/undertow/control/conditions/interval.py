"""Arrays of intervals with outward rounding, as far as bounds on eigenvalues over attitudes need them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from undertow.typing import Array, Flags

_EPS = float(np.finfo(float).eps)


class Interval:
    """An array of closed intervals; every operation contains all results that its operands allow.

    Parameters
    ----------
    lo, hi : array
        Lower and upper ends, of one shape.
    """

    __array_ufunc__ = None  # so that array * Interval comes here

    def __init__(self, lo: Any, hi: Any) -> None:
        self.lo, self.hi = np.asarray(lo, dtype=float), np.asarray(hi, dtype=float)

    @property
    def middle(self) -> Array:
        """A point of each interval near its middle."""
        return 0.5 * (self.lo + self.hi)

    @property
    def radius(self) -> Array:
        """At least the distance from the middle to either end."""
        middle = self.middle
        return np.nextafter(np.maximum(self.hi - middle, middle - self.lo), np.inf)

    def __add__(self, other: Any) -> Interval:
        o = enclose(other)
        return _out(self.lo + o.lo, self.hi + o.hi)

    __radd__ = __add__

    def __neg__(self) -> Interval:
        return Interval(-self.hi, -self.lo)

    def __sub__(self, other: Any) -> Interval:
        return self + -enclose(other)

    def __rsub__(self, other: Any) -> Interval:
        return -self + other

    def __mul__(self, other: Any) -> Interval:
        o = enclose(other)
        products = [self.lo * o.lo, self.lo * o.hi, self.hi * o.lo, self.hi * o.hi]
        return _out(np.minimum.reduce(products), np.maximum.reduce(products))

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Interval:
        return self * enclose(other).reciprocal()

    def __rtruediv__(self, other: Any) -> Interval:
        return enclose(other) * self.reciprocal()

    def __pow__(self, power: int) -> Interval:
        if power < 0:
            return self.reciprocal() ** -power
        result = enclose(np.ones_like(self.lo))
        for _ in range(power):
            result = result * self
        return result

    def __abs__(self) -> Interval:
        least = np.where((self.lo <= 0) & (self.hi >= 0), 0.0, np.minimum(np.abs(self.lo), np.abs(self.hi)))
        return Interval(least, self.size)

    @property
    def size(self) -> Array:
        """The largest magnitude in each interval."""
        return np.maximum(np.abs(self.lo), np.abs(self.hi))

    def reciprocal(self) -> Interval:
        """One over each; everything where an interval contains zero."""
        safe = (self.lo > 0) | (self.hi < 0)
        with np.errstate(divide="ignore"):
            lo, hi = np.where(safe, 1 / self.hi, -np.inf), np.where(safe, 1 / self.lo, np.inf)
        return _out(lo, hi)

    def __matmul__(self, other: Any) -> Interval:
        """Product of matrices by middle and radius (Rump 1999, Fast and parallel interval arithmetic)."""
        o = enclose(other)
        a, b, ra, rb = self.middle, o.middle, self.radius, o.radius
        middle = a @ b
        size = np.abs(a) @ np.abs(b)
        radius = np.abs(a) @ rb + ra @ (np.abs(b) + rb)
        radius = (radius + (a.shape[-1] + 2) * _EPS * (size + radius)) * (1 + 4 * _EPS)
        return _out(middle - radius, middle + radius)

    def __rmatmul__(self, other: Any) -> Interval:
        return enclose(other) @ self

    def columns(self, places: Sequence[int]) -> Interval:
        """Some columns of the matrices."""
        return Interval(self.lo[..., places], self.hi[..., places])

    @property
    def T(self) -> Interval:
        """Transposes of the matrices along the last two axes."""
        return Interval(np.swapaxes(self.lo, -1, -2), np.swapaxes(self.hi, -1, -2))


def _out(lo: Array, hi: Array) -> Interval:
    """The next numbers outside: one rounding is half a step at most."""
    return Interval(np.nextafter(lo, -np.inf), np.nextafter(hi, np.inf))


def enclose(value: Any) -> Interval:
    """A number or an array as intervals of no width."""
    return value if isinstance(value, Interval) else Interval(value, value)


def sin(x: Any) -> Interval:
    """Sine of an interval: its ends, and the extremes 1 and -1 where a quarter turn lies between them."""
    x = enclose(x)
    ends = np.sin(x.lo), np.sin(x.hi)
    # Library sines are off by an ulp or so: a margin of four, and a hair's breadth more for the extremes.
    lo, hi = np.minimum(*ends) - 4 * _EPS, np.maximum(*ends) + 4 * _EPS
    top, bottom = _contains(x, np.pi / 2), _contains(x, -np.pi / 2)
    return Interval(np.where(bottom, -1.0, np.maximum(lo, -1.0)), np.where(top, 1.0, np.minimum(hi, 1.0)))


def cos(x: Any) -> Interval:
    """Cosine of an interval."""
    return sin(enclose(x) + Interval(np.nextafter(np.pi / 2, 0), np.nextafter(np.pi / 2, 2)))


def tan(x: Any) -> Interval:
    """Tangent of an interval."""
    return sin(x) * cos(x).reciprocal()


def _contains(x: Interval, place: float) -> Flags:
    """Whether an interval may contain `place` plus whole turns."""
    slack = 1e-12
    first = np.ceil((x.lo - place - slack) / (2 * np.pi))
    return place + 2 * np.pi * first <= x.hi + slack


FUNCTIONS: dict[str, Callable[..., Interval]] = {"sin": sin, "cos": cos, "tan": tan}
"""For `model.evaluation.function_of`."""


def block(rows: Sequence[Sequence[Any]]) -> Any:
    """A matrix of blocks, of intervals where one of them is."""
    cells = [cell for row in rows for cell in row]
    shape = np.broadcast_shapes(*(_shape(c)[:-2] for c in cells))
    if not any(isinstance(c, Interval) for c in cells):
        return np.block([[np.broadcast_to(c, shape + _shape(c)[-2:]) for c in row] for row in rows])
    sides = (
        np.block(
            [[np.broadcast_to(getattr(enclose(c), s), shape + _shape(c)[-2:]) for c in row] for row in rows]
        )
        for s in ("lo", "hi")
    )
    return Interval(*sides)


def _shape(cell: Any) -> tuple[int, ...]:
    return np.shape(cell.lo if isinstance(cell, Interval) else cell)


def least_eigenvalue(matrix: Any) -> Array:
    """Smallest eigenvalue of the symmetric part, or a number that is certainly below it for intervals."""
    if not isinstance(matrix, Interval):
        return np.linalg.eigvalsh(0.5 * (matrix + np.swapaxes(matrix, -1, -2)))[..., 0]
    symmetric = 0.5 * (matrix + matrix.T)
    middle, radius = symmetric.middle, symmetric.radius
    usable = np.asarray(np.isfinite(radius).all(axis=(-1, -2)))
    middle = np.where(usable[..., None, None], middle, 0.0)
    n = middle.shape[-1]
    # x'Ex >= -sum_i (sum_j |E_ij|) x_i^2 for a symmetric change E; the solver is backward stable.
    spread = np.where(usable[..., None], np.abs(radius).sum(axis=-1), 0.0)
    lowered = middle - spread[..., None] * np.eye(n)
    rounding = 8 * n * _EPS * np.linalg.norm(lowered, axis=(-1, -2))
    return np.where(usable, np.linalg.eigvalsh(lowered)[..., 0] - rounding, -np.inf)
