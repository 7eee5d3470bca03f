"""Printing of headings, tables and JSON; what comes from files is printed as it stands, never as markup."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from typing import Any

import typer


def print_json(content: Any) -> None:
    """Print plain data as JSON on stdout."""
    typer.echo(json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False))


def console() -> Any:
    """The terminal, or whatever stdout is at the moment."""
    from rich.console import Console

    return Console(highlight=False)


def text(content: str, style: str = "") -> Any:
    """Text without markup; control characters out of files are shown and not sent to the terminal."""
    from rich.text import Text

    shown = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in content)
    return Text(shown, style=style)


def section(title: str, content: Any = None) -> None:
    """Print a heading, and what stands below it."""
    out = console()
    out.print()
    out.print(text(title, "bold"))
    if content is not None:
        out.print(content)


def table(columns: Sequence[str], rows: Iterable[Sequence[Any]], indent: int = 2) -> Any:
    """A table without lines; without a head where all columns are nameless.

    Parameters
    ----------
    columns
        Heads of the columns.
    rows
        Cells, as strings (taken as they stand) or as `text`.
    indent
        Blanks at the left.
    """
    from rich.padding import Padding
    from rich.table import Table

    grid = Table(*columns, box=None, pad_edge=False, header_style="dim", show_header=any(columns))
    for row in rows:
        grid.add_row(*(text(cell) if isinstance(cell, str) else cell for cell in row))
    return Padding(grid, (0, 0, 0, indent))
