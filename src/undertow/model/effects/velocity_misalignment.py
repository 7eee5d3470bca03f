"""A velocity sensor that is turned against the body axes."""

import sympy as sm

from undertow.model.effect import Measurement, Parameter, Signals
from undertow.model.symbols import rotation, skew


class VelocityMisalignment(Measurement):
    """The velocity sensor (DVL) is mounted at an angle, so that forward motion appears partly as sideways
    motion.

    Included because sensors are aligned by eye, and a rotated velocity looks like a side force. About the
    vertical axis the angle may be any; tilts about the other two axes are taken to first order.
    """

    id = "velocity_misalignment"
    of_velocity_sensor = True
    reference = "rotation of a vector between two frames, v_S = R' v; Fossen (2021), chapter 2"
    signature = "a sway velocity in proportion to the surge velocity, which the position does not confirm"
    stage = 20

    turn_z = Parameter(
        "rad", "angle of the sensor about the body z axis", (-3.2, 3.2), linear=False, starts=(0.0,)
    )
    tilt_x = Parameter("rad", "small tilt about the x axis", (-0.5, 0.5), linear=False, starts=(0.0,))
    tilt_y = Parameter("rad", "small tilt about the y axis", (-0.5, 0.5), linear=False, starts=(0.0,))

    def reported(self, eta: sm.Matrix, nu: sm.Matrix, s: Signals) -> tuple[sm.Matrix, sm.Matrix]:
        turn = rotation(sm.Matrix([0, 0, self.turn_z]))
        tilt = sm.eye(3) + skew(sm.Matrix([self.tilt_x, self.tilt_y, 0]))
        return eta, sm.Matrix([*(turn.T * tilt.T * nu[:3, :]), *nu[3:]])
