"""Running cases side by side, each in a process of its own, one line of JSON for each."""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import subprocess
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, Protocol

from undertow.fleet.engine import Engine, Failure

from .cases import Planned
from .measure import Record, measured

ROOT = Path(__file__).parents[2]
#: Seconds after which a case is given up and recorded as failed.
LIMIT = 1800.0
Work = Callable[[Any], Record]
Progress = Callable[[Record, int], None]


class Job(Protocol):
    """What is run: anything with an id, and with what the record of a failure says of it."""

    @property
    def id(self) -> str:
        """All that makes the case, as one word."""

    @property
    def kind(self) -> str:
        """Kind of case."""

    @property
    def label(self) -> str:
        """What is special about it."""

    @property
    def vehicle(self) -> str:
        """What it is about."""


@dataclass(frozen=True)
class _Running:
    case: Job
    process: BaseProcess
    answer: Connection
    began: float


def run(
    cases: Sequence[Job],
    out: Path,
    work: Work,
    *,
    jobs: int = 1,
    minutes: float | None = None,
    limit: float = LIMIT,
    report: Progress = lambda record, left: None,
    engine: Engine | None = None,
) -> int:
    """Measure cases that are not yet in a file, and append each as one line when it is done."""
    todo = [case for case in cases if case.id not in {r["id"] for r in records(out)}]
    end = time.monotonic() + 60 * minutes if minutes is not None else float("inf")
    failed, left = 0, len(todo)
    commit = version()
    there = engine and _by(engine, todo, work, minutes)
    for record in there or _results(todo, work, jobs, end, limit):
        left -= 1
        append(out, record | {"commit": commit})
        failed += "failure" in record
        report(record, left)
    return failed


def add_run_options(parser: argparse.ArgumentParser) -> None:
    """The options of every command that runs cases: how long, how many at a time, how long each."""
    add = parser.add_argument
    add("--minutes", type=float, metavar="M", help="after so long no case is begun")
    add("--jobs", type=int, default=1, help="cases at a time (default 1)")
    add("--limit", type=float, default=LIMIT, metavar="S", help="s per case (%(default)g)")


def run_limits(options: argparse.Namespace) -> dict[str, Any]:
    """Those options, as `run` takes them."""
    return {"jobs": options.jobs, "minutes": options.minutes, "limit": options.limit}


def records(path: Path) -> list[Record]:
    """The records of a file, of each case the last; a line cut off by a crash is passed over."""
    if not path.exists():
        return []
    found = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        try:
            record = json.loads(line)
        except json.JSONDecodeError:
            continue
        found[record["id"]] = record
    return list(found.values())


def append(path: Path, record: Record) -> None:
    """Write one line, on a line of its own even if the last one was cut off."""
    path.parent.mkdir(parents=True, exist_ok=True)
    whole = not path.exists() or path.read_bytes()[-1:] in (b"", b"\n")
    with path.open("a", encoding="utf-8") as stream:
        stream.write(("" if whole else "\n") + json.dumps(record) + "\n")


def version() -> str:
    """Commit of the working tree, with + where the package differs from it."""
    try:
        commit = _git("rev-parse", "--short", "HEAD")
        return commit + ("+" if _git("status", "--porcelain", "--", "src", "benchmarks") else "")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def _git(*words: str) -> str:
    done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def worker(peers: bool) -> Work:
    """What is done with a case: everything, with or without the other methods."""

    def work(case: Planned) -> Record:
        return measured(case, peers=peers)[0]

    return work


# --- a cluster --------------------------------------------------------------------------------
def _by(engine: Engine, todo: Sequence[Job], work: Work, minutes: float | None) -> Iterator[Record]:
    """Records of cases that a cluster works on; what nobody answers for is a failure."""
    until = time.time() + 60 * minutes if minutes is not None else float("inf")
    for place, answer in engine.results(_in_time, [(work, case, until) for case in todo]):
        if isinstance(answer, Failure):
            yield failure(todo[place], answer.words)
        elif answer is not None:
            yield answer


def _in_time(work: Work, case: Job, until: float) -> Record | None:
    """The record of a case; None where the time is over before it is begun."""
    if time.time() > until:
        return None
    try:
        return work(case)
    except Exception as error:
        return failure(case, f"{type(error).__name__}: {error}", traceback.format_exc())


# --- processes --------------------------------------------------------------------------------
def _results(todo: Sequence[Job], work: Work, jobs: int, end: float, limit: float) -> Iterator[Record]:
    waiting, running = list(todo), list[_Running]()
    while running or (waiting and time.monotonic() < end):
        while waiting and len(running) < jobs and time.monotonic() < end:
            running.append(_begun(waiting.pop(0), work, alone=jobs == 1))
        wait([r.answer for r in running], timeout=1.0)
        for one in [r for r in running if _over(r, limit)]:
            running.remove(one)
            yield _record(one, limit)


def _begun(case: Job, work: Work, *, alone: bool) -> _Running:
    # Forked: the imports are there already, and a case that crashes takes nothing with it.
    context = multiprocessing.get_context("fork")
    answer, speak = context.Pipe(duplex=False)
    # Only what is no daemon may have helpers of its own.
    process = context.Process(target=_do, args=(work, case, speak, alone), daemon=not alone)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of forks beside threads: none of ours run
        process.start()
    speak.close()
    return _Running(case, process, answer, time.monotonic())


def _do(work: Work, case: Job, speak: Connection, alone: bool) -> None:
    """One case: on all cores where it is alone, else on one."""
    if not alone:
        os.environ["UNDERTOW_JOBS"] = "1"
    try:
        record = work(case)
    except Exception as error:
        record = failure(case, f"{type(error).__name__}: {error}", traceback.format_exc())
    speak.send(record)


def _over(one: _Running, limit: float) -> bool:
    return one.answer.poll() or not one.process.is_alive() or time.monotonic() - one.began > limit


def _record(one: _Running, limit: float) -> Record:
    """The answer of a process; of one that died or takes too long, that it did."""
    if one.answer.poll():
        try:
            record = one.answer.recv()
            one.process.join()
        except EOFError:
            one.process.join()
            record = failure(one.case, f"the process ended with code {one.process.exitcode}")
        return record
    alive = one.process.is_alive()
    one.process.terminate()
    one.process.join()
    words = f"took more than {limit:g} s" if alive else f"the process ended with code {one.process.exitcode}"
    return failure(one.case, words)


def failure(case: Job, words: str, details: str = "") -> Record:
    """The record of a case that could not be measured."""
    return {
        "id": case.id,
        "kind": case.kind,
        "label": case.label,
        "vehicle": case.vehicle,
        "failure": words,
        "details": details[-4000:],
    }
