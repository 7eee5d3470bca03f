"""Semidefinite programs, by Clarabel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from undertow.errors import UndertowError
from undertow.typing import Array


class Form(NamedTuple):
    """constant + sum x_k forms_k has to be positive semidefinite."""

    constant: Array
    forms: Array


def solved(cost: Array, forms: Sequence[Form]) -> Array | None:
    """x of least cost' x for which every form is positive semidefinite, or None where there is none."""
    clarabel = _solver()
    from scipy.sparse import csc_matrix

    rows = [_packed(f.forms).T for f in forms]
    A = csc_matrix(-np.concatenate(rows))
    b = np.concatenate([_packed(f.constant[None])[0] for f in forms])
    cones = [clarabel.PSDTriangleConeT(len(f.constant)) for f in forms]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_iter = 80
    settings.max_threads = 1
    none = csc_matrix((len(cost), len(cost)))
    solution = clarabel.DefaultSolver(none, cost, A, b, cones, settings).solve()
    if str(solution.status) not in ("Solved", "AlmostSolved"):
        return None
    return np.array(solution.x)


def _packed(matrices: Array) -> Array:
    """Upper triangles column by column with sqrt 2 off the diagonal, as the solver takes them."""
    n = matrices.shape[-1]
    j, i = np.tril_indices(n)
    return np.asarray(matrices[:, i, j] * np.where(i == j, 1.0, np.sqrt(2)))


def _solver() -> Any:
    try:
        import clarabel
    except ImportError:
        raise UndertowError(
            "searching for V needs a solver of semidefinite programs, which is not installed: "
            "pip install 'undertow[certificates]'"
        ) from None
    return clarabel
