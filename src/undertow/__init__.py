"""Undertow: shows where a model of a vehicle in water fails on real logs, and names the missing effect.

The public names are imported at first use, so that ``import undertow`` (and ``undertow --help``) stays quick.
A new public name is one line here for type checkers and editors, and one line in the table below.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from undertow.codegen.public import compile_vehicle as compile  # noqa: F401
    from undertow.control.public import check_gains as check_gains
    from undertow.control.public import linearize as linearize
    from undertow.errors import UndertowError as UndertowError
    from undertow.identification.logs import Run as Run
    from undertow.identification.public import add_effect as add_effect
    from undertow.identification.public import diagnose as diagnose
    from undertow.identification.public import fit as fit
    from undertow.identification.public import read_log as read_log
    from undertow.model.catalogue import catalogue as effects  # noqa: F401
    from undertow.model.effect import Actuation as Actuation
    from undertow.model.effect import Flow as Flow
    from undertow.model.effect import Measurement as Measurement
    from undertow.model.effect import Wrench as Wrench
    from undertow.model.loading import load_vehicle as load_vehicle
    from undertow.model.parameter import Parameter as Parameter
    from undertow.model.vehicle import Vehicle as Vehicle

__version__ = "0.1.0"

# Where each name stands, and what it is called there.
_HOME_OF = {
    "Run": "undertow.identification.logs:Run",
    "UndertowError": "undertow.errors:UndertowError",
    "Vehicle": "undertow.model.vehicle:Vehicle",
    "Actuation": "undertow.model.effect:Actuation",
    "Flow": "undertow.model.effect:Flow",
    "Measurement": "undertow.model.effect:Measurement",
    "Parameter": "undertow.model.parameter:Parameter",
    "Wrench": "undertow.model.effect:Wrench",
    "add_effect": "undertow.identification.public:add_effect",
    "check_gains": "undertow.control.public:check_gains",
    "compile": "undertow.codegen.public:compile_vehicle",
    "diagnose": "undertow.identification.public:diagnose",
    "effects": "undertow.model.catalogue:catalogue",
    "fit": "undertow.identification.public:fit",
    "linearize": "undertow.control.public:linearize",
    "load_vehicle": "undertow.model.loading:load_vehicle",
    "read_log": "undertow.identification.public:read_log",
}

__all__ = ["__version__", *_HOME_OF]


def __getattr__(name: str) -> Any:
    if name not in _HOME_OF:
        raise AttributeError(f"module 'undertow' has no attribute {name!r}")
    module, _, own_name = _HOME_OF[name].partition(":")
    value = getattr(import_module(module), own_name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
