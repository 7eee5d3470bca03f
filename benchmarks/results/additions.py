"""Effects added by hand, one after the other: what each does to the error, whatever the verdict says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from undertow.identification.diagnosis.candidates import Candidate
from undertow.identification.diagnosis.evidence import compare_scores
from undertow.identification.diagnosis.trial import Bench, open_bench, screen
from undertow.identification.estimation.data import prepare
from undertow.identification.estimation.predictor import predict
from undertow.identification.estimation.weak_form import WeakFit
from undertow.identification.estimation.windows import Windows, cut, prediction_error
from undertow.identification.logs.run import Run
from undertow.model.catalogue import catalogue
from undertow.model.vehicle import Vehicle

HORIZON = 5.0


@dataclass(frozen=True)
class Addition:
    """A model with effects added.

    Attributes
    ----------
    effects : tuple of str
        Ids, in the order in which they were added.
    fit : WeakFit
        The model, fitted.
    error : float
        Error of the forces on the kept-aside run, 1 = noise of the sensors; geometric mean over the motions.
    parts : tuple of float
        The same for each degree of freedom.
    ahead : float
        Error of the velocities 5 s ahead, relative to their rms.
    p_value : float
        Chance that so consistent a fall against the model without the effects is luck (1 for that model).
    """

    effects: tuple[str, ...]
    fit: WeakFit
    error: float
    parts: tuple[float, ...]
    ahead: float
    p_value: float

    @property
    def vehicle(self) -> Vehicle:
        """The model at the fitted values."""
        return self.fit.vehicle

    def value(self, name: str) -> str:
        """A parameter with its standard error, or empty where the model does not have it."""
        if name not in self.fit.values:
            return ""
        return f"{self.fit.values[name]:.3g} ± {self.fit.standard_errors[name]:.1g}"


def added(
    vehicle: Vehicle, train: Sequence[Run], test: Sequence[Run], chains: Sequence[tuple[str, ...]]
) -> list[Addition]:
    """The model as it is, then with every chain of effects, all judged under one noise model.

    The noise model is that of the chain with the lowest error on the training data.
    """
    bench = _bench(vehicle, train, test)
    fits = {(): bench.base}
    for chain in chains:
        fits[chain] = _chained(bench, vehicle, chain)
    best = min(fits.values(), key=lambda fit: fit.cost)
    sharp = bench.sharpened(best)
    # The models are refitted under the noise model that judges them.
    settled = {k: sharp.fit(f.model.functions.vehicle, f.model.free, f.values) for k, f in fits.items()}
    windows = cut(list(test), vehicle, HORIZON)
    return [_addition(sharp, chain, fit, windows, settled[()]) for chain, fit in settled.items()]


def _bench(vehicle: Vehicle, train: Sequence[Run], test: Sequence[Run]) -> Bench:
    known = prepare(train, vehicle)
    aside = prepare(test, vehicle, sigma=known.sigma)
    return open_bench(vehicle, known, aside)


def _chained(bench: Bench, vehicle: Vehicle, chain: tuple[str, ...]) -> WeakFit:
    """Priors stay those of the vehicle: a fit of the incomplete model is no prior knowledge."""
    for effect in chain:
        candidate = Candidate(catalogue()[effect], vehicle)
        start = screen(candidate, bench)[0].values
        # All parameters of the effect are kept, also those that a diagnosis would drop as uncertain.
        fit = bench.fit(candidate.vehicle, candidate.free(), start)
        bench = replace(bench, base=fit)
        vehicle = _estimating(candidate)
    return bench.base


def _estimating(candidate: Candidate) -> Vehicle:
    """The model with the effect, whose parameters are free in later fits, too."""
    own = {p.name: candidate.vehicle.value_of(p.name) for p in candidate.parameters}
    return candidate.vehicle.with_values({n: replace(v, estimate=True) for n, v in own.items()})


def _addition(
    bench: Bench, chain: tuple[str, ...], fit: WeakFit, windows: Windows, base: WeakFit
) -> Addition:
    score, floor = bench.judge(fit), np.maximum(bench.noise_level, 1e-12)
    # Force equations only: where a log has exact pose, its equations hold for any model.
    parts = np.sqrt(score.mean_square / floor)[: len(bench.train.names) // 2]
    ahead = prediction_error(predict(fit.vehicle, windows, compiled=False))
    p = compare_scores(bench.judge(base), score, bench.test).p_value if chain else 1.0
    return Addition(chain, fit, float(np.exp(np.mean(np.log(parts)))), tuple(parts.tolist()), ahead, p)
