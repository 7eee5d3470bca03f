"""Writes the table of the added mass of boxes: python -m benchmarks.shape.box_table --help"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from undertow.files import write_whole
from undertow.shape.mesh import load_capytaine

from ..progress import clear, progress_line

Array = NDArray[np.float64]
RATIOS = 2.0 ** (np.arange(6) / 2)
#: Panels along half of the longest side; the finest two are extrapolated, the first tells the error.
CELLS = (5, 10, 20)
# Observed for panels that shrink with the cube of the distance to the edge: 1.81, 1.83, 1.84 for the forces
# on a box of 0.60 x 0.42 x 0.24 m with 6, 12 and 24 cells.
ORDER = 1.83
OUT = Path("src/undertow/shape/box_table.csv")
HEAD = """\
# Added mass of boxes with sides L >= B >= H in unbounded ideal fluid: source method, direct boundary-integral
# equation, capytaine {version}. Panels shrink towards the edges; 10 and 20 of them along half of the longest
# side (up to {most} in all), extrapolated with the order {order}.
# long, middle, short: motion along that side, over density L B H.
# about_long ...: rotation about it, over density L B H (sum of the squares of the other two sides) / 12.
# error: largest relative difference to the extrapolation from 5 and 10 panels. Written by
# python -m benchmarks.shape.box_table
"""
COLUMNS = "L/B,B/H,long,middle,short,about_long,about_middle,about_short,error"


def coefficients(sides: Array, cells: int) -> tuple[Array, int]:
    """Six coefficients of a box, in order of its axes, and how many panels it took."""
    cpt = load_capytaine()
    quarter = cpt.Mesh(*_quarter(sides / 2, cells))
    mesh = cpt.ReflectionSymmetricMesh(cpt.ReflectionSymmetricMesh(quarter, plane="xOz"), plane="yOz")
    body = cpt.FloatingBody(mesh=mesh, dofs=cpt.rigid_body_dofs(rotation_center=(0, 0, 0)), name="box")
    solver = cpt.BEMSolver(green_function=cpt.Delhommeau(tabulation_nr=0, tabulation_nz=0), method="direct")
    problems = [
        cpt.RadiationProblem(body=body, radiating_dof=dof, omega=1.0, free_surface=np.inf, rho=1.0)
        for dof in body.dofs
    ]
    results = solver.solve_all(problems, keep_details=False, progress_bar=False)
    found = np.array([r.added_masses[dof] for r, dof in zip(results, body.dofs, strict=True)])
    if not np.isfinite(found).all():
        raise SystemExit(f"box of {sides}: capytaine gave no numbers for {mesh.nb_faces} panels (memory?)")
    volume, squares = sides.prod(), sides**2
    return found / volume / np.concatenate([np.ones(3), (squares.sum() - squares) / 12]), mesh.nb_faces


def _quarter(half: Array, cells: int) -> tuple[Array, NDArray[np.int64]]:
    """Quadrilaterals of the part of a box with positive x and y."""
    counts = [max(cells // 2, round(cells * float(np.sqrt(h / half.max())))) for h in half]
    lines = [h * (1 - (1 - np.linspace(0, 1, n + 1)) ** 3) for h, n in zip(half, counts, strict=True)]
    lines[2] = np.concatenate([-lines[2][::-1], lines[2][1:]])
    vertices: list[Any] = []
    faces: list[Any] = []
    for axis, place in ((0, half[0]), (1, half[1]), (2, half[2]), (2, -half[2])):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        grid = np.meshgrid(lines[u], lines[v], indexing="ij")
        points = np.full((*grid[0].shape, 3), place)
        points[..., u], points[..., v] = grid
        at = np.arange(grid[0].size).reshape(grid[0].shape) + sum(len(p) for p in vertices)
        corners = [at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]]
        order = corners if place > 0 else corners[::-1]
        vertices.append(points.reshape(-1, 3))
        faces.append(np.stack(order, axis=-1).reshape(-1, 4))
    return np.concatenate(vertices), np.concatenate(faces)


def extrapolated(sides: Array) -> tuple[Array, float, int]:
    """Coefficients for endlessly small panels, the relative error of the worst, and the most panels."""
    coarse, middle, fine = (coefficients(sides, n) for n in CELLS)
    found = fine[0] + (fine[0] - middle[0]) / (2**ORDER - 1)
    before = middle[0] + (middle[0] - coarse[0]) / (2**ORDER - 1)
    return found, float(np.max(np.abs(before / found - 1))), fine[1]


def main(arguments: list[str] | None = None) -> int:
    """Write the table; some ten minutes."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.shape.box_table", description=__doc__)
    parser.add_argument("--out", type=Path, default=OUT, help="default: %(default)s")
    out: Path = parser.parse_args(arguments).out
    tell, rows, most = progress_line("boxes"), [], 0
    for i, (longer, wider) in enumerate(pairs := [(a, b) for a in RATIOS for b in RATIOS]):
        tell(i / len(pairs), f"{longer:.3g} x {wider:.3g}")
        found, error, panels = extrapolated(np.array([longer * wider, wider, 1.0]))
        most = max(most, panels)
        rows.append(",".join(f"{x:.6g}" for x in (longer, wider, *found)) + f",{error:.1g}")
    clear()
    head = HEAD.format(version=load_capytaine().__version__, most=most, order=ORDER)
    write_whole(out, head + "\n".join([COLUMNS, *rows]) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
