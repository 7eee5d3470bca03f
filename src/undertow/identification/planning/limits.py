"""What a manoeuvre may do: largest commands, speeds and excursions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from undertow.errors import UndertowError
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from ..logs import Run

_EVERY = ""


@dataclass(frozen=True)
class MotionLimits:
    """Bounds on the predicted motion, seen from where the manoeuvre starts; inf where there is none.

    Attributes
    ----------
    speed : float
        Magnitude of the linear velocity, m/s.
    rate : float
        Magnitude of every angular velocity, rad/s.
    depth : float
        Change of depth, m.
    tilt : float
        Magnitude of roll and of pitch, rad.
    distance : float
        Horizontal distance from the start, m.
    """

    speed: float = np.inf
    rate: float = np.radians(60.0)
    depth: float = 5.0
    tilt: float = np.radians(45.0)
    distance: float = np.inf

    def __post_init__(self) -> None:
        for name, value in self.as_dict().items():
            if not value > 0:
                raise UndertowError(f"largest {name} = {value:g} leaves no motion: give a positive value")

    def as_dict(self) -> dict[str, float]:
        """The limits by name."""
        return {name: float(getattr(self, name)) for name in ("speed", "rate", "depth", "tilt", "distance")}


@dataclass(frozen=True)
class CommandLimits:
    """Largest magnitude of every command.

    Attributes
    ----------
    value : (k,) array
        In the unit of the command.
    source : tuple of str
        Where each comes from.
    """

    value: Array
    source: tuple[str, ...]


def command_limits(vehicle: Vehicle, asked: Mapping[str, float], runs: Sequence[Run]) -> CommandLimits:
    """Largest commands: what was asked for, else the vehicle file, else the largest in the logs.

    Parameters
    ----------
    vehicle : Vehicle
        Whose commands these are.
    asked : mapping
        Limits by name of the command; the key "" stands for all that are not named. They may lower what the
        vehicle file says, never raise it.
    runs : sequence of Run
        Logs.

    Raises
    ------
    UndertowError
        If a command has no limit, or one was asked for that is unknown, not positive or above the file's.
    """
    for name, value in asked.items():
        if name not in (_EVERY, *vehicle.command_names):
            have = ", ".join(vehicle.command_names)
            raise UndertowError(f"--limit names the command '{name}', which is not there: there are {have}")
        if not (value > 0 and np.isfinite(value)):
            raise UndertowError(f"--limit {name or 'of all'} = {value:g} is no limit: give a positive value")
    stated = {t.name: t.limit for t in vehicle.thrusters if t.limit is not None}
    found = [_limit(n, asked, stated.get(n), runs) for n in vehicle.command_names]
    return CommandLimits(np.array([v for v, _ in found]), tuple(s for _, s in found))


def _limit(
    name: str, asked: Mapping[str, float], stated: float | None, runs: Sequence[Run]
) -> tuple[float, str]:
    wish = asked.get(name, asked.get(_EVERY))
    if wish is not None and stated is not None and wish > stated:
        raise UndertowError(
            f"--limit {wish:g} for '{name}' is above its limit in the vehicle file, {stated:g}"
        )
    if wish is not None:
        return wish, "asked for"
    if stated is not None:
        return stated, "vehicle file"
    largest = [float(np.nanmax(np.abs(r.channels[name]))) for r in runs if r.has(name)]
    if not largest or not max(largest) > 0:
        raise UndertowError(
            f"nothing says how large the command '{name}' may be: give --limit {name}=VALUE (or --limit "
            "VALUE for all), or write limit = ... into the vehicle file"
        )
    return max(largest), "largest in the logs"


def exceeded(y: Array, names: Sequence[str], limits: MotionLimits) -> tuple[str, float]:
    """The limit that a motion strains most, and how many times over (at most 1 is allowed).

    Parameters
    ----------
    y : (n, 2n) array
        Pose and velocity.
    names : sequence of str
        Names of the columns.
    """
    if not np.isfinite(y).all():
        return "speed", float("inf")
    bounds = limits.as_dict()
    strains = {what: size / bounds[what] for what, size in extremes(y, names).items()}
    worst = max(strains, key=lambda what: strains[what], default="speed")
    return worst, strains.get(worst, 0.0)


def extremes(y: Array, names: Sequence[str]) -> dict[str, float]:
    """Largest speed, rate, change of depth, tilt and distance of a motion, in SI; only what it has."""
    return dict(_extremes(dict(zip(names, y.T, strict=True))))


def _extremes(columns: Mapping[str, Array]) -> Iterator[tuple[str, float]]:
    def group(*wanted: str) -> list[Array]:
        return [columns[n] for n in wanted if n in columns]

    for what, found in (("speed", group("u", "v", "w")), ("distance", [c - c[0] for c in group("x", "y")])):
        if found:
            yield what, float(np.max(np.linalg.norm(np.column_stack(found), axis=1)))
    for what, found in (("rate", group("p", "q", "r")), ("tilt", group("phi", "theta"))):
        if found:
            yield what, max(float(np.max(np.abs(c))) for c in found)
    for depth in group("z"):
        yield "depth", float(np.max(np.abs(depth - depth[0])))
