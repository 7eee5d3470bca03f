"""A sampler that looks on the call stack which module is at work, and for which stage of the diagnosis."""

from __future__ import annotations

import os
import signal
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from types import FrameType

INTERVAL = 0.002
"""Seconds of processor time between two looks."""
OTHER = "other"
_PACKAGE = os.sep + "undertow" + os.sep
Place = tuple[str, str]
"""Module of undertow and function in it."""


def processor_seconds() -> float:
    """Of this process and of those that it has waited for."""
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system


@contextmanager
def sampled(stages: Mapping[Place, str]) -> Iterator[dict[Place, float]]:
    """Processor seconds by module of undertow and stage, with what NumPy, SciPy and C do for the module.

    A function of `stages` has all that it calls counted for its stage; of several on the stack it is the
    one that stands first in `stages`.
    """
    found: dict[Place, float] = defaultdict(float)
    last = time.process_time()

    def look(_: int, frame: FrameType | None) -> None:
        nonlocal last
        now = time.process_time()
        places = _places(frame)
        there = set(places)
        stage = next((words for place, words in stages.items() if place in there), OTHER)
        found[places[0][0] if places else OTHER, stage] += now - last
        last = now

    before = signal.signal(signal.SIGPROF, look)
    signal.setitimer(signal.ITIMER_PROF, INTERVAL, INTERVAL)
    try:
        yield found
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def _places(frame: FrameType | None) -> list[Place]:
    """The functions of undertow on the stack, the innermost first."""
    found = []
    while frame is not None:
        file = frame.f_code.co_filename
        if _PACKAGE in file:
            module = file.rpartition(_PACKAGE)[2].removesuffix(".py").replace(os.sep, ".")
            found.append((module, frame.f_code.co_name))
        frame = frame.f_back
    return found
