"""Models for MuJoCo (MJCF): rigid body, weight, buoyancy and thrusters, without the fluid forces."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import isfinite
from xml.etree import ElementTree as ET

import numpy as np

from undertow.model.vehicle import Thruster, Vehicle
from undertow.typing import Array
from undertow.version import __version__

from .body import FLIP, RIGID, STATICS, Body, numbers, point_of_action, steiner

_EXPORTED = (*RIGID, *STATICS, "thrusters")
# Motions that a coordinate in the world's axes stands for only if these are there, too.
_NEEDS = {"yaw": {"surge", "sway"}, "pitch": {"surge", "heave"}, "roll": {"sway", "heave"}}
_AXES = {
    "surge": "1 0 0",
    "sway": "0 1 0",
    "heave": "0 0 1",
    "yaw": "0 0 1",
    "pitch": "0 1 0",
    "roll": "1 0 0",
}


@dataclass(frozen=True)
class MjcfSettings:
    """Numbers of the export."""

    # Part of the mass that stands at the centre of buoyancy: MuJoCo lifts a body at its centre of mass. It is
    # taken from the rest, so that the sum stays; small, so that what is left is a body.
    float_share: float = 1e-6
    float_radius: float = 0.01  # radius of gyration of that part, m: MuJoCo takes no point for a body
    step: float = 0.002  # time step, s


SETTINGS = MjcfSettings()


class Mjcf(Body):
    """A vehicle as a model for MuJoCo, east-north-up and forward-left-up.

    MuJoCo documentation, XML reference (``body/gravcomp``, ``body/inertial``, ``actuator/motor``),
    https://mujoco.readthedocs.io/en/stable/XMLreference.html
    """

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle, "MuJoCo")
        self._root = self._model()
        self.losses += self._left_out_lines()

    def _model(self) -> ET.Element:
        root = ET.Element("mujoco", {"model": self.name})
        root.append(ET.Comment(f" by undertow {__version__}: ENU, forward-left-up, SI; ctrl is thrust in N "))
        # RK4, because nothing damps the motion and Euler's method adds energy to it.
        step = {"timestep": repr(SETTINGS.step), "integrator": "RK4"}
        gravity = numbers(0, 0, -self.vehicle.environment["g"])
        ET.SubElement(root, "option", {**step, "gravity": gravity})
        world = ET.SubElement(root, "worldbody")
        ET.SubElement(world, "light", {"pos": "0 0 5"})
        self._body(world)
        actuators = ET.SubElement(root, "actuator")
        for thruster in self.vehicle.thrusters:
            self._motor(actuators, thruster)
        return root

    # --- the body -----------------------------------------------------------------------------
    def _body(self, world: ET.Element) -> None:
        body = ET.SubElement(world, "body", {"name": self.name})
        self._joints(body)
        mass, centre, about = self.values["m"], self.centre_of_gravity, self.inertia
        if self.buoyancy is None:
            body.set("gravcomp", "1")
            self.losses.append("the model has no weight and buoyancy: gravity is off for it")
        else:
            mass, centre, about = self._with_float(body, *self.buoyancy)
        body.insert(0, _inertial(mass, centre, about))
        for thruster in self.vehicle.thrusters:
            position = FLIP[:3] * point_of_action(*_force_and_moment(thruster))
            ET.SubElement(body, "site", {"name": thruster.name, "pos": numbers(*position)})

    def _joints(self, body: ET.Element) -> None:
        """Six degrees of freedom, or those of the model where coordinates of the world can be them."""
        dofs = self.vehicle.degrees_of_freedom
        if len(dofs) == 6 or any(not need <= {*dofs} for turn, need in _NEEDS.items() if turn in dofs):
            ET.SubElement(body, "freejoint", {"name": "free"})
            self.losses += self.free_motions()
            return
        for name in (d for d in _AXES if d in dofs):  # yaw before pitch before roll
            kind = "hinge" if name in _NEEDS else "slide"
            ET.SubElement(body, "joint", {"name": name, "type": kind, "axis": _AXES[name]})

    def _with_float(self, body: ET.Element, lift: float, at: Array) -> tuple[float, Array, Array]:
        """Append what lifts at the centre of buoyancy; mass, centre and inertia of the rest."""
        m, r, g = self.values["m"], self.centre_of_gravity, self.vehicle.environment["g"]
        small = SETTINGS.float_share * m
        own = small * SETTINGS.float_radius**2 * np.eye(3)
        rest, centre = m - small, (m * r - small * at) / (m - small)
        about_origin = self.inertia + m * steiner(r) - own - small * steiner(at)
        element = ET.SubElement(body, "body", {"name": "float", "gravcomp": repr(lift / (small * g))})
        element.append(_inertial(small, at, own))
        half = numbers(*[self.cube_edge(lift) / 2] * 3)
        shape = {"type": "box", "size": half, "pos": numbers(*FLIP[:3] * at), "mass": "0"}
        ET.SubElement(element, "geom", shape)
        return rest, centre, about_origin - rest * steiner(centre)

    # --- thrusters ------------------------------------------------------------------------------
    def _motor(self, actuators: ET.Element, thruster: Thruster) -> None:
        """A motor that gives the wrench of one newton of thrust at its site."""
        force, moment = _force_and_moment(thruster)
        twist = moment - np.cross(point_of_action(force, moment), force)
        gear = numbers(*FLIP * np.concatenate([force, twist]))
        motor = ET.SubElement(
            actuators, "motor", {"name": thruster.name, "site": thruster.name, "gear": gear}
        )
        if thruster.law is not None:
            self.losses.append(f"thruster {thruster.name}: ctrl is thrust in newtons, its curve is left out")
        if isfinite(most := self.max_thrust(thruster)):
            motor.set("ctrlrange", numbers(-most, most))

    # --- what is lost --------------------------------------------------------------------------
    def _left_out_lines(self) -> Iterator[str]:
        """Lines on the effects that no part of the file stands for."""
        hint = ", which MuJoCo has for ellipsoids only"
        yield from self.left_out(_EXPORTED, lambda effect: hint if effect.id == "added_mass" else "")
        if self.effects("damping"):
            yield "nothing damps the motion: add these forces to qfrc_applied or xfrc_applied"


def _force_and_moment(thruster: Thruster) -> tuple[Array, Array]:
    """Wrench of one newton of thrust, body frame of undertow: force, and moment in m."""
    wrench = np.array(thruster.wrench, dtype=float)
    return wrench[:3], wrench[3:]


def _inertial(mass: float, centre: Array, about: Array) -> ET.Element:
    """Mass, centre of gravity and inertia about it, given in the body frame of undertow."""
    turned = about * np.outer(FLIP[:3], FLIP[:3])
    full = numbers(*np.diag(turned), turned[0, 1], turned[0, 2], turned[1, 2])
    position = numbers(*FLIP[:3] * centre)
    return ET.Element("inertial", {"pos": position, "mass": repr(float(mass)), "fullinertia": full})
