"""What is asked of a trim: which values are held, and which are found."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from math import isfinite

from undertow.errors import UndertowError
from undertow.model.catalogue import nearest
from undertow.model.symbols import FASTEST, VELOCITY
from undertow.model.vehicle import Vehicle

_HOVER = {"u": 0.0, "v": 0.0, "w": 0.0, "r": 0.0}
_FREE = ("r", "w", "z")
_PLACE = ("x", "y")
_FARTHEST = 1e6


@dataclass(frozen=True)
class Request:
    """What is asked of a trim.

    Attributes
    ----------
    held : mapping
        Values of states and commands that are given, by name.
    given : tuple of str
        Names of those that the caller stated.
    climbs : bool
        Whether depth may change.
    """

    held: Mapping[str, float]
    given: tuple[str, ...]
    climbs: bool

    def also(self, held: Mapping[str, float]) -> Request:
        """The request with more values held."""
        return replace(self, held=dict(self.held) | dict(held))


def request(vehicle: Vehicle, held: Mapping[str, float] | None, free: Collection[str]) -> Request:
    """A checked request; what neither is held nor may be free by itself is zero.

    Raises
    ------
    UndertowError
        If a name is none of the vehicle, a value is not finite or too large, or a name is both held and free.
    """
    given = _hovering(vehicle) if held is None else dict(held)
    known = (*vehicle.pose_names, *vehicle.velocity_names, *vehicle.command_names)
    for name, value in given.items():
        _check(vehicle, name, value, known)
    for name in free:
        if name not in _FREE or name not in known:
            raise UndertowError(f"'{name}' cannot be left free: {', '.join(_FREE)} can, as far as there are")
        if name in given:
            raise UndertowError(f"{name} is both held and free: name it once")
    resting = {name: 0.0 for name in (*_PLACE, "z", "r") if name in known and name not in free}
    return Request(resting | given, tuple(given), climbs="w" in free)


def _hovering(vehicle: Vehicle) -> dict[str, float]:
    return {name: value for name, value in _HOVER.items() if name in vehicle.velocity_names}


def _check(vehicle: Vehicle, name: str, value: float, known: tuple[str, ...]) -> None:
    if name not in known:
        raise UndertowError(
            f"'{name}' is no velocity, pose or command of '{vehicle.name}'{nearest(name, known)}: it has "
            f"{', '.join(known)}"
        )
    if name in _PLACE:
        raise UndertowError(f"{name} cannot be held: a steady motion is the same everywhere; leave it out")
    if not isfinite(value):
        raise UndertowError(f"{name} = {value} is no value for a steady motion: give a finite one")
    most = FASTEST if name in VELOCITY else _FARTHEST
    if abs(value) > most:
        raise UndertowError(f"{name} = {value:g} (SI) is too much for a steady motion: stay within {most:g}")
