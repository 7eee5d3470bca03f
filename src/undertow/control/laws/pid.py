"""PID control with gravity compensation."""

from __future__ import annotations

import sympy as sm

from .law import GainMatrix, LawSignals
from .pd import PD

K_I = GainMatrix("K_I", "N/(m s)", "N m/s", "integral of the position error")


class PID(PD):
    """PID control with gravity compensation: the PD law and an integral of the error in pose coordinates."""

    id = "pid"
    reference = "mini-AUV paper (2021), (26) and (27)"
    gains = (*PD.gains, K_I)
    states = ("integral",)

    def force(self, s: LawSignals) -> sm.Matrix:
        return super().force(s) + s.plant.J.T * s.K_I * s.states

    def rates(self, s: LawSignals) -> sm.Matrix:
        return s.error
