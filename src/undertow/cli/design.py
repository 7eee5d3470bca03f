"""Design gains by linear-quadratic control at hover, check them, and write a gain file.

An error as large as --error counts as much as a force as large as --force (Bryson's rule); each coordinate
that thrusters push in needs both. The law of a gain file is diagonal, so the diagonal of the optimal gain is
taken and the loop that it closes is checked. With --law pid an integral is given as much time as the
conditions on gains ask for.

    undertow design mini-auv --error x=0.5,z=0.2,psi=0.2 --force surge=1,heave=2,yaw=0.1 --out gains.toml

    undertow design mini-auv --law pid --error x=0.5,z=0.2,psi=10deg --force surge=1,heave=2,yaw=0.1
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from undertow.cli._vehicle_and_logs import EffectsOption, VehicleArgument

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
    from undertow.cli._design import designed, gain_file, show
    from undertow.control.linear.failures import told
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
