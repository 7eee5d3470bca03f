"""Weaker thrust in reverse."""

import sympy as sm

from undertow.model.effect import Actuation, Parameter, Signals


class ThrusterAsymmetry(Actuation):
    """Reverse thrust is weaker than forward thrust at the same command, the same for all thrusters.

    Included because blades are shaped for one sense of rotation, and the reversed jet hits the hull.
    """

    id = "thruster_asymmetry"
    reference = (
        "four-quadrant propeller characteristics (thrust astern below thrust ahead); Fossen (2021), chapter 9"
    )
    signature = "the vehicle gathers speed more slowly under negative commands than under positive ones"
    stage = 22

    reverse_loss = Parameter("1", "share of the thrust that is missing at negative commands", (-1, 1))

    def output(self, upstream: sm.Matrix, s: Signals) -> sm.Matrix:
        return upstream.applyfunc(lambda c: c - self.reverse_loss * (c - sm.Abs(c)) / 2)
