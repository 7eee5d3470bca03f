"""Stacks of matrices that are proved to be positive definite, in interval arithmetic."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from undertow.typing import Array, Flags

from .attitude import Interval, enclose
from .embedding import certainly_positive

ROOM = 1e-7
"""What bounds of proofs are widened by, relative: beyond all rounding of 64-bit numbers."""


def rows_of(stack: Interval, rows: Any) -> Interval:
    """Some rows of a stack."""
    return Interval(stack.lo[rows], stack.hi[rows])


def covers(ends: list[Interval], centres: list[Array], root: Array) -> tuple[list[Array], Flags]:
    """T_i in states in which root root' is the identity, and whether they cover every end, proved."""
    inverse, sure = np.linalg.inv(root), np.ones(len(root), dtype=bool)
    found = []
    for end, centre in zip(ends, centres, strict=True):
        off = inverse[:, None] @ (centre[:, None] - end.middle) @ np.swapaxes(inverse, -1, -2)[:, None]
        cover = _cover(off) + ROOM * np.eye(root.shape[-1])
        T = root @ cover @ np.swapaxes(root, -1, -2)
        sure &= positive(end - centre[:, None] + (0.5 * (T + np.swapaxes(T, -1, -2)))[:, None])
        found.append(cover)
    return found, sure


def mean_roots(middle: Array, place: Any, count: int) -> Array:
    """Cholesky factors of the mean of the matrices at each place; of the identity where there is none."""
    total, many = np.zeros((count, *middle.shape[1:])), np.bincount(place, minlength=count)
    np.add.at(total, place, middle)
    total[many == 0] = np.eye(middle.shape[-1])
    return np.asarray(np.linalg.cholesky(total / np.maximum(many, 1)[:, None, None]))


def widest(ends: list[Interval], covers: list[Array], rows: Array) -> int | None:
    """Of which velocity the ends should be cut, or None where each has one only."""
    several = [i for i, e in enumerate(ends) if e.lo.shape[1] > 1]
    if not len(rows):
        return None
    return max(several, key=lambda i: np.linalg.eigvalsh(covers[i][rows])[:, -1].sum(), default=None)


def _cover(off: Array) -> Array:
    """T >= each of the matrices off (k, ends, size, size), shape (k, size, size)."""
    if off.shape[1] == 1:
        return np.zeros_like(off[:, 0])
    largest = _part(off[:, 0], np.abs)  # the last end is the same turned round
    for k in range(1, off.shape[1] - 1):
        largest = largest + _part(off[:, k] - largest, lambda v: np.maximum(v, 0.0))
    return largest


def _part(matrices: Array, of: Callable[[Array], Array]) -> Array:
    """Symmetric matrices with a function of their eigenvalues."""
    values, vectors = np.linalg.eigh(matrices)
    return np.asarray((vectors * of(values)[..., None, :]) @ np.swapaxes(vectors, -1, -2))


def positive(matrices: Interval) -> Flags:
    """By row of a stack, whether all of its matrices are positive definite, proved."""
    count = len(matrices.lo)
    if count == 0 or certainly_positive(matrices):
        return np.ones(count, dtype=bool)
    if count == 1:
        return np.zeros(1, dtype=bool)
    halves = slice(None, count // 2), slice(count // 2, None)
    return np.concatenate([positive(rows_of(matrices, half)) for half in halves])


def bounded(P: Array, rows: Interval, bounds: Array) -> Flags:
    """By box, whether |row z| < bound on z' P z < 1, proved: bound^2 P - row row' is positive definite."""
    rows = rows * enclose(bounds[:, None]).reciprocal()
    outer = Interval(rows.lo[..., :, None], rows.hi[..., :, None]) * Interval(
        rows.lo[..., None, :], rows.hi[..., None, :]
    )
    return positive(P - outer)


def flat(stack: Interval) -> Interval:
    """Attitudes and cases in one row."""
    return Interval(*(v.reshape(-1, *v.shape[2:]) for v in (stack.lo, stack.hi)))


def doubled(P: Array, A: Array) -> Array:
    """P A + A' P."""
    held = P @ A
    return np.asarray(held + np.swapaxes(held, -1, -2))


def touched(B: Array, row: Array) -> Any:
    """Places of the states that a row is about, with those that P ties to them."""
    found: Flags = row != 0
    for _ in range(2):
        found = found | (np.abs(B).sum(axis=0)[found].sum(axis=0) > 0)
    return np.flatnonzero(found)


def along(P: Array, A: Array, x: Array) -> Array:
    """x' P A x for directions x (k, size) and matrices A (k, ends, size, size)."""
    return np.asarray(np.einsum("ks,kest,kt->ke", x @ P, A, x))
