"""Vehicle files with what was found from logs, and the history in them of how it came about."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import date
from pathlib import Path

from undertow.model.saving import save_vehicle
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .diagnose import DiagnosisResult
from .diagnosis.result import Role, RunInfo, ValuesByRun
from .diagnosis.verdict import values_by_run
from .estimation.fitted import Fitted
from .logs.run import Run


def roles(train: Sequence[Run], test: Sequence[Run]) -> list[tuple[Role, Run]]:
    """Logs with what they were for: to fit to, and to judge by."""
    names: tuple[Role, Role] = ("train", "holdout")
    return [(role, run) for role, runs in zip(names, (train, test), strict=True) for run in runs]


def known_by(fit: Fitted) -> tuple[tuple[str, ...], Array, list[ValuesByRun]]:
    """Names and covariance of what a fit found, and what has values in every run."""
    return (*fit.vehicle_covariance, values_by_run(fit, fit.model.functions.vehicle))


def save_found(
    vehicle: Vehicle,
    template: str | Path,
    out: Path,
    command: str,
    logs: Sequence[tuple[str, Run | RunInfo]],
    errors: tuple[float, float],
    known: tuple[Sequence[str], Array, Sequence[ValuesByRun]],
    **more: object,
) -> None:
    """Write a vehicle in the form of the file that it came from, with a history of its values.

    `errors` are those before and after, `known` is as by `known_by`, and `more` goes into the history.
    """
    names, covariance, by_run = known
    entry = {
        "command": command,
        "date": date.today().isoformat(),
        **more,
        "logs": [{"name": r.name, "sha256": r.sha256, "role": role} for role, r in logs],
        "error_before": errors[0],
        "error_after": errors[1],
        **({"by_run": list(map(_history_of, by_run))} if by_run else {}),
        "covariance": {"parameters": list(names), "matrix": covariance.tolist()},
    }
    save_vehicle(vehicle, template, out, history=entry)


def _history_of(table: ValuesByRun) -> dict[str, object]:
    """Values by run for a vehicle file."""
    errors = table.standard_errors
    runs = [{"run": run, "value": value, "sigma": errors[run]} for run, value in table.values.items()]
    return {"parameter": table.parameter, "runs": runs, "spread": table.spread, "q": table.q}


def save_diagnosis(
    result: DiagnosisResult, template: str | Path, out: Path, command: str = "undertow diagnose"
) -> None:
    """Write the vehicle file with what a diagnosis found."""
    d = result.diagnosis
    logs, errors = [(r.role, r) for r in d.runs], (d.steps[0].error, d.last_step.error)
    save_found(result.after, template, out, command, logs, errors, known_by(result.fit), added=d.effects)
