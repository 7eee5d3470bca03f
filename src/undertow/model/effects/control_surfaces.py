"""Lift and drag of rudders, fins and planes."""

from math import inf, pi

import sympy as sm

from undertow.model.effect import Parameter, PerSurface, Signals, Surface, Wrench, column, symbol
from undertow.model.effects.propellers import thrust_of

_HALF = sm.Rational(1, 2)
_AHEAD = sm.Matrix([1, 0, 0])


class ControlSurfaces(Wrench):
    """Force of every rudder, fin or plane in the flow past it, with the drag that steering costs.

    The force acts normal to the chord, in the local flow: reduced by the wake, straightened by the hull, and
    accelerated by a propeller ahead for the part of the surface in its slipstream (momentum theory). Since it
    turns with the chord, it also causes drag. The hull force induced by a rudder is a fraction of its own
    (MMG: a_H at x_H, t_R).
    """

    id = "control_surfaces"
    family = "actuation"
    reference = (
        "Yasukawa and Yoshimura (2015), MMG standard method (rudder normal force, flow straightening, "
        "acceleration by the propeller); Fossen (2021), chapter 9"
    )
    signature = "no force in response to an angle, or no loss of speed in turns"
    built_in = True
    shares = ("thrusters", "propellers")

    C_N = PerSurface(
        "1",
        "force across the chord: coefficient per sine of the angle of attack",
        (0, inf),
        within=2 * pi,  # that of a thin wing without ends; beyond it a rudder stands in for the hull's lift
    )
    C_D = PerSurface("1", "drag coefficient at zero angle", (0, inf))
    wake = PerSurface.with_default("1", "wake fraction of the speed ahead", (-1, 1), 0.0)
    straightening = PerSurface.with_default(
        "1", "flow straightening: share of the transverse flow that remains", (0, 2), 1.0
    )
    flow_lever = PerSurface.with_default(
        "1", "lever of the turning rate in the transverse flow, over the geometric lever", (0, 4), 1.0
    )
    in_slipstream = PerSurface.with_default("1", "share of the area in the slipstream", (0, 1), 1.0)
    slipstream = PerSurface.with_default(
        "1", "velocity increase at the surface over that far behind the propeller", (0, 1.5), 0.5
    )
    a_H = PerSurface.with_default("1", "transverse force on the hull per force of the surface", (0, 2), 0.0)
    x_H = PerSurface.with_default("m", "where the force on the hull acts, forward", (-200, 200), 0.0)
    t_R = PerSurface.with_default("1", "share of the steering drag recovered by the hull", (0, 1), 0.0)
    flow_least = Parameter.with_default("m/s", "speed below which the force fades", (1e-9, 1.0), 1e-6)

    def wrench(self, s: Signals) -> sm.Matrix:
        total = sm.zeros(6, 1)
        for k, surface in enumerate(self.surfaces):
            total += self._of(k, surface)
        return total

    def _of(self, k: int, surface: Surface) -> sm.Matrix:
        """Wrench of one surface, by the components of its force along the hull and across."""
        along, across = _forces(surface)
        side = _normal(surface)
        place = surface.place
        force = along * _AHEAD + across * side
        hull = self.a_H[k] * across * side
        moment = place.cross(force) + sm.Matrix([self.x_H[k], *place[1:]]).cross(hull)
        return sm.Matrix([*(force + hull), *moment])

    def abbreviations(self, s: Signals) -> dict[sm.Symbol, sm.Expr]:
        found: dict[sm.Symbol, sm.Expr] = {}
        for k, surface in enumerate(self.surfaces):
            found |= self._flow(k, surface, s)
            found |= dict(zip(_forces(surface), self._across_and_along(k, surface, s), strict=True))
        return found

    def _flow(self, k: int, surface: Surface, s: Signals) -> dict[sm.Symbol, sm.Expr]:
        """Velocity of the surface relative to the local water: ahead, across, and ahead in the slipstream."""
        turning = sm.Matrix(s.nu_r[3:]).cross(surface.place)
        ahead = (1 - self.wake[k]) * (s.nu_r[0] + turning[0])
        moved = sm.Matrix(s.nu_r[:3]) + self.flow_lever[k] * turning
        flow_x, flow_n, flow_s = _flows(surface)
        found = {flow_x: ahead, flow_n: self.straightening[k] * _normal(surface).dot(moved)}
        return found | ({flow_s: flow_x + self._gain(k, surface, s)} if surface.propeller else {})

    def _gain(self, k: int, surface: Surface, s: Signals) -> sm.Expr:
        """Speed that the propeller ahead adds, m/s; none when it pushes astern."""
        i = self.thrusters.index(surface.propeller)
        thrust = thrust_of(self, s)[i]
        pushing = (thrust + sm.Abs(thrust)) / 2
        disc = sm.pi * surface.diameter**2 / 4
        before = _flows(surface)[0] ** 2 + self.flow_least**2
        return self.slipstream[k] * (sm.sqrt(before + 2 * pushing / (s.rho * disc)) - sm.sqrt(before))

    def _across_and_along(self, k: int, surface: Surface, s: Signals) -> tuple[sm.Expr, sm.Expr]:
        """Force along the hull and across."""
        flow_x, flow_n, flow_s = _flows(surface)
        if not surface.propeller:
            return self._in_flow(k, surface, s, flow_x, flow_n)
        share = self.in_slipstream[k]
        inside = self._in_flow(k, surface, s, flow_s, flow_n)
        outside = self._in_flow(k, surface, s, flow_x, flow_n)
        along, across = (share * a + (1 - share) * b for a, b in zip(inside, outside, strict=True))
        return along, across

    def _in_flow(
        self, k: int, surface: Surface, s: Signals, ahead: sm.Expr, across: sm.Expr
    ) -> tuple[sm.Expr, sm.Expr]:
        """Force along the hull and across on a surface that moves so through the water."""
        angle = s.deflection[k]
        if surface.limit is not None:
            angle = sm.Max(-surface.limit, sm.Min(angle, surface.limit))
        speed = sm.sqrt(ahead**2 + across**2 + self.flow_least**2)
        pressure = _HALF * s.rho * surface.area * speed
        normal = pressure * self.C_N[k] * (ahead * sm.sin(angle) - across * sm.cos(angle))
        drag = pressure * self.C_D[k]
        held_back = (1 - self.t_R[k]) * normal * sm.sin(angle)
        return -held_back - drag * ahead, normal * sm.cos(angle) - drag * across


def _normal(surface: Surface) -> sm.Matrix:
    """Direction in which the leading edge goes where the angle grows, across the hull."""
    return surface.turned_about.cross(_AHEAD)


def _flows(surface: Surface) -> sm.Matrix:
    return column([f"{what}_{surface.name}" for what in ("flow_x", "flow_n", "flow_s")])


def _forces(surface: Surface) -> tuple[sm.Symbol, sm.Symbol]:
    return symbol(f"force_x_{surface.name}"), symbol(f"force_n_{surface.name}")
