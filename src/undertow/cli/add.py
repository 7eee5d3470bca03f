"""Put an effect into a vehicle file, refit, regenerate the code, and show the error before and after.

The effect is added to the model, everything that is marked as estimated is refitted with it, and both models
are judged on data that was kept aside: the logs given with --holdout, or stretches of the logs where none is
given. Parameters of the effect that prove to be zero are left out (--all keeps them).

    undertow add ocean_current rov.toml run1.csv run2.csv --holdout run3.csv --out better.toml

Without --out and --in-place nothing is written. The exit code is 1, and nothing is written either, where the
effect does not lower the error on kept-aside data; --force writes it all the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.markup import escape

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
from undertow.errors import UndertowError

if TYPE_CHECKING:
    from undertow.cli._vehicle_and_logs import Loaded
    from undertow.codegen.export import Report
    from undertow.identification.diagnosis.addition import Addition, AdditionSetup
    from undertow.identification.diagnosis.result import Step
    from undertow.model.effect import Effect


_EFFECT = typer.Argument(metavar="EFFECT", help="Id of the effect; 'undertow effects' lists them.")
_ALL = typer.Option("--all", help="Keep parameters that prove to be zero, too.")
_FORCE = typer.Option("--force", help="Write the effect even where it does not help.")
_CODEGEN = typer.Option("--codegen/--no-codegen", help="Regenerate the C code of the new vehicle.")
_BUILD = typer.Option("--build", metavar="FOLDER", help="Folder that gets a folder NAME with the code.")
_PICTURE = typer.Option("--picture", metavar="FILE.png", help="Draw the error before and after.")


def add(
    effect: Annotated[str, _EFFECT],
    vehicle: VehicleArgument,
    logs: LogsArgument,
    holdout: HoldoutOption = None,
    out: OutOption = None,
    in_place: InPlaceOption = False,
    all: Annotated[bool, _ALL] = False,
    force: Annotated[bool, _FORCE] = False,
    map: MapOption = None,
    effects: EffectsOption = None,
    since: FromOption = None,
    until: ToOption = None,
    fill: FillOption = None,
    trust_log: TrustOption = False,
    codegen: Annotated[bool, _CODEGEN] = True,
    build: Annotated[Path, _BUILD] = Path("build"),
    picture: Annotated[Path | None, _PICTURE] = None,
) -> int:
    from undertow.cli._vehicle_and_logs import load
    from undertow.files import check_writable, together
    from undertow.model.catalogue import catalogue, load_effects, lookup, merge

    wanted = lookup(effect, merge(catalogue(), [cls for file in effects or [] for cls in load_effects(file)]))
    target = target_of(vehicle, out, in_place)
    read: list[str | Path] = [*logs, *(holdout or []), *(effects or []), *([map] if map else [])]
    check_writable(target, picture, inputs=[*read, *([] if in_place else [vehicle])])
    loaded = load(
        vehicle, logs, holdout, map=map, effects=effects, window=(since, until), fill=fill, to_fit=True
    )
    setup, addition = _added(wanted, loaded, all, trust_log)
    show(addition)
    code, taken = None, target if addition.helps or force else None
    with together() as files:
        if picture is not None:
            draw(addition, picture)
        if taken is not None:
            write(addition, setup, loaded.path, taken)
            code = code_of(files.place_of(taken), effects or [], build) if codegen else None
    tell_written(picture, taken, code)
    if not addition.helps and not force:
        typer.echo(f"{effect} does not lower the error on kept-aside data: {_unwritten(target)}", err=True)
        return 1
    if target is None:
        typer.echo("nothing was written: --out NEW.toml or --in-place writes the vehicle file")
    return 0


def _added(
    effect: type[Effect], loaded: Loaded, keep_all: bool, trust_log: bool
) -> tuple[AdditionSetup, Addition]:
    from undertow.identification.diagnosis.addition import add_effect, set_up_addition

    from ._terminal import progress

    with progress("fitting the model as it is") as tell:
        setup = set_up_addition(loaded.vehicle, loaded.train, loaded.holdout, trust_log=trust_log)
        tell(0.3, f"fitting it with {effect.id}")
        return setup, add_effect(effect, setup, keep_all=keep_all)


def _unwritten(target: Path | None) -> str:
    return "--force puts it in all the same" if target is None else "nothing was written; --force writes it"


def target_of(vehicle: str, out: Path | None, in_place: bool) -> Path | None:
    """The vehicle file to be written, or None.

    Raises
    ------
    UndertowError
        If a file would be replaced that the user has not asked to be replaced.
    """
    from undertow.model.loading import bundled_vehicles, resolve_vehicle

    path = resolve_vehicle(vehicle)
    if out is not None and in_place:
        raise UndertowError("both --out and --in-place are given: choose one")
    if in_place and path in bundled_vehicles().values():
        raise UndertowError(f"'{vehicle}' comes with undertow and stays as it is: use --out")
    if out is not None and out.exists() and out.samefile(path):
        raise UndertowError(f"--out '{out}' is the vehicle file itself: name another, or give --in-place")
    return path if in_place else out


def show(addition: Addition) -> None:
    """Say what the effect does to the error, and with which values."""
    from undertow.identification.estimation.step import NOTHING_SAID

    console = Console(highlight=False)
    names = ("model as given", f"refitted without {addition.effect}", f"refitted with {addition.effect}")
    width = max(map(len, names))
    console.print("Error on kept-aside data (1 = noise of the sensors):")
    for name, step in zip(names, addition.steps, strict=True):
        console.print(f"  {name:{width}} {_errors(step)}")
    if not addition.helps:
        console.print(f"[yellow]{addition.effect} does not help[/yellow]: no fall, or none beyond chance.")
    errors, units = addition.fit.standard_errors, addition.fit.vehicle.declared_parameters
    for name in addition.kept:
        spread = f"± {errors[name]:.1g} " if errors[name] < NOTHING_SAID else ""
        text = f"  {name} = {addition.fit.values[name]:.4g} {spread}{units[name].unit}"
        console.print(escape(text.rstrip()))
    if addition.dropped:
        console.print(f"left out, zero within their error: {', '.join(addition.dropped)}")


def _errors(step: Step) -> str:
    ahead = "" if step.prediction is None else f", velocity error 5 s ahead {step.prediction:.1%}"
    return f"{step.error:.3g}{ahead}"


def draw(addition: Addition, out: Path) -> None:
    """The error before and after as a picture."""
    from undertow.identification.figures import save_png
    from undertow.identification.report.pictures import falling_error

    save_png(falling_error(addition.steps), out)


def write(addition: Addition, setup: AdditionSetup, template: Path, out: Path) -> None:
    """Write the vehicle file with the effect, and how it came about."""
    from undertow.model.saving import save_vehicle

    save_vehicle(addition.fit.vehicle, template, out, history=_history(addition, setup))


def _history(addition: Addition, setup: AdditionSetup) -> dict[str, object]:
    roles = [("train", r) for r in setup.train] + [("holdout", r) for r in setup.test]
    fit = addition.fit
    return {
        "command": "undertow add",
        "date": date.today().isoformat(),
        "added": [addition.effect],
        "helps": addition.helps,
        "logs": [{"name": r.name, "sha256": r.sha256, "role": role} for role, r in roles],
        "error_before": addition.before.error,
        "error_after": addition.after.error,
        "covariance": {"parameters": list(fit.model.free), "matrix": fit.covariance.tolist()},
    }


def code_of(vehicle: Path, effects: Sequence[Path], build: Path) -> Report:
    """Regenerate the C code of a vehicle file."""
    from undertow.codegen.export import Export
    from undertow.model.loading import load_vehicle

    return Export(load_vehicle(vehicle, effect_files=effects)).write(build)


def tell_written(picture: Path | None, vehicle: Path | None, code: Report | None) -> None:
    """Say where the picture, the vehicle file and its code are, and what has changed in the code."""
    console = Console(highlight=False)
    for path in filter(None, (picture, vehicle)):
        console.print(f"wrote {escape(str(path))}")
    if code is not None:
        console.print(f"wrote the code in {escape(str(code.folder))}")
        for line in code.changes:
            console.print(f"  {escape(line)}")
