"""Refit the parameters that a vehicle file marks as estimated, and evaluate the result on validation data.

By default the weak form comes first (quick, needs no simulation), then output error: simulation of many
windows, with estimated initial states. The windows are as long as the vehicle's own time constants, and whole
runs where the residual is close to noise; the result is kept if it predicts validation data no worse.
--method chooses one method alone: weak; integral, its simplest kind; output-error, over windows of --horizon
seconds; prediction-error, for vehicles disturbed by unmeasured forces, whose intensity is estimated together
with the parameters; or instrumental variables, which remove the bias that noisy velocities cause in the weak
form, with regressors from the simulated motion. Every value comes with its standard error. Values that the
logs do not determine, or that are far from the stated ones, are reported.

    undertow fit rov.toml run1.csv run2.csv --validation run3.csv --method output-error --out fitted.toml

If sensors have outliers, --loss huber or student-t limits their influence (for output error; the weak form
drops samples that differ from their neighbours).

    undertow fit rov.toml run1.csv run2.csv --method output-error --loss student-t

The mass matrix stays positive definite, and coefficients stay within physical limits. --equal ties
coefficients that are known to be equal. Parameters that the logs do not determine are constrained by the
stated standard deviations (sigma, widened five times) or, if none is stated, by what is plausible for a
vehicle of this mass, inertia and length.

    undertow fit float.toml run1.csv --equal "Y_vdot = Z_wdot" --equal "M_q = 0.9 N_r"

In logs from a towing tank or a planar motion mechanism, few motions are free. Logs with the same free motions
form an experiment, which is fitted separately; the results are combined in one vehicle file:

    undertow fit rov.toml surge.csv heave.csv yaw.csv --held unlogged --out fitted.toml

Without --map, a mapping file with the name of a log (surge.toml next to surge.csv) is used for that log.
Without --validation, segments of the logs are used for validation. Without --out or --in-place, nothing is
written. If the refitted model predicts validation data worse than the model as given, no vehicle file is
written and the exit code is 1; --force writes it anyway.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from .._options import InPlaceOption, JsonFileOption, OutOption, VehicleArgument, bundled, target_of
from .._terminal import console, progress, say, section, table, text, write_files
from ._logs import LogsArgument, RigOptions, ValidationOption, of_experiment, say_long

if TYPE_CHECKING:
    from undertow.identification.api import Refit
    from undertow.identification.estimation.fitted import Fitted
    from undertow.identification.report.sentences import CommandLine

_METHOD = typer.Option(help="Estimator; default: the weak form, then output error.")
_LOSS = typer.Option(help="Loss function; huber and student-t resist outliers.")
_EQUAL = typer.Option(
    metavar='"A = B"', help='Set A equal to B, or to a multiple of it: "M_q = 0.9 N_r"; may be repeated.'
)
_DISSIPATIVE = typer.Option(
    "--dissipative", help="Constrain linear damping to dissipate energy in every motion, including coupling."
)
_CORRELATION = typer.Option("--correlation", help="Print the correlation of the parameter errors.")
_FORCE = typer.Option("--force", help="Write the vehicle file even if it predicts worse.")
_HORIZON = typer.Option(metavar="SECONDS", help="Length of the simulated windows.", min=0.001)


@bundled
def fit(
    vehicle: VehicleArgument,
    logs: LogsArgument,
    options: RigOptions,
    validation: ValidationOption = None,
    method: Annotated[
        Literal["default", "weak", "integral", "instrumental", "output-error", "prediction-error"], _METHOD
    ] = "default",
    loss: Annotated[Literal["gaussian", "huber", "student-t"], _LOSS] = "gaussian",
    horizon: Annotated[float, _HORIZON] = 5.0,
    equal: Annotated[list[str] | None, _EQUAL] = None,
    dissipative: Annotated[bool, _DISSIPATIVE] = False,
    correlation: Annotated[bool, _CORRELATION] = False,
    out: OutOption = None,
    in_place: InPlaceOption = False,
    force: Annotated[bool, _FORCE] = False,
    json: JsonFileOption = None,
) -> int:
    from undertow.identification.api import combine_fits
    from undertow.identification.api import fit as refit
    from undertow.identification.diagnose import experiments, on_rig
    from undertow.identification.long_logs.choosing import FIT

    read = [*logs, *(validation or []), *options.files]
    target = target_of(vehicle, out, in_place, json, inputs=read)
    loaded = options.load(vehicle, logs, validation, to_fit=True, on_rig=True, budget=FIT, out=target)
    model, train, test, _, _ = loaded
    parts = experiments(model, train, test)  # one, of the vehicle itself, where no rig holds a motion
    fits = []
    for part in parts:
        with progress(f"fitting {part.name}" if len(parts) > 1 else "fitting") as report:
            done = refit(
                part.vehicle,
                part.train,
                part.test,
                method=method,
                horizon=horizon,
                loss=loss,
                equal=equal or [],
                dissipative=dissipative,
                report=report,
                trust_log=options.trust_log,
            )
        fits.append(done)
    rig = on_rig(model, [*train, *test])
    for part, done in zip(parts, fits, strict=True):
        if rig:
            say(str(part), "bold")
        show(done, options.line(vehicle, logs, validation))
        if correlation:
            show_correlation(done.fit)
    together = combine_fits(model, fits)
    for line in together.disagreements():
        say(line, "yellow")
    long = loaded.checked({"as given": fits[0].stated, "refitted": fits[0].vehicle})
    say_long(long)
    results = [done.result().model_copy(update={"long_logs": long}) for done in fits]
    worse = [result for result in results if result.worse]
    refused = bool(worse) and target is not None and not force
    files = [of_experiment(json, part.name if len(parts) > 1 else "") for part in parts]
    save = partial(together.save, vehicle, command=fits[0].command) if rig else partial(fits[0].save, vehicle)
    write_files(
        *((path, r.to_json()) for path, r in zip(files, results, strict=True)),
        (None if refused else target, save),
    )
    if refused:
        typer.echo(f"{worse[0].sentence()} No vehicle file was written; --force writes it", err=True)
        return 1
    if target is None:
        typer.echo("nothing was written: --out NEW.toml or --in-place writes the vehicle file")
    return 0


def show(done: Refit, given: CommandLine) -> None:
    """Print the error before and after, the parameters, and how far they can be trusted."""
    from undertow.identification.estimation.fitted import notes

    say(done.result().sentence())
    section(f"Parameters by {_METHODS[done.estimator.method]}", _parameters(done))
    console().print(text(f"  condition number {done.fit.condition:.3g}; {_BOUND}"))
    for line in [*_tied(done), *done.fit.active, *_process_noise(done.fit)]:
        say(f"  {line}")
    for line in [*notes(done.fit), *_combined(done.fit, given)]:
        say(f"  {line}", "yellow")
    for values in done.by_run:
        say(f"  {values}")
    for name, doubts in done.remarks.items():
        say(f"  {name}: {'; '.join(doubts)}", "yellow")
    horizon = done.before.windows.horizon
    section(f"Velocity error {horizon:.3g} s ahead on validation data, % of the motion", _errors(done))


def show_correlation(fit: Fitted) -> None:
    """Print the correlation matrix of the errors of the estimates."""
    from undertow.identification.estimation.fitted import correlation

    names = fit.model.free
    rows = [(n, *(f"{c:.2f}" for c in row)) for n, row in zip(names, correlation(fit), strict=True)]
    section("Correlation of the errors", table(("", *names), rows))


_BOUND = "bound: the error that sensor noise alone would leave (Cramér-Rao)"
_METHODS = {
    "default": "the weak form, then output error",
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
    from undertow.identification.estimation.step import follower_errors, followers
    from undertow.model.parameter import printed

    fit, vehicle = done.fit, done.stated
    values, errors = followers(fit.model, fit.values), follower_errors(fit.model, fit.standard_errors)
    lines = []
    for name, value in values.items():
        shown = printed(vehicle.declaration(name), value, vehicle.signs)
        lines.append(
            f"{name} = {shown:.5g} ± {errors[name]:.2g}, tied to {fit.model.functions.equal[name][0]}"
        )
    return lines


def _process_noise(fit: Fitted) -> list[str]:
    """What prediction error found to push the vehicle beside its model."""
    import numpy as np

    from undertow.identification.estimation.prediction_error import PredictionErrorFit

    if not isinstance(fit, PredictionErrorFit):
        return []
    quick = ", ".join(f"{name} {np.sqrt(strength):.2g}" for name, strength in fit.disturbance.items())
    slow = ", ".join(f"{name} {np.sqrt(strength):.2g}" for name, strength in fit.random_walk.items())
    return [
        f"the disturbance changes velocities by {quick} in one second (SI); its slow part varies by {slow} "
        "in acceleration"
    ]


def _combined(fit: Fitted, given: CommandLine) -> list[str]:
    """What is known only in sums, and which run would determine more."""
    from undertow.identification.estimation.fitted import base_parameters, verdicts
    from undertow.identification.planning.manoeuvres import can_be_planned

    sums = base_parameters(fit.gram, fit.model.free)
    lines = [f"only these combinations can be identified: {', '.join(map(str, sums))}"] if sums else []
    lacking = [name for name, verdict in verdicts(fit).items() if verdict != "identified"]
    if lacking and can_be_planned(fit.model.functions.vehicle):
        plan = given.on_logs(["plan"], "--only", ",".join(lacking), "--out", "plan.csv")
        lines.append(f"to plan a better run: {plan}")
    return lines


def _errors(done: Refit) -> object:
    before, after = done.before.relative, done.after.relative
    rows = [(name, _percent(before[name]), _percent(after[name])) for name in before]
    whole = [_percent(share) for share in done.errors]
    return table(("velocity", "as given", "refitted"), [*rows, ("all", *whole)])


def _percent(share: float) -> str:
    return "diverged" if share == float("inf") else f"{100 * share:.3g}"
