"""The search for what is missing: all candidates, the leading ones under a finer noise model, then the next
effect.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from undertow.model.catalogue import Catalogue
from undertow.model.vehicle import Vehicle

from ..weak.data import WeakData
from ..weak.fit import WeakFit, free_parameters
from .candidates import Candidate, candidates
from .evidence import Comparison, compare_scores, explained
from .trial import Bench, Trial, noise_ratio, only_noise, open_bench, rejected, scout, try_candidate

_log = logging.getLogger("undertow.diagnosis")
Report = Callable[[float, str], None]

FALSE_ALARM_RATE = 0.01
# An effect that takes away less than this share of the noise's own mean square is hidden in the noise.
SMALLEST_FALL = 0.05
MAX_EFFECTS = 3
_FULL_FITS = 8
_FINALISTS = 6
# Candidates that one step cannot make better than this (chi-square) are not worth a full fit.
_WORTH_A_FIT = 20.0


@dataclass(frozen=True)
class Finding:
    """A candidate with the evidence for it."""

    trial: Trial
    evidence: Comparison
    explained: float
    significant: bool

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
    worth = [(c, start) for c, cost, start in scouted if bench.base.cost - cost > _WORTH_A_FIT][:_FULL_FITS]
    trials = []
    for i, (candidate, start) in enumerate(worth):
        report(0.5 + 0.3 * i / len(worth), f"fitting {candidate.id}")
        trials.append(try_candidate(candidate, bench, start))
    finalists = sorted(
        (t for t in trials if t.kept or not t.candidate.removable), key=lambda t: t.score.error
    )
    bench, finalists = _final(bench, finalists[:_FINALISTS], report)
    tried = {t.id for t in finalists}
    others = [rejected(c, bench) for c in possible if c.id not in tried]
    return _judged(bench, finalists + others, len(possible))


def _scouted(
    possible: Sequence[Candidate], bench: Bench, report: Report
) -> list[tuple[Candidate, float, dict[str, float]]]:
    found = []
    for i, candidate in enumerate(possible):
        report(0.5 * i / len(possible), f"trying {candidate.id}")
        found.append((candidate, *scout(candidate, bench)))
    return sorted(found, key=lambda entry: entry[1])


def _final(bench: Bench, finalists: list[Trial], report: Report) -> tuple[Bench, list[Trial]]:
    """Judge the leading candidates again, with the noise model of the best of them."""
    if not finalists or finalists[0].score.error >= bench.base_score.error:
        return bench, finalists
    sharp = bench.sharpened(finalists[0].fit)
    again = []
    for i, trial in enumerate(finalists):
        report(0.8 + 0.2 * i / len(finalists), f"judging {trial.id}")
        again.append(try_candidate(trial.candidate, sharp, trial.fit.values))
    return sharp, sorted(again, key=lambda t: t.score.error)


def _judged(bench: Bench, trials: list[Trial], count: int) -> Round:
    findings = [_finding(t, bench, count) for t in sorted(trials, key=lambda t: t.score.error)]
    findings.sort(key=lambda f: (not f.significant, f.trial.score.error))
    rivals = [f.id for f in findings[1:] if f.significant and _equally_good(findings[0], f, bench)]
    for f in findings[:5]:
        _log.info("%s: normalised error %.3f, p = %.2g", f.id, f.trial.score.error, f.evidence.p_value)
    return Round(bench, findings, rivals)


def _finding(trial: Trial, bench: Bench, count: int) -> Finding:
    evidence = compare_scores(bench.base_score, trial.score, bench.test)
    strong = evidence.p_value < FALSE_ALARM_RATE / count and evidence.mean > SMALLEST_FALL
    share = explained(bench.base_score, trial.score, bench.noise_level)
    return Finding(trial, evidence, share, strong and trial.score.error < bench.base_score.error)


def _equally_good(best: Finding, other: Finding, bench: Bench) -> bool:
    """Whether the kept-aside data leave open which of two effects it is."""
    gap = compare_scores(other.trial.score, best.trial.score, bench.test)
    return gap.p_value > FALSE_ALARM_RATE or gap.mean < SMALLEST_FALL
