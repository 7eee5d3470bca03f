"""Worlds for Gazebo (SDF): inertia, added mass, damping, buoyancy and thrusters of a vehicle."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement
from math import isfinite
from xml.etree import ElementTree as ET

import numpy as np

from undertow.model.effect import Flow
from undertow.model.vehicle import Thruster, Vehicle
from undertow.typing import Array
from undertow.version import __version__

from .body import FLIP, Body, Drag, angles_of, append_elements, fit, numbers

_FORCES, _VELOCITIES = "xyzkmn", "UVWPQR"
_SYSTEMS = {"physics": "Physics", "user-commands": "UserCommands", "scene-broadcaster": "SceneBroadcaster"}


@dataclass(frozen=True)
class SdfSettings:
    """Numbers of the export."""

    # mass of the link of a propeller, kg: Gazebo moves no link without one, and it adds to the vehicle
    propeller_mass: float = 0.001
    step: float = 0.002  # time step of the world, s


SETTINGS = SdfSettings()


class Sdf(Body):
    """A vehicle as a world for `gz sim`, east-north-up and forward-left-up.

    Gazebo Sim, systems Hydrodynamics, Buoyancy and Thruster, https://gazebosim.org/api/sim; SDFormat 1.10,
    ``fluid_added_mass``, http://sdformat.org/spec.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle, "Gazebo")
        self._root = self._world()
        self.losses += self._left_out_lines()

    @cached_property
    def drag(self) -> dict[str, float]:
        """Name and value of every term of damping and lift of the plugin, forward-left-up, SNAME signs.

        What the plugin cannot say is added to the losses.
        """
        found = sum(fit(self).values(), Drag())
        t = FLIP
        tables = (
            ("{}{}", found.linear * np.einsum("i,j->ij", t, t)),
            ("{}{}abs{}", found.absolute * np.einsum("i,j->ij", t, t)[..., None]),
            ("{}{}{}", found.plain * np.einsum("i,j,k->ijk", t, t, t)),
        )
        return {
            form.format(_FORCES[place[0]], *(_VELOCITIES[k] for k in place[1:])): float(table[place])
            for form, table in tables
            for place in map(tuple, np.argwhere(table).tolist())
        }

    # --- the file -----------------------------------------------------------------------------
    def _world(self) -> ET.Element:
        root = ET.Element("sdf", {"version": "1.10"})
        root.append(ET.Comment(f" '{self.name}' by undertow {__version__}: ENU, forward-left-up "))
        world = ET.SubElement(root, "world", {"name": "water"})
        physics = ET.SubElement(world, "physics", {"name": "steps", "type": "ode"})
        append_elements(physics, {"max_step_size": SETTINGS.step, "real_time_factor": 1})
        append_elements(world, {"gravity": f"0 0 {-self.vehicle.environment['g']!r}"})
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
        return {**head, "disable_added_mass": "true", "disable_coriolis": "true", **self.drag}

    def _base(self, model: ET.Element) -> None:
        link = ET.SubElement(model, "link", {"name": "base_link"})
        inertial = ET.SubElement(link, "inertial")
        append_elements(
            inertial, {"pose": _pose(FLIP[:3] * self.centre_of_gravity), "mass": self.values["m"]}
        )
        turned = self.inertia * np.outer(FLIP[:3], FLIP[:3])
        names = {
            f"i{'xyz'[i]}{'xyz'[j]}": turned[i, j] for i, j in combinations_with_replacement(range(3), 2)
        }
        append_elements(ET.SubElement(inertial, "inertia"), names)
        self._added(inertial)
        self._volume(link)

    def _added(self, inertial: ET.Element) -> None:
        """`fluid_added_mass`, positive and symmetric, about the origin of the link."""
        turned = self.added_mass * np.outer(FLIP, FLIP)
        if not turned.any():
            return
        letters = "xyzpqr"
        pairs = combinations_with_replacement(range(6), 2)
        append_elements(
            ET.SubElement(inertial, "fluid_added_mass"),
            {f"{letters[i]}{letters[j]}": turned[i, j] for i, j in pairs},
        )

    def _volume(self, link: ET.Element) -> None:
        """A cube that displaces as much water as the model's buoyancy says."""
        if self.buoyancy is None:
            append_elements(link, {"gravity": "false"})
            self.losses.append("the model has no weight and buoyancy: gravity is off for it")
            return
        lift, centre = self.buoyancy
        edge = self.cube_edge(lift)
        for kind in ("collision", "visual"):
            element = ET.SubElement(link, kind, {"name": kind})
            append_elements(element, {"pose": _pose(FLIP[:3] * centre)})
            box = ET.SubElement(ET.SubElement(element, "geometry"), "box")
            append_elements(box, {"size": " ".join([repr(float(edge))] * 3)})

    def _thruster(self, model: ET.Element, thruster: Thruster) -> None:
        line = self.line_of_thrust(thruster)
        if line is None:
            return
        size, direction, point = line
        link, joint = f"{thruster.name}_link", f"{thruster.name}_joint"
        element = ET.SubElement(model, "link", {"name": link})
        append_elements(element, {"pose": _pose(FLIP[:3] * point, angles_of(FLIP[:3] * direction))})
        inertial = ET.SubElement(element, "inertial")
        mass = SETTINGS.propeller_mass
        append_elements(inertial, {"mass": mass})
        small = {f"i{a}{a}": mass * 1e-3 for a in "xyz"}
        append_elements(ET.SubElement(inertial, "inertia"), small)
        hinge = ET.SubElement(model, "joint", {"name": joint, "type": "revolute"})
        append_elements(hinge, {"parent": "base_link", "child": link})
        axis = ET.SubElement(hinge, "axis")
        append_elements(axis, {"xyz": "1 0 0"})
        append_elements(ET.SubElement(axis, "limit"), {"lower": -1e16, "upper": 1e16})
        _plugin(model, "thruster", "Thruster", self._limits(thruster, joint, size))

    def _limits(self, thruster: Thruster, joint: str, size: float) -> dict[str, object]:
        head: dict[str, object] = {"namespace": self.name, "joint_name": joint, "velocity_control": "true"}
        head |= {"fluid_density": self.vehicle.environment["rho"], "propeller_diameter": 0.1}
        head |= {"thrust_coefficient": 0.02}
        most = size * self.max_thrust(thruster)
        return head | ({"max_thrust_cmd": most, "min_thrust_cmd": -most} if isfinite(most) else {})

    # --- what is lost --------------------------------------------------------------------------
    def _left_out_lines(self) -> Iterator[str]:
        """Lines on the effects that no part of the file stands for."""
        yield from self.free_motions()
        yield from self.added_coriolis()
        yield from self.left_out(
            hint=lambda effect: ": publish it on /ocean_current" if isinstance(effect, Flow) else ""
        )


# --- XML ------------------------------------------------------------------------------------------
def _pose(position: Array, angles: tuple[float, ...] = (0.0, 0.0, 0.0)) -> str:
    return numbers(*position, *angles)


def _plugin(parent: ET.Element, file: str, system: str, values: Mapping[str, object]) -> None:
    names = {"filename": f"gz-sim-{file}-system", "name": f"gz::sim::systems::{system}"}
    append_elements(ET.SubElement(parent, "plugin", names), values)
