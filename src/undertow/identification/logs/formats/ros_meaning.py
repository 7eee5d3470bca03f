"""What the usual messages of ROS mean for a vehicle in water.

Poses are those of the body in the frame of the header, twists along the axes of the child frame:
east-north-up and forward-left-up (REP 103) unless the names of the frames say ned or frd. A Doppler log
reports forward, starboard, down, as its messages and makers define it. Columns that are added to those of a
topic: phi, theta, psi beside every quaternion (rad), and ``bottom.x`` … or ``water.x`` … of a Doppler log, by
what it tracked.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from undertow.identification.logs.guess_names import is_wanted, rows_by_number
from undertow.identification.logs.mapping import (
    ANGLES,
    FLIPPED_BODY,
    Column,
    Frames,
    LogMapping,
    angles,
    depth,
)
from undertow.typing import Array

from .fieldlog import Series

# Pa; absolute pressure is more, so that a smaller number is in hPa (mbar), as many drivers have it.
_LEAST_PRESSURE = 50_000.0
Kind = Literal["pose", "plane", "attitude", "twist", "rates", "velocity"]
_AXES = ("x", "y", "z")
_DOWN, _UP = ("ned", "frd"), ("enu", "flu")  # words in the names of frames
_LINEAR, _RATES = dict(zip("uvw", _AXES, strict=True)), dict(zip("pqr", _AXES, strict=True))

# Types in the order in which they are believed, and which of their fields are what.
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
_CONTROL = {"input", "cmd", "command", "control", "controller", "trajectory", "path"}  # of what is asked for


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
class _Understood:
    """What is known so far: columns by channel, and what is to be said."""

    columns: dict[str, tuple[str, Column]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def take(self, topic: Topic, named: Mapping[str, str], **known: Any) -> None:
        """Let columns of a topic be channels that no other is."""
        for channel, name in named.items():
            if channel not in self.columns:
                place = f"{topic.series.name}.{name}"
                self.columns[channel] = (place, Column(channel=channel, **known))


# --- columns of messages --------------------------------------------------------------------------
def derived(
    type_: str, columns: Mapping[str, Array], messages: Sequence[Any], constants: Mapping[str, Any]
) -> dict[str, Array]:
    """Columns that are computed from those of a topic: angles, and velocities by what was tracked."""
    found: dict[str, Array] = {}
    for name in columns:
        if _QUATERNION.match(name):
            base = name.removesuffix("w")
            turned = angles(*(columns[base + axis] for axis in "wxyz"))
            found |= {base + angle: column for angle, column in turned.items()}
    if _DVL.search(type_) and "velocity.x" in columns:
        found |= _tracked(columns, messages, constants)
    return found


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
        there = good & np.array([mode in (what, "") if what == "bottom" else mode == what for mode in modes])
        if there.any():
            for axis in _AXES:
                found[f"{what}.{axis}"] = np.where(there, columns[f"velocity.{axis}"], np.nan)
    return found


def _mode(message: Any, constants: Mapping[str, Any]) -> str:
    """What a Doppler log tracked: bottom or water; "" where it does not say."""
    for name in ("velocity_mode", "mode", "track", "tracking_mode"):
        value = getattr(message, name, None)
        words = (
            [value] if isinstance(value, str) else [c for c, v in constants.items() if _is_mode(c, v, value)]
        )
        for what in ("bottom", "water"):
            if any(what in str(word).lower() for word in words):
                return what
        if words:
            return "none"
    return ""


def _is_mode(constant: str, number: Any, value: Any) -> bool:
    return number == value and any(word in constant.lower() for word in ("mode", "bottom", "water", "track"))


# --- what they mean -------------------------------------------------------------------------------
def meaning(topics: Sequence[Topic]) -> tuple[LogMapping, tuple[tuple[str, Column], ...], list[str]]:
    """The mapping, the columns that drive the vehicle, and notes on what was chosen."""
    known, sources = _Understood(), list(_sources(topics))
    frames = _frames(sources, known) if sources else Frames()
    filled = {c for topic, fields in sources for c, n in _named(topic, fields, frames) if _filled(topic, n)}
    for topic, fields in sources:
        _take_motion(known, topic, fields, frames, filled)
    for topic in (one for one in _most(topics, _DVL) if "velocity.x" in one.series.columns):
        _take_doppler(known, topic, frames)
    for topic in _most(topics, re.compile("/FluidPressure$")):
        _take_depth(known, topic, frames)
    for topic in _most(topics, re.compile("/BatteryState$")):
        known.take(topic, {"voltage": "voltage"}, unit="V")
    actuators = _actuators(topics, known)
    _take_wrench(known, topics, bool(actuators))
    if known.columns and not actuators and "tau_X" not in known.columns:
        known.notes.append(
            "no topic is recognised as thruster commands: undertow map new --vehicle asks which ones are"
        )
    columns = dict(known.columns.values())
    return LogMapping(columns=columns, frames=frames), actuators, known.notes


def _most(topics: Sequence[Topic], pattern: re.Pattern[str]) -> list[Topic]:
    """Topics of some types, those with most samples first."""
    return sorted((t for t in topics if pattern.search(t.type)), key=lambda t: -len(t.series.t))


def _sources(topics: Sequence[Topic]) -> Iterator[tuple[Topic, dict[Kind, str]]]:
    for type_, fields in _TYPES.items():
        for topic in sorted(_most(topics, re.compile(f"^{re.escape(type_)}$")), key=_doubt):
            yield topic, fields


def _doubt(topic: Topic) -> tuple[bool, bool]:
    """How doubtful it is that a topic is a measurement whose axes are known; the least is believed first.

    A set-point has the type of what is measured, and where no header names a frame, of two poses one may be
    latitude and longitude.
    """
    name = topic.series.name
    framed = bool(topic.frame or topic.child or _said(name, *_DOWN, *_UP))
    return is_wanted(name) or _said(name.rsplit("/", 1)[-1], *_CONTROL), not framed


def _said(name: str, *words: str) -> bool:
    """Whether the name of a frame has one of some words in it."""
    return bool(set(re.split("[^a-z0-9]+", name.lower())) & set(words))


def _frames(sources: Sequence[tuple[Topic, Mapping[Kind, str]]], known: _Understood) -> Frames:
    """Axes of the topic that is believed most."""
    down, first = _is_down(sources[0][0]), sources[0][0]
    if _doubt(first)[1]:
        known.notes.append(
            f"{first.series.name} ({first.type}) names no frame: east-north-up is assumed, as in REP 103; "
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


def _is_down(topic: Topic) -> bool:
    """Whether the axes of a topic point down."""
    frames = [topic.frame, topic.child] if topic.frame or topic.child else [topic.series.name]
    return any(_said(name, *_DOWN) for name in frames) and not any(_said(n, *_UP) for n in frames)


def _take_motion(
    known: _Understood, topic: Topic, fields: Mapping[Kind, str], frames: Frames, filled: Set[str]
) -> None:
    """Let a topic be the channels that no earlier one is; `filled` are those that some topic measures."""
    before, like = len(known.columns), _is_down(topic) == (frames.position == "NED")
    named = {c: n for c, n in _named(topic, fields, frames) if _filled(topic, n) or c not in filled}
    if like:
        known.take(topic, named)
    else:  # of other axes only what is measured along those of the body can be turned here
        for channel, name in named.items():
            if channel in (*_LINEAR, *_RATES) and frames.velocity == "body":
                known.take(topic, {channel: name}, scale=-1.0 if channel in FLIPPED_BODY else 1.0)
    if len(known.columns) == before and named:
        _not_used(known, topic, named)


def _not_used(known: _Understood, topic: Topic, channels: Iterable[str]) -> None:
    """Say which topic has the channels that another could be."""
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
            yield from ((angle, f"{base}.orientation.{angle}") for angle in ANGLES)
        elif kind == "plane":
            yield from (("x", "x"), ("y", "y"), ("psi", "theta"))
        elif kind == "attitude" and _has_attitude(topic.first):
            yield from ((angle, f"{base}.{angle}") for angle in ANGLES)
        elif kind == "twist":
            yield from ((channel, f"{base}.linear.{axis}") for channel, axis in _LINEAR.items())
            if not earth:  # the axes of the earth do not turn with the body
                yield from ((channel, f"{base}.angular.{axis}") for channel, axis in _RATES.items())
        elif kind == "rates":
            yield from ((channel, f"{base}.{axis}") for channel, axis in _RATES.items())


def _filled(topic: Topic, name: str) -> bool:
    """Whether a column is of a vector that is not zero throughout; no sensor fills some of a message."""
    vector, axis = name[:-1], name[-1:]
    components = (topic.series.columns.get(f"{vector}{a}", 0.0) for a in _AXES)
    return axis not in _AXES or any(map(np.any, components))


def _has_attitude(imu: Any) -> bool:
    """Whether an inertial unit knows its attitude: else it says so by a covariance of -1."""
    q = imu.orientation
    return bool(imu.orientation_covariance[0] != -1.0 and (q.w, q.x, q.y, q.z) != (0.0, 0.0, 0.0, 0.0))


def _take_doppler(known: _Understood, topic: Topic, frames: Frames) -> None:
    columns, name = topic.series.columns, topic.series.name
    flip = _said(topic.frame, "flu", "enu") != (frames.body == "FLU")
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


def _take_depth(known: _Understood, topic: Topic, frames: Frames) -> None:
    if "z" in known.columns:
        return
    usual = float(np.nanmedian(topic.series.columns["fluid_pressure"]))
    pascal = 1.0 if usual > _LEAST_PRESSURE else 100.0
    if usual * pascal < _LEAST_PRESSURE:
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


def _take_wrench(known: _Understood, topics: Sequence[Topic], driven: bool) -> None:
    wrenches = _most(topics, re.compile("/WrenchStamped$"))
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
def _actuators(topics: Sequence[Topic], known: _Understood) -> tuple[tuple[str, Column], ...]:
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
    found = [name for name in topic.series.columns if _LIST.fullmatch(name) and _some(topic, name)]
    return [f"{topic.series.name}.{name}" for name in found]


def _some(topic: Topic, name: str) -> bool:
    return bool(np.any(np.isfinite(topic.series.columns[name])))


def _numbered(topics: Sequence[Topic]) -> list[list[str]]:
    """Topics with one number each whose names differ in a number, in its order."""
    cells = ((t.series.name, next((s for s in _SINGLE if s in t.series.columns), "")) for t in topics)
    single = {name: f"{name}.{cell}" for name, cell in cells if cell}
    return [[single[name] for name in row] for row in rows_by_number(single)]
