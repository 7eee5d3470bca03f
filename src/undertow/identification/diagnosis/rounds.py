"""One step of the search: all candidates, then the leading ones; and other values of fixed parameters."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from undertow.identification.estimation.data import inverse_of
from undertow.identification.estimation.residual import Linearised, WeakModel, whitened
from undertow.identification.estimation.step import PRIOR_WIDTH, normal_equations, prior_cost, prior_of
from undertow.identification.estimation.weak_form import WeakFit
from undertow.model.catalogue import Catalogue
from undertow.typing import Array, Progress

from .bench import Bench, Score, comparable_mean_squares
from .candidates import Candidate, possible_in
from .evidence import (
    Comparison,
    FoundEffect,
    IsNoise,
    Linearisation,
    NullDistributions,
    as_good,
    block_length_factor,
    compare_scores,
    explained,
    inclusion,
    linearised,
    rank_p_value,
    with_longer_blocks,
)
from .parallel import mapped
from .settings import DEFAULT, Settings
from .trial import (
    PackedTrial,
    Screened,
    Trial,
    best_start,
    packed,
    rejected,
    screen,
    try_candidate,
    unpacked,
    without_redundant,
)

_log = logging.getLogger("undertow.diagnosis")


@dataclass(frozen=True)
class Round:
    """One step of the search: the model so far and how every candidate would improve it.

    bench: data, noise model and the model so far.
    findings: all candidates, best first.
    """

    bench: Bench
    findings: list[FoundEffect]

    @property
    def winner(self) -> FoundEffect | None:
        """The best candidate, if the evidence for it is strong enough."""
        best = self.findings[0] if self.findings else None
        if best is None or not best.significant or best.may_be_slow_disturbance(self.bench.settings):
            return None
        return best


@np.errstate(over="ignore", invalid="ignore")  # unbounded states are rejected by their cost
def try_all(bench: Bench, known: Catalogue, report: Progress) -> Round:
    """Try every candidate in addition to a model."""
    vehicle, settings = bench.base.model.functions.vehicle, bench.settings
    candidates = [without_redundant(c, bench) for c in possible_in(bench.train, vehicle, known)]
    screened = _screened(candidates, bench, report)
    _log.info("error so far %.3f; %d effects tried", bench.base_score.error, len(screened))
    chance = NullDistributions([s.linear for s in screened], bench)
    promising = _promising(screened, bench)
    trials = _fit_candidates(promising, bench, report)
    falls = {c.id: _relative_fall(bench.base_score, t.score) for c, t in trials}
    trials_with_effect = [unpacked(t, c, bench) for c, t in trials if t.kept or not c.sizes]
    trials_with_effect.sort(key=lambda trial: trial.score.error)
    bench, finalists = _rescore_finalists(bench, trials_with_effect[: settings.finalists], report)
    outranked = [replace(t, score=bench.score(t.fit)) for t in trials_with_effect[settings.finalists :]]
    tried = {t.id for t in trials_with_effect}
    others = [rejected(s.candidate, bench) for s in screened if s.candidate.id not in tried]
    fits = [*finalists, *outranked]
    residual = bench.on_train(fits[0].fit).r if fits else bench.base.at.r
    return _ranked(bench, fits, others, _Evidence(falls, chance, residual, len(fits) + len(others)))


def _relative_fall(before: Score, after: Score) -> float:
    return 1.0 - float(np.mean(after.r**2) / max(float(np.mean(before.r**2)), 1e-300))


class _Screening(NamedTuple):
    candidate: Candidate
    cost: float
    starts: list[dict[str, float]]
    linear: Linearisation


def _screened(candidates: Sequence[Candidate], bench: Bench, report: Progress) -> list[_Screening]:
    """Predicted improvement of every candidate with parameters to add, the most promising first."""
    bench.precompute()
    # Candidates with shape parameters take longest: started first, they leave no core idle at the end.
    candidates = sorted(candidates, key=lambda c: not any(p.starts for p in c.effect(()).parameters))
    found = []
    for i, entry in enumerate(mapped(lambda i: _screen_candidate(candidates[i], bench), len(candidates))):
        report(0.5 * (i + 1) / len(candidates), f"tried {candidates[i].id}")
        if entry is not None:
            found.append(_Screening(candidates[i], *entry))
    return sorted(found, key=lambda entry: entry.cost)


def _promising(screened: Sequence[_Screening], bench: Bench) -> list[_Screening]:
    """The candidates to be fitted, from a list ordered by predicted improvement."""
    settings = bench.settings
    falls = [bench.base.cost - s.cost for s in screened]
    least = settings.predicted_fall_share * max(falls, default=0.0)
    count = max(settings.full_fits, min(settings.most_fits, sum(fall > least for fall in falls)))
    return [
        s for s, fall in zip(screened[:count], falls, strict=False) if fall > settings.least_predicted_fall
    ]


def _fit_candidates(
    promising: Sequence[_Screening], bench: Bench, report: Progress
) -> list[tuple[Candidate, PackedTrial]]:
    """Fits of the promising candidates."""

    tolerance = bench.settings.first_step

    def fit_candidate(i: int) -> PackedTrial:
        candidate = promising[i].candidate
        start = best_start(candidate, bench, promising[i].starts, tolerance)
        return packed(try_candidate(candidate, bench, start, tolerance), bench)

    found = []
    for i, trial in enumerate(mapped(fit_candidate, len(promising))):
        report(0.5 + 0.3 * (i + 1) / len(promising), f"fitted {promising[i].candidate.id}")
        found.append((promising[i].candidate, trial))
    return found


def _screen_candidate(
    candidate: Candidate, bench: Bench
) -> tuple[float, list[dict[str, float]], Linearisation] | None:
    if candidate.adds_nothing:
        return None
    screened = screen(candidate, bench)
    if not screened:
        return None
    return screened[0].cost, [s.values for s in screened], linearised(screened[0].start, bench)


def _rescore_finalists(bench: Bench, finalists: list[Trial], report: Progress) -> tuple[Bench, list[Trial]]:
    """Score the leading candidates again, with the noise model of the best of them.

    Under the noise model of a poor fit a mediocre candidate may lead; under its own noise model less is
    hidden, and the new leader sets the next noise model.
    """
    if not finalists or finalists[0].score.error >= bench.base_score.error:
        return bench, finalists
    for _ in range(bench.settings.leader_rounds):
        leader = finalists[0]
        # With all its parameters: what a dropped one would explain must not count as noise here.
        bench = bench.with_noise_model_of(leader.full)
        _log.info("under the noise model of %s: error so far %.3f", leader.id, bench.base_score.error)
        retried = _retry_all(finalists, bench, leader, report)
        finalists = sorted(retried, key=lambda t: t.score.error)
        if finalists[0].id == leader.id:
            break
    return bench, finalists


def _retry_all(finalists: list[Trial], refined: Bench, best: Trial, report: Progress) -> list[Trial]:
    work = mapped(lambda i: packed(_retry(finalists[i], refined, best), refined), len(finalists))
    retried = []
    for i, (trial, found) in enumerate(zip(finalists, work, strict=True)):
        report(0.8 + 0.2 * (i + 1) / len(finalists), f"judged {trial.id}")
        retried.append(unpacked(found, trial.candidate, refined))
    return retried


def _retry(trial: Trial, refined: Bench, best: Trial) -> Trial:
    """A trial under the finer noise model; candidates far behind with all their parameters are not fitted
    again.

    Parameters hidden by the coarser noise model were dropped from an effect, and may be decisive.
    """
    if trial is not best and _remains_far_behind(trial, refined, best):
        return replace(trial, score=refined.score(trial.fit))
    return try_candidate(trial.candidate, refined, trial.full.values)


def _remains_far_behind(trial: Trial, refined: Bench, best: Trial) -> bool:
    """Whether an effect is far behind the best one, and a further step of the fit would not change that.

    A rough fit under a coarse noise model may end many standard errors of the finer one from its optimum: a
    step brings it there.
    """
    mean_square, least = (float(np.mean(refined.score(t.full).r ** 2)) for t in (trial, best))

    def after_a_step() -> float:
        return Screened(trial.candidate, refined, trial.full.values).cost / len(refined.base.at.r)

    return far_behind(mean_square, least, after_a_step, refined.settings)


def far_behind(
    mean_square: float, least: float, after_a_step: Callable[[], float], settings: Settings = DEFAULT
) -> bool:
    """Whether a mean square is far above the least one, and remains so after a further step of the fit."""
    limit = settings.refit_limit
    return mean_square > limit * least and after_a_step() > limit * max(least, 1.0)


class _Evidence(NamedTuple):
    """Error reductions of candidates, their null distribution, the residual of the best one, (m,), and their
    number.
    """

    falls: dict[str, float]
    chance: NullDistributions
    residual: Array
    candidates: int


def _ranked(bench: Bench, tried: list[Trial], others: list[Trial], evidence: _Evidence) -> Round:
    linears = [linearised(t.fit, bench) for t in tried]
    inclusions = inclusion(linears, bench.settings).tolist()
    findings = [_finding(*found, bench, evidence) for found in zip(tried, linears, inclusions, strict=True)]
    findings += [_finding(t, None, float("nan"), bench, evidence) for t in others]
    findings.sort(key=lambda f: (not f.significant, f.trial.score.error))
    for f in findings[:5]:
        _log.info(
            "%s: normalised error %.3f, p = %.2g (slow disturbance: %.2g), best in %.0f %% of resamples",
            f.id, f.trial.score.error, f.p_value, f.slow_p_value, 100 * f.inclusion,
        )  # fmt: skip
    return Round(bench, findings)


def _finding(
    trial: Trial, at: Linearisation | None, inclusion: float, bench: Bench, evidence: _Evidence
) -> FoundEffect:
    """A candidate with the evidence for it; without a linearisation one that was not worth a fit."""
    settings = bench.settings
    compared = compare_scores(bench.base_score, trial.score, bench.test)
    chance, slow = (1.0, 1.0) if at is None else _chances(trial, at, compared, bench, evidence)
    significant = chance < settings.false_alarm_rate and compared.mean > settings.least_fall
    scores = comparable_mean_squares(bench.base_score, trial.score, bench.test)
    share = explained(*scores, bench.noise_level, settings)
    better = trial.score.error < bench.base_score.error
    return FoundEffect(trial, compared, share, chance, significant and better, slow, inclusion)


def _chances(
    trial: Trial, at: Linearisation, compared: Comparison, bench: Bench, evidence: _Evidence
) -> tuple[float, float]:
    """Probability that the best of all candidates does as well as this one if nothing is missing; and the
    same under a slow disturbance.

    The bootstrap weights blocks by their error reduction, the rank test counts them: each may detect what the
    other misses, and each gets half of the false alarms. Few of the longer blocks are in the validation data:
    all are compared, each with models that were fitted to the others.

    compared: the candidate and the model without it over the usual blocks.
    """
    if trial.id not in evidence.falls:
        return 1.0, 1.0

    def chance(by_rank: float, times: int) -> float:
        by_draws = evidence.chance.p_value(evidence.falls[trial.id], times)
        return min(1.0, 2.0 * min(by_draws, evidence.candidates * by_rank))

    usual, longer = chance(compared.p_value, 1), block_length_factor(trial, evidence.residual, bench)
    if longer == 1:
        return usual, usual
    return usual, chance(rank_p_value(with_longer_blocks(at, longer, bench).left_out_falls()), longer)


@dataclass(frozen=True)
class OtherValues:
    """The model with some of the values that the vehicle file holds fixed fitted instead.

    alike: names of those values, each with alternatives that would have the same effect.
    fit: the fit with them free.
    score: its score on the validation data.
    """

    alike: dict[str, tuple[str, ...]]
    fit: WeakFit
    score: Score


def values_to_free(current: Round, residual_is_noise: IsNoise) -> dict[str, tuple[str, ...]]:
    """Fixed values whose change explains more than the best effect, or as much with smaller changes
    elsewhere.

    Names of the values, each with alternatives that would have the same effect; empty if an effect, or the
    model as given, is to be preferred.
    """
    bench = current.bench
    if not _fixed(bench) or residual_is_noise(bench.base, bench.test):
        return {}
    found = other_values(bench)
    if found is None or as_good(found.score, bench.base_score, bench):
        return {}
    winner = current.winner
    if winner is not None and not _preferred(
        found, winner.trial.fit, winner.trial.score, bench, residual_is_noise
    ):
        return {}
    return found.alike


def other_values(bench: Bench) -> OtherValues | None:
    """The model with those fixed values free that the data contradict; None if there are none."""
    alike = _values_to_change(bench)
    if not alike:
        return None
    model = bench.base.model.with_free((*bench.base.model.free, *alike))
    fit = bench.fit(model, start=bench.base.values)
    return OtherValues(alike, fit, bench.score(fit))


def _deviance(fit: WeakFit, score: Score) -> float:
    """Twice the negative log-likelihood of the residual, if that is noise, and of the values.

    Stated priors have their full weight here.
    """
    prior_term = PRIOR_WIDTH**2 * prior_cost(prior_of(fit.model), fit.p[list(fit.model.places)])
    return float(np.sum(score.r**2)) + prior_term


def _preferred(
    found: OtherValues, fit: WeakFit, score: Score, bench: Bench, residual_is_noise: IsNoise
) -> bool:
    """Whether other values are the better explanation than an effect."""
    adequate, effect_adequate = (residual_is_noise(found.fit, bench.test), residual_is_noise(fit, bench.test))
    if adequate and effect_adequate:
        return _deviance(found.fit, found.score) + bench.settings.more_than_chance < _deviance(fit, score)
    return adequate or (not effect_adequate and not as_good(found.score, score, bench))


# --- which values ---------------------------------------------------------------------------------
def _fixed(bench: Bench) -> tuple[str, ...]:
    """Fixed values without a corresponding effect: all except those known by design or measured."""
    vehicle = bench.base.model.functions.vehicle
    own = {p.name for e in vehicle.all_effects if not (e.known_by_design or e.built_in) for p in e.parameters}
    return tuple(n for n in _held(bench) if n in vehicle.values and vehicle.declaration(n).name in own)


def _held(bench: Bench) -> tuple[str, ...]:
    """All values in the equations that a fit may not change."""
    model = bench.base.model
    names = model.functions.parameter_names
    vehicle = model.functions.vehicle
    held = (n for n in names if n not in model.values.names and vehicle.parameter_of(n) is not None)
    return tuple(n for n in held if np.isfinite(bench.base.p[names.index(n)]))


def _values_to_change(bench: Bench) -> dict[str, tuple[str, ...]]:
    """Fixed values that reduce the error in the linearised problem, one after the other, each with
    alternatives of the same effect.
    """
    fixed = _fixed(bench)
    if not fixed:
        return {}
    names, count = _held(bench), len(bench.base.model.free)
    gram, slope = _normal_equations(bench, names)
    open_to_change = [count + names.index(n) for n in fixed]
    chosen: list[int] = []
    own = list(range(count))
    while rest := [k for k in open_to_change if k not in chosen]:
        falls = [_fall_of_squares(gram, slope, [*own, *chosen, k]) for k in rest]
        if max(falls) < _fall_of_squares(gram, slope, [*own, *chosen]) + bench.settings.fixed_value_fall:
            break
        chosen.append(rest[int(np.argmax(falls))])
    least = _fall_of_squares(gram, slope, [*own, *chosen]) - bench.settings.more_than_chance

    def does_as_well(k: int, other: int) -> bool:
        columns = [*own, *(c for c in chosen if c != k), other]
        return other not in chosen and _fall_of_squares(gram, slope, columns) > least

    others = range(count, count + len(names))
    return {names[k - count]: tuple(names[i - count] for i in others if does_as_well(k, i)) for k in chosen}


def _normal_equations(bench: Bench, names: tuple[str, ...]) -> tuple[Array, Array]:
    """Information and gradient of the model's own parameters and of these values, in their order."""
    base = bench.base
    by_run = {n: base.values[n] for n in base.model.values.split}
    held, p = WeakModel(base.model.functions, names, known=by_run), base.p[: base.model.values.size]
    at = whitened(held.linearise(bench.train, p), bench.train_whitening)
    both = Linearised(base.at.r, np.hstack([base.at.J, at.J]), at.start)
    prior = prior_of(WeakModel(base.model.functions, (*base.model.free, *names)))
    return normal_equations(both, base.p[[*base.model.places, *held.places]], prior)


def _fall_of_squares(gram: Array, slope: Array, columns: list[int]) -> float:
    """Fall of the sum of squares when these columns are fitted."""
    if not columns:
        return 0.0
    own = slope[columns]
    return float(own @ inverse_of(gram[np.ix_(columns, columns)]) @ own)
