"""ROS 1 .bag, ROS 2 .db3 and .mcap, and folders of rosbag2 (with metadata.yaml), by rosbags.

Every topic is a series with all its numbers by name (``pose.pose.position.x``), decoded when they are asked
for. Its times are those of the headers of its messages, where they have any and the clock is that of the bag;
else when they were recorded. What the usual messages mean is said in `ros_meaning`.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from undertow.errors import UndertowError
from undertow.typing import Array, Flags

from .fieldlog import FieldLog, Format, Series, library
from .ros_meaning import Topic, derived, meaning

_WHAT = "a log of ROS"


@dataclass(frozen=True)
class RosSettings:
    """Numbers that decide what of a bag is read."""

    # Elements of a list that become columns, at most: commands and beams, but no covariances of six by six.
    longest: int = 16
    largest: int = 16384  # bytes; longer messages are pictures and clouds of points
    # Seconds between the stamps of a topic and the clock of the bag, beyond which they are of another clock.
    apart: float = 10.0
    kept: int = 400_000_000  # bytes of messages that are held at once
    together: int = 10_000  # messages that are decoded at once: an object takes ten times its bytes


SETTINGS = RosSettings()


@dataclass
class _Records:
    """What a bag holds of one topic."""

    type: str
    stamps: list[int]  # when recorded, ns
    raw: list[bytes]


class _Decoded(Mapping[str, Array]):
    """Columns of a topic, decoded when first asked for."""

    def __init__(self, columns: Callable[[], dict[str, Array]]) -> None:
        self._decode = columns

    @cached_property
    def _columns(self) -> dict[str, Array]:
        return self._decode()

    def __getitem__(self, name: str) -> Array:
        return self._columns[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)


def _read(path: Path, messages: Path | None) -> FieldLog:
    try:
        records, types, notes = _recorded(path, messages)
    except MemoryError as error:  # a damaged length asks for it, too
        raise UndertowError(f"log {path} is damaged, or larger than the memory: copy it again") from error
    if not records:
        what = "; ".join(notes) or "check what was recorded"
        raise UndertowError(f"log {path} has no message with numbers in it: {what}")
    begin = min(min(one.stamps) for one in records.values())
    topics = {}
    for name, one in records.items():
        t, note = _times(one, types, begin)
        topic = _topic(name, one, types, t)
        if topic is not None:
            topics[name] = topic
        notes += [f"{name}: {note}"] if note else []
        notes += [] if topic else [f"{name}: no message can be decoded: left out"]
    mapping, actuators, said = meaning(list(topics.values()))
    series = {name: topic.series for name, topic in topics.items()}
    return FieldLog(path, FORMAT.name, series, mapping, actuators, notes=tuple(notes), remarks=tuple(said))


# --- from the file to records ---------------------------------------------------------------------
class _Types:
    """Definitions of messages, and what they make of bytes."""

    def __init__(self, store: Any, ros1: bool) -> None:
        self.store, self.ros1 = store, ros1

    def known(self, name: str) -> bool:
        """Whether a type and all in it are defined."""
        fields = self.store.fielddefs.get(name)
        return fields is not None and all(self._defined(kind) for _, kind in fields[1])

    def _defined(self, field: tuple[int, Any]) -> bool:
        kind, inner = field
        if kind == _NAME:
            return self.known(inner)
        return kind == _BASE or self._defined(inner[0])

    def has_header(self, name: str) -> bool:
        """Whether messages of a type begin with a header."""
        fields = self.store.fielddefs[name][1]
        return bool(fields) and fields[0][1] == (_NAME, "std_msgs/msg/Header")

    def message(self, raw: bytes, name: str) -> Any:
        """The message of some bytes."""
        decode = self.store.deserialize_ros1 if self.ros1 else self.store.deserialize_cdr
        return decode(raw, name)

    def sound(self, raw: bytes, name: str) -> Any:
        """The message of some bytes; None for damaged ones."""
        try:
            return self.message(raw, name)
        except Exception:  # whatever the library makes of them
            return None

    def numbers(self, name: str, messages: list[Any]) -> dict[str, Array]:
        """All numbers of messages of a type, by name."""
        found: dict[str, Array] = {}
        for field, kind in self.store.fielddefs[name][1]:
            values = [getattr(message, field) for message in messages]
            found |= {f"{field}{rest}": column for rest, column in self._columns(kind, values)}
        return found

    def _columns(self, field: tuple[int, Any], values: list[Any]) -> Iterator[tuple[str, Array]]:
        kind, inner = field
        if kind == _BASE:
            if "string" not in inner[0] and inner[0] != "wchar":
                yield "", np.array(values, dtype=float)
        elif kind == _NAME:
            yield from ((f".{name}", column) for name, column in self.numbers(inner, values).items())
        else:
            yield from self._elements(inner[0], values)

    def _elements(self, element: tuple[int, Any], values: list[Any]) -> Iterator[tuple[str, Array]]:
        counts = np.array([len(value) for value in values])
        if np.max(counts, initial=0) > SETTINGS.longest:
            return
        for k in range(int(np.max(counts, initial=0))):
            there = counts > k
            cells = [value[k] for value in values if len(value) > k]
            for rest, known in self._columns(element, cells):
                column = np.full(len(values), np.nan)
                column[there] = known
                yield f"[{k}]{rest}", column


_BASE, _NAME = 1, 2  # of rosbags.interfaces.Nodetype


def _recorded(path: Path, messages: Path | None) -> tuple[dict[str, _Records], _Types, list[str]]:
    typesys = library("rosbags.typesys", _WHAT)
    ros1 = path.suffix == ".bag"
    with library("rosbags.rosbag1" if ros1 else "rosbags.rosbag2", _WHAT).Reader(path) as reader:
        known = {} if ros1 else typesys.get_typestore(typesys.Stores.LATEST).fielddefs
        own = _definitions(messages, typesys) if messages else {}
        store = typesys.get_typestore(typesys.Stores.EMPTY)
        store.register({**own, **known, **_defined_in(reader.connections, typesys)})
        types = _Types(store, ros1)
        readable = [c for c in reader.connections if types.known(c.msgtype)]
        strange = [c for c in reader.connections if c not in readable and "/srv/" not in c.msgtype]
        unknown = {c.topic: c.msgtype for c in strange}
        records, large = _collected(path, reader.messages(readable) if readable else [], readable)
    notes = [
        f"{topic} has messages of the unknown type {name}: give the folder with its definition (--messages)"
        for topic, name in unknown.items()
    ]
    notes += [f"{topic} has messages too large to be measurements: left out" for topic in sorted(large)]
    return records, types, notes


def _defined_in(connections: Iterable[Any], typesys: Any) -> dict[str, Any]:
    """Types that the bag itself defines, without those that cannot be parsed, as of events of services."""
    found: dict[str, Any] = {}
    for connection in connections:
        text = connection.msgdef.data
        with suppress(typesys.TypesysError):
            if connection.msgdef.format.name == "MSG":
                found |= typesys.get_types_from_msg(text, connection.msgtype)
            else:  # several follow each other below lines of their own
                for part in re.split(r"={80}\nIDL: .*\n", text):
                    found |= typesys.get_types_from_idl(part) if part.strip() else {}
    return found


def _collected(path: Path, messages: Any, connections: list[Any]) -> tuple[dict[str, _Records], set[str]]:
    types: dict[str, set[str]] = defaultdict(set)
    for connection in connections:
        types[connection.topic].add(connection.msgtype)
    records: dict[str, _Records] = {}
    large: set[str] = set()
    kept = 0
    for connection, stamp, raw in messages:
        name = connection.topic if len(types[connection.topic]) == 1 else _typed(connection)
        if name in large:
            continue
        if len(raw) > SETTINGS.largest:
            large.add(name)
            lost = records.pop(name, None)
            kept -= sum(map(len, lost.raw)) if lost else 0
            continue
        kept += len(raw)
        if kept > SETTINGS.kept:
            raise UndertowError(
                f"log {path} has more than {SETTINGS.kept / 1e6:g} MB of messages with measurements: "
                "rosbags-convert --src LOG --dst LESS --include-topic TOPIC TOPIC leaves topics out"
            )
        one = records.setdefault(name, _Records(connection.msgtype, [], []))
        one.stamps.append(stamp)
        one.raw.append(bytes(raw))
    return records, large


def _typed(connection: Any) -> str:
    return f"{connection.topic} ({connection.msgtype})"


def _definitions(folder: Path, typesys: Any) -> dict[str, Any]:
    """Types defined by the .msg files of a folder: package/msg/Name.msg, or package/Name.msg."""
    files = sorted(folder.rglob("*.msg"))
    if not files:
        raise UndertowError(f"folder {folder} has no message definitions: it needs files such as Name.msg")
    found: dict[str, Any] = {}
    for file in files:
        holder = file.parent.parent if file.parent.name == "msg" else file.parent
        name = f"{holder.resolve().name}/msg/{file.stem}"
        try:
            found |= typesys.get_types_from_msg(file.read_text(encoding="utf-8"), name)
        except Exception as error:  # whatever the parser makes of a text that is none
            words = str(error).split("\n")[0]
            raise UndertowError(f"{file} is not a message definition: {words}") from error
    return found


# --- from records to series -----------------------------------------------------------------------
def _times(one: _Records, types: _Types, begin: int) -> tuple[Array, str]:
    """Times of the messages of a topic, s from the start of the bag, and what is odd about them."""
    recorded = (np.array(one.stamps, dtype=np.int64) - begin).astype(np.float64) * 1e-9
    if not types.has_header(one.type):
        return recorded, ""
    # Bytes 4 to 12 are the stamp: after the number of a message (ROS 1) or what says how numbers are written.
    order = ">u4" if not types.ros1 and one.raw[0][1] & 1 == 0 else "<u4"
    parts = np.frombuffer(b"".join(raw[4:12] for raw in one.raw), order).astype(np.int64).reshape(-1, 2)
    stamped = parts[:, 0] * 1_000_000_000 + parts[:, 1]
    if np.any(stamped == 0):
        return recorded, "messages without a time stamp: their recording times are used"
    t = (stamped - begin).astype(np.float64) * 1e-9
    apart = float(np.median(t - recorded))
    if abs(apart) > SETTINGS.apart:
        return recorded, f"stamps are {apart:.6g} s off the clock of the bag: recorded times are used"
    return t, ""


def _topic(name: str, one: _Records, types: _Types, t: Array) -> Topic | None:
    """A topic; None if none of its messages can be decoded."""
    first = next((m for raw in one.raw if (m := types.sound(raw, one.type)) is not None), None)
    if first is None:
        return None

    def columns() -> dict[str, Array]:
        groups = [one.raw[k : k + SETTINGS.together] for k in range(0, len(one.raw), SETTINGS.together)]
        tables = [_decoded(raw, one.type, types, constants) for raw in groups]
        names = dict.fromkeys(name for table in tables for name in table)
        blank = [np.full(len(raw), np.nan) for raw in groups]
        return {
            name: np.concatenate([table.get(name, none) for table, none in zip(tables, blank, strict=True)])
            for name in names
        }

    constants = {constant: value for constant, _, value in types.store.fielddefs[one.type][0]}
    return Topic(Series(name, t, _Decoded(columns)), one.type, first)


def _decoded(raw: list[bytes], type_: str, types: _Types, constants: Mapping[str, Any]) -> dict[str, Array]:
    """Columns of messages; none of messages that are all damaged."""
    decoded = [types.sound(one, type_) for one in raw]
    messages = [message for message in decoded if message is not None]
    if not messages:
        return {}
    found = types.numbers(type_, messages)
    found |= derived(type_, found, messages, constants)
    there = np.array([message is not None for message in decoded])
    return {name: _spread(column, there) for name, column in found.items()}


def _spread(known: Array, there: Flags) -> Array:
    """A column with blanks for the messages that are damaged."""
    column = np.full(len(there), np.nan)
    column[there] = known
    return column


def _accepts(path: Path, head: bytes) -> bool:
    if not head:
        return (path / "metadata.yaml").is_file()
    return path.suffix in FORMAT.suffixes or head.startswith((b"#ROSBAG V", b"\x89MCAP0\r\n"))


FORMAT = Format(
    "ROS bag", (".bag", ".db3", ".mcap"), _accepts, _read, 10**12
)  # pictures in it are passed over
