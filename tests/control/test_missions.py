"""Missions: references within their limits, laws that stay on them, line of sight against closed forms."""

from __future__ import annotations

import ctypes
import math
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
import sympy as sm

from tests.quick import first_quick, quick_if
from undertow.codegen.compiler import pointer
from undertow.codegen.library import Library
from undertow.codegen.spelling import slug
from undertow.control.closed_loop import ClosedLoop, Overrides, Record, Scenario
from undertow.control.closed_loop.pictures import track
from undertow.control.conditions.full_loop import certify
from undertow.control.conditions.problem import Problem
from undertow.control.conditions.tracking import DecreaseCondition, check_mission, damping_corners, speeds
from undertow.control.controller import Controller
from undertow.control.controller_c import controller_c
from undertow.control.gains import GainSet, GainTable, gains_from_table, load_gains
from undertow.control.guidance.line_of_sight import Guidance, LineOfSight
from undertow.control.guidance.mission import Mission, MissionTable, load_mission, mission_from_table
from undertow.control.guidance.reference import Kinematics, Limits
from undertow.control.laws import DISCONTINUOUS, LAWS
from undertow.control.linear.systems import SteadyStateFilter, close_loop
from undertow.errors import UndertowError
from undertow.model.loading import load_vehicle
from undertow.model.vehicle import Value
from undertow.observer.design import ObserverTable, design

EXAMPLES = Path(__file__).parents[2] / "examples" / "missions"
GAINS = {
    "K_P": 20.0,
    "K_V": 30.0,
    "K_I": 1.0,
    "Lambda": 0.5,
    "K_Z": 0.2,
    "width": 0.05,
    "K_1": 0.3,
    "K_2": 0.05,
}
NAMES = ("x", "y", "z", "psi")
LIMITS = {"acceleration": 0.05, "turn_rate": 0.2, "turn_acceleration": 0.1}


def mission(kind: str, points: list[dict[str, object]], **more: object) -> Mission:
    content = {"schema": "undertow/mission/1", "name": kind, "kind": kind, "speed": 0.4, "limits": LIMITS}
    return mission_from_table(MissionTable.model_validate(content | {"waypoints": points} | more))


def scattered(seed: int, count: int = 5, **more: object) -> list[dict[str, object]]:
    random = np.random.default_rng(seed)
    return [dict(zip("xyz", map(float, 8 * random.normal(size=3)), strict=True)) | more for _ in range(count)]


def ship(law: str, **more: object) -> GainSet:
    """CyberShip II, which its thrusters push in surge, sway and yaw."""
    gains = {g.name: GAINS[g.name] for g in LAWS[law].gains}
    content = {"schema": "undertow/gains/1", "name": law, "law": law, "gains": gains, **more}
    return gains_from_table(GainTable.model_validate(content), load_vehicle("cybership2"))


SQUARE = [{"x": 0.0, "y": 0.0}, {"x": 3.0, "y": 1.0}, {"x": 4.0, "y": 4.0}, {"x": 1.0, "y": 5.0}]


# --- references -----------------------------------------------------------------------------------
@pytest.mark.parametrize("kind", ["setpoints", "spline"])
@pytest.mark.parametrize("seed", range(4))
def test_a_reference_keeps_to_its_limits_and_arrives_exactly(kind: str, seed: int) -> None:
    one = mission(kind, scattered(seed))
    profile = one.profile(NAMES)
    t = np.linspace(0, profile.duration, 20_001)
    for order, limits in ((1, (0.4, 0.2)), (2, (0.05, 0.1))):
        values = profile.at(t, order)
        sizes = np.linalg.norm(values[:, :3], axis=1).max(), np.abs(values[:, 3]).max()
        for angles, (size, limit) in enumerate(zip(sizes, limits, strict=True)):
            assert size <= limit + 1e-9
            # What is worked out from the roots is what the samples come to.
            assert profile.largest(order, bool(angles)) == pytest.approx(size, rel=1e-4, abs=1e-9)
    assert max(
        profile.largest(1) / 0.4, profile.largest(2) / 0.05, profile.largest(1, True) / 0.2
    ) > 0.99 or (profile.largest(2, True) > 0.099)
    end = profile.at(np.array([profile.duration, profile.duration + 100.0]))
    assert (end[:, :3] == one.points[-1]).all()
    assert (profile.at(np.array([profile.duration]), 1) == 0).all()
    assert np.abs(profile.at(np.array([0.0, profile.duration - 1e-9]), 1)).max() < 1e-6
    for point in one.points:
        assert np.linalg.norm(profile.at(t)[:, :3] - point, axis=1).min() < 0.02


@pytest.mark.parametrize("kind", ["setpoints", "spline"])
def test_derivatives_are_those_of_the_pose_and_continuous(kind: str) -> None:
    profile = mission(kind, scattered(7)).profile(NAMES)
    t, h = np.linspace(0.1, profile.duration - 0.1, 997), 1e-4
    for order in (0, 1):
        slope = (profile.at(t + h, order) - profile.at(t - h, order)) / (2 * h)
        assert slope == pytest.approx(profile.at(t, order + 1), abs=2e-5)
    inner = profile.knots[1:-1]
    for order in (0, 1, 2):
        assert profile.at(inner - 1e-9, order) == pytest.approx(profile.at(inner, order), abs=1e-7)


def test_a_straight_way_takes_the_time_of_its_profile() -> None:
    """Cubic ramps: way / speed + 1.5 speed / acceleration, here 10 / 0.4 + 1.5 * 0.4 / 0.05."""
    profile = mission("setpoints", [{"x": 0.0}, {"x": 10.0}]).profile(NAMES)
    assert profile.duration == pytest.approx(37.0, rel=1e-12)
    short = mission("setpoints", [{"x": 0.0}, {"x": 1.0}]).profile(NAMES)
    assert short.duration == pytest.approx(2 * math.sqrt(1.5 / 0.05), rel=1e-12)


def test_a_trajectory_that_is_too_fast_is_refused_with_the_time_that_it_needs() -> None:
    def at(factor: float) -> Mission:
        points = [dict(p, t=factor * t) for p, t in zip(SQUARE, (0.0, 5.0, 10.0, 15.0), strict=True)]
        return mission("trajectory", points, heading=0.0)

    with pytest.raises(UndertowError, match=r"speed of the trajectory is .* times the time") as refused:
        at(1.0).profile(NAMES)
    factor = float(str(refused.value).split(": allow ")[1].split(" times")[0])
    slow = at(4 * factor).profile(NAMES)
    for i, p in enumerate(SQUARE):
        assert slow.at(np.array([4 * factor * 5.0 * i]))[0, :2] == pytest.approx([p["x"], p["y"]], abs=1e-9)


# --- laws -----------------------------------------------------------------------------------------
@pytest.mark.parametrize("law", LAWS)
def test_on_the_reference_every_law_gives_exactly_its_acceleration(law: str) -> None:
    gains = ship(law)
    plant, signals = gains.plant, gains.tracking
    random = np.random.default_rng(3)
    zero = dict.fromkeys([*signals.error, *signals.states], sm.Integer(0))
    for _ in range(3):
        nu = dict(zip(plant.nu, map(sm.Float, random.normal(size=3)), strict=True))
        follows = dict(zip(signals.nu_r, plant.nu, strict=True))
        rising = dict(zip(signals.nu_r_dot, map(sm.Float, random.normal(size=3)), strict=True))
        pose = dict(zip(plant.eta, map(sm.Float, random.normal(size=3)), strict=True))
        known = {**zero, **nu, **rising, **pose, **plant.numbers, **gains.numbers}
        rest = (
            gains.law.force(signals) - (plant.C + plant.D) * plant.nu - plant.g - plant.M * signals.nu_r_dot
        )
        assert (
            np.abs(np.array(rest.xreplace(follows).xreplace(known).evalf().tolist(), dtype=float)).max()
            < 1e-11
        )


@pytest.mark.parametrize("law", LAWS)
def test_a_set_point_is_the_reference_that_stands_still(law: str) -> None:
    gains = ship(law)
    still = dict.fromkeys([*gains.tracking.nu_r, *gains.tracking.nu_r_dot], sm.Integer(0))
    moving = gains.law.force(gains.tracking).xreplace(still)
    assert (moving - gains.law.force(gains.signals)).applyfunc(sm.expand).is_zero_matrix


@pytest.mark.parametrize("law", first_quick(["pd", "pid", "sliding-mode-boundary-layer"]))
def test_a_vehicle_that_begins_on_its_spline_stays_there(law: str) -> None:
    loop = ClosedLoop(ship(law), mission=mission("spline", SQUARE))
    record = loop.run(Scenario(duration=60.0, dt=0.01, continuous=True))
    assert record.result.followed is not None
    assert record.result.followed.arrived is not None
    for error in record.result.followed.errors:
        assert error.largest < 1e-8
    sampled = loop.run(Scenario(duration=60.0, dt=0.05)).result.followed
    assert sampled is not None
    assert 1e-8 < max(e.largest for e in sampled.errors) < 0.01  # commands that are held are late


@pytest.mark.parametrize("law", DISCONTINUOUS)
def test_a_law_that_jumps_stays_within_what_its_samples_leave(law: str) -> None:
    found = (
        ClosedLoop(ship(law), mission=mission("spline", SQUARE)).run(Scenario(duration=60.0, dt=0.02)).result
    )
    assert found.followed is not None
    assert found.followed.arrived is not None
    left = {c.name: c.sampling_offset for c in found.coordinates}
    for error in found.followed.errors:
        assert 0 < error.largest < left[error.name]


def _rates(gains: GainSet, seed: int, iota: float) -> tuple[float, float]:
    """V_dot of the law along its loop with a reference that moves: by differentiating V, and as claimed."""
    plant, signals, law = gains.plant, gains.tracking, gains.law
    random = np.random.default_rng(seed)
    n = len(plant.nu)
    eta, nu, rate, rising, error, total = random.normal(size=(6, n))

    def at(matrix: sm.Matrix, pose: np.ndarray, moving: np.ndarray) -> np.ndarray:
        known = dict(zip([*plant.eta, *plant.nu], map(sm.Float, [*pose, *moving]), strict=True))
        return np.array(matrix.xreplace(plant.numbers).xreplace(known).evalf().tolist(), dtype=float)

    J, J_dot, C, D, M = (at(m, eta, nu) for m in (plant.J, plant.J_dot, plant.C, plant.D, plant.M))
    nu_r = np.linalg.solve(J, rate)
    nu_r_dot = np.linalg.solve(J, rising - J_dot @ nu_r)
    known = {**plant.numbers, **gains.numbers}
    for symbols, values in (
        (plant.eta, eta), (plant.nu, nu), (signals.nu_r, nu_r), (signals.nu_r_dot, nu_r_dot),
        (signals.error, error), (signals.states, total),
    ):  # fmt: skip
        known |= dict(zip(symbols, map(sm.Float, values), strict=False))
    force = np.array(law.force(signals).xreplace(known).evalf().tolist(), dtype=float).ravel()
    nu_dot = np.linalg.solve(M, force - (C + D) @ nu)
    K = {g.name: np.array(gains.matrix(g.name).tolist(), dtype=float) for g in type(law).gains}
    nu_e, e_dot = nu_r - nu, rate - J @ nu
    if law.id == "pd":
        found = nu_e @ M @ (nu_r_dot - nu_dot) + error @ K["K_P"] @ e_dot
        return float(found), float(-nu_e @ (D + J.T @ K["K_V"] @ J) @ nu_e)

    def V(h: float) -> float:
        """V a moment later."""
        inverse = np.linalg.inv(at(plant.J, eta + h * J @ nu, nu))
        e, z = error + h * e_dot, total + h * error
        e_ddot = rising - J_dot @ nu - J @ nu_dot
        s = e_dot + h * e_ddot + iota * e
        M_q = inverse.T @ M @ inverse
        spring = K["K_P"] - K["K_I"] / iota - iota**2 * M_q
        both = z * iota + e
        return float((s @ M_q @ s + e @ spring @ e + both @ K["K_I"] @ both / iota) / 2)

    inverse = np.linalg.inv(J)
    C_q = inverse.T @ (C - M @ inverse @ J_dot) @ inverse
    damper = K["K_V"] + inverse.T @ D @ inverse
    M_q = inverse.T @ M @ inverse
    # With K not symmetric the cross term has K itself, e' K e_dot.
    Q = np.block(
        [[iota * K["K_P"] - K["K_I"], iota * (damper - C_q.T) / 2],
         [iota * (damper.T - C_q) / 2, damper - iota * M_q]]
    )  # fmt: skip
    state = np.concatenate([error, e_dot])
    h = 1e-5
    return (V(h) - V(-h)) / (2 * h), float(-state @ Q @ state)


@pytest.mark.parametrize("law", ["pd", "pid"])
@pytest.mark.parametrize("seed", range(3))
def test_the_lyapunov_function_of_the_tracking_error_falls_as_claimed(law: str, seed: int) -> None:
    found, claimed = _rates(ship(law), seed, iota=0.3)
    assert found == pytest.approx(claimed, rel=1e-7)


def six(*without: str, **changed: dict[str, float]) -> GainSet:
    """PID for the bundled BlueROV2, which pushes in all six axes, without some of its parameters."""
    axes = ("x", "y", "z", "phi", "theta", "psi")
    gains = {
        "K_P": dict(zip(axes, (25.0, 25.0, 25.0, 2.0, 2.0, 2.0), strict=True)),
        "K_V": dict(zip(axes, (50.0, 50.0, 50.0, 2.0, 2.0, 2.0), strict=True)),
        "K_I": dict(zip(axes, (1.0, 1.0, 1.0, 0.1, 0.1, 0.1), strict=True)),
    }
    gains = {name: row | changed.get(name, {}) for name, row in gains.items()}
    table = {"schema": "undertow/gains/1", "name": "six", "law": "pid", "gains": gains}
    rov = load_vehicle("bluerov2")
    rov = replace(rov, values={n: v for n, v in rov.values.items() if n not in without})
    return gains_from_table(GainTable.model_validate(table), rov)


# Drag that does not grow with the speed, which leaves 256 corners of 4096.
FEW_CORNERS = ("Y_vabsv", "Z_wabsw", "K_pabsp", "M_qabsq")


def least_eigenvalue_of_q(gains: GainSet) -> Callable[[np.ndarray, np.ndarray, float], float]:
    """From pose, velocity and iota, by the matrices of the model."""
    plant = gains.plant
    numbers = [m.xreplace(dict(plant.numbers)) for m in (plant.J, plant.J_dot, plant.C, plant.D, plant.M)]
    matrices = sm.lambdify([*plant.eta, *plant.nu], numbers, "numpy")
    K_P, K_V, K_I = (np.array(gains.matrix(k).tolist(), dtype=float) for k in ("K_P", "K_V", "K_I"))

    def least(eta: np.ndarray, nu: np.ndarray, iota: float) -> float:
        J, J_dot, C, D, M = matrices(*eta, *nu)
        inverse = np.linalg.inv(J)
        C_q, M_q = inverse.T @ (C - M @ inverse @ J_dot) @ inverse, inverse.T @ M @ inverse
        K = K_V + inverse.T @ D @ inverse
        cross = iota * (K - C_q.T) / 2
        Q = np.block([[iota * K_P - K_I, cross], [cross.T, K - iota * M_q]])
        return float(np.linalg.eigvalsh(0.5 * (Q + Q.T))[0])

    return least


@pytest.mark.parametrize(
    ("without", "changed"),
    first_quick([(FEW_CORNERS, {}), ((), {}), ((), {"K_P": {"z": 30.0}})]),
    ids=["few corners", "equal", "other in depth"],
)
def test_pid_with_six_degrees_of_freedom_is_proved_on_a_reference(
    without: tuple[str, ...], changed: dict
) -> None:
    """Over all attitudes up to the tilt and all velocities, of which none that is tried has less margin."""
    gains, where = six(*without, **changed), load_mission(EXAMPLES / "bluerov2-spline.toml")
    found = check_mission(gains, where)
    assert found.ok
    rows = {r.condition: r for r in found.rows}
    assert [*rows] == ["K_I", "V", "V_dot", "commands"]
    iota = float(rows["V_dot"].where.split("iota = ")[1].split()[0])
    assert f"iota = {iota:.4g} 1/s; certainly above" in rows["V"].where
    most, random = speeds(Problem(gains), where), np.random.default_rng(2)
    least, falls = np.inf, least_eigenvalue_of_q(gains)
    for _ in range(300):
        eta = np.concatenate(
            [np.zeros(3), random.choice([-1, -0.5, 0.1, 1], 2) * np.pi / 3, [random.uniform(-3, 3)]]
        )
        least = min(least, falls(eta, random.choice([-1, 0, 1], 6) * most, iota))
    assert rows["V_dot"].margin <= least < 2 * rows["V_dot"].margin


@pytest.mark.parametrize(("turn_rate", "verdict"), first_quick([(20.0, "fails"), (3.0, "not proved")]))
def test_pid_with_six_degrees_of_freedom_that_turns_fast_is_not_claimed(
    turn_rate: float, verdict: str
) -> None:
    """Coriolis forces grow with the velocities that are covered, twice the limits of the mission."""
    fast = mission("spline", scattered(3), speed=0.3, limits={**LIMITS, "turn_rate": turn_rate})
    (row,) = (r for r in check_mission(six(*FEW_CORNERS), fast).rows if r.condition == "V_dot")
    assert row.verdict == verdict


def test_q_of_pid_is_that_of_the_model_whatever_frame_it_is_worked_out_in() -> None:
    """Of equal gains the rotation is left out, of others the heading or nothing."""
    random = np.random.default_rng(3)
    for changed in ({}, {"K_P": {"z": 30.0}}, {"K_P": {"y": 30.0}}):
        gains, most = six(**changed), np.array([1.0, 0.8, 0.6, 0.5, 0.4, 0.7])
        falling, falls = DecreaseCondition(Problem(gains), most), least_eigenvalue_of_q(gains)
        for _ in range(4):
            eta = np.concatenate([np.zeros(3), random.uniform(-1, 1, 3)])
            if changed.get("K_P", {}).get("z"):
                eta[5] = 0.0  # left out, as it changes no eigenvalue
            angles = dict(zip(("phi", "theta", "psi"), eta[3:], strict=True))
            corner = np.array([random.integers(len(falling.nu))])
            one = falling.margin(0.3, falling.attitudes.at(angles)[None], np.zeros(1, dtype=int), corner)
            assert one[0] == pytest.approx(falls(eta, falling.nu[corner[0]], 0.3), rel=1e-9)


def test_more_damping_at_speed_may_break_v_of_pid() -> None:
    """Damping is in the mixed block of Q, too, so that its largest value counts as well as its least."""
    gains = six(
        "K_pabsp",
        "M_qabsq",
        "N_rabsr",
        K_P={"x": 3.0, "y": 3.0, "z": 3.0},
        K_I={"x": 0.1, "y": 0.1, "z": 0.1},
    )
    slow = check_mission(gains, mission("spline", scattered(3), speed=0.05))
    fast = check_mission(gains, mission("spline", scattered(3), speed=3.0))
    margins = [next(r.margin for r in m.rows if r.condition == "V_dot") for m in (slow, fast)]
    assert margins[0] > 0
    assert margins[1] < 0
    problem = Problem(gains)
    falling = DecreaseCondition(problem, speeds(problem, mission("spline", scattered(3), speed=3.0)))
    still = np.abs(falling.nu[:, :3]).max(axis=1) == 0
    level = np.repeat(falling.attitudes.at({})[None], len(falling.nu), axis=0)
    each = falling.margin(0.2, level, np.arange(len(level)), np.arange(len(level)))
    assert each[still].min() > each[~still].min()


def test_damping_is_least_at_a_corner_of_the_speeds() -> None:
    problem = Problem(load_gains(EXAMPLES / "bluerov2-gains.toml", load_vehicle("bluerov2")))
    most = np.array([1.0, 1.0, 1.0, 0.7, 0.7, 0.7])
    corners, affine = damping_corners(problem, most)
    assert affine
    least = np.linalg.eigvalsh(0.5 * (corners + corners.transpose(0, 2, 1)))[:, 0].min()
    D = sm.lambdify(list(problem.plant.nu), problem.plant.D.xreplace(problem.plant.numbers), "numpy")
    for nu in np.random.default_rng(0).uniform(-most, most, (200, 6)):
        own = np.array(D(*nu), dtype=float)
        assert np.linalg.eigvalsh(0.5 * (own + own.T))[0] >= least - 1e-12
    assert least == pytest.approx(0.07)  # K_p, M_q and N_r at rest


def test_cubic_drag_is_within_its_corners() -> None:
    """CyberShip II has X_uuu: a parabola is below its chord, so that its product has a corner of its own."""
    gains = ship("pid")
    assert all(r.verdict == "holds" for r in check_mission(gains, mission("spline", SQUARE, speed=0.1)).rows)
    most, random = np.array([0.5, 0.3, 0.4]), np.random.default_rng(4)
    falling = DecreaseCondition(Problem(gains), most)
    assert falling.affine
    own = falling.attitudes.at({})[None]
    every = np.arange(len(falling.nu))
    least, falls = falling.margin(0.3, own, 0 * every, every).min(), least_eigenvalue_of_q(gains)
    for nu in random.uniform(-most, most, (200, 3)):
        assert falls(np.zeros(3), nu, 0.3) >= least
    assert {*np.round(falling.D[:, 0, 0][np.abs(falling.nu[:, 0]) == 0.5], 3)} > {
        round(float(d), 3) for d in (_drag(gains, 0.5), _drag(gains, -0.5))
    }


def _drag(gains: GainSet, u: float) -> float:
    """D in surge at a speed, kg/s."""
    known = dict(zip(gains.plant.nu, map(sm.Float, (u, 0.0, 0.0)), strict=True))
    return float(gains.plant.D.xreplace(gains.plant.numbers).xreplace(known)[0, 0])


def test_conditions_on_a_reference_hold_until_a_limit_is_asked_for() -> None:
    gains = load_gains(EXAMPLES / "bluerov2-gains.toml", load_vehicle("bluerov2"))
    good = check_mission(gains, load_mission(EXAMPLES / "bluerov2-spline.toml"))
    assert good.ok
    assert [r.condition for r in good.rows] == ["K_P", "K_V + D", "commands"]
    fast = check_mission(gains, mission("spline", SQUARE, speed=3.0, limits={**LIMITS, "acceleration": 5.0}))
    assert [r.verdict for r in fast.rows] == ["holds", "holds", "fails"]
    assert fast.rows[-1].margin < 0


# --- line of sight ----------------------------------------------------------------------------------
class Particle:
    """A vehicle that has the heading and speed asked for, in a current across its leg to the north."""

    def __init__(self, guidance: Guidance, speed: float = 1.5) -> None:
        quick = Limits(speed, 1e3, 40.0, 4000.0)  # the model of the heading is done in 0.1 s
        names = ("x", "y", "psi")
        self.guide = LineOfSight(names, np.array([[0.0, 0, 0], [1e5, 0, 0]]), quick, guidance, False)
        x, drift = ca.SX.sym("x", 3 + len(self.guide.state_names)), ca.SX.sym("drift")
        eta, s, r = x[:3], x[3:], ca.DM([n.value for n in self.guide.numbers])
        kin = Kinematics(names, eta, ca.SX([1.5, 0, 0]), ca.SX.eye(3), ca.SX.zeros(3, 3))
        course = self.guide.desired(r, s, kin)
        psi, ahead = course.eta_d[2], course.nu_r[0]
        moved = eta[:2] + 0.01 * (ahead * ca.vertcat(ca.cos(psi), ca.sin(psi)) + ca.vertcat(0, drift))
        following = ca.vertcat(moved, psi, self.guide.advance(r, s, kin, ca.SX(0.01)))
        self._step = ca.Function("step", [x, drift], [following, ca.vertcat(eta[:2], psi)])

    def run(self, y: float, seconds: float, drift: float = 0.0) -> np.ndarray:
        """Place and heading over time, shape (n, 3)."""
        start = [0.0, y, -math.atan(y / self.guide.guidance.lookahead), *self.guide.initial_states()]
        return np.asarray(self._step.mapaccum(round(seconds / 0.01))(start, drift)[1]).T


@pytest.mark.parametrize("law", ["sliding-mode", "sliding-mode-boundary-layer"])
def test_commands_on_a_reference_include_the_jump_of_a_sliding_mode_either_way(law: str) -> None:
    gains = ship(law, allocation={"limits": {f"T{i}": "4 N" for i in (1, 2, 3)} | {"L1": "9 N", "L2": "9 N"}})
    where = mission("setpoints", SQUARE)
    (row,) = (r for r in check_mission(gains, where).rows if r.condition == "commands")
    reference = where.reference(gains)
    controller = Controller(gains, reference)
    profile, share = reference.profile, controller.allocation.B_inverse
    turn = sm.lambdify(gains.plant.eta[2], gains.plant.J_inverse, "numpy")
    t = np.linspace(0, profile.duration, 400)
    nu = [turn(pose[2]) @ rate for pose, rate in zip(profile.at(t), profile.at(t, 1), strict=True)]
    signs = np.array(list(product((-1e-9, 1e-9), repeat=3)))
    poses = (profile.at(t)[:, None] + signs).reshape(-1, 3)
    y = np.hstack([poses, np.repeat(nu, len(signs), axis=0)])
    s = np.tile(controller.initial_states(), (len(y), 1))
    s[:, controller.state_names.index("mission_time")] = np.repeat(t, len(signs))
    tau = controller.continuous(y.T, controller.mission_numbers, s.T, controller.gain_values())[2]
    worst = float((np.abs(share @ np.asarray(tau)).T / controller.allocation.limits).max())
    assert 0.9 - row.margin == pytest.approx(worst, rel=2e-2)
    assert worst > (1.0 if law == "sliding-mode" else 0.1)


def test_sliding_modes_need_no_mass_that_stays_the_same_and_no_turn_before_the_way() -> None:
    ahead = {"X_udot_forward": Value(-2.0), "X_udot_backward": Value(-3.0)}
    values = {n: v for n, v in load_vehicle("cybership2").values.items() if n != "X_udot"} | ahead
    vehicle = replace(load_vehicle("cybership2"), values=values)
    found = {}
    for law in ("pd", "sliding-mode"):
        gains = {g.name: GAINS[g.name] for g in LAWS[law].gains}
        content = {"schema": "undertow/gains/1", "name": law, "law": law, "gains": gains}
        one = gains_from_table(GainTable.model_validate(content), vehicle)
        found[law] = {r.condition for r in check_mission(one, mission("setpoints", SQUARE)).rows}
    assert "M" in found["pd"]  # V of PD has M in it, S' S/2 has not
    assert "M" not in found["sliding-mode"]
    waits = ship("sliding-mode", schedule={"order": "yaw-first", "gate": "1 deg"})
    with pytest.raises(UndertowError, match="waits for the heading of a set-point"):
        check_mission(waits, mission("legs", SQUARE))


def test_the_cross_track_error_of_line_of_sight_is_that_of_its_equation() -> None:
    """y_dot = -U y / w with w = sqrt(y^2 + D^2), so U t = F(y_0) - F(y) with F = w + D ln(y / (D + w))."""
    D = 5.0

    def F(y: np.ndarray) -> np.ndarray:
        w = np.sqrt(y**2 + D**2)
        return w + D * np.log(y / (D + w))

    rows = Particle(Guidance(D, 1.0)).run(12.0, 12.0)
    t = 0.01 * np.arange(len(rows))
    assert 1.5 * t == pytest.approx(F(np.array(12.0)) - F(rows[:, 1]), abs=0.15)
    assert rows[-1, 1] < 2.0


def test_integral_line_of_sight_finds_the_side_slip_of_the_current() -> None:
    with_it = Particle(Guidance(5.0, 1.0, 0.4)).run(4.0, 100.0, drift=0.5)
    assert abs(with_it[-1, 1]) < 1e-4
    assert with_it[-1, 2] == pytest.approx(-math.asin(0.5 / 1.5), abs=1e-4)
    without = Particle(Guidance(5.0, 1.0)).run(4.0, 60.0, drift=0.5)
    # U y / sqrt(y^2 + D^2) = drift: the error that LOS without the integral keeps.
    assert without[-1, 1] == pytest.approx(5.0 * math.tan(math.asin(0.5 / 1.5)), rel=1e-4)


@pytest.mark.parametrize("turn", [0.0, 60.0, 90.0, 180.0])
def test_the_integral_is_turned_with_the_current_at_the_end_of_a_leg(turn: float) -> None:
    """What a steady current is across the next leg, of what is known: its part across this one."""
    way = np.radians(turn)
    points = [{"x": 0.0}, {"x": 20.0}, {"x": 20.0 + 9 * float(np.cos(way)), "y": 9 * float(np.sin(way))}]
    gains = ship("pd")
    legs = mission("legs", points, guidance={"lookahead": 5.0, "acceptance": 1.0, "integral": 0.2})
    controller = Controller(gains, legs.reference(gains))
    names, k = list(controller.state_names), controller.gain_values()
    s = np.array(controller.initial_states())
    s[[names.index(n) for n in ("started", "cross_integral", "depth_integral")]] = 1.0, 4.0, 2.0
    for x, factor in ((10.0, 1.0), (19.5, np.cos(way))):
        y = [x, 0.0, 0.0, 0.4, 0.0, 0.0]
        after = np.asarray(controller.sampled(y, controller.mission_numbers, s, k, 0.1)[1]).ravel()
        assert after[names.index("leg")] == (x > 19)
        assert after[names.index("cross_integral")] == pytest.approx(4.0 * factor, abs=1e-12)
        assert after[names.index("depth_integral")] == pytest.approx(2.0)  # trim knows of no turn


@pytest.fixture(scope="module")
def remus() -> GainSet:
    return load_gains(EXAMPLES / "remus100-gains.toml", load_vehicle("remus100"))


ONE_LEG = [{"x": 0.0, "y": 0.0, "z": 5.0}, {"x": 400.0, "y": 0.0, "z": 5.0}]
FINS = {
    "speed": 1.5,
    "limits": {"acceleration": 0.2, "turn_rate": "8 deg/s", "turn_acceleration": "8 deg/s^2"},
    "current": {"east": 0.3},
}


def on_leg(**guidance: object) -> Mission:
    return mission(
        "legs", ONE_LEG, guidance={"lookahead": 15, "integral": 0.3, "acceptance": 5} | guidance, **FINS
    )


def test_a_torpedo_with_fins_comes_to_its_leg_across_a_current(remus: GainSet) -> None:
    moving = Overrides(current=(0.0, 0.3)).in_current(remus.plant.vehicle)
    loop = ClosedLoop(remus, moving, mission=on_leg())
    record = loop.run(Scenario(duration=270.0, dt=0.05, start=(0, 10.0, 5.0), moving={"u": 1.5}))
    assert record.followed is not None
    late = (record.t > 225) & ~record.followed.arrived
    assert np.abs(record.followed.errors["cross track"][late]).max() < 0.2
    assert np.abs(record.followed.errors["depth"][late]).max() < 0.1
    slip = np.arctan2(record.state["v"], record.state["u"])[late] + record.state["psi"][late]
    assert slip == pytest.approx(0.0, abs=5e-3)  # over ground it goes north
    assert record.state["psi"][late] == pytest.approx(-math.asin(0.3 / 1.5), abs=0.03)


@pytest.mark.slow
def test_a_leg_is_certified_and_too_short_a_lookahead_is_not(remus: GainSet) -> None:
    good = check_mission(remus, on_leg(integral=0.1))
    assert good.ok
    # Kinematics alone, with U cos(psi) and k = D / (D^2 + q^2) at the heading psi that the current asks for:
    # s^2 + U cos(psi) k s + U cos(psi) k^2 sigma = 0.
    psi = math.asin(0.3 / 1.5)
    k = math.cos(psi) ** 2 / 15
    slow = np.roots([1, 1.5 * math.cos(psi) * k, 1.5 * math.cos(psi) * k**2 * 0.1]).max()
    assert good.rows[1].margin == pytest.approx(-slow, rel=0.05)
    assert [r.verdict for r in check_mission(remus, on_leg(lookahead=1.5)).rows] == ["holds", "fails"]


@pytest.mark.parametrize("law", DISCONTINUOUS)
def test_a_law_that_jumps_is_not_linearised_on_legs(law: str) -> None:
    """Sampled it has no steady motion, which says nothing against it."""
    rows = check_mission(ship(law), mission("legs", SQUARE, guidance={"lookahead": 3, "acceptance": 1})).rows
    assert [(r.condition, r.verdict) for r in rows] == [("current", "holds"), ("line of sight", "not proved")]
    assert f"law '{law}' is discontinuous" in rows[-1].where


def test_the_track_is_drawn_up_to_the_end_of_the_legs() -> None:
    """Which is not held: what comes after is no part of the mission."""
    legs = mission("legs", SQUARE, guidance={"lookahead": 3, "acceptance": 1})
    record = ClosedLoop(ship("sliding-mode-boundary-layer"), mission=legs).run(
        Scenario(duration=60.0, dt=0.1)
    )
    assert record.result.followed is not None
    arrived = record.result.followed.arrived
    assert arrived is not None
    line = next(line for line in track([record]).axes[0].lines if len(line.get_xdata()) > 10)
    assert len(line.get_xdata()) == np.count_nonzero(record.t <= arrived) < record.t.size


@pytest.mark.slow
def test_legs_of_one_direction_are_judged_together(remus: GainSet) -> None:
    """A lawn mower: out, across, back, across, out; the legs across go the same way."""
    found = check_mission(remus, load_mission(EXAMPLES / "remus100-survey.toml")).rows
    assert [r.condition for r in found] == ["current", "leg 1", "legs 2, 4", "leg 3", "leg 5"]


# --- behind an observer -----------------------------------------------------------------------------
def _observer(noise: float, process: str = "model", push: float = 1e-3, **more: float) -> ObserverTable:
    sensors = {name: {"noise": noise, "period": 0.1} for name in ("x", "y", "psi")}
    driven = ("u", "v", "r") if process == "model" else ("u_dot", "v_dot", "r_dot")
    own = dict.fromkeys(driven, push) | more
    content = {"schema": "undertow/observer/1", "name": "gnss", "process": process, "estimate": [*more]}
    return ObserverTable.model_validate(content | {"sensors": sensors, "disturbance": own})


FOUR = [{"x": 0.0, "y": 0.0}, {"x": 15.0}, {"x": 15.0, "y": 10.0}, {"y": 10.0}, {"x": 0.0}]
WATER = {"north": 0.03, "east": 0.05}


def _four_legs(observer: ObserverTable | None) -> Record:
    guidance = {"lookahead": 3.0, "acceptance": 1.0, "integral": 0.05}
    legs = mission("legs", FOUR, speed=0.2, guidance=guidance, current=WATER)
    gains = ship("pid", gains={"K_P": 5.0, "K_V": 30.0, "K_I": 0.1})
    chosen = None if observer is None else design(observer, gains.plant.vehicle)
    plant = Overrides(current=legs.current).in_current(gains.plant.vehicle)
    loop = ClosedLoop(gains, plant, mission=legs, observer=chosen)
    return loop.run(Scenario(duration=legs.simulation_time(gains.plant.vehicle.pose_names), dt=0.1))


@pytest.mark.slow
def test_a_mission_behind_an_observer_is_that_of_true_states() -> None:
    """Its states stand before those of the guidance: legs and the end have to be read behind them."""
    true = _four_legs(None).result.followed
    seen = _four_legs(_observer(1e-5, V_N=1e-3, V_E=1e-3)).result.followed
    assert true is not None
    assert seen is not None
    assert true.arrived is not None
    assert seen.arrived == pytest.approx(true.arrived, abs=0.5)
    for mine, own in zip(seen.errors, true.errors, strict=True):
        assert (mine.rms, mine.largest) == pytest.approx((own.rms, own.largest), abs=0.01)


@pytest.mark.slow
def test_legs_in_a_current_are_followed_by_estimates_that_are_near_the_truth() -> None:
    record = _four_legs(_observer(0.02, V_N=3e-3, V_E=3e-3))
    assert record.followed is not None
    assert record.result.followed is not None
    assert record.result.followed.arrived is not None
    late = (record.t > 30.0) & (record.t < record.result.followed.arrived)
    following = np.flatnonzero(late) + 1  # a row holds what is foretold for the next one
    for name, bound in (("x", 0.02), ("y", 0.02), ("u", 0.02), ("v", 0.02)):
        error = record.estimated[name][late] - record.state[name][following]
        assert np.sqrt(np.mean(error**2)) < bound
    for name, true in zip(("V_N", "V_E"), WATER.values(), strict=True):
        assert record.estimated[name][late].mean() == pytest.approx(true, abs=0.01)
    cross = np.abs(record.followed.errors["cross track"])[late]
    assert np.median(cross) < 0.3
    assert cross.max() < 1.5  # at a change of legs it is measured from the next one, 1 m off


def test_gains_judge_the_loop_behind_an_observer() -> None:
    gains = ship("pd")
    vehicle = gains.plant.vehicle
    found = certify(gains, observer=design(_observer(0.02), vehicle), forms=["derived"]).loop_with_observer
    loop = close_loop(vehicle, gains)
    filter = SteadyStateFilter(design(_observer(0.02), vehicle), loop.trim)
    # The separation principle: poles of the law and of the filter.
    slowest = max(
        [*np.linalg.eigvals(loop.closed.A).real, *np.linalg.eigvals(filter.a - filter.gain @ filter.c).real]
    )
    assert found is not None
    assert found.verdict == "stable"
    assert found.pole is not None
    assert found.pole.real == pytest.approx(slowest, rel=1e-4)
    # Kinematics do not know of the commands: a filter that is slow beside the law makes the loop grow.
    slow = certify(gains, observer=design(_observer(5.0, "kinematics", 1e-4), vehicle), forms=["derived"])
    assert slow.loop_with_observer is not None
    assert slow.loop_with_observer.verdict == "unstable"
    assert (slow.ok, replace(slow, loop_with_observer=None).ok) == (False, True)


# --- C ----------------------------------------------------------------------------------------------
@pytest.mark.skipif(sys.platform == "win32", reason="compiles with options of cc")
@pytest.mark.parametrize(
    ("kind", "compiler"),
    quick_if(
        lambda case: case[1] == "gcc" or case[0] == "spline",
        product(["spline", "legs", "spline of sight"], ["gcc", "clang"]),
    ),
)
def test_a_mission_in_c_is_that_of_python(kind: str, compiler: str, remus: GainSet, tmp_path: Path) -> None:
    if not shutil.which(compiler):
        pytest.skip(f"no {compiler} on this machine")
    gains = ship("pid", allocation={"limits": {"T1": 1.0}}) if kind == "spline" else remus
    name = "remus100-survey.toml" if kind == "legs" else "remus100-spline.toml"
    survey = load_mission(EXAMPLES / name)
    controller = Controller(
        gains, (mission("spline", SQUARE) if kind == "spline" else survey).reference(gains)
    )
    library = Library(gains.plant.vehicle, [(gains.name, lambda c: controller_c(controller, c))])
    made = library.write(tmp_path).folder
    name = f"{library.name}_{slug(gains.name).replace('-', '_')}"
    flags = (
        "-std=c99",
        "-Wall",
        "-Wextra",
        "-Wpedantic",
        "-Werror",
        "-O1",
        "-ffp-contract=off",
        "-fPIC",
        "-shared",
    )
    done = subprocess.run(
        [compiler, *flags, f"src/{name}.c", "-lm", "-o", "c.so"], cwd=made, capture_output=True,
        text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    library = ctypes.CDLL(str(made / "c.so"))
    r = np.array(controller.mission_numbers)
    assert (np.array((ctypes.c_double * len(r)).in_dll(library, f"{name}_mission_default")) == r).all()
    function, random = controller.sampled, np.random.default_rng(2)
    s, k = np.zeros(function.size1_in("s")), np.array(controller.gain_values())
    p = np.array(list(controller.parametrised().values.values()))
    getattr(library, f"{name}_start")(pointer(s))
    n, expected = function.size1_in("y") // 2, np.array(controller.initial_states())
    u, tau = np.zeros(function.size1_out("u")), np.zeros(n)
    y, seen = np.zeros(2 * n), set()
    of_kind = {"legs": "leg", "spline": "mission_time", "spline of sight": "path"}
    for i in range(600):
        y[:2] = survey.points[min(i // 100, len(survey.points) - 1), :2] * (
            0.02 if kind == "spline" else 1
        ) + random.normal(size=2)
        y[2:] = 0.2 * random.normal(size=2 * n - 2)
        arguments = map(pointer, (y, r, s, p))
        getattr(library, f"{name}_step")(*arguments, ctypes.c_double(0.1), *map(pointer, (u, s, tau)))
        found = [np.asarray(v).ravel() for v in function(y, r, expected, k, 0.1)]
        expected = found[1]
        for mine, python in zip((u, s, tau), found, strict=True):
            assert mine == pytest.approx(python, abs=1e-12, rel=1e-12)
        seen.add(float(s[controller.state_names.index(of_kind[kind])]))
    assert len(seen) > 3


# --- files ------------------------------------------------------------------------------------------
P = [{"x": 0.0}, {"x": 5.0}]
BAD = {
    "a unit": (lambda: mission("spline", P, speed="0.4 kg"), "speed"),
    "no speed": (lambda: mission("spline", P, speed=0.0), "speed = 0.0: give one from 1e-06"),
    "no times": (lambda: mission("trajectory", P).profile(NAMES), "way-point 1 of the trajectory has no"),
    "times back": (
        lambda: mission("trajectory", [{"t": 0}, {"x": 1.0, "t": 0}]).profile(NAMES),
        "way-point 2 has t = 0 s, not later than the one before",
    ),
    "a time that is not kept": (lambda: mission("spline", [{"t": 0}, {"x": 1.0}]), "way-point 1 has a time"),
    "twice the same": (lambda: mission("spline", [*P, {"x": 5.0}]), "way-points 2 and 3 are 0 m apart"),
    "all the same": (lambda: mission("setpoints", [P[0], P[0]]).profile(NAMES), "all the same pose"),
    "guidance of set-points": (lambda: mission("setpoints", P, guidance={}), "is for kind = 'legs' or"),
    "heading of legs": (lambda: mission("legs", P, heading=0.0), "remove psi and heading"),
    "far away": (lambda: mission("spline", [{"x": 0.0}, {"x": 1e9}]), "beyond 1e\\+06 m: check the unit"),
    "a ship at depth": (
        lambda: mission("spline", [{"z": 0.0}, {"z": 5.0, "x": 2.0}]).reference(ship("pd")),
        "way-points have z, which 'cybership2' does not move in",
    ),
}  # fmt: skip


@pytest.mark.parametrize("fault", BAD)
def test_a_mission_that_cannot_be_is_refused_in_one_line(fault: str) -> None:
    make, words = BAD[fault]
    with pytest.raises(UndertowError, match=words) as refused:
        make()
    assert "\n" not in str(refused.value)


def test_a_torpedo_holds_no_place_and_needs_a_speed_for_its_fins(remus: GainSet) -> None:
    with pytest.raises(UndertowError, match="controls y, in which 'remus100' has no actuator"):
        mission("setpoints", P).reference(remus)
    without = remus.allocation.model_copy(update={"speed": None})
    content = {
        "schema": "undertow/gains/1", "name": "a", "law": "pd", "gains": {"K_P": 1.0, "K_V": 1.0},
        "allocation": without, "unactuated": ["sway", "heave", "pitch", "yaw", "roll"],
    }  # fmt: skip
    drifting = gains_from_table(GainTable.model_validate(content), load_vehicle("remus100"))
    with pytest.raises(UndertowError, match=r"legs need a force in yaw.*\[allocation\] speed"):
        mission("legs", P).reference(drifting)
