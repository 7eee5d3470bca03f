"""Side force of propellers that push ahead or astern."""

import sympy as sm

from undertow.model.effect import Parameter, Signals, Wrench
from undertow.model.effects.propellers import thrust_of


class PropellerWalk(Wrench):
    """Thrust causes a side force and a yaw moment, with different factors ahead and astern.

    Included because every ship with one screw walks sideways when it goes astern; a
    thruster that points a little off its axis does the same with equal shares ahead and astern.
    """

    id = "propeller_walk"
    family = "actuation"
    reference = "paddle-wheel effect of seamanship (transverse thrust), stated as a share of the thrust"
    signature = "the stern moves to one side whenever the screw goes astern, in proportion to the thrust"
    requires = ("thrusters",)

    Y_walk = Parameter("1", "sway force per thrust along the hull", (-1, 1))
    N_walk = Parameter("m", "yaw moment per thrust along the hull", (-100, 100))
    Y_walk_back = Parameter("1", "additional sway force per thrust, astern only", (-1, 1))
    N_walk_back = Parameter("m", "additional yaw moment per thrust, astern only", (-100, 100))

    def wrench(self, s: Signals) -> sm.Matrix:
        thrust = thrust_of(self, s)
        along = (self.allocation[0, :] * thrust)[0]
        astern = (along - sm.Abs(along)) / 2
        side = self.Y_walk * along + self.Y_walk_back * astern
        turn = self.N_walk * along + self.N_walk_back * astern
        return sm.Matrix([0, side, 0, 0, 0, turn])
