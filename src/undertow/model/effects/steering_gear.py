"""Rudders and fins that need time to turn."""

import sympy as sm

from undertow.model.effect import Actuation, PerSurface, Signals


class SteeringGear(Actuation):
    """A control surface follows its command with a lag, and no faster than its gear turns it.

    Included because most logs contain the commanded angle: the steering gear of a ship turns the rudder at a
    few degrees a second, the servo of a small vehicle takes a tenth of a second.
    """

    id = "steering_gear"
    reference = "Fossen (2021), chapter 9 (steering machine: first order, with a limit of the rate)"
    signature = "the yaw rate responds late to a step of the rudder, the later the larger the step"
    stage = 40
    of_surfaces = True
    requires = ("control_surfaces",)

    lag = PerSurface.with_default("s", "time constant", (0.005, 60.0), 0.1, starts=(0.2, 1.0))
    rate = PerSurface.with_default("rad/s", "largest rate of turn", (1e-4, 100.0), 10.0, starts=(0.05, 0.5))

    @property
    def states(self) -> tuple[str, ...]:
        return tuple(f"angle_{n}" for n in self.surface_names)

    def output(self, upstream: sm.Matrix, s: Signals) -> sm.Matrix:
        return self.state_symbols

    def rates(self, upstream: sm.Matrix, s: Signals) -> sm.Matrix:
        wanted = (upstream - self.state_symbols).multiply_elementwise(self.lag.applyfunc(lambda T: 1 / T))
        rows = zip(wanted, self.rate, strict=True)
        return sm.Matrix(len(wanted), 1, [sm.Max(-most, sm.Min(v, most)) for v, most in rows])

    def rest_state(self, upstream: sm.Matrix) -> sm.Matrix:
        return upstream
