"""The search for missing effects: one by one, pairs where one is not enough, a final fit."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from undertow.identification.estimation.data import WeakData, inverse_of
from undertow.identification.estimation.residual import base_name, whitened
from undertow.identification.estimation.step import freed
from undertow.identification.estimation.weak_form import WeakFit, refitted, with_reestimated_noise
from undertow.model.catalogue import Catalogue
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Progress

from .bench import Bench, noise_ratio, only_noise, open_bench
from .candidates import Candidate
from .consistency import is_spring
from .evidence import (
    EffectSet,
    FoundEffect,
    IsNoise,
    as_good,
    compare_scores,
    equivalent_sets,
    explains_all,
    fitted,
    hidden_by_disturbance,
    too_fast_to_distinguish,
    under_own_noise,
    with_effects,
    without_redundant_effects,
)
from .rounds import Round, try_all, values_to_free
from .settings import DEFAULT, Settings
from .trial import significant_parameters


def better_pair(current: Round, residual_is_noise: IsNoise) -> EffectSet | None:
    """Two effects other than the best single one that together explain clearly more than it, if only noise
    remains.

    A pair that includes the best single effect is found in the next round.
    """
    adequate = [
        c
        for c in _fitted_pairs(current, current.bench.settings.pairs_beside)
        if residual_is_noise(c.fit, current.bench.test)
    ]
    return min(adequate, key=lambda c: c.score.error, default=None)


def joint_pair(current: Round, residual_is_noise: IsNoise) -> EffectSet | None:
    """Two effects of which neither is significant alone and that together leave only noise.

    All pairs of effects were tried, so the best of them looks good by chance more easily than the best single
    one; and if several do as well, none is established.
    """
    bench = current.bench
    if residual_is_noise(bench.base, bench.test):
        return None
    count = len(current.findings) * (len(current.findings) - 1) // 2
    return unique_significant_pair(
        _fitted_pairs(current, bench.settings.pairs_alone), bench, count, residual_is_noise
    )


def unique_significant_pair(
    tried: Sequence[EffectSet], bench: Bench, count: int, residual_is_noise: IsNoise
) -> EffectSet | None:
    """The pair, of `count` possible ones, that leaves only noise, if no other does as well."""
    adequate = [c for c in tried if _is_significant(c, bench, count) and residual_is_noise(c.fit, bench.test)]
    best = min(adequate, key=lambda c: c.score.error, default=None)
    if best is None or any(as_good(best.score, c.score, bench) for c in tried if c is not best):
        return None
    return best


def _fitted_pairs(current: Round, most: int) -> list[EffectSet]:
    """The most promising pairs of effects, fitted, excluding those with the best single one, if any."""
    bench = current.bench
    vehicle = bench.base.model.functions.vehicle
    pairs = promising_pairs(current.findings, bench, most)
    return [fitted(vehicle, pair, bench) for pair in pairs if current.winner not in pair]


def _is_significant(pair: EffectSet, bench: Bench, count: int) -> bool:
    gap = compare_scores(bench.base_score, pair.score, bench.test)
    return gap.beyond_chance(bench.settings, among=count)


def promising_pairs(
    findings: Sequence[FoundEffect], bench: Bench, most: int
) -> list[tuple[FoundEffect, FoundEffect]]:
    """Pairs of candidates by their joint predicted improvement, the most promising first.

    Their changes at their fits are added up, and all parameters are refitted linearly.
    """
    leading = [f for f in findings if f.trial.kept][: bench.settings.pair_candidates]
    columns = [_change_and_columns(f, bench) for f in leading]
    pairs = [(i, j) for i, j in combinations(range(len(leading)), 2)]
    costs = [_joint_cost(bench, columns[i], columns[j]) for i, j in pairs]
    return [(leading[pairs[k][0]], leading[pairs[k][1]]) for k in np.argsort(costs)[:most]]


def _change_and_columns(finding: FoundEffect, bench: Bench) -> tuple[Array, Array]:
    """Change of the residual by a candidate at its fit, and its own columns there."""
    fit = finding.trial.full
    at = whitened(fit.model.linearise(bench.train, fit.p), bench.train_whitening)
    own = {p.name for p in finding.trial.candidate.parameters}
    chosen = [k for k, n in enumerate(fit.model.free) if base_name(n) in own]
    return at.r - bench.base.at.r, at.J[:, chosen]


def _joint_cost(bench: Bench, first: tuple[Array, Array], second: tuple[Array, Array]) -> float:
    r = bench.base.at.r + first[0] + second[0]
    columns = np.hstack([bench.base.at.J, first[1], second[1]])
    slope = columns.T @ r
    return float(r @ r - slope @ inverse_of(columns.T @ columns) @ slope)


_log = logging.getLogger("undertow.diagnosis")
Freed = Mapping[str, tuple[str, ...]]
ToFree = Callable[[Round, IsNoise], Freed]


@dataclass(frozen=True)
class Search:
    """Result of the search.

    vehicle: the model as given, or with some of its fixed values to be estimated.
    rounds: its steps; the last has no winner unless the noise floor was reached or no effects remained.
    bench: data, the noise model of the best model found, and the model without any effect.
    effect_set: the effects found, none or several, fitted together.
    rivals: for each of the effects, those that do as well in its place.
    given: the model before any value was freed, fitted under its own noise model, where `fit` begins.
    base: the same for `vehicle`.
    freed: those values, each with alternatives that would have the same effect.
    second_look: the last round under sensor noise alone, if it was tried.
    """

    vehicle: Vehicle
    rounds: list[Round]
    bench: Bench
    effect_set: EffectSet
    rivals: list[list[EffectSet]]
    given: WeakFit
    base: WeakFit
    freed: Freed = field(default_factory=dict)
    second_look: Round | None = None

    @property
    def winners(self) -> list[FoundEffect]:
        """The effects that were found."""
        return list(self.effect_set.findings)

    def steps(self) -> list[WeakFit]:
        """Fits of the model without effects, with the first, with the first two, and so on."""
        found = self.winners
        between = [fitted(self.vehicle, found[:i], self.bench).fit for i in range(1, len(found))]
        return [self.bench.base, *between, *([self.effect_set.fit] if found else [])]


def search(
    vehicle: Vehicle,
    train: WeakData,
    test: WeakData,
    known: Catalogue,
    report: Progress = lambda done, words: None,
    residual_is_noise: IsNoise = only_noise,
    settings: Settings = DEFAULT,
) -> Search:
    """Search for missing effects until the noise floor is reached or nothing improves the model."""
    report(0.0, "fitting the model as given")
    initial = open_bench(vehicle, train, test, settings)
    vehicle = initial.base.model.functions.vehicle
    steps = _stepwise(vehicle, initial, known, report, residual_is_noise, values_to_free)
    if names := steps.freed:
        _log.info("fixed values that explain more than any effect: %s", ", ".join(names))
        found = search(freed(vehicle, list(names)), train, test, known, report, residual_is_noise, settings)
        if not _adequate_without_freed(vehicle, found.winners, initial, residual_is_noise):
            return replace(found, given=initial.base, freed={**names, **found.freed})
        steps = _stepwise(vehicle, initial, known, report, residual_is_noise, _none_to_free)
    report(0.9, "testing all effects together")
    found = _refitted_together(vehicle, initial, steps.rounds, steps.effect_set)
    return replace(found, second_look=steps.second_look)


@dataclass(frozen=True)
class _Steps:
    """Rounds of candidates, the effects that were added, and the model with them.

    `freed` are fixed values that improve the model more than the next effect: then the search ends here.
    `paired`: two effects of which neither is significant alone. `second_look`: the last round under sensor
    noise alone, in vain.
    """

    rounds: list[Round]
    effect_set: list[FoundEffect]
    fit: WeakFit
    freed: Freed
    paired: bool = False
    second_look: Round | None = None


def _none_to_free(current: Round, residual_is_noise: IsNoise) -> Freed:
    return {}


def _adequate_without_freed(
    vehicle: Vehicle, effects: Sequence[FoundEffect], bench: Bench, residual_is_noise: IsNoise
) -> bool:
    """Whether effects that were found together with freed values leave only noise without these."""
    return bool(effects) and residual_is_noise(fitted(vehicle, effects, bench).fit, bench.test)


def _stepwise(
    vehicle: Vehicle,
    bench: Bench,
    known: Catalogue,
    report: Progress,
    residual_is_noise: IsNoise,
    to_free: ToFree,
) -> _Steps:
    """Rounds of candidates, and a second look if nothing is found although more than noise remains."""
    steps = _steps(vehicle, bench, known, report, residual_is_noise, [], to_free)
    last = steps.rounds[-1].bench
    if steps.freed or steps.paired or steps.rounds[-1].winner is not None:
        return steps
    if not hidden_by_disturbance(last):
        return steps
    undisturbed = last.without_disturbance()
    again = _steps(
        vehicle,
        undisturbed,
        known,
        lambda done, words: report(0.9, words),
        residual_is_noise,
        steps.effect_set,
        _none_to_free,
    )
    if len(again.effect_set) > len(steps.effect_set) and explains_all(
        undisturbed, again.fit, residual_is_noise
    ):
        return replace(again, rounds=[*steps.rounds[:-1], *again.rounds])
    return replace(steps, second_look=again.rounds[0])


def _steps(
    vehicle: Vehicle,
    bench: Bench,
    known: Catalogue,
    report: Progress,
    residual_is_noise: IsNoise,
    found: Sequence[FoundEffect],
    to_free: ToFree,
) -> _Steps:
    """Rounds of candidates, each in addition to those found so far."""
    rounds: list[Round] = []
    effect_set, fit = list(found), bench.base
    while len(effect_set) < bench.settings.max_effects:
        part = _scaled(report, len(rounds), bench.settings.max_effects)
        current = _led_by_adequate(try_all(bench, known, part), residual_is_noise)
        rounds.append(current)
        if names := to_free(current, residual_is_noise):
            return _Steps(rounds, effect_set, fit, names)
        if current.winner is None:
            pair = None if effect_set else joint_pair(current, residual_is_noise)
            if pair is not None:
                return _Steps(rounds, list(pair.findings), pair.fit, {}, paired=True)
            break
        effect_set.append(current.winner)
        fit = current.winner.trial.fit
        _log.info("adding %s: normalised error %.3f", current.winner.id, current.winner.trial.score.error)
        if residual_is_noise(fit, bench.test):
            break
        pair = better_pair(current, residual_is_noise) if len(effect_set) == 1 else None
        if pair is not None:
            effect_set, fit = list(pair.findings), pair.fit
            _log.info("a pair: %s, normalised error %.3f", [f.id for f in effect_set], pair.score.error)
            if residual_is_noise(fit, bench.test):
                break
        if _noise_out_of_reach(bench.base, fit, bench, bench.settings.max_effects - len(effect_set)):
            break
        # The effects found become part of the model.
        bench = current.bench.with_model(with_effects(vehicle, effect_set), fit.values)
    return _Steps(rounds, effect_set, fit, {})


def _noise_out_of_reach(before: WeakFit, after: WeakFit, bench: Bench, left: int) -> bool:
    """Whether the remaining number of effects, each no better than the last one, could not reach the noise.

    Effects come in the order of their improvement. If no set of them can explain everything, simulation
    decides which of them to add.
    """
    ratios = [noise_ratio(fit, bench.test) for fit in (before, after)]
    limit = bench.settings.output_error_reach * np.count_nonzero(np.isfinite(ratios[1]))
    total, remaining = (float(np.nansum(ratio)) for ratio in ratios)
    return bool(remaining - left * max(total - remaining, 0.0) > limit)


def _led_by_adequate(current: Round, residual_is_noise: IsNoise) -> Round:
    """The round led by an effect that leaves only noise, if the leading one leaves more.

    Under a noise model that includes disturbances, some effects look alike that simulation tells apart.
    """
    leading = [f for f in current.findings if f.significant][: current.bench.settings.leading_effects]
    test = current.bench.test
    if not leading or residual_is_noise(leading[0].trial.fit, test):
        return current
    adequate = next((f for f in leading[1:] if residual_is_noise(f.trial.fit, test)), None)
    if adequate is None:
        return current
    return replace(current, findings=[adequate, *(f for f in current.findings if f is not adequate)])


def _scaled(report: Progress, rounds: int, most: int) -> Progress:
    """Progress within the next of `most` rounds as progress of the whole."""
    return lambda done, words: report(0.9 * (rounds + done) / most, words)


def _refitted_together(
    vehicle: Vehicle, initial: Bench, rounds: list[Round], found: list[FoundEffect]
) -> Search:
    """All effects fitted together under the last noise model, without those no longer needed."""
    if not found:
        return Search(
            vehicle, rounds, initial, fitted(vehicle, [], initial), [], given=initial.base, base=initial.base
        )
    bench = initial.with_noise_model_of(found[-1].trial.full) if len(rounds) > 1 else rounds[0].bench
    effect_set = without_redundant_effects(vehicle, fitted(vehicle, found, bench), bench)
    rivals: list[list[EffectSet]] = []
    for place in range(len(effect_set.findings)):
        possible = possible_rivals(effect_set, place, rounds, bench)
        equals = sorted(
            [effect_set, *equivalent_sets(vehicle, effect_set, place, possible, bench)],
            key=lambda c: c.score.error,
        )
        # A memory that removes more inertia than the added mass is no rival of an effect that does not.
        equals = [c for c in equals if not is_spring(c.findings[place])] or equals
        # An effect with enough parameters can imitate another: it is no rival of the simple one.
        fewest = min(len(c.findings[place].parameters) for c in equals)
        effect_set, *others = [
            c for c in equals if len(c.findings[place].parameters) <= fewest + bench.settings.more_parameters
        ]
        rivals.append(others or _simpler_equivalents(vehicle, effect_set, rounds, bench))
    return Search(vehicle, rounds, bench, effect_set, rivals, given=initial.base, base=initial.base)


def _simpler_equivalents(
    vehicle: Vehicle, effect_set: EffectSet, rounds: list[Round], bench: Bench
) -> list[EffectSet]:
    """Much simpler effects than the single one found that do as well once each is fitted under its own noise.

    Under a noise model that includes a disturbance, steady forces are fitted loosely, and an effect with many
    parameters may lead for that reason alone. Simulation decides between them.
    """
    if len(effect_set.findings) != 1 or len(rounds) != 1:
        return []
    near = much_simpler(effect_set.findings[0], effect_set.score.error, rounds[0].findings, bench.settings)
    simpler = [fitted(vehicle, [f], bench) for f in near]
    if not simpler:
        return []
    best = under_own_noise(effect_set, bench).score
    return [c for c in simpler if as_good(best, under_own_noise(c, bench).score, bench)]


def much_simpler(
    leader: FoundEffect, error: float, findings: Sequence[FoundEffect], settings: Settings = DEFAULT
) -> list[FoundEffect]:
    """Significant effects with far fewer parameters than the leading one and nearly its error."""
    others = [f for f in findings if f.significant and f is not leader]
    near = [f for f in others if f.trial.score.error < settings.plain_error * error][: settings.rivals]
    return [f for f in near if len(f.parameters) < len(leader.parameters) - settings.more_parameters]


def possible_rivals(
    effect_set: EffectSet, place: int, rounds: Sequence[Round], bench: Bench
) -> list[FoundEffect]:
    """Significant effects of the round in which an effect was found; for a single effect, those as good.

    An effect may do well together with another one though not alone.
    """
    effect = effect_set.findings[place]
    for current in rounds:
        others = [f for f in current.findings if f is not effect and f.significant]
        if effect in current.findings and others:
            if len(rounds) == len(effect_set.findings) == 1:
                best = effect_set.score
                others = [
                    f
                    for f in others
                    if as_good(best, f.trial.score, bench) or too_fast_to_distinguish(effect, f, bench)
                ]
            return others[: bench.settings.rivals]
    return []


def last_fit(fit: WeakFit, candidates: Sequence[Candidate], settings: Settings = DEFAULT) -> WeakFit:
    """Fit a model once more under its own noise model, with parameters for which the search was too strict.

    While effects compete, a parameter has to be far from zero to be kept, since many could be nonzero by
    chance. In a named effect, a parameter is kept if more likely present than not: two standard errors from
    zero.
    """
    fit = with_reestimated_noise(fit)
    names = fit.model.functions.parameter_names
    removable = {n for c in candidates for n in c.removable if n in names}
    left_out = removable - set(fit.model.values.names)
    if not left_out:
        return fit
    whole = _refitted(fit, (*fit.model.free, *sorted(left_out)))
    kept = significant_parameters(whole, tuple(sorted(removable)), settings.t_in_last_fit)
    free = (*fit.model.free, *(n for n in kept if n in left_out))
    return fit if free == fit.model.free else with_reestimated_noise(_refitted(whole, free))


def _refitted(fit: WeakFit, free: Collection[str]) -> WeakFit:
    start = {n: v for n, v in fit.values.items() if n in free}
    return refitted(fit, fit.model.with_free(tuple(free)), start)
