"""Other methods on the same data with the same candidate terms: stepwise F-test selection, and PySINDy."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import f as fisher

from undertow.identification.logs.run import Run
from undertow.model.vehicle import Vehicle

from .terms import Terms, make_terms
from .verdicts import Answer

Array = NDArray[np.float64]
Method = Callable[[Terms], Answer]
#: Level of the F test, over the number of candidates.
LEVEL = 0.01
#: Share of the validation mean square that a further effect has to take away.
WORTH = 0.02
MOST = 3
#: Thresholds of STLSQ, in units of what a column of that coefficient does to the rms of all that is left.
THRESHOLDS = np.geomspace(0.01, 1.0, 25)
_RIDGE = 1e-6
_AS_GOOD = 1.02


def stepwise(terms: Terms) -> Answer:
    """Forward selection by the F test of each effect's columns, guarded by the error on validation data."""
    chosen: list[str] = []
    first: list[str] = []
    while len(chosen) < MOST:
        order = _by_f_test(terms, chosen)
        first = first or [effect for effect, _ in order]
        if not order or not _worth_it(terms, chosen, *order[0]):
            break
        chosen.append(order[0][0])
    return _answer(chosen, first)


def _by_f_test(terms: Terms, chosen: Sequence[str]) -> list[tuple[str, float]]:
    """Effects that are not chosen, with the logarithm of the p-value of their F test, the least first."""
    before, n = _left(terms, chosen), len(terms.y)
    found = []
    for effect in terms.effects:
        if effect in chosen:
            continue
        own, all_ = len(terms.of([effect])), len(terms.of([*chosen, effect])) + terms.base
        after = _left(terms, [*chosen, effect])
        ratio = (before - after) / own / (after / (n - all_))
        # Where p underflows the ratio itself decides.
        found.append((effect, float(fisher.logsf(ratio, own, n - all_)), ratio))
    return [(effect, p) for effect, p, _ in sorted(found, key=lambda one: (one[1], -one[2]))]


def _worth_it(terms: Terms, chosen: Sequence[str], effect: str, log_p: float) -> bool:
    before, after = (terms.aside(_coefficients(terms, names)) for names in (chosen, [*chosen, effect]))
    return log_p < np.log(LEVEL / len(terms.effects)) and after < (1 - WORTH) * before


def _coefficients(terms: Terms, effects: Sequence[str]) -> Array:
    places, out = terms.of(effects), np.zeros(len(terms.effect))
    if places:
        out[places] = np.linalg.lstsq(terms.columns[:, places], terms.y, rcond=None)[0]
    return out


def _left(terms: Terms, effects: Sequence[str]) -> float:
    return float(np.sum((terms.y - terms.columns @ _coefficients(terms, effects)) ** 2))


def sindy(terms: Terms) -> Answer:
    """STLSQ of PySINDy; of all thresholds the sparsest model that predicts the validation data as well."""
    from pysindy.optimizers import STLSQ

    tried = []
    for threshold in THRESHOLDS * np.sqrt(np.mean(terms.y**2)):
        optimizer = STLSQ(threshold=threshold, alpha=_RIDGE, max_iter=20)
        optimizer.fit(terms.columns, terms.y[:, None])
        found = np.asarray(optimizer.coef_).ravel()
        tried.append((terms.aside(found), found))
    tried.append((terms.aside(np.zeros(len(terms.effect))), np.zeros(len(terms.effect))))
    best = min(error for error, _ in tried)
    chosen = min((c for error, c in tried if error <= _AS_GOOD * best), key=np.count_nonzero)
    # The columns have unit rms, so that coefficients are contributions.
    weight = {e: float(np.linalg.norm(chosen[terms.of([e])])) for e in terms.effects}
    named = sorted((e for e in terms.effects if weight[e] > 0), key=lambda e: -weight[e])
    return _answer(named, [*named, *(e for e in terms.effects if e not in named)])


def _answer(named: list[str], ranking: list[str]) -> Answer:
    return Answer("missing_effect" if named else "adequate", named, [], ranking)


def available() -> dict[str, Method]:
    """The methods that are installed, by name."""
    methods: dict[str, Method] = {"stepwise F test": stepwise}
    try:
        import pysindy  # noqa: F401
    except ImportError:
        return methods
    return {**methods, "PySINDy": sindy}


def asked(vehicle: Vehicle, train: Sequence[Run], test: Sequence[Run]) -> dict[str, dict[str, Any]]:
    """What each of the other methods says of a case, with the seconds it took and what it could express."""
    began = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        terms = make_terms(vehicle, train, test)
        shared = time.perf_counter() - began
        return {name: _timed(method, terms, shared) for name, method in available().items()}


def _timed(method: Method, terms: Terms, shared: float) -> dict[str, Any]:
    began = time.perf_counter()
    answer = method(terms).as_dict()
    return answer | {"seconds": shared + time.perf_counter() - began, "expressible": terms.effects}
