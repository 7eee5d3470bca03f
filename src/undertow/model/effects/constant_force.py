"""A constant force in body axes."""

import sympy as sm

from undertow.model.effect import Parameter, Signals, Wrench


class ConstantForce(Wrench):
    """A steady force and moment fixed in the body: a creeping thruster, an asymmetric hull, a sensor bias."""

    id = "constant_force"
    family = "statics"
    reference = "bias force in body axes; Fossen (2021) uses bias states of this kind in observers"
    signature = "a steady command is needed to stand still, whatever the heading"

    X_0 = Parameter("N", "surge force")
    Y_0 = Parameter("N", "sway force")
    Z_0 = Parameter("N", "heave force")
    K_0 = Parameter("N m", "roll moment")
    M_0 = Parameter("N m", "pitch moment")
    N_0 = Parameter("N m", "yaw moment")

    def wrench(self, s: Signals) -> sm.Matrix:
        return sm.Matrix([self.X_0, self.Y_0, self.Z_0, self.K_0, self.M_0, self.N_0])
