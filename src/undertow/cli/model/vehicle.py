"""Draft a vehicle file from a hull, a type and its dimensions, a log's parameters, or a towing tank.

    undertow vehicle new --mesh hull.stl --unit mm --frame FLU --mass 12 --cg 0,0,0.02 --out my.toml

    undertow vehicle new --type torpedo --length 1.33 --beam 0.19 --height 0.19 --mass 30.5 --out my.toml

    undertow vehicle new --log dive.bin --out my.toml

    undertow vehicle new --tank tank/ --out my.toml

    undertow vehicle new --mesh usv.stl --mass 55 --cg 0,0,-0.05 --floating --wave 3,0.1,180 --out usv.toml

    undertow vehicles show my.toml

`undertow vehicles` lists and shows existing vehicle files.
"""

from __future__ import annotations

import logging
import shlex
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from undertow.errors import UndertowError

from .._options import NewForceOption, new_file, words
from .._terminal import console, progress, say, table, text

if TYPE_CHECKING:
    from undertow.shape.bodies import AddedMass
    from undertow.shape.floating_vehicle import FloatingVehicle
    from undertow.shape.hull_vehicle import EffectTable, HullSpec
    from undertow.shape.mesh import Hull, Mesh


UnitOption = Annotated[
    str | None,
    typer.Option("--unit", metavar="UNIT", help="Length unit of the mesh.", show_default="m, if plausible"),
]
FrameOption = Annotated[
    str,
    typer.Option(
        "--frame",
        metavar="XYZ",
        help="Directions of x, y and z of the mesh: Forward or Back, Right or Left, Down or Up.",
    ),
]
PanelsOption = Annotated[
    int,
    typer.Option("--panels", metavar="N", help="Largest number of panels, on the finest of three meshes."),
]
CreaseOption = Annotated[
    float,
    typer.Option(
        "--crease",
        metavar="DEGREES",
        help="Edges with a smaller angle are treated as a coarsely meshed curve.",
    ),
]

Method = Literal["auto", "panels", "ellipsoid", "box"]

app = typer.Typer(add_completion=False)

Kind = Literal["rov6", "rov8", "torpedo", "glider", "ship", "asv", "azimuth"]

_MESH = typer.Option(metavar="HULL", help="Closed surface of the hull: STL, OBJ or MSH.")
_TYPE = typer.Option(
    "--type", help="Instead of a mesh: a type of vehicle; needs --length, --beam and --height."
)
_LOG = typer.Option(
    metavar="LOG",
    help="Instead of mesh and mass: an ArduSub log (.bin, .tlog), whose parameters give frame and motors.",
)
_TANK = typer.Option(
    metavar="FOLDER",
    help="Virtual towing tank that has been run (undertow tank), alone or with the --mesh of the same hull.",
)
_LENGTH = typer.Option(metavar="M", help="With --type: overall length, for ships that of the waterline.")
_BEAM = typer.Option(
    metavar="M", help="With --type: overall width; of catamarans across both hulls, of gliders without wings."
)
_HEIGHT = typer.Option(
    metavar="M", help="With --type: overall height; for ship, asv and azimuth the draught."
)
_CG = typer.Option(
    metavar="X,Y,Z", help="Centre of gravity with respect to the origin, m: forward, right, down."
)
_ORIGIN = typer.Option(help="Origin of the vehicle: its centre of buoyancy, or the origin of the mesh.")
_DOF = typer.Option(
    metavar="NAME,NAME",
    help="Degrees of freedom of the model; with --type a subset of its own.",
    show_default="all six; with --type its own",
)
_VOLUME = typer.Option(
    metavar="M3",
    help="Displaced volume of a hull that floods; the rest of the hull contains water that moves with it.",
    show_default="volume enclosed by the hull",
)
_CD = typer.Option(
    metavar="X,Y,Z",
    help="Drag coefficients for the projected areas.",
    show_default="from the form of the hull",
)
_ADDED = typer.Option(help="From panels, or from a body of the same extents; auto: panels if installed.")
_FLOATING = typer.Option(
    "--floating", help="The hull floats at the surface: waterplane stiffness and wave radiation."
)
_WAVE = typer.Option(
    metavar="RAD/S,M,DEGREES",
    help="With --floating: add the forces of a regular wave of this frequency, amplitude and direction of "
    "travel.",
)
_NAME = typer.Option(
    metavar="NAME", help="Name of the vehicle.", show_default="name of the mesh; with --type of the new file"
)
_OUT = typer.Option(metavar="NEW.toml", help="Output file.", show_default="NAME.toml")


def three(text: str, option: str) -> tuple[float, float, float]:
    """Three finite numbers out of an option."""
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError as error:
        raise UndertowError(f"{option} '{text}' is not three numbers: write it like 0.1,0,-0.02") from error
    if not all(map(isfinite, (x, y, z))):
        raise UndertowError(f"{option} '{text}': every number must be finite")
    return x, y, z


def read(path: Path, unit: str | None, frame: str) -> Hull:
    """A hull out of a file; what had to be mended is a warning."""
    from undertow.shape.mesh import read_hull

    hull = read_hull(path, unit=unit, frame=frame)
    for remark in hull.remarks:
        logging.getLogger("undertow").warning("%s: %s", path, remark)
    return hull


@app.command()
def new(
    mass: Annotated[float | None, typer.Option(metavar="KG", help="Dry mass of the vehicle.")] = None,
    mesh: Annotated[Path | None, _MESH] = None,
    log: Annotated[Path | None, _LOG] = None,
    tank: Annotated[Path | None, _TANK] = None,
    kind: Annotated[Kind | None, _TYPE] = None,
    length: Annotated[float | None, _LENGTH] = None,
    beam: Annotated[float | None, _BEAM] = None,
    height: Annotated[float | None, _HEIGHT] = None,
    unit: UnitOption = None,
    frame: FrameOption = "FRD",
    cg: Annotated[str, _CG] = "0,0,0",
    origin: Annotated[Literal["buoyancy", "mesh"], _ORIGIN] = "buoyancy",
    density: Annotated[float, typer.Option(metavar="KG/M3", help="Density of the water.")] = 1000.0,
    dof: Annotated[str | None, _DOF] = None,
    volume: Annotated[float | None, _VOLUME] = None,
    cd: Annotated[str | None, _CD] = None,
    added_mass: Annotated[Method, _ADDED] = "auto",
    panels: PanelsOption = 3200,
    crease: CreaseOption = 30.0,
    floating: Annotated[bool, _FLOATING] = False,
    wave: Annotated[str | None, _WAVE] = None,
    name: Annotated[str | None, _NAME] = None,
    out: Annotated[Path | None, _OUT] = None,
    force: NewForceOption = False,
) -> None:
    """Draft a vehicle file: inertia, added mass, drag, weight and buoyancy from a hull and its mass.

    From the mesh it takes volume, centre of buoyancy, projected areas and inertia (mass spread evenly); added
    mass from panels (extra undertow[bem]) or from a box or ellipsoid of the same extents; drag from
    coefficients for blunt, rounded or streamlined hulls. Each value has its source and a standard deviation;
    added mass, drag and buoyancy are marked to be estimated from logs. You have to state the thrusters.

    With --floating the hull floats at the draught that its mass gives, with the origin in the waterline:
    waterplane stiffness, added mass at infinite frequency, and wave radiation as a passive state-space model
    (needs the extra undertow[bem]). --wave adds forces and mean drift of a regular wave for every heading.

    With --type, no mesh is needed: dimensions and mass give a complete file, with thrusters, rudders and fins
    where such vehicles have them. Each value names the rule that it follows (ellipsoids, Clarke's regression,
    ITTC 1957, Hoerner).

    With --log, the file is the bundled BlueROV2 with the frame of the log (six or eight thrusters), the motor
    directions from the log's parameters, and the thrust curve of a T200 at the battery voltage.

    With --tank, the file has the motions tested there: added mass, linear and quadratic damping with errors
    of the fit and of the grid. The other motions come from --mesh, if the same hull is given.
    """
    from undertow.files import sha256_of, write_whole
    from undertow.model.symbols import DOFS
    from undertow.shape.hull_vehicle import HullSpec, hull_vehicle, motions

    chosen = None if dof is None else motions(words([dof]))
    sides = (length, beam, height)
    if log is not None or (tank is not None and mesh is None):
        if any(given is not None for given in (mass, mesh, kind, *sides, tank and log)):
            source = (
                "--log takes mass and shape from a bundled vehicle" if log else "--tank has mass and shape"
            )
            raise UndertowError(f"{source}: leave these options out")
        _of_log(log, out, force) if log is not None else _of_tank(tank, name, out, force)
        return
    if mass is None:
        raise UndertowError("the mass is missing: give --mass in kg")
    if mesh is None or kind is not None or any(s is not None for s in sides):
        _of_type(mesh, kind, sides, mass, density, chosen, name, out, force)
        return
    target = new_file(out or Path(f"{name or mesh.stem}.toml"), force, [mesh])
    hull = read(mesh, unit, frame)
    spec = HullSpec(
        name=name or mesh.stem,
        mesh=mesh.name,
        sha256=sha256_of(mesh),
        mass=mass,
        density=density,
        cg=three(cg, "--cg"),
        degrees_of_freedom=chosen or DOFS,
        origin=hull.mesh.centroid if origin == "buoyancy" else hull.mesh.centroid * 0.0,
        cd=None if cd is None else three(cd, "--cd"),
        volume=volume,
        remarks=(f"Axes of the mesh: {frame.upper()}.", *hull.remarks),
    )
    if floating or wave is not None:
        if tank is not None:
            raise UndertowError(f"--tank {tank} is of a hull far under water: leave it out with --floating")
        _afloat(hull.mesh, spec, floating, wave, panels, target)
        return
    found = _added(hull.mesh, density, added_mass, panels, crease)
    tests = [] if tank is None else _tests(tank, spec, origin)
    write_whole(target, hull_vehicle(hull.mesh, found, spec, tests))
    _summary(hull.mesh, target, spec.volume, mass, density, found.source)


def _afloat(mesh: Mesh, spec: HullSpec, floating: bool, wave: str | None, finest: int, target: Path) -> None:
    """Write a vehicle file of a hull at the surface."""
    from undertow.files import write_whole
    from undertow.shape.floating_vehicle import WaveSpec, floating_vehicle

    if not floating:
        raise UndertowError(f"--wave {wave} is for a hull at the surface: give --floating")
    regular = None if wave is None else WaveSpec(*three(wave, "--wave"))
    with progress("panels") as report:
        # About half of the hull is under water.
        made = floating_vehicle(mesh, spec, regular, finest // 2, report)
    write_whole(target, made.text)
    show_afloat(made)
    say(f"wrote {target}; state its thrusters, then: undertow vehicles show {target}")


def show_afloat(made: FloatingVehicle) -> None:
    """Print what a hull at the surface does at every frequency, and how well its memory is fitted."""
    from undertow.model.symbols import VELOCITY

    hull, memory = made.hull, made.memory
    say(f"draught {hull.draught:.4g} m, {hull.panels} panels under water")
    own = range(6)
    rows = [
        (
            f"{w:.3g}",
            *(f"{hull.added[k, i, i]:.3g}" for i in own),
            *(f"{hull.damping[k, i, i]:.3g}" for i in own),
        )
        for k, w in list(enumerate(hull.omega))[::3]
    ]
    heads = ("rad/s", *(f"A{i + 1}{i + 1}" for i in own), *(f"B{i + 1}{i + 1}" for i in own))
    console().print(table(heads, rows, indent=0))
    left = ", ".join(f"{VELOCITY[i]} {e:.0%}" for i, e in memory.error.items())
    say(f"memory: {memory.effect}, order {memory.order}; residual of its kernel: {left}")


def _of_log(log: Path, out: Path | None, force: bool) -> None:
    """Write a vehicle file from the parameters in a log."""
    from undertow.files import write_whole
    from undertow.identification.logs.formats.ardupilot import vehicle_text
    from undertow.identification.logs.formats.fieldlog import read_field_log

    target = new_file(out or Path(f"{log.stem}.toml"), force, [log])
    with progress("reading", None):
        found = read_field_log(log)
    write_whole(target, vehicle_text(found, target.stem))
    say(f"wrote {target}; commands are outputs of motors from -1 to 1, as undertow reads them from the log")
    say(f"then: undertow doctor {shlex.join(map(str, (target, log)))}")


def _of_tank(root: Path | None, name: str | None, out: Path | None, force: bool) -> None:
    """Write a vehicle file from the logs of a towing tank."""
    from undertow.files import write_whole
    from undertow.tank.coefficients import coefficients, tank_vehicle
    from undertow.tank.settings import read_tank

    assert root is not None
    made = read_tank(root)
    title = name or Path(made.hull).stem
    target = new_file(out or Path(f"{title}.toml"), force, [root / "tank.toml"])
    write_whole(target, tank_vehicle(made, coefficients(root, made), title))
    say(f"wrote {target}; state its thrusters, then: undertow vehicles show {target}")


def _tests(root: Path, spec: HullSpec, origin: str) -> list[EffectTable]:
    """What a towing tank has found of the same hull."""
    from undertow.tank.coefficients import coefficients, tested
    from undertow.tank.settings import read_tank

    if origin != "buoyancy":
        raise UndertowError(
            f"--tank {root} uses the centre of buoyancy as origin: leave out --origin {origin}"
        )
    made = read_tank(root)
    if made.sha256 != spec.sha256:
        raise UndertowError(
            f"--tank {root} was made with a different hull ({made.hull}) than {spec.mesh}: give that one"
        )
    found = coefficients(root, made)
    say(f"tested in the tank: {', '.join(dict.fromkeys(c.motion for c in found))}")
    return tested(found)


def _of_type(
    mesh: Path | None,
    kind: Kind | None,
    sides: tuple[float | None, float | None, float | None],
    mass: float,
    density: float,
    chosen: tuple[str, ...] | None,
    name: str | None,
    out: Path | None,
    force: bool,
) -> None:
    """Write a vehicle file from a type and its dimensions."""
    from undertow.files import write_whole
    from undertow.shape.types import MainDimensions, typed_vehicle

    if kind is None or mesh is not None:
        raise UndertowError(
            "give the shape only once: --mesh HULL, or --type with --length, --beam and --height"
        )
    length, beam, height = sides
    if length is None or beam is None or height is None:
        raise UndertowError(f"--type {kind} lacks dimensions: give --length, --beam and --height in m")
    target = new_file(out or Path(f"{name or kind}.toml"), force, [])
    size = MainDimensions(length, beam, height, mass, density)
    write_whole(target, typed_vehicle(kind, size, name or target.stem, chosen))
    say(f"wrote {target}; check what is assumed: undertow vehicles show {target}")


def _added(mesh: Mesh, density: float, method: Method, finest: int, crease: float) -> AddedMass:
    from undertow.shape.bodies import equivalent
    from undertow.shape.mesh import has_capytaine
    from undertow.shape.panels import added_mass_of_hull

    if not (method == "panels" or (method == "auto" and has_capytaine())):
        return equivalent(mesh, density, None if method == "auto" else method)
    with progress("panels") as report:
        return added_mass_of_hull(mesh, density, finest=finest, crease=crease, report=report).added


def _summary(
    mesh: Mesh, target: Path, volume: float | None, mass: float, density: float, source: str
) -> None:
    """What came out, and what to look at before it is used."""
    from undertow.shape.mesh import INSTALL, has_capytaine

    displaced = density * (mesh.volume if volume is None else volume)
    size = " x ".join(f"{e:.4g}" for e in mesh.extents)
    console().print(
        text(f"hull {size} m, {mesh.volume:.4g} m^3; displaces {displaced:.4g} kg, weighs {mass:.4g} kg")
    )
    say(f"added mass: {source}")
    if not has_capytaine():
        say(f"for the added mass of the hull itself: {INSTALL}")
    say(f"wrote {target}; state its thrusters, then: undertow vehicles show {target}")
    if abs(displaced / mass - 1) > 0.1:
        logging.getLogger("undertow").warning(
            "mass %.4g kg and displacement %.4g kg are far apart: is the mass right? The unit? Or does the "
            "hull flood (--volume)?",
            mass,
            displaced,
        )
