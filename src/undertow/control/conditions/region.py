"""The certified region: where V falls, attitudes stay in range and commands within their limits."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np
import sympy as sm

from undertow.errors import UndertowError
from undertow.model.parameter import printed
from undertow.model.units import si_of
from undertow.typing import Array

from .attitude import ANGLES
from .by_law import DERIVED_PD_DAMPER
from .commands import Commands, SlidingCommands, damping_loss, dampings, inertias, pd_commands
from .problem import Problem, Span
from .program import SETTINGS as PROGRAM
from .quadratic import QuadraticSearch
from .result import SETTINGS, Quadratic, Region, Transient
from .transient import bounds_in_time

_BEYOND = "beyond, it is not certain that"
_FAILS = "the conditions derived from the model do not hold"
_NOTHING_FOUND = (
    "no quadratic V was found that falls and holds the start within all limits, nor bounds in time that the "
    "couplings between the axes leave closed"
)
_NO_THRUST = "commands are not proved to stay within their limits for any error"


def region(problem: Problem, holds: bool, start: Mapping[str, float] | None = None) -> Region:
    """The largest region that is certified for a law, every axis pushed.

    `holds` says whether the conditions derived from the model hold: where they do not, a quadratic V is
    searched for. `start` are the largest errors to begin with, m and rad, at rest with integrals at zero: a
    box that the region has to hold. Without it the largest of some usual boxes is taken.
    """
    try:
        found = _region(problem, holds, start)
    except UndertowError as error:
        found = _no_region(str(error))
    except np.linalg.LinAlgError:
        found = _no_region("V is not positive at every attitude by more than rounding")
    vehicle, parameters = problem.plant.vehicle, dict[str, Span]()
    for symbol, ends in problem.parameter_box.items():
        declared = vehicle.declaration(str(symbol))
        low, high = sorted(printed(declared, e, vehicle.signs) for e in ends)
        parameters[str(symbol)] = low, high
    note = "" if found.kind == "none" else _gate_note(problem)
    found = replace(found, text=found.text + note, parameters=parameters)
    if start is None:
        return found
    return replace(found, start=dict(start), contains_start=_contains(problem, found, start))


def _parameters(problem: Problem) -> str:
    """For which parameters something is proved, in words."""
    if not problem.parameter_box:
        return "with parameters as in the file, not over their intervals"
    return "and every value of the uncertain parameters in their intervals"


def _region(problem: Problem, holds: bool, start: Mapping[str, float] | None) -> Region:
    commands, law = Commands(problem), problem.gains.law.id
    fault = _setpoint_fault(commands)
    if fault:
        return _no_region(fault)
    if law not in ("pd", "pid"):
        return _sliding(commands) if holds else _no_region(_FAILS)
    if law == "pd" and holds and not problem.parameter_box:
        found = _pd(commands)
        if found.kind != "none" and (start is None or _contains(problem, found, start)):
            return found
        if found.kind != "none" and start is not None:
            return _wider(problem, found, start)
    return _searched_region(problem, start)


def _wider(problem: Problem, found: Region, start: Mapping[str, float]) -> Region:
    """A region of a search that holds a start, or the one found, which does not, where there is none."""
    try:
        searched = _searched_region(problem, start)
    except UndertowError:
        return found
    return found if searched.kind == "none" else searched


def _no_region(reason: str) -> Region:
    return Region("none", f"no region: {reason}")


def _setpoint_fault(commands: Commands) -> str:
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
    # The level of V that keeps roll and pitch within what conditions hold for.
    angles = set(problem.attitudes.angles(False)) - {"psi"}
    pairs = zip(problem.coordinates, problem.values["K_P"], strict=True)
    upper = min((0.5 * k * problem.attitudes.tilt**2 for c, k in pairs if c in angles), default=np.inf)
    falling = _largest_level(_damping_stays_positive(problem), upper)
    if falling == 0.0:
        return _no_region("damping at speed is not proved to be positive at any speed")

    def within_limits(level: float) -> bool:
        return bool(np.all(_pd_bounds(commands, level) <= commands.limits))

    thrust = _largest_level(within_limits, min(upper, falling))
    if thrust == 0.0:
        return _no_region(_NO_THRUST)
    ends = {
        "roll and pitch stay in range": upper,
        "damping stays positive": falling,
        "thrust suffices": thrust,
    }
    return _region_of_level(commands, min(ends.values()), min(ends, key=lambda name: ends[name]))


def _pd_speeds(problem: Problem, level: float) -> Array:
    inverse = np.max([np.diag(np.linalg.inv(m)) for m in inertias(problem.sets)], axis=0)
    return np.asarray(np.sqrt(2 * level * inverse))


def _pd_bounds(commands: Commands, level: float) -> Array:
    if not len(commands.limits):
        return np.zeros(0)
    return pd_commands(commands, level, _starts(commands.problem, level))


def _damping_stays_positive(problem: Problem) -> Callable[[float], bool]:
    """Whether K_V + D(nu) is positive at all speeds that a level of V allows, over all attitudes, proved."""
    losses = [damping_loss(problem.plant, sign_set) for sign_set in problem.sets]
    if not any(d.decreases for d in losses):
        return lambda level: True  # the conditions at rest are those at any speed
    dampings_at_rest = dampings(problem.sets)
    body = problem.quantities(problem.sets[0], problem.attitudes.at({}), None)
    scales = np.sqrt(
        np.diag(body.K_V) + np.maximum(np.min([np.diag(d) for d in dampings_at_rest], axis=0), 0)
    )
    scale = np.outer(scales, scales)

    def stays_positive(level: float) -> bool:
        speeds = _pd_speeds(problem, level)
        largest = max(float(np.linalg.eigvalsh(d.loss(speeds) / scale)[-1]) for d in losses)
        lost = np.diag(max(largest, 0.0) * scales**2)  # outweighs what damping loses in any sign set
        remaining = (problem.with_damping(d - lost) for d in dampings_at_rest)
        return all(problem.certificate(DERIVED_PD_DAMPER, sign_set, None).bound > 0 for sign_set in remaining)

    return stays_positive


def _largest_level(allowed: Callable[[float], bool], upper: float) -> float:
    """The largest level up to `upper` that is allowed, to a hundredth; zero where hardly any is."""
    lowest, highest = SETTINGS.lowest_level, min(upper, SETTINGS.highest_level)
    if allowed(highest):
        return upper
    low, high = np.log(lowest), np.log(highest)
    if not allowed(lowest):
        return 0.0
    while high - low > SETTINGS.level_tolerance:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if allowed(float(np.exp(middle))) else (low, middle)
    return float(np.exp(low))


def _region_of_level(commands: Commands, level: float, ends: str) -> Region:
    problem = commands.problem
    if level >= SETTINGS.highest_level:
        return Region("everywhere", "everywhere: V falls at any speed, from any error (except half a turn)")
    reach = _starts(problem, level)
    speeds = _by_velocity(problem, _pd_speeds(problem, level))
    text = f"motions that begin with V < {level:.4g} stay there and come to rest ({_BEYOND} {ends})"
    largest = commands.result(_pd_bounds(commands, level))
    return _region_or_none(problem, Region("level", text, level, reach, speeds, commands=largest))


def _region_or_none(problem: Problem, found: Region) -> Region:
    """A region with the starts that it allows, or none where these are too small to be one."""
    starts = found.errors if found.level is None else _starts(problem, found.level)
    smallest = min(starts, key=lambda c: starts[c])
    if starts[smallest] < SETTINGS.smallest_error:
        unit = "rad" if smallest in ANGLES else "m"
        return _no_region(
            f"it would end at {starts[smallest]:.2g} {unit} in {smallest}; below "
            f"{SETTINGS.smallest_error:g} it does not count as a region"
        )
    return replace(found, starts=dict(starts))


def _starts(problem: Problem, level: float) -> dict[str, float]:
    """Largest error of each coordinate alone, at rest and with integrals at zero, with V below a level."""
    pairs = zip(problem.coordinates, problem.values["K_P"], strict=True)
    return {c: float(np.sqrt(2 * level / k)) for c, k in pairs}


# --- a quadratic V ----------------------------------------------------------------------------------
def _searched_region(problem: Problem, start: Mapping[str, float] | None) -> Region:
    """What is proved of the start, or of the largest usual start of which something is."""
    reason = _NOTHING_FOUND
    defaults = [dict.fromkeys(problem.coordinates, e) for e in SETTINGS.default_starts]
    for box in [start] if start else defaults:
        try:
            found = _region_of_start(problem, box, start is not None)
        except UndertowError as error:
            if start:
                raise
            reason = str(error)
            continue
        if found is not None:
            return found
    return _no_region(reason)


def _region_of_start(problem: Problem, box: Mapping[str, float], stated: bool) -> Region | None:
    """The level set of a quadratic V, or bounds in time: what is quickest first.

    With many axes there hardly ever is a V, and none where attitudes are in the loop. With few, a smaller
    usual start may have one, which says more than bounds in time; over parameters it takes far longer, too.
    """
    many, in_time = len(problem.coordinates) > PROGRAM.max_full_dofs, partial(_transient_region, problem, box)
    one_identity, all_identities = (
        partial(_quadratic_region, problem, box, every) for every in (False, True)
    )
    searches: list[Callable[[], Region | None]] = [in_time, one_identity]
    if many and not problem.equal_gains(("x", "y", "z")):
        searches = [in_time]
    elif not many and not problem.parameter_box:
        searches = [one_identity, in_time, all_identities] if stated else [one_identity, all_identities]
    refusals: list[UndertowError] = []
    for search in searches:
        try:
            found = search()
        except UndertowError as error:
            refusals.append(error)
            continue
        if found is not None:
            return found
    if refusals:
        raise refusals[0]
    return None


def _quadratic_region(problem: Problem, box: Mapping[str, float], all_identities: bool) -> Region | None:
    found = QuadraticSearch(problem, box, all_identities).run()
    return None if found is None else _of_quadratic(problem, found)


def _transient_region(problem: Problem, box: Mapping[str, float]) -> Region | None:
    found = bounds_in_time(problem, box)
    return None if found is None else _of_transient(problem, box, found)


def _of_transient(problem: Problem, box: Mapping[str, float], found: Transient) -> Region:
    text = (
        "motions that begin at rest in the start box stay within these errors and speeds and come to rest; "
        "bounded in time by variation of constants, all errors within half of these from "
        f"{found.halving_time:.4g} s on; proved in interval arithmetic at every attitude and every motion in "
        f"them, {_parameters(problem)}"
    )
    return Region(
        "box",
        text,
        None,
        _by_coordinate(problem, found.errors.max(axis=0)),
        _by_velocity(problem, found.speeds.max(axis=0)),
        {c: float(box.get(c, 0.0)) for c in problem.coordinates},
        Commands(problem).result(found.commands.max(axis=0)),
        transient=found,
    )


def _of_quadratic(problem: Problem, found: Quadratic) -> Region:
    commands = Commands(problem)
    # Where the loop is the same at any size of motion, what falls in a small box falls everywhere.
    plant = problem.plant
    signs = {sm.sign(v): sm.Integer(1) for v in plant.nu}
    varying = [m.xreplace(signs).free_symbols & set(plant.nu) for m in (plant.M, plant.C, plant.D)]
    if not any(varying) and not set(problem.coordinates) & set(ANGLES) and not len(commands.limits):
        return Region(
            "everywhere",
            "everywhere: inertia and damping do not depend on speed or attitude; V is proved to fall, "
            f"{_parameters(problem)}",
            quadratic=found,
        )
    text = (
        f"motions that begin with V = z' P z < 1 stay there and come to rest; z holds errors and velocities "
        f"in the {found.frame} frame and P is from a semidefinite program; proved by interval arithmetic at "
        f"every attitude and every motion in it, {_parameters(problem)}"
    )
    return Region(
        "level",
        text,
        1.0,
        _by_coordinate(problem, found.errors),
        _by_velocity(problem, found.speeds),
        _by_coordinate(problem, found.starts),
        commands.result(found.commands),
        quadratic=found,
    )


def _gate(problem: Problem) -> float:
    """Error of the heading beyond which x and y wait, rad; infinite where all are driven together."""
    schedule = problem.gains.schedule
    return si_of("[schedule] gate", schedule.gate, "rad") if schedule.order == "yaw-first" else np.inf


def _gate_note(problem: Problem) -> str:
    gate = _gate(problem)
    if gate == np.inf:
        return ""
    return (
        f"; counted from when the heading has come within its gate of {np.degrees(gate):.4g} deg, before "
        "which nothing controls x and y"
    )


def _contains(problem: Problem, found: Region, start: Mapping[str, float]) -> bool:
    """Whether a region holds every corner of a box of errors, at rest and with integrals at zero."""
    if found.kind == "none" or start.get("psi", 0.0) > _gate(problem):
        return False
    if found.by_search:
        return True  # it was searched for so
    angles = {"psi": np.pi} | dict.fromkeys(("phi", "theta"), problem.attitudes.tilt)
    if any(e >= angles.get(c, np.inf) for c, e in start.items()):
        return False
    if found.level is None or "K_P" not in problem.values:
        return all(e < found.errors.get(c, np.inf) for c, e in start.items())
    pairs = zip(problem.coordinates, problem.values["K_P"], strict=True)
    return bool(sum(0.5 * k * start.get(c, 0.0) ** 2 for c, k in pairs) < found.level * (1 - 1e-9))


def _by_coordinate(problem: Problem, values: Array) -> dict[str, float]:
    return dict(zip(problem.coordinates, map(float, values), strict=True))


def _by_velocity(problem: Problem, values: Array) -> dict[str, float]:
    return dict(zip(problem.plant.vehicle.velocity_names, map(float, values), strict=True))


# --- sliding modes --------------------------------------------------------------------------------
def _sliding(commands: Commands) -> Region:
    """The largest box of errors and surfaces, which is invariant, whose commands the thrusters can give."""
    problem = commands.problem
    tilted = set(problem.attitudes.angles(False)) - {"psi"}
    caps = dict.fromkeys(tilted, problem.attitudes.tilt) | {"psi": np.pi}
    largest_box = np.array([caps.get(c, np.inf) for c in problem.coordinates])
    if not len(commands.limits) and not tilted:
        return Region("everywhere", "everywhere: V falls at any speed, from any error (except half a turn)")
    bounds = SlidingCommands(commands)

    def allowed(scale: float) -> bool:
        return bool(np.all(bounds.bounds(np.minimum(scale, largest_box)) <= commands.limits))

    scale = SETTINGS.largest_error
    if len(commands.limits):
        scale = _largest_level(allowed, scale)
    if scale == 0.0:
        return _no_region(_NO_THRUST)
    box = np.minimum(scale, largest_box)
    largest = bounds.bounds(box) if len(commands.limits) else np.zeros(0)
    claim = (
        "motions that begin with |q~_i| within these errors and |S_i| < Lambda_i times them stay there and "
        f"come to rest ({_BEYOND} {'thrust suffices' if len(largest) else 'roll and pitch stay in range'})"
    )
    errors, speeds = _by_coordinate(problem, box), _by_velocity(problem, bounds.speeds(box))
    return _region_or_none(
        problem, Region("level", claim, None, errors, speeds, commands=commands.result(largest))
    )
