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

from datetime import date
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
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
from undertow.identification.api import Estimator, Refit
from undertow.identification.estimation.fitted import Fitted, base_parameters, correlation, remarks, verdicts
from undertow.identification.estimation.prediction_error import PredictionErrorFit
from undertow.identification.estimation.step import follower_errors, followers, written
from undertow.model.parameter import printed

from ._terminal import console, section, table, text

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
    from undertow.cli._vehicle_and_logs import load
    from undertow.files import check_writable
    from undertow.identification.api import fit as refit

    from ._terminal import progress
    from .add import target_of

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


def show(done: Refit) -> None:
    """Print parameters, how far they can be trusted, and the error before and after."""
    out = console()
    section(f"Parameters by {_METHODS[done.estimator.method]}", _parameters(done))
    out.print(text(f"  condition number {done.fit.condition:.3g}; {_BOUND}"))
    for line in [*_tied(done), *done.fit.active, *_disturbed(done.fit)]:
        out.print(text(f"  {line}"), soft_wrap=True)
    for line in _combined(done.fit):
        out.print(text(f"  {line}", "yellow"), soft_wrap=True)
    for name, said in remarks(done.fit, done.stated).items():
        if said:
            out.print(text(f"  {name}: {'; '.join(said)}", "yellow"), soft_wrap=True)
    horizon = done.before.windows.horizon
    section(f"Velocity error {horizon:.3g} s ahead on kept-aside data, % of the motion", _errors(done))
    if not done.errors[1] <= done.errors[0]:
        out.print(text("the refitted model predicts kept-aside data worse than the model as given", "yellow"))


def show_correlation(fit: Fitted) -> None:
    """Print the correlation matrix of the errors of the estimates."""
    names = fit.model.free
    rows = [(n, *(f"{c:.2f}" for c in row)) for n, row in zip(names, correlation(fit), strict=True)]
    section("Correlation of the errors", table(("", *names), rows))


_BOUND = "bound: the error that the noise of the sensors alone would leave (Cramér-Rao)"
_METHODS = {
    "weak": "the weak form",
    "integral": "the integral form",
    "instrumental": "instrumental variables on the weak form",
    "output-error": "output error",
    "prediction-error": "prediction error",
}


def _parameters(done: Refit) -> object:
    rows = []
    for r in done.parameters.iter_rows(named=True):
        spread, bound, prior = r["standard_error"], r["bound"], r["before"]
        rows.append(
            (
                r["parameter"],
                f"{r['value']:.5g}",
                "" if spread is None else f"± {spread:.2g}",
                "" if bound is None else f"{bound:.2g}",
                r["unit"],
                "" if prior is None else f"{prior:.5g}",
                f"{r['t']:.3g}",
                r["identified"],
            )
        )
    return table(("parameter", "value", "", "bound", "unit", "before", "|t|", "by these logs"), rows)


def _tied(done: Refit) -> list[str]:
    """Parameters that were asked to be a multiple of another one."""
    fit, vehicle = done.fit, done.stated
    values, errors = followers(fit.model, fit.values), follower_errors(fit.model, fit.standard_errors)
    lines = []
    for name, value in values.items():
        shown = printed(vehicle.declaration(name), value, vehicle.signs)
        lines.append(
            f"{name} = {shown:.5g} ± {errors[name]:.2g}, tied to {fit.model.functions.equal[name][0]}"
        )
    return lines


def _disturbed(fit: Fitted) -> list[str]:
    """What prediction error found to push the vehicle beside its model."""
    if not isinstance(fit, PredictionErrorFit):
        return []
    told = ", ".join(f"{name} {np.sqrt(strength):.2g}" for name, strength in fit.disturbance.items())
    slow = ", ".join(f"{name} {np.sqrt(strength):.2g}" for name, strength in fit.wander.items())
    return [
        f"a disturbance changes velocities by {told} in a second (SI); its slow part wanders by {slow} in "
        "acceleration"
    ]


def _combined(fit: Fitted) -> list[str]:
    """What is known only in sums, and which run would tell more."""
    sums = base_parameters(fit.gram, fit.model.free)
    lines = [f"only these sums can be identified: {', '.join(map(str, sums))}"] if sums else []
    lacking = [name for name, verdict in verdicts(fit).items() if verdict != "identified"]
    if lacking:
        lines.append(
            f"undertow plan VEHICLE LOG --only {','.join(lacking)} --out plan.csv designs a better run"
        )
    return lines


def _errors(done: Refit) -> object:
    before, after = done.before.relative, done.after.relative
    rows = [(name, _percent(before[name]), _percent(after[name])) for name in before]
    whole = [_percent(share) for share in done.errors]
    return table(("velocity", "as given", "refitted"), [*rows, ("all", *whole)])


def _percent(share: float) -> str:
    return "diverged" if share == float("inf") else f"{100 * share:.3g}"


def history(done: Refit) -> dict[str, object]:
    """How the values came about, for the vehicle file."""
    roles = [("train", r) for r in done.train] + [("holdout", r) for r in done.test]
    before, after = done.errors
    return {
        "command": " ".join(["undertow fit", *_options(done)]),
        "date": date.today().isoformat(),
        "logs": [{"name": r.name, "sha256": r.sha256, "role": role} for role, r in roles],
        "error_before": before,
        "error_after": after,
        "covariance": {"parameters": list(done.fit.model.free), "matrix": done.fit.covariance.tolist()},
    }


def _options(done: Refit) -> list[str]:
    e = done.estimator
    tied = [f'--equal "{text}"' for text in written(e.constraints.equal, done.stated)]
    loss = [] if e.loss == "gaussian" else [f"--loss {e.loss}"]
    ahead = [] if e.horizon in (None, Estimator.horizon) else [f"--horizon {e.horizon:.9g}"]
    return [
        f"--method {e.method}",
        *loss,
        *ahead,
        *tied,
        *(["--dissipative"] if e.constraints.dissipative else []),
    ]


def write(done: Refit, template: Path, target: Path) -> None:
    """Write the vehicle file with the fitted values."""
    from undertow.model.saving import save_vehicle

    save_vehicle(done.fit.vehicle, template, target, history=history(done))
    console().print(text(f"wrote {target}"))
