"""Righting moment of a floating hull at large roll angles."""

import sympy as sm

from undertow.model.effect import Parameter, Signals, Wrench
from undertow.model.effects.restoring import Restoring


class NonlinearRestoring(Wrench):
    """Righting moment in roll beyond that of small angles: the side that goes down gains waterline.

    Included because `restoring` has a righting arm proportional to sin(phi), which is exact under water; that
    of a hull at the surface changes with its waterline, GZ = (GM + BM tan^2(phi) / 2) sin(phi) where the
    sides are vertical. Flared sides act as a larger BM; sides that lean inwards and an immersed deck as a
    smaller or negative one. Tried where roll is modelled and heave is not: then the hull floats.
    """

    id = "nonlinear_restoring"
    family = "statics"
    reference = "Rawson and Tupper, Basic Ship Theory, chapter 4 (wall-sided formula)"
    signature = "the roll period changes with the amplitude"
    requires = ("restoring",)

    BM = Parameter("m", "height of the metacentre above the centre of buoyancy")

    @classmethod
    def observable_in(cls, dofs: tuple[str, ...]) -> bool:
        return "roll" in dofs and "heave" not in dofs

    def wrench(self, s: Signals) -> sm.Matrix:
        phi, theta = s.eta[3], s.eta[4]
        arm = self.BM / 2 * sm.tan(phi) ** 2 * sm.sin(phi)
        return sm.Matrix([0, 0, 0, -Restoring(self.thrusters).W * arm * sm.cos(theta), 0, 0])
