"""A progress bar for work that lasts; library code reports to a plain callback and knows no terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Lock, Timer
from typing import Any

Report = Callable[[float, str], None]
"""What library code calls: how much is done (0 to `total`), and a few words on what is being done now."""

DELAY = 2.0
"""Seconds before a bar appears."""


@contextmanager
def progress(description: str, total: float = 1.0) -> Iterator[Report]:
    """Show a bar on the terminal while the block runs, if that takes more than two seconds.

    Nothing is printed for shorter work or when stderr is not a terminal. The bar disappears at the end.

    Parameters
    ----------
    description
        What is being done; shown until the first report.
    total
        The value reported when all is done.

    Yields
    ------
    Callable[[float, str], None]
        To be handed to library code as its progress callback.
    """
    if not sys.stderr.isatty():
        yield _ignore
        return
    bar = _Bar(description, total)
    timer = Timer(DELAY, bar.show)
    timer.daemon = True
    timer.start()
    try:
        yield bar.report
    finally:
        timer.cancel()
        bar.close()


def _ignore(done: float, words: str) -> None:
    """Nobody is looking."""


class _Bar:
    """The state of the work and, once another thread has called `show`, its picture."""

    def __init__(self, description: str, total: float) -> None:
        self._words, self._total, self._done = description, total, 0.0
        self._picture: Any = None
        self._closed = False
        self._lock = Lock()

    def report(self, done: float, words: str = "") -> None:
        with self._lock:
            self._done, self._words = done, words or self._words
            self._draw()

    def show(self, console: Any = None) -> None:
        from rich.progress import Progress  # slow to import, and mostly not needed

        with self._lock:
            if self._closed:
                return
            self._picture = Progress(console=console or _terminal(), transient=True)
            self._task = self._picture.add_task(self._words, total=self._total)
            self._picture.start()
            self._draw()

    def close(self) -> None:
        with self._lock:
            self._closed = True
            if self._picture is not None:
                self._picture.stop()

    def _draw(self) -> None:
        if self._picture is not None:
            from rich.markup import escape  # names out of files are not markup

            self._picture.update(self._task, completed=self._done, description=escape(self._words))


def _terminal() -> Any:
    from rich.console import Console

    return Console(stderr=True)
