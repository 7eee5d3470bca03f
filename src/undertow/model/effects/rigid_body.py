"""Inertia of the rigid body."""

from collections.abc import Iterator, Mapping, Set
from math import sqrt

import sympy as sm

from undertow.errors import UndertowError
from undertow.model.effect import Limits, Parameter, SharedQuantity, Signals, VehicleSize, Wrench, symbol
from undertow.model.symbols import failing_pivot, inertia_matrix, inertia_tensor


class RigidBody(Wrench):
    """Inertia of the vehicle and of all it carries, in base parameters (mass, static moments, inertia).

    The static moments `m x_g` and the inertia about the body origin enter linearly; a vehicle file may give
    the centre of gravity `x_g`, `y_g`, `z_g` instead. A coordinate that only `restoring` states
    holds here, too.
    """

    id = "rigid_body"
    family = "inertia"
    known_by_design = True
    reference = "Fossen (2021), Handbook of Marine Craft Hydrodynamics and Motion Control, chapter 3"
    signature = "acceleration responds to a change of force by a different amount than the mass implies"

    shared_quantities = tuple(
        SharedQuantity(
            f"{a}_g", "restoring", (symbol(f"{a}_g"),), "m", unless=(f"m{a}_g",), only_if_missing=True
        )
        for a in "xyz"
    )

    m = Parameter("kg", "mass", (0, float("inf")), required=True)
    mx_g = Parameter("kg m", "mass times x of the centre of gravity", default=0.0, arm_of="m")
    my_g = Parameter("kg m", "mass times y of the centre of gravity", default=0.0, arm_of="m")
    mz_g = Parameter("kg m", "mass times z of the centre of gravity", default=0.0, arm_of="m")
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

    @classmethod
    def vehicle_size(cls, values: Mapping[str, float]) -> VehicleSize | None:
        mass = values.get("m", 0.0)
        if mass <= 0:
            return None
        largest = max(values.get(f"I_{a}", 0.0) for a in "xyz")
        return VehicleSize(mass, (mass / values["rho"]) ** (1 / 3), sqrt(max(largest, 0.0) / mass))

    @classmethod
    def impossible(
        cls, values: Mapping[str, float], limits: Limits, moved: Set[str] = frozenset()
    ) -> Iterator[str]:
        low, high = limits.mass
        if not low <= values.get("m", 1.0) <= high:
            possible = f"possible: {low:g} to {high:g} kg"
            yield f"m = {values['m']:g} kg is impossible ({possible}): correct it or its unit"
            return
        axes = [a for a in "xyz" if f"I_{a}" in values]
        tensor = _about_centre(values)
        for a in axes:
            yield from _moment(
                a, tensor["xyz".index(a)]["xyz".index(a)], values, cls.vehicle_size(values), limits
            )
        if len(axes) == 3 and not any(p.name in moved for p in cls().parameters):
            yield from _triangle(tensor, limits.rounding)
        rows = ["xyz".index(a) for a in axes]
        if failing_pivot([[tensor[i][j] for j in rows] for i in rows]) is not None:
            yield "has products of inertia too large for its moments about the centre of gravity: check both"


def _about_centre(values: Mapping[str, float]) -> list[list[float]]:
    """Inertia about the centre of gravity, shape (3, 3), kg m^2; what is not stated counts as zero."""
    mass = values.get("m", 0.0)
    r = [values.get(f"m{a}_g", 0.0) / mass if mass else 0.0 for a in "xyz"]
    ixx, iyy, izz, ixy, ixz, iyz = (values.get(f"I_{n}", 0.0) for n in ("x", "y", "z", "xy", "xz", "yz"))
    own = inertia_tensor((ixx, iyy, izz), (ixy, ixz, iyz))
    square = sum(x * x for x in r)
    return [[float(own[i, j]) - mass * (square * (i == j) - r[i] * r[j]) for j in range(3)] for i in range(3)]


def _moment(
    axis: str, about: float, values: Mapping[str, float], size: VehicleSize | None, limits: Limits
) -> Iterator[str]:
    name, stated = f"I_{axis}", values[f"I_{axis}"]
    if stated <= 0:
        yield f"{name} = {stated:g} kg m^2 is impossible: every body has some; give it about the body origin"
    elif about <= 0:
        yield (
            f"{name} = {stated:g} kg m^2 about the body origin leaves {about:.3g} about the centre of "
            f"gravity: it must be above m r^2 = {stated - about:.3g}; correct {name}, m or that centre"
        )
    elif size is not None:
        low, high = (share * size.length for share in limits.gyration)
        arm = sqrt(about / size.mass)
        if not low <= arm <= high:
            yield (
                f"{name} = {stated:g} kg m^2 makes {arm:.3g} m the radius of gyration of {size.mass:g} kg "
                f"(possible: {low:.2g} to {high:.2g} m): correct it or its unit"
            )


def _triangle(tensor: list[list[float]], rounding: float) -> Iterator[str]:
    """No moment exceeds the other two together: each is a sum of squares over two of three axes."""
    moments = [tensor[i][i] for i in range(3)]
    for i, axis in enumerate("xyz"):
        others = sum(moments) - moments[i]
        if moments[i] > (1 + rounding) * others:
            b, c = (a for a in "xyz" if a != axis)
            yield (
                f"I_{axis} = {moments[i]:.4g} kg m^2 about the centre of gravity is more than I_{b} + I_{c} "
                f"= {others:.4g}, which is impossible: correct one of them"
            )
            return
    spread = [[sum(moments) / 2 * (i == j) - tensor[i][j] for j in range(3)] for i in range(3)]
    if min(moments) > 0 and failing_pivot(spread, rounding * sum(moments)) is not None:
        yield "has products of inertia that no body with these moments has: check their signs and units"
