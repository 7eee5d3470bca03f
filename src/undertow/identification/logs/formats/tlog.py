"""MAVLink telemetry: .tlog, as received by a ground station, each message preceded by its time of arrival.

The definitions of messages and their checksums are those of pymavlink. Messages that carry the clock of the
vehicle are timed by it: they arrive in bursts. Read is what the autopilot of the vehicle said, not its
cameras, nor the ground station.

Columns that this reader adds:

- ``north, east, down`` (m) of ``GLOBAL_POSITION_INT``: from its first fix, on the ellipsoid of WGS 84;
- ``altitude`` (m) of ``DISTANCE_SENSOR``: where it looks down and its distance is within its range.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from undertow.errors import UndertowError
from undertow.identification.logs.mapping import Column, Frames, LogMapping, north_east
from undertow.typing import Array

from .ardupilot import SETTINGS, Parameters, actuators, outputs, shorter_by_pymavlink
from .fieldlog import (
    FieldLog,
    Format,
    Interval,
    Series,
    armed_intervals,
    library,
    named,
    outputs_of,
    rising,
    runs_of,
    steady,
    used_intervals,
)

# --- frames ---------------------------------------------------------------------------------------
_STAMP = 8  # bytes of the time before every message, microseconds since 1970
# First byte of a message of MAVLink 1 and 2; bytes of its head, and where the system stands in it.
_HEADS = {0xFE: (6, 3), 0xFD: (10, 5)}
_CHECKSUM, _SIGNATURE = 2, 13


@dataclass(frozen=True)
class TelemetrySettings:
    """Which times of telemetry are believed, and when its commands are too few."""

    # Times of arrival that are believed, microseconds since 1970: from 2000 to 2100.
    arrivals: tuple[float, float] = (946684800e6, 4102444800e6)
    together: int = 50  # messages, about, by whose median the offset of the vehicle's clock is known
    restart: float = 2.0  # s by which the vehicle's clock falls back when it boots anew
    # s by which the vehicle's time of a single message may differ from that of its arrival; the offset of the
    # two clocks is known by then, while `UnionSettings.apart` is of the offset.
    largest_delay: float = 10.0
    slow_commands: float = 5.0  # messages a second below which commands between them are worth a word


TELEMETRY = TelemetrySettings()


@dataclass(frozen=True)
class _Frame:
    stamp: float  # s since 1970
    source: tuple[int, int]  # system and component
    number: int
    payload: bytes
    end: int


@dataclass
class _Unreadable:
    """What could not be read."""

    broken: int = 0
    unknown: int = 0

    @property
    def notes(self) -> list[str]:
        counts = {
            "with a bad checksum or time, or cut off,": self.broken,
            "of kinds that pymavlink does not know": self.unknown,
        }
        return [f"{count} messages {which} are left out" for which, count in counts.items() if count]


Checksum = Callable[[bytes], int]


def _frames(data: bytes, mavlink: ModuleType, checksum: Checksum) -> tuple[list[_Frame], _Unreadable]:
    """The messages of a file whose checksum is right."""
    found, tally, place, lost = list[_Frame](), _Unreadable(), 0, False
    while place + _STAMP < len(data):
        frame, sound = _frame(data, place, mavlink, checksum)
        if sound and frame:
            found.append(frame)
            place, lost = frame.end, False
            continue
        known = frame is not None and frame.number in mavlink.mavlink_map
        if frame and not lost and _begins(data, frame.end):  # complete, but damaged or unknown
            tally.broken, tally.unknown = tally.broken + known, tally.unknown + (not known)
            place = frame.end
            continue
        tally.broken += not lost
        place, lost = _next(data, place + 1), True
    return found, tally


def _begins(data: bytes, place: int) -> bool:
    return place >= len(data) or (place + _STAMP < len(data) and data[place + _STAMP] in _HEADS)


def _next(data: bytes, place: int) -> int:
    """Where the next message may begin."""
    heads = (data.find(bytes([head]), place + _STAMP) for head in _HEADS)
    return min((head - _STAMP for head in heads if head >= 0), default=len(data))


def _ends(data: bytes, place: int) -> tuple[int, int] | None:
    """Where the payload and the whole message end whose time is at a place; None if none can be there."""
    begin = place + _STAMP
    stamp = int.from_bytes(data[place:begin], "big")
    if begin + 10 > len(data) or data[begin] not in _HEADS:
        return None
    earliest, latest = TELEMETRY.arrivals
    if not earliest <= stamp <= latest:
        return None
    size = _HEADS[data[begin]][0]
    last = begin + size + data[begin + 1]
    signed = size == 10 and data[begin + 2] & 1
    return last, last + _CHECKSUM + (_SIGNATURE if signed else 0)


def _frame(data: bytes, place: int, mavlink: ModuleType, checksum: Checksum) -> tuple[_Frame | None, bool]:
    """The message at a place, if one can be there, and whether its checksum is right."""
    ends = _ends(data, place)
    if ends is None or ends[1] > len(data):
        return None, False
    begin, (last, end) = place + _STAMP, ends
    size, at = _HEADS[data[begin]]
    number = int.from_bytes(data[begin + 7 : begin + 10], "little") if size == 10 else data[begin + 5]
    source = (data[begin + at], data[begin + at + 1])
    stamp = int.from_bytes(data[place:begin], "big")
    frame = _Frame(stamp * 1e-6, source, number, data[begin + size : last], end)
    kind = mavlink.mavlink_map.get(number)
    if kind is None:
        return frame, False
    sent = int.from_bytes(data[last : last + _CHECKSUM], "little")
    return frame, checksum(data[begin + 1 : last] + bytes([kind.crc_extra])) == sent


# --- series ---------------------------------------------------------------------------------------
_STRUCT = re.compile(r"(\d*)([a-zA-Z])")
_TYPES = {
    "b": "<i1", "B": "<u1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4", "q": "<i8", "Q": "<u8",
    "f": "<f4", "d": "<f8", "c": "S1",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Messages:
    """Messages of a kind: times of arrival, s since 1970, and a table of their fields."""

    kind: Any
    stamps: Array
    table: NDArray[np.void]

    def __contains__(self, field: str) -> bool:
        return field in (self.table.dtype.names or ())

    def numbers(self, field: str) -> Array:
        """A field of all messages."""
        return self.table[field].astype(np.float64)

    def texts(self, field: str) -> list[str]:
        """A field with a text."""
        return [cell.split(b"\0")[0].decode("utf-8", errors="replace") for cell in self.table[field].tolist()]

    @property
    def number_fields(self) -> list[str]:
        """Fields with one number."""
        fields: Mapping[str, Any] = self.table.dtype.fields or {}
        return [name for name in self.kind.fieldnames if fields[name][0].kind in "iuf"]


def _dtype(kind: Any) -> np.dtype[np.void]:
    """The fields of a kind of message as they are sent."""
    cells = []
    for name, (count, letter) in zip(
        kind.ordered_fieldnames, _STRUCT.findall(kind.unpacker.format), strict=True
    ):
        cells.append((name, f"S{count}") if letter == "s" else (name, _TYPES[letter], (int(count),))
                     if count else (name, _TYPES[letter]))  # fmt: skip
    return np.dtype(cells)


def _by_kind(frames: Iterable[_Frame], mavlink: ModuleType) -> dict[str, _Messages]:
    grouped: dict[int, list[_Frame]] = defaultdict(list)
    for frame in frames:
        grouped[frame.number].append(frame)
    found = {}
    for number, group in grouped.items():
        kind = mavlink.mavlink_map[number]
        dtype = _dtype(kind)
        # Zeros at the end of a message are not sent.
        cells = b"".join(f.payload[: dtype.itemsize].ljust(dtype.itemsize, b"\0") for f in group)
        stamps = np.array([f.stamp for f in group])
        found[kind.msgname] = _Messages(kind, stamps, np.frombuffer(cells, dtype))
    return found


def _autopilot(frames: Iterable[_Frame], mavlink: ModuleType) -> tuple[tuple[int, int], list[str]]:
    """System and component of the vehicle's autopilot, by its heartbeats, which name its type."""
    heartbeat, kind = mavlink.MAVLINK_MSG_ID_HEARTBEAT, 5  # place of the kind of autopilot in a heartbeat
    beats = Counter(
        f.source for f in frames
        if f.number == heartbeat and f.payload.ljust(9, b"\0")[kind] != mavlink.MAV_AUTOPILOT_INVALID
    )  # fmt: skip
    if not beats:
        raise UndertowError("no heartbeat of an autopilot: is it the log of a ground station?")
    chosen = beats.most_common(1)[0][0]
    others = [f"{system}" for system, component in beats if (system, component) != chosen]
    notes = [f"system {chosen[0]} is read; also heard: {', '.join(others)}"] if others else []
    return chosen, notes


# --- clock ----------------------------------------------------------------------------------------
_TURN = 2**32 * 1e-6  # s after which a counter of microseconds in 32 bits begins anew


@dataclass(frozen=True, eq=False)
class _Clock:
    """Offsets from the vehicle's clock, s since it booted, to s since 1970, and their start times."""

    since: Array
    offset: Array

    def of(self, messages: _Messages) -> Array:
        """Times of messages, s since 1970: by the vehicle's clock where they carry it."""
        added = self.offset[np.clip(np.searchsorted(self.since, messages.stamps, "right") - 1, 0, None)]
        if "time_boot_ms" in messages:
            own = messages.numbers("time_boot_ms") * 1e-3 + added
        elif "time_usec" in messages:
            own = messages.numbers("time_usec") * 1e-6 + added
            if messages.table.dtype["time_usec"].itemsize == 4:
                own = own + _TURN * np.round((messages.stamps - own) / _TURN)
        else:
            return messages.stamps
        return np.where(np.abs(own - messages.stamps) <= TELEMETRY.largest_delay, own, messages.stamps)


def _clock(messages: Mapping[str, _Messages]) -> _Clock:
    timed = [m for m in messages.values() if "time_boot_ms" in m]
    if not timed:
        return _Clock(np.zeros(1), np.zeros(1))
    stamps = np.concatenate([m.stamps for m in timed])
    boots = np.concatenate([m.numbers("time_boot_ms") * 1e-3 for m in timed])
    order = np.argsort(stamps, kind="stable")
    stamps, boots = stamps[order], boots[order]
    since = stamps - boots  # when it booted
    # A clock that is set back begins anew; single messages may be late.
    count = max(len(since) // TELEMETRY.together, 1)
    middle = np.array([np.median(part) for part in np.array_split(since, count)])
    starts = np.array_split(stamps, len(middle))
    fresh = np.concatenate([[True], np.abs(np.diff(middle)) > TELEMETRY.restart])
    begins = np.array([part[0] for part in starts])[fresh]
    groups = np.split(middle, np.flatnonzero(fresh)[1:])
    return _Clock(begins, np.array([np.median(group) for group in groups]))


# --- what is understood ---------------------------------------------------------------------------


def _read(path: Path, messages: Path | None) -> FieldLog:
    what = f"log {path} (MAVLink)"
    mavlink = library("pymavlink.dialects.v20.ardupilotmega", what)
    crc = library("pymavlink.generator.mavcrc", what)
    frames, tally = _frames(path.read_bytes(), mavlink, lambda text: int(crc.x25crc(text).crc))
    sound = steady(np.array([frame.stamp for frame in frames]))
    tally.broken += int(np.sum(~sound))  # no checksum covers the time of arrival
    frames = [frame for frame, kept in zip(frames, sound, strict=True) if kept]
    if not frames:
        raise UndertowError(f"log {path} has no whole MAVLink message: check that it is complete")
    source, notes = _autopilot(frames, mavlink)
    own = _by_kind((f for f in frames if f.source == source), mavlink)
    return _interpreted(path, own, [*tally.notes, *notes])


def _interpreted(path: Path, own: dict[str, _Messages], notes: list[str]) -> FieldLog:
    clock = _clock(own)
    times = {name: clock.of(m) for name, m in own.items()}
    start = min(float(t.min()) for t in times.values())
    series = {s.name: s for name, m in own.items() for s in _series(name, m, times[name] - start)}
    texts = own["STATUSTEXT"].texts("text") if "STATUSTEXT" in own else []
    firmware = next((text for text in texts if re.match(r"Ardu\w+ V", text)), "")
    stated = own.get("PARAM_VALUE")
    parameters: Parameters = {}
    if stated is not None:
        values = stated.numbers("param_value").tolist()
        parameters = dict(zip(stated.texts("param_id"), values, strict=True))
    columns, velocity, remarks = _columns(series)
    driven, more = actuators(parameters, outputs(series, _servos(series), r"servo(\d+)_raw"), firmware)
    resets = [float(t - start) for t in clock.since[1:]]
    intervals, left = _intervals(own, times, start, series, outputs_of(series, driven), resets)
    more += _pace(series, bool(driven))
    heard = (*([firmware] if firmware else []), *notes, *remarks, *more, *left)
    mapping = LogMapping(columns=columns, frames=Frames(velocity=velocity))
    return FieldLog(path, FORMAT.name, series, mapping, driven, parameters, intervals, heard)


def _series(name: str, messages: _Messages, t: Array) -> list[Series]:
    """The series of a kind of message: one for each instance where there are several."""
    units = {n: u for n, u in messages.kind.fieldunits_by_name.items() if n in messages.number_fields}
    table = {n: messages.numbers(n) for n in messages.number_fields}
    label = messages.kind.instance_field or ("name" if "name" in messages else None)
    if label is None:
        return [Series(name, t, table, units)]
    marks = messages.texts(label) if messages.table.dtype[label].kind == "S" else \
        [f"{number:g}" for number in messages.numbers(label)]  # fmt: skip
    which = np.array(marks)
    if len(set(marks)) == 1:
        return [Series(name, t, table, units)]
    return [
        Series(f"{name}[{mark}]", t[which == mark], {n: v[which == mark] for n, v in table.items()}, units)
        for mark in dict.fromkeys(marks)
    ]


def _servos(series: Mapping[str, Series]) -> list[str]:
    """Name of the series with the pulses of outputs 1 to 16, if there is one."""
    return [n for n in ("SERVO_OUTPUT_RAW[0]", "SERVO_OUTPUT_RAW") if n in series][:1]


def _pace(series: Mapping[str, Series], driven: bool) -> list[str]:
    t = next((series[name].t for name in _servos(series) if driven), np.zeros(0))
    t = t[rising(t)]
    if len(t) < 2 or (pace := 1.0 / float(np.median(np.diff(t)))) >= TELEMETRY.slow_commands:
        return []
    return [
        f"only {pace:.2g} commands a second were logged: the log on the autopilot (.bin) has more, or "
        "request SERVO_OUTPUT_RAW at a higher rate"
    ]


def _columns(series: dict[str, Series]) -> tuple[dict[str, Column], Any, list[str]]:
    """Channels of the series, the axes of velocities, and notes."""
    found, velocity, notes = _position(series)
    if "ATTITUDE" in series:
        names = {"roll": "phi", "pitch": "theta", "yaw": "psi", "rollspeed": "p", "pitchspeed": "q",
                 "yawspeed": "r"}  # fmt: skip
        found |= named("ATTITUDE", names)
    status = series.get("SYS_STATUS")
    if status is not None and np.any(status.columns["voltage_battery"] < 65535):
        found |= named("SYS_STATUS", {"voltage_battery": "voltage"}, unit="V", scale=1e-3)
    return {**found, **_height(series)}, velocity, notes


def _position(series: dict[str, Series]) -> tuple[dict[str, Column], Any, list[str]]:
    local, world = series.get("LOCAL_POSITION_NED"), series.get("GLOBAL_POSITION_INT")
    if local is not None and any(np.ptp(local.columns[name]) > 0 for name in ("x", "y", "vx")):
        names = {"x": "x", "y": "y", "z": "z", "vx": "u", "vy": "v", "vz": "w"}
        return named("LOCAL_POSITION_NED", names), "NED", []
    if world is None:
        return {}, "body", ["no position messages: angles and rates only"]
    if not np.any(world.columns["lat"]):
        return _depth_alone(world)
    places, note = _projected(world)
    series["GLOBAL_POSITION_INT"] = replace(world, columns={**world.columns, **places})
    moved = named("GLOBAL_POSITION_INT", {"vx": "u", "vy": "v", "vz": "w"}, unit="m/s", scale=0.01)
    stands = named("GLOBAL_POSITION_INT", {"north": "x", "east": "y", "down": "z"})
    return {**stands, **moved}, "NED", [note]


def _depth_alone(world: Series) -> tuple[dict[str, Column], Any, list[str]]:
    """Depth by the pressure, of a vehicle without an aid: it has no place, and its altitude is zero."""
    if not np.ptp(world.columns["relative_alt"]) > 0.0:
        return {}, "body", ["the vehicle has no position: angles and rates only"]
    depth = named("GLOBAL_POSITION_INT", {"relative_alt": "z"}, unit="m", scale=-1e-3)
    return depth, "body", ["the vehicle has no position: depth, angles and rates only"]


def _projected(world: Series) -> tuple[dict[str, Array], str]:
    """Metres north, east and down of the first fix, and a note on it."""
    lat, lon, height = (world.columns[name] for name in ("lat", "lon", "alt"))
    fixed = (lat != 0.0) | (lon != 0.0)
    lat, lon, down = (
        np.where(fixed, scale * values, np.nan)
        for scale, values in ((1e-7, lat), (1e-7, lon), (-1e-3, height))
    )
    north, east = north_east(lat, lon)
    first = int(np.argmax(fixed))
    note = f"positions are metres from the first fix, {lat[first]:.6f}, {lon[first]:.6f} degrees"
    return {"north": north, "east": east, "down": down}, note


_DOWN = 25  # orientation of a range finder


def _height(series: dict[str, Series]) -> dict[str, Column]:
    """Height above ground, by the first range finder that looks down."""
    for name, one in list(series.items()):
        if not re.match(r"DISTANCE_SENSOR\b", name) or not np.any(one.columns["orientation"] == _DOWN):
            continue
        distance, c = one.columns["current_distance"], one.columns
        good = (c["orientation"] == _DOWN) & (distance > c["min_distance"]) & (distance < c["max_distance"])
        series[name] = replace(one, columns={**c, "altitude": np.where(good, 0.01 * distance, np.nan)})
        return named(name, {"altitude": "altitude"})
    return {}


_ARMED = 128  # bit of base_mode


def _intervals(
    own: dict[str, _Messages],
    times: Mapping[str, Array],
    start: float,
    series: Mapping[str, Series],
    outputs: tuple[Array, Array] | None,
    resets: list[float],
) -> tuple[tuple[Interval, ...], list[str]]:
    span = (0.0, max(float(t.max()) for t in times.values()) - start)
    events: list[tuple[float, bool]] = []
    if "HEARTBEAT" in own:
        t, armed = times["HEARTBEAT"] - start, own["HEARTBEAT"].table["base_mode"] & _ARMED != 0
        changes = np.flatnonzero(np.diff(armed.astype(int))) + 1
        events = [(float(t[k]), bool(armed[k])) for k in changes] or [(0.0, bool(armed[0]))]
    status = series.get("EKF_STATUS_REPORT")
    held = runs_of(status.t, status.columns["flags"].astype(np.int64) & SETTINGS.held != 0) if status else []
    if "STATUSTEXT" in own:
        said = zip(times["STATUSTEXT"] - start, own["STATUSTEXT"].texts("text"), strict=True)
        resets = [*resets, *(float(t) for t, text in said if _RESET.search(text))]
    return used_intervals(span, armed_intervals(events, span), outputs, resets, held)


_RESET = re.compile(r"EKF.*(reset|yaw (re-?)?align|lane switch|is using|stopped aiding)|EKF primary changed")


def _accepts(path: Path, head: bytes) -> bool:
    if path.suffix.lower() == ".tlog":
        return bool(head)
    # Two messages follow each other from the first byte on, each after a time of this century.
    first = _ends(head, 0) if len(head) > 30 else None
    return first is not None and _ends(head, first[1]) is not None


FORMAT = Format("MAVLink telemetry", (".tlog",), _accepts, _read, 120_000_000, shorter_by_pymavlink(".tlog"))
