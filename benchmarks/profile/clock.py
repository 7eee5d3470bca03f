"""A clock that is told which stage begins, and a sampler that looks where the processor is."""

from __future__ import annotations

import os
import signal
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

INTERVAL = 0.002
"""Seconds of processor time between two looks."""
_PACKAGE = os.sep + "undertow" + os.sep


class Clock:
    """Adds up wall and processor seconds of stages; each lasts until the next begins."""

    def __init__(self) -> None:
        self.wall: dict[str, float] = defaultdict(float)
        self.cpu: dict[str, float] = defaultdict(float)
        self.stage, self._since = "", (time.perf_counter(), processor_seconds())

    def begin(self, stage: str) -> str:
        """From now on it is this stage; the one before is returned."""
        now, before = (time.perf_counter(), processor_seconds()), self.stage
        self.wall[before] += now[0] - self._since[0]
        self.cpu[before] += now[1] - self._since[1]
        self.stage, self._since = stage, now
        return before

    def during(self, stage: str, action: Callable[..., Any]) -> Callable[..., Any]:
        """The action as a stage of its own."""

        def timed(*given: Any, **named: Any) -> Any:
            before = self.begin(stage)
            try:
                return action(*given, **named)
            finally:
                self.begin(before)

        return timed


def processor_seconds() -> float:
    """Of this process and of those that it has waited for."""
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system


@contextmanager
def sampled(clock: Clock) -> Iterator[dict[tuple[str, str], float]]:
    """Processor seconds by module of undertow and stage, with what NumPy, SciPy and C do for the module."""
    found: dict[tuple[str, str], float] = defaultdict(float)
    last = time.process_time()

    def look(_: int, frame: FrameType | None) -> None:
        nonlocal last
        now = time.process_time()
        found[_module(frame), clock.stage] += now - last
        last = now

    before = signal.signal(signal.SIGPROF, look)
    signal.setitimer(signal.ITIMER_PROF, INTERVAL, INTERVAL)
    try:
        yield found
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def _module(frame: FrameType | None) -> str:
    """The innermost module of undertow that is at work."""
    while frame is not None:
        file = frame.f_code.co_filename
        if _PACKAGE in file:
            return file.rpartition(_PACKAGE)[2].removesuffix(".py").replace(os.sep, ".")
        frame = frame.f_back
    return "other"
