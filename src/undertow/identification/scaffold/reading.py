"""Diagnoses as `undertow diagnose --json` writes them."""

from __future__ import annotations

import math
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
    if not _finite(diagnosis.model_dump()):
        raise UndertowError(f"'{path}' is no diagnosis (a number in it is infinite or none): {_HOW}")
    return diagnosis


def _finite(content: object) -> bool:
    """Whether every number in what a file holds is one; JSON has 1e400."""
    if isinstance(content, dict):
        return all(map(_finite, content.values()))
    if isinstance(content, list | tuple):
        return all(map(_finite, content))
    return not isinstance(content, float) or math.isfinite(content)
