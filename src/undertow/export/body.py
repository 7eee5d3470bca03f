"""A vehicle's body for programs that build it from parts: inertia, buoyancy, added mass, drag."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations_with_replacement, product
from math import asin, atan2, inf, isfinite
from typing import ClassVar, NamedTuple

import casadi as ca
import numpy as np

from undertow.codegen.functions import Functions
from undertow.codegen.spelling import identifier, slug
from undertow.errors import UndertowError
from undertow.files import templates
from undertow.model.effect import Effect, Wrench
from undertow.model.symbols import DOFS
from undertow.model.vehicle import Thruster, Vehicle
from undertow.typing import Array
from undertow.version import __version__

# Forward-left-up out of forward-starboard-down, for forces and for velocities: half a turn about x.
FLIP = np.array([1.0, -1.0, -1.0, 1.0, -1.0, -1.0])
RIGID = ("rigid_body", "rigid_body_coriolis")
ADDED_MASS = ("added_mass", "added_mass_coupling", "added_mass_coriolis")
STATICS = ("restoring", "net_buoyancy")


class Push(NamedTuple):
    """A thruster as a force along a line, body frame of undertow."""

    name: str
    point: Array  # of the line, m
    direction: Array  # of length one
    limit: float | None  # largest force either way, N; None without one

    @property
    def angles(self) -> tuple[float, float, float]:
        """Roll, pitch and yaw that turn the first axis into the direction, rad."""
        x, y, z = self.direction
        return 0.0, -asin(max(-1.0, min(1.0, z))), atan2(y, x)


class Body:
    """A vehicle as a rigid body with what water adds to it, for a program, and what is lost on the way."""

    template: ClassVar[str]  # of the file
    text: str  # the file

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

    def filled(self, **values: object) -> str:
        """The template with name, mass and water of the vehicle and these values in it."""
        water, general = self.vehicle.environment, {"name": self.name, "mass": self.values["m"]}
        general |= {"g": water["g"], "density": water["rho"], "numbers": numbers}
        return filled(self.template, **general, **values)

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
        either = [self._mass(ids, np.full(6, way)) for way in (SETTINGS.slow, -SETTINGS.slow)]
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
        stands = max(known, default=SETTINGS.no_inertia * v["m"])
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

    def cube_edge(self, lift: float) -> float:
        """Edge of the cube that displaces as much water as buoyancy needs, m; it stands for the hull."""
        self.losses.append("the collision shape is a cube with the displaced volume, not the hull")
        return float((lift / (self.vehicle.environment["rho"] * self.gravity)) ** (1 / 3))

    def max_thrust(self, thruster: Thruster) -> float:
        """Largest thrust of a thruster either way, N; infinite without a limit, or where a curve has it.

        A positive command may push backwards: then thrust per command is negative, and its limit is not.
        """
        if thruster.limit is None or thruster.law is not None:
            return inf
        return abs(self.values.get(f"thrust_{thruster.name}", 1.0)) * thruster.limit

    def pushes(self) -> Iterator[Push]:
        """Thrusters whose wrench a single force has; what is lost of the others, and of curves, is noted."""
        for thruster in self.vehicle.thrusters:
            force, moment = force_and_moment(thruster)
            size = float(np.linalg.norm(force))
            if not size or abs(force @ moment) > SETTINGS.wrench * size:
                self.losses.append(f"thruster {thruster.name} is left out: no single force has its wrench")
                continue
            if thruster.law is not None:
                self.losses.append(
                    f"thruster {thruster.name}: {self.program} takes newtons, its curve is left out"
                )
            most = size * self.max_thrust(thruster)
            point = point_of_action(force, moment)
            yield Push(thruster.name, point, force / size, most if isfinite(most) else None)

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


def force_and_moment(thruster: Thruster) -> tuple[Array, Array]:
    """Wrench of one newton of thrust, body frame of undertow: force, and moment in m."""
    wrench = np.array(thruster.wrench, dtype=float)
    return wrench[:3], wrench[3:]


def point_of_action(force: Array, moment: Array) -> Array:
    """The point next to the origin on the line of a force with this moment, m; the origin for a couple."""
    size = float(force @ force)
    return np.cross(force, moment) / size if size else np.zeros(3)


def steiner(r: Array) -> Array:
    """Inertia of a unit mass at r about the origin, shape (3, 3)."""
    return np.asarray(r @ r * np.eye(3) - np.outer(r, r))


def filled(template: str, **values: object) -> str:
    """A template of exports with values in it."""
    found = templates("undertow.export", html=True).get_template(template)
    return found.render(version=__version__, **values) + "\n"


def numbers(*values: float) -> str:
    """Numbers with blanks between them, without a minus before zero."""
    return " ".join(repr(float(v) + 0.0) for v in values)


# --- damping and lift as terms of first and second order in the velocities ----------------------
@dataclass(frozen=True)
class DragSettings:
    """Numbers of the fit of drag, and of what a program cannot take."""

    rounding: float = 1e-9  # part of the largest force below which a misfit or a coefficient is rounding
    digits: int = 12  # of a coefficient
    slow: float = 0.1  # of every velocity, either way, at which added mass is looked at, m/s and rad/s
    no_inertia: float = 0.4  # kg m^2 per kg of mass, for moments of inertia where the model has none
    wrench: float = 1e-9  # moment along a force, m, up to which a single force has a wrench
    points: int = 200  # velocities at which forces are compared: more than the 69 terms
    seed: int = 1  # of these velocities


SETTINGS = DragSettings()


@dataclass(frozen=True)
class Drag:
    """Terms of damping and lift, body frame of undertow, SNAME signs."""

    # (6, 6): force i per velocity j
    linear: Array = field(default_factory=lambda: np.zeros((6, 6)))
    # (6, 6, 6): force i per velocity j times the magnitude of velocity k
    absolute: Array = field(default_factory=lambda: np.zeros((6, 6, 6)))
    # (6, 6, 6): force i per velocity j times velocity k, j not after k
    plain: Array = field(default_factory=lambda: np.zeros((6, 6, 6)))

    def __add__(self, other: Drag) -> Drag:
        return Drag(self.linear + other.linear, self.absolute + other.absolute, self.plain + other.plain)

    @property
    def diagonal(self) -> Array:
        """Linear and quadratic terms of each velocity against itself, shape (2, 6)."""
        return np.array([np.diag(self.linear), np.einsum("iii->i", self.absolute)])

    @property
    def size(self) -> int:
        """Number of terms."""
        return sum(map(np.count_nonzero, (self.linear, self.absolute, self.plain)))


def fit(body: Body) -> dict[str, Drag]:
    """Terms of every effect of damping; what has no such terms is added to the losses of the body."""
    terms = _terms()
    rng = np.random.default_rng(SETTINGS.seed)
    nu = rng.uniform(-1, 1, (SETTINGS.points, 6))
    nu[:, [i for i in range(6) if i not in body.rows]] = 0.0
    table = np.array([term(nu) for _, term in terms]).T
    drags = {}
    for effect in body.effects("damping"):
        force = body.wrench((effect.id,), nu, np.zeros_like(nu))
        found = np.linalg.lstsq(table, force, rcond=None)[0]
        largest = SETTINGS.rounding * max(float(np.abs(force).max()), 1e-300)
        if np.abs(table @ found - force).max() > largest:
            body.losses.append(f"{effect.id} is left out: it has no terms of second order in {body.program}")
            continue
        found[np.abs(found) <= largest] = 0.0
        found = np.array([float(f"{v:.{SETTINGS.digits}g}") for v in found.flat]).reshape(found.shape)
        even = [k for k, (place, _) in enumerate(terms) if place[0] == "magnitude"]
        if found[even].any():
            body.losses.append(f"{effect.id} differs forward and backward: its mean is taken")
        drags[effect.id] = drag = Drag()
        for ((kind, *place), _), column in zip(terms, found, strict=True):
            if kind != "magnitude":
                getattr(drag, str(kind))[(..., *place)] += column
    return drags


def on_the_diagonal(body: Body, drags: Mapping[str, Drag], rows: int) -> Array:
    """Linear and quadratic terms of the first rows against their own velocity, shape (2, rows).

    What else there is, is added to the losses of the body.
    """
    for name, drag in drags.items():
        kept = np.count_nonzero(drag.diagonal[:, :rows])
        if not kept:
            body.losses.append(f"{name} is left out")
        elif kept < drag.size:
            body.losses.append(f"{name}: terms that {body.program} has no place for are left out")
    return sum(drags.values(), Drag()).diagonal[:, :rows]


def _terms() -> list[tuple[tuple[str | int, ...], Callable[[Array], Array]]]:
    """Names and functions of all terms, and of |v|, in which a force differs forward and backward."""
    one = {("linear", j): lambda v, j=j: v[:, j] for j in range(6)}
    size = {("magnitude", j): lambda v, j=j: np.abs(v[:, j]) for j in range(6)}
    drag = {
        ("absolute", j, k): lambda v, j=j, k=k: v[:, j] * np.abs(v[:, k])
        for j, k in product(range(6), repeat=2)
    }
    pairs = combinations_with_replacement(range(6), 2)
    lift = {("plain", j, k): lambda v, j=j, k=k: v[:, j] * v[:, k] for j, k in pairs}
    return [*one.items(), *size.items(), *drag.items(), *lift.items()]
