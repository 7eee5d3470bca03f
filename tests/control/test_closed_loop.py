"""Closed loops against exact solutions, against each other, and against physics."""

from __future__ import annotations

import math
from dataclasses import astuple, replace

import numpy as np
import pytest

from tests.control.loops import AUV, CREEPING, GOAL, WITH_CORIOLIS, loop, run
from tests.quick import first_quick
from undertow.control.closed_loop import ClosedLoop, Overrides, Push, Scenario
from undertow.control.closed_loop.interconnection import SampledLoop
from undertow.control.closed_loop.measures import divergence, implausible
from undertow.control.closed_loop.scenario import RUNS
from undertow.control.closed_loop.stepping import VirtualLoop
from undertow.control.gains import GainTable, ScheduleTable, gains_from_table, load_gains
from undertow.errors import UndertowError
from undertow.model.catalogue import catalogue
from undertow.model.loading import load_vehicle
from undertow.model.symbols import FASTEST
from undertow.model.vehicle import Value

# --- 240 s at 1 ms: the rows of the paper's three controllers -----------------------------------
ROWS = {
    # gate, then of x, y, z and psi: t2%, of x and y: overshoot in %, error at the end
    "paper-pd": (
        22.877,
        {"x": 54.16, "y": 53.17, "z": 44.99, "psi": 18.38},
        (0.32, 0.91),
        (-2.9e-3, -2.9e-3),
    ),
    "paper-pid": (99.256, {"x": None, "y": None, "z": 34.74}, (109, 32), (0.016, 0.22)),
    "paper-smc": (32.702, {"x": 50.15, "y": 48.96, "z": 51.68, "psi": 26.20}, (0, 0.59), (-5.5e-3, -5.9e-3)),
}


@pytest.mark.parametrize("gains", first_quick(ROWS))
def test_the_paper_s_run(gains: str) -> None:
    gate, settling, overshoot, final = ROWS[gains]
    result = run(gains, moving=CREEPING).result
    assert result.gate_passed == pytest.approx(gate, abs=1e-9)
    for name, expected in settling.items():
        found = result.of(name).settling
        # The values to compare with are times of rows 10 ms apart, the first after the crossing.
        assert found == expected if expected is None else expected - 0.011 < found <= expected + 0.0005, name
    for name, percent, error in zip("xy", overshoot, final, strict=True):
        digits = 0.5 if percent > 1 else 0.005
        assert result.of(name).overshoot == pytest.approx(percent, abs=digits)
        assert result.of(name).final_error == pytest.approx(error, rel=0.04)
    assert result.diverged is None


def test_nothing_moves_sideways() -> None:
    assert np.abs(run("paper-pd", moving=CREEPING).state["v"]).max() == 0


def test_pd_by_its_linear_channels() -> None:
    result = run("paper-pd", continuous=True, moving=CREEPING, log_interval=0.5)
    assert result.result.of("psi").settling == pytest.approx(18.376616, abs=2e-6)
    assert result.result.of("z").settling == pytest.approx(44.988777, abs=2e-6)
    at_60 = float(result.errors["z"][result.t == 60.0][0])
    assert at_60 == pytest.approx(0.005273879, abs=2e-9)


def test_the_paper_s_other_arctangent() -> None:
    """(42) as printed: -45 degrees, backwards to the goal."""
    result = run("paper-pd", Overrides(heading="atan"), duration=60.0, continuous=True).result
    assert result.to["psi"] == pytest.approx(-math.pi / 4)
    # The gate is seen at the first sample behind it.
    assert 0 <= result.gate_passed - 17.899241 < 1e-3
    assert run("paper-pd", duration=60.0).result.gate_passed == pytest.approx(22.877, abs=1e-9)
    sliding = run("paper-smc", Overrides(heading="atan"), dt=2e-5, duration=27.0).result
    assert sliding.gate_passed == pytest.approx(25.437, abs=0.05)


def test_pid_by_its_linear_channels() -> None:
    result = run("paper-pid", continuous=True, duration=700.0, moving=CREEPING, log_interval=0.5)
    psi = result.result.of("psi")
    assert psi.settling == pytest.approx(543.413228, abs=2e-6)
    assert psi.overshoot == pytest.approx(13.879414, abs=1e-6)
    assert float(result.errors["psi"][result.t == 240.0][0]) == pytest.approx(-0.309198, abs=5e-7)
    assert result.result.of("z").settling == pytest.approx(34.740184, abs=2e-6)


def test_the_paper_s_pid_ends_in_a_limit_cycle() -> None:
    result = run("paper-pid", duration=3000.0, dt=0.002).result
    cycle = result.of("along track").cycle
    assert cycle is not None
    assert cycle.kind == "limit cycle"
    assert cycle.amplitude == pytest.approx(0.67, abs=0.005)
    assert cycle.period == pytest.approx(175.2, abs=0.5)
    assert cycle.spread < 0.1
    # Describing function of |u| u, 8 / (3 pi) of the amplitude, with the mean of both sets of parameters.
    m, linear, quadratic = 9.2818315, 0.005 + 0.116671, 5.510979
    omega = math.sqrt(0.012 / m)
    amplitude = (m * 0.0003 / 0.012 - linear) * 3 * math.pi / (8 * quadratic * omega)
    assert cycle.period == pytest.approx(2 * math.pi / omega, rel=0.005)
    assert cycle.amplitude == pytest.approx(amplitude, rel=0.03)


def test_integrals_that_start_at_once_overshoot_more() -> None:
    result = run("paper-pid", Overrides(integrators="start"), duration=240.0).result
    assert max(result.of(n).overshoot for n in ("x", "along track")) == pytest.approx(266, abs=5)


# --- the sign, sampled ---------------------------------------------------------------------------
@pytest.mark.slow
def test_sliding_mode_nears_its_exact_solution_as_it_is_sampled_faster() -> None:
    """Reaching in |S| / K_Z = 14 s, then exponential; what the sampled sign leaves is within its bound."""
    overrides = Overrides(order="together", sway="actuated")
    for dt in (1e-3, 1e-4, 4e-5):
        found = run("paper-smc", overrides, duration=70.0 if dt > 1e-4 else 28.0, dt=dt, moving=CREEPING)
        assert found.result.of("x").settling == pytest.approx(16.327979, abs=0.011 * dt / 1e-3 + 5e-4)
        if dt == 1e-3:
            x = found.result.of("x")
            assert abs(x.final_error) <= x.sampling_offset == pytest.approx(0.05e-3 / 0.7)
    exact = {"z": (55.921057, 0.07), "psi": (26.257649, 0.15)}
    for dt in (1e-3, 1e-4, 4e-5):
        result = run("paper-smc", duration=70.0, dt=dt).result
        for name, (time, slope) in exact.items():
            c = result.of(name)
            band = 0.02 * abs(c.move)
            late = [math.log((band + side * c.sampling_offset) / band) / slope for side in (-1, 1)]
            assert late[0] - 0.1 <= c.settling - time <= late[1] + 0.1
    late = math.log(1 + result.of("psi").sampling_offset / math.radians(1)) / 0.15
    assert abs(result.gate_passed - 32.879) <= late


def test_reaching_time() -> None:
    overrides = Overrides(order="together", sway="actuated")
    record = run("paper-smc", overrides, duration=16.0, dt=1e-4, log_interval=0.01, moving=CREEPING)
    surface = 0.7 * record.errors["x"] - np.gradient(record.state["x"], record.t)
    assert float(record.t[np.flatnonzero(np.abs(surface) > 2e-3)[-1]]) == pytest.approx(14.0, abs=0.06)


# --- without sampling --------------------------------------------------------------------------------
def damped(k_v: float) -> ClosedLoop:
    """A hull that is pushed by a known force, under PD."""
    content: dict[str, object] = {"schema": "undertow/gains/1", "name": "stiff", "law": "pd"}
    content |= {"gains": {"K_P": 200.0, "K_V": k_v}}
    return ClosedLoop(gains_from_table(GainTable.model_validate(content), load_vehicle("box-hull")))


def test_a_fast_loop_without_sampling_is_integrated_in_steps_that_suit_it() -> None:
    """The vehicle alone asks for no step this short; at 0.05 s the fast root is far outside Runge-Kutta's."""
    stiff = damped(3e4)
    rates = SampledLoop(stiff.parts, np.zeros(1), np.zeros(1)).continuous_rates()
    assert rates.real.min() * 0.05 < -3
    record = stiff.run(Scenario((1.0,), 10.0, 0.05, continuous=True))
    assert record.result.diverged is None
    slow = rates.real[rates.real < 0].max()
    assert float(record.errors["x"][-1]) == pytest.approx(math.exp(10 * slow), rel=1e-3)
    with pytest.raises(UndertowError, match=r"as fast as .* steps, but 5e\+07 is the limit"):
        damped(9e11).run(Scenario((1.0,), 10.0, 0.05, continuous=True))


# --- model, controller and integrator together -----------------------------------------------------
@pytest.mark.parametrize("continuous", first_quick([False, True]))
@pytest.mark.parametrize("gains", first_quick(["paper-pid", "paper-smc"]))
def test_without_a_compiler_the_numbers_are_the_same(gains: str, continuous: bool) -> None:
    disturbed = Scenario(
        GOAL, 3.0, 0.01, continuous=continuous, noise={} if continuous else {"x": 0.01, "r": 0.02}
    )
    law = load_gains(gains, WITH_CORIOLIS, lambda t: t.model_copy(update={"schedule": ScheduleTable()}))
    scenario = replace(disturbed, pushes=(Push("Z", 1.0, 1.0, 2.0),), log_interval=0.01, moving=CREEPING)
    vehicle = Overrides(current=(0.1, -0.05)).in_current(WITH_CORIOLIS)
    vehicle = vehicle.with_effect(catalogue()["thruster_lag"], {"T_lag": Value(0.2)})
    late = {"delay": Value(0.05)}
    vehicle = vehicle.with_effect(catalogue()["actuation_delay"], late) if not continuous else vehicle
    record = ClosedLoop(law, vehicle, compiled=True).run(scenario)
    again = ClosedLoop(law, vehicle, compiled=False)
    assert isinstance(again.stepper, VirtualLoop)
    for one, expected in zip(again.run(scenario).state.values(), record.state.values(), strict=True):
        assert one == pytest.approx(expected, abs=1e-12)
    assert record.state["x"].any()


def test_a_long_run_in_parts_is_the_same_as_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = Scenario(GOAL, 2.0, 0.001, noise={"psi": 0.01}, seed=3)
    at_once = loop("paper-pd").run(scenario)
    in_many_parts = replace(RUNS, samples_per_call=77)
    monkeypatch.setattr("undertow.control.closed_loop.simulate.RUNS", in_many_parts)
    in_parts = loop("paper-pd").run(scenario)
    for one, other in zip(in_parts.result.coordinates, at_once.result.coordinates, strict=True):
        assert replace(one, steady_error=0.0) == replace(other, steady_error=0.0)
        assert one.steady_error == pytest.approx(other.steady_error, abs=1e-14)
    for a, b in zip(in_parts.result.commands, at_once.result.commands, strict=True):
        assert astuple(a)[2:] == pytest.approx(astuple(b)[2:], rel=1e-12)
    assert all((in_parts.reported[n] == at_once.reported[n]).all() for n in at_once.reported)


def test_noise_is_as_stated_and_the_same_for_a_seed() -> None:
    quiet, noisy, again, other = (
        run("paper-pd", duration=20.0, dt=0.01, noise=n, seed=s, log_interval=0.01)
        for n, s in (({}, 0), ({"z": 0.02}, 1), ({"z": 0.02}, 1), ({"z": 0.02}, 2))
    )
    error = noisy.reported["z"] - noisy.state["z"]
    assert error.std() == pytest.approx(0.02, rel=0.05)
    assert (quiet.reported["z"] == quiet.state["z"]).all()
    assert (noisy.reported["z"] == again.reported["z"]).all()
    assert (noisy.reported["z"] != other.reported["z"]).any()


def test_a_push_displaces_by_force_over_stiffness() -> None:
    """PD on depth: 0.1 N against 1 N/m."""
    result = run("paper-pd", duration=120.0, dt=0.01, pushes=(Push("Z", 0.1),)).result
    assert result.of("z").final_error == pytest.approx(-0.1, abs=1e-4)
    gone = run("paper-pd", duration=120.0, dt=0.01, pushes=(Push("Z", 0.1, 10.0, 20.0),)).result
    assert abs(gone.of("z").final_error) < 1e-4


def test_a_current_pushes_pd_off_and_pid_brings_it_back() -> None:
    """Along the heading: drag in still water at the speed of the current, against the stiffness."""
    current = Overrides(current=(0.1, 0.0), order="together")
    pd = run("paper-pd", current, to=(0.0, 0.0, 0.0, 0.0), duration=200.0, dt=0.01).result
    drag = 0.142306 * 0.1 + 5.153776 * 0.01
    back = 0.091036 * 0.1 + 5.868182 * 0.01  # the hull moves backwards through the water
    assert -pd.of("x").final_error == pytest.approx(back / 0.2, rel=1e-3)
    assert back != drag


def test_the_controller_may_know_another_vehicle() -> None:
    """A controller that takes the vehicle for 1 N lighter stands 1 m too deep under a spring of 1 N/m."""
    heavier = AUV.with_values({"B_net": Value(-15.309872)})
    result = ClosedLoop(load_gains("paper-pd", AUV), heavier).run(Scenario(GOAL, 150.0, 0.01)).result
    assert result.of("z").final_error == pytest.approx(-1.0, abs=1e-4)


def test_thrusters_that_push_elsewhere() -> None:
    """Sides swapped, or reversed; an arm half as long again and another strength are no other direction."""
    thrusters = {t.name: t for t in AUV.thrusters}
    arms = {n: np.array(t.wrench)[[0, 2, 5]] for n, t in thrusters.items()}
    (one, *_) = (n for n, w in arms.items() if w[0] and w[2])

    def turned(wrench: np.ndarray, **more: object) -> tuple[str, ...]:
        other = replace(thrusters[one], wrench=tuple(map(float, wrench)), **more)  # type: ignore[arg-type]
        vehicle = replace(AUV, thrusters=tuple(other if t.name == one else t for t in AUV.thrusters))
        return ClosedLoop(load_gains("paper-pd", AUV), vehicle, compiled=False).parts.turned_thrusters

    own, arm = np.array(thrusters[one].wrench), np.array([1, 1, 1, 1, 1, 1.5])
    assert turned(own) == turned(own * arm) == turned(own, thrust_per_command=Value(3.0)) == ()
    assert turned(own * [1, 1, 1, 1, 1, -1]) == (one,)
    assert turned(own, thrust_per_command=Value(-1.0)) == turned(0 * own) == (one,)


def test_thruster_limits_and_anti_windup() -> None:
    """Held integrals overshoot less after a long time at the limit."""
    found = {}
    for kind in ("hold", "none"):
        table = GainTable.model_validate(
            {
                "schema": "undertow/gains/1",
                "name": "limited",
                "law": "pid",
                "unactuated": ["sway"],
                "gains": {"K_P": 1.0, "K_V": 4.0, "K_I": 0.1},
                "allocation": {"limits": {"f1": 7.3, "f3": 7.3}, "anti_windup": kind},
            }
        )
        gains = gains_from_table(table, AUV)
        found[kind] = ClosedLoop(gains).run(Scenario((0.0, 0.0, -4.0, 0.0), 300.0, 0.01)).result
        assert max(c.peak for c in found[kind].commands) == pytest.approx(7.3)
        assert found[kind].commands[0].at_limit > 0.05
    assert found["hold"].of("z").overshoot < 0.7 * found["none"].of("z").overshoot


@pytest.mark.parametrize("push", [(float("nan"), 0.0, 1.0), (1.0, 5.0, 1.0), (1.0, 0.0, float("nan"))])
def test_pushes_that_cannot_be_are_refused(push: tuple[float, float, float]) -> None:
    with pytest.raises(UndertowError, match="the earlier time first"):
        Push("X", *push)


def test_a_dead_time_acts() -> None:
    late = AUV.with_effect(catalogue()["actuation_delay"], {"delay": Value(0.5)})
    scenario = Scenario(GOAL, 2.0, 0.01, log_interval=0.01)
    record = ClosedLoop(load_gains("paper-pd", AUV), late).run(scenario)
    moved = np.flatnonzero(record.state["r"])
    # Only the weight acts before; a command of t = 0 is felt after 0.5 s.
    assert record.t[moved[0]] == pytest.approx(0.51)
    with pytest.raises(UndertowError, match="dead times"):
        ClosedLoop(load_gains("paper-pd", AUV), late).run(replace(scenario, continuous=True))


def test_a_dead_time_that_is_rounded_is_said(caplog: pytest.LogCaptureFixture) -> None:
    late = AUV.with_effect(catalogue()["actuation_delay"], {"delay": Value(0.04)})
    loop = ClosedLoop(load_gains("paper-pd", AUV), late, compiled=False)
    loop.run(Scenario(GOAL, 1.0, 0.02))
    assert not caplog.text
    loop.run(Scenario(GOAL, 1.0, 0.1))
    assert "a dead time of 0.04 s is taken as 0 samples of 0.1 s" in caplog.text


def diverging() -> ClosedLoop:
    """Depth under a stiff spring, felt a second late, and water that drags linearly only."""
    late = AUV.with_effect(catalogue()["actuation_delay"], {"delay": Value(1.0)})
    table = {"schema": "undertow/gains/1", "name": "stiff", "law": "pd", "unactuated": ["sway"]}
    content = table | {"gains": {"K_P": 30.0, "K_V": 1.0}}
    return ClosedLoop(gains_from_table(GainTable.model_validate(content), AUV), late)


DOWN = Scenario((0.0, 0.0, 1.0, 0.0), 3000.0, 0.05)


def test_a_loop_that_diverges_says_when() -> None:
    record = diverging().run(DOWN)
    assert record.result.diverged is not None
    assert 10 < record.result.diverged < 15
    assert record.result.of("z").settling is None
    assert np.isfinite(record.state["z"]).all()
    assert f'"diverged": {record.result.diverged}' in record.to_json()


def test_a_run_has_diverged_where_nothing_in_water_is_as_fast() -> None:
    """Long before the numbers end: the run that stops while they are finite has diverged as well."""
    whole = diverging().run(DOWN).result.divergence
    assert whole is not None
    assert (whole.name, whole.unit, whole.limit) == ("w", "m/s", FASTEST)
    assert FASTEST < abs(whole.value) < math.inf
    short = diverging().run(replace(DOWN, duration=round(whole.time + 1.0)))
    assert short.result.divergence == whole
    before = short.state["w"][short.t < whole.time]
    assert len(before) == len(short.t)
    assert np.abs(before).max() <= FASTEST
    assert short.result.of("z").largest < 2 * FASTEST * whole.time
    assert f"t = {whole.time:.6g} s: w = {whole.value:.4g} m/s" in whole.text
    assert diverging().run(replace(DOWN, duration=whole.time - 0.05)).result.divergence is None


def test_many_runs_diverge_where_one_does() -> None:
    one = diverging().run(DOWN).result
    scenario = replace(DOWN, duration=round(one.diverged + 5.0), log_interval=0.05)
    runs = diverging().run_many(scenario, starts={"z": np.array([0.0, 1.0])})
    assert runs.diverged[0]
    assert runs.t[np.isfinite(runs.state("w")[0])][-1] == pytest.approx(one.diverged - 0.05)


def test_a_pose_that_jumps_has_diverged() -> None:
    """Where the integration jumps there need be no speed: 3e12 m in 1000 s are none of a vehicle in water."""
    x = np.array([[0.0, 0.0, -3e12, 0.0, 0.1, 0.0, 0.2, 0.0], [9e4, 0.0, 1.0, 0.0, 99.0, 0.0, 0.2, 0.0]])
    t = np.array([1000.0, 1000.0])
    assert implausible(x, np.zeros(4), t).any(axis=1).tolist() == [True, False]
    names = ("x", "y", "z", "psi", "u", "v", "w", "r")
    found = divergence(names, x[0], np.zeros(4), 1000.0)
    assert (found.name, found.value, found.limit) == ("z", -3e12, 2 * FASTEST * 1001.0)
    far = divergence(names, np.array([0.0, 0.0, math.nan, *[0.0] * 5]), np.zeros(4), 1.0)
    assert "z is no longer a finite number" in far.text


def test_progress_is_reported() -> None:
    progress: list[float] = []
    loop("paper-pd").run(Scenario(GOAL, 60.0, 0.001), lambda done, words: progress.append(done))
    assert progress == pytest.approx([20.0, 40.0, 60.0, 60.001])


def test_headings_turn_the_short_way() -> None:
    result = run("paper-pd", to=(0.0, 0.0, 0.0, 2 * math.pi - 0.5), duration=60.0, dt=0.01).result
    assert result.to["psi"] == pytest.approx(-0.5)
    assert result.of("psi").settling is not None


def test_a_heading_whole_turns_on_is_the_same_heading() -> None:
    """Spun up at first, the vehicle comes to rest where the controller's wrapped error is zero."""
    at_rest, *spun = (
        run("paper-pd", to=(0.0, 0.0, 0.0, 3.1), duration=120.0, dt=0.01, moving={"r": r})
        for r in (0.0, 30.0, -30.0)
    )
    assert at_rest.result.of("psi").turns == 0
    for record, way in zip(spun, (1, -1), strict=True):
        psi = record.result.of("psi")
        assert psi.turns * way >= 1
        assert record.state["psi"][-1] == pytest.approx(3.1 + 2 * math.pi * psi.turns, abs=1e-3)
        assert record.result.to["psi"] == pytest.approx(3.1 + 2 * math.pi * psi.turns)
        assert psi.move == pytest.approx(3.1)
        assert max(abs(psi.final_error), abs(psi.steady_error)) < 1e-3
        assert psi.settling is not None
        assert psi.largest == pytest.approx(np.abs(record.errors["psi"]).max())
        late = np.abs(record.errors["psi"][record.t > psi.settling + 0.1])
        assert late.max() <= 0.02 * 3.1
        travelled = math.copysign(1.0, psi.move + 2 * math.pi * psi.turns)
        assert psi.overshoot == pytest.approx(
            100 * max(0.0, float((-travelled * record.errors["psi"]).max())) / 3.1, abs=0.5
        )
