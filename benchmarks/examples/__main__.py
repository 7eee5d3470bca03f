"""Command line: python -m benchmarks.examples --help"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType

from undertow import __version__
from undertow.errors import UndertowError
from undertow.files import write_whole
from undertow.identification.report.page import versions

from . import cfd, cfd_page, cse1, cse1_page, kvlcc2, kvlcc2_page, sf30k, sf30k_page
from .calls import Caller, Reported

#: Page to what it is made by.
EXAMPLES: dict[str, tuple[ModuleType, ModuleType]] = {
    "cse1": (cse1, cse1_page),
    "sf30k": (sf30k, sf30k_page),
    "kvlcc2": (kvlcc2, kvlcc2_page),
    "cfd-surge": (cfd, cfd_page),
}


def main(arguments: list[str] | None = None) -> int:
    """Make the pages; 0 when all went well, 1 when an example failed, 2 for data that are not there."""
    options = _parser().parse_args(arguments)
    chosen = [name for name in EXAMPLES if name in (options.only or EXAMPLES)]
    missing = [f for f in (EXAMPLES[name][0].FOLDER for name in chosen) if not (options.data / f).is_dir()]
    if missing and not options.from_stored:
        print(
            f"{options.data} has no folder {missing[0]}: give that of the data sets with --data",
            file=sys.stderr,
        )
        return 2
    failed = [name for name in chosen if not _made(name, options)]
    return int(bool(failed))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.examples", description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="default: %(default)s")
    parser.add_argument("--out", type=Path, default=Path("docs/examples"), help="default: %(default)s")
    parser.add_argument("--only", action="append", choices=tuple(EXAMPLES), help="this page, not all of them")
    parser.add_argument(
        "--scratch",
        type=Path,
        help="folder for intermediate files; diagnoses that it holds are not made again",
    )
    parser.add_argument(
        "--from-stored", action="store_true", help="write the pages from the numbers of the last time"
    )
    return parser


def _made(name: str, options: argparse.Namespace) -> bool:
    numbers = options.out / "numbers" / f"{name}.json"
    try:
        if not options.from_stored:
            write_whole(numbers, json.dumps(_worked(name, options), indent=1, ensure_ascii=False) + "\n")
        write_whole(options.out / f"{name}.md", page(name, json.loads(numbers.read_text(encoding="utf-8"))))
    except (UndertowError, ArithmeticError, ValueError) as error:  # an hour of other pages is not thrown away
        print(f"{name}: {error}", file=sys.stderr)
        return False
    return True


def _worked(name: str, options: argparse.Namespace) -> Reported:
    set_ = EXAMPLES[name][0]
    images = options.out / "images"
    for folder in (images, options.out / "numbers"):
        folder.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory() as passing:
        scratch = options.scratch or Path(passing)
        scratch.mkdir(parents=True, exist_ok=True)
        call = Caller((options.data / set_.FOLDER).resolve(), scratch, _log)
        found: Reported = set_.work(call, images)
    return {"made": {**versions(), "undertow": __version__, "cores": os.cpu_count()}, **found}


def _log(words: str) -> None:
    print(words, file=sys.stderr, flush=True)


def page(name: str, numbers: Reported) -> str:
    """A whole page: the words of `pages`, with the blocks that the numbers give.

    Raises
    ------
    ValueError
        If words and blocks do not fit each other.
    """
    blocks = EXAMPLES[name][1].blocks(numbers)
    words = (Path(__file__).parent / "pages" / f"{name}.md").read_text(encoding="utf-8")
    wanted = re.findall(r"\{\{(\w+)\}\}", words)
    if sorted(wanted) != sorted(blocks):
        raise ValueError(f"page {name} asks for {', '.join(wanted)} and is given {', '.join(blocks)}")
    for key, text in blocks.items():
        words = words.replace(f"{{{{{key}}}}}", text)
    return words + _making(name, numbers)


def _making(name: str, numbers: Reported) -> str:
    used = ", ".join(f"{k} {v}" for k, v in numbers["made"].items() if k != "cores")
    return (
        "\n## How this page was made\n\n"
        f"    python -m benchmarks.examples --data ../shared/data --out docs/examples --only {name}\n\n"
        f"with {used}, on {numbers['made']['cores']} cores. Verdicts, tables and pictures\nare what the "
        "commands gave; the text around them is written by hand.\n"
    )


if __name__ == "__main__":
    sys.exit(main())
