"""Diagnoses as `undertow diagnose --json` writes them."""

from __future__ import annotations

from pathlib import Path

from pydantic import ValidationError

from undertow.errors import UndertowError
from undertow.files import read_json

from ..diagnosis.result import SCHEMA, Diagnosis

_HOW = "give the file that 'undertow diagnose --json FILE' wrote"


def read_diagnosis(path: Path) -> Diagnosis:
    """Read a diagnosis.

    Raises
    ------
    UndertowError
        If the file cannot be read or is no diagnosis.
    """
    try:
        diagnosis = Diagnosis.model_validate_json(read_json(path, "diagnosis"))
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        why = f"{place}: {first['msg']}" if place else first["msg"]
        raise UndertowError(f"'{path}' is no diagnosis ({why}): {_HOW}") from error
    if diagnosis.schema_id != SCHEMA:
        raise UndertowError(f"'{path}' has the schema '{diagnosis.schema_id}', not '{SCHEMA}': {_HOW}")
    return diagnosis
