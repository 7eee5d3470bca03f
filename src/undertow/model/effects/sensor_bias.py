"""Constant errors of the velocity sensor and the gyro."""

import sympy as sm

from undertow.model.effect import Measurement, Parameter, Signals


class SensorBias(Measurement):
    """Velocities and angular rates are reported with a constant offset each.

    Included because gyros and electromagnetic logs have zero offsets, which would otherwise look like forces.
    """

    id = "sensor_bias"
    of_velocity_sensor = True
    reference = "constant bias of rate and velocity sensors; Fossen (2021), chapter 14 (inertial measurement)"
    signature = "a velocity is reported at rest, and positions drift away from it"
    stage = 40

    b_u = Parameter("m/s", "error of the surge velocity", (-5, 5), linear=False, starts=(0.0,))
    b_v = Parameter("m/s", "error of the sway velocity", (-5, 5), linear=False, starts=(0.0,))
    b_w = Parameter("m/s", "error of the heave velocity", (-5, 5), linear=False, starts=(0.0,))
    b_p = Parameter("rad/s", "error of the roll rate", (-1, 1), linear=False, starts=(0.0,))
    b_q = Parameter("rad/s", "error of the pitch rate", (-1, 1), linear=False, starts=(0.0,))
    b_r = Parameter("rad/s", "error of the yaw rate", (-1, 1), linear=False, starts=(0.0,))

    def reported(self, eta: sm.Matrix, nu: sm.Matrix, s: Signals) -> tuple[sm.Matrix, sm.Matrix]:
        return eta, nu + sm.Matrix([self.b_u, self.b_v, self.b_w, self.b_p, self.b_q, self.b_r])
