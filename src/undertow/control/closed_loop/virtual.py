"""Closed loops by CasADi's virtual machine, sample by sample like compiled ones, without a compiler."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from undertow.codegen.library import Evaluator
from undertow.codegen.virtual import runge_kutta

from .parts import Parts
from .problem import Block, LoopProblem, Rows


class VirtualLoop:
    """The steps of loop.c in NumPy; CasADi evaluates a function for all runs at once."""

    lanes, parallel = 1, False

    def __init__(self, parts: Parts) -> None:
        self._parts = parts
        self._functions = {
            "outputs": parts.outputs,
            "control": parts.control,
            "held": _held_step(parts),
            "joint": _joint_step(parts),
        }
        self._evaluators: dict[tuple[str, int], Evaluator] = {}

    def run(self, problem: LoopProblem, block: Block) -> Rows:
        rows, row = block.rows(self._parts, problem.runs), 0
        with np.errstate(all="ignore"):
            for i in range(block.samples):
                values = self._sample(problem, block, i)
                if block.first + i in block.recorded:
                    for name in block.wanted:
                        getattr(rows, name)[:, row] = values[name]
                    row += 1
        return rows

    def _evaluate(self, name: str, *inputs: np.ndarray | float) -> list[np.ndarray]:
        """Outputs of shape (b, n) for inputs of shape (b, n)."""
        runs = len(inputs[0]) if isinstance(inputs[0], np.ndarray) else 1
        key = name, runs
        if key not in self._evaluators:
            self._evaluators[key] = Evaluator(self._functions[name], runs)
        return [column[:, :, 0] for column in self._evaluators[key](*inputs)]

    def _sample(self, problem: LoopProblem, block: Block, i: int) -> dict[str, np.ndarray]:
        sample, ring = block.first + i, problem.input_delay + 1
        t, x = sample * problem.dt, problem.x.copy()
        told = self._told(problem, sample, t)
        if block.noise is not None:
            told = told + block.noise[:, i]
        hold = 0.0 if problem.continuous else problem.dt
        u, s, tau = self._evaluate("control", told, problem.r, problem.s, problem.k, hold)
        problem.s[:] = s
        problem.command[:] = problem.commands[:, sample % ring] = u
        sent = problem.commands[:, (sample + 1) % ring] if sample >= problem.input_delay else np.zeros_like(u)
        extra = np.zeros(u.shape[1]) if block.extra is None else block.extra[i]
        self._advance(problem, sent + extra, extra, t)
        return {"x": x, "y": told, "u": u, "s": s, "tau": tau}

    def _told(self, problem: LoopProblem, sample: int, t: float) -> np.ndarray:
        (y,) = self._evaluate("outputs", problem.x, problem.command, problem.p, t)
        size = problem.reports.shape[1]
        problem.reports[:, sample % size] = y
        since = np.maximum(sample - problem.output_delay, 0)
        return problem.reports[:, since % size, np.arange(len(since))]

    def _advance(self, problem: LoopProblem, u: np.ndarray, extra: np.ndarray, t: float) -> None:
        h = problem.dt / problem.substeps
        for k in range(problem.substeps):
            at = t + k * h
            if problem.continuous:
                others = (problem.r, problem.k, extra, problem.p, at, h)
                x, problem.s[:] = self._evaluate("joint", problem.x, problem.s, *others)
            else:
                (x,) = self._evaluate("held", problem.x, u, problem.p, at, h)
            problem.x[:] = x


def _held_step(parts: Parts) -> ca.Function:
    """`x_next = step(x, u, p, t, h)` with the commands held."""
    f = parts.functions
    sizes = {"x": f.x.numel(), "u": f.u.numel(), "p": f.p.numel(), "t": 1, "h": 1}
    x, u, p, t, h = (ca.SX.sym(name, size) for name, size in sizes.items())
    (following,) = runge_kutta(lambda z, reach: [parts.dynamics(*z, u, p, t + reach * h)], [x], [h])
    return ca.Function("held", [x, u, p, t, h], [ca.densify(following)])


def _joint_step(parts: Parts) -> ca.Function:
    """`(x_next, s_next) = step(x, s, r, k, extra, p, t, h)` with the law at every stage."""
    f, law = parts.functions, parts.law
    x, extra, p = ca.SX.sym("x", f.x.numel()), ca.SX.sym("e", f.u.numel()), ca.SX.sym("p", f.p.numel())
    s, r, k = (ca.SX.sym(n, law.size1_in(n)) for n in "srk")
    t, h = ca.SX.sym("t"), ca.SX.sym("h")
    u = ca.SX.zeros(extra.shape)

    def rates(z: Sequence[ca.SX], reach: float) -> list[ca.SX]:
        nonlocal u
        now = t + reach * h
        commands, s_dot, _ = law(parts.outputs(z[0], u, p, now), r, z[1], k)
        u = commands + extra
        return [parts.dynamics(z[0], u, p, now), s_dot]

    following = runge_kutta(rates, [x, s], [h, h])
    return ca.Function("joint", [x, s, r, k, extra, p, t, h], [*map(ca.densify, following)])
