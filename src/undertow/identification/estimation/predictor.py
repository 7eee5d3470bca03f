"""Simulation of windows by one model, from measured starts."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import casadi as ca
import numpy as np

from undertow.codegen.engine import at_samples, mapped
from undertow.codegen.functions import Functions
from undertow.codegen.simulate import LONGEST_STEP, Simulator
from undertow.identification.logs.run import Run
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Index

from .data import group_numbers
from .inputs import Inputs, PropagatedState, shifted_mean
from .pointwise import Pointwise
from .residual import SensorDelay
from .threads import one_thread
from .windows import (
    Prediction,
    Segment,
    WindowCommands,
    Windows,
    cut,
    delayed_commands,
    resolving_step,
)

Simulate = Callable[[Array, Array, WindowCommands, Array, Array], Array]


@dataclass(frozen=True)
class StartSettings:
    """Settings for estimating a model's own states at the start of a segment."""

    seconds: float = 10.0  # of the first window that they are estimated from
    fewest: int = 3  # samples in them
    # Standard deviation in which the motion at the start is sought, relative to the noise of a sample.
    motion: float = 3.0
    least_noise: float = 1e-6  # of a channel, relative to its rms
    rounds: int = 12
    secant: float = 1e-6
    shares: tuple[float, ...] = (1.0, 0.3, 0.1, 0.03, 0.0)  # of a step that are tried together
    least_fall: float = 1e-3  # of the sum of squares, as a share of the first one, with which the search ends
    # Parameters whose starts are kept: one set, and a step up and down in each that acts before a window.
    kept: int = 24
    diverged: float = 1e300  # sum of squares of a start from which the simulation diverges


SETTINGS = StartSettings()


@dataclass(frozen=True)
class SegmentStart:
    """States at the beginning of every segment of the logs for one set of parameters.

    state: (segments, nx); scale: (size,), uncertainty of each own state there; linear: the problem of
    estimating the states, linearised there.
    """

    state: Array
    scale: Array
    linear: LinearisedStarts


class InternalStates:
    """Own states of a model at the start of windows: memory of wrenches, and actuators.

    `simulate` reports (b, k, 2n) from start (b, nx), t, commands, p and what was reported at the start (b,
    2n).
    """

    def __init__(
        self, functions: Functions, points: Pointwise, sensor_delay: SensorDelay, simulate: Simulate
    ) -> None:
        self._functions, self._points, self._simulate = functions, points, simulate
        self._sensor_delay = sensor_delay
        self.size = functions.memory.shape[0] + functions.actuator_states.shape[0]

    def at_starts(
        self,
        windows: Windows,
        motion: Array,
        delay: float,
        p: Array,
        longest_step: float,
        near: SegmentStart | None = None,
    ) -> tuple[Array, SegmentStart | None]:
        """Memory and actuator states at the start of every window, (b, size), and where the segments begin.

        `motion` (b, 2n) is the true one at the starts; commands arrive `delay` s late. From what was found at
        parameters close by, `near`, it is one step. `longest_step` is that of the simulation, s.
        """
        own = np.zeros((len(windows), self.size))
        if self.size == 0:
            return own, None
        segments = _segments(windows)
        first = np.array([rows[0] for rows in segments])
        opening = _first_windows(windows, first)
        commands = replace(delayed_commands(opening, delay), longest_step=longest_step)
        command_logs = zip(windows.runs, windows.held, strict=True)
        delayed = [shifted_mean(run.t, u, delay) if delay else u for run, u in command_logs]
        rest = self._at_rest(commands.u[:, 0], opening.t[:, 0], p)
        along = partial(self._along, windows, segments, delayed, p)
        scale = self._scale(along(rest)) if near is None else near.scale
        noise = _noise(windows)
        deviation = np.concatenate([SETTINGS.motion * noise, scale])
        start = np.column_stack([motion[first], rest])

        def report(trials: Array) -> Array:
            rows = np.repeat(np.arange(len(opening)), len(trials) // len(opening))
            return self._simulate(trials, opening.t[rows], commands[rows], p, opening.start[rows]) / noise

        measured = np.where(np.isfinite(opening.measured), opening.measured / noise, np.nan)
        problem = StartProblem(report, measured, start, deviation)
        state, linear = problem.solved() if near is None else (problem.next_to(near), near.linear)
        for rows, states in zip(segments, along(state[:, -self.size :]), strict=True):
            own[rows] = states[windows.first[rows] - windows.first[rows[0]]]
        return own, SegmentStart(state, scale, linear)

    # --- along the log ------------------------------------------------------------------------
    def _at_rest(self, u: Array, t: Array, p: Array) -> Array:
        """Memory without a past, actuators as if the first command had long been held, by segment."""
        (actuator,) = at_samples(self._functions.rest, [u, p, t[:, None]], len(t))
        return np.column_stack([np.zeros((len(u), self._functions.memory.shape[0])), actuator])

    @staticmethod
    def _scale(along: list[Array]) -> Array:
        """Magnitude of the states, which bounds the error of the initial ones."""
        largest = np.max([np.max(np.abs(a), axis=0) for a in along], axis=0)
        return np.where(largest > 0, largest, 1.0)

    def _along(
        self, windows: Windows, segments: list[Index], delayed: list[Array], p: Array, start: Array
    ) -> list[Array]:
        """States from the first to the last start in every segment, shape (N, size) each."""
        inside = [self._between(windows, rows, delayed, p) for rows in segments]
        return self._propagated.side_by_side(start, inside, p)

    def _between(self, windows: Windows, rows: Index, delayed: list[Array], p: Array) -> tuple[Array, ...]:
        """Motion before and after every interval between the starts of a segment, commands, time, length."""
        run, first = int(windows.run[rows[0]]), int(windows.first[rows[0]])
        piece = slice(first, int(windows.first[rows[-1]]) + 1)
        t, u = windows.runs[run].t[piece], delayed[run][piece]
        reach = slice(first, piece.stop - 1 + int(windows.count[rows[-1]]))
        measured = self._measured(windows, run, reach, p)[: len(t)]
        return measured[:-1], measured[1:], u[:-1], t[:-1], np.diff(t)

    def _measured(self, windows: Windows, run: int, piece: slice, p: Array) -> Array:
        """Pose and velocity as reported in part of a run, each at the time that it was true."""
        return self._sensor_delay.aligned_signals(windows.runs[run].t[piece], windows.motion[run][piece], p)

    @cached_property
    def _propagated(self) -> PropagatedState:
        """Own states from sample to sample: the motion is linear in between, the command is held."""
        f, measured = self._functions, self._points.measured
        after, dt, rate = ca.SX.sym("after", measured.shape[0]), ca.SX.sym("dt"), self._rates
        nothing = ca.SX(0, 1)

        def at(state: ca.SX, share: float) -> ca.SX:
            return rate(state, measured + share * (after - measured), f.u, f.p, f.t + share * dt)

        inputs = Inputs([measured, after, f.u], f.p, f.t, dt)
        return PropagatedState(
            ca.vertcat(f.memory, f.actuator_states), inputs, nothing, at, lambda *_: nothing
        )

    @cached_property
    def _rates(self) -> ca.Function:
        f, points = self._functions, self._points
        driven = ca.substitute(f.memory_rates, f.actuation, f.actuator_output)
        rates = ca.substitute(
            ca.vertcat(driven, f.actuator_rates), ca.vertcat(f.eta, f.nu), points.true_motion
        )
        own = ca.vertcat(f.memory, f.actuator_states)
        return ca.Function("rates", [own, points.measured, f.u, f.p, f.t], [ca.densify(rates)])


def _first_windows(windows: Windows, first: Index) -> Windows:
    """The first seconds of the first window of every segment."""
    step = float(np.median(np.diff(windows.runs[0].t)))
    return windows.take(first, max(int(SETTINGS.seconds / step), SETTINGS.fewest))


def _segments(windows: Windows) -> list[Index]:
    """Windows of every gap-free segment, in order of time."""
    number = group_numbers(windows.run, windows.segment)
    return [np.flatnonzero(number == i) for i in range(number.max() + 1)]


def _noise(windows: Windows) -> Array:
    """Noise of the channels, with a floor for logs that have none."""
    least = SETTINGS.least_noise * windows.rms
    return np.maximum(np.maximum(windows.sigma, least), SETTINGS.least_noise)


# --- the state at the beginning, by how the log goes on -------------------------------------------
class LinearisedStarts(NamedTuple):
    """Reports linearised in the starts, these in units of their prior, (b, m, k c), and the inverse of the
    information on them, (b, m, m); zero where a simulation diverged.
    """

    slope: Array
    inverse: Array

    def step(self, residual: Array, moved: Array) -> Array:
        """Gauss-Newton step, (b, m), from a residual (b, k c)."""
        with np.errstate(over="ignore", invalid="ignore"):
            right = (self.slope @ residual[..., None])[..., 0] - moved
            found = (self.inverse @ right[..., None])[..., 0]
        return np.where(np.isfinite(found).all(axis=1, keepdims=True), found, 0.0)


@dataclass(frozen=True)
class StartProblem:
    """Starts (b, m) that best explain the following samples, with the given ones as prior.

    `report` gives what follows of b r starts, r trials for each log in turn, (b r, k, c); it and `measured`
    (b, k, c) are in units of the noise, NaN where nothing was measured. `deviation` (m,) is the standard
    deviation of the prior.
    """

    report: Callable[[Array], Array]
    measured: Array
    start: Array
    deviation: Array

    def solved(self) -> tuple[Array, LinearisedStarts]:
        """The starts by Gauss-Newton steps, and the last linearised problem."""
        moved = np.zeros_like(self.start)
        falls: list[Array] = []
        for _ in range(SETTINGS.rounds):
            linear, r = self._linearised(moved)
            step = linear.step(r, moved)
            trials = moved[:, None] + np.array(SETTINGS.shares)[:, None] * step[:, None]
            with np.errstate(over="ignore"):
                cost = np.sum(self._residual(trials) ** 2, axis=2) + np.sum(trials**2, axis=2)
            cost = np.nan_to_num(cost, nan=SETTINGS.diverged, posinf=SETTINGS.diverged)
            best = np.argmin(cost, axis=1)
            moved = trials[np.arange(len(best)), best]
            falls.append(cost[:, -1] - cost[np.arange(len(best)), best])
            if not np.any(falls[-1] > SETTINGS.least_fall * falls[0]):
                break
        return self.start + moved * self.deviation, linear

    def next_to(self, near: SegmentStart) -> Array:
        """The starts from those at parameters close by, whose linearised problem still holds."""
        moved = (near.state - self.start) / self.deviation
        step = near.linear.step(self._residual(moved[:, None])[:, 0], moved)
        return self.start + (moved + step) * self.deviation

    def _residual(self, moved: Array) -> Array:
        """Measured minus reported for trials of shape (b, r, m), shape (b, r, k c)."""
        b, r, m = moved.shape
        y = self.report((self.start[:, None] + moved * self.deviation).reshape(b * r, m))
        used = np.isfinite(self.measured)[:, None]
        known = np.where(used, self.measured[:, None], 0.0)
        return np.where(used, known - y.reshape(b, r, *y.shape[1:]), 0.0).reshape(b, r, -1)

    def _linearised(self, moved: Array) -> tuple[LinearisedStarts, Array]:
        """The problem linearised by differences, and the residual (b, k c)."""
        m = moved.shape[1]
        r = self._residual(moved[:, None] + np.vstack([np.zeros(m), SETTINGS.secant * np.eye(m)]))
        with np.errstate(over="ignore", invalid="ignore"):
            slope = (r[:, :1] - r[:, 1:]) / SETTINGS.secant
            gram = slope @ np.swapaxes(slope, 1, 2) + np.eye(m)
        good = np.isfinite(r).all(axis=(1, 2)) & np.isfinite(gram).all(axis=(1, 2))
        inverse = np.zeros_like(gram)
        # Where reports are extremely sensitive to the start, the prior is lost in rounding: no step that way.
        inverse[good] = np.linalg.pinv(gram[good], hermitian=True)
        return LinearisedStarts(slope, inverse), r[:, 0]


@dataclass(frozen=True)
class _StartStates:
    """True motion and own states at the starts of windows, at one set of parameters."""

    motion: Array
    own: Array
    origin: SegmentStart | None


class Predictor:
    """Predicts windows with one model; keeps its compiled code from one call to the next."""

    def __init__(self, model: Vehicle | Functions, *, compiled: bool | None = None) -> None:
        self.functions = model if isinstance(model, Functions) else Functions(model)
        self.simulator = Simulator(self.functions, compiled=compiled)
        self._points = Pointwise(self.functions, ())
        self.sensor_delay = SensorDelay(self.functions)
        self._own_states = InternalStates(self.functions, self._points, self.sensor_delay, self.simulated)
        # One tuple, so that threads with different windows do not mix them up.
        self._recent: tuple[Callable[[], Windows | None], dict[bytes, _StartStates]]
        self._recent = (lambda: None), {}
        # For the segments that windows were cut from: in a descent, steps must not change on the way.
        self._resolved: tuple[tuple[Segment, ...], float] = ((), LONGEST_STEP)

    def for_other_windows(self) -> Predictor:
        """The same predictor for other windows: what it keeps of them is its own."""
        other = copy(self)
        other._recent = (lambda: None), {}
        return other

    def for_first_samples(self, windows: Windows, rows: Index, part: Windows, p: Array) -> Predictor:
        """A predictor of `part`, which is the beginning of some of the windows.

        Starts known at these parameters are not computed again.
        """
        found, other = self._start_states(windows, p), self.for_other_windows()
        known = _StartStates(found.motion[rows], found.own[rows], found.origin)
        other._recent = weakref.ref(part), {p.tobytes(): known}
        return other

    @property
    def values(self) -> Array:
        """Parameters of the vehicle."""
        return np.array(self.functions.values(), dtype=float)

    def reports(
        self, windows: Windows, p: Array, motion: Array | None = None, near: Array | None = None
    ) -> Array:
        """What the sensors would report in every window, shape (b, k, 2n); NaN in the padding.

        `motion` (b, 2n) is the true one at the starts; as measured where not given. `near` are parameters
        close by, from which the model's own states at the starts are sought.
        """
        start, commands = self.start_and_commands(windows, p, motion, near)
        reported = self.simulated(start, windows.t, commands, p, windows.start)
        reported[~windows.inside] = np.nan
        return reported

    def start_and_commands(
        self, windows: Windows, p: Array, motion: Array | None = None, near: Array | None = None
    ) -> tuple[Array, WindowCommands]:
        """States at the start of every window, (b, nx), and the commands in it, as for `reports`."""
        commands = delayed_commands(windows, self._delay(p))
        found = self._start_states(windows, p, near, commands)
        commands = replace(commands, longest_step=self._resolving_step(windows, p))
        return np.column_stack([found.motion if motion is None else motion, found.own]), commands

    def _resolving_step(self, windows: Windows, p: Array) -> float:
        """Longest Runge-Kutta step in these windows, s, for the first parameters they are simulated with."""
        if self._resolved[0] is not windows.segments:
            self._resolved = windows.segments, resolving_step(self.functions, windows, p)
        return self._resolved[1]

    def _delay(self, p: Array) -> float:
        """How late commands arrive, s."""
        return float(self.functions.dead_time(p))

    def _start_states(
        self, windows: Windows, p: Array, near: Array | None = None, commands: WindowCommands | None = None
    ) -> _StartStates:
        """Measured motion and own states at the starts, kept for the next calls with the same parameters.

        A descent returns to the same parameters repeatedly while it moves the starts. Only one set of windows
        is cached.
        """
        of, recent = self._recent
        if of() is not windows:
            of, recent = self._recent = weakref.ref(windows), {}
        key = p.tobytes() + (b"" if near is None else near.tobytes())
        if key not in recent:
            origin = None if near is None else self._start_states(windows, near).origin
            delay = self._delay(p)
            motion = self.measured_motion(windows, (commands or delayed_commands(windows, delay)).u, p)
            step = self._resolving_step(windows, p)
            own, origin = self._own_states.at_starts(windows, motion, delay, p, step, origin)
            if len(recent) >= SETTINGS.kept:
                recent.pop(next(iter(recent)), None)
            if near is None:  # the linearised problem is large: that of the last parameters alone is kept
                recent.update({k: replace(v, origin=None) for k, v in recent.items()})
            recent[key] = _StartStates(motion, own, origin)
        return recent[key]

    def measured_motion(self, windows: Windows, u: Array, p: Array) -> Array:
        """True pose and velocity at the start of every window by what was measured around it, (b, 2n)."""
        f, count = self.functions, len(windows)
        nothing = [np.zeros((count, v.shape[0])) for v in (f.actuation, f.memory)]
        late = self.sensor_delay.present
        start = windows.start_after(self.sensor_delay.seconds(p)) if late else windows.start
        (motion,) = mapped(self._points.true_motion_at, [start, *nothing, u[:, 0]], p, windows.t[:, 0])
        return np.asarray(motion[:, :, 0])

    def states(self, start: Array, commands: WindowCommands, p: Array) -> Array:
        """Simulate from states (b, nx): those at the samples, (b, k, nx)."""
        states = self.simulator.run(start, commands.t, commands.held, p, max_step=commands.longest_step)
        return commands.at_samples(states)

    def simulated(
        self, start: Array, t: Array, commands: WindowCommands, p: Array, before: Array | None = None
    ) -> Array:
        """Simulate from states (b, nx), and say what the sensors report, shape (b, k, 2n).

        `before` (b, 2n) is what late sensors report at the starts; without it the vehicle was as at first.
        """
        states = self.states(start, commands, p)
        prompt = self.reported(states, t, commands.u, p)
        if not self.sensor_delay.present:
            return prompt
        return reported_late(
            prompt, t, self.sensor_delay.seconds(p), prompt[:, 0] if before is None else before
        )

    def reported(self, states: Array, t: Array, u: Array, p: Array) -> Array:
        """Reports of prompt sensors for states of shape (b, k, nx)."""
        size = 2 * self._points.size
        if self.ideal_sensors:
            return states[:, :, :size].copy()
        columns = [a.reshape(a.shape[0] * a.shape[1], a.shape[2]) for a in (states, u)]
        (flat,) = mapped(self.functions.outputs, columns, p, t.ravel())
        return np.asarray(flat.reshape(*t.shape, -1))

    @cached_property
    def ideal_sensors(self) -> bool:
        """Whether the sensors report pose and velocity as they are."""
        motion = ca.vertcat(self.functions.eta, self.functions.nu)
        return bool(ca.is_equal(self.functions.reported, motion, 2))


# --- what sensors report late ---------------------------------------------------------------------
def reported_late(values: Array, t: Array, seconds: Array, before: Array) -> Array:
    """Reports at each sample if every channel has its own delay, (b, k, c, ...).

    Of the time before a window only the report at its start is known, `before` (b, c, ...): from there a late
    channel goes linearly to the first value of the simulation, where its own time reaches the window.
    """
    late = values.copy()
    rest = (1,) * (values.ndim - 3)
    for delay in np.unique(seconds[seconds > 0]):
        columns = np.flatnonzero(seconds == delay)
        index, share = _places(t, t - delay)
        old = values[:, :, columns]
        at, after = (np.take_along_axis(old, i.reshape(*t.shape, 1, *rest), 1) for i in (index, index + 1))
        with np.errstate(over="ignore", invalid="ignore"):  # a simulation on its way to infinity
            inside = at + share.reshape(*t.shape, 1, *rest) * (after - at)
        line = np.clip((t - t[:, :1]) / delay, 0.0, 1.0).reshape(*t.shape, 1, *rest)
        start = before[:, None, columns]
        early = (t - t[:, :1] < delay).reshape(*t.shape, 1, *rest)
        late[:, :, columns] = np.where(early, start + line * (old[:, :1] - start), inside)
    return late


def _places(t: Array, when: Array) -> tuple[Index, Array]:
    """Interval of each row of t that an instant lies in, and the share of it that is over."""
    last = t.shape[1] - 2
    pairs = zip(t, when, strict=True)
    index = np.clip([np.searchsorted(own, w, side="right") - 1 for own, w in pairs], 0, last)
    begin, end = (np.take_along_axis(t, i, 1) for i in (index, index + 1))
    length = np.where(end > begin, end - begin, 1.0)
    return index, np.clip((when - begin) / length, 0.0, 1.0)


def predict(
    model: Vehicle | Functions | Predictor,
    runs: Sequence[Run] | Windows,
    horizon: float | None = 5.0,
    *,
    compiled: bool | None = None,
) -> Prediction:
    """Predict logs, or windows that were cut already, window by window.

    A `Predictor` as the model keeps its compiled code from one call to the next. `horizon` is the length of a
    window in s, or None: each segment without gaps from its first sample to its end; that of windows holds.
    """
    predictor = model if isinstance(model, Predictor) else Predictor(model, compiled=compiled)
    windows = runs if isinstance(runs, Windows) else cut(runs, predictor.functions.vehicle, horizon)
    return Prediction(windows, predictor.reports(windows, predictor.values))


@one_thread()
def predict_each(
    vehicles: Sequence[Vehicle], windows: Windows, predictor: Predictor | None = None
) -> Prediction:
    """Predict windows of several runs, each by a vehicle of its own; these differ in their values only."""
    predictor = Predictor(vehicles[0]) if predictor is None else predictor
    names, reports = predictor.functions.parameter_names, np.full(windows.measured.shape, np.nan)
    values = np.array([[vehicle.value_of(n).value for n in names] for vehicle in vehicles])
    if np.all(values == values[0]):
        return Prediction(windows, predictor.reports(windows, values[0]))
    for place in np.unique(windows.run).tolist():
        rows, own = windows.of_run(place)
        reports[rows] = predictor.reports(own, values[place])
    return Prediction(windows, reports)
