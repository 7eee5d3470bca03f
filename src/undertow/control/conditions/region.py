"""The certified region: where V falls, attitudes stay in range and commands within their limits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import sympy as sm
from scipy.optimize import brentq

from undertow.control.plant import Plant
from undertow.errors import UndertowError
from undertow.model.composition import function_of
from undertow.model.symbols import symbol
from undertow.typing import Array

from .attitude import ANGLES
from .by_law import DERIVED_PD_DAMPER
from .commands import (
    Commands,
    FastDamping,
    SlidingCommands,
    dampings,
    fast_damping,
    inertias,
    pd_commands,
    per_root_of_level,
)
from .problem import Problem, SignSet, Span, inside, inverse_of
from .result import SETTINGS, Region

# Levels of V, J, below and above which a region counts as none and as everything.
_LOWEST, _HIGHEST = 1e-30, 1e30
_BEYOND = "beyond, it is not certain that"
_NO_THRUST = "commands are not proved to stay within their limits for any error"


def region(problem: Problem, iota: Span | None) -> Region:
    """The largest region that is certified for a law whose conditions hold, every axis pushed.

    `iota` are the values for which the derived conditions of PID control hold together.
    """
    try:
        commands = Commands(problem)
        fault = _holding_fault(commands)
        if fault:
            return _none(fault)
        law = problem.gains.law.id
        return _pd(commands) if law == "pd" else _pid(commands, iota) if law == "pid" else _sliding(commands)
    except UndertowError as error:
        return _none(str(error))
    except np.linalg.LinAlgError:
        return _none("V is not positive at every attitude with digits to spare")


def _none(reason: str) -> Region:
    return Region("none", f"no region: {reason}")


def _holding_fault(commands: Commands) -> str:
    """Why the set-point itself cannot be held, or nothing."""
    steady = commands.steady()
    share = steady / commands.limits
    if not len(share) or share.max() <= 1 - SETTINGS.thrust_reserve:
        return ""
    worst = int(share.argmax())
    return (
        f"holding the set-point asks {steady[worst]:.4g} of {commands.names[worst]}, whose limit is "
        f"{commands.limits[worst]:.4g}, and {SETTINGS.thrust_reserve:.0%} of it have to be left for control"
    )


# --- PD -------------------------------------------------------------------------------------------
def _pd(commands: Commands) -> Region:
    """V = nu' M nu/2 + e' K_P e/2 never rises while angles are in range and damping outweighs its losses."""
    problem = commands.problem
    upper = _tilt_level(problem)
    falling = _largest_level(_damping_outlasts(problem), upper)
    if falling == 0.0:
        return _none("damping at speed is not proved to be positive at any speed")

    def within_limits(level: float) -> bool:
        return bool(np.all(_pd_bounds(commands, level) <= commands.limits))

    thrust = _largest_level(within_limits, min(upper, falling))
    if thrust == 0.0:
        return _none(_NO_THRUST)
    ends = {
        "roll and pitch stay in range": upper,
        "damping stays positive": falling,
        "thrust suffices": thrust,
    }
    return _region_of_level(commands, min(ends.values()), min(ends, key=lambda name: ends[name]))


def _pd_speeds(problem: Problem, level: float) -> Array:
    inverse = np.max([np.diag(np.linalg.inv(m)) for m in inertias(problem.sets)], axis=0)
    return np.asarray(np.sqrt(2 * level * inverse))


def _tilt_level(problem: Problem) -> float:
    """The level of V that keeps roll and pitch within what conditions hold for."""
    angles = set(problem.attitudes.angles(False)) - {"psi"}
    pairs = zip(problem.coordinates, problem.values["K_P"], strict=True)
    return min((0.5 * k * problem.attitudes.tilt**2 for c, k in pairs if c in angles), default=np.inf)


def _pd_bounds(commands: Commands, level: float) -> Array:
    if not len(commands.limits):
        return np.zeros(0)
    return pd_commands(commands, level, _starts(commands.problem, level))


def _damping_outlasts(problem: Problem) -> Callable[[float], bool]:
    """Whether K_V + D(nu) is positive at all speeds that a level of V allows, over all attitudes, proved."""
    fast = _fast_dampings(problem)
    if not any(d.falls for d in fast):
        return lambda level: True  # the conditions at rest are those at any speed
    rest = dampings(problem.sets)
    body = problem.quantities(problem.sets[0], problem.attitudes.at({}), None)
    size = np.sqrt(np.diag(body.K_V) + np.maximum(np.min([np.diag(d) for d in rest], axis=0), 0))
    scale = np.outer(size, size)

    def outlasts(level: float) -> bool:
        speeds = _pd_speeds(problem, level)
        most = max(float(np.linalg.eigvalsh(d.loss(speeds) / scale)[-1]) for d in fast)
        lost = np.diag(max(most, 0.0) * size**2)  # outweighs what damping loses in any sign set
        left = (problem.with_damping(d - lost) for d in rest)
        return all(problem.certificate(DERIVED_PD_DAMPER, one, None).bound > 0 for one in left)

    return outlasts


def _fast_dampings(problem: Problem) -> list[FastDamping]:
    """The bound of damping at speed in every sign set."""
    found = [fast_damping(problem.plant, one) for one in problem.sets]
    known = [d for d in found if d is not None]
    if len(known) < len(found):
        raise UndertowError("damping is no polynomial in velocities and their magnitudes")
    return known


def _largest_level(allowed: Callable[[float], bool], upper: float) -> float:
    """The largest level up to `upper` that is allowed, to a hundredth; zero where hardly any is."""
    if allowed(min(upper, _HIGHEST)):
        return upper
    low, high = np.log(_LOWEST), np.log(min(upper, _HIGHEST))
    if not allowed(_LOWEST):
        return 0.0
    while high - low > 0.01:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if allowed(float(np.exp(middle))) else (low, middle)
    return float(np.exp(low))


def _region_of_level(commands: Commands, level: float, ends: str) -> Region:
    problem = commands.problem
    if level >= _HIGHEST:
        return Region("everywhere", "everywhere: V falls at any speed, from any error (half a turn aside)")
    reach = _starts(problem, level)
    speeds = _by_velocity(problem, _pd_speeds(problem, level))
    text = f"motions that begin with V < {level:.4g} stay there and come to rest ({_BEYOND} {ends})"
    asked = commands.result(_pd_bounds(commands, level))
    return _bounded(problem, Region("level", text, level, reach, speeds, commands=asked))


def _bounded(problem: Problem, found: Region) -> Region:
    """A region with the starts that it allows, or none where these are too small to be one."""
    starts = found.errors if found.level is None else _starts(problem, found.level)
    smallest = min(starts, key=lambda c: starts[c])
    if starts[smallest] < SETTINGS.smallest_error:
        return _none(
            f"it would end at {starts[smallest]:.2g} {_unit(smallest)} in {smallest}, and below "
            f"{SETTINGS.smallest_error:g} it is none"
        )
    gated = problem.gains.schedule.order == "yaw-first"
    text = found.text + ("; counted from when the heading has come within its gate" if gated else "")
    return replace(found, starts=dict(starts), text=text)


def _starts(problem: Problem, level: float) -> dict[str, float]:
    """Largest error of each coordinate alone, at rest and with integrals at zero, with V below a level."""
    pairs = zip(problem.coordinates, problem.values["K_P"], strict=True)
    return {c: float(np.sqrt(2 * level / k)) for c, k in pairs}


# --- PID ------------------------------------------------------------------------------------------
def _pid(commands: Commands, iota: Span | None) -> Region:
    """Where the terms of third order in V_dot are outweighed by the others, at sampled attitudes.

    Two terms of V_dot are of third order: iota nu' H(q~) nu, in body axes and linear in the error, and
    iota q~' J^-T (D(nu) - D(0)) nu. Both are outweighed where iota sum |q~_i| c_i < 1 with c_i the largest
    eigenvalue of what belongs to |q~_i| relative to what the quadratic form leaves for the velocities (its
    Schur complement). The c_i are maxima over sign sets and over sampled attitudes. Where damping grows
    faster than in proportion, or falls with speed, they are those for the speeds that the level allows.
    """
    problem = commands.problem
    if iota is None:
        return _none("no ι satisfies the derived conditions together")
    places = _Places(commands, inside(iota), _fast_dampings(problem))
    falling = places.level()
    level = _largest_level(lambda level: bool(np.all(places.bounds(level) <= commands.limits)), falling)
    if level == 0.0:
        return _none(_NO_THRUST)
    return _estimate(places, level, "thrust suffices" if level < falling else "V falls")


def _estimate(places: _Places, level: float, ends: str) -> Region:
    problem = places.problem
    if level >= _HIGHEST:
        return Region("everywhere", "everywhere: inertia and damping are constant", iota=places.iota)
    weights, lost = places.weights(level)
    pairs = zip(problem.coordinates, weights, strict=True)
    shares = {c: (1.0 - lost) / (places.iota * w) for c, w in pairs if w > 1e-12}
    bounds = " + ".join(f"|q~_{c}|/{limit:.4g} {_unit(c)}" for c, limit in shares.items()) or "0"
    claim = (
        f"an estimate at sampled attitudes: V_dot < 0 where {bounds} < 1 at ι = {places.iota:.4g} 1/s"
        f"{places.proviso(level)}; motions that begin with V < {level:.4g} stay there and come to rest "
        f"({_BEYOND} {ends})"
    )
    asked = places.commands.result(places.bounds(level))
    errors, speeds = places.reach(level), places.fastest(level)
    found = Region("level", claim, level, errors, speeds, commands=asked, iota=places.iota, proved=False)
    return _bounded(problem, found)


def _unit(coordinate: str) -> str:
    return "rad" if coordinate in ANGLES else "m"


def _by_coordinate(problem: Problem, values: Array) -> dict[str, float]:
    return dict(zip(problem.coordinates, map(float, values), strict=True))


def _by_velocity(problem: Problem, values: Array) -> dict[str, float]:
    return dict(zip(problem.plant.vehicle.velocity_names, map(float, values), strict=True))


class _Place(NamedTuple):
    """One sign set at one attitude, velocities in the body frame."""

    left: Array  # what the quadratic form leaves for the velocities
    H: Array  # the forms of third order of the inertia for each coordinate, shape (n, n, n)
    inverse: Array  # J^-1
    damping: FastDamping
    spring: Array  # what V leaves for the error: V >= q~' spring q~/2
    mass: Array  # what V leaves for the velocities: V >= nu' mass nu/2
    form: Array  # V = z' form z/2 in z = (q_dot, q~, integral)


class _Places:
    """All sign sets at sampled attitudes."""

    def __init__(self, commands: Commands, iota: float, damping: list[FastDamping]) -> None:
        self.commands, self.problem, self.iota = commands, commands.problem, iota
        problem = self.problem
        self._places = [
            _place(problem, one, own, third, iota, *attitude)
            for one, own in zip(problem.sets, damping, strict=True)  # C mixes what belongs to several
            for third in (_ThirdOrder(problem.plant, one),)
            for attitude in problem.sampled
        ]
        # Of positive matrices that are alike over many attitudes a few decide.
        self._reach = np.max([np.abs(np.linalg.inv(p.spring)) for p in self._places], axis=0)
        self._speeds = np.max([np.sqrt(np.diag(np.linalg.inv(p.mass))) for p in self._places], axis=0)
        self._bent = any(d.falls or d.depends_on_speed for d in damping)
        self._moves = np.max(
            [per_root_of_level(commands, p.form, inverse_of(p.inverse)) for p in self._places],
            axis=0,
        )

    def weights(self, level: float) -> tuple[Array, float]:
        """c_i for each coordinate while V < level, and the share of the left side that damping takes."""
        speeds = np.sqrt(2 * level) * self._speeds if self._bent else self._speeds
        found = [_sizes(p, speeds) for p in self._places]
        return np.max([w for w, _ in found], axis=0), max(lost for _, lost in found)

    def reach(self, level: float) -> dict[str, float]:
        """Largest error of each coordinate while V < level, m and rad."""
        return _by_coordinate(self.problem, np.sqrt(2 * level * np.diag(self._reach)))

    def fastest(self, level: float) -> dict[str, float]:
        """Largest velocities while V < level, m/s and rad/s."""
        return _by_velocity(self.problem, np.sqrt(2 * level) * self._speeds)

    def bounds(self, level: float) -> Array:
        """Bound on the magnitude of each command while V < level, shape (m,)."""
        if not len(self.commands.limits):
            return np.zeros(0)
        rest = self.commands.at_rest(self.problem.attitudes.boxes(self.reach(level)))
        return np.asarray(rest + np.sqrt(level) * self._moves)

    def level(self) -> float:
        """The largest level of V within which V_dot is negative and angles stay in range.

        That is half a turn for the heading, beyond which V jumps, and the range of the conditions for roll
        and pitch.
        """
        angles = {c: np.pi if c == "psi" else self.problem.attitudes.tilt for c in ANGLES}
        pairs = zip(self.problem.coordinates, np.diag(self._reach), strict=True)
        highest = min((angles[c] ** 2 / (2 * r) for c, r in pairs if c in angles), default=np.inf)

        def excess(logarithm: float) -> float:
            weights, lost = self.weights(np.exp(logarithm))
            error = np.sqrt(2 * np.exp(logarithm) * float(weights @ self._reach @ weights))
            return float(np.log(max(self.iota * error + lost, 1e-300)))

        ends = np.log(_LOWEST), np.log(min(highest, _HIGHEST))
        if excess(ends[1]) < 0:
            return float(highest)
        if not self._bent:
            return float(np.exp(ends[1] - 2 * excess(ends[1])))
        return float(np.exp(brentq(excess, *ends, xtol=1e-9) - 1e-9))

    def proviso(self, level: float) -> str:
        """The bound on speeds that the weights count on, if they do."""
        return f" and V < {level:.4g}" if self._bent else ""


def _sizes(place: _Place, speeds: Array) -> tuple[Array, float]:
    root = np.linalg.inv(np.linalg.cholesky(place.left))
    scale = 1 / np.sqrt(np.diag(place.left))
    # Forms in |nu| are compared with a diagonal matrix below the left side.
    least_left = float(np.linalg.eigvalsh(place.left * np.outer(scale, scale))[0])

    def size(form: Array) -> float:
        scaled = form * np.outer(scale, scale)
        return float(np.linalg.eigvalsh(0.5 * (scaled + scaled.T))[-1]) / least_left

    T = place.damping.shares(speeds)
    weights = [
        np.abs(np.linalg.eigvalsh(root @ H @ root.T)).max() + size(np.einsum("l,lkj->kj", np.abs(b), T))
        for H, b in zip(place.H, place.inverse.T, strict=True)
    ]
    return np.array(weights), size(place.damping.loss(speeds)) if place.damping.falls else 0.0


def _place(
    problem: Problem,
    one: SignSet,
    damping: FastDamping,
    third: _ThirdOrder,
    iota: float,
    values: dict[str, float],
    inverse: Array,
) -> _Place:
    s = problem.quantities(one, inverse, iota)
    K = s.K_V + s.D
    rest = 0.5 * (K + K.T) - iota * s.M
    cross = iota * K / 2
    left = rest - cross.T @ np.linalg.solve(iota * s.K_P - s.K_I, cross)
    stiff = s.K_P - s.K_I / iota
    mass = s.M - iota**2 * s.M @ np.linalg.solve(stiff, s.M)
    J, none = np.linalg.inv(inverse), np.zeros_like(s.M)
    spring = stiff - iota**2 * s.M
    form = np.block([[s.M, -iota * s.M, none], [-iota * s.M, s.K_P, s.K_I], [none, s.K_I, iota * s.K_I]])
    return _Place(J.T @ left @ J, third(values), inverse, damping, spring, J.T @ mass @ J, form)


class _ThirdOrder:
    """All H_i at an attitude: symmetric matrices of nu' (C - M J^-1 J_dot) J^-1 q~ for q~ along i."""

    def __init__(self, plant: Plant, one: SignSet) -> None:
        moving = plant.C - plant.M * plant.J_inverse * plant.J_dot
        whole = (plant.one_way(moving, one.way) * plant.J_inverse).xreplace(plant.numbers)
        forms = [_hessian((plant.nu.T * whole[:, i])[0], plant.nu).tolist() for i in range(len(plant.nu))]
        self._function = function_of([symbol(a) for a in ANGLES], forms)

    def __call__(self, values: dict[str, float]) -> Array:
        return np.array(self._function(*(values.get(a, 0.0) for a in ANGLES)), dtype=float)


def _hessian(form: sm.Expr, nu: sm.Matrix) -> sm.Matrix:
    """Half the second derivative in the velocities, of which the form is quadratic."""
    return sm.Matrix([form]).jacobian(nu).T.jacobian(nu) / 2


# --- sliding modes --------------------------------------------------------------------------------
def _sliding(commands: Commands) -> Region:
    """The largest box of errors and surfaces, which is invariant, whose commands the thrusters can give."""
    problem = commands.problem
    tilted = set(problem.attitudes.angles(False)) - {"psi"}
    caps = dict.fromkeys(tilted, problem.attitudes.tilt) | {"psi": np.pi}
    largest_box = np.array([caps.get(c, np.inf) for c in problem.coordinates])
    if not len(commands.limits) and not tilted:
        return Region("everywhere", "everywhere: S falls at any speed, from any error (half a turn aside)")
    bounds = SlidingCommands(commands)

    def allowed(scale: float) -> bool:
        return bool(np.all(bounds.bounds(np.minimum(scale, largest_box)) <= commands.limits))

    scale = SETTINGS.largest_error
    if len(commands.limits):
        scale = _largest_level(allowed, scale)
    if scale == 0.0:
        return _none(_NO_THRUST)
    box = np.minimum(scale, largest_box)
    largest = bounds.bounds(box) if len(commands.limits) else np.zeros(0)
    claim = (
        "motions that begin with |q~_i| within these errors and |S_i| < Lambda_i times them stay there and "
        f"come to rest ({_BEYOND} {'thrust suffices' if len(largest) else 'roll and pitch stay in range'})"
    )
    errors, speeds = _by_coordinate(problem, box), _by_velocity(problem, bounds.speeds(box))
    return _bounded(problem, Region("level", claim, None, errors, speeds, commands=commands.result(largest)))
