"""Rudders and fins that do not stand where they should."""

import sympy as sm

from undertow.model.effect import Actuation, PerSurface, Signals


class SurfaceOffset(Actuation):
    """The angle of a control surface differs from the commanded one by a constant, or by a fraction of it.

    Included because linkages are trimmed by hand, and a rudder that is two degrees off at zero makes every
    straight run a turn.
    """

    id = "surface_offset"
    reference = "bias and scale of an actuator; Fossen (2021), control allocation"
    signature = "the vehicle turns at zero angle, to the other side astern, as the square of the speed"
    stage = 10
    of_surfaces = True
    requires = ("control_surfaces",)

    angle_offset = PerSurface("rad", "angle at a command of zero", (-1, 1))
    angle_error = PerSurface("1", "angle over command, minus one", (-2, 2))

    def output(self, upstream: sm.Matrix, s: Signals) -> sm.Matrix:
        return upstream + self.angle_offset + upstream.multiply_elementwise(self.angle_error)
