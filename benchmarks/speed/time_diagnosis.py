"""A diagnosis over the whole catalogue, beside stepwise selection on the same data and candidate terms."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from scipy.stats import f as fisher

from benchmarks.profile.case import HIDDEN, long_material, material
from benchmarks.profile.measure import effects_to_try, found, subset, warmed_up
from benchmarks.trust.peers import LEVEL, MOST, WORTH, stepwise
from benchmarks.trust.terms import Terms, make_terms
from undertow.model.catalogue import catalogue

from .conftest import Speed
from .goals import DIAGNOSIS, LONG, OURS

GROWTH = "diagnosis against the number of effects that may be missing"
PEER = "stepwise selection with statsmodels"


def time_whole_catalogue(speed: Speed) -> None:
    warmed_up()
    named: list[list[str]] = []
    more: dict[str, float | str] = {"effects tried": float(len(effects_to_try())), "named": HIDDEN}
    speed(DIAGNOSIS, OURS, lambda: named.append(found(catalogue())), rounds=1, more=more)
    assert named[-1] == [HIDDEN]


def time_long_log(speed: Speed) -> None:
    warmed_up()
    named: list[list[str]] = []
    speed(LONG, OURS, lambda: named.append(found(catalogue(), long_material)), rounds=1)
    assert named[-1] == [HIDDEN]


def time_stepwise(speed: Speed) -> None:
    pytest.importorskip("statsmodels", reason="statsmodels is not installed")
    terms = _terms()
    named = _selected(terms)
    assert named == stepwise(terms).named
    more: dict[str, float | str] = {
        "effects tried": float(len(terms.effects)),
        "named": ", ".join(named) or "nothing",
    }
    speed(DIAGNOSIS, PEER, lambda: _selected(_terms()), rounds=1, more=more)


@pytest.mark.parametrize("size", [5, 10, 20, 40])
def time_growth(speed: Speed, size: int) -> None:
    warmed_up()
    tried = min(size, len(effects_to_try()))
    speed(GROWTH, OURS, lambda: found(subset(size)), rounds=1, size=tried)


def _terms() -> Terms:
    """What stepwise selection starts from: smoothed logs and columns of all effects that it can express."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return make_terms(*material())


def _selected(terms: Terms) -> list[str]:
    """Forward selection by F tests, guarded by the error on validation data."""
    chosen: list[str] = []
    while len(chosen) < MOST:
        best = min((e for e in terms.effects if e not in chosen), key=lambda e: _log_p(terms, chosen, e))
        before, after = (_aside(terms, names) for names in (chosen, [*chosen, best]))
        strong = _log_p(terms, chosen, best)[0] < np.log(LEVEL / len(terms.effects))
        if not strong or after >= (1 - WORTH) * before:
            break
        chosen.append(best)
    return chosen


def _log_p(terms: Terms, chosen: Sequence[str], effect: str) -> tuple[float, float]:
    own, all_ = len(terms.of([effect])), len(terms.of([*chosen, effect])) + terms.base
    before, after, free = _ssr(terms, chosen), _ssr(terms, [*chosen, effect]), len(terms.y) - all_
    ratio = (before - after) / own / (after / free)
    return float(fisher.logsf(ratio, own, free)), -ratio


def _ssr(terms: Terms, effects: Sequence[str]) -> float:
    return float(_fit(terms, effects).ssr) if effects else float(terms.y @ terms.y)


def _aside(terms: Terms, effects: Sequence[str]) -> float:
    coefficients = np.zeros(len(terms.effect))
    if effects:
        coefficients[terms.of(effects)] = _fit(terms, effects).params
    return terms.aside(coefficients)


def _fit(terms: Terms, effects: Sequence[str]) -> Any:
    from statsmodels.api import OLS

    return OLS(terms.y, terms.columns[:, terms.of(effects)]).fit()
