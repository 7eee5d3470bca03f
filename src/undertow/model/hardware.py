"""Hardware as effects see it: control surfaces, and how the commands of thrusters become thrust."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any

import sympy as sm

from undertow.errors import UndertowError

from .symbols import symbol

Number = Any  # a float, or a symbol on a specimen


@dataclass(frozen=True)
class Surface:
    """A rudder, a fin or a plane that is turned about an axis."""

    name: str  # name, and log column of its angle in rad
    position: tuple[Number, Number, Number]  # centre of pressure in body axes, m
    # unit vector about which a positive angle turns it by the right hand, across the x axis: at zero the
    # chord points ahead
    axis: tuple[Number, Number, Number]
    area: Number  # m^2
    limit: Number | None = None  # largest magnitude of the angle, rad
    propeller: str = ""  # name of the thruster in whose slipstream it stands; empty without one
    diameter: Number = 0.0  # diameter of that propeller, m

    @classmethod
    def specimen(cls, name: str, propeller: str) -> Surface:
        """One whose numbers are symbols, but for its axis, which is upright as that of a rudder."""
        place, other = [symbol(f"place_{a}_{name}") for a in "xyz"], f"diameter_{propeller}"
        upright = (sm.Integer(0), sm.Integer(0), sm.Integer(-1))
        return cls(name, (*place,), upright, symbol(f"area_{name}"), None, propeller, symbol(other))

    @property
    def place(self) -> sm.Matrix:
        """The position as a column, shape (3, 1), m."""
        return sm.Matrix([_exact(v) for v in self.position])

    @property
    def turned_about(self) -> sm.Matrix:
        """The axis as a column, shape (3, 1)."""
        return sm.Matrix([_exact(v) for v in self.axis])

    @property
    def symbols(self) -> dict[sm.Symbol, str]:
        """Symbols among its numbers, with their units."""
        stated = [*((v, "m") for v in (*self.position, self.diameter)), (self.area, "m^2")]
        return {v: unit for v, unit in stated if isinstance(v, sm.Symbol)}


@dataclass(frozen=True)
class Propeller:
    """A propeller whose command is its speed of revolution."""

    diameter: Number  # m
    per_command: Number  # revolutions per second and unit of command

    @classmethod
    def specimen(cls, name: str) -> Propeller:
        """One whose numbers are symbols."""
        return cls(symbol(f"diameter_{name}"), symbol(f"turns_{name}"))

    @property
    def symbols(self) -> dict[sm.Symbol, str]:
        """Symbols among its numbers, with their units."""
        stated = ((self.diameter, "m"), (self.per_command, "1/(s command)"))
        return {v: unit for v, unit in stated if isinstance(v, sm.Symbol)}


@dataclass(frozen=True)
class Curve:
    """Thrust at rest over the command: cubic pieces that join with one slope, level beyond the ends."""

    start: float  # thrust at the first command and below, N
    # commands between which a piece holds, and what it adds to the thrust at its begin: coefficients of the
    # first, second ... power of the command beyond the begin, N
    pieces: tuple[tuple[float, float, tuple[float, ...]], ...]

    @classmethod
    def through(cls, points: Sequence[tuple[float, float]]) -> Curve:
        """The curve through points in the order of their commands, which rises and falls only as they do.

        Slopes are those of Fritsch and Carlson (1980) and Butland: a harmonic mean on either side, zero at
        a turning point.
        """
        steps = [(b[0] - a[0], (b[1] - a[1]) / (b[0] - a[0])) for a, b in pairwise(points)]
        inner = (_between(*one, *other) for one, other in pairwise(steps))
        slopes = [steps[0][1], *inner, steps[-1][1]]
        pieces = []
        for (x, _), (end, _), (h, rise), a, b in zip(
            points, points[1:], steps, slopes, slopes[1:], strict=False
        ):
            pieces.append((x, end, (a, (3 * rise - 2 * a - b) / h, (a + b - 2 * rise) / h**2)))
        return cls(points[0][1], tuple(pieces))

    @classmethod
    def polynomial(cls, coefficients: Sequence[float], limit: float) -> Curve:
        """Coefficients of the first, second ... power of a command up to a limit, N; none at zero."""
        shifted = [
            sum(math.comb(n, k) * c * (-limit) ** (n - k) for n, c in enumerate(coefficients, 1) if n >= k)
            for k in range(len(coefficients) + 1)
        ]
        return cls(shifted[0], ((-limit, limit, tuple(shifted[1:])),))

    @property
    def largest(self) -> float:
        """Largest magnitude of a command that the curve tells from a smaller one."""
        return max(abs(self.pieces[0][0]), abs(self.pieces[-1][1]))

    def thrust(self, command: sm.Expr) -> sm.Expr:
        """Thrust at a command, N: what every piece adds up to there."""
        return _thrust(self, command)

    def at(self, command: float) -> float:
        """The same for a number."""
        clipped = ((max(b, min(command, e)) - b, c) for b, e, c in self.pieces)
        return self.start + sum(c * x**n for x, cs in clipped for n, c in enumerate(cs, 1))

    @cached_property
    def _falls(self) -> bool:
        low, high = self.pieces[0][0], self.pieces[-1][1]
        thrusts = [self.at(low + (high - low) * k / _GRID) for k in range(_GRID + 1)]
        rounding = _FALL * abs(thrusts[-1] - thrusts[0])
        return any(b < a - rounding for a, b in pairwise(thrusts))

    def inverse(self, thrust: float) -> float:
        """The command that gives a thrust, N, or the nearest one that the curve has.

        Refused where the curve falls somewhere: then several commands give the same thrust.
        """
        if self._falls:
            raise UndertowError("the thrust falls with the command somewhere: no command belongs to a thrust")
        low, high = self.pieces[0][0], self.pieces[-1][1]
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            low, high = (low, middle) if self.at(middle) >= thrust else (middle, high)
        return (low + high) / 2


@lru_cache(maxsize=64)
def _thrust(curve: Curve, command: sm.Expr) -> sm.Expr:
    """Kept, as SymPy orders the ends of every piece anew, and several effects ask for the same thrust."""
    total = sm.Float(curve.start)
    for begin, end, coefficients in curve.pieces:
        beyond = sm.Max(sm.Float(begin), sm.Min(command, sm.Float(end))) - sm.Float(begin)
        powers = sm.Integer(0)
        for c in reversed(coefficients):
            powers = (powers + sm.Float(c)) * beyond
        total += powers
    return total


# Commands at which a curve is tried for a fall, the share of its rise that is rounding, and halvings of the
# range that leave nothing of it.
_GRID, _FALL, _HALVINGS = 400, 1e-9, 60


def _between(h: float, rise: float, after: float, next_rise: float) -> float:
    """Slope at a point between two steps, of lengths h and `after`."""
    if rise * next_rise <= 0:
        return 0.0
    share = (h + 2 * after) / (3 * (h + after))
    return rise * next_rise / (share * next_rise + (1 - share) * rise)


Law = Propeller | Curve | None


def _exact(number: Number) -> sm.Expr:
    """A whole number without a decimal point, so that zeros and ones vanish from products."""
    if isinstance(number, sm.Basic):
        return number
    return sm.Float(number) if number % 1 else sm.Integer(int(number))
