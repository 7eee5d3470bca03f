"""Trying one candidate: screen it, fit it, keep the parameters that matter, score it."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import lsq_linear
from scipy.stats import chi2

from undertow.identification.estimation.data import WeakData, inverse_of
from undertow.identification.estimation.fitted import BETWEEN_RUNS, least_differing, may_differ
from undertow.identification.estimation.residual import (
    Linearised,
    WeakModel,
    base_name,
    origins,
    whitened,
    with_values_by_run,
)
from undertow.identification.estimation.step import (
    bounded_step,
    bounds_of,
    search_prior,
    step_limits,
    within_limits,
)
from undertow.identification.estimation.test_functions import Whitening
from undertow.identification.estimation.weak_form import (
    WeakFit,
    fit_under_noise,
    predicted_cost,
    refitted,
    split_between_runs,
    with_reestimated_noise,
)
from undertow.typing import Array

from .bench import Bench, Score
from .candidates import Candidate


@dataclass(frozen=True)
class Trial:
    """A candidate after its fit.

    candidate: what was tried.
    full: the fit with all its parameters.
    fit: the fit with those that matter.
    kept: those parameters.
    score: how `fit` does on the validation data.
    """

    candidate: Candidate
    full: WeakFit
    fit: WeakFit
    kept: tuple[str, ...]
    score: Score

    @property
    def id(self) -> str:
        """Id of the effect."""
        return self.candidate.id

    def with_only(self, kept: Sequence[str], bench: Bench) -> Trial:
        """The same candidate with these of its parameters alone."""
        fit = bench.in_all_runs(_refit(self.candidate, self.full, tuple(kept), bench.settings.rough_step))
        return replace(self, fit=fit, kept=tuple(kept), score=bench.score(fit))

    def with_common_values(self, bench: Bench) -> Trial | None:
        """The same parameters with one value for all runs; None if none of them has one for each."""
        names, free = {p.name for p in self.candidate.parameters}, self.fit.model.free
        if not names & {*self.fit.model.values.by_run}:
            return None
        common = tuple(dict.fromkeys(base_name(n) if base_name(n) in names else n for n in free))
        fit = bench.fit(self.candidate.model(common), start=self.fit.values)
        return replace(self, fit=fit, score=bench.score(fit))


def try_candidate(
    candidate: Candidate, bench: Bench, start: Mapping[str, float], tolerance: float | None = None
) -> Trial:
    """Fit a candidate, drop the parameters that do not matter, and score it."""
    settings = bench.settings
    tolerance = settings.rough_step if tolerance is None else tolerance
    fit = bench.fit(candidate.model_from(start), start=start, tolerance=tolerance)
    if not np.isfinite(fit.cost):
        return rejected(candidate, bench)
    # If a candidate explains much, the noise model of the incomplete model is too coarse for the standard
    # errors of its parameters.
    if fit.cost < settings.finer_noise_share * len(fit.at.r):
        fit = with_reestimated_noise(fit, most=1)
    fit = _by_run_if_significant(candidate, fit, bench, tolerance)
    significant = significant_parameters(fit, candidate.removable, settings.t_in_search)
    # A parameter that differs significantly between runs is not zero in all of them.
    dropped = {*candidate.removable} - {*significant, *fit.model.values.by_run}
    kept = tuple(n for n in candidate.sizes if n not in dropped)
    if kept and not candidate.made_up_by(kept):
        return rejected(candidate, bench)
    reduced = _refit(candidate, fit, kept, tolerance) if dropped else fit
    return Trial(candidate, fit, reduced, kept, bench.score(reduced))


def _by_run_if_significant(candidate: Candidate, fit: WeakFit, bench: Bench, tolerance: float) -> WeakFit:
    """The fit with values by run for the parameters that differ significantly between runs, and no others."""
    own = [p.name for p in candidate.parameters]
    split = [n for n in own if n in fit.model.values.by_run]
    if split:
        values = fit.p[list(fit.model.places)]
        if least_differing(fit.model, values, fit.covariance, [split])[1] < BETWEEN_RUNS.chance:
            return bench.in_all_runs(with_reestimated_noise(fit))
        fit = bench.fit(candidate.model(), start=fit.values, tolerance=tolerance)
    return bench.in_all_runs(split_between_runs(fit, own))


def without_redundant(candidate: Candidate, bench: Bench) -> Candidate:
    """The candidate without terms that the model's own parameters reproduce exactly and that are no evidence
    of it: a term proportional to the command is thrust per command, if that is estimated.
    """
    parts = [i for i, p in enumerate(candidate.parameters) if not p.alone]
    if not parts:
        return candidate
    own = _candidate_columns(candidate, bench, {}).J[:, parts]
    J = bench.base.at.J
    rest = own - J @ np.linalg.lstsq(J, own, rcond=None)[0]
    redundant = np.linalg.norm(rest, axis=0) <= _REDUNDANT * np.linalg.norm(own, axis=0)
    names = [candidate.parameters[i].name for i, drop in zip(parts, redundant, strict=True) if drop]
    return replace(candidate, redundant=(*candidate.redundant, *names))


def rejected(candidate: Candidate, bench: Bench) -> Trial:
    """A candidate none of whose parameters matters: the model remains unchanged."""
    return Trial(candidate, bench.base, bench.base, (), bench.base_score)


def _refit(candidate: Candidate, fit: WeakFit, kept: tuple[str, ...], tolerance: float) -> WeakFit:
    dropped = set(candidate.removable) - set(kept)
    dropped |= _ineffective(candidate, fit, dropped)
    # A dropped parameter returns to its value in the vehicle of the candidate: zero, or its default.
    start = {n: v for n, v in fit.values.items() if n not in dropped}
    free = tuple(n for n in fit.model.free if n not in dropped)
    model = candidate.model(free).with_known_values(fit.model.values.known)
    return refitted(fit, model, start, tolerance=tolerance)


def _ineffective(candidate: Candidate, fit: WeakFit, dropped: Collection[str]) -> set[str]:
    """Shape parameters without influence once others are dropped: the width of a friction that is absent.

    A vehicle file need not state them then, unless the equations need a value: no time constant is zero.
    """
    searched = [p for p in candidate.parameters if p.starts]
    shapes = {p.name for p in searched if p.bounds[0] <= p.effective_default <= p.bounds[1]}
    if not shapes:
        return set()
    without, places = fit.p.copy(), fit.model.functions.parameter_names.index
    without[[places(n) for n in dropped]] = 0.0
    used = np.any([np.any(part.J, axis=0) for part in fit.model.linearise(fit.data, without)], axis=0)
    lost = np.any(fit.at.J, axis=0) & ~used
    return {n for n, idle in zip(fit.model.free, lost, strict=True) if n in shapes and idle}


def significant_parameters(fit: WeakFit, removable: tuple[str, ...], least_t: float) -> tuple[str, ...]:
    """Backward elimination on the quadratic model of the fit, with errors robust to autocorrelation.

    Others may compensate for a dropped one within their bounds: if only the ratio of stiffness and inertia is
    identifiable, no negative inertia replaces a stiffness. This simplifies an effect; the validation data
    decide whether it is needed at all, so one parameter stays.
    """
    names, bounds = list(fit.model.free), np.array(bounds_of(fit.model))
    information = fit.information
    inflation = np.sqrt(np.diag(fit.covariance) / np.diag(inverse_of(information)))
    active = list(range(len(names)))
    estimate = np.array([fit.values[n] for n in names])
    while True:
        remaining = information[np.ix_(active, active)]
        open_to_drop = [i for i, k in enumerate(active) if names[k] in removable]
        without = [_minimum_without(i, estimate[active], remaining, bounds[:, active]) for i in open_to_drop]
        t = [np.sqrt(w.rise) / inflation[active[i]] for i, w in zip(open_to_drop, without, strict=True)]
        if len(open_to_drop) < 2 or min(t) >= least_t:
            return tuple(names[k] for k in active if names[k] in removable)
        weakest = int(np.argmin(t))
        estimate[active] = without[weakest].values
        active.pop(open_to_drop[weakest])


class _ConstrainedMinimum(NamedTuple):
    """The minimum of a quadratic cost with one parameter zero, and how much higher it is."""

    values: Array
    rise: float


def _minimum_without(i: int, estimate: Array, information: Array, bounds: Array) -> _ConstrainedMinimum:
    """Parameters with the i-th zero and the others within bounds (rows: lower, upper)."""
    others = np.arange(len(estimate)) != i
    covariance = inverse_of(information)
    values = estimate - covariance[:, i] * estimate[i] / covariance[i, i]
    low, high = np.minimum(bounds[0], estimate), np.maximum(bounds[1], estimate)
    if np.all((values >= low) & (values <= high) | ~others):
        return _ConstrainedMinimum(values, float(estimate[i] ** 2 / covariance[i, i]))
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    scaled = information * np.outer(scale, scale) + 1e-11 * np.eye(len(scale))
    factor = np.linalg.cholesky(scaled).T / scale
    within = (low[others] - 1e-12, high[others] + 1e-12)
    found = lsq_linear(factor[:, others], factor @ estimate, bounds=within, method="bvls")
    values[others], values[i] = found.x, 0.0
    return _ConstrainedMinimum(values, 2.0 * float(found.cost))


# Relative norm of the residual of a column, regressed on the model, up to which it is redundant.
_REDUNDANT = 1e-6


class Screened:
    """A candidate at one start, and the improvement predicted by one Gauss-Newton step.

    start: the model at the start, not fitted.
    cost: sum of squares after the step.
    values: free parameters at the start of a fit: after the step from a given start, without it if steps were
    taken before, since a predicted improvement may not materialise.
    """

    def __init__(
        self, candidate: Candidate, bench: Bench, start: Mapping[str, float], steps: int = 0
    ) -> None:
        self._candidate, self._bench = candidate, bench
        model = candidate.model_from(start)
        noise, tolerance = (bench.train_whitening, bench.base.disturbance), bench.settings.first_step
        begin = bench.base.values | dict(start)
        self.start = fit_under_noise(model, bench.train, begin, *noise, steps=steps, tolerance=tolerance)
        self.cost, after = predicted_cost(self.start)
        if names := _better_by_run(self.start.model, self.start.at, self.cost, candidate, bench.train):
            free = with_values_by_run(self.start.model.free, names, candidate.runs)
            split = self.start.model.with_free(free)
            self.start = fit_under_noise(
                split, bench.train, self.start.values, *noise, steps=steps, tolerance=tolerance
            )
            self.cost, after = predicted_cost(self.start)
        own = [n for n in self.start.model.values.by_run if n not in bench.base.model.values.by_run]
        self.cost += _chance_fall(own, candidate.runs)
        self.values = self.start.values if steps else after

    def after_steps(self) -> Screened:
        """The same after some further steps."""
        return Screened(self._candidate, self._bench, self.values, self._bench.settings.steps_per_start)


def _better_by_run(
    model: WeakModel, at: Linearised, cost: float, candidate: Candidate, data: WeakData
) -> list[str]:
    """Parameters of a candidate whose values by run promise a significant improvement; or none."""
    own = [p.name for p in candidate.parameters]
    names = [n for group in may_differ(model, data.runs, own) for n in group]
    return names if names and _cost_by_run(model, at, names, data) < cost else []


def _cost_by_run(model: WeakModel, at: Linearised, names: Sequence[str], data: WeakData) -> float:
    """Predicted sum of squares if some parameters have a value in every run, and its fall by chance."""
    runs = origins(data.runs)
    place = np.array([runs.index(r.origin) for r in data.runs])[data.run_of]
    chosen = [k for k, n in enumerate(model.free) if n in names]
    split = [at.J[:, chosen] * (place == i)[:, None] for i in range(len(runs))]
    J = np.hstack([np.delete(at.J, chosen, axis=1), *split])
    slope = J.T @ at.r
    return float(at.r @ at.r - slope @ inverse_of(J.T @ J) @ slope) + _chance_fall(names, runs)


def _chance_fall(names: Sequence[str], runs: Sequence[str]) -> float:
    """Largest fall of the sum of squares by chance for values by run if the runs agree."""
    return float(chi2.isf(BETWEEN_RUNS.chance, len(names) * (len(runs) - 1))) if names else 0.0


@np.errstate(over="ignore", invalid="ignore")
def screen(candidate: Candidate, bench: Bench) -> list[Screened]:
    """Predicted improvement by a candidate from its best start, and from the next best ones if there are
    several.

    A start with a non-vanishing effect is worse than the model as given until a few steps are taken. If the
    refit of the model as given moved far from the stated values, these are a start as well. Starts from which
    states grow without bound are excluded, such as a lag far shorter than the sampling interval.
    """
    starts = candidate.starts(bench.command_scale, bench.observed_ranges)
    if len(starts) > bench.settings.fitted_starts:
        starts = _best_starts(candidate, bench, starts)
    if bench.stated_start:
        starts = [*starts, *(bench.stated_start | start for start in starts)]
    screened = (Screened(candidate, bench, start) for start in starts)
    found = sorted((s for s in screened if np.isfinite(s.cost)), key=lambda s: s.cost)
    if len(found) < 2:
        return found
    # A predicted improvement may not materialise: the costs after some steps are compared.
    after_steps = [s.after_steps() for s in found]
    bounded = [s for s in after_steps if np.isfinite(s.cost)]
    return sorted(bounded or found, key=lambda s: s.start.cost)


def best_start(
    candidate: Candidate, bench: Bench, starts: Sequence[dict[str, float]], tolerance: float = 0.0
) -> dict[str, float]:
    """The best of several fits: a few steps do not show which start leads to the lowest minimum."""
    if len(starts) == 1:
        return starts[0]
    fits = [bench.fit(candidate.model_from(start), start=start, tolerance=tolerance) for start in starts]
    return min(fits, key=lambda fit: fit.cost if np.isfinite(fit.cost) else np.inf).values


def _candidate_columns(candidate: Candidate, bench: Bench, start: Mapping[str, float]) -> Linearised:
    """The model with a candidate at a start, linearised in the candidate's own parameters only."""
    base = bench.base.model.values
    by_run = {n: bench.base.values[n] for n in base.split} | base.known
    model = candidate.model(tuple(p.name for p in candidate.parameters)).with_known_values(by_run)
    names = model.functions.parameter_names
    stated = {n: model.functions.vehicle.value_of(n).value for n in names}
    values = stated | bench.base.values | dict(start)
    parts = model.linearise(bench.train, np.array([values[n] for n in names]))
    return whitened(parts, bench.train_whitening)


def _best_starts(
    candidate: Candidate, bench: Bench, starts: Sequence[dict[str, float]]
) -> list[dict[str, float]]:
    """The best of many starts, by the candidate's columns together with those of the model as given.

    Parameters stay within their bounds: a negative mass may promise an impossible improvement.
    """
    model = candidate.model()
    bounds, prior, reach = bounds_of(model), search_prior(model), step_limits(model)
    costs = []
    for start in starts:
        at = _candidate_columns(candidate, bench, start)
        joint = Linearised(at.r, np.hstack([bench.base.at.J, at.J]), at.start)
        values = bench.base.values | start
        stated = model.functions.vehicle.value_of
        now = np.array([values[n] if n in values else stated(base_name(n)).value for n in model.free])
        step = bounded_step(joint, now, within_limits(bounds, now, reach), prior)
        cost = float(np.sum((joint.r + joint.J @ step) ** 2))
        names = _better_by_run(model, joint, cost, candidate, bench.train)
        costs.append(_cost_by_run(model, joint, names, bench.train) if names else cost)
    return [starts[i] for i in np.argsort(costs)[: bench.settings.fitted_starts]]


@dataclass(frozen=True)
class _PackedFit:
    """A fit without its model; no whitening if it is that of the bench."""

    free: tuple[str, ...]
    known: dict[str, float]
    p: Array
    whitening: list[Whitening] | None
    at: Linearised
    disturbance: Array
    iterations: int


@dataclass(frozen=True)
class PackedTrial:
    """A trial without its models; no fits if it was rejected, one if no parameter was dropped."""

    full: _PackedFit | None
    fit: _PackedFit | None
    kept: tuple[str, ...]
    score: Score


def packed(trial: Trial, bench: Bench) -> PackedTrial:
    """The trial as plain data."""
    if trial.full is bench.base:
        return PackedTrial(None, None, trial.kept, trial.score)
    reduced = None if trial.fit is trial.full else _packed_fit(trial.fit, bench)
    return PackedTrial(_packed_fit(trial.full, bench), reduced, trial.kept, trial.score)


def _packed_fit(fit: WeakFit, bench: Bench) -> _PackedFit:
    whitening = None if fit.whitening is bench.train_whitening else fit.whitening
    known = fit.model.values.known
    return _PackedFit(fit.model.free, known, fit.p, whitening, fit.at, fit.disturbance, fit.iterations)


def unpacked(found: PackedTrial, candidate: Candidate, bench: Bench) -> Trial:
    """The trial of a candidate from plain data."""
    full = bench.base if found.full is None else _unpacked_fit(found.full, candidate, bench)
    fit = full if found.fit is None else _unpacked_fit(found.fit, candidate, bench)
    return Trial(candidate, full, fit, found.kept, found.score)


def _unpacked_fit(fit: _PackedFit, candidate: Candidate, bench: Bench) -> WeakFit:
    whitening = bench.train_whitening if fit.whitening is None else fit.whitening
    model = candidate.model(fit.free).with_known_values(fit.known)
    return WeakFit(model, fit.p, bench.train, whitening, fit.at, fit.disturbance, fit.iterations)
