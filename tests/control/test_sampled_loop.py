"""How slowly a loop may be sampled, what sampling leaves, and oscillations that last."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.control.loops import GOAL, law_of, loop, run
from undertow.control.closed_loop import ClosedLoop, Push, Scenario
from undertow.control.closed_loop.interconnection import SampledLoop, sampling_offsets
from undertow.control.closed_loop.measures import find_cycle
from undertow.control.gains import GainTable, gains_from_table
from undertow.errors import UndertowError
from undertow.model.loading import load_vehicle


# --- sampling intervals ------------------------------------------------------------------------------
def test_the_longest_interval_is_where_the_sampled_loop_turns_unstable() -> None:
    """Depth under PD: M w_dot = -D w - k_p e - k_v w, sampled; the limit is that of the whole loop."""
    pd = loop("paper-pd")
    goal = np.array([-1.0, 1.0, 1.0, 2.0])
    limit = SampledLoop(pd.parts, goal, goal).longest_interval()
    assert 0.5 < limit < 2
    good, bad = (
        run("paper-pd", to=(*GOAL, 0.01), start=(-1.0, 1.0, 1.0, 0.0), duration=60 * dt, dt=dt)
        if ok
        else None
        for ok, dt in ((True, 0.97 * limit), (False, 1.03 * limit))
    )
    assert bad is None
    assert abs(good.result.of("psi").final_error) < 0.01
    with pytest.raises(UndertowError, match=f"dt = {1.03 * limit:g} s is too long .* limit is {limit:.3g} s"):
        run("paper-pd", dt=1.03 * limit)


def test_eigenvalues_of_the_sampled_loop_become_those_of_the_continuous_one() -> None:
    """The unstable roots of Table 5's PID in surge, with either set of parameters."""
    pid = loop("paper-pid")
    goal = np.array([-1.0, 1.0, 1.0, 3 * math.pi / 4])
    linear = SampledLoop(pid.parts, goal, goal)
    forward = linear.continuous_rates(0)
    assert min(abs(forward - (0.003198 + 0.038054j))) < 1e-6
    backward = linear.continuous_rates(1)
    assert min(abs(backward - (0.005482 + 0.038392j))) < 1e-6
    sampled = linear.sampled_rates(1e-3)
    assert max(min(abs(sampled - r)) for r in forward) < 2e-3
    assert linear.keeps_stability(1e-3)  # unstable it is, but not by sampling


def test_damping_of_pd_in_surge() -> None:
    goal = np.array([-1.0, 1.0, 1.0, 3 * math.pi / 4])
    linear = SampledLoop(loop("paper-pd").parts, goal, goal)
    for side, expected in ((0, 0.792650), (1, 0.761194)):
        rates = linear.continuous_rates(side)
        swinging = rates[np.abs(rates.imag) > 1e-3][0]
        assert -swinging.real / abs(swinging) == pytest.approx(expected, abs=1e-6)


def test_a_boundary_layer_may_be_sampled_as_slowly_as_its_slope_allows() -> None:
    """S_next = (1 - K_Z dt / width M_law / M) S; the law takes the mean of both sets of heave for M."""
    layer = law_of("sliding-mode-boundary-layer", K_Z=1.0, width=0.01, Lambda=0.05)
    goal = np.zeros(4)
    assert SampledLoop(layer.parts, goal, goal).longest_interval() == pytest.approx(
        2 * 0.01 / 1.0 * 10.088308 / 10.748347, rel=0.01
    )


def test_super_twisting_learns_a_push_and_a_boundary_layer_does_not() -> None:
    scenario = Scenario((0.0, 0.0, 1.0, 0.0), 60.0, 0.001, pushes=(Push("Z", 1.0),))
    twisting = law_of("super-twisting", K_1=0.3, K_2=0.1, Lambda=0.3).run(scenario).result
    layer = law_of("sliding-mode-boundary-layer", K_Z=0.3, width=0.02, Lambda=0.3).run(scenario).result
    sign = law_of("sliding-mode", K_Z=0.3, Lambda=0.3).run(scenario).result
    assert abs(twisting.of("z").final_error) < 1e-4
    # Push = M K_Z S / width; M is of one set of parameters or the mean of both, as the vehicle creeps.
    expected = [0.02 / (0.3 * mass) / 0.3 for mass in (11.408386, 10.088308)]
    assert expected[0] <= -layer.of("z").final_error * (1 + 1e-6)
    assert -layer.of("z").final_error <= expected[1] * (1 + 1e-6)
    assert layer.commands[0].variation < 0.01 * sign.commands[0].variation


def test_without_a_way_to_go_the_heading_is_kept() -> None:
    result = run("paper-pd", to=(0, 0, 1), start=(0, 0, 0, 0.4), duration=1.0, dt=0.01).result
    assert result.to["psi"] == 0.4


def test_offsets_of_the_sampled_sign() -> None:
    found = sampling_offsets(loop("paper-smc").parts, 1e-3)
    assert found["z"] == pytest.approx(0.0142857, abs=1e-6)
    assert sampling_offsets(loop("paper-pd").parts, 1e-3) == {}
    with pytest.raises(UndertowError, match=r"leave 2.86 in z on a way of 1; it must be below 0.07 s"):
        run("paper-smc", dt=0.2)


def test_super_twisting_stays_within_its_estimate() -> None:
    """On a double integrator: S of the order of dt^2, below the estimate whatever the gains."""
    k_1, k_2 = (a.ravel() for a in np.meshgrid(np.geomspace(0.1, 10, 9), np.geomspace(0.01, 100, 9)))
    few = (k_2 / k_1**2 > 0.01) & (k_2 / k_1**2 < 100)
    k_1, k_2, slope = k_1[few], k_2[few], 0.3
    estimate = (k_1 + k_2 / k_1) ** 2 / slope
    error, speed, twist, largest = 0.1 * estimate, 0.0, np.zeros_like(k_1), np.zeros_like(k_1)
    for i in range(6000):
        surface = slope * error - speed
        pull = k_1 * np.sqrt(np.abs(surface)) * np.sign(surface) + twist - slope * speed
        twist = twist + k_2 * np.sign(surface)
        error, speed = error - speed - pull / 2, speed + pull
        if i > 4000:
            largest = np.maximum(largest, np.abs(error))
    assert (largest < estimate).all()
    assert (largest > 0.3 * estimate).any()


def test_super_twisting_has_a_longest_interval() -> None:
    twisting = law_of("super-twisting", K_1=1.0, K_2=0.5, Lambda=0.8)
    assert sampling_offsets(twisting.parts, 0.01)["z"] == pytest.approx(1.5**2 * 1e-4 / 0.8)
    with pytest.raises(
        UndertowError, match=r"is estimated to leave 2.81 in z on a way of 1; .* below 0.596 s"
    ):
        twisting.run(Scenario((0.0, 0.0, 1.0, 0.0), 20.0, 1.0))
    z = twisting.run(Scenario((0.0, 0.0, 1.0, 0.0), 40.0, 0.05)).result.of("z")
    assert 0 < abs(z.steady_error) + z.steady_spread < z.sampling_offset
    assert z.sampling_offset == pytest.approx(2.25 * 0.0025 / 0.8)


# --- oscillations ---------------------------------------------------------------------------------------
T = np.arange(0.0, 100.0, 0.05)


@pytest.mark.parametrize(("growth", "kind"), [(0.0, "limit cycle"), (0.02, "growing"), (-0.02, "decaying")])
def test_oscillations_are_told_apart(growth: float, kind: str) -> None:
    cycle = find_cycle(T, 0.3 + 0.2 * np.exp(growth * T) * np.sin(2 * np.pi * T / 7), 1e-3)
    assert cycle is not None
    assert cycle.kind == kind
    assert cycle.period == pytest.approx(7, abs=0.05)
    if not growth:
        assert cycle.amplitude == pytest.approx(0.2, rel=1e-3)


@pytest.mark.parametrize(
    "error",
    [np.exp(-T / 10), np.zeros_like(T), np.sin(2 * np.pi * T / 45), 1e-5 * np.sin(T), np.sin(T**1.5 / 9)],
)
def test_what_is_no_lasting_oscillation_is_none(error: np.ndarray) -> None:
    assert find_cycle(T, error, 1e-3) is None


# --- other vehicles ---------------------------------------------------------------------------------
def test_sliding_mode_moves_every_vehicle_alike() -> None:
    """It takes out the vehicle's own dynamics: a ship with five thrusters, a box pushed by a known force."""
    content = {"schema": "undertow/gains/1", "name": "smc", "law": "sliding-mode-boundary-layer"}
    table = GainTable.model_validate(content | {"gains": {"K_Z": 0.3, "Lambda": 0.5, "width": 0.05}})
    goals = {"cybership2": (2.0, 1.0, 1.0), "box-hull": (2.0,)}
    moved = {
        name: ClosedLoop(gains_from_table(table, load_vehicle(name))).run(Scenario(to, 20.0, 0.001))
        for name, to in goals.items()
    }
    ship, box = moved.values()
    assert ship.state["x"] == pytest.approx(box.state["x"], abs=1e-3)
    # S falls by 0.3 m/s^2 from 1 m/s, the error follows S = 0.5 error - velocity.
    assert float(np.interp(2.0, box.t, 0.5 * box.errors["x"] - box.state["u"])) == pytest.approx(
        0.4, abs=1e-3
    )
