"""Make the table of docs/field-logs.md: `python -m benchmarks.formats --folder F --out docs/field-logs.md`.

Every command runs on a log of every format, in this process. Results are kept as JSON, so that some formats
can be tried anew (`--only dive.bin`). Gliders need the sample of dbdreader, as tests do that read it.
"""

from __future__ import annotations

import argparse
import json
import os
import re
from collections.abc import Sequence
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from shutil import rmtree

from benchmarks.shell import in_page
from undertow.cli.main import main as undertow
from undertow.files import read_toml, write_whole
from undertow.identification.logs.mapping import read_mapping

from .made import FIELD, KINDS, Kind, vehicle_for

RESULTS = Path(__file__).with_name("results.json")
BEGIN, END = "<!-- made by python -m benchmarks.formats -->\n", "<!-- end of what is made -->\n"


@dataclass(frozen=True)
class Command:
    """A command, and the words that it gets."""

    title: str
    words: str  # {vehicle} and {surge} are vehicles, {log} is the log


COMMANDS = (
    Command("`doctor`", "doctor {vehicle} {log} --plot used.png"),
    Command("`compare`", "compare {vehicle} {log}"),
    Command("`fit`", "fit {vehicle} {log} --method weak"),
    Command("`diagnose`", "diagnose {surge} {log}"),
    Command("`add`", "add ocean_current {vehicle} {log} --out added.toml --force"),
    Command("`plan`", "plan {vehicle} {log} --duration 10 --tries 1"),
    Command("`identify`", "identify {surge} {log}"),
    Command("`observe`", "observe {vehicle} {log}"),
    Command("`fleet diagnose`", "fleet diagnose {surge} {log} --workers 0"),
    Command("`fleet rollouts`", "fleet rollouts {vehicle} {log} --workers 0 --count 10 --horizon 2"),
    Command("`import`", "import {log} --vehicle {vehicle} --out table.parquet --force"),
    Command("`map new`", "map new {log} --out map.toml --force"),
    Command("`vehicle new --log`", "vehicle new --log {log} --out new.toml --force"),
)


def main(arguments: list[str] | None = None) -> int:
    """Run the commands, keep what came out, write the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.formats", description=__doc__)
    parser.add_argument("--folder", type=Path, required=True, help="gets the logs")
    parser.add_argument(
        "--out", type=Path, help="page to write the table into; printed where it is not given"
    )
    parser.add_argument("--only", action="append", metavar="FILE", help="try some formats anew, or 'none'")
    parser.add_argument("--command", action="append", metavar="WORD", help="try some commands anew")
    options = parser.parse_args(arguments)
    options.folder.mkdir(parents=True, exist_ok=True)
    os.environ["COLUMNS"] = "1000"
    known = json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.exists() else {}
    for kind in (k for k in KINDS if not options.only or k.name in options.only):
        asked = [c for c in COMMANDS if not options.command or set(options.command) & set(c.words.split())]
        known[kind.name] = known.get(kind.name, {}) | _tried(kind, options.folder.absolute(), asked)
        write_whole(RESULTS, json.dumps(known, indent=1, ensure_ascii=False) + "\n")
    if not options.only or "real" in options.only:
        with chdir(options.folder):
            real = {
                f"{name}: {words}": _answer(name, words) for name, words in REAL if (FIELD / name).exists()
            }
        known["real"] = real or known.get("real", {})
        write_whole(RESULTS, json.dumps(known, indent=1, ensure_ascii=False) + "\n")
    text = table(known) + real_table(known.get("real", {}))
    if options.out is None:
        print(text)
        return 0
    write_whole(options.out, in_page(options.out.read_text(encoding="utf-8"), text, BEGIN, END))
    return 0


LONGEST = 300  # characters of a line with which a command refuses
REAL = (
    ("small.BIN", "import LOG --list"),
    ("small.BIN", "vehicle new --log LOG --out real.toml --force"),
    ("small.BIN", "doctor real.toml LOG"),
    ("small.tlog", "import LOG --list"),
    ("small.tlog", "vehicle new --log LOG --out real.toml --force"),
    ("small.tlog", "doctor real.toml LOG"),
    ("small.tlog", "compare real.toml LOG"),
    ("small.tlog", "fit real.toml LOG"),
    ("small.tlog", "plan real.toml --limit 1 --duration 20 --tries 2"),
    ("px4/sample_log_small.ulg", "import LOG --list"),
    ("px4/sample_log_small.ulg", "import LOG --out real.parquet --force"),
    ("ros2/wbag", "import LOG --list"),
    ("ros2/cdr_test", "import LOG --list"),
    ("glider/amadeus-2014-204-05-000.dbd", "import LOG --out real.parquet --force"),
    ("glider/amadeus-2014-204-05-000.dbd", "doctor glider LOG"),
    ("glider/amadeus-2014-204-05-000.dbd", "compare glider LOG"),
    ("glider/amadeus-2014-204-05-000.ebd", "import LOG --out real.parquet --force"),
    ("glider/01600001.dcd", "import LOG --out real.parquet --force"),
)
"""Files of public repositories, under the folder of `FIELD`, and the words that a command gets."""


def _answer(name: str, words: str) -> str:
    """What a command says of a real file: its refusal, or how many lines and the last of them."""
    out, error, log = StringIO(), StringIO(), str(FIELD / name)
    with redirect_stdout(out), redirect_stderr(error):
        code = undertow([log if word == "LOG" else word for word in words.split()])
    print(code, name, words, flush=True)
    said = [" ".join(line.split()) for line in (out if code in (0, 1) else error).getvalue().splitlines()]
    lines = [line.replace(log, "LOG") for line in said if line]
    if "--list" in words:
        rows = [line for line in lines if (cells := line.split())[1:] and cells[1].isdigit()]
        return f"{len(rows)} series"
    if words.startswith("import"):
        channels = (column.channel for column in read_mapping("real.toml").columns.values())
        return f"read: {', '.join(channels)}"
    if words.startswith("vehicle"):
        return str(read_toml("real.toml", "vehicle file")["description"])
    return lines[-1].removeprefix("error: ")


def real_table(real: dict[str, str]) -> str:
    """What commands say of real files."""
    rows = ["", "| real file | command | what comes of it |", "|---|---|---|"]
    for asked, said in real.items():
        name, words = asked.split(": ", 1)
        rows.append(f"| {name} | `{words}` | {said.replace('|', '/')} |")
    return "\n".join([*rows, ""]) if real else ""


def _tried(kind: Kind, folder: Path, commands: Sequence[Command]) -> dict[str, str]:
    """What each command says of a log: nothing, or the line with which it refuses."""
    place = folder / kind.name.replace(".", "-")
    rmtree(place, ignore_errors=True)  # a bag is not written over another
    place.mkdir()
    log = kind.write(place / kind.name)
    if not log.exists():
        return {}
    named = {
        "log": str(log),
        "vehicle": vehicle_for(kind, folder, '"surge", "sway", "yaw"'),
        "surge": vehicle_for(kind, folder, '"surge"'),
    }
    with chdir(folder):
        return {c.title: _said(c.words.format(**named).split(), named) for c in commands}


def _said(words: list[str], named: dict[str, str]) -> str:
    error = StringIO()
    with redirect_stdout(StringIO()), redirect_stderr(error):
        code = undertow(words)
    print(code, *words, flush=True)
    if code in (0, 1):
        return ""
    line = error.getvalue().strip().splitlines()[-1]
    for what, path in named.items():
        if "/" in path:
            line = line.replace(path, "LOG" if what == "log" else "VEHICLE")
    return line.removeprefix("error: ")


def table(known: dict[str, dict[str, str]]) -> str:
    """The table, with the lines with which commands refuse below it."""
    kinds = [kind for kind in KINDS if known.get(kind.name)]
    lines: dict[str, int] = {}
    rows = ["| | " + " | ".join(k.title for k in kinds) + " |", "|---" * (len(kinds) + 1) + "|"]
    for command in COMMANDS:
        said = [_without_names(known[kind.name].get(command.title, "")) for kind in kinds]
        cells = [f"[{lines.setdefault(line, len(lines) + 1)}]" if line else "yes" for line in said]
        rows.append(f"| {command.title} | " + " | ".join(cells) + " |")
    notes = [f"{number}. {_cut(line)}" for line, number in lines.items()]
    return "\n".join([*rows, "", *notes, ""])


def _without_names(line: str) -> str:
    """A line that says the same of several formats."""
    return re.sub(r"is in .*? format, not a table", "is in FORMAT format, not a table", line)


def _cut(line: str) -> str:
    """The beginning of a long line, as Markdown takes it."""
    short = line if len(line) <= LONGEST else f"{line[:LONGEST].rsplit(' ', 1)[0]} …"
    return short.replace("<", "&lt;").replace("*", r"\*")


if __name__ == "__main__":
    raise SystemExit(main())
