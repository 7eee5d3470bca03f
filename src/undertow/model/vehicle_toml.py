"""Reading the text of a vehicle or gain file: size, TOML, keys and types; nothing in it is executed."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError

from undertow.errors import UndertowError
from undertow.files import read_toml

from .catalogue import nearest
from .vehicle_schema import VehicleTable

Content = TypeVar("Content", bound=BaseModel)
_UNION_MEMBERS = ("ParameterTable", "float", "int", "str")
_NO_QUANTITY = ("float_type", "int_type", "string_type", "model_type", "float_parsing", "int_parsing")


def read_vehicle_table(path: Path) -> VehicleTable:
    """Read and validate a vehicle file.

    Raises
    ------
    UndertowError
        If the file cannot be read, is too large, is no TOML, or has unknown keys or wrong types.
    """
    return read_table(path, VehicleTable, "vehicle file")


def read_table(path: Path, model: type[Content], kind: str) -> Content:
    """Read a TOML file of a given kind and validate it.

    Parameters
    ----------
    path : Path
        The file.
    model : type of BaseModel
        What it has to hold.
    kind : str
        What it is called in messages, such as "vehicle file".

    Raises
    ------
    UndertowError
        If the file cannot be read, is too large, is no TOML, or has unknown keys or wrong types.
    """
    content = read_toml(path, kind)
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise UndertowError(f"{path}: {_first_complaint(error, model)}") from error


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
        return f"'{place}' = {found} is no quantity: write a number in SI or a text such as '1.5 kg'"
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
