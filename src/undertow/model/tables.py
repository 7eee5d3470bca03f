"""Tables of vehicle files: reading them, the values that they state, thrusters and surfaces made of them."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    StrictBool,
    StrictFloat,
    StrictInt,
    StrictStr,
    ValidationError,
)

from undertow.errors import UndertowError, nearest
from undertow.files import files_beside, read_toml

from .effect import ACTUATORS, Curve, Law, Propeller, Surface
from .parameter import Parameter, printed
from .symbols import DOFS, ENVIRONMENT
from .units import PULSES, si_of
from .vehicle import Thruster, Value

Quantity = StrictFloat | StrictInt | StrictStr
_IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,39}")


def _identifier(name: object) -> object:
    if not isinstance(name, str) or not _IDENTIFIER.fullmatch(name):
        raise ValueError("a name must be a letter, then up to 39 letters, digits or underscores")
    return name


def _printable(text: object) -> object:
    if isinstance(text, str) and not text.isprintable():
        raise ValueError("a name must be printable, without line breaks and control characters")
    return text


Identifier = Annotated[StrictStr, BeforeValidator(_identifier)]
Printable = Annotated[StrictStr, BeforeValidator(_printable)]


class FileTable(BaseModel):
    """A table of the file; unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class ParameterTable(FileTable):
    """A parameter with its value, uncertainty and source."""

    value: Quantity | None = None
    forward: Quantity | None = None
    backward: Quantity | None = None
    estimate: StrictBool = False
    sigma: Quantity | None = None
    sigma_forward: Quantity | None = None
    sigma_backward: Quantity | None = None
    source: StrictStr = ""
    assumed: StrictBool = False
    allow_sign: StrictBool = False
    override: StrictBool = False
    per_run: StrictBool | None = None

    def one_way(self, way: str) -> ParameterTable:
        """What the table says about the value `forward` or `backward`; its sigma may be its own."""
        own = getattr(self, f"sigma_{way}")
        return self.model_copy(update={"sigma": self.sigma if own is None else own})


class PropellerTable(FileTable):
    """A propeller whose command is its speed of revolution."""

    diameter: Quantity
    K_T0: Quantity | ParameterTable
    K_T1: Quantity | ParameterTable = 0.0
    wake_fraction: Quantity | ParameterTable | None = None
    thrust_deduction: Quantity | ParameterTable | None = None
    revolutions: Literal["rad/s", "rev/s", "rpm"] = "rad/s"


class ThrusterTable(FileTable):
    """A thruster: where it is and which way it pushes, or its wrench per newton."""

    name: Identifier
    position: tuple[Quantity, Quantity, Quantity] | None = None
    direction: tuple[StrictFloat | StrictInt, StrictFloat | StrictInt, StrictFloat | StrictInt] | None = None
    wrench: Annotated[list[StrictFloat | StrictInt], Field(min_length=6, max_length=6)] | None = None
    thrust_per_command: Quantity | ParameterTable = 1.0
    curve: StrictStr | list[StrictFloat | StrictInt] | None = None
    propeller: PropellerTable | None = None
    limit: Quantity | None = None
    lowest: Quantity | None = None
    source: StrictStr = ""


class SurfaceTable(FileTable):
    """A rudder, a fin or a plane: position, axis and force."""

    name: Identifier
    position: tuple[Quantity, Quantity, Quantity]
    axis: StrictStr | tuple[StrictFloat | StrictInt, StrictFloat | StrictInt, StrictFloat | StrictInt]
    area: Quantity
    aspect_ratio: Quantity | None = None
    lift_coefficient: Quantity | ParameterTable | None = None
    drag_coefficient: Quantity | ParameterTable | None = None
    limit: Quantity | None = None
    rate: Quantity | ParameterTable | None = None
    lag: Quantity | ParameterTable | None = None
    slipstream_of: Identifier | None = None
    propeller_diameter: Quantity | None = None
    in_slipstream: Quantity | ParameterTable | None = None
    slipstream: Quantity | ParameterTable | None = None
    wake: Quantity | ParameterTable | None = None
    straightening: Quantity | ParameterTable | None = None
    flow_lever: Quantity | ParameterTable | None = None
    a_H: Quantity | ParameterTable | None = None
    x_H: Quantity | ParameterTable | None = None
    t_R: Quantity | ParameterTable | None = None
    source: StrictStr = ""


class VehicleTable(FileTable):
    """The whole file."""

    schema_: Annotated[Literal["undertow/vehicle/1"], Field(alias="schema")]
    name: Annotated[Printable, Field(min_length=1, max_length=80)]
    description: StrictStr = ""
    source: StrictStr = ""
    degrees_of_freedom: Annotated[list[Literal[DOFS]], Field(min_length=1)]  # type: ignore[valid-type]
    signs: Literal["sname", "magnitudes"]
    water_density: Quantity = ENVIRONMENT.density
    gravity: Quantity = ENVIRONMENT.gravity
    effects_from: list[StrictStr] = []
    generalised_forces: list[Literal["tau_X", "tau_Y", "tau_Z", "tau_K", "tau_M", "tau_N"]] = []
    effects: dict[str, dict[str, Quantity | ParameterTable]]
    thrusters: list[ThrusterTable] = []
    surfaces: list[SurfaceTable] = []
    inputs: list[Identifier] = []
    excluded_effects: list[Identifier] = []
    history: list[dict[str, object]] = []


# --- values of parameters -------------------------------------------------------------------------
def as_table(entry: Any) -> ParameterTable:
    return entry if isinstance(entry, ParameterTable) else ParameterTable(value=entry)


def parameter_values(place: str, parameter: Parameter, entry: Any, signs: str) -> dict[str, Value]:
    table = as_table(entry)
    given = {k: getattr(table, k) for k in ("value", "forward", "backward") if getattr(table, k) is not None}
    _refuse_idle_sigmas(f"{place} {parameter.name}", table, len(given))
    if set(given) == {"value"}:
        return {parameter.name: _value(place, parameter, parameter.name, given["value"], table, signs)}
    if set(given) != {"forward", "backward"}:
        raise UndertowError(
            f"{place} {parameter.name} needs either 'value' or both 'forward' and 'backward', "
            f"found {' and '.join(given) or 'none'}"
        )
    if parameter.motion is None:
        raise UndertowError(f"{place} {parameter.name} cannot differ forward and backward: give one value")
    values = {}
    for way, raw in given.items():
        name = f"{parameter.name}_{way}"
        values[name] = _value(place, parameter, name, raw, table.one_way(way), signs)
    return values


def _refuse_idle_sigmas(place: str, table: ParameterTable, values: int) -> None:
    """Refuse a standard deviation without effect, or of a missing value."""
    own = [s for s in (table.sigma_forward, table.sigma_backward) if s is not None]
    if own and (values < 2 or (len(own) == 2 and table.sigma is not None)):
        raise UndertowError(
            f"{place} has a sigma that holds for nothing: give 'sigma', or with 'forward' and 'backward' "
            f"'sigma_forward' and 'sigma_backward'"
        )


def _value(owner: str, parameter: Parameter, name: str, raw: Any, table: ParameterTable, signs: str) -> Value:
    place = f"{owner} {name}"
    stated = si_of(place, raw, parameter.unit)
    sigma = None if table.sigma is None else positive(f"{place} sigma", table.sigma, parameter.unit)
    number = printed(parameter, stated, signs)
    _check_bounds(place, parameter, number, stated, table, signs)
    return Value(number, table.estimate, sigma, table.source, table.assumed, table.per_run)


def _check_bounds(
    place: str, parameter: Parameter, number: float, stated: float, table: ParameterTable, signs: str
) -> None:
    low, high = parameter.bounds
    if low <= number <= high:
        return
    one_sided = 0.0 in (low, high)
    if one_sided and table.allow_sign:
        return
    limit = f"{low:g} to {high:g} {parameter.unit} in SNAME signs"
    remedy = "correct the value"
    if one_sided:
        other = "magnitudes" if signs == "sname" else "sname"
        remedy = (
            f'correct the sign, write signs = "{other}" if the whole file is meant so, or allow_sign = true'
        )
    raise UndertowError(
        f'{place} = {stated:g} is impossible under signs = "{signs}" (possible: {limit}); {remedy}'
    )


def positive(place: str, raw: Any, unit: str) -> float:
    value = si_of(place, raw, unit)
    if value <= 0:
        raise UndertowError(f"{place} = {value:g} is impossible: give a positive number")
    return value


# --- thrusters and control surfaces ---------------------------------------------------------------
def thruster_of(table: ThrusterTable, folder: Path) -> Thruster:
    place = f"thruster '{table.name}'"
    if {table.position is not None, table.direction is not None} != {table.wrench is None}:
        raise UndertowError(f"{place} needs either 'wrench' or 'position' and 'direction', not both")
    position, wrench = None, _numbers(f"{place} wrench", table.wrench)
    if table.position is not None:
        x, y, z = (si_of(f"{place} position", v, "m") for v in table.position)
        position, wrench = (x, y, z), _wrench_at(place, (x, y, z), table)
    if not any(wrench):
        raise UndertowError(f"{place} wrench is zero: give the force and moment of one newton of thrust")
    law, unit, normalised_by = _thrust_law(place, table, folder)
    limit = _limit(place, table.limit)
    if normalised_by is not None and limit is not None and limit > _CURVES.beyond:
        neutral, span = normalised_by
        raise UndertowError(
            f"{place} limit = {limit:g} is not normalised, as the commands of its curve are: "
            f"{neutral:g} in its file is 0, and {neutral + span:g} is 1; give {(limit - neutral) / span:.4g}"
        )
    lowest = _lowest_command(place, table.lowest, limit)
    push = _thrust_per_command(place, table)
    return Thruster(table.name, wrench, push, limit, lowest, law, unit, position, normalised_by)


# Revolutions per second of one unit of the speed of a propeller, by name.
TURNS = {"rad/s": 1 / (2 * math.pi), "rev/s": 1.0, "rpm": 1 / 60}
PROPELLER_KEYS = ("K_T0", "K_T1", "wake_fraction", "thrust_deduction")


def _thrust_law(
    place: str, table: ThrusterTable, folder: Path
) -> tuple[Law, str, tuple[float, float] | None]:
    """How the command becomes thrust, the command's unit, and by what it is normalised (see `Thruster`)."""
    stated = {"curve", "propeller", "thrust_per_command"} & table.model_fields_set
    if "propeller" in stated and len(stated) > 1:
        raise UndertowError(
            f"{place} states its push in several ways, {' and '.join(sorted(stated))}: keep one"
        )
    if table.propeller is not None:
        unit = table.propeller.revolutions
        return (
            Propeller(positive(f"{place} diameter", table.propeller.diameter, "m"), TURNS[unit]),
            unit,
            None,
        )
    if isinstance(table.curve, str):
        ours = bundled_curves().get(table.curve)
        error = _CURVES.bundled if ours else _CURVES.error
        points, normalised_by = _normalised(_points(place, ours or folder / table.curve, error))
        return Curve.through(points), "command", normalised_by
    if table.curve is not None:
        limit = _limit(place, table.limit)
        if limit is None or not table.curve:
            raise UndertowError(f"{place}: a polynomial curve needs a 'limit' up to which it is valid")
        return Curve.polynomial([float(c) for c in table.curve], limit), "command", None
    return None, "command", None


@dataclass(frozen=True)
class CurveSettings:
    """How many points of a bench test a curve keeps: every one costs time in every step of a simulation."""

    error: float = 0.003  # largest error, as a share of the span of the thrust; bench tests repeat to 1%
    points: int = 40  # most points
    # The same error for curves that come with undertow: one T200 differs from the next by more, and each
    # point of its eight thrusters costs a tenth of a second whenever the vehicle is loaded.
    bundled: float = 0.0075
    # Largest thrust at the neutral command, as a share of that of the curve from end to end; and distance of
    # that command from zero, as a share of the span, up to which it is an offset of the bench.
    neutral: float = 0.01
    offset: float = 0.1
    beyond: float = 1.5  # normalised command that no limit allows
    longest_span: float = 700.0  # of pulses, us: some controllers take more than 1100 to 1900


_CURVES = CurveSettings()

Point = tuple[float, float]


@cache
def bundled_curves() -> dict[str, Path]:
    """Bundled thruster curves, by name; their command goes from -1 to 1."""
    folder = Path(str(files("undertow") / "vehicles" / "curves"))
    return {path.stem: path for path in sorted(folder.glob("*.csv"))}


def _points(place: str, path: Path, largest_error: float) -> list[Point]:
    """Commands and thrusts, N, of a file with two columns, reduced to as few as needed."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        ours = ", ".join(bundled_curves())
        raise UndertowError(
            f"{place}: curve '{path}' cannot be read: {error}; bundled curves: {ours}"
        ) from error
    rows = [re.split(r"[,;\s]+", line.strip()) for line in text.splitlines() if line.strip()]
    found = [(float(r[0]), float(r[1])) for r in rows if len(r) > 1 and _is_number(r[0]) and _is_number(r[1])]
    if len(found) < 2 or len(found) < len(rows) - 1 - sum(r[0].startswith("#") for r in rows):
        raise UndertowError(f"{place}: curve '{path}' needs two columns of numbers, command and thrust in N")
    found = found[::-1] if found[-1][0] < found[0][0] else found
    if any(b[0] <= a[0] for a, b in pairwise(found)):
        raise UndertowError(
            f"{place}: commands of curve '{path}' neither rise nor fall from row to row: sort them"
        )
    return _reduced(found, largest_error)


def _normalised(points: list[Point]) -> tuple[list[Point], tuple[float, float] | None]:
    """Points with normalised commands, and neutral and span of the file; as they are where neutral is 0.

    Effects of a command's size or direction, and simulations without one, take zero as neutral.
    """
    (low, _), (high, _) = points[0], points[-1]
    most = max(y for _, y in points) - min(y for _, y in points)
    idle = [x for x, y in points if abs(y) <= _CURVES.neutral * most]
    crossed = [a[0] - a[1] * (b[0] - a[0]) / (b[1] - a[1]) for a, b in pairwise(points) if a[1] * b[1] < 0.0]
    idle = idle or crossed
    if not idle or min(idle) <= 0.0 <= max(idle):
        return points, None
    ends = [end for end in (low, high) if end in idle]
    neutral = ends[0] if ends else (min(idle) + max(idle)) / 2
    span = max(high - neutral, neutral - low)
    if not ends and min(idle) <= PULSES.neutral <= max(idle) and high - low <= 2 * _CURVES.longest_span:
        neutral, span = PULSES.neutral, PULSES.span
    if abs(neutral) <= _CURVES.offset * span:
        return points, None
    return [((x - neutral) / span, y) for x, y in points], (neutral, span)


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def _reduced(points: list[Point], largest_error: float) -> list[Point]:
    """Points without those that the curve through the others reproduces."""
    span = max(y for _, y in points) - min(y for _, y in points)
    kept = {0, len(points) - 1}
    while len(kept) < min(_CURVES.points, len(points)):
        curve = Curve.through([points[k] for k in sorted(kept)])
        errors = [abs(curve.at(x) - y) for x, y in points]
        worst = max(range(len(points)), key=errors.__getitem__)
        if errors[worst] <= largest_error * span:
            break
        kept.add(worst)
    return [points[k] for k in sorted(kept)]


def propeller_values(
    table: ThrusterTable, parameters: Mapping[str, Parameter], signs: str
) -> dict[str, Value]:
    """Parameters that the table of a propeller states, by name."""
    entries = {f"{key}_{table.name}": getattr(table.propeller, key, None) for key in PROPELLER_KEYS}
    return _values(f"propeller of thruster '{table.name}'", entries, table.source, parameters, signs)


def _values(
    place: str, entries: Mapping[str, Any], source: str, parameters: Mapping[str, Parameter], signs: str
) -> dict[str, Value]:
    """Parameters that the entries of a table state, by name; `source` is that of entries without one."""
    found: dict[str, Value] = {}
    for name, entry in entries.items():
        if entry is not None:
            stated = as_table(entry)
            stated = stated if stated.source else stated.model_copy(update={"source": source})
            found |= parameter_values(place, parameters[name], stated, signs)
    return found


def _thrust_per_command(place: str, table: ThrusterTable) -> Value:
    place = f"{place} thrust_per_command"
    spec = as_table(table.thrust_per_command)
    if spec.value is None:
        raise UndertowError(f"{place} needs a 'value'")
    value = si_of(place, spec.value, "N/command")
    if value < 0:  # none at rest is right for a rudder or a fin: what it gives is rudder_force
        raise UndertowError(
            f"{place} = {value:g} N is not a thrust: give a positive one and reverse the direction"
        )
    sigma = None if spec.sigma is None else positive(f"{place} sigma", spec.sigma, "N/command")
    return Value(value, spec.estimate, sigma, spec.source, spec.assumed, spec.per_run)


def _limit(place: str, limit: Any) -> float | None:
    if limit is None:
        return None
    # Where the command is the thrust itself, its limit is naturally written in N.
    return positive(f"{place} limit", limit, _limit_unit(limit))


def _lowest_command(place: str, lowest: Any, limit: float | None) -> float | None:
    """The lowest command, which may be zero where nothing is given in reverse."""
    if lowest is None:
        return None
    value = si_of(f"{place} lowest", lowest, _limit_unit(lowest))
    least = -math.inf if limit is None else -limit
    if not least <= value <= 0.0:
        raise UndertowError(
            f"{place} lowest = {value:g} is not between {least:g} and 0: give 0 for one that cannot reverse"
        )
    return value


def _limit_unit(limit: Any) -> str:
    return "N" if isinstance(limit, str) and "N" in limit else "command"


def _numbers(place: str, entries: Iterable[Any] | None) -> tuple[float, ...]:
    return tuple(si_of(place, entry, "1") for entry in entries or ())


def _wrench_at(place: str, position: tuple[float, float, float], table: ThrusterTable) -> tuple[float, ...]:
    assert table.direction is not None
    x, y, z = position
    a, b, c = _numbers(f"{place} direction", table.direction)
    length = math.hypot(a, b, c)
    if abs(length - 1) > ACTUATORS.unit_error:
        raise UndertowError(f"{place}: direction has length {length:g}; give a unit vector")
    return (a, b, c, y * c - z * b, z * a - x * c, x * b - y * a)


# --- control surfaces -----------------------------------------------------------------------------
# Keys of a surface's table that state a parameter, and the parameter's name without that of the surface.
_IN_THE_FLOW = ("wake", "straightening", "flow_lever", "in_slipstream", "slipstream", "a_H", "x_H", "t_R")
SURFACE_KEYS = {"lift_coefficient": "C_N", "drag_coefficient": "C_D"}
SURFACE_KEYS |= {key: key for key in (*_IN_THE_FLOW, "lag", "rate")}
# By name: a rudder turns the bow of a vehicle that goes ahead to starboard, a stern plane brings it down.
_AXES = {"rudder": (0.0, 0.0, -1.0), "stern_plane": (0.0, 1.0, 0.0)}


def surface_of(table: SurfaceTable, thrusters: Iterable[str]) -> Surface:
    """The hardware that a table describes."""
    place = f"surface '{table.name}'"
    x, y, z = (si_of(f"{place} position", v, "m") for v in table.position)
    return Surface(
        table.name,
        (x, y, z),
        _axis(place, table.axis),
        positive(f"{place} area", table.area, "m^2"),
        None if table.limit is None else positive(f"{place} limit", table.limit, "rad"),
        *_propeller(place, table, list(thrusters)),
    )


def _axis(place: str, stated: Any) -> tuple[float, float, float]:
    if isinstance(stated, str):
        if stated not in _AXES:
            raise UndertowError(
                f"{place}: axis '{stated}' is not known: give {', '.join(_AXES)} or a unit vector"
            )
        return _AXES[stated]
    a, b, c = _numbers(f"{place} axis", stated)
    length = math.hypot(b, c)
    if abs(a) > ACTUATORS.unit_error or abs(length - 1) > ACTUATORS.unit_error:
        raise UndertowError(
            f"{place}: axis is {[a, b, c]}: give a unit vector across the x axis, as [0, 0, -1]"
        )
    return (0.0, b / length, c / length)


def _propeller(place: str, table: SurfaceTable, thrusters: list[str]) -> tuple[str, float]:
    """Name and diameter of the propeller ahead of a surface."""
    if (table.slipstream_of is None) != (table.propeller_diameter is None):
        raise UndertowError(f"{place} needs both 'slipstream_of' and 'propeller_diameter', or neither")
    if table.slipstream_of is None:
        return "", 0.0
    if table.slipstream_of not in thrusters:
        have = ", ".join(thrusters) or "none"
        raise UndertowError(
            f"{place} is in the slipstream of '{table.slipstream_of}': the thrusters are {have}"
        )
    return table.slipstream_of, positive(f"{place} propeller_diameter", table.propeller_diameter, "m")


def surface_values(table: SurfaceTable, parameters: Mapping[str, Parameter], signs: str) -> dict[str, Value]:
    """Parameters that a surface's table states, by name; `parameters` are all those of surfaces, by name."""
    place = f"surface '{table.name}'"
    entries = {
        f"{name}_{table.name}": _lift(place, table) if key == "lift_coefficient" else getattr(table, key)
        for key, name in SURFACE_KEYS.items()
    }
    return _values(place, entries, table.source, parameters, signs)


def _lift(place: str, table: SurfaceTable) -> Any:
    """Coefficient of the force across the chord, as stated or by the aspect ratio."""
    if table.lift_coefficient is not None:
        return table.lift_coefficient
    if table.aspect_ratio is None:
        raise UndertowError(f"{place} needs 'lift_coefficient' or 'aspect_ratio' (span over chord)")
    ratio = positive(f"{place} aspect_ratio", table.aspect_ratio, "1")
    source = f"6.13 A/(A + 2.25) for the aspect ratio A = {ratio:g}, Fujii; Yasukawa and Yoshimura (2015)"
    return ParameterTable(value=6.13 * ratio / (ratio + 2.25), source=source)


# --- files of tables, and what is wrong with them -------------------------------------------------
Content = TypeVar("Content", bound=BaseModel)


_UNION_MEMBERS = ("ParameterTable", "float", "int", "str")


_NO_QUANTITY = ("float_type", "int_type", "string_type", "model_type", "float_parsing", "int_parsing")


def read_table(path: str | Path, model: type[Content], kind: str) -> Content:
    """Read a TOML file of a given kind and validate it."""
    return validated(read_toml(path, kind), model, str(path))


def validated(content: Mapping[str, Any], model: type[Content], file: str) -> Content:
    """The content of a TOML file as its model; `file` is what errors call it."""
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise UndertowError(f"{file}: {_first_complaint(error, model)}") from error


def _first_complaint(error: ValidationError, model: type[BaseModel]) -> str:
    """One line for what pydantic found first, with the nearest known key."""
    # Members of a union complain each for itself; a key that is too much is the more telling complaint.
    complaints = sorted(error.errors(include_url=False), key=lambda e: e["type"] != "extra_forbidden")
    first = complaints[0]
    place, kind, found = _location(first["loc"]), first["type"], _shown(first["input"])
    if kind == "extra_forbidden":
        keys = _keys_at(first["loc"], model)
        hint = nearest(str(first["loc"][-1]), keys)
        return f"key '{place}' is not known{hint}; known are {', '.join(keys)}"
    if kind == "missing":
        return f"'{place}' is missing: add it"
    if kind in _NO_QUANTITY and any(str(part) in _UNION_MEMBERS for part in first["loc"]):
        return f"'{place}' = {found} is not a quantity: write a number in SI or a text such as '1.5 kg'"
    expected = str(first.get("ctx", {}).get("expected", ""))
    hint = nearest(str(first["input"]), re.findall(r"'([^']*)'", expected))
    return f"'{place}': {first['msg'].removeprefix('Value error, ')}, found {found}{hint}"


def _location(loc: tuple[int | str, ...]) -> str:
    parts = [f"#{p + 1}" if isinstance(p, int) else p for p in loc if p not in _UNION_MEMBERS]
    return ".".join(parts).replace("schema_", "schema")


def _keys_at(loc: tuple[int | str, ...], table: type[BaseModel]) -> list[str]:
    """Keys that the table may have in which something is too much."""
    for part in loc[:-1]:
        fields = {f.alias or name: f.annotation for name, f in table.model_fields.items()}
        table = next(_tables_in(fields.get(str(part))), table)
    return [f.alias or name for name, f in table.model_fields.items()]


def _tables_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """Tables that a type is made of, such as the one in a list of tables."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from _tables_in(inner)


def _shown(value: object) -> str:
    try:
        text = repr(value)
    except (RecursionError, ValueError):  # deeply nested, or an integer of thousands of digits
        text = f"a {type(value).__name__}"
    return text if len(text) <= 60 else f"{text[:60]}..."


def file_or_bundled(source: str | Path, bundled: Mapping[str, Path], otherwise: str) -> Path:
    """A file, or a bundled one by its name; `otherwise` says what is wrong with any other source."""
    path = Path(str(source))
    if is_file(path):
        return path
    if str(source) in bundled:
        return bundled[str(source)]
    beside = [name for name in files_beside(path) if name.endswith(".toml")]
    known = ", ".join(bundled) or "none"
    raise UndertowError(f"{otherwise}{nearest(path.name, [*bundled, *beside])}; bundled are {known}")


def is_file(path: Path) -> bool:
    """Whether there is such a file; False for impossible file names."""
    try:
        return path.is_file()
    except (OSError, ValueError):  # a name that is too long for the system, or unreadable folders on the way
        return False
