"""Make docs/long-logs.md: `python -m benchmarks.long --folder /tmp/long --out docs/long-logs.md`."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from undertow.files import write_whole

from .made import VEHICLE, write
from .thinning import biases

PAGE = Path(__file__).with_name("page.md")


@dataclass(frozen=True)
class Log:
    """A log that is made and tried."""

    name: str
    title: str
    seconds: int
    commands: tuple[str, ...]


COMMANDS = ("compare", "doctor", "fit", "diagnose", "add ocean_current", "plan")
LOGS = (
    Log("hour.parquet", "1 h, 360,000 rows", 3_600, COMMANDS),
    Log("hour.csv", "1 h, 360,000 rows, CSV", 3_600, ("fit",)),
    Log("day.parquet", "28 h, 10,000,000 rows", 100_000, COMMANDS),
)


@dataclass(frozen=True)
class Cost:
    """What a command took."""

    log: str
    command: str
    seconds: float
    processor: float  # s, of all its processes
    memory: int  # bytes, of the largest of its processes at its peak
    code: int


def main(arguments: list[str] | None = None) -> int:
    """Make the logs, run the commands, write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.long", description=__doc__)
    parser.add_argument("--folder", type=Path, required=True, help="gets the logs, 1.1 GB, and the results")
    parser.add_argument("--out", type=Path, help="page to write; printed where it is not given")
    parser.add_argument(
        "--only", choices=[log.name for log in LOGS], action="append", help="try some of the logs anew"
    )
    options = parser.parse_args(arguments)
    options.folder.mkdir(parents=True, exist_ok=True)
    logs = [log for log in LOGS if not options.only or log.name in options.only]
    for log in logs:
        kept = [asdict(cost) for cost in _tried(log, options.folder)]
        write_whole(_costs_of(log, options.folder), json.dumps(kept, indent=1) + "\n")
    files = [file for log in LOGS if (file := _costs_of(log, options.folder)).exists()]
    text = page([Cost(**row) for file in files for row in json.loads(file.read_text())], options.folder)
    if options.out is None:
        print(text)
    else:
        write_whole(options.out, text)
    return 0


def _costs_of(log: Log, folder: Path) -> Path:
    """What the commands on a log took, so that logs can be tried one at a time."""
    return folder / f"{log.name}-costs.json"


def _tried(log: Log, folder: Path) -> list[Cost]:
    path = folder / log.name
    if not path.exists():
        write(path, log.seconds)
    return [_measured(log, command, path) for command in log.commands]


def _measured(log: Log, command: str, path: Path) -> Cost:
    """Run a command in a process of its own; what it and its children took."""
    from time import perf_counter

    first, *rest = command.split()
    words = [first, *rest, VEHICLE, str(path), "--json", str(_result(path, first))]
    began = perf_counter()
    with open(os.devnull, "w") as silent:
        dup = [(os.POSIX_SPAWN_DUP2, silent.fileno(), stream) for stream in (1, 2)]
        program = [sys.executable, "-m", "undertow", *words]
        number = os.posix_spawn(program[0], program, os.environ, file_actions=dup)
        _, status, used = os.wait4(number, 0)
    return Cost(
        log.title,
        command,
        perf_counter() - began,
        used.ru_utime + used.ru_stime,
        1024 * used.ru_maxrss,
        os.waitstatus_to_exitcode(status),
    )


def _result(path: Path, command: str) -> Path:
    return path.with_name(f"{path.stem}-{command}.json")


def page(costs: Sequence[Cost], folder: Path) -> str:
    """The page: its text, with what was measured."""
    rows = [
        f"| {c.log} | `{c.command}` | {c.seconds:.0f} | {c.processor:.0f} | {c.memory / 1e6:.0f} |"
        for c in costs
    ]
    found = [
        line
        for log, command in (("hour", "diagnose"), ("day", "diagnose"))
        if (file := folder / f"{log}-{command}.json").exists()
        for line in _found(log, json.loads(file.read_text()))
    ]
    marks = {
        "COSTS": rows,
        "FOUND": found,
        "BIASES": [f"| {k} | {rms:.2f} | {n} {e:+.2f} |" for k, rms, n, e in biases()],
    }
    text = PAGE.read_text(encoding="utf-8")
    for mark, lines in marks.items():
        text = text.replace(f"<{mark}>", "\n".join(lines))
    return text


def _found(log: str, diagnosis: dict[str, object]) -> list[str]:
    from undertow.identification.findings import LongLogs

    long = LongLogs.model_validate(diagnosis["long_logs"])
    lines = [str(diagnosis["headline"]), *long.sentences()]
    return [f"$ undertow diagnose {VEHICLE} {log}.parquet", *lines, ""]


if __name__ == "__main__":
    raise SystemExit(main())
