"""Simulation in NumPy, step by step like the compiled driver, where there is no compiler."""

from __future__ import annotations

import numpy as np

from undertow.typing import Array, Flags, Integers

from .buffers import Evaluator
from .functions import Functions
from .problem import Problem


class VirtualStepper:
    """The driver's steps in NumPy; CasADi's virtual machine evaluates all runs of a batch at once."""

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

    def _step(self, problem: Problem, i: int, t: Array, h: Array, x: Array, s: Array) -> tuple[Array, Array]:
        stage, z, total, total_s = x, s, np.zeros_like(x), np.zeros_like(s)
        h1, h2 = h[:, None], h[:, None, None]
        for reach, weight, ahead in ((0.0, 1, 0.5), (0.5, 2, 0.5), (0.5, 2, 1.0), (1.0, 1, 0.0)):
            f, *slopes = self._evaluate(stage, problem.u[:, i], problem.p, (t + reach * h)[:, None])
            dz = self._tangent_rate(slopes, z, problem.wrt)
            total += weight * f[:, :, 0]
            total_s += weight * dz
            stage, z = x + (ahead * h1) * f[:, :, 0], s + (ahead * h2) * dz
        return x + h1 / 6 * total, s + h2 / 6 * total_s

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
