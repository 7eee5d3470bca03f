"""The closed loop of PD and PID control as z_dot = A(angles, nu) z, enclosed in intervals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import sympy as sm

from undertow.control.plant import Plant
from undertow.errors import UndertowError
from undertow.model.symbols import symbol
from undertow.typing import Array, Index

from .attitude import ANGLES, Interval, block, enclose, enclosing, plus_minus
from .commands import (
    Commands,
    InertiaInverses,
    ParameterSlopes,
    Term,
    inverses_of_inertia,
    numeric_matrix,
    shift_symbols,
    sizes_and_signs,
    terms_of,
)
from .problem import EXACT_PARAMETERS, ParameterBox, Problem

_EPS = float(np.finfo(float).eps)
_ANGLES = [symbol(a) for a in ANGLES]


def proved_positive_definite(matrix: Interval) -> bool:
    """Whether every symmetric matrix in a stack of intervals is positive definite, proved.

    By the Cholesky factorisation in floating point of a matrix that is lowered by the radii and by a bound of
    its rounding (Rump 2006, Verification of positive definiteness, BIT 46).
    """
    symmetric = 0.5 * (matrix + matrix.T)
    middle, radius = symmetric.middle, symmetric.radius
    diagonal = np.einsum("...ii->...i", middle)
    if not np.isfinite(radius).all() or not (diagonal > 0).all():
        return False
    scale = 2.0 ** np.round(-0.5 * np.log2(diagonal))  # powers of two scale without rounding
    both = scale[..., :, None] * scale[..., None, :]
    middle, radius = middle * both, radius * both
    n = middle.shape[-1]
    rounding = 8 * (n + 2) * _EPS * np.trace(middle, axis1=-2, axis2=-1)
    lowered = radius.sum(axis=-1) * (1 + n * _EPS) + rounding[..., None]
    try:
        np.linalg.cholesky(middle - lowered[..., None] * np.eye(n))
    except np.linalg.LinAlgError:
        return False
    return True


class Jet:
    """A matrix that depends on one angle, with its first two derivatives, all as intervals."""

    def __init__(self, value: Interval, slope: Interval, curvature: Interval) -> None:
        self.value, self.slope, self.curvature = value, slope, curvature

    def __matmul__(self, other: Any) -> Jet:
        o = _jet(other)
        curvature = self.curvature @ o.value + 2.0 * (self.slope @ o.slope) + self.value @ o.curvature
        return Jet(self.value @ o.value, self.slope @ o.value + self.value @ o.slope, curvature)

    def __add__(self, other: Any) -> Jet:
        o = _jet(other)
        return Jet(self.value + o.value, self.slope + o.slope, self.curvature + o.curvature)

    def __neg__(self) -> Jet:
        return Jet(-self.value, -self.slope, -self.curvature)

    def __sub__(self, other: Any) -> Jet:
        return self + -_jet(other)

    def __mul__(self, other: Array) -> Jet:
        return Jet(self.value * other, self.slope * other, self.curvature * other)

    @property
    def T(self) -> Jet:
        """Transposes."""
        return Jet(self.value.T, self.slope.T, self.curvature.T)


def _jet(value: Any) -> Jet:
    """What does not depend on the angle, too."""
    if isinstance(value, Jet):
        return value
    value = enclose(value)
    none = enclose(np.zeros_like(value.lo))
    return Jet(value, none, none)


def rotation_of(plant: Plant) -> sm.Matrix:
    """How the translations turn from body to earth.

    What is no rotation, as with some axes left out, is refused: then the frame of an error matters, and
    inertia equal in all axes turns, too.
    """
    own = [i for i, d in enumerate(plant.vehicle.dof_indices) if d < 3]
    rotation = plant.J.extract(own, own)
    if plant.J_inverse.extract(own, own) != rotation.T:
        raise UndertowError(
            "its translations do not turn as a rotation: no quadratic V nor bounds in time are searched for"
        )
    return rotation


def sign_cases(switching: Sequence[int], n: int) -> Array:
    """All cases of the signs of some of n velocities, shape (cases, n); one for the others."""
    cases = np.ones((2 ** len(switching), n))
    cases[:, switching] = list(product((1.0, -1.0), repeat=len(switching)))
    return cases


Boxes = dict[str, Interval]
"""Boxes of angles by name, each an interval of shape (boxes,); empty where nothing depends on angles."""


@dataclass(frozen=True)
class Matrices:
    """What the loop is made of at some velocities, or what a velocity adds to it."""

    inverse: Interval  # of the mass matrix, shape (k, n, n)
    velocity: Interval  # C + D
    skew: Interval  # S(omega) of the translations, zero elsewhere


@dataclass(frozen=True)
class Corners:
    """The corners of a box of velocities as sums: A = A_rest + sum over velocities of what its end adds.

    No entry has a product of two velocities, so that a corner of the box is one end for each of them. Where a
    sign changes the mass matrix, or stands beside another velocity, each sign is a case of its own.
    """

    rest: Matrices  # without motion, by case of the signs
    ends: Sequence[Matrices]  # by velocity: what its ends add, those of the first case before the second's
    hull: Matrices  # one interval around all that velocities do, with the mass matrices of all cases
    switching: Sequence[int]  # velocities whose sign is that of the case; their second end is rest
    values: Sequence[Array]  # by velocity: its value at its ends, shape (cases, ends)
    # By uncertain parameter, at the upper end of its interval: what it adds to the inverse of the mass matrix
    # beside C + D without motion, and to C + D.
    shifts: Sequence[tuple[Matrices, Matrices]]
    remainder: Matrices  # what parameters do to both together: A is off by up to their product

    @property
    def cases(self) -> int:
        """How many cases of the signs there are."""
        return len(self.rest.inverse)


class Embedding:
    """z_dot = A z with z = (integral, error, velocity); the integral is missing in PD control.

    With J = diag(R, T), R the rotation of the translations, errors stand in a frame that is turned by G, the
    velocity of the translations too: E = G' e, w = L nu, L = diag(G' R, I). G is R where every gain commutes
    with it (then no attitude is left but that in T), else the identity. With N = diag(I, T) and
    Omega = G_dot' G

        E_dot = Omega E - N w,   integral_dot = Omega integral + E,
        w_dot = L_dot L' w + L M^-1 [L' N' (K_P E + K_I integral - K_V N w) - (C + D) L' w].

    Entries are affine in every velocity while no sign changes, and no entry has a product of two velocities,
    so A(nu) is A at rest and for each velocity something within the hull of its ends.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem, self.plant = problem, problem.plant
        plant = problem.plant
        dofs = plant.vehicle.dof_indices
        self.n = len(dofs)
        self.translations = [i for i, d in enumerate(dofs) if d < 3]
        self.rotations = [i for i, d in enumerate(dofs) if d >= 3]
        self._gains = [np.diag(problem.values[g]) for g in ("K_P", "K_V", "K_I") if g in problem.values]
        self.integral = "K_I" in problem.values
        self.size = (3 if self.integral else 2) * self.n
        rotation, unit = rotation_of(plant), sm.eye(len(self.translations))
        diagonals = [np.diag(K)[self.translations] for K in self._gains]
        pairs = product(range(rotation.rows), repeat=2)
        self._in_body_frame = all(
            rotation[i, j] == 0 or all(k[i] == k[j] for k in diagonals) for i, j in pairs if i != j
        )
        self._frame_rotation, rest_rotation = (rotation, unit) if self._in_body_frame else (unit, rotation)
        L = sm.eye(self.n)
        for i, a in enumerate(self.translations):
            for j, b in enumerate(self.translations):
                L[a, b] = rest_rotation[i, j]
        N = sm.eye(self.n)
        for a in self.rotations:
            for b in self.rotations:
                N[a, b] = plant.J[a, b]
        self._matrices = {"L": L, "N": N}
        self._functions: dict[str, Callable[..., Interval]] = {}
        self.angles = tuple(a for a in ANGLES if symbol(a) in (L.free_symbols | N.free_symbols))

    # --- frames -------------------------------------------------------------------------------

    @property
    def frame_name(self) -> str:
        """Which frame errors stand in."""
        return "body" if self._in_body_frame else "earth"

    @cached_property
    def groups(self) -> list[list[int]]:
        """Coordinates that the frame mixes, so that a bound on one has to be that on all of them."""
        indices = range(len(self.translations))
        mixed = [[j for j in indices if self._frame_rotation[i, j] != 0] for i in indices]
        merged: list[set[int]] = []
        for row in map(set, mixed):
            touching = [g for g in merged if g & row]
            merged = [g for g in merged if not g & row] + [row.union(*touching)]
        return [sorted(self.translations[i] for i in g) for g in merged] + [[i] for i in self.rotations]

    def _at(self, name: str, angles: Mapping[str, Interval], by: str = "", order: int = 0) -> Interval:
        """L or N, or a derivative by an angle, shape (boxes, 1, n, n)."""
        key = f"{name} {by} {order}"
        if key not in self._functions:
            matrix = self._matrices[name]
            self._functions[key] = enclosing(_ANGLES, matrix.diff(symbol(by), order) if order else matrix)
        return self._functions[key](*self.problem.attitudes.every_angle(dict(angles)))[:, None]

    @cached_property
    def half_turn(self) -> Array:
        """F, the turn by half a circle in the plane: A(psi + pi) = F A(psi) F, whatever the gains."""
        names = self.problem.coordinates
        signs = [-1.0 if c in ("x", "y") else 1.0 for c in names]
        return np.tile(signs, self.size // self.n)

    # --- velocities -----------------------------------------------------------------------------
    @cached_property
    def _velocity(self) -> _Velocity:
        """C + D and M as functions of velocities, their magnitudes and signs."""
        plant, nu, box = self.plant, list(self.plant.nu), self.problem.parameter_box
        sizes, signs = sizes_and_signs(plant)
        moving = numeric_matrix(plant, plant.C + plant.D, box).applyfunc(sm.expand)
        switching = _switching(plant, numeric_matrix(plant, plant.M))
        first = [sm.Symbol(f"first_{v}") for v in nu]
        rest = moving.xreplace(dict.fromkeys([*nu, *sizes], sm.Integer(0)))
        added = (moving - rest.xreplace(dict(zip(signs, first, strict=True)))).applyfunc(sm.expand)
        used = moving.free_symbols
        kinds = zip(signs, sizes, strict=True)  # a velocity turns the frame at least
        counts = [2 if i in switching else 4 if s in used else 3 if a in used else 2
                  for i, (s, a) in enumerate(kinds)]  # fmt: skip
        enclosed = enclosing([*nu, *sizes, *signs, *first, *shift_symbols(box)], added)
        any_shift = [plus_minus(np.ones(1))] * len(box)
        return _Velocity(rest, lambda *values: enclosed(*values, *any_shift), switching, counts)

    @cached_property
    def _at_rest(self) -> tuple[Array, InertiaInverses, ParameterSlopes]:
        """Cases of the signs, and in each of them the inverse of M, and C + D without motion."""
        cases, box = sign_cases(self._velocity.switching, self.n), self.problem.parameter_box
        at_rest = ParameterSlopes(sizes_and_signs(self.plant)[1], self._velocity.rest, box, cases)
        return cases, inverses_of_inertia(self.problem, cases), at_rest

    def corners(self, speeds: Array) -> Corners:
        """The corners of |nu_i| <= speeds_i."""
        m, n = self._velocity, self.n
        cases, inverses, damping = self._at_rest
        inverse, zero = inverses.enclosure, np.zeros((len(cases), n))
        still = enclose(self._skew(zero))
        rest = Matrices(
            inverses.middle + plus_minus(inverses.remainder),
            damping.value + plus_minus(damping.remainder),
            still,
        )
        remainder = Matrices(inverse - inverses.middle, plus_minus(damping.magnitude), still)
        shifts = [
            (Matrices(slope, damping.value, still), Matrices(inverses.middle, each, still))
            for slope, each in zip(inverses.slopes, damping.slopes, strict=True)
        ]
        ends, values = zip(*(self._ends(i, float(speeds[i]), cases, inverse) for i in range(n)), strict=True)
        nu, any_sign = plus_minus(speeds[None]), plus_minus(np.ones((1, n)))
        hull = inverse.lo.min(axis=0)[None], inverse.hi.max(axis=0)[None]
        at_rest = damping.value + plus_minus(damping.magnitude)
        velocity = Interval(at_rest.lo.min(axis=0)[None], at_rest.hi.max(axis=0)[None]) + m.added(
            *_columns(nu), *_columns(abs(nu)), *_columns(any_sign), *_columns(any_sign)
        )
        spin = plus_minus(np.abs(self._skew(np.array(speeds, dtype=float)[None])))
        total = Matrices(Interval(*hull), velocity, spin)
        return Corners(rest, ends, total, m.switching, values, shifts, remainder)

    def _ends(self, i: int, speed: float, cases: Array, inverse: Interval) -> tuple[Matrices, Array]:
        """What the ends of one velocity add in every case, and its value at them, (cases, ends)."""
        m, switched = self._velocity, i in self._velocity.switching
        rows = []
        for k, case in enumerate(cases):
            own = (
                [(case[i] * speed, case[i]), (0.0, case[i])] if switched else _speed_ends(speed, m.counts[i])
            )
            rows += [(k, value, sign) for value, sign in own]
        case_of_row = np.array([k for k, _, _ in rows])
        nu, signs = np.zeros((len(rows), self.n)), cases[case_of_row].copy()
        nu[:, i], signs[:, i] = [v for _, v, _ in rows], [s for _, _, s in rows]
        points = [enclose(c) for c in (*nu.T, *np.abs(nu).T, *signs.T)]
        added = m.added(*points, *_columns(cases[case_of_row]))
        ends = Matrices(inverse[case_of_row], added, enclose(self._skew(nu)))
        return ends, nu[:, i].reshape(len(cases), -1)

    def _skew(self, nu: Array) -> Array:
        """S(omega) of the translations, shape (k, n, n)."""
        dofs = list(self.plant.vehicle.dof_indices)
        omega = np.zeros((len(nu), 3))
        for i in self.rotations:
            omega[:, dofs[i] - 3] = nu[:, i]
        p, q, r = omega.T
        zero = np.zeros_like(p)
        S = np.array([[zero, -r, q], [r, zero, -p], [-q, p, zero]]).transpose(2, 0, 1)
        found = np.zeros((len(nu), self.n, self.n))
        own, rows = [dofs[i] for i in self.translations], range(len(nu))
        found[np.ix_(rows, self.translations, self.translations)] = S[np.ix_(rows, own, own)]
        return found

    # --- the loop -------------------------------------------------------------------------------
    def rest(self, at: Corners, angles: Mapping[str, Interval]) -> Interval:
        """A without motion in every case for every box of angles, shape (boxes, cases, size, size)."""
        transforms = {m: self._at(m, angles) for m in self._matrices}
        found: Interval = block(self._blocks(at.rest, transforms))
        return found + block(self._blocks(at.remainder, transforms, stiffness=False)) if at.shifts else found

    def added(self, at: Corners, angles: Mapping[str, Interval]) -> list[Interval]:
        """What the ends of each velocity add to A, each of shape (boxes, cases, ends, size, size).

        With a single box where no attitude changes it. Those of each uncertain parameter follow.
        """
        if self._in_body_frame and not at.shifts:
            angles = {a: v[:1] for a, v in angles.items()}
        enclosed = {m: self._at(m, angles) for m in self._matrices}
        blocks = [block(self._blocks(e, enclosed, stiffness=False)) for e in at.ends]
        terms = [b.reshape(len(b), at.cases, -1, self.size, self.size) for b in blocks]
        for inertia, velocity in at.shifts:
            term = block(self._blocks(inertia, enclosed, kinematics=False))
            term = term + block(self._blocks(velocity, enclosed, stiffness=False))
            terms.append(
                Interval(np.stack([term.lo, -term.hi], axis=2), np.stack([term.hi, -term.lo], axis=2))
            )
        return terms

    def curvature(self, at: Corners, angles: Mapping[str, Interval], by: str) -> Array:
        """Bound on |second derivative of A by one angle| in each box, shape (boxes, size, size)."""
        jets = {
            m: Jet(self._at(m, angles), self._at(m, angles, by, 1), self._at(m, angles, by, 2))
            for m in self._matrices
        }
        cells = [[_jet(c).curvature for c in row] for row in self._blocks(at.hull, jets)]
        return np.asarray(block(cells).magnitude[:, 0])

    def body(self, angles: Mapping[str, Interval], by: str = "", order: int = 0) -> Interval:
        """T of (integral, error, nu) = T' z, or a derivative by an angle, shape (boxes, 1, size, size)."""
        if self._in_body_frame:
            angles = {a: v[:1] for a, v in angles.items()}
        other = self.size - self.n
        unit, none = np.eye(other) * (order == 0), np.zeros((other, self.n))
        return block([[unit, none], [none.T, self._at("L", angles, by, order)]])  # type: ignore[no-any-return]

    def body_jet(self, angles: Mapping[str, Interval], by: str) -> Jet:
        """T with its derivatives by one angle."""
        return Jet(*(self.body(angles, by if order else "", order) for order in range(3)))

    def _blocks(
        self, at: Matrices, matrices: Mapping[str, Any], *, stiffness: bool = True, kinematics: bool = True
    ) -> list[list[Any]]:
        """A in blocks of (integral, error, velocity), intervals or with derivatives.

        Without `stiffness` it is what motion adds; without `kinematics` what no parameter changes is missing.
        """
        L, N = matrices["L"], matrices["N"]
        K = dict(zip(("K_P", "K_V", "K_I"), self._gains, strict=False))
        L_M_inv = L @ at.inverse  # L M^-1
        Omega: Any = enclose(np.zeros_like(at.skew.lo))
        if self._in_body_frame:
            Omega, L_dot = -at.skew, Omega
        else:
            L_dot = L @ at.skew @ L.T
        velocity = -(L_M_inv @ at.velocity @ L.T) + L_dot
        none, unit = np.zeros((1, self.n, self.n)), np.eye(self.n)[None] * kinematics
        if not stiffness:
            zero = enclose(np.zeros_like(velocity.lo))
            rows = [[Omega, zero], [zero, velocity]]
            return [[Omega, zero, zero], *([zero, *row] for row in rows)] if self.integral else rows
        force = L_M_inv @ (L.T @ N.T)
        velocity = velocity - force @ K["K_V"] @ N
        error = force @ K["K_P"]
        rate = -N if kinematics else none
        if not self.integral:
            return [[Omega, rate], [error, velocity]]
        return [[Omega, unit, none], [none, Omega, rate], [force @ K["K_I"], error, velocity]]

    def speeds_of(self, angles: Mapping[str, Interval]) -> Interval:
        """Rows that give the body velocities from z, shape (boxes, n, size)."""
        L = self._at("L", angles)
        none = np.zeros((self.n, self.size - self.n))
        return block([[none, L.T]])[:, 0]  # type: ignore[no-any-return]

    def commands_of(self, commands: Commands, angles: Mapping[str, Interval]) -> Interval:
        """Rows that give what each limited command adds to that at rest, shape (boxes, m, size)."""
        L, N = self._at("L", angles), self._at("N", angles)
        K = dict(zip(("K_P", "K_V", "K_I"), self._gains, strict=False))
        force = commands.B_inverse @ (L.T @ N.T)
        parts = [force @ K["K_P"], -(force @ K["K_V"] @ N)]
        return block([[force @ K["K_I"], *parts] if self.integral else parts])[:, 0]  # type: ignore[no-any-return]

    def boxes(self, ranges: Mapping[str, tuple[float, float]]) -> Boxes:
        """Boxes of the angles that A depends on, each of their ranges cut into two."""
        edges = [np.linspace(*ranges[a], 3) for a in self.angles]
        low, high = (np.meshgrid(*[e[part] for e in edges]) for part in (slice(-1), slice(1, None)))
        pairs = zip(self.angles, low, high, strict=True)
        return {a: Interval(lo.ravel(), hi.ravel()) for a, lo, hi in pairs}


def _speed_ends(speed: float, count: int) -> list[tuple[float, float]]:
    """Values and signs of one velocity that bound everything between."""
    first, at_rest, reversed_rest, last = (speed, 1.0), (0.0, 1.0), (0.0, -1.0), (-speed, -1.0)
    return {2: [first, last], 3: [first, at_rest, last], 4: [first, at_rest, reversed_rest, last]}[count]


class _Velocity(NamedTuple):
    """What C + D is, by signs and velocities."""

    rest: sm.Matrix  # without motion
    added: Callable[..., Interval]  # what motion adds, of velocities, magnitudes, signs and signs at rest
    switching: list[int]  # velocities each of whose signs is a case of its own
    counts: list[int]  # ends that each velocity has


def _columns(rows: Array | Interval) -> list[Interval]:
    own = enclose(rows)
    return [own[..., i] for i in range(own.lo.shape[-1])]


def motion_terms(plant: Plant, box: ParameterBox = EXACT_PARAMETERS) -> list[Term]:
    """C + D as a sum of products: of numbers, and of one velocity or its magnitude at most; else refused."""
    found = terms_of(plant, plant.C + plant.D, box)
    steep = [term for term in found if sum(term.powers[: 2 * len(plant.nu)]) > 1]
    if steep:
        dof = plant.vehicle.degrees_of_freedom[steep[0].row]
        raise UndertowError(
            f"damping of {dof} grows faster than in proportion to a velocity: no certificate is searched for"
        )
    return found


def _switching(plant: Plant, inertia: sm.Matrix) -> list[int]:
    """Velocities whose sign has to be known: those in the mass matrix, and in products with another one's."""
    n, signs = len(plant.nu), sizes_and_signs(plant)[1]
    found = {i for i in range(n) if signs[i] in inertia.free_symbols}
    for term in motion_terms(plant):
        signs_in_term = {k for k in range(n) if term.powers[2 * n + k]}
        velocities = {k for k in range(n) if term.powers[k] + term.powers[n + k]}
        if len(signs_in_term | velocities) > 1 or any(term.powers[2 * n + k] > 1 for k in signs_in_term):
            found |= signs_in_term
    return sorted(found)


def halved(boxes: Boxes) -> Boxes:
    """Two boxes of each, cut across the side that is longest."""
    longest = max(boxes, key=lambda a: float((boxes[a].hi - boxes[a].lo).max()))
    middle = boxes[longest].middle
    lower = boxes | {longest: Interval(boxes[longest].lo, middle)}
    upper = boxes | {longest: Interval(middle, boxes[longest].hi)}
    join = np.concatenate
    return {a: Interval(join([lower[a].lo, upper[a].lo]), join([lower[a].hi, upper[a].hi])) for a in boxes}


def corners_of(boxes: Boxes) -> tuple[Boxes, Index]:
    """The attitudes at the corners of boxes, each once, and their places, shape (corners, boxes)."""
    if not boxes:
        return {}, np.zeros((1, 1), dtype=int)
    ends = [np.stack([v.lo, v.hi]) for v in boxes.values()]
    rows = np.array(
        [[e[k] for e, k in zip(ends, ways, strict=True)] for ways in product((0, 1), repeat=len(ends))]
    )
    found, place = np.unique(rows.swapaxes(1, 2).reshape(-1, len(ends)), axis=0, return_inverse=True)
    return {a: enclose(found[:, i]) for i, a in enumerate(boxes)}, place.reshape(len(rows), -1)
