"""Bring everything that follows from a vehicle file up to date after an edit, and say what has changed.

Written into build/NAME/: the model's C code, and pictures of its poles, of the loops and of their steps; for
each gain file its controller in C, in a folder of its own beside. The conditions on gains are checked again.
What has changed since the last time is printed: parameters, eigenvalues, margins, verdicts.

    undertow update rov.toml --gains pd.toml --gains pid.toml --at u=0.5

The gain files and the motion are remembered: after the next edit the name of the vehicle is enough.

    undertow update rov.toml

Nothing is written if a file is no good. What was there the last time stands in build/NAME/update.json.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from undertow.cli._vehicle_and_logs import EffectsOption, VehicleArgument

_GAINS = typer.Option(
    "--gains",
    metavar="GAINS",
    help="Gain file, or name of a bundled one; may be repeated.",
    show_default="those of the last time",
)
_AT = typer.Option(
    "--at",
    metavar="NAME=VALUE",
    help="A motion besides hovering, whose eigenvalues are watched.",
    show_default="that of the last time",
)
_OUT = typer.Option("--out", metavar="FOLDER", help="Folder that gets a folder NAME for the vehicle.")


def update(
    vehicle: VehicleArgument,
    gains: Annotated[list[str] | None, _GAINS] = None,
    at: Annotated[list[str] | None, _AT] = None,
    out: Annotated[Path, _OUT] = Path("build"),
    effects: EffectsOption = None,
) -> None:
    from undertow.cli._progress import progress
    from undertow.cli._updating import Update, show
    from undertow.control.linear.failures import told

    with progress("updating") as tell, told():
        done = Update(vehicle, gains, at, out, effects or []).run(tell)
    show(done)
