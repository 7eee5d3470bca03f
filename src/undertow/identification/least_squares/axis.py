"""One motion by itself: a vehicle that can only surge, or only heave, driven by what the log holds."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from undertow.errors import UndertowError
from undertow.model.effect import Actuation, Effect, Measurement
from undertow.model.symbols import DOFS, FORCE, VELOCITY
from undertow.model.vehicle import Value, Vehicle

from ..logs import Run
from ..logs.checks import constant_channels

Direction = Literal["forward", "backward", "both"]
# Share of the way in the lesser direction from which a log is one of both directions.
_BOTH_WAYS = 0.05


@dataclass(frozen=True)
class Axis:
    """One motion in one direction.

    Attributes
    ----------
    motion : str
        Degree of freedom.
    direction : str
        ``forward``, ``backward``, or ``both`` where the vehicle does not tell them apart.
    vehicle : Vehicle
        The vehicle with this motion only, and the values of this direction.
    """

    motion: str
    direction: Direction
    vehicle: Vehicle

    @property
    def place(self) -> int:
        """Place of the motion among the six."""
        return DOFS.index(self.motion)

    @property
    def velocity(self) -> str:
        """Channel of its velocity."""
        return VELOCITY[self.place]

    @property
    def rate(self) -> str:
        """Channel of its acceleration."""
        return f"{self.velocity}_dot"

    @property
    def inertia(self) -> str:
        """What the sum of mass and added mass is called, as in the paper."""
        return ("m_x", "m_y", "m_z", "I_xx", "I_yy", "I_zz")[self.place]

    def name_of(self, parameter: str) -> str:
        """Name that a parameter of this motion has in the whole vehicle."""
        return parameter if self.direction == "both" else f"{parameter}_{self.direction}"

    def __str__(self) -> str:
        return self.motion if self.direction == "both" else f"{self.motion}, {self.direction}"


def moving(vehicle: Vehicle, run: Run) -> list[str]:
    """Motions of a vehicle that a run holds a velocity of which changes, and a force."""
    names = dict(zip(vehicle.degrees_of_freedom, vehicle.velocity_names, strict=True))
    still = constant_channels(run, names.values())
    moved = (m for m, name in names.items() if run.has(name) and name not in still)
    return [m for m in moved if _forced(vehicle, m, run)]


def _forced(vehicle: Vehicle, motion: str, run: Run) -> bool:
    pushed = bool(vehicle.thrusters) and all(run.has(t.name) for t in vehicle.thrusters)
    return pushed or run.has(f"tau_{FORCE[DOFS.index(motion)]}")


def axis_of(vehicle: Vehicle, motion: str, run: Run) -> Axis:
    """One motion of a vehicle, in the direction in which a run goes.

    The log's own force `tau_X` ... is used where it has one; else the thrusters push.

    Raises
    ------
    UndertowError
        If the vehicle has a value for each direction, and the run goes in both.
    """
    place = DOFS.index(motion)
    own = f"tau_{FORCE[place]}"
    alone = replace(vehicle, degrees_of_freedom=(motion,), force_channels=(own,) if run.has(own) else ())
    if run.has(own):
        alone = replace(alone, thrusters=(), effects=_without_actuation(vehicle))
    alone = replace(alone, effects=tuple(e for e in alone.effects if not isinstance(e, Measurement)))
    if not _split(alone):
        return Axis(motion, "both", alone)
    direction = _direction(run, VELOCITY[place], vehicle.name)
    return Axis(motion, direction, _one_way(alone, direction))


def _direction(run: Run, name: str, vehicle: str) -> Direction:
    way = run.channels[name]
    total = float(np.nansum(np.abs(way)))
    ahead = float(np.nansum(np.maximum(way, 0.0))) / total
    if _BOTH_WAYS < ahead < 1.0 - _BOTH_WAYS:
        raise UndertowError(
            f"run '{run.name}' goes forward for {ahead:.0%} of its way in {name} and backward for the rest, "
            f"but vehicle '{vehicle}' has a value for each direction: give the two parts by themselves "
            "(--from, --to)"
        )
    return "forward" if ahead > 0.5 else "backward"


def _without_actuation(vehicle: Vehicle) -> tuple[Effect, ...]:
    kept = [e for e in vehicle.effects if not isinstance(e, Actuation) and "thrusters" not in e.requires]
    return tuple(kept)


def _split(vehicle: Vehicle) -> bool:
    """Whether a parameter of this motion has a value for each direction."""
    return any(n in vehicle.sides for n in vehicle.parameter_names)


def _one_way(vehicle: Vehicle, direction: str) -> Vehicle:
    """The vehicle with the values of one direction for both."""
    values: dict[str, Value] = {}
    for name, value in vehicle.values.items():
        parameter, way = vehicle.sides.get(name, (None, direction))
        if way == direction:
            values[name if parameter is None else parameter.name] = value
    return replace(vehicle, values=values)


def known_states(vehicle: Vehicle, states: Iterable[str], whole: Sequence[str]) -> None:
    """Refuse a model with states that no sample holds.

    Raises
    ------
    UndertowError
        If an effect owns states.
    """
    hidden = [s for s in states if s not in whole]
    if hidden:
        raise UndertowError(
            f"vehicle '{vehicle.name}' has states that no sample of a log holds ({', '.join(hidden)}): least "
            "squares on samples cannot follow them; use undertow fit, or leave the effect out"
        )
