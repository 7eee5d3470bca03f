"""Curvature of the relation between command and thrust."""

import sympy as sm

from undertow.model.effect import Actuation, Parameter, Signals


class ThrusterCurve(Actuation):
    """Thrust is not proportional to the command: part of it grows with the square, for all thrusters alike.

    Included because the thrust of a propeller follows the square of its speed, while commands are often
    taken for thrust. Where thrust per command is estimated, too, curve_linear is part of it and stays zero.
    """

    id = "thruster_curve"
    reference = (
        "thrust proportional to |n| n of the shaft speed n; Fossen (2021), chapter 9 (propeller models)"
    )
    signature = "thrust too small at small commands and too large at large ones, or the other way round"
    stage = 20

    curve_linear = Parameter("1", "change of the part proportional to the command", (-2, 20), alone=False)
    curve_square = Parameter("1/command", "part proportional to the command times its magnitude")

    def output(self, upstream: sm.Matrix, s: Signals) -> sm.Matrix:
        return upstream.applyfunc(lambda c: c + self.curve_linear * c + self.curve_square * sm.Abs(c) * c)
