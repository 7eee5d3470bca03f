"""Pictures of the model ship's page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from undertow.figures import AFTER, BEFORE, figure, look, save_png
from undertow.identification.comparison import Comparison, compare
from undertow.identification.logs.run import Run
from undertow.identification.report.page import curves, errors_by_regime, leading, traces
from undertow.identification.report.pictures import error_map, measured_vs_simulated, residual_against

from . import cse1 as set_
from .calls import Caller, Judged
from .drawing import part
from .variants import runs_of, vehicle_of

NAMES = ("cse1-joystick.png", "cse1-positioning.png", "cse1-waves.png", "cse1-residual.png", "cse1-map.png")
_SHOWN = 60.0  # s of a run that a picture can hold
_LABELS = {
    "z": "heave z",
    "phi": "roll phi",
    "theta": "pitch theta",
    "x": "north x",
    "y": "east y",
    "psi": "heading",
}


def draw(call: Caller, vehicles: Sequence[Path], images: Path) -> None:
    """Write all pictures; `vehicles` are the models that came out of `WAYS`."""
    joystick = _judged(set_.WAYS[0], vehicles[0], call.data)
    positioning = _judged(set_.WAYS[4], vehicles[4], call.data)
    names = ("as stated", "after the diagnosis")
    for (before, after), start, name in ((joystick, 150.0, NAMES[0]), (positioning, 500.0, NAMES[1])):
        save_png(
            measured_vs_simulated(
                part(traces(before, after)[0], start, start + _SHOWN, ("u", "v", "r")), names
            ),
            images / name,
        )
    spectra = {name: set_.spectrum(set_.read(call.data, set_.DP_3, w)) for name, w in set_.PARTS.items()}
    save_png(waves(spectra), images / NAMES[2])
    save_png(_residual(*joystick, names), images / NAMES[3])
    save_png(error_map(errors_by_regime(*joystick), names), images / NAMES[4])


def _judged(way: Judged, after: Path, data: Path) -> tuple[Comparison, Comparison]:
    """The validation log by the model as stated and by the one that a diagnosis left."""
    stated = vehicle_of(way.vehicle)
    runs: list[Run] = runs_of(way, data, stated, held=True)
    return compare(stated, runs), compare(vehicle_of(after), runs)


def _residual(before: Comparison, after: Comparison, names: tuple[str, str]) -> Figure:
    return residual_against(leading(curves(before, after), "surge", 6), names)


def waves(spectra: dict[str, dict[str, tuple[set_.Array, set_.Array]]]) -> Figure:
    """Power density of every pose channel, before and in the waves."""
    with look():
        picture, axes = figure(4.8, 2, 3, sharex=True)
        for axis, (channel, unit) in zip(axes.ravel(), set_.CHANNELS.items(), strict=True):
            for part_, colour in (("calm", AFTER), ("waves", BEFORE)):
                frequency, density = spectra[part_][channel]
                axis.semilogy(frequency[1:], density[1:], color=colour, label=part_)
            axis.set_xlim(0, 3)
            axis.set_ylabel(f"{_LABELS[channel]} [{unit}²/Hz]")
            axis.grid()
        for axis in axes[-1]:
            axis.set_xlabel("frequency [Hz]")
        handles, labels = axes[0, 0].get_legend_handles_labels()
        picture.legend(handles, labels, loc="outside upper left", ncols=2)
    return picture
