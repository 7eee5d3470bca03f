"""Linear damping between different motions."""

import sympy as sm

from undertow.model.effect import OFF_DIAGONAL, DerivativeMatrix, Signals, Wrench


class LinearDampingCoupling(Wrench):
    """Force in one degree of freedom proportional to the velocity of another (N_v, Y_r and the like)."""

    id = "linear_damping_coupling"
    family = "damping"
    reference = "Fossen (2021), chapter 6 (linear damping matrix with coupling terms); SNAME (1950) notation"
    signature = "a yaw moment in pure sway, or a sway force in pure yaw, proportional to the rate"
    damping_matrix = "coupling"
    scales_with = "drag"

    coefficients = DerivativeMatrix(
        "{F}_{m}", ("m/s", "rad/s"), OFF_DIAGONAL, "{force} per {motion} velocity"
    )

    def wrench(self, s: Signals) -> sm.Matrix:
        return self.coefficients * s.nu_r
