"""Reading the text of a vehicle file: size, TOML, keys and types; nothing in it is executed."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from undertow.errors import UndertowError

from .catalogue import nearest
from .vehicle_schema import ParameterTable, ThrusterTable, VehicleTable

_LARGEST_FILE = 2_000_000
# tomllib needs memory in the square of the number of parts of a dotted key; no honest file comes near.
_MOST_DOTS_SQUARED = 2_000_000
_DECIMAL = re.compile(r"(?<![\w.-])[+-]?\d+\.\d+(?:[eE][+-]?\d+)?(?![\w.])")
_UNION_MEMBERS = ("ParameterTable", "float", "int", "str")
_NO_QUANTITY = ("float_type", "int_type", "string_type", "model_type", "float_parsing", "int_parsing")


def read_vehicle_table(path: Path) -> VehicleTable:
    """Read and validate a vehicle file.

    Raises
    ------
    UndertowError
        If the file cannot be read, is too large, is no TOML, or has unknown keys or wrong types.
    """
    try:
        content = tomllib.loads(_text(path))
    except RecursionError as error:
        raise UndertowError(f"{path}: values are nested too deeply for a vehicle file") from error
    except ValueError as error:  # TOMLDecodeError, UnicodeDecodeError, integers of thousands of digits
        raise UndertowError(f"{path}: not valid TOML: {error}") from error
    try:
        return VehicleTable.model_validate(content)
    except ValidationError as error:
        raise UndertowError(f"{path}: {_first_complaint(error)}") from error


def _text(path: Path) -> str:
    try:
        size = path.stat().st_size
        if size > _LARGEST_FILE:
            raise UndertowError(
                f"{path}: {size} bytes are too many for a vehicle file (limit {_LARGEST_FILE})"
            )
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise UndertowError(f"{path}: cannot be read: {error.strerror}") from error
    if sum(line.count(".") ** 2 for line in _DECIMAL.sub("0", text).splitlines()) > _MOST_DOTS_SQUARED:
        raise UndertowError(f"{path}: keys with so many dots are no part of a vehicle file")
    return text


def _first_complaint(error: ValidationError) -> str:
    """One line for what pydantic found first, with the nearest known key."""
    # Members of a union complain each for itself; a key that is too much is the more telling complaint.
    complaints = sorted(error.errors(include_url=False), key=lambda e: e["type"] != "extra_forbidden")
    first = complaints[0]
    place, kind, found = _place(first["loc"]), first["type"], _shown(first["input"])
    if kind == "extra_forbidden":
        keys = _keys_at(first["loc"])
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


def _keys_at(loc: tuple[int | str, ...]) -> list[str]:
    """Keys that the table may have in which something is too much."""
    table: Any = VehicleTable
    if "ParameterTable" in loc:
        table = ParameterTable
    elif loc[0] == "thrusters":
        table = ThrusterTable
    return [f.alias or name for name, f in table.model_fields.items()]


def _shown(value: object) -> str:
    try:
        text = repr(value)
    except (RecursionError, ValueError):  # deeply nested, or an integer of thousands of digits
        text = f"a {type(value).__name__}"
    return text if len(text) <= 60 else f"{text[:60]}..."
