"""How the objects of the API show themselves in a notebook."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape


def html(line: str, head: Sequence[str] = (), rows: Iterable[Sequence[object]] = ()) -> str:
    """A line of text and, where there is a head, a table: numbers with five digits, None as nothing."""
    said = f"<p>{escape(line)}</p>"
    if not head:
        return said
    body = "".join(_row("td", map(_text, row)) for row in rows)
    return f"{said}<table><thead>{_row('th', head)}</thead><tbody>{body}</tbody></table>"


def _row(tag: str, cells: Iterable[str]) -> str:
    return "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells) + "</tr>"


def _text(cell: object) -> str:
    if cell is None:
        return ""
    return f"{cell:.5g}" if isinstance(cell, float) else str(cell)
