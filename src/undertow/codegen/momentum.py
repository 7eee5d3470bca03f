"""Inertial wrenches found among all others, and their sum by Kirchhoff's equations.

A wrench is inertial if it equals -(M nu_dot + K(A, nu)) with M and A that depend on parameters alone, where
K(A, nu) is what Kirchhoff's equations give for the momentum h = (h_1, h_2) = A nu and nu = (v, omega):
(omega x h_1, v x h_1 + omega x h_2). The same may hold with the velocity through the water. Momenta add up,
so that all inertial wrenches together cost one product with a matrix and six cross products.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import casadi as ca
import numpy as np
import sympy as sm

from undertow.model.symbols import Signals

from .convert import Converter

# Cross products of Kirchhoff's equations: row, sign, component of the velocity, component of the momentum.
_CROSS = tuple(
    (row + i, sign, velocity + (i + a) % 3, momentum + (i + b) % 3)
    for row, velocity, momentum in ((0, 3, 0), (3, 0, 0), (3, 3, 3))
    for i in range(3)
    for sign, a, b in ((1, 1, 2), (-1, 2, 1))
)
Entry = tuple[int, int]
_TRIALS = 3
_ROUNDING = 1e-12
_SEED = 0


@dataclass(frozen=True)
class Inertia:
    """Inertial wrenches in rows and columns of the degrees of freedom.

    Attributes
    ----------
    ids : tuple of str
        The effects.
    mass, water_mass : SX, shape (6, 6)
        What multiplies nu_dot and, apart from that, the translations of nu_r_dot.
    momentum, water_momentum : SX, shape (6, 6)
        A for the velocity over ground, and for the velocity through the water.
    """

    ids: tuple[str, ...]
    mass: ca.SX
    water_mass: ca.SX
    momentum: ca.SX
    water_momentum: ca.SX


def kirchhoff(momentum: ca.SX, nu: ca.SX) -> ca.SX:
    """(omega x h_1, v x h_1 + omega x h_2), shape (6, 1)."""
    h, v, w = momentum @ nu, nu[:3], nu[3:]
    return ca.vertcat(ca.cross(w, h[:3]), ca.cross(v, h[:3]) + ca.cross(w, h[3:]))


def find_inertia(
    wrenches: Mapping[str, sm.Matrix], s: Signals, known: Converter, p: ca.SX, dofs: tuple[int, ...]
) -> Inertia:
    """The inertial ones among some wrenches."""
    search = _Search(s, known, p, dofs)
    found = {i: parts for i, w in wrenches.items() if (parts := search.parts(w)) is not None}
    total = [sum(parts, ca.SX(6, 6)) for parts in zip(*found.values(), strict=True)] or [ca.SX(6, 6)] * 4
    return Inertia(tuple(found), *total)


def is_galilean(inertia: Inertia, p: ca.SX, dofs: tuple[int, ...]) -> bool:
    """Whether what moves over ground feels no difference between still water and a steady flow.

    For water of velocity w in body axes, that is M (omega x w, 0) + K(A, nu - (w, 0)) = K(A, nu): a rigid
    body with all of its Coriolis forces does not know whether the ground moves.
    """
    nu, water = ca.SX.sym("nu", 6), ca.SX.sym("water", 3)
    moving = [int(i in dofs) for i in range(6)]
    turned = ca.vertcat(ca.cross(nu[3:], water), ca.SX.zeros(3)) * moving
    velocity = nu * moving
    relative = (nu - ca.vertcat(water, ca.SX.zeros(3))) * moving
    left = inertia.mass @ ca.substitute(turned, nu, velocity) + kirchhoff(inertia.momentum, relative)
    right, rows = kirchhoff(inertia.momentum, velocity), list(dofs)
    return identical(left[rows], right[rows], ca.vertcat(p, nu, water))


class _Search:
    """Decides for one wrench after the other."""

    def __init__(self, s: Signals, known: Converter, p: ca.SX, dofs: tuple[int, ...]) -> None:
        self._known, self._p, self._dofs = known, p, dofs
        self._ground, self._pushed = _column("nu", dofs), _column("nu_dot", dofs)
        # The water does not rotate: through it only the translations are different.
        moves = tuple(i for i in dofs if i < 3)
        self._water, self._water_pushed = _column("nu_r", moves), _column("nu_r_dot", moves)
        self._relative = ca.vertcat(self._water, *ca.vertsplit(self._ground)[len(moves) :])
        self._meaning: dict[sm.Symbol, ca.SX] = {
            x: ca.SX(0) for m in (s.nu, s.nu_r, s.nu_dot, s.nu_r_dot) for x in m
        }
        for stated, symbols, places in (
            (s.nu_r, self._water, moves),
            (s.nu_r_dot, self._water_pushed, moves),
            (s.nu, self._ground, dofs),
            (s.nu_dot, self._pushed, dofs),
        ):
            self._meaning.update({stated[i]: symbols[k] for k, i in enumerate(places)})
        self._motion = ca.vertcat(self._ground, self._pushed, self._water, self._water_pushed)

    def parts(self, wrench: sm.Matrix) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX] | None:
        """What a wrench adds to each matrix of `Inertia`, or None if it is not inertial."""
        w = self._converted(wrench)
        if w is None:
            return None
        masses = [-ca.jacobian(w, a) for a in (self._pushed, self._water_pushed)]
        if ca.depends_on(ca.horzcat(*masses), self._motion):
            return None
        momenta = self._momenta(_at_zero(w, ca.vertcat(self._pushed, self._water_pushed)))
        return None if momenta is None else (*(self._embedded(m) for m in masses), *momenta)

    def _converted(self, wrench: sm.Matrix) -> ca.SX | None:
        """The wrench in motion and parameters, or None if it depends on more."""
        rows = wrench.extract(list(self._dofs), [0])
        parameters = {x: self._known(x) for x in rows.free_symbols if x not in self._meaning}
        fixed = {e.element_hash() for e in ca.vertsplit(self._p)}
        used = ca.symvar(ca.vertcat(ca.SX(0, 1), *parameters.values()))
        if not fixed.issuperset(e.element_hash() for e in used):
            return None
        return Converter(parameters | self._meaning).matrix(rows)

    def _embedded(self, matrix: ca.SX) -> ca.SX:
        result = ca.SX(6, 6)
        result[list(self._dofs), list(self._dofs[: matrix.size2()])] = matrix
        return result

    def _momenta(self, still: ca.SX) -> tuple[ca.SX, ca.SX] | None:
        """A for the velocity over ground and A for that through the water, one of them zero."""
        none = ca.SX(6, 6)
        if not ca.depends_on(still, self._water):
            a = self._momentum(still, self._ground)
            return None if a is None else (a, none)
        a = self._momentum(still, self._relative)
        return None if a is None else (none, a)

    def _momentum(self, still: ca.SX, nu: ca.SX) -> ca.SX | None:
        """The matrix A with still = -K(A, nu), or None if there is none."""
        slope = ca.jacobian(still, nu)
        curvature = ca.jacobian(ca.vec(slope), nu)
        resting = _at_zero(ca.horzcat(still, slope), nu)
        if ca.depends_on(curvature, self._motion) or ca.sparsify(resting).nnz():
            return None
        # By Taylor's theorem the coefficients of nu_j nu_k say all.
        coefficients: dict[tuple[int, int, int], ca.SX] = {}
        rows, columns = curvature.sparsity().get_triplet()
        for place, k, value in zip(rows, columns, curvature.nonzeros(), strict=True):
            j, i = divmod(place, len(self._dofs))
            if j <= k:
                key = self._dofs[i], self._dofs[j], self._dofs[k]
                coefficients[key] = (-0.5 if j == k else -1) * value
        known = _solved(coefficients, self._dofs)
        return _symmetric(known) if self._gives(known, coefficients) else None

    def _gives(
        self, known: Mapping[Entry, ca.SX], coefficients: Mapping[tuple[int, int, int], ca.SX]
    ) -> bool:
        equations, zero = _equations(self._dofs), ca.SX(0)
        places = {*equations, *coefficients}
        left = [sum((sign * known[m] for sign, m in equations.get(c, [])), zero) for c in places]
        return identical(ca.vertcat(*left), ca.vertcat(*(coefficients.get(c, zero) for c in places)), self._p)


def _column(name: str, places: tuple[int, ...]) -> ca.SX:
    """Symbols, one for each place."""
    return ca.SX.sym(name, len(places))


def _at_zero(expression: ca.SX, symbols: ca.SX) -> ca.SX:
    return ca.substitute(expression, symbols, ca.SX.zeros(symbols.shape))


@cache
def _equations(dofs: tuple[int, ...]) -> dict[tuple[int, int, int], list[tuple[int, Entry]]]:
    """Coefficient of nu_j nu_k (j <= k) in row i of K(A, nu), as a sum of entries of the symmetric A."""
    found = defaultdict(list)
    for i, sign, j, b in _CROSS:
        for k in dofs:
            if i in dofs and j in dofs:
                found[i, min(j, k), max(j, k)].append((sign, (min(b, k), max(b, k))))
    return dict(found)


def _solved(coefficients: Mapping[tuple[int, int, int], ca.SX], dofs: tuple[int, ...]) -> dict[Entry, ca.SX]:
    """Entries of a matrix A whose K has these coefficients if there is one; what K does not show is zero."""
    equations, zero = _equations(dofs), ca.SX(0)
    known: dict[Entry, ca.SX] = {}
    while unknown := {m for terms in equations.values() for _, m in terms} - {*known}:
        open_ = {c: [(s, m) for s, m in terms if m not in known] for c, terms in equations.items()}
        single = next((c for c, terms in open_.items() if len(terms) == 1), None)
        if single is None:
            known[min(unknown)] = zero
            continue
        ((sign, entry),) = open_[single]
        rest = sum((s * known[m] for s, m in equations[single] if m != entry), zero)
        known[entry] = sign * (coefficients.get(single, zero) - rest)
    return known


def _symmetric(known: Mapping[Entry, ca.SX]) -> ca.SX:
    result = ca.SX(6, 6)
    for (j, k), value in known.items():
        if not value.is_zero():
            result[j, k] = result[k, j] = value
    return result


def identical(left: ca.SX, right: ca.SX, symbols: ca.SX) -> bool:
    """Whether two expressions are identical: equal at random points but for rounding."""
    both = ca.Function("both", [symbols], [ca.densify(left), ca.densify(right)])
    random = np.random.default_rng(_SEED)
    for _ in range(_TRIALS):
        a, b = (np.asarray(e) for e in both(random.uniform(0.5, 2, symbols.numel())))
        scale = max(np.abs(a).max(initial=0.0), np.abs(b).max(initial=0.0))
        if not np.abs(a - b).max(initial=0.0) <= _ROUNDING * scale:
            return False
    return True
