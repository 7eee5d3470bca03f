"""A speed log that measures through the water."""

import sympy as sm

from undertow.model.effect import Flow, Measurement, Parameter, Signals
from undertow.model.symbols import rotation


class WaterSpeedLog(Flow, Measurement):
    """The velocity is reported through the water, which moves steadily over ground, and not over ground.

    Included because electromagnetic logs, pitot tubes and Doppler logs without sight of
    the bottom do so: forces then seem to be independent of any current, and only positions drift.
    """

    id = "water_speed_log"
    of_velocity_sensor = True
    family = "measurement"
    reference = "relative velocity v_r = v - R' v_c; Fossen (2021), chapter 10 (ocean currents)"
    signature = (
        "positions drift away from the reported velocity in one direction over ground, whatever the heading"
    )
    stage = 10

    V_N_log = Parameter(
        "m/s", "velocity of the water to the north", (-5, 5), linear=False, starts=(0.0,), earth_axis=True
    )
    V_E_log = Parameter(
        "m/s", "velocity of the water to the east", (-5, 5), linear=False, starts=(0.0,), earth_axis=True
    )

    def velocity(self, s: Signals) -> sm.Matrix:
        return sm.Matrix([self.V_N_log, self.V_E_log, 0])

    def reported(self, eta: sm.Matrix, nu: sm.Matrix, s: Signals) -> tuple[sm.Matrix, sm.Matrix]:
        drift = rotation(sm.Matrix(s.eta[3:])).T * self.velocity(s)
        return eta, nu - sm.Matrix([*drift, 0, 0, 0])
