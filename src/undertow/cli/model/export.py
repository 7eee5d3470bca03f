"""Write a vehicle for other programs: functional mock-up unit, Gazebo, MuJoCo, Stonefish, auv_controllers, C.

    undertow export fmu bluerov2 --out bluerov2.fmu
    undertow export sdf bluerov2 --out bluerov2.sdf
    undertow export mujoco bluerov2 --out bluerov2.xml
    undertow export stonefish bluerov2 --out bluerov2.scn
    undertow export auv-controllers bluerov2 --out bluerov2.urdf
    undertow export c mini-auv --controller paper-pid

What the other program cannot represent is listed; docs/export.md has the details.
"""

from __future__ import annotations

import shlex
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeVar

import typer

from undertow.errors import UndertowError

from .._options import EffectsOption, NewForceOption, VehicleArgument, new_file
from .._terminal import progress, say, section, table

if TYPE_CHECKING:
    from undertow.codegen.library import Library
    from undertow.codegen.manifest import Report
    from undertow.export.body import Body
    from undertow.model.vehicle import Vehicle

B = TypeVar("B", bound="Body")

app = typer.Typer(add_completion=False)


def _out(ending: str) -> object:
    return typer.Option("--out", metavar=f"NEW.{ending}", help=f"Output file; NAME.{ending} by default.")


@app.command()
def fmu(
    vehicle: VehicleArgument,
    out: Annotated[Path | None, _out("fmu")] = None,
    fmi: Annotated[Literal["2.0", "3.0"], typer.Option(help="Version of FMI.")] = "3.0",
    force: NewForceOption = False,
    effects: EffectsOption = None,
) -> None:
    """Write a functional mock-up unit with its C sources, for co-simulation and model exchange.

    \b
    undertow export fmu bluerov2 --out bluerov2.fmu
    fmpy compile bluerov2.fmu        # for this machine
    fmpy simulate bluerov2.fmu --show-plot

    Inputs are the commands; outputs are pose, velocity and actuator forces; every parameter of the model is a
    parameter of the unit. SI units, NED and forward-starboard-down.
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
    """Write a Gazebo world that contains the vehicle.

    \b
    undertow export sdf bluerov2 --out bluerov2.sdf
    gz sim bluerov2.sdf
    gz topic -t /model/bluerov2/joint/f5_joint/cmd_thrust -m gz.msgs.Double -p "data: 5"

    Inertia with added mass, damping and lift (system Hydrodynamics), buoyancy (Buoyancy) and thrusters
    (Thruster), converted to forward-left-up. What these cannot represent is listed as a warning.
    """
    from undertow.export.sdf import Sdf

    world = _body(Sdf, vehicle, out, "sdf", force, effects)
    say(f"{len(world.drag)} terms of damping and lift")
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

    Inertia, weight, buoyancy at its centre and a motor for each thruster, converted to forward-left-up; ctrl
    is thrust in newtons. What MuJoCo cannot represent, above all added mass and damping, is listed as a
    warning.
    """
    from undertow.export.mjcf import Mjcf

    model = _body(Mjcf, vehicle, out, "xml", force, effects)
    say(f"{len(model.vehicle.thrusters)} motors")
    _lost(model.losses)


@app.command()
def stonefish(
    vehicle: VehicleArgument,
    out: Annotated[Path | None, _out("scn")] = None,
    force: NewForceOption = False,
    effects: EffectsOption = None,
) -> None:
    """Write a scenario for Stonefish with the body of the vehicle, its drag along the axes and its thrusters.

    \b
    undertow export stonefish bluerov2 --out bluerov2.scn

    Inertia, weight, buoyancy at its centre and a push for each thruster, NED and forward-starboard-down.
    Stonefish derives fluid forces from a shape, here a cube with the displaced volume of the vehicle. What it
    cannot represent, above all added mass, is listed as a warning.
    """
    from undertow.export.stonefish import Stonefish

    _lost(_body(Stonefish, vehicle, out, "scn", force, effects).losses)


@app.command()
def auv_controllers(
    vehicle: VehicleArgument,
    out: Annotated[Path | None, _out("urdf")] = None,
    force: NewForceOption = False,
    effects: EffectsOption = None,
) -> None:
    """Write the robot description that the ROS 2 package auv_controllers reads.

    \b
    undertow export auv-controllers bluerov2 --out bluerov2.urdf

    It writes the element hydrodynamics (mass and inertia, added mass, linear and quadratic damping of each
    motion, buoyancy) for the robot description; NED and forward-starboard-down, SNAME signs. What it cannot
    represent is listed as a warning.
    """
    from undertow.export.auv_controllers import AuvControllers

    _lost(_body(AuvControllers, vehicle, out, "urdf", force, effects).losses)


def _body(
    program: Callable[[Vehicle], B],
    vehicle: str,
    out: Path | None,
    ending: str,
    force: bool,
    effects: list[Path] | None,
) -> B:
    """The vehicle for a program that builds it from parts, written to a file."""
    from undertow.files import write_whole
    from undertow.model.loading import load_vehicle

    with progress("writing", None):
        body = program(load_vehicle(vehicle, effect_files=effects or []))
        target = new_file(out or Path(f"{body.name}.{ending}"), force, [vehicle])
    write_whole(target, body.text)
    say(f"wrote {target}")
    return body


_CONTROLLER = typer.Option(
    metavar="GAINS", help="Gain file (TOML), or name of a bundled one; may be repeated."
)
_OBSERVER = typer.Option(metavar="FILE", help="Observer file (TOML); may be repeated.")
_PATH = typer.Option(metavar="MISSION.toml", help="Mission file that the controllers follow.")
_FOLDER = typer.Option(metavar="FOLDER", help="Output folder; files go into a subfolder NAME.")
_CHECK = typer.Option("--check", help="Write nothing; exit code 1 if the code is missing or out of date.")
_SIZES = typer.Option(
    metavar="COMPILER",
    help="Flash and stack sizes are printed as compiled at -Os with this compiler and its flags.",
    show_default="arm-none-eabi-gcc for a Cortex-M4 in float, else gcc, if installed",
)


@app.command()
def c(
    vehicle: VehicleArgument,
    controller: Annotated[list[str] | None, _CONTROLLER] = None,
    path: Annotated[Path | None, _PATH] = None,
    observer: Annotated[list[Path] | None, _OBSERVER] = None,
    out: Annotated[Path, _FOLDER] = Path("build"),
    check: Annotated[bool, _CHECK] = False,
    sizes: Annotated[str | None, _SIZES] = None,
    effects: EffectsOption = None,
) -> int:
    """Write a C library into build/NAME/: model, Jacobians, thrusters, controllers, observers.

    \b
    undertow export c mini-auv --controller paper-pid
    undertow export c mini-auv --sizes "arm-none-eabi-gcc -mcpu=cortex-m4 -mthumb -DMINI_AUV_SINGLE"

    C99 in float or double, using only math.h, without dynamic memory; parameters, gains and allocation in
    structs; with CMakeLists.txt (install target), library.properties for Arduino and PlatformIO, README, an
    example main for each module and a manifest. Changes since the last time are printed. Edited examples are
    kept.

    A controller is one step function with schedule, thrust allocation and anti-windup; with --path it follows
    a mission: reference or line of sight, and law. An observer is predict, and one update for each sensor
    (undertow observe --save writes its file from a log). With --check nothing is written; the exit code is 1
    if the code no longer matches the files.
    """
    from undertow.control.gains import load_gains
    from undertow.control.guidance.mission import load_mission
    from undertow.control.update import library_of
    from undertow.model.loading import load_vehicle
    from undertow.observer.design import load_observer

    if path is not None and not controller:
        raise UndertowError(f"--path {path} is for a controller: also give --controller GAINS")
    with progress("writing C", None):
        model = load_vehicle(vehicle, effect_files=effects or [])
        library = library_of(
            model,
            [load_gains(g, model) for g in controller or []],
            [load_observer(f, model) for f in observer or []],
            load_mission(path) if path else None,
        )
        assert library.texts  # what cannot be stated in C is refused before anything is written
        report = library.check(out) if check else library.write(out)
    options = [f"--controller {g}" for g in controller or []] + ([f"--path {path}"] if path else [])
    again = " ".join(["undertow export c", vehicle, *options, *(f"--observer {f}" for f in observer or [])])
    code = _checked(report, again) if check else _written(report)
    _lost(library.losses)
    if sizes or not check:
        _print_sizes(library, sizes)
    return code


def _written(report: Report) -> int:
    say(f"{report.folder}: written")
    _say(["first time"] if report.first else report.changes or ["nothing has changed since the last time"])
    return 0


def _checked(report: Report, again: str) -> int:
    stale = report.first or report.changes
    if not stale:
        say(f"{report.folder}: current")
        return 0
    say(f"{report.folder}: {'missing' if report.first else 'stale'}; run {again}")
    _say(report.changes)
    return 1


def _say(lines: Sequence[str]) -> None:
    for line in lines:
        say(f"  {line}")


def _print_sizes(library: Library, asked: str | None) -> None:
    """Flash and stack by the compiler that is asked for, else by the first usual one that is installed."""
    from undertow.codegen.library import sizes, usual_compilers

    usual = ((words, flags) for words, flags in usual_compilers(library) if shutil.which(flags[0]))
    target, command = (asked, shlex.split(asked)) if asked else next(usual, ("", []))
    if not command:
        return
    with progress("compiling for the sizes", None):
        flash, stacks = sizes(library, *command)
    section(f"Sizes by {target}, -Os")
    section("Flash", table(("module", "bytes"), ((name, str(size)) for name, size in flash.items())))
    section("Stack", table(("function", "bytes"), ((s.function, str(s.stack)) for s in stacks)))


def _lost(lines: Sequence[str]) -> None:
    for line in lines:
        say(f"warning: {line}")
