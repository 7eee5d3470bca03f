"""Lift of a hull or fins that are not quite straight."""

import sympy as sm

from undertow.model.effect import Parameter, Signals, Wrench


class ZeroAngleLift(Wrench):
    """Forces and moments across the hull due to forward speed alone, proportional to its square.

    Included because a fin that sits a degree off, a bent hull, an antenna on one side or
    a wing with camber steers a vehicle whose rudders are straight: no force at rest, four times as much at
    twice the speed. A single-screw ship needs some rudder angle to go straight for the same reason.
    """

    id = "zero_angle_lift"
    family = "damping"
    reference = (
        "Gertler and Hagen (1967), Standard equations of motion for submarine simulation (Z_*, M_* and "
        "the like: forces at zero angle of attack, per speed squared)"
    )
    signature = "a pull to one side with controls straight that grows with the square of the speed ahead"

    Y_uabsu = Parameter("N/(m/s)^2", "sway force per surge velocity times its magnitude")
    Z_uabsu = Parameter("N/(m/s)^2", "heave force per surge velocity times its magnitude")
    K_uabsu = Parameter("N m/(m/s)^2", "roll moment per surge velocity times its magnitude")
    M_uabsu = Parameter("N m/(m/s)^2", "pitch moment per surge velocity times its magnitude")
    N_uabsu = Parameter("N m/(m/s)^2", "yaw moment per surge velocity times its magnitude")

    @classmethod
    def observable_in(cls, dofs: tuple[str, ...]) -> bool:
        return "surge" in dofs and len(dofs) > 1

    def wrench(self, s: Signals) -> sm.Matrix:
        across = sm.Matrix([0, self.Y_uabsu, self.Z_uabsu, self.K_uabsu, self.M_uabsu, self.N_uabsu])
        return sm.Abs(s.nu_r[0]) * s.nu_r[0] * across
