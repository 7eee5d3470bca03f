"""Applying a function to many items: in this process, or by Dask on a cluster; it always terminates."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from queue import Empty, SimpleQueue
from typing import Any, Protocol
from uuid import uuid4

from undertow.errors import UndertowError

INSTALL = 'pip install "undertow[fleet]"'
#: Where a cluster of this machine can be reached. Dask runs whatever code it is sent, so nobody outside can.
LISTEN = "127.0.0.1"


@dataclass(frozen=True)
class Timeouts:
    """Time limits for a cluster, s, and its batch size."""

    patience: float = 900.0  # without any answer; then what is left is given up
    scheduler: float = 10.0  # for an answer of the scheduler
    workerless: float = 30.0  # for a first worker
    poll: float = 1.0  # between two looks at the cluster
    tasks: int = 3  # for each worker that wait at the scheduler: few, so that it does not grow with the fleet


TIMEOUTS = Timeouts()

Items = Sequence[tuple[Any, ...]]
Results = Iterator[tuple[int, Any]]


@dataclass(frozen=True)
class Failure:
    """Why there is no result for an item, in one line."""

    words: str


class Engine(Protocol):
    """Applies a function to items."""

    def results(self, function: Callable[..., Any], items: Items) -> Results:
        """Place and result of every item as they come; a `Failure` where there is none."""


class InProcess:
    """This process, one item after the other."""

    def results(self, function: Callable[..., Any], items: Items) -> Results:
        for place, item in enumerate(items):
            yield place, guarded(function, *item)


def guarded(function: Callable[..., Any], *arguments: Any) -> Any:
    """The result of a function, or why there is none: one bad item stops no other."""
    try:
        return function(*arguments)
    except UndertowError as error:
        return Failure(str(error))
    except Exception as error:
        return Failure(_in_one_line(error))


class DaskEngine:
    """A cluster of Dask."""

    def __init__(self, client: Any, patience: float = TIMEOUTS.patience) -> None:
        self.client, self._patience = client, patience

    def results(self, function: Callable[..., Any], items: Items) -> Results:
        waiting, running = list(enumerate(items))[::-1], dict[Any, int]()
        token, last_reply, finished = uuid4().hex[:12], time.monotonic(), SimpleQueue[Any]()
        try:
            while waiting or running:
                room = TIMEOUTS.tasks * max(self._workers(), 1) - len(running)
                for _ in range(min(len(waiting), room)):
                    place, item = waiting.pop()
                    key = f"undertow-{token}-{place}"
                    future = self.client.submit(guarded, function, *item, key=key, pure=False)
                    running[future] = place
                    future.add_done_callback(finished.put)
                done = _next(finished)
                if done is not None:
                    last_reply = time.monotonic()
                    yield running.pop(done), self._answer(done)
                elif lost := self._lost(time.monotonic() - last_reply):
                    left = sorted([*running.values(), *(place for place, _ in waiting)])
                    yield from ((place, Failure(lost)) for place in left)
                    return
        finally:
            if running and self.client.status == "running":
                self.client.cancel(list(running), force=True)

    def _workers(self) -> int:
        if self.client.status != "running":
            return 0
        try:
            return len(self.client.sync(self.client.scheduler.ncores, callback_timeout=TIMEOUTS.scheduler))
        except (OSError, TimeoutError):  # client.nthreads() would wait for a scheduler that is stuck
            return 0

    def _answer(self, future: Any) -> Any:
        if future.status in ("cancelled", "lost"):
            return Failure("the cluster dropped it")
        try:
            return future.result(timeout=self._patience)  # it may be worked out again if its worker died
        except Exception as error:  # the worker died with it, again and again
            return Failure(_in_one_line(error))

    def _lost(self, silent: float) -> str:
        """Why no more results can arrive; empty while they can."""
        if self.client.status not in ("running", "connecting"):
            return "the scheduler was lost"
        if silent > TIMEOUTS.workerless and not self._workers():
            return f"the cluster has had no worker for {TIMEOUTS.workerless:g} s"
        return f"no answer of any worker for {self._patience:g} s" if silent > self._patience else ""


def _next(finished: SimpleQueue[Any]) -> Any:
    try:
        return finished.get(timeout=TIMEOUTS.poll)
    except Empty:
        return None


def _in_one_line(error: Exception) -> str:
    if type(error).__name__ == "KilledWorker":
        return "it killed several workers (out of memory?)"
    return f"{type(error).__name__}: {' '.join(str(error).split())[:300]}"


@contextmanager
def engine(
    scheduler: str | None = None,
    workers: int | None = None,
    patience: float = TIMEOUTS.patience,
    listen: str | None = None,
) -> Iterator[Engine]:
    """Something that does the work."""
    if listen is not None and (workers == 0 or scheduler is not None):
        other = "--workers 0 starts none" if scheduler is None else "--scheduler names a different one"
        raise UndertowError(f"--listen {listen} is for a local cluster, but {other}: leave out one of them")
    if workers == 0 and scheduler is None:
        yield InProcess()
        return
    if find_spec("distributed") is None:
        raise UndertowError(
            f"fleets need Dask, which is not installed: {INSTALL}, or give --workers 0 to "
            "work in this process"
        )
    with _client(scheduler, workers, LISTEN if listen is None else listen) as client:
        yield DaskEngine(client, patience)


@contextmanager
def _client(scheduler: str | None, workers: int | None, listen: str) -> Iterator[Any]:
    import dask
    import distributed  # noqa: F401  # first: it adds settings, which would go when ours are put back

    # The profiler of workers looks at them a hundred times a second, which doubles the time of this work.
    settings = {
        "distributed.comm.timeouts.connect": f"{TIMEOUTS.scheduler:g}s",
        "distributed.worker.profile.enabled": False,
    }
    with dask.config.set(settings):
        if scheduler is None:
            with _local(workers, listen) as cluster, _connected(cluster, "of this machine") as client:
                yield client
        else:
            with _connected(scheduler, f"at '{scheduler}'") as client:
                yield client


@contextmanager
def _local(workers: int | None, listen: str) -> Iterator[Any]:
    import logging

    from distributed import LocalCluster

    _check_own(listen)
    count = workers or os.cpu_count() or 1
    try:
        cluster = LocalCluster(
            n_workers=count,
            threads_per_worker=1,
            processes=True,
            host=listen,
            dashboard_address=None,
            # Dask opens its page even so, by default at a port that another cluster of this machine may have.
            scheduler_kwargs={"dashboard_address": f"{LISTEN}:0"},
            silence_logs=logging.CRITICAL,
        )
    except (OSError, RuntimeError, TimeoutError) as error:
        raise UndertowError(
            f"no cluster of {count} processes can be started here ({' '.join(str(error).split())[:200]}): "
            "use fewer (--workers), or --workers 0 for this process"
        ) from error
    with cluster:
        yield cluster


@contextmanager
def _connected(address: Any, where: str) -> Iterator[Any]:
    from distributed import Client
    from distributed.comm.addressing import parse_address, parse_host_port
    from distributed.comm.registry import get_backend

    client = Client.__new__(Client)
    try:
        # Refuse what cannot be an address before Dask begins to look for it.
        if isinstance(address, str):
            scheme, place = parse_address(address)
            get_backend(scheme)
            parse_host_port(place)
        Client.__init__(client, address, timeout=TIMEOUTS.scheduler, set_as_default=False)
    except (OSError, ValueError, TypeError, TimeoutError, ImportError) as error:
        client.status = "closed"  # Dask would wait, at some later time, for what never began
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise UndertowError(
            f"the Dask scheduler {where} does not answer ({reason}): start one with `dask scheduler`, and "
            "give its address such as tcp://10.0.0.1:8786"
        ) from error
    try:
        yield client
    finally:
        client.close(timeout=TIMEOUTS.scheduler)


def _check_own(address: str) -> None:
    """Refuse to listen at what is no address of this machine; an empty one would be every address."""
    try:
        with socket.socket() as probe:
            probe.bind((address or " ", 0))
    except (OSError, UnicodeError, TypeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise UndertowError(
            f"this machine cannot listen on '{address}' ({reason.lower()}): give one of its own IPv4 "
            f"addresses, or leave out --listen for {LISTEN}"
        ) from error
