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

from .attitude import ANGLES, Interval, enclose, enclosing, plus_minus
from .problem import EXACT_PARAMETERS, ParameterBox, Problem, SignSet
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
        self.B_inverse, self.limits = (allocation.B_inverse[limited], allocation.limits[limited])
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
        held = self._restoring_enclosed(*self.problem.attitudes.every_angle(boxes))
        return np.asarray(held.magnitude[..., 0].max(axis=0))

    def restoring_slopes(self, boxes: dict[str, Interval]) -> Interval:
        """How what compensates weight and buoyancy changes with roll and pitch, shape (boxes, m, 2)."""
        return self._restoring_slopes(*self.problem.attitudes.every_angle(boxes))

    @cached_property
    def _restoring_slopes(self) -> Callable[..., Interval]:
        return enclosing(_ANGLES, sm.Matrix.hstack(*(self._restoring.diff(a) for a in _ANGLES[:2])))

    @cached_property
    def _restoring_enclosed(self) -> Callable[..., Interval]:
        return enclosing(_ANGLES, self._restoring)

    @cached_property
    def _restoring(self) -> sm.Matrix:
        """What compensates weight and buoyancy, by command with a limit."""
        plant = self.problem.plant
        force = plant.g.xreplace(plant.numbers)
        others = force.free_symbols - set(_ANGLES)
        if others:
            raise UndertowError(
                f"the force at rest depends on {', '.join(sorted(map(str, others)))}: whether the thrusters "
                "can hold it everywhere is not certified"
            )
        return sm.Matrix(self.B_inverse) * force

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
    squares = [_squared_bound(problem, J, row) for row in commands.B_inverse]
    return rest + np.sqrt(2 * level * np.array(squares))


def _squared_bound(problem: Problem, J: Interval, row: Array) -> float:
    w = J @ row[:, None]
    spring = ((w.magnitude[..., 0] ** 2) @ problem.values["K_P"]).max()
    damped = J.T @ (problem.values["K_V"][:, None] * w)
    roots = [np.linalg.inv(np.linalg.cholesky(m)) for m in inertias(problem.sets)]
    return float(spring + max(((root @ damped).magnitude[..., 0] ** 2).sum(axis=-1).max() for root in roots))


def inertias(sets: Sequence[SignSet]) -> list[Array]:
    """Inertia matrices below that of every sign set; one where all are diagonal."""
    return _lower_bounds([sign_set.inertia for sign_set in sets])


def dampings(sets: Sequence[SignSet]) -> list[Array]:
    """The same of damping at rest, symmetric parts."""
    return _lower_bounds([0.5 * (sign_set.damping + sign_set.damping.T) for sign_set in sets])


def _lower_bounds(matrices: list[Array]) -> list[Array]:
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
        self._J_inverse = enclosing(_ANGLES, plant.J_inverse)
        self._J_dot_nu = enclosing([*_ANGLES, *nu], (plant.J_dot * plant.nu).xreplace(plant.numbers))
        force = (plant.C + plant.D) * plant.nu
        self._velocity_force = [
            enclosing([*_ANGLES, *nu], plant.with_signs(force, sign_set.signs).xreplace(plant.numbers))
            for sign_set in problem.sets
        ]

    def speeds(self, errors: Array) -> Array:
        """Bound on the body velocities in the box of these errors, shape (n,)."""
        angles = self._problem.attitudes.every_angle(self._boxes(errors))
        nu = self._J_inverse(*angles) @ self._rates(errors)
        return np.asarray(nu.magnitude.max(axis=0)[:, 0])

    def _rates(self, errors: Array) -> Interval:
        """What q_dot can be in the box, shape (n, 1)."""
        fastest = 2 * (self._problem.values["Lambda"] * errors)[:, None]
        return plus_minus(fastest)

    def _boxes(self, errors: Array) -> dict[str, Interval]:
        reach = dict(zip(self._problem.coordinates, map(float, errors), strict=True))
        return self._problem.attitudes.boxes({a: reach[a] for a in ("phi", "theta") if a in reach})

    def bounds(self, errors: Array) -> Array:
        """Bound on the magnitude of each command in the box, shape (m,)."""
        problem, boxes = self._problem, self._boxes(errors)
        angles = problem.attitudes.every_angle(boxes)
        inverse, rate = self._J_inverse(*angles), self._rates(errors)
        nu = inverse @ rate
        speeds = [nu[..., i, 0] for i in range(problem.size)]
        jump = self._reaching_rate(errors)[:, None]
        damping = problem.values["Lambda"][:, None] * rate
        acceleration = plus_minus(jump) - self._J_dot_nu(*angles, *speeds) - damping
        rest = self._commands.at_rest(boxes)
        found = []
        for sign_set, velocity_force in zip(problem.sets, self._velocity_force, strict=True):
            force = sign_set.inertia @ (inverse @ acceleration) + velocity_force(*angles, *speeds)
            found.append((self._commands.B_inverse @ force).magnitude[..., 0].max(axis=0))
        return rest + np.max(found, axis=0)

    def _reaching_rate(self, errors: Array) -> Array:
        """Bound on what drives S to zero, shape (n,), m/s^2 and rad/s^2."""
        values = self._problem.values
        if "K_Z" in values:
            return values["K_Z"]
        surface = values["Lambda"] * errors
        # |twist| from V = K_2 |S| + twist^2/2 of a start with twist zero.
        return values["K_1"] * np.sqrt(surface) + np.sqrt(2 * values["K_2"] * surface)


# --- parameters that are known within a box -------------------------------------------------------
def shift_symbols(box: ParameterBox) -> list[sm.Symbol]:
    """How far each uncertain parameter is from the middle of its interval, from -1 to 1."""
    return [sm.Symbol(f"shift_{parameter}") for parameter in box]


class ParameterSlopes:
    """What uncertain parameters add to a matrix: sums of their shifts times slopes, and bounds on the rest.

    The mean value theorem bounds what parameters add that stand in a product with each other.
    """

    def __init__(
        self, signs: Sequence[sm.Symbol], matrix: sm.Matrix, box: ParameterBox, cases: Array
    ) -> None:
        symbols = shift_symbols(box)
        at_signs = [enclose(c) for c in cases.T]
        no_shift, any_shift = [enclose(np.zeros(1))] * len(symbols), [plus_minus(np.ones(1))] * len(symbols)
        derivatives = [enclosing([*signs, *symbols], matrix.diff(s)) for s in symbols]
        self.value = enclosing([*signs, *symbols], matrix)(*at_signs, *no_shift)
        self.slopes = [part(*at_signs, *no_shift) for part in derivatives]
        wide = [part(*at_signs, *any_shift) for part in derivatives]
        zero = np.zeros_like(self.value.lo)
        self.remainder = sum(((w - e).magnitude for w, e in zip(wide, self.slopes, strict=True)), zero)
        self.magnitude = sum((w.magnitude for w in wide), zero)  # of all that they add


class InertiaInverses(NamedTuple):
    """Inverses of M by case of the signs: middle + sum of shifts times slopes, off by `remainder` at most."""

    middle: Interval
    slopes: list[Interval]
    remainder: Array

    @property
    def enclosure(self) -> Interval:
        """All of them."""
        return self.middle + plus_minus(sum((s.magnitude for s in self.slopes), self.remainder))


def inverses_of_inertia(problem: Problem, cases: Array) -> InertiaInverses:
    """M^-1 of every parameter in its box.

    With X what parameters add to M, times M_0^-1: M^-1 = M_0^-1 (I - X + X^2 (I + X)^-1).
    """
    plant, box = problem.plant, problem.parameter_box
    signs = sizes_and_signs(plant)[1]
    M = ParameterSlopes(signs, numeric_matrix(plant, plant.M, box), box, cases)
    middle = inverse_of_inertia(M.value)
    if not box:
        return InertiaInverses(middle, [], M.remainder)
    W, X = enclose(middle.magnitude), enclose(M.magnitude) @ middle.magnitude
    if np.abs(np.linalg.eigvals(X.hi)).max() >= 0.9:
        raise UndertowError(
            "the mass matrix may be singular within the uncertainty of its parameters: state a smaller one"
        )
    beyond = X @ X @ inverse_of_inertia(enclose(np.eye(len(plant.nu))) - X)
    rest = W @ (beyond + enclose(M.remainder) @ W)
    return InertiaInverses(middle, [-(middle @ slope @ middle) for slope in M.slopes], rest.magnitude)


def inverse_of_inertia(matrix: Interval) -> Interval:
    """Inverses of matrices of nearly no width, enclosed by what is left of the identity."""
    near = np.linalg.inv(matrix.middle)
    n = near.shape[-1]
    left = (enclose(np.eye(n)) - near @ matrix).magnitude.sum(axis=-1).max(axis=-1) * (1 + n * _EPS)
    if not (left < 0.5).all():
        raise UndertowError("the mass matrix is too badly conditioned for a certificate: check [effects]")
    return near + plus_minus((2 * left)[..., None, None] * np.abs(near).max(axis=-2, keepdims=True))


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


def numeric_matrix(plant: Plant, matrix: sm.Matrix, box: ParameterBox = EXACT_PARAMETERS) -> sm.Matrix:
    """Numbers for parameters, symbols for magnitudes and signs of velocities, and for what is uncertain."""
    found: dict[sm.Expr, sm.Expr] = {}
    for v, size, sign in zip(plant.nu, *sizes_and_signs(plant), strict=True):
        found |= {sm.Abs(v): size, sm.sign(v): sign}
    for (parameter, (low, high)), shift in zip(box.items(), shift_symbols(box), strict=True):
        middle = 0.5 * (low + high)
        half = np.nextafter(max(high - middle, middle - low), np.inf)
        found[parameter] = sm.Float(middle) + sm.Float(half) * shift
    return matrix.xreplace(found).xreplace(plant.numbers)


def terms_of(plant: Plant, matrix: sm.Matrix, box: ParameterBox = EXACT_PARAMETERS) -> list[Term]:
    """Damping and the like as a sum of products of numbers, velocities, their magnitudes and signs."""
    symbols = [*plant.nu, *(s for kind in sizes_and_signs(plant) for s in kind), *shift_symbols(box)]
    moving, found = numeric_matrix(plant, matrix, box).applyfunc(sm.expand), []
    for i, j in product(range(len(plant.nu)), repeat=2):
        if not moving[i, j].is_polynomial(*symbols) or moving[i, j].free_symbols - set(symbols):
            dof = plant.vehicle.degrees_of_freedom[i]
            raise UndertowError(f"damping of {dof} is no polynomial in velocities and their magnitudes")
        terms = sm.Poly(moving[i, j], *symbols).terms()
        found += [Term(i, j, powers, float(value)) for powers, value in terms if value]
    return found


@dataclass(frozen=True)
class DampingLoss:
    """A bound on what D(nu) may take away from D(0), by magnitudes of velocities."""

    size: int  # number of velocities
    decreasing: tuple[Term, ...]  # terms of D(nu) - D(0), but those of the diagonal that are never negative

    @property
    def decreases(self) -> bool:
        """Whether damping at speed may be less than at rest."""
        return bool(self.decreasing)

    def loss(self, speeds: Array) -> Array:
        """What damping can lose while |nu| <= speeds: |nu' (D(nu) - D(0)) nu| <= |nu|' loss |nu|, (n, n)."""
        found = np.zeros((self.size, self.size))
        for i, j, powers, value in self.decreasing:
            found[i, j] += abs(value) * float(
                np.prod(np.tile(speeds, 2) ** np.array(powers[: 2 * self.size]))
            )
        return 0.5 * (found + found.T)


def damping_loss(plant: Plant, sign_set: SignSet) -> DampingLoss:
    """The bound for one sign set."""
    n = len(plant.nu)
    moving = [t for t in terms_of(plant, plant.with_signs(plant.D, sign_set.signs)) if any(t.powers)]
    never = [t for t in moving if t.row == t.column and t.value > 0 and all(p % 2 == 0 for p in t.powers[:n])]
    return DampingLoss(n, tuple(t for t in moving if t not in never))
