"""Water that the vehicle carries along."""

from math import inf

import sympy as sm

from undertow.model.effect import Parameter, Signals, Wrench
from undertow.model.symbols import coriolis, inertia_matrix, inertia_tensor


class EntrainedWater(Wrench):
    """Water in free-flooding compartments: inertia and its Coriolis forces, but no weight in water.

    Included because a flooded hull has more inertia than its dry mass. Unlike added mass it is the
    same in every direction and is accelerated over ground. In base parameters (mass, static moments, inertia
    about the origin), so that it is linear: the water's centre is at mx_w / m_w forward and so on.
    """

    id = "entrained_water"
    family = "inertia"
    reference = "Fossen (2021), chapter 3 (rigid-body kinetics), for a mass whose weight its buoyancy carries"
    signature = "all accelerations are too large by the same mass, while weight and buoyancy are right"

    m_w = Parameter("kg", "mass of the water", (0, inf))
    mx_w = Parameter("kg m", "mass of the water times x of its centre", arm_of="m_w")
    my_w = Parameter("kg m", "mass of the water times y of its centre", arm_of="m_w")
    mz_w = Parameter("kg m", "mass of the water times z of its centre", arm_of="m_w")
    I_xw = Parameter("kg m^2", "its roll inertia about the body origin", (0, inf))
    I_yw = Parameter("kg m^2", "its pitch inertia about the body origin", (0, inf))
    I_zw = Parameter("kg m^2", "its yaw inertia about the body origin", (0, inf))
    I_xyw = Parameter("kg m^2", "its product of inertia, x and y")
    I_xzw = Parameter("kg m^2", "its product of inertia, x and z")
    I_yzw = Parameter("kg m^2", "its product of inertia, y and z")

    def wrench(self, s: Signals) -> sm.Matrix:
        moments = sm.Matrix([self.mx_w, self.my_w, self.mz_w])
        tensor = inertia_tensor((self.I_xw, self.I_yw, self.I_zw), (self.I_xyw, self.I_xzw, self.I_yzw))
        inertia = inertia_matrix(self.m_w, moments, tensor)
        return -(inertia * s.nu_dot + coriolis(inertia, s.nu) * s.nu)
