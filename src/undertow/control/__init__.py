"""Control laws, conditions on their gains, closed loops and linear analysis.

The public names are imported at first use: python-control takes a second to import.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .linear.design import lqg as lqg
    from .linear.design import lqr as lqr
    from .linear.family import family as family
    from .linear.numeric import in_direction as in_direction
    from .linear.systems import as_controller as as_controller
    from .linear.systems import as_nlsys as as_nlsys
    from .linear.systems import close_loop as close_loop
    from .linear.systems import linearize as linearize
    from .linear.trim import Trim as Trim
    from .linear.trim import find_trim as find_trim
    from .plant import in_current as in_current

_HOME_OF = {
    "Trim": "linear.trim",
    "as_controller": "linear.systems",
    "as_nlsys": "linear.systems",
    "close_loop": "linear.systems",
    "family": "linear.family",
    "find_trim": "linear.trim",
    "in_current": "plant",
    "in_direction": "linear.numeric",
    "linearize": "linear.systems",
    "lqg": "linear.design",
    "lqr": "linear.design",
}

__all__ = [*_HOME_OF]


def __getattr__(name: str) -> Any:
    if name not in _HOME_OF:
        raise AttributeError(f"module 'undertow.control' has no attribute {name!r}")
    value = getattr(import_module(f"undertow.control.{_HOME_OF[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
