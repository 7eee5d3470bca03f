"""Small edits of a TOML document that leave its comments where a reader expects them."""

from __future__ import annotations

from typing import Any

import tomlkit
from tomlkit.items import AoT, InlineTable, Table, Whitespace


def safe(value: Any) -> Any:
    """A value that can be written: what is no text in any encoding becomes a question mark."""
    if isinstance(value, str):
        return str(value).encode("utf-8", "replace").decode("utf-8")
    return value


def append(table: Any, key: str, item: Any) -> None:
    """Add a key at the end of a table, before the comment that belongs to what follows the table."""
    tail = _cut(table)
    table.append(key, item)
    _paste(table, tail)


def append_table(document: Any, parent: str, key: str, table: Any) -> None:
    """Add a table ``[parent.key]`` after the last one of its kind."""
    parents = document[parent]
    if isinstance(parents, InlineTable):
        parents.append(key, table)
    elif isinstance(parents, Table):
        tail = _cut(_last(parents))
        parents.append(key, table)
        _paste(table, tail or [(None, Whitespace("\n"))])
    else:  # several places of the file add to it
        outer = tomlkit.table(is_super_table=True)
        outer.append(key, table)
        document.append(parent, outer)


def _last(table: Any) -> Any:
    """The table that stands last inside a table, or the table itself."""
    inner = [v for _, v in table.value.body if isinstance(v, Table)]
    return _last(inner[-1]) if inner else table


def _cut(table: Any) -> list[Any]:
    """Take off what stands after the first blank line behind the last key."""
    if not isinstance(table, Table):
        return []
    body = table.value.body
    end = max((i + 1 for i, (key, _) in enumerate(body) if key is not None), default=0)
    blank = next((i for i in range(end, len(body)) if isinstance(body[i][1], Whitespace)), len(body))
    tail = body[blank:]
    del body[blank:]
    return tail


def _paste(table: Any, tail: list[Any]) -> None:
    if isinstance(table, Table):
        table.value.body.extend(tail)


def array_of_tables(document: Any, key: str) -> Any:
    """The array ``[[key]]`` of a document, made at its end where there is none."""
    if key not in document:
        document.append(None, Whitespace("\n"))
        document.append(key, AoT([]))
    return document[key]
