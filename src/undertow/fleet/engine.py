"""Doing one thing to many items: in this process, or by Dask on a cluster; it always comes to an end."""

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
#: Seconds without any answer after which what is left is given up.
PATIENCE = 900.0
#: Where a cluster of this machine can be reached. Dask runs whatever code it is sent, so nobody outside can.
LISTEN = "127.0.0.1"
# Seconds that a scheduler has for an answer, and a cluster without a single worker for getting one.
_REACH, _WORKERLESS = 10.0, 30.0
# Tasks for each worker that wait at the scheduler: few, so that it does not grow with the fleet.
_AHEAD = 3
_POLL = 1.0


@dataclass(frozen=True)
class Failure:
    """Why there is no result for an item, in one line."""

    words: str


class Engine(Protocol):
    """Applies a function to items."""

    def results(
        self, function: Callable[..., Any], items: Sequence[tuple[Any, ...]]
    ) -> Iterator[tuple[int, Any]]:
        """Place and result of every item as they come; a `Failure` where there is none."""


class Here:
    """This process, one item after the other."""

    def results(
        self, function: Callable[..., Any], items: Sequence[tuple[Any, ...]]
    ) -> Iterator[tuple[int, Any]]:
        for place, item in enumerate(items):
            yield place, guarded(function, *item)


def guarded(function: Callable[..., Any], *arguments: Any) -> Any:
    """The result of a function, or why there is none: one bad item stops no other."""
    try:
        return function(*arguments)
    except UndertowError as error:
        return Failure(str(error))
    except Exception as error:
        return Failure(f"{type(error).__name__}: {' '.join(str(error).split())[:300]}")


class OnDask:
    """A cluster of Dask."""

    def __init__(self, client: Any, patience: float = PATIENCE) -> None:
        self.client, self._patience = client, patience

    def results(
        self, function: Callable[..., Any], items: Sequence[tuple[Any, ...]]
    ) -> Iterator[tuple[int, Any]]:
        waiting, running = list(enumerate(items))[::-1], dict[Any, int]()
        token, heard, finished = uuid4().hex[:12], time.monotonic(), SimpleQueue[Any]()
        try:
            while waiting or running:
                for place, item in _taken(waiting, self._room() - len(running)):
                    future = self._begun(function, item, f"{token}-{place}")
                    running[future] = place
                    future.add_done_callback(finished.put)
                done = _next(finished)
                if done is not None:
                    heard = time.monotonic()
                    yield running.pop(done), self._answer(done)
                elif lost := self._lost(time.monotonic() - heard):
                    left = sorted([*running.values(), *(place for place, _ in waiting)])
                    yield from ((place, Failure(lost)) for place in left)
                    return
        finally:
            if running and self.client.status == "running":
                self.client.cancel(list(running), force=True)

    def _begun(self, function: Callable[..., Any], item: tuple[Any, ...], name: str) -> Any:
        return self.client.submit(guarded, function, *item, key=f"undertow-{name}", pure=False)

    def _room(self) -> int:
        return _AHEAD * max(self._workers(), 1)

    def _workers(self) -> int:
        if self.client.status != "running":
            return 0
        try:
            return len(self.client.sync(self.client.scheduler.ncores, callback_timeout=_REACH))
        except (OSError, TimeoutError):  # client.nthreads() would wait for a scheduler that is stuck
            return 0

    def _answer(self, future: Any) -> Any:
        if future.status in ("cancelled", "lost"):
            return Failure("the cluster dropped it")
        try:
            return future.result(timeout=self._patience)  # it may be worked out again if its worker died
        except Exception as error:  # the worker died with it, again and again
            return Failure(_told(error))

    def _lost(self, silent: float) -> str:
        """Why nothing more is to be expected; empty while there is hope."""
        if self.client.status not in ("running", "connecting"):
            return "the scheduler was lost"
        if silent > _WORKERLESS and not self._workers():
            return f"the cluster has had no worker for {_WORKERLESS:g} s"
        return f"no answer of any worker for {self._patience:g} s" if silent > self._patience else ""


def _taken(waiting: list[Any], most: int) -> list[Any]:
    """Up to so many from the end of a list, which loses them."""
    return [waiting.pop() for _ in range(min(most, len(waiting)))]


def _next(finished: SimpleQueue[Any]) -> Any:
    try:
        return finished.get(timeout=_POLL)
    except Empty:
        return None


def _told(error: Exception) -> str:
    if type(error).__name__ == "KilledWorker":
        return "workers died of it again and again (out of memory?)"
    return f"{type(error).__name__}: {' '.join(str(error).split())[:300]}"


@contextmanager
def engine(
    scheduler: str | None = None,
    workers: int | None = None,
    patience: float = PATIENCE,
    listen: str | None = None,
) -> Iterator[Engine]:
    """Something that does the work."""
    if listen is not None and (workers == 0 or scheduler is not None):
        other = "--workers 0 starts none" if scheduler is None else "--scheduler names another one"
        raise UndertowError(f"--listen {listen} is for a cluster of this machine, and {other}: leave one out")
    if workers == 0 and scheduler is None:
        yield Here()
        return
    if find_spec("distributed") is None:
        raise UndertowError(
            f"a fleet is worked through by Dask, which is not installed: {INSTALL}, or give --workers 0 to "
            "work in this process"
        )
    with _client(scheduler, workers, LISTEN if listen is None else listen) as client:
        yield OnDask(client, patience)


@contextmanager
def _client(scheduler: str | None, workers: int | None, listen: str) -> Iterator[Any]:
    import dask
    import distributed  # noqa: F401  # first: it adds settings, which would go when ours are put back

    # The profiler of workers looks at them a hundred times a second, which doubles the time of this work.
    settings = {
        "distributed.comm.timeouts.connect": f"{_REACH:g}s",
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
            "take fewer (--workers), or --workers 0 for this process"
        ) from error
    with cluster:
        yield cluster


@contextmanager
def _connected(address: Any, where: str) -> Iterator[Any]:
    from distributed import Client

    client = Client.__new__(Client)
    try:
        _check_address(address)
        Client.__init__(client, address, timeout=_REACH, set_as_default=False)
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
        client.close(timeout=_REACH)


def _check_own(address: str) -> None:
    """Refuse to listen at what is no address of this machine; an empty one would be every address."""
    try:
        with socket.socket() as probe:
            probe.bind((address or " ", 0))
    except (OSError, UnicodeError, TypeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise UndertowError(
            f"this machine cannot listen on '{address}' ({reason.lower()}): give one of its own IPv4 "
            f"addresses, or leave --listen out for {LISTEN}"
        ) from error


def _check_address(address: Any) -> None:
    """Refuse what cannot be an address before Dask begins to look for it."""
    from distributed.comm.addressing import parse_address, parse_host_port
    from distributed.comm.registry import get_backend

    if isinstance(address, str):
        scheme, place = parse_address(address)
        get_backend(scheme)
        parse_host_port(place)
