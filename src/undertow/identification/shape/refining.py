"""Panels of chosen sizes from the triangles that a hull comes with."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from undertow.errors import UndertowError
from undertow.typing import Array

from .capytaine import INSTALL
from .mending import edges_of, mended
from .mesh import Faces, Mesh

# Part of the triangles wanted to which a hull is simplified: cutting the longest edges then evens them out.
_PART = 0.33


def base_mesh(mesh: Mesh, count: int) -> Mesh:
    """A mesh of at most some `count` triangles of similar size: simplified, or cut at the longest edges.

    Raises
    ------
    UndertowError
        If a simplified surface is no closed body any more, or the package for it is missing.
    """
    found = _simplified(mesh, round(count * _PART)) if len(mesh.faces) > count else mesh
    longest = float(mesh.extents.max())
    while len((finer := bisected(found, longest)).faces) <= count:
        found, longest = finer, 0.9 * longest
    return found


def bisected(mesh: Mesh, longest: float) -> Mesh:
    """Cut edges in two, the longest of each triangle first, until none is longer than `longest`."""
    while True:
        edges, of_face = each_edge(mesh)
        lengths = np.linalg.norm(np.diff(mesh.vertices[edges], axis=1)[:, 0], axis=1)
        own = lengths[of_face]  # (k, 3)
        if own.max() <= longest:
            return mesh
        # An edge is cut where it is the longest of both its triangles: no other edge has to give way.
        worst = of_face[np.arange(len(own)), _first_longest(own, of_face)]
        wanted, votes = np.unique(worst, return_counts=True)
        mesh = _cut(mesh, edges, of_face, wanted[(votes == 2) & (lengths[wanted] > longest)], worst)


def _first_longest(own: Array, of_face: Faces) -> NDArray[np.intp]:
    """Place of the longest edge of each triangle; of equally long ones, the same for both neighbours."""
    rounded = np.round(own / own.max(axis=1, keepdims=True), 9)
    return np.lexsort((of_face, rounded), axis=1)[:, -1]


def _cut(mesh: Mesh, edges: Faces, of_face: Faces, chosen: Faces, worst: Faces) -> Mesh:
    """Each chosen edge gets a vertex in its middle, and both of its triangles become two."""
    middle = np.full(len(edges), -1)
    middle[chosen] = len(mesh.vertices) + np.arange(len(chosen))
    vertices = np.concatenate([mesh.vertices, mesh.vertices[edges[chosen]].mean(axis=1)])
    new = middle[worst]
    cut = new >= 0
    place = np.argmax(of_face[cut] == worst[cut][:, None], axis=1)
    rows = np.arange(len(place))
    a, b, c = (mesh.faces[cut][rows, (place + i) % 3] for i in range(3))
    halves = [np.column_stack([a, new[cut], c]), np.column_stack([new[cut], b, c])]
    return Mesh(vertices, np.concatenate([mesh.faces[~cut], *halves]))


def subdivided(mesh: Mesh) -> Mesh:
    """Four flat triangles for each, with a vertex in the middle of every edge."""
    edges, of_face = each_edge(mesh)
    return quartered(mesh, of_face, mesh.vertices[edges].mean(axis=1))


def quartered(mesh: Mesh, of_face: Faces, middles: Array) -> Mesh:
    """Four triangles for each, with given vertices in the middle of the edges."""
    ab, bc, ca = (len(mesh.vertices) + of_face).T
    p, q, r = mesh.faces.T
    faces = [(p, ab, ca), (ab, q, bc), (ca, bc, r), (ab, bc, ca)]
    return Mesh(np.concatenate([mesh.vertices, middles]), np.concatenate([np.column_stack(f) for f in faces]))


def each_edge(mesh: Mesh) -> tuple[Faces, Faces]:
    """Every edge once, and the edges of each triangle: from its first corner, its second, its third."""
    edges, place = np.unique(np.sort(edges_of(mesh.faces), axis=1), axis=0, return_inverse=True)
    return edges, place.reshape(3, -1).T


def _simplified(mesh: Mesh, count: int) -> Mesh:
    """At most some `count` triangles, by the collapse of edges that changes the surface least."""
    try:
        package: Any = importlib.import_module("igl")
    except ImportError as error:
        raise UndertowError(
            f"a hull of {len(mesh.faces)} triangles has to be simplified, which needs libigl: {INSTALL}"
        ) from error
    points, faces, *_ = package.qslim(mesh.vertices - mesh.centroid, mesh.faces, count)
    found, _ = mended(
        Mesh(np.asarray(points, dtype=float), np.asarray(faces, dtype=np.int64)),
        f"the hull simplified to {len(faces)} triangles",
    )
    return found.moved(mesh.centroid)
