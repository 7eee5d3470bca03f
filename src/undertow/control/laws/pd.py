"""Proportional-derivative control with gravity compensation."""

from __future__ import annotations

from typing import ClassVar

import sympy as sm

from .law import GainMatrix, Law, LawSignals

K_P = GainMatrix("K_P", "N/m", "N m", "position error")
K_V = GainMatrix("K_V", "N s/m", "N m s", "velocity")


class PD(Law):
    """PD control with gravity compensation: a spring to the set-point, a damper, and the weight in water.

    The force in pose coordinates is K_P error - K_V q_dot + g_q; with J' it becomes one in body axes, because
    power is the same in both.
    """

    id = "pd"
    reference = "mini-AUV paper (2021), (20) and (21)"
    gains: ClassVar[tuple[GainMatrix, ...]] = (K_P, K_V)

    def force(self, s: LawSignals) -> sm.Matrix:
        plant = s.plant
        return plant.J.T * (s.K_P * s.error - s.K_V * plant.J * plant.nu) + plant.g
