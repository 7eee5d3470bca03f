"""A limit of the thrust."""

from math import inf

import sympy as sm

from undertow.model.effect import Actuation, Parameter, Signals


class ThrusterSaturation(Actuation):
    """Commands beyond a limit give no more thrust than the limit itself, the same for all thrusters.

    Included because motors have a maximum current and speed, while a log contains the command.
    """

    id = "thruster_saturation"
    reference = "saturation, output sgn(c) min(|c|, L); Khalil (2002), Nonlinear Systems, section 1.2"
    signature = "large commands give no more than middling ones"
    stage = 16

    saturation_limit = Parameter(
        "command",
        "largest magnitude of a command that has an effect",
        (1e-9, inf),  # an effect without a limit has none, not one of zero
        linear=False,
        starts=(0.3, 0.5, 0.75, 1.0),
        required=True,
        neutral=inf,
    )

    def output(self, upstream: sm.Matrix, s: Signals) -> sm.Matrix:
        return upstream.applyfunc(lambda c: sm.Max(-self.saturation_limit, sm.Min(c, self.saturation_limit)))
