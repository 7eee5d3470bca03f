"""Two effects at once: pairs of leading candidates, for where no single one explains the residual."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ..weak.residual import whitened
from ..weak.step import inverse_of
from .finding import Finding
from .trial import Bench

Array = NDArray[np.float64]
_LEADING = 8


def promising_pairs(findings: Sequence[Finding], bench: Bench, most: int) -> list[tuple[Finding, Finding]]:
    """Pairs of candidates by what they promise together, the most promising first.

    What each changes where it was fitted is added up, and all parameters are refitted linearly.

    Parameters
    ----------
    findings : sequence of Finding
        Candidates of one round, best first.
    bench : Bench
        Data and noise model of the round.
    most : int
        Number of pairs.
    """
    leading = [f for f in findings if f.trial.kept][:_LEADING]
    columns = [_columns(f, bench) for f in leading]
    pairs = [(i, j) for i, j in combinations(range(len(leading)), 2)]
    costs = [_together(bench, columns[i], columns[j]) for i, j in pairs]
    return [(leading[pairs[k][0]], leading[pairs[k][1]]) for k in np.argsort(costs)[:most]]


def _columns(finding: Finding, bench: Bench) -> tuple[Array, Array]:
    """What a candidate changes in the residual where it was fitted, and its own columns there."""
    fit = finding.trial.full
    at = whitened(fit.model.linearise(bench.train, fit.p), bench.train_whitening)
    own = {p.name for p in finding.trial.candidate.parameters}
    chosen = [k for k, n in enumerate(fit.model.free) if n in own]
    return at.r - bench.base.at.r, at.J[:, chosen]


def _together(bench: Bench, first: tuple[Array, Array], second: tuple[Array, Array]) -> float:
    r = bench.base.at.r + first[0] + second[0]
    columns = np.hstack([bench.base.at.J, first[1], second[1]])
    slope = columns.T @ r
    return float(r @ r - slope @ inverse_of(columns.T @ columns) @ slope)
