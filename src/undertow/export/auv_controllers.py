"""Descriptions for the ROS 2 package auv_controllers: the equations of motion that its controllers invert."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from undertow.model.vehicle import Vehicle

from .body import Body, fit, numbers, on_the_diagonal, steiner

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

    template = "auv_controllers.xml"

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle, "auv_controllers", _GRAVITY)
        self.text = self.filled(**self._inertial(), **self._damping(), **self._hydrostatics())
        self.losses += self._left_out_lines()

    def _inertial(self) -> dict[str, object]:
        """Mass, inertia about the origin and added mass, of which the parser takes the diagonals."""
        added, m = self.added_mass, self.values["m"]
        about = self.inertia + m * steiner(self.centre_of_gravity)
        if np.count_nonzero(about - np.diag(np.diag(about))):
            self.losses.append(
                "I_xy, I_xz, I_yz are left out: the parser takes them for one of two axes only"
            )
        if np.count_nonzero(added - np.diag(np.diag(added))):
            self.losses.append("added mass off the diagonal is left out")
        return {
            "inertia": _named(("ixx", "iyy", "izz"), np.diag(about)),
            "gravity": _named("xyz", self.centre_of_gravity),
            "added": _named(_ADDED, -np.diag(added)),
        }

    def _damping(self) -> dict[str, object]:
        linear, quadratic = on_the_diagonal(self, fit(self), 6)
        return {"linear": _named(_LINEAR, linear), "quadratic": _named(_QUADRATIC, quadratic)}

    def _hydrostatics(self) -> dict[str, object]:
        lift, centre = self.buoyancy or (self.values["m"] * self.gravity, self.centre_of_gravity)
        return {"lift": lift, "buoyancy": _named("xyz", centre)}

    def _left_out_lines(self) -> Iterator[str]:
        """Lines on the effects that no part of the file stands for."""
        present = {e.id for e in self.vehicle.all_effects}
        if "rigid_body" in present and "rigid_body_coriolis" not in present:
            yield "the rigid body brings its Coriolis forces along in auv_controllers; the model has none"
        yield from self.added_coriolis()
        if self.vehicle.thrusters:
            yield "thrusters are left out: the matrix of thruster_allocation_matrix_controller is YAML"
        yield from self.left_out()


def _named(names: Iterable[str], values: Iterable[float]) -> dict[str, str]:
    return dict(zip(names, map(numbers, values), strict=True))
