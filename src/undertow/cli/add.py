"""Put an effect into a vehicle file, refit, regenerate the code, and show the error before and after.

The effect is added to the model, everything that is marked as estimated is refitted with it, and both models
are judged on data that was kept aside: the logs given with --holdout, or stretches of the logs where none is
given. Parameters of the effect that prove to be zero are left out (--all keeps them).

    undertow add ocean_current rov.toml run1.csv run2.csv --holdout run3.csv --out better.toml

Without --out and --in-place nothing is written. The exit code is 1, and nothing is written either, where the
effect does not lower the error on kept-aside data; --force writes it all the same.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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

if TYPE_CHECKING:
    from undertow.cli._vehicle_and_logs import Loaded
    from undertow.identification.diagnosis.addition import Addition, Ground
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
    from undertow.cli._adding import code_of, draw, show, target_of, tell_written, write
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
    ground, addition = _added(wanted, loaded, all, trust_log)
    show(addition)
    code, taken = None, target if addition.helps or force else None
    with together() as files:
        if picture is not None:
            draw(addition, picture)
        if taken is not None:
            write(addition, ground, loaded.path, taken)
            code = code_of(files.place_of(taken), effects or [], build) if codegen else None
    tell_written(picture, taken, code)
    if not addition.helps and not force:
        typer.echo(f"{effect} does not lower the error on kept-aside data: {_unwritten(target)}", err=True)
        return 1
    if target is None:
        typer.echo("nothing was written: --out NEW.toml or --in-place writes the vehicle file")
    return 0


def _added(effect: type[Effect], loaded: Loaded, keep_all: bool, trust_log: bool) -> tuple[Ground, Addition]:
    from undertow.cli._progress import progress
    from undertow.identification.diagnosis.addition import add_effect, lay_ground

    with progress("fitting the model as it is") as tell:
        ground = lay_ground(loaded.vehicle, loaded.train, loaded.holdout, trust_log=trust_log)
        tell(0.3, f"fitting it with {effect.id}")
        return ground, add_effect(effect, ground, keep_all=keep_all)


def _unwritten(target: Path | None) -> str:
    return "--force puts it in all the same" if target is None else "nothing was written; --force writes it"
