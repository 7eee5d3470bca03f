"""Coriolis and centripetal forces of the rigid body."""

import sympy as sm

from undertow.model.effect import Signals, Wrench
from undertow.model.effects.rigid_body import RigidBody
from undertow.model.symbols import coriolis


class RigidBodyCoriolis(Wrench):
    """Apparent forces of the vehicle's own inertia in the rotating body axes; no parameters of its own."""

    id = "rigid_body_coriolis"
    family = "inertia"
    reference = "Fossen (2021), chapter 3 (Coriolis and centripetal matrix from a symmetric inertia)"
    signature = "surge and sway errors in turns that grow with speed times yaw rate"
    requires = ("rigid_body",)
    workless = True

    def wrench(self, s: Signals) -> sm.Matrix:
        return -coriolis(RigidBody(self.thrusters).matrix(), s.nu) * s.nu
