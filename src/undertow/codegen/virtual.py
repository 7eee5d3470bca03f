"""Simulation by CasADi's virtual machine, where there is neither a C compiler nor a prebuilt engine."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from undertow.typing import Array, Flags, Integers

from .functions import Functions
from .library import Evaluator
from .problem import Problem

# Of the stages of a step: where in the step, how often it counts in six, and how far on the next one is.
_STAGES = ((0.0, 1, 0.5), (0.5, 2, 0.5), (0.5, 2, 1.0), (1.0, 1, 0.0))


def runge_kutta(
    rates: Callable[[Sequence[Any], float], Sequence[Any]], state: Sequence[Any], h: Sequence[Any]
) -> list[Any]:
    """One step of the classical fourth-order Runge-Kutta method, on numbers or on CasADi's expressions.

    Parameters
    ----------
    rates : callable
        Time derivatives of the parts of a state, given these and the part of the step that has passed.
    state, h : sequence
        The parts, and the length of the step in a form that each can be multiplied with.
    """
    stage, total = state, [0.0] * len(state)
    for reach, weight, ahead in _STAGES:
        rate = rates(stage, reach)
        total = [a + weight * f for a, f in zip(total, rate, strict=True)]
        stage = [z + (ahead * step) * f for z, step, f in zip(state, h, rate, strict=True)]
    return [z + step / 6 * a for z, step, a in zip(state, h, total, strict=True)]


class VirtualStepper:
    """Steps in NumPy; CasADi's virtual machine evaluates all runs of a batch at once."""

    def __init__(self, functions: Functions, *, sensitivities: bool) -> None:
        self._function = functions.tangents("x", "p") if sensitivities else functions.dynamics
        self._rows = functions.acceleration_rows
        self._evaluators: dict[int, Evaluator] = {}

    def advance(self, problem: Problem, first: int, last: int) -> None:
        with np.errstate(all="ignore"):
            for i in range(first, last):
                self._interval(problem, i)

    def _interval(self, problem: Problem, i: int) -> None:
        """From sample i to i + 1; runs with fewer steps than others wait, runs that diverged are NaN."""
        interval, count = problem.t[:, i + 1] - problem.t[:, i], problem.steps[:, i]
        x, s = problem.x[:, i].copy(), problem.s[:, i].copy()
        h = interval / count
        for k in range(count.max()):
            running = (k < count) & np.isfinite(x).all(axis=1)
            new = self._step(problem, i, problem.t[:, i] + k * h, h, x, s)
            x, s = (_where(running, a, b) for a, b in zip(new, (x, s), strict=True))
        finite = np.asarray(np.isfinite(x).all(axis=1))
        for target, last in ((problem.x, x), (problem.s, s)):
            target[:, i + 1] = _where(finite, last, np.full_like(last, np.nan))

    def _step(self, problem: Problem, i: int, t: Array, h: Array, x: Array, s: Array) -> list[Array]:
        def rates(z: Sequence[Array], reach: float) -> list[Array]:
            now = (t + reach * h)[:, None]
            f, *slopes = self._evaluate(z[0], problem.u[:, i], problem.p, now)
            return [f[:, :, 0], self._tangent_rate(slopes, z[1], problem.wrt)]

        return runge_kutta(rates, [x, s], [h[:, None], h[:, None, None]])

    def _evaluate(self, x: Array, *others: Array) -> list[Array]:
        if len(x) not in self._evaluators:
            self._evaluators[len(x)] = Evaluator(self._function, len(x))
        return self._evaluators[len(x)](x, *others)

    def _tangent_rate(self, slopes: list[Array], z: Array, wrt: Integers) -> Array:
        if not slopes:
            return np.zeros_like(z)
        inverse, r_x, r_p = slopes
        rate = r_x @ z
        known = wrt >= 0
        rate[:, :, known] += r_p[:, :, wrt[known]]
        rate[:, self._rows] = inverse @ rate[:, self._rows]
        return rate


def _where(runs: Flags, then: Array, otherwise: Array) -> Array:
    """`then` for the selected runs, `otherwise` for the others."""
    return np.where(runs.reshape(-1, *[1] * (then.ndim - 1)), then, otherwise)
