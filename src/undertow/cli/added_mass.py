"""Say how much water moves with a body: simple bodies in closed form, boxes by table, hulls by panels.

What is printed is the positive added mass, minus the SNAME derivatives: about the centre of the body (of a
mesh: about its origin), or about the vehicle's origin with --at and --turn. With --into it is written into a
vehicle file as priors, to be estimated from logs, with standard deviation and source.

    undertow added-mass box --length 0.60 --beam 0.42 --height 0.24

    undertow added-mass cylinder --length 1.6 --diameter 0.2 --at 0.1,0,0 --into auv.toml --out auv2.toml

    undertow added-mass mesh hull.stl --unit mm --frame FLU --into rov.toml --in-place

All of it is ideal fluid: flow that separates, openings and small parts are not in it, and the standard
deviation of a prior is therefore never less than --sigma.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from inspect import Signature, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from undertow.cli._vehicle_and_logs import InPlaceOption, OutOption

from .vehicle import (
    Asked,
    AtOption,
    CreaseOption,
    DensityOption,
    FrameOption,
    IntoOption,
    JsonOption,
    PanelsOption,
    SigmaOption,
    Target,
    TurnOption,
    UnitOption,
    place_of,
    read,
    tell,
)

if TYPE_CHECKING:
    from undertow.shape.bodies import AddedMass
    from undertow.shape.panels import PanelResult

    Body = Callable[[float], AddedMass | PanelResult]
else:
    Body = Callable[[float], object]

app = typer.Typer(add_completion=False)


@app.callback()
def added_mass() -> None:
    pass


def _metres(name: str, help: str) -> typer.models.OptionInfo:
    return typer.Option(name, metavar="M", help=help)  # type: ignore[no-any-return]


_LENGTH = _metres("--length", "Along x.")
_DIAMETER = _metres("--diameter", "Across.")
_MESH = typer.Argument(metavar="HULL", help="Closed surface of the hull: STL, OBJ or MSH.")
_DEPTH = _metres("--depth", "Depth of the centre of volume under the surface; endless without it.")
_OMEGA = typer.Option("--omega", metavar="RAD/S", help="Radiation damping there; may be repeated.")


def _asked(
    density: DensityOption = None,
    at: AtOption = "0,0,0",
    turn: TurnOption = "0,0,0",
    json: JsonOption = False,
    into: IntoOption = None,
    out: OutOption = None,
    in_place: InPlaceOption = False,
    sigma: SigmaOption = 0.1,
) -> Asked:
    """What every body takes."""
    return Asked(density, place_of(at, turn), json, Target(into, out, in_place), sigma)


def _command(body: Callable[..., Body]) -> Callable[..., Body]:
    """Make a command from a function of a body's sizes; the options that all bodies have are added."""
    own, shared = (signature(f, eval_str=True).parameters for f in (body, _asked))

    def command(**given: Any) -> None:
        asked = _asked(**{name: given.pop(name) for name in shared})
        tell(body(**given), asked, [value for value in given.values() if isinstance(value, Path)])

    parameters = [p.replace(kind=p.KEYWORD_ONLY) for p in (*own.values(), *shared.values())]
    command.__name__, command.__doc__ = body.__name__, body.__doc__
    command.__annotations__ = {p.name: p.annotation for p in parameters}
    command.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    app.command()(command)
    return body


@_command
def ellipsoid(
    a: Annotated[float, _metres("--a", "Semi-axis along x.")],
    b: Annotated[float, _metres("--b", "Semi-axis along y.")],
    c: Annotated[float, _metres("--c", "Semi-axis along z.")],
) -> Body:
    """An ellipsoid with three semi-axes (Lamb): exact in ideal fluid."""
    from undertow.shape.bodies import ellipsoid as body

    return lambda rho: body(a, b, c, rho)


@_command
def sphere(
    diameter: Annotated[float, _DIAMETER],
) -> Body:
    """A sphere: half of what it displaces, in every direction."""
    from undertow.shape.bodies import positive
    from undertow.shape.bodies import sphere as body

    positive(diameter=diameter)
    return lambda rho: body(diameter / 2, rho)


@_command
def spheroid(
    length: Annotated[float, _LENGTH],
    diameter: Annotated[float, _DIAMETER],
) -> Body:
    """A spheroid about x, such as the hull of a torpedo-shaped vehicle (Lamb): exact in ideal fluid."""
    from undertow.shape.bodies import prolate_spheroid as body

    return lambda rho: body(length, diameter, rho)


@_command
def cylinder(
    length: Annotated[float, _LENGTH],
    diameter: Annotated[float, _DIAMETER],
) -> Body:
    """A slender circular cylinder along x (--turn for other directions), by strips."""
    from undertow.shape.bodies import cylinder as body

    return lambda rho: body(length, diameter, rho)


@_command
def box(
    length: Annotated[float, _LENGTH],
    beam: Annotated[float, _metres("--beam", "Along y.")],
    height: Annotated[float, _metres("--height", "Along z.")],
) -> Body:
    """A rectangular box, from a table of panel computations; no side more than 5.6 times the next one."""
    from undertow.shape.bodies import box as body

    return lambda rho: body(length, beam, height, rho)


@_command
def mesh(
    hull: Annotated[Path, _MESH],
    unit: UnitOption = None,
    frame: FrameOption = "FRD",
    depth: Annotated[float | None, _DEPTH] = None,
    omega: Annotated[list[float] | None, _OMEGA] = None,
    panels: PanelsOption = 3200,
    crease: CreaseOption = 30.0,
) -> Body:
    """Any closed hull, by panels of three sizes, extrapolated; needs the extra undertow[bem].

    With --depth there is a free surface: the added mass is that of high frequency, and each --omega gives the
    radiation damping there. With --into, that at the first --omega is written as prior of the linear damping.
    """
    from undertow.shape.panels import added_mass_of_hull

    from ._terminal import progress

    surface = read(hull, unit, frame).mesh

    def found(rho: float) -> PanelResult:
        with progress("panels") as report:
            return added_mass_of_hull(
                surface, rho, depth=depth, omegas=omega or [], finest=panels, crease=crease, report=report
            )

    def named(rho: float) -> PanelResult:
        result = found(rho)
        return replace(result, added=replace(result.added, source=f"{hull.name}; {result.added.source}"))

    return named
