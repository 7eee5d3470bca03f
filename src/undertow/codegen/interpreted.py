"""Simulation by numba around an interpreter of instructions: import this only where numba is installed.

The steps are those of driver.c, in the same order.
"""

from __future__ import annotations

import math

import numpy as np

from undertow.typing import Array, Integers

from .functions import Functions
from .instructions import ready, tape_of
from .interpreter import call, put
from .numba_code import by_numba, tried
from .problem import Problem

REACH, WEIGHT = (0.0, 0.5, 0.5, 1.0), (1.0, 2.0, 2.0, 1.0)
"""Of the stages of a Runge-Kutta step: where in the step, and how often each counts in six."""

Tuple = tuple[np.ndarray, ...]


class InterpretedStepper:
    """The driver's steps in one call for all samples of all runs; nothing is compiled for a vehicle.

    Raises
    ------
    UndertowError
        If a model has an operation that the interpreter does not know, or there is no room for its cache.
    """

    def __init__(self, functions: Functions, *, sensitivities: bool) -> None:
        function = functions.tangents("x", "p") if sensitivities else functions.dynamics
        tape = tape_of(function)
        n = functions.nu_dot.numel()
        patterns = [function.sparsity_out(i).get_ccs() for i in ((2, 3) if sensitivities else ())]
        lists = [part for pattern in patterns for part in pattern] or [[0], []] * 2
        self._tape = tape
        self._slopes = (np.array([n, *tape.outputs]), *(np.array(part, dtype=np.int64) for part in lists))
        tried(lambda: self.advance(self._nothing(functions), 0, 0))

    def advance(self, problem: Problem, first: int, last: int) -> None:
        for b in range(len(problem.x)):
            self._run(problem, b, slice(first, last), slice(first, last + 1))

    def _run(self, problem: Problem, b: int, steps: slice, samples: slice) -> None:
        tape, shape = ready(self._tape), problem.s.shape[2:]
        put(tape, 2, problem.p[b % len(problem.p)].copy())
        work = (np.empty(len(tape[2])), np.empty(shape[0]), *np.empty((4, *shape)))
        timing = b % len(problem.t)
        # Copies: to numba what is not to be written is of another type, and compiled for again.
        grid = (problem.t[timing, samples].copy(), problem.steps[timing, steps].copy())
        u = problem.u[b % len(problem.u), steps].copy()
        _simulate(
            tape, self._slopes, work, grid, u, problem.wrt, problem.x[b, samples], problem.s[b, samples]
        )

    @staticmethod
    def _nothing(functions: Functions) -> Problem:
        nx, one = len(functions.state_names), np.zeros((1, 1))
        u, p = np.zeros((1, 1, functions.u.numel())), np.zeros((1, functions.p.numel()))
        none = np.zeros((1, 0), dtype=np.int64)
        return Problem(one, none, u, p, np.zeros((1, 1, nx)), none[0], np.zeros((1, 1, nx, 0)))


@by_numba
def _add_multiple(factor: float, given: Array, row: int, total: Array, to: int) -> None:
    for c in range(given.shape[1]):
        total[to, c] += factor * given[row, c]


@by_numba
def _tangent_rate(slopes: Tuple, found: Array, wrt: Integers, z: Array, dz: Array, force: Array) -> None:
    """dz = d(x_dot)/dx z + d(x_dot)/dp, column by column of what the sensitivities are wanted for."""
    begin, x_column, x_row, p_column, p_row = slopes
    n, w, rx, rp = begin[0], begin[2], begin[3], begin[4]
    dz[:] = 0
    for j in range(len(z)):
        for k in range(x_column[j], x_column[j + 1]):
            _add_multiple(found[rx + k], z, j, dz, x_row[k])
    for c in range(len(wrt)):
        if wrt[c] >= 0:
            for k in range(p_column[wrt[c]], p_column[wrt[c] + 1]):
                dz[p_row[k], c] += found[rp + k]
    # The rows of the acceleration hold forces so far; W turns them into accelerations.
    force[:] = 0
    for i in range(n):
        for j in range(n):
            _add_multiple(found[w + j * n + i], dz, n + j, force, i)
    for i in range(n):
        for c in range(len(wrt)):
            dz[n + i, c] = force[i, c]


@by_numba
def _step(
    tape: Tuple, slopes: Tuple, wrt: Integers, work: Tuple, t: float, h: float, x: Array, s: Array
) -> None:
    """One step of length h from t; states and sensitivities are advanced in place."""
    memory, at = tape[1], tape[3]
    found, total, z, dz, total_s, force = work
    for i in range(len(x)):
        memory[i], total[i] = x[i], 0
        for c in range(len(wrt)):
            z[i, c], total_s[i, c] = s[i, c], 0
    for k in range(4):
        memory[at[3]] = t + REACH[k] * h
        call(tape, found)
        ahead = REACH[k + 1] * h if k < 3 else 0.0
        if len(wrt):
            _tangent_rate(slopes, found, wrt, z, dz, force)
        for i in range(len(x)):
            total[i] += WEIGHT[k] * found[i]
            memory[i] = x[i] + ahead * found[i]
            for c in range(len(wrt)):
                total_s[i, c] += WEIGHT[k] * dz[i, c]
                z[i, c] = s[i, c] + ahead * dz[i, c]
    for i in range(len(x)):
        x[i] += h / 6 * total[i]
        for c in range(len(wrt)):
            s[i, c] += h / 6 * total_s[i, c]


@by_numba
def _finite(x: Array) -> bool:
    beyond = 0.0
    for value in x:
        beyond += value - value
    return beyond == 0


@by_numba
def _simulate(
    tape: Tuple, slopes: Tuple, work: Tuple, grid: Tuple, u: Array, wrt: Integers, x: Array, s: Array
) -> None:
    """All samples of one run; states that are not finite become NaN and stay so."""
    t, steps = grid
    for i in range(len(steps)):
        put(tape, 1, u[i])
        for j in range(x.shape[1]):
            x[i + 1, j] = x[i, j]
            for c in range(len(wrt)):
                s[i + 1, j, c] = s[i, j, c]
        h = (t[i + 1] - t[i]) / steps[i]
        done = 0
        while done < steps[i] and _finite(x[i + 1]):
            _step(tape, slopes, wrt, work, t[i] + done * h, h, x[i + 1], s[i + 1])
            done += 1
        if not _finite(x[i + 1]):
            for j in range(x.shape[1]):
                x[i + 1, j] = math.nan
                for c in range(len(wrt)):
                    s[i + 1, j, c] = math.nan
