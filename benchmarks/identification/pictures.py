"""Bias and spread of the estimators."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from undertow.figures import AFTER, BEFORE, INK, figure, look, save_png

from .profile import EXACT
from .study import OUTPUT, RULE, WEAK, Level
from .variables import METHODS, SMOOTHED, SQUARES, Bias

_SHOWN = (*(f"case {n}" for n in range(1, 12)), RULE, WEAK, OUTPUT)
_UNITS = ("m_x [kg]", "X_u|u| [kg/m]")


def draw(level: Level, target: Path) -> None:
    """Mean and standard deviation of every estimator beside the truth, as PNG."""
    target.parent.mkdir(parents=True, exist_ok=True)
    save_png(spread(level), target)


def spread(level: Level) -> Figure:
    """Two panels: mass with added mass, and quadratic drag."""
    with look():
        picture, axes = figure(4.6, 1, 2)
        places = np.arange(len(_SHOWN))[::-1]
        for axis, column, label in zip(axes[0], (0, 2), _UNITS, strict=True):
            for place, method in zip(places, _SHOWN, strict=True):
                found = level.estimates[method][:, column]
                colour = AFTER if method in (WEAK, OUTPUT) else BEFORE
                axis.errorbar(
                    np.nanmean(found), place, xerr=np.nanstd(found), fmt="o", color=colour, capsize=3
                )
            axis.axvline(EXACT[column], color=INK, linewidth=1)
            axis.set_xlabel(f"{label}: mean and standard deviation; line: truth")
            axis.set_yticks(places, _SHOWN if axis is axes[0, 0] else [""] * len(_SHOWN))
            axis.grid(axis="x")
    return picture


def draw_biases(found: Sequence[Bias], target: Path) -> None:
    """Bias of the quadratic drag against noise, and against an unknown current, as PNG."""
    target.parent.mkdir(parents=True, exist_ok=True)
    save_png(against_noise(found), target)


def against_noise(found: Sequence[Bias]) -> Figure:
    """Two panels: mass with added mass, and quadratic drag, over the noise of the velocity."""
    with look():
        picture, axes = figure(3.6, 1, 2)
        for axis, column, label in zip(axes[0], (0, 2), ("m_x", "X_u|u|"), strict=True):
            for method, marker in zip(METHODS, "sv^od", strict=True):
                one = [b for b in found if b.method == method and not b.current]
                colour = BEFORE if method in (SQUARES, SMOOTHED) else AFTER
                axis.errorbar(
                    [100 * b.noise for b in one],
                    [b.mean[column] for b in one],
                    yerr=[b.unsure[column] for b in one],
                    fmt=f"{marker}-",
                    color=colour,
                    markersize=4,
                    linewidth=1,
                    label=method,
                )
            axis.axhline(0.0, color=INK, linewidth=0.8)
            axis.set_xlabel("noise of the velocity, % of its rms")
            axis.set_ylabel(f"bias of {label} [%]")
        axes[0, 1].legend(fontsize=7, loc="lower left")
    return picture
