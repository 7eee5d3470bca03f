"""Added mass and radiation damping of any hull, by a panel method on smooth surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from undertow.errors import UndertowError
from undertow.typing import Array, Progress

from .bodies import AddedMass, transformation, transformed
from .mesh import Faces, Mesh, base_mesh, each_edge, load_capytaine, load_igl, quartered, subdivided


@dataclass(frozen=True)
class PanelRules:
    """How a hull is cut into panels, and their results extrapolated."""

    crease: float = 30.0  # degrees; edges that bend by less are taken for a coarsely drawn curve
    curved: int = 8000  # triangles from which a curve is drawn finely enough
    flat: float = 1e-9  # bulge of an edge, as a share of the size, that is none
    missed: float = 0.05  # share of the volume that panels may miss
    finest: int = 3200  # panels of the finest of three meshes: some seconds, 0.5 GB
    fewest: int = 320  # panels of the finest mesh
    most: int = 12_000  # the same
    pair: int = 48  # bytes of memory for each pair of panels: three complex matrices
    orders: tuple[float, float] = (1.0, 2.0)  # of convergence: at sharp edges, and on a smooth hull


PANEL_RULES = PanelRules()


def panels(mesh: Mesh, finest: int, crease: float = PANEL_RULES.crease) -> tuple[Mesh, Mesh, Mesh]:
    """A hull in triangles of three sizes, each half of the one before.

    `crease`: degrees. Edges at which the surface bends by less are taken for a curve, drawn coarsely.
    """
    coarse = base_mesh(mesh, finest // 16)
    smooth = mesh
    while len(smooth.faces) < PANEL_RULES.curved and _is_curved(smooth, crease):
        smooth = curved(smooth, crease)
    first = _projected(coarse, smooth)
    second = _projected(subdivided(first), smooth)
    third = _projected(subdivided(second), smooth)
    missed = abs(third.volume / smooth.volume - 1)
    if missed > PANEL_RULES.missed:
        raise UndertowError(
            f"{len(third.faces)} panels miss the volume of the hull by {missed:.1%} "
            f"(limit {PANEL_RULES.missed:.0%}): choose more panels"
        )
    return first, second, third


def _projected(mesh: Mesh, onto: Mesh) -> Mesh:
    """The same triangles with every vertex at the nearest point of a surface."""
    package = load_igl("cutting a hull into panels")
    _, _, nearest = package.point_mesh_squared_distance(mesh.vertices, onto.vertices, onto.faces)
    return Mesh(nearest, mesh.faces)


def _is_curved(mesh: Mesh, crease: float) -> bool:
    edges, of_face = each_edge(mesh)
    bulge = _bulge(mesh, edges, of_face, np.diff(mesh.vertices[edges], axis=1)[:, 0], crease)
    return bool(np.abs(bulge).max() > PANEL_RULES.flat * mesh.extents.max())


def curved(mesh: Mesh, crease: float = PANEL_RULES.crease) -> Mesh:
    """Four triangles for each; new vertices lie on the curve that the normals at both ends of an edge give.

    `crease`: degrees. An edge at which the surface bends by more, or not at all, stays straight.

    The middle of an edge from a to b with normals n_a and n_b is that of the cubic of a PN triangle
    (Vlachos, Peters, Boyd and Mitchell 2001, Curved PN triangles).
    """
    edges, of_face = each_edge(mesh)
    a, b = mesh.vertices[edges[:, 0]], mesh.vertices[edges[:, 1]]
    middles = (a + b) / 2 + _bulge(mesh, edges, of_face, b - a, crease)
    return quartered(mesh, of_face, middles)


def _bulge(mesh: Mesh, edges: Faces, of_face: Faces, along: Array, crease: float) -> Array:
    """How far the middles of the edges lie off the chord, m."""
    least_cosine = float(np.cos(np.radians(crease)))
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
    to_next = np.roll(mesh.corners, -1, axis=1) - mesh.corners
    to_next /= np.linalg.norm(to_next, axis=2, keepdims=True)
    cosine = -np.sum(to_next * np.roll(to_next, 1, axis=1), axis=2)
    weights = (mesh.areas[:, None] * np.arccos(np.clip(cosine, -1.0, 1.0))).reshape(-1)
    found = np.zeros((3 * len(mesh.faces), 3))
    for step in range(int(counts.max())):
        here = step < counts
        mine, other = corner[order][here], order[(begins + step)[here]]
        alike = np.sum(flat[mine // 3] * flat[other // 3], axis=1) > least_cosine
        near = alike | (mine == other)  # rounding can make a triangle differ from itself
        found[mine] += np.where(near[:, None], weights[other][:, None] * flat[other // 3], 0.0)
    return (found / np.linalg.norm(found, axis=1, keepdims=True)).reshape(-1, 3, 3)


# Between body axes (z down) and those of the panel method (z up).
UP = np.diag([1.0, -1.0, -1.0])
_LIMITS = (
    "ideal fluid: no separation, no boundary layer; appendages, thrusters and openings count as far as the "
    "mesh has them"
)


@dataclass(frozen=True)
class Radiation:
    """What a hull radiates at one frequency, about the origin of its mesh."""

    omega: float  # rad/s
    damping: Array  # (6, 6): force per velocity, N/(m/s) and so on, positive
    error: Array  # (6, 6): how far it may be off

    def placed(self, rotation: ArrayLike, offset: ArrayLike) -> Radiation:
        """The same hull turned by `rotation` and with its origin at `offset`; see `transformation`."""
        T = transformation(rotation, offset)
        return replace(self, damping=T @ self.damping @ T.T, error=np.abs(T) @ self.error @ np.abs(T).T)


@dataclass(frozen=True)
class PanelResult:
    """What a panel method says of a hull."""

    added: AddedMass  # at infinite frequency, about the origin of the mesh
    radiation: tuple[Radiation, ...]  # damping at the frequencies asked for
    panels: tuple[int, ...]  # sizes of the three meshes

    def placed(self, rotation: ArrayLike, offset: ArrayLike) -> PanelResult:
        """The same hull turned by `rotation` and with its origin at `offset`; see `transformation`."""
        radiation = tuple(r.placed(rotation, offset) for r in self.radiation)
        return replace(self, added=self.added.placed(rotation, offset), radiation=radiation)


def added_mass_of_hull(
    mesh: Mesh,
    density: float = 1000.0,
    *,
    depth: float | None = None,
    omegas: Sequence[float] = (),
    finest: int = PANEL_RULES.finest,
    crease: float = PANEL_RULES.crease,
    report: Progress = lambda done, words: None,
) -> PanelResult:
    """Added mass of a hull by panels of three sizes, extrapolated to infinitely small ones.

    `mesh`: the hull, m, body axes; `density`: of the water, kg/m^3; `depth`: depth of the centre of volume
    under the free surface, m; infinitely deep by default; `omegas`: frequencies of radiation damping, rad/s;
    they need a depth; `crease`: degrees, 0 to 180; edges at which the surface bends by less are taken for a
    curve, drawn coarsely.

    Direct boundary-integral equation. Of the three results the order of convergence is observed, from one
    (sharp edges) to two (smooth hulls); the error is half of what the extrapolation adds, more where two
    extrapolations or the two triangles of the matrix differ more, or the panels miss some of the volume.
    """
    cpt = load_capytaine()
    _check(mesh, depth, omegas, finest, crease)
    report(0.0, "cutting the hull into panels" if not omegas else "panels, and a table of waves (made once)")
    meshes = panels(mesh, finest, crease)
    cases = [np.inf, *omegas]
    found: list[list[NDArray[np.complex128]]] = []
    for i, omega in enumerate(cases):
        found.append([])
        for j, coarse in enumerate(meshes):
            report((i + (0.0, 0.02, 0.15)[j]) / len(cases), f"{len(coarse.faces)} panels")
            found[-1].append(_of_hull(cpt, coarse, mesh.centroid, density, depth, omega))
    missed = abs(meshes[-1].volume / mesh.volume - 1) if len(mesh.faces) > len(meshes[0].faces) else 0.0
    parts = [_extrapolated([part(f) for f in fs], missed) for fs in found for part in (np.real, np.imag)]
    sizes = tuple(len(m.faces) for m in meshes)
    added = AddedMass(parts[0][0], _source(cpt, sizes, depth), _LIMITS, parts[0][1])
    radiated = tuple(Radiation(w, *parts[2 * i + 1]) for i, w in enumerate(cases) if i)
    return PanelResult(added, radiated, sizes).placed(np.eye(3), mesh.centroid)


def _source(cpt: Any, sizes: tuple[int, ...], depth: float | None) -> str:
    where = (
        "far from surface and bottom" if depth is None else f"{depth:g} m under the surface, high frequency"
    )
    counts = f"{sizes[1]} and {sizes[2]} panels extrapolated, order from {sizes[0]}"
    return f"capytaine {cpt.__version__}, direct method, {where}; {counts}"


def _check(mesh: Mesh, depth: float | None, omegas: Sequence[float], finest: int, crease: float) -> None:
    if not PANEL_RULES.fewest <= finest <= PANEL_RULES.most:
        raise UndertowError(
            f"{finest} panels are out of reach: choose {PANEL_RULES.fewest} to {PANEL_RULES.most}"
        )
    if not 0.0 < crease < 180.0:
        raise UndertowError(f"crease = {crease:g} degrees is impossible: choose between 0 and 180")
    if omegas and depth is None:
        raise UndertowError("radiation damping needs a free surface: give the depth of the hull")
    wrong = [w for w in omegas if not (w > 0 and np.isfinite(w))]
    if wrong:
        raise UndertowError(f"omega = {wrong[0]:g} rad/s is impossible: give a positive number")
    above = 0.0 if depth is None else float(mesh.centroid[2] - mesh.bounds[0, 2])
    if depth is not None and not depth > above:
        raise UndertowError(
            f"depth = {depth:g} m: the hull reaches {above:.4g} m above its centre and would stand out of "
            "the water: go deeper; hulls at the surface are for undertow vehicle new --floating"
        )


def _of_hull(
    cpt: Any, mesh: Mesh, centre: Array, density: float, depth: float | None, omega: float
) -> NDArray[np.complex128]:
    """Added mass + i radiation damping about the centre of the hull, body axes, shape (6, 6)."""
    vertices = (mesh.vertices - centre) @ UP - np.array([0.0, 0.0, depth or 0.0])
    place = (0.0, 0.0, -(depth or 0.0))
    body = cpt.FloatingBody(
        mesh=cpt.Mesh(vertices, mesh.faces), dofs=cpt.rigid_body_dofs(rotation_center=place), name="hull"
    )
    surface = np.inf if depth is None else 0.0
    # Without a surface the frequency is of no matter.
    frequency = 1.0 if depth is None else omega
    problems = [
        cpt.RadiationProblem(body=body, radiating_dof=dof, omega=frequency, free_surface=surface, rho=density)
        for dof in body.dofs
    ]
    return radiated(solved(cpt, problems, omega))


def solved(cpt: Any, problems: Sequence[Any], omega: float, method: str = "direct") -> list[Any]:
    """Results of problems at one frequency; at an infinite one there are no waves to be tabulated."""
    waves = {} if np.isfinite(omega) else {"tabulation_nr": 0, "tabulation_nz": 0}
    solver = cpt.BEMSolver(green_function=cpt.Delhommeau(**waves), method=method)
    return list(solver.solve_all(problems, keep_details=method == "indirect", progress_bar=False))


def radiated(results: Sequence[Any]) -> NDArray[np.complex128]:
    """Added mass + i radiation damping by the results for each motion, body axes, shape (6, 6)."""
    body = results[0].body
    found = np.array([[r.added_masses[d] + 1j * r.radiation_dampings[d] for d in body.dofs] for r in results])
    if not np.isfinite(found).all():  # it goes on after an error, with numbers that are none
        count = body.mesh.nb_faces
        raise UndertowError(
            f"capytaine gave no result for {count} panels, which take "
            f"{PANEL_RULES.pair * count**2 / 1e9:.2g} GB of memory: choose fewer panels"
        )
    return transformed(found.real, UP) + 1j * transformed(found.imag, UP)


def _extrapolated(found: Sequence[Array], missed: float) -> tuple[Array, Array]:
    """The symmetric matrix for infinitely small panels and its error, from three sizes halved each time."""
    coarse, middle, fine = ((f + f.T) / 2 for f in found)
    first, second = middle - coarse, fine - middle
    with np.errstate(divide="ignore", invalid="ignore"):
        orders = np.nan_to_num(np.log2(np.abs(first / second)), nan=1.0)
    share = 1 / (2 ** np.clip(orders, *PANEL_RULES.orders) - 1)
    result, before = fine + share * second, middle + share * first
    # The nearest matrix that gives no negative energy: a body of revolution spins without moving water.
    values, vectors = np.linalg.eigh(result)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    result = np.asarray(root @ root.T)
    scale = np.sqrt(np.outer(*2 * [np.diag(result)]))
    parts = [
        np.abs(result - fine) / 2,
        np.abs(result - before),
        np.abs(found[-1] - found[-1].T),
        missed * scale,
    ]
    return result, np.maximum.reduce(parts)
