"""Make docs/fleet.md: `python -m benchmarks.fleet --out docs/fleet.md`."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from contextlib import chdir
from pathlib import Path
from tempfile import TemporaryDirectory

from undertow.files import write_whole

from . import costs
from .made import days, folder_with_vehicle, fouling, write
from .names import counted, table
from .page import Costs, page

ROOT = Path(__file__).parents[2]
_LOGS, _ROWS = 12, 4000
_MEMORY = (20_000, 80_000)
_COMMANDS = (
    "undertow fleet diagnose craft.toml 'logs/**/*.parquet' --workers 2 --out report",
    "undertow fleet rollouts craft.toml logs/vehicle=alfa/day=2026-01-02/part.parquet --count 200",
)


def main(arguments: list[str] | None = None) -> int:
    """Run the example, measure, write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.fleet", description=__doc__)
    parser.add_argument("--out", type=Path, help="page to write; printed where it is not given")
    options = parser.parse_args(arguments)
    shown, report = example()
    text = page(shown, report, table(counted()), measured())
    if options.out is None:
        print(text)
    else:
        write_whole(options.out, text)
    return 0


def example() -> tuple[list[tuple[str, str]], str]:
    """Commands with what they printed, and the report, of a fleet of three."""
    with TemporaryDirectory() as name, chdir(name):
        vehicle, own = folder_with_vehicle(Path(name)), days(months=4, each=5)
        length = (own[-1] - own[0]).days
        shares = [(d, (d - own[0]).days / length) for d in own]
        write(Path("logs"), vehicle, "alfa", [(d, {}) for d, _ in shares])
        write(Path("logs"), vehicle, "bravo", [(d, fouling(0.4 * s)) for d, s in shares])
        write(Path("logs"), vehicle, "charlie", [(d, {"gain_error_port": -0.25 * s}) for d, s in shares])
        (Path("logs") / "vehicle=alfa" / f"day={own[3]}" / "part.parquet").write_bytes(b"PAR1 cut off")
        shown = [(command, _printed(command)) for command in _COMMANDS]
        return shown, _plain(Path("report/report.md").read_text(encoding="utf-8"))


def _plain(printed: str) -> str:
    """Without the folder in which it was printed."""
    return printed.replace(f"{Path.cwd().resolve()}/", "")


def _printed(command: str) -> str:
    words = command.replace("'", "").split()[1:]
    places = os.pathsep.join(map(str, (ROOT / "src", ROOT)))
    done = subprocess.run(
        [sys.executable, "-m", "undertow", *words],
        env={**os.environ, "PYTHONPATH": places, "COLUMNS": "110"},
        capture_output=True,
        text=True,
        check=False,
    )
    return f"{_plain(done.stdout + done.stderr)}(exit code {done.returncode})"


def measured() -> Costs:
    """Rows per second and memory."""
    with costs.material(_LOGS, _ROWS) as given:
        times, results = {}, {}
        for workers in (0, 1, 2):
            with costs.ready(given, workers) as doing:
                results[workers] = costs.worked(given, doing)
                times[workers] = costs.seconds(lambda doing=doing: costs.worked(given, doing))  # type: ignore[misc]
        apart = max(costs.apart(results[w], results[0]) for w in (1, 2))
        rates = {w: given.total / t for w, t in times.items()}
    memory = {rows: costs.peak_of_worker(rows) for rows in _MEMORY}
    size = sum(os.path.getsize(p) for p in given.paths) if all(map(os.path.exists, given.paths)) else 0
    return Costs(given.total, rates, apart, memory, size, os.getloadavg()[0], os.cpu_count() or 1)


if __name__ == "__main__":
    sys.exit(main())
