"""Pictures of a tank: a section of the grid around the hull with the speed of the water, and the forces."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from undertow.errors import UndertowError
from undertow.figures import AFTER, BEFORE, FAINT, INK, figure, look
from undertow.model.symbols import DOFS
from undertow.typing import Array, Integers

from .case import SECTION_AXES
from .coefficients import Coefficient, Record, read_record
from .settings import Case, Tank, folder_of, log_of

_NAMES = ("x", "y", "z")


@dataclass(frozen=True)
class PictureSettings:
    """When and where a section is shown."""

    full_speed: float = 0.999  # share of the highest speed at which a hull is as quick as it gets
    margin: float = 1.2  # longest sides of the hull that a picture shows to each side of it


SETTINGS = PictureSettings()


Section = tuple[float, Array, Integers, Array]


def read_section(folder: Path, at: float | None = None) -> Section:
    """Time, s, points (n, 3), m, triangles (k, 3), speeds (k,), m/s, of a section: at a time, or the last."""
    files = sorted(folder.glob("postProcessing/section/*/*.vtk"), key=lambda p: float(p.parent.name))
    if not files:
        raise UndertowError(f"{folder}: no section yet: undertow tank run writes some")
    if at is not None:
        files.sort(key=lambda p: -abs(float(p.parent.name) - at))
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
        rows, ratios = (2, [2.2, 1]) if record else (1, None)
        result, axes = figure(7.2, rows, height_ratios=ratios)
        result.set_facecolor("white")
        section = read_section(folder_of(root, case, grid), _at_speed(record))
        _draw_section(result, axes[0, 0], tank, case, section, record)
        axes[0, 0].set_title(
            f"{case.name}, grid {grid}: speed of the water at t = {section[0]:.4g} s, and half of the grid"
        )
        if record:
            _draw_history(axes[1, 0], record, case, [c for c in found if c.motion == case.motion])
    return result


def _draw_section(
    result: Figure, axes: Any, tank: Tank, case: Case, section: Section, record: Record | None
) -> None:
    """Half of it with the grid, half without."""
    time, points, polygons, speeds = section
    shown = [i for i in range(3) if i != SECTION_AXES[case.motion]]
    corners = points[polygons][:, :, shown]
    centre = _centre(record, case, time)[shown]
    lined = corners[corners[:, :, 1].mean(axis=1) > centre[1]]
    for i, axis in enumerate(shown):
        if _NAMES[axis] in case.planes:
            corners = np.concatenate([corners, corners * (1 - 2 * (np.arange(2) == i))])
            lined = np.concatenate([lined, lined * (1 - 2 * (np.arange(2) == i))]) if i == 0 else lined
            speeds = np.concatenate([speeds, speeds])
    cells = PolyCollection(list(corners), array=speeds, cmap="viridis", edgecolors="face", linewidths=0.3)
    axes.add_collection(cells)
    axes.add_collection(PolyCollection(list(lined), facecolors="none", edgecolors="white", linewidths=0.12))
    reach = SETTINGS.margin * tank.size * np.array([1.0, 0.6])
    axes.set(xlim=centre[0] + reach[0] * np.array([-1, 1]), ylim=centre[1] + reach[1] * np.array([-1, 1]))
    axes.set_aspect("equal")
    if shown[1] == 2:
        axes.invert_yaxis()  # z points down
    axes.set(xlabel=f"{_NAMES[shown[0]]} / m", ylabel=f"{_NAMES[shown[1]]} / m")
    result.colorbar(cells, ax=axes, label="water / (m/s)", shrink=0.8)


def _at_speed(record: Record | None) -> float | None:
    """The last time at which the hull is as quick as it gets, s: the wake is longest then."""
    if record is None:
        return None
    speed = np.abs(record.speed)
    return float(record.time[np.flatnonzero(speed >= SETTINGS.full_speed * speed.max())[-1]])


def _centre(record: Record | None, case: Case, time: float) -> Array:
    """Where the hull is, m, shape (3,)."""
    result = np.zeros(3)
    if record and DOFS.index(case.motion) < 3:
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
    other.plot(
        record.time,
        record.speed,
        color=INK,
        lw=0.9,
        ls=":",
        label="rate (right)" if turns else "speed (right)",
    )
    other.set_ylabel("rate / (rad/s)" if turns else "speed / (m/s)")
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
