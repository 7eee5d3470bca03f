"""A position sensor away from the body origin."""

import sympy as sm

from undertow.model.effect import Measurement, Parameter, Signals
from undertow.model.symbols import rotation


class PositionLeverArm(Measurement):
    """The antenna or transponder that gives the position sits off the body origin and swings around it.

    Included because hardly any antenna is at the origin, and the lever arm of the velocity sensor cannot
    replace it: forces depend on the velocity.
    """

    id = "position_lever_arm"
    reference = "position of a point of a rigid body, p + R r; Fossen (2021), chapter 2"
    signature = (
        "the position moves when the vehicle turns on the spot, although the reported velocity is zero"
    )
    stage = 10

    x_fix = Parameter(
        "m", "position of the antenna, forward", (-200, 200), linear=False, starts=(0.0,), arm_of="1"
    )
    y_fix = Parameter(
        "m", "position of the antenna, to starboard", (-50, 50), linear=False, starts=(0.0,), arm_of="1"
    )
    z_fix = Parameter(
        "m", "position of the antenna, down", (-50, 50), linear=False, starts=(0.0,), arm_of="1"
    )

    def reported(self, eta: sm.Matrix, nu: sm.Matrix, s: Signals) -> tuple[sm.Matrix, sm.Matrix]:
        swing = rotation(sm.Matrix(s.eta[3:])) * sm.Matrix([self.x_fix, self.y_fix, self.z_fix])
        return eta + sm.Matrix([*swing, 0, 0, 0]), nu
