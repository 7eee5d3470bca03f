"""Drag of a deflected rudder or fin."""

from math import inf

import sympy as sm

from undertow.model.effect import PerThruster, Signals, Wrench


class RudderDrag(Wrench):
    """Drag of deflected rudders and fins: speed loss due to steering, proportional to the deflection squared.

    Included because `rudder_force` acts along a fixed line across the hull, while the
    normal force F_N of a rudder turns with it: X = -(1 - t_R) F_N sin(delta). With F_N in proportion to
    delta, and small angles, that is (1 - t_R) times `rudder` times delta^2 for a command delta in rad. Only
    the part of a column of the allocation that lies across the hull counts, so a propeller has none.
    """

    id = "rudder_drag"
    family = "actuation"
    reference = (
        "Yasukawa and Yoshimura (2015), MMG standard method (surge force by steering, deduction t_R); "
        "Fossen (2021), chapter 9 (rudder forces)"
    )
    signature = "the vehicle slows down whenever a rudder is deflected, the same to either side"
    requires = ("rudder_force",)
    dissipative = True

    rudder_drag = PerThruster(
        "N/(m/s)^2/command/command", "drag per command squared and speed ahead squared", (0, inf)
    )

    def wrench(self, s: Signals) -> sm.Matrix:
        speed = s.nu_r[0]
        across = [self.allocation[1, i] ** 2 + self.allocation[2, i] ** 2 for i in range(s.actuation.rows)]
        each = zip(self.rudder_drag, across, s.actuation, strict=True)
        drag = sm.Add(*(coefficient * share * c**2 for coefficient, share, c in each))
        return sm.Matrix([-sm.Abs(speed) * speed * drag, 0, 0, 0, 0, 0])
