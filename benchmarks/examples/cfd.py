"""A box pushed through water by a flow solver: a wake with a memory, and no noise."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from undertow.figures import AFTER, BEFORE, FAINT, INK, figure, look, save_png
from undertow.identification.comparison import Comparison, compare
from undertow.identification.report.page import traces
from undertow.identification.report.pictures import measured_vs_simulated
from undertow.model.vehicle import Vehicle

from . import tables
from .calls import Caller, Judged, Reported
from .variants import runs_of, vehicle_of

FOLDER = "cfd-surge"
VEHICLE = "box-hull"
MAPPING = "src/undertow/demo_data/cfd-surge/log.toml"
STEP, MULTISTEP, FINE = "surge_step_coarse.csv", "surge_multistep_coarse.csv", "surge_step_medium.csv"
#: Effects added by hand, whatever the verdict.
BY_HAND = ("radiation_memory", "drag_asymmetry", "constant_force")
#: Added mass of the box by boundary elements and by small oscillations in the same solver, kg.
ADDED_MASS = (20.4, 21.1)
NAMES = ("cfd-run.png", "cfd-force.png")


def both(one: str, other: str) -> tuple[Judged, Judged]:
    """Identify on one profile and judge on the other, and the other way round."""
    name = lambda file: file.removeprefix("surge_").removesuffix(".csv")  # noqa: E731
    first, second = (
        Judged(f"{name(a)} → {name(b)}", VEHICLE, MAPPING, (a,), (b,))
        for a, b in ((one, other), (other, one))
    )
    return first, second


WAYS = (*both(STEP, MULTISTEP), *both(STEP, FINE))


def work(call: Caller, images: Path) -> Reported:
    """Everything that takes time."""
    logs = {name[6:-4]: Judged("", VEHICLE, MAPPING, (name,)) for name in (STEP, MULTISTEP, FINE)}
    compared = {name: tables.comparison_kept(call.compare(what)) for name, what in logs.items()}
    diagnoses = [tables.diagnosis_kept(call.diagnose(way)[0]) for way in WAYS]
    hand = [model for way in WAYS[:2] for model in by_hand(call, way)]
    stated, memory = vehicle_of(VEHICLE), hand[1][1]
    runs = runs_of(WAYS[0], call.data, stated, held=True)
    before, after = (compare(model, runs) for model in (stated, memory))
    names = ("as stated", f"with {BY_HAND[0]}")
    save_png(measured_vs_simulated(traces(before, after, free=True)[0], names), images / NAMES[0])
    save_png(force(before, after, names), images / NAMES[1])
    return {"compared": compared, "diagnoses": diagnoses, "by_hand": tables.rounded([row for row, _ in hand])}


def by_hand(call: Caller, way: Judged) -> Iterator[tuple[Reported, Vehicle]]:
    """The model as it is and with every effect that is added by hand, refitted, and judged 5 s ahead."""
    fitted = vehicle_of(call.fit(way))
    yield _row(call, way, fitted, {"effect": "", "command": ""}), fitted
    for effect in BY_HAND:
        reported, file = call.add(effect, way)
        model = vehicle_of(file)
        yield _row(call, way, model, {"effect": effect, **reported}), model


def _row(call: Caller, way: Judged, model: Vehicle, reported: Reported) -> Reported:
    values = {n: v.value for n, v in model.values.items() if v.estimate}
    ahead = compare(model, runs_of(way, call.data, model, held=True)).result.prediction_error
    return {"way": way.title, "ahead": ahead, "values": values, **reported}


def force(before: Comparison, after: Comparison, names: tuple[str, str]) -> Figure:
    """The push, and what both models lack of the force along a run."""
    with look():
        picture, axes = figure(4.6, 2, sharex=True)
        push = before.forces.wrenches["generalised_force"][:, 0]
        axes[0, 0].plot(before.forces.t, push, color=INK)
        axes[0, 0].set_ylabel("push [N]")
        for comparison, name, colour in ((before, names[0], BEFORE), (after, names[1], AFTER)):
            axes[1, 0].plot(comparison.forces.t, comparison.forces.missing[:, 0], color=colour, label=name)
        axes[1, 0].axhline(0.0, color=FAINT, linewidth=0.8)
        axes[1, 0].set_ylabel("model lacks [N]")
        axes[1, 0].set_xlabel("time [s]")
        limit = float(np.quantile(np.abs(before.forces.missing[:, 0]), 0.99))
        axes[1, 0].set_ylim(-1.3 * limit, 1.3 * limit)
        for axis in axes[:, 0]:
            axis.grid()
        picture.legend(loc="outside upper left", ncols=2)
    return picture
