"""Dead band of the thrusters."""

import sympy as sm

from undertow.model.effect import Actuation, Parameter, Signals


class ThrusterDeadband(Actuation):
    """Small commands give no thrust; beyond the dead band the thrust starts from zero."""

    id = "thruster_deadband"
    reference = (
        "dead zone, output c - w sgn(c) outside |c| < w; Khalil (2002), Nonlinear Systems, section 1.2"
    )
    signature = "no response at all to small commands, and a constant shortfall at large ones"
    stage = 14

    deadband_width = Parameter(
        "command",
        "commands smaller than this give no thrust",
        (0, float("inf")),
        linear=False,
        starts=(0.05, 0.2),
    )

    def output(self, upstream: sm.Matrix, s: Signals) -> sm.Matrix:
        return upstream.applyfunc(self._dead_zone)

    def _dead_zone(self, c: sm.Expr) -> sm.Expr:
        w = self.deadband_width
        return c - (sm.Abs(c + w) - sm.Abs(c - w)) / 2
