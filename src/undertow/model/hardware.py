"""Control surfaces as effects see them: where they are, how they turn, what flows past them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import sympy as sm

from .symbols import symbol

Number = Any  # a float, or a symbol on a specimen


@dataclass(frozen=True)
class Surface:
    """A rudder, a fin or a plane that is turned about an axis.

    Attributes
    ----------
    name : str
        Name, and log column of its angle in rad.
    position : tuple of three numbers
        Centre of pressure in body axes, m.
    axis : tuple of three numbers
        Unit vector about which a positive angle turns it by the right hand, across the x axis: at zero the
        chord points ahead.
    area : number
        m^2.
    limit : number, optional
        Largest magnitude of the angle, rad.
    propeller : str
        Name of the thruster in whose slipstream it stands; empty without one.
    diameter : number
        Diameter of that propeller, m.
    """

    name: str
    position: tuple[Number, Number, Number]
    axis: tuple[Number, Number, Number]
    area: Number
    limit: Number | None = None
    propeller: str = ""
    diameter: Number = 0.0

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


def _exact(number: Number) -> sm.Expr:
    """A whole number without a decimal point, so that zeros and ones vanish from products."""
    if isinstance(number, sm.Basic):
        return number
    return sm.Float(number) if number % 1 else sm.Integer(int(number))
