"""What the commands that start from a shape share: options, and what they print and write."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from undertow.errors import UndertowError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from undertow.identification.shape import AddedMass
    from undertow.identification.shape.panels import PanelResult, Radiation
    from undertow.identification.shape.reading import Hull
    from undertow.model.vehicle import Vehicle
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
        from undertow.cli._adding import target_of

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

    from undertow.identification.shape.reading import read_hull

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
    from undertow.cli._show import console, section, table, text
    from undertow.identification.shape.priors import coupled, derivative
    from undertow.model.symbols import FORCE, VELOCITY

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
    from undertow.cli._show import print_json
    from undertow.identification.shape import AddedMass
    from undertow.identification.shape.priors import sigma_of
    from undertow.model.loading import load_vehicle

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
    from undertow.identification.shape.priors import with_added_mass, with_radiation
    from undertow.model.saving import save_vehicle

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
