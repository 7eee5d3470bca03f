"""Measures of a run: settling, overshoot, final error, effort, and sustained oscillations."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Literal

import numpy as np

from undertow.model.symbols import FASTEST, MOTION_UNITS

if TYPE_CHECKING:
    from .interconnection import Interconnection
    from .scenario import Scenario
    from .stepping import Rows


@dataclass(frozen=True)
class MeasureSettings:
    """Settings of what is measured of a simulated loop."""

    oscillating: float = 0.6  # part of the run, its end, that an oscillation is sought in
    hysteresis: float = 0.1  # part of the greatest swing that a crossing must leave behind to count
    fewest: int = 3  # cycles
    samples: int = 8  # fewest in that part of the run
    steady: float = 0.01  # change of the amplitude from cycle to cycle that counts as none
    regular: float = 0.1  # scatter of a period that still is one
    band: float = 0.02  # of a step, in which it has settled
    tail: float = 0.1  # part of the run, its end, over which the remaining error is measured
    # Smallest amplitude of an oscillation that is mentioned, as a part of the largest error, and in m or rad.
    least_amplitude_share: float = 2e-3
    least_amplitude: float = 1e-5
    at_limit: float = 1e-12  # share of its limit by which a command may miss it, and is still limited


SETTINGS = MeasureSettings()


@dataclass(frozen=True)
class Cycle:
    """An oscillation."""

    # "limit cycle" where the amplitude stays, else "growing" or "decaying"
    kind: Literal["limit cycle", "growing", "decaying"]
    amplitude: float  # half the distance between the extremes, of the last cycles, m or rad
    period: float  # mean period, s
    spread: float  # standard deviation of the period from cycle to cycle, s
    cycles: int  # how many cycles were seen


def find_cycle(t: np.ndarray, error: np.ndarray, least: float) -> Cycle | None:
    """The oscillation in the last three fifths of a run, if there is one of this amplitude at least."""
    tail = t >= t[-1] - SETTINGS.oscillating * (t[-1] - t[0])
    t, error = t[tail], error[tail]
    if len(t) < SETTINGS.samples or not np.isfinite(error).all():
        return None
    middle = 0.5 * (error.max() + error.min())
    swing = error - middle
    rising = _rising(swing, SETTINGS.hysteresis * np.abs(swing).max())
    if len(rising) <= SETTINGS.fewest:
        return None
    times = t[rising] - swing[rising] * (t[rising + 1] - t[rising]) / (swing[rising + 1] - swing[rising])
    amplitudes = np.array([np.ptp(swing[a:b]) / 2 for a, b in pairwise(rising)])
    periods = np.diff(times)
    spread = float(periods.std())
    if amplitudes[-1] < least or spread > SETTINGS.regular * periods.mean():
        return None
    growth = (amplitudes[-1] / amplitudes[0]) ** (1 / (len(amplitudes) - 1)) - 1
    kind: Literal["limit cycle", "growing", "decaying"] = "growing" if growth > 0 else "decaying"
    if abs(growth) < SETTINGS.steady:
        kind = "limit cycle"
    return Cycle(kind, float(amplitudes[-2:].mean()), float(periods.mean()), spread, len(periods))


def _rising(swing: np.ndarray, threshold: float) -> np.ndarray:
    """Last samples before upward zero crossings, one for each time the signal has been well below zero."""
    side = np.where(swing > threshold, 1, np.where(swing < -threshold, -1, 0))
    marks = np.flatnonzero(side)
    upward = marks[1:][(side[marks[1:]] > 0) & (side[marks[:-1]] < 0)]
    below = np.flatnonzero((swing[:-1] <= 0) & (swing[1:] > 0))
    indices = np.searchsorted(below, upward, side="left") - 1
    return np.unique(below[indices[indices >= 0]])


_FULL_TURN = 2 * math.pi
ALONG, CROSS = "along track", "cross track"


@dataclass(frozen=True)
class PlausibleSettings:
    """What a vehicle in water can do; a run beyond it has diverged."""

    # largest speed and turning rate along each axis, m/s and rad/s: `FASTEST`, which no vehicle reaches
    speed: float = FASTEST
    # A pose may be as far from the start as twice that speed (the vehicle's and the water's) leads in the
    # time so far and this many seconds more, m and rad; farther, the integration has jumped
    ahead: float = 1.0


PLAUSIBLE = PlausibleSettings()


def _limits(t: np.ndarray, pose: int, states: int) -> np.ndarray:
    """Largest magnitudes at some times, shape (n, states): change of pose, velocities, then no limit."""
    found = np.full((len(t), states), np.inf)
    found[:, :pose] = 2 * PLAUSIBLE.speed * (t[:, None] + PLAUSIBLE.ahead)
    found[:, pose : 2 * pose] = PLAUSIBLE.speed
    return found


def implausible(x: np.ndarray, start: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Where states are not finite or no vehicle in water reaches them, shape (..., n, states)."""
    pose = start.shape[-1]
    moved = x.copy()
    moved[..., :pose] -= start[..., None, :]
    return ~np.isfinite(x) | (np.abs(moved) > _limits(t, pose, x.shape[-1]))


@dataclass(frozen=True)
class Divergence:
    """The first impossible state of a run."""

    time: float  # when, s
    # name, unit: which state; velocities in m/s and rad/s
    name: str
    unit: str
    value: float  # its value; the change since the start for a pose
    limit: float  # what it may be
    text: str  # all of that in a line


def divergence(names: Sequence[str], x: np.ndarray, start: np.ndarray, t: float) -> Divergence:
    """What has diverged in a state at time t, shape (states,), with the pose that the run began with."""
    index = int(np.argmax(implausible(x[None], start, np.array([t]))[0]))
    pose = len(start)
    limit = float(_limits(np.array([t]), pose, len(x))[0, index])
    name, value = names[index], float(x[index] - (start[index] if index < pose else 0.0))
    unit = MOTION_UNITS.get(name, "")
    if not math.isfinite(value):
        why = f"{name} is no longer a finite number"
    elif index < pose:
        why = f"{name} is {value:.4g} {unit} from where it began, beyond the limit of {limit:.4g}"
    else:
        why = f"{name} = {value:.4g} {unit}, above the limit of {limit:g}"
    return Divergence(t, name, unit, value, limit, f"diverged at t = {t:.6g} s: {why}")


@dataclass(frozen=True)
class CoordinateResult:
    """How one coordinate approached its set-point; errors are desired minus true.

    Headings repeat with every turn: an angle has settled if it is near any of them, and the other measures
    refer to the one that the vehicle reaches.
    """

    # name, unit: the coordinate; "along track" and "cross track" are measured on the line from the start to
    # the goal
    name: str
    unit: str
    move: float  # what was to be gone, the short way round for an angle
    turns: int  # whole turns from where the move leads to where the vehicle comes to; zero but for angles
    # time after which the error stays within 2% of the move, s; None if it is not there for the whole last
    # tenth of the run (it may just pass), or nothing was to go
    settling: float | None
    overshoot: float | None  # largest distance beyond the set-point, % of the move
    final_error: float  # error at the end
    # steady_error, steady_spread: mean of the error over the last tenth of the run, and half the distance
    # between its extremes there
    steady_error: float
    steady_spread: float
    largest: float  # largest magnitude of the error
    sampling_offset: float  # what the sampled jump of the law may leave, zero for laws without one
    cycle: Cycle | None  # the oscillation of the last part of the run


@dataclass(frozen=True)
class CommandResult:
    """What a command did, in units of the command."""

    name: str  # the thruster
    unit: str  # of the command; "command" if it is the thruster's own
    effort: float  # integral of the magnitude over time
    # rms, peak: root of the mean square, and largest magnitude
    rms: float
    peak: float
    variation: float  # sum of all changes from sample to sample, per second: how much the law chatters
    at_limit: float  # share of the time at the limit


class _Error:
    """Accumulated measures of one coordinate; `turn` is its period."""

    def __init__(self, move: float, turn: float) -> None:
        self.move, self.band, self._turn = move, SETTINGS.band * abs(move), turn
        self.settling: float | None = 0.0
        self.least, self.most, self.final = math.inf, -math.inf, move
        self.tail: list[np.ndarray] = []
        self._before: float | None = None

    def add(self, t: np.ndarray, error: np.ndarray, tail: float) -> None:
        self.tail.append(error[t >= tail])
        if self._before is not None:
            dt = t[1] - t[0] if len(t) > 1 else 0.0
            t, error = np.r_[t[0] - dt, t], np.r_[self._before, error]
        self._settle(t, np.abs(error - self._turn * np.rint(error / (self._turn or 1.0))))
        self.least, self.most = min(self.least, float(error.min())), max(self.most, float(error.max()))
        self._before = self.final = float(error[-1])

    @property
    def turns(self) -> int:
        return -round(self.final / self._turn) if self._turn else 0

    def overshoot(self, turns: int) -> float:
        """Overshoot beyond the set-point shifted by a number of turns, at least zero."""
        further = self._turn * turns
        least, most = self.least + further, self.most + further
        return max(-least if self.move + further > 0 else most, 0.0)

    def largest(self, turns: int) -> float:
        further = self._turn * turns
        return max(abs(self.least + further), abs(self.most + further))

    def _settle(self, t: np.ndarray, size: np.ndarray) -> None:
        outside = np.flatnonzero(~(size <= self.band))
        if not outside.size:
            return
        last = int(outside[-1])
        if last == len(t) - 1:
            self.settling = None
            return
        ahead = (size[last] - self.band) / (size[last] - size[last + 1])
        self.settling = float(t[last] + ahead * (t[last + 1] - t[last]))


class Measures:
    """Gathers the measures of a run."""

    def __init__(
        self,
        parts: Interconnection,
        scenario: Scenario,
        start: Mapping[str, float],
        to: Mapping[str, float],
        offsets: Mapping[str, float],
    ) -> None:
        self._scenario, self._offsets = scenario, offsets
        self._goal = {name: start[name] + _wrapped(name, to[name] - start[name]) for name in to}
        moves = {name: self._goal[name] - start[name] for name in to}
        self._course: float | None = None
        if {"x", "y"} <= moves.keys() and (moves["x"] or moves["y"]):
            self._course = math.atan2(moves["y"], moves["x"])
            moves |= {ALONG: math.hypot(moves["x"], moves["y"]), CROSS: 0.0}
        self._errors = {
            n: _Error(m, _FULL_TURN if MOTION_UNITS.get(n) == "rad" else 0.0) for n, m in moves.items()
        }
        self._names = list(to)
        self._states = parts.functions.state_names
        self._start = np.array(list(start.values()))
        self._commands = _Commands(parts)
        self.gate: float | None = None
        self.diverged: Divergence | None = None

    @property
    def goal(self) -> dict[str, float]:
        """The set-point, angles as many turns on as the vehicle has come to by now."""
        return {name: value + _FULL_TURN * self._turns(name) for name, value in self._goal.items()}

    def _turns(self, name: str) -> int:
        return self._errors[name].turns if self.diverged is None else 0

    def add(self, begin: int, rows: Rows) -> int:
        """Take in the rows of the samples from `begin` on; how many there are before the run diverges."""
        t = (begin + np.arange(len(rows.x))) * self._scenario.dt
        beyond = np.flatnonzero(implausible(rows.x, self._start, t).any(axis=1))
        count = int(beyond[0]) if beyond.size else len(t)
        if count < len(t):
            self.diverged = divergence(self._states, rows.x[count], self._start, float(t[count]))
        if count:
            errors = self._errors_from(self._goal, rows.x[:count])
            for name, error in errors.items():
                self._errors[name].add(t[:count], error, (1 - SETTINGS.tail) * self._scenario.duration)
            passed = np.flatnonzero(rows.s[:count, -1] > 0)
            if self.gate is None and passed.size:
                self.gate = float(t[passed[0]])
            self._commands.add(rows.u[:count], self._scenario.dt)
        return count

    def errors(self, x: np.ndarray) -> dict[str, np.ndarray]:
        """Desired less true pose over rows of states, along and across the track, too."""
        return self._errors_from(self.goal, x)

    def _errors_from(self, goal: Mapping[str, float], x: np.ndarray) -> dict[str, np.ndarray]:
        errors = {name: goal[name] - x[:, i] for i, name in enumerate(self._names)}
        if self._course is not None:
            c, s = math.cos(self._course), math.sin(self._course)
            errors[ALONG] = c * errors["x"] + s * errors["y"]
            errors[CROSS] = c * errors["y"] - s * errors["x"]
        return errors

    def coordinates(self, cycles: Mapping[str, Cycle | None]) -> tuple[CoordinateResult, ...]:
        """The measures of every coordinate."""
        return tuple(self._coordinate(name, cycles.get(name)) for name in self._errors)

    def commands(self) -> tuple[CommandResult, ...]:
        """The measures of every command."""
        return self._commands.results()

    def _coordinate(self, name: str, cycle: Cycle | None) -> CoordinateResult:
        e, turns = self._errors[name], self._turns(name)
        tail = np.concatenate(e.tail) if e.tail else np.array([])
        tail = (tail if tail.size else np.array([e.final])) + _FULL_TURN * turns
        moved = self.diverged is None and e.move != 0
        in_band = e.settling is not None and e.settling <= (1 - SETTINGS.tail) * self._scenario.duration
        return CoordinateResult(
            name,
            MOTION_UNITS.get(name, "m"),
            e.move,
            turns,
            e.settling if moved and in_band else None,
            100 * e.overshoot(turns) / abs(e.move) if e.move else None,
            e.final + _FULL_TURN * turns,
            float(tail.mean()),
            float(np.ptp(tail)) / 2,
            e.largest(turns),
            self._offsets.get(name, 0.0),
            cycle,
        )


class _Commands:
    """Accumulated measures of the commands."""

    def __init__(self, parts: Interconnection) -> None:
        self._names, self._indices = parts.controller.command_names, parts.commanded
        self._units = parts.controller.gains.plant.vehicle.input_units
        self._limits = parts.controller.allocation.limits
        n = len(self._names)
        self._effort, self._square, self._peak, self._changes, self._limited = (np.zeros(n) for _ in range(5))
        self._time = 0.0
        self._last: np.ndarray | None = None

    def add(self, u: np.ndarray, dt: float) -> None:
        u = u[:, self._indices]
        size = np.abs(u)
        self._effort += dt * size.sum(axis=0)
        self._square += dt * (u**2).sum(axis=0)
        self._peak = np.maximum(self._peak, size.max(axis=0))
        self._limited += dt * (size >= self._limits * (1 - SETTINGS.at_limit)).sum(axis=0)
        before = u[:1] if self._last is None else self._last
        self._changes += np.abs(np.diff(np.vstack([before, u]), axis=0)).sum(axis=0)
        self._last, self._time = u[-1:], self._time + dt * len(u)

    def results(self) -> tuple[CommandResult, ...]:
        time = self._time or 1.0
        columns = (
            self._effort,
            np.sqrt(self._square / time),
            self._peak,
            self._changes / time,
            self._limited / time,
        )
        rows = np.transpose(columns).tolist()
        return tuple(CommandResult(n, self._units[n], *row) for n, row in zip(self._names, rows, strict=True))


def _wrapped(name: str, move: float) -> float:
    """The short way round for an angle."""
    return math.remainder(move, _FULL_TURN) if MOTION_UNITS[name] == "rad" else move
