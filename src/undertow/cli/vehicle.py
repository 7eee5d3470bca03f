"""Make a first vehicle file from the shape of a hull, before any test.

    undertow vehicle new --mesh hull.stl --unit mm --frame FLU --mass 12 --cg 0,0,0.02 --out my.toml

    undertow vehicles show my.toml

`undertow vehicles` lists and shows vehicle files that exist already.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from undertow.cli._shape import CreaseOption, FrameOption, PanelsOption, UnitOption

if TYPE_CHECKING:
    from undertow.identification.shape import AddedMass
    from undertow.identification.shape.mesh import Mesh

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
    from undertow.cli._shape import read, three
    from undertow.errors import UndertowError
    from undertow.files import check_writable, sha256_of, write_whole
    from undertow.identification.shape.first import Wish, first_vehicle, motions

    target = out or Path(f"{name or mesh.stem}.toml")
    check_writable(target, inputs=[mesh])
    if target.exists() and not force:
        raise UndertowError(f"'{target}' exists already: name another file with --out, or give --force")
    hull = read(mesh, unit, frame)
    wish = Wish(
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
    write_whole(target, first_vehicle(hull.mesh, found, wish))
    _say(hull.mesh, target, wish.volume, mass, density, found.source)


def _by_panels(method: Method) -> bool:
    from undertow.identification.shape.capytaine import has_capytaine

    return method == "panels" or (method == "auto" and has_capytaine())


def _added(mesh: Mesh, density: float, method: Method, finest: int, crease: float) -> AddedMass:
    from undertow.cli._progress import progress
    from undertow.identification.shape.boxes import equivalent
    from undertow.identification.shape.panels import added_mass_of_hull

    if not _by_panels(method):
        return equivalent(mesh, density, None if method == "auto" else method)
    with progress("panels") as report:
        return added_mass_of_hull(mesh, density, finest=finest, crease=crease, report=report).added


def _say(mesh: Mesh, target: Path, volume: float | None, mass: float, density: float, source: str) -> None:
    """What came out, and what to look at before it is used."""
    import logging

    from undertow.cli._show import console, text
    from undertow.identification.shape.capytaine import INSTALL, has_capytaine

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
