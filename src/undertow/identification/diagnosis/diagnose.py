"""The whole diagnosis: split the data, search, judge, and put it into words and numbers."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from undertow.errors import UndertowError
from undertow.model.catalogue import Catalogue, catalogue
from undertow.model.vehicle import Vehicle
from undertow.typing import Progress

from ..doctor import Examination, examine, refuse_impossible
from ..fitted import Fitted
from ..logs import Run
from ..parallel import aside
from ..weak.data import prepare
from .excitation import check_excitation
from .referee import DECIDING, Referee
from .result import Diagnosis, RunInfo
from .search import search
from .split import keep_blocks_aside
from .story import Story
from .trial import FALSE_ALARM_RATE

Role = Literal["train", "holdout", "blocks"]
HORIZON = DECIDING
# Chances of a false alarm that evidence can be held to: less than the first no bootstrap of 1000 draws shows.
_LEAST_RATE, _MOST_RATE = 0.005, 0.2


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
    fit : Fitted
        The fit of `after`.
    """

    diagnosis: Diagnosis
    before: Vehicle
    after: Vehicle
    train: list[Run]
    test: list[Run]
    fit: Fitted


def diagnose(
    vehicle: Vehicle,
    runs: Sequence[Run],
    holdout: Sequence[Run] = (),
    *,
    known: Catalogue | None = None,
    report: Progress = lambda done, words: None,
    false_alarms: float = FALSE_ALARM_RATE,
    trust_log: bool = False,
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
    false_alarms : float
        Chance of naming an effect where nothing is missing, that the evidence is held to.
    trust_log : bool
        Take logs as they are, also those that `undertow.identification.doctor.refuse_impossible` refuses.

    Raises
    ------
    UndertowError
        If a channel is missing, a log is too short or cannot be, nothing moved in it, or `false_alarms` is
        out of bounds.
    """
    check_false_alarms(false_alarms)
    began = time.perf_counter()
    refuse_impossible(vehicle, [*runs, *holdout], trust_log=trust_log)
    train_runs, test_runs = (list(runs), list(holdout)) if holdout else keep_blocks_aside(runs)
    train = prepare(train_runs, vehicle)
    check_excitation(vehicle, train_runs, train.sigma)
    with aside(lambda: examine(vehicle, [*runs, *holdout]).result) as examined:
        test = prepare(test_runs, vehicle, sigma=train.sigma)
        referee = Referee(vehicle, train_runs, test_runs, train.sigma)
        effects = known or catalogue()
        found = search(
            vehicle,
            train,
            test,
            effects,
            lambda done, words: report(0.9 * done, words),
            referee.quiet,
            false_alarms,
        )
        report(0.9, "judging the result by simulation")
        story = Story(vehicle, found, referee, effects)
        roles: tuple[Role, Role] = ("train", "holdout") if holdout else ("blocks", "blocks")
        infos = [_info(r, roles[0]) for r in runs] + [_info(r, roles[1]) for r in holdout]
        diagnosis = _with_doctor(story.told(infos, time.perf_counter() - began), examined())
    return Outcome(diagnosis, story.given.vehicle, story.after.vehicle, train_runs, test_runs, story.after)


def check_false_alarms(rate: float) -> None:
    """Refuse a chance of false alarms that the evidence cannot be held to.

    Raises
    ------
    UndertowError
        If it is below what 1000 draws can show, or so high that a name would mean little.
    """
    if not _LEAST_RATE <= rate <= _MOST_RATE:
        raise UndertowError(
            f"a chance of false alarms of {rate:g} is not possible: choose one between {_LEAST_RATE:g} and "
            f"{_MOST_RATE:g} ({FALSE_ALARM_RATE:g} by default)"
        )


def _with_doctor(diagnosis: Diagnosis, examined: Examination) -> Diagnosis:
    """The diagnosis with what the doctor found; mistakes come first among the warnings."""
    told = [f"{f.severity}: {f.text}" for f in examined.mistakes]
    ids = ", ".join(f.id for f in examined.mistakes)
    first = [f"First mend what the logs or the vehicle file have wrong: {ids}."] if told else []
    return diagnosis.model_copy(
        update={
            "doctor": examined.findings,
            "warnings": [*told, *diagnosis.warnings],
            "headline": " ".join([*first, diagnosis.headline]),
        }
    )


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
