"""Undertow: shows where a model of a vehicle in water fails on real logs, and names the missing effect.

The public names are imported at first use, so that ``import undertow`` (and ``undertow --help``) stays quick.
A new public name is one line here for type checkers and editors, and one line in the table below.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from undertow.errors import UndertowError as UndertowError

__version__ = "0.1.0"

_HOME_OF = {
    "UndertowError": "undertow.errors",
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
