"""Thrust that fades in the course of a run."""

from __future__ import annotations

import sympy as sm

from undertow.model.effect import Actuation
from undertow.model.parameter import Parameter
from undertow.model.symbols import Signals


class SupplyDroop(Actuation):
    """All thrusters fade linearly with time since the start of the run, which a charged battery begins.

    It is there because the voltage of a battery falls while it is discharged, and thrust with its square.
    """

    id = "supply_droop"
    reference = (
        "first-order expansion in time of thrust that falls with the supply voltage; no model of a battery"
    )
    signature = "the same command gives less and less towards the end of a run"
    stage = 35

    droop_rate = Parameter("1/s", "share of the thrust that is lost per second", (-0.1, 0.1), per_run=True)

    def output(self, upstream: sm.Matrix, s: Signals) -> sm.Matrix:
        return upstream - self.droop_rate * s.t * upstream
