"""Damping beyond that at rest, bounded for the Lyapunov function of PID control."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
import sympy as sm

from undertow.control.plant import Plant

from .case import SignSet

Array = np.ndarray


def extra_damping(plant: Plant, one: SignSet) -> sm.Matrix:
    """D(nu) - D(0) in one sign set, with the numbers of the vehicle, shape (n, n)."""
    D = plant.one_way(plant.D, one.way).xreplace(plant.numbers)
    return (D - D.xreplace(dict.fromkeys(plant.nu, sm.Integer(0)))).applyfunc(sm.expand)


def never_negative(more: sm.Matrix, nu: sm.Matrix) -> bool:
    """Whether a diagonal of polynomials in magnitudes and even powers has no negative coefficient."""
    return bool(more.is_diagonal()) and all(_never_negative(e, nu) for e in more.diagonal())


def _never_negative(entry: sm.Expr, nu: sm.Matrix) -> bool:
    sizes = {sm.Abs(v): sm.Symbol(f"size_{v}", nonnegative=True) for v in nu}
    squares = {v: sm.Symbol(f"size_{v}", nonnegative=True) for v in nu}
    plain = sm.expand(entry).xreplace(sizes)
    if any(sm.expand(plain - plain.xreplace({v: -v})) != 0 for v in nu):
        return False  # an odd power changes its sign
    return bool(sm.expand(plain.xreplace(squares)).is_nonnegative)


@dataclass(frozen=True)
class FastDamping:
    """A bound on |D(nu) - D(0)| by magnitudes of velocities.

    Attributes
    ----------
    size : int
        Number of velocities.
    terms : tuple of (row, column, exponents, coefficient)
        |D_ij(nu) - D_ij(0)| is at most the sum of coefficient times powers of |nu|; coefficients positive.
    falls : bool
        Whether damping at speed may be less than at rest.
    """

    size: int
    terms: tuple[tuple[int, int, tuple[int, ...], float], ...]
    falls: bool

    def shares(self, speeds: Array) -> Array:
        """T with |D(nu) - D(0)| <= sum_k |nu_k| T[:, k, :] while |nu| <= speeds, shape (n, n, n)."""
        T = np.zeros((self.size,) * 3)
        for i, j, powers, coefficient in self.terms:
            k = j if powers[j] else next(k for k, p in enumerate(powers) if p)
            rest = np.array(powers) - np.eye(self.size, dtype=int)[k]
            T[i, k, j] += coefficient * float(np.prod(speeds**rest))
        return T

    @property
    def depends_on_speed(self) -> bool:
        """Whether `shares` changes with the speeds."""
        return any(sum(powers) > 1 for _, _, powers, _ in self.terms)


def fast_damping(plant: Plant, one: SignSet) -> FastDamping | None:
    """The bound for one sign set, or None where damping is no polynomial in velocities and magnitudes."""
    more, n = extra_damping(plant, one), len(plant.nu)
    terms: list[tuple[int, int, tuple[int, ...], float]] = []
    for i in range(n):
        for j in range(n):
            found = _monomials(more[i, j], plant.nu)
            if found is None:
                return None
            terms += [(i, j, powers, c) for powers, c in found]
    return FastDamping(n, tuple(terms), not never_negative(more, plant.nu))


def _monomials(entry: sm.Expr, nu: sm.Matrix) -> list[tuple[tuple[int, ...], float]] | None:
    """Powers of the magnitudes with the size of each coefficient."""
    sizes = [sm.Symbol(f"size_{v}", nonnegative=True) for v in nu]
    plain = sm.expand(entry).xreplace({sm.Abs(v): s for v, s in zip(nu, sizes, strict=True)})
    if not plain.is_polynomial(*nu, *sizes) or plain.free_symbols - {*nu, *sizes}:
        return None
    n, found = len(sizes), []
    for powers, coefficient in sm.Poly(plain, *nu, *sizes).terms():
        if coefficient != 0:
            both = cast(tuple[int, ...], tuple(powers[k] + powers[n + k] for k in range(n)))
            found.append((both, abs(float(coefficient))))
    return found
