"""References over time: poses with rates and accelerations within limits, as piecewise polynomials."""

from __future__ import annotations

import abc
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import casadi as ca
import numpy as np
from numpy.polynomial import Polynomial

from undertow.errors import UndertowError
from undertow.model.symbols import POSE


@dataclass(frozen=True)
class MissionNumber:
    """A number of a mission as generated code holds it."""

    name: str
    unit: str
    value: float


@dataclass(frozen=True)
class Kinematics:
    """The reported motion, in the coordinates of the vehicle."""

    names: tuple[str, ...]  # pose coordinates
    # eta, nu: (n, 1): reported pose (NED) and body velocity, SI
    eta: ca.SX
    nu: ca.SX
    # J_inverse, J_dot: (n, n): kinematics there
    J_inverse: ca.SX
    J_dot: ca.SX

    def index(self, name: str) -> int:
        """Where a coordinate stands."""
        return self.names.index(name)


@dataclass(frozen=True)
class DesiredMotion:
    """Desired motion at a sample."""

    eta_d: ca.SX  # (n, 1): desired pose, m and rad
    # nu_r, nu_r_dot: (n, 1): reference velocity and its rate, body frame, SI
    nu_r: ca.SX
    nu_r_dot: ca.SX


@dataclass(frozen=True)
class Followed:
    """A reference along a run, rows over time."""

    desired: dict[str, np.ndarray]  # (n,): what was desired, by pose coordinate
    # (n,): desired less true, by coordinate; "cross track" and "depth" (m) for legs
    errors: dict[str, np.ndarray]
    arrived: np.ndarray  # (n,): where the end of the mission has been reached
    # (k, 2): where it leads in the plane, north and east, m: way-points, or the curve over the rows
    path: np.ndarray


class Reference(abc.ABC):
    """A reference with states of its own, stated once in CasADi for simulation and for C."""

    state_names: ClassVar[tuple[str, ...]]  # its states, a part of those of the controller
    # whether its states have rates, so that a law may act without sampling
    continuous: ClassVar[bool] = False
    # velocities that the law takes as zero: nothing pushes there, and in a current they are the water's
    uncontrolled: tuple[str, ...] = ()
    # start, end: (n,): pose where it begins and where it ends, m and rad
    start: np.ndarray
    end: np.ndarray

    @property
    @abc.abstractmethod
    def numbers(self) -> list[MissionNumber]:
        """The numbers of the mission, r of the controller."""

    @abc.abstractmethod
    def initial_states(self) -> list[float]:
        """States at the start."""

    @abc.abstractmethod
    def desired(self, r: ca.SX, s: ca.SX, kin: Kinematics) -> DesiredMotion:
        """What is asked for in these states."""

    @abc.abstractmethod
    def advance(self, r: ca.SX, s: ca.SX, kin: Kinematics, dt: ca.SX) -> ca.SX:
        """The states dt seconds on."""

    @abc.abstractmethod
    def followed(self, t: np.ndarray, state: dict[str, np.ndarray], s: np.ndarray) -> Followed:
        """The reference beside rows of a run: times, true motion by name, and these states."""


_ORDER = 6  # coefficients of a quintic, lowest power first


@dataclass(frozen=True)
class ReferenceSettings:
    """The numbers of references."""

    # A reference is evaluated piece by piece in generated C: more than this is a table, not a mission.
    max_pieces: int = 400
    # The ends of a spline begin and end at rest: so much longer than at full speed (a quintic from rest to
    # rest has 1.875 times its mean speed at most; one end of it has about half of that).
    end_factor: float = 1.4
    real: float = 1e-6  # imaginary part of a root, relative to the length of its piece, that is rounding
    room: float = 1e-12  # by which a path is slower than its limits, relative, for rounding


SETTINGS = ReferenceSettings()


@dataclass(frozen=True)
class Limits:
    """Limits of a reference."""

    # speed, acceleration: of the position, magnitude, m/s and m/s^2
    speed: float
    acceleration: float
    # turn_rate, turn_acceleration: of each angle, rad/s and rad/s^2
    turn_rate: float
    turn_acceleration: float

    def of(self, angles: bool) -> tuple[float, float]:
        """Largest rate and acceleration of positions or of angles."""
        return (self.turn_rate, self.turn_acceleration) if angles else (self.speed, self.acceleration)


@dataclass(frozen=True)
class Profile:
    """A pose over time, quintic between knots; before the first and after the last knot it stands still."""

    names: tuple[str, ...]  # pose coordinates
    knots: np.ndarray  # (k + 1,): times, s; the first is zero
    # (k, n, 6): by piece and coordinate, in the time since the knot, lowest power first, SI
    coefficients: np.ndarray
    end: np.ndarray  # (n,): where it arrives

    @property
    def duration(self) -> float:
        """When it arrives, s."""
        return float(self.knots[-1])

    @property
    def table(self) -> np.ndarray:
        """The coefficients with those of the end, at which it stays, shape (k + 1, n, 6)."""
        rest = np.zeros((1, len(self.names), _ORDER))
        rest[0, :, 0] = self.end
        return np.concatenate([self.coefficients, rest])

    def at(self, t: np.ndarray, order: int = 0) -> np.ndarray:
        """The pose or a derivative of it over time, shape (len(t), n)."""
        piece = np.clip(np.searchsorted(self.knots, t, side="right") - 1, 0, len(self.knots) - 1)
        since = np.maximum(np.asarray(t) - self.knots[piece], 0.0)
        powers = _derivative(self.table[piece], order)
        return np.einsum("tnk,tk->tn", powers, since[:, None] ** np.arange(_ORDER))

    def largest(self, order: int, angles: bool = False) -> float:
        """Largest magnitude of a derivative of the position, or of any angle; by the roots of its slope."""
        return max(self.peaks(order, angles), default=0.0)

    def peaks(self, order: int, angles: bool = False) -> list[float]:
        """The same for every piece."""
        own = [i for i, n in enumerate(self.names) if (POSE.index(n) >= 3) == angles]
        found = []
        for length, piece in zip(np.diff(self.knots), _derivative(self.coefficients, order), strict=True):
            squares = [Polynomial(piece[i]) ** 2 for i in own]
            groups = squares if angles else [sum(squares, Polynomial([0.0]))]
            found.append(math.sqrt(max((_peak(g, length) for g in groups), default=0.0)))
        return found

    def stretched(self, factor: float) -> Profile:
        """The same path in `factor` times the time."""
        scale = factor ** -np.arange(_ORDER)
        return Profile(self.names, self.knots * factor, self.coefficients * scale, self.end)


def _derivative(coefficients: np.ndarray, order: int) -> np.ndarray:
    found = coefficients
    for _ in range(order):
        found = np.concatenate(
            [found[..., 1:] * np.arange(1, _ORDER), np.zeros_like(found[..., :1])], axis=-1
        )
    return found


def _peak(square: Polynomial, length: float) -> float:
    """The largest value of a polynomial from 0 to `length`."""
    slope = square.deriv().trim(1e-300)
    roots = slope.roots() if slope.degree() > 0 else np.array([])
    inside = [r.real for r in roots if abs(r.imag) <= SETTINGS.real * length and 0 <= r.real <= length]
    return max(float(square(x)) for x in (0.0, length, *inside))


# --- making them ---------------------------------------------------------------------------------
def straight_legs(
    names: tuple[str, ...], poses: Sequence[np.ndarray], limits: Limits, hold: float
) -> Profile:
    """From pose to pose on straight lines, at rest at each for `hold` s, as fast as the limits allow.

    Speed grows by a cubic of time, so that the acceleration is continuous.
    """
    pieces: list[tuple[float, np.ndarray]] = []
    for begin, end in pairwise(poses):
        pieces += _rest_to_rest(names, begin, end - begin, limits)
        if hold:
            pieces.append((hold, _line_coefficients(end, np.zeros_like(end), ())))
    if not pieces:
        raise UndertowError("the way-points of the mission are all the same pose: give two that differ")
    knots = np.cumsum([0.0, *(length for length, _ in pieces)])
    return _checked(Profile(names, knots, np.array([c for _, c in pieces]), np.asarray(poses[-1])))


def _rest_to_rest(
    names: tuple[str, ...], begin: np.ndarray, move: np.ndarray, limits: Limits
) -> list[tuple[float, np.ndarray]]:
    """Pieces in the share of the way, 0 to 1: faster, steady, slower."""
    rate, acceleration = _way_limits(names, move, limits)
    if not math.isfinite(rate):
        return []
    ramp = 1.5 * rate / acceleration  # the acceleration 6 v tau (1 - tau) / T is largest halfway, 1.5 v / T
    if rate * ramp > 1:
        rate = math.sqrt(acceleration / 1.5)
        ramp = 1 / rate
    up, half = (rate / ramp**2, -rate / (2 * ramp**3)), rate * ramp / 2
    steady = max((1 - 2 * half) / rate, 0.0)
    found = [(ramp, _line_coefficients(begin, move, (0.0, 0.0, 0.0, *up)))]
    if steady:
        found.append((steady, _line_coefficients(begin, move, (half, rate))))
    return [*found, (ramp, _line_coefficients(begin, move, (1 - half, rate, 0.0, -up[0], -up[1])))]


def _way_limits(names: tuple[str, ...], move: np.ndarray, limits: Limits) -> tuple[float, float]:
    """Largest rate and acceleration of the share of a way."""
    is_angle = np.array([POSE.index(n) >= 3 for n in names])
    distance = float(np.linalg.norm(move[~is_angle]))
    turn = float(np.abs(move[is_angle]).max(initial=0.0))
    sizes = [(distance, limits.of(False)), (turn, limits.of(True))]
    pairs = [(rate / size, acceleration / size) for size, (rate, acceleration) in sizes if size > 0]
    return tuple(min(column) for column in zip(*pairs, strict=True)) if pairs else (math.inf, math.inf)  # type: ignore[return-value]


def _line_coefficients(begin: np.ndarray, move: np.ndarray, share: Sequence[float]) -> np.ndarray:
    """Coefficients of begin + share(t) move, shape (n, 6)."""
    found = np.zeros((len(begin), _ORDER))
    found[:, : len(share)] = np.outer(move, share)
    found[:, 0] += begin
    return found


def spline(names: tuple[str, ...], poses: np.ndarray, times: np.ndarray) -> Profile:
    """A quintic spline through poses at times, at rest at both ends; four times differentiable."""
    from scipy.interpolate import make_interp_spline

    still = [(1, np.zeros(len(names))), (2, np.zeros(len(names)))]
    curve = make_interp_spline(times, poses, k=5, bc_type=(still, still))
    knots = np.unique(curve.t)
    taylor = [curve(knots[:-1], nu=k) / math.factorial(k) for k in range(_ORDER)]
    coefficients = np.stack(taylor, axis=-1)
    return _checked(Profile(names, knots - knots[0], coefficients, np.asarray(poses[-1])))


def fitted(profile: Profile, limits: Limits) -> Profile:
    """The path of a profile, uniformly scaled in time until it just meets its limits."""
    factors = [0.0]
    for angles in (False, True):
        rate, acceleration = limits.of(angles)
        factors += [profile.largest(1, angles) / rate, math.sqrt(profile.largest(2, angles) / acceleration)]
    # Rounding of the roots must not take it past a limit.
    return profile.stretched(max(factors) * (1 + SETTINGS.room))


def waypoint_times(positions: np.ndarray, turns: np.ndarray, limits: Limits) -> np.ndarray:
    """Times of way-points at full speed along chords, the ends longer, shape (k,)."""
    lengths = np.linalg.norm(np.diff(positions, axis=0), axis=1) / limits.speed
    lengths = np.maximum(lengths, np.abs(np.diff(turns)) / limits.turn_rate)
    lengths[[0, -1]] *= SETTINGS.end_factor
    return np.concatenate([[0.0], np.cumsum(lengths)])


def _checked(profile: Profile) -> Profile:
    pieces = len(profile.coefficients)
    if pieces > SETTINGS.max_pieces:
        raise UndertowError(
            f"the mission has {pieces} pieces, but {SETTINGS.max_pieces} is the limit: split it in two"
        )
    return profile


# --- following them ------------------------------------------------------------------------------
class TimedReference(Reference):
    """A profile as a reference: its one state is the time."""

    state_names: ClassVar[tuple[str, ...]] = ("mission_time",)
    continuous = True

    def __init__(self, profile: Profile) -> None:
        self.profile = profile
        self.start, self.end = profile.coefficients[0, :, 0], profile.end

    @property
    def numbers(self) -> list[MissionNumber]:
        """Knots, then coefficients by piece, coordinate and power."""
        profile = self.profile
        knots = [MissionNumber(f"time_{i}", "s", float(t)) for i, t in enumerate(profile.knots)]
        return knots + [
            MissionNumber(f"{name}_{i}_t{k}", f"{'m' if POSE.index(name) < 3 else 'rad'}/s^{k}", float(value))
            for i, piece in enumerate(profile.table)
            for name, row in zip(profile.names, piece, strict=True)
            for k, value in enumerate(row)
        ]

    def initial_states(self) -> list[float]:
        """Time zero."""
        return [0.0]

    def desired(self, r: ca.SX, s: ca.SX, kin: Kinematics) -> DesiredMotion:
        """Pose, velocity and its rate at the time that s has come to."""
        count, n = len(self.profile.knots), len(self.profile.names)
        knots, table = r[:count], ca.reshape(r[count:], n * _ORDER, count)
        after = s[0] >= knots
        here = after - ca.vertcat(after[1:], 0)
        here[0] = 1 - after[1] if count > 1 else 1
        since = ca.fmax(s[0] - knots.T @ here, 0)
        own = ca.reshape(table @ here, _ORDER, n)
        pose, rate, acceleration = (_horner(own, since, order) for order in range(3))
        nu_r = kin.J_inverse @ rate
        return DesiredMotion(pose, nu_r, kin.J_inverse @ (acceleration - kin.J_dot @ nu_r))

    def advance(self, r: ca.SX, s: ca.SX, kin: Kinematics, dt: ca.SX) -> ca.SX:
        """The clock goes on."""
        return s + dt

    def followed(self, t: np.ndarray, state: dict[str, np.ndarray], s: np.ndarray) -> Followed:
        """Desired pose over rows, and whether its end is reached there."""
        desired = dict(zip(self.profile.names, self.profile.at(t).T, strict=True))
        errors = {n: _wrapped(n, desired[n] - state[n]) for n in self.profile.names}
        path = np.column_stack([desired["x"], desired["y"]])
        return Followed(desired, errors, t >= self.profile.duration, path)


def _wrapped(name: str, error: np.ndarray) -> np.ndarray:
    """An error, the short way round for an angle."""
    return np.remainder(error + np.pi, 2 * np.pi) - np.pi if POSE.index(name) >= 3 else error


def _horner(own: ca.SX, t: ca.SX, order: int) -> ca.SX:
    """A derivative of polynomials, coefficients in columns of shape (6, n), at t, shape (n, 1)."""
    found = ca.SX.zeros(own.size2(), 1)
    for power in range(_ORDER - 1, order - 1, -1):
        found = found * t + math.perm(power, order) * own[power, :].T
    return found
