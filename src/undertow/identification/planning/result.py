"""What a plan says, as it is written to JSON."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict

SCHEMA = "undertow/plan/1"
Goal = Literal["parameters", "separate"]


class Table(BaseModel):
    """A table of the result."""

    model_config = ConfigDict(extra="forbid")


class Command(Table):
    """A command: its limit and where that comes from, its value at rest, and what the plan uses."""

    name: str
    unit: str
    limit: float
    limit_from: str
    trim: float
    lowest: float
    highest: float


class Channel(Table):
    """Noise of a channel that the plan counts with, SI; None for one that is not measured."""

    name: str
    sigma: float | None
    source: str


class Known(Table):
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


class Separation(Table):
    """How far the predictions of two models are apart once each has been refitted to the other.

    `chi_square` is the smaller of the two ways round, in units of the noise; `deviations` its root. Those
    with `_now` are of the logs; None without logs.
    """

    pair: tuple[str, str]
    chi_square: float
    deviations: float
    chi_square_now: float | None
    deviations_now: float | None


class Rival(Table):
    """One of the models to be told apart, and the values that its effects were planned with."""

    name: str
    values: dict[str, float]
    units: dict[str, str]
    source: str


class Plan(Table):
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
    commands: list[Command]
    noise: list[Channel]
    extremes: dict[str, float]
    limits: dict[str, float | None]
    depth_spread: float | None
    parameters: list[Known]
    undetermined: list[list[str]]
    rivals: list[Rival]
    separations: list[Separation]
    logs: list[str]
    remarks: list[str]
