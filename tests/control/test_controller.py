"""Thrust allocation and one sample of a controller."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import lsq_linear

from undertow.control.controller import Controller, SymbolicAllocation, thruster_commands
from undertow.control.gains import (
    Allocation,
    AllocationTable,
    GainSet,
    ScheduleTable,
    allocation_of,
    load_gains,
)
from undertow.errors import UndertowError
from undertow.model.loading import load_vehicle

AUV = load_vehicle("mini-auv")
ROV = np.array(load_vehicle("bluerov2").allocation.tolist(), dtype=float)


def gain_set(name: str = "paper-pid", **changes: object) -> GainSet:
    return replace(load_gains(name, AUV), **changes)


def sample(
    controller: Controller, y: list[float], r: list[float], s: list[float] | None = None, dt: float = 0.1
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    states = controller.initial_states() if s is None else s
    found = controller.sampled(y, r, states, controller.gain_values(), dt)
    return tuple(np.asarray(v).ravel() for v in found)  # type: ignore[return-value]


# --- allocation -------------------------------------------------------------------------------
def test_the_paper_s_allocation_comes_out() -> None:
    """(4) and (5) with no roll moment and d = 0: f1 = f3 = Z / 2, f2 and f4 = (X +- N / l_y) / 2."""
    f = commands(allocation_of(gain_set()), [0.4, 99.0, -3.0, 0.02])
    assert f == pytest.approx([-1.5, 0.2 + 0.02 / 0.32, -1.5, 0.2 - 0.02 / 0.32], abs=1e-14)


def commands(allocation: Allocation, force: Sequence[float]) -> np.ndarray:
    return allocating(allocation)(force)


def allocating(allocation: Allocation) -> Callable[[Sequence[float]], np.ndarray]:
    wanted = ca.SX.sym("force", len(allocation.matrix))
    function = ca.Function(
        "allocate", [wanted], [thruster_commands(SymbolicAllocation.of(allocation), wanted)]
    )
    return lambda force: np.asarray(ca.densify(function(force))).ravel()


def rov(limit: float = math.inf, weights: np.ndarray | None = None) -> Allocation:
    m = ROV.shape[1]
    return Allocation(ROV, tuple(range(6)), np.ones(m) if weights is None else weights, np.full(m, limit))


def test_without_limits_it_is_the_weighted_pseudo_inverse() -> None:
    rng = np.random.default_rng(1)
    for _ in range(5):
        tau, weights = rng.normal(size=6), rng.uniform(0.2, 5, ROV.shape[1])
        f = commands(rov(weights=weights), tau)
        root = np.sqrt(weights)
        expected = np.linalg.lstsq(ROV / root, tau, rcond=None)[0] / root
        assert f == pytest.approx(expected, abs=1e-12)
        assert ROV @ f == pytest.approx(tau, abs=1e-12)
        assert commands(rov(1e3, weights), tau) == pytest.approx(f, abs=1e-14)


def test_limits_hold_and_the_others_take_over() -> None:
    rng = np.random.default_rng(2)
    helped, without, within = 0, allocating(rov()), allocating(rov(12.0))
    for _ in range(60):
        tau = rng.normal(size=6) * [30, 30, 30, 4, 4, 4]
        plain, f = np.clip(without(tau), -12, 12), within(tau)
        assert np.abs(f).max() <= 12
        best = lsq_linear(ROV, tau, (-12, 12)).cost
        left = 0.5 * np.sum((tau - ROV @ f) ** 2)
        assert left <= 0.5 * np.sum(tau**2)
        if best < 1e-12 < 0.5 * np.sum((tau - ROV @ plain) ** 2):
            helped += left < 1e-6
    assert helped >= 5


def test_a_limit_of_one_thruster_is_taken_over_exactly() -> None:
    """Two thrusters abreast and one between them: what the middle one cannot give the two give."""
    matrix = np.array([[1.0, 1.0, 1.0], [-0.2, 0.0, 0.2]])
    f = commands(Allocation(matrix, (0, 1), np.ones(3), np.array([9.0, 1.0, 9.0])), [6.0, 0.2])
    assert f == pytest.approx([2.0, 1.0, 3.0], abs=1e-6)


# --- a sample -----------------------------------------------------------------------------------
def test_pid_by_hand() -> None:
    controller = Controller(gain_set(schedule=ScheduleTable()))
    y, r = [0.1, -0.2, 0.3, 0.5, 0.2, 0.0, -0.1, 0.05], [-1.0, 1.0, 1.0, 0.7]
    s = [0.5, -0.4, 0.3, 0.2, 1.0]
    u, s_next, tau = sample(controller, y, r, s, dt=0.1)
    kp, kv, ki = (
        np.array([0.012, 0.012, 1, 0.01]),
        np.array([0.005, 0.005, 3, 0.5]),
        np.array([0.0003, 0.0003, 0.0005, 0.00005]),
    )
    c, sn = math.cos(0.5), math.sin(0.5)
    j = np.array([[c, -sn, 0, 0], [sn, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    e = np.array(r) - y[:4]
    expected = j.T @ (kp * e - kv * (j @ y[4:]) + ki * s[:4]) + [0, 0, -14.309872, 0]
    expected[1] = 0  # nothing pushes sideways
    assert tau == pytest.approx(expected, abs=1e-13)
    assert controller.allocation.matrix @ u == pytest.approx(expected, abs=1e-13)
    assert s_next == pytest.approx([*(np.array(s[:4]) + 0.1 * e), 1.0], abs=1e-15)


def test_headings_go_the_short_way_round() -> None:
    controller = Controller(gain_set("paper-pd", schedule=ScheduleTable()))
    _, _, tau = sample(controller, [0, 0, 0, 3.0, 0, 0, 0, 0], [0, 0, 0, -3.0])
    assert tau[3] == pytest.approx(0.1 * (2 * math.pi - 6.0))


def test_x_and_y_wait_for_the_heading_and_the_gate_stays_open() -> None:
    controller = Controller(gain_set())
    r = [-1.0, 1.0, 1.0, 2.0]
    _, s, tau = sample(controller, [0, 0, 0, 0, 0, 0, 0, 0], r)
    assert (tau[0], s[-1]) == (0.0, 0.0)
    assert s[:2] == pytest.approx(0)
    assert s[2] == pytest.approx(0.1)
    _, s, tau = sample(controller, [0, 0, 0, 2.01, 0, 0, 0, 0], r)
    assert s[-1] == 1.0
    assert tau[0] == pytest.approx(0.012 * (-math.cos(2.01) + math.sin(2.01)))
    _, later, tau = sample(controller, [0, 0, 0, 1.0, 0, 0, 0, 0], r, list(s))
    assert later[-1] == 1.0
    assert tau[0] != 0


def test_integrals_may_begin_at_the_start() -> None:
    schedule = ScheduleTable(order="yaw-first", integrators="start")
    controller = Controller(gain_set(schedule=schedule))
    _, s, tau = sample(controller, [0] * 8, [-1.0, 1.0, 1.0, 2.0], [3.0, 3.0, 0, 0, 0])
    assert s[:2] == pytest.approx([2.9, 3.1])
    assert tau[0] == 0


@pytest.mark.parametrize(("kind", "held"), [("hold", True), ("none", False)])
def test_an_integral_that_pushes_into_a_limit_is_held(kind: str, held: bool) -> None:
    """Net weight 14.3 N, thrusters 5 N each: they are at their limit upwards."""
    table = AllocationTable(limits={"f1": "5 N", "f3": "5 N"}, anti_windup=kind)  # type: ignore[arg-type]
    controller = Controller(gain_set(schedule=ScheduleTable(), allocation=table))
    u, s, _ = sample(controller, [0] * 8, [0.0, 0.0, -1.0, 0.0])
    assert u[[0, 2]] == pytest.approx(-5)
    assert s[2] == (0.0 if held else pytest.approx(-0.1))
    _, s, _ = sample(controller, [0] * 8, [0.0, 0.0, 1.0, 0.0])
    assert s[2] == pytest.approx(0.1)  # towards the inside of the limit it may run


def test_continuous_and_sampled_are_the_same_law() -> None:
    controller = Controller(gain_set())
    y, r, s, k = [0.1, 0, 0, 2.0, 0.1, 0, 0, 0.1], [-1, 1, 1, 2.0], [0.1, 0.2, 0.3, 0.1, 1], None
    k = controller.gain_values()
    u, s_dot, tau = controller.continuous(y, r, s, k)
    u2, s_next, tau2 = controller.sampled(y, r, s, k, 0.5)
    assert np.asarray(u == u2).all()
    assert np.asarray(tau == tau2).all()
    assert np.asarray(s_next).ravel() == pytest.approx(np.array(s) + 0.5 * np.asarray(s_dot).ravel())


# --- bad input ------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("table", "words"),
    [
        (AllocationTable(limits={"f1": "-1 N"}), "above zero"),
        (AllocationTable(limits={"f1": "1 kg"}), "limit of 'f1'"),
    ],
)
def test_limits_that_are_none_are_refused(table: AllocationTable, words: str) -> None:
    with pytest.raises(UndertowError, match=words):
        Controller(gain_set(allocation=table))
