"""Matrices that are to be positive definite: found by a program (Clarabel), proved in interval arithmetic."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from undertow.errors import UndertowError
from undertow.typing import Array, Flags

from .attitude import Interval, enclose
from .embedding import proved_positive_definite


@dataclass(frozen=True)
class ProofSettings:
    """Numbers of the proofs.

    None of them decides what is proved, only what room rounding is given, and how exact a program is solved.
    """

    room: float = 1e-7  # what bounds are widened by, relative: beyond all rounding of 64-bit numbers
    # Beyond the rounding of some products of matrices of twenty rows, relative to their norms.
    rounding: float = 1e-13
    sum_rounding: float = 1e-15  # beyond the rounding of a sum of two numbers that is scaled, relative
    level: float = 1e-9  # what a diagonal that is to be above a matrix is widened by, relative
    batch: int = 4096  # matrices that are looked at together: memory
    # Relative, of objective and forms: what is found is proved afterwards, with more room than that.
    program_accuracy: float = 1e-4
    program_rounds: int = 80  # of the solver, at most


SETTINGS = ProofSettings()


def _mean_cholesky(middle: Array, place: Any) -> Array:
    """Cholesky factors of the mean of the matrices at each place."""
    total = np.zeros((place.max() + 1, *middle.shape[1:]))
    np.add.at(total, place, middle)
    return np.asarray(np.linalg.cholesky(total / np.bincount(place)[:, None, None]))


def _upper_bound(offsets: Array) -> Array:
    """T >= each of the matrices off (k, ends, size, size), shape (k, size, size)."""
    if offsets.shape[1] == 1:
        return np.zeros_like(offsets[:, 0])
    largest = _spectral_function(offsets[:, 0], np.abs)  # the last end is the same turned round
    for k in range(1, offsets.shape[1] - 1):
        largest = largest + _spectral_function(offsets[:, k] - largest, lambda v: np.maximum(v, 0.0))
    return largest


def _spectral_function(matrices: Array, of: Callable[[Array], Array]) -> Array:
    """Symmetric matrices with a function of their eigenvalues."""
    values, vectors = np.linalg.eigh(matrices)
    return np.asarray((vectors * of(values)[..., None, :]) @ np.swapaxes(vectors, -1, -2))


def positive_definite(matrices: Interval) -> Flags:
    """By row of a stack, whether all of its matrices are positive definite, proved."""
    count = len(matrices)
    if count == 0 or proved_positive_definite(matrices):
        return np.ones(count, dtype=bool)
    if count == 1:
        return np.zeros(1, dtype=bool)
    halves = slice(None, count // 2), slice(count // 2, None)
    return np.concatenate([positive_definite(matrices[half]) for half in halves])


def bounded(P: Array, rows: Interval, bounds: Array) -> Flags:
    """By box, whether |row z| < bound on z' P z < 1, proved: bound^2 P - row row' is positive definite."""
    rows = rows * enclose(bounds[:, None]).reciprocal()
    return positive_definite(P - rows[..., :, None] * rows[..., None, :])


def lyapunov_operator(P: Array, A: Array) -> Array:
    """P A + A' P."""
    product = P @ A
    return np.asarray(product + np.swapaxes(product, -1, -2))


def coupled_states(B: Array, row: Array) -> Any:
    """Places of the states that a row is about, with those that P ties to them."""
    found: Flags = row != 0
    for _ in range(2):
        found = found | (np.abs(B).sum(axis=0)[found].sum(axis=0) > 0)
    return np.flatnonzero(found)


def quadratic_values(P: Array, A: Array, x: Array) -> Array:
    """x' P A x for directions x (k, size) and matrices A (k, ends, size, size)."""
    return np.asarray(np.einsum("ks,kest,kt->ke", x @ P, A, x))


# --- sums -----------------------------------------------------------------------------------------
@dataclass
class MatrixBudget:
    """How many matrices a proof may still look at."""

    remaining: int


class VertexTree:
    """The ends of one velocity in sets, by halving, and a matrix below all ends of each set."""

    def __init__(self, ends: Array) -> None:
        self.ends = ends  # one below each end, shape (places, ends, size, size)
        ranges = [(0, ends.shape[1])]
        halves: list[tuple[int, int]] = []
        while len(halves) < len(ranges):
            low, high = ranges[len(halves)]
            single = high - low == 1
            halves.append((-1, -1) if single else (len(ranges), len(ranges) + 1))
            ranges += [] if single else [(low, (low + high) // 2), ((low + high) // 2, high)]
        self.children = np.array(halves)  # the two halves of each set; -1 where it is a single end
        # `lower`, shape (places, sets, size, size), and how far it is from the middle of the set.
        found = [_lower_bound(ends[:, low:high]) for low, high in ranges]
        self.lower, self.offset = (np.stack(part, axis=1) for part in zip(*found, strict=True))

    @cached_property
    def sizes(self) -> Array:
        """Norms of `lower` and `offset` together."""
        return _norm(self.lower) + _norm(self.offset)


def _norm(matrices: Array) -> Array:
    return np.asarray(np.sqrt(np.sum(matrices**2, axis=(-2, -1))))


def _lower_bound(ends: Array) -> tuple[Array, Array]:
    """A matrix below each of the ends (places, k, size, size), and how far it is from their middle."""
    centre = 0.5 * (ends[:, 0] + ends[:, -1])
    # Eigenvalues and eigenvectors are exact for a matrix nearby: SETTINGS.room is beyond how far it is.
    shift = (SETTINGS.room * _norm(ends).max(axis=1))[:, None, None] * np.eye(ends.shape[-1])
    offset = _upper_bound(centre[:, None] - ends) + shift
    return centre - offset, offset


def lower_bound(stack: Interval) -> Array:
    """A symmetric matrix below all that each place of a stack holds."""
    symmetric = 0.5 * (stack + stack.T)
    middle, radius = symmetric.middle, symmetric.radius
    less = radius.sum(axis=-1) * (1 + SETTINGS.room) + SETTINGS.rounding * _norm(middle)[..., None]
    return np.asarray(middle - less[..., None] * np.eye(middle.shape[-1]))


def sums_positive(rest: Interval, place: Any, ends: list[Interval], box: Any, budget: MatrixBudget) -> Flags:
    """By box of rows, whether rest + one of the ends of each is positive definite whichever they are, proved.

    The ends of a row are those at its `place`. With C_i in the middle of the ends and T_i >= C_i - end for
    each of them, rest + sum of (C_i - T_i) is below every such sum. Where that is not positive, the set of
    ends that takes most is cut into two. (Ben-Tal and Nemirovski 2002, On tractable approximations of
    uncertain linear matrix inequalities affected by interval uncertainty, SIAM J. Optim. 12, look for T_i
    by a program.)
    """
    proved = np.ones(box.max() + 1, dtype=bool)
    budget.remaining -= len(place)
    if budget.remaining < 0:
        return ~proved
    centre = np.sum([0.5 * (e.middle[:, 0] + e.middle[:, -1]) for e in ends], axis=0)
    middle = rest.middle + centre[place]
    proved[box[~(np.linalg.eigvalsh(middle)[:, 0] > 0)]] = False
    pending = np.flatnonzero(proved[box])
    if len(pending):
        used, places = np.unique(place[pending], return_inverse=True)
        # Triangular, so regular for certain: in these states rows are near the identity.
        inverse = np.asarray(np.linalg.inv(_mean_cholesky(middle[pending], places)), dtype=float)
        rows = lower_bound(_congruent(rest[pending], inverse[places]))
        trees = [VertexTree(_congruent_lower(e[used], inverse[:, None])) for e in ends]
        _branch(rows, places, trees, box[pending], proved, budget)
    return proved


def _congruent(stack: Interval, T: Array) -> Interval:
    return T @ stack @ np.swapaxes(T, -1, -2)


def _congruent_lower(stack: Interval, T: Array) -> Array:
    """`lower_bound` of `_congruent`; nearly exact intervals in numbers, lowered by more than rounding."""
    if (stack.radius > SETTINGS.room * _norm(stack.middle)[..., None, None]).any():
        return lower_bound(_congruent(stack, T))
    below = lower_bound(stack)
    shift = SETTINGS.rounding * _norm(T) ** 2 * _norm(below)
    return np.asarray(T @ below @ np.swapaxes(T, -1, -2) - shift[..., None, None] * np.eye(T.shape[-1]))


def _branch(
    rows: Array, place: Any, trees: list[VertexTree], box: Any, proved: Flags, budget: MatrixBudget
) -> None:
    """Take boxes that are not proved out of `proved`; all of them where the work is too much."""
    pending = [(np.arange(len(rows)), np.zeros((len(rows), len(trees)), dtype=int))]
    while pending:
        row, sets = pending.pop()
        row, sets = row[proved[box[row]]], sets[proved[box[row]]]
        if len(row) > SETTINGS.batch:
            pending.append((row[SETTINGS.batch :], sets[SETTINGS.batch :]))
            row, sets = row[: SETTINGS.batch], sets[: SETTINGS.batch]
        budget.remaining -= len(row)
        if budget.remaining < 0:
            proved[:] = False
            return
        if len(row):
            unproved, x = _unproved(rows[row], place[row], sets, trees)
            row, sets = row[unproved], sets[unproved]
            refuted, axis = _branching(rows[row], place[row], sets, trees, x)
            proved[box[row[refuted]]] = False
            pending += [(row[~refuted], _halve(sets[~refuted], axis[~refuted], trees, k)) for k in (0, 1)]


def _halve(sets: Any, axis: Any, trees: list[VertexTree], half: int) -> Any:
    """The sets of ends with one half of that which is cut."""
    found = sets.copy()
    for i, tree in enumerate(trees):
        found[axis == i, i] = tree.children[sets[axis == i, i], half]
    return found


def _unproved(rows: Array, place: Any, sets: Any, trees: list[VertexTree]) -> tuple[Any, Array]:
    """Which rows are not proved with these sets of ends, and the worst direction of each of them."""
    pairs = list(zip(trees, sets.T, strict=True))
    total = rows + sum(c.lower[place, p] for c, p in pairs)
    size = _norm(rows) + sum(c.sizes[place, p] for c, p in pairs)
    unproved = np.flatnonzero(~(np.linalg.eigvalsh(total)[:, 0] > SETTINGS.room * size))
    return unproved, np.linalg.eigh(total[unproved])[1][..., 0]


def _branching(rows: Array, place: Any, sets: Any, trees: list[VertexTree], x: Array) -> tuple[Flags, Array]:
    """Rows that are lost, and for the others of which velocity the ends are cut.

    A row is lost where the worst ends for its direction leave nothing of it, or where each set is one end.
    """
    least = np.einsum("ks,kst,kt->k", x, rows, x)
    lost = np.zeros((len(rows), len(trees)))
    for i, (tree, chosen) in enumerate(zip(trees, sets.T, strict=True)):
        least = least + quadratic_values(np.eye(x.shape[-1]), tree.ends[place], x).min(axis=-1)
        lost[:, i] = np.einsum("ks,kst,kt->k", x, tree.offset[place, chosen], x)
        lost[tree.children[chosen, 0] < 0, i] = -np.inf
    return (least <= 0) | np.isinf(lost).all(axis=1), lost.argmax(axis=1)


# --- programs -----------------------------------------------------------------------------------------


class LMI(NamedTuple):
    """constant + sum x_k forms_k has to be positive semidefinite."""

    constant: Array
    coefficients: Array


class Solution(NamedTuple):
    """What a program came to."""

    x: Array  # the unknowns
    # By form, a matrix Z: the least cost changes by -trace(Z' change) with a small change of the form.
    duals: list[Array]


def solve_sdp(cost: Array, inequalities: Sequence[LMI]) -> Solution | None:
    """x of least cost' x for which every form is positive semidefinite, or None where there is none."""
    clarabel = _solver()
    from scipy.sparse import csc_matrix

    rows = [_packed(f.coefficients).T for f in inequalities]
    A = csc_matrix(-np.concatenate(rows))
    b = np.concatenate([_packed(f.constant[None])[0] for f in inequalities])
    cones = [clarabel.PSDTriangleConeT(len(f.constant)) for f in inequalities]
    none = csc_matrix((len(cost), len(cost)))
    # Cut into their cliques, forms are solved several times as fast; where rounding stops that, whole.
    for decompose in (True, False):
        solution = clarabel.DefaultSolver(none, cost, A, b, cones, _settings(clarabel, decompose)).solve()
        if str(solution.status) in ("Solved", "AlmostSolved"):
            break
        if "Infeasible" in str(solution.status):
            return None
    else:
        return None
    sizes = np.cumsum([r.shape[0] for r in rows])[:-1]
    duals = map(_unpacked, np.split(np.array(solution.z), sizes), (len(f.constant) for f in inequalities))
    return Solution(np.array(solution.x), list(duals))


def _settings(clarabel: Any, decompose: bool) -> Any:
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_iter = SETTINGS.program_rounds
    settings.max_threads = 1
    settings.direct_solve_method = "faer"  # dense blocks: twice as fast as the default
    # Programs come scaled and need few digits: without these two it takes half the time.
    settings.equilibrate_enable = settings.iterative_refinement_enable = False
    settings.chordal_decomposition_enable = decompose
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = SETTINGS.program_accuracy
    return settings


def _packed(matrices: Array) -> Array:
    """Upper triangles column by column with sqrt 2 off the diagonal, as the solver takes them."""
    n = matrices.shape[-1]
    j, i = np.tril_indices(n)
    return np.asarray(matrices[:, i, j] * np.where(i == j, 1.0, np.sqrt(2)))


def _unpacked(triangle: Array, n: int) -> Array:
    """The symmetric matrix of such a triangle."""
    found = np.zeros((n, n))
    j, i = np.tril_indices(n)
    found[i, j] = found[j, i] = triangle / np.where(i == j, 1.0, np.sqrt(2))
    return found


def _solver() -> Any:
    try:
        import clarabel
    except ImportError:
        raise UndertowError(
            "searching for V needs a solver of semidefinite programs, which is not installed: "
            "pip install 'undertow[certificates]'"
        ) from None
    return clarabel
