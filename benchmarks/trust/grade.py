"""How much the truth helps: the incomplete model against a refit that knows what is hidden (oracle)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from undertow.identification.diagnosis.candidates import Candidate
from undertow.identification.diagnosis.validation import SimulationValidator
from undertow.identification.estimation.data import WeakData, prepare
from undertow.identification.estimation.fitted import Fitted
from undertow.identification.estimation.residual import whitened
from undertow.identification.estimation.step import Constraints
from undertow.identification.estimation.test_functions import Whitening
from undertow.identification.estimation.weak_form import (
    WeakFit,
    fit_under_noise,
    fit_weak,
    mean_square,
    with_reestimated_noise,
)
from undertow.identification.logs.run import Run
from undertow.model.catalogue import catalogue
from undertow.model.vehicle import Value, Vehicle

from .oracle_values import true_values

#: Name and smallest ratio of each grade, the strongest first.
GRADES = (("strong", 3.0), ("medium", 1.5), ("weak", 1.1))
HIDDEN = "hidden in the noise"
_GLANCE, _STEPS = 3, 15  # Gauss-Newton steps after which starting points are compared, and at most


def grade_of(ratio: float) -> str:
    """`strong`, `medium`, `weak` or `hidden in the noise`."""
    return next((name for name, least in GRADES if ratio >= least), HIDDEN)


def error_of(fit: Fitted, test: WeakData, noise: list[Whitening]) -> float:
    """Error of a model on validation data: rms over all equations of the residual, in units of the noise.

    Not the geometric mean that the diagnosis prints: in twelve equations that would hide one bad one.
    """
    r = whitened(fit.model.linearise(test, np.asarray(fit.p)), noise).r
    return float(np.sqrt(np.nanmean(mean_square(r, test))))


@dataclass(frozen=True)
class OracleRefit:
    """A refit that knows the truth, and what others are held against.

    fit: the model with the true effects, fitted as the diagnosis fits what it names: by output error, started
        from the weak form, where that simulates the validation run no worse.
    test: validation data.
    before, error: error of the refitted incomplete model, by weak form or by output error, whichever is less,
        and of the oracle refit, in units of the same noise: that of the sensors, as the oracle refit has it.
    lacking: error of the model that lacks only this one of two true effects.
    """

    fit: Fitted
    test: WeakData
    before: float
    error: float
    lacking: dict[str, float]

    @property
    def ratio(self) -> float:
        """What the truth is worth; for two effects, what the less visible of them is worth."""
        return min(self.lacking.values(), default=self.before) / self.error

    def error_of(self, fit: Fitted) -> float:
        """Error of any model in the same units."""
        return error_of(fit, self.test, sensor_noise(self.fit, self.test))


def sensor_noise(fit: Fitted, data: WeakData) -> list[Whitening]:
    """The noise that the sensors alone make in the equations of a model."""
    return fit.model.whitening(data, np.asarray(fit.p))


def oracle_refit(
    vehicle: Vehicle,
    train: Sequence[Run],
    test: Sequence[Run],
    truth: Sequence[str],
    values: Mapping[str, float],
) -> OracleRefit:
    """Add the true effects, all their parameters free, and refit."""
    base, aside = opened(vehicle, train, test)
    validator = SimulationValidator(vehicle, train, test, aside.sigma)
    fit, _ = validator.refined(with_reestimated_noise(_added(base, vehicle, truth, values)))
    noise = sensor_noise(fit, aside)

    def least(weak: WeakFit) -> float:
        return min(error_of(f, aside, noise) for f in (weak, validator.refined(weak)[0]))

    lacking = {}
    for effect in truth if len(truth) > 1 else ():
        others = [other for other in truth if other != effect]
        lacking[effect] = least(with_reestimated_noise(_added(base, vehicle, others, values)))
    return OracleRefit(fit, aside, least(base), error_of(fit, aside, noise), lacking)


def opened(vehicle: Vehicle, train: Sequence[Run], test: Sequence[Run]) -> tuple[WeakFit, WeakData]:
    """The incomplete model, refitted, and the data to judge it by."""
    known = prepare(train, vehicle)
    return fit_weak(vehicle, known), prepare(test, vehicle, sigma=known.sigma)


def excess(base: WeakFit, test: WeakData) -> float:
    """Error of a refitted model on validation data, in units of the noise of the sensors alone."""
    return error_of(base, test, sensor_noise(base, test))


def addable(vehicle: Vehicle, effect: str) -> bool:
    """Whether the catalogue has an effect, and this vehicle could have it."""
    known = catalogue()
    return effect in known and not Candidate(known[effect], vehicle).adds_nothing


def _added(base: WeakFit, vehicle: Vehicle, effects: Sequence[str], values: Mapping[str, float]) -> WeakFit:
    """Priors stay those of the vehicle: a fit of the incomplete model is no prior knowledge."""
    fit = base
    for effect in effects:
        candidate = Candidate(catalogue()[effect], vehicle)
        fit = _fitted(fit, candidate, true_values(candidate.parameters, values))
        found = {p.name: Value(fit.values[p.name], estimate=True) for p in candidate.parameters}
        vehicle = candidate.vehicle.with_values(found)
    return fit


def _fitted(before: WeakFit, candidate: Candidate, true: Mapping[str, float]) -> WeakFit:
    """The best fit from the true values and, of what is not told, from every start of the catalogue."""
    starts = [{**before.values, **true, **other} for other in _starts(candidate, true, _scale(before))]
    most = _GLANCE if len(starts) > 1 else _STEPS
    found = [_fit(before, candidate, start, most) for start in starts]
    best = min(found, key=lambda fit: fit.cost)
    return best if most == _STEPS else _fit(before, candidate, best.values, _STEPS)


def _fit(before: WeakFit, candidate: Candidate, start: Mapping[str, float], most: int) -> WeakFit:
    model = Constraints().model(candidate.vehicle, candidate.free())
    noise = before.whitening, before.disturbance
    return fit_under_noise(model, before.data, start, *noise, steps=most)


def _starts(candidate: Candidate, true: Mapping[str, float], command: float) -> list[dict[str, float]]:
    open_ = [p for p in candidate.parameters if p.starts and p.name not in true]
    grids = [[s * command if p.unit == "command" else s for s in p.starts] for p in open_]
    return [dict(zip((p.name for p in open_), point, strict=True)) for point in product(*grids)]


def _scale(fit: WeakFit) -> float:
    """Typical large command."""
    pieces = [np.abs(s.u).ravel() for s in fit.data.segments if s.u.size]
    return float(np.quantile(np.concatenate(pieces), 0.9)) if pieces else 1.0
