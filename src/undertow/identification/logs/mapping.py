"""The mapping file: how columns of a log become channels of a run in undertow's frames; changes of it."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Self

import numpy as np
import tomlkit
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, field_validator, model_validator
from tomlkit.items import Table

from undertow.errors import UndertowError, nearest
from undertow.files import read_toml
from undertow.model.symbols import ENVIRONMENT
from undertow.model.tables import validated
from undertow.model.units import si_of
from undertow.typing import Array, Flags

SCHEMA = "undertow/mapping/1"
CommandPolicy = Literal["refuse", "hold", "gap"]
Motion = Literal["surge", "sway", "heave", "roll", "pitch", "yaw"]
Held = tuple[Motion, ...] | Literal["unlogged"]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, populate_by_name=True)


class Column(_Strict):
    """One column: its channel value is ``scale * cell^power + offset`` in `unit`, converted to SI."""

    channel: str = Field(min_length=1)  # name of the channel it becomes
    unit: str | None = None  # unit of the column; None: the SI unit of the channel
    # scale, offset: applied to the cell first; `offset` is in `unit`.
    scale: float = 1.0
    offset: float = 0.0
    # Exponent of the magnitude of the cell; the sign stays (rpm |rpm| for 2).
    power: float = Field(default=1.0, gt=0)
    # Cell value that means no output: the channel is zero there, whatever the offset (a pulse of 0 us of an
    # output that is switched off).
    off: float | None = None
    wrapped: bool | None = None  # whether to unwrap jumps by a turn, without samples across one; default: psi
    optional: bool = False  # whether a log may lack this column
    # For the measured position of an actuator (rudder angle, shaft speed), which moves on between samples; a
    # command is held until the next one.
    interpolate: bool = False
    # For a sensor slower than the log that repeats its values: a column that is not zero in rows with a new
    # sample of this one, or this column itself, if every change of its value is a new sample. Not needed if
    # the cells in between are blank.
    fresh: str | None = Field(default=None, min_length=1)
    # How late its time stamps are, "0.12 s" or a number in s (the doctor estimates it): the value in a row
    # was true that much earlier.
    delay: str | float = 0.0
    # Standard deviation of the sensor noise, "2 cm" or a number in `unit`; default: estimated from the log.
    noise: str | float | None = None

    def scaled(self, cells: Array, scale: float, offset: float) -> Array:
        """Values of cells, with the scale and offset of this column in some unit."""
        size = cells if self.power == 1.0 else np.sign(cells) * np.abs(cells) ** self.power
        values = scale * size + offset
        return values if self.off is None else np.where(cells == self.off, 0.0, values)

    def times(self, factor: float) -> Column:
        """The column with its values multiplied by a factor."""
        return self.model_copy(update={"scale": factor * self.scale, "offset": factor * self.offset})

    def in_units_of(self, factor: float) -> Column:
        """The column scaled by a factor to the unit of its channel, which it then no longer states."""
        return self.times(factor).model_copy(update={"unit": None})


class Channel(_Strict):
    """A channel that is a formula in columns: its value is in `unit`, converted to SI."""

    expression: str  # arithmetic in the cells of columns, see `Formula`
    unit: str | None = None  # unit of the result; None: the SI unit of the channel
    delay: str | float = 0.0  # as for a column
    interpolate: bool = False  # as for a column
    # As for a column: of a column of the formula, every change of its value is a new sample.
    fresh: str | None = Field(default=None, min_length=1)
    wrapped: bool | None = None  # as for a column

    def in_units_of(self, factor: float) -> Channel:
        """The formula scaled by a factor to the unit of its channel, which it then no longer states."""
        return self.model_copy(update={"unit": None, "expression": f"{factor!r} * ({self.expression})"})

    @field_validator("expression")
    @classmethod
    def _is_arithmetic(cls, text: str) -> str:
        try:
            return Formula(text).text
        except UndertowError as error:
            raise ValueError(str(error)) from error

    @property
    def formula(self) -> Formula:
        """The parsed expression."""
        return Formula(self.expression)


class Time(_Strict):
    """The time column."""

    column: str = "t"  # name of the time column
    # ``"s"``, ``"ms"``, ``"ns"``, ``"min"``, ``"h"``, ``"day"`` … or ``"iso"`` for dates (also 31/12/2025 or
    # 12/31/2025, whichever fits the log), and for times of day such as 17:28:59 or 172859.
    unit: str = "s"
    # Column of the nanoseconds that are added, where a stamp stands in two columns (``stamp.sec``,
    # ``stamp.nanosec``).
    nanoseconds: str | None = Field(default=None, min_length=1)
    offset: float = 0.0  # added to all times, s
    # Sampling interval, "0.05 s" or a number in s, of a log without times or with times of too few digits:
    # its rows are that far apart, the first at 0 s, and `column` is not read.
    interval: str | float | None = None
    # What to do with rows whose time is not later than that of all rows before.
    disorder: Literal["refuse", "drop"] = "refuse"
    # Use only every n-th row (n up to 10^6), for pose logged much faster than the vehicle moves; of columns
    # that report more rarely than that, all reports.
    every: int = Field(default=1, ge=1, le=1_000_000)
    # Column that numbers the segments to use: each number is a separate run, rows without a number are left
    # out (vehicle on deck, estimator reset).
    stretch: str | None = Field(default=None, min_length=1)

    @model_validator(mode="after")
    def _keys_fit(self) -> Self:
        if self.nanoseconds is not None and self.unit != "s":
            raise ValueError(
                f'nanoseconds belong to a column in s, but unit is {self.unit!r}: write unit = "s"'
            )
        if self.interval is not None and (self.unit != "s" or self.nanoseconds is not None):
            raise ValueError("interval replaces the times of the log: remove unit and nanoseconds")
        try:
            _ = self.spacing
        except UndertowError as error:
            raise ValueError(str(error)) from error
        return self

    @property
    def spacing(self) -> float:
        """The stated sampling interval, s; 0 where times are read."""
        return 0.0 if self.interval is None else spacing_of(self.interval)

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns of the time."""
        return (self.column,) if self.nanoseconds is None else (self.column, self.nanoseconds)


class Frames(_Strict):
    """The frames of the log."""

    position: Literal["NED", "ENU"] = "NED"  # axes of x, y, z
    body: Literal["FRD", "FLU"] = "FRD"  # axes of u … r and tau_X … tau_N
    # Whether phi, theta, psi rotate FRD axes in NED (heading from north, clockwise) or FLU axes in ENU
    # (heading from east, anticlockwise); default: as `position` and `body`, which then must agree.
    attitude: Literal["NED", "ENU"] | None = None
    # Axes of u, v, w only: body axes (those of `body`), north-east-down or east-north-up.
    velocity: Literal["body", "NED", "ENU"] = "body"


class Compass(_Strict):
    """The compass: its deviation is added to psi, A + B sin psi + C cos psi of the psi that it shows."""

    # A, B, C: "2 deg" or a number in rad; A is a constant error, B and C are made by iron and currents
    # near it.
    A: str | float = 0.0
    B: str | float = 0.0
    C: str | float = 0.0
    # Whether u and v, along the body, were computed by this heading from velocities over ground: they are
    # turned, too.
    velocities: bool = False

    @property
    def coefficients(self) -> tuple[float, float, float]:
        """A, B and C, rad."""
        a, b, c = (si_of(f"compass: {n}", getattr(self, n), "rad") for n in "ABC")
        return a, b, c


class Water(_Strict):
    """The water, where u, v, w are measured through it: its `velocity` (NED, m/s) is added to them."""

    velocity: tuple[float, float, float]


def _short_for(key: str) -> BeforeValidator:
    """Let a text stand for a table of one key: ``heading = "psi"`` for ``heading = { channel = "psi" }``."""
    return BeforeValidator(lambda value: {key: value} if isinstance(value, str) else value)


class LogMapping(_Strict):
    """A whole mapping file."""

    schema_: Literal["undertow/mapping/1"] = Field(alias="schema", default="undertow/mapping/1")
    description: str = ""
    # Column name to `Column` (or just to the channel name).
    columns: dict[str, Annotated[Column, _short_for("channel")]] = {}
    # Channel name to `Channel` (or just to its expression): what is computed from columns.
    channels: dict[str, Annotated[Channel, _short_for("expression")]] = {}
    # time, frames: time base and axes.
    time: Time = Time()
    frames: Frames = Frames()
    # Expected disturbance in each force or moment, rms: X = "0.4 N"; a number is in N or N m.
    disturbance: dict[Literal["X", "Y", "Z", "K", "M", "N"], str | float] = {}
    # Deviation of the compass (the doctor estimates it); default: psi is the true heading.
    compass: Compass | None = None
    # Velocity of the water, if the log has velocities through the water; default: they are over ground.
    water: Water | None = None
    # delimiter, decimal, comment: how the text is written; `comment` is a prefix of lines to skip.
    delimiter: str = Field(default=",", min_length=1, max_length=1, pattern=r"[\x01-\x7f]")
    decimal: Literal[".", ","] = "."
    comment: str | None = Field(default=None, min_length=1, max_length=5)
    # Lines above the header that are left out: a title, settings of the run.
    skip: int = Field(default=0, ge=0, le=10_000)
    # Texts and numbers that mean a missing sample, besides empty cells and NaN.
    missing: tuple[float | str, ...] = ()
    # What to do with cells that are not numbers; a number with a unit ("1.76V") is one. A line of units below
    # the names is left out with "missing".
    not_numbers: Literal["refuse", "missing"] = "refuse"
    ignore: tuple[str, ...] = ()  # columns to leave out without a note
    missing_commands: CommandPolicy = "refuse"  # what to do if a command has no sample
    # Motions held at rest by a rig (towing carriage, planar motion mechanism), or moved as logged;
    # "unlogged": all without a column.
    held: Held = ()
    # Folder with definitions that are not in the log: ROS messages (.msg), glider sensors (.cac).
    messages: Path | None = None

    @property
    def flags(self) -> tuple[str, ...]:
        """Columns that show where others have a new sample."""
        fresh = (*(c.fresh for c in self.columns.values()), *(c.fresh for c in self.channels.values()))
        return tuple(name for name in fresh if name)

    def required(self, commands: Collection[str]) -> set[str]:
        """Names of the columns that a log must have; that of a command is never optional."""
        return {n for n, column in self.columns.items() if not column.optional or column.channel in commands}

    def jumps(self, channel: str) -> bool:
        """Whether an angle may jump by a turn: psi does unless that is denied."""
        stated = {column.channel: column.wrapped for column in self.columns.values()}
        stated |= {name: one.wrapped for name, one in self.channels.items()}
        asked = stated.get(channel)
        return asked or (channel == "psi" and asked is None)


def read_mapping(path: str | Path) -> LogMapping:
    """Read a mapping file, TOML with ``schema = "undertow/mapping/1"``."""
    path = Path(path)
    data = read_toml(path, "mapping file")
    if data.get("schema") != SCHEMA:
        raise UndertowError(
            f"mapping file {path} has schema {data.get('schema')!r}: write schema = {SCHEMA!r} on top"
        )
    mapping = validated(data, LogMapping, f"mapping file {path}")
    _refuse_duplicate_channels(mapping, path)
    return mapping


def mapping_beside(log: Path) -> LogMapping | None:
    """The mapping of a log from a mapping file of the same name next to it, run1.toml for run1.csv."""
    path = place_beside(log)
    if not path.is_file() or read_toml(path, "file").get("schema") != SCHEMA:
        return None
    return read_mapping(path)


def place_beside(log: Path) -> Path:
    """Default location of the mapping file of a log."""
    return log.parent / f"{name_of_log(log)}.toml"


def name_of_log(path: Path) -> str:
    """Name of a log: that of its file without the ending, which begins with a letter, and without .gz."""
    return re.sub(r"\.[A-Za-z]\w*$", "", path.name.removesuffix(".gz"))


def mapping_text(mapping: LogMapping) -> str:
    """The mapping as a mapping file: what differs from the defaults, one line for a column."""
    content = mapping.model_dump(mode="json", by_alias=True, exclude_defaults=True)
    lines = tomlkit.document()
    lines["schema"] = SCHEMA
    for key, value in content.items():
        lines[key] = _table_of(value) if isinstance(value, dict) else value
    return tomlkit.dumps(lines)


def _table_of(entries: dict[str, Any]) -> Table:
    table = tomlkit.table()
    for name, entry in entries.items():
        inline = tomlkit.inline_table()
        table[name] = inline.update(entry) or inline if isinstance(entry, dict) else entry
    return table


def _refuse_duplicate_channels(mapping: LogMapping, path: Path) -> None:
    seen: dict[str, str] = {}
    for name, column in mapping.columns.items():
        if column.channel in seen:
            raise UndertowError(
                f"mapping file {path}: columns {seen[column.channel]!r} and {name!r} both become channel "
                f"{column.channel!r}: name one of them under `ignore`"
            )
        seen[column.channel] = name
    for channel in mapping.channels:
        if channel in seen:
            raise UndertowError(
                f"mapping file {path}: channel {channel!r} is column {seen[channel]!r} and an expression: "
                "keep one"
            )


def spacing_of(interval: str | float) -> float:
    """A stated sampling interval, s."""
    spacing = si_of("interval", interval, "s")
    if not 0.0 < spacing < np.inf:
        raise UndertowError(f"interval {interval!r} is not above zero: write the time between two rows")
    return spacing


Channels = dict[str, Array]
_LINEAR, ANGLES = ("u", "v", "w"), ("phi", "theta", "psi")
_SWAPPED = {"x": "y", "y": "x"}
# Forward stays forward; left becomes starboard and up becomes down, so second and third components turn.
FLIPPED_BODY = (
    "v", "w", "q", "r", "v_dot", "w_dot", "q_dot", "r_dot", "tau_Y", "tau_Z", "tau_M", "tau_N"
)  # fmt: skip


def swap_position(channels: Mapping[str, NDArray[np.float64]]) -> Channels:
    """Turn positions from ENU to NED, or back: east and north change places, z changes sign."""
    turned = {_SWAPPED.get(name, name): data for name, data in channels.items()}
    return _negated(turned, ("z",))


def turned_name(name: str, position: str) -> str:
    """Return the name that a channel of the log has after the turn from `position` to NED."""
    return _SWAPPED.get(name, name) if position == "ENU" else name


def swap_attitude(channels: Mapping[str, NDArray[np.float64]]) -> Channels:
    """Turn roll-pitch-yaw of FLU axes in ENU into those of FRD axes in NED, or back.

    Heading counts from north clockwise instead of from east anticlockwise (psi becomes pi/2 - psi), pitch is
    positive nose up instead of nose down, roll is the same.
    """
    turned = _negated(channels, ("theta",))
    if "psi" in turned:
        turned["psi"] = np.pi / 2 - turned["psi"]
    return turned


def swap_body(channels: Mapping[str, NDArray[np.float64]]) -> Channels:
    """Turn body velocities and forces from forward-left-up to forward-starboard-down, or back."""
    return _negated(channels, FLIPPED_BODY)


def velocity_to_body(channels: Mapping[str, NDArray[np.float64]], axes: str) -> Channels:
    """Turn u, v, w along the axes of NED or ENU into body axes, by the attitude in NED (else zero)."""
    linear = _three(channels, _LINEAR)
    north_east_down = linear if axes == "NED" else np.array([linear[1], linear[0], -linear[2]])
    turned = np.einsum("ijn,jn->in", to_body(*_three(channels, ANGLES)), north_east_down)
    return {**channels, **_present(channels, turned)}


def velocity_to_earth(channels: Mapping[str, NDArray[np.float64]]) -> Channels:
    """Rates of x, y, z in NED, from u, v, w and the attitude (what is missing is zero)."""
    turned = np.einsum("ijn,in->jn", to_body(*_three(channels, ANGLES)), _three(channels, _LINEAR))
    return dict(zip("xyz", turned, strict=True))


def over_ground(channels: Mapping[str, NDArray[np.float64]], water: Sequence[float]) -> Channels:
    """Add the velocity of the water (NED, m/s) to u, v, w that are measured through the water."""
    drift = np.einsum("ijn,j->in", to_body(*_three(channels, ANGLES)), np.asarray(water))
    return {**channels, **_present(channels, _three(channels, _LINEAR) + drift)}


def to_body(phi: Array, theta: Array, psi: Array) -> Array:
    """Return R^T (NED to body), (3, 3, n) (Fossen 2021, section 2.2)."""
    (cf, sf), (ct, st), (cp, sp) = ((np.cos(angle), np.sin(angle)) for angle in (phi, theta, psi))
    return np.array(
        [
            [ct * cp, ct * sp, -st],
            [sf * st * cp - cf * sp, sf * st * sp + cf * cp, sf * ct],
            [cf * st * cp + sf * sp, cf * st * sp - sf * cp, cf * ct],
        ]
    )


def _three(channels: Mapping[str, NDArray[np.float64]], names: tuple[str, ...]) -> Array:
    zero = np.zeros_like(next(iter(channels.values())))
    return np.array([channels.get(name, zero) for name in names])


def _present(channels: Mapping[str, NDArray[np.float64]], linear: Array) -> Channels:
    return {name: data for name, data in zip(_LINEAR, linear, strict=True) if name in channels}


def _negated(channels: Mapping[str, NDArray[np.float64]], names: tuple[str, ...]) -> Channels:
    return {name: -data if name in names else data for name, data in channels.items()}


# --- formulas ------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class FormulaLimits:
    """Limits of a formula: anything longer is a program, or a mistake."""

    characters: int = 2000  # an attitude has ten names of columns in it
    parts: int = 200  # numbers, names and operations


_LIMITS = FormulaLimits()
_OPERATIONS: dict[type[ast.AST], Callable[..., Any]] = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.divide,
    ast.Pow: np.power,
    ast.USub: np.negative,
    ast.UAdd: np.positive,
}
_FUNCTIONS: dict[str, tuple[Callable[..., Any], int]] = {
    **{n: (getattr(np, n), 1) for n in ("sqrt", "exp", "log", "sin", "cos", "tan", "sign", "floor")},
    "abs": (np.abs, 1),
    "atan2": (np.arctan2, 2),
    "hypot": (np.hypot, 2),
    "min": (np.minimum, 2),
    "max": (np.maximum, 2),
    "clip": (np.clip, 3),
}
_NUMBERS = {"pi": np.pi}
_COLUMN = "column"  # column("any name") stands for a column whose name is no identifier


@dataclass(frozen=True)
class Formula:
    """An arithmetic expression in columns.

    Numbers, names of columns, ``+ - * / **``, parentheses, `column("a name")` and the functions above;
    anything else is refused.
    """

    text: str

    def __post_init__(self) -> None:
        _ = self.columns

    @cached_property
    def _tree(self) -> ast.expr:
        if len(self.text) > _LIMITS.characters:
            raise UndertowError(
                f"formula {self.text[:40]!r}... is longer than {_LIMITS.characters} characters: shorten it"
            )
        try:
            tree = ast.parse(self.text.strip(), mode="eval")
        except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
            reason = error.msg if isinstance(error, SyntaxError) else str(error)
            raise UndertowError(f"formula {self.text!r} is not arithmetic ({reason}): {_HOW}") from error
        if sum(1 for _ in ast.walk(tree)) > _LIMITS.parts:
            raise UndertowError(f"formula {self.text!r} has more than {_LIMITS.parts} parts: shorten it")
        return tree.body

    @cached_property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns in it."""
        found: dict[str, None] = {}
        self._walk(self._tree, lambda name: found.setdefault(name) or np.nan)
        return tuple(found)

    def of(self, cells: Mapping[str, Array]) -> Array:
        """Its values at cells, shape (n,) each; what has no value (a division by zero) is NaN or infinite."""
        with np.errstate(all="ignore"):
            values = self._walk(self._tree, lambda name: cells[name])
        shape = np.shape(next(iter(cells.values()), np.zeros(())))
        return np.array(np.broadcast_to(np.asarray(values, dtype=float), shape))

    def _walk(self, node: ast.expr, column: Callable[[str], Any]) -> Any:
        """Value of a part of the tree."""
        match node:
            case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
                return float(number)
            case ast.Name(id=name):
                return _NUMBERS[name] if name in _NUMBERS else column(name)
            case ast.UnaryOp(op=op, operand=inner) if type(op) in _OPERATIONS:
                return _OPERATIONS[type(op)](self._walk(inner, column))
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATIONS:
                return _OPERATIONS[type(op)](self._walk(left, column), self._walk(right, column))
            case ast.Call(func=ast.Name(id=name), args=[ast.Constant(value=str(text))], keywords=[]) if (
                name == _COLUMN
            ):
                return column(text)
            case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
                return self._function(name, len(arguments))(*(self._walk(a, column) for a in arguments))
        part = ast.unparse(node)
        raise UndertowError(f"formula {self.text!r} has {part!r}, which is not arithmetic: {_HOW}")

    def _function(self, name: str, count: int) -> Callable[..., Any]:
        if name not in _FUNCTIONS:
            hint = nearest(name, _FUNCTIONS)
            raise UndertowError(f"formula {self.text!r}: function {name!r} is not known{hint}: {_HOW}")
        function, wanted = _FUNCTIONS[name]
        if count != wanted:
            raise UndertowError(f"formula {self.text!r}: {name} takes {wanted} numbers, found {count}")
        return function


_HOW = (
    f"write numbers, columns (column('its name') if it is not a plain word), + - * / ** and "
    f"{', '.join(_FUNCTIONS)}"
)


# --- what formats of logs state in other ways: quaternions, latitudes and longitudes, pressures ---
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "day": 86400.0}
"""Seconds in the units of clocks, the likelier first."""


_ROUNDED = 1e-2  # how far the length of a quaternion may be from one


def has_unit_length(quaternions: Array) -> Flags:
    """Which of the columns, (4, n), are quaternions of length one but for rounding; NaN has no length."""
    return np.asarray(np.abs(np.linalg.norm(quaternions, axis=0) - 1.0) < _ROUNDED)


def angles(w: Array, x: Array, y: Array, z: Array) -> dict[str, Array]:
    """Roll, pitch and yaw, rad, of quaternions from body to earth axes (Fossen 2021, section 2.2).

    Quaternions may have any length; one of no length gives NaN.
    """
    square = w**2 + x**2 + y**2 + z**2
    length = np.where(square > 0.0, square, np.nan)
    phi = np.arctan2(2.0 * (w * x + y * z) / length, 1.0 - 2.0 * (x**2 + y**2) / length)
    theta = np.arcsin(np.clip(2.0 * (w * y - z * x) / length, -1.0, 1.0))
    psi = np.arctan2(2.0 * (w * z + x * y) / length, 1.0 - 2.0 * (y**2 + z**2) / length)
    return dict(zip(ANGLES, (phi, theta, psi), strict=True))


_RADIUS, _FLATTENING = 6_378_137.0, 1.0 / 298.257223563  # WGS 84: m at the equator


def north_east(latitude: Array, longitude: Array) -> tuple[Array, Array]:
    """Distances from the first fix on the plane that touches the ellipsoid there, m.

    Ten kilometres away they are wrong by some metres. Degrees are NaN where there is no fix.
    """
    there = np.flatnonzero(np.isfinite(latitude) & np.isfinite(longitude))
    if not len(there):
        return np.full(len(latitude), np.nan), np.full(len(latitude), np.nan)
    lat0, lon0 = latitude[there[0]], longitude[there[0]]
    north, east = metres_per_degree(lat0)
    return north * (latitude - lat0), east * ((longitude - lon0 + 180.0) % 360.0 - 180.0)


def metres_per_degree(latitude: float) -> tuple[float, float]:
    """Metres to the north in a degree of latitude, and to the east in one of longitude, at a latitude."""
    lat, square = np.radians(latitude), _FLATTENING * (2.0 - _FLATTENING)
    across = _RADIUS / np.sqrt(1.0 - square * np.sin(lat) ** 2)
    along = across * (1.0 - square) / (1.0 - square * np.sin(lat) ** 2)
    return float(np.radians(along)), float(np.radians(across * np.cos(lat)))


@dataclass(frozen=True)
class PressureSettings:
    """What a pressure is taken for where the log does not say; the note on a depth states it."""

    density: float = 1025.0  # of sea water, kg/m^3; in fresh water a depth is 2.5% more
    atmosphere: float = 101325.0  # standard, Pa


_PRESSURE = PressureSettings()


def depth(pascal: float, *, absolute: bool, down: float = 1.0) -> tuple[Column, str]:
    """Conversion of pressure to depth, and a note on it.

    `pascal` is Pa in one of its unit, `absolute` whether it has the air above the water in it, `down` 1 where
    z counts downwards in the log and -1 where it counts upwards.
    """
    metre = _PRESSURE.density * ENVIRONMENT.gravity
    above = _PRESSURE.atmosphere if absolute else 0.0
    column = Column(
        channel="z", unit="m", scale=down * pascal / metre, offset=-down * above / metre if above else 0.0
    )
    assumed = f"{_PRESSURE.density:g} kg/m^3 and {above:g} Pa at the surface"
    return column, f"{assumed}: for other water change `scale` in a mapping file"


# --- changes of a mapping file, in TOML -----------------------------------------------------------
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
    changed = column.times(changes.pop("times", 1.0)).model_copy(update=changes)
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
    return column_edit(mapping, channel, delay=f"{si_of(channel, given, 's') + more:.3g} s")


def reassigned(mapping: LogMapping, places: Mapping[str, tuple[str, float]]) -> Edits:
    """Assign columns of channels to others: channel to (channel that its column has now, sign).

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
        turned = column.times(signs[target])
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
    """State the three frames, except those that the mapping states already, or that are defaults.

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
    parts = [_toml_lines(tables.pop("", {}))]
    parts += [f"[{table}]\n{_toml_lines(content)}" for table, content in tables.items()]
    return "\n".join(part for part in parts if part).strip()


def read_edits(lines: str) -> Edits:
    """The changes in the lines of a finding: the inverse of `as_toml`."""
    content = tomllib.loads(lines)
    tables = {key: value for key, value in content.items() if isinstance(value, dict)}
    on_top = [Edit("", key, value) for key, value in content.items() if key not in tables]
    inside = [Edit(table, key, value) for table, own in tables.items() for key, value in own.items()]
    return (*on_top, *inside)


def _toml_lines(content: dict[str, Any]) -> str:
    return "\n".join(f"{tomlkit.key(k).as_string()} = {_toml_value(v)}" for k, v in content.items())


def _toml_value(value: Any) -> str:
    """One TOML value on one line."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{k} = {_toml_value(v)}" for k, v in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_toml_value(v) for v in value) + "]"
    if isinstance(value, float):
        return f"{value:.6g}" if "." in f"{value:.6g}" or "e" in f"{value:.6g}" else f"{value:.6g}.0"
    return str(tomlkit.item(value).as_string())


def into_file(text: str, edits: Iterable[Edit]) -> str:
    """The text of a mapping file with changes; comments and order are kept."""
    document = tomlkit.parse(text)
    for table, key, value in edits:
        place: Any = document.setdefault(table, tomlkit.table()) if table else document
        place[key] = tomlkit.value(_toml_value(value))
    return tomlkit.dumps(document)
