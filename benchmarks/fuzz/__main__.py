"""Command line: python -m benchmarks.fuzz --help"""

from __future__ import annotations

import argparse
import re
import sys
from collections import Counter, defaultdict
from collections.abc import Iterable
from pathlib import Path

from benchmarks.progress import clear, progress_line

from .cases import case
from .run import LIMIT, Done, one, results

PROGRAM = "python -m benchmarks.fuzz"
EXAMPLES = """\
examples:
  python -m benchmarks.fuzz                                  # 10,000 cases of seed 0
  python -m benchmarks.fuzz --seed 7 --count 500 --from 2000  # a part of another 10,000
  python -m benchmarks.fuzz --case 0:4711 --keep /tmp/4711    # one case again, its files kept
"""


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; 0 where every case was answered as it has to be, 1 where one was not."""
    options = _parser().parse_args(arguments)
    if options.case is not None:
        return _again(options.case, options.keep)
    numbers = range(options.begin, options.begin + options.count)
    return _summary(
        options.seed, _reported(results(options.seed, numbers, options.jobs, options.limit), options.count)
    )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=PROGRAM,
        description="Damage files in many ways; readers and commands must answer, or refuse in one line.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--count", type=int, default=10_000, help="cases (default %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of all cases (default %(default)s)")
    parser.add_argument("--from", dest="begin", type=int, default=0, metavar="N", help="first case")
    parser.add_argument("--jobs", type=int, default=2, help="cases at a time (default %(default)s)")
    parser.add_argument("--limit", type=float, default=LIMIT, metavar="S", help="s per case (%(default)g)")
    parser.add_argument("--case", metavar="SEED:NUMBER", help="one case again, in this process")
    parser.add_argument("--keep", type=Path, default=Path("fuzz-case"), metavar="DIR", help="for its files")
    return parser


def _again(name: str, keep: Path) -> int:
    seed, number = map(int, name.split(":"))
    chosen = case(seed, number)
    asked = chosen.command.format("the file") or "the reader alone"
    print(f"{name}: {chosen.reader}, {asked}; files in {keep}")
    found = one(seed, number, keep.absolute())
    print(f"{found.said} {found.words}".rstrip())
    return int(found.said == "failed")


def _reported(found: Iterable[Done], count: int) -> list[Done]:
    """All results, with a line on how far it is."""
    tell, done, failed = progress_line("fuzz"), [], 0
    for one_done in found:
        done.append(one_done)
        failed += one_done.outcome.said == "failed"
        if len(done) % max(count // 20, 1) == 0:
            tell(len(done) / count, f"{len(done)} of {count}: {failed} failed")
    clear()
    return done


def _summary(seed: int, done: list[Done]) -> int:
    said = Counter(d.outcome.said for d in done)
    print(f"{len(done)} cases of seed {seed}: {', '.join(f'{n} {what}' for what, n in said.most_common())}")
    slow = max(done, key=lambda d: d.seconds)
    print(f"the slowest was {seed}:{slow.number} with {slow.seconds:.1f} s")
    alike: dict[str, list[Done]] = defaultdict(list)
    for failure in sorted(d for d in done if d.outcome.said == "failed"):
        alike[_kind(failure.outcome.words)].append(failure)
    for kind, failures in sorted(alike.items(), key=lambda item: -len(item[1])):
        names = ", ".join(f"{seed}:{d.number}" for d in failures[:3])
        print(f"\n{len(failures)} x {kind}\n   {failures[0].outcome.words}\n   {PROGRAM} --case {names}")
    return int(bool(alike))


def _kind(words: str) -> str:
    """Words without what differs from case to case."""
    return re.sub(r"'[^']*'|\"[^\"]*\"|\d+(\.\d+)?(e[+-]?\d+)?", "…", words)[:90]


if __name__ == "__main__":
    sys.exit(main())
