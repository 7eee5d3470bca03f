"""The numbers of a vehicle's body for programs that build it from parts: inertia, buoyancy, added mass."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from functools import cached_property
from math import asin, atan2, inf
from xml.etree import ElementTree as ET

import casadi as ca
import numpy as np

from undertow.codegen.functions import Functions
from undertow.codegen.spelling import identifier, slug
from undertow.errors import UndertowError
from undertow.model.effect import Effect, Wrench
from undertow.model.symbols import DOFS
from undertow.model.vehicle import Thruster, Vehicle
from undertow.typing import Array

# Forward-left-up out of forward-starboard-down, for forces and for velocities: half a turn about x.
FLIP = np.array([1.0, -1.0, -1.0, 1.0, -1.0, -1.0])
RIGID = ("rigid_body", "rigid_body_coriolis")
ADDED_MASS = ("added_mass", "added_mass_coupling", "added_mass_coriolis")
STATICS = ("restoring", "net_buoyancy")


class Body:
    """A vehicle as a rigid body with what water adds to it, for a program, and what is lost on the way."""

    _root: ET.Element  # of the file

    def __init__(self, vehicle: Vehicle, program: str, gravity: float | None = None) -> None:
        # gravity: m/s^2, of a program that has one of its own
        self.vehicle, self.program = vehicle, program
        self.gravity = vehicle.environment["g"] if gravity is None else gravity
        self.functions = Functions(vehicle)
        self.values = dict(zip(self.functions.parameter_names, self.functions.values(), strict=True))
        self.rows = list(vehicle.dof_indices)
        self.name = identifier(slug(vehicle.name))
        self.losses: list[str] = []
        if self.values.get("m", 0.0) <= 0:
            raise UndertowError(
                f"vehicle '{vehicle.name}' has no mass m: {program} needs one, add rigid_body"
            )

    @property
    def text(self) -> str:
        """The file."""
        ET.indent(self._root)
        return f'<?xml version="1.0"?>\n{ET.tostring(self._root, encoding="unicode")}\n'

    # --- the model's numbers ------------------------------------------------------------------
    def wrench(self, ids: tuple[str, ...], nu: Array, nu_dot: Array) -> Array:
        """Sum of effects at motions in still water, level and without commands, shape (k, 6)."""
        f = self.functions
        total = sum((f.wrenches[i] for i in ids if i in f.wrenches), ca.SX(len(self.rows), 1))
        evaluate = ca.Function("wrench", [f.x, f.nu_dot, f.actuation, f.p, f.t], [ca.densify(total)])
        n = f.nu.numel()
        states = np.zeros((f.x.numel(), len(nu)))
        states[n : 2 * n] = nu[:, self.rows].T
        p = np.tile(np.array(f.values())[:, None], len(nu))
        found = evaluate.map(len(nu))(
            states,
            nu_dot[:, self.rows].T,
            np.zeros((f.actuation.numel(), len(nu))),
            p,
            np.zeros((1, len(nu))),
        )
        result = np.zeros((len(nu), 6))
        result[:, self.rows] = np.asarray(found).T
        return result

    def _mass(self, ids: tuple[str, ...], nu: Array) -> Array:
        """Minus the force of the effects per acceleration at one velocity, shape (6, 6)."""
        still = self.wrench(ids, nu[None], np.zeros((1, 6)))
        return -(self.wrench(ids, np.tile(nu, (6, 1)), np.eye(6)) - still).T

    @cached_property
    def added_mass(self) -> Array:
        """Added mass, positive, body frame of undertow, shape (6, 6)."""
        ids = ADDED_MASS[:2]
        either = [self._mass(ids, np.full(6, way)) for way in (0.1, -0.1)]
        if not np.allclose(either[0], either[1]):
            self.losses.append("added mass differs forward and backward: its mean is taken")
        return np.asarray(sum(either) / 2)

    def effects(self, family: str) -> list[Wrench]:
        """Effects of one family that give a force."""
        return [e for e in self.vehicle.all_effects if isinstance(e, Wrench) and e.family == family]

    @cached_property
    def centre_of_gravity(self) -> Array:
        """Centre of gravity, body frame of undertow, m."""
        return np.array([self.values.get(f"m{a}_g", 0.0) for a in "xyz"]) / self.values["m"]

    @cached_property
    def inertia(self) -> Array:
        """Inertia about the centre of gravity, body frame of undertow, shape (3, 3), kg m^2."""
        v, r = self.values, self.centre_of_gravity
        known = [v[n] for n in ("I_x", "I_y", "I_z") if n in v]
        stands = max(known, default=0.4 * v["m"])
        absent = [n for n in ("I_x", "I_y", "I_z") if n not in v]
        if absent:
            self.losses.append(f"{', '.join(absent)} are not in the model: {stands:g} kg m^2 stands for them")
        about = np.diag([v.get(n, stands) for n in ("I_x", "I_y", "I_z")])
        for i, j, name in ((0, 1, "I_xy"), (0, 2, "I_xz"), (1, 2, "I_yz")):
            about[i, j] = about[j, i] = -v.get(name, 0.0)
        centred = about - v["m"] * steiner(r)
        if np.linalg.eigvalsh(centred).min() <= 0:
            raise UndertowError(
                f"inertia of '{self.vehicle.name}' about its centre of gravity is not positive "
                f"(smallest moment {np.linalg.eigvalsh(centred).min():.3g} kg m^2): check I_x, I_y, I_z, x_g"
            )
        return centred

    @cached_property
    def buoyancy(self) -> tuple[float, Array] | None:
        """Buoyancy in N and its centre in m, body frame; None where the model has no weight.

        With the weight under the program's gravity they give the forces and moments of the model.
        """
        v, weight = self.values, self.values["m"] * self.gravity
        present = {e.id for e in self.vehicle.all_effects}
        if not present & set(STATICS):
            return None
        surplus = v.get("B_net", 0.0) + v.get("B", 0.0) - v.get("W", 0.0)
        lift = weight + surplus
        if lift <= 0:
            raise UndertowError(f"buoyancy of '{self.vehicle.name}' is {lift:g} N: give one above zero")
        r = self.centre_of_gravity
        if "restoring" not in present:  # then the difference acts at the body origin
            return lift, weight * r / lift
        return lift, (weight * r - np.array([v.get(f"S_{a}", 0.0) for a in "xyz"])) / lift

    def edge(self, lift: float) -> float:
        """Edge of the cube that displaces as much water as buoyancy needs, m; it stands for the hull."""
        self.losses.append("the collision shape is a cube with the displaced volume, not the hull")
        return float((lift / (self.vehicle.environment["rho"] * self.gravity)) ** (1 / 3))

    def most_thrust(self, thruster: Thruster) -> float:
        """Largest thrust of a thruster either way, N; infinite without a limit, or where a curve has it.

        A positive command may push backwards: then thrust per command is negative, and its limit is not.
        """
        if thruster.limit is None or thruster.law is not None:
            return inf
        return abs(self.values.get(f"thrust_{thruster.name}", 1.0)) * thruster.limit

    def line_of_thrust(self, thruster: Thruster) -> tuple[float, Array, Array] | None:
        """Size of the force per newton of thrust, its direction and a point of its line, body frame.

        None where no single force has the wrench, which is then lost; so is a curve.
        """
        wrench = np.array(thruster.wrench, dtype=float)
        force, moment = wrench[:3], wrench[3:]
        size = float(np.linalg.norm(force))
        if not size or abs(force @ moment) > 1e-9 * size:
            self.losses.append(f"thruster {thruster.name} is left out: no single force has its wrench")
            return None
        if thruster.law is not None:
            self.losses.append(
                f"thruster {thruster.name}: {self.program} takes newtons, its curve is left out"
            )
        return size, force / size, point_of_action(force, moment)

    # --- what is lost --------------------------------------------------------------------------
    def free_motions(self) -> Iterator[str]:
        """A line on the motions that only the other program has."""
        locked = [d for d in DOFS if d not in self.vehicle.degrees_of_freedom]
        if locked:
            names = ", ".join(locked)
            yield f"{names} are free in {self.program}, without damping: the model has no such motion"

    def added_coriolis(self) -> Iterator[str]:
        """A line on the Coriolis forces of added mass of a program that always has them."""
        present = {e.id for e in self.vehicle.all_effects}
        if "added_mass" in present and "added_mass_coriolis" not in present:
            yield (
                f"added mass brings its Coriolis and Munk forces along in {self.program}; the model has none"
            )

    def left_out(
        self, exported: Collection[str] | None = None, hint: Callable[[Effect], str] = lambda effect: ""
    ) -> Iterator[str]:
        """A line on each effect that no part of the file stands for, with a hint.

        `exported`: ids of the others; by default rigid body, added mass, statics, thrusters and damping.
        """
        if exported is None:
            damping = (e.id for e in self.effects("damping"))
            exported = {*RIGID, *ADDED_MASS, *STATICS, "thrusters", *damping}
        for effect in self.vehicle.all_effects:
            if effect.id not in exported:
                yield f"{effect.id} is left out{hint(effect)}"


def point_of_action(force: Array, moment: Array) -> Array:
    """The point next to the origin on the line of a force with this moment, m; the origin for a couple."""
    size = float(force @ force)
    return np.cross(force, moment) / size if size else np.zeros(3)


def steiner(r: Array) -> Array:
    """Inertia of a unit mass at r about the origin, shape (3, 3)."""
    return np.asarray(r @ r * np.eye(3) - np.outer(r, r))


def angles_of(direction: Array) -> tuple[float, float, float]:
    """Roll, pitch and yaw that turn the first axis into a direction of length one, rad."""
    return 0.0, -asin(max(-1.0, min(1.0, direction[2]))), atan2(direction[1], direction[0])


# --- XML ------------------------------------------------------------------------------------------
def leaves(parent: ET.Element, values: Mapping[str, object]) -> None:
    """Append elements with a text or number each."""
    for name, value in values.items():
        shown = value if isinstance(value, str) else repr(float(value))  # type: ignore[arg-type]
        ET.SubElement(parent, name).text = shown


def attributes(parent: ET.Element, name: str, keys: Iterable[str], values: Iterable[float]) -> None:
    """Append an element with numbers as attributes."""
    shown = {key: numbers(value) for key, value in zip(keys, values, strict=True)}
    ET.SubElement(parent, name, shown)


def numbers(*values: float) -> str:
    """Numbers with blanks between them, without a minus before zero."""
    return " ".join(repr(float(v) + 0.0) for v in values)
