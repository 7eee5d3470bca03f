"""Linearised channels: Routh arrays, and whether a sliding surface is reached."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import sympy as sm
from scipy.special import ndtri

from undertow.control.plant import Plant
from undertow.model.composition import function_of
from undertow.model.symbols import symbol
from undertow.typing import Array

from .attitude import FUNCTIONS, Interval
from .problem import Problem, SignSet, Uncertainty
from .result import FAILS, HOLDS, Row


def routh_array(coefficients: Sequence[Any]) -> list[list[Any]]:
    """The Routh array of a polynomial, numbers or symbols.

    Parameters
    ----------
    coefficients : sequence
        Highest power first; the first is not zero.

    Returns
    -------
    list of list
        One row for each power. A row of zeros is replaced by the derivative of the row above it, and a zero
        at the beginning of a row by a small positive symbol-free number times the largest coefficient.
    """
    terms = list(coefficients)
    width = (len(terms) + 1) // 2
    rows = [_padded(terms[0::2], width), _padded(terms[1::2], width)]
    for power in range(len(terms) - 3, -1, -1):
        above, last = rows[-2], rows[-1]
        if all(c == 0 for c in last):
            last = rows[-1] = [c * max(power + 2 - 2 * k, 0) for k, c in enumerate(above)]
        if last[0] == 0:
            last[0] = 1e-12 * max(abs(c) for c in terms)
        rows.append(
            _padded(
                [(last[0] * above[k + 1] - above[0] * last[k + 1]) / last[0] for k in range(width - 1)], width
            )
        )
    return rows[: len(terms)]


def unstable_roots(coefficients: Sequence[float]) -> int:
    """Number of roots in the open right half-plane: sign changes in the first column of the Routh array."""
    first = [row[0] for row in routh_array(coefficients)]
    return sum(a * b < 0 for a, b in pairwise(first))


def _padded(row: list[Any], width: int) -> list[Any]:
    return row + [0] * (width - len(row))


def channel_polynomial(gains: dict[str, float], inertia: float, damping: float) -> list[float] | None:
    """Characteristic polynomial of a linearised channel, highest power first; None for sliding laws."""
    if "K_P" not in gains:
        return None
    polynomial = [inertia, gains["K_V"] + damping, gains["K_P"]]
    return [*polynomial, gains["K_I"]] if "K_I" in gains else polynomial


def roots(coefficients: Sequence[float]) -> list[complex]:
    """Roots of a polynomial, those that grow fastest first."""
    found = [complex(r) for r in np.roots(np.array(coefficients))]
    return sorted(found, key=lambda r: (-r.real, -r.imag))


def coupled_roots(
    gains: dict[str, Array], inertia: Array, damping: Array, plant: Plant, J: Array | None = None
) -> list[complex]:
    """Eigenvalues of the loop linearised at rest, all axes together.

    What no thruster can push keeps its own dynamics.

    Parameters
    ----------
    gains : dict of array
        Diagonals of the gain matrices by name, pose coordinates.
    inertia, damping : array, shape (n, n)
        M and D(0), body frame.
    plant : Plant
        What is pushed.
    J : array, shape (n, n), optional
        The attitude; heading north on an even keel unless given.
    """
    n = len(inertia)
    J = np.eye(n) if J is None else J
    pushed = np.diag([float(any(row)) for row in plant.B.tolist()])
    zero, one = np.zeros((n, n)), np.eye(n)
    push = np.linalg.inv(inertia) @ pushed @ J.T
    own = np.linalg.inv(inertia) @ damping
    integral = np.diag(gains.get("K_I", np.zeros(n)))
    rows = [
        [zero, J, zero],
        [-push @ np.diag(gains["K_P"]), -push @ np.diag(gains["K_V"]) @ J - own, -push @ integral],
        [one, zero, zero],
    ]
    matrix = np.block(rows)
    if "K_I" not in gains:
        matrix = matrix[: 2 * n, : 2 * n]
    return sorted((complex(v) for v in np.linalg.eigvals(matrix)), key=lambda r: (-r.real, -r.imag))


def routh_symbols() -> sm.Expr:
    """The third entry of the first column for M s^3 + K s^2 + k_p s + k_i, symbolically."""
    M, K, p, i = sm.symbols("M K k_p k_i", positive=True)
    return sm.simplify(routh_array([M, K, p, i])[2][0])


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
