"""The loop linearised at rest: Routh arrays, coupled axes, axes that nothing pushes; reaching a surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import sympy as sm
from scipy.special import ndtri

from undertow.control.gains import GainSet, allocation_of
from undertow.control.plant import Plant
from undertow.model.composition import function_of
from undertow.model.symbols import symbol
from undertow.typing import Array

from .attitude import ANGLES, FUNCTIONS, enclose, plus_minus
from .problem import Problem, SignSet, Uncertainty, sign_sets
from .result import FAILS, HOLDS, SETTINGS, Channel, Row, ZeroDynamics


def routh_array(coefficients: Sequence[Any]) -> list[list[Any]]:
    """The Routh array of a polynomial, numbers or symbols, highest power first; one row for each power.

    A row of zeros is replaced by the derivative of the row above it, and a zero at the beginning of a row by
    a small positive number times the largest coefficient.
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
        following = [(last[0] * above[k + 1] - above[0] * last[k + 1]) / last[0] for k in range(width - 1)]
        rows.append(_padded(following, width))
    return rows[: len(terms)]


def _padded(row: list[Any], width: int) -> list[Any]:
    return row + [0] * (width - len(row))


def roots(coefficients: Sequence[float]) -> list[complex]:
    """Roots of a polynomial, those that grow fastest first."""
    return _fastest_first(np.roots(np.array(coefficients)))


def _fastest_first(values: Any) -> list[complex]:
    return sorted((complex(v) for v in values), key=lambda r: (-r.real, -r.imag))


# --- one axis at a time -----------------------------------------------------------------------
def linear_channels(problem: Problem) -> list[Channel]:
    """Every channel of a law without a jump, once where both sets of parameters agree."""
    if "K_P" not in problem.values:
        return []
    found = []
    for i, axis, name in problem.channels:
        own = [_channel(problem, signs, i, axis, name) for signs in problem.sets[:2]]
        if len(own) == 2 and own[0].polynomial == own[1].polynomial:
            own = [replace(own[0], signs="both")]
        found += own
    return found


def _channel(problem: Problem, signs: SignSet, i: int, axis: int, name: str) -> Channel:
    gains = {gain: float(v[i]) for gain, v in problem.values.items()}
    damping = gains["K_V"] + float(signs.damping[axis, axis])
    polynomial = [float(signs.inertia[axis, axis]), damping, gains["K_P"]]
    polynomial += [gains["K_I"]] if "K_I" in gains else []
    first = [float(row[0]) for row in routh_array(polynomial)]
    found = roots(polynomial)
    stable = all(a * b > 0 for a, b in pairwise(first)) and found[0].real < 0
    return Channel(name, signs.name, polynomial, first, found, stable)


# --- all axes together ------------------------------------------------------------------------
def coupled(problem: Problem) -> dict[str, list[complex]]:
    """Roots with all axes together, where M or D couple them or gains tell north from east.

    Of all headings, where they matter, the one with the root that grows fastest. Velocities whose signs
    differ have a set of their own, which is named where its root is beyond those of all forward or backward.
    """
    if (problem.decoupled and not problem.heading_matters) or "K_P" not in problem.values:
        return {}
    achieved, (_, stiffness) = _achieved_force(problem.gains), _restoring(problem.plant)
    found: dict[str, list[complex]] = {}
    for signs in problem.sets:
        cases = [
            (coupled_roots(problem.values, signs.inertia, signs.damping, achieved, stiffness, J), degrees)
            for degrees, J in problem.headings
        ]
        roots_there, degrees = max(cases, key=lambda case: case[0][0].real)
        of = "" if not problem.heading_matters else f"worst of {len(cases)} headings: {degrees:.0f} deg"
        if len(found) < 2 or roots_there[0].real > max(r[0].real for r in found.values()):
            found[", ".join(filter(None, (signs.name, of)))] = roots_there
    return found


def coupled_roots(
    gains: dict[str, Array],
    inertia: Array,
    damping: Array,
    achieved: Array,
    stiffness: Array,
    J: Array | None = None,
) -> list[complex]:
    """Eigenvalues of the loop linearised at rest, all axes together.

    `gains` are diagonals in pose coordinates; inertia, damping, the force `achieved` for a wanted one and the
    stiffness of weight and buoyancy are of the body frame, shape (n, n). The law takes the weight off where
    its force is given; what is not given keeps its own. Without J the vehicle heads north on an even keel.
    """
    n = len(inertia)
    J = np.eye(n) if J is None else J
    zero, identity = np.zeros((n, n)), np.eye(n)
    drive = np.linalg.solve(inertia, achieved @ J.T)
    drag = np.linalg.solve(inertia, damping)
    spring = np.linalg.solve(inertia, (identity - achieved) @ stiffness)
    integral = np.diag(gains.get("K_I", np.zeros(n)))
    rows = [
        [zero, J, zero],
        [
            -drive @ np.diag(gains["K_P"]) - spring,
            -drive @ np.diag(gains["K_V"]) @ J - drag,
            -drive @ integral,
        ],
        [identity, zero, zero],
    ]
    matrix = np.block(rows)
    if "K_I" not in gains:
        matrix = matrix[: 2 * n, : 2 * n]
    return _fastest_first(np.linalg.eigvals(matrix))


def _achieved_force(gains: GainSet) -> Array:
    """Force that the thrusters give for a unit of each wanted one, shape (n, n)."""
    n = len(gains.plant.nu)
    if len(gains.unactuated) in (0, n):  # all of it, or none
        return np.eye(n) * (not gains.unactuated)
    return np.asarray(allocation_of(gains).achieved)


# --- what nothing pushes ----------------------------------------------------------------------
def zero_dynamics(gains: GainSet) -> ZeroDynamics | None:
    """The zero dynamics of the axes that nothing pushes, the others at their set-points; None without.

    What holds the others there may push along an axis that nothing pushes, too.
    """
    if not gains.unactuated:
        return None
    plant = gains.plant
    unactuated = [plant.vehicle.degrees_of_freedom.index(d) for d in gains.unactuated]
    unachieved = (np.eye(len(plant.nu)) - _achieved_force(gains))[unactuated]
    force, stiffness = (unachieved @ m for m in _restoring(plant))
    poles: list[complex] = []
    for signs in sign_sets(plant):
        M, D = ((unachieved @ m)[:, unactuated] for m in (signs.inertia, signs.damping))
        acceleration = -np.linalg.solve(M, np.hstack([stiffness[:, unactuated], D]))
        rates = np.vstack([np.eye(len(unactuated), 2 * len(unactuated), len(unactuated)), acceleration])
        poles += map(complex, np.linalg.eigvals(rates))
    poles = sorted(set(poles), key=lambda p: (-p.real, p.imag))
    stable, text = _unactuated_verdict(gains.unactuated, poles, force, stiffness[:, unactuated])
    return ZeroDynamics(gains.unactuated, poles, stable, text)


def _restoring(plant: Plant) -> tuple[Array, Array]:
    """Force at the set-point on an even keel (n,), and its slope in the pose (n, n), left-hand side."""
    level = dict.fromkeys(plant.eta, 0)
    force = plant.g.xreplace(plant.numbers)
    slope = force.jacobian(plant.eta).xreplace(level)
    at_rest, stiffness = (np.array(m.evalf().tolist(), dtype=float) for m in (force.xreplace(level), slope))
    return at_rest[:, 0], stiffness


def _unactuated_verdict(
    axes: tuple[str, ...], poles: list[complex], forces: Array, stiffness: Array
) -> tuple[bool, str]:
    """Whether unactuated axes come to rest, and where they go, in words."""
    names = ", ".join(axes)
    if poles[0].real > SETTINGS.slowest_decay:
        return False, f"{names}: unactuated and unstable, it diverges at {poles[0].real:.4g} 1/s"
    free = [a for a, row in zip(axes, stiffness, strict=True) if not np.any(row)]
    acting = {a: abs(f) for a, f in zip(axes, forces, strict=True) if a in free}
    loaded = {a: f for a, f in acting.items() if f > SETTINGS.no_force}
    if loaded:
        force = float(max(loaded.values()))
        return False, (
            f"{', '.join(loaded)}: a force of {force:.4g} (N, N m) acts at the set-point and nothing holds it"
        )
    decaying = [p.real for p in poles if p.real < -SETTINGS.slowest_decay]
    if len(poles) - len(decaying) > 2 * len(free) or not decaying:
        return False, f"{names}: unactuated, its motion neither decays nor grows"
    text = f"{names}: unactuated, its speed decays at {-max(decaying):.4g} 1/s"
    if free:
        axes_free = ", ".join(free)
        text += f"; it comes to rest where that leaves it: an error along {axes_free} is never corrected"
    return True, text


# --- sliding surfaces -------------------------------------------------------------------------
def reaching(problem: Problem, uncertainty: Uncertainty) -> list[Row]:
    """One row for each channel and the sets of parameters that differ; none where g is known exactly.

    M and D of the law in the motion of the true vehicle give
    M S_dot = -M^ K_Z sgn S + (M^ - M) Lambda nu - (D^ - D) nu - (g^ - g), with ^ for the law's own.
    """
    if "K_Z" not in problem.values or not problem.decoupled:
        return []
    # Largest error of each row of g over all attitudes, when every parameter is within its interval.
    plant = problem.plant
    symbols = sorted(plant.g.free_symbols & set(plant.numbers), key=str)
    widths = _half_widths(uncertainty, tuple(map(str, symbols)))
    weight = np.zeros(len(plant.g))
    for x, width in zip(symbols, widths, strict=True):
        slope = plant.g.diff(x).xreplace(plant.numbers)
        weight += width * np.array([_largest(e, problem) for e in slope])
    if not weight.any():
        return []
    rows = ((signs, i) for signs in problem.sets[:2] for i in problem.driven)
    return [_reaching_row(problem, signs, i, float(weight[i]), uncertainty) for signs, i in rows]


def _reaching_row(problem: Problem, signs: SignSet, i: int, weight: float, uncertainty: Uncertainty) -> Row:
    force = float(problem.values["K_Z"][i] * signs.inertia[i, i])
    slopes = np.abs(signs.D.slopes[:, i, i]) + problem.values["Lambda"][i] * np.abs(signs.M.slopes[:, i, i])
    per_speed = float(slopes @ _half_widths(uncertainty, signs.names))
    speed = (force - weight) / per_speed if per_speed > 0 else np.inf
    unit = "m/s" if i < 3 and problem.coordinates[i] in "xyz" else "rad/s"
    holds = force > weight
    return Row(
        form="derived",
        condition="reaching",
        statement="K_Z M > |error of g|",
        about="With M, D, g off by dM, dD, dg the surface is still reached in a straight run at speed s "
        "while K_Z M > |dg| + (|dD| + Λ |dM|) s.",
        source="derived here",
        scope=problem.coordinates[i],
        signs=signs.name,
        left=force,
        right=weight,
        margin=force - weight,
        verdict=HOLDS if holds else FAILS,
        where=f"reached up to {speed:.3g} {unit}" if holds else "not even at rest",
    )


def _half_widths(uncertainty: Uncertainty, names: tuple[str, ...]) -> Array:
    """Half the width of the interval of each parameter."""
    sigmas = np.sqrt(np.diag(uncertainty.covariance(names))) if names else np.zeros(0)
    return ndtri(0.5 + uncertainty.confidence / 2) * sigmas


def _largest(expression: sm.Expr, problem: Problem) -> float:
    """Bound on the magnitude of an expression of the attitude."""
    angles = [symbol(a) for a in ANGLES]
    if expression.free_symbols - set(angles):
        return np.inf
    tilt = problem.attitudes.tilt
    ranges = map(plus_minus, (tilt, tilt, np.pi))
    found = function_of(angles, expression, FUNCTIONS)(*ranges)
    return float(enclose(found).magnitude)
