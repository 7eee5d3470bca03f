"""Whether damping at speed is at least that at rest, which is what conditions on V_dot are stated with."""

from __future__ import annotations

import numpy as np
import sympy as sm

from .case import SignSet
from .problem import Problem

Array = np.ndarray
_SEED, _TRIALS, _FASTEST = 20210405, 500, 3.0


def damping_at_speed(problem: Problem) -> str:
    """One sentence on D(nu) - D(0): proved, not refuted by random velocities, or refuted by one."""
    texts = [_one(problem, one) for one in problem.sets]
    return next((t for t in texts if t.startswith("may be")), max(texts, key=len))


def _one(problem: Problem, one: SignSet) -> str:
    plant = problem.plant
    D = plant.one_way(plant.D, one.way).xreplace(plant.numbers)
    more = (D - D.xreplace(dict.fromkeys(plant.nu, sm.Integer(0)))).applyfunc(sm.expand)
    if more.is_diagonal() and all(_never_negative(e, plant.nu) for e in more.diagonal()):
        return "never less than at rest, so the conditions at rest serve at any speed"
    names = list(plant.nu)
    velocities = np.random.default_rng(_SEED).uniform(-_FASTEST, _FASTEST, (_TRIALS, len(names)))
    for i, v in enumerate(names):
        if v in one.way:
            velocities[:, i] = one.way[v] * np.abs(velocities[:, i])
    function = sm.lambdify(names, more.tolist(), "numpy")
    values = np.array([np.array(function(*row), dtype=float) for row in velocities])
    least = np.linalg.eigvalsh(0.5 * (values + np.swapaxes(values, 1, 2)))[:, 0]
    if least.min() >= -1e-9:
        return f"not less than at rest at {_TRIALS} random velocities; that is no proof"
    worst = velocities[int(least.argmin())]
    at = ", ".join(f"{n} = {x:.3g}" for n, x in zip(names, worst, strict=True))
    return f"may be less than at rest (by {-least.min():.3g} at {at}): the conditions hold at low speed only"


def _never_negative(entry: sm.Expr, nu: sm.Matrix) -> bool:
    """Whether a polynomial in magnitudes and even powers of velocities has no negative coefficient."""
    sizes = {sm.Abs(v): sm.Symbol(f"size_{v}", nonnegative=True) for v in nu}
    squares = {v: sm.Symbol(f"size_{v}", nonnegative=True) for v in nu}
    plain = sm.expand(entry).xreplace(sizes)
    if any(sm.expand(plain - plain.xreplace({v: -v})) != 0 for v in nu):
        return False  # an odd power changes its sign
    return bool(sm.expand(plain.xreplace(squares)).is_nonnegative)
