"""A steady current."""

import sympy as sm

from undertow.errors import UndertowError
from undertow.model.effect import FASTEST, Flow, Parameter, Signals


class OceanCurrent(Flow):
    """Water that moves steadily and uniformly over ground.

    Where the log has the velocity of the water (a current profiler over the bottom), it is that from sample
    to sample.
    """

    id = "ocean_current"
    reference = "Fossen (2021), chapter 10 (constant irrotational ocean current in NED)"
    signature = "surge and sway errors that turn with the heading, and drift at zero thrust"

    V_N = Parameter(
        "m/s",
        "velocity of the water to the north",
        (-5, 5),
        linear=False,
        starts=(0.0,),
        logged=True,
        per_run=True,
        earth_axis=True,
    )
    V_E = Parameter(
        "m/s",
        "velocity of the water to the east",
        (-5, 5),
        linear=False,
        starts=(0.0,),
        logged=True,
        per_run=True,
        earth_axis=True,
    )

    def velocity(self, s: Signals) -> sm.Matrix:
        return sm.Matrix([self.V_N, self.V_E, 0])


def check_current(north: float, east: float) -> None:
    """Refuse an impossible velocity of the water, m/s."""
    for way, value in (("north", north), ("east", east)):
        if not abs(value) <= FASTEST:
            raise UndertowError(
                f"a current of {value:g} m/s to the {way} exceeds the limit of {FASTEST:g} m/s: "
                "correct it or its unit"
            )
