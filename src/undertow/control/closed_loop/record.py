"""The rows of a run that are kept, its log, and its result."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from undertow.control.guidance.mission import Mission
from undertow.control.guidance.reference import Followed
from undertow.files import json_ready
from undertow.model.symbols import MOTION_UNITS

from .measures import SETTINGS, CommandResult, CoordinateResult, Cycle, Divergence, Measures, find_cycle

if TYPE_CHECKING:
    from .interconnection import Interconnection
    from .scenario import Scenario
    from .stepping import Rows


@dataclass(frozen=True)
class FollowedResult:
    """How well a mission was followed, up to its end; errors are desired less true."""

    # mission, kind: its name and kind
    mission: str
    kind: str
    arrived: float | None  # when its end was reached, s; None if the run ended before
    errors: tuple[FollowedError, ...]  # by coordinate, or cross track and depth for legs


@dataclass(frozen=True)
class FollowedError:
    """One error along a mission, over the recorded rows: root of the mean square, largest, and the last."""

    name: str
    unit: str
    rms: float
    largest: float
    final: float


@dataclass(frozen=True)
class LoopResult:
    """The result of a run."""

    # controller, law, vehicle: name and law of the gain set, and name of the vehicle that moved
    controller: str
    law: str
    vehicle: str
    # duration, dt: length of the run and sampling interval, s
    duration: float
    dt: float
    law_is: str  # "sampled" or "continuous"
    # start, to: first and desired pose, m and rad
    start: Mapping[str, float]
    to: Mapping[str, float]
    # when the heading came within the gate, s; None if it did not, or there is no gate
    gate_passed: float | None
    # When the state left what a vehicle in water can have, s: not finite, or `implausible`. The
    # measures are of the run up to there.
    diverged: float | None
    divergence: Divergence | None  # what diverged, with the numbers
    coordinates: tuple[CoordinateResult, ...]  # one for each pose coordinate, and along and across the track
    commands: tuple[CommandResult, ...]  # one for each command
    # those that push elsewhere, by more than 45 degrees, than the controller takes them to
    turned_thrusters: tuple[str, ...]
    # how well a mission was followed; the coordinates are then measured from its end
    followed: FollowedResult | None = None

    def of(self, name: str) -> CoordinateResult:
        """The measures of one coordinate."""
        return next(c for c in self.coordinates if c.name == name)


@dataclass(frozen=True)
class CommandRange:
    """Variation of a command within each row interval, which its mean does not show; shape (n,) each."""

    low: np.ndarray
    high: np.ndarray
    travel: np.ndarray  # sum of the magnitudes of its changes from sample to sample


@dataclass(frozen=True)
class Record:
    """A run.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Times of the rows, s.
    state : mapping
        True pose and velocity, by name.
    reported : mapping
        What the sensors report, noise included, by name.
    commands : mapping
        Mean of each command from its row to the next, so that the impulse is the true one.
    force : mapping
        Force that the law asks for, body frame, by degree of freedom.
    errors : mapping
        Desired less true pose, and along and across the track, by name.
    result : LoopResult
        The measures.
    estimated : mapping
        What an observer predicts for the next sample, by state; empty without one.
    followed : Followed, optional
        The mission beside the run: what was desired, and the errors.
    command_ranges : mapping
        What each command does from its row to the next, by name.
    """

    t: np.ndarray
    state: Mapping[str, np.ndarray]
    reported: Mapping[str, np.ndarray]
    commands: Mapping[str, np.ndarray]
    force: Mapping[str, np.ndarray]
    errors: Mapping[str, np.ndarray]
    result: LoopResult
    estimated: Mapping[str, np.ndarray] = field(default_factory=dict)
    followed: Followed | None = None
    command_ranges: Mapping[str, CommandRange] = field(default_factory=dict)

    def to_csv(self) -> str:
        """A log as undertow reads it: t, what the sensors report, and the commands."""
        return _csv({"t": self.t, **self.reported, **self.commands})

    def states_to_csv(self) -> str:
        """The true pose and velocity at the same rows, as a log."""
        return _csv({"t": self.t, **self.state})

    def to_json(self) -> str:
        """The result as JSON; infinite numbers are null."""
        return json.dumps(json_ready(asdict(self.result)), indent=2, allow_nan=False) + "\n"


def _csv(columns: Mapping[str, np.ndarray]) -> str:
    stream = io.StringIO()
    rows, header = np.column_stack(list(columns.values())), ",".join(columns)
    np.savetxt(stream, rows, fmt="%.12g", delimiter=",", header=header, comments="")
    return stream.getvalue()


class Recorder:
    """Keeps every n-th row of a run, with mean and swing of the commands up to the next."""

    def __init__(self, parts: Interconnection, scenario: Scenario, mission: Mission | None = None) -> None:
        self._parts, self._scenario, self._stride = parts, scenario, scenario.stride
        self._mission = mission
        rows = -(-scenario.samples // self._stride)
        self._sums = np.zeros((rows, parts.functions.u.numel()))
        self._counts = np.zeros(rows)
        self._low, self._high = np.full_like(self._sums, np.inf), np.full_like(self._sums, -np.inf)
        self._travel = np.zeros_like(self._sums)
        self._last: np.ndarray | None = None
        self._kept: list[tuple[np.ndarray, ...]] = []

    def add(self, begin: int, rows: Rows) -> None:
        """Take in the rows of the samples from `begin` on."""
        if not len(rows.x):
            return
        samples = begin + np.arange(len(rows.x))
        every = np.flatnonzero(samples % self._stride == 0)
        self._kept.append((samples[every], *(part[every] for part in (rows.x, rows.y, rows.tau, rows.s))))
        bins = samples // self._stride
        starts = np.flatnonzero(np.diff(bins, prepend=-1))
        into = bins[starts]
        self._sums[into] += np.add.reduceat(rows.u, starts)
        self._counts[into] += np.diff(starts, append=len(samples))
        self._low[into] = np.minimum(self._low[into], np.minimum.reduceat(rows.u, starts))
        self._high[into] = np.maximum(self._high[into], np.maximum.reduceat(rows.u, starts))
        before = rows.u[:1] if self._last is None else self._last
        self._travel[into] += np.add.reduceat(np.abs(np.diff(rows.u, axis=0, prepend=before)), starts)
        self._last = rows.u[-1:]

    def record(self, start: Mapping[str, float], to: Mapping[str, float], measures: Measures) -> Record:
        """The rows and the result."""
        samples, x, y, tau, s = (np.concatenate(part) for part in zip(*self._kept, strict=True))
        t, parts = samples * self._scenario.dt, self._parts
        vehicle, known = parts.vehicle, self._parts.controller.gains.plant.vehicle
        means = (self._sums / np.maximum(self._counts, 1)[:, None])[samples // self._stride]
        if len(means) > 1 and self._counts[samples[-1] // self._stride] < self._stride:
            means[-1] = means[-2]  # of its interval there is a part only, one sample as a rule
        command_ranges = (self._low, self._high, self._travel)
        named = list(zip(parts.controller.command_names, parts.commanded, strict=True))
        errors = measures.errors(x)
        state = dict(zip((*vehicle.pose_names, *vehicle.velocity_names), x.T, strict=False))
        followed = self._followed(t, state, s)
        result = self._result(start, to, measures, {n: _cycle(t, e) for n, e in errors.items()})
        return Record(
            t,
            state,
            dict(zip(parts.reported_names, y.T, strict=True)),
            {n: means[:, i] for n, i in named},
            dict(zip(known.degrees_of_freedom, tau.T, strict=True)),
            errors,
            replace(result, followed=_mission_result(self._mission, t, followed)) if followed else result,
            parts.estimates(s),
            followed,
            {
                n: CommandRange(*(part[samples // self._stride, i] for part in command_ranges))
                for n, i in named
            },
        )

    def _followed(self, t: np.ndarray, state: dict[str, np.ndarray], s: np.ndarray) -> Followed | None:
        reference = self._parts.controller.reference
        if reference is None:
            return None
        before = self._parts.observer.size if self._parts.observer else 0  # its states stand first
        own = [before + self._parts.controller.state_names.index(n) for n in reference.state_names]
        return reference.followed(t, state, s[:, own])

    def _result(
        self,
        start: Mapping[str, float],
        to: Mapping[str, float],
        measures: Measures,
        cycles: Mapping[str, Cycle | None],
    ) -> LoopResult:
        gains, scenario = self._parts.controller.gains, self._scenario
        return LoopResult(
            gains.name,
            gains.law.id,
            self._parts.vehicle.name,
            scenario.duration,
            scenario.dt,
            "continuous" if scenario.continuous else "sampled",
            dict(start),
            measures.goal if to else {},
            measures.gate if gains.schedule.order == "yaw-first" else None,
            None if measures.diverged is None else measures.diverged.time,
            measures.diverged,
            measures.coordinates(cycles),
            measures.commands(),
            self._parts.turned_thrusters,
        )


def _mission_result(mission: Mission | None, t: np.ndarray, followed: Followed) -> FollowedResult:
    """The measures of a mission, up to its end."""
    assert mission is not None
    done = np.flatnonzero(followed.arrived)
    until = int(done[0]) + 1 if done.size else len(t)
    errors = []
    for name, values in followed.errors.items():
        own = values[:until]
        numbers = float(np.sqrt(np.mean(own**2))), float(np.abs(own).max()), float(own[-1])
        errors.append(FollowedError(name, MOTION_UNITS.get(name, "m"), *numbers))
    arrived = float(t[done[0]]) if done.size else None
    return FollowedResult(mission.name, mission.kind, arrived, tuple(errors))


def _cycle(t: np.ndarray, error: np.ndarray) -> Cycle | None:
    largest = float(np.abs(error).max(initial=0.0))
    least = max(SETTINGS.least_amplitude_share * largest, SETTINGS.least_amplitude)
    return find_cycle(t, error, least) if len(t) else None
