"""One step of the search: all candidates, then the leading ones under a finer noise model."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from undertow.model.catalogue import Catalogue
from undertow.typing import Progress

from ..parallel import mapped
from .candidates import Candidate, possible
from .chance import Linear, best_by_chance, inclusion, p_value
from .evidence import SMALLEST_FALL, as_good, compare_scores, explained
from .finding import Finding
from .linear import linear
from .scouting import Scouted, begun, scouts
from .sending import Sent, received, sent
from .trial import Bench, Score, Trial, rejected, told_apart, try_candidate

_log = logging.getLogger("undertow.diagnosis")

_FULL_FITS = 10
_FINALISTS = 6
# Times that the noise model is made anew because another candidate leads under it.
_LEADERS = 2
# Share of the sum of squares that a step must promise before the leading candidates are known.
_FIRST_LOOK = 1e-2
# Times the mean square of the best candidate, under its noise model, from which another is no rival of it.
_OUT_OF_REACH = 2.0
# Candidates that one step cannot make better than this (chi-square) are not worth a full fit.
_WORTH_A_FIT = 20.0


@dataclass(frozen=True)
class Round:
    """One step of the search: the model so far and what every candidate would do for it.

    Attributes
    ----------
    bench : Bench
        Data, noise model and the model so far.
    findings : list of Finding
        All candidates, best first.
    rivals : list of Finding
        Effects that the data cannot tell from the best one.
    """

    bench: Bench
    findings: list[Finding]
    rivals: list[Finding]

    @property
    def winner(self) -> Finding | None:
        """The best candidate, if the evidence for it is strong enough."""
        best = self.findings[0] if self.findings else None
        return best if best is not None and best.significant else None


def try_all(bench: Bench, known: Catalogue, report: Progress) -> Round:
    """Try every candidate on top of a model.

    Parameters
    ----------
    bench : Bench
        Data, noise model and the model so far.
    known : Catalogue
        Effects that may be missing.
    report : callable
        Told the share done and what is going on.
    """
    vehicle = bench.base.model.functions.vehicle
    scouted = _scouted(possible(vehicle, known, derived=bench.train.velocities_derived), bench, report)
    _log.info("error so far %.3f; %d effects tried", bench.base_score.error, len(scouted))
    by_chance = best_by_chance([s.linear for s in scouted])
    worth = [s for s in scouted if bench.base.cost - s.cost > _WORTH_A_FIT][:_FULL_FITS]
    trials = _tried(worth, bench, report)
    chances = {c.id: p_value(_fall(bench.base_score, t.score), by_chance) for c, t in trials}
    able = ((c, t) for c, t in trials if t.kept or not c.removable)
    leading = sorted(able, key=lambda entry: entry[1].score.error)[:_FINALISTS]
    bench, finalists = _final(bench, [received(t, c, bench) for c, t in leading], report)
    tried = {t.id for t in finalists}
    others = [rejected(s.candidate, bench) for s in scouted if s.candidate.id not in tried]
    return _judged(bench, finalists, others, chances)


def _fall(before: Score, after: Score) -> float:
    return float(np.mean(before.r**2) - np.mean(after.r**2))


class _Look(NamedTuple):
    candidate: Candidate
    cost: float
    starts: list[dict[str, float]]
    linear: Linear


def _scouted(listed: Sequence[Candidate], bench: Bench, report: Progress) -> list[_Look]:
    """What every candidate promises that adds anything, the most promising first."""
    bench.work_out()
    # What has to be searched takes longest: begun first, it leaves no core idle at the end.
    listed = sorted(listed, key=lambda c: not any(p.starts for p in c.effect(()).parameters))
    found = []
    for i, look in enumerate(mapped(lambda i: _look(listed[i], bench), len(listed))):
        report(0.5 * (i + 1) / len(listed), f"tried {listed[i].id}")
        if look is not None:
            found.append(_Look(listed[i], *look))
    return sorted(found, key=lambda entry: entry.cost)


def _tried(worth: Sequence[_Look], bench: Bench, report: Progress) -> list[tuple[Candidate, Sent]]:
    """Fits of the candidates that promise something."""

    def one(i: int) -> Sent:
        candidate = worth[i].candidate
        start = begun(candidate, bench, worth[i].starts, _FIRST_LOOK)
        return sent(try_candidate(candidate, bench, start, _FIRST_LOOK), bench)

    found = []
    for i, trial in enumerate(mapped(one, len(worth))):
        report(0.5 + 0.3 * (i + 1) / len(worth), f"fitted {worth[i].candidate.id}")
        found.append((worth[i].candidate, trial))
    return found


def _look(candidate: Candidate, bench: Bench) -> tuple[float, list[dict[str, float]], Linear] | None:
    if candidate.adds_nothing:
        return None
    looks = scouts(candidate, bench)
    return looks[0].cost, [look.values for look in looks], linear(looks[0].start, bench, looks[0].on_test)


def _final(bench: Bench, finalists: list[Trial], report: Progress) -> tuple[Bench, list[Trial]]:
    """Judge the leading candidates again, with the noise model of the best of them.

    Under the noise model of a poor fit a mediocre candidate may lead, and its own hides less: who leads then
    sets the next.
    """
    if not finalists or finalists[0].score.error >= bench.base_score.error:
        return bench, finalists
    for _ in range(_LEADERS):
        leader = finalists[0]
        # What a parameter that was left out would explain must not count as noise here: all are in.
        bench = bench.sharpened(leader.full)
        again = []
        for i, trial in enumerate(finalists):
            report(0.8 + 0.2 * i / len(finalists), f"judging {trial.id}")
            again.append(_again(trial, bench, leader))
        finalists = sorted(again, key=lambda t: t.score.error)
        if finalists[0].id == leader.id:
            break
    return bench, finalists


def _again(trial: Trial, sharp: Bench, best: Trial) -> Trial:
    """A trial under the finer noise model; what is far behind with all its parameters is not fitted again.

    What the coarser noise model hid of an effect was left out of it, and may be what makes it the right one.
    """
    if trial is not best and _out_of_reach(trial, sharp, best):
        return replace(trial, score=sharp.judge(trial.fit))
    return try_candidate(trial.candidate, sharp, trial.full.values)


def _out_of_reach(trial: Trial, sharp: Bench, best: Trial) -> bool:
    """Whether an effect is far behind the best one, and no step of a fit would change that.

    A rough fit under a coarse noise model may end many standard errors of the finer one from where it
    belongs: a step brings it there.
    """
    left, least = (float(np.mean(sharp.judge(t.full).r ** 2)) for t in (trial, best))
    if left <= _OUT_OF_REACH * least:
        return False
    promised = Scouted(trial.candidate, sharp, trial.full.values).cost / len(sharp.base.at.r)
    return promised > _OUT_OF_REACH * max(least, 1.0)


def _judged(bench: Bench, finalists: list[Trial], others: list[Trial], chances: dict[str, float]) -> Round:
    linears = [linear(t.fit, bench) for t in finalists]
    often = [*inclusion(linears).tolist(), *[float("nan")] * len(others)]
    findings = [
        _finding(t, bench, chances.get(t.id, 1.0), share, len(often))
        for t, share in zip([*finalists, *others], often, strict=True)
    ]
    findings.sort(key=lambda f: (not f.significant, f.trial.score.error))
    best = findings[0].trial.score
    rivals = [f for f in findings[1:] if f.significant and as_good(best, f.trial.score, bench.test)]
    for f in findings[:5]:
        _log.info(
            "%s: normalised error %.3f, p = %.2g, best in %.0f %% of resamples",
            f.id, f.trial.score.error, f.p_value, 100 * f.inclusion,
        )  # fmt: skip
    return Round(bench, findings, rivals)


def _finding(trial: Trial, bench: Bench, p: float, inclusion: float, count: int) -> Finding:
    evidence = compare_scores(bench.base_score, trial.score, bench.test)
    # The bootstrap weighs blocks by what falls in them, the rank test counts them: either may show what the
    # other is blind to, and each gets half of the false alarms.
    chance = min(1.0, 2.0 * min(p, count * evidence.p_value))
    strong = chance < bench.false_alarms and evidence.mean > SMALLEST_FALL
    share = explained(*told_apart(bench.base_score, trial.score, bench.test), bench.noise_level)
    better = trial.score.error < bench.base_score.error
    return Finding(trial, evidence, share, chance, strong and better, inclusion)
