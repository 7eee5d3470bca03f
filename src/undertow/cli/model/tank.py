"""Test a hull in a virtual towing tank (OpenFOAM), and find its added mass and damping.

    undertow tank new hull.stl --mass 7.5 --motion surge,heave,yaw --prescribed --out tank/

    undertow tank run tank/ --cores 2 --grids 2

    undertow tank look tank/

    undertow vehicle new --tank tank/ --out my.toml

The hull moves in one degree of freedom at a time in still water, deeply submerged or at a --depth. A short
push gives the added mass, steps of speed or force give the drag. `run` resumes where it was interrupted, and
prints the coefficients with standard errors of the fit and of the grid. Its logs can be used like any others:

    undertow fit my.toml tank/logs/surge-*-grid1.csv

There are no waves (see `undertow vehicle new --floating` for hulls at the surface). OpenFOAM is a system
package: apt-get install openfoam.
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from undertow.errors import UndertowError

from .._options import JsonOption, words
from .._terminal import console, print_json, progress, say, table, write_files
from .vehicle import FrameOption, UnitOption, read

if TYPE_CHECKING:
    from undertow.tank.coefficients import Coefficient

app = typer.Typer(add_completion=False)

_HULL = typer.Argument(metavar="HULL", help="Closed surface of the hull: STL, OBJ or MSH.")
_ROOT = typer.Argument(metavar="TANK", help="Folder of the tank.")
_MOTION = typer.Option(metavar="NAME,NAME", help="Motions to test, one at a time.")
_PROFILE = typer.Option(
    metavar="NAME,NAME", help="push, step, sine, paper, or a CSV file of time and force or speed."
)
_PRESCRIBED = typer.Option(
    "--prescribed", help="Prescribe the motion and measure the force, instead of the other way round."
)
_SPEED = typer.Option(metavar="M/S", help="Highest speed; in rotation, that of the ends of the hull.")
_FORCE = typer.Option(
    metavar="N", help="Highest force or moment.", show_default="what it takes to hold --speed"
)
_INERTIA = typer.Option(
    metavar="KG M2", help="Moment of inertia.", show_default="mass spread evenly over the hull"
)
_TURBULENCE = typer.Option(help="Turbulence model; auto: by the Reynolds number.")
_SPAN = typer.Option(
    metavar="x|y|z",
    help="Two-dimensional flow: the hull is a slice of an infinitely long one along this axis.",
)
_DEPTH = typer.Option(
    metavar="M", help="Depth of the centre of volume below the surface.", show_default="deeply submerged"
)
_STEP = typer.Option(metavar="SHARE", help="Fraction of the usual time step; reduce it if a run diverges.")
_GRIDS = typer.Option(metavar="N", min=1, max=4, help="Number of grids to run, coarsest first.")
_CASE = typer.Option(metavar="NAME", help="Draw one case only.", show_default="all that were run")
_PICTURES = typer.Option(metavar="FOLDER", help="Where to write the figures.", show_default="TANK/pictures")


@app.command()
def new(
    hull: Annotated[Path, _HULL],
    mass: Annotated[float, typer.Option(metavar="KG", help="Mass of the vehicle.")],
    motion: Annotated[str, _MOTION] = "surge",
    profile: Annotated[str, _PROFILE] = "push,step",
    prescribed: Annotated[bool, _PRESCRIBED] = False,
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Where to write the tank.")] = Path("tank"),
    unit: UnitOption = None,
    frame: FrameOption = "FRD",
    speed: Annotated[float, _SPEED] = 0.3,
    force_peak: Annotated[float | None, _FORCE] = None,
    inertia: Annotated[float | None, _INERTIA] = None,
    density: Annotated[float, typer.Option(metavar="KG/M3", help="Density of the water.")] = 1000.0,
    viscosity: Annotated[
        float, typer.Option(metavar="M2/S", help="Kinematic viscosity of the water.")
    ] = 1e-6,
    turbulence: Annotated[Literal["auto", "laminar", "k-omega-sst"], _TURBULENCE] = "auto",
    depth: Annotated[float | None, _DEPTH] = None,
    span: Annotated[str | None, _SPAN] = None,
    grids: Annotated[int, typer.Option(metavar="N", help="Number of grids to write, 1 to 4.")] = 3,
    time_step: Annotated[float, _STEP] = 1.0,
    force: Annotated[bool, typer.Option("--force", help="Replace a tank that has not been run.")] = False,
) -> None:
    """Write OpenFOAM cases around a hull, for every motion and direction, on several grids.

    The hull has to be closed. If both directions are mirror images there is one case for both, and the domain
    is halved at planes of symmetry. This command does not need OpenFOAM.
    """
    from undertow.files import check_folder, sha256_of
    from undertow.shape.hull_vehicle import motions
    from undertow.tank.case import TankPlan, make_tank, write_tank

    check_folder(out)
    _refuse_old(out, force)
    surface = read(hull, unit, frame).mesh
    plan = TankPlan(
        mass=mass,
        motions=motions(words([motion])),
        profiles=words([profile]),
        prescribed=prescribed,
        speed=speed,
        force=force_peak,
        inertia=inertia,
        density=density,
        viscosity=viscosity,
        turbulence=turbulence,
        grids=grids,
        step=time_step,
        depth=depth,
        span=span,
    )
    made, centred = make_tank(surface, plan, hull.name, sha256_of(hull))
    with progress("writing", None):
        write_tank(out, made, centred)
    high = made.half[2] + (made.half[2] if depth is None else depth)
    size = " x ".join(f"{length:.3g}" for length in (2 * made.half[0], 2 * made.half[1], high))
    rows = [
        (
            c.name,
            f"{c.end:.3g} s",
            f"{c.end / c.step:.0f}",
            "k-omega SST" if c.turbulent else "laminar",
            f"1/{c.copies}",
        )
        for c in made.cases
    ]
    console().print(table(("case", "time", "steps, grid 1", "flow", "share of water"), rows, indent=0))
    sides = " x ".join(f"{side:.3g}" for side in centred.extents)
    say(f"hull {sides} m, displaces {density * centred.volume:.4g} kg, weighs {mass:g} kg")
    say(f"{size} m of water; cells of {made.cell:.3g} m at the hull")
    say(f"wrote {out}; then: undertow tank run {out}")


def _refuse_old(out: Path, force: bool) -> None:
    from undertow.tank.settings import FILE

    if (out / FILE).exists():
        if any(out.glob("logs/*.csv")):
            raise UndertowError(f"'{out}' is a tank with logs: choose another folder with --out")
        if not force or any(out.glob("cases/*/grid*/grid.json")):
            raise UndertowError(f"'{out}' is a tank already: choose another folder with --out")


@app.command()
def run(
    root: Annotated[Path, _ROOT],
    cores: Annotated[int, typer.Option(metavar="N", min=1, help="Number of solver processes.")] = 1,
    grids: Annotated[int, _GRIDS] = 1,
    json: JsonOption = False,
) -> None:
    """Run every case that has no log yet, and print the coefficients.

    After an interruption (Ctrl-C, power failure) the same command resumes from the last saved time. A run
    that diverges is refused with the time and the Courant number. Logs and mapping files are in TANK/logs.
    """
    from undertow.tank.coefficients import coefficients
    from undertow.tank.run import run_tank, unlayered
    from undertow.tank.settings import read_tank

    made = read_tank(root)
    with progress("towing tank") as report:
        written = run_tank(root, made, grids=grids, cores=cores, progress=report)
    for line in unlayered(root, made):
        logging.getLogger("undertow").warning("%s", line)
    found = coefficients(root, made)
    if json:
        print_json({"coefficients": [_plain(c) for c in found], "written": written})
        return
    count = f"{len(written)} log{'s' * (len(written) != 1)}"
    say(f"{count} written to {root / 'logs'}" if written else "nothing left to compute")
    show(found)
    say(f"then: undertow tank look {root}; undertow vehicle new --tank {root}")


def _plain(c: Coefficient) -> dict[str, Any]:
    from dataclasses import asdict

    return {**asdict(c), "value": c.value, "sigma": c.sigma}


def show(found: list[Coefficient]) -> None:
    """Print coefficients with their errors."""
    rows = []
    for c in found:
        numbers = (
            f"{c.value:.4g}",
            f"{c.sigma:.2g}",
            f"{c.fit:.2g}",
            f"{c.grid.index:.2g}",
            f"{c.grid.extrapolated:.4g}",
        )
        rows.append((f"-{c.name}", c.way, *numbers, c.grid.kind, c.unit))
    heads = ("", "", "value", "sigma", "of the fit", "grid index", "extrapolated", "grids", "")
    console().print(table(heads, rows, indent=0))


@app.command()
def look(
    root: Annotated[Path, _ROOT],
    case: Annotated[str | None, _CASE] = None,
    out: Annotated[Path | None, _PICTURES] = None,
) -> None:
    """Draw grid, flow speed and force histories, one picture for each case."""
    from contextlib import suppress

    from undertow.errors import nearest
    from undertow.files import check_folder, make_folder
    from undertow.tank.coefficients import coefficients
    from undertow.tank.pictures import picture
    from undertow.tank.settings import folder_of, log_of, read_tank

    made, folder = read_tank(root), out or root / "pictures"
    names = [c.name for c in made.cases]
    if case is not None and case not in names:
        raise UndertowError(
            f"case '{case}' is not in {root}{nearest(case, names) or ': choose from ' + ', '.join(names)}"
        )
    found: list[Coefficient] = []
    with suppress(UndertowError):  # too few logs for coefficients are enough for pictures
        found = coefficients(root, made)
    wanted = []
    for c in made.cases:
        grids = [
            g
            for g in range(made.grids, 0, -1)
            if any(folder_of(root, c, g).glob("postProcessing/section/*/*"))
        ]
        if grids and case in (None, c.name):
            done = [g for g in grids if log_of(root, c, g).is_file()]
            wanted.append((c, (done or grids)[0]))
    if not wanted:
        raise UndertowError(f"{root}: nothing to draw yet: compute it with undertow tank run {root}")
    check_folder(folder)
    make_folder(folder)
    for c, grid in wanted:
        path = folder / f"{c.name}-grid{grid}.png"
        drawn = picture(root, made, c, grid, found)
        write_files((path, drawn))
