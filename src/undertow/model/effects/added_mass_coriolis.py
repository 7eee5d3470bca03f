"""Coriolis forces and the Munk moment of the added mass."""

import sympy as sm

from undertow.model.effect import Signals, Wrench
from undertow.model.effects.added_mass import AddedMass
from undertow.model.symbols import coriolis


class AddedMassCoriolis(Wrench):
    """Coriolis, centripetal and Munk terms of the added mass; no parameter of its own."""

    id = "added_mass_coriolis"
    family = "inertia"
    reference = "Fossen (2021), chapter 6 (hydrodynamic Coriolis matrix C_A)"
    signature = "a yaw or pitch moment that grows with the product of two velocities (Munk moment)"
    requires = ("added_mass",)
    workless = True

    def wrench(self, s: Signals) -> sm.Matrix:
        return -coriolis(AddedMass(self.thrusters).matrix(), s.nu_r) * s.nu_r
