"""Estimate pose and velocities from the sensors of a log, smoothed, with standard deviations.

An extended (or unscented) Kalman filter and a Rauch-Tung-Striebel smoother process the log. Sensors may
report at different rates, late (a velocity_delay in the vehicle file), or not at all. The innovations are
tested for consistency with the filter's covariance (NIS) and for whiteness.

    undertow observe rov.toml dive.csv --map log.toml --out smoothed.csv --plot observed.png

    undertow observe rov.toml dive.csv --process model --current --bias r

--process kinematics, the default, uses no forces: the acceleration is a random walk. Its velocities may be
used to diagnose a log that has none:

    undertow observe rov.toml dive.csv --out smoothed.csv
    undertow diagnose rov.toml smoothed.csv

--process model predicts with the equations of the vehicle file. It is more accurate if the model is right,
and can estimate the current (--current), but it is biased towards the model: a diagnosis of such a log only
confirms the model that produced it. It is therefore written only with --trust-model.

Sensor noise is taken from the mapping file, or from differences of the log; process noise is estimated by
maximum likelihood.

Several logs (or segments of one) each have their own filter and noise; the tests are over all of them. Output
files are numbered in the order of the logs (smoothed-1.csv ...), and an observer file has the noise of all.

    undertow observe rov.toml dive1.csv dive2.csv --out smoothed.csv

--reference names a log of true states (motion capture, or undertow simulate --states), one for each log, on
the same clock, with a mapping file of its own name beside it if need be. The errors of the filter are then
tested by its covariance (NEES), by group of states.

    undertow observe rov.toml dive.csv --reference mocap.csv
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from undertow.errors import UndertowError

from .._options import JsonOption, VehicleArgument, bundled, words
from .._terminal import print_json, progress, say, section, table, write_files
from ._logs import LogsArgument, ReadOptions

if TYPE_CHECKING:
    from undertow.identification.logs.run import Run
    from undertow.identification.observe import Observed, ObservedLogs
    from undertow.model.vehicle import Vehicle

_Pair = tuple[Path | None, Path | None]
_PROCESS = typer.Option(help="Process model: kinematics alone, or the vehicle model.")
_FILTER = typer.Option(
    help="Extended or unscented Kalman filter.",
    show_default="ukf with the model (less sensitive to an unknown initial velocity), else ekf",
)
_CURRENT = typer.Option("--current", help="Estimate the velocity of the water (only with the model).")
_BIAS = typer.Option(metavar="NAMES", help="Estimate biases of velocity sensors, as u,v,r.")
_REFERENCE = typer.Option(metavar="LOG", help="Log of true states, for NEES; once for each log.")
_OUT = typer.Option(metavar="LOG.csv", help="Write pose, velocities, commands and deviations.")
_TRUST_MODEL = typer.Option("--trust-model", help="Write --out even if the velocities come from the model.")
_SAVE = typer.Option(metavar="NEW.toml", help="Write an observer file for simulate, linearize and export c.")
_PLOT = typer.Option(metavar="OUT.png", help="Draw estimates with two sigma, and the NIS.")


@bundled
def observe(
    vehicle: VehicleArgument,
    logs: LogsArgument,
    options: ReadOptions,
    process: Annotated[Literal["kinematics", "model"], _PROCESS] = "kinematics",
    filter: Annotated[Literal["ekf", "ukf"] | None, _FILTER] = None,
    current: Annotated[bool, _CURRENT] = False,
    bias: Annotated[str | None, _BIAS] = None,
    reference: Annotated[list[Path] | None, _REFERENCE] = None,
    out: Annotated[Path | None, _OUT] = None,
    trust_model: Annotated[bool, _TRUST_MODEL] = False,
    save: Annotated[Path | None, _SAVE] = None,
    plot: Annotated[Path | None, _PLOT] = None,
    json: JsonOption = False,
) -> None:
    from undertow.files import check_writable
    from undertow.identification.observe import observe_logs, observer_file

    given = reference or []
    check_writable(out, save, plot, inputs=[vehicle, *logs, *given, *options.files])
    if out is not None and process == "model" and not trust_model:
        raise UndertowError(
            f"--out {out}: velocities from the model must not be used for its own diagnosis; use --process "
            "kinematics, or --trust-model if the log is for another purpose"
        )
    model, runs = _read(vehicle, logs, options)
    true = _references(model, runs, logs, given)
    estimated = (*(("V_N", "V_E") if current else ()), *(f"b_{n}" for n in words([bias] if bias else [])))
    with progress("observing") as report:
        found = observe_logs(
            model, runs, process=process, estimated=estimated, method=filter, references=true, progress=report
        )

    names = _of_each(out, plot, runs)
    check_writable(*(path for pair in names for path in pair), inputs=[*logs, *given, *options.files])
    write_files(
        *(pair for n, one, run in zip(names, found.each, runs, strict=True) for pair in _files(n, one, run)),
        (save, lambda path: observer_file(found, runs, path.stem, filter or "ekf")),
        silent=json,
    )
    if json:
        print_json(found.content())
    else:
        _show_all(found)


def _files(names: _Pair, one: Observed, run: Run) -> list[tuple[Path | None, Callable[[Path], object]]]:
    """The table and the picture of a log, with what makes them."""
    from undertow.identification.observe import csv, observed_picture

    return [(names[0], lambda _: csv(one)), (names[1], lambda _: observed_picture(one, run))]


def _of_each(out: Path | None, plot: Path | None, runs: Sequence[Run]) -> list[_Pair]:
    """The table and the picture of every log: numbered where there are several."""
    if len(runs) == 1:
        return [(out, plot)]

    def numbered(path: Path | None, k: int) -> Path | None:
        return path and path.with_name(f"{path.stem}-{k}{path.suffix}")

    return [(numbered(out, k), numbered(plot, k)) for k in range(1, len(runs) + 1)]


def _read(vehicle: str, logs: Sequence[Path], options: ReadOptions) -> tuple[Vehicle, list[Run]]:
    """The vehicle and the logs, as they are: an observer derives nothing."""
    from undertow.identification.logs.reading import read_logs
    from undertow.model.loading import load_vehicle

    model = load_vehicle(vehicle, effect_files=options.effects or [])
    window, fill = (options.since, options.until), options.fill
    runs = read_logs(
        list(logs), model, options.mapping, window=window, missing_commands=fill or "gap", one_motion=True
    )
    return model, list(runs)


def _references(
    model: Vehicle, runs: Sequence[Run], logs: Sequence[Path], given: Sequence[Path]
) -> list[list[Run]]:
    """The segments of the reference of every run; nothing without references."""
    from undertow.identification.logs.reading import read_logs

    if not given:
        return []
    if len(given) != len(logs):
        raise UndertowError(
            f"--reference names {len(given)} files, but there are {len(logs)} logs: repeat the option "
            "for each log, in their order"
        )
    read = {
        str(log): read_logs([path], model, one_motion=True) for log, path in zip(logs, given, strict=True)
    }
    return [read[run.source] for run in runs]


def _show_all(found: ObservedLogs) -> None:
    """Print each log, then the tests over all."""
    for one in found.each:
        if len(found.each) > 1:
            section(one.run.name)
        show(one)
    if len(found.each) > 1:
        innovations(f"Innovations of all {len(found.each)} logs", found)
        say(verdict(found), "bold")
        errors(f"Errors of the filter in all {len(found.each)} logs", found)


def show(found: Observed) -> None:
    """Print sensors, noise, estimated parameters and the tests."""
    innovations(f"Innovations ({found.process})", found)
    driven = [(n, f"{v:.3g}") for n, v in found.disturbance.items()]
    section("Process noise on the rates, root of the spectral density", table(("state", "SI, s^0.5"), driven))
    if found.parameters:
        values = [(n, f"{v:.4g}", f"{s:.2g}") for n, (v, s) in found.parameters.items()]
        section("Estimated", table(("parameter", "value", "sigma"), values))
    say(verdict(found), "bold")
    errors("Errors of the filter", found)


def innovations(title: str, found: Observed | ObservedLogs) -> None:
    """Print the tests by sensor."""
    white = {one.name: one for one in found.white}
    rows = []
    for one in found.nis[:-1]:
        p = f"{white[one.name].p_value:.2g}" if one.name in white else ""
        gone = found.rejected.get(one.name, 0)
        numbers = (f"{found.noise[one.name]:.3g}", str(one.count), f"{gone or ''}", f"{one.mean:.3f}")
        rows.append((one.name, *numbers, f"{one.low:.3f} to {one.high:.3f}", p))
    head = ("sensor", "noise", "reports", "rejected", "NIS", "95%", "white, p")
    section(title, table(head, rows))


def errors(title: str, found: Observed | ObservedLogs) -> None:
    """Print the test against true states, if there are some."""
    if not found.nees:
        return
    rows = [
        (
            one.name,
            " ".join(one.states),
            str(one.count),
            f"{one.independent:.0f}",
            f"{one.mean:.3f}",
            f"{one.low:.3f} to {one.high:.3f}",
        )
        for one in found.nees
    ]
    section(title, table(("group", "states", "squares", "independent", "NEES", "95%"), rows))
    say(verdict_of_errors(found), "bold")


def verdict_of_errors(found: Observed | ObservedLogs) -> str:
    """One line on the errors against true states."""
    outside = [one for one in found.nees if not one.consistent]
    if not outside:
        return f"errors are as large as expected (NEES {found.nees[-1].mean:.3f})"
    faults = [f"NEES of {one.name} {one.mean:.3f}, not {one.low:.3f} to {one.high:.3f}" for one in outside]
    large = {one.mean > one.high for one in outside}
    words = {True: "too small", False: "too large"}
    how = words[large.pop()] if len(large) == 1 else "wrong"
    return f"{'; '.join(faults)}: the standard deviations of the filter are {how}"


_KINEMATIC = (
    "noise is not as stated, or the acceleration jumps (thruster steps), where kinematics are overconfident"
)


def verdict(found: Observed | ObservedLogs) -> str:
    """One line on the whole."""
    whole = found.nis[-1]
    if found.consistent:
        return f"innovations are as large as expected (NIS {whole.mean:.3f}) and white"
    faults = [] if whole.consistent else [f"NIS {whole.mean:.3f}, not {whole.low:.3f} to {whole.high:.3f}"]
    faults += [f"{count} reports of {name} are rejected" for name, count in found.lost.items()]
    coloured = [one.name for one in found.white if not one.white]
    faults += [f"innovations of {', '.join(coloured)} are not white"] if coloured else []
    what = "noise or model are not as stated" if found.process == "model" else _KINEMATIC
    return f"{'; '.join(faults)}: {what}, so the standard deviations are not reliable"
