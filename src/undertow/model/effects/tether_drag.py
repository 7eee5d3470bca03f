"""Drag of a tether."""

import math
from collections.abc import Mapping

import sympy as sm

from undertow.model.effect import LoggedOnly, Parameter, Place, Signals, Wrench, column, symbol

_DRAG, _SPEED = column(["drag_x", "drag_y", "drag_z"]), column(["tail_u", "tail_v", "tail_w"])
_LENGTH, _COEFFICIENT = symbol("length"), symbol("tether_coefficient")


class TetherDrag(Wrench):
    """Drag of the tether towed through the water, which grows with the distance from the winch.

    Included because the cable of a small ROV drags more than its hull, and grows with the distance from
    the winch, so that no hull coefficient can stand for it. It acts where the tether is attached, against the
    velocity of that place through the water; only the part of its length that moves with the vehicle counts.
    A length paid out regardless of position drags equally everywhere (`c_paid_out`). If the paid-out length
    is logged, the position of the winch is not needed.
    """

    id = "tether_drag"
    family = "tether"
    reference = "Hoerner (1965), Fluid-Dynamic Drag (cylinders and cables across the flow)"
    signature = "the drag grows with the distance from the winch, and speeds fall on the way out"
    dissipative = True

    c_tether = Parameter("N/m/(m/s)^2", "drag per metre of tether and speed squared", (0, math.inf))
    c_paid_out = Parameter(
        "N/(m/s)^2", "drag of what is paid out wherever the vehicle is, per speed squared", (0, math.inf)
    )
    # Of one that is farther away all but its direction is in what is paid out anyway.
    winch = Place("winch", "where the tether comes from", "ned", 1e3, without_log="tether_length")
    tether_length = LoggedOnly("m", "length of the tether that is out", (0, math.inf))
    tail = Place("tail", "attachment on the vehicle", "body", 200)
    length_least = Parameter.with_default(
        "m", "tether that is out at the winch", (1e-9, 1e3), 1e-6, without_log="tether_length"
    )
    speed_least = Parameter.with_default("m/s", "speed below which the drag fades", (1e-9, 1.0), 1e-6)

    @classmethod
    def starts_near(cls, seen: Mapping[str, tuple[float, float]]) -> list[dict[str, float]]:
        ranges = [seen.get(axis, (0.0, 0.0)) for axis in "xyz"]
        x, y, z = (sum(ends) / 2 for ends in ranges)
        # Away from the plane of the motion, in which the height of a winch could not show; and on both sides
        # of it, for a fit that comes too near ends in a local minimum on the other side.
        away = math.dist(*zip(*ranges, strict=True)) / 4
        start = {"x_winch": x, "y_winch": y, "y_tail": 0.0, "z_tail": 0.0}
        # The moment gives a tether away, and only from an attachment on its own side of the origin.
        return [
            start | {"z_winch": z + height, "x_tail": ahead}
            for height in (-away, away)
            for ahead in (-0.5, 0.5)
        ]

    def wrench(self, s: Signals) -> sm.Matrix:
        return sm.Matrix([*_DRAG, *self.tail.cross(_DRAG)])

    def abbreviations(self, s: Signals) -> dict[sm.Symbol, sm.Expr]:
        velocity = sm.Matrix(s.nu_r[:3]) + sm.Matrix(s.nu_r[3:]).cross(self.tail)
        # Neither root has a derivative at zero, hence the small length and the small speed under them.
        coefficient = self.c_paid_out + self.c_tether * _LENGTH
        drag = -_COEFFICIENT * sm.sqrt(_SPEED.dot(_SPEED) + self.speed_least**2) * _SPEED
        names = [*_SPEED, _LENGTH, _COEFFICIENT, *_DRAG]
        return dict(zip(names, [*velocity, self._length(s), coefficient, *drag], strict=True))

    def _length(self, s: Signals) -> sm.Expr:
        """Tether that is out, as logged or as far as the vehicle is from the winch, m."""
        if "tether_length" in self.inputs:
            return self.tether_length
        away = sm.Matrix(s.eta[:3]) - self.winch
        return sm.sqrt(away.dot(away) + self.length_least**2)
