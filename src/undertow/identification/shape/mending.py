"""Checks of a hull's surface, and the faults that can be mended."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components

from undertow.errors import UndertowError

from .mesh import Faces, Mesh

# Points closer than this share of the size are one: STL has seven digits.
_SAME = 1e-6


def mended(mesh: Mesh, name: str) -> tuple[Mesh, tuple[str, ...]]:
    """One closed body whose triangles all look outward, and what was done for it.

    Parameters
    ----------
    mesh : Mesh
        Triangles as a file has them; corners that coincide need not be the same vertex.
    name : str
        What to call it in messages.

    Raises
    ------
    UndertowError
        If the surface is open, branches, or encloses several bodies.
    """
    joined = _joined(mesh)
    if not len(joined.faces):
        raise UndertowError(f"{name}: every triangle has no area: export the surface of the hull as STL")
    pairs = _neighbours(joined, name)
    even = _consistent(joined, pairs)
    remarks = [f"{even[1]} triangles looked the other way than their neighbours: turned"] if even[1] else []
    _check_one_body(even[0], pairs, name)
    if even[0].volume < 0:
        remarks.append("all triangles looked inward: turned")
        even = Mesh(even[0].vertices, even[0].faces[:, ::-1]), 0
    if not even[0].volume > 1e-9 * float(even[0].extents.max()) ** 3:
        raise UndertowError(f"{name}: encloses no volume: export the hull as a solid")
    return even[0], tuple(remarks)


def _joined(mesh: Mesh) -> Mesh:
    """Equal corners as one vertex, without triangles that have no area or stand there twice."""
    size = float(mesh.extents.max()) or 1.0
    _, first, place = np.unique(
        np.round((mesh.vertices - mesh.vertices.min(axis=0)) / (_SAME * size)),
        axis=0,
        return_index=True,
        return_inverse=True,
    )
    faces = place.reshape(-1)[mesh.faces]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    once = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)[1]
    return Mesh(mesh.vertices[first], faces[np.sort(once)])


def edges_of(faces: Faces) -> Faces:
    """Edges of triangles as they go round, shape (3 k, 2): first edges, second edges, third edges."""
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def _neighbours(mesh: Mesh, name: str) -> Faces:
    """Triangles that share an edge, two by two, and whether both go along it the same way, shape (n, 3)."""
    edges = edges_of(mesh.faces)
    _, place, count = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True, return_counts=True)
    place = place.reshape(-1)
    for wrong, what in ((count == 1, "open"), (count > 2, "not the surface of a solid")):
        if wrong.any():
            x, y, z = mesh.vertices[edges[np.flatnonzero(wrong[place])[0]]].mean(axis=0)
            raise UndertowError(
                f"{name}: the hull is {what}: {wrong.sum()} edges belong to {count[wrong].min()} triangle(s) "
                f"instead of 2, one near ({x:.4g}, {y:.4g}, {z:.4g}) m: repair it where it was drawn"
            )
    order = np.argsort(place, kind="stable").reshape(-1, 2)
    triangles = order % len(mesh.faces)
    same = edges[order[:, 0], 0] == edges[order[:, 1], 0]
    return np.column_stack([triangles, same])


def _graph(pairs: Faces, count: int) -> coo_array:
    return coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))


def _consistent(mesh: Mesh, pairs: Faces) -> tuple[Mesh, int]:
    """All triangles of a part looking to the same side, and how many had to be turned for it."""
    count = len(mesh.faces)
    if not pairs[:, 2].any():
        return mesh, 0
    odd = {(int(a), int(b)): bool(same) for a, b, same in pairs}
    graph = _graph(pairs, count).tocsr()
    turned = np.zeros(count, dtype=bool)
    for part in np.unique(connected_components(graph, directed=False)[1], return_index=True)[1]:
        order, before = breadth_first_order(graph, int(part), directed=False)
        for triangle in order[1:].tolist():
            other = int(before[triangle])
            turned[triangle] = turned[other] ^ odd.get((triangle, other), odd.get((other, triangle), False))
        if turned[order].mean() > 0.5:
            turned[order] = ~turned[order]
    faces = np.where(turned[:, None], mesh.faces[:, ::-1], mesh.faces)
    return Mesh(mesh.vertices, faces), int(turned.sum())


def _check_one_body(mesh: Mesh, pairs: NDArray[np.int64], name: str) -> None:
    count, part = connected_components(_graph(pairs, len(mesh.faces)), directed=False)
    if count > 1:
        volumes = sorted(abs(Mesh(mesh.vertices, mesh.faces[part == i]).volume) for i in range(count))[::-1]
        shown = ", ".join(f"{v:.3g}" for v in volumes[:4]) + (", ..." if count > 4 else "")
        raise UndertowError(
            f"{name}: {count} separate bodies ({shown} m^3): unite them where they were drawn, fill "
            "cavities, or export the hull alone"
        )
