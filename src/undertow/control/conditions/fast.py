"""Damping beyond that at rest, bounded by magnitudes of velocities for the regions of Lyapunov functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
import sympy as sm

from undertow.control.plant import Plant
from undertow.typing import Array

from .case import SignSet

Term = tuple[int, int, tuple[int, ...], float]
"""Row, column, exponents of the magnitudes of the velocities, size of the coefficient."""


def extra_damping(plant: Plant, one: SignSet) -> sm.Matrix:
    """D(nu) - D(0) in one sign set, with the numbers of the vehicle, shape (n, n)."""
    D = plant.one_way(plant.D, one.way).xreplace(plant.numbers)
    return (D - D.xreplace(dict.fromkeys(plant.nu, sm.Integer(0)))).applyfunc(sm.expand)


@dataclass(frozen=True)
class FastDamping:
    """A bound on |D(nu) - D(0)| by magnitudes of velocities.

    Attributes
    ----------
    size : int
        Number of velocities.
    terms : tuple of Term
        |D_ij(nu) - D_ij(0)| is at most the sum of coefficient times powers of |nu|; coefficients positive.
    falling : tuple of Term
        Those that may take damping away: all but terms of the diagonal that are nowhere negative.
    """

    size: int
    terms: tuple[Term, ...]
    falling: tuple[Term, ...]

    @property
    def falls(self) -> bool:
        """Whether damping at speed may be less than at rest."""
        return bool(self.falling)

    def shares(self, speeds: Array) -> Array:
        """T with |D(nu) - D(0)| <= sum_k |nu_k| T[:, k, :] while |nu| <= speeds, shape (n, n, n)."""
        T = np.zeros((self.size,) * 3)
        for i, j, powers, coefficient in self.terms:
            k = j if powers[j] else next(k for k, p in enumerate(powers) if p)
            rest = np.array(powers) - np.eye(self.size, dtype=int)[k]
            T[i, k, j] += coefficient * float(np.prod(speeds**rest))
        return T

    def loss(self, speeds: Array) -> Array:
        """What damping can lose while |nu| <= speeds: |nu' (D(nu) - D(0)) nu| <= |nu|' loss |nu|, (n, n)."""
        found = np.zeros((self.size, self.size))
        for i, j, powers, coefficient in self.falling:
            found[i, j] += coefficient * float(np.prod(speeds ** np.array(powers)))
        return 0.5 * (found + found.T)

    @property
    def depends_on_speed(self) -> bool:
        """Whether `shares` changes with the speeds."""
        return any(sum(powers) > 1 for _, _, powers, _ in self.terms)


def fast_damping(plant: Plant, one: SignSet) -> FastDamping | None:
    """The bound for one sign set, or None where damping is no polynomial in velocities and magnitudes."""
    more, n = extra_damping(plant, one), len(plant.nu)
    terms: list[Term] = []
    falling: list[Term] = []
    for i in range(n):
        for j in range(n):
            found = _monomials(more[i, j], plant.nu)
            if found is None:
                return None
            terms += [(i, j, powers, abs(c)) for powers, c, _ in found]
            falling += [(i, j, powers, abs(c)) for powers, c, even in found if i != j or c < 0 or not even]
    return FastDamping(n, tuple(terms), tuple(falling))


def _monomials(entry: sm.Expr, nu: Sequence[sm.Symbol]) -> list[tuple[tuple[int, ...], float, bool]] | None:
    """Powers of the magnitudes, coefficient, and whether the monomial itself is nowhere negative."""
    sizes = [sm.Symbol(f"size_{v}", nonnegative=True) for v in nu]
    plain = sm.expand(entry).xreplace({sm.Abs(v): s for v, s in zip(nu, sizes, strict=True)})
    if not plain.is_polynomial(*nu, *sizes) or plain.free_symbols - {*nu, *sizes}:
        return None
    n, found = len(sizes), []
    for powers, coefficient in sm.Poly(plain, *nu, *sizes).terms():
        if coefficient != 0:
            both = cast(tuple[int, ...], tuple(powers[k] + powers[n + k] for k in range(n)))
            found.append((both, float(coefficient), all(p % 2 == 0 for p in powers[:n])))
    return found
