"""The examples of `undertow demo`: where models fail, what they lack, how errors fall, and a towing tank."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from undertow.figures import save_png, unit_text
from undertow.files import make_folder, templates, write_whole
from undertow.identification.comparison import Forces, compare, residual_forces
from undertow.identification.diagnose import DiagnosisResult, diagnose, save_diagnosis
from undertow.identification.diagnosis.addition import (
    Addition,
    AdditionSetup,
    add_effects,
    set_up_addition,
    visible_effects,
)
from undertow.identification.logs.mapping import LogMapping, read_mapping
from undertow.identification.logs.reading import read_logs
from undertow.identification.report.page import render_report, traces
from undertow.identification.report.pictures import (
    ErrorMap,
    error_map,
    falling_error,
    measured_vs_simulated,
    residual_against,
)
from undertow.model.catalogue import catalogue
from undertow.model.loading import load_vehicle
from undertow.model.symbols import VELOCITY
from undertow.model.vehicle import Vehicle
from undertow.tank.coefficients import coefficients, tank_vehicle
from undertow.tank.settings import read_tank
from undertow.typing import Array, Progress

DATA = Path(str(files("undertow") / "demo_data"))
_AUV, _HULL = DATA / "auv", DATA / "cfd-surge"
_COMMAND = "undertow demo"

#: "title" or "text" with a string, "table" with (head, rows), "picture" or "file" with (name, what it shows).
Piece = tuple[str, Any]
Bar = Callable[[str], AbstractContextManager[Progress]]


@dataclass(frozen=True)
class DemoSettings:
    """What counts in the second example, chosen by the look of its six runs."""

    noticeable: float = 0.05  # share of an error by which it must change to be worth a word
    start_up: float = 3.0  # length of the start of a run, s
    no_push: float = 0.01  # share of the largest push below which the hull coasts


SETTINGS = DemoSettings()


def examples(folder: Path, bar: Bar) -> Iterator[Piece]:
    """Work through all examples; files go into a folder that exists. `bar` shows the progress of a piece."""
    output = _Output(folder)
    yield from _auv(output, bar)
    yield from _hull(output, bar)
    yield from _tank(output)


def _text(words: str) -> Piece:
    return "text", words


def page(pieces: Sequence[Piece]) -> str:
    """One HTML page with all pieces."""
    return templates("undertow", html=True).get_template("index.html").render(pieces=pieces)


class _Output:
    """Writes files into a folder, and gives the pieces that refer to them."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def picture(self, name: str, picture: Any, what: str) -> Piece:
        save_png(picture, self._place(name))
        return "picture", (name, what)

    def text(self, name: str, content: str, what: str) -> Piece:
        write_whole(self._place(name), content)
        return "file", (name, what)

    def vehicle(self, name: str, outcome: DiagnosisResult, template: str | Path, what: str) -> Piece:
        save_diagnosis(outcome, template, self._place(name), _COMMAND)
        return "file", (name, f"{what} {' and '.join(outcome.effects)}")

    def _place(self, name: str) -> Path:
        make_folder((self._folder / name).parent)
        return self._folder / name


# --- 1. an AUV ----------------------------------------------------------------------------------
def _auv(output: _Output, bar: Bar) -> Iterator[Piece]:
    """Where the model fails, what it lacks, and how the error falls."""
    yield "title", "1. An AUV whose model lacks something"
    vehicle = load_vehicle(_AUV / "vehicle.toml")
    names = [*(f"train_{i}" for i in (1, 2, 3)), "holdout"]
    *train, test = read_logs([_AUV / f"{name}.csv.gz" for name in names], vehicle, LogMapping())
    yield _text(
        "A small AUV with four thrusters was logged in three runs of a minute; a fourth run is for "
        "validation. Its vehicle file has mass, added mass, damping and restoring, with guesses good to 15%."
    )
    comparison = compare(vehicle, [test], compiled=False)
    yield "text", f"Where the model fails on the validation run: it {comparison.result.headline}."
    with bar("looking for what is missing") as report:
        outcome = diagnose(vehicle, train, [test], report=report)
    yield from _verdict(output, outcome)
    yield from _pictures(output, outcome)
    if outcome.effects:
        yield output.vehicle("auv/vehicle.toml", outcome, _AUV / "vehicle.toml", "the vehicle file, now with")
        setup = set_up_addition(vehicle, train, [test])
        yield from _falling(output, add_effects([catalogue()[outcome.effects[0]]], setup))
    # What was hidden, read only now that all has been said.
    values = json.loads((_AUV / "truth.json").read_text(encoding="utf-8"))["values"]
    hidden = "; ".join(
        f"{effect} with {', '.join(f'{name} = {value:.4f}' for name, value in own.items())}"
        for effect, own in values.items()
    )
    yield _text(
        f"For comparison: the log was simulated, independently of undertow's own models, with {hidden} (m/s)."
    )


def _verdict(output: _Output, outcome: DiagnosisResult) -> Iterator[Piece]:
    d = outcome.diagnosis
    yield _text(
        f"Every effect of the catalogue that could be added was tried ({len(d.ranking)} of them), each "
        f"refitted with the rest of the model. Verdict: {d.headline}"
    )
    for p in d.parameters:
        if p.effect in d.effects:
            error = "" if p.standard_error is None else f" ± {p.standard_error:.1g}"
            yield "text", f"{p.effect}: {p.name} = {p.value:.4f}{error} {p.unit}"
    for warning in d.warnings:
        yield "text", f"Without it, the fit had distorted the model: {warning}."
    yield output.text("auv/diagnosis.json", d.to_json(), "the diagnosis, for programs")


def _pictures(output: _Output, outcome: DiagnosisResult) -> Iterator[Piece]:
    # For a minute of data compiling takes longer than it saves.
    data = outcome.comparison(compiled=False)
    names = (data.before, data.after)
    run = data.runs[0]
    velocities = replace(run, traces=tuple(t for t in run.traces if t.channel in VELOCITY))
    sway = [c for c in data.residuals if c.before.degree_of_freedom == "sway"]
    yield output.text("auv/report.html", render_report(outcome.diagnosis, data), "the full report")
    pictures = {
        "error-map": (error_map(data.maps[0], names), "residual force by motion and regime"),
        "measured-vs-simulated": (
            measured_vs_simulated(velocities, names),
            "the validation run, simulated from its commands alone",
        ),
        "residual-force": (residual_against(sway, names), "residual force in sway, against the variables"),
    }
    for name, (picture, what) in pictures.items():
        yield output.picture(f"auv/{name}.png", picture, what)


def _falling(output: _Output, addition: Addition) -> Iterator[Piece]:
    names = ("model as given", "refitted", f"with {addition.effects[0]}")
    rows = [
        (name, f"{step.error:.3g}", f"{step.prediction or 0.0:.1%}")
        for name, step in zip(names, addition.steps, strict=True)
    ]
    yield "text", "The error on the validation run falls (1 is sensor noise):"
    yield "table", (("model", "error / noise", "velocity error 5 s ahead"), rows)
    yield output.picture(
        "auv/falling-error.png", falling_error(addition.steps), "the error on the validation run"
    )


# --- 2. a hull in a flow solver -------------------------------------------------------------------
_VEHICLE = "box-hull"
_PROFILES = ("step", "multistep")


@dataclass(frozen=True)
class Way:
    """One way round: identified on one force profile, validated on the other."""

    profile: str
    other: str
    setup: AdditionSetup
    outcome: DiagnosisResult
    additions: dict[str, Addition]  # every effect that these logs could show, put into the model, by its id

    @classmethod
    def of(cls, profile: str, other: str) -> Way:
        """Fit, add every effect that can be seen, and diagnose."""
        vehicle = load_vehicle(_VEHICLE)
        logs = [_HULL / f"surge_{name}_coarse.csv.gz" for name in (profile, other)]
        run, held_out = read_logs(logs, vehicle, read_mapping(_HULL / "log.toml"))
        setup = set_up_addition(vehicle, [run], [held_out])
        additions = [add_effects([effect], setup) for effect in visible_effects(setup, catalogue())]
        outcome = diagnose(vehicle, [run], [held_out])
        return cls(profile, other, setup, outcome, {a.effects[0]: a for a in additions})

    @property
    def name(self) -> str:
        return f"{self.profile} → {self.other}"

    @property
    def plain(self) -> Vehicle:
        """The fitted model of inertia and drag."""
        return self.outcome.before

    @property
    def without(self) -> float:
        """Velocity error ahead of the model of inertia and drag."""
        return self.outcome.diagnosis.steps[0].prediction or 0.0

    def ahead(self, effect: str) -> float:
        """Velocity error ahead with an effect in the model."""
        return self.additions[effect].after.prediction or 0.0

    def missing(self, vehicle: Vehicle) -> Forces:
        """Force that a model lacks on the profile that judges."""
        return residual_forces(vehicle, self.setup.test)


Ways = tuple[Way, Way]


def _hull(output: _Output, bar: Bar) -> Iterator[Piece]:
    """Where inertia and drag fail, which effects lower the error both ways round, and what remains."""
    yield "title", "2. A box hull in a flow solver"
    yield _text(
        "A Navier-Stokes solver pushed a box hull through water: these data come from no formula. The "
        "model is inertia with linear and quadratic drag. It is identified on one profile of the push and "
        "judged on the other, then the other way round."
    )
    with bar("both ways round") as report:
        report(0.0, "step, judged on multistep")
        first = Way.of(*_PROFILES)
        report(0.5, "multistep, judged on step")
        ways = (first, Way.of(*reversed(_PROFILES)))
    yield from _where(ways)
    for way in ways:
        headline = way.outcome.diagnosis.headline
        yield "text", f"Diagnosis, identified on {way.profile}, judged on {way.other}: {headline}"
    tried = [i for i in ways[0].additions if i in ways[1].additions]
    changed = [
        i for i in tried if any(abs(way.ahead(i) / way.without - 1.0) > SETTINGS.noticeable for way in ways)
    ]
    changed.sort(key=lambda i: sum(way.ahead(i) / way.without for way in ways))
    lower = [i for i in changed if all(w.ahead(i) < (1.0 - SETTINGS.noticeable) * w.without for w in ways)]
    yield from _effects(output, ways, changed, len(tried) - len(changed), lower)
    if lower:
        yield from _best(output, ways, lower[0])
    yield from _files(output, ways)


def _where(ways: Ways) -> Iterator[Piece]:
    found = [_phases(way.missing(way.plain)) for way in ways]
    rows = [
        (phase, *(f"{f[phase]:.2f} N" if phase in f else "–" for f in found)) for phase in found[0] | found[1]
    ]
    push = max(float(np.max(np.abs(r.channels["tau_X"]))) for way in ways for r in way.setup.test)
    yield _text(
        f"Force that the fitted model lacks on the other profile (rms; the push reaches {push:.2g} N):"
    )
    yield "table", (("phase", *(way.name for way in ways)), rows)
    for way, forces in zip(ways, found, strict=True):
        worst = max(forces, key=lambda phase: forces[phase])
        yield "text", f"Fitted to {way.profile} and judged on {way.other} it fails most in: {worst}."


def _phases(forces: Forces) -> dict[str, float]:
    push, speed = forces.commands[:, 0], forces.velocity[:, 0]
    coasting = np.abs(push) <= SETTINGS.no_push * np.max(np.abs(push))
    against = ~coasting & (push * speed < 0)
    start = ~coasting & ~against & (forces.t < forces.t.min() + SETTINGS.start_up)
    masks = {
        "start-up (first 3 s)": start,
        "pushed along": ~coasting & ~against & ~start,
        "coasting": coasting,
        "reversal (push against the motion)": against,
    }
    return {name: _rms(forces.missing[mask, 0]) for name, mask in masks.items() if mask.any()}


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _effects(
    output: _Output, ways: Ways, changed: list[str], others: int, lower: list[str]
) -> Iterator[Piece]:
    """What each effect does both ways round."""
    names = ("inertia and drag alone", *changed)
    errors = [[way.without for way in ways], *([way.ahead(i) for way in ways] for i in changed)]
    yield _text(
        "What each effect does to the velocity error 5 s ahead on the profile that it was not fitted to:"
    )
    rows = [(name, *(f"{e:.1%}" for e in row)) for name, row in zip(names, errors, strict=True)]
    yield "table", (("with", *(way.name for way in ways)), rows)
    if others:
        yield "text", f"{others} others change it by less than {SETTINGS.noticeable:.0%}."
    regimes = tuple(way.name for way in ways)
    chart = ErrorMap(names, regimes, 100 * np.array(errors), quantity="velocity error [%]", floor=None)
    picture = error_map(chart, ("fitted to one profile → judged on the other", ""))
    yield output.picture("hull/effects.png", picture, "velocity error 5 s ahead on the other profile, %")
    clear = [i for i in lower if all(way.additions[i].helps for way in ways)]
    yield "text", f"Lower both ways round: {', '.join(lower) or 'none'}."
    yield _text(f"Lower beyond chance, by the residual force of both profiles: {', '.join(clear) or 'none'}.")


def _best(output: _Output, ways: Ways, best: str) -> Iterator[Piece]:
    """What the effect that lowers the error most does to the parameters, and what remains with it."""
    prior = ways[0].setup.vehicle.value_of("X_udot")
    plain = " and ".join(f"{-way.plain.value_of('X_udot').value:.1f}" for way in ways)
    fits = [way.additions[best].fit for way in ways]
    helped = " and ".join(f"{-fit.values['X_udot']:.1f}" for fit in fits)
    yield _text(
        f"Without {best} the two profiles give {plain} kg of added mass, with it {helped} kg; "
        f"potential theory, which the fits take as a prior, gives {-prior.value:.1f} kg."
    )
    for name in ways[0].additions[best].kept:
        values = [
            f"{fit.values[name]:.2f} ± {fit.standard_errors[name]:.1g}" for fit in fits if name in fit.values
        ]
        unit = unit_text(fits[0].vehicle.declared_parameters[name].unit)
        yield "text", f"{best}, {name}: {' and '.join(values)} {unit}"
    left = [_rms(w.missing(fit.vehicle).missing[:, 0]) for w, fit in zip(ways, fits, strict=True)]
    before = [_rms(w.missing(w.plain).missing[:, 0]) for w in ways]
    falls = " and ".join(f"from {b:.2f} to {a:.2f} N" for b, a in zip(before, left, strict=True))
    yield "text", f"With it the force that is missing falls {falls} rms."
    for way in ways:
        d = way.outcome.diagnosis
        yield _text(
            f"Diagnosis of the fit to {way.profile}, judged on {way.other}: {d.verdict}. {d.headline}"
        )
    yield "text", "The residual is not noise, because these logs have hardly any."
    for way in ways:
        models = (way.plain, way.additions[best].fit.vehicle)
        pair = (compare(v, way.setup.test, compiled=False) for v in models)
        picture = measured_vs_simulated(traces(*pair, free=True)[0], ("inertia and drag", f"with {best}"))
        what = f"{way.other}, simulated from its push alone by models fitted to {way.profile}"
        yield output.picture(f"hull/{way.other}.png", picture, what)


def _files(output: _Output, ways: Ways) -> Iterator[Piece]:
    for way in ways:
        d, name = way.outcome.diagnosis, f"hull/{way.profile}-to-{way.other}"
        text = render_report(d, way.outcome.comparison(compiled=False))
        yield output.text(
            f"{name}.html", text, f"full report: fitted to {way.profile}, judged on {way.other}"
        )
        yield output.text(f"{name}.json", d.to_json(), "the same for programs")
        if d.effects:
            yield output.vehicle(f"{name}.toml", way.outcome, _VEHICLE, "the vehicle file with")


# --- 3. a towing tank ---------------------------------------------------------------------------
def _tank(output: _Output) -> Iterator[Piece]:
    """What the logs of a virtual towing tank say of a hull."""
    yield "title", "3. A hull in a virtual towing tank"
    tank = read_tank(DATA / "tank")
    found = coefficients(DATA / "tank", tank)
    yield _text(
        f"There is no vehicle yet, only a mesh of its hull: an AUV of {tank.mass:g} kg, {tank.size:g} m "
        "long. OpenFOAM pushed it (added mass) and towed it forward (damping); the logs give:"
    )
    rows = [(f"-{c.name}", c.way, f"{c.value:.4g}", f"{c.sigma:.2g}", c.unit) for c in found]
    yield "table", (("coefficient", "direction", "value", "sigma", "unit"), rows)
    what = "a vehicle file made from them; undertow tank new, run and vehicle new do this for your hull"
    yield output.text("tank/vehicle.toml", tank_vehicle(tank, found, "auv"), what)
