"""Thrust of the vehicle's thrusters."""

from __future__ import annotations

import sympy as sm

from undertow.model.effect import Wrench
from undertow.model.parameter import PerThruster
from undertow.model.symbols import Signals


class Thrusters(Wrench):
    """Thrust of every thruster at its place and in its direction (control allocation)."""

    id = "thrusters"
    family = "actuation"
    reference = "Fossen (2021), thruster configuration matrix"
    signature = "no motion in answer to a command"
    built_in = True

    thrust = PerThruster("N/command", "thrust per unit of command", (0, float("inf")))

    def wrench(self, s: Signals) -> sm.Matrix:
        if not self.thrusters:
            return sm.zeros(6, 1)
        return self.allocation * s.actuation.multiply_elementwise(self.thrust)
