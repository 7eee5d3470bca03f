"""Design gains by linear-quadratic control at hover, check them, and write a gain file.

An error as large as --error counts as much as a force as large as --force (Bryson's rule); each coordinate
that thrusters push in needs both. The law of a gain file is diagonal, so the diagonal of the optimal gain is
taken and the loop that it closes is checked. With --law pid an integral is given as much time as the
conditions on gains ask for.

    undertow design mini-auv --error x=0.5,z=0.2,psi=0.2 --force surge=1,heave=2,yaw=0.1 --out gains.toml

    undertow design mini-auv --law pid --error x=0.5,z=0.2,psi=10deg --force surge=1,heave=2,yaw=0.1
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import tomlkit
import typer

from undertow.cli._vehicle_and_logs import EffectsOption, VehicleArgument
from undertow.control.conditions.check import check, derived_conditions_hold
from undertow.control.linear.design import Design, lqr
from undertow.model.symbols import DOFS, FORCE_UNITS, POSE

from ._terminal import console, section, table, text
from .linearize import Wish, pairs, show_modes, si

_ERROR = typer.Option("--error", metavar="NAME=VALUE", help="Acceptable error of x, z, psi ..., m and rad.")
_FORCE = typer.Option("--force", metavar="NAME=VALUE", help="Available force in surge, heave ..., N and N m.")
_DIRECTION = typer.Option(
    "--direction", metavar="NAME=1|-1", help="Whose parameters hold at rest.", show_default="1"
)
_NAME = typer.Option("--name", metavar="NAME", help="Of the gain set.")
_OUT = typer.Option("--out", metavar="NEW.toml", help="Write the gain file.")


def design(
    vehicle: VehicleArgument,
    error: Annotated[list[str], _ERROR],
    force: Annotated[list[str], _FORCE],
    law: Annotated[Literal["pd", "pid"], typer.Option("--law", help="Law of the gain file.")] = "pd",
    direction: Annotated[list[str] | None, _DIRECTION] = None,
    name: Annotated[str, _NAME] = "lqr",
    out: Annotated[Path | None, _OUT] = None,
    effects: EffectsOption = None,
) -> None:
    from undertow.control.linear.numeric import told
    from undertow.files import check_writable, write_whole

    check_writable(out, inputs=[vehicle, *(effects or [])])
    with told():
        done = designed(vehicle, error, force, law, direction or [], name, effects or [])
    show(done)
    if out is None:
        typer.echo("nothing was written: --out NEW.toml writes the gain file")
    else:
        write_whole(out, gain_file(done, error, force))
        typer.echo(f"wrote {out}")


_POSE_UNITS = dict(zip(POSE, (*("m",) * 3, *("rad",) * 3), strict=True))
_UNITS_OF_FORCE = dict(zip(DOFS, FORCE_UNITS, strict=True))


def designed(
    vehicle: str,
    error: Sequence[str],
    force: Sequence[str],
    law: str,
    direction: Sequence[str],
    name: str,
    effects: Sequence[Path],
) -> Design:
    """The design that is asked for."""
    wish = Wish(vehicle, [], [], None, list(direction), effects=effects)
    model = wish.model()
    errors = {n: si(f"--error {n}", v, _POSE_UNITS.get(n, "1")) for n, v in pairs("--error", error)}
    forces = {n: si(f"--force {n}", v, _UNITS_OF_FORCE.get(n, "1")) for n, v in pairs("--force", force)}
    return lqr(
        model, errors, forces, law=law, trim=wish.trim(model), conditions=derived_conditions_hold, name=name
    )


def show(done: Design) -> None:
    """Print gains, poles and margins."""
    section(f"Gains of law {done.gains.law.id}", table(("", *_coordinates(done)), _rows(done)))
    out = console()
    share = f"{100 * done.coupling:.3g} %"
    out.print(text(f"  coupling that the diagonal law leaves out: up to {share} of the optimal gain"))
    for line in _told(done):
        out.print(text(f"  {line}"), soft_wrap=True)
    if done.slowed:
        out.print(text(f"  the integral was given twice the time {done.slowed} times until they held"))
    show_modes("Poles of the loop", done.modes)


_VERDICTS = {True: "all hold", False: "not all hold"}


def _told(done: Design) -> Iterator[str]:
    """What the conditions say, with everything for which undertow gains would say no."""
    report = check(done.gains)
    yield f"conditions derived from the model: {_VERDICTS[bool(done.certified)]}"
    if report.alone:
        yield f"left alone: {report.alone.text}"
    if done.certified and not report.conditions_hold:
        yield "the conditions in their printed form do not all hold: undertow gains shows which"


def _coordinates(done: Design) -> list[str]:
    gain = type(done.gains.law).gains[0]
    return [c for c in done.gains.signals.coordinates if done.gains.values[str(gain.symbol(c))]]


def _rows(done: Design) -> list[tuple[str, ...]]:
    return [
        (g.name, *(f"{done.gains.values[str(g.symbol(c))]:.6g} {g.unit(c)}" for c in _coordinates(done)))
        for g in type(done.gains.law).gains
    ]


def gain_file(done: Design, error: Sequence[str], force: Sequence[str]) -> str:
    """Text of the gain file."""
    gains, document = done.gains, tomlkit.document()
    document.add(tomlkit.comment("Linear-quadratic design at hover with the diagonal of the optimal gain."))
    document["schema"] = "undertow/gains/1"
    document["name"] = gains.name
    vehicle = gains.plant.vehicle.name
    document["description"] = f"{gains.law.id} for {vehicle}"
    document["source"] = f"undertow design: --error {','.join(error)} --force {','.join(force)}"
    document["law"] = gains.law.id
    if gains.unactuated:
        document["unactuated"] = list(gains.unactuated)
    tables: Any = tomlkit.table()
    for gain in type(gains.law).gains:
        row = tomlkit.inline_table()
        for c in _coordinates(done):
            row[c] = f"{gains.values[str(gain.symbol(c))]:.6g} {gain.unit(c)}"
        tables[gain.name] = row
    document["gains"] = tables
    return tomlkit.dumps(document)
