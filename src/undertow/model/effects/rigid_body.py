"""Inertia of the rigid body."""

from __future__ import annotations

import sympy as sm

from undertow.errors import UndertowError
from undertow.model.effect import Wrench
from undertow.model.kinematics import inertia_matrix, inertia_tensor
from undertow.model.parameter import Parameter, Taken
from undertow.model.symbols import Signals, symbol


class RigidBody(Wrench):
    """Inertia of the vehicle and of all it carries, in base parameters (mass, static moments, inertia).

    The static moments `m x_g` and the inertia about the body origin enter linearly; a vehicle file may give
    the centre of gravity `x_g`, `y_g`, `z_g` instead. A coordinate that only `restoring` states
    holds here, too.
    """

    id = "rigid_body"
    family = "inertia"
    weighed = True
    reference = "Fossen (2021), Handbook of Marine Craft Hydrodynamics and Motion Control, chapter 3"
    signature = "acceleration answers a change of force by another amount than the mass says"

    taken = tuple(
        Taken(f"{a}_g", "restoring", (symbol(f"{a}_g"),), "m", unless=(f"m{a}_g",), only_where_silent=True)
        for a in "xyz"
    )

    m = Parameter("kg", "mass", (0, float("inf")), required=True)
    mx_g = Parameter("kg m", "mass times x of the centre of gravity", default=0.0)
    my_g = Parameter("kg m", "mass times y of the centre of gravity", default=0.0)
    mz_g = Parameter("kg m", "mass times z of the centre of gravity", default=0.0)
    I_x = Parameter("kg m^2", "roll inertia about the body origin", (0, float("inf")), required=True)
    I_y = Parameter("kg m^2", "pitch inertia about the body origin", (0, float("inf")), required=True)
    I_z = Parameter("kg m^2", "yaw inertia about the body origin", (0, float("inf")), required=True)
    I_xy = Parameter("kg m^2", "product of inertia, x and y", default=0.0)
    I_xz = Parameter("kg m^2", "product of inertia, x and z", default=0.0)
    I_yz = Parameter("kg m^2", "product of inertia, y and z", default=0.0)

    def matrix(self) -> sm.Matrix:
        """Inertia matrix M_RB about the body origin, shape (6, 6)."""
        moments = sm.Matrix([self.mx_g, self.my_g, self.mz_g])
        inertia = inertia_tensor((self.I_x, self.I_y, self.I_z), products=(self.I_xy, self.I_xz, self.I_yz))
        return inertia_matrix(self.m, moments, inertia)

    def wrench(self, s: Signals) -> sm.Matrix:
        return -self.matrix() * s.nu_dot

    @classmethod
    def file_units(cls) -> dict[str, str]:
        return {"x_g": "m", "y_g": "m", "z_g": "m"}

    @classmethod
    def from_file(cls, entries: dict[str, float]) -> dict[str, float]:
        arms = {k: v for k, v in entries.items() if k in cls.file_units()}
        if arms and "m" not in entries:
            raise UndertowError(
                "rigid_body: x_g, y_g, z_g need the mass m: give m, or static moments mx_g ..."
            )
        base = {k: v for k, v in entries.items() if k not in arms}
        return base | {f"m{k}": entries["m"] * v for k, v in arms.items()}
