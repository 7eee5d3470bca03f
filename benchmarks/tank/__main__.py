"""Runs the virtual towing tank and writes docs/tank.md: python -m benchmarks.tank --help"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from undertow.errors import UndertowError
from undertow.figures import save_png
from undertow.files import write_whole

from ..progress import clear, progress_line
from .bodies import BODIES, drawing, results, run, shelf, ship
from .chain import compare
from .page import CHAIN, page

RESULTS = Path(__file__).parent / "results.json"
PICTURES = {
    name: (Path(f"docs/images/tank-{picture}.png"), case)
    for name, picture, case in (
        ("box", "box", "surge-push"),
        ("box-steps", "box-steps", "surge-step"),
        ("auv-across", "auv", "heave-step-forward"),
    )
}


def main(arguments: list[str] | None = None) -> int:
    """Run bodies or make the page; 0 when all went well, 2 without OpenFOAM."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.tank", description=__doc__)
    parser.add_argument(
        "what",
        choices=("run", "ship", "chain", "page"),
        help="run the solver, keep logs and what they say, fit those of the AUV, or make the page",
    )
    parser.add_argument("bodies", nargs="*", default=[], help=f"some of {', '.join(BODIES)}; default: all")
    parser.add_argument("--work", type=Path, default=Path("build/tank"), help="default: %(default)s")
    parser.add_argument("--out", type=Path, default=Path("docs/tank.md"), help="default: %(default)s")
    options = parser.parse_args(arguments)
    if wrong := [name for name in options.bodies if name not in BODIES]:
        parser.error(f"{wrong[0]} is no body: choose from {', '.join(BODIES)}")
    if options.what == "page":
        write_whole(options.out, page(_rows()))
        return 0
    if options.what == "ship":
        for name in options.bodies:
            ship(name, options.work)
            _store(name, results(name, shelf(name)))
        return 0
    if options.what == "chain":
        free = shelf("auv-paper")
        found = [row for forced in ("auv", "auv-across") for row in compare(shelf(forced), free)]
        write_whole(CHAIN, json.dumps(found, indent=1) + "\n")
        return 0
    for name in options.bodies or BODIES:
        try:
            found = run(name, options.work, progress_line(name))
        except UndertowError as error:
            print(f"error: {error}", file=sys.stderr)
            return 2
        clear()
        if name in PICTURES:
            path, case = PICTURES[name]
            save_png(drawing(name, options.work, case), path)
        _store(name, found)
    return 0


def _store(name: str, found: list[dict[str, Any]]) -> None:
    rows = [row for row in _rows() if row["body"] != name] + found
    rows.sort(key=lambda row: list(BODIES).index(row["body"]))
    write_whole(RESULTS, json.dumps(rows, indent=1) + "\n")


def _rows() -> list[dict[str, Any]]:
    return json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.exists() else []


if __name__ == "__main__":
    sys.exit(main())
