"""The tables of a vehicle file, and the values of parameters that they state."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    StrictBool,
    StrictFloat,
    StrictInt,
    StrictStr,
)

from undertow.errors import UndertowError

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
