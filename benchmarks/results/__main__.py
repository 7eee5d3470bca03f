"""Command line: python -m benchmarks.results --help"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.progress import clear, part_of, progress_line
from undertow import __version__
from undertow.errors import UndertowError
from undertow.files import write_whole
from undertow.identification.report.page import versions

from .hidden import CASES, CaseResult, run_case, section
from .summary import speed_of, summary_of

FOLDER = "hidden-effects"
INTRODUCTION = """\
# Results

How often the diagnosis is right on simulated logs, and how fast everything is. Real logs: tables in
[real.md](real.md), four vehicles in detail in the [examples](examples/README.md). The true answers are used
for these tables only; wrong answers are included. This page is made by programs (last section); do not edit
it by hand.
"""


def main(arguments: list[str] | None = None) -> int:
    """Make the page; 0 when all went well, 1 when a case failed, 2 for data that are not there."""
    options = _parser().parse_args(arguments)
    data = options.data / FOLDER
    if not data.is_dir():
        print(
            f"{options.data} has no folder {FOLDER}: give that of the data sets with --data", file=sys.stderr
        )
        return 2
    try:
        results = _diagnosed(data)
    except (UndertowError, ArithmeticError, ValueError) as error:  # LinAlgError is a ValueError
        clear()
        print(f"{FOLDER}: {error}", file=sys.stderr)
        return 1
    known = options.out.read_text(encoding="utf-8") if options.out.exists() else ""
    write_whole(options.out, page(known, results))
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.results", description=__doc__)
    parser.add_argument("--data", type=Path, required=True, help=f"folder with {FOLDER}")
    parser.add_argument("--out", type=Path, default=Path("docs/results.md"), help="default: %(default)s")
    return parser


def _diagnosed(data: Path) -> list[CaseResult]:
    report, results = progress_line(FOLDER), []
    for i, case in enumerate(CASES):
        results.append(run_case(data, case, part_of(report, i, len(CASES), f"{case}: ")))
    return results


def page(known: str, results: Sequence[CaseResult]) -> str:
    """The page; the parts that other programs fill in are those of the page that is `known`."""
    return "\n".join([INTRODUCTION, summary_of(known), speed_of(known), section(results), _making()])


def _making() -> str:
    used = ", ".join(f"{name} {version}" for name, version in versions().items())
    return (
        "## How it was made\n\n"
        "    python -m benchmarks.results --data ../shared/data --out docs/results.md\n\n"
        f"undertow {__version__}; {used}; a machine with {os.cpu_count()} cores, busy with other work, too: "
        "seconds are upper limits. All else follows from the data.\n"
    )


if __name__ == "__main__":
    code = main()
    clear()
    sys.exit(code)
