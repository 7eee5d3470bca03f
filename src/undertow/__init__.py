"""Undertow: shows where a model of a vehicle in water fails on real logs, and names the missing effect.

The public names are imported at first use, so that ``import undertow`` (and ``undertow --help``) stays quick.
A new public name is one line here for type checkers and editors, and one line in the table below.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from undertow.version import __version__

if TYPE_CHECKING:
    from undertow.codegen.simulate import compile as compile
    from undertow.control.api import check_gains as check_gains
    from undertow.control.api import linearize as linearize
    from undertow.errors import UndertowError as UndertowError
    from undertow.identification.api import add_effect as add_effect
    from undertow.identification.api import diagnose as diagnose
    from undertow.identification.api import fit as fit
    from undertow.identification.api import read_log as read_log
    from undertow.identification.logs.run import Run as Run
    from undertow.model.catalogue import catalogue as catalogue
    from undertow.model.effect import Actuation as Actuation
    from undertow.model.effect import Flow as Flow
    from undertow.model.effect import Measurement as Measurement
    from undertow.model.effect import Wrench as Wrench
    from undertow.model.loading import load_vehicle as load_vehicle
    from undertow.model.parameter import Parameter as Parameter
    from undertow.model.vehicle import Vehicle as Vehicle


_HOME_OF = {
    "Run": "undertow.identification.logs.run",
    "UndertowError": "undertow.errors",
    "Vehicle": "undertow.model.vehicle",
    "Actuation": "undertow.model.effect",
    "Flow": "undertow.model.effect",
    "Measurement": "undertow.model.effect",
    "Parameter": "undertow.model.parameter",
    "Wrench": "undertow.model.effect",
    "add_effect": "undertow.identification.api",
    "check_gains": "undertow.control.api",
    "compile": "undertow.codegen.simulate",
    "diagnose": "undertow.identification.api",
    "catalogue": "undertow.model.catalogue",
    "fit": "undertow.identification.api",
    "linearize": "undertow.control.api",
    "load_vehicle": "undertow.model.loading",
    "read_log": "undertow.identification.api",
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
