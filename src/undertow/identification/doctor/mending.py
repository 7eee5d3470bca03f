"""Changes of a mapping file: what they say in TOML, and the mapping with them."""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Mapping as TypingMapping
from typing import Any, NamedTuple

from ..logs import Mapping
from ..logs.frames import FLIPPED_BODY
from ..logs.mapping import SCHEMA, Column


class Edit(NamedTuple):
    """A key of a mapping file and its new value; `table` is empty for a key on top."""

    table: str
    key: str
    value: Any


Edits = tuple[Edit, ...]


def column_edit(mapping: Mapping, channel: str, **changes: Any) -> Edit:
    """Change how the column of a channel is read.

    Parameters
    ----------
    mapping : Mapping
        How the log was read.
    channel : str
        Name of the channel inside undertow (after the turn to NED).
    changes
        Attributes of `Column`; `times` multiplies its scale and its offset.
    """
    name, column = column_of(mapping, channel)
    times = changes.pop("times", 1.0)
    scaled = {"scale": times * column.scale, "offset": times * column.offset}
    changed = column.model_copy(update={**scaled, **changes})
    said = changed.model_dump(exclude_defaults=True)
    return Edit("columns", name, {"channel": changed.channel} | said)


def reassigned(mapping: Mapping, places: TypingMapping[str, tuple[str, float]]) -> Edits:
    """Let the columns of some channels become others, possibly with the opposite sign.

    Parameters
    ----------
    mapping : Mapping
        How the log was read.
    places : mapping
        Channel to (channel that the column stands for now, sign).
    """
    found = []
    for target, (source, sign) in places.items():
        name, column = column_of(mapping, source)
        times = sign * _axis_sign(mapping, source) * _axis_sign(mapping, target)
        said = column.model_copy(update={"scale": times * column.scale, "offset": times * column.offset})
        into = column_of(mapping, target)[1].channel
        found.append(Edit("columns", name, said.model_dump(exclude_defaults=True) | {"channel": into}))
    return tuple(found)


def _axis_sign(mapping: Mapping, channel: str) -> float:
    return -1.0 if mapping.frames.body == "FLU" and channel in FLIPPED_BODY else 1.0


def column_of(mapping: Mapping, channel: str) -> tuple[str, Column]:
    """Column of the log that becomes a channel; without a mapping it is called like the channel."""
    name = _in_the_file(mapping, channel)
    found = {c.channel: (n, c) for n, c in mapping.columns.items()}
    return found.get(name, (name, Column(channel=name)))


def _in_the_file(mapping: Mapping, channel: str) -> str:
    swapped = {"x": "y", "y": "x"} if mapping.frames.position == "ENU" else {}
    return swapped.get(channel, channel)


def frames_edits(mapping: Mapping, position: str, body: str, attitude: str) -> Edits:
    """Say the three frames; what the mapping says already, or need not say, is left out."""
    spec = mapping.frames
    implied = position if (position == "ENU") == (body == "FLU") else None
    said = {"position": position, "body": body, "attitude": None if attitude == implied else attitude}
    if said["attitude"] is None and spec.attitude not in (None, attitude):
        said["attitude"] = attitude
    changed = {k: v for k, v in said.items() if v is not None and v != getattr(spec, k)}
    return tuple(Edit("frames", k, v) for k, v in changed.items())


def attitude_of(mapping: Mapping) -> str:
    """How the angles of a log count, "NED" or "ENU"."""
    return mapping.frames.attitude or mapping.frames.position


def edited(mapping: Mapping, edits: Iterable[Edit]) -> Mapping:
    """The mapping with changes."""
    content = mapping.model_dump(by_alias=True, exclude_defaults=True)
    for table, key, value in edits:
        (content.setdefault(table, {}) if table else content)[key] = value
    return Mapping.model_validate(content | {"schema": SCHEMA})


def as_toml(edits: Iterable[Edit], *, whole: bool = False) -> str:
    """Changes as lines of a mapping file; with `whole` as a file of its own."""
    tables: dict[str, dict[str, Any]] = {}
    for table, key, value in edits:
        tables.setdefault(table, {})[key] = value
    parts = [_lines(tables.pop("", {}))]
    parts += [f"[{table}]\n{_lines(content)}" for table, content in tables.items()]
    head = f'schema = "{SCHEMA}"\n' if whole else ""
    return head + "\n".join(part for part in parts if part).strip()


def _lines(content: dict[str, Any]) -> str:
    import tomlkit

    return "\n".join(f"{tomlkit.key(k).as_string()} = {_value(v)}" for k, v in content.items())


def _value(value: Any) -> str:
    """One TOML value on one line."""
    import tomlkit

    if isinstance(value, dict):
        return "{ " + ", ".join(f"{k} = {_value(v)}" for k, v in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_value(v) for v in value) + "]"
    if isinstance(value, float):
        return f"{value:.6g}" if "." in f"{value:.6g}" or "e" in f"{value:.6g}" else f"{value:.6g}.0"
    return str(tomlkit.item(value).as_string())


def into_file(text: str, edits: Iterable[Edit]) -> str:
    """The text of a mapping file with changes; comments and order are kept."""
    import tomlkit

    document = tomlkit.parse(text)
    for table, key, value in edits:
        place: Any = document.setdefault(table, tomlkit.table()) if table else document
        place[key] = tomlkit.value(_value(value))
    return tomlkit.dumps(document)
