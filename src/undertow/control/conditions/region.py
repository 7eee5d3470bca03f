"""Where the local result of PID control holds: the term of third order in V_dot against the others."""

from __future__ import annotations

from functools import reduce

import numpy as np
import sympy as sm

from undertow.control.plant import Plant
from undertow.model.symbols import symbol

from .case import SignSet
from .feasible import Span, inside
from .problem import Problem
from .result import Region

Array = np.ndarray
_SMALL = 1e-12


def region(problem: Problem, iota: Span | None) -> Region:
    """The errors for which V_dot is negative, and a level of V that stays within them.

    In body axes the third-order term is iota nu' H(q~) nu, linear in the error; it is outweighed where
    iota sum |q~_i| c_i < 1 with c_i the largest eigenvalue of H_i relative to what the quadratic form leaves
    for the velocities (its Schur complement). The c_i are maxima over sign sets and over sampled attitudes.

    Parameters
    ----------
    problem : Problem
        PID gains on their vehicle.
    iota : (float, float) or None
        The values of iota for which the derived conditions hold together.
    """
    if iota is None:
        return Region(None, None, None, "no region: no iota satisfies the derived conditions together")
    chosen = inside(iota)
    weights, spring = _weights(problem, chosen)
    if weights.max() < _SMALL:
        text = "everywhere: the inertia depends on no coordinate, so there is no term of third order"
        return Region(chosen, np.inf, np.inf, text)
    turning = [_unit(c) == "rad" for c in problem.coordinates]
    # Errors of angles are within half a turn: beyond it V jumps.
    limited = np.where(turning, np.maximum(weights, 1.0 / (chosen * np.pi)), weights)
    level = 1.0 / (2.0 * chosen**2 * float(limited @ np.abs(np.linalg.inv(spring)) @ limited))
    shares = {c: 1.0 / (chosen * w) for c, w in zip(problem.coordinates, weights, strict=True) if w > _SMALL}
    bounds = " + ".join(f"|q~_{c}|/{limit:.4g} {_unit(c)}" for c, limit in shares.items())
    text = (
        f"{bounds} < 1 at iota = {chosen:.4g} 1/s; motions that begin with V < {level:.4g} stay there and "
        "within half a turn"
    )
    angles = [limit for c, limit in shares.items() if c in ("phi", "theta", "psi")]
    return Region(chosen, min(angles, default=np.inf), level, text)


def _unit(coordinate: str) -> str:
    return "rad" if coordinate in ("phi", "theta", "psi") else "m"


def _weights(problem: Problem, iota: float) -> tuple[Array, Array]:
    """c_i for each coordinate, and the weakest matrix K_P - K_I/iota - iota^2 M_q."""
    n = problem.size
    weights, springs = np.zeros(n), []
    for one in problem.sets:  # C mixes what belongs to several velocities
        third = _third_order(problem.plant, one)
        for values, inverse in _attitudes(problem):
            left, spring = _left_for_velocities(problem, one, inverse, iota)
            springs.append(spring)
            root = np.linalg.inv(np.linalg.cholesky(left))
            for i in range(n):
                H = third(i, values)
                size = np.abs(np.linalg.eigvalsh(root @ H @ root.T)).max()
                weights[i] = max(weights[i], size)
    return weights, min(springs, key=lambda P: np.linalg.eigvalsh(P)[0])


def _attitudes(problem: Problem) -> list[tuple[dict[str, float], Array]]:
    angles = problem.attitudes.angles(False)
    if not angles:
        return [({}, problem.attitudes.at({}))]
    axes = [np.linspace(low, high, 5) for low, high in problem.attitudes.box(angles)]
    rows = np.stack([g.ravel() for g in np.meshgrid(*axes)], axis=1)
    points = [dict(zip(angles, map(float, row), strict=True)) for row in rows]
    return [(point, problem.attitudes.at(point)) for point in points]


def _left_for_velocities(problem: Problem, one: SignSet, inverse: Array, iota: float) -> tuple[Array, Array]:
    """What the quadratic form leaves for nu once the error is at its worst, and the spring of V."""
    s = problem.signs(one, inverse, iota)
    K = s.K_V + s.D
    rest = 0.5 * (K + K.T) - iota * s.M
    cross = iota * K / 2
    left = rest - cross.T @ np.linalg.solve(iota * s.K_P - s.K_I, cross)
    J = np.linalg.inv(inverse)
    return J.T @ left @ J, s.K_P - s.K_I / iota - iota**2 * s.M


class _ThirdOrder:
    """H_i at an attitude: the symmetric matrix of nu' (C - M J^-1 J_dot) J^-1 q~ for q~ along i."""

    def __init__(self, plant: Plant, one: SignSet) -> None:
        self._angles = [symbol(a) for a in ("phi", "theta", "psi")]
        moving = plant.C - plant.M * plant.J_inverse * plant.J_dot
        whole = (plant.one_way(moving, one.way) * plant.J_inverse).xreplace(plant.numbers)
        forms = [_hessian((plant.nu.T * whole[:, i])[0], plant.nu).tolist() for i in range(len(plant.nu))]
        self._function = sm.lambdify(self._angles, forms, "math", cse=True)

    def __call__(self, i: int, values: dict[str, float]) -> Array:
        forms = self._function(*(values.get(str(a), 0.0) for a in self._angles))
        return np.array(forms[i], dtype=float)


def _third_order(plant: Plant, one: SignSet) -> _ThirdOrder:
    return _ThirdOrder(plant, one)


def _hessian(form: sm.Expr, nu: sm.Matrix) -> sm.Matrix:
    """Half the second derivative in the velocities, of which the form is quadratic."""
    gradient = sm.Matrix([form]).jacobian(nu)
    return reduce(lambda m, f: f(m), (lambda m: m.jacobian(nu), lambda m: m / 2), gradient.T)
