"""One case from its simulation to the numbers that are kept of it."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from benchmarks.hidden_effects import Case
from undertow.identification.diagnose import DiagnosisResult, diagnose
from undertow.identification.diagnosis.parallel import jobs
from undertow.identification.diagnosis.result import Diagnosis
from undertow.identification.logs.run import Run
from undertow.model.vehicle import Vehicle

from .cases import Planned
from .grade import OracleRefit, addable, excess, grade_of, opened, oracle_refit
from .material import simulated, without, written_and_read, written_to_memory
from .peers import asked
from .sizing import sized
from .verdicts import Answer

Record = dict[str, Any]
Data = tuple[Vehicle, list[Run], list[Run]]


def measured(
    case: Planned, *, peers: bool = True, keep: Path | None = None
) -> tuple[Record, DiagnosisResult]:
    """Simulate, diagnose and grade one case.

    What is written as one line of JSON, and the whole diagnosis.
    """
    made = simulated(sized(case))
    data = _data(made, keep)
    began, worked = time.perf_counter(), time.process_time()
    outcome = diagnose(*data)
    times = {"seconds": time.perf_counter() - began, "cpu": time.process_time() - worked, "cores": jobs()}
    record = described(case, made, data[0]) | _said(outcome.diagnosis) | times
    record |= _graded(case, made, record, data, outcome)
    if peers:
        record["peers"] = asked(*data)
    return record, outcome


def spent(record: Record) -> float:
    """Processor time on one core, which other work does not lengthen; else that of the clock, s."""
    return float(record["cpu"] if record.get("cores") == 1 else record["seconds"])


def described(case: Planned, made: Case, vehicle: Vehicle) -> Record:
    """What the case is, and what is true in it."""
    truth = made.truth["effects"]
    hidden = {k: v for name in case.hidden for k, v in made.truth["values"][name].items()}
    return {
        "id": case.id,
        "kind": case.kind,
        "label": case.label,
        "vehicle": case.vehicle,
        "motions": list(vehicle.degrees_of_freedom),
        "truth": truth,
        "known": all(addable(vehicle, effect) for effect in truth),
        "values": hidden,
        "strength": made.truth["strength"],
        "noise": case.noise,
        "closed_loop": case.closed_loop,
        "variant": case.variant,
    }


def _data(made: Case, keep: Path | None) -> Data:
    return written_to_memory(made) if keep is None else written_and_read(made, keep)


def _said(found: Diagnosis) -> Record:
    return {
        "answer": answer_of(found).as_dict(),
        "headline": found.headline,
        "warnings": list(found.warnings),
        "steps": [[*step.added, round(step.error, 4)] for step in found.steps],
    }


def answer_of(found: Diagnosis) -> Answer:
    """What counts of a diagnosis."""
    sets = [list(group.effects) for group in found.indistinguishable]
    return Answer(found.verdict, list(found.effects), sets, [entry.effect for entry in found.ranking])


def _graded(case: Planned, made: Case, record: Record, data: Data, outcome: DiagnosisResult) -> Record:
    """Ratio and grade, and the errors they come from, in units of one noise model.

    What no catalogue knows has no oracle refit: it is held against the same vehicle with nothing hidden.
    """
    began = time.perf_counter()
    if case.kind == "complete":
        return {}
    if record["known"]:
        truth = oracle_refit(*data, record["truth"], record["values"])
        found = _against_oracle(truth, outcome)
    else:
        found = _against_nothing_hidden(case, data)
    ratio = found["ratio"]
    return found | {"grade": grade_of(ratio), "grading_seconds": time.perf_counter() - began}


def _against_oracle(truth: OracleRefit, outcome: DiagnosisResult) -> Record:
    return {
        "ratio": truth.ratio,
        "before": truth.before,
        "after": truth.error_of(outcome.fit),
        "oracle": truth.error,
        "lacking": truth.lacking,
        "oracle_values": truth.fit.values,
    }


def _against_nothing_hidden(case: Planned, data: Data) -> Record:
    twin = _data(simulated(without(case)), None)
    before, floor = excess(*opened(*data)), excess(*opened(*twin))
    return {"ratio": before / floor, "before": before, "oracle": floor}
