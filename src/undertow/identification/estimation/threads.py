"""The linear algebra of an estimate in one thread."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import threadpool_limits

_limited = False  # for whoever calls: looking at all libraries anew takes longer than a small fit


@contextmanager
def one_thread() -> Iterator[None]:
    """The linear algebra in one thread while the block, or the decorated function, runs.

    Every function that estimates and may be called from Python is decorated: matrices are small here, and
    thread synchronisation costs more than it saves, several times more with other busy processes. Limits only
    libraries that are loaded already.
    """
    global _limited
    if _limited:
        yield
        return
    with threadpool_limits(1):
        _limited = True
        try:
            yield
        finally:
            _limited = False


__all__ = ["one_thread"]
