"""Command line: python -m benchmarks.trust --help"""

from __future__ import annotations

import os

# Before NumPy is loaded: cases run side by side, each on one core.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import json
import sys
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

from benchmarks.results.summary import with_summary
from undertow.errors import UndertowError
from undertow.files import write_whole
from undertow.fleet.engine import Engine, engine

from .ablation import ablate, ablation_page, answering, of_simulation, sample
from .cases import BASE_SEED, ROUNDS, Planned, part, plan
from .measure import Record, measured
from .report import goal_table, page
from .run import add_run_options, records, run, run_limits, worker

PROGRAM = "python -m benchmarks.trust"
EXAMPLES = """\
examples:
  # twenty minutes on two cores; the same command goes on where it was cut off
  python -m benchmarks.trust run --out trust.jsonl --minutes 20 --jobs 2
  # the same on a cluster of Dask; every worker needs this checkout
  python -m benchmarks.trust run --out trust.jsonl --scheduler tcp://10.0.0.1:8786
  python -m benchmarks.trust report trust.jsonl --out docs/trust.md --summary docs/results.md
  # every number of the diagnosis switched off in turn, on a fixed sample; it goes on where it was cut off
  python -m benchmarks.trust ablate --source ablation.jsonl --out docs/ablation.md --minutes 60
  # one case with all that is known of it, its files kept
  python -m benchmarks.trust one usv:lift:x1:n1:open:plain:17 --keep cases/lift
"""


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; 0 when all went well, 1 when a case failed to run, 2 for a bad request."""
    options = _parser().parse_args(arguments)
    try:
        commands = {"run": _run, "one": _one, "list": _list, "report": _report, "ablate": _ablate}
        return commands[options.command](options)
    except (ValueError, OSError, UndertowError) as error:
        print(f"{PROGRAM}: {error}", file=sys.stderr)
        return 2


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=PROGRAM,
        description="Measure how often the diagnosis is right, on an independent simulator.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    doing = commands.add_parser("run", help="diagnose the cases of the plan, one line of JSON for each")
    doing.add_argument("--out", type=Path, required=True, metavar="FILE.jsonl", help="appended to")
    add_run_options(doing)
    doing.add_argument(
        "--scheduler", metavar="ADDRESS", help="on Dask; 'local': on a cluster of --jobs processes"
    )
    doing.add_argument("--no-peers", action="store_true", help="leave the other methods out")
    listing = commands.add_parser("list", help="the cases of the plan")
    for command in (doing, listing):
        _add_plan(command)
    one = commands.add_parser("one", help="diagnose one case and print everything")
    one.add_argument("case", help="id of the case")
    one.add_argument("--keep", type=Path, metavar="DIR", help="folder for its files")
    one.add_argument("--no-peers", action="store_true", help="leave the other methods out")
    reporting = commands.add_parser("report", help="the tables of a run")
    reporting.add_argument("source", type=Path, nargs="+", metavar="FILE.jsonl")
    reporting.add_argument("--out", type=Path, metavar="FILE.md", help="printed where it is not given")
    reporting.add_argument(
        "--summary", type=Path, metavar="RESULTS.md", help="page of results that gets the table of goals"
    )
    ablating = commands.add_parser("ablate", help="the fixed sample with each number switched off in turn")
    ablating.add_argument("--source", type=Path, required=True, metavar="FILE.jsonl", help="appended to")
    ablating.add_argument("--out", type=Path, metavar="FILE.md", help="printed where it is not given")
    ablating.add_argument("--number", action="append", default=[], metavar="NAME", help="only these numbers")
    ablating.add_argument(
        "--beside", type=Path, action="append", default=[], metavar="FILE.jsonl",
        help="of `python -m benchmarks.real ablate`: counted on the page, too",
    )  # fmt: skip
    ablating.add_argument("--cases", type=int, metavar="N", help="only the first cases of the sample")
    ablating.add_argument("--vehicle", action="append", help="only its cases with these vehicles")
    add_run_options(ablating)
    return parser


def _add_plan(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--plan", choices=list(ROUNDS), default="full", help="default: %(default)s")
    add("--rounds", type=int, metavar="N", help="rounds, where not those of the plan")
    add("--seed", type=int, default=BASE_SEED, help="base seed (default %(default)s)")
    add("--part", default="1/1", metavar="I/N", help="every n-th case, from the i-th")
    add("--kind", action="append", help="only these kinds: complete, single, pair, uncatalogued, hard")
    add("--label", action="append", help="only these, such as 'pose only': rows of the page")
    add("--vehicle", action="append", help="only these vehicles")


def _planned(options: argparse.Namespace) -> list[Planned]:
    cases = plan(options.rounds or ROUNDS[options.plan], options.seed)
    wanted = [
        c
        for c in cases
        if (not options.kind or c.kind in options.kind)
        and (not options.label or c.label in options.label)
        and (not options.vehicle or c.vehicle in options.vehicle)
    ]
    return part(wanted, options.part)


def _run(options: argparse.Namespace) -> int:
    with _engine(options) as doing:
        failed = run(
            _planned(options),
            options.out,
            worker(not options.no_peers),
            jobs=options.jobs,
            minutes=options.minutes,
            limit=options.limit,
            report=_report_record,
            engine=doing,
        )
    return int(failed > 0)


def _engine(options: argparse.Namespace) -> AbstractContextManager[Engine | None]:
    if options.scheduler is None:
        return nullcontext()
    address = None if options.scheduler == "local" else options.scheduler
    return engine(address, max(options.jobs, 1), options.limit)


def _report_record(record: Record, left: int) -> None:
    if "failure" in record:
        words = f"FAILED: {record['failure']}"
    else:
        said, ratio = record["answer"], record.get("ratio")
        worth = "" if ratio is None else f", ratio {ratio:.3g}"
        words = f"{said['verdict']} {' + '.join(said['named'])} ({record['seconds']:.0f} s{worth})"
    print(f"{left:4d} left  {record['id']}  {words}", file=sys.stderr, flush=True)


def _one(options: argparse.Namespace) -> int:
    record, outcome = measured(Planned.read(options.case), peers=not options.no_peers, keep=options.keep)
    found = outcome.diagnosis
    print(json.dumps(record, indent=1))
    for entry in found.ranking[:10]:
        values = ", ".join(f"{p.name} = {p.value:.4g}" for p in entry.parameters)
        print(f"{entry.effect:24s} {entry.error_before:.4g} -> {entry.error_after:.4g}  {values}")
    for left in found.remaining:
        print(f"{left.degree_of_freedom}: {left.note}")
    return 0


def _list(options: argparse.Namespace) -> int:
    for case in _planned(options):
        print(f"{case.kind:9s} {case.id}")
    return 0


def _ablate(options: argparse.Namespace) -> int:
    cases = [c for c in sample() if not options.vehicle or c.vehicle in options.vehicle]
    work, how = answering(of_simulation), {"report": _report_record, **run_limits(options)}
    failed = ablate(cases[: options.cases], options.number, options.source, work, **how)
    text = ablation_page(r for path in (options.source, *options.beside) for r in records(path))
    if options.out is None:
        print(text)
    else:
        write_whole(options.out, text)
    return int(failed > 0)


def _report(options: argparse.Namespace) -> int:
    missing = [p for p in options.source if not p.is_file()]
    if missing:
        raise ValueError(f"{missing[0]} is not there: give the file that run wrote")
    kept = list({r["id"]: r for p in options.source for r in records(p)}.values())
    text = page(kept)
    if options.summary is not None:
        results = options.summary.read_text(encoding="utf-8")
        write_whole(options.summary, with_summary(results, goal_table(kept)))
    if options.out is None:
        print(text)
    else:
        write_whole(options.out, text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
