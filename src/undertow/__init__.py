"""Undertow: shows where a model of a vehicle in water fails on real logs, and names the missing effect.

The public names are imported at first use, so that ``import undertow`` (and ``undertow --help``) stays quick.
A new public name is one line here for type checkers and editors, and one line in the table below.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from undertow.codegen.public import compile as compile
    from undertow.control.public import check_gains as check_gains
    from undertow.control.public import linearize as linearize
    from undertow.errors import UndertowError as UndertowError
    from undertow.identification.logs import Run as Run
    from undertow.identification.public import add_effect as add_effect
    from undertow.identification.public import diagnose as diagnose
    from undertow.identification.public import fit as fit
    from undertow.identification.public import read_log as read_log
    from undertow.model.catalogue import catalogue as catalogue
    from undertow.model.effect import Actuation as Actuation
    from undertow.model.effect import Flow as Flow
    from undertow.model.effect import Measurement as Measurement
    from undertow.model.effect import Wrench as Wrench
    from undertow.model.loading import load_vehicle as load_vehicle
    from undertow.model.parameter import Parameter as Parameter
    from undertow.model.vehicle import Vehicle as Vehicle

__version__ = "0.1.0"

_HOME_OF = {
    "Run": "undertow.identification.logs",
    "UndertowError": "undertow.errors",
    "Vehicle": "undertow.model.vehicle",
    "Actuation": "undertow.model.effect",
    "Flow": "undertow.model.effect",
    "Measurement": "undertow.model.effect",
    "Parameter": "undertow.model.parameter",
    "Wrench": "undertow.model.effect",
    "add_effect": "undertow.identification.public",
    "check_gains": "undertow.control.public",
    "compile": "undertow.codegen.public",
    "diagnose": "undertow.identification.public",
    "catalogue": "undertow.model.catalogue",
    "fit": "undertow.identification.public",
    "linearize": "undertow.control.public",
    "load_vehicle": "undertow.model.loading",
    "read_log": "undertow.identification.public",
}

__all__ = ["__version__", *_HOME_OF]


def __getattr__(name: str) -> Any:
    if name not in _HOME_OF:
        raise AttributeError(f"module 'undertow' has no attribute {name!r}")
    value = getattr(import_module(_HOME_OF[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
