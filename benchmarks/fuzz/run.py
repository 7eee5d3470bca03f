"""Cases one after the other in processes of their own, which may hang, or die, or take too much memory."""

from __future__ import annotations

import multiprocessing
import os
import resource
import shutil
import tempfile
import time
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import NamedTuple

from .cases import case
from .judging import Outcome, outcome

#: Seconds after which a case counts as hanging; the slowest sound one takes eight, on a busy machine sixty.
LIMIT = 180.0
#: Memory that a case may take, bytes; ten times what the greediest sound one takes.
MEMORY = 6 << 30


class Done(NamedTuple):
    """A case that has come to its end."""

    number: int
    outcome: Outcome
    seconds: float


def one(seed: int, number: int, folder: Path) -> Outcome:
    """What comes of a case, in this process; its files are left in the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    return outcome(case(seed, number), folder)


def results(seed: int, numbers: Sequence[int], jobs: int, limit: float = LIMIT) -> Iterator[Done]:
    """What comes of cases, as they come."""
    waiting = list(numbers)[::-1]
    with tempfile.TemporaryDirectory(prefix="undertow-fuzz-") as name:
        os.environ.update(XDG_CACHE_HOME=name, UNDERTOW_JOBS="1", OMP_NUM_THREADS="1", MPLBACKEND="Agg")
        workers = [_Worker(seed, Path(name)) for _ in range(min(jobs, len(waiting)))]
        try:
            for worker in workers:
                worker.give(waiting.pop())
            while busy := [worker for worker in workers if worker.number is not None]:
                ready = wait([worker.pipe for worker in busy], timeout=0.2)
                for worker in busy:
                    done = worker.answer(limit, heard=worker.pipe in ready)
                    if done is not None:
                        yield done
                        if waiting:
                            worker.give(waiting.pop())
        finally:
            for worker in workers:
                worker.end()


class _Worker:
    """A process that takes one case at a time, begun anew where it hangs or dies."""

    def __init__(self, seed: int, folder: Path) -> None:
        self._seed, self._folder = seed, folder
        self.number: int | None = None
        self._begin()

    def _begin(self) -> None:
        context = multiprocessing.get_context("spawn")  # polars does not live on in a forked process
        self.pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, self._seed, self._folder), daemon=True)
        self._process.start()
        theirs.close()

    def give(self, number: int) -> None:
        self.number, self._since = number, time.monotonic()
        self.pipe.send(number)

    def answer(self, limit: float, heard: bool) -> Done | None:
        """What came of the case, once something has."""
        seconds = time.monotonic() - self._since
        if heard:
            try:
                found = Outcome(*self.pipe.recv())
            except EOFError:
                found = self._anew("the process died")
        elif seconds > limit:
            found = self._anew(f"no answer in {limit:g} s")
        else:
            return None
        number, self.number = self.number, None
        assert number is not None
        return Done(number, found, seconds)

    def _anew(self, words: str) -> Outcome:
        self.end()
        code = self._process.exitcode
        self._begin()
        return Outcome("failed", f"{words} (exit code {code})")

    def end(self) -> None:
        self._process.kill()
        self._process.join()
        self.pipe.close()


def _serve(pipe: Connection, seed: int, place: Path) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    while True:
        try:
            number = pipe.recv()
        except EOFError:
            return
        folder = Path(tempfile.mkdtemp(dir=place))
        found = one(seed, number, folder)
        shutil.rmtree(folder, ignore_errors=True)
        pipe.send(tuple(found))
