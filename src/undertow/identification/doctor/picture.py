"""Pose rates against body velocities, as given and with the mistakes undone."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from undertow.errors import UndertowError
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from ..logs.run import UNITS
from ..report.style import AFTER, BEFORE, FAINT, figure, look, plain
from .examine import Examined
from .findings import percent
from .kinematics import Kinematics

_MOST = 1500
_HEIGHT = 2.5
_OUTLIERS = 0.002


def rates_picture(examined: Examined, vehicle: Vehicle) -> Figure:
    """One row for each pose coordinate: rate of the pose against what the velocities make of it.

    Raises
    ------
    UndertowError
        If the logs have no pose with a velocity of its own.
    """
    kinematics = Kinematics(examined.given, vehicle)
    if not kinematics:
        raise UndertowError(
            f"no picture: the logs of '{vehicle.name}' have no pose with a measured velocity beside it"
        )
    pairs = [("as given", examined.given, BEFORE)]
    if examined.edits:
        pairs.append(("mistakes undone", examined.mended, AFTER))
    with look():
        picture, axes = figure(_HEIGHT * len(kinematics.rows) + 0.5, len(kinematics.rows), len(pairs))
        for column, (title, runs, colour) in enumerate(pairs):
            rates = kinematics.rates(runs)
            share = kinematics.of_rates(rates).share
            for row, name in enumerate(kinematics.rows):
                block = next(i for i, b in enumerate(kinematics.blocks) if row in b)
                heading = f"{title}: mismatch {percent(share[block])}"
                _panel(axes[row, column], (rates.velocity[:, row], rates.pose[:, row]), name, heading, colour)
    return picture


def _panel(axis: Any, points: tuple[Array, Array], name: str, title: str, colour: str) -> None:
    step = max(1, len(points[0]) // _MOST)
    x, y = (p[::step] for p in points)
    low, high = (float(np.quantile(np.concatenate([x, y]), q)) for q in (_OUTLIERS, 1 - _OUTLIERS))
    margin = 0.05 * (high - low) or 1.0
    ends = (low - margin, high + margin)
    axis.plot(ends, ends, color=FAINT, linestyle="--", zorder=1)
    axis.scatter(x, y, s=5, color=colour, alpha=0.5, linewidths=0, zorder=2)
    axis.set_xlim(*ends)
    axis.set_ylim(*ends)
    unit = f"{UNITS[name]}/s"
    axis.set_xlabel(f"from the velocities [{unit}]")
    axis.set_ylabel(f"rate of {plain(name)} [{unit}]")
    axis.set_title(title)
    axis.grid(visible=True)
