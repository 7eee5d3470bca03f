"""Independent tasks on all cores, with the same results in the same order as sequentially."""

from __future__ import annotations

import logging
import multiprocessing
import signal
import sys
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Any, TypeVar

from undertow.codegen.engine import processors

T = TypeVar("T")
_log = logging.getLogger("undertow")
# What the children of this process work on: they inherit it, for models cannot be sent.
_work: list[Callable[[int], Any]] = []


def jobs() -> int:
    """Processes to use: the cores that this process may use, or what UNDERTOW_JOBS says.

    One where processes cannot share memory (all systems but Linux), and in a worker process.
    """
    if sys.platform != "linux" or _work or multiprocessing.current_process().daemon:
        return 1
    return processors()


def mapped(work: Callable[[int], T], count: int) -> Iterator[T]:
    """`work(0)` to `work(count - 1)` in this order; results travel between processes."""
    processes = min(jobs(), count)
    if processes < 2:
        yield from map(work, range(count))
        return
    done = 0
    try:
        with _running(work, count, processes) as futures:
            for future in futures:
                yield future.result()
                done += 1
    except BrokenProcessPool:
        # Killed from outside, for want of memory perhaps: one at a time needs less.
        _log.warning(
            "a worker process was killed; continuing with one process (UNDERTOW_JOBS=1 starts with one)"
        )
        yield from map(work, range(done, count))


@contextmanager
def in_background(work: Callable[[], T]) -> Iterator[Callable[[], T]]:
    """Run a task on another core while the block runs; the object yielded waits for its result."""
    if jobs() < 2:
        found = work()
        yield lambda: found
        return
    with _running(lambda _: work(), 1, 1) as (future,):
        yield lambda: _result_or_repeat(future, work)


def _result_or_repeat(future: Future[T], work: Callable[[], T]) -> T:
    try:
        return future.result()
    except BrokenProcessPool:
        return work()


def _run_task(task: int) -> Any:
    return _work[-1](task)


@contextmanager
def _running(work: Callable[[int], T], count: int, processes: int) -> Iterator[list[Future[T]]]:
    pool = ProcessPoolExecutor(processes, multiprocessing.get_context("fork"), _initialise_worker)
    _work.append(work)
    try:
        with warnings.catch_warnings():
            # Other threads of this process only draw a progress bar; children do not touch it.
            warnings.filterwarnings("ignore", "This process .* is multi-threaded", DeprecationWarning)
            futures = [pool.submit(_run_task, i) for i in range(count)]
    finally:
        _work.pop()
    try:
        yield futures
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def _initialise_worker() -> None:
    """In a child process: no output, and interrupts are left to the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    logging.disable()


__all__ = ["in_background", "jobs", "mapped"]
