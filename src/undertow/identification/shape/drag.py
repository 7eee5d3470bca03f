"""Drag of a hull from its silhouettes and stated drag coefficients."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from undertow.errors import UndertowError
from undertow.typing import Array

from .mesh import Mesh
from .refining import bisected

_HOERNER = "Hoerner (1965), Fluid-Dynamic Drag, chapter 3"
# Friction coefficient of a turbulent boundary layer on a hull of this size; only turning hulls get it, the
# coefficients of silhouettes have it in them.
_FRICTION = 0.005
# Triangles are no longer than this part of the hull, so that the integrals over them are good to 1 %.
_STRIPS = 30
_BLUNT, _ROUND = 0.8, 0.4
_CLASSES = {
    "blunt": (1.05, 0.4, f"between a cube face on (1.05) and a long plate; {_HOERNER}"),
    "rounded": (0.8, 0.5, f"between a sphere (0.47) and a long circular cylinder (1.1 to 1.2); {_HOERNER}"),
    "streamlined": (
        0.2,
        0.75,
        "a slender body with the appendages that vehicles have; bare hulls are below 0.1",
    ),
}


@dataclass(frozen=True)
class Drag:
    """Quadratic drag of a hull about an origin.

    Attributes
    ----------
    coefficients : (6,) array
        Force per speed squared, kg/m, and moment per rate squared, kg m^2; positive.
    sigma : (6,) array
        How far to trust them.
    sources : tuple of str
        Where each is from.
    """

    coefficients: Array
    sigma: Array
    sources: tuple[str, ...]


def drag_of_hull(
    mesh: Mesh,
    density: float = 1000.0,
    origin: Sequence[float] = (0.0, 0.0, 0.0),
    cd: Sequence[float] | None = None,
) -> Drag:
    """Drag by silhouettes in translation, and by the speeds of all strips of the surface in rotation.

    Parameters
    ----------
    mesh : Mesh
        The hull.
    density : float
        Of the water, kg/m^3.
    origin : (3,) sequence of float
        What rotation is about, m.
    cd : (3,) sequence of float, optional
        Drag coefficients on the silhouettes seen along x, y and z; by the form of the hull if None.

    Raises
    ------
    UndertowError
        If a coefficient is negative.

    Notes
    -----
    Force: density/2 C_d times silhouette. Moment: every strip of surface gives half of that for its own
    normal velocity, so that a box gets what strip theory gives its sides, and a hull that turns about its
    axis of revolution gets friction only.
    """
    for value in cd or ():
        if not (value >= 0 and np.isfinite(value)):
            raise UndertowError(f"drag coefficient {value:g} cannot be: give a number from 0, such as 1.0")
    areas = np.array([mesh.projected_area(i) for i in range(3)])
    mesh = bisected(mesh, float(mesh.extents.max()) / _STRIPS)
    facing = np.abs(mesh.vector_areas) / mesh.areas[:, None]
    blunt = (mesh.areas @ facing**3) / 2 / areas
    chosen = [_coefficient(float(b), None if cd is None else float(cd[i])) for i, b in enumerate(blunt)]
    values, shares, sources = zip(*chosen, strict=True)
    forces = density / 2 * np.array(values) * areas
    moments = density / 2 * _moments(mesh, np.asarray(origin, dtype=float), np.array(values) / blunt, facing)
    turning = float(np.hypot(0.5, max(shares)))
    told = [f"C_d {v:g} on {a:.4g} m^2: {s}" for v, a, s in zip(values, areas, sources, strict=True)]
    about = "strips of the surface with the drag coefficients of x, y and z, and friction"
    return Drag(
        np.concatenate([forces, moments]),
        np.concatenate([forces * np.array(shares), moments * turning]),
        (*told, *[about] * 3),
    )


def _coefficient(bluntness: float, stated: float | None) -> tuple[float, float, str]:
    """Drag coefficient, its standard deviation as a share, and where it is from."""
    if stated is not None:
        return stated, 0.3, "coefficient as stated"
    form = "blunt" if bluntness >= _BLUNT else "rounded" if bluntness >= _ROUND else "streamlined"
    value, share, source = _CLASSES[form]
    return value, share, f"{form} this way (bluntness {bluntness:.2f}), {source}"


def _moments(mesh: Mesh, origin: Array, weights: Array, facing: Array) -> Array:
    """Integrals of the speeds cubed over the surface for a unit rate about x, y and z, m^5."""
    found = []
    places, areas = _points(mesh)
    normals = np.repeat(mesh.vector_areas / mesh.areas[:, None], 3, axis=0)
    pressure = np.repeat(facing**2 @ weights, 3)
    for axis in np.eye(3):
        speed = np.cross(axis, places - origin)
        normal = np.sum(speed * normals, axis=1)
        along = np.linalg.norm(speed - normal[:, None] * normals, axis=1)
        found.append(areas @ (pressure * np.abs(normal) ** 3 / 2 + _FRICTION * along**3))
    return np.array(found)


def _points(mesh: Mesh) -> tuple[Array, Array]:
    """Three points of each triangle, with a third of its area: exact for squares."""
    corners = mesh.corners
    places = corners / 2 + corners.sum(axis=1, keepdims=True) / 6
    return places.reshape(-1, 3), np.repeat(mesh.areas / 3, 3)
