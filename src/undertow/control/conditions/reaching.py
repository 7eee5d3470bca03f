"""Whether a sliding-mode law reaches its surface although the parameters are not quite as known."""

from __future__ import annotations

import numpy as np
import sympy as sm
from scipy.special import ndtri

from undertow.model.evaluation import function_of
from undertow.model.symbols import symbol
from undertow.typing import Array

from .case import SignSet
from .interval import FUNCTIONS, Interval
from .problem import Problem
from .result import FAILS, HOLDS, Row
from .uncertain import Uncertainty

_STATEMENT = "K_Z M > |error of g|"
_ABOUT = (
    "With M, D, g off by dM, dD, dg the surface is still reached in a straight run at speed s while "
    "K_Z M > |dg| + (|dD| + Λ |dM|) s."
)


def reaching(problem: Problem, uncertainty: Uncertainty) -> list[Row]:
    """One row for each channel and the sets of parameters that differ; none where g is known exactly.

    M and D of the law in the motion of the true vehicle give
    M S_dot = -M^ K_Z sgn S + (M^ - M) Lambda nu - (D^ - D) nu - (g^ - g), with ^ for the law's own.
    """
    if "K_Z" not in problem.values or not problem.decoupled:
        return []
    weight = _weight_error(problem, uncertainty)
    if not weight.any():
        return []
    chosen = problem.sets[:1] if len(problem.sets) == 1 else problem.sets[:2]
    return [_row(problem, one, i, float(weight[i]), uncertainty) for one in chosen for i in problem.driven]


def _row(problem: Problem, one: SignSet, i: int, weight: float, uncertainty: Uncertainty) -> Row:
    drive = float(problem.values["K_Z"][i] * one.inertia[i, i])
    reach = _reach(uncertainty, one.names)
    slopes = np.abs(one.D.slopes[:, i, i]) + problem.values["Lambda"][i] * np.abs(one.M.slopes[:, i, i])
    per_speed = float(slopes @ reach)
    speed = (drive - weight) / per_speed if per_speed > 0 else np.inf
    where = f"reached up to {speed:.3g} {'m/s' if i < 3 and problem.coordinates[i] in 'xyz' else 'rad/s'}"
    holds = drive > weight
    return Row(
        "derived",
        "reaching",
        _STATEMENT,
        _ABOUT,
        "derived here",
        problem.coordinates[i],
        one.name,
        drive,
        weight,
        drive - weight,
        HOLDS if holds else FAILS,
        where=where if holds else "not even at rest",
    )


def _reach(uncertainty: Uncertainty, names: tuple[str, ...]) -> Array:
    spread = np.sqrt(np.diag(uncertainty.covariance(names))) if names else np.zeros(0)
    return ndtri(0.5 + uncertainty.confidence / 2) * spread


def _weight_error(problem: Problem, uncertainty: Uncertainty) -> Array:
    """Largest error of each row of g over all attitudes, when every parameter is within its interval."""
    plant = problem.plant
    symbols = sorted(plant.g.free_symbols & set(plant.numbers), key=str)
    reach = _reach(uncertainty, tuple(map(str, symbols)))
    total = np.zeros(len(plant.g))
    for x, r in zip(symbols, reach, strict=True):
        slope = plant.g.diff(x).xreplace(plant.numbers)
        total += r * np.array([_largest(e, problem) for e in slope])
    return total


def _largest(expression: sm.Expr, problem: Problem) -> float:
    """Bound on the magnitude of an expression of the attitude."""
    angles = [symbol(a) for a in ("phi", "theta", "psi")]
    if expression.free_symbols - set(angles):
        return np.inf
    tilt = problem.attitudes.tilt
    ranges = [Interval(-tilt, tilt), Interval(-tilt, tilt), Interval(-np.pi, np.pi)]
    found = function_of(angles, expression, FUNCTIONS)(*ranges)
    return float(np.max(np.abs([found.lo, found.hi]))) if isinstance(found, Interval) else abs(float(found))
