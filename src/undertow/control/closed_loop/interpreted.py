"""A closed loop by numba around an interpreter of instructions: import this only where numba is installed.

The steps are those of loop.c, in the same order.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from undertow.codegen.instructions import ready, tape_of
from undertow.codegen.interpreted import REACH, WEIGHT
from undertow.codegen.interpreter import call, put
from undertow.codegen.numba_code import by_numba, tried
from undertow.typing import Array

from .parts import Parts
from .problem import ALL, Block, LoopProblem, Rows, problem_of

Tuple = tuple[Array, ...]
Tapes = tuple[Tuple, ...]


class InterpretedLoop:
    """Model, sensors, controller and integrator in one call for many samples of a run.

    Raises
    ------
    UndertowError
        If a function has an operation that the interpreter does not know, or there is no room for its cache.
    """

    lanes, parallel = 1, False

    def __init__(self, parts: Parts) -> None:
        self._parts = parts
        functions = (parts.dynamics, parts.outputs, parts.control, parts.law)
        self._tapes = tuple(map(tape_of, functions))
        tried(self._compile)

    def run(self, problem: LoopProblem, block: Block) -> Rows:
        rows = block.rows(self._parts, problem.runs)
        whole = replace(block, stride=1, wanted=ALL)
        chosen = np.array(block.recorded, dtype=np.int64) - block.first
        for run in range(problem.runs):
            found = self._one(problem, run, whole)
            for name in block.wanted:
                getattr(rows, name)[run] = getattr(found, name)[chosen]
        return rows

    def _one(self, problem: LoopProblem, run: int, block: Block) -> Rows:
        """All samples of one run; its state moves on."""
        dynamics, outputs, control, law = tapes = tuple(map(ready, self._tapes))
        for tape in (dynamics, outputs):
            put(tape, 2, problem.p[run])
        for tape in (control, law):
            put(tape, 1, problem.r[run])
            put(tape, 3, problem.k[run])
        rows, nu, ny = block.rows(self._parts, 1).of(0), problem.command.shape[1], problem.reports.shape[2]
        noise = np.zeros((block.samples, ny)) if block.noise is None else block.noise[run]
        extra = np.zeros((block.samples, nu)) if block.extra is None else block.extra
        found = tuple(np.zeros(len(tape[2])) for tape in tapes)
        state = tuple(a[run] for a in (problem.x, problem.s, problem.commands, problem.reports))
        space = (*found, *(np.zeros(len(a)) for a in (*state[:2], extra[0], extra[0])))
        delays = (problem.input_delay, problem.output_delay)
        steps = (problem.dt, problem.substeps, bool(problem.continuous))
        _run(tapes, space, steps, delays, state, tuple(vars(rows).values()), block.first, noise, extra)
        problem.command[run] = rows.u[-1]
        return rows

    def _compile(self) -> None:
        size = 2 * len(self._parts.vehicle.dof_indices)
        desired = np.zeros(self._parts.control.size1_in("r"))
        nothing = problem_of(self._parts, np.zeros((1, size)), desired, 1.0, 1, False)
        self.run(nothing, Block(0, 1))


@by_numba
def _held_step(tapes: Tapes, space: Tuple, x: Array, t: float, h: float) -> None:
    """One step of the vehicle with its commands held."""
    dynamics, f, total = tapes[0], space[0], space[4]
    memory, at = dynamics[1], dynamics[3]
    put(dynamics, 0, x)
    total[:] = 0
    for k in range(4):
        memory[at[3]] = t + REACH[k] * h
        call(dynamics, f)
        ahead = REACH[k + 1] * h if k < 3 else 0.0
        for i in range(len(x)):
            total[i] += WEIGHT[k] * f[i]
            memory[i] = x[i] + ahead * f[i]
    for i in range(len(x)):
        x[i] += h / 6 * total[i]


@by_numba
def _joint_step(tapes: Tapes, space: Tuple, x: Array, s: Array, extra: Array, t: float, h: float) -> None:
    """One step of vehicle and law together."""
    dynamics, outputs, _, law = tapes
    f, y, _, g, total, total_s, u, _ = space
    begin, n = law[3][2], len(u)
    put(dynamics, 0, x)
    put(outputs, 0, x)
    put(law, 2, s)
    total[:], total_s[:], u[:] = 0, 0, 0
    for k in range(4):
        dynamics[1][dynamics[3][3]] = outputs[1][outputs[3][3]] = t + REACH[k] * h
        put(outputs, 1, u)
        call(outputs, y)
        put(law, 0, y)
        call(law, g)
        for i in range(n):
            u[i] = g[i] + extra[i]
        put(dynamics, 1, u)
        call(dynamics, f)
        ahead = REACH[k + 1] * h if k < 3 else 0.0
        for i in range(len(x)):
            total[i] += WEIGHT[k] * f[i]
            dynamics[1][i] = outputs[1][i] = x[i] + ahead * f[i]
        for i in range(len(s)):
            total_s[i] += WEIGHT[k] * g[n + i]
            law[1][begin + i] = s[i] + ahead * g[n + i]
    for i in range(len(x)):
        x[i] += h / 6 * total[i]
    for i in range(len(s)):
        s[i] += h / 6 * total_s[i]


@by_numba
def _report(reports: Array, delays: Array, sample: int, y: Array, noise: Array, told: Array) -> None:
    """What the controller is told: the reports, each as old as its sensor is late, and noise."""
    size = len(reports)
    for i in range(len(y)):
        reports[sample % size, i] = y[i]
    for i in range(len(y)):
        told[i] = reports[max(sample - delays[i], 0) % size, i] + noise[i]


@by_numba
def _decide(
    control: Tuple, found: Array, told: Array, hold: float, s: Array, command: Array, tau: Array
) -> None:
    """The controller's turn; its states are advanced in place."""
    put(control, 0, told)
    put(control, 2, s)
    control[1][control[3][4]] = hold
    call(control, found)
    n = len(command)
    for i in range(n):
        command[i] = found[i]
    for i in range(len(s)):
        s[i] = found[n + i]
    for i in range(len(tau)):
        tau[i] = found[n + len(s) + i]


@by_numba
def _run(
    tapes: Tapes,
    space: Tuple,
    steps: tuple[float, int, bool],
    delays: tuple[int, Array],
    state: Tuple,
    rows: Tuple,
    first: int,
    noise: Array,
    extra: Array,
) -> None:
    """Samples from `first` on, as many as `noise` has rows."""
    dt, substeps, continuous = steps
    late, ages = delays
    x, s, commands, reports = state
    y, u, h, ring = space[1], space[7], dt / substeps, late + 1
    for n in range(len(noise)):
        sample = first + n
        t, told, command = sample * dt, rows[1][n], rows[2][n]
        rows[0][n] = x
        put(tapes[1], 0, x)
        put(tapes[1], 1, commands[(sample + ring - 1) % ring])
        tapes[1][1][tapes[1][3][3]] = t
        call(tapes[1], y)
        _report(reports, ages, sample, y, noise[n], told)
        _decide(tapes[2], space[2], told, 0.0 if continuous else dt, s, command, rows[4][n])
        rows[3][n] = s
        commands[sample % ring] = command
        for i in range(len(u)):
            u[i] = (commands[(sample + 1) % ring, i] if sample >= late else 0.0) + extra[n, i]
        put(tapes[0], 1, u)
        for k in range(substeps):
            if continuous:
                _joint_step(tapes, space, x, s, extra[n], t + k * h, h)
            else:
                _held_step(tapes, space, x, t + k * h, h)
