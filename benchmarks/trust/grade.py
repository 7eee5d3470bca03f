"""How much the truth helps: the incomplete model against a refit that was told what is hidden."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from undertow.identification.diagnosis.candidates import Candidate
from undertow.identification.diagnosis.trial import Bench, open_bench
from undertow.identification.logs import Run
from undertow.identification.weak.data import WeakData, prepare
from undertow.identification.weak.fit import WeakFit, mean_square
from undertow.identification.weak.noise import Whitening
from undertow.identification.weak.residual import whitened
from undertow.model.catalogue import catalogue
from undertow.model.vehicle import Value, Vehicle

#: Name and smallest ratio of each grade, the strongest first.
GRADES = (("strong", 3.0), ("medium", 1.5), ("weak", 1.1))
HIDDEN = "hidden in the noise"
_GLANCE = 3  # Gauss-Newton steps after which starting points are compared


def grade_of(ratio: float) -> str:
    """`strong`, `medium`, `weak` or `hidden in the noise`."""
    return next((name for name, least in GRADES if ratio >= least), HIDDEN)


def error_of(fit: WeakFit, test: WeakData, noise: list[Whitening]) -> float:
    """Error of a model on kept-aside data: rms over all equations of the residual, in units of the noise.

    Not the geometric mean that the diagnosis prints: in twelve equations that would hide one bad one.
    """
    r = whitened(fit.model.linearise(test, fit.p), noise).r
    return float(np.sqrt(np.nanmean(mean_square(r, test))))


@dataclass(frozen=True)
class Told:
    """A refit that was told the truth, and what others are held against.

    Attributes
    ----------
    fit : WeakFit
        The model with the true effects.
    test : WeakData
        Data kept aside.
    before, error : float
        Error of the refitted incomplete model and of the told one, in units of the same noise: that which
        the sensors make, as the told model sees it.
    lacking : dict
        Error of the model that lacks only this one of two true effects.
    """

    fit: WeakFit
    test: WeakData
    before: float
    error: float
    lacking: dict[str, float]

    @property
    def ratio(self) -> float:
        """What the truth is worth; for two effects, what the less visible of them is worth."""
        return min(self.lacking.values(), default=self.before) / self.error

    def error_of(self, fit: WeakFit) -> float:
        """Error of any model in the same units."""
        return error_of(fit, self.test, quiet(self.fit, self.test))


def quiet(fit: WeakFit, data: WeakData) -> list[Whitening]:
    """The noise that the sensors alone make in the equations of a model."""
    return fit.model.whitening(data, fit.p)


def told(
    vehicle: Vehicle,
    train: Sequence[Run],
    test: Sequence[Run],
    truth: Sequence[str],
    values: Mapping[str, float],
) -> Told:
    """Add the true effects, all their parameters free, and refit.

    Parameters
    ----------
    vehicle : Vehicle
        The incomplete model.
    train, test : sequence of Run
        Data to fit to and data kept aside.
    truth : sequence of str
        Ids of what is hidden; all in the catalogue.
    values : mapping
        True values, as far as they bear the names of the catalogue: the search begins there.
    """
    bench = opened(vehicle, train, test)
    fit = _settled(bench, _added(bench, vehicle, truth, values))
    noise = quiet(fit, bench.test)
    lacking = {}
    for effect in truth if len(truth) > 1 else ():
        others = [other for other in truth if other != effect]
        rest = _settled(bench, _added(bench, vehicle, others, values))
        lacking[effect] = error_of(rest, bench.test, noise)
    before, after = (error_of(f, bench.test, noise) for f in (bench.base, fit))
    return Told(fit, bench.test, before, after, lacking)


def opened(vehicle: Vehicle, train: Sequence[Run], test: Sequence[Run]) -> Bench:
    """The incomplete model, refitted, with the data to judge it by."""
    known = prepare(train, vehicle)
    return open_bench(vehicle, known, prepare(test, vehicle, sigma=known.sigma))


def excess(bench: Bench) -> float:
    """Error of the refitted model on kept-aside data, in units of the noise of the sensors alone."""
    return error_of(bench.base, bench.test, quiet(bench.base, bench.test))


def addable(vehicle: Vehicle, effect: str) -> bool:
    """Whether the catalogue has an effect, and this vehicle could have it."""
    known = catalogue()
    return effect in known and not Candidate(known[effect], vehicle).adds_nothing


def _added(bench: Bench, vehicle: Vehicle, effects: Sequence[str], values: Mapping[str, float]) -> WeakFit:
    """Priors stay those of the vehicle: a fit of the incomplete model is no prior knowledge."""
    fit = bench.base
    for effect in effects:
        candidate = Candidate(catalogue()[effect], vehicle)
        fit = _fitted(bench, candidate, fit.values, values)
        free = {p.name: Value(fit.values[p.name], estimate=True) for p in candidate.parameters}
        vehicle = candidate.vehicle.with_values(free)
    return fit


def _fitted(
    bench: Bench, candidate: Candidate, begin: Mapping[str, float], values: Mapping[str, float]
) -> WeakFit:
    true = {p.name: values[p.name] for p in candidate.parameters if p.name in values}
    starts = _different([begin | s | true for s in candidate.starts(bench.command_scale) or [{}]])
    if len(starts) == 1:
        return bench.fit(candidate.vehicle, candidate.free(), starts[0])
    glances = [bench.fit(candidate.vehicle, candidate.free(), s, most=_GLANCE) for s in starts]
    best = min(glances, key=lambda fit: fit.cost)
    return bench.fit(candidate.vehicle, candidate.free(), best.values)


def _different(starts: Sequence[dict[str, float]]) -> list[dict[str, float]]:
    return list({tuple(sorted(s.items())): s for s in starts}.values())


def _settled(bench: Bench, fit: WeakFit) -> WeakFit:
    """The same model under the noise model that fits it."""
    sharp = bench.sharpened(fit)
    return sharp.fit(fit.model.functions.vehicle, fit.model.free, fit.values)
