"""Adding effects to a model: the refit, and the error on validation data before and after."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from undertow.codegen.functions import Functions
from undertow.errors import UndertowError
from undertow.identification.diagnosis.bench import Bench, error_of, open_bench
from undertow.identification.diagnosis.candidates import Candidate, possible_in
from undertow.identification.diagnosis.evidence import Comparison, compare_scores
from undertow.identification.diagnosis.result import Step
from undertow.identification.diagnosis.trial import Trial, try_candidate
from undertow.identification.estimation.data import WeakData, prepare
from undertow.identification.estimation.fitted import Fitted
from undertow.identification.estimation.output_error import NO_WORSE, horizon_error
from undertow.identification.estimation.residual import WeakModel, base_name, origins, whitened
from undertow.identification.estimation.test_functions import Whitening
from undertow.identification.estimation.weak_form import WeakFit, mean_square
from undertow.identification.logs.run import Run
from undertow.model.catalogue import Catalogue
from undertow.model.effect import Effect
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .search import last_fit
from .settings import DEFAULT
from .splitting import Runs, normalised, training_and_validation
from .trial import best_start, screen, without_redundant
from .validation import SimulationValidator


@dataclass(frozen=True)
class AdditionSetup:
    """Training and validation logs, and the model as given, fitted to them.

    vehicle: the model as it was given.
    train, test: the logs.
    bench: data, noise and the fitted model without the effect.
    validator: simulates them.
    """

    vehicle: Vehicle
    train: list[Run]
    test: list[Run]
    bench: Bench
    validator: SimulationValidator


@dataclass(frozen=True)
class Addition:
    """Effects that were added to a model.

    effects: their ids.
    fit: the fit of the model with them.
    kept, dropped: their parameters that are in the model now, and those that turned out to be zero.
    given, before, after: error on validation data (1 = sensor noise) and prediction ahead, of the model as
    given, refitted without the effects, and refitted with them.
    evidence: how strongly the validation data support the effects.
    ahead: error of predicted velocities over the vehicle's horizons without and with them, as shares.
    """

    effects: tuple[str, ...]
    fit: Fitted
    kept: tuple[str, ...]
    dropped: tuple[str, ...]
    given: Step
    before: Step
    after: Step
    evidence: Comparison
    ahead: tuple[float, float]

    @property
    def steps(self) -> list[Step]:
        """The three models in their order."""
        return [self.given, self.before, self.after]

    @property
    def helps(self) -> bool:
        """Whether the force on validation data is explained significantly better and the motion no worse, or
        the motion is predicted better by enough to matter.
        """
        before, after = self.ahead
        explains = self.evidence.beyond_chance(DEFAULT) and self.after.error < self.before.error
        return after < (1.0 + NO_WORSE if explains else 1.0 - DEFAULT.worth) * before


def set_up_addition(
    vehicle: Vehicle, runs: Runs, validation: Runs = (), *, trust_log: bool = False
) -> AdditionSetup:
    """Fit a model as given, and prepare to evaluate effects added to it."""
    vehicle, runs, validation = normalised(vehicle, runs, validation)
    train_runs, test_runs = training_and_validation(vehicle, runs, validation, trust_log=trust_log)
    train = prepare(train_runs, vehicle)
    test = prepare(test_runs, vehicle, sigma=train.sigma)
    bench = open_bench(vehicle, train, test)
    validator = SimulationValidator(vehicle, train_runs, test_runs, train.sigma)
    return AdditionSetup(vehicle, train_runs, test_runs, bench, validator)


@np.errstate(over="ignore", invalid="ignore")  # unbounded states are rejected by their cost
def add_effects(effects: Sequence[type[Effect]], setup: AdditionSetup, *, keep_all: bool = False) -> Addition:
    """Add effects to the model one by one, refit it each time, and evaluate it on validation data.

    keep_all: whether parameters that turn out to be zero are kept.
    """
    bench, added = setup.bench, list[_Added]()
    for effect in effects:
        bench = added[-1].bench_with_it if added else bench
        added.append(_added(effect, bench, keep_all))
    last, candidates = added[-1], [one.candidate for one in added]
    # Models without and with the effects are evaluated under the noise model of the better fit.
    refined = last.bench if len(added) == 1 else setup.bench.with_noise_model_of(last.full)
    return _evaluated(setup, refined, candidates, [last_fit(last.fit, candidates), last.fit])


@dataclass(frozen=True)
class _Added:
    """An effect that was added to the base of a bench.

    full, fit: the fits with all of its parameters and with those that matter.
    bench: that to which it was added, under the noise model of the full fit.
    """

    candidate: Candidate
    full: WeakFit
    fit: WeakFit
    bench: Bench

    @property
    def bench_with_it(self) -> Bench:
        """The bench whose base has the effect."""
        return self.bench.with_model(self.candidate.vehicle_with(self.fit.values), self.fit.values)


def _added(effect: type[Effect], bench: Bench, keep_all: bool) -> _Added:
    """Fit the model with one more effect."""
    base = bench.base.model.functions.vehicle
    candidate = replace(_candidate(effect, base), runs=origins(bench.train.runs))
    candidate = without_redundant(candidate, bench)
    screened = screen(candidate, bench)
    if not _visible(candidate, screened[0].start):
        raise UndertowError(
            f"effect '{effect.id}' has no influence on '{base.name}' in these logs: its parameters cannot be "
            "estimated"
        )
    start = best_start(candidate, bench, [s.values for s in screened])
    first = _fit_candidate(candidate, bench, start, keep_all)
    if candidate.sizes and not first.kept:
        # No parameter differs significantly from zero: the validation data decide, with all of them.
        keep_all, first = True, _fit_with_all_parameters(candidate, bench, start)
    refined = bench.with_noise_model_of(first.full)
    found = _fit_candidate(candidate, refined, first.fit.values, keep_all).fit
    return _Added(candidate, first.full, found, refined)


def _candidate(effect: type[Effect], vehicle: Vehicle) -> Candidate:
    lacking = vehicle.lacks(effect)
    if effect.built_in:
        raise UndertowError(f"effect '{effect.id}' is part of every vehicle: there is nothing to add")
    if lacking:
        needed = " and ".join(lacking)
        raise UndertowError(f"effect '{effect.id}' needs {needed} in the vehicle file: add that first")
    candidate = Candidate(effect, vehicle)
    if candidate.adds_nothing:
        raise UndertowError(
            f"effect '{effect.id}' adds nothing to '{vehicle.name}': all that can act in its degrees of "
            "freedom is already in the vehicle file"
        )
    return candidate


def visible_effects(setup: AdditionSetup, known: Catalogue) -> list[type[Effect]]:
    """Effects that could be added to the model and could be identified from these logs."""
    bench = setup.bench
    possible = possible_in(bench.train, bench.base.model.functions.vehicle, known)
    return [c.effect for c in possible if not c.adds_nothing and _visible(c, screen(c, bench)[0].start)]


def _visible(candidate: Candidate, start: WeakFit) -> bool:
    """Whether its parameters have any influence: a command delay has none on a vehicle without commands."""
    used = {base_name(n) for n, own in zip(start.model.free, np.diag(start.gram), strict=True) if own > 0.0}
    return not candidate.parameters or any(p.name in used for p in candidate.parameters)


def _fit_candidate(candidate: Candidate, bench: Bench, start: dict[str, float], keep_all: bool) -> Trial:
    return (_fit_with_all_parameters if keep_all else try_candidate)(candidate, bench, start)


def _fit_with_all_parameters(candidate: Candidate, bench: Bench, start: dict[str, float]) -> Trial:
    """The candidate with all of its parameters."""
    fit = bench.fit(candidate.model_from(start), start=start)
    return Trial(candidate, fit, fit, candidate.sizes, bench.score(fit))


def _evaluated(
    setup: AdditionSetup, bench: Bench, candidates: Sequence[Candidate], fits: Sequence[WeakFit]
) -> Addition:
    # The final fit of `fit`, from the same start: both commands give the same model.
    weak, fit, with_it = best_predicting(setup, fits)
    base = setup.validator.final(setup.bench.base)
    without = float(horizon_error([base], setup.test)[0])
    own = tuple(p.name for candidate in candidates for p in candidate.parameters)
    effects = tuple(candidate.id for candidate in candidates)
    kept = tuple(n for n in own if n in fit.model.values.names)
    noise = fit.model.whitening(bench.test, np.asarray(fit.p))
    return Addition(
        effects,
        fit,
        kept,
        tuple(n for n in own if n not in kept),
        _step(setup, [], setup.vehicle, noise),
        _step(setup, [], base, noise),
        _step(setup, [*effects], fit, noise),
        compare_scores(bench.base_score, bench.score(weak), bench.test),
        (without, with_it),
    )


def best_predicting(setup: AdditionSetup, fits: Sequence[WeakFit]) -> tuple[WeakFit, Fitted, float]:
    """The first of these fits whose final fit predicts no worse than the best, with that and its error.

    They differ in the parameters of the effect that are left out. One that is significant in the force may
    make predictions worse if something else is missing as well.
    """
    different = [f for i, f in enumerate(fits) if f.model.free not in [g.model.free for g in fits[:i]]]
    finals = [setup.validator.final(f) for f in different]
    errors = [float(horizon_error([f], setup.test)[0]) for f in finals]
    limit = (1.0 + NO_WORSE) * min(errors)
    return next(found for found in zip(different, finals, errors, strict=True) if found[2] <= limit)


def _step(setup: AdditionSetup, added: list[str], model: Fitted | Vehicle, noise: list[Whitening]) -> Step:
    """Errors of a model on the validation data; `noise` is that of the channels alone."""
    return setup.validator.step(added, model, _force_error(model, setup.bench.test, noise))


def force_errors(
    models: Sequence[Fitted | Vehicle], runs: Sequence[Run], vehicle: Vehicle, sigma: Array
) -> list[float]:
    """Force errors of several models on the same runs, relative to the noise of the last one.

    sigma: (2n,), noise of the channels of `vehicle`.
    """
    data = prepare(runs, vehicle, sigma=sigma)
    weak, p = _weak(models[-1])
    noise = weak.whitening(data, p)
    return [_force_error(model, data, noise) for model in models]


def _force_error(model: Fitted | Vehicle, data: WeakData, noise: list[Whitening]) -> float:
    weak, p = _weak(model)
    return error_of(mean_square(whitened(weak.linearise(data, p), noise).r, data))


def _weak(model: Fitted | Vehicle) -> tuple[WeakModel, Array]:
    if isinstance(model, Vehicle):
        functions = Functions(model)
        return WeakModel(functions, ()), np.array(functions.values(), dtype=float)
    return model.model, np.asarray(model.p)
