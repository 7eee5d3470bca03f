"""Motion of second order in the start: what products of the linear loop's signals drive.

With z_1 = sum of V_j e^{l_j t} (C_j s) for a start s, z_2' = A z_2 + q(z_1, z_1) has the solution

    z_2 = sum over j, k of Z_jk (C_j s)(C_k s) e^{(l_j + l_k) t} + sum over m of Y_m(s) e^{l_m t},

of which nothing has to be exact: what it misses of the equation is bounded and pushes what is left.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from undertow.typing import Array

from .definite import SETTINGS as PROOFS
from .kernels import Modes, bounds_within


class Form(NamedTuple):
    """q(z, z): of each angle times the force, each angle times the rates, and of products of rates."""

    angles: Array  # rows on z, (angles, states)
    force: Array  # (n, states)
    W: Array  # (angles, n, n)
    P: Array
    Gamma: Array  # (n, n, n)


class Second(NamedTuple):
    """Bounds on signals of z_2 by piece of time, and on what it misses."""

    signals: Array  # (pieces, signals)
    missed: Array  # of the equation at the start, by state; it decays like the slowest mode
    begun: Array  # bound on z_2 at the start, which should be zero, by state


def complex_modes(found: Modes) -> tuple[Array, Array, Array, Array]:
    """Exponents, vectors V (states, modes), rows C (modes, states) and the radius of C."""
    first, pair = found.starts, found.rates.imag != 0
    T, left, around = found.T.lo, found.inverse.middle, found.inverse.radius
    V = T[:, first].astype(complex)
    V[:, pair] = 0.5 * (T[:, first[pair]] - 1j * T[:, first[pair] + 1])
    C, radius = left[first].astype(complex), around[first].copy()
    C[pair] += 1j * left[first[pair] + 1]
    radius[pair] += around[first[pair] + 1]
    exponents = -found.rates.real + 1j * found.rates.imag
    twins = np.concatenate([np.arange(len(first)), np.flatnonzero(pair)])
    turned = np.arange(len(twins)) >= len(first)
    return (
        np.where(turned, exponents[twins].conj(), exponents[twins]),
        np.where(turned, V[:, twins].conj(), V[:, twins]),
        np.where(turned[:, None], C[twins].conj(), C[twins]),
        radius[twins],
    )


def products(form: Form, V: Array) -> Array:
    """q of each pair of vectors, shape (n, modes, modes)."""
    n = len(form.force)
    angles, force, v = form.angles @ V, form.force @ V, V[-n:]
    turned = np.einsum("aj,aik->ijk", angles, form.W @ force - form.P @ v)
    return np.asarray(0.5 * (turned + turned.swapaxes(1, 2)) + np.einsum("ipq,pj,qk->ijk", form.Gamma, v, v))


def second_order(
    found: Modes, A: Array, form: Form, rows: Array, start: Array, plane: list[int], times: Array
) -> Second:
    """z_2 of starts in a box of errors, of which those in the plane stand in any frame."""
    n, size = len(form.force), len(A)
    exponents, V, C, radius = complex_modes(found)
    errors = slice(size - 2 * n, size - n)
    C, around = C[:, errors], radius[:, errors]
    j, k = np.triu_indices(len(exponents))
    twice = np.where(j == k, 1.0, 2.0)
    q = np.zeros((len(j), size), dtype=complex)
    q[:, -n:] = (products(form, V)[:, j, k] * twice).T
    both = exponents[j] + exponents[k]
    system = both[:, None, None] * np.eye(size) - A
    Z: Any = np.linalg.solve(system, q[..., None])[..., 0]
    coefficient = 0.5 * (C[j][:, :, None] * C[k][:, None, :] + C[k][:, :, None] * C[j][:, None, :])
    own_modes = np.einsum("ms,ls,lpq->pqm", np.linalg.inv(V), Z, coefficient)
    Y = -V * own_modes[:, :, None, :]  # (p, q, states, modes), of vectors that are modes exactly
    # What is missed: of the equation by rounding and by the modes, of the start, and of the rows C.
    absolute, reach = _absolute(form, V), _reach(start, plane)
    size_Z, own = np.abs(Z), np.abs(C) @ reach
    wrong = np.abs(np.einsum("lst,lt->ls", system, Z) - q) + size_Z @ found.off.T
    wrong += PROOFS.rounding * (size_Z @ np.abs(A).T + np.abs(both)[:, None] * size_Z + np.abs(q))
    missed = (wrong * (own[j] * own[k])[:, None]).sum(axis=0)
    loose = around @ reach + PROOFS.rounding * own
    missed[-n:] += (absolute @ (own + loose)) @ (own + loose) - (absolute @ own) @ own
    begun = np.abs(np.einsum("ls,lpq->pqs", Z, coefficient) + Y.sum(axis=-1))
    slack = PROOFS.rounding * (np.einsum("ls,lpq->pqs", size_Z, np.abs(coefficient)) + np.abs(Y).sum(axis=-1))
    begun = np.einsum("pqs,p,q->s", begun + slack, reach, reach)
    every: Any = np.concatenate([both, exponents])
    signals = _signals(rows, Z, coefficient, Y, every, times, start, plane)
    return Second(signals, missed, begun)


def _absolute(form: Form, V: Array) -> Array:
    """Bound on |q| of each pair of vectors with any signs."""
    n = len(form.force)
    angles, force, v = np.abs(form.angles) @ np.abs(V), np.abs(form.force) @ np.abs(V), np.abs(V[-n:])
    turned = np.einsum("aj,aik->ijk", angles, np.abs(form.W) @ force + np.abs(form.P) @ v)
    return np.asarray(
        0.5 * (turned + turned.swapaxes(1, 2)) + np.einsum("ipq,pj,qk->ijk", np.abs(form.Gamma), v, v)
    )


def _reach(start: Array, plane: list[int]) -> Array:
    reach = start.astype(float).copy()
    if plane:
        reach[plane] = np.hypot(*start[plane])
    return reach * (1 + PROOFS.room)


def _signals(
    rows: Array,
    Z: Array,
    coefficient: Array,
    Y: Array,
    exponents: Array,
    times: Array,
    start: Array,
    plane: list[int],
) -> Array:
    """Bounds on rows on z_2 by piece, over all starts."""
    n = len(start)
    SZ, sizes = (rows @ Z.T), np.abs(rows) @ np.abs(Z).T
    reach = _reach(start, plane)
    blocks: dict[tuple[int, int], Array] = {}
    for p in range(n):
        for q in range(p, n):
            part = coefficient[:, p, q] * (1.0 if p == q else 2.0)
            more = Y[p, q] * (1.0 if p == q else 2.0)
            amplitude = np.concatenate([SZ * part, rows @ more], axis=1)
            size = np.concatenate([sizes * np.abs(part), np.abs(rows) @ np.abs(more)], axis=1)
            blocks[p, q] = (
                bounds_within(amplitude, size, PROOFS.level * size, exponents, times) * reach[p] * reach[q]
            )
    if plane:
        return _in_plane(blocks, n, plane).T
    return np.asarray(sum(blocks.values())).T


def _in_plane(blocks: dict[tuple[int, int], Array], n: int, plane: list[int]) -> Array:
    """The sum where the start in the plane is in a disc, of whose square blocks have the radius."""
    x, y = plane
    xx, yy, xy = blocks[x, x], blocks[y, y], blocks[x, y]
    total = 0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), 0.5 * xy)
    rest = [c for c in range(n) if c not in plane]
    for c in rest:
        total = total + np.hypot(*(blocks[min(a, c), max(a, c)] for a in plane))
        total = total + sum(blocks[c, d] for d in rest if d >= c)
    return np.asarray(total)
