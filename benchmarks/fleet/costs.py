"""What working through logs costs: in one process, on one worker, on two; time and memory."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import date, timedelta
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from undertow.fleet.engine import DaskEngine, Engine, Failure, InProcess, engine
from undertow.fleet.reduction import Job, Reduced, panel_of, reduce_log, with_fingerprint

from .made import folder_with_vehicle, write


@dataclass(frozen=True)
class Material:
    """Logs of equal length."""

    job: Job
    paths: tuple[str, ...]
    rows: int

    @property
    def total(self) -> int:
        """Rows in all logs."""
        return self.rows * len(self.paths)


@contextmanager
def material(logs: int, rows: int) -> Iterator[Material]:
    """So many logs of so many rows, in a folder that goes away."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        vehicle = folder_with_vehicle(folder)
        first = date(2026, 1, 1)
        days: list[tuple[date, dict[str, float]]] = [(first + timedelta(days=i), {}) for i in range(logs)]
        write(folder / "logs", vehicle, "one", days, seconds=rows // 10)
        paths = tuple(str(p) for p in sorted((folder / "logs").rglob("*.parquet")))
        yield Material(with_fingerprint(Job(str(vehicle)))[0], paths, rows // 10 * 10 + 1)


@contextmanager
def ready(given: Material, workers: int) -> Iterator[Engine]:
    """An engine whose workers have their model; none works in this process."""
    if not workers:
        panel_of(given.job)
        yield InProcess()
        return
    with engine(workers=workers) as doing:
        assert isinstance(doing, DaskEngine)
        doing.client.run(_warm, given.job, given.paths[0])
        yield doing


def _warm(job: Job, path: str) -> None:
    reduce_log(job, path)


def worked(given: Material, doing: Engine) -> list[Reduced]:
    """All logs reduced, in their order."""
    found = dict(doing.results(reduce_log, [(given.job, path) for path in given.paths]))
    bad = [answer.words for answer in found.values() if isinstance(answer, Failure)]
    assert not bad, bad[0]
    return [found[i] for i in range(len(given.paths))]


def apart(one: list[Reduced], other: list[Reduced]) -> float:
    """Largest distance of factors, as a share of the largest entry."""
    return max(
        float(np.max(np.abs(a.factor - b.factor)) / np.max(np.abs(b.factor)))
        for a, b in zip(one, other, strict=True)
    )


def seconds(work: Callable[[], object], rounds: int = 3) -> float:
    """Time of the fastest of some rounds."""
    times = []
    for _ in range(rounds):
        began = time.perf_counter()
        work()
        times.append(time.perf_counter() - began)
    return min(times)


def peak(job: Job, path: str) -> tuple[float, float]:
    """Memory before a log and the peak after it, MB, as the process that does it sees them."""
    panel_of(job)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    reduce_log(job, path)
    return before, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def peak_of_worker(rows: int) -> tuple[float, float]:
    """`peak` of one log of so many rows, in a worker that has done nothing before."""
    with material(1, rows) as given, engine(workers=1) as doing:
        ((_, found),) = doing.results(peak, [(given.job, given.paths[0])])
        assert not isinstance(found, Failure), found.words
        return found
