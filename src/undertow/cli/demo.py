"""Work through bundled examples: where models fail, what is missing, and how the error falls.

First an AUV whose model lacks an effect, then a box-shaped hull in a flow solver that no simple model
explains, then an AUV in a virtual towing tank. Figures, reports and vehicle files are written to a folder;
open its index.html.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ._terminal import progress

_OUT = typer.Option(metavar="FOLDER", help="Output folder; it is created.")


def demo(out: Annotated[Path, _OUT] = Path("demo-output")) -> None:
    from rich.console import Console
    from rich.markup import escape

    from undertow.demo import examples, page
    from undertow.files import check_folder, make_folder, write_whole

    check_folder(out)
    make_folder(out)
    console, shown = Console(highlight=False), []
    for kind, content in examples(out, progress):
        shown.append((kind, content))
        if kind == "title":
            console.print(f"\n[bold]{escape(content)}[/bold]")
        elif kind == "text":
            console.print(escape(content))
        elif kind == "table":
            console.print(_table(*content))
    write_whole(out / "index.html", page(shown))
    console.print(f"\n[bold]All of this, with pictures: {escape(str(out / 'index.html'))}[/bold]")
    for name, what in (content for kind, content in shown if kind in ("file", "picture")):
        console.print(f"  {escape(str(out / name))}  [dim]{escape(what)}[/dim]", soft_wrap=True)


def _table(head: Any, rows: Any) -> Any:
    from rich.markup import escape
    from rich.table import Table

    table = Table()
    for i, name in enumerate(head):
        table.add_column(escape(name), justify="right" if i else "left")
    for row in rows:
        table.add_row(*map(escape, row))
    return table
