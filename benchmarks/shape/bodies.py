"""Added mass of bodies by a closed form or table, and by panels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from undertow.shape.bodies import AddedMass, box, cylinder, ellipsoid, equivalent, prolate_spheroid, sphere
from undertow.shape.mesh import Mesh, repaired
from undertow.shape.panels import added_mass_of_hull
from undertow.typing import Progress

from .hulls import ball, box_mesh, cylinder_mesh, revolved, spheroid_mesh, torpedo_mesh

Array = NDArray[np.float64]
RHO = 1000.0


@dataclass(frozen=True)
class Measured:
    """One body by two ways.

    Attributes
    ----------
    group, body : str
        What it is compared for, and what it is.
    simple, panels, error : (6,) array
        Diagonal of the added mass by the simple way, by panels, and the error that those state; kg, kg m^2.
    """

    group: str
    body: str
    simple: Array
    panels: Array
    error: Array


CLOSED, STRIPS, TABLE, INSTEAD = "closed form", "strips", "table", "instead of the hull"
_CONE = ((-0.4, 0.0), (-0.4, 0.2), (0.4, 0.0))


def _scaled(mesh: Mesh, a: float, b: float, c: float) -> Mesh:
    return Mesh(mesh.vertices * np.array([a, b, c]), mesh.faces)


def _cases() -> list[tuple[str, str, Mesh, Callable[[Mesh], AddedMass]]]:
    drawn = ball(4)
    return [
        (CLOSED, "sphere, diameter 0.5 m", _scaled(drawn, 0.25, 0.25, 0.25), lambda m: sphere(0.25)),
        (CLOSED, "spheroid 1.2 x 0.4 m", spheroid_mesh(1.2, 0.4, 4), lambda m: prolate_spheroid(1.2, 0.4)),
        (
            CLOSED,
            "ellipsoid 1.0 x 0.6 x 0.3 m",
            _scaled(drawn, 0.5, 0.3, 0.15),
            lambda m: ellipsoid(0.5, 0.3, 0.15),
        ),
        *(
            (
                STRIPS,
                f"cylinder {n * 0.2:g} x 0.2 m",
                cylinder_mesh(n * 0.2, 0.2),
                lambda m, n=n: cylinder(n * 0.2, 0.2),
            )
            for n in (5, 10)
        ),
        *(
            (TABLE, "box {} x {} x {} m".format(*sides), box_mesh(sides), lambda m, sides=sides: box(*sides))
            for sides in ((0.6, 0.42, 0.24), (0.46, 0.34, 0.25), (2.8, 1.7, 1.6), (1.5, 0.4, 0.1))
        ),
        *(
            (INSTEAD, f"cylinder {n * 0.4:g} x 0.4 m", cylinder_mesh(n * 0.4, 0.4), equivalent)
            for n in (1, 3)
        ),
        (INSTEAD, "torpedo 1.6 x 0.4 m", torpedo_mesh(1.6, 0.4), equivalent),
        (INSTEAD, "cone 0.8 x 0.4 m", revolved(_CONE), equivalent),
    ]


def measure(finest: int, report: Progress) -> list[Measured]:
    """Every body by both ways, about its centre of volume."""
    found, cases = [], _cases()
    for i, (group, body, drawn, simple) in enumerate(cases):
        report(i / len(cases), body)
        mesh, _ = repaired(drawn, body)
        mesh = mesh.moved(-mesh.centroid)
        by_panels = added_mass_of_hull(mesh, RHO, finest=finest).added
        numbers = (np.diag(m) for m in (simple(mesh).matrix, by_panels.matrix, by_panels.error))
        found.append(Measured(group, body, *numbers))
    return found
