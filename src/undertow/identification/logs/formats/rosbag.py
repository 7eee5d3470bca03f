"""ROS 1 .bag, ROS 2 .db3 and .mcap, and folders of rosbag2 (with metadata.yaml), by rosbags.

Every topic is a series with all its numbers by name (``pose.pose.position.x``), decoded when first used. Its
times are those of the headers of its messages, where they have any and the clock is that of the bag; else the
recording times. `meaning` interprets the usual messages.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np

from undertow.errors import UndertowError
from undertow.identification.logs.guess_names import is_wanted, rows_by_number
from undertow.identification.logs.mapping import (
    ANGLES,
    FLIPPED_BODY,
    Column,
    Frames,
    LogMapping,
    angles,
    depth,
    has_unit_length,
)
from undertow.typing import Array, Flags

from .fieldlog import SETTINGS as UNION
from .fieldlog import FieldLog, Format, Series, library

# --- what messages mean ---------------------------------------------------------------------------
# Poses are those of the body in the frame of the header, twists along the axes of the child frame:
# east-north-up and forward-left-up (REP 103) unless the names of the frames say ned or frd. A Doppler log
# reports forward, starboard, down, as its messages and makers define it. Columns that are added to those of
# a topic: phi, theta, psi beside every quaternion (rad), and bottom.x … or water.x … of a Doppler log, by
# what it tracked.

Kind = Literal["pose", "plane", "attitude", "twist", "rates", "velocity"]
_AXES = ("x", "y", "z")
_DOWN, _UP = ("ned", "frd"), ("enu", "flu")  # words in the names of frames
# Words in the names of frames whose axes REP 103 and REP 105 define.
_USUAL = ("map", "odom", "earth", "world", "base", "link", "body", "utm", "gps", "imu", "dvl", "camera")
_LINEAR, _RATES = dict(zip("uvw", _AXES, strict=True)), dict(zip("pqr", _AXES, strict=True))

# Types in order of precedence, and the kinds of their fields.
_TYPES: dict[str, dict[Kind, str]] = {
    "nav_msgs/msg/Odometry": {"pose": "pose.pose", "twist": "twist.twist"},
    "geometry_msgs/msg/PoseWithCovarianceStamped": {"pose": "pose.pose"},
    "geometry_msgs/msg/PoseStamped": {"pose": "pose"},
    "geometry_msgs/msg/TwistWithCovarianceStamped": {"twist": "twist.twist"},
    "geometry_msgs/msg/TwistStamped": {"twist": "twist"},
    "geometry_msgs/msg/Pose2D": {"plane": ""},
    "sensor_msgs/msg/Imu": {"attitude": "orientation", "rates": "angular_velocity"},
}
_DVL = re.compile(r"/(dvl|dvldata)$", re.IGNORECASE)
_QUATERNION = re.compile(r"(?:^|(.*)\.)orientation\.w$")
_DRIVES = re.compile(r"thrust|motor|actuator|pwm|rc_?out|propeller|servo|(?:^|[/_])esc", re.IGNORECASE)
_ASKED = re.compile(r"input|cmd|command|control|pwm|rpm|setpoint", re.IGNORECASE)
_LIST = re.compile(r"(?:data|channels|outputs?|controls?|commands?|pwm|thrust|forces?)\[\d+\]")
_SINGLE = ("data", "value")
_CONTROL = {"input", "cmd", "command", "control", "controller", "trajectory", "path"}  # words for set-points


@dataclass(frozen=True, eq=False)
class Topic:
    """A topic, the type of its messages, and the first of them."""

    series: Series
    type: str
    first: Any

    @property
    def frame(self) -> str:
        """Frame of its header; "" without one."""
        return str(getattr(getattr(self.first, "header", None), "frame_id", ""))

    @property
    def child(self) -> str:
        """Frame of the body."""
        return str(getattr(self.first, "child_frame_id", ""))


@dataclass
class _Interpretation:
    """Columns by channel as known so far, and notes."""

    columns: dict[str, tuple[str, Column]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def take(self, topic: Topic, named: Mapping[str, str], **known: Any) -> None:
        """Use columns of a topic for channels that have none yet."""
        for channel, name in named.items():
            if channel not in self.columns:
                place = f"{topic.series.name}.{name}"
                self.columns[channel] = (place, Column(channel=channel, **known))


# --- columns of messages --------------------------------------------------------------------------
def derived(
    type_: str, columns: Mapping[str, Array], messages: Sequence[Any], constants: Mapping[str, Any]
) -> dict[str, Array]:
    """Columns that are computed from those of a topic: angles, and velocities over ground and in water."""
    found: dict[str, Array] = {}
    for name in columns:
        if _QUATERNION.match(name):
            base = name.removesuffix("w")
            q = np.array([columns[base + axis] for axis in "wxyz"])
            valid = _are_quaternions(q)
            found |= {base + angle: np.where(valid, a, np.nan) for angle, a in angles(*q).items()}
    if _DVL.search(type_) and "velocity.x" in columns:
        found |= _tracked(columns, messages, constants)
    return found


def _are_quaternions(q: Array) -> Flags:
    """Which of the numbers in the place of quaternions, (4, n), are some: those of length one.

    Programs leave them zero where they measure none, or put angles there, few of which are of that length.
    """
    valid = has_unit_length(q)
    return np.asarray(valid & (2 * np.sum(valid) >= np.sum(q.any(axis=0))))


def _tracked(
    columns: Mapping[str, Array], messages: Sequence[Any], constants: Mapping[str, Any]
) -> dict[str, Array]:
    """Velocities of a Doppler log over ground and through the water, blank where it tracked the other."""
    good = np.ones(len(messages), dtype=bool)
    for flag in ("velocity_valid", "beam_velocities_valid"):
        good &= columns[flag] > 0 if flag in columns else True
    modes = [_mode(message, constants) for message in messages]
    found = {}
    for what in ("bottom", "water"):
        valid = good & np.array([mode in (what, "") if what == "bottom" else mode == what for mode in modes])
        if valid.any():
            for axis in _AXES:
                found[f"{what}.{axis}"] = np.where(valid, columns[f"velocity.{axis}"], np.nan)
    return found


def _mode(message: Any, constants: Mapping[str, Any]) -> str:
    """What a Doppler log tracked: bottom or water; "" where it does not say."""
    for name in ("velocity_mode", "mode", "track", "tracking_mode"):
        value = getattr(message, name, None)
        words = [value] if isinstance(value, str) else [c for c, v in constants.items() if v == value]
        if not isinstance(value, str):
            told = ("mode", "bottom", "water", "track")
            words = [word for word in words if any(part in word.lower() for part in told)]
        for what in ("bottom", "water"):
            if any(what in str(word).lower() for word in words):
                return what
        if words:
            return "none"
    return ""


# --- what they mean -------------------------------------------------------------------------------
def meaning(topics: Sequence[Topic]) -> tuple[LogMapping, tuple[tuple[str, Column], ...], list[str]]:
    """The mapping, the columns that drive the vehicle, and notes on what was chosen."""
    known, sources = _Interpretation(), list(_sources(topics))
    frames = _frames(sources, known) if sources else Frames()
    filled = {c for topic, fields in sources for c, n in _named(topic, fields, frames) if _filled(topic, n)}
    for topic, fields in sources:
        _take_motion(known, topic, fields, frames, filled)
        known.notes += [
            _no_quaternion(topic, base) for base in _orientations(fields) if _has_other_numbers(topic, base)
        ]
    for topic in (one for one in _by_samples(topics, _DVL) if "velocity.x" in one.series.columns):
        _take_doppler(known, topic, frames)
    for topic in _by_samples(topics, re.compile("/FluidPressure$")):
        _take_depth(known, topic, frames)
    for topic in _by_samples(topics, re.compile("/BatteryState$")):
        known.take(topic, {"voltage": "voltage"}, unit="V")
    actuators = _actuators(topics, known)
    _take_wrench(known, topics, bool(actuators))
    if known.columns and not actuators and "tau_X" not in known.columns:
        known.notes.append(
            "no topic is recognised as thruster commands: undertow map new --vehicle asks which ones are"
        )
    columns = dict(known.columns.values())
    return LogMapping(columns=columns, frames=frames), actuators, known.notes


def _by_samples(topics: Sequence[Topic], pattern: re.Pattern[str]) -> list[Topic]:
    """Topics of some types, those with most samples first."""
    return sorted((t for t in topics if pattern.search(t.type)), key=lambda t: -len(t.series.t))


def _sources(topics: Sequence[Topic]) -> Iterator[tuple[Topic, dict[Kind, str]]]:
    for type_, fields in _TYPES.items():
        for topic in sorted(_by_samples(topics, re.compile(f"^{re.escape(type_)}$")), key=_precedence):
            yield topic, fields


def _precedence(topic: Topic) -> tuple[bool, bool]:
    """Sort key of topics: measurements before set-points, and those with known axes first."""
    # A set-point has the type of a measurement, and where no header names a frame, one of two poses may be
    # latitude and longitude.
    name = topic.series.name
    framed = bool(topic.frame or topic.child or _has_word(name, *_DOWN, *_UP))
    return is_wanted(name) or _has_word(name.rsplit("/", 1)[-1], *_CONTROL), not framed


def _has_word(name: str, *words: str) -> bool:
    """Whether the name of a frame or topic has one of some words in it, or the plural of one."""
    found = re.split("[^a-z0-9]+", name.lower())
    return not {*found, *(word.removesuffix("s") for word in found)}.isdisjoint(words)


def _frames(sources: Sequence[tuple[Topic, Mapping[Kind, str]]], known: _Interpretation) -> Frames:
    """Axes of the topic that takes precedence."""
    down, first = _is_down(sources[0][0]), sources[0][0]
    if not _has_known_axes(first):
        frame = first.frame or first.child
        named = f"a frame {frame!r}, which says nothing of axes" if frame else "no frame"
        known.notes.append(
            f"{first.series.name} ({first.type}) names {named}: east-north-up is assumed, as in REP 103; "
            '[frames] position = "NED", body = "FRD" in a mapping file changes that'
        )
    pose = next((topic for topic, fields in sources if "pose" in fields), None)
    twist = next((topic for topic, fields in sources if "twist" in fields), None)
    axes = (twist.child or twist.frame) if twist else ""
    if pose and twist and axes and axes == pose.frame:
        known.notes.append(
            f"{twist.series.name}: its velocities are in the frame of the pose, {axes!r}, so they are taken "
            "along earth axes"
        )
        return Frames(velocity="NED") if down else Frames(position="ENU", body="FLU", velocity="ENU")
    return Frames() if down else Frames(position="ENU", body="FLU")


def _has_known_axes(topic: Topic) -> bool:
    """Whether a topic names its axes: drivers also write the state of a vehicle where the frame belongs."""
    of_frames = any(_has_word(name, *_DOWN, *_UP, *_USUAL) for name in (topic.frame, topic.child))
    return of_frames or (not (topic.frame or topic.child) and _has_word(topic.series.name, *_DOWN, *_UP))


def _is_down(topic: Topic) -> bool:
    """Whether the axes of a topic point down."""
    frames = [topic.frame, topic.child] if topic.frame or topic.child else [topic.series.name]
    return any(_has_word(name, *_DOWN) for name in frames) and not any(_has_word(n, *_UP) for n in frames)


def _take_motion(
    known: _Interpretation, topic: Topic, fields: Mapping[Kind, str], frames: Frames, filled: Set[str]
) -> None:
    """Use a topic for channels that no earlier one has; `filled` are those that some topic measures."""
    before, same_axes = len(known.columns), _is_down(topic) == (frames.position == "NED")
    named = {c: n for c, n in _named(topic, fields, frames) if _filled(topic, n) or c not in filled}
    if same_axes:
        known.take(topic, named)
    else:  # of other axes only velocities along those of the body can be converted here
        for channel, name in named.items():
            if channel in (*_LINEAR, *_RATES) and frames.velocity == "body":
                known.take(topic, {channel: name}, scale=-1.0 if channel in FLIPPED_BODY else 1.0)
    if len(known.columns) == before and named:
        _not_used(known, topic, named)


def _not_used(known: _Interpretation, topic: Topic, channels: Iterable[str]) -> None:
    """Note which other topic has the channels of one that is not used."""
    taken = {c: known.columns[c][0].split(".")[0] for c in channels if c in known.columns}
    of = f"{', '.join(taken)} are those of {' and '.join(dict.fromkeys(taken.values()))}"
    why = of if taken else "its axes are not those of the others"
    known.notes.append(f"{topic.series.name} ({topic.type}) is not used: {why}")


def _named(topic: Topic, fields: Mapping[Kind, str], frames: Frames) -> Iterator[tuple[str, str]]:
    """Channels of a topic, and the names of their columns."""
    earth = frames.velocity != "body"
    for kind, base in fields.items():
        if kind == "pose":
            yield from ((axis, f"{base}.position.{axis}") for axis in _AXES)
            if _has_quaternion(topic, f"{base}.orientation"):
                yield from ((angle, f"{base}.orientation.{angle}") for angle in ANGLES)
        elif kind == "plane":
            yield from (("x", "x"), ("y", "y"), ("psi", "theta"))
        elif kind == "attitude" and _has_attitude(topic.first) and _has_quaternion(topic, base):
            yield from ((angle, f"{base}.{angle}") for angle in ANGLES)
        elif kind == "twist":
            yield from ((channel, f"{base}.linear.{axis}") for channel, axis in _LINEAR.items())
            if not earth:  # the axes of the earth do not turn with the body
                yield from ((channel, f"{base}.angular.{axis}") for channel, axis in _RATES.items())
        elif kind == "rates":
            yield from ((channel, f"{base}.{axis}") for channel, axis in _RATES.items())


def _orientations(fields: Mapping[Kind, str]) -> Iterator[str]:
    """The names of the quaternions of a topic."""
    for kind, base in fields.items():
        if kind in ("pose", "attitude"):
            yield base if kind == "attitude" else f"{base}.orientation"


def _has_quaternion(topic: Topic, quaternion: str) -> bool:
    """Whether any message of a topic has an attitude."""
    return bool(np.isfinite(topic.series.columns[f"{quaternion}.{ANGLES[0]}"]).any())


def _has_other_numbers(topic: Topic, quaternion: str) -> bool:
    """Whether a topic has numbers in the place of its quaternion that are none."""
    parts = (topic.series.columns[f"{quaternion}.{axis}"] for axis in "wxyz")
    return not _has_quaternion(topic, quaternion) and any(map(np.any, parts))


def _no_quaternion(topic: Topic, name: str) -> str:
    parts = [topic.series.columns[f"{name}.{axis}"] for axis in "wxyz"]
    longest = float(np.nanmax(np.linalg.norm(parts, axis=0)))
    return (
        f"{topic.series.name}: {name} is no quaternion (length up to {longest:.3g}, not 1): no attitude is "
        f"taken from it; if {name}.x ... are angles, name them in a mapping file"
    )


def _filled(topic: Topic, name: str) -> bool:
    """Whether a column is of a vector that is not zero throughout; no sensor fills some of a message."""
    vector, axis = name[:-1], name[-1:]
    components = (topic.series.columns.get(f"{vector}{a}", 0.0) for a in _AXES)
    return axis not in _AXES or any(map(np.any, components))


def _has_attitude(imu: Any) -> bool:
    """Whether an inertial unit has an attitude: without one its covariance is -1."""
    q = imu.orientation
    return bool(imu.orientation_covariance[0] != -1.0 and (q.w, q.x, q.y, q.z) != (0.0, 0.0, 0.0, 0.0))


def _take_doppler(known: _Interpretation, topic: Topic, frames: Frames) -> None:
    columns, name = topic.series.columns, topic.series.name
    flip = _has_word(topic.frame, "flu", "enu") != (frames.body == "FLU")
    if "altitude" in columns:
        known.take(topic, {"altitude": "altitude"}, unit="m")
    if "bottom.x" not in columns:
        if "water.x" in columns:
            known.notes.append(
                f"{name} reports velocities through the water only: columns water.x, water.y, water.z can be "
                "u, v, w in a mapping file with the velocity of the water in [water]"
            )
        return
    if frames.velocity != "body" or "u" in known.columns:
        _not_used(known, topic, _LINEAR)
        return
    for channel, axis in _LINEAR.items():
        known.take(
            topic, {channel: f"bottom.{axis}"}, scale=-1.0 if flip and channel in FLIPPED_BODY else 1.0
        )


def _take_depth(known: _Interpretation, topic: Topic, frames: Frames) -> None:
    if "z" in known.columns:
        return
    usual = float(np.nanmedian(topic.series.columns["fluid_pressure"]))
    pascal = 1.0 if usual > SETTINGS.least_pressure else 100.0
    if usual * pascal < SETTINGS.least_pressure:
        known.notes.append(
            f"{topic.series.name}: a pressure of {usual:.3g} is neither Pa nor hPa in air or water, so it "
            "gives no depth: column fluid_pressure can be z in a mapping file"
        )
        return
    down = 1.0 if frames.position == "NED" else -1.0
    column, water = depth(pascal, absolute=True, down=down)
    known.columns["z"] = f"{topic.series.name}.fluid_pressure", column
    unit = "Pa" if pascal == 1.0 else "hPa"
    known.notes.append(f"{topic.series.name}: depth from pressure in {unit}, with {water}")


def _take_wrench(known: _Interpretation, topics: Sequence[Topic], driven: bool) -> None:
    wrenches = _by_samples(topics, re.compile("/WrenchStamped$"))
    if not wrenches:
        return
    names = ", ".join(topic.series.name for topic in wrenches)
    if driven or len(wrenches) > 1:
        why = "commands drive the vehicle" if driven else "there are several"
        known.notes.append(
            f"{names}: forces are not used, since {why}: columns wrench.force.x … can be tau_X … in a "
            "mapping file"
        )
        return
    of = {"tau_X": "force.x", "tau_Y": "force.y", "tau_Z": "force.z"}
    of |= {"tau_K": "torque.x", "tau_M": "torque.y", "tau_N": "torque.z"}
    known.take(wrenches[0], {channel: f"wrench.{name}" for channel, name in of.items()})


# --- what drives the vehicle ----------------------------------------------------------------------
def _actuators(topics: Sequence[Topic], known: _Interpretation) -> tuple[tuple[str, Column], ...]:
    """Commands of the thrusters: a topic with a list of them, or numbered topics with one each."""
    driving = [topic for topic in topics if _DRIVES.search(topic.series.name) or _DRIVES.search(topic.type)]
    sets = [found for topic in driving if (found := _listed(topic))] + _numbered(driving)
    if not sets:
        return ()
    best, *others = sorted(sets, key=lambda one: (not _ASKED.search(one[0]), -len(one)))
    if others:
        left = ", ".join(one[0] for one in others)
        known.notes.append(f"commands are taken from {best[0]} and the topics after it, not from {left}")
    return tuple((name, Column(channel=f"motor{k}")) for k, name in enumerate(best, 1))


def _listed(topic: Topic) -> list[str]:
    columns = topic.series.columns
    found = [name for name in columns if _LIST.fullmatch(name) and np.isfinite(columns[name]).any()]
    return [f"{topic.series.name}.{name}" for name in found]


def _numbered(topics: Sequence[Topic]) -> list[list[str]]:
    """Topics with one number each whose names differ in a number, in its order."""
    cells = ((t.series.name, next((s for s in _SINGLE if s in t.series.columns), "")) for t in topics)
    single = {name: f"{name}.{cell}" for name, cell in cells if cell}
    return [[single[name] for name in row] for row in rows_by_number(single)]


# --- bags -----------------------------------------------------------------------------------------
_WHAT = "a log of ROS"


@dataclass(frozen=True)
class RosSettings:
    """Limits on the messages of a bag that are read, and on what they carry."""

    largest: int = 16384  # bytes; longer messages are pictures and clouds of points
    kept: int = 400_000_000  # bytes of messages that are held at once
    together: int = 10_000  # messages that are decoded at once: an object takes ten times its bytes
    # Pa; absolute pressure is more, so that a smaller number is in hPa (mbar), as many drivers have it.
    least_pressure: float = 50_000.0


SETTINGS = RosSettings()


@dataclass
class _Records:
    """The messages of one topic in a bag."""

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
        records, types, notes = _read_records(path, messages)
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
    mapping, actuators, remarks = meaning(list(topics.values()))
    series = {name: topic.series for name, topic in topics.items()}
    return FieldLog(path, FORMAT.name, series, mapping, actuators, notes=tuple(notes), remarks=tuple(remarks))


# --- from the file to records ---------------------------------------------------------------------
class _Types:
    """Definitions of messages, and decoding by them."""

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

    def sound(self, raw: bytes, name: str) -> Any:
        """The message of some bytes; None for damaged ones."""
        decode = self.store.deserialize_ros1 if self.ros1 else self.store.deserialize_cdr
        try:
            return decode(raw, name)
        except Exception:  # whatever the library raises for them
            return None

    def numbers(self, name: str, messages: list[Any]) -> dict[str, Array]:
        """All numbers of messages of a type, by name."""
        found: dict[str, Array] = {}
        for entry, kind in self.store.fielddefs[name][1]:
            values = [getattr(message, entry) for message in messages]
            found |= {f"{entry}{rest}": column for rest, column in self._columns(kind, values)}
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
        if np.max(counts, initial=0) > UNION.widest:
            return
        for k in range(int(np.max(counts, initial=0))):
            valid = counts > k
            cells = [value[k] for value in values if len(value) > k]
            for rest, known in self._columns(element, cells):
                column = np.full(len(values), np.nan)
                column[valid] = known
                yield f"[{k}]{rest}", column


_BASE, _NAME = 1, 2  # of rosbags.interfaces.Nodetype


def _read_records(path: Path, messages: Path | None) -> tuple[dict[str, _Records], _Types, list[str]]:
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
        one_type = len(types[connection.topic]) == 1
        name = connection.topic if one_type else f"{connection.topic} ({connection.msgtype})"
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
        except Exception as error:  # whatever the parser raises for another text
            words = str(error).split("\n")[0]
            raise UndertowError(f"{file} is not a message definition: {words}") from error
    return found


# --- from records to series -----------------------------------------------------------------------
def _times(one: _Records, types: _Types, begin: int) -> tuple[Array, str]:
    """Times of the messages of a topic, s from the start of the bag, and a note on unusual ones."""
    recorded = (np.array(one.stamps, dtype=np.int64) - begin).astype(np.float64) * 1e-9
    fields = types.store.fielddefs[one.type][1]
    if not fields or fields[0][1] != (_NAME, "std_msgs/msg/Header"):
        return recorded, ""
    # Bytes 4 to 12 are the stamp: after the number of a message (ROS 1) or the byte order.
    order = ">u4" if not types.ros1 and one.raw[0][1] & 1 == 0 else "<u4"
    parts = np.frombuffer(b"".join(raw[4:12] for raw in one.raw), order).astype(np.int64).reshape(-1, 2)
    stamped = parts[:, 0] * 1_000_000_000 + parts[:, 1]
    if np.any(stamped == 0):
        return recorded, "messages without a time stamp: their recording times are used"
    t = (stamped - begin).astype(np.float64) * 1e-9
    apart = float(np.median(t - recorded))
    if abs(apart) > UNION.apart:
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
    valid = np.array([message is not None for message in decoded])
    columns = {name: np.full(len(valid), np.nan) for name in found}  # blank where a message is damaged
    for name, column in columns.items():
        column[valid] = found[name]
    return columns


def _accepts(path: Path, head: bytes) -> bool:
    if not head:
        bags = (file for end in ("*.db3*", "*.mcap*") for file in path.glob(end))
        return (path / "metadata.yaml").is_file() and any(bags)
    return path.suffix in FORMAT.suffixes or head.startswith((b"#ROSBAG V", b"\x89MCAP0\r\n"))


FORMAT = Format(
    "ROS bag", (".bag", ".db3", ".mcap"), _accepts, _read, 10**12
)  # pictures in it are passed over
