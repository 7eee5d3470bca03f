"""A fleet's logs: found, reduced where that is not done yet, put together for each vehicle and month."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from undertow.errors import UndertowError
from undertow.identification.weak.step import bounds_of, physical
from undertow.typing import Progress

from .changes import Changes
from .combine import Day, choosing, days_of, solve
from .engine import Engine, Failure
from .panel import Panel
from .partitions import Partition, find, twins
from .reduction import Job, looked_at, marked, panel_of, reduce_log
from .result import Fleet
from .store import Store
from .summary import Vehicles, summarised

PLACE = "{vehicle}"
# What may stand for a vehicle in the path of its file: it leads to no other folder.
_NAME = re.compile(r"(?!\.\.?$)[^/\\\0]+")
_NO_NAME = "'{}' is no name that a file may have: rename the vehicle, or give one file for all vehicles"


@dataclass(frozen=True)
class Question:
    """What is asked of which logs.

    Attributes
    ----------
    patterns : sequence of str
        Patterns of Parquet files.
    job : Job
        What is done with every log; `{vehicle}` in its vehicle file stands for the name of each vehicle.
    passes : int
        How often the model is linearised, each time at what was found before.
    """

    patterns: Sequence[str]
    job: Job
    passes: int = 1


@dataclass
class _Known:
    """What is known of the files so far."""

    partitions: dict[Partition, str] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)
    worked: set[Path] = field(default_factory=set)


def diagnose(
    question: Question, engine: Engine, store: Store, tell: Progress = lambda done, words: None
) -> Fleet:
    """Estimates, changes and scores of every vehicle.

    A file that cannot be used, or whose worker is lost, is named in the answer; all others count. What was
    worked out is kept in the store, and only what is missing there is done.

    Parameters
    ----------
    question : Question
        What is asked.
    engine : Engine
        Who does the work.
    store : Store
        Where results of partitions are kept.
    tell : callable
        Told what share is done, and what is being done.

    Raises
    ------
    UndertowError
        If no file fits a pattern, a vehicle file is bad, or not one file can be used.
    """
    paths = find(question.patterns)
    known = _looked_at(paths, question.job, engine, tell)
    same = twins(known.partitions.items())
    for partition in same:
        del known.partitions[partition]
    jobs = _jobs(question.job, sorted({p.vehicle for p in known.partitions}))
    done: Vehicles = {}
    for turn in range(question.passes):
        tell(0.05, f"reducing, pass {turn + 1} of {question.passes}")
        done = _reduced(jobs, known, engine, store, lambda share, words: tell(0.05 + 0.9 * share, words))
        if turn + 1 < question.passes:
            jobs = {v: _moved(jobs[v], *done[v]) for v in done}
    _refuse_nothing(done, known, len(paths))
    tell(0.95, "putting months together")
    found = summarised(done)
    return replace(
        found,
        failed=dict(sorted(known.failed.items())),
        twins={str(p.path): str(other.path) for p, other in same.items()},
        done=len(known.partitions),
        found=len(paths),
        worked=sum(p.path in known.worked for p in known.partitions),
    )


def _looked_at(paths: Sequence[Path], job: Job, engine: Engine, tell: Progress) -> _Known:
    known = _Known()
    items = [(str(p), job.mapping) for p in paths]
    for count, (place, answer) in enumerate(engine.results(looked_at, items), start=1):
        tell(0.05 * count / len(paths), "looking at files")
        if isinstance(answer, Failure):
            known.failed[str(paths[place])] = answer.words
        else:
            partition, sha256 = answer
            if PLACE in job.vehicle and not _NAME.fullmatch(partition.vehicle):
                known.failed[str(partition.path)] = _NO_NAME.format(partition.vehicle)
            else:
                known.partitions[partition] = sha256
    known.partitions = dict(sorted(known.partitions.items()))
    return known


def _jobs(job: Job, vehicles: Sequence[str]) -> dict[str, Job]:
    """The job of every vehicle, with the fingerprint of its model."""
    found: dict[str, Job] = {}
    by_source: dict[str, Job] = {}
    for vehicle in vehicles:
        source = job.vehicle.replace(PLACE, vehicle)
        if source not in by_source:
            by_source[source] = marked(replace(job, vehicle=source))[0]
        found[vehicle] = by_source[source]
    return found


def _reduced(
    jobs: Mapping[str, Job], known: _Known, engine: Engine, store: Store, tell: Progress
) -> Vehicles:
    """Work out what is not known yet; then all that is known, in the order of vehicles, days and files."""
    missing = [
        (p, h) for p, h in known.partitions.items() if store.get(jobs[p.vehicle].fingerprint, h) is None
    ]
    items = [(jobs[p.vehicle], str(p.path), sha256) for p, sha256 in missing]
    for count, (place, answer) in enumerate(engine.results(reduce_log, items), start=1):
        partition, sha256 = missing[place]
        tell(count / len(missing), f"{count} of {len(missing)}: {partition.name}")
        if isinstance(answer, Failure):
            known.failed[str(partition.path)] = answer.words
            del known.partitions[partition]
        else:
            store.put(jobs[partition.vehicle].fingerprint, sha256, answer)
            known.worked.add(partition.path)
    return {v: (panel_of(job), _days(v, job, known, store)) for v, job in jobs.items() if _has(v, known)}


def _has(vehicle: str, known: _Known) -> bool:
    return any(p.vehicle == vehicle for p in known.partitions)


def _days(vehicle: str, job: Job, known: _Known, store: Store) -> list[Day]:
    parts = []
    for partition, sha256 in known.partitions.items():
        if partition.vehicle == vehicle:
            reduced = store.get(job.fingerprint, sha256)
            if reduced is None:
                raise UndertowError(f"'{store.folder}' loses what is written to it: choose another folder")
            parts.append((partition.day, reduced))
    return days_of(parts)


def _moved(job: Job, panel: Panel, days: Sequence[Day]) -> Job:
    """The job linearised at what all days of a vehicle say."""
    changes = Changes(panel)
    found = solve(days, [choosing(panel.names, panel.free)] * len(days), changes.prior)
    model = panel.base
    p, places, bounds = np.array(model.functions.values(), dtype=float), list(model.places), bounds_of(model)
    p[places] = np.clip(p[places] + found.theta, *bounds)
    p = physical(model, p, bounds)
    values: tuple[tuple[str, Any], ...] = tuple(zip(panel.free, p[places].tolist(), strict=True))
    return marked(replace(job, values=values))[0]


def _refuse_nothing(done: Vehicles, known: _Known, count: int) -> None:
    if done:
        return
    path, words = next(iter(sorted(known.failed.items())))
    told = words if path in words else f"{path}: {words}"
    raise UndertowError(f"none of {count} files could be used; {told}" if count > 1 else told)
