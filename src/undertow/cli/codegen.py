"""Write C code of a vehicle into build/NAME/, or check that it is current.

Written are model.c and model.h (dynamics, Jacobians, residual, regressor and outputs in plain C99), an
example main.c that steps the model, a CMakeLists.txt and a manifest. What has changed since the last time is
printed.

With --check nothing is written; the exit code is 1 when the code does not fit the vehicle file any more.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from undertow.cli._vehicle_and_logs import EffectsOption, VehicleArgument

if TYPE_CHECKING:
    from undertow.codegen.export import Report

_OUT = typer.Option("--out", metavar="FOLDER", help="Folder that gets a folder NAME for the vehicle.")
_CHECK = typer.Option("--check", help="Write nothing; exit with 1 when the code is missing or stale.")


def codegen(
    vehicle: VehicleArgument,
    out: Annotated[Path, _OUT] = Path("build"),
    check: Annotated[bool, _CHECK] = False,
    effects: EffectsOption = None,
) -> int:
    from undertow.codegen.export import Export
    from undertow.model.loading import load_vehicle

    export = Export(load_vehicle(vehicle, effect_files=effects or []))
    if check:
        return _checked(export.check(out), vehicle)
    report = export.write(out)
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
