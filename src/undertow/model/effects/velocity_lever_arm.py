"""A velocity sensor away from the body origin."""

import sympy as sm

from undertow.model.effect import Measurement, Parameter, Signals
from undertow.model.symbols import skew


class VelocityLeverArm(Measurement):
    """The velocity sensor (DVL) sits off the body origin, so rotation contributes to its readings."""

    id = "velocity_lever_arm"
    of_velocity_sensor = True
    reference = "rigid-body velocity field, v_S = v + omega x r_S; Fossen (2021), chapter 2"
    signature = "measured velocity disagrees with the position's rate in turns, by yaw rate times a length"
    stage = 10

    x_s = Parameter("m", "sensor position, forward", linear=False, starts=(0.0,), arm_of="1")
    y_s = Parameter("m", "sensor position, to starboard", linear=False, starts=(0.0,), arm_of="1")
    z_s = Parameter("m", "sensor position, down", linear=False, starts=(0.0,), arm_of="1")

    def reported(self, eta: sm.Matrix, nu: sm.Matrix, s: Signals) -> tuple[sm.Matrix, sm.Matrix]:
        arm = sm.Matrix([self.x_s, self.y_s, self.z_s])
        rate = sm.Matrix(nu[3:])
        velocity = sm.Matrix(nu[:3]) + skew(rate) * arm
        return eta, sm.Matrix([*velocity, *rate])
