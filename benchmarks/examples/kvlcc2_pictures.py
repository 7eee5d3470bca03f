"""Pictures of the roll decay page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from undertow.figures import AFTER, BEFORE, FLOOR, INK, figure, look, save_png
from undertow.identification.comparison import Comparison, compare
from undertow.identification.logs.run import Run
from undertow.identification.report.page import curves, leading, traces
from undertow.identification.report.pictures import measured_vs_simulated, residual_against
from undertow.model.vehicle import Vehicle

from . import kvlcc2 as set_
from .drawing import part

Array = NDArray[np.float64]
NAMES = ("kvlcc2-swings.png", "kvlcc2-run.png", "kvlcc2-residual.png")
# Where errors of the period have added up, s.
_LAST = (71.0, 91.0)
_FROM = "21338 → 21337"
_LOOKS = (("o", INK), ("s", FLOOR), ("^", BEFORE))
# Under way the towing carriage brakes at the end.
_ENDS = {"model_test_21337": 91.0, "model_test_21338": 194.0, "model_test_21340": 76.0}


def draw(data: Path, vehicles: dict[str, Vehicle], images: Path) -> None:
    """Write all pictures."""
    linear, best = vehicles[f"{_FROM}: linear"], vehicles[f"{_FROM}: {set_.BEST}"]
    tests = [set_.read([f"{name}.csv"], data, (set_.WINDOW[0], end))[0] for name, end in _ENDS.items()]
    save_png(swings(tests, linear, best), images / NAMES[0])
    held = set_.read([set_.STILL], data, set_.WINDOW)
    before, after = compare(linear, held), compare(best, held)
    names = ("linear damping", set_.BEST)
    save_png(
        measured_vs_simulated(part(traces(before, after, free=True)[0], *_LAST, ("phi", "p")), names),
        images / NAMES[1],
    )
    save_png(_residual(before, after, names), images / NAMES[2])


def _residual(before: Comparison, after: Comparison, names: tuple[str, str]) -> Figure:
    chosen = [c for c in leading(curves(before, after), "roll") if c.before.variable in ("phi", "p")]
    picture = residual_against(chosen, names)
    for axis in picture.axes:
        axis.locator_params(axis="x", nbins=5)
    return picture


def swings(tests: list[Run], linear: Vehicle, best: Vehicle) -> Figure:
    """Period and damping of every swing against its amplitude, measured and by two models."""
    with look():
        picture, axes = figure(4.2, 1, 2)
        for run, (marker, colour) in zip(tests, _LOOKS, strict=True):
            _measured(axes[0], run, marker, colour)
        reach = np.radians(np.linspace(0.5, 9.5, 60))
        for vehicle, name, colour in ((linear, "linear damping", BEFORE), (best, set_.BEST, AFTER)):
            axes[0, 0].plot(np.degrees(reach), set_.period(vehicle, reach), color=colour, label=name)
            axes[0, 1].plot(np.degrees(reach), damping_ratio(vehicle, reach), color=colour, label=name)
        for axis, title in zip(axes[0], ("period of a swing [s]", "damping ratio"), strict=True):
            axis.set_xlabel("amplitude [deg]")
            axis.set_ylabel(title)
            axis.grid()
        handles, labels = axes[0, 0].get_legend_handles_labels()
        picture.legend(handles, labels, loc="outside upper left", ncols=3)
    return picture


def _measured(axes: Any, run: Run, marker: str, colour: str) -> None:
    _, height, period = set_.swings(run)
    lost = np.log(height[:-1] / height[1:]) / (2 * np.pi)
    how = {"linestyle": "none", "marker": marker, "color": colour, "markersize": 3.5}
    under_way = " (15.5 kn)" if run.name.endswith("40") else ""
    axes[0].plot(np.degrees(height), period, label=f"test {run.name[-5:]}{under_way}", **how)
    axes[1].plot(np.degrees((height[:-1] + height[1:]) / 2), lost, **how)


def damping_ratio(vehicle: Vehicle, amplitude: Array) -> Array:
    """Damping ratio that takes as much energy out of a sinusoidal swing as the damping laws do."""
    value = lambda n: vehicle.value_of(n).value if n in vehicle.values else 0.0  # noqa: E731
    rate = 2 * np.pi / set_.period(vehicle, amplitude)
    peak = rate * amplitude
    moment = value("K_p") + 8 / (3 * np.pi) * peak * value("K_pabsp") + 0.75 * peak**2 * value("K_ppp")
    return np.asarray(-moment / (2 * (value("I_x") - value("K_pdot")) * rate))
