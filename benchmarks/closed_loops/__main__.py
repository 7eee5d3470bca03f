"""Writes docs/closed-loops.md and its pictures: python -m benchmarks.closed_loops --help"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from undertow.errors import UndertowError
from undertow.files import write_whole

from ..progress import clear, progress_line
from .page import Material, page
from .pictures import draw
from .runs import long_pid, paper_run, read, sampled_signs, six


def main(arguments: list[str] | None = None) -> int:
    """Make the page; 0 when all went well, 2 when something is missing."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.closed_loops", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/closed-loops.md"), help="default: %(default)s")
    options = parser.parse_args(arguments)
    tell = progress_line("closed loops")
    try:
        material = Material(paper_run(), long_pid(), read(tell), sampled_signs(), six(tell))
    except UndertowError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    clear()
    draw(material.run, material.long, options.out.parent / "images")
    write_whole(options.out, page(material))
    return 0


if __name__ == "__main__":
    sys.exit(main())
