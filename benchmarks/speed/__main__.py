"""Command line: python -m benchmarks.speed --help"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.results.summary import SPEED, speed_of, with_part
from undertow.files import write_whole

from . import history, report

HERE = Path(__file__).parent
_ABOUT = """\
Every column is one processor; peers do the same work in the same run, and every time is paired with a check
of the result. Times are those of the fastest round; bold ones miss their goal, a dash was not measured.
*Command* is the command of undertow that does it. Made by `make bench`.
"""


def main(arguments: list[str] | None = None) -> int:
    """Measure, print, and keep; the exit code of the measurements."""
    options = _parser().parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        stored = options.store or Path(folder) / "speed.json"
        if not options.from_stored:
            stored.unlink(missing_ok=True)
        code = (
            0
            if options.from_stored
            else _measure(stored, options.only, processor_time=options.processor_time)
        )
        if not stored.exists():
            return code or 1
        known = options.out.read_text(encoding="utf-8") if options.out else ""
        page = _page(stored, speed_of(known))
    print(page)
    if options.out:
        write_whole(options.out, with_part(known, SPEED, f"{_ABOUT}\n{page}"))
    return code


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.speed", description=__doc__)
    parser.add_argument("--only", help="only topics that fit this ('rollout or fit'), as pytest -k")
    parser.add_argument(
        "--processor-time",
        action="store_true",
        help="where other programs run, too: what the process itself uses; not for threads or microseconds",
    )
    parser.add_argument("--store", type=Path, help="keep what pytest-benchmark measured in this JSON file")
    parser.add_argument("--from-stored", action="store_true", help="page from --store, measure nothing")
    parser.add_argument("--out", type=Path, help="page whose part on speed is replaced (docs/results.md)")
    return parser


def _measure(stored: Path, only: str | None, *, processor_time: bool) -> int:
    """Each topic in a process of its own, so that none runs in the memory that another leaves behind."""
    chosen, parts, worst = ["-k", only] if only else [], [], 0
    if processor_time:
        chosen.append("--benchmark-timer=time.process_time")
    with tempfile.TemporaryDirectory() as folder:
        for topic in sorted(HERE.glob("time_*.py")):
            part = Path(folder) / f"{topic.stem}.json"
            code = subprocess.run(
                [
                    *(sys.executable, "-m", "pytest", "-q", "-c", str(HERE / "pytest.ini"), str(topic)),
                    *(f"--benchmark-json={part}", "--benchmark-disable-gc", "--benchmark-quiet", *chosen),
                ],
                check=False,
            ).returncode
            worst = max(worst, 0 if code == _NOTHING_CHOSEN else code)
            if part.exists() and part.stat().st_size:
                parts.append(json.loads(part.read_text(encoding="utf-8")))
    if parts:
        whole = parts[0] | {"benchmarks": [b for part in parts for b in part["benchmarks"]]}
        write_whole(stored, json.dumps(whole))
    return worst


_NOTHING_CHOSEN = 5  # of pytest


def _page(stored: Path, known: str) -> str:
    timings, info = report.read(stored)
    machine = report.machine(info)
    cpu = machine.partition(",")[0]
    rows = history.runs(known, timings, cpu)
    own = "\n".join([f"### {machine}\n", report.times(timings), report.growth(timings)])
    goals = report.goals(history.by_processor(rows))
    return "\n".join([goals, own, *history.of_others(known, cpu), history.table(rows)])


if __name__ == "__main__":
    sys.exit(main())
