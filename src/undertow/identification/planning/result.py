"""What a plan says, as it is written to JSON."""

from __future__ import annotations

from typing import Literal

import numpy as np

from undertow.files import json_ready
from undertow.identification.long_logs.result import LongLogs, ResultTable
from undertow.model.parameter import printed
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .manoeuvres import extremes
from .problem import Knowledge, Manoeuvre, PlanningProblem

SCHEMA = "undertow/plan/1"
Goal = Literal["parameters", "separate"]


class PlannedCommand(ResultTable):
    """A command: its limit and where that comes from, its value at rest, and what the plan uses."""

    name: str
    unit: str
    limit: float
    limit_from: str
    trim: float
    lowest: float
    highest: float


class PlannedNoise(ResultTable):
    """Noise of a channel that the plan counts with, SI; None for one that is not measured."""

    name: str
    sigma: float | None
    source: str


class PlannedParameter(ResultTable):
    """A parameter, in the sign convention of the vehicle file, and how well it is known.

    Standard errors are None where nothing determines the parameter.
    """

    name: str
    unit: str
    about: str
    value: float
    error_now: float | None
    error_after: float | None
    verdict: Literal["", "badly known", "not determined"]


class Separation(ResultTable):
    """How far the predictions of two models are apart once each has been refitted to the other.

    `chi_square` is the smaller of the two ways round, in units of the noise; `deviations` its root. Those
    with `_now` are of the logs; None without logs.
    """

    pair: tuple[str, str]
    chi_square: float
    deviations: float
    chi_square_now: float | None
    deviations_now: float | None


class Rival(ResultTable):
    """One of the models to be told apart, and the values that its effects were planned with."""

    name: str
    values: dict[str, float]
    units: dict[str, str]
    source: str


class Plan(ResultTable):
    """Outcome of `undertow plan`.

    `families` has the value of the criterion for the best manoeuvre of every kind, None where no manoeuvre of
    it was within the limits. The criterion of the goal "parameters" is the mean factor by which standard
    errors fall (geometric mean); of "separate", the standard deviations between the two models that are
    hardest to tell apart.
    """

    schema_id: str = SCHEMA
    undertow: str
    vehicle: str
    signs: str
    goal: Goal
    seed: int
    tries: int
    duration: float
    rate: float
    manoeuvre: str
    criterion: float
    families: dict[str, float | None]
    commands: list[PlannedCommand]
    noise: list[PlannedNoise]
    extremes: dict[str, float]
    limits: dict[str, float | None]
    depth_spread: float | None
    parameters: list[PlannedParameter]
    undetermined: list[list[str]]
    rivals: list[Rival]
    separations: list[Separation]
    logs: list[str]
    remarks: list[str]
    # How logs were thinned that are longer than this takes, and which stretches were used; null of others.
    long_logs: LongLogs | None = None


# A standard error above this share of the value is nothing to build on.
_BADLY = 0.3
# A manoeuvre that brings an error below this share of what it was does determine the parameter.
_DETERMINED = 0.3


def commands_of(problem: PlanningProblem, manoeuvre: Manoeuvre) -> list[PlannedCommand]:
    """Every command with its limit and what the manoeuvre makes of it."""
    return [
        PlannedCommand(
            name=name,
            unit=problem.vehicle.input_units[name],
            limit=float(problem.limits.value[i]),
            limit_from=problem.limits.source[i],
            trim=float(problem.trim.commands[i]),
            lowest=float(manoeuvre.u[:, i].min()),
            highest=float(manoeuvre.u[:, i].max()),
        )
        for i, name in enumerate(problem.vehicle.command_names)
    ]


def noise_of(problem: PlanningProblem) -> list[PlannedNoise]:
    """Noise of every channel that the plan counts with."""
    n = problem.noise
    return [
        PlannedNoise(name=name, sigma=json_ready(s), source=source)
        for name, s, source in zip(n.names, n.sigma, n.source, strict=True)
    ]


def extremes_of(problem: PlanningProblem, manoeuvre: Manoeuvre) -> dict[str, float]:
    """Largest motions by any of the models, SI."""
    found = [extremes(y, problem.names) for y in manoeuvre.y]
    return {what: max(one[what] for one in found) for what in found[0]}


def parameters_of(
    known: Knowledge, signs: str, after: Array, undetermined: list[list[str]]
) -> list[PlannedParameter]:
    """Every free parameter with its standard errors before and after."""
    now, then = known.errors(known.now), known.errors(after)
    lost = {name for group in undetermined for name in group}
    return [
        _planned(known.vehicle, signs, name, float(now[i]), float(then[i]), name in lost)
        for i, name in enumerate(known.free)
    ]


def _planned(
    vehicle: Vehicle, signs: str, name: str, now: float, then: float, lost: bool
) -> PlannedParameter:
    parameter, value = vehicle.declaration(name), vehicle.value_of(name).value
    # A prior that is all there is does not become knowledge of the manoeuvre.
    silent = lost and not then < _DETERMINED * now
    verdict = "not determined" if silent else "badly known" if not then < _BADLY * abs(value) else ""
    return PlannedParameter(
        name=name,
        unit="" if parameter.unit == "1" else parameter.unit,
        about=parameter.about,
        value=printed(parameter, value, signs),
        error_now=json_ready(now),
        error_after=json_ready(then),
        verdict=verdict,  # type: ignore[arg-type]
    )


def safety_remarks(problem: PlanningProblem, manoeuvre: Manoeuvre, spread: float | None) -> list[str]:
    """What to mind before the manoeuvre is carried out."""
    lines = [
        f"the actuators cannot balance {value:.3g} {'N' if dof == 'heave' else 'N m'} in {dof} at rest: the "
        "vehicle does not hold its depth and attitude"
        for dof, value in problem.trim.left.items()
    ]
    rise = _rise(problem, manoeuvre)
    if rise > problem.depth:
        lines.append(f"the vehicle rises up to {rise:.2g} m above its start: begin deeper than that")
    depth = extremes_of(problem, manoeuvre).get("depth", 0.0)
    if spread is not None and depth + spread > problem.motion.depth:
        lines.append(
            f"in open loop, the depth may differ by {spread:.2g} m from the prediction by the end, given "
            "what is known now: hold it by hand or with a controller, and log the commands"
        )
    return lines


def _rise(problem: PlanningProblem, manoeuvre: Manoeuvre) -> float:
    if "z" not in problem.names:
        return 0.0
    column = problem.names.index("z")
    return max(float(np.max(y[0, column] - y[:, column])) for y in manoeuvre.y)
