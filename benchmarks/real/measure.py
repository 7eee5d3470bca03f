"""One case: what the diagnosis says, and errors of simulation with and without what is true."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any

from benchmarks.results.text import remaining_of
from benchmarks.trust.measure import Record, answer_of
from undertow.errors import UndertowError
from undertow.files import write_whole
from undertow.identification.api import diagnose, try_effect
from undertow.identification.diagnose import DiagnosisResult
from undertow.identification.diagnosis.parallel import jobs
from undertow.identification.diagnosis.result import Diagnosis
from undertow.identification.diagnosis.splitting import training_and_validation
from undertow.identification.estimation.predictor import predict_each
from undertow.identification.estimation.weak_form import adapted, end_of_first_part
from undertow.identification.estimation.windows import Windows, cut, prediction_error
from undertow.identification.logs.run import Run
from undertow.model.vehicle import Vehicle

from . import peers
from .cases import Case, without
from .injections import INJECTIONS
from .logs import LogSet

Errors = list[float | None]
REFUSED = "refused"


@dataclass(frozen=True)
class Material:
    """What the diagnosis is given, and what is right.

    value: size of an injection in its unit.
    right: ids of right answers; none for logs as they are. Of the first, `known`, any is what was changed.
    """

    vehicle: Vehicle
    train: list[Run]
    test: list[Run]
    value: float = 0.0
    right: tuple[str, ...] = ()
    known: int = 1


def material(case: Case, logs: LogSet, data: Path) -> Material:
    """Vehicle and logs of a case."""
    vehicle, train, test = logs.read(data)
    if case.removed:
        return Material(
            without(vehicle, case.removed),
            train,
            test,
            right=(case.removed, *logs.also.get(case.removed, ())),
        )
    if case.kind != "injection":
        return Material(vehicle, train, test)
    injection = INJECTIONS[case.change]
    value = injection.value(case.size, logs.scales)
    changed, runs = injection.applied(vehicle, [*train, *test], value)
    right, known = injection.right(vehicle.degrees_of_freedom), len(injection.answers)
    return Material(changed, runs[: len(train)], runs[len(train) :], value, tuple(right), known)


def worker(sets: Mapping[str, LogSet], data: Path, keep: Path | None = None) -> Any:
    """What is done with a case of these log sets; whole diagnoses go to a folder, where one is given."""

    def work(case: Case) -> Record:
        logs = sets[case.logs]
        given, known = material(case, logs, data), _described(case, logs)
        if case.kind == "prediction":
            return known | predicted(given, logs.horizons)
        record, outcome = measured(given, logs.horizons)
        if keep is not None and outcome is not None:
            write_whole(keep / f"{case.id.replace(':', '_')}.json", outcome.diagnosis.model_dump_json())
        return known | record

    return work


def _described(case: Case, logs: LogSet) -> Record:
    own = {"id": case.id, "kind": case.kind, "label": case.label, "vehicle": case.logs, "size": case.size}
    return own | {"title": logs.what.title, "horizons": list(logs.horizons)}


def measured(given: Material, horizons: Sequence[float]) -> tuple[Record, DiagnosisResult | None]:
    """What the diagnosis says of a case, and the errors of the models about it; and the whole of it."""
    began, worked = time.perf_counter(), time.process_time()
    facts: Record = {
        "motions": list(given.vehicle.degrees_of_freedom),
        "value": given.value,
        "truth": given.right,
    }
    try:
        outcome = diagnose(given.vehicle, given.train, given.test)
    except UndertowError as error:
        # A refusal in one line is an answer, too: that nothing is to be made of such logs.
        said = {"verdict": REFUSED, "named": [], "sets": [], "ranking": []}
        spent = {"seconds": time.perf_counter() - began}
        return facts | {"answer": said, "headline": str(error)} | spent, None
    spent = {
        "seconds": time.perf_counter() - began, "cpu": time.process_time() - worked, "cores": jobs(),
    }  # fmt: skip
    windows = cut_all(given.vehicle, outcome.test, horizons)
    models = {"stated": given.vehicle, "refitted": outcome.before, "found": outcome.after}
    if not given.right and outcome.helped is not None:
        models["helped"] = outcome.helped
    errors = {name: ahead(vehicle, outcome.test, windows) for name, vehicle in models.items()}
    if given.right:
        errors["true"], facts["not_added"] = with_truth(given, outcome, windows)
    facts |= said_of(outcome.diagnosis, whole=not given.right)
    return facts | {"errors": errors} | spent, outcome


def said_of(found: Diagnosis, *, whole: bool) -> Record:
    """Answer and reasons; where the whole is wanted, also what remains and which data would help."""
    said = {
        "answer": answer_of(found).as_dict(),
        "headline": found.headline,
        "helps": found.helps,
        "not_named": {r.effect: r.not_named for r in found.ranking if r.not_named}
        | {a.effect: a.doubt for a in found.added if a.doubt},
    }
    return said if not whole else said | remaining_of(found)


def with_truth(
    given: Material, outcome: DiagnosisResult, windows: Sequence[Windows]
) -> tuple[Errors, list[str]]:
    """Errors of the model with what is true added and refitted; of several names the best far ahead.

    Also why what could not be added could not.
    """
    found, refused = [], []
    for effect in given.right[: given.known]:
        try:
            added = try_effect(given.vehicle, effect, outcome.train, outcome.test)[1]
        except UndertowError as error:
            refused.append(f"{effect}: {error}")
            continue
        found.append(ahead(added.fit.vehicle, outcome.test, windows))
    return min(found, key=_last, default=[None] * len(windows)), refused


def _last(errors: Errors) -> float:
    return float("inf") if errors[-1] is None else errors[-1]


def predicted(given: Material, horizons: Sequence[float]) -> Record:
    """Errors of the peers, fitted to the logs that ours is fitted to and judged by the same windows."""
    train, test = training_and_validation(given.vehicle, given.train, given.test)
    windows = cut_all(given.vehicle, test, horizons)
    errors, failures, seconds = {}, {}, {}
    for name, method in peers.METHODS.items():
        began = time.perf_counter()
        try:
            model = method(given.vehicle, train, longest_of(train, given.vehicle, horizons[1]))
            errors[name] = [finite(prediction_error(model.predicted(w))) for w in windows]
        except (peers.NotApplicable, ImportError) as error:
            failures[name] = str(error)
        seconds[name] = time.perf_counter() - began
    return {"errors": errors, "not_applicable": failures, "seconds": sum(seconds.values()), "each": seconds}


def cut_all(vehicle: Vehicle, test: Sequence[Run], horizons: Sequence[float]) -> list[Windows]:
    """Windows of all lengths; where no stretch is so long, windows as long as it is.

    The first part of each run judges nothing, so that what belongs to a run (its current, its trim) may be
    estimated from it; the rest is the same for all models.
    """
    judging = [run.slice(end_of_first_part(run)) for run in test]
    return [cut(judging, vehicle, longest_of(judging, vehicle, horizon)) for horizon in horizons]


def longest_of(runs: Sequence[Run], vehicle: Vehicle, horizon: float) -> float:
    """The horizon, or the longest stretch without gaps where none is so long."""
    names = (*vehicle.pose_names, *vehicle.velocity_names, *vehicle.command_names)
    pieces = ((run, piece) for run in runs for piece in run.segments(n for n in names if run.has(n)))
    return min(horizon, max(float(run.t[p.stop - 1] - run.t[p.start]) for run, p in pieces))


def ahead(vehicle: Vehicle, test: Sequence[Run], windows: Sequence[Windows]) -> Errors:
    """Error of the simulated velocities as a share of the motion, for each length; None: it diverged."""
    each = [adapted(vehicle, run)[0] for run in test]
    return [finite(prediction_error(predict_each(each, w))) for w in windows]


def finite(value: float) -> float | None:
    """A number that JSON has."""
    return round(value, 6) if isfinite(value) else None
