"""The smooth surface that coarse triangles stand for, and points on it."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from undertow.errors import UndertowError
from undertow.typing import Array

from .mesh import Faces, Mesh
from .refining import base_mesh, bisected, each_edge, quartered, subdivided

#: Angle in degrees below which the bend at an edge is taken for a coarsely drawn curve.
CREASE = 30.0
_FINE_ENOUGH = 8000
_CANDIDATES = 12
# Share of the volume that panels may miss.
_MISSED = 0.05


def panels(mesh: Mesh, finest: int, crease: float = CREASE) -> tuple[Mesh, Mesh, Mesh]:
    """A hull in triangles of three sizes, each half of the one before.

    Parameters
    ----------
    mesh : Mesh
        The hull as it was drawn.
    finest : int
        Most triangles of the finest.
    crease : float
        Degrees. Edges at which the surface bends by less are taken for a curve, drawn coarsely.

    Raises
    ------
    UndertowError
        If the hull has too many triangles and cannot be simplified, or so few panels miss its shape.
    """
    coarse = base_mesh(mesh, finest // 16)
    smooth = mesh
    while len(smooth.faces) < _FINE_ENOUGH and _bends(smooth, crease):
        smooth = curved(smooth, crease)
    onto = _Surface(bisected(smooth, float(np.sqrt(coarse.areas.mean()))))
    first = Mesh(onto.nearest(coarse.vertices), coarse.faces)
    second = _finer(first, onto)
    third = _finer(second, onto)
    _check_shape(third, smooth)
    return first, second, third


def _check_shape(panelled: Mesh, smooth: Mesh) -> None:
    missed = abs(panelled.volume / smooth.volume - 1)
    if missed > _MISSED:
        raise UndertowError(
            f"{len(panelled.faces)} panels miss the volume of the hull by {missed:.1%} "
            f"(limit {_MISSED:.0%}): choose more panels"
        )


def _finer(mesh: Mesh, onto: _Surface) -> Mesh:
    flat = subdivided(mesh)
    return Mesh(onto.nearest(flat.vertices), flat.faces)


class _Surface:
    """Finds points on a surface whose triangles are of similar size."""

    def __init__(self, mesh: Mesh) -> None:
        self._corners = mesh.corners
        self._tree = KDTree(mesh.corners.mean(axis=1))

    def nearest(self, points: Array) -> Array:
        """The nearest point of the surface for each point, m, shape (n, 3)."""
        count = min(_CANDIDATES, len(self._corners))
        _, which = self._tree.query(points, k=count)
        found = _on_triangles(points[:, None], self._corners[which.reshape(len(points), count)])
        best = np.argmin(np.sum((found - points[:, None]) ** 2, axis=2), axis=1)
        return np.asarray(found[np.arange(len(points)), best])


def _on_triangles(points: Array, corners: Array) -> Array:
    """Nearest points of triangles (..., 3 corners, 3) to points (..., 3)."""
    a, b, c = (corners[..., i, :] for i in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-300)
    flat = points - np.sum((points - a) * normal, axis=-1, keepdims=True) * normal
    inside = np.stack(
        [np.sum(np.cross(q - p, flat - p) * normal, axis=-1) >= 0 for p, q in ((a, b), (b, c), (c, a))]
    )
    ends = np.stack([_on_edge(points, p, q) for p, q in ((a, b), (b, c), (c, a))])
    nearest = np.argmin(np.sum((ends - points) ** 2, axis=-1), axis=0)
    edge = np.take_along_axis(ends, nearest[None, ..., None], axis=0)[0]
    return np.where(np.all(inside, axis=0)[..., None], flat, edge)


def _on_edge(points: Array, a: Array, b: Array) -> Array:
    along = b - a
    share = np.sum((points - a) * along, axis=-1) / np.maximum(np.sum(along**2, axis=-1), 1e-300)
    return np.asarray(a + np.clip(share, 0.0, 1.0)[..., None] * along)


def _bends(mesh: Mesh, crease: float) -> bool:
    edges, of_face = each_edge(mesh)
    bulge = _bulge(mesh, edges, of_face, np.diff(mesh.vertices[edges], axis=1)[:, 0], _cosine(crease))
    return bool(np.abs(bulge).max() > 1e-9 * mesh.extents.max())


def _cosine(degrees: float) -> float:
    return float(np.cos(np.radians(degrees)))


def curved(mesh: Mesh, crease: float = CREASE) -> Mesh:
    """Four triangles for each; new vertices lie on the curve that the normals at both ends of an edge tell.

    Parameters
    ----------
    mesh : Mesh
        The coarser mesh.
    crease : float
        Degrees. An edge at which the surface bends by more, or not at all, stays straight.

    Notes
    -----
    The middle of an edge from a to b with normals n_a and n_b is that of the cubic of a PN triangle
    (Vlachos, Peters, Boyd and Mitchell 2001, Curved PN triangles).
    """
    edges, of_face = each_edge(mesh)
    a, b = mesh.vertices[edges[:, 0]], mesh.vertices[edges[:, 1]]
    middles = (a + b) / 2 + _bulge(mesh, edges, of_face, b - a, _cosine(crease))
    return quartered(mesh, of_face, middles)


def _bulge(mesh: Mesh, edges: Faces, of_face: Faces, along: Array, least_cosine: float) -> Array:
    """How far the middles of the edges lie off the chord, m."""
    flat = mesh.vector_areas / mesh.areas[:, None]
    smooth = _corner_normals(mesh, flat, least_cosine)
    total = np.zeros((len(edges), 2, 3))
    sides = np.zeros((len(edges), 3))
    for i in range(3):
        which, ends = of_face[:, i], np.stack([smooth[:, i], smooth[:, (i + 1) % 3]], axis=1)
        backward = mesh.faces[:, i] != edges[which, 0]
        np.add.at(total, which, np.where(backward[:, None, None], ends[:, ::-1], ends))
        np.add.at(sides, which, flat)
    # |n_1 + n_2|^2 = 2 + 2 cos of the bend.
    bent = np.sum(sides**2, axis=1, keepdims=True) / 2 - 1 <= least_cosine
    normals = total / np.maximum(np.linalg.norm(total, axis=2, keepdims=True), 1e-300)
    slope = np.einsum("eki,ei->ek", normals, along)
    bulge = (slope[:, 1, None] * normals[:, 1] - slope[:, 0, None] * normals[:, 0]) / 8
    return np.where(bent, 0.0, bulge)


def _corner_normals(mesh: Mesh, flat: Array, least_cosine: float) -> Array:
    """Normals at the corners of each triangle, shape (k, 3, 3): mean over neighbours that bend little."""
    corner = np.arange(3 * len(mesh.faces))
    order = np.argsort(mesh.faces.reshape(-1), kind="stable")
    vertex = mesh.faces.reshape(-1)[order]
    begins = np.searchsorted(vertex, vertex, side="left")
    counts = np.searchsorted(vertex, vertex, side="right") - begins
    weights = (mesh.areas[:, None] * _angles(mesh)).reshape(-1)
    found = np.zeros((3 * len(mesh.faces), 3))
    for step in range(int(counts.max())):
        here = step < counts
        mine, other = corner[order][here], order[(begins + step)[here]]
        alike = np.sum(flat[mine // 3] * flat[other // 3], axis=1) > least_cosine
        near = alike | (mine == other)  # rounding can make a triangle differ from itself
        found[mine] += np.where(near[:, None], weights[other][:, None] * flat[other // 3], 0.0)
    return (found / np.linalg.norm(found, axis=1, keepdims=True)).reshape(-1, 3, 3)


def _angles(mesh: Mesh) -> Array:
    to_next = np.roll(mesh.corners, -1, axis=1) - mesh.corners
    to_next /= np.linalg.norm(to_next, axis=2, keepdims=True)
    cosine = -np.sum(to_next * np.roll(to_next, 1, axis=1), axis=2)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))
