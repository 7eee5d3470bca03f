"""Thrusters that give more or less thrust than nominal."""

import sympy as sm

from undertow.model.effect import Actuation, PerThruster, Signals


class ThrusterGain(Actuation):
    """One or more thrusters deliver a fixed fraction of what is commanded: fouling, damage, a wrong curve."""

    id = "thruster_gain"
    reference = "actuator effectiveness (loss-of-effectiveness factor); Fossen (2021), control allocation"
    signature = "the vehicle pulls to one side in proportion to the command of one thruster"
    stage = 10

    gain_error = PerThruster("1", "delivered over commanded, minus one", (-2, 2))

    def output(self, upstream: sm.Matrix, s: Signals) -> sm.Matrix:
        return upstream + upstream.multiply_elementwise(self.gain_error)
