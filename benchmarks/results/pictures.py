"""Pictures of docs/results.md."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from undertow.figures import AFTER, BEFORE, INK, figure, look, save_png
from undertow.identification.report.pictures import measured_vs_simulated

from .basin import Basin, drag
from .cse1 import Direction, shown_run

NAMES = ("results-cse1-run.png", "results-cse1-drag.png")
_COLOURS = (BEFORE, AFTER)


def draw(directions: list[Direction], basin: Basin, folder: Path) -> None:
    """Write both pictures into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    names = ("model as it is, refitted", "with " + " + ".join(directions[0].best.effects))
    save_png(measured_vs_simulated(shown_run(directions[0]), names), folder / NAMES[0])
    save_png(drag_picture(directions, basin), folder / NAMES[1])


def drag_picture(directions: list[Direction], basin: Basin) -> Figure:
    """Identified drag over the speeds that occur in the logs, beside the points of the towing tests."""
    with look():
        picture, axes = figure(4.0, 1, 2)
        for axis, direction, points, motion in zip(
            axes[0], "uv", (basin.surge, basin.sway), ("surge", "sway"), strict=True
        ):
            _panel(axis, directions, direction, points)
            axis.set_xlabel(f"{motion} velocity {direction} [m/s]")
            axis.set_ylabel(f"{motion} force of drag [N]")
            axis.grid()
        handles, labels = axes[0, 0].get_legend_handles_labels()
        picture.legend(handles, labels, loc="outside upper left", ncols=3)
    return picture


def _panel(axis: Any, directions: list[Direction], direction: str, points: np.ndarray) -> None:
    axis.plot(*points.T, "o", color=INK, markersize=3.5, label="towing tests")
    for d, colour in zip(directions, _COLOURS, strict=True):
        # Only as fast as the ship went in the run that was fitted to.
        fastest = float(np.nanquantile(np.abs(d.train.channels[direction]), 0.995))
        speeds = np.linspace(-fastest, fastest, 81)
        axis.plot(
            speeds,
            drag(d.best.vehicle, direction, speeds),
            color=colour,
            label=f"identified on {d.train.name}",
        )
