"""First part of the demo: an AUV in a current that its model does not have."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from undertow.cli._outcome import write_vehicle
from undertow.cli._progress import progress
from undertow.cli._vehicle_and_logs import load
from undertow.identification.compare.comparison import compare
from undertow.identification.diagnosis.addition import add_effect, lay_ground
from undertow.identification.diagnosis.diagnose import diagnose
from undertow.identification.report import (
    error_map,
    falling_error,
    measured_vs_simulated,
    render_report,
    residual_against,
)
from undertow.model.catalogue import catalogue
from undertow.model.symbols import VELOCITY

from .scene import DATA, Scene, report_data_of

if TYPE_CHECKING:
    from undertow.cli._vehicle_and_logs import Loaded
    from undertow.identification.diagnosis.diagnose import Outcome
    from undertow.identification.report import ReportData, RunTraces

_FOLDER = DATA / "auv"


def tell_auv(scene: Scene) -> None:
    """Where the model fails, what it lacks, and how the error falls."""
    scene.title("1. An AUV whose model lacks something")
    runs = [_FOLDER / f"train_{i}.csv.gz" for i in (1, 2, 3)]
    loaded = load(str(_FOLDER / "vehicle.toml"), runs, [_FOLDER / "holdout.csv.gz"])
    scene.say(
        "A small AUV with four thrusters was logged in three runs of a minute; a fourth run is kept aside. "
        "Its vehicle file has mass, added mass, damping and restoring, with guesses good to 15 %."
    )
    comparison = compare(loaded.vehicle, loaded.holdout, compiled=False)
    scene.say(f"Where the model fails on the kept-aside run: it {comparison.result.headline}.")
    with progress("looking for what is missing") as report:
        outcome = diagnose(loaded.vehicle, loaded.train, loaded.holdout, report=report)
    _verdict(scene, outcome)
    _pictures(scene, outcome)
    if outcome.diagnosis.effects:
        _added(scene, loaded, outcome)
    _truth(scene)


def _verdict(scene: Scene, outcome: Outcome) -> None:
    d = outcome.diagnosis
    scene.say(
        f"Every effect of the catalogue that could be added was tried ({len(d.ranking)} of them), each "
        f"refitted with the rest of the model. Verdict: {d.headline}"
    )
    for p in d.parameters:
        if p.effect in d.effects:
            error = "" if p.standard_error is None else f" ± {p.standard_error:.1g}"
            scene.say(f"{p.effect}: {p.name} = {p.value:.4f}{error} {p.unit}")
    for warning in d.warnings:
        scene.say(f"Without it, the fit had bent the model: {warning}.")
    scene.text("auv/diagnosis.json", d.model_dump_json(indent=1) + "\n", "the diagnosis, for programs")


def _pictures(scene: Scene, outcome: Outcome) -> None:
    data = report_data_of(outcome)
    names = (data.before, data.after)
    scene.text("auv/report.html", render_report(outcome.diagnosis, data), "the full report")
    drawn = {
        "error-map": (error_map(data.maps[0], names), "where force is missing, by motion and regime"),
        "measured-vs-simulated": (
            measured_vs_simulated(_velocities(data.runs[0]), names),
            "the kept-aside run, simulated from its commands alone",
        ),
        "residual-force": (_sway(data, names), "force that the model lacks in sway, against the variables"),
    }
    for name, (picture, what) in drawn.items():
        scene.picture(f"auv/{name}.png", picture, what)


def _velocities(run: RunTraces) -> RunTraces:
    return replace(run, traces=tuple(t for t in run.traces if t.channel in VELOCITY))


def _sway(data: ReportData, names: tuple[str, str]) -> Any:
    return residual_against([c for c in data.residuals if c.degree_of_freedom == "sway"], names)


def _added(scene: Scene, loaded: Loaded, outcome: Outcome) -> None:
    """The effect goes into a new vehicle file, and the error falls."""
    d = outcome.diagnosis
    write_vehicle(outcome, loaded.path, scene.path("auv/vehicle.toml"), "undertow demo")
    scene.mention("auv/vehicle.toml", f"the vehicle file with {' and '.join(d.effects)} in it")
    ground = lay_ground(loaded.vehicle, loaded.train, loaded.holdout)
    addition = add_effect(catalogue()[d.effects[0]], ground)
    names = ("model as given", "refitted", f"with {addition.effect}")
    rows = [
        (name, f"{step.error:.3g}", f"{step.prediction or 0.0:.1%}")
        for name, step in zip(names, addition.steps, strict=True)
    ]
    scene.say("The error on the kept-aside run falls (1 is the noise of the sensors):")
    scene.table(("model", "error / noise", "velocity error 5 s ahead"), rows)
    scene.picture("auv/falling-error.png", falling_error(addition.steps), "the error on the kept-aside run")


def _truth(scene: Scene) -> None:
    """What was hidden, read only now that all has been said."""
    values = json.loads((_FOLDER / "truth.json").read_text(encoding="utf-8"))["values"]
    hidden = "; ".join(
        f"{effect} with {', '.join(f'{name} = {value:.4f}' for name, value in own.items())}"
        for effect, own in values.items()
    )
    scene.say(f"To check: the log was simulated, apart from undertow's own models, with {hidden} (m/s).")
