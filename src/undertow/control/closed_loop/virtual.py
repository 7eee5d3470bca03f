"""A closed loop by CasADi's virtual machine, sample by sample like the compiled one, without a compiler."""

from __future__ import annotations

import casadi as ca
import numpy as np

from undertow.codegen.buffers import Evaluator

from .parts import Parts
from .problem import LoopProblem, Rows

_STAGES = ((1, 0.5), (2, 0.5), (2, 1.0), (1, 0.0))
_REACH = (0.0, 0.5, 0.5, 1.0)


class VirtualLoop:
    """The steps of loop.c in Python; the functions are evaluated by CasADi."""

    def __init__(self, parts: Parts) -> None:
        self._parts = parts
        self._outputs, self._control = Evaluator(parts.outputs), Evaluator(parts.control)
        self._held, self._joint = Evaluator(_held_step(parts)), Evaluator(_joint_step(parts))

    def run(self, problem: LoopProblem, first: int, noise: np.ndarray, extra: np.ndarray) -> Rows:
        rows = Rows.empty(self._parts, len(noise))
        with np.errstate(all="ignore"):
            for i in range(len(noise)):
                self._sample(problem, rows, i, first + i, noise[i], extra[i])
        return rows

    def _sample(
        self, problem: LoopProblem, rows: Rows, i: int, sample: int, noise: np.ndarray, extra: np.ndarray
    ) -> None:
        ring, t = problem.input_delay + 1, sample * problem.dt
        rows.x[i] = problem.x
        last = problem.commands[(sample + ring - 1) % ring]
        rows.y[i] = self._told(problem, sample, last, t) + noise
        hold = 0.0 if problem.continuous else problem.dt
        found = self._control(rows.y[i], problem.r, problem.s, problem.k, hold)
        rows.u[i], rows.s[i], rows.tau[i] = (column[0, :, 0] for column in found)
        problem.s[:] = rows.s[i]
        problem.commands[sample % ring] = rows.u[i]
        sent = problem.commands[(sample + 1) % ring] if sample >= problem.input_delay else 0.0
        self._advance(problem, sent + extra, extra, t)

    def _told(self, problem: LoopProblem, sample: int, last: np.ndarray, t: float) -> np.ndarray:
        (y,) = self._outputs(problem.x, last, problem.p, t)
        size = len(problem.reports)
        problem.reports[sample % size] = y[0, :, 0]
        since = np.maximum(sample - problem.output_delay, 0)
        return problem.reports[since % size, np.arange(len(since))]

    def _advance(self, problem: LoopProblem, u: np.ndarray, extra: np.ndarray, t: float) -> None:
        h = problem.dt / problem.substeps
        for k in range(problem.substeps):
            at = t + k * h
            if problem.continuous:
                others = (problem.r, problem.k, extra, problem.p, at, h)
                x, s = self._joint(problem.x, problem.s, *others)
                problem.s[:] = s[0, :, 0]
            else:
                (x,) = self._held(problem.x, u, problem.p, at, h)
            problem.x[:] = x[0, :, 0]


def _held_step(parts: Parts) -> ca.Function:
    """`x_next = step(x, u, p, t, h)` with the commands held."""
    f = parts.functions
    sizes = {"x": f.x.numel(), "u": f.u.numel(), "p": f.p.numel(), "t": 1, "h": 1}
    x, u, p, t, h = (ca.SX.sym(name, size) for name, size in sizes.items())
    stage, total = x, ca.SX.zeros(x.shape)
    for (weight, ahead), reach in zip(_STAGES, _REACH, strict=True):
        rate = parts.dynamics(stage, u, p, t + reach * h)
        total, stage = total + weight * rate, x + ahead * h * rate
    return ca.Function("held", [x, u, p, t, h], [ca.densify(x + h / 6 * total)])


def _joint_step(parts: Parts) -> ca.Function:
    """`(x_next, s_next) = step(x, s, r, k, extra, p, t, h)` with the law at every stage."""
    f, law = parts.functions, parts.law
    x, extra, p = ca.SX.sym("x", f.x.numel()), ca.SX.sym("e", f.u.numel()), ca.SX.sym("p", f.p.numel())
    s, r, k = (ca.SX.sym(n, law.size1_in(n)) for n in "srk")
    t, h = ca.SX.sym("t"), ca.SX.sym("h")
    z, w, total, total_s, u = x, s, ca.SX.zeros(x.shape), ca.SX.zeros(s.shape), ca.SX.zeros(extra.shape)
    for (weight, ahead), reach in zip(_STAGES, _REACH, strict=True):
        commands, s_dot, _ = law(parts.outputs(z, u, p, t + reach * h), r, w, k)
        u = commands + extra
        x_dot = parts.dynamics(z, u, p, t + reach * h)
        total, z = total + weight * x_dot, x + ahead * h * x_dot
        total_s, w = total_s + weight * s_dot, s + ahead * h * s_dot
    following = [ca.densify(x + h / 6 * total), ca.densify(s + h / 6 * total_s)]
    return ca.Function("joint", [x, s, r, k, extra, p, t, h], following)
