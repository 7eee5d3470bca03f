"""Pictures of the page on the ROV at sea."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from undertow.figures import AFTER, BEFORE, FLOOR, INK, figure, look, save_png
from undertow.identification.comparison import Comparison
from undertow.identification.logs.run import Run
from undertow.identification.report.page import errors_by_regime, traces
from undertow.identification.report.pictures import error_map, measured_vs_simulated
from undertow.model.symbols import FORCE_UNITS

from . import sf30k as set_
from .drawing import part

NAMES = ("sf30k-thrust.png", "sf30k-run.png", "sf30k-map.png", "sf30k-doppler.png")
_MINUTES = (1010.0, 1130.0)  # s
_MODELS = ("as published", list(set_.BY_HAND)[-1])


def draw(before: Comparison, after: Comparison, run: Run, images: Path) -> None:
    """Write all pictures; both comparisons are of the model in four degrees of freedom."""
    save_png(thrust(before), images / NAMES[0])
    save_png(
        measured_vs_simulated(part(traces(before, after)[0], *_MINUTES, ("u", "v", "w", "r")), _MODELS),
        images / NAMES[1],
    )
    save_png(error_map(errors_by_regime(before, after), _MODELS), images / NAMES[2])
    save_png(doppler(run), images / NAMES[3])


def thrust(comparison: Comparison) -> Figure:
    """Force that the motion needs by the published model against the force that is commanded."""
    dofs = comparison.result.degrees_of_freedom
    with look():
        picture, axes = figure(3.0, 1, len(dofs))
        for i, (axis, dof) in enumerate(zip(axes[0], dofs, strict=True)):
            _needed(axis, comparison, i)
            unit = FORCE_UNITS[comparison.vehicle.dof_indices[i]]
            axis.set_title(dof)
            axis.set_xlabel(f"commanded [{unit}]")
            axis.set_ylabel(f"needed [{unit}]")
        handles, labels = axes[0, 0].get_legend_handles_labels()
        picture.legend(handles, labels, loc="outside upper left", ncols=3)
    return picture


def _needed(axis: Any, comparison: Comparison, i: int) -> None:
    drive, needed = set_.steady(comparison, i)
    reach = np.array([np.nanmin(drive), np.nanmax(drive)])
    slope, offset = set_.line(drive, needed)
    axis.plot(drive, needed, "o", color=INK, markersize=3.5, label=f"means over {set_.STEADY:g} s")
    axis.plot(reach, reach, color=FLOOR, linestyle="--", label="all of it arrives")
    axis.plot(reach, slope * reach + offset, color=BEFORE, label="best line")
    axis.grid()


def doppler(run: Run) -> Figure:
    """What the Doppler log reads beyond the rate of the position fixes, against the yaw rate."""
    yaw, ahead, aside = set_.excess(run)
    published = (-set_.DOPPLER_LOG["y_s"], set_.DOPPLER_LOG["x_s"])
    with look():
        picture, axes = figure(3.2, 1, 2)
        for axis, values, slope, name in zip(axes[0], (ahead, aside), published, ("u", "v"), strict=True):
            good = np.isfinite(yaw) & np.isfinite(values)
            reach = np.array([yaw[good].min(), yaw[good].max()])
            middle = float(np.median(values[good] - slope * yaw[good]))
            axis.plot(yaw, values, "o", color=INK, markersize=3, label="means over 4 s")
            axis.plot(
                reach,
                slope * reach + middle,
                color=AFTER,
                label="slope from the published place of the sensor",
            )
            axis.set_ylim(-0.2, 0.2)
            axis.set_xlabel("yaw rate [rad/s]")
            axis.set_ylabel(f"{name} beyond rate of position [m/s]")
            axis.grid()
        handles, labels = axes[0, 0].get_legend_handles_labels()
        picture.legend(handles, labels, loc="outside upper left", ncols=2)
    return picture
