"""The whole diagnosis: split the data, search, judge, and put it into words and numbers."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from undertow import __version__
from undertow.model.catalogue import Catalogue, catalogue
from undertow.model.vehicle import Vehicle

from ..compare.cutting import cut
from ..compare.windows import predict, prediction_error
from ..logs import Run
from ..weak.data import prepare
from ..weak.fit import WeakFit, mean_square
from ..weak.residual import whitened
from .compensation import Relief, absorbing, reliefs
from .estimates import estimate, estimates
from .excitation import check_excitation
from .finding import Finding
from .remaining import remaining
from .result import Diagnosis, Ranked, RunInfo, Step
from .search import FALSE_ALARM_RATE, Search, search
from .split import keep_blocks_aside
from .trial import Bench, Score, noise_ratio, only_noise
from .verdict import Judgement, judge, unique_ids

Report = Callable[[float, str], None]
Role = Literal["train", "holdout", "blocks"]
HORIZON = 5.0


@dataclass(frozen=True)
class Outcome:
    """A diagnosis with the models it is about.

    Attributes
    ----------
    diagnosis : Diagnosis
        What is written to JSON.
    before, after : Vehicle
        The refitted model as it was, and with the named effects (the same where none is named).
    train, test : list of Run
        What was fitted to, and what was judged by.
    fit : WeakFit
        The fit of `after`.
    """

    diagnosis: Diagnosis
    before: Vehicle
    after: Vehicle
    train: list[Run]
    test: list[Run]
    fit: WeakFit


def diagnose(
    vehicle: Vehicle,
    runs: Sequence[Run],
    holdout: Sequence[Run] = (),
    *,
    known: Catalogue | None = None,
    report: Report = lambda done, words: None,
) -> Outcome:
    """Find out which effect a model lacks, judged on data kept aside.

    Parameters
    ----------
    vehicle : Vehicle
        The model; parameters marked `estimate` are refitted.
    runs : sequence of Run
        Logs to fit to.
    holdout : sequence of Run
        Logs to judge by; without any, stretches of `runs` are kept aside.
    known : mapping, optional
        Effects that may be missing; the whole catalogue by default.
    report : callable
        Told what share is done, and what is being done.

    Raises
    ------
    UndertowError
        If a channel is missing, a log is too short, or nothing moved in it.
    """
    began = time.perf_counter()
    train_runs, test_runs = (list(runs), list(holdout)) if holdout else keep_blocks_aside(runs)
    train = prepare(train_runs, vehicle)
    check_excitation(vehicle, train_runs, train.sigma)
    test = prepare(test_runs, vehicle, sigma=train.sigma)
    found = search(vehicle, train, test, known or catalogue(), lambda done, words: report(0.9 * done, words))
    report(0.9, "judging the result")
    story = _Story(vehicle, found, train_runs, test_runs)
    roles: tuple[Role, Role] = ("train", "holdout") if holdout else ("blocks", "blocks")
    infos = [_info(r, roles[0]) for r in runs] + [_info(r, roles[1]) for r in holdout]
    return story.told(infos, time.perf_counter() - began)


def _info(run: Run, role: Role) -> RunInfo:
    duration = float(run.t[-1] - run.t[0])
    return RunInfo(
        name=run.name,
        source=run.source,
        sha256=run.sha256,
        role=role,
        samples=len(run.t),
        duration=duration,
        notes=list(run.notes),
    )


class _Story:
    """The outcome of a search, judged once more under one noise model for all steps."""

    def __init__(self, vehicle: Vehicle, found: Search, train: list[Run], test: list[Run]) -> None:
        self.vehicle, self.found, self.train, self.test = vehicle, found, train, test
        self.base_fit = found.rounds[0].bench.base
        self.bench: Bench = found.bench
        self.fits = found.steps()
        self.scores: list[Score] = [self.bench.judge(f) for f in self.fits]
        final = self.fits[-1]
        # All models are shown in units of the same noise, that of the sensors alone.
        self.whitening = final.model.whitening(self.bench.test, final.p)
        ends = (self.scores[0], self.scores[-1])
        quiet = only_noise(noise_ratio(self.fits[-1], self.bench.test))
        self.judgement: Judgement = judge(found, ends, self.bench.noise_level, quiet)
        self.windows = cut(test, vehicle, min(HORIZON, _shortest(test)))

    def told(self, infos: list[RunInfo], seconds: float) -> Outcome:
        """The diagnosis."""
        named = self.judgement.effects
        after = self.fits[len(named)] if named else self.base_fit
        diagnosis = Diagnosis(
            undertow=__version__,
            vehicle=self.vehicle.name,
            degrees_of_freedom=list(self.vehicle.degrees_of_freedom),
            signs=self.vehicle.signs,
            runs=infos,
            verdict=self.judgement.verdict,
            headline=self.judgement.headline,
            effects=unique_ids(named),
            ranking=[self._ranked(f) for f in self.found.rounds[0].findings],
            steps=self._steps(),
            indistinguishable=self.judgement.sets,
            warnings=self._warnings(after),
            remaining=remaining(after, self.bench.test),
            parameters=estimates(after, self.vehicle),
            false_alarm_rate=FALSE_ALARM_RATE,
            noise=dict(zip(self.bench.train.names, self.bench.train.sigma.tolist(), strict=True)),
            seconds=seconds,
        )
        return Outcome(diagnosis, self.base_fit.vehicle, after.vehicle, self.train, self.test, after)

    def _normalised(self, fit: WeakFit) -> float:
        r = whitened(fit.model.linearise(self.bench.test, fit.p), self.whitening).r
        return Score(r, mean_square(r, self.bench.test)).error

    def _predicted(self, vehicle: Vehicle) -> float:
        return prediction_error(predict(vehicle, self.windows, compiled=False))

    def _steps(self) -> list[Step]:
        ids = [w.id for w in self.found.winners]
        return [
            Step(added=ids[:i], error=self._normalised(fit), prediction=self._predicted(fit.vehicle))
            for i, fit in enumerate(self.fits)
        ]

    def _ranked(self, finding: Finding) -> Ranked:
        trial, base = finding.trial, self.found.rounds[0].bench.base
        return Ranked(
            effect=finding.id,
            family=trial.candidate.effect.family,
            about=trial.candidate.effect.about(),
            parameters=[estimate(trial.fit, n, self.vehicle) for n in _new_parameters(finding)],
            error_before=self._normalised(base),
            error_after=self._normalised(trial.fit),
            explained=finding.explained,
            improvement=finding.evidence.mean,
            interval=finding.evidence.interval,
            significant=finding.significant,
        )

    def _warnings(self, after: WeakFit) -> list[str]:
        named = tuple(unique_ids(self.judgement.effects))
        claimed = {*named, *(e for s in self.judgement.sets for e in s.effects)}
        helpers = [h for h in reliefs(self.found.rounds[0].findings) if claimed.issuperset(h.effects)]
        if len(named) > 1:
            helpers.append(Relief(named, after.values, min((h.error for h in helpers), default=0.0)))
        return absorbing(self.vehicle, self.base_fit, helpers)


def _new_parameters(finding: Finding) -> tuple[str, ...]:
    own = [p.name for p in finding.trial.candidate.parameters]
    removable = finding.trial.candidate.removable
    return tuple(n for n in own if n in finding.trial.kept or (finding.trial.kept and n not in removable))


def _shortest(runs: Sequence[Run]) -> float:
    return 0.9 * min(float(r.t[-1] - r.t[0]) for r in runs)
