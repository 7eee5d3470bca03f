"""Constant errors of compass and inclinometers."""

import sympy as sm

from undertow.model.effect import Measurement, Parameter, Signals


class AttitudeBias(Measurement):
    """Heading, roll and pitch are reported with a constant error: uncorrected declination, a unit that is not
    level.

    Included because compass errors are the most common heading error: the directions of position change and
    velocity then disagree although both sensors are right.
    """

    id = "attitude_bias"
    reference = (
        "constant misalignment of the attitude reference; Fossen (2021), chapter 14 (compass, inclinometers)"
    )
    signature = "the track over ground is turned against heading and body velocity by a constant angle"
    stage = 20

    b_phi = Parameter("rad", "error of the roll angle", (-1, 1), linear=False, starts=(0.0,))
    b_theta = Parameter("rad", "error of the pitch angle", (-1, 1), linear=False, starts=(0.0,))
    b_psi = Parameter("rad", "error of the heading", (-3.2, 3.2), linear=False, starts=(0.0,))

    def reported(self, eta: sm.Matrix, nu: sm.Matrix, s: Signals) -> tuple[sm.Matrix, sm.Matrix]:
        return eta + sm.Matrix([0, 0, 0, self.b_phi, self.b_theta, self.b_psi]), nu
