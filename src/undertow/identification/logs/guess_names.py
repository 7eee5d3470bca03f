"""Possible meaning of a column name: its unit, and the motion or command that it denotes."""

from __future__ import annotations

import re
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, takewhile

from undertow.model.symbols import POSE, VELOCITY

from .cells import GLOBE, words_of
from .mapping import SECONDS, LogMapping
from .run import FORCES

_UNITS = {
    "m": "m", "mm": "mm", "cm": "cm", "km": "km", "ft": "ft", "rad": "rad", "deg": "deg", "degrees": "deg",
    "mps": "m/s", "m s": "m/s", "m/s": "m/s", "mmps": "mm/s", "mm s": "mm/s", "mm/s": "mm/s", "kn": "knot",
    "kt": "knot", "kts": "knot", "knots": "knot", "radps": "rad/s", "rad s": "rad/s", "rad/s": "rad/s",
    "rps": "rev/s", "rev/s": "rev/s", "degps": "deg/s", "dps": "deg/s", "deg s": "deg/s", "deg/s": "deg/s",
    "deg min": "deg/min", "deg/min": "deg/min", "°": "deg", "°/s": "deg/s", "deg/sec": "deg/s",
    "rad/sec": "rad/s", "m/sec": "m/s", "km/h": "km/h", "km h": "km/h", "kmh": "km/h", "kph": "km/h",
    "cm/s": "cm/s", "cm s": "cm/s", "cmps": "cm/s", "ft/s": "ft/s", "ft s": "ft/s", "mph": "mph",
    "n": "N", "nm": "N m", "kilonewton": "kN", "kilonewton m": "kN m",
    "mps2": "m/s^2", "m s2": "m/s^2", "m/s^2": "m/s^2", "m/s2": "m/s^2", "s": "s",
    "sec": "s", "ms": "ms", "us": "us", "ns": "ns", "rpm": "rpm", "1/min": "rpm",
    "r/min": "rpm", "min^-1": "rpm", "pct": "%", "percent": "%", "%": "%",
    "v": "V", "pwm": "pwm", "mbar": "mbar", "dbar": "dbar", "hpa": "hPa", "kpa": "kPa",
    "mg l": "mg/l", "mg/l": "mg/l", "ug l": "ug/l", "ug/l": "ug/l",
}  # fmt: skip
_LENGTHS, _ANGLES = {"m", "mm", "cm", "km", "ft"}, {"rad", "deg"}
_SPEEDS, RATES = {"m/s", "cm/s", "mm/s", "km/h", "ft/s", "mph", "knot"}, {"rad/s", "deg/s", "deg/min"}
# "SOG left (kn)" is a motion, and not the left thruster. A propeller may be commanded in rad/s.
_NO_COMMANDS = {*_LENGTHS, *_SPEEDS, "deg/s", "deg/min", "m/s^2"}
# Units of quantities other than motions and commands; in brackets alone: "w" is a heave velocity.
_OTHERS = {
    "w": "W", "kw": "kW", "mw": "MW", "hp": "hp", "a": "A", "ma": "mA", "ah": "Ah", "mah": "mAh",
    "pa": "Pa", "bar": "bar", "c": "degC", "°c": "degC", "degc": "degC", "celsius": "degC",
}  # fmt: skip
_PLACES = {
    "x": 0, "n": 0, "north": 0, "northing": 0, "y": 1, "e": 1, "east": 1, "easting": 1,
    "z": 2, "d": 2, "depth": 2, "down": 2, "up": 2,
}  # fmt: skip
# Words for directions of the earth: a speed in one of them is along no axis of the vehicle.
_EARTH = {"n": 0, "north": 0, "e": 1, "east": 1, "d": 2, "down": 2, "up": 2}
_EARTH_SPEEDS = {"vn": 0, "ve": 1, "vd": 2, "vu": 2}
_TURNS = {
    "phi": 0, "fi": 0, "roll": 0, "heel": 0, "theta": 1, "pitch": 1, "psi": 2, "yaw": 2, "heading": 2,
    "hdg": 2, "compass": 2, "cap": 2,
}  # fmt: skip
_MOVES = {
    "u": 0, "vx": 0, "surge": 0, "v": 1, "vy": 1, "sway": 1, "w": 2, "vz": 2, "heave": 2,
    "p": 3, "wx": 3, "q": 4, "wy": 4, "r": 5, "wz": 5,
    "vm": 1,  # v_m of the MMG model: sway velocity at midship
    "rot": 5,  # rate of turn, as in sentences of NMEA 0183
}  # fmt: skip
# Sides of the vehicle: a speed there is along its axes, as in "SOG fwd (m/s)"; to the left it is -v.
_SIDEWAYS = {
    "forward": 0, "fwd": 0, "ahead": 0, "left": 1, "port": 1, "right": 1, "starboard": 1, "stbd": 1,
}  # fmt: skip
_SOG = {"sog", "over", "ground", "vs"}
_STW = {"stw", "through", "water"}
_NAMED = {"surge", "sway", "heave"}
_OF_TURN = {"orientation", "attitude", "rpy", "euler"}
_OF_SPEED = {"vel", "velo", "velocity", "velocities", "speed", "speeds", "spd", "linear", "twist"}
_OF_RATE = {"rate", "rates", "dot", "gyr", "gyro", "angular", "omega", "angvel", "rotational"}
_ALONG = {*(w for w, place in _MOVES.items() if place < 3), *_OF_SPEED, *_EARTH_SPEEDS, "sog"}
_OF_VECTOR = {*_OF_TURN, *_OF_SPEED, *_OF_RATE, "position", "pos"}
# Not the motion as measured: what was wanted of it, how far off it was, how well it is known.
WANTED = {
    "des", "desired", "ref", "reference", "sp", "setpoint", "target", "goal", "wp", "waypoint", "err", "diff",
    "error", "std", "var", "cov", "sigma", "acc", "accel", "acceleration", "ship", "alt", "altitude", "limit",
}  # fmt: skip
# A height above a level that stays (the sea, where it was armed), and not above the bottom, grows upwards.
_HEIGHTS, _LEVELS = {"alt", "altitude", "height"}, {"relative", "rel", "home", "amsl", "msl", "baro"}
# Less direct than the measurement where the log has both.
_RANK = {"meas": 0, "measured": 0, "actual": 0, "filt": 2, "filtered": 2, "est": 3, "estimated": 3, "raw": 4}
_PLAIN = {
    "pos", "position", "pose", "att", "attitude", "imu", "gps", "dvl", "nav", "body", "vel", "angle", "enu",
    "ned",
}  # fmt: skip
_DRIVES = {
    "cmd", "command", "thruster", "thrust", "thr", "rpm", "pwm", "servo", "rudder", "delta", "del", "fin",
    "prop", "rev", "propeller", "motor", "throttle", "esc", "tau",
}  # fmt: skip
ANGLES = {"rudder", "delta", "del", "fin", "azimuth", "azi", "angle"}
"""Words of commands that are angles."""
# Consumption, temperature and state of a motor are no commands.
_CONSUMED = {
    "voltage", "volt", "current", "amp", "ampere", "power", "watt", "energy", "battery", "charge", "temp",
    "temperature", "error", "fault", "status", "state", "mode", "id", "count", "counter",
}  # fmt: skip
_HEADER = {"header", "seq", "covariance", "status"}
_CONTAINERS = {"data", "value", "input", "output", "out", "control", "controller", "actuator"}
# What moves is not the vehicle, or what is measured is no motion.
_ABOUT_ELSE = {
    "wind", "vibration", "vib", "mag", "magnetic", "magnetometer", "camera", "gimbal", "joy", "joystick",
    "temp", "temperature",
}  # fmt: skip
_MOMENT = {"torque", "moment"}
# Buoyancy engines of gliders; their volume as commanded (c_ballast_pumped of a Slocum) is not that pumped.
_ENGINE, _COMMANDED = {"ballast", "vbd", "buoyancy", "bladder"}, {"c", "cmd", "command", "commanded"}
_VOLUMES, _WHOSE = {"volume", "vol", "cc", "cm3", "ml", "pumped", "pos"}, {"m", "eng", "glider"}
_WHOLE_FORCE = {"force", "wrench", *_MOMENT}
_AXES = {"x": 0, "y": 1, "z": 2}
# Forces and moments in one word, beside one for a wrench: "wrench.fx", "tau_mz".
_LETTERED = {f"{kind}{axis}": 3 * (kind != "f") + i for kind in "fmt" for axis, i in _AXES.items()}
# Other words for those of a command, the likeliest first.
_ALSO = {
    "rudder": ("delta", "rud", "del"),
    "azimuth": ("azi",),
    "prop": ("propeller", "thrust", "rpm", "rev"),
    "propeller": ("prop", "rpm", "rev", "thrust"),
    "port": ("ps", "left"),
    "starboard": ("stbd", "stb", "sb", "right"),
    "bow": ("bt",),
    "lateral": ("side",),
    "vertical": ("vert",),
    "tau": ("force",),
}
# Other words for those of a logged quantity that drives an effect.
_SENSED = {
    "apparent": {"relative", "rel", "app"},
    "speed": _OF_SPEED,
    "angle": {"dir", "direction", "ang"},
    "from": {"dir", "direction", "angle", "ang"},
    "voltage": {"volt", "volts", "battery", "batt", "vbat"},
}
# What a command counts, by the unit of its column, and by words in the name of one that states none.
_COUNTS = {
    "N": "N", "kN": "N", "rev/s": "rev/s", "rpm": "rev/s", "rad/s": "rev/s", "rad": "rad", "deg": "rad",
    "pwm": "command", "%": "command", "us": "command",
}  # fmt: skip
_COUNTED = {"force": "N", "thrust": "N", "rev": "rev/s", "n": "rev/s", "angle": "rad", "throttle": "command"}


@dataclass(frozen=True)
class DistanceSettings:
    """Distances of the name of a column from that of a command: 0 the same name, 1 the same words."""

    same: float = 0.0
    same_words: float = 1.0
    alike: float = 2.0  # words that mean the same, or the force that the command is
    per_word: float = 0.1  # more for each word that is a likelier name of the command
    begins_alike: float = 3.0
    by_unit: float = 2.9  # only the unit is that of the command: just before a name that begins alike
    no_fit: float = 9.0  # the column is none of the command


DISTANCES = DistanceSettings()
# Units of clocks. As the last word of another name some of them mean something else: the least, a height.
_OF_CLOCKS = {
    "second": "s", "seconds": "s", "secs": "s", "msec": "ms", "millis": "ms", "milliseconds": "ms",
    "usec": "us", "micros": "us", "microseconds": "us", "nsec": "ns", "nanoseconds": "ns", "min": "min",
    "mins": "min", "minutes": "min", "h": "h", "hr": "h", "hrs": "h", "hour": "h", "hours": "h",
    "day": "day", "days": "day",
}  # fmt: skip
_NORTH, _EAST = {"north", "northing", *GLOBE[0]}, {"east", "easting", *GLOBE[1]}
_TIMES = {"t", "time", "timestamp", "stamp", "seconds", "sec", "elapsed", "unix", "epoch", "clock"}


def _with_dots(words: Sequence[str]) -> list[str]:
    """The words, with derivatives by time as what changes and "dot": "psidot" and "dpsi", "dt" alike."""
    of = "|".join(sorted({*_TURNS, *_MOVES, "x", "y", "z"}))
    split = [(m[1], "dot") if (m := re.fullmatch(f"({of})dot", w)) else (w,) for w in words]
    for k, (word, after) in enumerate(pairwise(words)):
        if after == "dt" and (m := re.fullmatch(f"d({of})", word)):
            split[k], split[k + 1] = (m[1],), ("dot",)
    return [w for part in split for w in part]


# "gyroz" is "gyro", "z"; "yawspeed" is of MAVLink, "imuyaw" the yaw of something.
_RUN_TOGETHER = (
    "(gyro?|omega|vel|pos)([xyz])|(.*?)(roll|pitch|yaw|heading)(speed|rate)?(deg|rad)?|(ground)(speed)"
    "|(port|starboard|stbd|left|right|rudder|motor)(cmd|command|thrust|rpm|pwm|angle)"
)


def _no_knots(text: str) -> str:
    """The text with kN as a word, for in small letters it is the unit of a speed."""
    return re.sub("(?<![A-Za-z])kN(?=$|[^A-Za-z]|m)", "kilonewton ", text)


@dataclass(frozen=True)
class Name:
    """A column's name taken apart: words in small letters, and the unit that it states ("" for none)."""

    column: str
    words: tuple[str, ...]
    unit: str

    @classmethod
    def of(cls, column: str) -> Name:
        """Take a name such as "yawRate [deg/s]" or "u_meas_mps" apart."""
        bracket = re.search(r"[\[(](?!\d+[\])])([^\])]*)[\])]", column)  # a number is that of an instance
        rest = _no_knots(column if bracket is None else column.replace(bracket[0], " "))
        words = words_of(rest)
        fixed = "[xyz][0g]" if len(words) == 1 else "[xyz]0"  # to the earth; beside other words g is a gyro
        words = [w[:-1] if re.fullmatch(fixed, w) else w for w in words]
        words = re.sub(r"\brate of turn\b", "rot", " ".join(words)).split()
        compounds = ((w, re.fullmatch(_RUN_TOGETHER, w)) for w in words)
        words = _with_dots([part for w, m in compounds for part in (filter(None, m.groups()) if m else (w,))])
        if bracket is not None:
            return cls(column, tuple(words), stated_unit(bracket[1]))
        for length in (2, 1):
            unit = _UNITS.get(" ".join(words[-length:]), "")
            speed = unit == "N" and {"v", *_OF_SPEED} & {*words}  # to the north: none is counted in newtons
            if unit == "ms" and {*words[:-length]} & _ALONG:
                unit = "m/s"  # "u_ms": no speed is counted in milliseconds
            if unit and len(words) > length and not speed:
                return cls(column, tuple(words[:-length]), unit)
        counted = (re.fullmatch(r"(rpm|pwm)\d*", w) for w in words)
        return cls(column, tuple(words), next((m[1] for m in counted if m), ""))

    @property
    def rank(self) -> tuple[int, int, bool]:
        """Distance of the name from that of a measurement; the smallest is chosen, and of equals "u"."""
        motions = {*_PLACES, *_TURNS, *_MOVES, *_OF_SPEED, *_OF_RATE, *_EARTH_SPEEDS, *_SIDEWAYS}
        known = {*motions, *_RANK, *_PLAIN}
        least = 2 if self.is_height else 1  # a depth is what the vehicle feels
        direct = max((_RANK.get(w, least) for w in self.words), default=least)
        return direct, len(set(self.words) - known), self.column not in {*POSE, *VELOCITY}

    @property
    def stem(self) -> tuple[str, ...]:
        """The words without those for a direction: those that the components of one vector share."""
        return tuple(w for w in self.words if w not in {*_TURNS, *_MOVES, *_PLACES, *_SIDEWAYS})

    def motion(self, only: int | None = None) -> str:
        """The channel of pose or velocity that the name means; "" for none.

        `only` is the one degree of freedom of a vehicle, whose "position" needs no axis.
        """
        wanted = WANTED - _HEIGHTS if self.is_height else WANTED
        if set(self.words) & {*wanted, *_DRIVES, *_ABOUT_ELSE, "battery"} or self.force or self.of_header:
            return ""
        globe = {*GLOBE[0], *GLOBE[1]} & {*self.words}  # the E of "Longitude E/W" is no axis
        found = "" if globe and self._axis(only) in POSE[:2] else self._axis(only)
        units = (_LENGTHS, _ANGLES, _SPEEDS, RATES | {"rev/s"})
        fits = dict(zip((*POSE, *VELOCITY), (u for u in units for _ in range(3)), strict=True))
        return found if found and (not self.unit or self.unit in fits[found]) else ""

    @property
    def is_speed(self) -> bool:
        """Whether it is the speed of the vehicle along no particular axis, such as that over ground."""
        words = {*self.words}
        others = {w for w in words if not w.isdigit()} - {
            *_OF_SPEED,
            *_PLAIN,
            *_RANK,
            *(_STW if self.is_through_water else _SOG),
        }
        is_speed = bool(words & {"speed", "spd", "velocity", "vel", "sog", "stw", "vs"}) and not others
        return is_speed and self.unit in {"", *_SPEEDS}

    @property
    def is_through_water(self) -> bool:
        """Whether it says that it is measured through the water; "water speed" may be that of the water."""
        words = {*self.words}
        return "stw" in words or {"through", "water"} <= words

    @property
    def of_header(self) -> bool:
        """Whether it is of the header of a message, or the quality of a measurement."""
        return bool(_HEADER & {*self.words}) or {"frame", "id"} <= {*self.words}

    @property
    def along_earth(self) -> bool:
        """Whether it is a speed to the north, east, down or up."""
        return self._along_earth is not None and self.motion() in VELOCITY[:3]

    @property
    def is_to_north(self) -> bool:
        """Whether it says that it grows to the north."""
        return bool(_NORTH & {*self.words})

    @property
    def is_upward(self) -> bool:
        """Whether it grows upwards."""
        return self.is_height or bool({"up", "vu"} & self._with_pairs)

    @property
    def is_leftward(self) -> bool:
        """Whether it is a speed that grows to port."""
        return bool({"left", "port"} & set(self.words)) and self.motion() == "v"

    @property
    def is_height(self) -> bool:
        """Whether it is a height above a level, such as "altitudeRelative" or "alt_msl_m"."""
        return bool(_HEIGHTS & set(self.words) and _LEVELS & set(self.words))

    @property
    def _along_earth(self) -> int | None:
        """Place among north, east and down of a speed in one of them, such as "vE_mps" or "North_Vel"."""
        words = set(self.words)
        if "dot" in words:  # of a position, along the axes in which that is given
            return next((_PLACES[w] for w in self.words if w in "xyz"), None)
        if self.unit in RATES or words & _OF_RATE:
            return None
        if "ned" in words and (words & _OF_SPEED or self.unit in _SPEEDS):
            return next((_PLACES[w] for w in self.words if w in "xyz"), None)
        if words & {"v", *_OF_SPEED} or self.unit in _SPEEDS:
            return next((_EARTH[w] for w in self.words if w in _EARTH), self._earth_speed)
        return self._earth_speed

    @property
    def _earth_speed(self) -> int | None:
        return next((place for w, place in _EARTH_SPEEDS.items() if w in self._with_pairs), None)

    @property
    def _with_pairs(self) -> set[str]:
        """The words, and what two in a row make together: "vN" and "v_n" are the "vn" of others."""
        return {*self.words, *(a + b for a, b in pairwise(self.words))}

    def _axis(self, only: int | None) -> str:
        words = set(self.words)
        if self.is_height:
            return "" if words & {*_OF_SPEED, *_OF_RATE} else "z"
        if self._along_earth is not None:
            return VELOCITY[self._along_earth]
        speed = self.unit in _SPEEDS or bool(words & _OF_SPEED)
        rate = self.unit in RATES or bool(words & _OF_RATE)
        for word in self.words:
            if word in _MOVES and "dot" in words:
                return ""  # an acceleration
            if word in _MOVES:
                place = word in _NAMED and self.unit in _LENGTHS  # of a hull that swings in waves
                return (POSE if place else VELOCITY)[_MOVES[word]]
            if word in _TURNS:
                return (VELOCITY if rate or speed else POSE)[3 + _TURNS[word]]
            if word in _PLACES:
                turned = 3 if rate or words & _OF_TURN else 0
                return (VELOCITY if rate or speed else POSE)[turned + _PLACES[word]]
            if word in _SIDEWAYS and not rate and (self.unit in _SPEEDS or "sog" in words):
                return VELOCITY[_SIDEWAYS[word]]
        if only is not None and words & {"position", "pos", "velocity", "vel", "speed", "angle", "rate"}:
            return (VELOCITY if speed or rate else POSE)[only]
        return ""

    @property
    def is_motion_by_unit(self) -> bool:
        """Whether only its unit shows that a position or an angle is a velocity."""
        of_motion = {*_MOVES, *_OF_SPEED, *_OF_RATE, *_SIDEWAYS}
        return self.unit in {*_SPEEDS, *RATES, "rev/s"} and not of_motion & set(self.words)

    @property
    def counts(self) -> str:
        """What the column of a command counts: "N", "rev/s", "rad", "command" (shares, pulses) or ""."""
        return _COUNTS.get(self.unit) or next((_COUNTED[w] for w in self.unnumbered if w in _COUNTED), "")

    def fits(self, command: str, unit: str, axes: Mapping[str, str]) -> tuple[float, int]:
        """Distance of a column from a command of a vehicle, by name and quantity; the smallest is chosen."""
        wanted = _COUNTS.get(unit, unit)
        name = self.drives(command, axes)
        if name == DISTANCES.no_fit and wanted == "rev/s" and _COUNTS.get(self.unit) == wanted:
            name = DISTANCES.by_unit
        return name, 0 if self.counts == wanted else 2 if self.counts else 1

    def senses(self, quantity: str, unit: str) -> tuple[float, int]:
        """Distance of a column from a logged quantity, such as the wind speed; the smallest is chosen."""
        wanted, words = quantity.lower().split("_"), set(self.words)
        if self.column.lower() == quantity.lower():
            return 0.0, 0
        there = all({word, *_SENSED.get(word, ())} & words for word in wanted)
        apparent = "apparent" in wanted or not {"apparent", *_SENSED["apparent"]} & words
        dimension = next((d for d in (_LENGTHS, _ANGLES, _SPEEDS, {"V"}, {"N"}) if unit in d), {unit})
        fits = there and apparent and self.unit in {"", *dimension}
        return 2.0 if fits else DISTANCES.no_fit, len(words)

    @property
    def is_pumped_volume(self) -> bool:
        """Whether it is the volume by which a buoyancy engine has changed that of the vehicle."""
        words = set(self.words)
        measured = not words & {*WANTED, *_COMMANDED}
        named = words & _VOLUMES or not words - _ENGINE - _WHOSE  # and not what the engine consumes or counts
        return measured and bool(words & _ENGINE and named) and self.unit in {"", "cc", "cm^3", "cm3", "ml"}

    @property
    def force(self) -> str:
        """The force or moment on the whole vehicle, tau_X ... tau_N, that the name means; "" for none."""
        words = set(self.words)
        exact = next((f for f in FORCES if f.lower() == self.column.lower()), "")
        if exact:
            return exact
        if not words & {"tau", *_WHOLE_FORCE} or words & _ABOUT_ELSE:
            return ""
        kind = 3 if words & _MOMENT else 0
        named = [_LETTERED[w] for w in self.words if w in _LETTERED]
        named += [kind + _AXES[w] for w in self.words if w in _AXES and words & _WHOLE_FORCE]
        return FORCES[named[0]] if named else ""

    def drives(self, command: str, axes: Mapping[str, str]) -> float:
        """Distance of a name from that of a command: 0 the same name, 1 the same words, more for others.

        `axes`: the force or moment that is all of what a command gives, by the command.
        """
        wanted = [w for w in re.split(r"[^a-z0-9]+", command.lower()) if w]
        also = [other for word in wanted for other in _ALSO.get(word, ())]
        if self.column.lower() == command.lower():
            return DISTANCES.same
        if self.unit in {*_NO_COMMANDS, *_OTHERS.values()}:
            return DISTANCES.no_fit
        if set(wanted) <= set(self.words):
            return DISTANCES.same_words
        if self.force and command in axes:
            both = "tau" in wanted and "tau" in self.words
            if self.force != axes[command]:
                return DISTANCES.no_fit
            return DISTANCES.same_words if both else DISTANCES.alike
        known = [k for k, other in enumerate(also) if other in self.words]
        if known:
            return DISTANCES.alike + DISTANCES.per_word * known[0]
        alike = any(w.startswith(other) for w in self.words for other in [*wanted, *also] if len(other) > 3)
        return DISTANCES.begins_alike if alike else DISTANCES.no_fit

    def is_surely(self, command: str, axes: Mapping[str, str]) -> bool:
        """Whether a name is that of a command, with at most one word of another meaning."""
        words = {word.removesuffix("s") for word in self.words} - {*command.lower().split("_")}
        return self.drives(command, axes) < DISTANCES.alike and len(words - _DRIVES - _CONTAINERS) < 2

    @property
    def is_command(self) -> bool:
        """Whether it looks like a command of a vehicle."""
        numbered = any(re.fullmatch(r"[nuftm]\d+|tau[xyzkmn]", word) for word in self.words)
        single = {word.removesuffix("s") for word in self.unnumbered}  # of several thrusters, one column each
        drives = bool({*self.unnumbered, *single} & _DRIVES or numbered) or self.unit == "pwm"
        other = {"limit", *_CONSUMED} & {*self.unnumbered, *single} or self.is_difference
        counts = self.unit in {"", "V", "N m", "kN m", *_COUNTS}
        return drives and counts and not other and not self.of_header

    @property
    def is_difference(self) -> bool:
        """Whether its delta is a change, as in "delta_distance", and no angle of a rudder."""
        driving = {*_DRIVES, *_ALSO, *_SIDEWAYS, *_RANK, *_CONTAINERS, "angle"}
        pairs = pairwise(self.unnumbered)
        return any(a == "delta" and len(b) > 2 and b not in driving for a, b in pairs)  # delta_r: a rudder

    @property
    def unnumbered(self) -> list[str]:
        """The words without numbers at their ends, of columns that differ in these."""
        return [re.sub(r"\d+$", "", word) for word in self.words]


def known_unit(text: str) -> str:
    """The unit that a text at the end of a name stands for; "" for none."""
    return _UNITS.get(" ".join(_no_knots(text).lower().replace("_", " ").split()), "")


def stated_unit(text: str) -> str:
    """The unit that a text alone stands for, also of other quantities than motions and commands."""
    return known_unit(text) or _OTHERS.get(text.lower(), "")


def with_axes(names: Sequence[Name]) -> list[Name]:
    """The names, with x, y, z for the numbers of three of a place, a turn or a speed that differ in these."""
    # A last letter n or v is a direction, and not a unit, beside a name that has e or u there.
    there = {name.words for name in names}
    names = [_lettered(name, there) for name in names]
    rows: dict[tuple[str, ...], dict[int, Name]] = {}
    for name in names:
        if name.words and re.fullmatch(r"\d", name.words[-1]) and _OF_VECTOR & {*name.words}:
            rows.setdefault(name.words[:-1], {})[int(name.words[-1])] = name
    axes = {
        row[number]: replace(row[number], words=(*words, axis))
        for words, row in rows.items()
        if sorted(row) in ([0, 1, 2], [1, 2, 3])
        for number, axis in zip(sorted(row), "xyz", strict=True)
    }
    return [axes.get(name, name) for name in names]


_BESIDE = {"n": "e", "v": "u"}


def _lettered(name: Name, there: Container[tuple[str, ...]]) -> Name:
    """A name such as "gps_n" or "dvl_v", whose last letter could be newtons or volts."""
    found = re.search("[^A-Za-z0-9]([nv])$", name.column.lower())
    if found is None or (*name.words, _BESIDE[found[1]]) not in there:
        return name
    return replace(name, words=(*name.words, found[1]), unit="")


def with_sides(names: Sequence[Name]) -> list[Name]:
    """The names, with left and right for the l and r of two that differ in these."""
    # u is the input of a control loop then: a vehicle has one speed ahead, and not one for each side.
    there = {name.words for name in names}
    return [_sided(name, there) for name in names]


def with_azimuths(names: Sequence[Name]) -> list[Name]:
    """The names, with azimuths as commands beside revolutions: alone they may be those of anything."""
    turning = any(n.is_command and n.counts == "rev/s" for n in names)
    own = [n for n in names if turning and {*n.unnumbered} & {"azimuth", "azi"} and n.unit in {"", *_ANGLES}]
    return [replace(n, words=(*n.words, "cmd")) if n in own else n for n in names]


_SIDES = {"l": ("r", "left"), "r": ("l", "right")}


def _sided(name: Name, there: Container[tuple[str, ...]]) -> Name:
    for at, word in enumerate(name.words):
        other, side = _SIDES.get(word, ("", ""))
        if other and (*name.words[:at], other, *name.words[at + 1 :]) in there:
            words = (*name.words[:at], side, *name.words[at + 1 :])
            return replace(name, words=tuple("cmd" if w == "u" else w for w in words))
    return name


def rows_by_number(names: Iterable[str]) -> list[list[str]]:
    """Names that differ in their last number alone, in its order, row by row; in "[1/min]" there is none."""
    rows: dict[str, list[tuple[int, str]]] = {}
    for name in names:
        if parts := re.fullmatch(r"(.*?)(\d+)(\D*(?:[\[(][^\])]*[a-zA-Z][^\])]*[\])])?)", name):
            rows.setdefault(f"{parts[1]}#{parts[3]}", []).append((int(parts[2]), name))
    return [[name for _, name in sorted(row, key=lambda pair: pair[0])] for row in rows.values()]


def latitude_and_longitude(columns: Iterable[str]) -> tuple[str, ...]:
    """The first columns that are called latitude and longitude; () where one of them is missing."""
    return next(iter(places_called_so(columns)), ())


def places_called_so(columns: Iterable[str]) -> list[tuple[str, str]]:
    """Pairs of columns that are called latitude and longitude, and alike in their other words."""
    # Those of a place that is given, as of an origin, are not where the vehicle is.
    words = {column: {*Name.of(column).words} for column in columns}
    known = [c for c, own in words.items() if not own & {"origin", "home", *WANTED}]
    north, east = ([c for c in known if words[c] & called] for called in GLOBE)
    alike = [(a, b) for a in north for b in east if words[a] - GLOBE[0] == words[b] - GLOBE[1]]
    return alike or [*zip(north[:1], east[:1], strict=False)]


def position_axes(mapping: LogMapping) -> str:
    """ "NED" or "ENU" where the names of its columns say it of the position in a log, else ""."""
    # They do if both names have the word, or if one has that for north and the other that for east.
    x, y = (_words_in_columns(mapping, channel) for channel in "xy")
    for axes in ("NED", "ENU"):
        if axes.lower() in x & y:
            return axes
    if x & _NORTH and y & _EAST:
        return "NED"
    return "ENU" if x & _EAST and y & _NORTH else ""


def _words_in_columns(mapping: LogMapping, channel: str) -> set[str]:
    """Words in the names of the columns that become a channel of the log."""
    computed = mapping.channels.get(channel)
    names = computed.formula.columns if computed else ()
    names = (*names, *(n for n, column in mapping.columns.items() if column.channel == channel))
    return {word for name in names for word in Name.of(name).words}


def part_of_quaternion(column: str, columns: Container[str]) -> bool:
    """Whether a column is one of four that differ in w, x, y, z alone and are an attitude by their names."""
    letters = next((four for four in ("wxyz", "WXYZ") if column[-1:] and column[-1] in four), "")
    four = [column[:-1] + letter for letter in letters]
    return bool(four) and all(c in columns for c in four) and Name.of(four[1]).motion() in POSE[3:]


def attitude_beside(place: str, quaternions: Iterable[Sequence[str]]) -> Sequence[str]:
    """Of the columns of several quaternions those of the attitude as measured, () where none is.

    Rather that of the message which has the column of the position, for its axes are those of the position.
    """

    def distance(four: Sequence[str]) -> tuple[int, tuple[int, int, bool]]:
        name = Name.of(four[1])
        pairs = zip(name.words, Name.of(place).words, strict=False)
        return -sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs)), name.rank

    return min((four for four in quaternions if not is_wanted(four[0])), key=distance, default=())


def is_force(name: str) -> bool:
    """Whether a name means a force or a moment on the whole vehicle."""
    return bool({*Name.of(name).words} & {*_WHOLE_FORCE, "tau"})


def is_wanted(name: str) -> bool:
    """Whether a name means a set-point or an error of a motion, and not the motion."""
    return bool({*Name.of(name).words} & WANTED)


def is_clock(name: str) -> bool:
    """Whether a word in the name of a column means time."""
    return bool(set(Name.of(name).words) & _TIMES)


def unit_of_clock(name: str) -> str:
    """The unit that the name of a clock states, such as "Time (min)" or "t_hours"; "" for none."""
    bracket = re.search(r"[\[(]([^\])]*)[\])]", name)
    known, words = Name.of(name).unit, re.split(r"[^a-z]+", name.lower())
    if known in SECONDS:
        return known
    stated = bracket[1].strip().lower() if bracket else words[-1] if len(words) > 1 else ""
    return _OF_CLOCKS.get(stated, "")


def is_time(name: str) -> bool:
    """Whether the name of a column means that it counts the time."""
    return is_clock(name) and not is_wanted(name)
