"""Torque of the propellers."""

import sympy as sm

from undertow.model.effect import Parameter, PerThruster, Signals, Wrench
from undertow.model.effects.propellers import thrust_of


class ReactionTorque(Wrench):
    """Every propeller turns the vehicle about its own axis, against its rotation, in proportion to its
    thrust.

    Included because the water resists the blades: torque over thrust is a length, some per cent of the
    propeller's diameter. hand_<thruster> = -1 says that a propeller turns the other way than the rest.
    """

    id = "reaction_torque"
    family = "actuation"
    reference = "mini-AUV paper (2021), section 2 (moment d f_i of each thruster along its axis)"
    signature = "thrust along an axis comes with a rotation about that axis"
    requires = ("thrusters",)

    d_reaction = Parameter("m", "moment about the thruster's axis per thrust", (-1, 1))
    hand = PerThruster.with_default("1", "sense of rotation, 1 or -1", (-1, 1), 1.0)

    def wrench(self, s: Signals) -> sm.Matrix:
        thrust = thrust_of(self, s)
        axes = self.allocation[:3, :]
        moment = self.d_reaction * axes * thrust.multiply_elementwise(self.hand)
        return sm.Matrix([0, 0, 0, *moment])
