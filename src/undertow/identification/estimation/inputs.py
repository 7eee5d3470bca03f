"""Inputs of a model between samples: actuator states along the commands, zero-order hold."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from math import factorial
from typing import NamedTuple

import casadi as ca
import numpy as np
from scipy.linalg.lapack import dtbtrs

from undertow.codegen.engine import carried, mapped
from undertow.codegen.functions import Functions
from undertow.codegen.source import CHAINS
from undertow.errors import UndertowError
from undertow.identification.logs.run import Run, last_known
from undertow.typing import Array, Index


def change(values: Array) -> Array:
    """Change since the sample before."""
    return np.diff(values, axis=0, prepend=values[:1])


def share_of_step(t: Array, delay: float) -> tuple[Array, Array]:
    """Where in the step after each sample a jump with this delay arrives, and its derivative."""
    step = np.append(np.diff(t), np.inf)
    index = np.minimum(_active_sample(t, delay), len(t) - 2)
    return np.clip((t[index + 1] + delay - t) / step, 0.0, 1.0), 1.0 / step


def _active_sample(t: Array, delay: float) -> Index:
    """From which sample on was held what was at work just before each sample, `delay` seconds late.

    Just before, for a delay that is a multiple of the step can only grow where it is zero.
    """
    slack = 1e-12 * float(t[-1] - t[0])
    return np.maximum(np.searchsorted(t, t - delay - slack) - 1, 0)


def without_gaps(u: Array) -> Array:
    """Commands with the last known value where one is missing; no equation is used inside such gaps."""
    return np.nan_to_num(last_known(u))


def held_commands(runs: Sequence[Run], names: Sequence[str]) -> list[Array]:
    """Commands in every run, (N, n_commands), with the last known value where one is missing."""
    return [without_gaps(run.matrix(names)) for run in runs]


def shifted_mean(t: Array, held: Array, delay: float) -> Array:
    """Mean over each interval of a held signal that arrives `delay` seconds late; before the log, its first
    value.
    """
    total = np.vstack([np.zeros_like(held[:1]), np.cumsum(held[:-1] * np.diff(t)[:, None], axis=0)])
    delayed = _integral_at(t, total, held, t - delay)
    step = np.diff(t)[:, None]
    return np.vstack([np.diff(delayed, axis=0) / step, held[-1:]])


def shift_rate(t: Array, held: Array, delay: float) -> Array:
    """Minus the derivative of `shifted_mean` in the delay."""
    start = held[_active_sample(t, delay)]
    step = np.diff(t)[:, None]
    return np.vstack([np.diff(start, axis=0) / step, np.zeros_like(held[:1])])


def _integral_at(t: Array, total: Array, held: Array, when: Array) -> Array:
    index = np.clip(np.searchsorted(t, when, side="right") - 1, 0, len(t) - 1)
    return total[index] + held[index] * (when - t[index])[:, None]


@dataclass(frozen=True)
class StateSettings:
    """Settings of the integration of states that effects own."""

    substeps: int = 4  # in an interval between samples, an even number: means are by Simpson's rule
    # Where quotients of exponential steps lose digits, in time constants, and terms of their series there.
    near: float = 0.5
    terms: int = 9


SETTINGS = StateSettings()
Rate = Callable[[ca.SX, float], ca.SX]


class Inputs(NamedTuple):
    """What drives a state over one interval: columns that vary from sample to sample, parameters, its begin
    and its length in seconds.
    """

    columns: list[ca.SX]
    p: ca.SX
    t: ca.SX
    dt: ca.SX


class PropagatedState:
    """States under given rates over the intervals between samples, and the mean of an output along each.

    `rate` and `output` are functions of the states and of the share of the interval that has passed; `free`
    are the parameters that derivatives are taken in. The states alone follow one after the other. At known
    states, the derivatives of all intervals are computed side by side; what is then left of propagating
    derivatives is one banded triangular solution.
    """

    def __init__(self, z: ca.SX, inputs: Inputs, free: ca.SX, rate: Rate, output: Rate) -> None:
        self._z, self._inputs, self._free = z, inputs, free
        self._end, self._mean = _integrated(rate, output, z, inputs.dt)

    @cached_property
    def _step(self) -> ca.Function:
        columns, p, t, dt = self._inputs
        return ca.Function("carried", [self._z, *columns, t, dt, p], ca.cse([self._end]))

    @cached_property
    def _slopes(self) -> ca.Function:
        columns, p, t, dt = self._inputs
        tables = [ca.jacobian(v, x) for v in (self._end, self._mean) for x in (self._z, self._free)]
        results = ca.cse([ca.densify(v) for v in (*tables, self._mean)])
        return ca.Function("slopes", [self._z, *columns, dt, p, t], results)

    def side_by_side(self, start: Array, logs: Sequence[tuple[Array, ...]], p: Array) -> list[Array]:
        """States of S logs at the samples and after the last interval, shape (N + 1, n) each.

        A log is its columns, t and dt; start: (S, n); p: (n_p,) or (S, n_p).

        Logs of about the same length are propagated together: a shorter one takes as long as the longest.
        """
        found: dict[int, Array] = {}
        order = sorted(range(len(logs)), key=lambda i: -len(logs[i][-1]))
        for begin in range(0, len(order), CHAINS):
            rows = order[begin : begin + CHAINS]
            *columns, t, dt = map(_padded, zip(*(logs[i] for i in rows), strict=True))
            own = p[rows] if p.ndim > 1 else p
            states = carried(self._step, start[rows], [*columns, t[..., None], dt[..., None], own], len(dt))
            found |= {i: states[: len(logs[i][-1]) + 1, k] for k, i in enumerate(rows)}
        return [found[i] for i in range(len(logs))]

    def along_each(
        self, start: Array, slopes: Sequence[Array], logs: Sequence[tuple[Array, ...]], p: Array
    ) -> Iterator[tuple[Array, Array, Array, Array]]:
        """States of logs as by `side_by_side`, p of shape (S, n_p), with what `along` gives for each."""
        every = self.side_by_side(start, logs, p)
        for states, slope, (*columns, t, dt), own in zip(every, slopes, logs, p, strict=True):
            yield states, *self.along(states, slope, columns, own, t, dt)

    def along(
        self, states: Array, slope: Array, columns: list[Array], p: Array, t: Array, dt: Array
    ) -> tuple[Array, Array, Array]:
        """Derivatives of the states (N + 1, n), and means over the intervals (N, k) with theirs.

        Derivatives are those in the free parameters, then in the first states: shapes (N + 1, n, m + n) and
        (N, k, m + n); `slope`, (n, m), has those of the first states in the free parameters.
        """
        inside = [states[:-1], *columns, dt[:, None]]
        by_state, free, mean_by_state, mean_free, mean = mapped(self._slopes, inside, p, t)
        size = states.shape[1]
        first = np.hstack([slope, np.eye(size)])
        slopes = _propagated_slopes(first, by_state, _with_start(free, size))
        means = mean_by_state @ slopes[:-1] + _with_start(mean_free, size)
        return slopes, mean[:, :, 0], means


def _padded(signals: Sequence[Array]) -> Array:
    """Signals (N, ...) of several logs as (longest N, logs, ...), zeros after the end of each.

    Where an interval has no length, no state changes.
    """
    found = np.zeros((len(signals), max(map(len, signals)), *signals[0].shape[1:]))
    for whole, signal in zip(found, signals, strict=True):
        whole[: len(signal)] = signal
    return np.swapaxes(found, 0, 1)


def _with_start(direct: Array, states: int) -> Array:
    """Derivatives in the parameters, and none in the first states."""
    return np.concatenate([direct, np.zeros((*direct.shape[:2], states))], axis=2)


def _propagated_slopes(first: Array, factor: Array, added: Array) -> Array:
    """Solution of S_k+1 = A_k S_k + B_k from S_0, shapes (N, n, n) and (N, n, m): (N + 1, n, m)."""
    count, size, _ = factor.shape
    right = np.concatenate([first[None], added]).reshape((count + 1) * size, -1)
    bands = np.zeros((2 * size, (count + 1) * size))
    for i in range(size):
        for j in range(size):
            bands[size + i - j, j::size][:count] = -factor[:, i, j]
    solution, info = dtbtrs(bands, right, uplo="L", diag="U")
    assert info == 0
    return np.asarray(solution).reshape(count + 1, size, -1)


def _integrated(rate: Rate, output: Rate, z: ca.SX, dt: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Exponential Runge-Kutta over one interval, and Simpson's mean of an output along it.

    A time constant may be far shorter than the interval: classical Runge-Kutta would grow without bound. A
    state that only decays needs no substeps: its step is exact where its input is a parabola in time.
    """
    mean = output(z, 0.0)
    count = 1 if mean.is_empty() and _decays_alone(*_own_slopes(rate, z)) else SETTINGS.substeps
    h, share = dt / count, 1.0 / count
    for step in range(count):
        decay, rest = _without_decay(_part_of(rate, step * share, share), z)
        z = _exponential_step(rest, decay, z, h)
        weight = 1 if step == count - 1 else 4 if step % 2 == 0 else 2
        mean = mean + weight * output(z, (step + 1) * share)
    return z, mean / (3 * count)


def _part_of(rate: Rate, begin: float, share: float) -> Rate:
    """Rates over part of an interval."""
    return lambda state, reach: rate(state, begin + reach * share)


def _without_decay(rate: Rate, z: ca.SX) -> tuple[ca.SX, Rate]:
    """Rates at which each state decays by itself, 1/s, and the rates of change without this decay.

    Where the states enter in no other way, the rest does not depend on them. Elsewhere a state that grows by
    itself is left to the rest.
    """
    slopes, at = _own_slopes(rate, z)
    own = ca.diag(slopes)
    if _decays_alone(slopes, at):
        return own, lambda state, reach: rate(ca.SX.zeros(state.shape[0]), reach)
    decay = ca.fmin(ca.substitute(own, at, z), 0.0)
    return decay, lambda state, reach: rate(state, reach) - decay * state


def _own_slopes(rate: Rate, z: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Derivatives of the rates in the states, and the states that these are at."""
    at = ca.SX.sym("at", z.shape[0])
    return ca.jacobian(rate(at, 0.0), at), at


def _decays_alone(slopes: ca.SX, at: ca.SX) -> bool:
    """Whether every state enters the rates only by its own decay at a constant rate."""
    own = ca.diag(slopes)
    return slopes.nnz() == own.nnz() and not ca.depends_on(own, at)


def _exponential_step(rest: Rate, decay: ca.SX, z: ca.SX, h: ca.SX) -> ca.SX:
    """One step of the fourth-order method of Cox and Matthews (2002), ETDRK4: exact for what decays alone.

    Without decay it is the classical Runge-Kutta method.
    """
    half, whole = _phi(decay * h / 2), _phi(decay * h)
    fade, fades = ca.exp(decay * h / 2), ca.exp(decay * h)

    start = rest(z, 0.0)
    first = z * fade + h / 2 * half[0] * start
    middle = rest(first, 0.5)
    second = z * fade + h / 2 * half[0] * middle
    again = rest(second, 0.5)
    third = first * fade + h / 2 * half[0] * (2 * again - start)
    end = rest(third, 1.0)
    one, two, three = whole
    weighted = (one - 3 * two + 4 * three) * start + (2 * two - 4 * three) * (middle + again)
    return z * fades + h * (weighted + (4 * three - two) * end)


def _phi(x: ca.SX) -> list[ca.SX]:
    """(exp x - 1) / x and the next two of its kind, for x not positive."""
    near = x > -SETTINGS.near
    far, close = ca.if_else(near, -1.0, x), ca.if_else(near, x, 0.0)
    quotient, found = ca.exp(far), []
    for order in (1, 2, 3):
        quotient = (quotient - 1.0 / factorial(order - 1)) / far
        series = sum(close**k / factorial(k + order) for k in range(SETTINGS.terms))
        found.append(ca.if_else(near, series, quotient))
    return found


@dataclass(frozen=True)
class DrivenSignal:
    """A driven signal with its derivative in the free parameters."""

    value: Array  # (N, k) value at each sample, or mean over the interval that follows it
    slope: Array  # (N, k, n_free) its derivative; no columns where it depends on no free parameter
    start: Array  # (N, k, n_states) its derivative in the states that it started from, which no log has

    @classmethod
    def joined(cls, parts: Sequence[DrivenSignal]) -> DrivenSignal:
        """The signal along several segments, one after the other."""
        if len(parts) == 1:
            return parts[0]
        tables = ([getattr(p, f.name) for p in parts] for f in fields(DrivenSignal))
        return DrivenSignal(*map(np.concatenate, tables))


@dataclass(frozen=True)
class Actuation(DrivenSignal):
    """Actuation along a log."""

    # What it was before it changed at each sample; the same where it follows the commands without jumps
    before: DrivenSignal

    @classmethod
    def of(cls, now: DrivenSignal, before: DrivenSignal) -> Actuation:
        """What it is, and what it was."""
        return cls(now.value, now.slope, now.start, before)

    @classmethod
    def along_all(cls, parts: Sequence[Actuation]) -> Actuation:
        """Actuation along several segments, one after the other."""
        return cls.of(DrivenSignal.joined(parts), DrivenSignal.joined([p.before for p in parts]))


class ActuatorStates:
    """Actuation along the logged commands: mean output over each sampling interval.

    An actuation effect that depends on the motion is refused: actuation follows the commands, before any
    motion is known. `free` holds the places in p of the free parameters.
    """

    def __init__(self, functions: Functions, free: tuple[int, ...]) -> None:
        self.functions, self.free = functions, free
        _refuse_motion(functions)

    def along(self, t: Array, u: Array, p: Array) -> Actuation:
        """Mean actuation over [t_i, t_i+1) for commands held between samples, u of shape (N, n_commands)."""
        return self.along_each([(t, u, p)])[0]

    def along_each(self, logs: Sequence[tuple[Array, Array, Array]]) -> list[Actuation]:
        """The same along several logs (t, u, p)."""
        if self.functions.actuation.shape[0] == 0:
            nothing = [_empty(len(t), 0) for t, _, _ in logs]
            return [Actuation.of(none, none) for none in nothing]
        means = self._propagate(logs) if self._has_states else [self._static(*log) for log in logs]
        found = []
        for (t, _, p), mean in zip(logs, means, strict=True):
            delayed = self._delayed(t, mean, p)
            found.append(Actuation.of(delayed, delayed if self._has_states else self._before(t, delayed, p)))
        return found

    @property
    def _has_states(self) -> bool:
        return bool(self.functions.actuator_states.shape[0])

    @property
    def varies(self) -> bool:
        """Whether the actuation depends on a free parameter or on states."""
        composition = self.functions.vehicle.composition
        return self._has_states or bool(self._dependent) or composition.dead_time != 0

    def _propagate(self, logs: Sequence[tuple[Array, Array, Array]]) -> list[DrivenSignal]:
        inside = [(u, t, np.append(np.diff(t), 0.0)) for t, u, _ in logs]
        rest = [[np.asarray(v) for v in self._rest(u[0], p, t[0])] for t, u, p in logs]
        first, parameters = np.array([start[:, 0] for start, _ in rest]), np.array([p for *_, p in logs])
        every = self._propagated.along_each(first, [slope for _, slope in rest], inside, parameters)
        return [_driven_signal(mean, by, self._dependent, len(self.free)) for _, _, mean, by in every]

    def _static(self, t: Array, u: Array, p: Array) -> DrivenSignal:
        """A chain without states: its output in the middle of every interval."""
        middle = t + np.append(np.diff(t), 0.0) / 2
        value, slope = mapped(self._output, [u], p, middle)
        return _driven_signal(value[:, :, 0], slope, self._dependent, len(self.free) if self.varies else 0)

    @cached_property
    def _output(self) -> ca.Function:
        f = self.functions
        slope = ca.densify(ca.jacobian(f.actuator_output, self._free))
        return ca.Function("output", [f.u, f.p, f.t], [ca.densify(f.actuator_output), slope])

    @cached_property
    def _rest(self) -> ca.Function:
        """States at rest, and their derivatives."""
        f = self.functions
        slope = ca.jacobian(f.actuator_rest, self._free)
        return ca.Function("rest", [f.u, f.p, f.t], [ca.densify(f.actuator_rest), ca.densify(slope)])

    @cached_property
    def _dependent(self) -> list[int]:
        """Which of the free parameters the chain depends on."""
        f = self.functions
        return _dependence(f, self.free, ca.vertcat(f.actuator_output, f.actuator_rates, f.actuator_rest))

    @property
    def _free(self) -> ca.SX:
        return _selected(self.functions, [self.free[k] for k in self._dependent])

    @cached_property
    def _propagated(self) -> PropagatedState:
        f, dt = self.functions, ca.SX.sym("dt")
        z = f.actuator_states
        rates, output = (
            ca.Function("step", [z, f.u, f.p, f.t], [v]) for v in (f.actuator_rates, f.actuator_output)
        )
        return PropagatedState(
            z,
            Inputs([f.u], f.p, f.t, dt),
            self._free,
            lambda state, share: rates(state, f.u, f.p, f.t + share * dt),
            lambda state, share: output(state, f.u, f.p, f.t + share * dt),
        )

    @cached_property
    def _dead_time(self) -> ca.Function:
        f = self.functions
        expression = f.convert(f.vehicle.composition.dead_time)
        slope = ca.jacobian(expression, _selected(f, list(self.free)))
        return ca.Function("dead_time", [f.p], [expression, ca.densify(slope)])

    def _delayed(self, t: Array, driven: DrivenSignal, p: Array) -> DrivenSignal:
        if self.functions.vehicle.composition.dead_time == 0:
            return driven
        delay, slope = (np.asarray(v) for v in self._dead_time(p))
        seconds = float(delay[0, 0])
        dependent, places = self._dependent, np.flatnonzero(slope)
        by_dependent, start = (
            shifted_mean(t, s.reshape(len(t), -1), seconds).reshape(s.shape)
            for s in (driven.slope[:, :, dependent], driven.start)
        )
        slopes = np.zeros_like(driven.slope)
        slopes[:, :, dependent] = by_dependent
        slopes[:, :, places] -= shift_rate(t, driven.value, seconds)[:, :, None] * slope[0, places]
        return DrivenSignal(shifted_mean(t, driven.value, seconds), slopes, start)

    def dead_time(self, p: Array) -> float:
        """Dead time between commands and their effect, s."""
        return float(self._dead_time(p)[0]) if self.functions.vehicle.composition.dead_time != 0 else 0.0

    def _before(self, t: Array, driven: DrivenSignal, p: Array) -> DrivenSignal:
        """Output of a chain without states before each sample.

        A jump that falls between samples bends the velocity there: trapezoids over a kink at the share s of a
        step are off by 1 - 6 s (1 - s) times what they are off by over one at a sample.
        """
        if not self.varies:
            return DrivenSignal(
                np.concatenate([driven.value[:1], driven.value[:-1]]), driven.slope, driven.start
            )
        delay, slope = (np.asarray(v) for v in self._dead_time(p))
        share, per_second = share_of_step(t, float(delay[0, 0]))
        weight = 1.0 - 6.0 * share * (1.0 - share)
        places = np.flatnonzero(slope)
        dependent, slopes = sorted({*self._dependent, *places.tolist()}), driven.slope.copy()
        value, by_dependent, by_start = (
            change(a) for a in (driven.value, slopes[:, :, dependent], driven.start)
        )
        by_delay = (6.0 * (1.0 - 2.0 * share) * per_second)[:, None] * value
        slopes[:, :, dependent] -= weight[:, None, None] * by_dependent
        slopes[:, :, places] += by_delay[:, :, None] * slope[0, places]
        return DrivenSignal(
            driven.value - weight[:, None] * value, slopes, driven.start - weight[:, None, None] * by_start
        )


class Memory:
    """States of wrenches along the measured motion; `true_motion` is the motion in terms of `measured`."""

    def __init__(
        self, functions: Functions, free: tuple[int, ...], measured: ca.SX, true_motion: ca.SX
    ) -> None:
        self.functions, self.free = functions, free
        self._measured, self._true_motion = measured, true_motion

    def along(self, t: Array, measured: Array, actuation: Array, u: Array, p: Array) -> DrivenSignal:
        """States at the samples, zero at the first; the motion is taken as linear between samples."""
        return self.along_each([(t, measured, actuation, u, p)])[0]

    def along_each(self, logs: Sequence[tuple[Array, Array, Array, Array, Array]]) -> list[DrivenSignal]:
        """The same along several logs (t, measured, actuation, u, p)."""
        size = self.functions.memory.shape[0]
        if size == 0:
            return [_empty(len(t), len(self.free)) for t, *_ in logs]
        inside = [(y[:-1], y[1:], a[:-1], u[:-1], t[:-1], np.diff(t)) for t, y, a, u, _ in logs]
        start, slopes = np.zeros((len(logs), size)), np.zeros((len(logs), size, len(self._dependent)))
        every = self._propagated.along_each(start, [*slopes], inside, np.array([p for *_, p in logs]))
        return [_driven_signal(states, by, self._dependent, len(self.free)) for states, by, *_ in every]

    @cached_property
    def _rates(self) -> ca.SX:
        f = self.functions
        return ca.substitute(f.memory_rates, ca.vertcat(f.eta, f.nu), self._true_motion)

    @cached_property
    def _dependent(self) -> list[int]:
        """Which of the free parameters the memory depends on."""
        return _dependence(self.functions, self.free, self._rates)

    @cached_property
    def _propagated(self) -> PropagatedState:
        f, dt, after = self.functions, ca.SX.sym("dt"), ca.SX.sym("after", self._measured.shape[0])
        rate = ca.Function("rate", [f.memory, self._measured, f.actuation, f.u, f.p, f.t], [self._rates])

        def at(state: ca.SX, share: float) -> ca.SX:
            here = self._measured + share * (after - self._measured)
            return rate(state, here, f.actuation, f.u, f.p, f.t + share * dt)

        return PropagatedState(
            f.memory,
            Inputs([self._measured, after, f.actuation, f.u], f.p, f.t, dt),
            _selected(f, [self.free[k] for k in self._dependent]),
            at,
            lambda state, share: ca.SX(0, 1),
        )


def _refuse_motion(functions: Functions) -> None:
    f = functions
    if ca.depends_on(ca.vertcat(f.actuator_output, f.actuator_rates), ca.vertcat(f.eta, f.nu)):
        raise UndertowError(
            f"an actuation effect of '{f.vehicle.name}' depends on the motion, which no fit can handle: "
            "state how the motion changes the thrust as a Wrench in s.actuation"
        )


def _empty(count: int, n_free: int) -> DrivenSignal:
    return DrivenSignal(np.zeros((count, 0)), np.zeros((count, 0, n_free)), np.zeros((count, 0, 0)))


def _selected(functions: Functions, places: list[int]) -> ca.SX:
    return ca.vertcat(*[functions.p[i] for i in places]) if places else ca.SX(0, 1)


def _dependence(functions: Functions, free: tuple[int, ...], expression: ca.SX) -> list[int]:
    pattern = ca.jacobian_sparsity(expression, functions.p)
    used = set(pattern.get_col())
    return [k for k, place in enumerate(free) if place in used]


def _driven_signal(value: Array, slopes: Array, dependent: list[int], n_free: int) -> DrivenSignal:
    """Values, and slopes put in the columns of the parameters that they belong to."""
    slope = np.zeros((*value.shape, n_free))
    slope[:, :, dependent] = slopes[:, :, : len(dependent)]
    return DrivenSignal(value, slope, slopes[:, :, len(dependent) :])
