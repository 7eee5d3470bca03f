"""Lift: forces bilinear in the forward speed and a cross-flow motion."""

import sympy as sm

from undertow.model.effect import Parameter, Signals, Wrench


class Lift(Wrench):
    """Lift and lift moment of hull and fins, proportional to forward speed times cross-flow."""

    id = "lift"
    family = "damping"
    reference = "Fossen (2021), chapter 6 (lift and linear manoeuvring coefficients, Y_uv and the like)"
    signature = "sway force and yaw moment in turns that vanish when the vehicle does not move ahead"

    Y_uv = Parameter("N/(m/s)^2", "sway force per surge times sway velocity")
    N_uv = Parameter("N m/(m/s)^2", "yaw moment per surge times sway velocity")
    Y_ur = Parameter("N/(m/s)/(rad/s)", "sway force per surge velocity times yaw rate")
    N_ur = Parameter("N m/(m/s)/(rad/s)", "yaw moment per surge velocity times yaw rate")
    Z_uw = Parameter("N/(m/s)^2", "heave force per surge times heave velocity")
    M_uw = Parameter("N m/(m/s)^2", "pitch moment per surge times heave velocity")
    Z_uq = Parameter("N/(m/s)/(rad/s)", "heave force per surge velocity times pitch rate")
    M_uq = Parameter("N m/(m/s)/(rad/s)", "pitch moment per surge velocity times pitch rate")

    def wrench(self, s: Signals) -> sm.Matrix:
        u, v, w, _, q, r = s.nu_r
        sway, yaw = self.Y_uv * v + self.Y_ur * r, self.N_uv * v + self.N_ur * r
        heave, pitch = self.Z_uw * w + self.Z_uq * q, self.M_uw * w + self.M_uq * q
        return u * sm.Matrix([0, sway, heave, 0, pitch, yaw])
