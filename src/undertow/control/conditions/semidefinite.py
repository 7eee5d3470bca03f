"""Semidefinite programs, by Clarabel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from undertow.errors import UndertowError
from undertow.typing import Array

ACCURACY = 1e-4
"""Relative, of objective and forms: what is found is proved afterwards, with more room than that."""


class Form(NamedTuple):
    """constant + sum x_k forms_k has to be positive semidefinite."""

    constant: Array
    forms: Array


class Solution(NamedTuple):
    """What a program came to.

    Attributes
    ----------
    x : ndarray
        The unknowns.
    duals : list of ndarray
        By form, a matrix Z: the least cost changes by -trace(Z' change) with a small change of the form.
    """

    x: Array
    duals: list[Array]


def solved(cost: Array, forms: Sequence[Form]) -> Solution | None:
    """x of least cost' x for which every form is positive semidefinite, or None where there is none."""
    clarabel = _solver()
    from scipy.sparse import csc_matrix

    rows = [_packed(f.forms).T for f in forms]
    A = csc_matrix(-np.concatenate(rows))
    b = np.concatenate([_packed(f.constant[None])[0] for f in forms])
    cones = [clarabel.PSDTriangleConeT(len(f.constant)) for f in forms]
    none = csc_matrix((len(cost), len(cost)))
    # Cut into their cliques, forms are solved several times as fast; where rounding stops that, whole.
    for cut in (True, False):
        solution = clarabel.DefaultSolver(none, cost, A, b, cones, _settings(clarabel, cut)).solve()
        if str(solution.status) in ("Solved", "AlmostSolved"):
            break
        if "Infeasible" in str(solution.status):
            return None
    else:
        return None
    sizes = np.cumsum([r.shape[0] for r in rows])[:-1]
    duals = map(_unpacked, np.split(np.array(solution.z), sizes), (len(f.constant) for f in forms))
    return Solution(np.array(solution.x), list(duals))


def _settings(clarabel: Any, cut: bool) -> Any:
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_iter = 80
    settings.max_threads = 1
    settings.direct_solve_method = "faer"  # dense blocks: twice as fast as the default
    # Programs come scaled and need few digits: without these two it takes half the time.
    settings.equilibrate_enable = settings.iterative_refinement_enable = False
    settings.chordal_decomposition_enable = cut
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = ACCURACY
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
