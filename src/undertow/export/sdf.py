"""Worlds for Gazebo (SDF): inertia, added mass, damping, buoyancy and thrusters of a vehicle."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement, product
from math import asin, atan2, isfinite
from xml.etree import ElementTree as ET

import numpy as np

from undertow.model.effect import Flow
from undertow.model.vehicle import Thruster, Vehicle
from undertow.typing import Array
from undertow.version import __version__

from .body import FLIP, STATICS, Body, leaves, numbers, point_of_action

_FORCES, _VELOCITIES = "xyzkmn", "UVWPQR"
_SYSTEMS = {"physics": "Physics", "user-commands": "UserCommands", "scene-broadcaster": "SceneBroadcaster"}
_BODY = ("rigid_body", "rigid_body_coriolis", "added_mass", "added_mass_coupling", "added_mass_coriolis")


@dataclass(frozen=True)
class SdfSettings:
    """Numbers of the export."""

    # mass of the link of a propeller, kg: Gazebo moves no link without one, and it adds to the vehicle
    propeller_mass: float = 0.001
    rounding: float = 1e-9  # part of the largest force below which a misfit or a coefficient is rounding
    # velocities at which the damping is compared with what the plugin can say: more than its 69 terms
    points: int = 200
    seed: int = 1  # of these velocities
    step: float = 0.002  # time step of the world, s


@dataclass(frozen=True)
class Drag:
    """Damping and lift as the plugin states them, body frame of undertow, SNAME signs."""

    linear: Array  # (6, 6): force i per velocity j
    absolute: Array  # (6, 6, 6): force i per velocity j times the magnitude of velocity k
    plain: Array  # (6, 6, 6): force i per velocity j times velocity k, j not after k

    def elements(self) -> dict[str, float]:
        """Name and value of every coefficient that is not zero, forward-left-up."""
        t = FLIP
        tables = (
            ("{}{}", self.linear * np.einsum("i,j->ij", t, t)),
            ("{}{}abs{}", self.absolute * np.einsum("i,j->ij", t, t)[..., None]),
            ("{}{}{}", self.plain * np.einsum("i,j,k->ijk", t, t, t)),
        )
        return {
            form.format(_FORCES[place[0]], *(_VELOCITIES[k] for k in place[1:])): float(
                f"{table[place]:.12g}"
            )
            for form, table in tables
            for place in map(tuple, np.argwhere(table).tolist())
        }


class Sdf(Body):
    """A vehicle as a world for `gz sim`, east-north-up and forward-left-up.

    References
    ----------
    Gazebo Sim, systems Hydrodynamics, Buoyancy and Thruster, https://gazebosim.org/api/sim; SDFormat 1.10,
    ``fluid_added_mass``, http://sdformat.org/spec.
    """

    def __init__(self, vehicle: Vehicle, settings: SdfSettings | None = None) -> None:
        super().__init__(vehicle, "Gazebo")
        self.settings = settings or SdfSettings()
        self._root = self._world()
        self.losses += self._what_is_left()

    @property
    def text(self) -> str:
        """The file."""
        ET.indent(self._root)
        return f'<?xml version="1.0"?>\n{ET.tostring(self._root, encoding="unicode")}\n'

    @cached_property
    def drag(self) -> Drag:
        """Damping and lift in the terms of the plugin; what it cannot say is added to the losses."""
        terms = _terms()
        rng = np.random.default_rng(self.settings.seed)
        nu = rng.uniform(-1, 1, (self.settings.points, 6))
        nu[:, [i for i in range(6) if i not in self.rows]] = 0.0
        table = np.array([term(nu) for _, term in terms]).T
        drag = Drag(np.zeros((6, 6)), np.zeros((6, 6, 6)), np.zeros((6, 6, 6)))
        for effect in self.effects("damping"):
            force = self.wrench((effect.id,), nu, np.zeros_like(nu))
            found = np.linalg.lstsq(table, force, rcond=None)[0]
            largest = self.settings.rounding * max(float(np.abs(force).max()), 1e-300)
            if np.abs(table @ found - force).max() > largest:
                self.losses.append(f"{effect.id} is left out: it has no terms in the Hydrodynamics plugin")
                continue
            found[np.abs(found) <= largest] = 0.0
            even = [k for k, (place, _) in enumerate(terms) if place[0] == "magnitude"]
            if found[even].any():
                self.losses.append(f"{effect.id} differs forward and backward: its mean is taken")
            for ((kind, *place), _), column in zip(terms, found, strict=True):
                if kind != "magnitude":
                    getattr(drag, str(kind))[(..., *place)] += column
        return drag

    # --- the file -----------------------------------------------------------------------------
    def _world(self) -> ET.Element:
        root = ET.Element("sdf", {"version": "1.10"})
        root.append(ET.Comment(f" '{self.name}' by undertow {__version__}: ENU, forward-left-up "))
        world = ET.SubElement(root, "world", {"name": "water"})
        physics = ET.SubElement(world, "physics", {"name": "steps", "type": "ode"})
        leaves(physics, {"max_step_size": self.settings.step, "real_time_factor": 1})
        leaves(world, {"gravity": f"0 0 {-self.vehicle.environment['g']!r}"})
        for file, system in _SYSTEMS.items():
            _plugin(world, file, system, {})
        density = {"uniform_fluid_density": self.vehicle.environment["rho"]}
        _plugin(world, "buoyancy", "Buoyancy", density)
        model = ET.SubElement(world, "model", {"name": self.name})
        self._base(model)
        _plugin(model, "hydrodynamics", "Hydrodynamics", self._hydrodynamics())
        for thruster in self.vehicle.thrusters:
            self._thruster(model, thruster)
        return root

    def _hydrodynamics(self) -> dict[str, object]:
        # Added mass stands in the inertia alone: the plugin would add it, and its Coriolis forces, again.
        head = {"link_name": "base_link", "water_density": self.vehicle.environment["rho"]}
        return {**head, "disable_added_mass": "true", "disable_coriolis": "true", **self.drag.elements()}

    def _base(self, model: ET.Element) -> None:
        link = ET.SubElement(model, "link", {"name": "base_link"})
        inertial = ET.SubElement(link, "inertial")
        leaves(inertial, {"pose": _pose(FLIP[:3] * self.centre_of_gravity), "mass": self.values["m"]})
        turned = self.inertia * np.outer(FLIP[:3], FLIP[:3])
        names = {
            f"i{'xyz'[i]}{'xyz'[j]}": turned[i, j] for i, j in combinations_with_replacement(range(3), 2)
        }
        leaves(ET.SubElement(inertial, "inertia"), names)
        self._added(inertial)
        self._volume(link)

    def _added(self, inertial: ET.Element) -> None:
        """`fluid_added_mass`, positive and symmetric, about the origin of the link."""
        turned = self.added_mass * np.outer(FLIP, FLIP)
        if not turned.any():
            return
        letters = "xyzpqr"
        pairs = combinations_with_replacement(range(6), 2)
        leaves(
            ET.SubElement(inertial, "fluid_added_mass"),
            {f"{letters[i]}{letters[j]}": turned[i, j] for i, j in pairs},
        )

    def _volume(self, link: ET.Element) -> None:
        """A cube that displaces as much water as the model's buoyancy says."""
        if self.buoyancy is None:
            leaves(link, {"gravity": "false"})
            self.losses.append("the model has no weight and buoyancy: gravity is off for it")
            return
        lift, centre = self.buoyancy
        edge = self.edge(lift)
        for kind in ("collision", "visual"):
            element = ET.SubElement(link, kind, {"name": kind})
            leaves(element, {"pose": _pose(FLIP[:3] * centre)})
            box = ET.SubElement(ET.SubElement(element, "geometry"), "box")
            leaves(box, {"size": " ".join([repr(float(edge))] * 3)})

    def _thruster(self, model: ET.Element, thruster: Thruster) -> None:
        wrench = FLIP * np.array(thruster.wrench, dtype=float)
        force, moment = wrench[:3], wrench[3:]
        size, arm = float(np.linalg.norm(force)), point_of_action(force, moment)
        if not size or abs(force @ moment) > 1e-9 * size:
            self.losses.append(f"thruster {thruster.name} is left out: no single force has its wrench")
            return
        if thruster.law is not None:
            self.losses.append(f"thruster {thruster.name}: Gazebo takes newtons, its curve is left out")
        d = force / size
        link, joint = f"{thruster.name}_link", f"{thruster.name}_joint"
        element = ET.SubElement(model, "link", {"name": link})
        angles = (0.0, -asin(max(-1.0, min(1.0, d[2]))), atan2(d[1], d[0]))
        leaves(element, {"pose": _pose(arm, angles)})
        inertial = ET.SubElement(element, "inertial")
        mass = self.settings.propeller_mass
        leaves(inertial, {"mass": mass})
        small = {f"i{a}{a}": mass * 1e-3 for a in "xyz"}
        leaves(ET.SubElement(inertial, "inertia"), small)
        hinge = ET.SubElement(model, "joint", {"name": joint, "type": "revolute"})
        leaves(hinge, {"parent": "base_link", "child": link})
        axis = ET.SubElement(hinge, "axis")
        leaves(axis, {"xyz": "1 0 0"})
        leaves(ET.SubElement(axis, "limit"), {"lower": -1e16, "upper": 1e16})
        _plugin(model, "thruster", "Thruster", self._limits(thruster, joint, size))

    def _limits(self, thruster: Thruster, joint: str, size: float) -> dict[str, object]:
        head: dict[str, object] = {"namespace": self.name, "joint_name": joint, "velocity_control": "true"}
        head |= {"fluid_density": self.vehicle.environment["rho"], "propeller_diameter": 0.1}
        head |= {"thrust_coefficient": 0.02}
        most = size * self.most_thrust(thruster)
        return head | ({"max_thrust_cmd": most, "min_thrust_cmd": -most} if isfinite(most) else {})

    # --- what is lost --------------------------------------------------------------------------
    def _what_is_left(self) -> Iterator[str]:
        """Lines on the effects that no part of the file stands for."""
        yield from self.free_motions()
        exported = {*_BODY, *STATICS, "thrusters", *(e.id for e in self.effects("damping"))}
        present = {e.id for e in self.vehicle.all_effects}
        if "added_mass" in present and "added_mass_coriolis" not in present:
            yield "added mass brings its Coriolis and Munk forces along in Gazebo; the model has none"
        for effect in self.not_exported(exported):
            hint = ": publish it on /ocean_current" if isinstance(effect, Flow) else ""
            yield f"{effect.id} is left out{hint}"


def _terms() -> list[tuple[tuple[str | int, ...], Callable[[Array], Array]]]:
    """Names and functions of all terms in velocities that the plugin has, and of |v|, which it has not."""
    one = {("linear", j): lambda v, j=j: v[:, j] for j in range(6)}
    size = {("magnitude", j): lambda v, j=j: np.abs(v[:, j]) for j in range(6)}
    drag = {
        ("absolute", j, k): lambda v, j=j, k=k: v[:, j] * np.abs(v[:, k])
        for j, k in product(range(6), repeat=2)
    }
    pairs = combinations_with_replacement(range(6), 2)
    lift = {("plain", j, k): lambda v, j=j, k=k: v[:, j] * v[:, k] for j, k in pairs}
    return [*one.items(), *size.items(), *drag.items(), *lift.items()]


# --- XML ------------------------------------------------------------------------------------------
def _pose(position: Array, angles: tuple[float, ...] = (0.0, 0.0, 0.0)) -> str:
    return numbers(*position, *angles)


def _plugin(parent: ET.Element, file: str, system: str, values: Mapping[str, object]) -> None:
    names = {"filename": f"gz-sim-{file}-system", "name": f"gz::sim::systems::{system}"}
    leaves(ET.SubElement(parent, "plugin", names), values)
