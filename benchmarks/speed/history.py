"""What the page keeps from run to run: one line for each run, and the tables of other processors."""

from __future__ import annotations

import datetime
import re
import subprocess
from pathlib import Path

from .goals import GOALS
from .report import NOT_MEASURED, Timing, measured

HEADING = "### History\n"
_KEPT = 30
_RUN = re.compile(r"\| \d{4}-\d\d-\d\d \|")
_MACHINE = 2
Row = list[str]


def runs(known: str, timings: list[Timing], cpu: str) -> list[Row]:
    """Day, commit, processor and what was measured for each goal: the runs that the page has, and this one.

    Parameters
    ----------
    known : str
        The part of the page as it is.
    timings : list of Timing
        What was measured.
    cpu : str
        The processor.
    """
    lines = known.partition(HEADING)[2].splitlines()
    old = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines if _RUN.match(line)]
    for row in old:  # a goal that came later was not measured then
        row += [NOT_MEASURED] * (_MACHINE + 1 + len(GOALS) - len(row))
    return [*old, [datetime.date.today().isoformat(), _commit(), cpu, *(measured(g, timings) for g in GOALS)]]


def by_processor(rows: list[Row]) -> dict[str, Row]:
    """What was measured last on each processor, goal by goal; the processor of the last run first."""
    found: dict[str, Row] = {}
    for row in reversed(rows):
        older = row[_MACHINE + 1 :]
        newer = found.get(row[_MACHINE], older)
        found[row[_MACHINE]] = [b if a == NOT_MEASURED else a for a, b in zip(newer, older, strict=True)]
    return found


def table(rows: list[Row]) -> str:
    """All runs."""
    head = ["day", "commit", "processor", *(str(k) for k in range(1, len(GOALS) + 1))]
    lines = [_line(head), _line(["---"] * 3 + ["---:"] * len(GOALS)), *map(_line, rows[-_KEPT:])]
    return f"{HEADING}\nColumns are the lines of the first table.\n\n" + "\n".join(lines) + "\n"


def of_others(known: str, cpu: str) -> list[str]:
    """The tables of other processors, as the page has them."""
    parts = ["### " + part.strip("\n") + "\n" for part in known.partition(HEADING)[0].split("\n### ")[1:]]
    return [part for part in parts if not part.startswith(f"### {cpu},")]


def _line(cells: Row) -> str:
    return "| " + " | ".join(cells) + " |"


def _commit() -> str:
    """Short hash of what was measured; a star where files were changed since."""
    words = ["git", "describe", "--always", "--dirty=*", "--exclude=*"]
    done = subprocess.run(words, cwd=Path(__file__).parent, capture_output=True, text=True, check=False)
    return done.stdout.strip() or "unknown"
