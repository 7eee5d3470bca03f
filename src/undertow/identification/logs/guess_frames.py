"""Possible axes of a log judging by its motion, quaternion columns, and a guessed mapping."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from undertow.typing import Array

from .mapping import SCHEMA, Formula, LogMapping, has_unit_length, metres_per_degree


@dataclass(frozen=True)
class FrameSettings:
    """Settings for guessing axes."""

    # Times over which motions are compared, s: long against noise, short against drift.
    over: tuple[float, ...] = (1.0, 5.0, 20.0)
    agrees: float = 0.5  # share of the motion that may be unexplained where axes agree
    clearly: float = 0.6  # that share of the best, over that of the next best, at most
    jump: float = 0.2  # share of a turn by which a jump of the heading may differ from it
    many_units: float = 1e6  # latitude beyond which it counts 1e-7 degrees
    # Latitude or longitude below which a place is near zero and zero, where simulators put theirs: whether
    # it is in radians or in degrees cannot be told.
    nowhere: float = 0.05
    upright: float = 0.01  # mean square of x and y of a quaternion below which they do not identify w


SETTINGS = FrameSettings()

_HERE, _EARTH = "the axes written here", "velocities along the axes of the position"
_SWAPPED = "x east and y north"
_EAST = "velocities east and north, the position north and east"
_WHICH = "north-east-down and forward-starboard-down, or all of it east-north-up and forward-left-up?"
_HEADING = (
    "does the heading grow clockwise seen from above, as that of a compass? If it grows the other way: "
    'position = "ENU", body = "FLU"'
)
_TURNED = (
    "so the heading grows from east to north, anticlockwise? Then make the column to the east x, that to the "
    'north y, with position = "ENU", attitude = "ENU", and body = "FLU" if the yaw rate grows as the heading'
)
# Keys of [frames], whether y and x change places, v changes sign, velocities are along earth axes, and
# whether these are east and north.
_ENTRIES: dict[str, tuple[dict[str, str], tuple[bool, bool, bool, bool]]] = {
    _HERE: ({"position": "NED", "body": "FRD"}, (False, False, False, False)),
    _SWAPPED: (
        {"position": "ENU", "body": "FRD", "attitude": "NED"},
        (True, False, False, False),
    ),
    "sway to port": ({"position": "NED", "body": "FLU", "attitude": "NED"}, (False, True, False, False)),
    "x east, y north and sway to port": (
        {"position": "ENU", "body": "FLU", "attitude": "NED"},
        (True, True, False, False),
    ),
    _EARTH: ({"position": "NED", "body": "FRD", "velocity": "NED"}, (False, False, True, False)),
    _EAST: ({"position": "NED", "body": "FRD", "velocity": "ENU"}, (False, False, True, True)),
}


@dataclass(frozen=True)
class Axes:
    """Keys of [frames] in a mapping file, and questions that the log does not answer."""

    entry: Mapping[str, str] = field(default_factory=lambda: dict(_ENTRIES[_HERE][0]))
    questions: tuple[str, ...] = ()


def axes_of(
    channels: Mapping[str, Array], t: Array, *, along_earth: bool = False, to_north: bool = False
) -> Axes:
    """The axes that position, heading and velocity (by channel, SI) agree with, as far as logged.

    `along_earth`: the velocities are called those to the north and to the east; `to_north`: so are x and y.
    """
    if along_earth:
        return Axes(_ENTRIES[_EARTH][0], (_HEADING,) if "psi" in channels else ())
    if not {"x", "y", "psi"} <= channels.keys():
        turning = any(name in channels for name in ("psi", "r", "v", "w", "y", "z"))
        return Axes(
            questions=(f"{_WHICH} Position and heading, which would decide, are not both logged",) * turning
        )
    logged = "u" in channels
    left = least_unexplained_shares(t, channels if logged else {**channels, "u": _pace(t, channels)})
    if not logged:  # a vehicle that goes ahead has no speed along other axes
        left = {name: share for name, share in left.items() if name in (_HERE, _SWAPPED)}
    if len(left) < 2:
        return Axes(questions=(_WHICH, _HEADING))
    best, other, *_ = sorted(left, key=lambda name: left[name])
    shares = f"{best} {left[best]:.0%}, {other} {left[other]:.0%}"
    by = "velocity and heading leave" if logged else "going where the heading points leaves"
    finding = f"{by} these shares of the change of position unexplained: {shares}"
    if left[best] > SETTINGS.agrees or left[best] > SETTINGS.clearly * left[other]:
        return Axes(questions=(f"{finding}. That is not decisive: which axes are they?", _HEADING))
    if to_north and _ENTRIES[best][1][0]:
        return Axes(questions=(f"{finding}. But x is called north and y east: {_TURNED}",))
    doubts = [_HEADING] if best in (_HERE, _EARTH, _EAST) and not (to_north and best == _HERE) else []
    return Axes(_ENTRIES[best][0], (f"{finding}. Hence these axes: is that right?", *doubts))


def _pace(t: Array, channels: Mapping[str, Array]) -> Array:
    """Speed by the change of position, m/s."""
    half = SETTINGS.over[0] / 2
    x, y = (np.interp(t + half, t, channels[n]) - np.interp(t - half, t, channels[n]) for n in ("x", "y"))
    return np.asarray(np.hypot(x, y) / (2 * half))


def least_unexplained_shares(t: Array, channels: Mapping[str, Array]) -> dict[str, float]:
    """Share of the change of position that velocities leave unexplained, by possible axes."""
    # Over the one of the times in the settings with the smallest share: long where the position is noisy.
    found = [_unexplained_shares(seconds, t, channels) for seconds in SETTINGS.over]
    return min(found, key=lambda shares: min(shares.values(), default=np.inf))


def _unexplained_shares(seconds: float, t: Array, channels: Mapping[str, Array]) -> dict[str, float]:
    zero = np.zeros_like(t)
    known = np.array([t, *(channels.get(name, zero) for name in ("x", "y", "psi", "u", "v"))])
    t, x, y, psi, u, v = known[:, np.all(np.isfinite(known), axis=0)]
    step = rows_in(seconds, t)
    if len(t) <= 2 * step:
        return {}
    motion = np.sqrt(np.mean(change(x, step) ** 2 + change(y, step) ** 2))
    found = {}
    for name, (_, (swapped, port, earth, east)) in _ENTRIES.items():
        if port and "v" not in channels:  # the same as without
            continue
        side = -v if port else v
        ahead = v + 1j * u if east else u + 1j * side
        across = 1.0 if earth else np.exp(1j * psi)
        by_velocity = change(summed(ahead * across, t), step)
        by_position = change(y + 1j * x if swapped else x + 1j * y, step)
        found[name] = float(np.sqrt(np.mean(np.abs(by_position - by_velocity) ** 2)) / max(motion, 1e-12))
    return found


def unit_of_heading(psi: Array, channels: Mapping[str, Array], t: Array) -> str:
    """ "rad" or "deg" by jumps of a full turn, or by the change of position; "" where neither decides."""
    finite = psi[np.isfinite(psi)]
    steps, span = np.abs(np.diff(finite)), float(np.ptp(finite)) if len(finite) else 0.0
    for unit, turn in (("rad", 2 * np.pi), ("deg", 360.0)):
        # A heading that jumps by a turn has no wider range than that.
        far = steps[steps > turn / 2] if span < (1.0 + SETTINGS.jump) * turn else steps[:0]
        if len(far) and abs(float(np.median(far)) - turn) < SETTINGS.jump * turn:
            return unit
    if not {"x", "y", "u"} <= channels.keys():
        return ""
    units = {"rad": psi, "deg": np.radians(psi)}
    left = {
        unit: min(least_unexplained_shares(t, {**channels, "psi": values}).values(), default=1.0)
        for unit, values in units.items()
    }
    best, other = sorted(left, key=lambda unit: left[unit])
    return best if left[best] < SETTINGS.clearly * left[other] else ""


def rows_in(seconds: float, t: Array) -> int:
    """Number of rows in a time."""
    return max(1, round(seconds / max(float(np.median(np.diff(t))), 1e-9))) if len(t) > 1 else 1


def change(values: Any, step: int) -> Any:
    return values[step:] - values[:-step]


def summed(rate: Any, t: Array) -> Any:
    return np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t))])


# --- places on the globe ---------------------------------------------------------------------------
def place_of(latitude: tuple[str, Array], longitude: tuple[str, Array]) -> dict[str, tuple[str, Array]]:
    """North and east of the first fix, m, of latitude and longitude: formula and values; {} if they are none.

    A fix at zero and zero is that of a receiver without one.
    """
    degrees, (lat, lon) = _degrees(latitude, longitude)
    fixes = np.flatnonzero(np.isfinite(lat) & np.isfinite(lon) & ((lat != 0.0) | (lon != 0.0)))
    if not len(fixes) or np.nanmax(np.abs(lat)) > 90.0 or np.nanmax(np.abs(lon)) > 360.0:
        return {}
    first = fixes[0]
    found = {}
    for channel, (name, _), data, size in zip(
        "xy", (latitude, longitude), (lat, lon), metres_per_degree(float(lat[first])), strict=True
    ):
        formula = f"({degrees[name]} - {data[first]:.9f}) * {size:.2f}".replace("- -", "+ ")
        found[channel] = formula, (data - data[first]) * size
    return found


def in_degrees(latitude: tuple[str, Array], longitude: tuple[str, Array]) -> tuple[Array, Array]:
    """Latitude and longitude, degrees, by their names and values in whatever unit these are."""
    return _degrees(latitude, longitude)[1]


def _degrees(
    latitude: tuple[str, Array], longitude: tuple[str, Array]
) -> tuple[dict[str, str], tuple[Array, Array]]:
    """Formulas for degrees by name, and the values of both."""
    written = _DEGREES[unit_of_place(latitude[1], longitude[1])]
    formulas = {name: written.format(in_formula(name)) for name, _ in (latitude, longitude)}
    lat, lon = (Formula(formulas[name]).of({name: data}) for name, data in (latitude, longitude))
    return formulas, (lat, lon)


_MINUTES = "degrees and minutes (4854.6 for 48 degrees 54.6', west and south negative)"
# Formulas for degrees.
_DEGREES = {
    "degrees": "{0}",
    "1e-7 degrees": "{0} / 1e7",
    "radians": "{0} * 180 / pi",
    _MINUTES: "({0} - 40 * sign({0}) * floor(abs({0}) / 100)) / 60",
}


def unit_of_place(latitude: Array, longitude: Array) -> str:
    """The unit of latitude and longitude.

    Whole numbers of 1e-7 degrees are those of MAVLink; degrees and minutes as in NMEA 0183 stay far below,
    and the last two digits before their point below 60. What a radian can say is in degrees a piece of sea
    off Africa: few vehicles are there.
    """
    north, east = (float(np.nanmax(np.abs(data), initial=0.0)) for data in (latitude, longitude))
    if north > SETTINGS.many_units:
        return "1e-7 degrees"
    if max(north, east) > 360.0 and north <= 9000.0 and east <= 18000.0:
        minutes = np.abs(np.concatenate([latitude, longitude])) % 100.0
        return "degrees" if np.any(minutes >= 60.0) else _MINUTES
    known = max(north, east) > SETTINGS.nowhere
    return "radians" if known and north <= np.pi / 2 and east <= np.pi else "degrees"


def in_formula(name: str) -> str:
    return name if name.isidentifier() else f'column("{name}")'


# --- attitudes ------------------------------------------------------------------------------------
def quaternions_in(data: Mapping[str, Array]) -> list[tuple[str, ...]]:
    """Columns w, x, y, z of each quaternion: names that differ in these letters, of length one."""
    letters = {"w": "wxyz", "W": "WXYZ"}
    likely = (tuple(name[:-1] + letter for letter in letters.get(name[-1:], "")) for name in data)
    return [q for q in likely if q and all(n in data for n in q) and _is_unit([data[n] for n in q])]


def unnamed_quaternion(data: Mapping[str, Array]) -> tuple[str, ...]:
    """Columns w, x, y, z of a quaternion by their values alone; none: ().

    They are adjacent, their names differ in a letter or a number, and they are of length one.
    """
    names = [*data]
    for four in zip(names, names[1:], names[2:], names[3:], strict=False):
        columns = [data[n] for n in four]
        one_name = len({_LAST.sub("", n) for n in four}) == 1
        if not one_name or not _is_unit(columns) or all(map(is_flag, columns)):
            continue
        # A vehicle in water is about upright: x and y are small. Heading north z is, too: then w is one.
        first, _, third, last = (float(np.nanmean(column**2)) for column in columns)
        scalar_is_last = last > first if max(first, third) < SETTINGS.upright else first < third
        return (four[3], *four[:3]) if scalar_is_last else four
    return ()


_LAST = re.compile(r"(\d+|[A-Za-z])(?=[^A-Za-z0-9]*$)")  # in which columns of a vector differ


def is_flag(values: Array) -> bool:
    """Whether a column is never anything but zero or one."""
    return bool(np.isin(values[np.isfinite(values)], (0.0, 1.0)).all())


def _is_unit(columns: Sequence[Array]) -> bool:
    q = np.array(columns)
    finite = np.isfinite(q).all(axis=0)
    return bool(finite.any() and has_unit_length(q[:, finite]).all())


def formulas(names: Sequence[str]) -> dict[str, str]:
    """Roll, pitch and yaw, rad, from columns w, x, y, z, as a mapping file computes them."""
    w, x, y, z = map(in_formula, names)
    ahead, across = f"1 - 2*({y}**2 + {z}**2)", f"2*({w}*{z} + {x}*{y})"
    return {
        "phi": f"atan2(2*({w}*{x} + {y}*{z}), 1 - 2*({x}**2 + {y}**2))",
        "theta": f"atan2(2*({w}*{y} - {z}*{x}), hypot({ahead}, {across}))",
        "psi": f"atan2({across}, {ahead})",
    }


# --- a mapping that was guessed -------------------------------------------------------------------
@dataclass(frozen=True)
class Guess:
    """The likely meaning of a column: keys and values of its entry in the mapping file, and the doubt."""

    column: str
    entry: Mapping[str, object]
    doubt: str = ""

    @property
    def channel(self) -> str:
        """The channel that it becomes."""
        return str(self.entry["channel"])

    @property
    def is_formula(self) -> bool:
        """Whether it is computed, from the columns that `column` lists."""
        return "expression" in self.entry

    def line(self) -> str:
        """The entry in TOML, after its question."""
        key, omitted = (self.channel, {"channel"}) if self.is_formula else (self.column, set())
        inside = ", ".join(f"{k} = {_toml(value)}" for k, value in self.entry.items() if k not in omitted)
        asked = f"# ? {self.doubt}\n" if self.doubt else ""
        plain = re.fullmatch(r"[A-Za-z0-9_-]+", key)
        return f"{asked}{key if plain else _toml(key)} = {{ {inside} }}"


@dataclass(frozen=True)
class GuessedMapping:
    """A draft of a mapping file."""

    log: str
    time: Guess  # column, unit, and a question on the rate
    columns: tuple[Guess, ...]
    axes: Axes
    ignored: Mapping[str, tuple[str, ...]]  # columns that are left out, by the reason
    reading: LogMapping = field(default_factory=LogMapping)  # format of the text of the table
    questions: tuple[str, ...] = ()  # those that only the people who made the log can answer

    @property
    def asked(self) -> list[str]:
        """All questions, those about columns with their names."""
        doubts: dict[str, list[str]] = {}
        for guess in (self.time, *self.columns):
            doubts.setdefault(guess.doubt, []).append(guess.column)
        of_columns = [f"{', '.join(names)}: {doubt}" for doubt, names in doubts.items() if doubt]
        return [*of_columns, *self.axes.questions, *self.questions]

    @property
    def meaning(self) -> LogMapping:
        """The draft as a mapping."""
        return LogMapping.model_validate(tomllib.loads(self.text()))

    def text(self) -> str:
        """The mapping file."""
        head = [
            f"# Guessed from {self.log}: every line with '# ?' is a question that the log does not answer.",
            f"schema = {_toml(SCHEMA)}",
        ]
        head += [
            f"{key} = {_toml(getattr(self.reading, key))}"
            for key in ("delimiter", "decimal", "comment", "skip", "not_numbers", "missing_commands")
            if getattr(self.reading, key) != LogMapping.model_fields[key].default
        ]
        left: list[str] = []
        for reason, names in self.ignored.items():
            left += [f"    # {reason}", *(f"    {_toml(name)}," for name in names)]
        head += ["ignore = [", *left, "]"] if left else []
        time = [f"{key} = {_toml(value)}" for key, value in self.time.entry.items()]
        asked = [f"# ? {self.time.doubt}"] if self.time.doubt else []
        frames = [f"# ? {question}" for question in self.axes.questions]
        frames += [f"{key} = {_toml(value)}" for key, value in self.axes.entry.items()]
        formulas = [guess.line() for guess in self.columns if guess.is_formula]
        columns = [guess.line() for guess in self.columns if not guess.is_formula]
        columns += [f"# ? {q}" for q in self.questions]
        sections = {"time": [*asked, *time], "frames": frames, "columns": columns}
        sections |= {"channels": formulas} if formulas else {}
        parts = [f"[{name}]\n" + "\n".join(lines) for name, lines in sections.items()]
        return "\n\n".join(["\n".join(head), *parts]) + "\n"


def _toml(value: object) -> str:
    return json.dumps(value, ensure_ascii=False)
