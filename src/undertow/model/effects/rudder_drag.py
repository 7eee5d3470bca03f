"""Drag of a deflected rudder or fin."""

from math import inf

import sympy as sm

from undertow.model.effect import PerThruster, Signals, Wrench


class RudderDrag(Wrench):
    """Drag of deflected rudders and fins: speed loss due to steering, less while the vehicle drifts with it.

    Included because `rudder_force` and a thruster push along a fixed line across the hull, while the normal
    force F_N of a rudder turns with it: X = -(1 - t_R) F_N sin(delta). F_N is proportional to the angle of
    attack, delta less the angle of the flow past the rudder, and has a part without speed in the slipstream
    of a propeller. With small angles and a command delta in rad, `rudder_drag` is (1 - t_R) times `rudder`,
    `rudder_inflow` that times the flow straightening of the hull, gamma_R, and `slipstream_drag` (1 - t_R)
    times the thrust per command. Only the part of a column of the allocation that lies across the hull
    counts, so a propeller has none. What the flow past the rudder does to F_N across the hull is part of the
    hull's lift (`lift`).
    """

    id = "rudder_drag"
    family = "actuation"
    reference = (
        "Yasukawa and Yoshimura (2015), MMG standard method (surge force by steering, deduction t_R, flow "
        "straightening gamma_R, acceleration by the propeller); Fossen (2021), chapter 9 (rudder forces)"
    )
    signature = "the vehicle slows down whenever a rudder is deflected, less while it drifts or turns with it"
    requires = ("rudder_force",)

    rudder_drag = PerThruster(
        "N/(m/s)^2/command/command", "drag per command squared and speed ahead squared", (0, inf)
    )
    rudder_inflow = PerThruster(
        "N/(m/s)^2/command", "loss of drag per command, speed ahead and speed across of the rudder", (0, inf)
    )

    slipstream_drag = PerThruster(
        "N/command/command", "drag per command squared without speed, in a slipstream", (0, inf)
    )

    def wrench(self, s: Signals) -> sm.Matrix:
        speed, drag = s.nu_r[0], sm.S.Zero
        for i, command in enumerate(s.actuation):
            across = self.allocation[:, i].copy()
            across[0] = 0
            share = across[1] ** 2 + across[2] ** 2
            flow = self.rudder_drag[i] * command * speed - self.rudder_inflow[i] * across.dot(s.nu_r)
            drag += share * command * (sm.Abs(speed) * flow + self.slipstream_drag[i] * command)
        return sm.Matrix([-drag, 0, 0, 0, 0, 0])
