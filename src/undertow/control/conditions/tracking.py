"""Conditions for the error on a mission: of the law on a reference that moves, and of the loop on legs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any

import casadi as ca
import numpy as np
import sympy as sm

from undertow.control.closed_loop.parts import Parts
from undertow.control.closed_loop.simulate import Choices
from undertow.control.closed_loop.stepping import sample_of
from undertow.control.controller import GATE, Controller
from undertow.control.gains import GainSet
from undertow.control.guidance.line_of_sight import LineOfSight
from undertow.control.guidance.mission import Mission
from undertow.control.guidance.reference import TimedReference
from undertow.control.laws import JUMPING
from undertow.model.composition import function_of
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .attitude import least
from .by_law import CONDITIONS, DERIVED_PD_DAMPER, POSITIVE_CANDIDATE, Condition
from .problem import Problem
from .result import FAILS, HOLDS, SETTINGS, UNPROVED


@dataclass(frozen=True)
class TrackingSettings:
    """The numbers that decide on missions."""

    # Velocities up to this multiple of the limits of the mission are covered: the reference, and as much
    # of error.
    reach: float = 2.0
    iotas: int = 12  # values of iota that are tried in the range which serves a set-point
    samples: int = 400  # times at which the commands on the reference are looked at
    dt: float = 0.02  # sampling interval of the loop on legs, s: what autopilots have
    # A leg is followed for so many times the slowest of lookahead / speed and lookahead / integral, so that
    # what is left of the start is below `still` of it.
    lasts: float = 30.0
    longest: float = 2000.0  # s, at most
    still: float = 1e-6  # change in a second that counts as steady, m, rad, m/s and rad/s


TRACKING = TrackingSettings()


@dataclass(frozen=True)
class MissionRow:
    """One condition on a mission."""

    condition: str
    statement: str
    about: str  # what follows from it, and what it assumes
    source: str
    margin: float  # above zero where it holds
    verdict: str  # HOLDS, FAILS or UNPROVED
    where: str = ""


@dataclass(frozen=True)
class MissionReport:
    """What is known of a gain set on a mission."""

    vehicle: str
    gains: str
    law: str
    mission: str
    kind: str
    rows: tuple[MissionRow, ...]
    not_covered: Mapping[str, str]  # effects that no condition knows; on legs all are in the loop

    @property
    def ok(self) -> bool:
        """Whether every condition holds."""
        return all(r.verdict == HOLDS for r in self.rows)


def check_mission(gains: GainSet, mission: Mission, tilt: float = np.pi / 3) -> MissionReport:
    """Check the conditions for the tracking error of a mission, without simulating it.

    Parameters
    ----------
    gains : GainSet
        Law, numbers and vehicle.
    mission : Mission
        What is followed.
    tilt : float
        Largest roll and pitch that conditions on a reference cover, rad.

    Raises
    ------
    UndertowError
        If the vehicle cannot follow the mission.
    """
    reference = mission.reference(gains)
    if isinstance(reference, TimedReference):
        rows = [*_law_rows(gains, mission, tilt), _command_row(gains, reference)]
    else:
        assert isinstance(reference, LineOfSight)
        rows = list(_leg_rows(gains, mission, reference))
    plant = gains.plant
    return MissionReport(
        plant.vehicle.name,
        gains.name,
        gains.law.id,
        mission.name,
        mission.kind,
        tuple(rows),
        plant.left_out if isinstance(reference, TimedReference) else {},
    )


# --- laws on a reference over time ----------------------------------------------------------------
_SOURCE = "derived here along the closed loop with the error of a reference that moves"
_BOUNDED = "It assumes a reference of bounded speed and acceleration, and the exact model."
_PD = (
    "V = nu_e' M nu_e/2 + e' K_P e/2 with nu_e = nu_r - nu has V_dot = -nu_e' (D(nu) + J' K_V J) nu_e, "
    "because C(nu) is skew; nu_e, and then e, go to zero."
)
_PID = (
    "V of the set-point with its error measured from the reference; V_dot has iota e_dot' C_q e besides, so "
    "that Q = [[iota K_P - K_I, iota (K - C_q')/2], [., K - iota M_q]] with K = K_V + D_q."
)
_SLIDING = "S = J nu_e + Lambda e obeys the same S_dot as at a set-point, whatever the reference."


def _law_rows(gains: GainSet, mission: Mission, tilt: float) -> Iterator[MissionRow]:
    problem = Problem(gains, tilt)
    derived = [c for c in CONDITIONS[gains.law.id] if c.form == "derived" and not c.uses and not c.uses_iota]
    about = f"{_SLIDING if gains.law.id not in ('pd', 'pid') else ''} {_BOUNDED}".strip()
    for condition in derived:
        yield _plain_row(problem, condition, f"{condition.about} {about}")
    if any(v in gains.plant.M.free_symbols for v in gains.plant.reversing):
        yield _reversing_row(gains)
    if gains.law.id in ("pd", "pid"):
        rule = _pd_row if gains.law.id == "pd" else _pid_row
        yield rule(problem, mission)


def _plain_row(problem: Problem, condition: Condition, about: str) -> MissionRow:
    margin = problem.margin(condition, problem.sets[0], None)
    return _row(condition.id, condition.matrices, about, margin, margin > 0, "gains alone")


def _reversing_row(gains: GainSet) -> MissionRow:
    names = ", ".join(map(str, gains.plant.reversing))
    return MissionRow(
        "M",
        "M does not change along the motion",
        "V is continuous only while M keeps one set of parameters.",
        _SOURCE,
        0.0,
        UNPROVED,
        f"M changes with the sign of {names}: V may jump where it does",
    )


def _row(
    name: str, statement: str, about: str, found: float, proved: bool, where: str, source: str = _SOURCE
) -> MissionRow:
    verdict = HOLDS if found > 0 and proved else UNPROVED if found > 0 else FAILS
    return MissionRow(name, statement, about, source, float(found), verdict, where)


def speeds(problem: Problem, mission: Mission) -> Array:
    """Velocities that are covered, shape (n,), m/s and rad/s."""
    own = problem.plant.vehicle.dof_indices
    limits = mission.limits
    return TRACKING.reach * np.array([limits.speed if i < 3 else limits.turn_rate for i in own])


def _pd_row(problem: Problem, mission: Mission) -> MissionRow:
    most = speeds(problem, mission)
    matrices, affine = damping_corners(problem, most)
    sets = [problem.with_damping(d) for d in _lowest(matrices)]

    def margins(inverse: Any) -> Array:
        found = [DERIVED_PD_DAMPER.margin(problem.quantities(one, inverse, None)) for one in sets]
        return np.broadcast_to(np.min(found, axis=0), len(inverse))

    certificate = least(margins, problem.attitudes, problem.turned)
    where = f"{_covered(problem, most)}; {certificate.proof}"
    if not affine:
        where += "; damping is no straight line in each velocity, so that corners are samples"
    statement = "K_V + D_q(nu) ≻ 0"
    proved = affine and certificate.bound > 0
    return _row("K_V + D", statement, f"{_PD} {_BOUNDED}", certificate.found, proved, where)


def _pid_row(problem: Problem, mission: Mission) -> MissionRow:
    most = speeds(problem, mission)
    one = problem.sets[0]
    span = problem.iota([POSITIVE_CANDIDATE], [one])
    places = problem.sampled[:: max(1, len(problem.sampled) // 8)]
    if span is None:
        return _row("V_dot", "Q(iota, nu) ≻ 0", _PID, -1.0, False, "V is positive for no iota")
    D, affine = damping_corners(problem, most)
    nu = np.array(
        list(product(*((-m, m) for m in most)))
    )  # C is linear in nu, and Q affine: corners are enough
    low, high = max(span[0], 1e-6), min(span[1], 1e6)
    iotas = np.geomspace(low, high, TRACKING.iotas + 2)[1:-1]
    J_inverse = function_of(list(problem.plant.eta), problem.plant.J_inverse.tolist())
    cases = []
    for angles, _ in places:
        inverse = np.array(J_inverse(*_pose(problem, angles)), dtype=float)
        cases.append((inverse, _coriolis(problem, angles, nu)))
    found = [min(_pid_margin(problem, i, case, _lowest(D)) for case in cases) for i in iotas]
    best = int(np.argmax(found))
    single = len(problem.sampled) == 1
    where = f"{_covered(problem, most)}; iota = {iotas[best]:.4g} 1/s" + (
        "" if single else f"; at {len(places)} sampled attitudes, which is no proof for all"
    )
    return _row("V_dot", "Q(iota, nu) ≻ 0", f"{_PID} {_BOUNDED}", found[best], single and affine, where)


def _pose(problem: Problem, angles: Mapping[str, float]) -> list[float]:
    return [angles.get(str(q), 0.0) for q in problem.plant.eta]


def _pid_margin(problem: Problem, iota: float, case: tuple[Array, Array], lowest: Array) -> float:
    """Least eigenvalue of Q over the corners of the velocities, for C and D apart: both are affine."""
    inverse, coriolis = case
    own, one = problem.driven, problem.sets[0]
    s = problem.quantities(one, inverse, iota)
    columns = inverse[:, own]
    C = coriolis[:, own][:, :, own]
    least_of = []
    for d in lowest:
        K = s.K_V + columns.T @ d @ columns
        cross = iota * (K - np.swapaxes(C, 1, 2)) / 2
        upper = np.broadcast_to(iota * s.K_P - s.K_I, C.shape)
        lower = np.broadcast_to(K - iota * s.M, C.shape)
        Q = np.block([[upper, cross], [np.swapaxes(cross, 1, 2), lower]])
        least_of.append(np.linalg.eigvalsh(0.5 * (Q + np.swapaxes(Q, 1, 2)))[:, 0].min())
    return float(min(least_of))


def _coriolis(problem: Problem, angles: Mapping[str, float], nu: Array) -> Array:
    """C_q at an attitude for velocities, shape (k, n, n); linear in them, so that its slopes are enough."""
    plant = problem.plant
    pose, n = _pose(problem, angles), len(plant.nu)
    known = [*plant.eta, *plant.nu]
    J_inverse, J_dot, C = (
        function_of(known, m.xreplace(dict(plant.numbers)).tolist())
        for m in (plant.J_inverse, plant.J_dot, plant.C)
    )
    M = problem.sets[0].inertia
    slopes = []
    for unit in np.eye(n):
        inverse, J_rate, own = (np.array(f(*pose, *unit), dtype=float) for f in (J_inverse, J_dot, C))
        slopes.append(inverse.T @ (own - M @ inverse @ J_rate) @ inverse)
    return np.einsum("kv,vij->kij", nu, np.array(slopes))


def damping_corners(problem: Problem, most: Array) -> tuple[Array, bool]:
    """D at the corners of |nu| <= most with each choice of signs, shape (k, n, n), and whether that is all.

    With the signs of the velocities fixed, the usual drag is affine in nu; then the least eigenvalue of its
    symmetric part is concave, and over the box it is least at a corner.
    """
    plant = problem.plant
    D = plant.D.xreplace(dict(plant.numbers))
    moving = [i for i, v in enumerate(plant.nu) if v in D.free_symbols]
    affine, found = True, []
    for signs in product((1, -1), repeat=len(moving)):
        way = {plant.nu[i]: s for i, s in zip(moving, signs, strict=True)}
        own = D.xreplace(
            {sm.Abs(v): s * v for v, s in way.items()} | {sm.sign(v): sm.Integer(s) for v, s in way.items()}
        )
        affine = affine and all(
            own.diff(v).applyfunc(sm.expand).free_symbols.isdisjoint(plant.nu) for v in way
        )
        function = function_of(list(way), own.tolist())
        for share in product((0.0, 1.0), repeat=len(moving)):
            nu = [s * x * most[i] for s, x, i in zip(signs, share, moving, strict=True)]
            found.append(np.array(function(*nu), dtype=float))
    return np.unique(np.array(found), axis=0), affine


def _lowest(matrices: Array) -> Array:
    """Those whose symmetric part is not above that of another one: the others decide nothing."""
    symmetric = 0.5 * (matrices + np.swapaxes(matrices, 1, 2))
    symmetric = np.unique(symmetric.round(12), axis=0)
    kept: list[Array] = []
    for one in sorted(symmetric, key=lambda m: float(np.trace(m))):
        if all(np.linalg.eigvalsh(one - other)[0] < -1e-12 for other in kept):
            kept.append(one)
    return np.array(kept)


def _covered(problem: Problem, most: Array) -> str:
    pairs = zip(problem.plant.nu, most, strict=True)
    return "velocities up to " + ", ".join(f"|{v}| = {m:.3g}" for v, m in pairs)


def _command_row(gains: GainSet, reference: TimedReference) -> MissionRow:
    """The part of the limit of each thruster that the reference itself asks for, with no error."""
    controller = Controller(gains, reference)
    limits, profile = controller.allocation.limits, reference.profile
    share = controller.allocation.share
    t = np.unique(np.concatenate([np.linspace(0, profile.duration, TRACKING.samples), profile.knots]))
    force = _on_reference(controller, profile.at(t), profile.at(t, 1), t)
    commands = np.abs(force @ share.T)
    parts = commands / limits
    i, j = np.unravel_index(int(np.argmax(parts)), parts.shape)
    name, most = controller.command_names[j], float(parts[i, j])
    where = f"{name} has {commands[i, j]:.4g} of {limits[j]:.4g} at t = {t[i]:.4g} s"
    return MissionRow(
        "commands",
        f"commands on the reference < {1 - SETTINGS.thrust_reserve:.0%} of their limits",
        "Beyond a limit the error grows, whatever the gains; the rest is for disturbances.",
        f"feed-forward of the model at {len(t)} times",
        1 - SETTINGS.thrust_reserve - most,
        HOLDS if most < 1 - SETTINGS.thrust_reserve else FAILS,
        where if np.isfinite(limits).any() else "no command has a limit",
    )


def _on_reference(controller: Controller, poses: Array, rates: Array, t: Array) -> Array:
    """Force that the law asks for where the vehicle is exactly on its reference, shape (k, n)."""
    plant = controller.gains.plant
    kinematics = function_of(list(plant.eta), plant.J_inverse.tolist())
    numbers, gains = controller.mission_numbers, controller.gain_values()
    place = controller.state_names.index("mission_time")
    forces = []
    for pose, rate, now in zip(poses, rates, t, strict=True):
        nu = np.asarray(kinematics(*pose), dtype=float) @ rate
        s = np.array(controller.initial_states())
        s[place] = now
        tau = controller.continuous(np.concatenate([pose, nu]), numbers, s, gains)[2]
        forces.append(np.asarray(tau).ravel())
    return np.array(forces)


# --- straight legs ----------------------------------------------------------------------------
_DISCRETE = ("leg", "arrived", "started", GATE)


def _leg_rows(gains: GainSet, mission: Mission, reference: LineOfSight) -> Iterator[MissionRow]:
    """The vehicle makes way against the current, and the whole loop is stable on every leg."""
    water = float(np.hypot(*(mission.current or (0.0, 0.0))))
    speed = mission.limits.speed
    yield _row(
        "current", "speed > current", "A slower vehicle has no heading that keeps it on every leg.",
        speed - water, True, f"{speed:.4g} m/s against {water:.4g} m/s", "kinematics",
    )  # fmt: skip
    if gains.law.id in JUMPING:
        yield _jumping_row(gains)
        return
    vehicle = Choices(current=mission.current).in_current(gains.plant.vehicle)
    steps = np.diff(mission.points, axis=0)
    alike: dict[tuple[float, ...], list[int]] = {}  # legs by their direction, by which their poles differ
    for number, step in enumerate(steps, 1):
        alike.setdefault(tuple((step / np.linalg.norm(step)).round(4)), []).append(number)
    for numbers in alike.values():
        yield _leg_row(gains, vehicle, mission, reference, numbers)


def _jumping_row(gains: GainSet) -> MissionRow:
    return MissionRow(
        "legs",
        "all poles on every leg decay",
        "A discontinuous law has no linearisation on its surface, and sampled no steady motion either.",
        "linearisation",
        0.0,
        UNPROVED,
        f"law '{gains.law.id}' is discontinuous: simulate it, or use 'sliding-mode-boundary-layer'",
    )


def _leg_row(
    gains: GainSet, vehicle: Vehicle, mission: Mission, reference: LineOfSight, numbers: list[int]
) -> MissionRow:
    """Poles of vehicle, autopilot and guidance together on a leg without end, for all of its direction."""
    far = 10 * TRACKING.longest * mission.limits.speed
    begin, end = mission.points[numbers[0] - 1 : numbers[0] + 1]
    way = (end - begin) / np.linalg.norm(end - begin)
    leg = f"leg{'s' * (len(numbers) > 1)} {', '.join(map(str, numbers))}"
    endless = LineOfSight(
        reference.names,
        np.array([begin, begin + far * way]),
        mission.limits,
        mission.guidance,
        reference.pitches,
        reference.unheld,
    )
    parts = Parts(vehicle, Controller(gains, endless))
    step, names = _sample(parts)
    state, change = _steady(parts, mission, endless, step)
    statement = f"all poles on {leg} decay"
    about = (
        "Vehicle, autopilot and line of sight, linearised at their steady motion along the leg in the "
        "current of the mission: small errors die out. It says nothing of turns and of limits that are met."
    )
    if not change <= TRACKING.still:
        text = f"no steady motion was found: it still changes by {change:.3g} in a second"
        return MissionRow(leg, statement, about, "linearisation", -change, FAILS, text)
    slope = _along_the_leg(np.asarray(step.factory("A", ["z"], ["jac:after:z"])(state)), names, way)
    kept = _that_count(slope, names, vehicle)
    poles = np.log(np.linalg.eigvals(slope[np.ix_(kept, kept)]).astype(complex)) / TRACKING.dt
    slowest = poles[int(np.argmax(poles.real))]
    where = f"the slowest is {slowest.real:.4g} ± {abs(slowest.imag):.4g}i 1/s"
    margin = -float(slowest.real) - SETTINGS.slowest
    return _row(leg, statement, about, margin, True, where, "linearisation of the sampled loop")


def _sample(parts: Parts) -> tuple[ca.Function, list[str]]:
    """One sample of the loop as a map of its states, and their names."""
    f, control = parts.functions, parts.control
    nx, nu = f.x.numel(), f.u.numel()
    z = ca.MX.sym("z", nx + control.size1_in("s"))
    still, seen = ca.DM.zeros(nu), ca.DM.zeros(len(parts.reported_names))
    given = (still, seen, 0, 0, 0, parts.parameters, parts.controller.mission_numbers, parts.gains)
    x, s, *_ = sample_of(parts, TRACKING.dt)(z[:nx], z[nx:], still, *given)
    names = [*f.state_names, *parts.controller.state_names]
    return ca.Function("step", [z], [ca.vertcat(x, s)], ["z"], ["after"]).expand(), names


def _steady(parts: Parts, mission: Mission, reference: LineOfSight, step: ca.Function) -> tuple[Array, float]:
    """The state after a long way along the leg, and how much what counts still changes in a second."""
    guidance, speed = mission.guidance, mission.limits.speed
    slow = max(
        guidance.lookahead / speed, guidance.lookahead / guidance.integral if guidance.integral else 0.0
    )
    count = int(min(TRACKING.lasts * slow, TRACKING.longest) / TRACKING.dt)
    names = parts.vehicle.pose_names
    known = dict(zip(reference.names, reference.start, strict=True))
    start = np.array([known.get(n, 0.0) for n in names] + [0.0] * len(names))
    start[len(names) + names.index("x")] = speed
    x = parts.at_rest(start[None], parts.parameters[None])[0]
    z = np.concatenate([x, parts.controller.initial_states()])
    second = round(1 / TRACKING.dt)
    far = step.mapaccum("far", max(count - second, 1))
    with np.errstate(all="ignore"):
        before = np.asarray(far(z))[:, -1]
        after = np.asarray(step.mapaccum("second", second)(before))[:, -1]
    own = slice(len(names), 2 * len(names))  # velocities
    angles = [i for i, n in enumerate(names) if n in ("phi", "theta", "psi")]
    change = np.abs(after - before)
    found = float(max(change[own].max(), change[angles].max(initial=0.0)))
    return after, found if np.isfinite(found) else np.inf


def _along_the_leg(slope: Array, names: list[str], way: Array) -> Array:
    """The map in the way along the leg, to starboard of it and below it, in place of x, y and z."""
    flat = float(np.hypot(way[0], way[1]))
    c, s, sink = way[0] / flat, way[1] / flat, way[2] / flat
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [-sink * c, -sink * s, 1.0]])
    own = [i for i, n in enumerate("xyz") if n in names]
    places = [names.index("xyz"[i]) for i in own]
    whole = np.eye(len(slope))
    whole[np.ix_(places, places)] = turn[np.ix_(own, own)]
    return np.asarray(whole @ slope @ np.linalg.inv(whole))


def _that_count(slope: Array, names: list[str], vehicle: Vehicle) -> list[int]:
    """States that act on pose or velocity, but for the way along the leg, in place of x, which is free."""
    poses = vehicle.pose_names
    count = {i for i, n in enumerate(names) if n in (*poses, *vehicle.velocity_names) and n != "x"}
    # What nothing drives has no pole: integrals of errors that are zero by the guidance.
    idle = set(map(int, np.flatnonzero((np.abs(slope - np.eye(len(slope))) < 1e-12).all(axis=1))))
    fixed = idle | {names.index(n) for n in _DISCRETE}
    while True:
        more = {int(j) for i in count for j in np.flatnonzero(np.abs(slope[i]) > 1e-12)} - fixed - {0}
        if more <= count:
            return sorted(count - fixed)
        count |= more
