"""An unknown shift of the centre of buoyancy."""

import sympy as sm

from undertow.model.effect import Parameter, Signals, Wrench
from undertow.model.effects.restoring import Restoring
from undertow.model.symbols import rotation


class TrimOffset(Wrench):
    """Shift of the centre of buoyancy relative to the model: the vehicle lists or trims at rest."""

    id = "trim_offset"
    family = "statics"
    reference = "Fossen (2021), chapter 4 (restoring moment, r_B x buoyancy)"
    signature = "constant roll or pitch at rest"
    requires = ("restoring",)

    dx_B = Parameter("m", "shift of the centre of buoyancy, forward", arm_of="1", per_run=True)
    dy_B = Parameter("m", "shift of the centre of buoyancy, to starboard", arm_of="1", per_run=True)
    dz_B = Parameter("m", "shift of the centre of buoyancy, down", arm_of="1", per_run=True)

    def wrench(self, s: Signals) -> sm.Matrix:
        buoyancy = Restoring(self.thrusters).B
        up = rotation(sm.Matrix(s.eta[3:])).T * sm.Matrix([0, 0, -buoyancy])
        return sm.Matrix([0, 0, 0, *sm.Matrix([self.dx_B, self.dy_B, self.dz_B]).cross(up)])
