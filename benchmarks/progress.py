"""What a program that makes a page says while it works."""

from __future__ import annotations

import sys

from undertow.typing import Progress


def progress_line(part: str) -> Progress:
    """A line on stderr that is rewritten on a terminal; one line per step elsewhere.

    The step is what stands before the colon in what is told.
    """
    last = [""]

    def tell(done: float, words: str) -> None:
        line = f"{part} {100 * done:3.0f}%  {words}"
        if sys.stderr.isatty():
            print(f"\r\x1b[K{line}", end="", file=sys.stderr, flush=True)
        elif words.partition(":")[0] != last[0]:
            print(line, file=sys.stderr, flush=True)
        last[0] = words.partition(":")[0]

    return tell


def part_of(report: Progress, number: int, count: int, before: str = "") -> Progress:
    """Progress of one of `count` equal parts, numbered from zero, as progress of the whole."""
    return lambda done, words: report((number + done) / count, before + words)


def clear() -> None:
    """Take the line away."""
    if sys.stderr.isatty():
        print("\r\x1b[K", end="", file=sys.stderr)
