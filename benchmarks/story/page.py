"""The page of the story: words, what the commands said, and a picture."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from undertow.figures import AFTER, BEFORE, FAINT, FLOOR, INK, figure, look
from undertow.shape.mesh import read_hull
from undertow.tank.coefficients import coefficients, read_record
from undertow.tank.settings import log_of, read_tank
from undertow.typing import Array

from ..shell import Said, block

TEXT = Path(__file__).parent / "page.md"
SHOWN = {"first flight": 2, "diagnosis": 15, "added": 12}


def page(said: dict[str, Said]) -> str:
    """The whole page: each command in its place in the text."""
    text = TEXT.read_text(encoding="utf-8")
    for name, answer in said.items():
        text = text.replace(f"{{{name}}}", _shown(name, answer))
    return text


def _shown(name: str, answer: Said) -> str:
    if name.startswith("gains"):
        return block(_verdict(answer)).rstrip()
    return block(answer, SHOWN.get(name, 40)).rstrip()


def _verdict(answer: Said) -> Said:
    """The first line of `gains`, the region, and what is outside the conditions."""
    lines = answer.text.splitlines()
    parts = [_part(lines, head) for head in ("Certified region", "Not in the conditions")]
    return Said(
        answer.words, answer.code, "\n".join([lines[0], *(x for part in parts for x in ("...", *part))])
    )


def _part(lines: list[str], head: str) -> list[str]:
    begins = [i for i, line in enumerate(lines) if line.startswith(head)]
    if not begins:
        return []
    end = next((j for j in range(begins[0], len(lines)) if not lines[j].strip()), len(lines))
    return lines[begins[0] : end]


# --- the picture ----------------------------------------------------------------------------------
def picture(folder: Path) -> Figure:
    """Hull, tank, and the loop with both gain sets."""
    with look():
        shown, axes = figure(6.6, 2, 2)
        shown.set_facecolor("white")
        _draw_hull(axes[0, 0], folder / "hull.stl")
        _draw_tank(axes[0, 1], folder / "tank")
        first = {"on the model of the tank": ("on-model", FLOOR), "on the vehicle": ("on-vehicle", BEFORE)}
        second = {"on the complete model": ("second-on-model", FLOOR), "on the vehicle": ("second", AFTER)}
        _draw_runs(axes[1, 0], folder, "Gains for the model of the tank", first)
        _draw_runs(axes[1, 1], folder, "Gains for the complete model", second)
    return shown


def _draw_hull(axis: Any, path: Path) -> None:
    corners = read_hull(path).mesh.corners
    for across, lift, label in ((1, 0.14, "from above"), (2, -0.10, "from the side")):
        lines = corners[:, [0, 1, 2, 0]][:, :, [0, across]] * (1, -1) + (0, lift)
        axis.add_collection(LineCollection(list(lines), linewidths=0.2, colors=INK))
        axis.text(-0.42, lift + 0.10, label)
    axis.set(xlim=(-0.45, 0.45), ylim=(-0.22, 0.28), aspect="equal", xlabel="forward [m]", title="hull.stl")


_FINEST = 3  # grid on which all of surge was run


def _draw_tank(axis: Any, root: Path) -> None:
    tank = read_tank(root)
    found = {c.name: c.value for c in coefficients(root, tank) if c.motion == "surge" and c.direction >= 0}
    case = next(c for c in tank.cases if c.name == "surge-step-forward")
    r = read_record(log_of(root, case, _FINEST), _FINEST)
    u = r.speed
    model = -(found["X_udot"] * r.acceleration + found["X_u"] * u + found["X_uabsu"] * np.abs(u) * u)
    axis.plot(r.time, 1000 * r.water, color=AFTER, label="computed water")
    axis.plot(r.time, 1000 * model, color=BEFORE, linestyle="--", label="three coefficients")
    axis.set(xlabel="time [s]", ylabel="force [mN]", title="Tank: 0.15, then 0.3 m/s")
    axis.grid()
    axis.legend()


def _draw_runs(axis: Any, folder: Path, title: str, runs: dict[str, tuple[str, str]]) -> None:
    for width, (label, (name, colour)) in zip(
        (3.5, 1.5), runs.items(), strict=True
    ):  # one may hide the other
        t, psi = _column(folder / f"{name}.csv", "psi")
        axis.plot(t, np.degrees(psi), color=colour, linewidth=width, label=label)
    axis.axhline(np.degrees(0.1), color=FAINT, linewidth=0.8)
    axis.set(xlabel="time [s]", ylabel="heading [degrees]", title=title)
    axis.grid()
    axis.margins(y=0.4)  # room for the legend
    axis.legend(loc="upper right")


def _column(path: Path, name: str) -> tuple[Array, Array]:
    with open(path, newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    return np.array([float(r["t"]) for r in rows]), np.array([float(r[name]) for r in rows])
