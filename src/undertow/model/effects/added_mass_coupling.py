"""Off-diagonal added mass with its Coriolis part."""

import sympy as sm

from undertow.model.effect import UPPER_TRIANGLE, DerivativeMatrix, Signals, Wrench
from undertow.model.symbols import coriolis


class AddedMassCoupling(Wrench):
    """Added mass that couples two motions (Y_rdot and the like), with the Coriolis forces that go with it."""

    id = "added_mass_coupling"
    family = "inertia"
    reference = "Fossen (2021), chapter 6 (M_A symmetric with off-diagonal terms, C_A from the same matrix)"
    signature = "one motion responds, without delay, to the acceleration of another"
    scales_with = "inertia"

    coefficients = DerivativeMatrix(
        "{F}_{m}dot",
        ("m/s^2", "rad/s^2"),
        UPPER_TRIANGLE,
        "{force} per {motion} acceleration",
        symmetric=True,
        within=10.0,  # as the diagonal: off it, the matrix is the smaller part
    )

    def wrench(self, s: Signals) -> sm.Matrix:
        inertia = -self.coefficients
        return -(inertia * s.nu_r_dot + coriolis(inertia, s.nu_r) * s.nu_r)
