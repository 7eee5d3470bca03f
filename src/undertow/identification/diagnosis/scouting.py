"""What a candidate promises before it is fitted: one Gauss-Newton step from its start."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..weak.data import WeakData
from ..weak.fit import opened, promise
from ..weak.noise import Whitening
from ..weak.residual import Linearised, whitened
from ..weak.step import bounded_step, bounds_of, prior_of, reach_of, within_reach
from .candidates import Candidate
from .trial import Bench

# Of more starts than this, only the best are looked at more closely.
_MANY_STARTS, _BEST_STARTS = 4, 2
_CLOSER = 2
# Relative difference of two residuals up to which they are the same.
_SAME = 1e-9


class Scouted:
    """A candidate at one start, and what one Gauss-Newton step from there promises.

    Where the candidate changes nothing yet, the columns of the model without it are what they were, and only
    its own are worked out.

    Parameters
    ----------
    candidate : Candidate
        What is tried.
    bench : Bench
        Data, noise model and the model without it.
    start : mapping
        Values that differ from those of the model without it.
    steps : int
        Gauss-Newton steps taken beforehand.

    Attributes
    ----------
    start : WeakFit
        The model at the start, not fitted.
    cost : float
        Sum of squares after the step.
    values : dict
        Free parameters where a fit is to begin: after the step from a start as given, without it where steps
        were taken beforehand, since what one promises may not come true.
    """

    def __init__(
        self, candidate: Candidate, bench: Bench, start: Mapping[str, float], steps: int = 0
    ) -> None:
        self._candidate, self._bench, self._values = candidate, bench, start
        known = (bench.base.at, bench.train, bench.train_whitening)
        at = None if steps else self._beside(*known)
        noise = (bench.train_whitening, bench.base.disturbance)
        begin = bench.base.values | dict(start)
        self.start = opened(candidate.model(), bench.train, begin, *noise, at=at, steps=steps)
        self.cost, after = promise(self.start)
        self.values = self.start.values if steps else after
        self._changes_nothing = at is not None

    def closer(self) -> Scouted:
        """The same from where the step leads, after some more."""
        return Scouted(self._candidate, self._bench, self.values, _CLOSER)

    @property
    def on_test(self) -> Linearised:
        """The start on the kept-aside data."""
        bench = self._bench
        known = (bench.base_on_test, bench.test, bench.test_whitening)
        at = self._beside(*known) if self._changes_nothing else None
        return bench.on_test(self.start) if at is None else at

    def _beside(self, known: Linearised, data: WeakData, noise: list[Whitening]) -> Linearised | None:
        """The columns of the model without the candidate and its own; None where the start changes things."""
        own = _own_columns(self._candidate, self._bench, self._values, data)
        if any(np.any(part.start) for part in own):
            return None
        at, size = whitened(own, noise), float(np.max(np.abs(known.r), initial=0.0))
        if not np.allclose(at.r, known.r, rtol=_SAME, atol=_SAME * size):
            return None
        return Linearised(known.r, np.hstack([known.J, at.J]), at.start)


def scout(candidate: Candidate, bench: Bench) -> Scouted:
    """What a candidate promises from its best start, after some steps where there are several."""
    return scouts(candidate, bench)[0]


def scouts(candidate: Candidate, bench: Bench) -> list[Scouted]:
    """What a candidate promises from its best start, and from the next best one where there are several.

    A start away from where the effect vanishes is worse than the model as it is until a few steps are taken.
    """
    starts = candidate.starts(bench.command_scale, bench.seen)
    if len(starts) > _MANY_STARTS:
        starts = _promising(candidate, bench, starts)
    found = sorted((Scouted(candidate, bench, start) for start in starts), key=lambda s: s.cost)
    if len(found) == 1:
        return found
    # What a step promises may not come true; what some steps have reached has.
    return sorted((s.closer() for s in found[:_BEST_STARTS]), key=lambda s: s.start.cost)


def begun(
    candidate: Candidate, bench: Bench, starts: Sequence[dict[str, float]], enough: float = 0.0
) -> dict[str, float]:
    """Where the better one of several fits ends: which start leads there, a few steps cannot show.

    Parameters
    ----------
    candidate : Candidate
        What is tried.
    bench : Bench
        Data, noise model and the model without it.
    starts : sequence of dict
        Values from which to fit; a single one is handed back as it is.
    enough : float
        Share of the sum of squares that a step has to promise for another to follow.
    """
    if len(starts) == 1:
        return starts[0]
    fits = [bench.fit(candidate.model(), start=start, enough=enough) for start in starts]
    return min(fits, key=lambda fit: fit.cost).values


def _own_columns(
    candidate: Candidate, bench: Bench, start: Mapping[str, float], data: WeakData
) -> list[Linearised]:
    """The model with a candidate at a start, differentiated in the candidate's own parameters only."""
    model = candidate.model(tuple(p.name for p in candidate.parameters))
    names = model.functions.parameter_names
    stated = {n: model.functions.vehicle.value_of(n).value for n in names}
    values = stated | bench.base.values | dict(start)
    return model.linearise(data, np.array([values[n] for n in names]))


def _promising(
    candidate: Candidate, bench: Bench, starts: Sequence[dict[str, float]]
) -> list[dict[str, float]]:
    """The best of many starts, by the candidate's own columns beside those of the model as it is.

    Parameters keep within their bounds: a negative mass may promise what no mass can do.
    """
    model = candidate.model()
    bounds, prior, reach = bounds_of(model), prior_of(model), reach_of(model)
    costs = []
    for start in starts:
        at = whitened(_own_columns(candidate, bench, start, bench.train), bench.train_whitening)
        beside = Linearised(at.r, np.hstack([bench.base.at.J, at.J]), at.start)
        values = bench.base.values | start
        now = np.array([values.get(n, model.functions.vehicle.value_of(n).value) for n in model.free])
        step = bounded_step(beside, now, within_reach(bounds, now, reach), prior)
        costs.append(float(np.sum((beside.r + beside.J @ step) ** 2)))
    return [starts[i] for i in np.argsort(costs)[:_BEST_STARTS]]
