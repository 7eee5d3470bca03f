"""What the doctor says about logs, as it is written to JSON, and changes of a mapping file in TOML."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from collections.abc import Mapping as TypingMapping
from typing import Any, Literal, NamedTuple

from pydantic import Field

from undertow.identification.logs.mapping import (
    FLIPPED_BODY,
    SCHEMA,
    Channel,
    Column,
    LogMapping,
    seconds_of,
    turned_name,
)
from undertow.identification.long_logs.result import LongLogs, ResultTable

EXAMINATION_SCHEMA = "undertow/doctor/1"
Severity = Literal["mistake", "warning", "note"]
SEVERITIES: tuple[Severity, ...] = ("mistake", "warning", "note")


class Finding(ResultTable):
    """One thing that the logs show."""

    id: str  # kind of finding; stable between versions
    # A mistake is certain and spoils every result; a warning may; a note is for information.
    severity: Severity
    text: str  # one line with the numbers
    evidence: dict[str, float] = Field(default_factory=dict)  # the numbers behind it, SI
    mapping: str = ""  # lines for the mapping file that correct it, in TOML; empty if none can
    # Alternative correction in the vehicle file; empty if there is none.
    vehicle: str = ""
    alternatives: list[str] = Field(default_factory=list)  # other explanations that these logs do not exclude

    def clause(self, runs: Iterable[str] = ()) -> str:
        """What is wrong, without the evidence and the name of the run in front of it."""
        parts = [part for part in self.text.split(": ") if part not in runs]
        return parts[0].partition(":")[0]


class DofExcitation(ResultTable):
    """What happened in one degree of freedom."""

    # degree_of_freedom, velocity, unit: which one, the channel of its velocity, and the unit of that.
    degree_of_freedom: str
    velocity: str
    unit: str
    # rms, noise: of the velocity.
    rms: float
    noise: float
    # Share of the time in which it stands out of its noise and exceeds a tenth of its usual largest value.
    moving: float
    positive: float  # share of that time in the positive direction
    reversals: int  # changes of direction
    # Span of the force that the commands ask for, over the largest that they could; None: no limit is known
    # or nothing acts there.
    command_range: float | None
    cannot: list[str]  # what cannot be identified from it


class Examination(ResultTable):
    """Outcome of `undertow doctor`."""

    schema_id: str = EXAMINATION_SCHEMA
    undertow: str
    vehicle: str
    runs: list[str]
    findings: list[Finding]  # the most serious first
    excitation: list[DofExcitation]
    seconds: float
    # How logs were thinned that are longer than this takes, and which stretches were used; null of others.
    long_logs: LongLogs | None = None

    @property
    def mistakes(self) -> list[Finding]:
        """The findings that are mistakes."""
        return [f for f in self.findings if f.severity == "mistake"]


def percent(share: float) -> str:
    """A share in percent, with two digits where that says something."""
    if share < 1e-4:
        return "< 0.01 %"
    return f"{100 * share:.0f} %" if share >= 0.1 else f"{100 * share:.2g} %"


class Edit(NamedTuple):
    """A key of a mapping file and its new value; `table` is empty for a key on top."""

    table: str
    key: str
    value: Any


Edits = tuple[Edit, ...]


def column_edit(mapping: LogMapping, channel: str, **changes: Any) -> Edit:
    """Change attributes of the column of a channel; `times` multiplies its scale and its offset.

    Of a channel that is a formula, they change the formula.
    """
    name, column = column_of(mapping, channel)
    if name in mapping.channels:
        return _formula_edit(name, mapping.channels[name], changes)
    times = changes.pop("times", 1.0)
    scaled = {"scale": times * column.scale, "offset": times * column.offset}
    changed = column.model_copy(update={**scaled, **changes})
    content = changed.model_dump(exclude_defaults=True)
    return Edit("columns", name, {"channel": changed.channel} | content)


def _formula_edit(name: str, computed: Channel, changes: dict[str, Any]) -> Edit:
    """The same of a formula, which has its scale and its offset in its arithmetic."""
    times = changes.pop("times", 1.0) * changes.pop("scale", 1.0)
    offset = changes.pop("offset", 0.0)
    text = computed.expression if times == 1.0 else f"{times:.9g} * ({computed.expression})"
    text = text if offset == 0.0 else f"{text} + {offset:.9g}"
    changed = computed.model_copy(update={"expression": text, **changes})
    return Edit("channels", name, changed.model_dump(exclude_defaults=True))


def delay_edit(mapping: LogMapping, channel: str, more: float) -> Edit:
    """Add so many seconds to the delay of the column, or of the expression, that becomes a channel."""
    given = column_of(mapping, channel)[1].delay
    return column_edit(mapping, channel, delay=f"{seconds_of(given, channel) + more:.3g} s")


def reassigned(mapping: LogMapping, places: TypingMapping[str, tuple[str, float]]) -> Edits:
    """Let columns of channels become others: channel to (channel that its column stands for now, sign).

    Formulas are exchanged among themselves. Between a formula and a column nothing is said: the line of the
    formula would have to go.
    """
    signs = {t: sign * _axis_sign(mapping, s) * _axis_sign(mapping, t) for t, (s, sign) in places.items()}
    computed = [column_of(mapping, s)[0] in mapping.channels for s, _ in places.values()]
    if any(computed) and not all(computed):
        return ()
    if any(computed):
        moved = [(t, column_edit(mapping, s, times=signs[t]).value) for t, (s, _) in places.items()]
        return tuple(Edit("channels", column_of(mapping, t)[0], v) for t, v in moved)
    found = []
    for target, (source, _) in places.items():
        name, column = column_of(mapping, source)
        times = signs[target]
        turned = column.model_copy(update={"scale": times * column.scale, "offset": times * column.offset})
        into = column_of(mapping, target)[1].channel
        found.append(Edit("columns", name, turned.model_dump(exclude_defaults=True) | {"channel": into}))
    return tuple(found)


def _axis_sign(mapping: LogMapping, channel: str) -> float:
    return -1.0 if mapping.frames.body == "FLU" and channel in FLIPPED_BODY else 1.0


def column_of(mapping: LogMapping, channel: str) -> tuple[str, Column]:
    """Column of the log that becomes a channel, or what stands for it.

    Without a mapping it is called like the channel, as is a formula.
    """
    name = turned_name(channel, mapping.frames.position)
    found = {c.channel: (n, c) for n, c in mapping.columns.items()}
    computed = mapping.channels.get(name)
    if computed is not None:  # a formula: its result is as a column without a scale
        said = {"unit": computed.unit, "delay": computed.delay, "wrapped": computed.wrapped}
        return name, Column.model_validate({"channel": name, **said})
    return found.get(name, (name, Column(channel=name)))


def frames_edits(mapping: LogMapping, position: str, body: str, attitude: str) -> Edits:
    """Say the three frames; what the mapping says already, or need not say, is left out.

    Velocities along the earth have the axes of the position, which they turn with.
    """
    spec = mapping.frames
    implied = position if (position == "ENU") == (body == "FLU") else None
    frames = {"position": position, "body": body, "attitude": None if attitude == implied else attitude}
    if frames["attitude"] is None and spec.attitude not in (None, attitude):
        frames["attitude"] = attitude
    if spec.velocity != "body" and position != spec.position:
        frames["velocity"] = "ENU" if spec.velocity == "NED" else "NED"
    changed = {k: v for k, v in frames.items() if v is not None and v != getattr(spec, k)}
    return tuple(Edit("frames", k, v) for k, v in changed.items())


def attitude_of(mapping: LogMapping) -> str:
    """How the angles of a log count, "NED" or "ENU"."""
    return mapping.frames.attitude or mapping.frames.position


def edited(mapping: LogMapping, edits: Iterable[Edit]) -> LogMapping:
    """The mapping with changes."""
    content = mapping.model_dump(by_alias=True, exclude_defaults=True)
    for table, key, value in edits:
        (content.setdefault(table, {}) if table else content)[key] = value
    return LogMapping.model_validate(content | {"schema": SCHEMA})


def as_toml(edits: Iterable[Edit]) -> str:
    """Changes as lines of a mapping file."""
    tables: dict[str, dict[str, Any]] = {}
    for table, key, value in edits:
        tables.setdefault(table, {})[key] = value
    parts = [_lines(tables.pop("", {}))]
    parts += [f"[{table}]\n{_lines(content)}" for table, content in tables.items()]
    return "\n".join(part for part in parts if part).strip()


def read_edits(lines: str) -> Edits:
    """The changes that the lines of a finding stand for: the way back of `as_toml`."""
    content = tomllib.loads(lines)
    tables = {key: value for key, value in content.items() if isinstance(value, dict)}
    on_top = [Edit("", key, value) for key, value in content.items() if key not in tables]
    inside = [Edit(table, key, value) for table, own in tables.items() for key, value in own.items()]
    return (*on_top, *inside)


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
