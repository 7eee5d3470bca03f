"""Runs side by side in the lanes of vector registers, and in threads."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from typing import TypeVar

import numpy as np

from undertow.errors import UndertowError
from undertow.typing import Array

from .source import c_file

T = TypeVar("T")
LANES_HEADER = c_file("lanes.h")
_LIMIT = "UNDERTOW_JOBS"
# So few runs are as fast one after the other.
_FEW = 2


def lanes_for(runs: int, lanes: int) -> int:
    """How many lanes a number of runs goes through."""
    return 1 if runs <= _FEW else lanes


def packed(array: Array, lanes: int) -> Array:
    """Runs side by side: shape (b, ...) to (groups, ..., lanes); the last run fills up the last group.

    With one lane the memory is the same.
    """
    if lanes == 1:
        return np.ascontiguousarray(array)[..., None]
    groups = -(-len(array) // lanes)
    lacking = groups * lanes - len(array)
    full = np.concatenate([array, np.repeat(array[-1:], lacking, axis=0)]) if lacking else array
    return np.ascontiguousarray(np.moveaxis(full.reshape(groups, lanes, *array.shape[1:]), 1, -1))


def unpacked(array: Array, runs: int) -> Array:
    """The reverse of `packed`, a view where there is one lane."""
    if array.shape[-1] == 1:
        return array[..., 0]
    groups, lanes = len(array), array.shape[-1]
    return np.moveaxis(array, -1, 1).reshape(groups * lanes, *array.shape[1:-1])[:runs]


def processors() -> int:
    """How many processors this process may use, or as many as UNDERTOW_JOBS says."""
    stated = os.environ.get(_LIMIT, "")
    if stated.isdecimal():
        return max(1, int(stated))
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on every system
        return os.cpu_count() or 1


def in_threads(
    work: Callable[[T], object],
    parts: Sequence[T],
    threads: int | None,
    done: Callable[[T], object] = lambda part: None,
) -> None:
    """Do the parts of a work in threads; compiled code runs outside Python's lock.

    Parameters
    ----------
    work : callable
        Does one part.
    parts : sequence
        The parts.
    threads : int, optional
        How many at a time; by default as many as there are processors.
    done : callable, optional
        Called with every part that is done, in the thread of the caller.

    Raises
    ------
    UndertowError
        If there is no thread.
    """
    wanted = processors() if threads is None else threads
    if wanted < 1:
        raise UndertowError(f"threads = {threads}: give one at least")
    if min(wanted, len(parts)) == 1:
        for part in parts:
            work(part)
            done(part)
        return
    with ThreadPoolExecutor(min(wanted, len(parts))) as pool:
        started = {pool.submit(work, part): part for part in parts}
        try:
            for future in as_completed(started):
                future.result()
                done(started[future])
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise


def shares(runs: int, work: float, threads: int | None, lanes: int) -> list[slice]:
    """Runs in shares of whole groups, each a fraction of a second and a few for every thread."""
    groups, wanted = -(-runs // lanes), threads or processors()
    least, most = (max(int(steps / max(work, 1) / lanes), 1) for steps in _STEPS_IN_SHARE)
    each = lanes * min(max(-(-groups // (_SHARES * wanted)), least), most)
    return [slice(a, min(a + each, runs)) for a in range(0, runs, each)]


# From what is worth a thread of its own, a millisecond, to the tenth of a second in which Ctrl-C is heard.
_STEPS_IN_SHARE = (20_000, 1_000_000)
# For each thread, so that none waits long for the others.
_SHARES = 4


def defines(sizes: Iterable[tuple[str, int]]) -> str:
    """Sizes as C macros; C has no empty arrays."""
    return "".join(f"#define {name} {max(size, 1)}\n" for name, size in sizes)
