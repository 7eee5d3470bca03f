"""Simulate a vehicle under closed-loop control on its way to a goal.

Model, sensors, control law, schedule, thrust allocation and integrator (fourth-order Runge-Kutta) are
compiled into one call. The controller is sampled every --dt and its commands are held in between; with
--continuous it is not sampled. The output gives settling time (2%), overshoot, final error, control effort,
and sustained oscillations (amplitude and period). Several gain files are compared with each other.

    undertow simulate mini-auv paper-pd paper-pid paper-smc --to -1,1,1 --for 240 --figures figures

    undertow simulate mini-auv paper-pd --to -1,1,1,135deg --current 0.05,0 --noise x=0.01 --out log.csv

    undertow simulate rov.toml gains.toml --plant rov-as-identified.toml --to 5,0,2,0

    undertow simulate remus100 remus100-gains.toml --path remus100-survey.toml

With --path, the vehicle follows a mission: set-points, a spline or a trajectory with feed-forward from the
model, or straight legs or a spline by line of sight (docs/missions.md). The output gives the tracking error.

VEHICLE is both the true vehicle and the controller's model, unless --plant names another true vehicle. A
set-point has x, y, z as far as the vehicle has them, and optionally a heading; without one, the heading is
taken from the direction of the set-point (--heading). Numbers are in SI unless they have a unit: 135deg. The
controller does not know the current, the noise or the disturbances.

With --observer, the controller uses the estimate of a Kalman filter; its sensors have the noise and report at
the times stated in the file (undertow observe --save writes one from a log).

--out writes a log that undertow can read: the sensor readings, and the mean of every command from one row to
the next; --states writes the true pose and velocities at the same rows. A --dt that is too long for the law
is refused, and the limit is stated. The exit code is 1 if a run diverges: the state is not finite, a speed
exceeds 100 m/s or 100 rad/s, or the pose is farther from the start than twice the distance that such speeds
allow. Tables, log and figures end there. A run that has not settled yet has not diverged.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from undertow.errors import UndertowError

from .._options import (
    CurrentOption,
    EffectsOption,
    JsonFileOption,
    VehicleArgument,
    bundled,
    current_of,
    in_si,
    number_or_text,
    quantities,
)
from .._terminal import progress, section, table, write_files

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from undertow.control.closed_loop import LoopResult, Overrides, Push, Record, Scenario
    from undertow.control.closed_loop.measures import CoordinateResult, Cycle
    from undertow.control.closed_loop.record import FollowedError
    from undertow.control.guidance.mission import Mission


_GAINS = typer.Argument(metavar="GAINS", help="Gain files (TOML), or names of bundled ones (paper-pd ...).")
_FOR = typer.Option(
    "--for", metavar="SECONDS", help="Duration of the run.", show_default="240, or that of the mission"
)
_START = typer.Option("--from", metavar="X,Y,Z[,PSI]", help="Initial pose.", show_default="0")
_MOVING = typer.Option(metavar="NAME=VALUE", help="Initial velocity, as u=0.2.")
_WITHOUT = typer.Option(metavar="EFFECT", help="Remove an effect from the vehicle.")
_PLANT = typer.Option(metavar="OTHER.toml", help="True vehicle, if it differs from the controller's model.")
_OBSERVER = typer.Option(metavar="FILE", help="Observer file (TOML); the controller uses its estimate.")
_FILE = "gain file"
_ORDER = typer.Option(
    help="Turn to the heading first, or move in all directions at once.", show_default=_FILE
)
_HEADING = typer.Option(help="Heading for a set-point that states none.", show_default=_FILE)
_GATE = typer.Option(
    metavar="ANGLE", help="Heading error below which control of x and y begins.", show_default=_FILE
)
_INTEGRATORS = typer.Option(help="When the integrators of x and y start.", show_default=_FILE)
_SWAY = typer.Option(help="Add an ideal sway force, or remove the sway force.", show_default=_FILE)
_PUSH = typer.Option(
    metavar="AXIS=VALUE[:FROM:TO]",
    help="Disturbance force (X, Y, Z) or moment (K, M, N), all the time or for an interval.",
)
_NOISE = typer.Option(metavar="NAME=VALUE", help="Standard deviation of a sensor (x=0.01, psi=0.5deg).")
_CONTINUOUS = typer.Option(
    "--continuous", help="Continuous controller: no sampling, Runge-Kutta steps of at most --dt."
)
_LOG = typer.Option(metavar="SECONDS", help="Interval between the rows of --out.", show_default="~5000 rows")
_STATES = typer.Option(metavar="LOG.csv", help="Write the true states, for observe --reference.")
_FIGURES = typer.Option(metavar="FOLDER", help="Write figures (PNG) to this folder.")


@dataclass(frozen=True)
class ScheduleOptions:
    """What is not as the gain file says, and the current."""

    order: Annotated[Literal["together", "yaw-first"] | None, _ORDER] = None
    heading: Annotated[Literal["atan", "atan2"] | None, _HEADING] = None
    gate: Annotated[str | None, _GATE] = None
    integrators: Annotated[Literal["gate", "start"] | None, _INTEGRATORS] = None
    sway: Annotated[Literal["actuated", "unactuated"] | None, _SWAY] = None
    current: CurrentOption = None

    def overrides(self) -> Overrides:
        """The same for a closed loop; a gate without a unit is in rad."""
        from undertow.control.closed_loop import Overrides

        water = None if self.current is None else current_of(self.current)
        gate = None if self.gate is None else f"{in_si('--gate', self.gate, 'rad')!r} rad"
        return Overrides(self.order, self.heading, self.integrators, gate, self.sway, water)


@dataclass(frozen=True)
class ScenarioOptions:
    """What is simulated."""

    to: Annotated[str | None, typer.Option(metavar="X,Y,Z[,PSI]", help="Set-point.")] = None
    path: Annotated[Path | None, typer.Option(metavar="MISSION.toml", help="Follow this mission.")] = None
    duration: Annotated[float | None, _FOR] = None
    dt: Annotated[float, typer.Option(metavar="SECONDS", help="Sampling interval of the controller.")] = 0.001
    start: Annotated[str | None, _START] = None
    moving: Annotated[list[str] | None, _MOVING] = None
    push: Annotated[list[str] | None, _PUSH] = None
    noise: Annotated[list[str] | None, _NOISE] = None
    seed: Annotated[int, typer.Option(help="Seed of the noise.")] = 0
    continuous: Annotated[bool, _CONTINUOUS] = False
    log: Annotated[float | None, _LOG] = None

    def mission(self) -> Mission | None:
        """What is followed, if it is a mission."""
        from undertow.control.guidance.mission import load_mission

        if (self.to is None) == (self.path is None):
            raise UndertowError("give either a set-point, --to X,Y,Z, or a mission, --path MISSION.toml")
        return load_mission(self.path) if self.path else None

    def scenario(self, lasts: float = 240.0) -> Scenario:
        """The same for a closed loop; what cannot be read, or cannot be, is refused."""
        from undertow.control.closed_loop import Scenario
        from undertow.model.symbols import MOTION_UNITS

        return Scenario(
            _values(self.to, "--to") if self.to else (),
            lasts if self.duration is None else self.duration,
            self.dt,
            _values(self.start, "--from") if self.start else (),
            quantities("--moving", self.moving or (), MOTION_UNITS),
            self.continuous,
            quantities("--noise", self.noise or (), MOTION_UNITS, example="x=0.01"),
            self.seed,
            tuple(_push(text) for text in self.push or ()),
            self.log,
        )


@bundled
@bundled
def simulate(
    vehicle: VehicleArgument,
    gains: Annotated[list[str], _GAINS],
    scenario_options: ScenarioOptions,
    schedule: ScheduleOptions,
    without: Annotated[list[str] | None, _WITHOUT] = None,
    plant: Annotated[str | None, _PLANT] = None,
    observer: Annotated[Path | None, _OBSERVER] = None,
    out: Annotated[Path | None, typer.Option(metavar="LOG.csv", help="Write the run as a log.")] = None,
    states: Annotated[Path | None, _STATES] = None,
    figures: Annotated[Path | None, _FIGURES] = None,
    json: JsonFileOption = None,
    effects: EffectsOption = None,
) -> int:
    from undertow.control.closed_loop.simulate import simulate_each
    from undertow.control.closed_loop.simulate import without_effects as left_out
    from undertow.files import check_folder, check_writable
    from undertow.model.loading import load_vehicle

    for option, path in (("--out", out), ("--states", states)):
        if path is not None and len(gains) > 1:
            raise UndertowError(
                f"{option} {path} holds one run, but there are {len(gains)} gain files: give only one"
            )
    more = [str(p) for p in (plant, scenario_options.path, observer) if p]
    check_writable(out, states, json, inputs=[vehicle, *gains, *more, *(effects or [])])
    if figures is not None:
        check_folder(figures)
    mission, overrides = scenario_options.mission(), schedule.overrides()
    if mission is None:
        scenario = scenario_options.scenario()
    known = left_out(load_vehicle(vehicle, effect_files=effects or []), without or [])
    if mission is None:
        _remark_turns("--to", scenario.pose(scenario.to, known.pose_names, "set-point"), scenario.to)
    else:
        scenario = scenario_options.scenario(mission.simulation_time(known.pose_names))
    moving = load_vehicle(plant, effect_files=effects or []) if plant else None
    with progress("simulating", total=len(gains) * scenario.duration) as report:
        records = simulate_each(
            known,
            gains,
            scenario,
            overrides,
            plant=moving,
            mission=mission,
            observer=observer,
            progress=report,
        )
    show([record.result for record in records])
    _write(records, out, states, figures, json)
    return int(any(record.result.diverged is not None for record in records))


_MUCH = 1e5  # of an overshoot in %: more has no decimals
_OF_COMMANDS = ("command", "effort", "rms", "peak", "changes per s", "at limit")


def _values(text: str, option: str) -> tuple[str | float, ...]:
    parts = [part.strip() for part in text.split(",")]
    if not all(parts):
        raise UndertowError(f"{option} {text} has an empty value: write numbers separated by commas")
    return tuple(number_or_text(part) for part in parts)


def _push(text: str) -> Push:
    from undertow.control.closed_loop import Push
    from undertow.control.closed_loop.scenario import force_unit

    axis, _, rest = text.partition("=")
    value, *times = rest.split(":")
    if axis not in tuple("XYZKMN") or len(times) not in (0, 2):
        raise UndertowError(
            f"--push {text} is not AXIS=VALUE or AXIS=VALUE:FROM:TO: write it like X=0.5:60:90"
        )
    begin, end = (in_si(f"--push {text}", t, "s") for t in times) if times else (0.0, math.inf)
    return Push(axis, in_si(f"--push {text}", value, force_unit(axis)), begin, end)


def _remark_turns(option: str, pose: dict[str, float], stated: Sequence[str | float]) -> None:
    """Ask whether degrees were meant, where a heading without a unit is more than a turn."""
    psi = pose.get("psi", 0.0)
    if abs(psi) > 2 * math.pi and not isinstance(dict(zip(pose, stated, strict=True))["psi"], str):
        remark = f"{option}: the heading {psi:g} is in radians, {psi / (2 * math.pi):.1f} turns"
        typer.echo(f"{remark}; write {psi:g}deg if degrees are meant", err=True)


def _write(
    records: Sequence[Record], out: Path | None, states: Path | None, figures: Path | None, json: Path | None
) -> None:
    """Write the log, the true states, the result and the pictures that are asked for."""

    def draw(_: Path) -> dict[str, Figure]:
        from undertow.control.closed_loop.pictures import pictures

        return pictures(records)

    write_files(
        (out, lambda _: records[0].to_csv()),
        (states, lambda _: records[0].states_to_csv()),
        (json, lambda _: "[\n" + ",\n".join(record.to_json().rstrip() for record in records) + "\n]\n"),
        (figures, draw),
        silent=True,
    )


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
        if result.followed is None:
            section("  Coordinates", table(head, [_coordinate(c) for c in result.coordinates], 4))
        else:
            rows = [_followed(e) for e in result.followed.errors]
            section("  Mission", table(("error", "rms", "largest", "at the end"), rows, 4))
        section("  Commands", table(_OF_COMMANDS, [_command(c) for c in result.commands], 4))


def _facts(result: LoopResult) -> Iterator[str]:
    how = "law not sampled, steps of at most" if result.law_is == "continuous" else "controller sampled every"
    yield f"{result.duration:g} s, {how} {result.dt:g} s"
    if result.gate_passed is not None:
        yield f"heading within the gate after {result.gate_passed:.3f} s, then x and y"
    if result.followed is not None:
        arrived = result.followed.arrived
        end = "not reached"
        if arrived is not None:
            end = f"reached after {arrived:.4g} s"
            by_sight = any(e.name == "cross track" for e in result.followed.errors)
            if by_sight and arrived == 0.0:
                end = "reached at the start: the way is shorter than [guidance] acceptance"
            elif by_sight and math.ceil(arrived) < result.duration:
                end += f", but not held: --for {math.ceil(arrived)} leaves out what comes after"
        yield f"mission '{result.followed.mission}' ({result.followed.kind}): its end is {end}"
    if result.divergence is not None:
        yield f"DIVERGED: {result.divergence.text}; the numbers are up to that time"
    if result.turned_thrusters:
        names = ", ".join(result.turned_thrusters)
        yield (
            f"REMARK: these push in a direction more than 45 deg from that in the controller's model: {names}"
        )
    for c in () if result.followed else result.coordinates:
        if c.turns:
            yield f"{c.name}: errors are from the set-point {_turns(c.turns)}, the nearest one at the end"
    left = {c.name: c for c in result.coordinates if c.sampling_offset}
    if left:
        sizes = ", ".join(f"{c.sampling_offset:.3g} {c.unit} in {name}" for name, c in left.items())
        yield f"the sampled sign of the law may leave an error of up to {sizes} (an estimate)"


def _followed(e: FollowedError) -> tuple[str, ...]:
    return (e.name, *(f"{v:.3g} {e.unit}" for v in (e.rms, e.largest, e.final)))


def _turns(count: int) -> str:
    return f"{abs(count)} whole turn{'s' if abs(count) > 1 else ''} {'on' if count > 0 else 'back'}"


def _coordinate(c: CoordinateResult) -> tuple[str, ...]:
    settled = (
        "not settled" if c.settling is None and c.move else "" if c.settling is None else f"{c.settling:.2f}"
    )
    overshoot = "" if c.overshoot is None else f"{c.overshoot:{'.2f' if c.overshoot < _MUCH else '.3g'}}%"
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
    return (c.name, *numbers, f"{100 * c.at_limit:.2g}%" if c.at_limit else "")
