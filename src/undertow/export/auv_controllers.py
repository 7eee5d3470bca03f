"""Descriptions for the ROS 2 package auv_controllers: the equations of motion that its controllers invert."""

from __future__ import annotations

from collections.abc import Iterator
from xml.etree import ElementTree as ET

import numpy as np

from undertow.model.vehicle import Vehicle

from .body import Body, attributes, fit, on_the_diagonal, steiner

# What its parser takes for gravity, m/s^2: the weight is the mass times it.
_GRAVITY = 9.81
_ADDED = ("Xdu", "Ydv", "Zdw", "Kdp", "Mdq", "Ndr")
_LINEAR = ("Xu", "Yv", "Zw", "Kp", "Mq", "Nr")
_QUADRATIC = ("Xuu", "Yvv", "Zww", "Kpp", "Mqq", "Nrr")


class AuvControllers(Body):
    """A vehicle as the element `hydrodynamics` of a robot's description, forward-starboard-down, SNAME signs.

    Robotic Decision Making Laboratory, hydrodynamics (the parser and the equations of auv_controllers),
    https://github.com/Robotic-Decision-Making-Lab/hydrodynamics
    """

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle, "auv_controllers", _GRAVITY)
        self._root = ET.Element("robot", {"name": self.name})
        hydrodynamics = ET.SubElement(self._root, "hydrodynamics")
        self._inertial(hydrodynamics)
        self._damping(hydrodynamics)
        self._hydrostatics(hydrodynamics)
        self.losses += self._left_out_lines()

    def _inertial(self, parent: ET.Element) -> None:
        """Mass, inertia about the origin and added mass, of which the parser takes the diagonals."""
        inertial = ET.SubElement(parent, "inertial")
        added, m = self.added_mass, self.values["m"]
        about = self.inertia + m * steiner(self.centre_of_gravity)
        attributes(inertial, "mass", ("value",), [m])
        attributes(inertial, "inertia", ("ixx", "iyy", "izz"), np.diag(about))
        attributes(inertial, "center_of_gravity", "xyz", self.centre_of_gravity)
        attributes(inertial, "added_mass", _ADDED, -np.diag(added))
        if np.count_nonzero(about - np.diag(np.diag(about))):
            self.losses.append(
                "I_xy, I_xz, I_yz are left out: the parser takes them for one of two axes only"
            )
        if np.count_nonzero(added - np.diag(np.diag(added))):
            self.losses.append("added mass off the diagonal is left out")

    def _damping(self, parent: ET.Element) -> None:
        damping = ET.SubElement(parent, "damping")
        linear, quadratic = on_the_diagonal(self, fit(self), 6)
        attributes(damping, "linear", _LINEAR, linear)
        attributes(damping, "quadratic", _QUADRATIC, quadratic)

    def _hydrostatics(self, parent: ET.Element) -> None:
        hydrostatics = ET.SubElement(parent, "hydrostatics")
        lift, centre = self.buoyancy or (self.values["m"] * self.gravity, self.centre_of_gravity)
        attributes(hydrostatics, "buoyancy", ("value",), [lift])
        attributes(hydrostatics, "center_of_buoyancy", "xyz", centre)

    def _left_out_lines(self) -> Iterator[str]:
        """Lines on the effects that no part of the file stands for."""
        present = {e.id for e in self.vehicle.all_effects}
        if "rigid_body" in present and "rigid_body_coriolis" not in present:
            yield "the rigid body brings its Coriolis forces along in auv_controllers; the model has none"
        yield from self.added_coriolis()
        if self.vehicle.thrusters:
            yield "thrusters are left out: the matrix of thruster_allocation_matrix_controller is YAML"
        yield from self.left_out()
