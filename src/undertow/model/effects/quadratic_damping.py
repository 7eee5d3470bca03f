"""Quadratic damping, diagonal."""

from math import inf

import sympy as sm

from undertow.model.effect import DIAGONAL, DerivativeMatrix, Signals, Wrench


class QuadraticDamping(Wrench):
    """Drag proportional to the speed times its magnitude: pressure drag of a separated flow."""

    id = "quadratic_damping"
    family = "damping"
    reference = "Fossen (2021), chapter 6 (nonlinear viscous damping, |u|u terms); SNAME (1950) notation"
    signature = "the model is too fast at high speed and right at low speed"
    scales_with = "drag"
    dissipative = True

    coefficients = DerivativeMatrix(
        "{F}_{m}abs{m}",
        ("(m/s)^2", "(rad/s)^2"),
        DIAGONAL,
        "{force} per {motion} velocity times its magnitude",
        bounds=(-inf, 0),
        directional=True,
    )

    def wrench(self, s: Signals) -> sm.Matrix:
        return self.coefficients * s.nu_r.applyfunc(lambda v: sm.Abs(v) * v)
