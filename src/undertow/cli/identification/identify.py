"""Estimate added mass and damping from forced motion by the paper's method: filters, then least squares.

Each log holds one motion (surge, heave, yaw ...) driven by a known force, as from a towing tank or a flow
solver: a velocity, the force tau_X (Y, Z, K, M, N) or the thruster commands, and if possible the acceleration
u_dot (v_dot ...); without it, velocities are differentiated. Velocity and acceleration are smoothed by
Savitzky-Golay filters in eleven ways (--cases, Tables 1 to 3 of the paper), and least squares gives added
mass and damping for each of them. If a vehicle has different values for forward and backward motion, each is
estimated from the logs in that direction.

    undertow identify mini-auv surge.csv heave.csv yaw.csv --cases all --out identified.toml

Among the cases whose estimates are all physical, the one with the least residual variance is selected.

    undertow identify mini-auv surge.csv --figures figures

draws velocity and acceleration before and after filtering, as Figures 6 to 12 of the paper do.

Long logs are read in parts, in constant memory and with the same answer: those of more than 200 MB (unpacked)
automatically if possible, shorter ones with --stream.

    undertow identify mini-auv week.parquet --stream

This is the baseline for other methods: filtering the motion but not the force biases the estimates, and the
stated errors treat smoothed samples as independent. `undertow fit` avoids both.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from .._options import InPlaceOption, JsonFileOption, OutOption, VehicleArgument, bundled, target_of
from .._terminal import console, progress, say, section, table, text, write_files
from ._logs import LogOptions, LogsArgument

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from undertow.paper.least_squares import Estimation, Experiment, Identified
    from undertow.paper.regression import Edges

_METHOD = typer.Option(help="Savitzky-Golay filters, then least squares.")
_CASES = typer.Option(metavar="all|N,N", help="Filter cases, by their number in the paper.")
_EDGES = typer.Option(help="How filters treat the ends of a log; interp is as in MATLAB's sgolayfilt.")
_STREAM = typer.Option("--stream", help="Read the logs in parts, even short ones.")
_FIGURES = typer.Option(metavar="FOLDER", help="Draw the filtered signals: Figures 6 to 12 of the paper.")
_LONG = 200_000_000  # bytes, unpacked; a week of one motion at 100 Hz


@bundled
def identify(
    vehicle: VehicleArgument,
    logs: LogsArgument,
    options: LogOptions,
    method: Annotated[Literal["sg-ls"], _METHOD] = "sg-ls",
    cases: Annotated[str, _CASES] = "all",
    edges: Annotated[Literal["interp", "drop", "nearest", "mirror", "constant", "wrap"], _EDGES] = "interp",
    stream: Annotated[bool, _STREAM] = False,
    figures: Annotated[Path | None, _FIGURES] = None,
    json: JsonFileOption = None,
    out: OutOption = None,
    in_place: InPlaceOption = False,
) -> None:
    target = target_of(vehicle, out, in_place, json, inputs=[*logs, *options.files])
    if figures is not None:
        _check_figures(figures, logs, stream)
    done = _identified(vehicle, logs, cases, edges, stream, options)
    show(done)

    def draw(_: Path) -> dict[str, Figure]:
        from undertow.paper.figures import figures

        return figures([experiment for experiment, _ in done.found], edges)

    write_files((figures, draw), (json, done.to_json()), (target, partial(done.save, vehicle)), silent=True)
    typer.echo(
        "no vehicle file was written: --out NEW.toml or --in-place writes it"
        if target is None
        else f"wrote {target}"
    )


def _are_long(logs: Sequence[Path]) -> bool:
    from undertow.identification.logs.table import size_of

    return sum(map(size_of, logs)) > _LONG


def _check_figures(folder: Path, logs: Sequence[Path], stream: bool) -> None:
    """Refuse pictures of logs that are read in parts, or a folder that cannot be one."""
    from undertow.errors import UndertowError
    from undertow.files import check_folder

    check_folder(folder)
    if stream or _are_long(logs):
        raise UndertowError(
            "--figures needs logs that are read whole: leave out --stream, or give a part (--from)"
        )


def _identified(
    vehicle: str, logs: list[Path], cases: str, edges: Edges, stream: bool, options: LogOptions
) -> Identified:
    """Estimates; from parts of the logs where that is asked for or they are long."""
    from undertow.identification.logs.chunks import NeedsWhole
    from undertow.model.loading import load_vehicle
    from undertow.paper.least_squares import identify, identify_in_parts

    if stream or _are_long(logs):
        try:
            with progress("reading logs") as report:
                model = load_vehicle(vehicle, effect_files=options.effects or ())
                long = options.in_parts(model, logs)
                return identify_in_parts(
                    model, long, cases, edges, progress=report, trust_log=options.trust_log
                )
        except NeedsWhole:
            if stream:
                raise
    model, runs, *_ = options.load(vehicle, logs, one_motion=True)
    with progress("estimating", None):
        return identify(model, runs, cases, edges, trust_log=options.trust_log)


def show(done: Identified) -> None:
    """Print a table for each motion, what the rule takes, and what speaks against it."""
    for experiment, estimations in done.found:
        names = ", ".join(run.name for run in experiment.runs)
        section(f"{experiment.axis} ({names}; {estimations[0].samples} samples)")
        console().print(_table(experiment, estimations))
        say(f"  {_verdict(estimations)}")
        for line in _doubts(experiment, estimations):
            say(f"  {line}", "yellow")
    console().print(text("± is from (17) of the paper, which takes smoothed samples as independent"))
    for line in done.chosen.contradictions if done.chosen else ():
        say(line, "yellow")


def _table(experiment: Experiment, estimations: Sequence[Estimation]) -> Any:
    names = estimations[0].names
    heads = ["case", *(_head(experiment, estimations[0], n) for n in names), "residual variance", "physical"]
    return table(heads, [_row(experiment, e) for e in estimations])


def _head(experiment: Experiment, estimation: Estimation, name: str) -> str:
    from undertow.model.units import short_unit

    unit = short_unit(experiment.axis.vehicle.declared_parameters[name].unit)
    return f"{_name(experiment, estimation, name)}, {unit} (|t|)"


def _row(experiment: Experiment, estimation: Estimation) -> list[str]:
    from undertow.identification.estimation.fitted import t_value

    cells = []
    for name in estimation.names:
        value, error = _printed(experiment, estimation, name)
        cells.append(f"{value:.6g} ± {error:.2g} ({t_value(value, error):.3g})")
    impossible = ", ".join(_name(experiment, estimation, name) for name in estimation.impossible)
    lacking = f"no: {impossible}" if impossible else "yes"
    return [estimation.case.name, *cells, f"{estimation.residual_variance:.6g}", lacking]


def _name(experiment: Experiment, estimation: Estimation, name: str) -> str:
    return experiment.axis.inertia if name in estimation.inertial else name


def _printed(experiment: Experiment, estimation: Estimation, name: str) -> tuple[float, float]:
    """A value (inertia: mass and added mass) in the signs of the vehicle file, and its standard error."""
    from undertow.model.parameter import printed

    if name in estimation.inertial and len(estimation.inertial) == 1:
        return estimation.inertia
    vehicle = experiment.axis.vehicle
    value = printed(vehicle.declared_parameters[name], estimation.values[name], vehicle.signs)
    return value, estimation.standard_errors[name]


def _verdict(estimations: Sequence[Estimation]) -> str:
    from undertow.paper.least_squares import RULE, selected

    pick = selected(estimations)
    if pick is None:
        return (
            "no case is physical (inertia above that of the body, damping that dissipates energy): "
            "none is selected"
        )
    count = sum(e.valid for e in estimations)
    return (
        f"selected: case {pick.case.name} ({pick.case}); {RULE} ({count} of {len(estimations)} are physical)"
    )


def _doubts(experiment: Experiment, estimations: Sequence[Estimation]) -> list[str]:
    from undertow.identification.estimation.fitted import SIGNIFICANT_T, t_values
    from undertow.paper.least_squares import selected

    lines = []
    pick = selected(estimations)
    for name, t in t_values(pick).items() if pick else ():
        if t < SIGNIFICANT_T:
            lines.append(f"{name} is not determined by this experiment: |t| = {t:.2f}")
    rate = experiment.axis.rate
    lacking = [run.name for run in experiment.runs if not run.has(rate)]
    if lacking and any(not e.case.differentiated for e in estimations):
        lines.append(
            f"{', '.join(lacking)}: no column {rate}; the velocity was differentiated (central differences)"
        )
    return lines
