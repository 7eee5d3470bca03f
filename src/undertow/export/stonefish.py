"""Scenarios for Stonefish: rigid body, weight, buoyancy and thrusters; drag along the axes, no added mass."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import asin, atan2

import numpy as np

from undertow.model.effect import Flow
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .body import Body, fit, on_the_diagonal


@dataclass(frozen=True)
class StonefishSettings:
    """Numbers of the export."""

    gravity: float = 9.81  # of Stonefish, whose scenarios state none, m/s^2
    depth: float = 2.0  # of the origin at the start, edges of the cube that displaces the water
    gray: float = 0.5  # of the cube
    roughness: float = 0.5  # of the cube


SETTINGS = StonefishSettings()


class Stonefish(Body):
    """A vehicle as a scenario for Stonefish, NED and forward-starboard-down.

    Stonefish documentation, dynamic bodies and actuators, https://stonefish.readthedocs.io; what its drag is
    per face of a body stands in `SolidEntity.cpp` (1.4 and later).
    """

    template = "stonefish.xml"

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle, "Stonefish", SETTINGS.gravity)
        lift, centre = self.buoyancy or (self.values["m"] * self.gravity, self.centre_of_gravity)
        self._edge = self.cube_edge(lift)
        moments, angles = _principal(self.inertia)
        # A cube that displaces as much water as the model's buoyancy says, with the body's own inertia.
        self.text = self.filled(
            settings=SETTINGS,
            edge=self._edge,
            centre=centre,
            moments=moments,
            angles=angles,
            gravity=self.centre_of_gravity,
            drag=self._drag(),
            pushes=list(self.pushes()),
        )
        self.losses += self._left_out_lines()

    def _drag(self) -> Array:
        """Coefficients of viscous and quadratic drag that brake the cube along each axis, shape (2, 3).

        Along an axis four faces give rho C_f A v, and one gives 1/2 rho C_d A v^2 times the speed in m/s.
        """
        drags = fit(self)
        area = self.vehicle.environment["rho"] * self._edge**2
        found = -on_the_diagonal(self, drags, 3) / (area * np.array([[4.0], [0.5]]))
        if (found < 0).any():
            self.losses.append("damping that drives the motion is left out")
        if found[1].any():
            self.losses.append(
                "quadratic drag grows with the third power of the speed in Stonefish: right at 1 m/s"
            )
        return np.maximum(found, 0.0)

    # --- what is lost --------------------------------------------------------------------------
    def _left_out_lines(self) -> Iterator[str]:
        """Lines on the effects that no part of the file stands for."""
        yield from self.free_motions()
        if self.effects("damping"):
            yield "drag acts at the centre of buoyancy, and that of rotation and oblique motion is the cube's"
        if "added_mass" in {e.id for e in self.vehicle.all_effects}:
            yield "added mass is left out: Stonefish knows one mean of what it estimates from a shape"
        yield from self.left_out(
            hint=lambda effect: ": give <ocean> a <current>" if isinstance(effect, Flow) else ""
        )


def _principal(inertia: Array) -> tuple[Array, tuple[float, float, float]]:
    """Principal moments, and roll, pitch and yaw of their axes; those of the body where they are such."""
    if not np.count_nonzero(inertia - np.diag(np.diag(inertia))):
        return np.diag(inertia), (0.0, 0.0, 0.0)
    moments, axes = np.linalg.eigh(inertia)
    axes[:, 0] *= np.linalg.det(axes)  # right-handed
    pitch = -asin(max(-1.0, min(1.0, axes[2, 0])))
    return moments, (atan2(axes[2, 1], axes[2, 2]), pitch, atan2(axes[1, 0], axes[0, 0]))
