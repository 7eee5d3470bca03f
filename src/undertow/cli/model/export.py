"""Write a vehicle for other programs: a functional mock-up unit, Gazebo, MuJoCo, a C library.

    undertow export fmu bluerov2 --out bluerov2.fmu
    undertow export sdf bluerov2 --out bluerov2.sdf
    undertow export mujoco bluerov2 --out bluerov2.xml
    undertow export c mini-auv --controller paper-pid --out mini_auv

What the other program cannot say is listed; docs/export.md has the whole of it.
"""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from .._options import EffectsOption, NewForceOption, VehicleArgument, new_file
from .._terminal import progress, say, section, table

if TYPE_CHECKING:
    from undertow.export.library import Library

app = typer.Typer(add_completion=False)

_FMI = typer.Option("--fmi", help="Version of FMI.")


@app.callback()
def export() -> None:
    pass


def _out(ending: str) -> object:
    return typer.Option(
        "--out", metavar=f"NEW.{ending}", help=f"Where to write it; NAME.{ending} by default."
    )


@app.command()
def fmu(
    vehicle: VehicleArgument,
    out: Annotated[Path | None, _out("fmu")] = None,
    fmi: Annotated[Literal["2.0", "3.0"], _FMI] = "3.0",
    force: NewForceOption = False,
    effects: EffectsOption = None,
) -> None:
    """Write a functional mock-up unit with its C sources, for co-simulation and model exchange.

    \b
    undertow export fmu bluerov2 --out bluerov2.fmu
    fmpy compile bluerov2.fmu        # for this machine
    fmpy simulate bluerov2.fmu --show-plot

    Inputs are the commands, outputs are pose, velocity and the forces of the actuators; every parameter of
    the model is one of the unit. SI units, NED and forward-starboard-down.
    """
    from undertow.export.fmu import Fmu
    from undertow.files import write_whole
    from undertow.model.loading import load_vehicle

    with progress("writing C", None):
        unit = Fmu(load_vehicle(vehicle, effect_files=effects or []), fmi)
        target = new_file(out or Path(f"{unit.name}.fmu"), force, [vehicle])
        data = unit.archive()
    write_whole(target, data)
    counts = [sum(v.causality == c for v in unit.variables) for c in ("input", "output", "parameter")]
    say(f"wrote {target}: FMI {fmi}, {counts[0]} inputs, {counts[1]} outputs, {counts[2]} parameters")
    _lost(unit.losses)


@app.command()
def sdf(
    vehicle: VehicleArgument,
    out: Annotated[Path | None, _out("sdf")] = None,
    force: NewForceOption = False,
    effects: EffectsOption = None,
) -> None:
    """Write a world for Gazebo with the vehicle in it.

    \b
    undertow export sdf bluerov2 --out bluerov2.sdf
    gz sim bluerov2.sdf
    gz topic -t /model/bluerov2/joint/f5_joint/cmd_thrust -m gz.msgs.Double -p "data: 5"

    Inertia with added mass, damping and lift (system Hydrodynamics), buoyancy (Buoyancy) and thrusters
    (Thruster), turned into forward-left-up. What these cannot say is listed as a warning.
    """
    from undertow.export.sdf import Sdf
    from undertow.files import write_whole
    from undertow.model.loading import load_vehicle

    with progress("writing SDF", None):
        world = Sdf(load_vehicle(vehicle, effect_files=effects or []))
        target = new_file(out or Path(f"{world.name}.sdf"), force, [vehicle])
    write_whole(target, world.text)
    say(f"wrote {target}: {len(world.drag.elements())} terms of damping and lift")
    _lost(world.losses)


@app.command()
def mujoco(
    vehicle: VehicleArgument,
    out: Annotated[Path | None, _out("xml")] = None,
    force: NewForceOption = False,
    effects: EffectsOption = None,
) -> None:
    """Write a model for MuJoCo (MJCF) with the body of the vehicle, without its fluid forces.

    \b
    undertow export mujoco bluerov2 --out bluerov2.xml
    python -m mujoco.viewer --mjcf=bluerov2.xml

    Inertia, weight, buoyancy at its centre and a motor for each thruster, turned into forward-left-up; ctrl
    is thrust in newtons. What MuJoCo cannot say, added mass and damping above all, is listed as a warning.
    """
    from undertow.export.mjcf import Mjcf
    from undertow.files import write_whole
    from undertow.model.loading import load_vehicle

    with progress("writing MJCF", None):
        model = Mjcf(load_vehicle(vehicle, effect_files=effects or []))
        target = new_file(out or Path(f"{model.name}.xml"), force, [vehicle])
    write_whole(target, model.text)
    say(f"wrote {target}: {len(model.vehicle.thrusters)} motors")
    _lost(model.losses)


_CONTROLLER = typer.Option("--controller", metavar="GAINS", help="Gain file or name of a controller.")
_FOLDER = typer.Option("--out", metavar="FOLDER", help="New folder for the library; NAME by default.")
_SIZES = typer.Option("--sizes", metavar="COMPILER", help="Print flash and stack with this compiler and -Os.")


@app.command()
def c(
    vehicle: VehicleArgument,
    controller: Annotated[str | None, _CONTROLLER] = None,
    out: Annotated[Path | None, _FOLDER] = None,
    sizes: Annotated[str | None, _SIZES] = None,
    force: NewForceOption = False,
    effects: EffectsOption = None,
) -> None:
    """Write a C library for boards: vehicle, controller, allocation from newtons to servo pulses.

    \b
    undertow export c mini-auv --controller paper-pid --out mini_auv
    undertow export c mini-auv --sizes "arm-none-eabi-gcc -mcpu=cortex-m4 -mthumb -DMINI_AUV_SINGLE"

    float or double, every parameter in a struct, nothing allocated; with CMakeLists.txt (install target),
    library.properties for Arduino and PlatformIO, README and an example main for each part.
    """
    from undertow.control.gains import load_gains
    from undertow.errors import UndertowError
    from undertow.export.library import Library
    from undertow.model.loading import load_vehicle

    with progress("writing C", None):
        model = load_vehicle(vehicle, effect_files=effects or [])
        library = Library(model, load_gains(controller, model) if controller else None)
        folder = out or Path(library.name)
        taken = [name for name in library.texts if (folder / name).exists()]
        if taken and not force:
            raise UndertowError(
                f"'{folder / taken[0]}' exists already: name another folder with --out, or give --force"
            )
        library.write(folder)
    say(f"wrote {folder}: {len(library.texts)} files")
    if sizes:
        _print_sizes(library, sizes)


def _print_sizes(library: Library, compiler: str) -> None:
    from undertow.export.library import sizes

    flash, stacks = sizes(library, *shlex.split(compiler))
    section("Flash", table(("module", "bytes"), ((name, str(size)) for name, size in flash.items())))
    section("Stack", table(("function", "bytes"), ((s.function, str(s.stack)) for s in stacks)))


def _lost(lines: Sequence[str]) -> None:
    for line in lines:
        say(f"warning: {line}")
