"""The vehicle file as pydantic sees it: unknown keys and wrong types are refused, with their place."""

from __future__ import annotations

import re
from typing import Annotated, Literal

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

from .symbols import DOFS

SCHEMA = "undertow/vehicle/1"
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

    def one_way(self, way: str) -> ParameterTable:
        """What the table says about the value `forward` or `backward`; its sigma may be its own."""
        own = getattr(self, f"sigma_{way}")
        return self.model_copy(update={"sigma": self.sigma if own is None else own})


class ThrusterTable(FileTable):
    """A thruster: where it is and which way it pushes, or its wrench per newton."""

    name: Identifier
    position: tuple[Quantity, Quantity, Quantity] | None = None
    direction: tuple[StrictFloat | StrictInt, StrictFloat | StrictInt, StrictFloat | StrictInt] | None = None
    wrench: Annotated[list[StrictFloat | StrictInt], Field(min_length=6, max_length=6)] | None = None
    thrust_per_command: Quantity | ParameterTable = 1.0
    limit: Quantity | None = None
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
    history: list[dict[str, object]] = []
