"""Buoyancy that does not equal the weight."""

from __future__ import annotations

import sympy as sm

from undertow.model.effect import Wrench
from undertow.model.kinematics import rotation
from undertow.model.parameter import Parameter
from undertow.model.symbols import Signals


class NetBuoyancy(Wrench):
    """Buoyancy in excess of the weight, upward, through the body origin (bad trim, other water density)."""

    id = "net_buoyancy"
    family = "statics"
    reference = "Fossen (2021), chapter 4 (hydrostatics of submerged vehicles, W - B)"
    signature = "a steady vertical command is needed to hold depth, turning with roll and pitch"

    B_net = Parameter("N", "buoyancy minus weight, positive up")

    def wrench(self, s: Signals) -> sm.Matrix:
        upward = rotation(sm.Matrix(s.eta[3:])).T * sm.Matrix([0, 0, -self.B_net])
        return sm.Matrix([*upward, 0, 0, 0])
