"""Steady motions: the balance of forces that a request asks for."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import product
from math import inf, isfinite

import casadi as ca
import numpy as np

from undertow.errors import UndertowError, of_stated_kinds, refuse_unknown
from undertow.model.effect import Propeller
from undertow.model.symbols import FASTEST, POSE, VELOCITY
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .numeric import Numeric, in_direction, reversing, with_ideal_thrust

_HOVER = {"u": 0.0, "v": 0.0, "w": 0.0, "r": 0.0}
_FREE = ("u", "v", "w", "r", "z")
_POSITION = ("x", "y")


@dataclass(frozen=True)
class Request:
    """What is wanted of a trim."""

    held: Mapping[str, float]  # values of states and commands that are given, by name
    stated: tuple[str, ...]  # names of those that the caller stated
    climbs: bool  # whether depth may change


def checked_request(vehicle: Vehicle, held: Mapping[str, float] | None, free: Collection[str]) -> Request:
    """A checked request; values neither held nor free are zero."""
    hover = {n: v for n, v in _HOVER.items() if n in vehicle.velocity_names and n not in free}
    given = hover if held is None else dict(held)
    known = (*vehicle.pose_names, *vehicle.velocity_names, *vehicle.command_names)
    refuse_unknown(given, known, "", f" is not a velocity, pose or command of '{vehicle.name}'", "it has")
    for name, value in given.items():
        _check(name, value)
    for name in free:
        if name not in _FREE or name not in known:
            raise UndertowError(
                f"'{name}' cannot be left free: only {', '.join(_FREE)} can, as far as the vehicle has them"
            )
        if name in given:
            raise UndertowError(f"{name} is both held and free: name it only once")
    resting = {name: 0.0 for name in (*_POSITION, "z", "r") if name in known and name not in free}
    return Request(resting | given, tuple(given), climbs="w" in free)


def _check(name: str, value: float) -> None:
    if name in _POSITION:
        raise UndertowError(f"{name} cannot be held: a steady motion is the same everywhere; leave it out")
    if not isfinite(value):
        raise UndertowError(f"{name} = {value} is not a value of a steady motion: give a finite one")
    most = FASTEST if name in VELOCITY else SETTINGS.farthest
    if abs(value) > most:
        raise UndertowError(f"{name} = {value:g} (SI) is too large for a steady motion: stay within {most:g}")


@dataclass(frozen=True)
class TrimSettings:
    """Preferences of a trim, and tolerances."""

    # Price of the square of a velocity that is not held, (m/s)^-2: drift is avoided before tilt.
    drift: float = 1e2
    tilt: float = 1.0  # the same of a pose coordinate: tilt is avoided before command
    command: float = 1e-4  # the same of a command
    effect_state: float = 1e-6  # the same of a state of an effect
    # From which the search begins where speed and heading are to be found: m/s, degrees.
    speeds: tuple[float, ...] = (0.0, 0.5)
    headings: tuple[float, ...] = (0.0, 90.0, 180.0, -90.0)
    # The same of propellers, revolutions a second: in their inflow they brake before they push.
    revolutions: tuple[float, ...] = (1.0, -1.0, 10.0, -10.0, 100.0, -100.0)
    tolerance: float = 1e-9  # rates of change below this are none, SI
    search_rounds: int = 300  # of the search for the least price, and the change of it that ends the search
    search_change: float = 1e-14
    rank: float = 1e-10  # singular values of the slope below this part of the largest are none
    rounds: int = 12  # Newton's steps, and halvings of each
    at_limit: float = 1e-9  # share of a limit by which a command may exceed it: rounding
    # Drift and tilt below this are put to zero where commands can do so: m/s, rad/s and rad.
    negligible: float = 5e-3
    # Forces of a steady motion may change by this much in a second, m/s^3: far above rounding.
    steady: float = 1e-7
    farthest: float = 1e6  # largest value that is held, of all but velocities, SI
    at_rest: float = 1e-9  # speed through the water, m/s, and turning rate, rad/s, that are rounding


SETTINGS = TrimSettings()


class Balance:
    """Equations F(y) = 0 of a steady motion in the unknowns y among states and commands.

    With `p` the parameters are others than the stated ones; thrusters can be counted as without limits.
    """

    def __init__(
        self, numeric: Numeric, request: Request, p: Array | None = None, limited: bool = True
    ) -> None:
        self.numeric, self.request, self._p, self._limited = numeric, request, p, limited
        self.names = (*numeric.states, *numeric.commands)
        self.unknown = [i for i, name in enumerate(self.names) if name not in request.held]
        # Heading and place may go on changing; velocities and all else may not.
        free = ("x", "y", "psi", "z") if request.climbs else ("x", "y", "psi")
        self._rows = [i for i, name in enumerate(numeric.states) if name not in free]
        self.start = np.array([request.held.get(name, 0.0) for name in self.names])

    @property
    def rows(self) -> list[str]:
        """Names of the states that are to be steady."""
        return [self.numeric.states[i] for i in self._rows]

    @property
    def weights(self) -> Array:
        """Price of the square of each unknown."""
        return np.array([self._weight(self.names[i]) for i in self.unknown])

    def _weight(self, name: str) -> float:
        if name in self.numeric.commands:
            return SETTINGS.command
        return (
            SETTINGS.drift if name in VELOCITY else SETTINGS.tilt if name in POSE else SETTINGS.effect_state
        )

    def bounds(self) -> list[tuple[float | None, float | None]]:
        """Limits of each unknown: what thrusters can give."""
        vehicle, names = self.numeric.vehicle, [self.names[i] for i in self.unknown]
        lowest, highest = (vehicle.lowest_commands, vehicle.largest_commands) if self._limited else ({}, {})
        return [(lowest.get(n), highest.get(n)) for n in names]

    def split(self, y: Array) -> tuple[Array, Array]:
        """State and commands for values of the unknowns."""
        every = self.start.copy()
        every[self.unknown] = y
        n = len(self.numeric.states)
        return every[:n], every[n:]

    def __call__(self, y: Array) -> Array:
        return self.numeric.rate(0.0, *self.split(y), self._p)[self._rows]

    def slope(self, y: Array) -> Array:
        """dF/dy."""
        _, a, b, _ = self.numeric.slopes(*self.split(y), self._p)
        return np.hstack([a, b])[np.ix_(self._rows, self.unknown)]

    def residual(self, y: Array) -> float:
        """How far a motion is from steady; infinite where numbers fail."""
        largest = float(np.max(np.abs(self(y)), initial=0.0))
        return largest if np.isfinite(largest) else inf

    def is_steady(self, y: Array) -> bool:
        """Whether a motion is steady."""
        return self.residual(y) < SETTINGS.tolerance


def solve(balance: Balance, commands: Array | None = None) -> tuple[Array, Array]:
    """State and commands of the cheapest steady motion; the search begins at `commands`, shape (nu,)."""
    found = [_minimised(balance, y) for y in _starts(balance, commands)]
    good = [y for y in found if balance.is_steady(y)]
    if not good:
        raise UndertowError(_why_none(balance, min(found, key=balance.residual)))
    inside = [y for y in good if not _beyond_limit(balance, y)]
    if not inside:
        raise UndertowError(_beyond_limit(balance, good[0]))
    best = min(inside, key=lambda y: float(balance.weights @ y**2))
    # The motion with no drift and no tilt at all where they are negligible.
    names = [balance.names[i] for i in balance.unknown]
    faint = [n for n, v in zip(names, best, strict=True) if abs(v) < SETTINGS.negligible]
    small = [n for n in faint if n in (*POSE, *VELOCITY)]
    held = dict(balance.request.held) | dict.fromkeys(small, 0.0)
    upright = Balance(balance.numeric, replace(balance.request, held=held))
    start = np.array([v for n, v in zip(names, best, strict=True) if n not in small])
    again = _polished(upright, start)
    better = upright.is_steady(again) and not _beyond_limit(upright, again)
    return upright.split(again) if better else balance.split(best)


def _starts(balance: Balance, commands: Array | None = None) -> list[Array]:
    """Where the search begins: at rest and, where that is to be found, at some speed and several headings."""
    index_of = {balance.names[i]: k for k, i in enumerate(balance.unknown)}
    begin = np.zeros(len(index_of))
    for name, value in zip(balance.numeric.commands, () if commands is None else commands, strict=False):
        if name in index_of:
            begin[index_of[name]] = value
    values_of = {"u": SETTINGS.speeds, "psi": tuple(np.radians(SETTINGS.headings))}
    names = [n for n in values_of if n in index_of]
    starts = []
    for values in product(*(values_of[n] for n in names)):
        start = begin.copy()
        start[[index_of[n] for n in names]] = values
        starts.append(start)
    return starts


def _minimised(balance: Balance, y: Array) -> Array:
    if not y.size:  # everything is held: SLSQP does not take a search without unknowns
        return y
    from scipy.optimize import minimize

    weights = balance.weights
    done = minimize(
        lambda y: 0.5 * float(weights @ y**2),
        y,
        jac=lambda y: weights * y,
        method="SLSQP",
        bounds=balance.bounds(),
        constraints={"type": "eq", "fun": balance, "jac": balance.slope},
        options={"maxiter": SETTINGS.search_rounds, "ftol": SETTINGS.search_change},
    )
    return _polished(balance, done.x)


def _polished(balance: Balance, y: Array) -> Array:
    """The last digits: Newton's steps onto F = 0, then along it to the least price."""
    for _ in range(SETTINGS.rounds):
        y = _newton_step(balance, y)
    for _ in range(SETTINGS.rounds):
        inverse, target, scale = _linearised(balance, y)
        cheaper = scale * (inverse @ (target - balance(y)))
        if not balance.residual(cheaper) < SETTINGS.tolerance / 10:
            break
        y = cheaper
    return y


def _linearised(balance: Balance, y: Array) -> tuple[Array, Array, Array]:
    """Inverse of the slope in unknowns divided by their scale, slope times y, and the scale."""
    scale: Array = 1 / np.sqrt(balance.weights)
    slope: Array = np.nan_to_num(balance.slope(y)) * scale
    inverse = np.asarray(np.linalg.pinv(slope, rcond=SETTINGS.rank), dtype=float)
    return inverse, slope @ (y / scale), scale


def _newton_step(balance: Balance, y: Array) -> Array:
    """One step of Newton's, halved until it brings the motion nearer to a steady one."""
    before = balance.residual(y)
    inverse, _, scale = _linearised(balance, y)
    step = -scale * (inverse @ balance(y))
    tries = (y + step / 2**k for k in range(SETTINGS.rounds))
    return next((t for t in tries if balance.residual(t) < before), y)


# --- why there is none ----------------------------------------------------------------------------
def _why_none(balance: Balance, y: Array) -> str:
    if any(m != (None, None) for m in balance.bounds()):
        unlimited = Balance(balance.numeric, balance.request, limited=False)
        far = [y for y in (_minimised(unlimited, s) for s in _starts(unlimited)) if unlimited.is_steady(y)]
        if far:
            return _beyond_limit(balance, far[0])
    value = np.abs(balance(y))
    worst = balance.rows[int(np.argmax(value))]
    return (
        f"no steady motion of '{balance.numeric.vehicle.name}' has these values: {worst} keeps changing by "
        f"{value.max():.3g} (SI) a second, whatever the commands; {_remedy(balance.request.stated)}"
    )


def _remedy(held: Collection[str]) -> str:
    free = [n for n in held if n in _FREE]
    return f"hold other values, or leave one of {', '.join(free)} free" if free else "hold something else"


def _beyond_limit(balance: Balance, y: Array) -> str:
    """Required command, if beyond its limit."""
    for i, value, (_, most) in zip(balance.unknown, y, balance.bounds(), strict=True):
        if most is not None and abs(value) > most * (1 + SETTINGS.at_limit):
            return (
                f"this steady motion needs {balance.names[i]} = {value:.4g}, but its limit is {most:g}: use "
                "a lower speed or a stronger thruster"
            )
    return ""


def at_parameters(balance: Balance, p: Array, x: Array, u: Array) -> tuple[Array, Array] | None:
    """The trim near a known one for other values of the parameters, or None where there is none."""
    changed = Balance(balance.numeric, balance.request, p)
    y = _polished(changed, np.concatenate([x, u])[balance.unknown])
    return changed.split(y) if changed.is_steady(y) else None


@dataclass(frozen=True)
class Trim:
    """A steady motion of a vehicle."""

    # states, commands: value by name, SI; place x, y is where the motion begins
    states: Mapping[str, float]
    commands: Mapping[str, float]
    # velocity to 1 or -1 where parameters of one direction of motion were taken because the motion itself
    # does not tell (it is at rest in the water in that direction)
    direction: Mapping[str, int]
    request: Request  # what was held
    remarks: tuple[str, ...] = ()  # what was assumed
    turning: bool = False  # whether the heading changes, so that slopes in x and y depend on time
    ineffective: tuple[str, ...] = ()  # commands around which a small change has no effect
    # what the sensors report of pose and velocity, by name, SI: what a controller gets
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


@of_stated_kinds
def find_trim(
    vehicle: Vehicle,
    held: Mapping[str, float] | None = None,
    *,
    free: Collection[str] = (),
    direction: Mapping[str, int] | None = None,
    numeric: Numeric | None = None,
) -> Trim:
    """The steady motion with these values.

    Values not held are found: minimum drift and tilt, then minimum command. A turning rate that is not stated
    is zero, and depth is constant.

    Parameters
    ----------
    vehicle : Vehicle
        The model; `in_current` puts it into a current.
    held : mapping
        Velocities over ground (u, v, w, p, q, r), depth and attitude (z, phi, theta, psi) or commands by
        name, SI. ``{"u": 0.5}`` is steady speed, ``{"u": 0.5, "r": 0.1}`` a turn,
        ``{"u": 0, "v": 0, "w": 0}`` hovering, also in a current. None is hovering.
    free : collection of str
        "u", "v": without `held`, the vehicle need not hover; "r": it may turn as it likes; "w": it may rise
        or sink; "z": depth is found.
    direction : mapping
        1 or -1 by velocity: direction whose parameters are used if forward and backward ones differ and the
        motion does not decide; forward unless stated.
    numeric : Numeric, optional
        The equations of the vehicle in this direction, if they are at hand.

    Raises
    ------
    UndertowError
        If a name is unknown, forces depend on time, no steady motion has these values, or it takes a command
        beyond its limit.
    """
    request = checked_request(vehicle, held, free)
    trim = _find(vehicle, request, dict(direction or {}), numeric)
    assumed = [f"{name}={sign}" for name, sign in trim.direction.items() if name not in (direction or {})]
    remarks = []
    if assumed:
        remarks.append(
            "at rest in the water the direction of motion is ambiguous: parameters for "
            f"{', '.join(assumed)} are taken"
        )
    if trim.ineffective:
        remarks.append(
            f"small changes of {', '.join(trim.ineffective)} have no effect here (a dead band, a flat part "
            "of a thrust curve, or a rudder without flow): linearise at a motion that needs them (--at)"
        )
    return replace(trim, remarks=tuple(remarks))


def _find(
    vehicle: Vehicle, request: Request, direction: dict[str, int], known: Numeric | None = None
) -> Trim:
    """A trim, with the set of parameters for rest where the vehicle is at rest in the water."""
    numeric = known or Numeric(in_direction(vehicle, direction))
    directed = numeric.vehicle
    if numeric.time_varying:
        raise UndertowError(
            f"forces on '{vehicle.name}' depend on time (waves, battery droop): there is no steady motion; "
            "remove such effects in a copy of the vehicle file"
        )
    x, u = _solved(numeric, request)
    _check_steady(numeric, x, u)
    resting = [
        name
        for name in reversing(directed)
        if name not in direction and abs(_through_water(numeric, x, name)) < SETTINGS.at_rest
    ]
    if resting:
        return _find(vehicle, request, direction | dict.fromkeys(resting, 1))
    states, commands = dict(zip(numeric.states, x, strict=True)), dict(zip(numeric.commands, u, strict=True))
    rates = numeric.rate(0.0, x, u)
    turning = any(
        abs(r) > SETTINGS.at_rest for n, r in zip(numeric.states, rates, strict=True) if n in POSE[3:]
    )
    ineffective = tuple(
        n
        for n, felt in zip(numeric.commands, np.any(numeric.slopes(x, u)[2], axis=0), strict=True)
        if not felt
    )
    return Trim(states, commands, direction, request, (), bool(turning), ineffective, numeric.reports(x, u))


def _solved(numeric: Numeric, request: Request) -> tuple[Array, Array]:
    """State and commands; where no command moves the vehicle at rest, from commands beyond its dead band."""
    balance = Balance(numeric, request)
    try:
        return solve(balance)
    except UndertowError:
        for commands in _beyond_dead_bands(numeric, request):
            with suppress(UndertowError):
                return solve(balance, commands)
        raise


def _beyond_dead_bands(numeric: Numeric, request: Request) -> Iterator[Array]:
    """Commands that ideal thrusters need, half of what they can be, either way, and turning propellers.

    Dead bands, flat parts of thrust curves and propellers leave the search at rest without a direction.
    """
    ideal = with_ideal_thrust(numeric.vehicle)
    if len(ideal.effects) < len(numeric.vehicle.effects):
        with suppress(UndertowError):
            yield solve(Balance(Numeric(ideal), request))[1]
    for limits in (numeric.vehicle.largest_commands, numeric.vehicle.lowest_commands):
        if limits:
            yield np.array([limits.get(name, 0.0) / 2 for name in numeric.commands])
    thrusters = numeric.vehicle.thrusters
    turns = {t.name: float(t.law.per_command) for t in thrusters if isinstance(t.law, Propeller)}
    for speed in SETTINGS.revolutions if turns else ():
        yield np.array([speed / turns[name] if name in turns else 0.0 for name in numeric.commands])


def _through_water(numeric: Numeric, x: Array, name: str) -> float:
    """Velocity through the water of one motion."""
    f, signals = numeric.functions, numeric.vehicle.composition.signals
    relative = f.convert(signals.nu_r[VELOCITY.index(name)])
    return float(ca.Function("relative", [f.x, f.p, f.t], [relative])(x, numeric.p, 0.0))


def _check_steady(numeric: Numeric, x: Array, u: Array) -> None:
    """Forces must not change while the pose moves on, as they do for a turn in a current."""
    rate, slopes, _, _ = numeric.slopes(x, u)
    n = len(numeric.vehicle.pose_names)
    change = slopes[n:, :n] @ rate[:n]
    if np.max(np.abs(change), initial=0.0) > SETTINGS.steady:
        felt = (abs(rate[:n]) > SETTINGS.at_rest) & np.any(slopes[n:, :n], axis=0)
        changing = [numeric.states[i] for i in np.flatnonzero(felt)]
        raise UndertowError(
            f"no steady motion: forces change with {', '.join(changing)}, which keeps changing (a turn in a "
            "current, a depth change of a compressible hull): hold it fixed"
        )
