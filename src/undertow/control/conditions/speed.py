"""Whether damping at speed is at least that at rest, which is what conditions on V_dot are stated with."""

from __future__ import annotations

import numpy as np

from undertow.model.evaluation import function_of

from .case import SignSet
from .fast import extra_damping, never_negative
from .problem import Problem

Array = np.ndarray
_SEED, _TRIALS, _FASTEST = 20210405, 500, 3.0


def damping_at_speed(problem: Problem) -> str:
    """One sentence on D(nu) - D(0): proved, not refuted by random velocities, or refuted by one."""
    texts = [_one(problem, one) for one in problem.sets]
    return next((t for t in texts if t.startswith("may be")), max(texts, key=len))


def _one(problem: Problem, one: SignSet) -> str:
    plant = problem.plant
    more = extra_damping(plant, one)
    if never_negative(more, plant.nu):
        return "never less than at rest, so the conditions at rest serve at any speed"
    names = list(plant.nu)
    velocities = np.random.default_rng(_SEED).uniform(-_FASTEST, _FASTEST, (_TRIALS, len(names)))
    for i, v in enumerate(names):
        if v in one.way:
            velocities[:, i] = one.way[v] * np.abs(velocities[:, i])
    function = function_of(names, more.tolist(), "numpy")
    values = np.array([np.array(function(*row), dtype=float) for row in velocities])
    least = np.linalg.eigvalsh(0.5 * (values + np.swapaxes(values, 1, 2)))[:, 0]
    if least.min() >= -1e-9:
        return f"not less than at rest at {_TRIALS} random velocities; that is no proof"
    worst = velocities[int(least.argmin())]
    at = ", ".join(f"{n} = {x:.3g}" for n, x in zip(names, worst, strict=True))
    return f"may be less than at rest (by {-least.min():.3g} at {at}): the conditions hold at low speed only"
