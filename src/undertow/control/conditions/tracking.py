"""Conditions for the error on a mission: of the law on a reference that moves, and of the loop on legs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Any

import casadi as ca
import numpy as np

from undertow.control.closed_loop.interconnection import Interconnection
from undertow.control.closed_loop.simulate import Overrides
from undertow.control.closed_loop.stepping import sample_of
from undertow.control.controller import GATE, Controller
from undertow.control.gains import GainSet
from undertow.control.guidance.curves import SplineOfSight
from undertow.control.guidance.line_of_sight import LineOfSight
from undertow.control.guidance.mission import Mission
from undertow.control.guidance.reference import TimedReference
from undertow.control.laws import DISCONTINUOUS, BoundaryLayer, SlidingMode
from undertow.control.plant import Plant
from undertow.errors import UndertowError
from undertow.model.composition import function_of
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Index

from .attitude import (
    Attitudes,
    Certificate,
    block,
    enclose,
    enclosing,
    least_eigenvalue,
    margin_bound,
    margin_bound_over_cases,
    transposed,
)
from .by_law import CONDITIONS, DERIVED_PD_DAMPER, POSITIVE_CANDIDATE
from .commands import numeric_matrix, sizes_and_signs, terms_of
from .problem import SEARCH, Problem, Span, sign_sets
from .result import FAILS, HOLDS, SETTINGS, UNPROVED


@dataclass(frozen=True)
class TrackingSettings:
    """The numbers that decide on missions."""

    # Velocities up to this multiple of the limits of the mission are covered: the reference, and as much
    # of error.
    velocity_factor: float = 2.0
    iotas: int = 12  # values of iota that are tried in the range which serves a set-point
    iota_range: tuple[float, float] = (1e-6, 1e6)  # as far as that range lies in this one, 1/s
    headings: int = 9  # of half a turn at which they are tried
    max_products: int = 3  # products of velocities in D at most, each of which doubles the corners
    samples: int = 400  # times at which the commands on the reference are looked at
    dt: float = 0.02  # sampling interval of the loop on legs, s: what autopilots have
    # A leg is followed for so many times the slowest of lookahead / speed and lookahead / integral, so that
    # what is left of the start is below `steady_change` of it.
    time_constants: float = 30.0
    longest_simulation: float = 2000.0  # s, at most
    far: float = 10.0  # length of a leg without end, in what the vehicle makes in that time
    rounding: float = 1e-12  # of damping, and of what states do to each other in a sample
    steady_change: float = 1e-6  # change in a second that counts as steady, m, rad, m/s and rad/s


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


def check_mission(gains: GainSet, mission: Mission, tilt: float = math.radians(SEARCH.tilt)) -> MissionReport:
    """Check the conditions for the tracking error of a mission, without simulating it.

    `tilt` is the largest roll and pitch that conditions on a reference cover, rad.
    """
    reference = mission.reference(gains)
    Controller(gains, reference)  # refuses what cannot run, whatever the conditions say
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
_ASSUMPTION = "It assumes a reference of bounded speed and acceleration, and the exact model."
_PD_ABOUT = (
    "V = nu_e' M nu_e/2 + e' K_P e/2 with nu_e = nu_r - nu has V_dot = -nu_e' (D(nu) + J' K_V J) nu_e, "
    "because C(nu) is skew; nu_e, and then e, go to zero."
)
_PID_ABOUT = (
    "V of the set-point with its error measured from the reference; V_dot has iota e_dot' C_q e besides, so "
    "that Q = [[iota K_P - K_I, iota (K - C_q')/2], [., K - iota M_q]] with K = K_V + D_q."
)
_SLIDING_ABOUT = "S = J nu_e + Lambda e obeys the same S_dot as at a set-point, whatever the reference."


def _law_rows(gains: GainSet, mission: Mission, tilt: float) -> Iterator[MissionRow]:
    problem = Problem(gains, tilt)
    derived = [c for c in CONDITIONS[gains.law.id] if c.form == "derived" and not c.uses and not c.uses_iota]
    about = f"{_SLIDING_ABOUT if gains.law.id not in ('pd', 'pid') else ''} {_ASSUMPTION}".strip()
    for condition in derived:
        margin = problem.margin(condition, problem.sets[0], None)
        yield _row(
            condition.id, condition.matrices, f"{condition.about} {about}", margin, margin > 0, "gains alone"
        )
    # S' S/2 of sliding modes does not contain M.
    if gains.law.id in ("pd", "pid") and any(v in gains.plant.M.free_symbols for v in gains.plant.reversing):
        names = ", ".join(map(str, gains.plant.reversing))
        yield MissionRow(
            "M",
            "M does not change along the motion",
            "V is continuous only while M keeps one set of parameters.",
            _SOURCE,
            0.0,
            UNPROVED,
            f"M changes with the sign of {names}: V may jump where it does",
        )
    if gains.law.id == "pd":
        yield _pd_row(problem, mission)
    if gains.law.id == "pid":
        yield from _pid_rows(problem, mission)


def _row(
    name: str, statement: str, about: str, found: float, proved: bool, where: str, source: str = _SOURCE
) -> MissionRow:
    verdict = HOLDS if found > 0 and proved else UNPROVED if found > 0 else FAILS
    return MissionRow(name, statement, about, source, float(found), verdict, where)


def speeds(problem: Problem, mission: Mission) -> Array:
    """Velocities that are covered, shape (n,), m/s and rad/s."""
    own = problem.plant.vehicle.dof_indices
    limits = mission.limits
    return TRACKING.velocity_factor * np.array([limits.speed if i < 3 else limits.turn_rate for i in own])


def _pd_row(problem: Problem, mission: Mission) -> MissionRow:
    most = speeds(problem, mission)
    matrices, affine = damping_corners(problem, most)
    # Those whose symmetric part is not above that of another one: the others decide nothing for PD.
    symmetric = 0.5 * (matrices + np.swapaxes(matrices, 1, 2))
    symmetric = np.unique(symmetric.round(12), axis=0)
    kept: list[Array] = []
    for matrix in sorted(symmetric, key=lambda m: float(np.trace(m))):
        if all(np.linalg.eigvalsh(matrix - other)[0] < -TRACKING.rounding for other in kept):
            kept.append(matrix)
    sets = [problem.with_damping(d) for d in np.array(kept)]

    def margins(inverse: Any) -> Array:
        found = [DERIVED_PD_DAMPER.margin(problem.quantities(sign_set, inverse, None)) for sign_set in sets]
        return np.broadcast_to(np.min(found, axis=0), len(inverse))

    certificate = margin_bound(margins, problem.attitudes, problem.yaw_invariant)
    where = f"{_velocity_range(problem, most)}; {certificate.proof}{'' if affine else _CURVED}"
    proved = affine and certificate.bound > 0
    return _row(
        "K_V + D", "K_V + D_q(nu) ≻ 0", f"{_PD_ABOUT} {_ASSUMPTION}", certificate.least, proved, where
    )


_CURVED = "; damping is no sum of a few products of velocities, so that corners are samples"


def _pid_rows(problem: Problem, mission: Mission) -> Iterator[MissionRow]:
    """V is positive, and falls, with one iota."""
    most, sign_set = speeds(problem, mission), problem.sets[0]
    span = problem.iota_interval([POSITIVE_CANDIDATE], [sign_set])
    if span is None:
        yield _row("V", POSITIVE_CANDIDATE.matrices, _PID_ABOUT, -1.0, False, "V is positive for no iota")
        return
    decrease = DecreaseCondition(problem, most)
    iota = decrease.best_iota(span)
    positive = problem.certificate(POSITIVE_CANDIDATE, sign_set, iota)
    at = f"iota = {iota:.4g} 1/s"
    about = f"{POSITIVE_CANDIDATE.about} The same with a reference."
    yield _row(
        "V", POSITIVE_CANDIDATE.matrices, about, positive.least, positive.bound > 0, f"{at}; {positive.proof}"
    )
    found = decrease.certificate(iota)
    where = f"{_velocity_range(problem, most)}; {at}; {found.proof}{'' if decrease.affine else _CURVED}"
    proved = decrease.affine and found.bound > 0
    yield _row("V_dot", "Q(iota, nu) ≻ 0", f"{_PID_ABOUT} {_ASSUMPTION}", found.least, proved, where)


class DecreaseCondition:
    """Q of PID on a reference, V_dot = -z' Q z for z = (e, e_dot), at velocities up to some.

    With the signs of the velocities fixed, C and the usual drag are affine in nu, and so is Q: its least
    eigenvalue is concave, and least at a corner. More damping is not always better, for it is beside the
    diagonal, too: every corner counts.
    """

    def __init__(self, problem: Problem, most: Array) -> None:
        self.problem, plant = problem, problem.plant
        self.nu, self.D, self.affine = corners(problem, most)
        self.M = problem.sets[0].inertia
        C = function_of(list(plant.nu), plant.C.xreplace(dict(plant.numbers)).tolist())
        self.C = np.array([C(*unit) for unit in np.eye(len(plant.nu))], dtype=float)
        # Seen from the body, R is left in the gains alone, and there in their differences.
        self.body = len(plant.nu) == 6
        seen = self.body or problem.equal_gains(("x", "y", "z"))
        self.attitudes = Attitudes(plant, problem.attitudes.tilt, seen, rates=True)

    def margin(self, iota: float, stack: Any, place: Index, case: Index) -> Array:
        """Least eigenvalue of Q by J^-1 with its rates at some attitudes, for pairs of these and corners."""
        n, driven, sign_set = len(self.M), self.problem.driven, self.problem.sets[0]
        inverse, rates = stack[..., :n, :], stack[..., n : n + n * n, :].reshape(len(stack), n, n, n)
        columns = inverse[..., driven]
        stacked, m = columns[:, None], len(driven)
        # C_q = J^-T (C J^-1 + M d(J^-1)/dt) of a unit of each velocity, and then of all of them.
        coriolis = transposed(stacked) @ (self.C @ stacked + self.M @ rates[..., driven])
        C = self.nu[case][:, None] @ coriolis.reshape(len(stack), n, m * m)[place]
        s = self.problem.quantities(sign_set, inverse, iota)
        K_V, spring = (self._in_body_axes(K, stack)[place] for K in (s.K_V, iota * s.K_P - s.K_I))
        K = K_V + transposed(columns)[place] @ self.D[case] @ columns[place]
        cross = (K - transposed(C.reshape(len(place), m, m))) * (iota / 2)
        return least_eigenvalue(block([[spring, cross], [transposed(cross), K - s.M[place] * iota]]))

    def _in_body_axes(self, gain: Array, stack: Any) -> Any:
        """A gain as the body sees it: what is the same for all translations plus what turns, (k, m, m)."""
        if not self.body:
            return np.repeat(gain[None], len(stack), axis=0)
        driven = self.problem.driven
        translations = [k for k, i in enumerate(driven) if i < 3]
        least = np.diag(gain)[translations].min() if len(translations) == 3 else 0.0
        mean = np.diag([least if k in translations else gain[k, k] for k in range(len(driven))])
        turn = stack[..., -len(self.M) :, :][..., driven, :][..., driven]
        return mean + transposed(turn) @ (gain - mean) @ turn

    def best_iota(self, span: Span) -> float:
        """The iota with which the margin at some attitudes is largest, on a grid and on a finer one."""
        stack = self.attitudes.numbers(self._sampled_angles())
        place, case = (m.ravel() for m in np.indices((len(stack), len(self.nu))))
        least, most = TRACKING.iota_range
        low, high = max(span[0], least), min(span[1], most)
        for _ in range(2):  # the margin is concave in iota
            iotas = np.geomspace(low, high, TRACKING.iotas + 2)
            k = 1 + int(np.argmax([self.margin(i, stack, place, case).min() for i in iotas[1:-1]]))
            low, high = iotas[k - 1], iotas[k + 1]
        return float(iotas[k])

    def _sampled_angles(self) -> dict[str, Array]:
        """Level and with the largest roll and pitch, each at another heading if that counts."""
        if self.attitudes.invariant(self.problem.yaw_invariant):
            return {}
        angles = self.attitudes.angles(self.problem.yaw_invariant)
        tilts = [a for a in angles if a != "psi"]
        most = self.attitudes.tilt
        rows = np.array(list(product((-most, 0.0, most), repeat=len(tilts)))).T
        found = dict(zip(tilts, rows, strict=True))
        count = TRACKING.headings
        headings = {"psi": np.linspace(0, np.pi, count, endpoint=False)} if "psi" in angles else {}
        return found | {a: np.resize(v, rows.shape[1] if tilts else count) for a, v in headings.items()}

    def certificate(self, iota: float) -> Certificate:
        """The margin over all attitudes and corners, with its proof."""
        own = partial(self.margin, iota)
        return margin_bound_over_cases(own, self.attitudes, self.problem.yaw_invariant, len(self.nu))


def corners(problem: Problem, most: Array) -> tuple[Array, Array, bool]:
    """Corners of |nu| <= most with each choice of signs, and D there; and whether D has no more between.

    Shapes (k, n) and (k, n, n). Between the signs the usual drag is affine in nu. A product of velocities in
    D counts as a quantity of its own, anywhere between its least and its largest value.
    """
    plant = problem.plant
    sizes, sign_symbols = sizes_and_signs(plant)
    D = numeric_matrix(plant, plant.D)
    ends = []
    for v, size, sign, end in zip(plant.nu, sizes, sign_symbols, most, strict=True):
        at_rest = [(0.0, 1.0), (0.0, -1.0)] if sign in D.free_symbols else [(0.0, 1.0)]
        ends.append([(end, 1.0), (-end, -1.0), *(at_rest if {v, size, sign} & D.free_symbols else [])])
    rows = np.array(list(product(*ends)))
    nu, signs = rows[..., 0], rows[..., 1]
    found = enclosing([*plant.nu, *sizes, *sign_symbols], D)(*map(enclose, (*nu.T, *np.abs(nu).T, *signs.T)))
    damping = np.broadcast_to(found.middle, (len(nu), *D.shape))
    try:
        products = _velocity_products(plant, most)
    except UndertowError:
        return nu, damping, False
    if len(products) > TRACKING.max_products:
        return nu, damping, False
    monomials = np.concatenate([nu, np.abs(nu), signs], axis=1)
    for powers, (matrix, lowest, largest) in products.items():
        value = (monomials ** np.array(powers)).prod(axis=1)
        damping = np.concatenate([damping + (e - value)[:, None, None] * matrix for e in (lowest, largest)])
        nu, monomials = (np.concatenate([m, m]) for m in (nu, monomials))
    return nu, damping, True


def _velocity_products(plant: Plant, most: Array) -> dict[tuple[int, ...], tuple[Array, float, float]]:
    """Products of velocities in D by their powers: what D has of each, its least and its largest value."""
    n = len(most)
    found: dict[tuple[int, ...], tuple[Array, float, float]] = {}
    for row, column, powers, value in terms_of(plant, plant.D):
        if sum(powers[: 2 * n]) <= 1:
            continue
        largest = float(np.prod(np.tile(most, 2) ** np.array(powers[: 2 * n])))
        signed = any(p % 2 for p in (*powers[:n], *powers[2 * n : 3 * n]))
        matrix, *_ = found.setdefault(powers, (np.zeros((n, n)), -largest * signed, largest))
        matrix[row, column] += value
    return found


def damping_corners(problem: Problem, most: Array) -> tuple[Array, bool]:
    """D at the corners of |nu| <= most, shape (k, n, n), and whether it has no more between them."""
    _, D, affine = corners(problem, most)
    return np.unique(D, axis=0), affine


def _velocity_range(problem: Problem, most: Array) -> str:
    pairs = zip(problem.plant.nu, most, strict=True)
    return "velocities up to " + ", ".join(f"|{v}| = {m:.3g}" for v, m in pairs)


def _command_row(gains: GainSet, reference: TimedReference) -> MissionRow:
    """The part of the limit of each thruster that the reference itself asks for, with no error."""
    controller = Controller(_with_boundary_layer(gains), reference)
    limits, profile = controller.allocation.limits, reference.profile
    share = controller.allocation.B_inverse
    t = np.unique(np.concatenate([np.linspace(0, profile.duration, TRACKING.samples), profile.knots]))
    force = _reference_force(controller, profile.at(t), profile.at(t, 1), t)
    commands = np.abs(force @ share.T) + _jump_commands(gains, profile.at(t), share)
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


def _with_boundary_layer(gains: GainSet) -> GainSet:
    """A sliding mode without its jump, whose sign on the reference is that of rounding."""
    if gains.law.id != SlidingMode.id:
        return gains
    widths = {f"width_{c}": 1.0 for c in gains.signals.coordinates}
    return replace(gains, law=BoundaryLayer(), values={**gains.values, **widths})


def _jump_commands(gains: GainSet, poses: Array, share: Array) -> Array:
    """How far the jump of a sliding mode takes each command either way, shape (k, commands)."""
    plant = gains.plant
    if gains.law.id != SlidingMode.id:
        return np.zeros((len(poses), len(share)))
    reach = np.array([gains.values[f"K_Z_{c}"] for c in gains.signals.coordinates])
    kinematics = function_of(list(plant.eta), plant.J_inverse.tolist())
    inverse = np.array([kinematics(*pose) for pose in poses], dtype=float)
    each = [np.abs(share @ sign_set.inertia @ inverse) @ reach for sign_set in sign_sets(plant)]
    return np.asarray(np.max(each, axis=0))


def _reference_force(controller: Controller, poses: Array, rates: Array, t: Array) -> Array:
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
    """The vehicle makes way against the current, and the whole loop is stable on every leg or tangent."""
    current = float(np.hypot(*(mission.current or (0.0, 0.0))))
    speed = mission.limits.speed
    yield _row(
        "current", "speed > current", "A slower vehicle has no heading that keeps it on every leg.",
        speed - current, True, f"{speed:.4g} m/s against {current:.4g} m/s", "kinematics",
    )  # fmt: skip
    if gains.law.id in DISCONTINUOUS:
        yield MissionRow(
            "line of sight",
            "all poles along the path decay",
            "A discontinuous law has no linearisation on its surface, and sampled no steady motion either.",
            "linearisation",
            0.0,
            UNPROVED,
            f"law '{gains.law.id}' is discontinuous: simulate it, or use 'sliding-mode-boundary-layer'",
        )
        return
    vehicle = Overrides(current=mission.current).in_current(gains.plant.vehicle)
    directions, name = np.diff(mission.points, axis=0), "leg"
    if isinstance(reference, SplineOfSight):
        yield _curvature_row(reference)
        directions, name = reference.tangents(), "tangent at way-point"
    legs: dict[tuple[float, ...], list[int]] = {}  # by their direction, by which their poles differ
    for number, direction in enumerate(directions, 1):
        legs.setdefault(tuple((direction / np.linalg.norm(direction)).round(4)), []).append(number)
    for numbers in legs.values():
        first = numbers[0] - 1
        label = f"{name}{'s' * (len(numbers) > 1)} {', '.join(map(str, numbers))}"
        yield _leg_row(gains, vehicle, mission, reference, label, mission.points[first], directions[first])


def _curvature_row(reference: SplineOfSight) -> MissionRow:
    """The heading keeps up with the path at its sharpest bend."""
    yaw_rate = float(reference.curvatures.max()) * reference.limits.speed
    return _row(
        "bends", "curvature · speed < turn_rate", "The model of the heading keeps up with the spline.",
        reference.limits.turn_rate - yaw_rate, True, f"{yaw_rate:.4g} rad/s at the sharpest bend",
        "kinematics",
    )  # fmt: skip


def _leg_row(
    gains: GainSet,
    vehicle: Vehicle,
    mission: Mission,
    reference: LineOfSight,
    leg: str,
    begin: Array,
    along: Array,
) -> MissionRow:
    """Poles of vehicle, autopilot and guidance together on a leg without end, for all of its direction."""
    far = TRACKING.far * TRACKING.longest_simulation * mission.limits.speed
    direction = along / np.linalg.norm(along)
    endless = LineOfSight(
        reference.names,
        np.array([begin, begin + far * direction]),
        mission.limits,
        mission.guidance,
        reference.pitches,
        reference.uncontrolled,
    )
    parts = Interconnection(vehicle, Controller(gains, endless))
    step, names = _sampled_map(parts)
    state, change = _steady_state(parts, mission, endless, step)
    statement = f"all poles on {leg} decay"
    about = (
        "Vehicle, autopilot and line of sight, linearised at their steady straight motion in the current of "
        "the mission: small errors die out. It says nothing of turns and of limits that are met."
    )
    if not change <= TRACKING.steady_change:
        text = f"no steady motion was found: it still changes by {change:.3g} in a second"
        return MissionRow(leg, statement, about, "linearisation", -change, FAILS, text)
    slope = _in_leg_coordinates(
        np.asarray(step.factory("A", ["z"], ["jac:after:z"])(state)), names, direction
    )
    relevant = _relevant_states(slope, names, vehicle)
    poles = np.log(np.linalg.eigvals(slope[np.ix_(relevant, relevant)]).astype(complex)) / TRACKING.dt
    slowest = poles[int(np.argmax(poles.real))]
    where = f"the slowest is {slowest.real:.4g} ± {abs(slowest.imag):.4g}i 1/s"
    margin = -float(slowest.real) - SETTINGS.slowest_decay
    return _row(leg, statement, about, margin, True, where, "linearisation of the sampled loop")


def _sampled_map(parts: Interconnection) -> tuple[ca.Function, list[str]]:
    """One sample of the loop as a map of its states, and their names."""
    f, control = parts.functions, parts.control
    nx, nu = f.x.numel(), f.u.numel()
    z = ca.MX.sym("z", nx + control.size1_in("s"))
    zero, reported = ca.DM.zeros(nu), ca.DM.zeros(len(parts.reported_names))
    inputs = (zero, reported, 0, 0, 0, parts.parameters, parts.controller.mission_numbers, parts.gains)
    x, s, *_ = sample_of(parts, TRACKING.dt)(z[:nx], z[nx:], zero, *inputs)
    names = [*f.state_names, *parts.controller.state_names]
    return ca.Function("step", [z], [ca.vertcat(x, s)], ["z"], ["after"]).expand(), names


def _steady_state(
    parts: Interconnection, mission: Mission, reference: LineOfSight, step: ca.Function
) -> tuple[Array, float]:
    """The state after a long way along the leg, and how much what counts still changes in a second."""
    guidance, speed = mission.guidance, mission.limits.speed
    slow = max(
        guidance.lookahead / speed, guidance.lookahead / guidance.integral if guidance.integral else 0.0
    )
    count = int(min(TRACKING.time_constants * slow, TRACKING.longest_simulation) / TRACKING.dt)
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


def _in_leg_coordinates(slope: Array, names: list[str], direction: Array) -> Array:
    """The map in the way along the leg, to starboard of it and below it, in place of x, y and z."""
    horizontal = float(np.hypot(direction[0], direction[1]))
    c, s, slope_down = direction[0] / horizontal, direction[1] / horizontal, direction[2] / horizontal
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [-slope_down * c, -slope_down * s, 1.0]])
    axes = [i for i, n in enumerate("xyz") if n in names]
    rows = [names.index("xyz"[i]) for i in axes]
    transform = np.eye(len(slope))
    transform[np.ix_(rows, rows)] = turn[np.ix_(axes, axes)]
    return np.asarray(transform @ slope @ np.linalg.inv(transform))


def _relevant_states(slope: Array, names: list[str], vehicle: Vehicle) -> list[int]:
    """States that act on pose or velocity, but for the way along the leg, in place of x, which is free."""
    poses = vehicle.pose_names
    count = {i for i, n in enumerate(names) if n in (*poses, *vehicle.velocity_names) and n != "x"}
    # What nothing drives has no pole: integrals of errors that are zero by the guidance.
    none = TRACKING.rounding
    undriven = set(map(int, np.flatnonzero((np.abs(slope - np.eye(len(slope))) < none).all(axis=1))))
    fixed = undriven | {names.index(n) for n in _DISCRETE}
    while True:
        coupled = {int(j) for i in count for j in np.flatnonzero(np.abs(slope[i]) > none)} - fixed - {0}
        if coupled <= count:
            return sorted(count - fixed)
        count |= coupled
