"""Dead time of the velocity sensor."""

import sympy as sm

from undertow.model.effect import Measurement, Parameter, Signals


class SensorDelay(Measurement):
    """The velocity sensor (DVL) reports u, v and w late; pose and angular velocity come in time."""

    id = "sensor_delay"
    of_velocity_sensor = True
    reference = "transport delay; Ljung (1999), System Identification, section 4.2 (dead time)"
    signature = "measured velocity trails the position's rate by a constant time, whatever the manoeuvre"
    stage = 50

    velocity_delay = Parameter(
        "s", "age of a velocity when it is reported", (0.0, 2.0), linear=False, starts=(0.05, 0.3)
    )

    def reported(self, eta: sm.Matrix, nu: sm.Matrix, s: Signals) -> tuple[sm.Matrix, sm.Matrix]:
        return eta, nu

    def age(self) -> sm.Matrix:
        return sm.Matrix([0] * 6 + [self.velocity_delay] * 3 + [0] * 3)
