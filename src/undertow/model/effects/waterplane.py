"""Stiffness of a hull that floats at the surface."""

from math import inf

import sympy as sm

from undertow.model.effect import Parameter, Signals, Wrench


class Waterplane(Wrench):
    """Weight and buoyancy of a hull that floats at the surface, for small motions about equilibrium.

    Included because `restoring` is of hulls under water: buoyancy that grows with the
    draught is what a vessel heaves and rolls on. It floats where z, phi and theta are zero: the origin has
    to lie in the waterline. Weight and centre of gravity are in the coefficients (K_phi = -m g GM).
    """

    id = "waterplane"
    family = "statics"
    of_shape = True
    reference = "Faltinsen (1990), Sea Loads on Ships and Offshore Structures, chapter 3 (restoring forces)"
    signature = "heave, roll and pitch oscillate about a rest position"

    Z_z = Parameter("N/m", "heave force per depth below the rest position", (-inf, 0))
    K_phi = Parameter("N m/rad", "righting moment per roll angle", (-inf, 0))
    M_theta = Parameter("N m/rad", "righting moment per pitch angle", (-inf, 0))
    Z_theta = Parameter("N/rad", "heave force per pitch angle, and pitch moment per depth")

    def wrench(self, s: Signals) -> sm.Matrix:
        z, phi, theta = s.eta[2:5]
        heave = self.Z_z * z + self.Z_theta * theta
        return sm.Matrix([0, 0, heave, self.K_phi * phi, self.Z_theta * z + self.M_theta * theta, 0])
