"""Wrong scale of the velocity sensor and the gyro."""

import sympy as sm

from undertow.model.effect import Measurement, Parameter, Signals


class SensorScale(Measurement):
    """The velocity sensor (and the gyro) reads high by a constant factor, one for each instrument.

    Included because a Doppler log set for another speed of sound reads u, v and w wrong by one factor,
    which would otherwise distort drag and thrust.
    """

    id = "sensor_scale"
    of_velocity_sensor = True
    by_pose = True
    reference = (
        "scale factor error; a Doppler log's speed is proportional to the speed of sound assumed in it"
    )
    signature = "distances by summed velocity and by position differ by the same share at all speeds"
    stage = 30

    scale_velocity = Parameter(
        "1", "u, v and w as read over true, minus one", (-0.9, 4), linear=False, starts=(0.0,)
    )
    scale_rate = Parameter(
        "1", "p, q and r as read over true, minus one", (-0.9, 4), linear=False, starts=(0.0,)
    )

    def reported(self, eta: sm.Matrix, nu: sm.Matrix, s: Signals) -> tuple[sm.Matrix, sm.Matrix]:
        error = sm.diag(*[self.scale_velocity] * 3, *[self.scale_rate] * 3)
        return eta, nu + error * nu
