"""Combinations of parameters that data determine where they do not determine each by itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from undertow.typing import Array

# Share of the largest eigenvalue of the scaled information below which a direction is not seen at all.
NOTHING = 1e-10
_TOUCHED = 1e-3
_ROUNDING = 1e-6


@dataclass(frozen=True)
class Combination:
    """A sum of parameters that the data determine.

    Attributes
    ----------
    coefficients : dict of float
        Factor of each parameter in it; one for the first.
    """

    coefficients: dict[str, float]

    def __str__(self) -> str:
        (first, _), *others = self.coefficients.items()
        return " ".join([first, *(_term(name, factor) for name, factor in others)])


def _term(name: str, factor: float) -> str:
    size = abs(factor)
    return f"{'-' if factor < 0 else '+'} {'' if abs(size - 1.0) < 1e-4 else f'{size:.4g} '}{name}"


def undetermined(gram: Array, free: Sequence[str], nothing: float = NOTHING) -> list[list[str]]:
    """Parameters that data do not determine, in groups that hang together.

    Parameters
    ----------
    gram : (k, k) array
        Information J'J of the data, without priors.
    free : sequence of str
        Names of the parameters.
    nothing : float
        Share of the largest eigenvalue of the scaled information below which a direction is not seen.

    Returns
    -------
    list of list of str
        A group of one does not show at all; of a larger one only combinations show.
    """
    _, vectors, unseen = _directions(gram, nothing)
    null = vectors[:, unseen]
    projector = null @ null.T
    groups: list[list[int]] = []
    left = [i for i in range(len(free)) if projector[i, i] > _TOUCHED]
    while left:
        group = [left.pop(0)]
        for i in group:
            group += [j for j in left if abs(projector[i, j]) > _TOUCHED]
            left = [j for j in left if j not in group]
        groups.append(sorted(group))
    return [[free[i] for i in group] for group in groups]


def base_parameters(gram: Array, free: Sequence[str], nothing: float = NOTHING) -> list[Combination]:
    """The combinations that stand in for parameters which data determine together only.

    They span what the information of each group of `undetermined` sees, in reduced row echelon form: each
    begins with a parameter that is in no other.

    Parameters
    ----------
    gram, free, nothing
        As for `undetermined`.
    """
    size, vectors, unseen = _directions(gram, nothing)
    found = []
    for group in undetermined(gram, free, nothing):
        places = [list(free).index(name) for name in group]
        # A functional is seen if it vanishes along every direction that is not.
        null = vectors[places][:, unseen] / np.where(size > 0, size, 1.0)[places, None]
        basis, weight, _ = np.linalg.svd(null)
        rank = int(np.sum(weight > _ROUNDING * max(weight.max(initial=0.0), 1e-300)))
        found += [_named(row, group) for row in _echelon(basis[:, rank:].T)]
    return found


def _directions(gram: Array, nothing: float) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Scale of the parameters, eigenvectors of the scaled information, and which of them are not seen."""
    size = np.sqrt(np.diag(gram))
    scale = np.where(size > 0, 1.0 / np.where(size > 0, size, 1.0), 1.0)
    weight, vectors = np.linalg.eigh(gram * np.outer(scale, scale))
    return size, vectors, weight < nothing * max(float(weight.max(initial=0.0)), 1e-300)


def _echelon(rows: Array) -> Array:
    """Reduced row echelon form."""
    table = rows.copy()
    done = 0
    for column in range(table.shape[1]):
        if done == len(table):
            break
        pivot = done + int(np.argmax(np.abs(table[done:, column])))
        if abs(table[pivot, column]) < _ROUNDING:
            continue
        table[[done, pivot]] = table[[pivot, done]]
        table[done] /= table[done, column]
        others = np.arange(len(table)) != done
        table[others] -= np.outer(table[others, column], table[done])
        done += 1
    return table[:done]


def _named(row: Array, group: Sequence[str]) -> Combination:
    return Combination({n: float(c) for n, c in zip(group, row, strict=True) if abs(c) > _ROUNDING})
