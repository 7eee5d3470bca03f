"""Command line: python -m benchmarks.profile --help"""

from __future__ import annotations

import argparse
import os
import platform
from pathlib import Path

from undertow.files import write_whole
from undertow.model.catalogue import catalogue

from .measure import growth, profiled, warmed_up
from .page import PICTURE, page
from .pictures import draw


def main() -> None:
    """Measure, write the page and its picture."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.profile", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/profile.md"), help="page to write")
    out: Path = parser.parse_args().out
    os.environ["UNDERTOW_JOBS"] = "1"  # what helper processes do cannot be seen from here
    warmed_up()
    profile = profiled(catalogue())
    draw(profile, out.parent / PICTURE)
    write_whole(out, page(profile, growth(), _machine()))


def _machine() -> str:
    python = f"Python {platform.python_version()}"
    return f"{os.cpu_count()} cores, {platform.system()} {platform.machine()}, {python}"


if __name__ == "__main__":
    main()
