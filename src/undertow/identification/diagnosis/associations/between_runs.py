"""Whether a force differs from run to run by more than its scatter within a run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from undertow.typing import Array, Index

from ...weak.step import inverse_of

_FEWEST_BLOCKS = 4


@dataclass(frozen=True)
class Difference:
    """Coefficients of the same columns in every run.

    Attributes
    ----------
    values : (runs, k) array
        The coefficients.
    chance : float
        Chance of so large differences when all runs are alike.
    """

    values: Array
    chance: float


def difference(r: Array, columns: Array, run: Index, block: Index) -> Difference | None:
    """Fit columns to a residual in every run by itself; None unless two runs are long enough.

    Parameters
    ----------
    r : (m,) array
        Residual in units of its noise.
    columns : (m, k) array
        Its derivative in the coefficients.
    run, block : (m,) array of int
        Run and block of time of each entry.
    """
    groups = [np.flatnonzero(run == i) for i in np.unique(run)]
    if len(groups) < 2 or min(len(np.unique(block[g])) for g in groups) < _FEWEST_BLOCKS:
        return None
    fits = [_fitted(r[g], columns[g], block[g]) for g in groups]
    values = np.array([value for value, _ in fits])
    weights = [inverse_of(spread) for _, spread in fits]
    mean = inverse_of(np.sum(weights, axis=0)) @ np.einsum("gij,gj->i", np.array(weights), values)
    distance = sum(float((v - mean) @ w @ (v - mean)) for v, w in zip(values, weights, strict=True))
    return Difference(values, float(chi2.sf(distance, (len(groups) - 1) * columns.shape[1])))


def _fitted(r: Array, columns: Array, block: Index) -> tuple[Array, Array]:
    """Coefficients and their covariance: what noise gives at least, and what the scatter of blocks shows."""
    inverse = inverse_of(columns.T @ columns)
    value = -inverse @ (columns.T @ r)
    scores = columns * (r + columns @ value)[:, None]
    summed = np.array([scores[block == b].sum(axis=0) for b in np.unique(block)])
    scattered = np.sqrt(np.diag(inverse @ (summed.T @ summed) @ inverse) / np.diag(inverse))
    inflation = np.maximum(1.0, scattered)
    return value, inverse * np.outer(inflation, inflation)
