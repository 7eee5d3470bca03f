"""Forces and moments that the log itself holds."""

import sympy as sm

from undertow.model.effect import Signals, Wrench


class GeneralisedForce(Wrench):
    """Known force and moment on the vehicle, read from the log channels tau_X ... tau_N."""

    id = "generalised_force"
    family = "actuation"
    reference = "SNAME (1950) notation of forces and moments"
    signature = "no motion in response to the force"
    built_in = True

    def wrench(self, s: Signals) -> sm.Matrix:
        return s.generalised_force
