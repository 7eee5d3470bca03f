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

from .attitude import ANGLES, Interval, block, enclose, enclosing, within
from .commands import (
    Commands,
    Inverses,
    Slopes,
    Term,
    inverses_of_inertia,
    plain,
    shifts,
    sizes_and_signs,
    terms_of,
)
from .problem import NO_SPREAD, Problem, Spread

_EPS = float(np.finfo(float).eps)
_ANGLES = [symbol(a) for a in ANGLES]


def certainly_positive(matrix: Interval) -> bool:
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

    def __init__(self, value: Interval, slope: Interval, bend: Interval) -> None:
        self.value, self.slope, self.bend = value, slope, bend

    def __matmul__(self, other: Any) -> Jet:
        o = _jet(other)
        bend = self.bend @ o.value + 2.0 * (self.slope @ o.slope) + self.value @ o.bend
        return Jet(self.value @ o.value, self.slope @ o.value + self.value @ o.slope, bend)

    def __add__(self, other: Any) -> Jet:
        o = _jet(other)
        return Jet(self.value + o.value, self.slope + o.slope, self.bend + o.bend)

    def __neg__(self) -> Jet:
        return Jet(-self.value, -self.slope, -self.bend)

    def __sub__(self, other: Any) -> Jet:
        return self + -_jet(other)

    def __mul__(self, other: Array) -> Jet:
        return Jet(self.value * other, self.slope * other, self.bend * other)

    @property
    def T(self) -> Jet:
        """Transposes."""
        return Jet(self.value.T, self.slope.T, self.bend.T)


def _jet(value: Any) -> Jet:
    """What does not depend on the angle, too."""
    if isinstance(value, Jet):
        return value
    value = enclose(value)
    none = enclose(np.zeros_like(value.lo))
    return Jet(value, none, none)


def rotation_of(plant: Plant) -> sm.Matrix:
    """How the translations turn from body to earth: a rotation, which with some axes left out they need not.

    Raises
    ------
    UndertowError
        If they do not: then the frame of an error matters, and inertia equal in all axes turns, too.
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
    moving: Interval  # C + D
    turning: Interval  # S(omega) of the translations, zero elsewhere


@dataclass(frozen=True)
class Corners:
    """The corners of a box of velocities as sums: A = A_rest + sum over velocities of what its end adds.

    No entry has a product of two velocities, so that a corner of the box is one end for each of them. Where a
    sign changes the mass matrix, or stands beside another velocity, each sign is a case of its own.

    Attributes
    ----------
    rest : Matrices
        Without motion, by case of the signs.
    ends : sequence of Matrices
        By velocity: what its ends add, the ends of the first case before those of the second.
    bend : Matrices
        One interval around all that velocities do, with the mass matrices of all cases.
    switching : sequence of int
        Velocities whose sign is that of the case; their second end is rest.
    values : sequence of ndarray
        By velocity: its value at its ends, shape (cases, ends).
    shifted : sequence of (Matrices, Matrices)
        By uncertain parameter, at the upper end of its interval: what it adds to the inverse of the mass
        matrix beside C + D without motion, and to C + D.
    beyond : Matrices
        What parameters do to both together: A is off by up to their product.
    """

    rest: Matrices
    ends: Sequence[Matrices]
    bend: Matrices
    switching: Sequence[int]
    values: Sequence[Array]
    shifted: Sequence[tuple[Matrices, Matrices]]
    beyond: Matrices

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
        self.shifts = [i for i, d in enumerate(dofs) if d < 3]
        self.turns = [i for i, d in enumerate(dofs) if d >= 3]
        self._gains = [np.diag(problem.values[g]) for g in ("K_P", "K_V", "K_I") if g in problem.values]
        self.integral = "K_I" in problem.values
        self.size = (3 if self.integral else 2) * self.n
        rotation, unit = rotation_of(plant), sm.eye(len(self.shifts))
        self._turned_by_body = self._commutes(rotation)
        self._turn, left = (rotation, unit) if self._turned_by_body else (unit, rotation)
        whole = sm.eye(self.n)
        for i, a in enumerate(self.shifts):
            for j, b in enumerate(self.shifts):
                whole[a, b] = left[i, j]
        N = sm.eye(self.n)
        for a in self.turns:
            for b in self.turns:
                N[a, b] = plant.J[a, b]
        self._matrices = {"L": whole, "N": N}
        self._functions: dict[str, Callable[..., Interval]] = {}
        self.angles = tuple(a for a in ANGLES if symbol(a) in (whole.free_symbols | N.free_symbols))

    # --- frames -------------------------------------------------------------------------------
    def _commutes(self, turn: sm.Matrix) -> bool:
        own = [np.diag(K)[self.shifts] for K in self._gains]
        pairs = product(range(turn.rows), repeat=2)
        return all(turn[i, j] == 0 or all(k[i] == k[j] for k in own) for i, j in pairs if i != j)

    @property
    def frame_name(self) -> str:
        """Which frame errors stand in."""
        return "body" if self._turned_by_body else "earth"

    @cached_property
    def groups(self) -> list[list[int]]:
        """Coordinates that the frame mixes, so that a bound on one has to be that on all of them."""
        places = range(len(self.shifts))
        mixed = [[j for j in places if self._turn[i, j] != 0] for i in places]
        joined: list[set[int]] = []
        for row in map(set, mixed):
            touching = [g for g in joined if g & row]
            joined = [g for g in joined if not g & row] + [row.union(*touching)]
        return [sorted(self.shifts[i] for i in g) for g in joined] + [[i] for i in self.turns]

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
    def _moving(self) -> _Moving:
        """C + D and M as functions of velocities, their magnitudes and signs."""
        plant, nu, spread = self.plant, list(self.plant.nu), self.problem.spread
        sizes, signs = sizes_and_signs(plant)
        moving = plain(plant, plant.C + plant.D, spread).applyfunc(sm.expand)
        switching = _switching(plant, plain(plant, plant.M))
        first = [sm.Symbol(f"first_{v}") for v in nu]
        rest = moving.xreplace(dict.fromkeys([*nu, *sizes], sm.Integer(0)))
        added = (moving - rest.xreplace(dict(zip(signs, first, strict=True)))).applyfunc(sm.expand)
        used = moving.free_symbols
        kinds = zip(signs, sizes, strict=True)  # a velocity turns the frame at least
        counts = [2 if i in switching else 4 if s in used else 3 if a in used else 2
                  for i, (s, a) in enumerate(kinds)]  # fmt: skip
        added_of = enclosing([*nu, *sizes, *signs, *first, *shifts(spread)], added)
        every = [within(np.ones(1))] * len(spread)
        return _Moving(rest, lambda *values: added_of(*values, *every), switching, counts)

    @cached_property
    def _at_rest(self) -> tuple[Array, Inverses, Slopes]:
        """Cases of the signs, and in each of them the inverse of M, and C + D without motion."""
        cases, spread = sign_cases(self._moving.switching, self.n), self.problem.spread
        still = Slopes(sizes_and_signs(self.plant)[1], self._moving.rest, spread, cases)
        return cases, inverses_of_inertia(self.problem, cases), still

    def corners(self, speeds: Array) -> Corners:
        """The corners of |nu_i| <= speeds_i."""
        m, n = self._moving, self.n
        cases, inverses, still = self._at_rest
        whole, zero = inverses.whole, np.zeros((len(cases), n))
        none = enclose(self._turning(zero))
        rest = Matrices(inverses.middle + within(inverses.rest), still.value + within(still.curved), none)
        beyond = Matrices(whole - inverses.middle, within(still.size), none)
        shifted = [
            (Matrices(slope, still.value, none), Matrices(inverses.middle, each, none))
            for slope, each in zip(inverses.slopes, still.each, strict=True)
        ]
        ends, values = zip(*(self._ends(i, float(speeds[i]), cases, whole) for i in range(n)), strict=True)
        nu, either = within(speeds[None]), within(np.ones((1, n)))
        hull = whole.lo.min(axis=0)[None], whole.hi.max(axis=0)[None]
        at_rest = still.value + within(still.size)
        moving = Interval(at_rest.lo.min(axis=0)[None], at_rest.hi.max(axis=0)[None]) + m.added(
            *_columns(nu), *_columns(abs(nu)), *_columns(either), *_columns(either)
        )
        turning = within(np.abs(self._turning(np.array(speeds, dtype=float)[None])))
        bend = Matrices(Interval(*hull), moving, turning)
        return Corners(rest, ends, bend, m.switching, values, shifted, beyond)

    def _ends(self, i: int, speed: float, cases: Array, inverse: Interval) -> tuple[Matrices, Array]:
        """What the ends of one velocity add in every case, and its value at them, (cases, ends)."""
        m, switched = self._moving, i in self._moving.switching
        rows = []
        for k, case in enumerate(cases):
            own = [(case[i] * speed, case[i]), (0.0, case[i])] if switched else _corners(speed, m.counts[i])
            rows += [(k, value, sign) for value, sign in own]
        place = np.array([k for k, _, _ in rows])
        nu, signs = np.zeros((len(rows), self.n)), cases[place].copy()
        nu[:, i], signs[:, i] = [v for _, v, _ in rows], [s for _, _, s in rows]
        points = [enclose(c) for c in (*nu.T, *np.abs(nu).T, *signs.T)]
        added = m.added(*points, *_columns(cases[place]))
        ends = Matrices(inverse[place], added, enclose(self._turning(nu)))
        return ends, nu[:, i].reshape(len(cases), -1)

    def _turning(self, nu: Array) -> Array:
        """S(omega) of the translations, shape (k, n, n)."""
        dofs = list(self.plant.vehicle.dof_indices)
        omega = np.zeros((len(nu), 3))
        for i in self.turns:
            omega[:, dofs[i] - 3] = nu[:, i]
        p, q, r = omega.T
        zero = np.zeros_like(p)
        S = np.array([[zero, -r, q], [r, zero, -p], [-q, p, zero]]).transpose(2, 0, 1)
        found = np.zeros((len(nu), self.n, self.n))
        own = [dofs[i] for i in self.shifts]
        found[np.ix_(range(len(nu)), self.shifts, self.shifts)] = S[np.ix_(range(len(nu)), own, own)]
        return found

    # --- the loop -------------------------------------------------------------------------------
    def rest(self, at: Corners, angles: Mapping[str, Interval]) -> Interval:
        """A without motion in every case for every box of angles, shape (boxes, cases, size, size)."""
        turns = {m: self._at(m, angles) for m in self._matrices}
        found: Interval = block(self._cells(at.rest, turns))
        return found + block(self._cells(at.beyond, turns, springs=False)) if at.shifted else found

    def added(self, at: Corners, angles: Mapping[str, Interval]) -> list[Interval]:
        """What the ends of each velocity add to A, each of shape (boxes, cases, ends, size, size).

        With a single box where no attitude changes it. Those of each uncertain parameter follow.
        """
        if self._turned_by_body and not at.shifted:
            angles = {a: v[:1] for a, v in angles.items()}
        found = {m: self._at(m, angles) for m in self._matrices}
        blocks = [block(self._cells(e, found, springs=False)) for e in at.ends]
        moved = [b.reshape(len(b), at.cases, -1, self.size, self.size) for b in blocks]
        for inertia, moving in at.shifted:
            one = block(self._cells(inertia, found, links=False))
            one = one + block(self._cells(moving, found, springs=False))
            moved.append(Interval(np.stack([one.lo, -one.hi], axis=2), np.stack([one.hi, -one.lo], axis=2)))
        return moved

    def bend(self, at: Corners, angles: Mapping[str, Interval], by: str) -> Array:
        """Bound on |second derivative of A by one angle| in each box, shape (boxes, size, size)."""
        jets = {
            m: Jet(self._at(m, angles), self._at(m, angles, by, 1), self._at(m, angles, by, 2))
            for m in self._matrices
        }
        cells = [[_jet(c).bend for c in row] for row in self._cells(at.bend, jets)]
        return np.asarray(block(cells).size[:, 0])

    def body(self, angles: Mapping[str, Interval], by: str = "", order: int = 0) -> Interval:
        """T of (integral, error, nu) = T' z, or a derivative by an angle, shape (boxes, 1, size, size)."""
        if self._turned_by_body:
            angles = {a: v[:1] for a, v in angles.items()}
        other = self.size - self.n
        unit, none = np.eye(other) * (order == 0), np.zeros((other, self.n))
        return block([[unit, none], [none.T, self._at("L", angles, by, order)]])  # type: ignore[no-any-return]

    def body_jet(self, angles: Mapping[str, Interval], by: str) -> Jet:
        """T with its derivatives by one angle."""
        return Jet(*(self.body(angles, by if order else "", order) for order in range(3)))

    def _cells(
        self, at: Matrices, matrices: Mapping[str, Any], *, springs: bool = True, links: bool = True
    ) -> list[list[Any]]:
        """A in blocks of (integral, error, velocity), intervals or with derivatives.

        Without `springs` it is what motion adds, without `links` there is nothing that no parameter changes.
        """
        L, N = matrices["L"], matrices["N"]
        K = dict(zip(("K_P", "K_V", "K_I"), self._gains, strict=False))
        push = L @ at.inverse  # L M^-1
        spin: Any = enclose(np.zeros_like(at.turning.lo))
        if self._turned_by_body:
            spin, swing = -at.turning, spin
        else:
            swing = L @ at.turning @ L.T
        brake = -(push @ at.moving @ L.T) + swing
        none, unit = np.zeros((1, self.n, self.n)), np.eye(self.n)[None] * links
        if not springs:
            still = enclose(np.zeros_like(brake.lo))
            rows = [[spin, still], [still, brake]]
            return [[spin, still, still], *([still, *row] for row in rows)] if self.integral else rows
        spring = push @ (L.T @ N.T)
        brake = brake - spring @ K["K_V"] @ N
        pull = spring @ K["K_P"]
        link = -N if links else none
        if not self.integral:
            return [[spin, link], [pull, brake]]
        return [[spin, unit, none], [none, spin, link], [spring @ K["K_I"], pull, brake]]

    def speeds_of(self, angles: Mapping[str, Interval]) -> Interval:
        """Rows that give the body velocities from z, shape (boxes, n, size)."""
        L = self._at("L", angles)
        none = np.zeros((self.n, self.size - self.n))
        return block([[none, L.T]])[:, 0]  # type: ignore[no-any-return]

    def commands_of(self, commands: Commands, angles: Mapping[str, Interval]) -> Interval:
        """Rows that give what each limited command adds to that at rest, shape (boxes, m, size)."""
        L, N = self._at("L", angles), self._at("N", angles)
        K = dict(zip(("K_P", "K_V", "K_I"), self._gains, strict=False))
        force = commands.share @ (L.T @ N.T)
        parts = [force @ K["K_P"], -(force @ K["K_V"] @ N)]
        return block([[force @ K["K_I"], *parts] if self.integral else parts])[:, 0]  # type: ignore[no-any-return]

    def boxes(self, ranges: Mapping[str, tuple[float, float]]) -> Boxes:
        """Boxes of the angles that A depends on, each of their ranges cut into two."""
        edges = [np.linspace(*ranges[a], 3) for a in self.angles]
        low, high = (np.meshgrid(*[e[part] for e in edges]) for part in (slice(-1), slice(1, None)))
        pairs = zip(self.angles, low, high, strict=True)
        return {a: Interval(lo.ravel(), hi.ravel()) for a, lo, hi in pairs}


def _corners(speed: float, count: int) -> list[tuple[float, float]]:
    """Values and signs of one velocity that bound everything between."""
    first, still, turned, last = (speed, 1.0), (0.0, 1.0), (0.0, -1.0), (-speed, -1.0)
    return {2: [first, last], 3: [first, still, last], 4: [first, still, turned, last]}[count]


class _Moving(NamedTuple):
    """What C + D is, by signs and velocities."""

    rest: sm.Matrix  # without motion
    added: Callable[..., Interval]  # what motion adds, of velocities, magnitudes, signs and signs at rest
    switching: list[int]  # velocities each of whose signs is a case of its own
    counts: list[int]  # ends that each velocity has


def _columns(rows: Array | Interval) -> list[Interval]:
    own = enclose(rows)
    return [own[..., i] for i in range(own.lo.shape[-1])]


def motion_terms(plant: Plant, spread: Spread = NO_SPREAD) -> list[Term]:
    """C + D as a sum of products: of numbers, and of one velocity or its magnitude at most.

    Raises
    ------
    UndertowError
        If it is no such sum.
    """
    found = terms_of(plant, plant.C + plant.D, spread)
    if any(sum(term.powers[: 2 * len(plant.nu)]) > 1 for term in found):
        raise UndertowError(
            "damping grows faster than in proportion to a velocity: no certificate is searched for"
        )
    return found


def _switching(plant: Plant, inertia: sm.Matrix) -> list[int]:
    """Velocities whose sign has to be known: those in the mass matrix, and in products with another one's."""
    n, signs = len(plant.nu), sizes_and_signs(plant)[1]
    found = {i for i in range(n) if signs[i] in inertia.free_symbols}
    for term in motion_terms(plant):
        own = {k for k in range(n) if term.powers[2 * n + k]}
        moved = {k for k in range(n) if term.powers[k] + term.powers[n + k]}
        if len(own | moved) > 1 or any(term.powers[2 * n + k] > 1 for k in own):
            found |= own
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
