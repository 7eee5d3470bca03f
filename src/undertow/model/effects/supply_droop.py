"""Thrust that fades in the course of a run."""

import sympy as sm

from undertow.model.effect import Actuation, LoggedOnly, Parameter, Signals


class SupplyDroop(Actuation):
    """All thrusters weaken with their supply: with its voltage if logged, else linearly in time.

    Included because the voltage of a battery falls while it is discharged, and thrust with its square,
    which is an exponent of 2. Without the voltage, every run is assumed to begin with a charged battery.
    """

    id = "supply_droop"
    reference = "first-order expansion of the thrust in the supply voltage, or in time; no model of a battery"
    signature = "the same command gives less and less towards the end of a run"
    stage = 35

    droop_rate = Parameter(
        "1/s", "share of the thrust that is lost per second", (0, 0.1), without_log="voltage", per_run=True
    )
    voltage = LoggedOnly("V", "voltage of the supply")
    voltage_exponent = Parameter(
        "1",
        "relative change of the thrust over that of the voltage",
        (0, 10),
        with_log="voltage",
    )
    voltage_nominal = Parameter.with_starts(
        "V", "voltage at which thrust is as stated", (0.1, 1e5), (12.0, 24.0, 48.0), with_log="voltage"
    )

    def output(self, upstream: sm.Matrix, s: Signals) -> sm.Matrix:
        if "voltage" in self.inputs:
            return upstream + self.voltage_exponent * (self.voltage / self.voltage_nominal - 1) * upstream
        return upstream - self.droop_rate * s.t * upstream
