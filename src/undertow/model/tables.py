"""Tables of a vehicle file, the values of parameters that they state, and how files of tables are read."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
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
from undertow.files import read_toml

from .parameter import Parameter, printed
from .symbols import DOFS
from .units import si_of
from .vehicle import Value

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
    """A table of the file; keys that it does not know are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class ParameterTable(FileTable):
    """A parameter with what is known of it."""

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
    source: StrictStr = ""


class SurfaceTable(FileTable):
    """A rudder, a fin or a plane: where it is, how it turns, and what it gives."""

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
    water_density: Quantity = 1000.0
    gravity: Quantity = 9.81
    effects_from: list[StrictStr] = []
    generalised_forces: list[Literal["tau_X", "tau_Y", "tau_Z", "tau_K", "tau_M", "tau_N"]] = []
    effects: dict[str, dict[str, Quantity | ParameterTable]]
    thrusters: list[ThrusterTable] = []
    surfaces: list[SurfaceTable] = []
    inputs: list[Identifier] = []
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
    return {
        f"{parameter.name}_{way}": _value(
            place, parameter, f"{parameter.name}_{way}", raw, table.one_way(way), signs
        )
        for way, raw in given.items()
    }


def _refuse_idle_sigmas(place: str, table: ParameterTable, values: int) -> None:
    """A standard deviation that another one makes idle, or that belongs to a value that is not there."""
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


# --- reading files --------------------------------------------------------------------------------
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
    place, kind, found = _place(first["loc"]), first["type"], _shown(first["input"])
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


def _place(loc: tuple[int | str, ...]) -> str:
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
    path = Path(source)
    if is_file(path):
        return path
    if str(source) in bundled:
        return bundled[str(source)]
    known = ", ".join(bundled) or "none"
    raise UndertowError(f"{otherwise}{nearest(str(source), bundled)}; bundled are {known}")


def is_file(path: Path) -> bool:
    """Whether there is such a file; no for what no file can be called."""
    try:
        return path.is_file()
    except (OSError, ValueError):  # a name that is too long for the system, or unreadable folders on the way
        return False
