"""Stacks of matrices that are proved to be positive definite, in interval arithmetic."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from undertow.typing import Array, Flags

from .attitude import Interval, enclose
from .embedding import certainly_positive


@dataclass(frozen=True)
class ProofSettings:
    """Numbers of the proofs; none of them decides what is proved, only what room rounding is given."""

    room: float = 1e-7  # what bounds are widened by, relative: beyond all rounding of 64-bit numbers
    # Beyond the rounding of some products of matrices of twenty rows, relative to their norms.
    rounding: float = 1e-13
    sum: float = 1e-15  # beyond the rounding of a sum of two numbers that is scaled, relative
    level: float = 1e-9  # what a diagonal that is to be above a matrix is widened by, relative
    together: int = 4096  # matrices that are looked at together: memory


SETTINGS = ProofSettings()


def mean_roots(middle: Array, place: Any, count: int) -> Array:
    """Cholesky factors of the mean of the matrices at each place; of the identity where there is none."""
    total, many = np.zeros((count, *middle.shape[1:])), np.bincount(place, minlength=count)
    np.add.at(total, place, middle)
    total[many == 0] = np.eye(middle.shape[-1])
    return np.asarray(np.linalg.cholesky(total / np.maximum(many, 1)[:, None, None]))


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
    count = len(matrices)
    if count == 0 or certainly_positive(matrices):
        return np.ones(count, dtype=bool)
    if count == 1:
        return np.zeros(1, dtype=bool)
    halves = slice(None, count // 2), slice(count // 2, None)
    return np.concatenate([positive(matrices[half]) for half in halves])


def bounded(P: Array, rows: Interval, bounds: Array) -> Flags:
    """By box, whether |row z| < bound on z' P z < 1, proved: bound^2 P - row row' is positive definite."""
    rows = rows * enclose(bounds[:, None]).reciprocal()
    return positive(P - rows[..., :, None] * rows[..., None, :])


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


# --- sums -----------------------------------------------------------------------------------------
@dataclass
class Work:
    """How many matrices a proof may still look at."""

    left: int


class Choices:
    """The ends of one velocity in sets, by halving, and a matrix below all ends of each set.

    Attributes
    ----------
    children : ndarray
        The two halves of each set, shape (sets, 2); -1 where it is a single end.
    below : ndarray
        Shape (places, sets, size, size).
    off : ndarray
        How far `below` is from the middle of the set, of the same shape.
    """

    def __init__(self, ends: Array) -> None:
        self.ends = ends  # one below each end, shape (places, ends, size, size)
        ranges = [(0, ends.shape[1])]
        halves: list[tuple[int, int]] = []
        while len(halves) < len(ranges):
            low, high = ranges[len(halves)]
            single = high - low == 1
            halves.append((-1, -1) if single else (len(ranges), len(ranges) + 1))
            ranges += [] if single else [(low, (low + high) // 2), ((low + high) // 2, high)]
        self.children = np.array(halves)
        found = [_below(ends[:, low:high]) for low, high in ranges]
        self.below, self.off = (np.stack(part, axis=1) for part in zip(*found, strict=True))

    @cached_property
    def sizes(self) -> Array:
        """Norms of `below` and `off` together."""
        return _norm(self.below) + _norm(self.off)


def _norm(matrices: Array) -> Array:
    return np.asarray(np.sqrt(np.sum(matrices**2, axis=(-2, -1))))


def _below(ends: Array) -> tuple[Array, Array]:
    """A matrix below each of the ends (places, k, size, size), and how far it is from their middle."""
    centre = 0.5 * (ends[:, 0] + ends[:, -1])
    # Eigenvalues and eigenvectors are exact for a matrix nearby: SETTINGS.room is beyond how far it is.
    shift = (SETTINGS.room * _norm(ends).max(axis=1))[:, None, None] * np.eye(ends.shape[-1])
    off = _cover(centre[:, None] - ends) + shift
    return centre - off, off


def lowest(stack: Interval) -> Array:
    """A symmetric matrix below all that each place of a stack holds."""
    symmetric = 0.5 * (stack + stack.T)
    middle, radius = symmetric.middle, symmetric.radius
    less = radius.sum(axis=-1) * (1 + SETTINGS.room) + SETTINGS.rounding * _norm(middle)[..., None]
    return np.asarray(middle - less[..., None] * np.eye(middle.shape[-1]))


def sums_positive(rest: Interval, place: Any, ends: list[Interval], box: Any, work: Work) -> Flags:
    """By box of rows, whether rest + one of the ends of each is positive definite whichever they are, proved.

    The ends of a row are those at its `place`. With C_i in the middle of the ends and T_i >= C_i - end for
    each of them, rest + sum of (C_i - T_i) is below every such sum. Where that is not positive, the set of
    ends that takes most is cut into two. (Ben-Tal and Nemirovski 2002, On tractable approximations of
    uncertain linear matrix inequalities affected by interval uncertainty, SIAM J. Optim. 12, look for T_i
    by a program.)
    """
    held = np.ones(box.max() + 1, dtype=bool)
    work.left -= len(place)
    if work.left < 0:
        return ~held
    centre = np.sum([0.5 * (e.middle[:, 0] + e.middle[:, -1]) for e in ends], axis=0)
    middle = rest.middle + centre[place]
    held[box[~(np.linalg.eigvalsh(middle)[:, 0] > 0)]] = False
    left = np.flatnonzero(held[box])
    if len(left):
        own, places = np.unique(place[left], return_inverse=True)
        # Triangular, so regular for certain: in these states rows are near the identity.
        inverse = np.asarray(np.linalg.inv(mean_roots(middle[left], places, len(own))), dtype=float)
        rows = lowest(_turned(rest[left], inverse[places]))
        choices = [Choices(_lowest_turned(e[own], inverse[:, None])) for e in ends]
        _cut(rows, places, choices, box[left], held, work)
    return held


def _turned(stack: Interval, by: Array) -> Interval:
    return by @ stack @ np.swapaxes(by, -1, -2)


def _lowest_turned(stack: Interval, by: Array) -> Array:
    """`lowest` of `_turned`; for intervals of hardly any width in numbers, lowered by more than rounding."""
    if (stack.radius > SETTINGS.room * _norm(stack.middle)[..., None, None]).any():
        return lowest(_turned(stack, by))
    below = lowest(stack)
    shift = SETTINGS.rounding * _norm(by) ** 2 * _norm(below)
    return np.asarray(by @ below @ np.swapaxes(by, -1, -2) - shift[..., None, None] * np.eye(by.shape[-1]))


def _cut(rows: Array, place: Any, choices: list[Choices], box: Any, held: Flags, work: Work) -> None:
    """Take boxes that are not proved out of `held`; all of them where the work is too much."""
    pending = [(np.arange(len(rows)), np.zeros((len(rows), len(choices)), dtype=int))]
    while pending:
        row, picks = pending.pop()
        row, picks = row[held[box[row]]], picks[held[box[row]]]
        if len(row) > SETTINGS.together:
            pending.append((row[SETTINGS.together :], picks[SETTINGS.together :]))
            row, picks = row[: SETTINGS.together], picks[: SETTINGS.together]
        work.left -= len(row)
        if work.left < 0:
            held[:] = False
            return
        if len(row):
            open_, x = _open(rows[row], place[row], picks, choices)
            row, picks = row[open_], picks[open_]
            lost, cut = _to_cut(rows[row], place[row], picks, choices, x)
            held[box[row[lost]]] = False
            pending += [(row[~lost], _half(picks[~lost], cut[~lost], choices, k)) for k in (0, 1)]


def _half(picks: Any, cut: Any, choices: list[Choices], which: int) -> Any:
    """The sets of ends with one half of that which is cut."""
    found = picks.copy()
    for i, choice in enumerate(choices):
        found[cut == i, i] = choice.children[picks[cut == i, i], which]
    return found


def _open(rows: Array, place: Any, picks: Any, choices: list[Choices]) -> tuple[Any, Array]:
    """Which rows are not proved with these sets of ends, and the worst direction of each of them."""
    pairs = list(zip(choices, picks.T, strict=True))
    total = rows + sum(c.below[place, p] for c, p in pairs)
    size = _norm(rows) + sum(c.sizes[place, p] for c, p in pairs)
    open_ = np.flatnonzero(~(np.linalg.eigvalsh(total)[:, 0] > SETTINGS.room * size))
    return open_, np.linalg.eigh(total[open_])[1][..., 0]


def _to_cut(rows: Array, place: Any, picks: Any, choices: list[Choices], x: Array) -> tuple[Flags, Array]:
    """Rows that are lost, and for the others of which velocity the ends are cut.

    A row is lost where the worst ends for its direction leave nothing of it, or where each set is one end.
    """
    least = np.einsum("ks,kst,kt->k", x, rows, x)
    taken = np.zeros((len(rows), len(choices)))
    for i, (choice, pick) in enumerate(zip(choices, picks.T, strict=True)):
        least = least + along(np.eye(x.shape[-1]), choice.ends[place], x).min(axis=-1)
        taken[:, i] = np.einsum("ks,kst,kt->k", x, choice.off[place, pick], x)
        taken[choice.children[pick, 0] < 0, i] = -np.inf
    return (least <= 0) | np.isinf(taken).all(axis=1), taken.argmax(axis=1)
