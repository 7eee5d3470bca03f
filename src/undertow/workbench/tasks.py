"""The work behind the buttons, done in a process of its own by the functions that the commands call."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from undertow.codegen.library import Library
from undertow.errors import UndertowError
from undertow.files import check_writable, write_whole
from undertow.identification import api, comparison
from undertow.identification.comparison import Comparison, Profile
from undertow.identification.diagnose import DiagnosisResult
from undertow.identification.diagnose import diagnose as diagnosis
from undertow.identification.diagnosis.addition import force_errors
from undertow.identification.diagnosis.result import Diagnosis
from undertow.identification.diagnosis.splitting import training_and_validation
from undertow.identification.diagnosis.validation import SimulationValidator
from undertow.identification.doctor.examine import examine as doctor
from undertow.identification.estimation.data import prepare
from undertow.identification.estimation.fitted import Fitted, base_parameters, correlation, notes
from undertow.identification.logs.reading import read_logs
from undertow.identification.logs.run import Run
from undertow.identification.report.page import (
    estimate_text,
    informativeness,
    render_report,
    report_data,
    simulated,
)
from undertow.identification.report.pictures import RunTraces, decimated
from undertow.identification.report.results import addition_sentence
from undertow.identification.report.scaffold import check_id, effect_file, suggested
from undertow.model.catalogue import Catalogue, with_effects
from undertow.model.describe import describe, equations_on
from undertow.model.loading import load_vehicle
from undertow.model.parameter import printed
from undertow.model.saving import save_vehicle
from undertow.model.symbols import VELOCITY
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Progress

from .figures import plain
from .session import FORCE, REFITTED, ModelStep, Workspace

Result = dict[str, Any]


@dataclass(frozen=True)
class TaskSettings:
    """How much of what is worked out is kept for the page."""

    candidates: int = 8  # that are simulated, the best first: more lines than that nobody compares
    seen: float = 0.01  # fall of an error, as a share of it, below which two bars look the same
    supplied: int = 3  # candidates whose force is drawn over the residual
    runs: int = 3  # validation runs that are drawn: the fourth looks like the third
    pixels: int = 300  # of a simulated line, with a least and a greatest value each
    points: int = 3000  # of a residual force along the logs


SETTINGS = TaskSettings()


@dataclass
class Job:
    """A piece of work: the session as it was when the button was pressed, and what the button said."""

    place: Workspace
    args: Mapping[str, Any]
    report: Progress

    @cached_property
    def effect_files(self) -> list[Path]:
        """Files with effects of the user's own."""
        return [Path(path) for path in self.place.session.effects]

    @cached_property
    def known(self) -> Catalogue:
        """The catalogue with the effects of the user."""
        return with_effects(self.effect_files)

    def vehicle_of(self, step: int) -> Vehicle:
        """A model of the session."""
        return load_vehicle(self.place.vehicle_file(step), effect_files=self.effect_files)

    @cached_property
    def vehicle(self) -> Vehicle:
        """The present model."""
        return self.vehicle_of(-1)

    @cached_property
    def trust(self) -> bool:
        """Whether logs are taken as they are."""
        return self.place.session.trust_log

    @cached_property
    def chosen(self) -> list[tuple[str, Run]]:
        """All segments of all logs, with what is done with each."""
        runs = read_all(self.place, self.vehicle)
        pairs = zip(self.place.session.chosen(runs), runs, strict=True)
        return [part for choice, run in pairs for part in choice.parts(run)]

    @property
    def used(self) -> list[Run]:
        """The segments that are not left out."""
        return [run for role, run in self.chosen if role != "out"]

    def runs(self, role: str) -> list[Run]:
        """The segments to fit to ("train") or to judge by ("judge")."""
        return [run for own, run in self.chosen if own == role]

    @cached_property
    def to_fit(self) -> tuple[list[Run], list[Run]]:
        """The segments to fit to and to judge by, where there is something to fit to."""
        if not self.runs("train"):
            raise UndertowError("no segment of any log is chosen for training: choose one on the page Log")
        return self.runs("train"), self.runs("judge")

    @cached_property
    def validator(self) -> SimulationValidator:
        """Who simulates the validation data, over horizons that stay the same from model to model."""
        given = self.vehicle_of(0)
        train, test = training_and_validation(given, *self.to_fit, trust_log=self.trust)
        return SimulationValidator(given, train, test, prepare(train, given).sigma)

    def ahead(self, force: float, model: Fitted | Vehicle) -> dict[str, float]:
        """Errors of a model by measure, that of its force given; without predictions that diverge."""
        return {FORCE: force, **_finite(self.validator.ahead(model)[0])}

    def errors(self, *models: Fitted | Vehicle) -> list[dict[str, float]]:
        """Errors of models on validation data by measure; the noise of the force is that of the last one."""
        validator = self.validator
        try:
            force = force_errors(models, validator.test, self.vehicle_of(0), validator.sigma)
        except UndertowError:  # runs that can be simulated may be too short for test functions
            force = [math.nan] * len(models)
        return [_finite(self.ahead(f, m)) for f, m in zip(force, models, strict=True)]


def read_all(place: Workspace, vehicle: Vehicle, *, mended: bool = True) -> list[Run]:
    """All logs of a session; without `mended` as they were read before the last remedy of the doctor."""
    session, mapping = place.session, place.mapping(mended=mended)
    return read_logs(session.paths, vehicle, mapping, missing_commands=session.fill, in_any_order=True)


def examine(job: Job) -> Result:
    """What the doctor says about the logs."""
    return doctor(job.vehicle, job.used, mapping=job.place.mapping(), report=job.report).result.model_dump()


def compare(job: Job) -> Result:
    """Where the present model fails."""
    if not job.used:
        raise UndertowError("all logs are left out: choose a segment on the page Log")
    found = comparison.compare(
        job.vehicle, job.used, progress=_share(job.report, 0.0, 0.8), trust_log=job.trust
    )
    job.report(0.8, "predicting validation data")
    return {**_compared(found), "errors": _predicted(job)}


def _predicted(job: Job) -> dict[str, float]:
    """Errors of the present model on validation data; none where these are too short, which a map may be."""
    try:
        return job.errors(job.vehicle)[0]
    except UndertowError:
        return {}


def _compared(found: Comparison) -> Result:
    result = found.result
    cells = [c for c in result.cells if c.normalised is not None]
    stretches: dict[str, dict[str, Any]] = {dof: {} for dof in result.degrees_of_freedom}
    for c in cells:
        stretches[c.degree_of_freedom][c.regime] = found.stretches(c.degree_of_freedom, c.regime)
    every = max(1, math.ceil(len(found.forces) / SETTINGS.points))
    rows = slice(None, None, every)
    return {
        "headline": result.headline,
        "runs": [r.name for r in result.runs],
        "dofs": {d.degree_of_freedom: d.unit for d in result.dofs},
        "cells": [c.model_dump() for c in cells],
        "worst": None if result.worst is None else result.worst.model_dump(),
        "stretches": stretches,
        "profiles": [_profile(p) for p in sorted(found.profiles, key=informativeness, reverse=True)],
        "run": found.forces.run[rows].tolist(),
        "t": plain(found.forces.t[rows]),
        "missing": _columns(result.degrees_of_freedom, found.forces.missing[rows]),
        "noise": _columns(result.degrees_of_freedom, found.forces.noise[rows]),
        "variables": {n: {"unit": u, "values": plain(v[rows])} for n, (u, v) in found.variables.items()},
    }


def _columns(names: Sequence[str], table: Array) -> dict[str, list[float | None]]:
    return {name: plain(table[:, i]) for i, name in enumerate(names)}


def _profile(p: Profile) -> Result:
    return {
        "dof": p.degree_of_freedom,
        "variable": p.variable,
        "centre": plain(p.centre),
        "force": plain(p.force),
        "error": plain(1.96 * p.error),  # half the 95% interval, as in reports
    }


def diagnose(job: Job) -> Result:
    """What is missing in the present model, and what every candidate would do."""
    train, judge = job.to_fit
    progress = _share(job.report, 0.0, 0.8)
    found = diagnosis(job.vehicle, train, judge, known=job.known, report=progress, trust_log=job.trust)
    ranking = {r.effect: r for r in found.diagnosis.ranking}
    best = sorted(found.tried, key=lambda name: ranking[name].error_after)[: SETTINGS.candidates]
    candidates = []
    for i, name in enumerate(best):
        job.report(0.8 + 0.2 * i / len(best), f"simulating it with {name}")
        candidates.append(_candidate(job, found, name, with_force=i < SETTINGS.supplied))
    without = job.ahead(found.diagnosis.steps[0].error, found.before)
    shown = [c for c in candidates if _does_something(c, without)]
    return {
        "diagnosis": found.diagnosis.model_dump(mode="json"),
        "step": len(job.place.session.steps) - 1,
        "errors": without,
        "traces": _simulated(job, found.before),
        "candidates": shown,
        "idle": [name for name in ranking if name not in {c["effect"] for c in shown}],
    }


def _does_something(candidate: Result, without: Mapping[str, float]) -> bool:
    """Whether an effect is named, or lowers an error over some horizon by as much as can be seen."""
    least = 1.0 - SETTINGS.seen
    errors: dict[str, float] = candidate["errors"]
    named = candidate["named"] or candidate["confused"]
    return bool(named) or any(e < least * without.get(name, 0.0) for name, e in errors.items())


def _candidate(job: Job, found: DiagnosisResult, name: str, *, with_force: bool) -> Result:
    diagnosis, fit = found.diagnosis, found.tried[name]
    ranked = next(r for r in diagnosis.ranking if r.effect == name)
    alike = next((s for s in diagnosis.indistinguishable if name in s.effects), None)
    # In the motions of this vehicle; of all where no parameter of it was kept.
    added = next((e for e in fit.vehicle.all_effects if e.id == name), None)
    whole = describe(job.known[name], job.known).equations
    equations = whole if added is None else equations_on(fit.vehicle.composition, added)
    return {
        "effect": name,
        "about": ranked.about,
        "equations": [f"{e.left} = {e.plain}" for e in equations],
        "typeset": [e.latex for e in equations],
        "parameters": [estimate_text(p) for p in ranked.parameters],
        "errors": job.ahead(ranked.error_after, fit),
        "explained": ranked.explained,
        "chance": ranked.p_value,
        "sure": ranked.sure,
        "named": name in diagnosis.effects,
        "not_named": ranked.not_named,
        "confused": [] if alike is None else [e for e in alike.effects if e != name],
        "tell": "" if alike is None else alike.separated_by,
        "traces": _simulated(job, fit.vehicle),
        "supplied": [_profile(p) for p in comparison.supplied(job.vehicle, fit.vehicle, job.used)]
        if with_force
        else [],
    }


def _simulated(job: Job, vehicle: Vehicle) -> dict[str, list[Result]]:
    """Measured and simulated velocities of the first validation runs, by horizon."""
    runs = job.validator.test[: SETTINGS.runs]
    return {f"{h:g} s": [_run_traces(r) for r in simulated(vehicle, runs, h)] for h in job.validator.horizons}


def _run_traces(run: RunTraces) -> Result:
    channels = []
    for trace in run.traces:
        if trace.channel in VELOCITY:
            lines = {"measured": trace.measured, "simulated": trace.before}
            drawn = {k: [*map(plain, decimated(trace.t, y, SETTINGS.pixels))] for k, y in lines.items()}
            channels.append({"name": trace.channel, "unit": trace.unit, **drawn})
    return {"run": run.run, "channels": channels}


def add(job: Job) -> Result:
    """Put an effect into the present model, and write the vehicle file where that helps."""
    effect, force = str(job.args["effect"]), bool(job.args.get("force", False))
    train, judge = job.to_fit
    setup, done = api.try_effect(
        job.vehicle, effect, train, judge, known=job.known, report=job.report, trust_log=job.trust
    )
    job.report(0.9, "predicting validation data")
    steps = zip(("given", "refitted", "errors"), done.steps, strict=True)
    ahead = {name: {FORCE: step.error, **_finite(step.ahead)} for name, step in steps}
    result = {"sentence": addition_sentence(done), "helps": done.helps, "effect": effect, **ahead}
    if not (done.helps or force):
        return result
    out = job.place.new_file("model")
    api.save_addition(setup, done, job.place.vehicle_file(), out)
    step = ModelStep(
        what=f"with {effect}",
        file=out.name,
        effect=effect,
        command=f"add {effect}",
        errors=ahead["errors"],
        refitted=ahead["refitted"],
    )
    return {**result, "step": step.model_dump()}


def fit(job: Job) -> Result:
    """Refit what the present model marks as estimated, and write the vehicle file."""
    train, judge = job.to_fit
    done = api.fit(job.vehicle, train, judge, report=_share(job.report, 0.0, 0.9), trust_log=job.trust)
    out = job.place.new_file("model")
    done.save(job.place.vehicle_file(), out)
    given, errors = job.errors(job.vehicle, done.fit)
    combined = [str(c) for c in base_parameters(done.fit.gram, done.fit.model.free)]
    step = ModelStep(what=REFITTED, file=out.name, command="fit", errors=errors)
    return {
        "step": step.model_dump(),
        "given": given,
        "sentence": done.result().sentence(),
        "parameters": [_finite(row) for row in done.parameters.iter_rows(named=True)],
        "names": list(done.fit.model.free),
        "correlation": [plain(row) for row in correlation(done.fit)],
        "remarks": done.remarks,
        "combinations": combined,
        "notes": notes(done.fit),
        "condition": done.fit.condition,
    }


def edit(job: Job) -> Result:
    """Change values of the present model, and which of them are estimated."""
    changed, words, vehicle = {}, [], job.vehicle
    for name, wanted in dict(job.args["values"]).items():
        old = vehicle.value_of(name)
        value = printed(vehicle.declaration(name), float(wanted["value"]), vehicle.signs)
        new = replace(old, estimate=bool(wanted["estimate"]))
        if not math.isclose(value, old.value, rel_tol=1e-9):
            new = replace(new, value=value, source="set at the workbench", assumed=False)
        changed[name] = new
        words.append(f"{name} = {float(wanted['value']):.6g} {'estimated' if new.estimate else 'fixed'}")
    out = job.place.new_file("model")
    save_vehicle(vehicle.with_values(changed), job.place.vehicle_file(), out)
    job.place.session.steps.append(ModelStep(what=", ".join(words), file=out.name))
    job.vehicle_of(-1)  # refuses what cannot be, such as a negative mass
    return {"step": job.place.session.steps[-1].model_dump()}


def invent(job: Job) -> Result:
    """Write an effect of the user's own, made from what remains."""
    effect = str(job.args["effect"])
    check_id(effect)
    diagnosis = Diagnosis.model_validate(_last_diagnosis(job)["diagnosis"])
    out = (job.place.folder / f"{effect}.py").absolute()
    if out.exists() or effect in job.known:
        raise UndertowError(f"an effect '{effect}' is there already: choose another id")
    found = suggested(diagnosis, "the workbench")
    write_whole(out, effect_file(effect, out.name, found))
    terms = [f"{term.name}: {term.about}" for term in found.terms]
    return {"effect": effect, "file": str(out), "terms": terms}


def _last_diagnosis(job: Job) -> Result:
    found = job.place.result("diagnose", job.args.get("key"))
    if found is None:
        raise UndertowError("nothing was diagnosed so far: press 'Look for what is missing' first")
    return found


# --- what is written ------------------------------------------------------------------------------
def write_vehicle(job: Job) -> Result:
    """Write the present model."""
    out = _target(job)
    save_vehicle(job.vehicle, job.place.vehicle_file(), out)
    return {"written": [str(out)]}


def write_report(job: Job) -> Result:
    """Write the report of the last diagnosis, with the present model beside the one that was diagnosed."""
    out, found = _target(job), _last_diagnosis(job)
    steps, test = job.place.session.steps, job.validator.test
    first = min(int(found["step"]), len(steps) - 1)
    job.report(0.1, "comparing the models with validation data")
    before = comparison.compare(job.vehicle_of(first), test, trust_log=job.trust)
    after = comparison.compare(job.vehicle, test, trust_log=job.trust) if first < len(steps) - 1 else None
    job.report(0.7, "drawing")
    data = report_data(before, after, names=(f"model {steps[first].what}", f"model {steps[-1].what}"))
    write_whole(out, render_report(Diagnosis.model_validate(found["diagnosis"]), data))
    return {"written": [str(out)]}


def write_code(job: Job) -> Result:
    """Write the C code of the present model."""
    done = Library(job.vehicle).write(Path(job.args["out"]))
    return {"written": [str(done.folder)]}


def write_logs(job: Job) -> Result:
    """Write the chosen segments as logs, for command lines to name."""
    written = []
    for role in ("train", "judge"):
        for i, run in enumerate(job.runs(role), start=1):
            out = job.place.folder / f"{role}-{i}.csv"
            out.with_suffix(".toml").unlink(missing_ok=True)
            api.save_log(run, out)
            written.append(str(out))
    return {"written": written, "logs": written}


def _target(job: Job) -> Path:
    out, session = Path(job.args["out"]), job.place.session
    given: list[str | Path] = [job.place.vehicle_file(0), *(log.path for log in session.logs)]
    check_writable(out, inputs=[*given, *session.effects, *filter(None, [session.mapping])])
    return out


TASKS: dict[str, tuple[Callable[[Job], Result], str]] = {
    "examine": (examine, "examining the logs"),
    "compare": (compare, "comparing the model with the logs"),
    "diagnose": (diagnose, "looking for what is missing"),
    "add": (add, "adding the effect"),
    "fit": (fit, "refitting"),
    "edit": (edit, "changing the vehicle"),
    "invent": (invent, "writing an effect from the residual"),
    "vehicle": (write_vehicle, "writing the vehicle file"),
    "report": (write_report, "writing the report"),
    "code": (write_code, "writing the C code"),
    "logs": (write_logs, "writing the segments"),
}


# --- numbers for JSON -----------------------------------------------------------------------------
def _finite(table: Mapping[str, Any]) -> dict[str, Any]:
    """A table without numbers that JSON does not have."""
    return {n: v for n, v in table.items() if not isinstance(v, float) or math.isfinite(v)}


def _share(report: Progress, low: float, high: float) -> Progress:
    return lambda done, words: report(low + (high - low) * done, words)
