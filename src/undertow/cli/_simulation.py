"""Reading what `undertow simulate` is asked, and telling what came of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from undertow.cli._progress import progress
from undertow.cli._show import section, table
from undertow.control.closed_loop import Choices, ClosedLoop, LoopResult, Push, Record, Scenario
from undertow.control.closed_loop import without as left_out
from undertow.control.closed_loop.scenario import UNITS, force_unit
from undertow.errors import UndertowError
from undertow.files import check_folder, check_writable, together, write_whole
from undertow.model.effects.ocean_current import check_current
from undertow.model.units import to_si

if TYPE_CHECKING:
    from undertow.control.closed_loop.measures import CoordinateResult, Cycle

_AXES = "XYZKMN"
_MUCH = 1e5  # of an overshoot in %: more has no decimals
_OF_COMMANDS = ("command", "effort", "rms", "peak", "changes per s", "at limit")


# --- what is asked --------------------------------------------------------------------------------
def scenario_of(
    to: str,
    start: str | None,
    duration: float,
    dt: float,
    moving: list[str] | None,
    continuous: bool,
    noise: list[str] | None,
    seed: int,
    pushes: list[str] | None,
    log: float | None,
) -> Scenario:
    """The scenario of the command line.

    Raises
    ------
    UndertowError
        If an option cannot be read, or asks for what cannot be.
    """
    return Scenario(
        _values(to, "--to"),
        duration,
        dt,
        _values(start, "--from") if start else (),
        _named(moving, "--moving", UNITS.get),
        continuous,
        _named(noise, "--noise", UNITS.get),
        seed,
        tuple(_push(text) for text in pushes or ()),
        log,
    )


def choices_of(
    order: Any, heading: Any, integrators: Any, gate: str | None, sway: Any, current: str | None
) -> Choices:
    """The choices of the command line; a gate without a unit is in degrees nowhere, but in rad."""
    water = (
        None
        if current is None
        else tuple(_number(v, "m/s", "--current") for v in _values(current, "--current"))
    )
    if water is not None and len(water) != 2:
        raise UndertowError(
            f"--current {current} has {len(water)} values: give two, to the north and to the east"
        )
    if water is not None:
        check_current(*water)
    wanted = None if gate is None else f"{_number(gate, 'rad', '--gate')!r} rad"
    return Choices(order, heading, integrators, wanted, sway, water)  # type: ignore[arg-type]


def _values(text: str, option: str) -> tuple[str | float, ...]:
    parts = [part.strip() for part in text.split(",")]
    if not all(parts):
        raise UndertowError(f"{option} {text} has an empty value: write numbers with commas between them")
    return tuple(_plain(part) for part in parts)


def _plain(text: str) -> str | float:
    """A number where the text is one, else the text with its unit."""
    try:
        return float(text)
    except ValueError:
        return text


def _number(text: str | float, unit: str, option: str) -> float:
    try:
        return to_si(_plain(text) if isinstance(text, str) else text, unit)
    except UndertowError as error:
        raise UndertowError(f"{option}: {error}") from error


def _named(texts: list[str] | None, option: str, unit_of: Callable[[str], str | None]) -> dict[str, float]:
    found: dict[str, float] = {}
    for text in texts or ():
        name, _, value = text.partition("=")
        unit = unit_of(name)
        if unit is None or not value:
            raise UndertowError(f"{option} {text} is not NAME=VALUE: write it like {option} x=0.01")
        found[name] = _number(value, unit, f"{option} {name}")
    return found


def _push(text: str) -> Push:
    axis, _, rest = text.partition("=")
    value, *times = rest.split(":")
    if axis not in tuple(_AXES) or len(times) not in (0, 2):
        raise UndertowError(
            f"--push {text} is not AXIS=VALUE or AXIS=VALUE:FROM:TO: write it like X=0.5:60:90"
        )
    begin, end = (_number(t, "s", f"--push {text}") for t in times) if times else (0.0, math.inf)
    if not begin < end:
        raise UndertowError(f"--push {text} ends before it begins: give FROM and TO in s, FROM first")
    return Push(axis, _number(value, force_unit(axis), f"--push {text}"), begin, end)


def check_outputs(
    gains: list[str], out: Path | None, figures: Path | None, json: Path | None, inputs: Sequence[str | Path]
) -> None:
    """Refuse what could not be written.

    Raises
    ------
    UndertowError
        If a file cannot be written, or one log is to hold several runs.
    """
    if out is not None and len(gains) > 1:
        raise UndertowError(
            f"--out {out} holds one run, and there are {len(gains)} gain files: give one of them"
        )
    check_writable(out, json, inputs=inputs)
    if figures is not None:
        check_folder(figures)


# --- the runs ---------------------------------------------------------------------------------------
def simulated(
    vehicle: str,
    plant: str | None,
    gains: list[str],
    scenario: Scenario,
    choices: Choices,
    without: list[str],
    effects: list[Path],
) -> list[Record]:
    """A run with every gain set, with a progress bar."""
    from undertow.model.loading import load_vehicle

    known = left_out(load_vehicle(vehicle, effect_files=effects), without)
    _remark_turns("--to", scenario.pose(scenario.to, known.pose_names, "set-point"), scenario.to)
    moving = load_vehicle(plant, effect_files=effects) if plant else None
    with progress("simulating", total=len(gains) * scenario.duration) as report:
        return [
            _one(choices.loop(name, known, moving), scenario, report, i * scenario.duration)
            for i, name in enumerate(gains)
        ]


def _remark_turns(option: str, pose: dict[str, float], stated: Sequence[str | float]) -> None:
    """Ask whether degrees were meant, where a heading without a unit is more than a turn."""
    psi = pose.get("psi", 0.0)
    if abs(psi) > 2 * math.pi and not isinstance(dict(zip(pose, stated, strict=True))["psi"], str):
        remark = f"{option}: the heading {psi:g} is in radians, {psi / (2 * math.pi):.1f} turns"
        typer.echo(f"{remark}; write {psi:g}deg if degrees are meant", err=True)


def _one(loop: ClosedLoop, scenario: Scenario, report: Callable[[float, str], None], before: float) -> Record:
    return loop.run(scenario, lambda done, words: report(before + done, words))


# --- telling ----------------------------------------------------------------------------------------
def show(results: Sequence[LoopResult]) -> None:
    """Print the tables of every run."""
    for result in results:
        section(f"{result.controller} ({result.law}) on {result.vehicle}")
        for line in _facts(result):
            typer.echo(f"  {line}")
        head = (
            "coordinate",
            "move",
            "t2%, s",
            "overshoot",
            "error at end",
            "mean, last tenth",
            "oscillation",
        )
        section("  Coordinates", table(head, [_coordinate(c) for c in result.coordinates], 4))
        section("  Commands", table(_OF_COMMANDS, [_command(c) for c in result.commands], 4))


def _facts(result: LoopResult) -> Iterator[str]:
    how = "law not sampled, steps of at most" if result.law_is == "continuous" else "controller sampled every"
    yield f"{result.duration:g} s, {how} {result.dt:g} s"
    if result.gate_passed is not None:
        yield f"heading within the gate after {result.gate_passed:.3f} s, then x and y"
    if result.divergence is not None:
        yield f"DIVERGED: {result.divergence.text}; the numbers are of the run up to there"
    if result.turned_thrusters:
        names = ", ".join(result.turned_thrusters)
        yield f"REMARK: more than 45 deg from where the controller takes them to push: {names}"
    for c in result.coordinates:
        if c.turns:
            yield f"{c.name}: errors are from the set-point {_turns(c.turns)}, the nearest one at the end"
    left = {c.name: c for c in result.coordinates if c.sampling_offset}
    if left:
        sizes = ", ".join(f"{c.sampling_offset:.3g} {c.unit} in {name}" for name, c in left.items())
        yield f"the sign of the law, sampled, may leave up to {sizes} (an estimate)"


def _turns(count: int) -> str:
    return f"{abs(count)} whole turn{'s' if abs(count) > 1 else ''} {'on' if count > 0 else 'back'}"


def _coordinate(c: CoordinateResult) -> tuple[str, ...]:
    settled = (
        "not settled" if c.settling is None and c.move else "" if c.settling is None else f"{c.settling:.2f}"
    )
    overshoot = "" if c.overshoot is None else f"{c.overshoot:{'.2f' if c.overshoot < _MUCH else '.3g'}} %"
    steady = f"{c.steady_error:+.3g} ± {c.steady_spread:.2g}"
    return (
        c.name,
        f"{c.move:.4g} {c.unit}",
        settled,
        overshoot,
        f"{c.final_error:+.4g}",
        steady,
        _cycle(c.cycle, c.unit),
    )


def _cycle(cycle: Cycle | None, unit: str) -> str:
    if cycle is None:
        return ""
    return f"{cycle.kind}: ±{cycle.amplitude:.3g} {unit}, {cycle.period:.4g} s ({cycle.cycles} seen)"


def _command(c: Any) -> tuple[str, ...]:
    numbers = (f"{v:.4g}" for v in (c.effort, c.rms, c.peak, c.variation))
    return (c.name, *numbers, f"{100 * c.at_limit:.2g} %" if c.at_limit else "")


def write(records: Sequence[Record], out: Path | None, figures: Path | None, json: Path | None) -> None:
    """Write the log, the result and the pictures that are asked for."""
    drawn = 0
    with together():
        if out is not None:
            write_whole(out, records[0].to_csv())
        if json is not None:
            write_whole(json, "[\n" + ",\n".join(record.to_json().rstrip() for record in records) + "\n]\n")
        if figures is not None:
            from undertow.cli._simulation_pictures import draw

            drawn = draw(records, figures)
    if figures is not None:
        typer.echo(f"{drawn} pictures in {figures}")
