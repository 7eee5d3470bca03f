"""Design gains by linear-quadratic control at hover, check them, and write a gain file.

--error and --force state errors and forces of equal cost (Bryson's rule); each actuated coordinate needs
both. The law of a gain file is diagonal, so only the diagonal of the optimal gain is used, and the resulting
loop is checked. With --law pid, the integral action is as slow as the conditions on the gains require.

    undertow design mini-auv --error x=0.5,z=0.2,psi=0.2 --force surge=1,heave=2,yaw=0.1 --out gains.toml

    undertow design mini-auv --law pid --error x=0.5,z=0.2,psi=10deg --force surge=1,heave=2,yaw=0.1
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from .._options import EffectsOption, VehicleArgument, quantities
from .._terminal import console, progress, say, section, table, text, write_files
from .linearize import DIRECTION, directions, show_modes

if TYPE_CHECKING:
    from undertow.control.linear.design import Design

_ERROR = typer.Option(metavar="NAME=VALUE", help="Acceptable error of x, z, psi ..., m and rad.")
_FORCE = typer.Option(metavar="NAME=VALUE", help="Available force in surge, heave ..., N and N m.")


def design(
    vehicle: VehicleArgument,
    error: Annotated[list[str], _ERROR],
    force: Annotated[list[str], _FORCE],
    law: Annotated[Literal["pd", "pid"], typer.Option(help="Law of the gain file.")] = "pd",
    direction: Annotated[list[str] | None, DIRECTION] = None,
    name: Annotated[str, typer.Option(metavar="NAME", help="Name of the gain set.")] = "lqr",
    out: Annotated[Path | None, typer.Option(metavar="NEW.toml", help="Write the gain file.")] = None,
    effects: EffectsOption = None,
) -> None:
    from undertow.control.conditions.check import derived_conditions_hold
    from undertow.control.linear.design import lqr
    from undertow.control.linear.numeric import as_input_error
    from undertow.control.linear.trim import find_trim
    from undertow.files import check_writable
    from undertow.model.loading import load_vehicle
    from undertow.model.symbols import DOFS, FORCE_UNITS, MOTION_UNITS

    check_writable(out, inputs=[vehicle, *(effects or [])])
    with progress("designing", None), as_input_error():
        model = load_vehicle(vehicle, effect_files=effects or [])
        done = lqr(
            model,
            quantities("--error", error, MOTION_UNITS),
            quantities("--force", force, dict(zip(DOFS, FORCE_UNITS, strict=True))),
            law=law,
            trim=find_trim(model, direction=directions(direction or [])),
            conditions=derived_conditions_hold,
            name=name,
        )
    show(done)
    source = f"undertow design: --error {','.join(error)} --force {','.join(force)}"
    write_files((out, done.to_toml(source)))
    if out is None:
        typer.echo("nothing was written: --out NEW.toml writes the gain file")


def show(done: Design) -> None:
    """Print gains, poles and margins."""
    section(f"Gains of law {done.gains.law.id}", table(("", *done.coordinates), _rows(done)))
    share = f"{100 * done.coupling:.3g}%"
    console().print(text(f"  coupling that the diagonal law leaves out: up to {share} of the optimal gain"))
    for line in _on_conditions(done):
        say(f"  {line}")
    if done.slowed:
        console().print(text(f"  the integral time was doubled {done.slowed} times until they held"))
    show_modes("Poles of the loop", done.modes)


_VERDICTS = {True: "all hold", False: "not all hold"}


def _on_conditions(done: Design) -> Iterator[str]:
    """What the conditions say, with everything for which undertow gains would say no."""
    from undertow.control.conditions.check import check

    report = check(done.gains)
    yield f"conditions derived from the model: {_VERDICTS[bool(done.certified)]}"
    if report.zero_dynamics:
        yield f"unactuated axes: {report.zero_dynamics.text}"
    if done.certified and not report.conditions_hold:
        yield "not all conditions in their printed form hold: undertow gains shows which"


def _rows(done: Design) -> list[tuple[str, ...]]:
    return [
        (g.name, *(f"{done.gains.values[str(g.symbol(c))]:.6g} {g.unit(c)}" for c in done.coordinates))
        for g in type(done.gains.law).gains
    ]
