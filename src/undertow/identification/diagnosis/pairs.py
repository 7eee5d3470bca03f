"""Two effects at once: pairs of leading candidates, for where no single one explains the residual."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from undertow.typing import Array

from ..weak.residual import whitened
from ..weak.step import inverse_of
from .chain import Chain, fitted
from .evidence import as_good, compare_scores
from .finding import Finding
from .rounds import Round
from .second_look import Quiet
from .trial import Bench

_LEADING = 8
# Pairs that are tried beside an effect that shows alone, and where none does.
_PAIRS, _LONE_PAIRS = 2, 6


def pair_beside(current: Round, quiet: Quiet) -> Chain | None:
    """Two effects that without the best single one explain clearly more than that, if the logs leave no more.

    A pair with the best single effect is found by the next round.

    Parameters
    ----------
    current : Round
        Every effect by itself.
    quiet : callable
        Whether a model leaves only noise of the kept-aside data.
    """
    good = [c for c in _tried(current, _PAIRS) if quiet(c.fit, current.bench.test)]
    return min(good, key=lambda c: c.score.error, default=None)


def lone_pair(current: Round, quiet: Quiet) -> Chain | None:
    """Two effects of which neither is in evidence alone and that together leave only noise.

    All pairs of effects were in the race, so that by chance the best of them looks good more easily than the
    best single one; and of several that do as well, none is in evidence.

    Parameters
    ----------
    current : Round
        Every effect by itself.
    quiet : callable
        Whether a model leaves only noise of the kept-aside data.
    """
    bench = current.bench
    if quiet(bench.base, bench.test):
        return None
    count = len(current.findings) * (len(current.findings) - 1) // 2
    tried = _tried(current, _LONE_PAIRS)
    good = [c for c in tried if _in_evidence(c, bench, count) and quiet(c.fit, bench.test)]
    best = min(good, key=lambda c: c.score.error, default=None)
    if best is None or any(as_good(best.score, c.score, bench.test) for c in tried if c is not best):
        return None
    return best


def _tried(current: Round, most: int) -> list[Chain]:
    """The most promising pairs of effects, fitted, without those of the best single one if there is one."""
    bench = current.bench
    vehicle = bench.base.model.functions.vehicle
    pairs = promising_pairs(current.findings, bench, most)
    return [fitted(vehicle, pair, bench) for pair in pairs if current.winner not in pair]


def _in_evidence(pair: Chain, bench: Bench, count: int) -> bool:
    gap = compare_scores(bench.base_score, pair.score, bench.test)
    return gap.beyond_chance(bench.false_alarms, among=count)


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
