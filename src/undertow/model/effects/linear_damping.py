"""Linear damping, diagonal."""

from math import inf

import sympy as sm

from undertow.model.effect import DIAGONAL, DerivativeMatrix, Signals, Wrench


class LinearDamping(Wrench):
    """Drag proportional to the speed through the water: skin friction, wave radiation at low frequency."""

    id = "linear_damping"
    family = "damping"
    reference = "Fossen (2021), chapter 6 (linear viscous damping); SNAME (1950) notation"
    signature = "the vehicle coasts too long at low speed"
    damping_matrix = "diagonal"
    scales_with = "drag"
    dissipative = True

    coefficients = DerivativeMatrix(
        "{F}_{m}",
        ("m/s", "rad/s"),
        DIAGONAL,
        "{force} per {motion} velocity",
        bounds=(-inf, 0),
        directional=True,
    )

    def wrench(self, s: Signals) -> sm.Matrix:
        return self.coefficients * s.nu_r
