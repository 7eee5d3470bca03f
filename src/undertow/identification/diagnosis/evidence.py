"""Strength of the evidence: paired comparison over blocks, and the null distribution of the best."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student
from scipy.stats import wilcoxon

from undertow.identification.estimation.data import WeakData, inverse_of
from undertow.identification.estimation.prediction_error import (
    refit_by_prediction_error,
    vuong_p_value,
)
from undertow.identification.estimation.residual import base_name
from undertow.identification.estimation.step import prior_of
from undertow.identification.estimation.weak_form import WeakFit, free_parameters, with_reestimated_noise
from undertow.model.effect import Actuation, Measurement
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .bench import Bench, Score, comparable_mean_squares, is_noise, noise_ratio, rows_of
from .settings import DEFAULT, Settings
from .trial import Trial


@dataclass(frozen=True)
class Comparison:
    """Fall of the mean square from one model to another, block by block.

    mean: mean fall of the whitened mean square.
    interval: 95% interval of the mean over blocks.
    p_value: p-value of the fall if the models are equally good (Wilcoxon signed-rank test, one-sided).
    """

    mean: float
    interval: tuple[float, float]
    p_value: float

    def beyond_chance(self, settings: Settings = DEFAULT, among: int = 1) -> bool:
        """Whether the fall is large enough to matter and significant, as the best of so many."""
        return among * self.p_value < settings.false_alarm_rate and self.mean > settings.least_fall


def compare_scores(worse: Score, better: Score, data: WeakData) -> Comparison:
    """Compare two models on the same data, both whitened by the same noise model."""
    fall = worse.r**2 - better.r**2
    total, count = np.bincount(data.block, weights=fall), np.bincount(data.block)
    means = total / np.maximum(count, 1)
    mean = float(np.mean(means))
    n = len(means)
    half = float(student.ppf(0.975, n - 1) * np.std(means, ddof=1) / np.sqrt(n)) if n > 1 else np.inf
    if np.allclose(means, 0.0):
        return Comparison(0.0, (0.0, 0.0), 1.0)
    return Comparison(mean, (mean - half, mean + half), rank_p_value(means))


def rank_p_value(falls: Array) -> float:
    """P-value of falls of the error by block (B,) if the models are equally good, by their signed ranks."""
    return 1.0 if np.allclose(falls, 0.0) else float(wilcoxon(falls, alternative="greater").pvalue)


def explained(before: Array, after: Array, noise: Array, settings: Settings = DEFAULT) -> float:
    """Fraction of the excess over sensor noise that was removed, from mean squares by equation.

    Equations that noise explains are ignored; the others are weighted by their excess, such that one very bad
    equation does not hide the rest.
    """
    floor = np.maximum(noise, 1e-12)
    counted = np.nan_to_num(before / floor) > settings.equation_noise_limit
    if not np.any(counted):
        return 0.0
    first, last, floor = before[counted], after[counted], floor[counted]
    share = np.clip((first - np.maximum(last, floor)) / (first - floor), -1.0, 1.0)
    return float(np.average(share, weights=np.log(first / floor)))


def as_good(best: Score, other: Score, bench: Bench) -> bool:
    """Whether the validation data do not decide which of two models is better."""
    gap, settings = compare_scores(other, best, bench.test), bench.settings
    return gap.p_value > settings.comparison_level or gap.mean < settings.least_fall


def too_fast_to_distinguish(one: FoundEffect, other: FoundEffect, bench: Bench) -> bool:
    """Whether two effects that shift commands in time differ only within a fraction of a sample.

    A lag that short and a dead time as long differ by how the weak form integrates between samples.
    """
    delays, enough = [_delays(f) for f in (one, other)], bench.settings.named_share
    if not all(delays) or min(one.explained, other.explained) < enough:
        return False
    step = min(float(np.median(np.diff(s.t))) for s in bench.test.segments)
    return min(map(max, delays)) < bench.settings.resolved_time * step


def _delays(finding: FoundEffect) -> list[float]:
    """Free parameters, s, of an effect that acts on commands, if all are times."""
    if not issubclass(finding.trial.candidate.effect, Actuation):
        return []
    own = [p for p in finding.trial.candidate.parameters if p.name in finding.parameters]
    return [finding.trial.fit.values[p.name] for p in own] if all(p.unit == "s" for p in own) else []


@dataclass(frozen=True)
class FoundEffect:
    """A candidate with the evidence for it.

    trial: the candidate after its fit.
    evidence: fall of the validation error, block by block.
    explained: fraction of the excess over noise that it removes.
    p_value: probability that the best of all candidates reduces the error as much if nothing is missing.
    significant: whether it is significant and competes with others.
    slow_p_value: the same under a slow disturbance, with blocks long enough to be uncorrelated.
    inclusion: how often it is the best one when the blocks of the logs are resampled; NaN if not compared.
    """

    trial: Trial
    evidence: Comparison
    explained: float
    p_value: float
    significant: bool
    slow_p_value: float = 0.0
    inclusion: float = float("nan")

    @property
    def parameters(self) -> tuple[str, ...]:
        """Parameters that its fit adds to the model."""
        free = {base_name(n) for n in self.trial.fit.model.free}
        return tuple(p.name for p in self.trial.candidate.parameters if p.name in free)

    @property
    def id(self) -> str:
        """Id of the effect."""
        return self.trial.id

    def may_be_slow_disturbance(self, settings: Settings = DEFAULT) -> bool:
        """Whether a slow disturbance would score as well by chance: then the effect may be one."""
        return self.slow_p_value >= settings.false_alarm_rate

    @property
    def of_sensors(self) -> bool:
        """Whether it is a measurement effect."""
        return issubclass(self.trial.candidate.effect, Measurement)


def reconciles_sensors(finding: FoundEffect, bench: Bench) -> bool:
    """Whether an error of the sensors explains most of the contradiction between pose and velocities.

    They follow from each other without a force, so that no force explains that, known or unknown.
    """
    if not finding.of_sensors:
        return False
    n = len(bench.test.names) // 2
    before, after = comparable_mean_squares(bench.base_score, finding.trial.score, bench.test)
    share = explained(before[n:], after[n:], bench.noise_level[n:], bench.settings)
    return share >= bench.settings.own_share


IsNoise = Callable[[WeakFit, WeakData], bool]


def hidden_by_disturbance(bench: Bench) -> bool:
    """Whether a residual slightly above noise is absorbed by the disturbance of the noise model.

    Decided by the weak form, even if the simulation of windows finds only noise, since their estimated
    initial states absorb part of a small steady force. Simulation then decides if it is needed.
    """
    ratio = noise_ratio(bench.base, bench.test)
    return slightly_above_noise(bench.base.disturbance, ratio, rows_of(bench.test), bench.settings)


def slightly_above_noise(
    disturbance: Array, ratio: Array, rows: NDArray[np.intp], settings: Settings = DEFAULT
) -> bool:
    """Whether mean squares exceed noise, but not by far, and there is process noise to absorb them."""
    if not np.any(disturbance) or is_noise(ratio, rows, settings):
        return False
    # A large excess is unlikely to be removed by effects that the first search did not find.
    return bool(np.nanmax(ratio) < settings.second_look_limit)


def explains_all(bench: Bench, fit: WeakFit, residual_is_noise: IsNoise) -> bool:
    """Whether only noise remains with effects that were found without a disturbance in the noise model."""
    scores = comparable_mean_squares(bench.base_score, bench.score(fit), bench.test)
    share = explained(*scores, bench.noise_level, bench.settings)
    # A model just above the noise limit may fall below it by chance.
    return share >= bench.settings.excess_share and residual_is_noise(fit, bench.test)


@dataclass(frozen=True)
class Blocks:
    """Products of the columns of a linearised model, block by block.

    The whitened residual of the model is r + shift + J delta: r is that of the model without the candidate,
    shift its change by the candidate at the point of linearisation, J its derivative there.

    grams: (B, k + 2, k + 2), gram matrices of the columns of J (k of them), shift and r, one for each block.
    """

    grams: Array

    @classmethod
    def of(cls, J: Array, shift: Array, r: Array, block: NDArray[np.intp]) -> Blocks:
        """Tables from the whitened columns and the block of every row."""
        columns = np.column_stack([J, shift, r])
        order = np.argsort(block, kind="stable")
        edges = np.flatnonzero(np.diff(block[order])) + 1
        parts = np.split(columns[order], edges)
        return cls(np.stack([part.T @ part for part in parts]))

    @property
    def count(self) -> int:
        """Number of blocks."""
        return len(self.grams)

    def merged(self, group: NDArray[np.intp]) -> Blocks:
        """With the blocks of a group merged; `group` (B,) is the number of that of each block."""
        grams = np.zeros((int(group.max()) + 1, *self.grams.shape[1:]))
        np.add.at(grams, group, self.grams)
        return Blocks(grams)

    @cached_property
    def gram(self) -> Array:
        """J' J over all blocks, shape (k, k)."""
        return np.asarray(self.grams[:, :-2, :-2].sum(axis=0))

    def slope(self, signs: Array) -> Array:
        """J' (signs r + shift), shape (draws, k), for signs of the blocks of shape (draws, B)."""
        return np.asarray(signs @ self.grams[:, :-2, -1] + self.grams[:, :-2, -2].sum(axis=0))

    def squares(self, signs: Array, delta: Array) -> Array:
        """|signs r + shift + J delta|^2, shape (draws,), for delta of shape (draws, k)."""
        own = self.grams[:, -2:, -2:].sum(axis=0)
        constant = own[0, 0] + own[1, 1] + 2 * signs @ self.grams[:, -2, -1]
        return np.asarray(
            constant
            + 2 * np.einsum("dk,dk->d", delta, self.slope(signs))
            + np.einsum("dk,kl,dl->d", delta, self.gram, delta)
        )

    def without(self, dropped: int) -> Blocks:
        """The model without the shift and the last `dropped` columns of J, that is, without the candidate."""
        size = self.grams.shape[1]
        kept = [*range(size - 2 - dropped), size - 2, size - 1]
        grams = self.grams[:, kept][:, :, kept].copy()
        grams[:, -2, :] = grams[:, :, -2] = 0.0
        return Blocks(grams)


@dataclass(frozen=True)
class Linearisation:
    """A candidate linearised at its fit, on training and validation data.

    train, test: parameters of the model first, the candidate's last.
    added: number of columns that belong to the candidate.
    stiffness: (k,), weight of the stated priors.
    """

    train: Blocks
    test: Blocks
    added: int
    stiffness: Array

    def falls(self, train_signs: Array, test_signs: Array) -> Array:
        """Fall of the validation mean square by the candidate when both models are refitted, (draws,).

        Relative to its value before, since the size of the residual sets the size of chance falls.
        """
        stiffness = self.stiffness[: -self.added or None]
        without = Linearisation(self.train.without(self.added), self.test.without(self.added), 0, stiffness)
        before = without._squares(train_signs, test_signs)
        return np.asarray(1.0 - self._squares(train_signs, test_signs) / np.maximum(before, 1e-300))

    def _squares(self, train_signs: Array, test_signs: Array) -> Array:
        delta = -self.train.slope(train_signs) @ _inverse(self.train.gram, self.stiffness)
        return self.test.squares(test_signs, delta)

    def left_out_falls(self) -> Array:
        """Fall of the sum of squares of each block by the candidate, (B,): both models are fitted to all
        other blocks, of training and validation data (cross-validation).
        """
        grams = np.concatenate([self.train.grams, self.test.grams])
        count = len(self.stiffness) - self.added
        without = [*range(count), -1]
        before = _left_out_squares(grams[:, without][:, :, without], self.stiffness[:count])
        return before - _left_out_squares(grams, self.stiffness)

    def resampled(self, train_weight: Array, test_weight: Array) -> Array:
        """Validation sum of squares after a refit to weighted blocks, shape (draws,)."""
        return np.array(
            [self._weighted(a, b) for a, b in zip(train_weight, test_weight, strict=True)], dtype=float
        )

    def _weighted(self, train: Array, test: Array) -> float:
        fitted, judged = (np.tensordot(w, b.grams, 1) for w, b in ((train, self.train), (test, self.test)))
        k = len(self.stiffness)
        ones = np.ones(2)
        slope = fitted[:k, k:] @ ones
        delta = -_inverse(fitted[:k, :k], self.stiffness) @ slope
        whole = np.concatenate([delta, ones])
        return float(whole @ judged @ whole)


def _inverse(gram: Array, stiffness: Array) -> Array:
    """Inverse of the information; a parameter without any influence on the data stays unchanged."""
    used = np.diag(gram) > 0.0
    inverse = np.zeros_like(gram)
    inverse[np.ix_(used, used)] = inverse_of((gram + np.diag(stiffness**2))[np.ix_(used, used)])
    return inverse


def _left_out_squares(grams: Array, stiffness: Array) -> Array:
    """Sum of squares of each block, (B,), at the parameters fitted to all others.

    grams: (B, k + n, k + n), gram matrices of k columns and of the n parts of the residual.
    """
    k, whole = len(stiffness), grams.sum(axis=0)
    parts = np.ones(len(whole) - k)

    def squares(block: Array) -> float:
        others = whole - block
        delta = -_inverse(others[:k, :k], stiffness) @ (others[:k, k:] @ parts)
        at = np.concatenate([delta, parts])
        return float(at @ block @ at)

    return np.array([squares(block) for block in grams])


def null_distribution(candidates: Sequence[Linearisation], settings: Settings = DEFAULT) -> Array:
    """Largest relative fall of the validation error by any candidate if nothing is missing, (draws,).

    The residual of the model without any candidate keeps its size and its correlation within blocks; the sign
    of every block is drawn at random (wild bootstrap), which removes whatever the blocks have in common.
    """
    if not candidates:
        return np.zeros(settings.null_draws)
    rng = np.random.default_rng(settings.seed)
    first = candidates[0]
    train, test = (rng.choice([-1.0, 1.0], (settings.null_draws, b.count)) for b in (first.train, first.test))
    return np.asarray(np.max([c.falls(train, test) for c in candidates], axis=0))


@dataclass(frozen=True)
class NullDistributions:
    """Null distribution of the best of all candidates, with blocks as long as each of them needs.

    A slow disturbance extends over several blocks: if blocks are correlated there are fewer independent
    segments than blocks, and chance findings are larger than their signs suggest. The quantity that has to be
    uncorrelated is the product of the change by an effect and the residual of the best candidate (its score).
    """

    candidates: Sequence[Linearisation]
    bench: Bench
    _cache: dict[int, Array] = field(default_factory=dict)

    def p_value(self, fall: float, factor: int) -> float:
        """Probability that the best reduces the error as much, with blocks longer by this factor."""
        if factor not in self._cache:
            merged = [with_longer_blocks(c, factor, self.bench) for c in self.candidates]
            self._cache[factor] = null_distribution(merged, self.bench.settings)
        return p_value(fall, self._cache[factor])


def with_longer_blocks(candidate: Linearisation, factor: int, bench: Bench) -> Linearisation:
    """The candidate with blocks longer by this factor."""
    if factor == 1:
        return candidate
    train, test = (_longer_block(data, factor) for data in (bench.train, bench.test))
    return replace(candidate, train=candidate.train.merged(train), test=candidate.test.merged(test))


def _longer_block(data: WeakData, factor: int) -> NDArray[np.intp]:
    """Number of the longer block that each block of the data is in, (B,)."""
    first = np.unique(data.block, return_index=True)[1]
    return data.blocks_of(factor * data.block_seconds)[first]


def block_length_factor(trial: Trial, residual: Array, bench: Bench) -> int:
    """Factor by which blocks have to be longer for the score of an effect to be uncorrelated between them.

    residual: (m,), that of the best candidate on the training data: the closest estimate of the disturbance.
    """
    data, change = bench.train, bench.base.at.r - bench.on_train(trial.fit).r
    score = (residual * change).reshape(-1, len(data.rows)).sum(axis=1)
    longest = data.seconds / bench.settings.slow_blocks
    return max(1, round(min(data.uncorrelated_seconds(score), longest) / data.block_seconds))


def p_value_by_prediction_error(finding: FoundEffect, bench: Bench) -> float:
    """P-value of an effect by one-step predictions of the training data, with process noise in the model.

    Where commands answer what the model lacks, estimates are consistent if predictions are made from the past
    alone (direct identification in closed loop: Ljung 1999, chapter 13).
    """
    runs, base = bench.train.runs, bench.base_by_prediction_error
    found = refit_by_prediction_error(finding.trial.fit, runs, base)
    p_value = vuong_p_value(base, found)
    if p_value > bench.settings.false_alarm_rate:
        return p_value
    # The search for the smaller model may have ended at a worse minimum.
    again = refit_by_prediction_error(bench.base, runs, found)
    return max(p_value, vuong_p_value(again, found))


def p_value(fall: float, by_chance: Array) -> float:
    """Probability that the best candidate reduces the error by at least this much if nothing is missing."""
    return float((1 + np.count_nonzero(by_chance >= fall)) / (1 + len(by_chance)))


def inclusion(candidates: Sequence[Linearisation], settings: Settings = DEFAULT) -> Array:
    """How often each candidate is the best one when the blocks are resampled, shape (len(candidates),)."""
    if not candidates:
        return np.zeros(0)
    rng = np.random.default_rng(settings.seed)
    first, draws = candidates[0], settings.resamples
    train, test = (
        rng.multinomial(b.count, np.full(b.count, 1.0 / b.count), draws).astype(float)
        for b in (first.train, first.test)
    )
    squares = np.array([c.resampled(train, test) for c in candidates])
    return np.bincount(np.argmin(squares, axis=0), minlength=len(candidates)) / draws


def linearised(at: WeakFit, bench: Bench) -> Linearisation:
    """Linearise a model with a candidate at its fit, and the model without it."""
    base = bench.base
    added = len(at.model.free) - len(base.model.free)
    train, test = bench.on_train(at), bench.on_test(at)
    return Linearisation(
        Blocks.of(train.J, train.r - base.at.r, base.at.r, bench.train.block),
        Blocks.of(test.J, test.r - bench.base_score.r, bench.base_score.r, bench.test.block),
        added,
        prior_of(at.model)[1],
    )


@dataclass(frozen=True)
class EffectSet:
    """Effects added to a model, fitted together.

    findings: the effects, in the order in which they were found.
    fit: the model with all of them.
    score: its score on the validation data.
    """

    findings: tuple[FoundEffect, ...]
    fit: WeakFit
    score: Score


def with_effects(vehicle: Vehicle, findings: Sequence[FoundEffect]) -> Vehicle:
    """The model with effects, at the values at which they were found.

    Effects that share parameters of an absent effect are left out: without the added mass that was found, its
    memory is left out, too.
    """
    for finding in findings:
        candidate = finding.trial.candidate
        if not vehicle.lacks(candidate.effect):
            vehicle = candidate.for_model(vehicle).vehicle_with(finding.trial.fit.values)
    return vehicle


def fitted(vehicle: Vehicle, findings: Sequence[FoundEffect], bench: Bench) -> EffectSet:
    """Fit a model with several effects (see `with_effects`), and score it."""
    grown = with_effects(vehicle, findings)
    present = {e.id for e in grown.all_effects}
    free = free_parameters(grown)
    known = findings[-1].trial.fit.values if findings else bench.base.values
    own = set(free_parameters(vehicle))
    fit = bench.fit(grown, free, {n: v for n, v in known.items() if n in own})
    return EffectSet(tuple(f for f in findings if f.id in present), fit, bench.score(fit))


def reduced_to_same_force(other: FoundEffect, chosen: FoundEffect, bench: Bench) -> FoundEffect | None:
    """Another effect reduced to those of its terms that reproduce the force of the chosen one.

    None if it cannot reproduce that force with as few terms, does not explain half as much of the validation
    data, or has no other terms. Terms that explain something else are no evidence against it here.
    """
    mine, theirs = (
        _linear_terms(fit, f, bench) for fit, f in ((chosen.trial.fit, chosen), (other.trial.full, other))
    )
    if mine is None or theirs is None:
        return None
    force = mine.columns @ mine.values
    share = 1.0 - bench.settings.same_force
    size = np.linalg.lstsq(theirs.columns, force, rcond=None)[0]
    kept = np.sum((theirs.columns * size) ** 2, axis=0) > share * np.sum(force**2)
    names = [n for n, keep in zip(theirs.names, kept, strict=True) if keep]
    if not 0 < len(names) <= len(mine.names) or set(names) == set(other.parameters):
        return None
    columns = theirs.columns[:, kept]
    left = force - columns @ np.linalg.lstsq(columns, force, rcond=None)[0]
    if np.sum(left**2) > share * np.sum(force**2):
        return None
    alone = other.trial.with_only(names, bench)
    before, by_chosen, by_other = (s.error for s in (bench.base_score, chosen.trial.score, alone.score))
    enough = before - by_other > bench.settings.kept_gain * (before - by_chosen)
    return replace(other, trial=alone) if enough else None


class _LinearTerms(NamedTuple):
    names: list[str]
    values: Array
    columns: Array  # derivatives of the whitened residual, in these parameters


def _linear_terms(fit: WeakFit, found: FoundEffect, bench: Bench) -> _LinearTerms | None:
    """Change of the training residual by an effect; None if that is not linear."""
    own = {p.name: p for p in found.trial.candidate.parameters}
    places = [k for k, n in enumerate(fit.model.free) if n in own]
    names = [fit.model.free[k] for k in places]
    if not names or not all(own[n].linear for n in names) or fit.model.values.split:
        return None
    return _LinearTerms(names, np.array([fit.values[n] for n in names]), bench.on_train(fit).J[:, places])


def without_redundant_effects(vehicle: Vehicle, effect_set: EffectSet, bench: Bench) -> EffectSet:
    """The effects without those made redundant by those found later."""
    for finding in effect_set.findings[:-1]:
        shorter = fitted(vehicle, [f for f in effect_set.findings if f is not finding], bench)
        if as_good(effect_set.score, shorter.score, bench):
            return without_redundant_effects(vehicle, shorter, bench)
    return effect_set


def under_own_noise(effect_set: EffectSet, bench: Bench) -> EffectSet:
    """The same effects, fitted under the noise model of their own residual."""
    fit = with_reestimated_noise(effect_set.fit)
    return EffectSet(effect_set.findings, fit, bench.score(fit))


def equivalent_sets(
    vehicle: Vehicle, effect_set: EffectSet, place: int, rivals: Sequence[FoundEffect], bench: Bench
) -> list[EffectSet]:
    """Effect sets with one effect exchanged that do as well or better, the best first.

    The noise model of the bench is that of the effect found: sensor noise passed through that model, plus its
    disturbance. An effect that does worse under it may do better under its own noise model.
    """
    found, chosen = [], effect_set.findings[place]
    least = cache(lambda: _total_noise_ratio(under_own_noise(effect_set, bench), bench))
    for rival in rivals:
        others = list(effect_set.findings)
        if rival.id in {f.id for f in others}:
            continue
        others[place] = rival
        alternative = fitted(vehicle, others, bench)
        if len(alternative.findings) < len(others):
            continue
        as_fast = too_fast_to_distinguish(chosen, rival, bench)
        if not as_fast and not as_good(effect_set.score, alternative.score, bench):
            alternative = under_own_noise(alternative, bench)
            if _total_noise_ratio(alternative, bench) > least():
                continue
        found.append(alternative)
    return sorted(found, key=lambda c: c.score.error)


def _total_noise_ratio(effect_set: EffectSet, bench: Bench) -> float:
    """Validation residual of a model relative to sensor noise, over all equations."""
    return float(np.nansum(noise_ratio(effect_set.fit, bench.test)))
