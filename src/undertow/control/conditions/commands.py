"""What a law asks of the thrusters below a level of its Lyapunov function; damping beyond that at rest."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import NamedTuple

import numpy as np
import sympy as sm

from undertow.control.gains import allocation_of
from undertow.control.plant import Plant
from undertow.errors import UndertowError
from undertow.model.symbols import symbol
from undertow.typing import Array

from .attitude import ANGLES, Interval, enclose, enclosing, within
from .problem import NO_SPREAD, Problem, SignSet, Spread
from .result import Command

_ANGLES = [symbol(a) for a in ANGLES]
_EPS = float(np.finfo(float).eps)


class Commands:
    """The commands of a law whose thrusters have limits, over a set of states.

    Commands are B's weighted inverse times the force that the law asks for. As long as all of them are within
    their limits the force is given exactly, and neither the redistribution at limits nor anti-windup acts.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        allocation = allocation_of(problem.gains)
        limited = np.isfinite(allocation.limits)
        self.share, self.limits = allocation.share[limited], allocation.limits[limited]
        names = problem.plant.vehicle.command_names
        self.names = [n for n, there in zip(names, limited, strict=True) if there]

    def steady(self) -> Array:
        """Magnitude of each command at a set-point on an even keel, any heading, shape (m,)."""
        level = {str(a): enclose(np.zeros(1)) for a in _ANGLES}
        return self.at_rest(self.problem.attitudes.boxes({"phi": 0.0, "theta": 0.0}) or level)

    def at_rest(self, boxes: dict[str, Interval]) -> Array:
        """Bound on the part of each command that compensates weight and buoyancy, shape (m,)."""
        if not len(self.limits):
            return np.zeros(0)
        held = self._holding(*self.problem.attitudes.every_angle(boxes))
        return np.asarray(held.size[..., 0].max(axis=0))

    def holding_slopes(self, boxes: dict[str, Interval]) -> Interval:
        """How what compensates weight and buoyancy changes with roll and pitch, shape (boxes, m, 2)."""
        return self._holding_slopes(*self.problem.attitudes.every_angle(boxes))

    @cached_property
    def _holding_slopes(self) -> Callable[..., Interval]:
        return enclosing(_ANGLES, sm.Matrix.hstack(*(self._held.diff(a) for a in _ANGLES[:2])))

    @cached_property
    def _holding(self) -> Callable[..., Interval]:
        return enclosing(_ANGLES, self._held)

    @cached_property
    def _held(self) -> sm.Matrix:
        """What compensates weight and buoyancy, by command with a limit."""
        plant = self.problem.plant
        force = plant.g.xreplace(plant.numbers)
        others = force.free_symbols - set(_ANGLES)
        if others:
            raise UndertowError(
                f"the force at rest depends on {', '.join(sorted(map(str, others)))}: whether the thrusters "
                "can hold it everywhere is not certified"
            )
        return sm.Matrix(self.share) * force

    def result(self, largest: Array) -> tuple[Command, ...]:
        """The commands with a bound on each."""
        rows = zip(self.names, self.steady(), largest, self.limits, strict=True)
        return tuple(Command(n, float(s), float(b), float(m)) for n, s, b, m in rows)


def pd_commands(commands: Commands, level: float, reach: dict[str, float]) -> Array:
    """Bound on the magnitude of each command of PD control while V < level, shape (m,).

    With w = J b for the row b of a command, b' J' (K_P e - K_V q_dot) is linear in e and nu, and V =
    nu' M nu/2 + e' K_P e/2 < level bounds it by sqrt(2 level (w' K_P w + w' K_V J M^-1 J' K_V w)): proved by
    interval arithmetic over boxes of attitudes. `reach` has the largest roll and pitch while V < level, rad.
    """
    problem = commands.problem
    boxes = problem.attitudes.boxes(reach)
    J = problem.attitudes.forward(boxes)
    rest = commands.at_rest(boxes)
    squares = [_square(problem, J, row) for row in commands.share]
    return rest + np.sqrt(2 * level * np.array(squares))


def _square(problem: Problem, J: Interval, row: Array) -> float:
    w = J @ row[:, None]
    spring = ((w.size[..., 0] ** 2) @ problem.values["K_P"]).max()
    braked = J.T @ (problem.values["K_V"][:, None] * w)
    roots = [np.linalg.inv(np.linalg.cholesky(m)) for m in inertias(problem.sets)]
    return float(spring + max(((root @ braked).size[..., 0] ** 2).sum(axis=-1).max() for root in roots))


def inertias(sets: Sequence[SignSet]) -> list[Array]:
    """Inertia matrices below that of every sign set; one where all are diagonal."""
    return _extreme([one.inertia for one in sets])


def dampings(sets: Sequence[SignSet]) -> list[Array]:
    """The same of damping at rest, symmetric parts."""
    return _extreme([0.5 * (one.damping + one.damping.T) for one in sets])


def _extreme(matrices: list[Array]) -> list[Array]:
    if all(np.array_equal(m, np.diag(np.diag(m))) for m in matrices):
        return [np.diag(np.min([np.diag(m) for m in matrices], axis=0))]
    return matrices


class SlidingCommands:
    """Bounds on the commands of a sliding-mode law on a box of errors and surfaces.

    With S = -q_dot + Lambda e the box |S_i| <= Lambda_i e_i, |error_i| <= e_i is invariant: S falls in
    magnitude, and the error follows error_dot = -Lambda error + S. In it |q_dot_i| <= 2 Lambda_i e_i.
    """

    def __init__(self, commands: Commands) -> None:
        self._commands, self._problem = commands, commands.problem
        plant, problem = self._problem.plant, self._problem
        nu = list(plant.nu)
        # With the rotation of the translations, which changes commands though no eigenvalue.
        self._backward = enclosing(_ANGLES, plant.J_inverse)
        self._turning = enclosing([*_ANGLES, *nu], (plant.J_dot * plant.nu).xreplace(plant.numbers))
        moving = (plant.C + plant.D) * plant.nu
        self._moving = [
            enclosing([*_ANGLES, *nu], plant.one_way(moving, one.way).xreplace(plant.numbers))
            for one in problem.sets
        ]

    def speeds(self, errors: Array) -> Array:
        """Bound on the body velocities in the box of these errors, shape (n,)."""
        angles = self._problem.attitudes.every_angle(self._boxes(errors))
        nu = self._backward(*angles) @ self._rates(errors)
        return np.asarray(nu.size.max(axis=0)[:, 0])

    def _rates(self, errors: Array) -> Interval:
        """What q_dot can be in the box, shape (n, 1)."""
        fastest = 2 * (self._problem.values["Lambda"] * errors)[:, None]
        return within(fastest)

    def _boxes(self, errors: Array) -> dict[str, Interval]:
        reach = dict(zip(self._problem.coordinates, map(float, errors), strict=True))
        return self._problem.attitudes.boxes({a: reach[a] for a in ("phi", "theta") if a in reach})

    def bounds(self, errors: Array) -> Array:
        """Bound on the magnitude of each command in the box, shape (m,)."""
        problem, boxes = self._problem, self._boxes(errors)
        angles = problem.attitudes.every_angle(boxes)
        inverse, rate = self._backward(*angles), self._rates(errors)
        nu = inverse @ rate
        speeds = [nu[..., i, 0] for i in range(problem.size)]
        jump = self._reach(errors)[:, None]
        braked = problem.values["Lambda"][:, None] * rate
        wanted = within(jump) - self._turning(*angles, *speeds) - braked
        rest = self._commands.at_rest(boxes)
        found = []
        for one, moving in zip(problem.sets, self._moving, strict=True):
            force = one.inertia @ (inverse @ wanted) + moving(*angles, *speeds)
            found.append((self._commands.share @ force).size[..., 0].max(axis=0))
        return rest + np.max(found, axis=0)

    def _reach(self, errors: Array) -> Array:
        """Bound on what drives S to zero, shape (n,), m/s^2 and rad/s^2."""
        values = self._problem.values
        if "K_Z" in values:
            return values["K_Z"]
        surface = values["Lambda"] * errors
        # |twist| from V = K_2 |S| + twist^2/2 of a start with twist zero.
        return values["K_1"] * np.sqrt(surface) + np.sqrt(2 * values["K_2"] * surface)


# --- parameters that are known within a box -------------------------------------------------------
def shifts(spread: Spread) -> list[sm.Symbol]:
    """How far each uncertain parameter is from the middle of its interval, from -1 to 1."""
    return [sm.Symbol(f"shift_{parameter}") for parameter in spread]


class Slopes:
    """What uncertain parameters add to a matrix: sums of their shifts times slopes, and bounds on the rest.

    The mean value theorem bounds what parameters add that stand in a product with each other.
    """

    def __init__(self, signs: Sequence[sm.Symbol], matrix: sm.Matrix, spread: Spread, cases: Array) -> None:
        own = shifts(spread)
        here = [enclose(c) for c in cases.T]
        none, every = [enclose(np.zeros(1))] * len(own), [within(np.ones(1))] * len(own)
        parts = [enclosing([*signs, *own], matrix.diff(s)) for s in own]
        self.value = enclosing([*signs, *own], matrix)(*here, *none)
        self.each = [part(*here, *none) for part in parts]
        wide = [part(*here, *every) for part in parts]
        nothing = np.zeros_like(self.value.lo)
        self.curved = sum(((w - e).size for w, e in zip(wide, self.each, strict=True)), nothing)
        self.size = sum((w.size for w in wide), nothing)  # of all that they add


class Inverses(NamedTuple):
    """Inverses of M by case of the signs: middle + sum of shifts times slopes, off by `rest` at most."""

    middle: Interval
    slopes: list[Interval]
    rest: Array

    @property
    def whole(self) -> Interval:
        """All of them."""
        return self.middle + within(sum((s.size for s in self.slopes), self.rest))


def inverses_of_inertia(problem: Problem, cases: Array) -> Inverses:
    """M^-1 of every parameter in its box.

    With X what parameters add to M, times M_0^-1: M^-1 = M_0^-1 (I - X + X^2 (I + X)^-1).
    """
    plant, spread = problem.plant, problem.spread
    signs = sizes_and_signs(plant)[1]
    M = Slopes(signs, plain(plant, plant.M, spread), spread, cases)
    middle = inverse_of_inertia(M.value)
    if not spread:
        return Inverses(middle, [], M.curved)
    W, X = enclose(middle.size), enclose(M.size) @ middle.size
    if np.abs(np.linalg.eigvals(X.hi)).max() >= 0.9:
        raise UndertowError(
            "the mass matrix may be singular within the uncertainty of its parameters: state a smaller one"
        )
    beyond = X @ X @ inverse_of_inertia(enclose(np.eye(len(plant.nu))) - X)
    rest = W @ (beyond + enclose(M.curved) @ W)
    return Inverses(middle, [-(middle @ one @ middle) for one in M.each], rest.size)


def inverse_of_inertia(matrix: Interval) -> Interval:
    """Inverses of matrices of nearly no width, enclosed by what is left of the identity."""
    near = np.linalg.inv(matrix.middle)
    n = near.shape[-1]
    left = (enclose(np.eye(n)) - near @ matrix).size.sum(axis=-1).max(axis=-1) * (1 + n * _EPS)
    if not (left < 0.5).all():
        raise UndertowError("the mass matrix is too badly conditioned for a certificate: check [effects]")
    return near + within((2 * left)[..., None, None] * np.abs(near).max(axis=-2, keepdims=True))


# --- what motion does to the matrices -------------------------------------------------------------
class Term(NamedTuple):
    """One product in an entry of a matrix."""

    row: int
    column: int
    powers: tuple[int, ...]  # of the velocities, their magnitudes, their signs, and shifts of parameters
    value: float


def sizes_and_signs(plant: Plant) -> tuple[list[sm.Symbol], list[sm.Symbol]]:
    """Symbols for the magnitudes and the signs of the velocities."""
    sizes, signs = ([sm.Symbol(f"{kind}_{v}") for v in plant.nu] for kind in ("size", "sign"))
    return sizes, signs


def plain(plant: Plant, matrix: sm.Matrix, spread: Spread = NO_SPREAD) -> sm.Matrix:
    """Numbers for parameters, symbols for magnitudes and signs of velocities, and for what is uncertain."""
    found: dict[sm.Expr, sm.Expr] = {}
    for v, size, sign in zip(plant.nu, *sizes_and_signs(plant), strict=True):
        found |= {sm.Abs(v): size, sm.sign(v): sign}
    for (parameter, (low, high)), shift in zip(spread.items(), shifts(spread), strict=True):
        middle = 0.5 * (low + high)
        half = np.nextafter(max(high - middle, middle - low), np.inf)
        found[parameter] = sm.Float(middle) + sm.Float(half) * shift
    return matrix.xreplace(found).xreplace(plant.numbers)


def terms_of(plant: Plant, matrix: sm.Matrix, spread: Spread = NO_SPREAD) -> list[Term]:
    """Damping and the like as a sum of products of numbers, velocities, their magnitudes and signs.

    Raises
    ------
    UndertowError
        If it is no such sum.
    """
    symbols = [*plant.nu, *(s for kind in sizes_and_signs(plant) for s in kind), *shifts(spread)]
    moving, found = plain(plant, matrix, spread).applyfunc(sm.expand), []
    for i, j in product(range(len(plant.nu)), repeat=2):
        if not moving[i, j].is_polynomial(*symbols) or moving[i, j].free_symbols - set(symbols):
            raise UndertowError("damping is no polynomial in velocities and their magnitudes")
        terms = sm.Poly(moving[i, j], *symbols).terms()
        found += [Term(i, j, powers, float(value)) for powers, value in terms if value]
    return found


@dataclass(frozen=True)
class FastDamping:
    """A bound on what D(nu) may take away from D(0), by magnitudes of velocities."""

    size: int  # number of velocities
    falling: tuple[Term, ...]  # terms of D(nu) - D(0), but those of the diagonal that are never negative

    @property
    def falls(self) -> bool:
        """Whether damping at speed may be less than at rest."""
        return bool(self.falling)

    def loss(self, speeds: Array) -> Array:
        """What damping can lose while |nu| <= speeds: |nu' (D(nu) - D(0)) nu| <= |nu|' loss |nu|, (n, n)."""
        found = np.zeros((self.size, self.size))
        for i, j, powers, value in self.falling:
            found[i, j] += abs(value) * float(
                np.prod(np.tile(speeds, 2) ** np.array(powers[: 2 * self.size]))
            )
        return 0.5 * (found + found.T)


def fast_damping(plant: Plant, one: SignSet) -> FastDamping:
    """The bound for one sign set."""
    n = len(plant.nu)
    moving = [t for t in terms_of(plant, plant.one_way(plant.D, one.way)) if any(t.powers)]
    never = [t for t in moving if t.row == t.column and t.value > 0 and all(p % 2 == 0 for p in t.powers[:n])]
    return FastDamping(n, tuple(t for t in moving if t not in never))
