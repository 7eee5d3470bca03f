"""The linearised problem of many windows with their unknown starts eliminated, from sums of products."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from undertow.codegen.gauss_newton import Products
from undertow.typing import Array

# Keeps a start bounded in directions that its window does not show, relative to those that it shows.
_HOLD = 1e-12


@dataclass(frozen=True)
class Reduced:
    """The linearised problem of all windows with their starts eliminated.

    Attributes
    ----------
    r : (m,) array
        What is left of the residual, m = n_free + 1: the square of its norm is the cost at the best starts.
    J : (m, n_free) array
        Its derivative in the free parameters.
    cost : float
        Sum of squares at the present starts; inf if a simulation diverged.
    squares, counts : (2n,) array
        Sum of squares by channel, and number of samples in it.
    scores : (groups, n_free) array
        J' r of groups of residuals that count as independent: windows, or parts of long ones.
    start_step, start_slope : (b, k) and (b, k, n_free) array
        Best change of every start, and its derivative in the parameters.
    """

    r: Array
    J: Array
    cost: float
    squares: Array
    counts: Array
    scores: Array
    start_step: Array
    start_slope: Array


def eliminated(parts: list[Products], counts: Array, n: int) -> Reduced:
    """The problem that remains once every window has its best start.

    Parameters
    ----------
    parts : list of Products
        Sums of all windows, batch by batch; derivatives in the n free parameters come first.
    counts : (2n,) array
        Samples that count, by channel.
    n : int
        Number of free parameters.
    """
    windows, size = sum(len(p.squares) for p in parts), len(counts)
    with np.errstate(over="ignore"):
        squares = np.sum([p.squares.sum(axis=0) for p in parts], axis=0)
    # What nearly diverged may be so large that its squares are beyond all numbers.
    whole = all(np.all(np.isfinite(p.table)) for p in parts) and np.all(np.isfinite(squares))
    if any(p.diverged for p in parts) or not whole:
        return _diverged(windows, n, size)
    back = np.concatenate([_starts(p.table.sum(axis=1), n) for p in parts])
    first = np.cumsum([0, *(len(p.squares) for p in parts)])
    scores, gram = [], np.zeros((n + 1, n + 1))
    for part, begin in zip(parts, first, strict=False):
        left = _projected(part.table, back[begin : begin + len(part.squares)], n)
        scores.append(left[:, :, :n, n].reshape(left.shape[0] * left.shape[1], n))
        gram += left.sum(axis=(0, 1))
    condensed = _condensed(gram)
    return Reduced(
        r=condensed[:, n],
        J=condensed[:, :n],
        cost=float(squares.sum()),
        squares=squares,
        counts=counts,
        scores=np.concatenate(scores),
        start_step=-back[:, :, n],
        start_slope=-back[:, :, :n],
    )


def _starts(table: Array, n: int) -> Array:
    """Least squares on the starts, window by window: solution for every free column and the error.

    Normal equations: the columns of a start are few and well conditioned once they are scaled.
    """
    gram, right = table[:, n:-1, n:-1], _outer(table, n)
    scale = np.sqrt(np.diagonal(gram, axis1=1, axis2=2))
    scale = np.where(scale > 0, scale, 1.0)[:, :, None]
    scaled = gram / (scale * np.swapaxes(scale, 1, 2)) + _HOLD * np.eye(gram.shape[1])
    return np.asarray(np.linalg.solve(scaled, right / scale) / scale)


def _outer(table: Array, n: int) -> Array:
    """Products of the starts with the free columns and the error."""
    return np.concatenate([table[..., n:-1, :n], table[..., n:-1, -1:]], axis=-1)


def _projected(table: Array, back: Array, n: int) -> Array:
    """Products of the free columns and the error once their shares of the starts are taken off."""
    kept = [*range(n), table.shape[-1] - 1]
    own = table[..., kept, :][..., :, kept]
    across = np.swapaxes(back, 1, 2)[:, None]
    shared = across @ _outer(table, n)
    # All four terms: to first order a solution that is a little off takes nothing away.
    return np.asarray(
        own - shared - np.swapaxes(shared, -1, -2) + across @ table[..., n:-1, n:-1] @ back[:, None]
    )


def _condensed(gram: Array) -> Array:
    """Few rows with these products of their columns."""
    diagonal = np.diag(gram)
    # A column that lies in the starts is nil but for rounding, which may be negative.
    there = diagonal > 0.0
    scale = np.sqrt(np.where(there, diagonal, 1.0))
    cosines = np.where(np.outer(there, there), gram / scale / scale[:, None], 0.0)
    weight, vectors = np.linalg.eigh(np.clip(cosines, -1.0, 1.0))
    return np.asarray(np.sqrt(np.maximum(weight, 0.0))[:, None] * vectors.T * scale)


def _diverged(windows: int, n: int, size: int) -> Reduced:
    nothing = np.zeros((1, n))
    steps = np.zeros((windows, size)), np.zeros((windows, size, n))
    return Reduced(np.zeros(1), nothing, float("inf"), np.zeros(size), np.zeros(size), nothing, *steps)
