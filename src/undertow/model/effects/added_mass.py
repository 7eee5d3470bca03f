"""Added mass, diagonal."""

from math import inf

import sympy as sm

from undertow.model.effect import DIAGONAL, DerivativeMatrix, Signals, Wrench


class AddedMass(Wrench):
    """Water that has to be accelerated with the vehicle, one coefficient for each motion."""

    id = "added_mass"
    family = "inertia"
    reference = "Fossen (2021), chapter 6 (hydrodynamic added mass); SNAME (1950) notation"
    signature = "accelerations are too large in one degree of freedom whenever the thrust changes"
    scales_with = "inertia"

    coefficients = DerivativeMatrix(
        "{F}_{m}dot",
        ("m/s^2", "rad/s^2"),
        DIAGONAL,
        "{force} per {motion} acceleration",
        bounds=(-inf, 0),
        directional=True,
        within=10.0,  # hulls have up to once their own inertia, open frames twice or three times, plates more
    )

    def matrix(self) -> sm.Matrix:
        """Added mass M_A, positive, shape (6, 6)."""
        return -self.coefficients

    def wrench(self, s: Signals) -> sm.Matrix:
        return -self.matrix() * s.nu_r_dot
