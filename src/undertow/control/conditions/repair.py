"""Minimal repairs: the smallest change of gains that satisfies a set of conditions."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar, nnls

from undertow.errors import UndertowError
from undertow.typing import Array

from .by_law import (
    FALLING_CANDIDATE,
    PRINTED_DAMPER,
    PRINTED_LAST,
    PRINTED_SPRING,
    ROUTH,
    SOME_IOTA,
    Condition,
)
from .problem import Problem, SignSet, where_positive


@dataclass(frozen=True)
class RepairSettings:
    """How repairs are searched for."""

    rounds: int = 80  # most rounds of cutting planes
    least_gain: float = 1e-3  # every gain keeps at least this part of itself
    # Distances inside every demand, tried until the gains hold in the six digits that are printed.
    slacks: tuple[float, ...] = (1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2)
    # Powers of ten of iota, 1/s, and points between which its best value is searched for.
    iota_grid: tuple[float, float, int] = (-4, 1, 26)
    iota_tolerance: float = 1e-7  # of its logarithm
    infeasible: float = 1e-9  # what is left of a target of one where no gains meet all demands
    unchanged: float = 1e-9  # relative change of a gain that is none


SETTINGS = RepairSettings()


class Cut(NamedTuple):
    """A demand `slope . x + offset >= 0` that follows from a concave one."""

    slope: Array
    offset: float


Cuts = Callable[[Array], Iterable[Cut]]
"""Cuts at a point x of relative changes; at least one of them is violated where a demand is."""


def least_change(cuts: Cuts, size: int, slack: float) -> Array | None:
    """The relative changes x with the least sum of squares that satisfy all demands, or None.

    `slack` is how far inside every demand x lies, as a distance.
    """
    x = np.zeros(size)
    slopes, floors = [*np.eye(size)], [SETTINGS.least_gain - 1.0] * size
    for _ in range(SETTINGS.rounds):
        violated = [c for c in map(_scaled, cuts(x)) if c.slope @ x + c.offset < 0.5 * slack]
        if not violated:
            return x
        slopes += [c.slope for c in violated]
        floors += [slack - c.offset for c in violated]
        found = _least_distance(np.array(slopes), np.array(floors))
        if found is None:
            return None
        x = found
    return None


def _scaled(cut: Cut) -> Cut:
    size = max(float(np.linalg.norm(cut.slope)), 1e-300)
    return Cut(cut.slope / size, cut.offset / size)


def _least_distance(slopes: Array, floors: Array) -> Array | None:
    """The x of least length with slopes x >= floors.

    Lawson and Hanson (1974), Solving Least Squares Problems: least-distance programming by nnls.
    """
    scale = max(1.0, float(floors.max()))
    matrix = np.vstack([slopes.T, floors / scale])
    target = np.zeros(matrix.shape[0])
    target[-1] = 1.0
    multipliers, distance = nnls(matrix, target, maxiter=50 * matrix.shape[1])
    if distance < SETTINGS.infeasible:
        return None
    rest = matrix @ multipliers - target
    return -rest[:-1] / rest[-1] * scale


@dataclass(frozen=True)
class RepairKind:
    """What has to hold after a repair, the gains that may change, and how the change is found."""

    conditions: tuple[Condition, ...]
    changes: tuple[str, ...]
    method: str


_LINEAR = (
    "convex for a given iota: cutting planes, each a least-distance problem solved by scipy.optimize.nnls; "
    "iota by a search in one dimension"
)
# The last one in the manner of the others: smallest gain against largest inertia.
_LITERAL = (PRINTED_DAMPER, PRINTED_SPRING, replace(PRINTED_LAST, eigenvalues=True))
KINDS = {
    "literal": RepairKind(_LITERAL, ("K_P", "K_V"), _LINEAR),
    "lyapunov": RepairKind((FALLING_CANDIDATE,), ("K_P", "K_V", "K_I"), _LINEAR),
    "routh": RepairKind(
        (ROUTH,),
        ("K_P", "K_V", "K_I"),
        "convex in k_p, k_v and sqrt(k_i): cutting planes, each a least-distance problem solved by "
        "scipy.optimize.nnls",
    ),
}
"""What `--repair` takes."""


@dataclass(frozen=True)
class Repair:
    """Gains with which a set of conditions holds."""

    kind: str  # which conditions
    method: str  # how the change was found
    gains: dict[str, dict[str, float]]  # new value by gain and coordinate, SI; only what changes
    factors: dict[str, dict[str, float]]  # new over old value
    iota: float | None  # that belongs to them
    found: bool  # False where no change of the gains was found to do it


@dataclass(frozen=True)
class SingleRepair:
    """What one gain would have to be if it alone changed."""

    kind: str  # "routh" or "lyapunov"
    gain: str
    coordinate: str  # of the channel
    signs: str  # set of parameters
    bound: float | None  # the value it has to pass; None where no value of it does
    above: bool  # whether it has to be larger than that


# --- one gain alone -----------------------------------------------------------------------------
def single_repairs(problem: Problem) -> list[SingleRepair]:
    """For every channel that fails a condition: what each of its gains would have to be alone."""
    if "K_I" not in problem.values:
        return []
    kinds = (("routh", ROUTH), ("lyapunov", SOME_IOTA))
    return [
        found
        for kind, condition in kinds
        for signs in problem.sets[:2]
        for i in problem.driven
        if problem.margin(condition, signs, None, i) <= 0
        for found in (_single(problem, kind, condition, signs, i, name) for name in ("K_P", "K_V", "K_I"))
    ]


def _single(
    problem: Problem, kind: str, condition: Condition, signs: SignSet, i: int, name: str
) -> SingleRepair:
    def margin(value: float) -> float:
        values = {**problem.values, name: problem.values[name].copy()}
        values[name][i] = value
        return problem.with_gains(values).margin(condition, signs, None, i)

    span = where_positive(lambda gains: np.array([margin(g) for g in gains]), concave=False)
    current = float(problem.values[name][i])
    above = span is not None and current <= span[0]
    bound = None if span is None else span[0] if above else span[1]
    return SingleRepair(kind, name, problem.coordinates[i], signs.name, bound, above)


# --- all gains together -------------------------------------------------------------------------
def repair(problem: Problem, kind: str) -> Repair:
    """The smallest change, in the sum of squared relative changes, after which conditions hold in every set.

    Where the heading matters, gains that are the same for x and y stay the same.
    """
    if "K_I" not in problem.values:
        raise UndertowError(
            f"--repair {kind} is for PID gains: the conditions of law '{problem.gains.law.id}' are signs only"
        )
    variables = _Variables(problem, KINDS[kind].changes)
    for slack in SETTINGS.slacks:
        found = _with_slack(kind, variables, slack)
        if not found.found or _holds_as_printed(problem, found):
            return found
    return Repair(kind, KINDS[kind].method, {}, {}, None, False)


def _with_slack(kind: str, variables: _Variables, slack: float) -> Repair:
    size, conditions = variables.size, KINDS[kind].conditions
    if kind == "routh":
        change = least_change(_routh_cuts(variables), size, slack)
        return _result(kind, variables, variables.from_roots(change), None)
    iota, change = _best_iota(lambda value: least_change(_cuts(variables, conditions, value), size, slack))
    return _result(kind, variables, change, iota)


def _holds_as_printed(problem: Problem, found: Repair) -> bool:
    """Whether the gains satisfy what they were repaired for in the digits that are printed."""
    values = {name: v.copy() for name, v in problem.values.items()}
    for name, new_values in found.gains.items():
        for coordinate, value in new_values.items():
            values[name][problem.coordinates.index(coordinate)] = float(f"{value:.6g}")
    repaired, conditions = problem.with_gains(values), KINDS[found.kind].conditions
    if found.iota is not None:
        return repaired.iota_interval(conditions, repaired.relevant_sets) is not None
    return all(
        np.min(c.margin(repaired.channel_quantities(signs, i, None, axis=axis))) > 0
        for c in conditions
        for signs in repaired.sets[:2]
        for i, axis, _ in repaired.channels
    )


class _Variables:
    """Relative changes of gains, one for each gain of a coordinate or of several that go together."""

    def __init__(self, problem: Problem, names: tuple[str, ...]) -> None:
        self.problem, self.names = problem, names
        # Translations whose gains are alike go together where the heading turns one into the other.
        shared = next((c for c in (("x", "y", "z"), ("x", "y")) if problem.equal_gains(tuple(c))), ())
        group = [problem.coordinates.index(c) for c in shared] if "psi" in problem.coordinates else []
        singles = [[i] for i in range(problem.size) if i not in group]
        self.groups = [group, *singles] if group else singles
        self.size = len(self.names) * len(self.groups)

    def index(self, name: str, i: int) -> int:
        """Which variable a gain is."""
        group = next(k for k, members in enumerate(self.groups) if i in members)
        return self.names.index(name) * len(self.groups) + group

    def values(self, x: Array) -> dict[str, Array]:
        """All gains after a change."""
        result = {name: v.copy() for name, v in self.problem.values.items()}
        for name in self.names:
            for i in range(self.problem.size):
                result[name][i] *= 1.0 + x[self.index(name, i)]
        return result

    def from_roots(self, x: Array | None) -> Array | None:
        """The change where that of an integral gain is counted as twice that of its root."""
        if x is None:
            return None
        changed, n = x.copy(), len(self.groups)
        own = slice(self.names.index("K_I") * n, (self.names.index("K_I") + 1) * n)
        changed[own] = (1 + x[own] / 2) ** 2 - 1
        return changed

    def directions(self) -> list[dict[str, Array]]:
        """The gains that each variable moves by one."""
        zero = {name: np.zeros_like(v) for name, v in self.problem.values.items()}
        found = [{n: v.copy() for n, v in zero.items()} for _ in range(self.size)]
        for name in self.names:
            for i in range(self.problem.size):
                found[self.index(name, i)][name][i] = self.problem.values[name][i]
        return found


def _best_iota(solve: Callable[[float], Array | None]) -> tuple[float | None, Array | None]:
    def cost(logarithm: float) -> float:
        x = solve(math.exp(logarithm))
        return math.inf if x is None else float(x @ x)

    low, high, points = SETTINGS.iota_grid
    grid = np.log(np.logspace(low, high, points))
    costs = [cost(v) for v in grid]
    best = int(np.argmin(costs))
    if math.isinf(costs[best]):
        return None, None
    around = float(grid[max(best - 1, 0)]), float(grid[min(best + 1, points - 1)])
    big, close = 1e6 * (1.0 + costs[best]), {"xatol": SETTINGS.iota_tolerance}
    found = minimize_scalar(lambda v: min(cost(v), big), bounds=around, method="bounded", options=close)
    iota = math.exp(found.x if found.fun < costs[best] else grid[best])
    return iota, solve(iota)


def _cuts(
    variables: _Variables, conditions: tuple[Condition, ...], iota: float
) -> Callable[[Array], Iterator[Cut]]:
    """Cuts of matrix conditions that are affine in the gains: u' left u - w' right w for eigenvectors."""
    problem = variables.problem
    directions = variables.directions()

    def at(x: Array) -> Iterator[Cut]:
        changed = problem.with_gains(variables.values(x))
        for condition in conditions:
            for signs in problem.relevant_sets:
                for inverse in problem.few_inverses:
                    yield from _matrix_cuts(changed, condition, signs, inverse, iota, directions, x)

    return at


def _matrix_cuts(
    changed: Problem,
    condition: Condition,
    signs: SignSet,
    inverse: Array,
    iota: float,
    directions: list[dict[str, Array]],
    x: Array,
) -> Iterator[Cut]:
    def sides(values: dict[str, Array]) -> tuple[Array, Array]:
        s = changed.with_gains(values).quantities(signs, inverse, iota)
        return condition.left(s), condition.right(s)

    left, right = sides(changed.values)
    moved = [sides({n: changed.values[n] + d[n] for n in d}) for d in directions]
    slopes = [(a - left, b - right) for a, b in moved]
    if condition.eigenvalues:
        pairs = [(u, w) for u in np.linalg.eigh(left)[1].T for w in np.linalg.eigh(right)[1].T]
    else:
        pairs = [(u, u) for u in np.linalg.eigh(left - right)[1].T]
    for u, w in pairs:
        slope = np.array([u @ a @ u - w @ b @ w for a, b in slopes])
        value = float(u @ left @ u - w @ right @ w)
        yield Cut(slope, value - float(slope @ x))


def _routh_cuts(variables: _Variables) -> Callable[[Array], Iterator[Cut]]:
    """sqrt(K k_p) >= sqrt(M) sqrt(k_i): a concave function against one that is linear in sqrt(k_i).

    The change of an integral gain is counted as twice that of its root, the same for small changes.
    """
    problem = variables.problem

    def at(x: Array) -> Iterator[Cut]:
        for signs in problem.sets[:2]:
            for i, axis, _ in problem.channels:
                p, v, s = (variables.index(n, i) for n in ("K_P", "K_V", "K_I"))
                k_p, k_v, k_i = (float(problem.values[n][i]) for n in ("K_P", "K_V", "K_I"))
                K, P = k_v * (1 + x[v]) + float(signs.damping[axis, axis]), k_p * (1 + x[p])
                mean, root = math.sqrt(max(K * P, 0.0)), math.sqrt(float(signs.inertia[axis, axis]) * k_i)
                slope = np.zeros(variables.size)
                slope[p], slope[v], slope[s] = K * k_p / (2 * mean), P * k_v / (2 * mean), -root / 2
                value = mean - root * (1 + x[s] / 2)
                yield Cut(slope, value - float(slope @ x))

    return at


def _result(kind: str, variables: _Variables, change: Array | None, iota: float | None) -> Repair:
    if change is None:
        return Repair(kind, KINDS[kind].method, {}, {}, None, False)
    problem, new = variables.problem, variables.values(change)
    gains: dict[str, dict[str, float]] = {}
    factors: dict[str, dict[str, float]] = {}
    for name in variables.names:
        for i, coordinate in enumerate(problem.coordinates):
            old = float(problem.values[name][i])
            if old and abs(new[name][i] / old - 1) > SETTINGS.unchanged:
                gains.setdefault(name, {})[coordinate] = float(new[name][i])
                factors.setdefault(name, {})[coordinate] = float(new[name][i]) / old
    return Repair(kind, KINDS[kind].method, gains, factors, iota, True)
