"""Estimate added mass and damping from forced motion by the paper's chain: filters, then least squares.

Each log holds one motion (surge, heave, yaw ...) that a known force drives, as a towing tank or a flow
solver gives it: a velocity, the force tau_X (Y, Z, K, M, N) or the thrusters, and if possible the
acceleration u_dot (v_dot ...), else velocities are differentiated. Velocity and acceleration are smoothed by
Savitzky-Golay filters in eleven ways (--cases, Tables 1 to 3 of the paper), and added mass and damping follow
by least squares for each of them. A vehicle with values for forward and backward motion gets each from the
logs that go that way.

    undertow identify mini-auv surge.csv heave.csv yaw.csv --cases all --out identified.toml

Of the cases whose estimates are all physical, the one with the least residual variance is taken.

Logs of any length are read in parts, in constant memory and with the same answer: those of more than 200 MB
(unpacked) by themselves where that can be done, shorter ones with --stream.

    undertow identify mini-auv week.parquet --stream

This is the baseline that others are held against: filtering the motion and not the force biases the
estimates, and the errors that it states take smoothed samples as independent. `undertow fit` has neither
fault.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from undertow.cli._vehicle_and_logs import (
    EffectsOption,
    FillOption,
    FromOption,
    InPlaceOption,
    LogsArgument,
    MapOption,
    OutOption,
    ToOption,
    TrustOption,
    VehicleArgument,
)
from undertow.errors import UndertowError
from undertow.identification.estimation.fitted import SURE, t_value, t_values
from undertow.identification.logs.chunks import LongLog
from undertow.identification.logs.run import Run
from undertow.model.parameter import printed
from undertow.model.units import short_unit
from undertow.model.vehicle import Vehicle
from undertow.paper.least_squares import (
    RULE,
    CombinedEstimates,
    Estimation,
    Experiment,
    combined,
    estimate,
    estimate_streaming,
    experiments,
    selected,
)
from undertow.paper.regression import Edges, chosen_cases

from ._terminal import Report, console, section, table, text

_METHOD = typer.Option("--method", help="Savitzky-Golay filters, then least squares.")
_CASES = typer.Option("--cases", metavar="all|N,N", help="Ways to filter, by their number in the paper.")
_EDGES = typer.Option("--edges", help="What filters do at the ends: interp is MATLAB's sgolayfilt.")
_STREAM = typer.Option("--stream", help="Read the logs in parts, however short they are.")
_LONG = 200_000_000
_JSON = typer.Option("--json", metavar="FILE.json", help="Write all numbers.")


def identify(
    vehicle: VehicleArgument,
    logs: LogsArgument,
    method: Annotated[Literal["sg-ls"], _METHOD] = "sg-ls",
    cases: Annotated[str, _CASES] = "all",
    edges: Annotated[Literal["interp", "drop", "nearest", "mirror", "constant", "wrap"], _EDGES] = "interp",
    stream: Annotated[bool, _STREAM] = False,
    json: Annotated[Path | None, _JSON] = None,
    out: OutOption = None,
    in_place: InPlaceOption = False,
    map: MapOption = None,
    effects: EffectsOption = None,
    since: FromOption = None,
    until: ToOption = None,
    fill: FillOption = None,
    trust_log: TrustOption = False,
) -> None:
    from undertow.files import check_writable, together, write_whole

    from .add import target_of

    target = target_of(vehicle, out, in_place)
    read: list[str | Path] = [*logs, *(effects or []), *([map] if map else [])]
    check_writable(target, json, inputs=[*read, *([] if in_place else [vehicle])])
    given: dict[str, Any] = {"map": map, "effects": effects, "window": (since, until), "fill": fill}
    path, done = _estimated(vehicle, logs, cases, edges, stream, given, trust_log)
    show(done)
    with together():
        if json is not None:
            write_whole(json, written(done))
        if target is not None:
            write(done, path, target)
    typer.echo(
        "no vehicle file was written: --out NEW.toml or --in-place does that"
        if target is None
        else f"wrote {target}"
    )


def _estimated(
    vehicle: str,
    logs: list[Path],
    cases: str,
    edges: Edges,
    stream: bool,
    given: dict[str, Any],
    trust_log: bool,
) -> tuple[Path, Identified]:
    """File of the vehicle and estimates; from parts of the logs where that is asked for or they are long."""
    from undertow.cli._vehicle_and_logs import load, load_in_parts
    from undertow.identification.logs.chunks import NeedsWhole, size_of

    from ._terminal import progress

    if stream or sum(map(size_of, logs)) > _LONG:
        model, path, long = load_in_parts(vehicle, logs, **given)
        try:
            with progress("reading logs") as tell:
                return path, identified_in_parts(model, long, cases, edges, tell, trust_log=trust_log)
        except NeedsWhole:
            if stream:
                raise
    loaded = load(vehicle, logs, one_motion=True, **given)
    return loaded.path, identified(loaded.vehicle, loaded.train, cases, edges, trust_log=trust_log)


@dataclass(frozen=True)
class Identified:
    """Estimates of all motions.

    Attributes
    ----------
    stated : Vehicle
        The vehicle as given.
    found : list of (Experiment, list of Estimation)
        For each motion and direction its estimates, one for each case.
    edges : str
        What the filters did at the ends.
    """

    stated: Vehicle
    found: list[tuple[Experiment, list[Estimation]]]
    edges: str

    @property
    def taken(self) -> list[tuple[Experiment, Estimation]]:
        """What the rule takes, motions without a physical case left out."""
        picks = ((e, selected(estimations)) for e, estimations in self.found)
        return [(e, pick) for e, pick in picks if pick is not None]

    @cached_property
    def chosen(self) -> CombinedEstimates | None:
        """The values of the whole vehicle; None where no case of any motion is physical."""
        return combined(self.stated, self.taken) if self.taken else None


def identified(
    vehicle: Vehicle, runs: Sequence[Run], cases: str, edges: Edges, *, trust_log: bool = False
) -> Identified:
    """All chosen cases for every motion that the logs hold."""
    wanted = chosen_cases(cases)
    found = [
        (e, [estimate(e, case, edges) for case in wanted])
        for e in experiments(vehicle, runs, trust_log=trust_log)
    ]
    return Identified(vehicle, found, edges)


def identified_in_parts(
    vehicle: Vehicle,
    logs: Sequence[LongLog],
    cases: str,
    edges: Edges,
    tell: Report,
    *,
    trust_log: bool = False,
) -> Identified:
    """The same from logs that are read in parts."""
    return Identified(
        vehicle,
        estimate_streaming(vehicle, logs, chosen_cases(cases), edges, progress=tell, trust_log=trust_log),
        edges,
    )


def show(done: Identified) -> None:
    """Print a table for each motion, what the rule takes, and what speaks against it."""
    out = console()
    for experiment, estimations in done.found:
        names = ", ".join(run.name for run in experiment.runs)
        section(f"{experiment.axis} ({names}; {estimations[0].samples} samples)")
        out.print(_table(experiment, estimations))
        out.print(text(f"  {_verdict(experiment, estimations)}"), soft_wrap=True)
        for line in _doubts(experiment, estimations):
            out.print(text(f"  {line}", "yellow"), soft_wrap=True)
    out.print(text("± is what (17) of the paper gives; it takes smoothed samples as independent"))
    for line in done.chosen.contradictions if done.chosen else ():
        out.print(text(line, "yellow"), soft_wrap=True)


def _table(experiment: Experiment, estimations: Sequence[Estimation]) -> Any:
    names = estimations[0].names
    heads = ["case", *(_head(experiment, estimations[0], n) for n in names), "residual variance", "physical"]
    return table(heads, [_row(experiment, e) for e in estimations])


def _head(experiment: Experiment, estimation: Estimation, name: str) -> str:
    unit = short_unit(experiment.axis.vehicle.declared_parameters[name].unit)
    return f"{experiment.axis.inertia if name in estimation.inertial else name}, {unit} (|t|)"


def _row(experiment: Experiment, estimation: Estimation) -> list[str]:
    cells = []
    for name in estimation.names:
        value, error = shown(experiment, estimation, name)
        cells.append(f"{value:.6g} ± {error:.2g} ({t_value(value, error):.3g})")
    lacking = "yes" if estimation.valid else "no: " + ", ".join(_named(experiment, estimation))
    return [estimation.case.name, *cells, f"{estimation.residual_variance:.6g}", lacking]


def _named(experiment: Experiment, estimation: Estimation) -> list[str]:
    return [experiment.axis.inertia if n in estimation.inertial else n for n in estimation.impossible]


def shown(experiment: Experiment, estimation: Estimation, name: str) -> tuple[float, float]:
    """A value as the paper prints it, in the signs of the vehicle's file, and its standard error.

    The inertia is the sum of mass and added mass.
    """
    if name in estimation.inertial and len(estimation.inertial) == 1:
        return estimation.inertia
    vehicle = experiment.axis.vehicle
    value = printed(vehicle.declared_parameters[name], estimation.values[name], vehicle.signs)
    return value, estimation.standard_errors[name]


def _verdict(experiment: Experiment, estimations: Sequence[Estimation]) -> str:
    pick = selected(estimations)
    if pick is None:
        return (
            "no case is physical (inertia above that of the body, damping that takes energy): none is taken"
        )
    count = sum(e.valid for e in estimations)
    return f"taken: case {pick.case.name} ({pick.case}); {RULE} ({count} of {len(estimations)} are physical)"


def _doubts(experiment: Experiment, estimations: Sequence[Estimation]) -> list[str]:
    lines = []
    pick = selected(estimations)
    for name, t in t_values(pick).items() if pick else ():
        if t < SURE:
            lines.append(f"{name} is not determined by this experiment: |t| = {t:.2f}")
    rate = experiment.axis.rate
    lacking = [run.name for run in experiment.runs if not run.has(rate)]
    if lacking and any(not e.case.differentiated for e in estimations):
        lines.append(
            f"{', '.join(lacking)}: no column {rate}; the velocity was differentiated (central differences)"
        )
    return lines


def written(done: Identified) -> str:
    """All numbers as JSON, SI and SNAME signs."""
    content = {
        "vehicle": done.stated.name,
        "edges": done.edges,
        "rule": RULE,
        "motions": [
            {
                "motion": experiment.axis.motion,
                "direction": experiment.axis.direction,
                "logs": [{"name": r.name, "sha256": r.sha256} for r in experiment.runs],
                "selected": pick.case.name if (pick := selected(estimations)) else None,
                "cases": [_case(e) for e in estimations],
            }
            for experiment, estimations in done.found
        ],
    }
    return json.dumps(content, indent=1, allow_nan=False) + "\n"


def _case(estimation: Estimation) -> dict[str, Any]:
    return {
        "case": estimation.case.name,
        "estimates": estimation.values,
        "standard_errors": estimation.standard_errors,
        "covariance": estimation.covariance.tolist(),
        "inertia": dict(zip(("value", "standard_error"), estimation.inertia, strict=True)),
        "residual_variance": estimation.residual_variance,
        "samples": estimation.samples,
        "condition": estimation.condition,
        "physical": estimation.valid,
    }


def write(done: Identified, template: Path, target: Path) -> None:
    """Write the vehicle file with what the rule takes, and its covariance.

    Raises
    ------
    UndertowError
        If no case of any motion is physical.
    """
    from undertow.model.saving import save_vehicle

    if done.chosen is None:
        raise UndertowError(f"{target} is not written: no case of any motion is physical")
    save_vehicle(done.chosen.vehicle(done.stated), template, target, history=_history(done, done.chosen))


def _history(done: Identified, taken: CombinedEstimates) -> dict[str, object]:
    cases = ", ".join(f"{e.axis}: case {pick.case.name}" for e, pick in done.taken)
    runs = [run for experiment, _ in done.taken for run in experiment.runs]
    return {
        "command": f"undertow identify --method sg-ls --edges {done.edges} ({cases})",
        "date": date.today().isoformat(),
        "logs": [{"name": r.name, "sha256": r.sha256, "role": "train"} for r in runs],
        "covariance": {"parameters": list(taken.names), "matrix": taken.covariance.tolist()},
    }
