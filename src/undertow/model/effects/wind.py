"""Steady wind on what stands out of the water."""

from __future__ import annotations

import sympy as sm

from undertow.model.effect import Wrench
from undertow.model.kinematics import rotation
from undertow.model.parameter import Parameter
from undertow.model.symbols import Signals, column

_AHEAD, _ACROSS = column(["wind_x", "wind_y"])


class Wind(Wrench):
    """Force of a steady wind on a surface vessel, fixed over ground, so that it turns with the heading.

    Beside the list of the design because no log of a surface vessel outdoors is without it, and a current
    does not look the same: wind pushes, while a current carries and its force fades with the drag. The beam
    wind's force is `wind_aspect` times the bow wind's (lateral over frontal area). It acts x_wind ahead of
    the origin and z_wind below it (above: negative).
    """

    id = "wind"
    family = "water"
    reference = (
        "Fossen (2021), chapter 10 (wind forces, C_X with the cosine and C_Y with the sine of the angle)"
    )
    signature = "a force on surface vessels that points to one side of the world, at all speeds alike"

    W_N = Parameter("N", "force to the north on the vessel heading north or south", per_run=True)
    W_E = Parameter("N", "force to the east on the vessel heading east or west", per_run=True)
    wind_aspect = Parameter(
        "1", "beam wind over bow wind", (0.05, 50), linear=False, starts=(1, 4), neutral=None
    )
    x_wind = Parameter(
        "m", "where it acts, forward", (-200, 200), linear=False, starts=(0,), neutral=None, arm_of="1"
    )
    z_wind = Parameter(
        "m", "where it acts, down", (-100, 10), linear=False, starts=(0,), neutral=None, arm_of="1"
    )

    @classmethod
    def suits(cls, dofs: tuple[str, ...]) -> bool:
        # Without yaw it cannot be told from a constant force.
        return "heave" not in dofs and "yaw" in dofs and bool({"surge", "sway"} & set(dofs))

    def wrench(self, s: Signals) -> sm.Matrix:
        return sm.Matrix(
            [_AHEAD, _ACROSS, 0, -self.z_wind * _ACROSS, self.z_wind * _AHEAD, self.x_wind * _ACROSS]
        )

    def abbreviations(self, s: Signals) -> dict[sm.Symbol, sm.Expr]:
        ahead, across, _ = rotation(sm.Matrix([0, 0, s.eta[5]])).T * sm.Matrix([self.W_N, self.W_E, 0])
        return {_AHEAD: ahead, _ACROSS: self.wind_aspect * across}
