"""Ctrl-C that is heard even where a library drops the exception."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

# Seconds after which an interruption that came to nothing is repeated.
_PATIENCE = 0.5


@contextmanager
def insisting() -> Iterator[None]:
    """While the block runs, repeat KeyboardInterrupt after Ctrl-C until it has ended the block.

    CasADi clears whatever is raised while it looks at the arguments of a call, an interruption as well: once
    in ten times a diagnosis would otherwise go on to its end. Nothing is changed outside the main thread,
    where signals are handled otherwise already, and on systems without timers.
    """
    if not _free():
        yield
        return
    signal.signal(signal.SIGINT, _raise)
    signal.signal(signal.SIGALRM, _raise)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _free() -> bool:
    if threading.current_thread() is not threading.main_thread() or not hasattr(signal, "setitimer"):
        return False
    usual = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    return usual and signal.getsignal(signal.SIGALRM) == signal.SIG_DFL


def _raise(number: int, frame: FrameType | None) -> None:
    signal.setitimer(signal.ITIMER_REAL, _PATIENCE)
    raise KeyboardInterrupt
