"""Simulate a vehicle under a controller on its way to a goal.

Model, sensors, control law, schedule, thrust allocation and integrator (Runge-Kutta of fourth order) are
compiled into one call. The controller is sampled every --dt and its commands are held in between; with
--continuous it acts without sampling. Shown are settling time (2 %), overshoot, what is left at the end,
effort, and oscillations that last (amplitude and period). Several gain files are compared with each other.

    undertow simulate mini-auv paper-pd paper-pid paper-smc --to -1,1,1 --for 240 --figures figures

    undertow simulate mini-auv paper-pd --to -1,1,1,135deg --current 0.05,0 --noise x=0.01 --out log.csv

    undertow simulate rov.toml gains.toml --plant rov-as-identified.toml --to 5,0,2,0

The vehicle moves as VEHICLE says, unless --plant names another file: then the controller knows VEHICLE and
moves the other one. A set-point has x, y, z as far as the vehicle has them, and the heading if you wish;
without one it is taken from the direction of the set-point (--heading). Numbers are in SI unless they have a
unit: 135deg. A current, noise and pushes are not known to the controller.

--out writes a log that undertow itself reads: what the sensors report, and the mean of every command from one
row to the next. An interval --dt that is too long for the law is refused, and the limit is said. The exit
code is 1 if a run diverges: if the state is no number any more, a speed is beyond 100 m/s or 100 rad/s, which
nothing in water reaches, or the pose is farther from the start than twice that can lead. The tables, the log
and the pictures are of the run up to there. A run that has not settled yet has not diverged.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import typer
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

from undertow.cli._vehicle_and_logs import EffectsOption, VehicleArgument
from undertow.control.closed_loop import Choices, ClosedLoop, LoopResult, Push, Record, Scenario
from undertow.control.closed_loop import without as left_out
from undertow.control.closed_loop.scenario import UNITS, force_unit
from undertow.errors import UndertowError
from undertow.files import check_folder, check_writable, make_folder, together, write_whole
from undertow.identification.figures import AFTER, BEFORE, FAINT, FLOOR, INK, figure, look, plain, save_png
from undertow.model.effects.ocean_current import check_current
from undertow.model.units import to_si

from ._terminal import progress, section, table

if TYPE_CHECKING:
    from undertow.control.closed_loop.measures import CoordinateResult, Cycle


_GAINS = typer.Argument(metavar="GAINS", help="Gain files (TOML), or names of bundled ones (paper-pd ...).")
_TO = typer.Option("--to", metavar="X,Y,Z[,PSI]", help="Set-point.")
_FOR = typer.Option("--for", metavar="SECONDS", help="Length of the run.")
_DT = typer.Option("--dt", metavar="SECONDS", help="Sampling interval of the controller.")
_START = typer.Option("--from", metavar="X,Y,Z[,PSI]", help="Where the vehicle begins.", show_default="0")
_MOVING = typer.Option("--moving", metavar="NAME=VALUE", help="A velocity that it begins with, as u=0.2.")
_WITHOUT = typer.Option("--without", metavar="EFFECT", help="Leave an effect of the vehicle out.")
_PLANT = typer.Option("--plant", metavar="OTHER.toml", help="The vehicle that moves, if it is another one.")
_FILE = "gain file"
_ORDER = typer.Option("--order", help="Heading first, or all at once.", show_default=_FILE)
_HEADING = typer.Option("--heading", help="Heading to a set-point without one.", show_default=_FILE)
_GATE = typer.Option(
    "--gate", metavar="ANGLE", help="Error of the heading at which x and y begin.", show_default=_FILE
)
_INTEGRATORS = typer.Option("--integrators", help="When the integrals of x and y begin.", show_default=_FILE)
_SWAY = typer.Option("--sway", help="Add an ideal sway force, or leave that force out.", show_default=_FILE)
_CURRENT = typer.Option("--current", metavar="NORTH,EAST", help="Velocity of the water, m/s.")
_PUSH = typer.Option(
    "--push",
    metavar="AXIS=VALUE[:FROM:TO]",
    help="A force (X, Y, Z) or moment (K, M, N), for all the time or a part.",
)
_NOISE = typer.Option(
    "--noise", metavar="NAME=VALUE", help="Standard deviation of a sensor (x=0.01, psi=0.5deg)."
)
_SEED = typer.Option("--seed", help="Of the noise.")
_CONTINUOUS = typer.Option(
    "--continuous", help="The law acts without sampling, in Runge-Kutta steps of at most --dt."
)
_LOG = typer.Option(
    "--log", metavar="SECONDS", help="Interval of the rows of --out.", show_default="~5000 rows"
)
_OUT = typer.Option("--out", metavar="LOG.csv", help="Write the run as a log.")
_FIGURES = typer.Option("--figures", metavar="FOLDER", help="Write pictures (PNG) into this folder.")
_JSON = typer.Option("--json", metavar="FILE", help="Write the result as JSON.")


def simulate(
    vehicle: VehicleArgument,
    gains: Annotated[list[str], _GAINS],
    to: Annotated[str, _TO],
    duration: Annotated[float, _FOR] = 240.0,
    dt: Annotated[float, _DT] = 0.001,
    start: Annotated[str | None, _START] = None,
    moving: Annotated[list[str] | None, _MOVING] = None,
    without: Annotated[list[str] | None, _WITHOUT] = None,
    plant: Annotated[str | None, _PLANT] = None,
    order: Annotated[Literal["together", "yaw-first"] | None, _ORDER] = None,
    heading: Annotated[Literal["atan", "atan2"] | None, _HEADING] = None,
    gate: Annotated[str | None, _GATE] = None,
    integrators: Annotated[Literal["gate", "start"] | None, _INTEGRATORS] = None,
    sway: Annotated[Literal["actuated", "unactuated"] | None, _SWAY] = None,
    current: Annotated[str | None, _CURRENT] = None,
    push: Annotated[list[str] | None, _PUSH] = None,
    noise: Annotated[list[str] | None, _NOISE] = None,
    seed: Annotated[int, _SEED] = 0,
    continuous: Annotated[bool, _CONTINUOUS] = False,
    log: Annotated[float | None, _LOG] = None,
    out: Annotated[Path | None, _OUT] = None,
    figures: Annotated[Path | None, _FIGURES] = None,
    json: Annotated[Path | None, _JSON] = None,
    effects: EffectsOption = None,
) -> int:

    check_outputs(gains, out, figures, json, [vehicle, *gains, *([plant] if plant else []), *(effects or [])])
    scenario = scenario_of(to, start, duration, dt, moving, continuous, noise, seed, push, log)
    choices = choices_of(order, heading, integrators, gate, sway, current)
    records = simulated(vehicle, plant, gains, scenario, choices, without or [], effects or [])
    show([record.result for record in records])
    write(records, out, figures, json)
    return int(any(record.result.diverged is not None for record in records))


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
            drawn = draw(records, figures)
    if figures is not None:
        typer.echo(f"{drawn} pictures in {figures}")


_COLOURS = (AFTER, BEFORE, FLOOR, "#cc79a7", "#e69f00", "#56b4e9")
_STYLES = ("-", "--", "-.", ":")
_TITLES = {
    "x": "Position to the north",
    "y": "Position to the east",
    "z": "Depth",
    "phi": "Roll",
    "theta": "Pitch",
    "psi": "Heading",
}


def draw(records: Sequence[Record], folder: Path) -> int:
    """Write the pictures of some runs into a folder; their number is returned."""
    make_folder(folder)
    names = [n for n in _TITLES if all(n in r.result.to for r in records)]
    pictures = {name: coordinate(records, name) for name in names}
    pictures["commands"] = commands(records)
    if all(r.result.gate_passed is not None for r in records):
        pictures["strategy"] = strategy()
    for name, picture in pictures.items():
        save_png(picture, folder / f"{name}.png")
    return len(pictures)


def coordinate(records: Sequence[Record], name: str) -> Figure:
    """One coordinate of several runs over time, with the set-point."""
    angle = records[0].result.of(name).unit == "rad"
    scale, unit = (180 / np.pi, "deg") if angle else (1.0, "m")
    with look():
        picture, axes = figure(3.6)
        axis = axes[0, 0]
        goal = scale * records[0].result.to[name]
        axis.axhline(
            goal, color=INK, linewidth=0.9, linestyle=(0, (1, 2)), label=f"set-point {goal:.4g} {unit}"
        )
        for i, record in enumerate(records):
            axis.plot(record.t, scale * record.state[name], label=plain(record.result.controller), **_line(i))
            if record.result.gate_passed is not None and name in "xy":
                _mark_gate(axis, record, scale * record.result.start[name], i)
        axis.set_title(f"{_TITLES[name]} of {plain(records[0].result.vehicle)}")
        axis.set_xlabel("time [s]")
        axis.set_ylabel(f"{_TITLES[name].lower()} {name} [{unit}]")
        axis.grid()
        axis.legend(loc="best")
    return picture


def _line(i: int) -> dict[str, Any]:
    return {"color": _COLOURS[i % len(_COLOURS)], "linestyle": _STYLES[i % len(_STYLES)]}


def _mark_gate(axis: Any, record: Record, height: float, i: int) -> None:
    axis.plot(record.result.gate_passed, height, "o", color=_line(i)["color"], markersize=4)


def commands(records: Sequence[Record]) -> Figure:
    """The commands of several runs over time, one panel for each."""
    names = list(records[0].commands)
    with look():
        picture, axes = figure(1.1 + 1.4 * len(names), len(names), 1, sharex=True)
        for axis, name in zip(axes[:, 0], names, strict=True):
            for i, record in enumerate(records):
                if name in record.commands:
                    axis.plot(
                        record.t, record.commands[name], label=plain(record.result.controller), **_line(i)
                    )
            axis.set_ylabel(plain(name))
            axis.grid()
        axes[0, 0].set_title("Commands, in their units, mean from row to row")
        axes[-1, 0].set_xlabel("time [s]")
        picture.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper right", ncols=3)
    return picture


# --- the control strategy ---------------------------------------------------------------------------
_BOXES = {
    "goal": (0.2, 2.8, 1.6, 0.9, "set-point\nx, y, z"),
    "heading": (2.7, 4.2, 2.2, 0.9, "heading to\nthe goal, (42)"),
    "gate": (2.7, 2.8, 2.2, 0.9, "gate: opens once\nheading is reached"),
    "yaw": (6.4, 4.2, 1.9, 0.9, "heading control"),
    "plane": (6.4, 2.8, 1.9, 0.9, "x-y control"),
    "depth": (6.4, 1.4, 1.9, 0.9, "depth control"),
    "allocation": (9.3, 2.8, 1.9, 0.9, "thrust allocation\n(4), (5)"),
    "vehicle": (12.0, 2.8, 1.4, 0.9, "vehicle"),
}
# From the side of one box to that of another (right, left, above or below), words, and where they stand.
_ARROWS = (
    ("goal", "above", "heading", "left", "", 0.0),
    ("goal", "right", "gate", "left", "x, y", 2.25),
    ("goal", "below", "depth", "left", "z", 4.0),
    ("heading", "right", "yaw", "left", "desired psi", 5.5),
    ("heading", "below", "gate", "above", "", 0.0),
    ("gate", "right", "plane", "left", "", 0.0),
    ("yaw", "right", "allocation", "above", "yaw moment", 9.4),
    ("plane", "right", "allocation", "left", "force", 8.95),
    ("depth", "right", "allocation", "below", "heave force", 9.4),
    ("allocation", "right", "vehicle", "left", "", 0.0),
)
_LAW = (6.1, 1.1, 2.5, 4.3)


def strategy() -> Figure:
    """Block diagram of the schedule: first the heading, then x and y; depth all the time."""
    with look():
        picture, axes = figure(3.6)
        axis = axes[0, 0]
        axis.set_xlim(0, 13.6)
        axis.set_ylim(0, 5.6)
        axis.axis("off")
        axis.set_title("Control strategy: heading first, then x and y; depth in parallel")
        _box(axis, *_LAW, "", edgecolor=FAINT, linestyle="--")
        for box in _BOXES.values():
            _box(axis, *box, edgecolor=INK)
        for arrow in _ARROWS:
            _arrow(axis, *arrow)
        low, law = 0.45, _LAW[0] + _LAW[2] / 2
        right, bottom = _side("vehicle", "below")
        _path(axis, [(right, bottom), (right, low), (law, low), (law, _LAW[1])])
        words = "measured pose and velocity, to all of the law and to the gate"
        axis.text((law + right) / 2, low - 0.08, words, ha="center", va="top", fontsize=8)
    return picture


def _box(axis: Any, x: float, y: float, width: float, height: float, words: str, **style: Any) -> None:
    round_off = "round,pad=0,rounding_size=0.1"
    axis.add_patch(FancyBboxPatch((x, y), width, height, boxstyle=round_off, facecolor="white", **style))
    axis.text(x + width / 2, y + height / 2, words, ha="center", va="center", fontsize=8.5)


def _side(name: str, side: str) -> tuple[float, float]:
    x, y, width, height, _ = _BOXES[name]
    places = {"left": (0, 0.5), "right": (1, 0.5), "above": (0.5, 1), "below": (0.5, 0)}
    across, up = places[side]
    return x + across * width, y + up * height


def _arrow(axis: Any, source: str, leaves: str, target: str, enters: str, words: str, middle: float) -> None:
    begin, end = _side(source, leaves), _side(target, enters)
    corner = (begin[0], end[1]) if leaves in ("above", "below") else (end[0], begin[1])
    _path(axis, list(dict.fromkeys([begin, corner, end])))
    height = begin[1] if begin[1] == corner[1] else end[1]
    axis.text(middle, height + 0.08, words, ha="center", va="bottom", fontsize=7.5)


def _path(axis: Any, points: Sequence[tuple[float, float]]) -> None:
    axis.plot(*zip(*points[:-1], strict=True), color=INK, linewidth=1)
    arrow = {"arrowstyle": "-|>", "color": INK, "shrinkA": 0, "shrinkB": 0, "linewidth": 1}
    axis.annotate("", points[-1], points[-2], arrowprops=arrow)
