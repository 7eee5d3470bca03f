"""Hulls as closed surfaces of triangles: reading, mending, refining, volume, centre, inertia, areas."""

from __future__ import annotations

import importlib
import logging
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
from io import StringIO
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components

from undertow.errors import UndertowError
from undertow.model.units import to_si
from undertow.typing import Array

Faces = NDArray[np.int64]


@dataclass(frozen=True)
class MeshLimits:
    """What is read from a file of a hull, and how it is cut."""

    stations: int = 100  # at which a silhouette is measured
    same: float = 1e-6  # points closer than this share of the size are one: STL has seven digits
    file: int = 300_000_000  # bytes
    triangles: int = 1_000_000
    longest: float = 100.0  # m, of a hull in a file that does not say its unit
    shortest: float = 0.01  # m, the same
    empty: float = 1e-9  # volume over the cube of the longest side, up to which a mesh encloses nothing
    shorter: float = 0.9  # factor on the longest edge until there are as many triangles as are wanted
    alike: int = 9  # decimals of an edge over the longest of its triangle, in which edges are equally long
    simplified: float = 0.33  # of the triangles wanted: cutting the longest edges then evens them out


_LIMITS = MeshLimits()


@dataclass(frozen=True)
class Mesh:
    """A closed surface of triangles that are seen counter-clockwise from outside."""

    vertices: Array  # (n, 3): m, body axes (x forward, y to starboard, z down)
    faces: Faces  # (k, 3): places of the corners among the vertices

    @cached_property
    def corners(self) -> Array:
        """Corners of each triangle, m, shape (k, 3 corners, 3)."""
        return self.vertices[self.faces]

    @cached_property
    def vector_areas(self) -> Array:
        """Outward normals times areas, m^2, shape (k, 3)."""
        a, b, c = self.corners.transpose(1, 0, 2)
        return np.cross(b - a, c - a) / 2

    @cached_property
    def areas(self) -> Array:
        """Areas, m^2, shape (k,)."""
        return np.asarray(np.linalg.norm(self.vector_areas, axis=1))

    @property
    def bounds(self) -> Array:
        """Least and greatest coordinates, m, shape (2, 3)."""
        return np.array([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    @property
    def extents(self) -> Array:
        """Length, beam and height, m, shape (3,)."""
        return np.asarray(np.ptp(self.vertices, axis=0))

    @cached_property
    def _middle(self) -> Array:
        return np.asarray(self.bounds.mean(axis=0))

    @cached_property
    def _tetrahedra(self) -> tuple[Array, Array]:
        """Corners of tetrahedra with their fourth corner in the middle, and six times their volumes."""
        corners = self.corners - self._middle
        return corners, np.linalg.det(corners)

    @property
    def volume(self) -> float:
        """Enclosed volume, m^3; negative where the triangles look inward."""
        return float(self._tetrahedra[1].sum()) / 6

    @property
    def centroid(self) -> Array:
        """Centre of the enclosed volume, m, shape (3,)."""
        corners, six = self._tetrahedra
        return np.asarray(self._middle + six @ corners.sum(axis=1) / six.sum() / 4)

    @property
    def inertia(self) -> Array:
        """Inertia tensor about the centroid for a density of one, m^5, shape (3, 3)."""
        corners, six = self._tetrahedra
        total = corners.sum(axis=1)
        squares = np.einsum("k,kpi,kpj->ij", six, corners, corners)
        second = (squares + np.einsum("k,ki,kj->ij", six, total, total)) / 120
        away = self.centroid - self._middle
        second -= self.volume * np.outer(away, away)
        return np.asarray(np.trace(second) * np.eye(3) - second)

    def widths(self, along: int, across: int) -> tuple[Array, Array]:
        """How wide the hull is at stations along an axis, seen along the third.

        Axes `along` and `across` are 0, 1, 2 for x, y, z. Widths (n,), m, leave out gaps between parts of a
        section; steps (n,), m, are what each station stands for: stations are closer at the ends.
        """
        low, high = self.bounds[:, along]
        angles = (np.arange(_LIMITS.stations) + 0.5) / _LIMITS.stations * np.pi - np.pi / 2
        half = (high - low) / 2
        places = low + half + half * np.sin(angles)
        weights = np.cos(angles)
        found = [_union_length(*self._cut(along, across, place)) for place in places]
        return np.array(found), weights / weights.sum() * (high - low)

    def projected_area(self, axis: int) -> float:
        """Area of the silhouette seen along an axis, m^2."""
        widths, steps = self.widths((axis + 1) % 3, (axis + 2) % 3)
        return float(widths @ steps)

    def _cut(self, along: int, across: int, place: float) -> tuple[Array, Array]:
        """Where the triangles that a plane cuts begin and end in it."""
        reach = self.corners[:, :, along]
        cut = (reach.min(axis=1) < place) & (reach.max(axis=1) > place)
        x, y = reach[cut], self.corners[cut][:, :, across]
        x_next, y_next = np.roll(x, -1, axis=1), np.roll(y, -1, axis=1)
        crossed = (x < place) != (x_next < place)
        share = np.where(crossed, (place - x) / np.where(crossed, x_next - x, 1.0), 0.0)
        points = y + share * (y_next - y)
        return (np.where(crossed, points, np.inf).min(axis=1), np.where(crossed, points, -np.inf).max(axis=1))

    def moved(self, by: ArrayLike) -> Mesh:
        """The same hull elsewhere."""
        return Mesh(self.vertices + np.asarray(by, dtype=float), self.faces)


def _union_length(begins: Array, ends: Array) -> float:
    """Length of the union of intervals."""
    order = np.argsort(begins)
    begins, ends = begins[order], ends[order]
    reached = np.concatenate([[-np.inf], np.maximum.accumulate(ends)[:-1]]) if len(ends) else ends
    return float(np.maximum(ends - np.maximum(begins, reached), 0.0).sum())


def repaired(mesh: Mesh, name: str) -> tuple[Mesh, tuple[str, ...]]:
    """One closed body whose triangles all look outward, and what was done for it."""
    joined = _merged(mesh)
    if not len(joined.faces):
        raise UndertowError(f"{name}: every triangle has no area: export the surface of the hull as STL")
    pairs = _neighbours(joined, name)
    even = _consistent(joined, pairs)
    remarks = [f"{even[1]} triangles faced the opposite way to their neighbours: flipped"] if even[1] else []
    _check_one_body(even[0], pairs, name)
    if even[0].volume < 0:
        remarks.append("all triangles faced inward: flipped")
        even = Mesh(even[0].vertices, even[0].faces[:, ::-1]), 0
    if not even[0].volume > _LIMITS.empty * float(even[0].extents.max()) ** 3:
        raise UndertowError(f"{name}: encloses no volume: export the hull as a solid")
    return even[0], tuple(remarks)


def _merged(mesh: Mesh) -> Mesh:
    """Equal corners as one vertex, without triangles that have no area or stand there twice."""
    size = float(mesh.extents.max()) or 1.0
    _, first, place = np.unique(
        np.round((mesh.vertices - mesh.vertices.min(axis=0)) / (_LIMITS.same * size)),
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
                f"instead of 2, one near ({x:.4g}, {y:.4g}, {z:.4g}) m: close it in the CAD program"
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
            f"{name}: {count} separate bodies ({shown} m^3): unite them in the CAD program, fill "
            "cavities, or export the hull alone"
        )


INSTALL = 'pip install "undertow[bem]"'


def has_capytaine() -> bool:
    """Whether the package is installed."""
    return find_spec("capytaine") is not None


def load_capytaine() -> Any:
    """The package capytaine, which logs errors only."""
    root, silent = logging.getLogger(), logging.NullHandler()
    # On import it gives the root logger a handler to stdout, unless there is one.
    root.addHandler(silent)
    try:
        package = importlib.import_module("capytaine")
    except ImportError as error:
        raise UndertowError(
            f"added mass by panels needs capytaine, which is not installed ({error}): {INSTALL}"
        ) from error
    finally:
        root.removeHandler(silent)
    logging.getLogger("capytaine").setLevel(logging.ERROR)
    return package


def load_igl(purpose: str) -> Any:
    """The package igl; `purpose` is what it is needed for."""
    try:
        return importlib.import_module("igl")
    except ImportError as error:
        raise UndertowError(f"{purpose} needs libigl: {INSTALL}") from error


_LETTERS = {"F": (0, 1), "B": (0, -1), "R": (1, 1), "L": (1, -1), "D": (2, 1), "U": (2, -1)}
_STL_HEAD, _STL_FACET = 84, np.dtype([("floats", "<f4", 12), ("attribute", "<u2")])


@dataclass(frozen=True)
class Hull:
    """A hull out of a file."""

    mesh: Mesh  # its surface in body axes
    remarks: tuple[str, ...]  # what was mended, one line each


def read_hull(path: str | Path, *, unit: str | None = None, frame: str = "FRD") -> Hull:
    """Read a closed hull from an STL (binary or text), OBJ or, with the extra `bem`, MSH file.

    `unit` is that of its numbers, such as "mm"; m by default, and then an unlikely size is refused. `frame`
    has the directions of its x, y and z axes: Forward or Back, Right or Left, Down or Up.
    """
    path = Path(path)
    vertices, faces = _content(path)
    if not len(faces):
        raise UndertowError(f"{path}: no triangles in it: export the surface of the hull as STL")
    if len(faces) > _LIMITS.triangles:
        raise UndertowError(
            f"{path}: {len(faces)} triangles are too many (limit {_LIMITS.triangles}): export it more "
            "coarsely"
        )
    if not np.isfinite(vertices).all():
        raise UndertowError(f"{path}: a coordinate is not a finite number: export the hull again")
    scaled = vertices * (1.0 if unit is None else _metres(unit))
    _check_size(path, scaled, unit)
    return Hull(*repaired(Mesh(scaled @ _rotation(frame).T, faces), str(path)))


def _metres(unit: str) -> float:
    try:
        return to_si(f"1 {unit}", "m")
    except UndertowError as error:
        raise UndertowError(f"unit '{unit}' is not a length: give m, mm, cm, in or ft") from error


def _rotation(frame: str) -> Array:
    """From the axes of a file to body axes."""
    rotation = np.zeros((3, 3))
    letters = [_LETTERS.get(letter, (0, 0)) for letter in frame.upper()]
    for column, (axis, sign) in enumerate(letters[:3]):
        rotation[axis, column] = sign
    if len(letters) != 3 or not np.isclose(np.linalg.det(rotation), 1.0):
        raise UndertowError(
            f"frame '{frame}' is not a right-handed set of axes: say where x, y and z point, such as FRD "
            "(forward, right, down) or FLU (forward, left, up)"
        )
    return rotation


def _check_size(path: Path, vertices: Array, unit: str | None) -> None:
    extents = np.ptp(vertices, axis=0)
    longest = float(extents.max())
    if unit is None and not _LIMITS.shortest <= longest <= _LIMITS.longest:
        size = " x ".join(f"{e:.4g}" for e in extents)
        likely = "mm" if longest > _LIMITS.longest else "in, ft or km"
        raise UndertowError(
            f"{path}: {size} m is an unlikely hull size ({_LIMITS.shortest:g} to {_LIMITS.longest:g} m): "
            f"give the unit of its numbers, such as {likely} (or m if it is so)"
        )


def _content(path: Path) -> tuple[Array, Faces]:
    readers = {".stl": _stl, ".obj": _obj, ".msh": _msh}
    read = readers.get(path.suffix.lower())
    if read is None:
        raise UndertowError(f"{path}: hulls are read from .stl, .obj and .msh files: export it as STL")
    try:
        if path.stat().st_size > _LIMITS.file:
            raise UndertowError(f"{path}: larger than {_LIMITS.file / 1e6:g} MB: export it more coarsely")
        return read(path)
    except OSError as error:
        raise UndertowError(f"{path}: cannot be read: {error.strerror or error}") from error


# --- STL -----------------------------------------------------------------------------------------
def _stl(path: Path) -> tuple[Array, Faces]:
    data = path.read_bytes()
    count = int.from_bytes(data[80:84], "little") if len(data) >= _STL_HEAD else -1
    binary = len(data) == _STL_HEAD + count * _STL_FACET.itemsize
    if not binary and not data[:512].lstrip().startswith(b"solid"):
        raise UndertowError(f"{path}: not an STL file, or cut off: export the hull again")
    if binary:
        facets = np.frombuffer(data, dtype=_STL_FACET, offset=_STL_HEAD)
        points = facets["floats"][:, 3:].reshape(-1, 3).astype(float)
    else:
        points = _text_facets(path, data)
    return points, np.arange(len(points)).reshape(-1, 3)


def stl_bytes(mesh: Mesh) -> bytes:
    """The content of a binary STL file of a hull."""
    facets = np.zeros(len(mesh.faces), dtype=_STL_FACET)
    normals = mesh.vector_areas / mesh.areas[:, None]
    facets["floats"] = np.concatenate([normals[:, None], mesh.corners], axis=1).reshape(-1, 12)
    return b"hull".ljust(_STL_HEAD - 4) + np.uint32(len(facets)).tobytes() + facets.tobytes()


def _text_facets(path: Path, data: bytes) -> Array:
    words = [line.split() for line in data.splitlines()]
    points = [w[1:] for w in words if w and w[0].lower() == b"vertex"]
    try:
        found = np.array(points, dtype=float)
    except ValueError as error:
        raise UndertowError(f"{path}: a vertex is not three numbers: export the hull again") from error
    if len(points) % 3 or (points and found.shape[1:] != (3,)):
        raise UndertowError(f"{path}: {len(points)} vertices do not make triangles: export the hull again")
    return found.reshape(-1, 3)


# --- OBJ -----------------------------------------------------------------------------------------
def _obj(path: Path) -> tuple[Array, Faces]:
    lines = [line.split() for line in path.read_text(encoding="utf-8", errors="replace").splitlines()]
    try:
        points, faces = _obj_content(lines)
    except (ValueError, OverflowError) as error:
        raise UndertowError(f"{path}: a line is not valid OBJ ({error}): export the hull again") from error
    if faces.size and not (faces.min() >= 0 and faces.max() < len(points)):
        raise UndertowError(f"{path}: a face names a vertex that is not there: export the hull again")
    return points, faces


def _obj_content(lines: list[list[str]]) -> tuple[Array, Faces]:
    points: list[list[str]] = []
    triangles: list[list[int]] = []
    for kind, *words in filter(None, lines):
        if kind == "v":
            points.append(words[:3])
        elif kind == "f":
            triangles += _fan([_place(corner, len(points)) for corner in words])
    return np.array(points, dtype=float).reshape(-1, 3), np.array(triangles, dtype=np.int64).reshape(-1, 3)


def _place(corner: str, before: int) -> int:
    """Place of a vertex: OBJ counts from one, or backwards from the last vertex before the face."""
    number = int(corner.split("/")[0])
    return before + number if number < 0 else number - 1


def _fan(polygon: list[int]) -> list[list[int]]:
    return [[polygon[0], b, c] for b, c in pairwise(polygon[1:])]


# --- MSH -----------------------------------------------------------------------------------------
def _msh(path: Path) -> tuple[Array, Faces]:
    try:
        meshio: Any = importlib.import_module("meshio")
    except ImportError as error:
        raise UndertowError(f"{path}: MSH files need meshio: {INSTALL}, or export the hull as STL") from error
    try:
        with redirect_stdout(StringIO()), redirect_stderr(StringIO()):  # it prints beside what it raises
            content = meshio.read(path)
    except (SystemExit, Exception) as error:  # meshio leaves the program where it cannot read a file
        raise UndertowError(f"{path}: meshio cannot read it ({error}): export the hull as STL") from error
    cells = [block.data for block in content.cells if block.type in ("triangle", "quad")]
    faces = [t for data in cells for polygon in data.tolist() for t in _fan(polygon)]
    return np.asarray(content.points, dtype=float), np.array(faces, dtype=np.int64).reshape(-1, 3)


def base_mesh(mesh: Mesh, count: int) -> Mesh:
    """A mesh of at most some `count` triangles of similar size: simplified, or cut at the longest edges."""
    found = _simplified(mesh, round(count * _LIMITS.simplified)) if len(mesh.faces) > count else mesh
    longest = float(mesh.extents.max())
    while len((finer := bisected(found, longest)).faces) <= count:
        found, longest = finer, _LIMITS.shorter * longest
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
        # Place of the longest edge of each triangle; of equally long ones, the same for both neighbours.
        rounded = np.round(own / own.max(axis=1, keepdims=True), _LIMITS.alike)
        worst = of_face[np.arange(len(own)), np.lexsort((of_face, rounded), axis=1)[:, -1]]
        wanted, votes = np.unique(worst, return_counts=True)
        mesh = _cut(mesh, edges, of_face, wanted[(votes == 2) & (lengths[wanted] > longest)], worst)


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
    ends = np.sort(edges_of(mesh.faces), axis=1).astype(np.int64)
    # One number for each edge, in the same order: rows would be compared byte by byte.
    count = max(len(mesh.vertices), 1)
    found, place = np.unique(ends[:, 0] * count + ends[:, 1], return_inverse=True)
    return np.column_stack(np.divmod(found, count)).astype(mesh.faces.dtype), place.reshape(3, -1).T


def _simplified(mesh: Mesh, count: int) -> Mesh:
    """At most some `count` triangles, by the collapse of edges that changes the surface least."""
    package = load_igl(f"a hull of {len(mesh.faces)} triangles has to be simplified, which")
    points, faces, *_ = package.qslim(mesh.vertices - mesh.centroid, mesh.faces, count)
    found, _ = repaired(
        Mesh(np.asarray(points, dtype=float), np.asarray(faces, dtype=np.int64)),
        f"the hull simplified to {len(faces)} triangles",
    )
    return found.moved(mesh.centroid)
