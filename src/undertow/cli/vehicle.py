"""Make a first vehicle file from the shape of a hull, before any test.

    undertow vehicle new --mesh hull.stl --unit mm --frame FLU --mass 12 --cg 0,0,0.02 --out my.toml

    undertow vehicles show my.toml

`undertow vehicles` lists and shows vehicle files that exist already.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from undertow.errors import UndertowError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from undertow.model.vehicle import Vehicle
    from undertow.shape.bodies import AddedMass
    from undertow.shape.mesh import Hull, Mesh
    from undertow.shape.panels import PanelResult, Radiation
    from undertow.typing import Array


DensityOption = Annotated[
    float | None,
    typer.Option(
        "--density",
        metavar="KG/M3",
        help="Of the water.",
        show_default="that of --into VEHICLE, or 1000",
    ),
]
AtOption = Annotated[
    str,
    typer.Option(
        "--at",
        metavar="X,Y,Z",
        help="Where its centre (of a mesh: the origin) lies in the vehicle's axes, m.",
    ),
]
TurnOption = Annotated[
    str,
    typer.Option(
        "--turn", metavar="ROLL,PITCH,YAW", help="How it is turned against the vehicle's axes, degrees."
    ),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")]
IntoOption = Annotated[
    str | None,
    typer.Option("--into", metavar="VEHICLE", help="Vehicle file that gets the added mass as priors."),
]
SigmaOption = Annotated[
    float,
    typer.Option("--sigma", metavar="SHARE", help="Least standard deviation of the priors, as a share."),
]
UnitOption = Annotated[
    str | None,
    typer.Option(
        "--unit", metavar="UNIT", help="What the numbers of the mesh are in.", show_default="m, if likely"
    ),
]
FrameOption = Annotated[
    str,
    typer.Option(
        "--frame",
        metavar="XYZ",
        help="Where x, y and z of the mesh point: Forward or Back, Right or Left, Down or Up.",
    ),
]
PanelsOption = Annotated[
    int, typer.Option("--panels", metavar="N", help="Most panels of the finest of three meshes.")
]
CreaseOption = Annotated[
    float,
    typer.Option(
        "--crease", metavar="DEGREES", help="Edges that bend by less are taken for a curve, drawn coarsely."
    ),
]


@dataclass(frozen=True)
class Target:
    """A vehicle file to put something into, and where the new one goes."""

    into: str | None
    out: Path | None
    in_place: bool

    @property
    def path(self) -> Path | None:
        """The file to be written, or None."""
        from .add import target_of

        return None if self.into is None else target_of(self.into, self.out, self.in_place)


@dataclass(frozen=True)
class Asked:
    """What is to be done with an added mass: the density, place and turn of the body, printing, writing."""

    density: float | None
    place: tuple[Array, tuple[float, float, float]]
    json: bool
    target: Target
    sigma: float


def three(text: str, option: str) -> tuple[float, float, float]:
    """Three numbers out of an option.

    Raises
    ------
    UndertowError
        If there are not three finite numbers.
    """
    from math import isfinite

    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError as error:
        raise UndertowError(f"{option} '{text}' is not three numbers: write it like 0.1,0,-0.02") from error
    if not all(map(isfinite, (x, y, z))):
        raise UndertowError(f"{option} '{text}': every number must be finite")
    return x, y, z


def place_of(at: str, turn: str) -> tuple[Array, tuple[float, float, float]]:
    """Rotation and place of a body in the vehicle, from roll, pitch and yaw in degrees and a place in m."""
    import numpy as np
    from scipy.spatial.transform import Rotation

    roll, pitch, yaw = three(turn, "--turn")
    rotation = Rotation.from_euler("ZYX", np.array([yaw, pitch, roll]), degrees=True).as_matrix()
    return rotation, three(at, "--at")


def density_of(density: float | None, vehicle: Vehicle | None) -> float:
    """The density asked for, that of the vehicle's water, or that of fresh water, kg/m^3."""
    if density is not None:
        return density
    return 1000.0 if vehicle is None else vehicle.environment["rho"]


def read(path: Path, unit: str | None, frame: str) -> Hull:
    """A hull out of a file; what had to be mended is told."""
    import logging

    from undertow.shape.mesh import read_hull

    hull = read_hull(path, unit=unit, frame=frame)
    for remark in hull.remarks:
        logging.getLogger("undertow").warning("%s: %s", path, remark)
    return hull


# --- printing -------------------------------------------------------------------------------------
_UNITS = (("kg", "kg m"), ("kg m", "kg m^2"))


def content_of(added: AddedMass, sigma: Array, radiation: Sequence[Radiation] = ()) -> dict[str, Any]:
    """What is known of an added mass, as plain data."""
    return {
        "matrix": added.matrix.tolist(),
        "error": added.error.tolist(),
        "sigma": sigma.tolist(),
        "source": added.source,
        "limits": added.limits,
        "radiation": [
            {"omega": r.omega, "damping": r.damping.tolist(), "error": r.error.tolist()} for r in radiation
        ],
    }


def show(added: AddedMass, sigma: Array, radiation: Sequence[Radiation] = ()) -> None:
    """Print an added mass: what matters of its matrix, where it is from, how far to trust it."""
    from undertow.model.symbols import FORCE, VELOCITY
    from undertow.shape.first import coupled, derivative

    from ._terminal import console, section, table, text

    places = [*((i, i) for i in range(6)), *coupled(added.matrix)]
    rows = [
        (
            f"-{derivative(i, j)}",
            f"{added.matrix[i, j] + 0.0:.4g}",
            f"{added.error[i, j]:.2g}",
            f"{sigma[i, j]:.2g}",
            _UNITS[i > 2][j > 2],
        )
        for i, j in places
    ]
    console().print(table(("", "added mass", "error", "sigma", ""), rows, indent=0))
    for r in radiation:
        own = [
            (f"-{FORCE[i]}_{VELOCITY[i]}", f"{r.damping[i, i] + 0.0:.3g}", f"{r.error[i, i]:.1g}")
            for i in range(6)
        ]
        section(f"radiation damping at {r.omega:g} rad/s", table(("", "SI", "error"), own))
    console().print(text(f"source: {added.source}"), soft_wrap=True)
    console().print(text(f"limits: {added.limits}"), soft_wrap=True)


# --- writing --------------------------------------------------------------------------------------
def tell(body: Callable[[float], AddedMass | PanelResult], asked: Asked, inputs: Sequence[Path] = ()) -> None:
    """Print the added mass of a body, and write it where that is wanted.

    Parameters
    ----------
    body : callable
        Added mass about the body's own origin for a density of the water.
    asked : Asked
        What to do with it.
    inputs : sequence of Path
        Files that the body is from, which nothing is written over.
    """
    from undertow.model.loading import load_vehicle
    from undertow.shape.bodies import AddedMass
    from undertow.shape.first import sigma_of

    from ._terminal import print_json

    _check(asked, inputs)
    vehicle = None if asked.target.into is None else load_vehicle(asked.target.into)
    found = body(density_of(asked.density, vehicle)).placed(*asked.place)
    added, radiation = (found, ()) if isinstance(found, AddedMass) else (found.added, found.radiation)
    spread = sigma_of(added, asked.sigma)
    if asked.json:
        print_json(content_of(added, spread, radiation))
    else:
        show(added, spread, radiation)
    if vehicle is not None:
        _write(vehicle, added, radiation, asked)


def _check(asked: Asked, inputs: Sequence[Path]) -> None:
    """Refuse before the work what could not be done after it."""
    from undertow.files import check_writable

    target = asked.target
    if target.into is None and (target.out is not None or target.in_place):
        raise UndertowError("--out and --in-place are for --into VEHICLE: name the vehicle file")
    if not 0 < asked.sigma < float("inf"):
        raise UndertowError(f"--sigma {asked.sigma:g} is no share: give a number above 0, such as 0.1")
    check_writable(target.path, inputs=inputs)


def _write(vehicle: Vehicle, added: AddedMass, radiation: Sequence[Radiation], asked: Asked) -> None:
    from undertow.model.saving import save_vehicle
    from undertow.shape.first import with_added_mass, with_radiation

    path = asked.target.path
    if path is None:
        typer.echo("no vehicle file was written: --out NEW.toml or --in-place does that", err=True)
        return
    vehicle = with_added_mass(vehicle, added, floor=asked.sigma)
    # Of several frequencies the first is taken: a linear damping has none.
    vehicle = with_radiation(vehicle, radiation[0], added.source) if radiation else vehicle
    history = {"command": "undertow added-mass", "date": date.today().isoformat(), "shape": added.source}
    save_vehicle(vehicle, str(asked.target.into), path, history=history)
    typer.echo(f"wrote {path}", err=True)


Method = Literal["auto", "panels", "ellipsoid", "box"]

app = typer.Typer(add_completion=False)

_MESH = typer.Option("--mesh", metavar="HULL", help="Closed surface of the hull: STL, OBJ or MSH.")
_MASS = typer.Option("--mass", metavar="KG", help="Of the vehicle, dry.")
_CG = typer.Option(
    "--cg", metavar="X,Y,Z", help="Centre of gravity from the origin, m: forward, right, down."
)
_ORIGIN = typer.Option("--origin", help="Origin of the vehicle: its centre of buoyancy, or that of the mesh.")
_DENSITY = typer.Option("--density", metavar="KG/M3", help="Of the water.")
_DOF = typer.Option("--dof", metavar="NAME,NAME", help="Motions of the model.")
_VOLUME = typer.Option(
    "--volume",
    metavar="M3",
    help="What a hull that floods displaces; the rest of it is water carried along.",
    show_default="what the hull encloses",
)
_CD = typer.Option(
    "--cd",
    metavar="X,Y,Z",
    help="Drag coefficients on the silhouettes.",
    show_default="by the form of the hull",
)
_ADDED = typer.Option(
    "--added-mass", help="By panels, or of a body of the same extents; auto: panels if installed."
)
_NAME = typer.Option("--name", metavar="NAME", help="Of the vehicle.", show_default="name of the mesh file")
_OUT = typer.Option("--out", metavar="NEW.toml", help="Where to write it.", show_default="NAME.toml")
_FORCE = typer.Option("--force", help="Replace the file if it exists.")


@app.callback()
def vehicle() -> None:
    pass


@app.command()
def new(
    mesh: Annotated[Path, _MESH],
    mass: Annotated[float, _MASS],
    unit: UnitOption = None,
    frame: FrameOption = "FRD",
    cg: Annotated[str, _CG] = "0,0,0",
    origin: Annotated[Literal["buoyancy", "mesh"], _ORIGIN] = "buoyancy",
    density: Annotated[float, _DENSITY] = 1000.0,
    dof: Annotated[str, _DOF] = "surge,sway,heave,roll,pitch,yaw",
    volume: Annotated[float | None, _VOLUME] = None,
    cd: Annotated[str | None, _CD] = None,
    added_mass: Annotated[Method, _ADDED] = "auto",
    panels: PanelsOption = 3200,
    crease: CreaseOption = 30.0,
    name: Annotated[str | None, _NAME] = None,
    out: Annotated[Path | None, _OUT] = None,
    force: Annotated[bool, _FORCE] = False,
) -> None:
    """Write a first vehicle file: inertia, added mass, drag, weight and buoyancy from a hull and its mass.

    Volume, centre of buoyancy, silhouettes and inertia (mass spread evenly) come from the mesh, the added
    mass from panels (extra undertow[bem]) or from a box or ellipsoid of the same extents, the drag from
    coefficients for blunt, rounded or streamlined hulls. Each value has its source and a standard deviation;
    added mass, drag and buoyancy are marked to be estimated from logs. Thrusters are left for you to state.
    """
    from undertow.errors import UndertowError
    from undertow.files import check_writable, sha256_of, write_whole
    from undertow.shape.first import HullSpec, first_vehicle, motions

    target = out or Path(f"{name or mesh.stem}.toml")
    check_writable(target, inputs=[mesh])
    if target.exists() and not force:
        raise UndertowError(f"'{target}' exists already: name another file with --out, or give --force")
    hull = read(mesh, unit, frame)
    spec = HullSpec(
        name=name or mesh.stem,
        mesh=mesh.name,
        sha256=sha256_of(mesh),
        mass=mass,
        density=density,
        cg=three(cg, "--cg"),
        degrees_of_freedom=motions([d.strip() for d in dof.split(",")]),
        origin=hull.mesh.centroid if origin == "buoyancy" else hull.mesh.centroid * 0.0,
        cd=None if cd is None else three(cd, "--cd"),
        volume=volume,
        remarks=(f"Axes of the mesh: {frame.upper()}.", *hull.remarks),
    )
    found = _added(hull.mesh, density, added_mass, panels, crease)
    write_whole(target, first_vehicle(hull.mesh, found, spec))
    _say(hull.mesh, target, spec.volume, mass, density, found.source)


def _by_panels(method: Method) -> bool:
    from undertow.shape.mesh import has_capytaine

    return method == "panels" or (method == "auto" and has_capytaine())


def _added(mesh: Mesh, density: float, method: Method, finest: int, crease: float) -> AddedMass:
    from undertow.shape.bodies import equivalent
    from undertow.shape.panels import added_mass_of_hull

    from ._terminal import progress

    if not _by_panels(method):
        return equivalent(mesh, density, None if method == "auto" else method)
    with progress("panels") as report:
        return added_mass_of_hull(mesh, density, finest=finest, crease=crease, report=report).added


def _say(mesh: Mesh, target: Path, volume: float | None, mass: float, density: float, source: str) -> None:
    """What came out, and what to look at before it is used."""
    import logging

    from undertow.shape.mesh import INSTALL, has_capytaine

    from ._terminal import console, text

    displaced = density * (mesh.volume if volume is None else volume)
    size = " x ".join(f"{e:.4g}" for e in mesh.extents)
    out = console()
    out.print(
        text(f"hull {size} m, {mesh.volume:.4g} m^3; displaces {displaced:.4g} kg, weighs {mass:.4g} kg")
    )
    out.print(text(f"added mass: {source}"), soft_wrap=True)
    if not has_capytaine():
        out.print(text(f"for the added mass of the hull itself: {INSTALL}"), soft_wrap=True)
    out.print(
        text(f"wrote {target}; state its thrusters, then: undertow vehicles show {target}"), soft_wrap=True
    )
    if abs(displaced / mass - 1) > 0.1:
        logging.getLogger("undertow").warning(
            "mass %.4g kg and displacement %.4g kg are far apart: is the mass right, is the unit, or "
            "does the hull flood (--volume)?",
            mass,
            displaced,
        )
