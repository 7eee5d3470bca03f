"""Identification: from logs and a vehicle to estimates, comparisons and diagnoses.

Names are loaded on first use, so that importing the package costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from undertow.identification.logs import Mapping, Run, read_log, read_mapping, velocities_from_pose

__all__ = ["Mapping", "Run", "read_log", "read_mapping", "velocities_from_pose"]

_HOMES = dict.fromkeys(__all__, "undertow.identification.logs")


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
