"""Models for MuJoCo (MJCF): rigid body, weight, buoyancy and thrusters, without the fluid forces."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import isfinite

import numpy as np

from undertow.model.vehicle import Thruster, Vehicle
from undertow.typing import Array

from .body import FLIP, RIGID, STATICS, Body, force_and_moment, numbers, point_of_action, steiner

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

    template = "mjcf.xml"

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle, "MuJoCo")
        self.text = self.filled(
            step=SETTINGS.step,
            joints=self._joints(),
            **self._masses(),
            thrusters=[self._thruster(t) for t in self.vehicle.thrusters],
        )
        self.losses += self._left_out_lines()

    # --- the body -----------------------------------------------------------------------------
    def _joints(self) -> list[dict[str, str]]:
        """Degrees of freedom of the model where coordinates of the world can be them; else a free joint."""
        dofs = self.vehicle.degrees_of_freedom
        if len(dofs) == 6 or any(not need <= {*dofs} for turn, need in _NEEDS.items() if turn in dofs):
            self.losses += self.free_motions()
            return []
        return [
            {"name": name, "type": "hinge" if name in _NEEDS else "slide", "axis": axis}
            for name, axis in _AXES.items()  # yaw before pitch before roll
            if name in dofs
        ]

    def _masses(self) -> dict[str, object]:
        """The body, and what lifts at the centre of buoyancy, if the model has weight and buoyancy."""
        m, r, about = self.values["m"], self.centre_of_gravity, self.inertia
        if self.buoyancy is None:
            self.losses.append("the model has no weight and buoyancy: gravity is off for it")
            return {"inertial": _inertial(m, r, about), "lift": None}
        lift, at = self.buoyancy
        small = SETTINGS.float_share * m
        own = small * SETTINGS.float_radius**2 * np.eye(3)
        rest, centre = m - small, (m * r - small * at) / (m - small)
        about_origin = about + m * steiner(r) - own - small * steiner(at)
        floating = {
            "share": lift / (small * self.vehicle.environment["g"]),
            "inertial": _inertial(small, at, own),
            "size": numbers(*[self.cube_edge(lift) / 2] * 3),
        }
        return {"inertial": _inertial(rest, centre, about_origin - rest * steiner(centre)), "lift": floating}

    # --- thrusters ------------------------------------------------------------------------------
    def _thruster(self, thruster: Thruster) -> dict[str, object]:
        """A site, and a motor that gives the wrench of one newton of thrust there."""
        force, moment = force_and_moment(thruster)
        point = point_of_action(force, moment)
        drive = {"gear": numbers(*FLIP * np.concatenate([force, moment - np.cross(point, force)]))}
        if thruster.law is not None:
            self.losses.append(f"thruster {thruster.name}: ctrl is thrust in newtons, its curve is left out")
        if isfinite(most := self.max_thrust(thruster)):
            drive["ctrlrange"] = numbers(-most, most)
        return {"name": thruster.name, "pos": numbers(*FLIP[:3] * point), "drive": drive}

    # --- what is lost --------------------------------------------------------------------------
    def _left_out_lines(self) -> Iterator[str]:
        """Lines on the effects that no part of the file stands for."""
        hint = ", which MuJoCo has for ellipsoids only"
        yield from self.left_out(_EXPORTED, lambda effect: hint if effect.id == "added_mass" else "")
        if self.effects("damping"):
            yield "nothing damps the motion: add these forces to qfrc_applied or xfrc_applied"


def _inertial(mass: float, centre: Array, about: Array) -> dict[str, str]:
    """Mass, centre of gravity and inertia about it, given in the body frame of undertow."""
    turned = about * np.outer(FLIP[:3], FLIP[:3])
    full = numbers(*np.diag(turned), turned[0, 1], turned[0, 2], turned[1, 2])
    return {"pos": numbers(*FLIP[:3] * centre), "mass": repr(float(mass)), "fullinertia": full}
