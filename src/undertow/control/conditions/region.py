"""Where the local result of PID control holds: the terms of third order in V_dot against the others."""

from __future__ import annotations

from functools import reduce
from typing import NamedTuple

import numpy as np
import sympy as sm
from scipy.optimize import brentq

from undertow.control.plant import Plant
from undertow.model.evaluation import function_of
from undertow.model.symbols import symbol

from .case import SignSet
from .fast import FastDamping, fast_damping
from .feasible import Span, inside
from .problem import Problem
from .result import Region

Array = np.ndarray
_SMALL = 1e-12
_LOWEST, _HIGHEST = 1e-30, 1e30


def region(problem: Problem, iota: Span | None) -> Region:
    """The errors for which V_dot is negative, and a level of V that stays within them.

    Two terms of V_dot are of third order: iota nu' H(q~) nu, in body axes and linear in the error, and
    iota q~' J^-T (D(nu) - D(0)) nu. Both are outweighed where iota sum |q~_i| c_i < 1 with c_i the largest
    eigenvalue of what belongs to |q~_i| relative to what the quadratic form leaves for the velocities (its
    Schur complement). The c_i are maxima over sign sets and over sampled attitudes. Where damping grows
    faster than in proportion, or falls with speed, they are those for the speeds that the level allows.

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
    damping = [fast_damping(problem.plant, one) for one in problem.sets]
    known = [d for d in damping if d is not None]
    if len(known) < len(damping):
        text = "no region estimated: damping is no polynomial in velocities and their magnitudes"
        return Region(chosen, None, None, text)
    return _told(problem, chosen, _Places(problem, chosen, known))


def _told(problem: Problem, iota: float, places: _Places) -> Region:
    level = places.level()
    weights, lost = places.weights(level)
    if weights.max() < _SMALL and lost == 0.0:
        text = "everywhere: inertia and damping are constant, so there is no term of third order"
        return Region(iota, np.inf, np.inf, text)
    shares = {
        c: (1.0 - lost) / (iota * w) for c, w in zip(problem.coordinates, weights, strict=True) if w > _SMALL
    }
    bounds = " + ".join(f"|q~_{c}|/{limit:.4g} {_unit(c)}" for c, limit in shares.items()) or "0"
    text = (
        f"an estimate: V_dot < 0 where {bounds} < 1 at iota = {iota:.4g} 1/s{places.proviso(level)}; motions "
        f"that begin with V < {level:.4g} stay there{' and within half a turn' if places.turning else ''}"
    )
    angles = [limit for c, limit in shares.items() if _unit(c) == "rad"]
    return Region(iota, min(angles, default=np.inf), level, text)


def _unit(coordinate: str) -> str:
    return "rad" if coordinate in ("phi", "theta", "psi") else "m"


class _Place(NamedTuple):
    """One sign set at one attitude, velocities in the body frame."""

    left: Array
    """What the quadratic form leaves for the velocities."""
    H: Array
    """The forms of third order of the inertia for each coordinate, shape (n, n, n)."""
    inverse: Array
    """J^-1."""
    damping: FastDamping
    spring: Array
    """What V leaves for the error: V >= q~' spring q~/2."""
    mass: Array
    """What V leaves for the velocities: V >= nu' mass nu/2."""


class _Places:
    """All sign sets at sampled attitudes."""

    def __init__(self, problem: Problem, iota: float, damping: list[FastDamping]) -> None:
        self._iota = iota
        self.turning = [i for i, c in enumerate(problem.coordinates) if _unit(c) == "rad"]
        attitudes = _attitudes(problem)
        self._places = [
            _place(problem, one, own, third, iota, *attitude)
            for one, own in zip(problem.sets, damping, strict=True)  # C mixes what belongs to several
            for third in (_ThirdOrder(problem.plant, one),)
            for attitude in attitudes
        ]
        # Of positive matrices that are alike over many attitudes a few decide.
        self._reach = np.max([np.abs(np.linalg.inv(p.spring)) for p in self._places], axis=0)
        self._speeds = np.max([np.sqrt(np.diag(np.linalg.inv(p.mass))) for p in self._places], axis=0)
        self._bent = any(d.falls or d.depends_on_speed for d in damping)

    def weights(self, level: float) -> tuple[Array, float]:
        """c_i for each coordinate while V < level, and the share of the left side that damping takes."""
        speeds = np.sqrt(2 * level) * self._speeds if self._bent else self._speeds
        found = [_sizes(p, speeds) for p in self._places]
        return np.max([w for w, _ in found], axis=0), max(lost for _, lost in found)

    def level(self) -> float:
        """The largest level of V within which V_dot is negative and angles are within half a turn."""
        # Errors of angles are within half a turn: beyond it V jumps.
        highest = min((np.pi**2 / (2 * self._reach[i, i]) for i in self.turning), default=np.inf)

        def excess(logarithm: float) -> float:
            weights, lost = self.weights(np.exp(logarithm))
            error = np.sqrt(2 * np.exp(logarithm) * float(weights @ self._reach @ weights))
            return float(np.log(max(self._iota * error + lost, 1e-300)))

        ends = np.log(_LOWEST), np.log(min(highest, _HIGHEST))
        if excess(ends[1]) < 0:
            return float(highest)
        if not self._bent:
            return float(np.exp(ends[1] - 2 * excess(ends[1])))
        return float(np.exp(brentq(excess, *ends, xtol=1e-9) - 1e-9))

    def proviso(self, level: float) -> str:
        """The bound on speeds that the weights count on, if they do."""
        return f" and V < {level:.4g}" if self._bent else ""


def _sizes(place: _Place, speeds: Array) -> tuple[Array, float]:
    root = np.linalg.inv(np.linalg.cholesky(place.left))
    scale = 1 / np.sqrt(np.diag(place.left))
    # Forms in |nu| are compared with a diagonal matrix below the left side.
    least = float(np.linalg.eigvalsh(place.left * np.outer(scale, scale))[0])

    def size(form: Array) -> float:
        scaled = form * np.outer(scale, scale)
        return float(np.linalg.eigvalsh(0.5 * (scaled + scaled.T))[-1]) / least

    T = place.damping.shares(speeds)
    weights = [
        np.abs(np.linalg.eigvalsh(root @ H @ root.T)).max() + size(np.einsum("l,lkj->kj", np.abs(b), T))
        for H, b in zip(place.H, place.inverse.T, strict=True)
    ]
    return np.array(weights), size(np.einsum("k,ikj->ij", speeds, T)) if place.damping.falls else 0.0


def _attitudes(problem: Problem) -> list[tuple[dict[str, float], Array]]:
    angles = problem.attitudes.angles(False)
    if not angles:
        return [({}, problem.attitudes.at({}))]
    count = 9 if len(angles) == 1 else 5
    axes = [np.linspace(low, high, count) for low, high in problem.attitudes.box(angles)]
    rows = np.stack([g.ravel() for g in np.meshgrid(*axes)], axis=1)
    points = [dict(zip(angles, map(float, row), strict=True)) for row in rows]
    return [(point, problem.attitudes.at(point)) for point in points]


def _place(
    problem: Problem,
    one: SignSet,
    damping: FastDamping,
    third: _ThirdOrder,
    iota: float,
    values: dict[str, float],
    inverse: Array,
) -> _Place:
    s = problem.signs(one, inverse, iota)
    K = s.K_V + s.D
    rest = 0.5 * (K + K.T) - iota * s.M
    cross = iota * K / 2
    left = rest - cross.T @ np.linalg.solve(iota * s.K_P - s.K_I, cross)
    stiff = s.K_P - s.K_I / iota
    mass = s.M - iota**2 * s.M @ np.linalg.solve(stiff, s.M)
    J = np.linalg.inv(inverse)
    spring = stiff - iota**2 * s.M
    return _Place(J.T @ left @ J, third(values), inverse, damping, spring, J.T @ mass @ J)


class _ThirdOrder:
    """All H_i at an attitude: symmetric matrices of nu' (C - M J^-1 J_dot) J^-1 q~ for q~ along i."""

    def __init__(self, plant: Plant, one: SignSet) -> None:
        self._angles = [symbol(a) for a in ("phi", "theta", "psi")]
        moving = plant.C - plant.M * plant.J_inverse * plant.J_dot
        whole = (plant.one_way(moving, one.way) * plant.J_inverse).xreplace(plant.numbers)
        forms = [_hessian((plant.nu.T * whole[:, i])[0], plant.nu).tolist() for i in range(len(plant.nu))]
        self._function = function_of(self._angles, forms)

    def __call__(self, values: dict[str, float]) -> Array:
        forms = self._function(*(values.get(str(a), 0.0) for a in self._angles))
        return np.array(forms, dtype=float)


def _hessian(form: sm.Expr, nu: sm.Matrix) -> sm.Matrix:
    """Half the second derivative in the velocities, of which the form is quadratic."""
    gradient = sm.Matrix([form]).jacobian(nu)
    return reduce(lambda m, f: f(m), (lambda m: m.jacobian(nu), lambda m: m / 2), gradient.T)
