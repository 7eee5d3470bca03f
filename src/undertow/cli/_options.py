"""Options that many commands share, and the reading of what they name."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import is_dataclass
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import Annotated, Any

import typer

from undertow.errors import UndertowError

VehicleArgument = Annotated[
    str, typer.Argument(metavar="VEHICLE", help="Vehicle file (TOML), or the name of a bundled vehicle.")
]
EffectsOption = Annotated[
    list[Path] | None,
    typer.Option(metavar="FILE", help="Python file with effects of your own; it is executed."),
]
OutOption = Annotated[Path | None, typer.Option(metavar="NEW.toml", help="Write a new vehicle file.")]
InPlaceOption = Annotated[bool, typer.Option("--in-place", help="Change the vehicle file itself.")]
CurrentOption = Annotated[
    str | None,
    typer.Option(metavar="NORTH,EAST", help="Velocity of the water over ground, m/s."),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")]
JsonFileOption = Annotated[Path | None, typer.Option(metavar="FILE", help="Write the whole result as JSON.")]
NewForceOption = Annotated[bool, typer.Option("--force", help="Replace the file if it exists.")]


def bundled(command: Callable[..., Any]) -> Callable[..., Any]:
    """Let a command take the fields of a dataclass, one of its parameters, as options of its own."""
    given = signature(command, eval_str=True).parameters.values()
    bundle = next(p for p in given if is_dataclass(p.annotation))
    fields = signature(bundle.annotation, eval_str=True).parameters
    parameters = [*(p for p in given if p is not bundle), *fields.values()]

    def expanded(**values: Any) -> Any:
        options = bundle.annotation(**{name: values.pop(name) for name in fields})
        return command(**values, **{bundle.name: options})

    expanded.__name__, expanded.__doc__ = command.__name__, command.__doc__
    expanded.__annotations__ = {p.name: p.annotation for p in parameters}
    keywords = [p.replace(kind=Parameter.KEYWORD_ONLY) for p in parameters]
    expanded.__signature__ = Signature(keywords)  # type: ignore[attr-defined]
    return expanded


def target_of(
    vehicle: str, out: Path | None, in_place: bool, *beside: Path | None, inputs: Sequence[str | Path]
) -> Path | None:
    """The vehicle file to be written, or None; one that the user has not asked to be replaced is refused.

    So is one that cannot be written, or is one of the `inputs`; the same of the files `beside` it.
    """
    from undertow.files import check_writable
    from undertow.model.loading import bundled_vehicles, resolve_vehicle

    path = resolve_vehicle(vehicle)
    if out is not None and in_place:
        raise UndertowError("both --out and --in-place are given: choose one")
    if in_place and path in bundled_vehicles().values():
        raise UndertowError(f"'{vehicle}' is bundled with undertow and is never changed: use --out")
    if out is not None and out.exists() and out.samefile(path):
        raise UndertowError(f"--out '{out}' is the vehicle file itself: name another, or give --in-place")
    target = path if in_place else out
    check_writable(target, *beside, inputs=[*inputs, *([] if in_place else [vehicle])])
    return target


def new_file(target: Path, force: bool, inputs: Iterable[str | Path]) -> Path:
    """A file that is to be written and replaced with --force only."""
    from undertow.files import check_writable

    check_writable(target, inputs=list(inputs))
    if target.exists() and not force:
        raise UndertowError(f"'{target}' exists already: name another file with --out, or give --force")
    return target


def names_and_values(option: str, texts: Iterable[str], example: str) -> list[tuple[str, str]]:
    """Names and values out of "u=0.5" and "x=1,z=2"."""
    parts = [word.partition("=") for text in texts for word in words([text]) or [text]]
    wrong = [name for name, mark, value in parts if not (mark and name.strip() and value.strip())]
    if wrong:
        raise UndertowError(f"{option} {wrong[0]}: write NAME=VALUE, such as {example}")
    names = [name.strip() for name, _, _ in parts]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise UndertowError(f"{option} names {twice[0]} twice: name it once")
    return [(name.strip(), value.strip()) for name, _, value in parts]


def words(texts: Iterable[str]) -> list[str]:
    """The parts of texts that have commas in them, without those that are blank."""
    return [word.strip() for one in texts for word in one.split(",") if word.strip()]


def number_or_text(value: str) -> float | str:
    """A number where the text is one, else the text with its unit."""
    try:
        return float(value)
    except ValueError:
        return value


def in_si(option: str, value: str | float, unit: str) -> float:
    """A value in SI: a plain number, or one with a unit."""
    from undertow.model.units import si_of

    return si_of(option, number_or_text(value) if isinstance(value, str) else value, unit)


def quantities(
    option: str,
    texts: Iterable[str],
    units: Mapping[str, str],
    otherwise: str = "1",
    example: str = "u=0.5",
) -> dict[str, float]:
    """Values in SI by name, out of "u=0.5" and "x=1 m,psi=20 deg"; `otherwise` is the unit of other names."""
    pairs = names_and_values(option, texts, example)
    return {n: in_si(f"{option} {n}", value, units.get(n, otherwise)) for n, value in pairs}


def current_of(text: str) -> tuple[float, float]:
    """The velocities of --current to the north and to the east, m/s."""
    parts = [in_si("--current", part, "m/s") for part in text.split(",")]
    if len(parts) != 2:
        raise UndertowError(f"--current {text}: give two velocities, such as 0.3,0.1 (north, east)")
    return parts[0], parts[1]
