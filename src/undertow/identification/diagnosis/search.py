"""The search for what is missing: effect after effect, pairs where one is not enough, a last fit."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations

import numpy as np

from undertow.identification.estimation.data import WeakData
from undertow.identification.estimation.fitted import SURE
from undertow.identification.estimation.residual import WeakModel, whitened
from undertow.identification.estimation.step import inverse_of
from undertow.identification.estimation.weak_form import (
    WeakFit,
    fit_weak,
    free_parameters,
    with_reestimated_noise,
)
from undertow.model.catalogue import Catalogue
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Progress

from .candidates import Candidate
from .evidence import (
    Chain,
    FoundEffect,
    Quiet,
    alternatives,
    as_good,
    compare_scores,
    explains_all,
    fitted,
    hidden_by_disturbance,
    thinned,
    with_effects,
)
from .rounds import Round, freed, try_all, values_to_free
from .trial import FALSE_ALARM_RATE, Bench, only_noise, open_bench, parameters_that_matter

_LEADING = 8
# Pairs that are tried beside an effect that shows alone, and where none does.
_PAIRS, _LONE_PAIRS = 2, 6


def pair_beside(current: Round, quiet: Quiet) -> Chain | None:
    """Two effects that without the best single one explain clearly more than that, if the logs leave no more.

    A pair with the best single effect is found by the next round.

    Parameters
    ----------
    current : Round
        Every effect by itself.
    quiet : callable
        Whether a model leaves only noise of the kept-aside data.
    """
    good = [c for c in _tried(current, _PAIRS) if quiet(c.fit, current.bench.test)]
    return min(good, key=lambda c: c.score.error, default=None)


def lone_pair(current: Round, quiet: Quiet) -> Chain | None:
    """Two effects of which neither is in evidence alone and that together leave only noise.

    All pairs of effects were in the race, so that by chance the best of them looks good more easily than the
    best single one; and of several that do as well, none is in evidence.

    Parameters
    ----------
    current : Round
        Every effect by itself.
    quiet : callable
        Whether a model leaves only noise of the kept-aside data.
    """
    bench = current.bench
    if quiet(bench.base, bench.test):
        return None
    count = len(current.findings) * (len(current.findings) - 1) // 2
    tried = _tried(current, _LONE_PAIRS)
    good = [c for c in tried if _in_evidence(c, bench, count) and quiet(c.fit, bench.test)]
    best = min(good, key=lambda c: c.score.error, default=None)
    if best is None or any(as_good(best.score, c.score, bench.test) for c in tried if c is not best):
        return None
    return best


def _tried(current: Round, most: int) -> list[Chain]:
    """The most promising pairs of effects, fitted, without those of the best single one if there is one."""
    bench = current.bench
    vehicle = bench.base.model.functions.vehicle
    pairs = promising_pairs(current.findings, bench, most)
    return [fitted(vehicle, pair, bench) for pair in pairs if current.winner not in pair]


def _in_evidence(pair: Chain, bench: Bench, count: int) -> bool:
    gap = compare_scores(bench.base_score, pair.score, bench.test)
    return gap.beyond_chance(bench.false_alarms, among=count)


def promising_pairs(
    findings: Sequence[FoundEffect], bench: Bench, most: int
) -> list[tuple[FoundEffect, FoundEffect]]:
    """Pairs of candidates by what they promise together, the most promising first.

    What each changes where it was fitted is added up, and all parameters are refitted linearly.

    Parameters
    ----------
    findings : sequence of Finding
        Candidates of one round, best first.
    bench : Bench
        Data and noise model of the round.
    most : int
        Number of pairs.
    """
    leading = [f for f in findings if f.trial.kept][:_LEADING]
    columns = [_columns(f, bench) for f in leading]
    pairs = [(i, j) for i, j in combinations(range(len(leading)), 2)]
    costs = [_together(bench, columns[i], columns[j]) for i, j in pairs]
    return [(leading[pairs[k][0]], leading[pairs[k][1]]) for k in np.argsort(costs)[:most]]


def _columns(finding: FoundEffect, bench: Bench) -> tuple[Array, Array]:
    """What a candidate changes in the residual where it was fitted, and its own columns there."""
    fit = finding.trial.full
    at = whitened(fit.model.linearise(bench.train, fit.p), bench.train_whitening)
    own = {p.name for p in finding.trial.candidate.parameters}
    chosen = [k for k, n in enumerate(fit.model.free) if n in own]
    return at.r - bench.base.at.r, at.J[:, chosen]


def _together(bench: Bench, first: tuple[Array, Array], second: tuple[Array, Array]) -> float:
    r = bench.base.at.r + first[0] + second[0]
    columns = np.hstack([bench.base.at.J, first[1], second[1]])
    slope = columns.T @ r
    return float(r @ r - slope @ inverse_of(columns.T @ columns) @ slope)


_log = logging.getLogger("undertow.diagnosis")
Freed = Mapping[str, tuple[str, ...]]
ToFree = Callable[[Round, Quiet], Freed]
MAX_EFFECTS = 3
_RIVALS = 5
# Significant effects of which one may leave only noise although another has the smaller weak residual.
_LEADING_ROUNDS = 4
# Parameters more than the plainest of equally good effects from which one is none of them.
_BENDABLE = 3
# Times the error of an effect with many parameters up to which a plain one is worth another look.
_NEAR = 1.1


@dataclass(frozen=True)
class Search:
    """What the search found.

    Attributes
    ----------
    vehicle : Vehicle
        The model as given, or with some of its fixed values to be estimated.
    rounds : list of Round
        Its steps; the last is without a winner unless the noise floor was reached or effects ran out.
    bench : Bench
        Data, the noise model of the best model that was found, and the model without any effect.
    chain : Chain
        The effects that were found, none or several, fitted together.
    rivals : list of list of Chain
        For each of the effects, what does as well in its place.
    freed : mapping
        Those values, each with fixed values that would do the same in its place.
    """

    vehicle: Vehicle
    rounds: list[Round]
    bench: Bench
    chain: Chain
    rivals: list[list[Chain]]
    freed: Freed = field(default_factory=dict)

    @property
    def winners(self) -> list[FoundEffect]:
        """The effects that were found."""
        return list(self.chain.findings)

    def steps(self) -> list[WeakFit]:
        """Fits of the model without effects, with the first, with the first two, and so on."""
        found = self.winners
        between = [fitted(self.vehicle, found[:i], self.bench).fit for i in range(1, len(found))]
        return [self.bench.base, *between, *([self.chain.fit] if found else [])]


def search(
    vehicle: Vehicle,
    train: WeakData,
    test: WeakData,
    known: Catalogue,
    report: Progress = lambda done, words: None,
    quiet: Quiet = only_noise,
    false_alarms: float = FALSE_ALARM_RATE,
) -> Search:
    """Look for missing effects until the noise floor or until nothing helps.

    Parameters
    ----------
    vehicle : Vehicle
        The model.
    train, test : WeakData
        Data to fit to, and data kept aside to judge by.
    known : Catalogue
        Effects that may be missing.
    report : callable, optional
        Told the share done and what is going on.
    quiet : callable, optional
        Whether a model leaves only noise of the kept-aside data; the search ends with one that does.
    false_alarms : float
        Chance of naming an effect where nothing is missing.
    """
    report(0.0, "fitting the model as it is")
    opened = open_bench(vehicle, train, test, false_alarms)
    steps = _stepwise(vehicle, opened, known, report, quiet, values_to_free)
    if names := steps.freed:
        _log.info("fixed values that explain more than any effect: %s", ", ".join(names))
        found = search(freed(vehicle, list(names)), train, test, known, report, quiet, false_alarms)
        if not _do_alone(vehicle, found.winners, opened, quiet):
            return replace(found, freed={**names, **found.freed})
        steps = _stepwise(vehicle, opened, known, report, quiet, _none_to_free)
    report(0.9, "looking at all effects together")
    return _refitted_together(vehicle, opened, steps.rounds, steps.chain)


@dataclass(frozen=True)
class _Steps:
    """Rounds of candidates, the effects that were added, and the model with them.

    `freed` are fixed values that do more than the next effect would: then the search ends here. `paired`: the
    effects are two of which neither shows alone.
    """

    rounds: list[Round]
    chain: list[FoundEffect]
    fit: WeakFit
    freed: Freed
    paired: bool = False


def _none_to_free(current: Round, quiet: Quiet) -> Freed:
    return {}


def _do_alone(vehicle: Vehicle, effects: Sequence[FoundEffect], bench: Bench, quiet: Quiet) -> bool:
    """Whether effects that were found beside other values leave only noise without these."""
    return bool(effects) and quiet(fitted(vehicle, effects, bench).fit, bench.test)


def _stepwise(
    vehicle: Vehicle, bench: Bench, known: Catalogue, report: Progress, quiet: Quiet, to_free: ToFree
) -> _Steps:
    """Rounds of candidates, and a second look where nothing is found although more than noise is left."""
    steps = _steps(vehicle, bench, known, report, quiet, [], to_free)
    last = steps.rounds[-1].bench
    if steps.freed or steps.paired or steps.rounds[-1].winner is not None:
        return steps
    if not hidden_by_disturbance(last):
        return steps
    bare = last.without_disturbance()
    again = _steps(vehicle, bare, known, partial(_late, report), quiet, steps.chain, _none_to_free)
    if len(again.chain) > len(steps.chain) and explains_all(bare, again.fit, quiet):
        return replace(again, rounds=[*steps.rounds[:-1], *again.rounds])
    return steps


def _late(report: Progress, done: float, words: str) -> None:
    report(0.9, words)


def _steps(
    vehicle: Vehicle,
    bench: Bench,
    known: Catalogue,
    report: Progress,
    quiet: Quiet,
    found: Sequence[FoundEffect],
    to_free: ToFree,
) -> _Steps:
    """Rounds of candidates, each on top of what was found so far."""
    rounds: list[Round] = []
    chain, fit = list(found), bench.base
    while len(chain) < MAX_EFFECTS:
        current = _sound_first(try_all(bench, known, _share_of(report, len(rounds))), quiet)
        rounds.append(current)
        if names := to_free(current, quiet):
            return _Steps(rounds, chain, fit, names)
        if current.winner is None:
            pair = None if chain else lone_pair(current, quiet)
            if pair is not None:
                return _Steps(rounds, list(pair.findings), pair.fit, {}, paired=True)
            break
        chain.append(current.winner)
        fit = current.winner.trial.fit
        _log.info("adding %s: normalised error %.3f", current.winner.id, current.winner.trial.score.error)
        if quiet(fit, bench.test):
            break
        pair = pair_beside(current, quiet) if len(chain) == 1 else None
        if pair is not None:
            chain, fit = list(pair.findings), pair.fit
            _log.info("a pair: %s, normalised error %.3f", [f.id for f in chain], pair.score.error)
            if quiet(fit, bench.test):
                break
        bench = _on_top(current.bench, vehicle, chain, fit)
    return _Steps(rounds, chain, fit, {})


def _sound_first(current: Round, quiet: Quiet) -> Round:
    """The round led by an effect with which nothing but noise is left, where the leading one leaves more.

    Under a noise model with room for disturbances, some effects look alike that simulation tells apart.
    """
    leading = [f for f in current.findings if f.significant][:_LEADING_ROUNDS]
    test = current.bench.test
    if not leading or quiet(leading[0].trial.fit, test):
        return current
    sound = next((f for f in leading[1:] if quiet(f.trial.fit, test)), None)
    if sound is None:
        return current
    return replace(current, findings=[sound, *(f for f in current.findings if f is not sound)])


def _on_top(bench: Bench, vehicle: Vehicle, chain: list[FoundEffect], fit: WeakFit) -> Bench:
    """The bench for the next round: what was found belongs to the model."""
    grown = with_effects(vehicle, chain)
    base = bench.fit(grown, free_parameters(grown), fit.values)
    return replace(bench, base=base)


def _share_of(report: Progress, done_rounds: int) -> Progress:
    """Progress within one round as progress of the whole."""

    def told(done: float, words: str) -> None:
        report(0.9 * (done_rounds + done) / MAX_EFFECTS, words)

    return told


def _refitted_together(
    vehicle: Vehicle, opened: Bench, rounds: list[Round], found: list[FoundEffect]
) -> Search:
    """All effects fitted together under the last noise model, without those that are not needed any more."""
    if not found:
        return Search(vehicle, rounds, opened, fitted(vehicle, [], opened), [])
    bench = opened.sharpened(found[-1].trial.full) if len(rounds) > 1 else rounds[0].bench
    chain = thinned(vehicle, fitted(vehicle, found, bench), bench)
    rivals: list[list[Chain]] = []
    for place in range(len(chain.findings)):
        equals = sorted([chain, *_rivals(vehicle, chain, place, rounds, bench)], key=lambda c: c.score.error)
        # With enough parameters an effect can be bent into another: it is no rival of the plain one.
        plainest = min(len(c.findings[place].parameters) for c in equals)
        chain, *others = [c for c in equals if len(c.findings[place].parameters) <= plainest + _BENDABLE]
        rivals.append(others or _plain_ones(vehicle, chain, rounds, bench))
    return Search(vehicle, rounds, bench, chain, rivals)


def _plain_ones(vehicle: Vehicle, chain: Chain, rounds: list[Round], bench: Bench) -> list[Chain]:
    """Much plainer effects than the single one found that do as well once each is fitted under its own noise.

    Under a noise model with room for a disturbance, what is steady is fitted loosely, and an effect with many
    parameters gets ahead by that alone. Which of them it is, the simulation has to say.
    """
    if len(chain.findings) != 1 or len(rounds) != 1:
        return []
    others = [f for f in rounds[0].findings if f.significant and f is not chain.findings[0]]
    near = [f for f in others if f.trial.score.error < _NEAR * chain.score.error][:_RIVALS]
    most = len(chain.findings[0].parameters) - _BENDABLE
    plain = [fitted(vehicle, [f], bench) for f in near if len(f.parameters) < most]
    if not plain:
        return []
    best = bench.judge(with_reestimated_noise(chain.fit))
    return [c for c in plain if as_good(best, bench.judge(with_reestimated_noise(c.fit)), bench.test)]


def _rivals(vehicle: Vehicle, chain: Chain, place: int, rounds: list[Round], bench: Bench) -> list[Chain]:
    """What does as well as one of the effects, the others being what they are."""
    effect = chain.findings[place]
    for current in rounds:
        others = [f for f in current.findings if f is not effect and f.significant]
        if effect in current.findings and others:
            if len(rounds) == len(chain.findings) == 1:
                others = [f for f in others if as_good(chain.score, f.trial.score, bench.test)]
            return alternatives(vehicle, chain, place, others[:_RIVALS], bench)
    return []


def last_fit(fit: WeakFit, candidates: Sequence[Candidate]) -> WeakFit:
    """Fit a model once more under the noise that it leaves itself, with what the search was too strict about.

    While effects compete, a parameter has to be far from zero to stay, for there are many that could be there
    by chance. Of an effect that is named, a parameter stays that is more likely there than not: two standard
    errors from zero.

    Parameters
    ----------
    fit : WeakFit
        The model with the effects.
    candidates : sequence of Candidate
        The effects that it got.
    """
    fit = with_reestimated_noise(fit)
    names = fit.model.functions.parameter_names
    removable = {n for c in candidates for n in c.removable if n in names}
    left_out = removable - set(fit.model.free)
    if not left_out:
        return fit
    whole = _refitted(fit, (*fit.model.free, *sorted(left_out)))
    kept = parameters_that_matter(whole, tuple(sorted(removable)), SURE)
    free = (*fit.model.free, *(n for n in kept if n in left_out))
    return fit if free == fit.model.free else with_reestimated_noise(_refitted(whole, free))


def _refitted(fit: WeakFit, free: Collection[str]) -> WeakFit:
    start = {n: v for n, v in fit.values.items() if n in free}
    return fit_weak(
        WeakModel(fit.model.functions, tuple(free)),
        fit.data,
        start=start,
        whitening=fit.whitening,
        disturbance=fit.disturbance,
    )
