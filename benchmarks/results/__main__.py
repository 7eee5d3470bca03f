"""Command line: python -m benchmarks.results --help"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable
from pathlib import Path

from benchmarks.progress import clear, teller
from undertow import __version__
from undertow.errors import UndertowError
from undertow.files import write_whole
from undertow.identification.report.tables import versions

from . import cfd, cse1, hidden
from .basin import Basin
from .pictures import NAMES, draw
from .reading import Report
from .summary import speed_of, summary_of
from .words import CFD, CSE1, HIDDEN, INTRODUCTION

SECTIONS = ("hidden-effects", "ntnu-cse1", "cfd-surge")


def main(arguments: list[str] | None = None) -> int:
    """Make the page; 0 when all went well, 1 when a part failed, 2 for data that are not there."""
    options = _parser().parse_args(arguments)
    missing = [s for s in SECTIONS if not (options.data / s).is_dir()]
    if missing:
        print(
            f"{options.data} has no folder {missing[0]}: give that of the data sets with --data",
            file=sys.stderr,
        )
        return 2
    images = options.out.parent / "images"
    makers = {"hidden-effects": _hidden, "ntnu-cse1": _cse1, "cfd-surge": _cfd}
    chosen = [s for s in SECTIONS if s in (options.only or SECTIONS)]
    parts = [_attempt(makers[s], options.data / s, images) for s in chosen]
    if options.only:
        print("\n".join(parts))
    else:
        known = options.out.read_text(encoding="utf-8") if options.out.exists() else ""
        write_whole(
            options.out, "\n".join([INTRODUCTION, summary_of(known), speed_of(known), *parts, _making()])
        )
    return int(any(_FAILED in p for p in parts))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.results", description=__doc__)
    parser.add_argument("--data", type=Path, required=True, help=f"folder with {', '.join(SECTIONS)}")
    parser.add_argument("--out", type=Path, default=Path("docs/results.md"), help="default: %(default)s")
    parser.add_argument(
        "--only", action="append", choices=SECTIONS, help="print this part, do not write the page"
    )
    return parser


_FAILED = "**This part failed:**"


def _attempt(make: Callable[[Path, Path, Report], str], data: Path, images: Path) -> str:
    """A part of the page, or why there is none: an hour of work is not thrown away for one error."""
    try:
        return make(data, images, teller(data.name))
    except (UndertowError, ArithmeticError, ValueError) as error:  # LinAlgError is a ValueError
        clear()
        print(f"{data.name}: {error}", file=sys.stderr)
        return f"## {data.name}\n\n{_FAILED} {type(error).__name__}: {error}\n"


# --- parts ------------------------------------------------------------------------------------
def _hidden(data: Path, images: Path, report: Report) -> str:
    results = []
    for i, case in enumerate(hidden.CASES):
        results.append(hidden.run_case(data, case, lambda done, words, i=i, case=case: report(
            (i + done) / len(hidden.CASES), f"{case}: {words}")))  # fmt: skip
    return HIDDEN + hidden.section(results)


def _cse1(data: Path, images: Path, report: Report) -> str:
    directions, basin = cse1.run_both(data, report), Basin.read(data)
    draw(directions, basin, images)
    shown = "\n".join(f"![{title}](images/{name})\n" for title, name in zip(_TITLES, NAMES, strict=True))
    return CSE1 + cse1.section(directions, basin) + "\n" + shown


_TITLES = (
    "Kept-aside run: measured velocities, and 5 s predictions before and after adding effects",
    "Drag identified in free runs against towing tests",
)


def _cfd(data: Path, images: Path, report: Report) -> str:
    return CFD + cfd.section(cfd.run_both(data, report))


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
