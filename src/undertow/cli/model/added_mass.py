"""Compute the added mass of a body: simple bodies in closed form, boxes by table, hulls by panels.

It prints positive added mass (minus the SNAME derivatives), about the centre of the body (for a mesh: about
its origin), or about the vehicle's origin with --at and --turn. --into writes it into a vehicle file as
priors to be estimated from logs, with standard deviation and source.

    undertow added-mass box --length 0.60 --beam 0.42 --height 0.24

    undertow added-mass cylinder --length 1.6 --diameter 0.2 --at 0.1,0,0 --into auv.toml --out auv2.toml

    undertow added-mass mesh hull.stl --unit mm --frame FLU --into rov.toml --in-place

All methods assume an ideal fluid, without flow separation, openings or small parts. The standard deviation of
a prior is therefore never less than --sigma.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from undertow.errors import UndertowError

from .._options import InPlaceOption, JsonOption, OutOption, bundled, target_of
from .._terminal import console, print_json, progress, say, section, table
from .vehicle import CreaseOption, FrameOption, PanelsOption, UnitOption, read, three

if TYPE_CHECKING:
    from undertow.model.vehicle import Vehicle
    from undertow.shape.bodies import AddedMass
    from undertow.shape.panels import PanelResult, Radiation
    from undertow.typing import Array

    Body = Callable[[float], AddedMass | PanelResult]

app = typer.Typer(add_completion=False)


def _metres(name: str, help: str) -> typer.models.OptionInfo:
    return typer.Option(name, metavar="M", help=help)  # type: ignore[no-any-return]


_LENGTH = _metres("--length", "Along x.")
_DIAMETER = _metres("--diameter", "Diameter.")
_MESH = typer.Argument(metavar="HULL", help="Closed surface of the hull: STL, OBJ or MSH.")
_DEPTH = _metres(
    "--depth", "Depth of the centre of volume below the surface; without it, the water is unbounded."
)
_OMEGA = typer.Option(
    metavar="RAD/S", help="Frequency at which to compute radiation damping; may be repeated."
)

_DENSITY = typer.Option(
    metavar="KG/M3", help="Density of the water.", show_default="that of --into VEHICLE, or 1000"
)
_AT = typer.Option(
    metavar="X,Y,Z", help="Position of its centre (of a mesh: its origin) in the vehicle's axes, m."
)
_TURN = typer.Option(metavar="ROLL,PITCH,YAW", help="Rotation with respect to the vehicle's axes, degrees.")
_INTO = typer.Option(metavar="VEHICLE", help="Vehicle file to write the added mass into, as priors.")
_SIGMA = typer.Option(metavar="SHARE", help="Smallest relative standard deviation of the priors.")


@dataclass(frozen=True)
class BodyOptions:
    """What is to be done with the added mass of a body: density, place and turn, printing, writing."""

    density: Annotated[float | None, _DENSITY] = None
    at: Annotated[str, _AT] = "0,0,0"
    turn: Annotated[str, _TURN] = "0,0,0"
    json: JsonOption = False
    into: Annotated[str | None, _INTO] = None
    out: OutOption = None
    in_place: InPlaceOption = False
    sigma: Annotated[float, _SIGMA] = 0.1

    def report(self, body: Body, inputs: Sequence[Path] = ()) -> None:
        """Print the added mass of a body, and write it where that is wanted.

        `body` gives the added mass about the body's own origin for a density of the water; nothing is written
        over `inputs`, the files that it is from.
        """
        from undertow.model.loading import load_vehicle
        from undertow.model.symbols import ENVIRONMENT
        from undertow.shape.bodies import AddedMass
        from undertow.shape.hull_vehicle import sigma_of

        place = self._place()
        target = self._target(inputs)
        vehicle = None if self.into is None else load_vehicle(self.into)
        stated = ENVIRONMENT.density if vehicle is None else vehicle.environment["rho"]
        found = body(stated if self.density is None else self.density).placed(*place)
        added, radiation = (found, ()) if isinstance(found, AddedMass) else (found.added, found.radiation)
        spread = sigma_of(added, self.sigma)
        if self.json:
            print_json(_content(added, spread, radiation))
        else:
            show(added, spread, radiation)
        if vehicle is not None:
            self._write(vehicle, added, radiation, target)

    def _place(self) -> tuple[Array, tuple[float, float, float]]:
        """Rotation and place of the body in the vehicle."""
        import numpy as np
        from scipy.spatial.transform import Rotation

        roll, pitch, yaw = three(self.turn, "--turn")
        rotation = Rotation.from_euler("ZYX", np.array([yaw, pitch, roll]), degrees=True).as_matrix()
        return rotation, three(self.at, "--at")

    def _target(self, inputs: Sequence[Path]) -> Path | None:
        """The vehicle file to be written; what could not be done after the work is refused before it."""
        if self.into is None and (self.out is not None or self.in_place):
            raise UndertowError("--out and --in-place are for --into VEHICLE: name the vehicle file")
        if not 0 < self.sigma < float("inf"):
            raise UndertowError(f"--sigma {self.sigma:g} is not a share: give a number above 0, such as 0.1")
        if self.into is None:
            return None
        return target_of(self.into, self.out, self.in_place, inputs=inputs)

    def _write(
        self, vehicle: Vehicle, added: AddedMass, radiation: Sequence[Radiation], target: Path | None
    ) -> None:
        from undertow.model.saving import save_vehicle
        from undertow.shape.hull_vehicle import with_added_mass, with_radiation

        if target is None:
            typer.echo("no vehicle file was written: --out NEW.toml or --in-place writes it", err=True)
            return
        vehicle = with_added_mass(vehicle, added, floor=self.sigma)
        # Of several frequencies the first is taken: a linear damping has none.
        vehicle = with_radiation(vehicle, radiation[0], added.source) if radiation else vehicle
        history = {"command": "undertow added-mass", "date": date.today().isoformat(), "shape": added.source}
        save_vehicle(vehicle, str(self.into), target, history=history)
        typer.echo(f"wrote {target}", err=True)


@app.command()
@bundled
def ellipsoid(
    a: Annotated[float, _metres("--a", "Semi-axis along x.")],
    b: Annotated[float, _metres("--b", "Semi-axis along y.")],
    c: Annotated[float, _metres("--c", "Semi-axis along z.")],
    options: BodyOptions,
) -> None:
    """An ellipsoid with three semi-axes (Lamb): exact in ideal fluid."""
    from undertow.shape.bodies import ellipsoid as body

    options.report(lambda rho: body(a, b, c, rho))


@app.command()
@bundled
def sphere(diameter: Annotated[float, _DIAMETER], options: BodyOptions) -> None:
    """A sphere: half of the displaced mass, in every direction."""
    from undertow.shape.bodies import positive
    from undertow.shape.bodies import sphere as body

    positive(diameter=diameter)
    options.report(lambda rho: body(diameter / 2, rho))


@app.command()
@bundled
def spheroid(
    length: Annotated[float, _LENGTH], diameter: Annotated[float, _DIAMETER], options: BodyOptions
) -> None:
    """A spheroid about x, such as the hull of a torpedo-shaped vehicle (Lamb): exact in ideal fluid."""
    from undertow.shape.bodies import prolate_spheroid as body

    options.report(lambda rho: body(length, diameter, rho))


@app.command()
@bundled
def cylinder(
    length: Annotated[float, _LENGTH], diameter: Annotated[float, _DIAMETER], options: BodyOptions
) -> None:
    """A slender circular cylinder along x (--turn for other directions), by strips."""
    from undertow.shape.bodies import cylinder as body

    options.report(lambda rho: body(length, diameter, rho))


@app.command()
@bundled
def box(
    length: Annotated[float, _LENGTH],
    beam: Annotated[float, _metres("--beam", "Along y.")],
    height: Annotated[float, _metres("--height", "Along z.")],
    options: BodyOptions,
) -> None:
    """A rectangular box, from a table of panel computations; no side more than 5.6 times the next one."""
    from undertow.shape.bodies import box as body

    options.report(lambda rho: body(length, beam, height, rho))


@app.command()
@bundled
def mesh(
    hull: Annotated[Path, _MESH],
    options: BodyOptions,
    unit: UnitOption = None,
    frame: FrameOption = "FRD",
    depth: Annotated[float | None, _DEPTH] = None,
    omega: Annotated[list[float] | None, _OMEGA] = None,
    panels: PanelsOption = 3200,
    crease: CreaseOption = 30.0,
) -> None:
    """Any closed hull, by panels of three sizes, extrapolated; needs the extra undertow[bem].

    With --depth there is a free surface: the added mass is that at high frequency, and each --omega adds the
    radiation damping at that frequency. With --into, the damping at the first --omega is written as the prior
    of the linear damping.
    """
    from undertow.shape.panels import added_mass_of_hull

    surface = read(hull, unit, frame).mesh

    def found(rho: float) -> PanelResult:
        with progress("panels") as report:
            result = added_mass_of_hull(
                surface, rho, depth=depth, omegas=omega or [], finest=panels, crease=crease, report=report
            )
        return replace(result, added=replace(result.added, source=f"{hull.name}; {result.added.source}"))

    options.report(found, [hull])


# --- printing -------------------------------------------------------------------------------------
_UNITS = (("kg", "kg m"), ("kg m", "kg m^2"))


def _content(added: AddedMass, sigma: Array, radiation: Sequence[Radiation]) -> dict[str, Any]:
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


def show(added: AddedMass, sigma: Array, radiation: Sequence[Radiation]) -> None:
    """Print an added mass: what matters of its matrix, where it is from, how far to trust it."""
    from undertow.model.symbols import FORCE, VELOCITY
    from undertow.shape.hull_vehicle import coupled, derivative

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
    say(f"source: {added.source}")
    say(f"limits: {added.limits}")
