"""Command line: python -m benchmarks.identification --help"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from benchmarks.progress import clear, progress_line
from undertow import __version__
from undertow.errors import UndertowError
from undertow.files import write_whole
from undertow.identification.report.page import versions

from .cfd import estimates
from .hardships import hardships
from .page import BIASES, Beyond, page
from .pictures import draw, draw_biases
from .study import study
from .towing import towing
from .variables import biases

PICTURE = "identification-spread.png"


def main(arguments: list[str] | None = None) -> int:
    """Make the page; 0 when all went well, 2 when the data cannot be read."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.identification", description=__doc__)
    parser.add_argument("--draws", type=int, default=200, help="of each noise (default %(default)s)")
    parser.add_argument("--more", type=int, default=40, help="draws of the rest (default %(default)s)")
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="default: %(default)s")
    parser.add_argument(
        "--out", type=Path, default=Path("docs/identification.md"), help="default: %(default)s"
    )
    options = parser.parse_args(arguments)
    try:
        folder = options.data / "cfd-surge"
        box = estimates(folder) if folder.is_dir() else []
        basin = options.data / "ntnu-cse1"
        towed = towing(basin) if basin.is_dir() else None
        levels = study(options.draws, progress_line("profile P"))
        variables = biases(options.more, progress_line("errors in variables"))
        hard = hardships(options.more, progress_line("outliers and disturbances"))
        clear()
    except UndertowError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    draw(levels[1], options.out.parent / "images" / PICTURE)
    beyond = Beyond(options.more, variables, hard)
    draw_biases(variables, options.out.parent / "images" / BIASES)
    making = _making(options.draws, options.more)
    write_whole(options.out, page(levels, options.draws, box, making, beyond, towed))
    return 0


def _making(draws: int, more: int) -> str:
    used = ", ".join(f"{name} {version}" for name, version in versions().items())
    return (
        "## How it was made\n\n"
        f"    python -m benchmarks.identification --draws {draws} --more {more} --data ../shared/data\n\n"
        f"undertow {__version__}; {used}.\n"
    )


if __name__ == "__main__":
    sys.exit(main())
