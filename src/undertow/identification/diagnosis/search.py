"""The search for what is missing: all candidates, the leading ones under a finer noise model, then the next
effect.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from undertow.model.catalogue import Catalogue
from undertow.model.vehicle import Vehicle

from ..weak.data import WeakData
from ..weak.fit import WeakFit, free_parameters
from .candidates import Candidate, candidates
from .chance import Linear, best_by_chance, inclusion, p_value
from .evidence import Comparison, compare_scores, explained
from .linear import linear
from .trial import Bench, Score, Trial, noise_ratio, only_noise, open_bench, rejected, scout, try_candidate

_log = logging.getLogger("undertow.diagnosis")
Report = Callable[[float, str], None]

FALSE_ALARM_RATE = 0.01
# An effect that takes away less than this share of the noise's own mean square is hidden in the noise.
SMALLEST_FALL = 0.05
MAX_EFFECTS = 3
_FULL_FITS = 10
_FINALISTS = 6
# Share of the sum of squares that a step must promise before the leading candidates are known.
_FIRST_LOOK = 1e-2
# Times the error of the best candidate from which another is no rival of it.
_OUT_OF_REACH = 3.0
# Candidates that one step cannot make better than this (chi-square) are not worth a full fit.
_WORTH_A_FIT = 20.0


@dataclass(frozen=True)
class Finding:
    """A candidate with the evidence for it.

    Attributes
    ----------
    trial : Trial
        The candidate after its fit.
    evidence : Comparison
        Fall of the kept-aside error, block by block.
    explained : float
        Share of what exceeds the noise that it takes away.
    p_value : float
        Chance that the best of all candidates lowers the error as much when nothing is missing.
    significant : bool
        Whether it is held to be there.
    inclusion : float
        How often it is the best one when the blocks of the logs are drawn anew; NaN if not compared.
    """

    trial: Trial
    evidence: Comparison
    explained: float
    p_value: float
    significant: bool
    inclusion: float = float("nan")

    @property
    def id(self) -> str:
        """Id of the effect."""
        return self.trial.id


@dataclass(frozen=True)
class Round:
    """One step of the search: the model so far and what every candidate would do for it.

    Attributes
    ----------
    bench : Bench
        Data, noise model and the model so far.
    findings : list of Finding
        All candidates, best first.
    rivals : list of str
        Effects that the data cannot tell from the best one.
    """

    bench: Bench
    findings: list[Finding]
    rivals: list[str]

    @property
    def winner(self) -> Finding | None:
        """The best candidate, if the evidence for it is strong enough."""
        best = self.findings[0] if self.findings else None
        return best if best is not None and best.significant else None


@dataclass(frozen=True)
class Search:
    """All rounds, the last without a winner unless the noise floor was reached or effects ran out."""

    rounds: list[Round]
    final_fit: WeakFit

    @property
    def winners(self) -> list[Finding]:
        """Effects in the order in which they were added."""
        return [r.winner for r in self.rounds if r.winner is not None]


def search(
    vehicle: Vehicle,
    train: WeakData,
    test: WeakData,
    known: Catalogue,
    report: Report = lambda done, words: None,
) -> Search:
    """Look for missing effects, one after the other, until the noise floor or until nothing helps.

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
    """
    rounds: list[Round] = []
    report(0.0, "fitting the model as it is")
    bench = open_bench(vehicle, train, test)
    fit = bench.base
    while len(rounds) < MAX_EFFECTS and (not rounds or not only_noise(noise_ratio(fit, test))):
        current = _round(bench, known, _share_of(report, len(rounds)))
        rounds.append(current)
        if current.winner is None:
            break
        trial = current.winner.trial
        fit = trial.fit
        _log.info("adding %s: normalised error %.3f", trial.id, trial.score.error)
        grown = trial.candidate.adopted(fit.values)
        base = current.bench.fit(grown, free_parameters(grown), fit.values)
        bench = Bench(train, test, current.bench.train_whitening, current.bench.test_whitening, base)
    return Search(rounds, fit)


def _share_of(report: Report, done_rounds: int) -> Report:
    """Progress within one round as progress of the whole."""

    def told(done: float, words: str) -> None:
        report((done_rounds + done) / MAX_EFFECTS, words)

    return told


def _round(bench: Bench, known: Catalogue, report: Report) -> Round:
    possible = candidates(bench.base.model.functions.vehicle, known)
    _log.info("error so far %.3f; %d effects to try", bench.base_score.error, len(possible))
    scouted = _scouted(possible, bench, report)
    by_chance = best_by_chance([s.linear for s in scouted])
    worth = [s for s in scouted if bench.base.cost - s.cost > _WORTH_A_FIT][:_FULL_FITS]
    trials = []
    for i, s in enumerate(worth):
        report(0.5 + 0.3 * i / len(worth), f"fitting {s.candidate.id}")
        trials.append(try_candidate(s.candidate, bench, s.values, _FIRST_LOOK))
    chances = {t.id: p_value(_fall(bench.base_score, t.score), by_chance) for t in trials}
    finalists = sorted(
        (t for t in trials if t.kept or not t.candidate.removable), key=lambda t: t.score.error
    )
    bench, finalists = _final(bench, finalists[:_FINALISTS], report)
    tried = {t.id for t in finalists}
    others = [rejected(c, bench) for c in possible if c.id not in tried]
    return _judged(bench, finalists, others, chances)


def _fall(before: Score, after: Score) -> float:
    return float(np.mean(before.r**2) - np.mean(after.r**2))


class _Scouted(NamedTuple):
    candidate: Candidate
    cost: float
    values: dict[str, float]
    linear: Linear


def _scouted(possible: Sequence[Candidate], bench: Bench, report: Report) -> list[_Scouted]:
    """What every candidate promises, the most promising first."""
    found = []
    for i, candidate in enumerate(possible):
        report(0.5 * i / len(possible), f"trying {candidate.id}")
        cost, values, start = scout(candidate, bench)
        found.append(_Scouted(candidate, cost, values, linear(start, bench)))
    return sorted(found, key=lambda entry: entry.cost)


def _final(bench: Bench, finalists: list[Trial], report: Report) -> tuple[Bench, list[Trial]]:
    """Judge the leading candidates again, with the noise model of the best of them."""
    if not finalists or finalists[0].score.error >= bench.base_score.error:
        return bench, finalists
    # What a parameter that was left out would explain must not count as noise here: all are in.
    sharp = bench.sharpened(finalists[0].full)
    again = []
    for i, trial in enumerate(finalists):
        report(0.8 + 0.2 * i / len(finalists), f"judging {trial.id}")
        again.append(_again(trial, sharp, finalists[0]))
    return sharp, sorted(again, key=lambda t: t.score.error)


def _again(trial: Trial, sharp: Bench, best: Trial) -> Trial:
    """A trial under the finer noise model; what is far behind is not fitted once more."""
    if trial is not best and trial.score.error > _OUT_OF_REACH * best.score.error:
        return replace(trial, score=sharp.judge(trial.fit))
    return try_candidate(trial.candidate, sharp, trial.full.values)


def _judged(bench: Bench, finalists: list[Trial], others: list[Trial], chances: dict[str, float]) -> Round:
    linears = [linear(t.fit, bench) for t in finalists]
    often = [*inclusion(linears).tolist(), *[float("nan")] * len(others)]
    findings = [
        _finding(t, bench, chances.get(t.id, 1.0), share)
        for t, share in zip([*finalists, *others], often, strict=True)
    ]
    findings.sort(key=lambda f: (not f.significant, f.trial.score.error))
    rivals = [f.id for f in findings[1:] if f.significant and _equally_good(findings[0], f, bench)]
    for f in findings[:5]:
        _log.info(
            "%s: normalised error %.3f, p = %.2g, best in %.0f %% of resamples",
            f.id, f.trial.score.error, f.p_value, 100 * f.inclusion,
        )  # fmt: skip
    return Round(bench, findings, rivals)


def _finding(trial: Trial, bench: Bench, p: float, inclusion: float) -> Finding:
    evidence = compare_scores(bench.base_score, trial.score, bench.test)
    strong = p < FALSE_ALARM_RATE and evidence.mean > SMALLEST_FALL
    share = explained(bench.base_score, trial.score, bench.noise_level)
    better = trial.score.error < bench.base_score.error
    return Finding(trial, evidence, share, p, strong and better, inclusion)


def _equally_good(best: Finding, other: Finding, bench: Bench) -> bool:
    """Whether the kept-aside data leave open which of two effects it is."""
    gap = compare_scores(other.trial.score, best.trial.score, bench.test)
    return gap.p_value > FALSE_ALARM_RATE or gap.mean < SMALLEST_FALL
