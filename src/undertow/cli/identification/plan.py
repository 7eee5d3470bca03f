"""Plan the manoeuvre that best determines poorly known parameters, or best tells rival effects apart.

Manoeuvres of many kinds (steps, doublets, multisines, random steps, chirps, reversals, coast-downs, sweeps,
circles, zigzags; of all motions together, in turn, or actuator by actuator) are simulated with the model and
ranked by the information that their log would add to the vehicle file and existing logs. Every command stays
within its limit, the predicted motion within --max-..., and the ends are smooth.

    undertow plan rov.toml run1.csv --duration 90 --out plan.csv --picture plan.png

    undertow plan rov.toml run1.csv --goal separate --between ocean_current,constant_force --out plan.csv

    undertow diagnose rov.toml run1.csv --json found.json

    undertow plan rov.toml run1.csv --goal separate --diagnosis found.json --out plan.csv

The goal "parameters" minimises the volume of the confidence region of the parameters marked estimate = true
(D-optimal). The goal "separate" maximises the difference between the predictions of rival models after each
has been refitted to the other (T-optimal); their values come from a fit to the logs, from the diagnosis, or
are of a typical size. Both plans are optimal for the present values: fit to the new log, and plan again.

The CSV has a column t in s and one for each command, named as in the vehicle file, in the unit of the command
(N for a thruster unless its thrust_per_command says otherwise; N or N m for a known force). Run it open loop
from rest, or from the speed of --speed; each row is held until the next. The same --seed gives the same plan.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import degrees, exp, inf, log, radians
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from undertow.errors import UndertowError

from .._options import JsonFileOption, VehicleArgument, bundled, names_and_values, words
from .._terminal import console, progress, say, section, table, text, write_files
from ._logs import LogOptions, ordered_logs, say_long

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from undertow.identification.planning.problem import Plan, PlannedParameter
    from undertow.identification.planning.search import Planned


_LOGS = typer.Argument(metavar="LOG", help="Existing logs: CSV, CSV.gz or Parquet.", callback=ordered_logs)
_GOAL = typer.Option(help="Goal: determine parameters, or tell models apart.")
_BETWEEN = typer.Option(
    metavar="ID,ID[,ID]", help='Effects to tell apart; "none" is the model as it is, a+b has both.'
)
_DIAGNOSIS = typer.Option(metavar="FILE.json", help="Take the effects to tell apart from a diagnosis.")
_ONLY = typer.Option(metavar="NAME,NAME", help="Parameters to determine; all by default.")
_LIMIT = typer.Option(
    metavar="VALUE|NAME=VALUE",
    help="Largest command: VALUE for all, or NAME=VALUE; LOWEST:HIGHEST if the limits are asymmetric.",
    show_default="as in the vehicle file, or the largest in the logs",
)
_NOISE = typer.Option(
    metavar="NAME=VALUE",
    help="Noise of a channel (SI); none if it is not measured.",
    show_default="as in the logs, or 0.02 m, 0.01 rad, 0.01 m/s, 0.005 rad/s",
)
_DURATION = typer.Option(metavar="SECONDS", help="Duration.", show_default="that of the logs, or 60")
_RATE = typer.Option(
    metavar="HZ", help="Samples per second.", show_default="those of the logs, at most 20, or 20"
)
_SPEED = typer.Option(
    metavar="M/S",
    help="Speed ahead at the start; rudders and fins do nothing at rest.",
    show_default="that at which the logs begin, or 0",
)
_DEPTH = typer.Option(metavar="M", help="Depth at the start.", show_default="median of the logs, or 0")
_TRIES = typer.Option(
    help="Number of manoeuvres to try, at least one of each kind.",
    min=1,
    max=100_000,
    show_default="as many as take about ten seconds",
)


@dataclass(frozen=True)
class MotionOptions:
    """How large the predicted motion may be."""

    max_speed: Annotated[float | None, typer.Option(metavar="M/S", help="Largest speed.")] = None
    max_rate: Annotated[float, typer.Option(metavar="DEG/S", help="Largest angular rate.")] = 60.0
    max_depth_change: Annotated[float, typer.Option(metavar="M", help="Largest change of depth.")] = 5.0
    max_tilt: Annotated[float, typer.Option(metavar="DEG", help="Largest roll and pitch.")] = 45.0
    max_distance: Annotated[
        float | None, typer.Option(metavar="M", help="Largest horizontal distance from the start.")
    ] = None

    @property
    def limits(self) -> dict[str, float]:
        """Limits by what they limit, SI; one that leaves no motion is refused."""
        largest = {
            name.removeprefix("max_"): value for name, value in vars(self).items() if value is not None
        }
        for name, value in largest.items():
            if not value > 0:
                option = f"--max-{name.replace('_', '-')}"
                raise UndertowError(f"{option} {value:g} leaves no motion: give a positive value")
        largest["depth"] = largest.pop("depth_change")
        return {name: radians(v) if name in _ANGULAR else v for name, v in largest.items()}


@bundled
@bundled
def plan(
    vehicle: VehicleArgument,
    motion: MotionOptions,
    options: LogOptions,
    logs: Annotated[list[Path] | None, _LOGS] = None,
    goal: Annotated[Literal["parameters", "separate"] | None, _GOAL] = None,
    between: Annotated[list[str] | None, _BETWEEN] = None,
    diagnosis: Annotated[Path | None, _DIAGNOSIS] = None,
    only: Annotated[list[str] | None, _ONLY] = None,
    duration: Annotated[float | None, _DURATION] = None,
    rate: Annotated[float | None, _RATE] = None,
    limit: Annotated[list[str] | None, _LIMIT] = None,
    depth: Annotated[float | None, _DEPTH] = None,
    speed: Annotated[float | None, _SPEED] = None,
    noise: Annotated[list[str] | None, _NOISE] = None,
    seed: Annotated[int, typer.Option(help="Seed of the random search.", min=0)] = 0,
    tries: Annotated[int | None, _TRIES] = None,
    out: Annotated[Path | None, typer.Option(metavar="OUT.csv", help="Write the commands.")] = None,
    picture: Annotated[
        Path | None, typer.Option(metavar="OUT.png", help="Draw commands, motions and errors.")
    ] = None,
    json: JsonFileOption = None,
) -> None:
    from undertow.files import check_writable
    from undertow.identification.api import plan as planned_for
    from undertow.identification.long_logs.choosing import LOOK
    from undertow.identification.planning.manoeuvres import MotionLimits
    from undertow.identification.planning.problem import PlanRequest

    logs = logs or []
    check_writable(out, picture, json, inputs=[vehicle, *logs, *options.files, *filter(None, [diagnosis])])
    _check_goal(goal, words(between or []), diagnosis, words(only or []))
    limits = motion.limits
    largest = {n: _limit(value) for n, value in _named("--limit", limit or [], whole=True).items()}
    sigma = {n: _number("--noise", value) for n, value in _named("--noise", noise or [], whole=False).items()}
    loaded = options.load(vehicle, logs, to_fit=bool(logs), budget=LOOK if logs else None)
    model, runs = loaded.vehicle, loaded.runs
    with progress("planning") as report:
        done = planned_for(
            model,
            runs,
            PlanRequest(
                duration=duration,
                rate=rate,
                motion=MotionLimits(**limits),
                depth=depth,
                speed=speed,
                seed=seed,
                tries=tries,
                report=report,
                limits=largest,
                noise=sigma,
            ),
            only=words(only or []),
            between=words(between or []),
            diagnosis=diagnosis,
            known=options.known,
            trust_log=options.trust_log,
        )
    show(done)
    long = loaded.checked()
    say_long(long)
    plan = done.plan.model_copy(update={"long_logs": long})

    def draw(_: Path) -> Figure:
        from undertow.identification.planning.picture import plan_picture

        return plan_picture(done)

    def commands(_: Path) -> str:
        from undertow.identification.planning.picture import command_csv

        return command_csv(done)

    write_files((out, commands), (picture, draw), (json, plan.to_json()))
    if out is None:
        console().print(text("the commands were not written: --out OUT.csv writes them"))


_ANGULAR = ("rate", "tilt")
_FAMILIES = 2
_UNITS = {"speed": "m/s", "distance": "m", "rate": "deg/s", "tilt": "deg", "depth": "m"}


def _check_goal(
    goal: str | None, between: Sequence[str], diagnosis: Path | None, only: Sequence[str]
) -> None:
    """Refuse options that contradict each other, or leave open which models are to be told apart."""
    given = [n for n, v in (("--between", between), ("--diagnosis", diagnosis)) if v]
    if len(given) == 2:
        raise UndertowError("both --between and --diagnosis name the effects to tell apart: give only one")
    if goal == "parameters" and given:
        raise UndertowError(f"{given[0]} is for --goal separate: leave one of the two out")
    if goal == "separate" and not given:
        raise UndertowError("--goal separate needs the effects: give --between ID,ID or --diagnosis FILE")
    if given and only:
        raise UndertowError(f"--only is for --goal parameters: leave it or {given[0]} out")


def _named(option: str, texts: Sequence[str], *, whole: bool) -> dict[str, str]:
    """``NAME=VALUE``, or ``VALUE`` alone (named "") where `whole` allows it."""
    listed = words(texts)
    alone = [word for word in listed if whole and "=" not in word]
    named = names_and_values(option, [word for word in listed if word not in alone], "u=0.01")
    return dict([*(("", word) for word in alone), *named])


def _limit(word: str) -> float | tuple[float, float]:
    """The largest magnitude of a command, or its lowest and its highest value."""
    low, between, high = word.partition(":")
    least = _number("--limit", low)
    return (least, _number("--limit", high)) if between else least


def _number(option: str, word: str) -> float:
    if option == "--noise" and word.strip().lower() == "none":
        return inf
    try:
        value = float(word)
    except ValueError:
        value = float("nan")
    if value != value:
        raise UndertowError(f"{option}: '{word}' is not a number")
    return value


def show(done: Planned) -> None:
    """Print the manoeuvre, what it would bring, and what to mind."""
    plan = done.plan
    begins = f", from {plan.speed:.3g} m/s ahead" if plan.speed else ""
    what = f"{plan.vehicle}: {plan.manoeuvre}, {plan.duration:g} s at {plan.rate:g} Hz{begins}"
    console().print(text(what, "bold"))
    say(f"  best of {plan.tries} manoeuvres (seed {plan.seed}); {_best(plan)}")
    predicted = (_extreme(plan, what, value) for what, value in plan.extremes.items())
    say(f"  predicted: {', '.join(predicted)}")
    say(f"  noise: {_noise(plan)}")
    section("Commands", _commands(plan))
    if plan.parameters:
        section("Standard errors, expected if the model is right", _errors(plan))
    else:
        section("Models and their values", _rivals(plan))
        section("Distance of their predictions after refitting, standard deviations", _distances(plan))
    for line in [*_undetermined(plan), *plan.remarks]:
        say(f"  {line}", "yellow")


def _best(plan: Plan) -> str:
    """What the manoeuvre brings on average, and how far behind other kinds are."""
    value = plan.families[plan.manoeuvre] or plan.criterion
    behind = sorted((value / v, n) for n, v in plan.families.items() if v and n != plan.manoeuvre)
    ratio = "errors {:.2g} times as large" if plan.goal == "parameters" else "{:.2g} times less"
    others = "; ".join(f"{n} {ratio.format(r)}" for r, n in behind[:_FAMILIES])
    return _gain(plan, value) + (f" (next: {others})" if others else "")


def _gain(plan: Plan, value: float) -> str:
    if plan.goal == "separate":
        return f"{value:.3g} standard deviations between the models on average"
    shares = [p.error_after / abs(p.value) for p in plan.parameters if p.error_after and p.value]
    if not shares:
        return f"standard errors fall by a factor of {value:.3g}"
    mean = f"standard errors {100 * exp(sum(map(log, shares)) / len(shares)):.2g}% of the values on average"
    known = all(p.error_now is not None for p in plan.parameters)
    return f"{mean}, {value:.3g} times smaller than now" if known else mean


def _extreme(plan: Plan, what: str, value: float) -> str:
    name = {"depth": "change of depth", "distance": "distance", "rate": "angular rate"}.get(what, what)
    factor = degrees(1.0) if what in _ANGULAR else 1.0
    bound = plan.limits[what]
    limit = "" if bound is None else f" of {factor * bound:.3g}"
    return f"{name} {factor * value:.3g}{limit} {_UNITS[what]}"


def _noise(plan: Plan) -> str:
    from undertow.identification.logs.run import UNITS

    measured = [c for c in plan.noise if c.sigma is not None]
    sources = list(dict.fromkeys(c.source for c in measured))
    parts = [
        ", ".join(f"{c.name} {c.sigma:.2g} {UNITS[c.name]}" for c in measured if c.source == source)
        + f" ({source})"
        for source in sources
    ]
    missing = [c.name for c in plan.noise if c.sigma is None]
    return "; ".join([*parts, *([f"not measured: {', '.join(missing)}"] if missing else [])])


def _commands(plan: Plan) -> object:
    from undertow.identification.planning.manoeuvres import limit_text

    rows = [
        (
            c.name,
            f"{c.trim:.3g}",
            f"{c.lowest:.3g}",
            f"{c.highest:.3g}",
            limit_text((c.least, c.limit)),
            c.unit,
            c.limit_from,
        )
        for c in plan.commands
    ]
    return table(("command", "at the start", "lowest", "highest", "limit", "", ""), rows)


def _errors(plan: Plan) -> object:
    from undertow.figures import unit_text

    rows = [
        (
            p.name,
            f"{p.value:.4g}",
            _error(p.error_now),
            _error(p.error_after),
            _share(p),
            unit_text(p.unit),
            p.verdict,
        )
        for p in plan.parameters
    ]
    return table(("parameter", "value", "now", "after", "", "", ""), rows)


def _error(error: float | None) -> str:
    return "not known" if error is None else f"± {error:.2g}"


def _share(known: PlannedParameter) -> str:
    """Expected error as a share of the value."""
    if known.error_after is None or not known.value:
        return ""
    share = 100 * known.error_after / abs(known.value)
    return f"{share:.2g}%" if share < 99 else f"{share:.0f}%"


def _rivals(plan: Plan) -> object:
    rows = [
        (r.name, ", ".join(f"{n} = {v:.3g} {r.units[n]}".rstrip() for n, v in r.values.items()), r.source)
        for r in plan.rivals
    ]
    return table(("model", "values", ""), rows)


def _distances(plan: Plan) -> object:
    rows = [
        (
            " / ".join(p.pair),
            "no logs" if p.deviations_now is None else f"{p.deviations_now:.3g}",
            f"{p.deviations:.3g}",
        )
        for p in plan.separations
    ]
    return table(("models", "now", "after"), rows)


def _undetermined(plan: Plan) -> list[str]:
    return [
        f"{group[0]}: no manoeuvre that was tried determines it, because nothing measured depends on it"
        if len(group) == 1
        else f"only a combination of {', '.join(group)} is determined by any manoeuvre that was tried"
        for group in plan.undetermined
    ]
