"""Tension of an elastic tether."""

import math
from collections.abc import Mapping

import sympy as sm

from undertow.model.effect import Parameter, Place, Signals, Wrench, column, symbol
from undertow.model.symbols import rotation

_PULL, _REACH = column(["pull_x", "pull_y", "pull_z"]), column(["reach_x", "reach_y", "reach_z"])
_SPAN, _STRETCH = symbol("span"), symbol("stretch")


class TetherTension(Wrench):
    """Pull of an elastic tether towards where it is made fast, slack below a length.

    Included because a cable that comes taut, a mooring line or a float on a line pulls with a force that
    depends on where the vehicle is and not on how it moves: no damping and no constant force can replace it.
    The place `anchor` is counted from the attachment `eye` of a level vehicle that heads north, since without
    rotation only their difference can show.
    """

    id = "tether_tension"
    family = "tether"
    reference = "Hooke's law on one side, k max(0, d - L_0); Faltinsen (1990), Sea Loads, chapter 8 (mooring)"
    signature = "beyond some distance the vehicle is pulled back to one place, harder the farther it goes"

    k_tension = Parameter("N/m", "stiffness of the tether", (0, math.inf))
    L_slack = Parameter.with_starts("m", "length up to which it is slack", (0, 1e4), (0, 3, 10))
    anchor = Place("anchor", "where it is made fast, less the attachment", "ned", 1.1e4)
    eye = Place("eye", "attachment on the vehicle", "body", 200)
    span_least = Parameter.with_default("m", "distance below which its pull fades", (1e-9, 1.0), 1e-6)

    @classmethod
    def starts_near(cls, seen: Mapping[str, tuple[float, float]]) -> list[dict[str, float]]:
        if len(axes := [axis for axis in "xyz" if axis in seen]) == 1:
            return cls._along_a_line(axes[0], *seen[axes[0]])
        ranges = [seen.get(axis, (0.0, 0.0)) for axis in "xyz"]
        across = math.dist(*zip(*ranges, strict=True))
        x, y, z = (sum(ends) / 2 for ends in ranges)
        # Above the vehicle, since in the plane of the motion the height of an anchor could not show.
        place = {"x_anchor": x, "y_anchor": y, "z_anchor": z - across / 4}
        start = place | {"y_eye": 0.0, "z_eye": 0.0}
        shapes = (0.0, 0.0), (0.25, 0.0), (0.5, 0.0), (0.25, -0.4), (0.25, 0.4)
        return [start | {"L_slack": slack * across, "x_eye": ahead} for slack, ahead in shapes]

    @classmethod
    def _along_a_line(cls, axis: str, low: float, high: float) -> list[dict[str, float]]:
        """On a line the anchor is ahead or astern of all that was seen, and the tether slack near it."""
        across, (dx, dy, dz) = high - low, (float(axis == a) for a in "xyz")
        ends = low - across / 10, high + across / 10
        return [
            {"x_anchor": end * dx, "y_anchor": end * dy, "z_anchor": end * dz, "L_slack": share * across}
            for end in ends
            for share in (0.1, 0.3, 0.5, 0.7, 0.9)
        ]

    def wrench(self, s: Signals) -> sm.Matrix:
        return sm.Matrix([*_PULL, *self.eye.cross(_PULL)])

    def abbreviations(self, s: Signals) -> dict[sm.Symbol, sm.Expr]:
        turn = rotation(sm.Matrix(s.eta[3:]))
        reach = turn.T * (sm.Matrix(s.eta[:3]) - self.anchor - self.eye) + self.eye
        # At the anchor itself the distance has no derivative, hence the small length under the root.
        span = sm.sqrt(_REACH.dot(_REACH) + self.span_least**2)
        stretch = (_SPAN - self.L_slack + sm.Abs(_SPAN - self.L_slack)) / 2
        pull = -self.k_tension * _STRETCH / _SPAN * _REACH
        return dict(zip([*_REACH, _SPAN, _STRETCH, *_PULL], [*reach, span, stretch, *pull], strict=True))
