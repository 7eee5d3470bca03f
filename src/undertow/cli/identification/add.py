"""Add effects to a vehicle file, refit, regenerate the code, and show the error before and after.

The effect is added to the model, all parameters marked as estimated are refitted with it, and both models are
evaluated on validation data: the logs given with --validation, or segments of the logs if none is given.
Parameters of the effect that turn out to be zero are left out (--all keeps them). Several effects, with
commas between them, are added one by one.

    undertow add ocean_current rov.toml run1.csv run2.csv --validation run3.csv --out better.toml
    undertow add rudder_drag,hull_cubic ship.toml run1.csv run2.csv --out better.toml

Without --out or --in-place, nothing is written. If the error on validation data is not lowered, nothing is
written either and the exit code is 1; --force writes the file anyway.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from undertow.errors import listed

from .._options import InPlaceOption, JsonFileOption, OutOption, VehicleArgument, bundled, target_of, words
from .._terminal import progress, say, section, table
from ._logs import LogOptions, LogsArgument, ValidationOption, refuse_vehicle_as_effect, say_long

if TYPE_CHECKING:
    from undertow.codegen.manifest import Report
    from undertow.identification.diagnosis.addition import Addition
    from undertow.model.vehicle import Vehicle

_EFFECT = typer.Argument(metavar="EFFECT[,EFFECT]", help="Ids of effects; 'undertow effects' lists them.")
_FORCE = typer.Option("--force", help="Add the effects even if they do not reduce the error.")
_CODEGEN = typer.Option("--codegen/--no-codegen", help="Regenerate the C code of the new vehicle.")
_BUILD = typer.Option(metavar="FOLDER", help="Folder for the code; it goes into a subfolder NAME.")
_PICTURE = typer.Option(metavar="FILE.png", help="Draw the error before and after.")


@bundled
def add(
    effect: Annotated[str, _EFFECT],
    vehicle: VehicleArgument,
    logs: LogsArgument,
    options: LogOptions,
    validation: ValidationOption = None,
    out: OutOption = None,
    in_place: InPlaceOption = False,
    all: Annotated[
        bool, typer.Option("--all", help="Also keep parameters that turn out to be zero.")
    ] = False,
    force: Annotated[bool, _FORCE] = False,
    codegen: Annotated[bool, _CODEGEN] = True,
    build: Annotated[Path, _BUILD] = Path("build"),
    picture: Annotated[Path | None, _PICTURE] = None,
    json: JsonFileOption = None,
) -> int:
    from undertow.files import check_folder, together, write_whole
    from undertow.identification.api import result_of, save_addition, try_effect
    from undertow.identification.long_logs.choosing import FIT
    from undertow.model.catalogue import lookup

    known, effects = options.known, words([effect])
    refuse_vehicle_as_effect(effect, vehicle, known)
    for name in effects:
        lookup(name, known)  # before any log is read
    read = [*logs, *(validation or []), *options.files]
    target = target_of(vehicle, out, in_place, picture, json, inputs=read)
    if target is not None and codegen:
        check_folder(build)
    loaded = options.load(vehicle, logs, validation, to_fit=True, budget=FIT, out=target)
    model, train, test, _, _ = loaded
    with progress("fitting the model as given") as report:
        setup, addition = try_effect(
            model, effects, train, test, known=known, keep_all=all, report=report, trust_log=options.trust_log
        )
    show(addition, setup.vehicle)
    long = loaded.checked(
        {"as given": setup.vehicle, f"with {listed(addition.effects)}": addition.fit.vehicle}
    )
    say_long(long)
    code, taken = None, target if addition.helps or force else None
    with progress("writing", None), together() as files:
        if picture is not None:
            _draw(addition, picture)
        if json is not None:
            result = result_of(setup, addition).model_copy(update={"long_logs": long})
            write_whole(json, result.to_json())
        if taken is not None:
            save_addition(setup, addition, vehicle, taken)
            code = _code_of(files.place_of(taken), options, build) if codegen else None
    _show_written([picture, json, taken], code)
    if not addition.helps and not force:
        written = "--force adds it anyway" if target is None else "--force writes it anyway"
        are = "is" if len(effects) == 1 else "are"
        typer.echo(f"{listed(effects)} {are} not added to the vehicle file; {written}", err=True)
        return 1
    if target is None:
        typer.echo("nothing was written: --out NEW.toml or --in-place writes the vehicle file")
    return 0


def show(addition: Addition, stated: Vehicle) -> None:
    """Say what the effects do to the error, and with which values, in the signs of the vehicle file."""
    from undertow.identification.diagnosis.verdict import estimate, values_by_run
    from undertow.identification.report.results import addition_sentence
    from undertow.identification.report.sentences import percentage

    say(addition_sentence(addition), "" if addition.helps else "yellow")
    added = listed(addition.effects)
    names = ("model as given", f"refitted without {added}", f"refitted with {added}")
    horizons = list(dict.fromkeys(h for step in addition.steps for h in step.ahead))
    rows = [
        (name, f"{step.error:.4g}", *(percentage(step.ahead.get(h), 3) for h in horizons))
        for name, step in zip(names, addition.steps, strict=True)
    ]
    heads = ("", "force, times noise", *(f"{h}, %" for h in horizons))
    section("Error on validation data: of the force, and of velocities ahead", table(heads, rows))
    for name in addition.kept:
        say(f"  {estimate(addition.fit, name, stated)}")
    for values in values_by_run(addition.fit, stated):
        say(f"  {values}")
    for line in addition.fit.active:
        say(f"  {line}", "yellow")
    if addition.dropped:
        say(f"left out (zero within their error, or predicting no better): {', '.join(addition.dropped)}")


def _draw(addition: Addition, out: Path) -> None:
    from undertow.figures import save_png
    from undertow.identification.report.pictures import falling_error

    save_png(falling_error(addition.steps), out)


def _code_of(vehicle: Path, options: LogOptions, build: Path) -> Report:
    from undertow.codegen.library import Library
    from undertow.model.loading import load_vehicle

    return Library(load_vehicle(vehicle, effect_files=options.effects or ())).write(build)


def _show_written(files: Sequence[Path | None], code: Report | None) -> None:
    """Say where the files and the code of the vehicle are, and what has changed in the code."""
    for path in filter(None, files):
        say(f"wrote {path}")
    if code is not None:
        say(f"wrote the code in {code.folder}")
        for line in code.changes:
            say(f"  {line}")
