"""One line for each run of the measurements, kept in the page from run to run."""

from __future__ import annotations

import datetime
import re
import subprocess
from pathlib import Path

from .goals import GOALS
from .report import Timing, measured

HEADING = "**History**\n"
_KEPT = 30
_RUN = re.compile(r"\| \d{4}-\d\d-\d\d \|")


def with_history(known: str, timings: list[Timing], cpu: str) -> str:
    """The table of all runs: those that the page has, and this one.

    Parameters
    ----------
    known : str
        The page as it is.
    timings : list of Timing
        What was measured.
    cpu : str
        The machine.
    """
    old = [line for line in known.partition(HEADING)[2].splitlines() if _RUN.match(line)]
    row = [datetime.date.today().isoformat(), _commit(), cpu, *(measured(goal, timings) for goal in GOALS)]
    head = ["day", "commit", "machine", *(str(k) for k in range(1, len(GOALS) + 1))]
    lines = [_row(head), _row(["---"] * 3 + ["---:"] * len(GOALS)), *[*old, _row(row)][-_KEPT:]]
    return f"{HEADING}\nColumns are the lines of the first table.\n\n" + "\n".join(lines) + "\n"


def _row(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _commit() -> str:
    """Short hash of what was measured; a star where files were changed since."""
    words = ["git", "describe", "--always", "--dirty=*", "--exclude=*"]
    done = subprocess.run(words, cwd=Path(__file__).parent, capture_output=True, text=True, check=False)
    return done.stdout.strip() or "unknown"
