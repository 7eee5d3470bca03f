"""Command line: python -m benchmarks.real --help"""

from __future__ import annotations

import os

# Before NumPy is loaded: cases run side by side, each on one core.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from benchmarks.results.text import errors
from benchmarks.trust.ablation import Data, ablate, answering
from benchmarks.trust.cases import part
from benchmarks.trust.measure import Record
from benchmarks.trust.run import Work, add_run_options, records, run, run_limits
from undertow.errors import UndertowError
from undertow.files import write_whole

from .cases import KINDS, Case, ablated, plan
from .logs import LogSet, improved, log_sets
from .measure import material, worker
from .page import page
from .unsaid import unsaid_page

PROGRAM = "python -m benchmarks.real"
STORED = Path("benchmarks/results/real.jsonl")
STORED_IMPROVED = Path("benchmarks/results/real-improved.jsonl")
ZIGZAGS = """\
zigzags of the tanker, which nobody may hand on: to make the folder, clone the repository that
DATA/kvlcc2-hsva/README.md names, run `python DATA/kvlcc2-hsva/convert.py CLONE FOLDER`, copy vehicle.toml and
log.toml from DATA/kvlcc2-hsva into it, and delete the runs that are kept for judging (named there); without
it these cases are left out"""
FREE_RUNS = """\
free runs of a ship in a pond: folder data of a clone of NAOE-5thLab/FRT-DS-ESSO (CC BY-NC 4.0, not part of
this project); without it these cases are left out"""
EXAMPLES = """\
examples:
  # all cases on two cores; the same command goes on where it was cut off
  python -m benchmarks.real run --jobs 2 --minutes 60
  # only the logs as they are, and the other methods on them
  python -m benchmarks.real run --kind baseline --kind prediction
  # the page from what is stored
  python -m benchmarks.real page --out docs/real.md
  # one case with all that is known of it
  python -m benchmarks.real one cse1-joystick:current:0.25
"""


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; 0 when all went well, 1 when a case failed to run, 2 for a bad request."""
    options = _parser().parse_args(arguments)
    commands = {"run": _run, "ablate": _ablate, "list": _list, "one": _one, "page": _page, "unsaid": _unsaid}
    try:
        return commands[options.command](options)
    except (ValueError, OSError, UndertowError) as error:
        print(f"{PROGRAM}: {error}", file=sys.stderr)
        return 2


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=PROGRAM,
        description="Known changes in real logs and their models, and how well the models predict.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    doing = commands.add_parser("run", help="diagnose the cases of the plan, one line of JSON for each")
    doing.add_argument("--out", type=Path, default=STORED, metavar="FILE.jsonl", help="default: %(default)s")
    add_run_options(doing)
    doing.add_argument(
        "--improved",
        action="store_true",
        help=f"with the effects found in the unmodified logs in the vehicle files (for {STORED_IMPROVED})",
    )
    listing = commands.add_parser("list", help="the cases of the plan")
    doing.add_argument(
        "--keep", type=Path, metavar="FOLDER", help="whole diagnoses as JSON, one file for each"
    )
    ablating = commands.add_parser("ablate", help="a sample with each number of the diagnosis switched off")
    ablating.add_argument("--source", type=Path, required=True, metavar="FILE.jsonl", help="appended to")
    ablating.add_argument("--number", action="append", default=[], metavar="NAME", help="only these numbers")
    add_run_options(ablating)
    one = commands.add_parser("one", help="diagnose one case and print everything")
    one.add_argument("case", help="id of the case")
    for command in (doing, listing):
        _add_plan(command)
    for command in (doing, listing, ablating, one):
        _add_data(command)
    paging = commands.add_parser("page", help="the tables of a run")
    unsaid = commands.add_parser("unsaid", help="what could not be said of the logs as they are, and why")
    for command in (paging, unsaid):
        add = command.add_argument
        add("source", type=Path, nargs="*", default=[STORED], metavar="FILE.jsonl")
        add("--out", type=Path, metavar="FILE.md", help="printed where it is not given")
        add("--before", type=Path, metavar="FILE.jsonl", help="an earlier run, shown beside it")
    paging.add_argument(
        "--improved", type=Path, metavar="FILE.jsonl", help=f"a run with --improved ({STORED_IMPROVED})"
    )
    return parser


def _add_data(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--data", type=Path, default=Path("../shared/data"), help="folder of the logs (default %(default)s)")
    add("--kvlcc2", type=Path, metavar="FOLDER", help=ZIGZAGS)
    add("--esso", type=Path, metavar="FOLDER", help=FREE_RUNS)


def _add_plan(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--part", default="1/1", metavar="I/N", help="every n-th case, from the i-th")
    add("--kind", action="append", choices=KINDS, help="only this kind")
    add("--only", action="append", metavar="WORD", help="only cases with this word in their id")


def _sets(options: argparse.Namespace) -> dict[str, LogSet]:
    sets = log_sets(options.kvlcc2, options.esso)
    for logs in sets.values():
        if not (options.data / logs.folder).is_dir():
            raise ValueError(f"{options.data / logs.folder} is not there: give the folder with --data")
    return sets


def _planned(options: argparse.Namespace) -> list[Case]:
    wanted = [
        case
        for case in plan(log_sets(options.kvlcc2, options.esso))
        if (not options.kind or case.kind in options.kind)
        and (not options.only or any(word in case.id for word in options.only))
    ]
    return part(wanted, options.part)


def _run(options: argparse.Namespace) -> int:
    if options.keep is not None:
        options.keep.mkdir(parents=True, exist_ok=True)
    sets, cases = _sets(options), _planned(options)
    if options.improved:
        sets = {name: improved(logs) for name, logs in sets.items() if logs.injections or logs.removals}
        cases = [c for c in cases if c.logs in sets and c.kind != "prediction"]
    work = worker(sets, options.data, options.keep)
    return int(run(cases, options.out, work, report=_report, **run_limits(options)) > 0)


def _ablate(options: argparse.Namespace) -> int:
    sets = _sets(options)
    work, how = _answered(sets, options.data), {"report": _report, **run_limits(options)}
    return int(ablate(ablated(sets), options.number, options.source, work, **how) > 0)


def _answered(sets: Mapping[str, LogSet], data: Path) -> Work:
    def given(case: Case) -> Data:
        found = material(case, sets[case.logs], data)
        return found.vehicle, found.train, found.test

    return answering(given)


def _report(record: Record, left: int) -> None:
    print(f"{left:4d} left  {record['id']}  {_words(record)}", file=sys.stderr, flush=True)


def _words(record: Record) -> str:
    if "failure" in record:
        return f"FAILED: {record['failure']}"
    reported = "; ".join(f"{name} {errors(e)}" for name, e in record.get("errors", {}).items())
    said = record.get("answer", {"verdict": "", "named": []})
    return f"{said['verdict']} {' + '.join(said['named'])} ({record['seconds']:.0f} s; {reported})".lstrip()


def _list(options: argparse.Namespace) -> int:
    for case in _planned(options):
        print(f"{case.kind:10s} {case.id}")
    return 0


def _one(options: argparse.Namespace) -> int:
    sets = _sets(options)
    print(json.dumps(worker(sets, options.data)(Case.read(options.case, sets)), indent=1))
    return 0


def _page(options: argparse.Namespace) -> int:
    planned = plan(log_sets(Path(), Path()))
    again = _stored([options.improved] if options.improved else [])
    return _write(page(_stored(options.source), _before(options), planned, again), options.out)


def _unsaid(options: argparse.Namespace) -> int:
    return _write(unsaid_page(_stored(options.source), _before(options)), options.out)


def _before(options: argparse.Namespace) -> list[Record]:
    return _stored([options.before] if options.before else [])


def _stored(files: Sequence[Path]) -> list[Record]:
    """Records of several files, of each case the last."""
    if missing := [p for p in files if not p.is_file()]:
        raise ValueError(f"{missing[0]} is not there: give the file that run wrote")
    return list({r["id"]: r for p in files for r in records(p)}.values())


def _write(text: str, out: Path | None) -> int:
    if out is None:
        print(text)
    else:
        write_whole(out, text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
