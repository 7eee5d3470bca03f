"""What `undertow add` prints and writes."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape

from undertow.errors import UndertowError

if TYPE_CHECKING:
    from undertow.codegen.export import Report
    from undertow.identification.diagnosis.addition import Addition, Ground
    from undertow.identification.diagnosis.result import Step


def target_of(vehicle: str, out: Path | None, in_place: bool) -> Path | None:
    """The vehicle file to be written, or None.

    Raises
    ------
    UndertowError
        If a file would be replaced that the user has not asked to be replaced.
    """
    from undertow.model.loading import bundled_vehicles, resolve_vehicle

    path = resolve_vehicle(vehicle)
    if out is not None and in_place:
        raise UndertowError("both --out and --in-place are given: choose one")
    if in_place and path in bundled_vehicles().values():
        raise UndertowError(f"'{vehicle}' comes with undertow and stays as it is: use --out")
    if out is not None and out.exists() and out.samefile(path):
        raise UndertowError(f"--out '{out}' is the vehicle file itself: name another, or give --in-place")
    return path if in_place else out


def show(addition: Addition) -> None:
    """Say what the effect does to the error, and with which values."""
    from undertow.identification.weak.estimated import NOTHING_SAID

    console = Console(highlight=False)
    names = ("model as given", f"refitted without {addition.effect}", f"refitted with {addition.effect}")
    width = max(map(len, names))
    console.print("Error on kept-aside data (1 = noise of the sensors):")
    for name, step in zip(names, addition.steps, strict=True):
        console.print(f"  {name:{width}} {_errors(step)}")
    if not addition.helps:
        console.print(f"[yellow]{addition.effect} does not help[/yellow]: no fall, or none beyond chance.")
    errors, units = addition.fit.standard_errors, addition.fit.vehicle.declared_parameters
    for name in addition.kept:
        spread = f"± {errors[name]:.1g} " if errors[name] < NOTHING_SAID else ""
        text = f"  {name} = {addition.fit.values[name]:.4g} {spread}{units[name].unit}"
        console.print(escape(text.rstrip()))
    if addition.dropped:
        console.print(f"left out, zero within their error: {', '.join(addition.dropped)}")


def _errors(step: Step) -> str:
    ahead = "" if step.prediction is None else f", velocity error 5 s ahead {step.prediction:.1%}"
    return f"{step.error:.3g}{ahead}"


def draw(addition: Addition, out: Path) -> None:
    """The error before and after as a picture."""
    from undertow.identification.report import falling_error, save_png

    save_png(falling_error(addition.steps), out)


def write(addition: Addition, ground: Ground, template: Path, out: Path) -> None:
    """Write the vehicle file with the effect, and how it came about."""
    from undertow.model.saving import save_vehicle

    save_vehicle(addition.fit.vehicle, template, out, history=_history(addition, ground))


def _history(addition: Addition, ground: Ground) -> dict[str, object]:
    roles = [("train", r) for r in ground.train] + [("holdout", r) for r in ground.test]
    fit = addition.fit
    return {
        "command": "undertow add",
        "date": date.today().isoformat(),
        "added": [addition.effect],
        "helps": addition.helps,
        "logs": [{"name": r.name, "sha256": r.sha256, "role": role} for role, r in roles],
        "error_before": addition.before.error,
        "error_after": addition.after.error,
        "covariance": {"parameters": list(fit.model.free), "matrix": fit.covariance.tolist()},
    }


def code_of(vehicle: Path, effects: Sequence[Path], build: Path) -> Report:
    """Regenerate the C code of a vehicle file."""
    from undertow.codegen.export import Export
    from undertow.model.loading import load_vehicle

    return Export(load_vehicle(vehicle, effect_files=effects)).write(build)


def tell_written(picture: Path | None, vehicle: Path | None, code: Report | None) -> None:
    """Say where the picture, the vehicle file and its code are, and what has changed in the code."""
    console = Console(highlight=False)
    for path in filter(None, (picture, vehicle)):
        console.print(f"wrote {escape(str(path))}")
    if code is not None:
        console.print(f"wrote the code in {escape(str(code.folder))}")
        for line in code.changes:
            console.print(f"  {escape(line)}")
