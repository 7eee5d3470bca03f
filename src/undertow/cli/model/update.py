"""Regenerate everything derived from a vehicle file after an edit, and report what has changed.

It writes into build/NAME/ the C library of the model and of each gain file's controller (as undertow export c
does), and plots of poles, loops and step responses. It checks the conditions on gains again, and prints what
has changed since the last update: parameters, eigenvalues, margins, verdicts.

    undertow update rov.toml --gains pd.toml --gains pid.toml --at u=0.5

The gain files and the motion are remembered: after the next edit the name of the vehicle is enough.

    undertow update rov.toml

Nothing is written if a file is invalid. The state of the last update is in build/NAME/update.json.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .._options import EffectsOption, VehicleArgument
from .._terminal import progress, say, section, table
from ..control.linearize import held

if TYPE_CHECKING:
    from undertow.codegen.manifest import Report
    from undertow.control.linear.report import Change, Snapshot
    from undertow.control.update import Update

_GAINS = typer.Option(
    metavar="GAINS",
    help="Gain file, or name of a bundled one; may be repeated.",
    show_default="as last time",
)
_AT = typer.Option(
    metavar="NAME=VALUE",
    help="A steady motion, in addition to hovering, whose eigenvalues are tracked.",
    show_default="as last time",
)
_OUT = typer.Option(metavar="FOLDER", help="Output folder; files go into a subfolder NAME.")


def update(
    vehicle: VehicleArgument,
    gains: Annotated[list[str] | None, _GAINS] = None,
    at: Annotated[list[str] | None, _AT] = None,
    out: Annotated[Path, _OUT] = Path("build"),
    effects: EffectsOption = None,
) -> None:
    from undertow.control.update import last_update
    from undertow.control.update import update as updated
    from undertow.model.loading import load_vehicle

    with progress("updating") as report:
        model = load_vehicle(vehicle, effect_files=effects or [])
        old = last_update(model, out)
        if gains is None:
            gains = old.gains if old else []
        if at is None:
            at = old.at if old else []
        done = updated(model, out, gains, held(at), at_words=at, old=old, progress=report)
    show(done)


_TITLES = {
    "parameters": "Parameters",
    "eigenvalues": "Eigenvalues, rad/s",
    "margins": "Margins",
    "verdicts": "Verdicts",
}


def show(done: Update) -> None:
    """Print what was written, and what has changed."""
    from undertow.control.linear.report import changes

    say(f"{done.written.folder}: written")
    for line in _of_equations(done.written):
        say(f"  {line}")
    say(f"{done.pictures[0].parent}: {', '.join(p.name for p in done.pictures)}")
    if done.old is None:
        say("first time: from now on, changes are reported")
        _show_verdicts(done.new)
        return
    found = changes(done.old, done.new)
    for kind, title in _TITLES.items():
        _show_changes(title, found[kind])


def _of_equations(report: Report) -> list[str]:
    """Changes of the code besides those of values, which are shown below."""
    if report.first:
        return ["first time"]
    return [line for line in report.changes if not line.startswith("parameters changed")]


def _show_changes(title: str, found: Sequence[Change]) -> None:
    if not found:
        section(f"{title}: none has changed")
        return
    rows = [(c.what, c.old or "(none)", c.new or "(none)") for c in found]
    section(title, table(("", "old", "new"), rows))


def _show_verdicts(new: Snapshot) -> None:
    from undertow.control.conditions.result import HOLDS

    conditions = {name: v for name, v in new.verdicts.items() if " condition " in name}
    rows = [(name, v) for name, v in new.verdicts.items() if name not in conditions]
    for gains in new.gains:
        own = [v for name, v in conditions.items() if name.startswith(f"{gains}, ")]
        failing = sum(v != HOLDS for v in own)
        count = f"{len(own) - failing} hold, {failing} fail (undertow gains shows which)"
        rows.append((f"{gains}, conditions one by one", count))
    section("Verdicts", table(("", ""), rows))
