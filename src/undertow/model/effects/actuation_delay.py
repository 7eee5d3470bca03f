"""Dead time between command and thrust."""

import sympy as sm

from undertow.model.effect import Actuation, Parameter, Signals


class ActuationDelay(Actuation):
    """Pure delay from the logged command to the thrust: network, motor controller, clock of the log."""

    id = "actuation_delay"
    reference = "transport delay; Ljung (1999), System Identification, section 4.2 (dead time)"
    signature = "the vehicle responds late but then sharply"
    stage = 50

    delay = Parameter("s", "dead time", (0.0, 5.0), linear=False, starts=(0.05, 0.3, 1.0))

    def output(self, upstream: sm.Matrix, s: Signals) -> sm.Matrix:
        return upstream

    def dead_time(self) -> sm.Expr:
        return self.delay
