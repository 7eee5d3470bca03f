"""Drag that rises near the bottom, a wall or the surface."""

from collections.abc import Mapping
from math import inf

import sympy as sm

from undertow.model.effect import LoggedOnly, Parameter, Signals, Wrench, symbol
from undertow.model.effects.cubic_damping import CubicDamping
from undertow.model.effects.linear_damping import LinearDamping
from undertow.model.effects.quadratic_damping import QuadraticDamping

_AHEAD, _GAP = symbol("ahead"), symbol("gap")
# Where a search begins: decay lengths in the range of the vehicle, and how far inside that the boundary is.
# One long run makes the range wide for what happens in a small part of it.
_STARTS = ((4.0, 0.0), (4.0, 0.4), (16.0, 0.2), (16.0, 0.4), (16.0, 0.6), (16.0, 0.8))


class BoundaryProximity(Wrench):
    """All damping of the hull raised near a bottom, a wall or the surface, fading with the distance.

    Included because drag identified in open water is too small beside a quay, over the sea bed or in a
    narrow tank. The boundary is a plane: it lies in the direction (fade_N, fade_E, fade_D), the rise fades to
    1/e over 1 / |fade| metres, and the NED origin is fade_0 such lengths away from it. A bottom at depth z_b
    is fade_D = 1/L, fade_0 = z_b/L; the surface fade_D = -1/L, fade_0 = 0; a wall at y = y_w to the east
    fade_E = 1/L, fade_0 = y_w/L. A vehicle that never comes close shows only rise * exp(-fade_0). Where the
    log has the distance from the bottom, the bottom need not be flat, and fade_D = 1/L is all.
    """

    id = "boundary_proximity"
    family = "water"
    reference = (
        "Happel and Brenner (1983), Low Reynolds Number Hydrodynamics, chapter 7 (walls raise drag); "
        "fading by an exponential"
    )
    signature = "all motions are damped more in one part of the basin, the more the closer to its border"
    shares = ("linear_damping", "quadratic_damping", "cubic_damping")
    dissipative = True

    boundary_rise = Parameter("1", "relative increase of the damping at the boundary", (0, inf))
    fade_N = Parameter.with_starts(
        "1/m", "decay of that increase away from it, north part", (-50, 50), (0, 1), without_log="altitude"
    )
    fade_E = Parameter.with_starts("1/m", "east part", (-50, 50), (0, 1), without_log="altitude")
    fade_D = Parameter.with_starts("1/m", "downward part", (-50, 50), (0, 1))
    fade_0 = Parameter.with_starts(
        "1", "decay lengths from the NED origin to it", (-1e4, 1e4), (1, 10), without_log="altitude"
    )
    altitude = LoggedOnly("m", "distance from the bottom, as an echo sounder has it")

    @classmethod
    def starts_near(cls, seen: Mapping[str, tuple[float, float]]) -> list[dict[str, float]]:
        points = []
        for part, axis in zip("NED", "xyz", strict=True):
            low, high = seen.get(axis, (0.0, 0.0))
            # On either side: a boundary at the edge of where the vehicle was, and some that readings pass.
            for side, edge, reach in ((1, high, high - low), (-1, -low, high - low)):
                for fades, beyond in _STARTS if reach > 0 else ():
                    fade = fades / reach
                    point = {"fade_N": 0.0, "fade_E": 0.0, "fade_D": 0.0, f"fade_{part}": side * fade}
                    points.append(point | {"fade_0": fade * (edge - beyond * reach)})
        return points

    @classmethod
    def observable_in(cls, dofs: tuple[str, ...]) -> bool:
        return bool({"surge", "sway", "heave"} & set(dofs))

    def wrench(self, s: Signals) -> sm.Matrix:
        laws = (law(self.thrusters) for law in (LinearDamping, QuadraticDamping, CubicDamping))
        return self.boundary_rise * sm.exp(-_GAP) * sum((law.wrench(s) for law in laws), sm.zeros(6, 1))

    def abbreviations(self, s: Signals) -> dict[sm.Symbol, sm.Expr]:
        fade = sm.Matrix([self.fade_N, self.fade_E, self.fade_D])
        ahead = self.fade_0 - fade.dot(sm.Matrix(s.eta[:3]))
        if "altitude" in self.inputs:
            ahead = self.fade_D * self.altitude
        # Measured positions may lie a little beyond the boundary: the rise stays what it is there.
        gap = (_AHEAD + sm.Abs(_AHEAD)) / 2
        return {_AHEAD: ahead, _GAP: gap}
