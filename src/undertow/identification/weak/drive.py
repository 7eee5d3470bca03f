"""States that are driven by what was logged: the actuation chain along the commands, memory along the
motion.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from undertow.codegen.functions import Functions
from undertow.errors import UndertowError
from undertow.typing import Array

from .carried import Carried, Inputs
from .held import change, share_of_step, shift_rate, shifted_mean
from .mapping import mapped


@dataclass(frozen=True)
class Driven:
    """A driven signal with its derivative in the free parameters.

    Attributes
    ----------
    value : (N, k) array
        Value at each sample, or mean over the interval that follows it.
    slope : (N, k, n_free) array
        Its derivative.
    start : (N, k, n_states) array
        Its derivative in the states that it started from, which no log tells.
    """

    value: Array
    slope: Array
    start: Array


@dataclass(frozen=True)
class Actuated(Driven):
    """Actuation along a log.

    Attributes
    ----------
    before : Driven
        What it was before it changed at each sample; the same where it follows the commands without jumps.
    """

    before: Driven

    @classmethod
    def of(cls, now: Driven, before: Driven) -> Actuated:
        """What it is, and what it was."""
        return cls(now.value, now.slope, now.start, before)


class ActuatorStates:
    """Actuation along the logged commands: mean output over each sampling interval.

    Parameters
    ----------
    functions : Functions
        The model.
    free : tuple of int
        Places in p of the free parameters.

    Raises
    ------
    UndertowError
        If a step of the chain feels the motion: the chain follows the commands, before any motion is known.
    """

    def __init__(self, functions: Functions, free: tuple[int, ...]) -> None:
        self.functions, self.free = functions, free
        _refuse_motion(functions)

    def along(self, t: Array, u: Array, p: Array) -> Actuated:
        """Mean actuation over [t_i, t_i+1) for commands held between samples, u of shape (N, n_commands)."""
        size, count = self.functions.actuation.shape[0], len(t)
        if size == 0:
            nothing = _nothing(count, len(self.free))
            return Actuated.of(nothing, nothing)
        mean = self._carried_along(t, u, p) if self._has_states else self._static(t, u, p)
        late = self._delayed(t, mean, p)
        return Actuated.of(late, late if self._has_states else self._before(t, late, p))

    @property
    def _has_states(self) -> bool:
        return bool(self.functions.actuator_states.shape[0])

    @property
    def moves(self) -> bool:
        """Whether the actuation depends on a free parameter or on states."""
        composition = self.functions.vehicle.composition
        return self._has_states or bool(self._felt) or composition.dead_time != 0

    def _carried_along(self, t: Array, u: Array, p: Array) -> Driven:
        step = np.append(np.diff(t), 0.0)
        start, slope = (np.asarray(v) for v in self._rest(u[0], p, t[0]))
        _, _, mean, slopes = self._carried.along(start[:, 0], slope, [u], p, t, step)
        return _driven(mean, slopes, self._felt, len(self.free))

    def _static(self, t: Array, u: Array, p: Array) -> Driven:
        """A chain without states: its output in the middle of every interval."""
        middle = t + np.append(np.diff(t), 0.0) / 2
        value, slope = mapped(self._output, [u], p, middle)
        return _driven(value[:, :, 0], slope, self._felt, len(self.free))

    @cached_property
    def _output(self) -> ca.Function:
        f = self.functions
        slope = ca.densify(ca.jacobian(f.chain_output, self._free))
        return ca.Function("output", [f.u, f.p, f.t], [ca.densify(f.chain_output), slope])

    @cached_property
    def _rest(self) -> ca.Function:
        """States at rest, and their derivatives."""
        f = self.functions
        slope = ca.jacobian(f.chain_rest, self._free)
        return ca.Function("rest", [f.u, f.p, f.t], [ca.densify(f.chain_rest), ca.densify(slope)])

    @cached_property
    def _felt(self) -> list[int]:
        """Which of the free parameters the chain depends on."""
        f = self.functions
        return _dependence(f, self.free, ca.vertcat(f.chain_output, f.chain_rates, f.chain_rest))

    @property
    def _free(self) -> ca.SX:
        return _chosen(self.functions, [self.free[k] for k in self._felt])

    @cached_property
    def _carried(self) -> Carried:
        f, dt = self.functions, ca.SX.sym("dt")
        z = f.actuator_states
        rates, output = (
            ca.Function("step", [z, f.u, f.p, f.t], [v]) for v in (f.chain_rates, f.chain_output)
        )
        return Carried(
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
        slope = ca.jacobian(expression, _chosen(f, list(self.free)))
        return ca.Function("dead_time", [f.p], [expression, ca.densify(slope)])

    def _delayed(self, t: Array, driven: Driven, p: Array) -> Driven:
        if self.functions.vehicle.composition.dead_time == 0:
            return driven
        delay, slope = (np.asarray(v) for v in self._dead_time(p))
        seconds = float(delay[0, 0])
        value = shifted_mean(t, driven.value, seconds)
        moved, start = (
            shifted_mean(t, s.reshape(len(t), -1), seconds).reshape(s.shape)
            for s in (driven.slope, driven.start)
        )
        per_second = -shift_rate(t, driven.value, seconds)
        return Driven(value, moved + per_second[:, :, None] * slope.ravel(), start)

    def seconds_late(self, p: Array) -> float:
        """Dead time between commands and what they bring about, s."""
        return float(self._dead_time(p)[0]) if self.functions.vehicle.composition.dead_time != 0 else 0.0

    def _before(self, t: Array, driven: Driven, p: Array) -> Driven:
        """What a chain without states gave before each sample.

        A jump that falls between samples bends the velocity there: trapezoids over a kink at the share s of a
        step are off by 1 - 6 s (1 - s) times what they are off by over one at a sample.
        """
        if not self.moves:
            return Driven(np.concatenate([driven.value[:1], driven.value[:-1]]), driven.slope, driven.start)
        delay, slope = (np.asarray(v) for v in self._dead_time(p))
        share, per_second = share_of_step(t, float(delay[0, 0]))
        weight = 1.0 - 6.0 * share * (1.0 - share)
        value, by_free, by_start = (change(a) for a in (driven.value, driven.slope, driven.start))
        turned = (6.0 * (1.0 - 2.0 * share) * per_second)[:, None] * value
        return Driven(
            driven.value - weight[:, None] * value,
            driven.slope - weight[:, None, None] * by_free + turned[:, :, None] * slope.ravel(),
            driven.start - weight[:, None, None] * by_start,
        )


class Memory:
    """States of wrenches along the measured motion, at the samples of a segment.

    Parameters
    ----------
    functions : Functions
        The model.
    true_motion : CasADi expression
        Pose and velocity in terms of `measured`.
    """

    def __init__(
        self, functions: Functions, free: tuple[int, ...], measured: ca.SX, true_motion: ca.SX
    ) -> None:
        self.functions, self.free = functions, free
        self._measured, self._true_motion = measured, true_motion

    def along(self, t: Array, measured: Array, actuation: Array, u: Array, p: Array) -> Driven:
        """States at the samples, zero at the first; the motion is taken as linear between samples."""
        size, count = self.functions.memory.shape[0], len(t)
        if size == 0:
            return _nothing(count, len(self.free))
        columns = [measured[:-1], measured[1:], actuation[:-1], u[:-1]]
        start, slope = np.zeros(size), np.zeros((size, len(self._felt)))
        states, slopes, _, _ = self._carried.along(start, slope, columns, p, t[:-1], np.diff(t))
        return _driven(states, slopes, self._felt, len(self.free))

    @cached_property
    def _rates(self) -> ca.SX:
        f = self.functions
        return ca.substitute(f.memory_rates, ca.vertcat(f.eta, f.nu), self._true_motion)

    @cached_property
    def _felt(self) -> list[int]:
        """Which of the free parameters the memory depends on."""
        return _dependence(self.functions, self.free, self._rates)

    @cached_property
    def _carried(self) -> Carried:
        f, dt, after = self.functions, ca.SX.sym("dt"), ca.SX.sym("after", self._measured.shape[0])
        rate = ca.Function("rate", [f.memory, self._measured, f.actuation, f.u, f.p, f.t], [self._rates])

        def at(state: ca.SX, share: float) -> ca.SX:
            here = self._measured + share * (after - self._measured)
            return rate(state, here, f.actuation, f.u, f.p, f.t + share * dt)

        return Carried(
            f.memory,
            Inputs([self._measured, after, f.actuation, f.u], f.p, f.t, dt),
            _chosen(f, [self.free[k] for k in self._felt]),
            at,
            lambda state, share: ca.SX(0, 1),
        )


def _refuse_motion(functions: Functions) -> None:
    f = functions
    if ca.depends_on(ca.vertcat(f.chain_output, f.chain_rates), ca.vertcat(f.eta, f.nu)):
        raise UndertowError(
            f"an actuation effect of '{f.vehicle.name}' depends on the motion, which no fit can follow: "
            "state what the motion takes from the thrust as a Wrench in s.actuation"
        )


def _nothing(count: int, n_free: int) -> Driven:
    return Driven(np.zeros((count, 0)), np.zeros((count, 0, n_free)), np.zeros((count, 0, 0)))


def _chosen(functions: Functions, places: list[int]) -> ca.SX:
    return ca.vertcat(*[functions.p[i] for i in places]) if places else ca.SX(0, 1)


def _dependence(functions: Functions, free: tuple[int, ...], expression: ca.SX) -> list[int]:
    pattern = ca.jacobian_sparsity(expression, functions.p)
    used = set(pattern.get_col())
    return [k for k, place in enumerate(free) if place in used]


def _driven(value: Array, slopes: Array, felt: list[int], n_free: int) -> Driven:
    """Values, and slopes put in the columns of the parameters that they belong to."""
    slope = np.zeros((*value.shape, n_free))
    slope[:, :, felt] = slopes[:, :, : len(felt)]
    return Driven(value, slope, slopes[:, :, len(felt) :])
