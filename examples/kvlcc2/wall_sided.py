"""Righting moment of a ship with vertical sides: an effect of one's own, for `--effects wall_sided.py`."""

from __future__ import annotations

from math import inf

import sympy as sm

from undertow.model.effect import Wrench
from undertow.model.effects.restoring import Restoring
from undertow.model.parameter import Parameter
from undertow.model.symbols import Signals


class WallSided(Wrench):
    """Righting moment in roll beyond that of small angles: the side that goes down gains waterline."""

    id = "wall_sided"
    family = "statics"
    reference = (
        "wall-sided formula GZ = (GM + BM tan^2(phi) / 2) sin(phi); "
        "Rawson and Tupper, Basic Ship Theory, chapter 4"
    )
    signature = "the roll period is shorter at large amplitude"
    requires = ("restoring",)

    BM = Parameter("m", "height of the metacentre above the centre of buoyancy", (0, inf))

    def wrench(self, s: Signals) -> sm.Matrix:
        phi, theta = s.eta[3], s.eta[4]
        lever = self.BM / 2 * sm.tan(phi) ** 2 * sm.sin(phi) * sm.cos(theta)
        return sm.Matrix([0, 0, 0, -Restoring(self.thrusters).W * lever, 0, 0])
