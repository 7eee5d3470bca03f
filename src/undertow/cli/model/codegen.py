"""Write C code of a vehicle into build/NAME/, or check that it is current.

Written are model.c and model.h (dynamics, Jacobians, residual, regressor and outputs in plain C99), an
example main.c that steps the model, a CMakeLists.txt and a manifest. What has changed since the last time is
printed.

With --controller a control law with its gains is written, too, as controller.c and controller.h in a folder
of its own: one step function with schedule, thrust allocation and anti-windup, and only math.h behind it.

    undertow codegen mini-auv --controller paper-pid

With --path the controller follows a mission: reference or line of sight, and law, in that one step function.

With --observer a Kalman filter is written as observer.c and observer.h: predict, and one update for each
sensor of the observer file (undertow observe --save writes one from a log).

With --check nothing is written; the exit code is 1 when the code does not fit the files any more.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from undertow.errors import UndertowError

from .._options import EffectsOption, VehicleArgument
from .._terminal import progress

if TYPE_CHECKING:
    from undertow.codegen.export import Export, Report
    from undertow.control.controller import ControllerExport
    from undertow.model.vehicle import Vehicle
    from undertow.observer.export import ObserverExport

_OUT = typer.Option("--out", metavar="FOLDER", help="Folder that gets a folder NAME for the vehicle.")
_CHECK = typer.Option("--check", help="Write nothing; exit with 1 when the code is missing or stale.")
_CONTROLLER = typer.Option(
    "--controller", metavar="GAINS", help="Gain file (TOML), or the name of a bundled one: write that, too."
)

_OBSERVER = typer.Option("--observer", metavar="FILE", help="Observer file (TOML): write that filter, too.")
_PATH = typer.Option("--path", metavar="MISSION.toml", help="The controller follows this mission.")


def codegen(
    vehicle: VehicleArgument,
    controller: Annotated[str | None, _CONTROLLER] = None,
    path: Annotated[Path | None, _PATH] = None,
    observer: Annotated[Path | None, _OBSERVER] = None,
    out: Annotated[Path, _OUT] = Path("build"),
    check: Annotated[bool, _CHECK] = False,
    effects: EffectsOption = None,
) -> int:
    from undertow.codegen.export import Export
    from undertow.files import together
    from undertow.model.loading import load_vehicle

    if path is not None and controller is None:
        raise UndertowError(f"--path {path} is followed by a controller: give --controller GAINS, too")
    with progress("writing C", None):
        model = load_vehicle(vehicle, effect_files=effects or [])
        exports: list[Export | ControllerExport | ObserverExport] = [Export(model)]
        if controller is not None:
            exports.append(_controller_export(controller, model, path))
        if observer is not None:
            exports.append(_observer_export(observer, model))
        with together():
            found = [export.check(out) if check else export.write(out) for export in exports]
    given = {"--controller": controller, "--path": path, "--observer": observer}
    again = " ".join([vehicle, *(f"{name} {value}" for name, value in given.items() if value is not None)])
    return max([_checked(report, again) if check else _written(report) for report in found])


def _controller_export(gains: str, vehicle: Vehicle, path: Path | None) -> ControllerExport:
    from undertow.control.controller import Controller, ControllerExport
    from undertow.control.gains import load_gains
    from undertow.control.guidance.mission import load_mission

    chosen = load_gains(gains, vehicle)
    reference = load_mission(path).reference(chosen) if path else None
    export = ControllerExport(Controller(chosen, reference))
    assert export.texts  # what cannot be stated in C is refused before anything is written
    return export


def _observer_export(path: Path, vehicle: Vehicle) -> ObserverExport:
    from undertow.observer.design import load_observer
    from undertow.observer.export import ObserverExport

    export = ObserverExport(load_observer(path, vehicle))
    assert export.texts
    return export


def _written(report: Report) -> int:
    typer.echo(f"{report.folder}: written")
    _say(["first time"] if report.first else report.changes or ["nothing has changed since the last time"])
    return 0


def _checked(report: Report, vehicle: str) -> int:
    stale = report.first or report.changes
    if not stale:
        typer.echo(f"{report.folder}: current")
        return 0
    typer.echo(f"{report.folder}: {'missing' if report.first else 'stale'}; run undertow codegen {vehicle}")
    _say(report.changes)
    return 1


def _say(lines: Sequence[str]) -> None:
    for line in lines:
        typer.echo(f"  {line}")
