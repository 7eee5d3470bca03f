"""Steady motions: states and commands for which nothing but the place changes."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from undertow.errors import UndertowError
from undertow.model.symbols import POSE
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .balance import Balance, solve
from .numeric import Numeric, in_direction, reversing, with_ideal_thrust
from .request import Request, request

# Forces of a steady motion may change by this much in a second (share of the gravity of rounding, m/s^3).
_STEADY = 1e-7
_AT_REST = 1e-9


@dataclass(frozen=True)
class Trim:
    """A steady motion of a vehicle.

    Attributes
    ----------
    states, commands : mapping
        Value by name, SI; place x, y is where the motion begins.
    direction : mapping
        Velocity to 1 or -1 where parameters of one direction of motion were taken because the motion itself
        does not tell (it is at rest in the water in that direction).
    remarks : tuple of str
        What was assumed.
    wanted : Request
        What was held.
    turning : bool
        Whether the heading changes, so that slopes in x and y depend on time.
    reports : mapping
        What the sensors report of pose and velocity, by name, SI: what a controller is told.
    """

    states: Mapping[str, float]
    commands: Mapping[str, float]
    direction: Mapping[str, int]
    wanted: Request
    remarks: tuple[str, ...] = ()
    turning: bool = False
    reports: Mapping[str, float] = field(default_factory=dict)

    @property
    def y(self) -> Array:
        """Reported pose and velocity, shape (2n,)."""
        return np.array(list(self.reports.values()))

    @property
    def x(self) -> Array:
        """The state, shape (nx,)."""
        return np.array(list(self.states.values()))

    @property
    def u(self) -> Array:
        """The commands, shape (nu,)."""
        return np.array(list(self.commands.values()))


def find_trim(
    vehicle: Vehicle,
    held: Mapping[str, float] | None = None,
    *,
    free: Collection[str] = (),
    direction: Mapping[str, int] | None = None,
    numeric: Numeric | None = None,
) -> Trim:
    """The steady motion with these values.

    What is not held is found: as little drift and tilt as can be, then as little command. A turning rate that
    is not stated is none, and depth does not change.

    Parameters
    ----------
    vehicle : Vehicle
        The model; `in_current` puts it into a current.
    held : mapping
        Velocities over ground (u, v, w, p, q, r), depth and attitude (z, phi, theta, psi) or commands by
        name, SI. ``{"u": 0.5}`` is steady speed, ``{"u": 0.5, "r": 0.1}`` a turn,
        ``{"u": 0, "v": 0, "w": 0}`` hovering, also in a current. None is hovering.
    free : collection of str
        "r": the vehicle may turn as it likes; "w": it may rise or sink; "z": depth is found.
    direction : mapping
        1 or -1 by velocity: whose set of parameters holds where forward and backward ones differ and the
        motion does not tell; forward unless stated.
    numeric : Numeric, optional
        The equations of the vehicle in this direction, if they are at hand.

    Raises
    ------
    UndertowError
        If a name is unknown, forces depend on time, no steady motion has these values, or it takes a command
        beyond its limit.
    """
    wanted = request(vehicle, held, free)
    trim = _search(vehicle, wanted, dict(direction or {}), numeric)
    asked = {name: way for name, way in trim.direction.items() if name not in (direction or {})}
    words = [f"{name}={way}" for name, way in asked.items()]
    return replace(trim, remarks=(*trim.remarks, *_assumed(words)))


def _assumed(words: list[str]) -> list[str]:
    if not words:
        return []
    return [
        f"at rest in the water the direction of motion is open: parameters for {', '.join(words)} are taken"
    ]


def _search(
    vehicle: Vehicle, wanted: Request, direction: dict[str, int], known: Numeric | None = None
) -> Trim:
    """A trim, with the set of parameters for rest where the vehicle is at rest in the water."""
    numeric = known or Numeric(in_direction(vehicle, direction))
    one_way = numeric.vehicle
    if numeric.varies:
        raise UndertowError(
            f"forces on '{vehicle.name}' depend on time (waves, a supply that fades): there is no steady "
            "motion; take such effects out of a copy of the vehicle file"
        )
    x, u = _solved(numeric, wanted)
    _check_steady(numeric, x, u)
    resting = [n for n in reversing(one_way) if n not in direction and _at_rest(numeric, x, n)]
    if resting:
        return _search(vehicle, wanted, direction | dict.fromkeys(resting, 1))
    states, commands = dict(zip(numeric.states, x, strict=True)), dict(zip(numeric.commands, u, strict=True))
    turning = any(abs(r) > _AT_REST for r in _turning_rates(numeric, x, u))
    return Trim(states, commands, direction, wanted, turning=turning, reports=numeric.reports(x, u))


def _solved(numeric: Numeric, wanted: Request) -> tuple[Array, Array]:
    """State and commands; where a dead band hides the way, from the commands that ideal thrusters need."""
    balance, vehicle = Balance(numeric, wanted), numeric.vehicle
    try:
        return solve(balance)
    except UndertowError:
        ideal = with_ideal_thrust(vehicle)
        if len(ideal.effects) == len(vehicle.effects):
            raise
        try:
            _, commands = solve(Balance(Numeric(ideal), wanted))
            return solve(balance, commands)
        except UndertowError:
            pass
        raise


def _at_rest(numeric: Numeric, x: Array, name: str) -> bool:
    return bool(abs(_through_water(numeric, x, name)) < _AT_REST)


def _through_water(numeric: Numeric, x: Array, name: str) -> float:
    """Velocity through the water of one motion."""
    import casadi as ca

    from undertow.model.symbols import VELOCITY

    f, signals = numeric.functions, numeric.vehicle.composition.signals
    relative = f.convert(signals.nu_r[VELOCITY.index(name)])
    return float(ca.Function("relative", [f.x, f.p, f.t], [relative])(x, numeric.p, 0.0))


def _turning_rates(numeric: Numeric, x: Array, u: Array) -> list[float]:
    rates = numeric.rate(0.0, x, u)
    return [float(rates[i]) for i, name in enumerate(numeric.states) if name in POSE[3:]]


def _check_steady(numeric: Numeric, x: Array, u: Array) -> None:
    """Forces must not change while the pose moves on, as they do for a turn in a current."""
    rate, slopes, _, _ = numeric.slopes(x, u)
    n = len(numeric.vehicle.pose_names)
    change = slopes[n:, :n] @ rate[:n]
    if np.max(np.abs(change), initial=0.0) > _STEADY:
        felt = (abs(rate[:n]) > _AT_REST) & np.any(slopes[n:, :n], axis=0)
        guilty = [numeric.states[i] for i in np.flatnonzero(felt)]
        raise UndertowError(
            f"no steady motion: forces change with {', '.join(guilty)}, which moves on (a turn in a "
            "current, a change of depth of a hull that is compressed): hold it still"
        )
