"""Hulls made of triangles, of which volume and added mass are known otherwise, and STL files of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from undertow.shape.mesh import Mesh, subdivided

SIDES = (0.60, 0.42, 0.24)
_BOX = [
    *([0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]),
    *([2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]),
]


def box_mesh(sides: tuple[float, float, float] = SIDES) -> Mesh:
    """Twelve triangles about the origin."""
    corners = [[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    return Mesh(np.array(corners) * np.array(sides) / 2, np.array(_BOX))


def ball(times: int) -> Mesh:
    """A sphere of radius one: an octahedron subdivided, 8 * 4^times triangles with their corners on it."""
    points = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float)
    faces = [[x, y, z] if (x + y + z) % 2 == 0 else [x, z, y] for x in (0, 1) for y in (2, 3) for z in (4, 5)]
    mesh = Mesh(points, np.array(faces))
    for _ in range(times):
        finer = subdivided(mesh)
        mesh = Mesh(finer.vertices / np.linalg.norm(finer.vertices, axis=1, keepdims=True), finer.faces)
    return mesh


def spheroid_mesh(length: float, diameter: float, times: int) -> Mesh:
    """A spheroid about x."""
    unit = ball(times)
    return Mesh(unit.vertices * np.array([length, diameter, diameter]) / 2, unit.faces)


def revolved(profile: Sequence[tuple[float, float]], around: int = 24) -> Mesh:
    """A body of revolution about x from places and radii, in between cones, with tips at both ends.

    Parameters
    ----------
    profile : sequence of (x, radius)
        From stern to bow, the first and the last radius zero.
    around : int
        Sides of the sections.
    """
    angles = 2 * np.pi * np.arange(around) / around
    rings = [[(x, r * np.cos(a), r * np.sin(a)) for a in angles] for x, r in profile[1:-1]]
    tips = [(profile[0][0], 0.0, 0.0), (profile[-1][0], 0.0, 0.0)]
    points = np.array([p for ring in rings for p in ring] + tips)
    stern, bow = len(points) - 2, len(points) - 1
    faces = []
    for i in range(around):
        j = (i + 1) % around
        faces.append([stern, j, i])
        for k in range(len(rings) - 1):
            a, b, c, d = (k * around + i, k * around + j, (k + 1) * around + j, (k + 1) * around + i)
            faces += [[a, b, c], [a, c, d]]
        last = (len(rings) - 1) * around
        faces.append([bow, last + i, last + j])
    return Mesh(points, np.array(faces))


def cylinder_mesh(length: float, diameter: float, around: int = 24) -> Mesh:
    """A circular cylinder about x with flat ends."""
    x, r = length / 2, diameter / 2
    return revolved([(-x, 0.0), (-x, r), (x, r), (x, 0.0)], around)


def torpedo_mesh(length: float, diameter: float, around: int = 24) -> Mesh:
    """A cylinder about x with half-spheres at its ends."""
    r, angles = diameter / 2, np.linspace(0, np.pi / 2, 7)
    stern = [(-(length / 2 - r) - r * np.cos(a), r * np.sin(a)) for a in angles]
    return revolved([*stern, *((-x, y) for x, y in reversed(stern))], around)


def stl(mesh: Mesh, path: Path, scale: float = 1.0) -> Path:
    """Write a binary STL."""
    facets = np.zeros(len(mesh.faces), dtype=[("floats", "<f4", 12), ("attribute", "<u2")])
    facets["floats"][:, 3:] = (mesh.corners * scale).reshape(-1, 9)
    path.write_bytes(bytes(80) + len(facets).to_bytes(4, "little") + facets.tobytes())
    return path
