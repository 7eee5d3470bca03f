"""Refit the parameters that a vehicle file marks as estimated, and judge the result on data kept aside.

By the weak form (quick, needs no simulation; integral is its simplest kind), by output error: simulation of
many windows with the start of each estimated, too (the final word), or by prediction error where something
pushes the vehicle that no log holds: its strength is estimated with the parameters. Instrumental variables
take the bias out of the weak form that noisy velocities cause, by regressors of the simulated motion. Every
value comes with its standard error; values that the logs do not determine, or that are far from what was
stated before, are pointed out.

    undertow fit rov.toml run1.csv run2.csv --holdout run3.csv --method output-error --out fitted.toml

Where sensors have outliers, --loss huber or student-t keeps them from pulling (by output error; the weak form
leaves out samples that stand off their neighbours).

    undertow fit rov.toml run1.csv run2.csv --method output-error --loss student-t

The mass matrix stays positive, and coefficients keep within what is physical. Coefficients that are known
to be alike are fitted as one, with --equal; stated standard deviations (sigma), taken five times
as wide, hold what logs leave open.

    undertow fit float.toml run1.csv --equal "Y_vdot = Z_wdot" --equal "M_q = 0.9 N_r"

Without --holdout, stretches of the logs are kept aside. Without --out and --in-place nothing is written.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from undertow.cli._vehicle_and_logs import (
    EffectsOption,
    FillOption,
    FromOption,
    HoldoutOption,
    InPlaceOption,
    LogsArgument,
    MapOption,
    OutOption,
    ToOption,
    TrustOption,
    VehicleArgument,
)

_METHOD = typer.Option("--method", help="Weak form, or simulation without or with a disturbance.")
_LOSS = typer.Option("--loss", help="How much an error counts: squares, or less for outliers.")
_EQUAL = typer.Option(
    "--equal", metavar='"A = B"', help='Fit A as B, or as a multiple of it: "M_q = 0.9 N_r"; may be repeated.'
)
_DISSIPATIVE = typer.Option(
    "--dissipative", help="Let linear damping take energy from every motion, coupling included."
)
_CORRELATION = typer.Option("--correlation", help="Print how the errors of the parameters hang together.")
_HORIZON = typer.Option("--horizon", metavar="SECONDS", help="Length of the simulated windows.", min=0.001)


def fit(
    vehicle: VehicleArgument,
    logs: LogsArgument,
    holdout: HoldoutOption = None,
    method: Annotated[
        Literal["weak", "integral", "instrumental", "output-error", "prediction-error"], _METHOD
    ] = "weak",
    loss: Annotated[Literal["gaussian", "huber", "student-t"], _LOSS] = "gaussian",
    horizon: Annotated[float, _HORIZON] = 5.0,
    equal: Annotated[list[str] | None, _EQUAL] = None,
    dissipative: Annotated[bool, _DISSIPATIVE] = False,
    correlation: Annotated[bool, _CORRELATION] = False,
    out: OutOption = None,
    in_place: InPlaceOption = False,
    map: MapOption = None,
    effects: EffectsOption = None,
    since: FromOption = None,
    until: ToOption = None,
    fill: FillOption = None,
    trust_log: TrustOption = False,
) -> None:
    from undertow.cli._adding import target_of
    from undertow.cli._fitting import show, show_correlation, write
    from undertow.cli._progress import progress
    from undertow.cli._vehicle_and_logs import load
    from undertow.files import check_writable
    from undertow.identification.public import fit as refit

    target = target_of(vehicle, out, in_place)
    read: list[str | Path] = [*logs, *(holdout or []), *(effects or []), *([map] if map else [])]
    check_writable(target, inputs=[*read, *([] if in_place else [vehicle])])
    loaded = load(
        vehicle, logs, holdout, map=map, effects=effects, window=(since, until), fill=fill, to_fit=True
    )
    with progress("fitting") as tell:
        done = refit(
            loaded.vehicle,
            loaded.train,
            loaded.holdout,
            method=method,
            horizon=horizon,
            loss=loss,
            equal=equal or [],
            dissipative=dissipative,
            report=tell,
            trust_log=trust_log,
        )
    show(done)
    if correlation:
        show_correlation(done.fit)
    if target is None:
        typer.echo("nothing was written: --out NEW.toml or --in-place writes the vehicle file")
    else:
        write(done, loaded.path, target)
