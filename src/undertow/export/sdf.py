"""Worlds for Gazebo (SDF): inertia, added mass, damping, buoyancy and thrusters of a vehicle."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement

import numpy as np

from undertow.model.effect import Flow
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .body import FLIP, Body, Drag, fit

_FORCES, _VELOCITIES = "xyzkmn", "UVWPQR"


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

    template = "sdf.xml"

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle, "Gazebo")
        self.text = self.filled(
            settings=SETTINGS,
            gravity_centre=FLIP[:3] * self.centre_of_gravity,
            inertia=_upper(self.inertia, "xyz", "i"),
            # positive and symmetric, about the origin of the link
            added_mass=_upper(self.added_mass, "xyzpqr") if self.added_mass.any() else {},
            cube=self._cube(),
            drag=self.drag,
            pushes=[
                push._replace(point=FLIP[:3] * push.point, direction=FLIP[:3] * push.direction)
                for push in self.pushes()
            ],
        )
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

    def _cube(self) -> dict[str, object] | None:
        """A cube that displaces as much water as the model's buoyancy says."""
        if self.buoyancy is None:
            self.losses.append("the model has no weight and buoyancy: gravity is off for it")
            return None
        lift, centre = self.buoyancy
        return {"edge": self.cube_edge(lift), "centre": FLIP[:3] * centre}

    # --- what is lost --------------------------------------------------------------------------
    def _left_out_lines(self) -> Iterator[str]:
        """Lines on the effects that no part of the file stands for."""
        yield from self.free_motions()
        yield from self.added_coriolis()
        yield from self.left_out(
            hint=lambda effect: ": publish it on /ocean_current" if isinstance(effect, Flow) else ""
        )


def _upper(matrix: Array, axes: str, before: str = "") -> dict[str, float]:
    """Upper triangle of a symmetric matrix, forward-left-up, by names of the axes."""
    turned = matrix * np.outer(FLIP[: len(axes)], FLIP[: len(axes)])
    pairs = combinations_with_replacement(range(len(axes)), 2)
    return {f"{before}{axes[i]}{axes[j]}": turned[i, j] for i, j in pairs}
