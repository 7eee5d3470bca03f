"""Thrusters that need time to spin up."""

import sympy as sm

from undertow.model.effect import Actuation, Parameter, Signals


class ThrusterLag(Actuation):
    """First-order lag from command to thrust, the same for all thrusters."""

    id = "thruster_lag"
    reference = "first-order propulsor dynamics; Fossen (2021), chapter 9"
    signature = "the vehicle responds smoothly and late to a step of thrust, with the right final speed"
    stage = 40

    T_lag = Parameter.with_starts("s", "time constant", (0.01, 20.0), (0.1, 0.4, 1.5))

    @property
    def states(self) -> tuple[str, ...]:
        return tuple(f"lagged_{n}" for n in self.thrusters)

    def output(self, upstream: sm.Matrix, s: Signals) -> sm.Matrix:
        return self.state_symbols

    def rates(self, upstream: sm.Matrix, s: Signals) -> sm.Matrix:
        return (upstream - self.state_symbols) / self.T_lag

    def rest_state(self, upstream: sm.Matrix) -> sm.Matrix:
        return upstream
