"""Cubic damping, diagonal."""

from math import inf

import sympy as sm

from undertow.model.effect import DIAGONAL, DerivativeMatrix, Signals, Wrench


class CubicDamping(Wrench):
    """Drag proportional to the third power of the speed, as fitted to some basin tests of ships."""

    id = "cubic_damping"
    family = "damping"
    reference = "Fossen (2021), chapter 6 (odd-order expansions of damping); Abkowitz (1964) series"
    signature = "drag grows faster than the square of the speed"
    scales_with = "drag"
    dissipative = True

    coefficients = DerivativeMatrix(
        "{F}_{m}{m}{m}",
        ("(m/s)^3", "(rad/s)^3"),
        DIAGONAL,
        "{force} per cube of the {motion} velocity",
        bounds=(-inf, 0),
        directional=True,
        within=1e4,  # the cube of sqrt(g L) is a thousand times that of the speeds of vehicles in water
    )

    def wrench(self, s: Signals) -> sm.Matrix:
        return self.coefficients * s.nu_r.applyfunc(lambda v: v**3)
