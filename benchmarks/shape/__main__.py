"""Writes docs/shape.md: python -m benchmarks.shape --help"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from undertow.errors import UndertowError
from undertow.files import write_whole
from undertow.shape.panels import PANEL_RULES

from ..progress import clear, progress_line
from .bodies import measure
from .page import page


def main(arguments: list[str] | None = None) -> int:
    """Make the page; 0 when all went well, 2 without capytaine."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.shape", description=__doc__)
    parser.add_argument(
        "--panels", type=int, default=PANEL_RULES.finest, help="of the finest mesh (default %(default)s)"
    )
    parser.add_argument("--out", type=Path, default=Path("docs/shape.md"), help="default: %(default)s")
    options = parser.parse_args(arguments)
    try:
        measured = measure(options.panels, progress_line("bodies"))
    except UndertowError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    clear()
    write_whole(options.out, page(measured, options.panels))
    return 0


if __name__ == "__main__":
    sys.exit(main())
