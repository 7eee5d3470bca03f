"""Pictures of a tank: a section of the grid around the hull with the speed of the water, and the forces."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from undertow.errors import UndertowError
from undertow.figures import AFTER, BEFORE, FAINT, INK, figure, look
from undertow.model.symbols import DOFS
from undertow.typing import Array, Integers

from .case import section_axis
from .coefficients import Coefficient
from .records import Record, read_record
from .settings import Case, Tank, folder_of, log_of

_NAMES = ("x", "y", "z")
_AROUND = 1.2  # longest sides of the hull that a picture shows to each side of it


def read_section(folder: Path) -> tuple[float, Array, Integers, Array]:
    """The latest section: its time, s; points (n, 3), m; triangles (k, 3); speeds of the water (k,), m/s."""
    files = sorted(folder.glob("postProcessing/section/*/*.vtk"), key=lambda p: float(p.parent.name))
    if not files:
        raise UndertowError(f"{folder}: no section yet: undertow tank run writes some")
    try:
        points, polygons, speeds = _vtk(files[-1].read_text(encoding="utf-8"))
    except (OSError, ValueError, IndexError) as error:
        raise UndertowError(
            f"{files[-1]}: not a section as the solver writes it: run the tank again"
        ) from error
    return float(files[-1].parent.name), points, polygons, speeds


def _vtk(text: str) -> tuple[Array, Integers, Array]:
    """Points, triangles and speeds in their middles out of a legacy VTK file of polygons in ASCII."""
    words = text.split()
    start = words.index("POINTS")
    count = int(words[start + 1])
    points = np.array(words[start + 3 : start + 3 + 3 * count], dtype=float).reshape(-1, 3)
    start = words.index("POLYGONS")
    total = int(words[start + 2])
    polygons = np.array(words[start + 3 : start + 3 + total], dtype=int).reshape(-1, 4)[:, 1:]
    start = words.index("U", start)
    count = int(words[start + 2])
    vectors = np.array(words[start + 4 : start + 4 + 3 * count], dtype=float).reshape(-1, 3)
    return points, polygons, np.linalg.norm(vectors, axis=1)


def picture(root: Path, tank: Tank, case: Case, grid: int, found: list[Coefficient]) -> Figure:
    """Section, force and speed of a case on a grid; `found` are coefficients whose force is drawn beside."""
    log = log_of(root, case, grid)
    record = read_record(log, grid) if log.is_file() else None
    with look():
        drawn = figure(7.2, 2 if record else 1, 1, height_ratios=[2.2, 1] if record else None)
        result, axes = drawn
        result.set_facecolor("white")
        _draw_section(result, axes[0, 0], root, tank, case, grid)
        if record:
            _draw_history(axes[1, 0], record, case, [c for c in found if c.motion == case.motion])
    return result


def _draw_section(result: Figure, axes: Any, root: Path, tank: Tank, case: Case, grid: int) -> None:
    time, points, polygons, speeds = read_section(folder_of(root, case, grid))
    normal = section_axis(case.motion)
    one, two = [i for i in range(3) if i != normal]
    corners = points[polygons][:, :, [one, two]]
    centre = _centre(root, case, grid, time)[[one, two]]
    cells = PolyCollection(list(corners), array=speeds, cmap="viridis", edgecolors="face", linewidths=0.3)
    axes.add_collection(cells)
    # Half of the grid as lines: flow and grid are both to be seen.
    lower = corners[corners[:, :, 1].mean(axis=1) > centre[1]]
    axes.add_collection(PolyCollection(list(lower), facecolors="none", edgecolors="white", linewidths=0.15))
    for i, set_limits in enumerate((axes.set_xlim, axes.set_ylim)):
        low, high = points[:, (one, two)[i]].min(), points[:, (one, two)[i]].max()
        reach = _AROUND * tank.size * (1.0 if i == 0 else 0.6)
        set_limits(max(low, centre[i] - reach), min(high, centre[i] + reach))
    axes.set_aspect("equal")
    if two == 2:
        axes.invert_yaxis()  # z points down
    axes.set(xlabel=f"{_NAMES[one]} / m", ylabel=f"{_NAMES[two]} / m")
    axes.set_title(f"{case.name}, grid {grid}: speed of the water at t = {time:.4g} s")
    result.colorbar(cells, ax=axes, label="m/s", shrink=0.8)


def _centre(root: Path, case: Case, grid: int, time: float) -> Array:
    """Where the hull is, m, shape (3,)."""
    result, log = np.zeros(3), log_of(root, case, grid)
    if log.is_file() and DOFS.index(case.motion) < 3:
        record = read_record(log, grid)
        result[DOFS.index(case.motion)] = np.interp(time, record.time, record.place)
    return result


def _draw_history(axes: Any, record: Record, case: Case, found: list[Coefficient]) -> None:
    turns = DOFS.index(case.motion) > 2
    axes.plot(record.time, record.water, color=AFTER, label="of the water on the hull")
    if found:
        axes.plot(record.time, _model(record, found), color=BEFORE, ls="--", label="by the coefficients")
    axes.axhline(0.0, color=FAINT, lw=0.6)
    axes.set(xlabel="t / s", ylabel="moment / (N m)" if turns else "force / N")
    axes.set_title("Force and speed" if not turns else "Moment and rate")
    other = axes.twinx()
    other.plot(record.time, record.speed, color=INK, lw=0.9, ls=":", label="speed (right)")
    other.set_ylabel("rad/s" if turns else "m/s")
    other.spines["right"].set_visible(True)
    lines = axes.get_lines()[: 1 + bool(found)] + other.get_lines()
    axes.legend(handles=lines, loc="upper center", bbox_to_anchor=(0.5, -0.22), ncols=3)


def _model(record: Record, found: list[Coefficient]) -> Array:
    """Force of the water by the coefficients."""
    total = np.zeros(len(record.time))
    for c in found:
        own = np.ones(len(total)) if not c.direction else record.speed * c.direction > 0
        of = record.acceleration if "dot" in c.name else record.speed
        total -= own * c.value * (np.abs(record.speed) * record.speed if "abs" in c.name else of)
    return total
