"""Closed loops side by side: against runs one by one, by gains, parameters and starts."""

from __future__ import annotations

import numpy as np
import pytest

from tests.control.loops import AUV, GOAL, law_of, loop
from tests.quick import first_quick
from undertow.codegen.compiler import Compiler, find_compiler
from undertow.control.closed_loop import ClosedLoop, Overrides, Push, Scenario
from undertow.control.gains import load_gains
from undertow.errors import UndertowError
from undertow.model.catalogue import catalogue
from undertow.model.vehicle import Value

RUNS = 11
RNG = np.random.default_rng(4)
MASS = {"m": 7.5 * (1 + 0.1 * RNG.normal(size=RUNS))}
GAINS = {"K_P_z": RNG.uniform(0.5, 2, RUNS), "K_V_z": RNG.uniform(2, 4, RUNS)}
STARTS = {"z": RNG.uniform(-0.5, 0.5, RUNS), "u": RNG.uniform(0, 0.1, RUNS)}
LAWS = ["paper-pd", "paper-pid", "paper-smc"]


@pytest.fixture(params=first_quick([8, 4, 1]))
def lanes(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    if find_compiler() is None:
        pytest.skip("no C compiler on this machine")
    monkeypatch.setattr(Compiler, "lanes", property(lambda self: request.param))
    return request.param


def closed(gains: str, overrides: Overrides | None = None, *, compiled: bool = True) -> ClosedLoop:
    return (overrides or Overrides()).loop(gains, AUV, compiled=compiled)


@pytest.mark.parametrize("gains", first_quick(LAWS))
def test_lanes_are_runs_one_by_one(gains: str, lanes: int) -> None:
    known = {n: v for n, v in GAINS.items() if n in closed(gains).parts.controller.gain_names}
    scenario, loops = Scenario(GOAL, 10.0, log_interval=0.5), closed(gains)
    together = loops.run_many(scenario, parameters=MASS, gains=known, starts=STARTS)
    assert together.states.shape == (RUNS, 21, 8)
    for i in range(RUNS):
        one = [{n: v[i : i + 1] for n, v in d.items()} for d in (MASS, known, STARTS)]
        alone = loops.run_many(scenario, parameters=one[0], gains=one[1], starts=one[2])
        np.testing.assert_allclose(together.states[i], alone.states[0], rtol=0, atol=1e-10)
        np.testing.assert_allclose(together.commands[i], alone.commands[0], rtol=0, atol=1e-8)


def test_the_virtual_machine_agrees(lanes: int) -> None:
    scenario = Scenario(GOAL, 0.4, log_interval=0.1, noise={"z": 0.01}, pushes=(Push("X", 0.5, 0.1, 0.2),))
    found, expected = (
        closed("paper-pid", compiled=c).run_many(scenario, parameters=MASS, starts=STARTS)
        for c in (True, False)
    )
    np.testing.assert_allclose(found.states, expected.states, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.commands, expected.commands, rtol=0, atol=1e-10)


def test_limits_of_commands_differ_from_run_to_run(lanes: int) -> None:
    """As loops of gain files that state them."""
    limits, scenario = [0.02, 0.1, 3.0], Scenario(GOAL, 5.0, log_interval=0.5)

    def stated(limit: float) -> ClosedLoop:
        own = {"limits": {"f1": limit}}
        change = lambda t: t.model_copy(update={"allocation": t.allocation.model_copy(update=own)})  # noqa: E731
        return ClosedLoop(load_gains("paper-pid", AUV, change), compiled=True)

    many = stated(3.0).run_many(scenario, gains={"limit_f1": np.array(limits)})
    for i, limit in enumerate(limits):
        alone = stated(limit).run_many(scenario, starts={"z": np.zeros(1)})
        np.testing.assert_allclose(many.commands[i], alone.commands[0], rtol=0, atol=1e-9)
    used = np.abs(many.command("f1")).max(axis=1)
    assert used[:2] == pytest.approx(limits[:2])
    assert used[2] > limits[1]


def test_run_many_is_run(lanes: int) -> None:
    """The run of the files among others is the run alone, noise of its own seed included."""
    scenario = Scenario(GOAL, 2.0, noise={"psi": 0.01, "u": 0.001}, seed=5, log_interval=0.1)
    many = closed("paper-pd").run_many(scenario, parameters={"m": np.full(4, 7.5)})
    for i in range(4):
        alone = loop("paper-pd").run(Scenario(GOAL, 2.0, noise=scenario.noise, seed=5 + i, log_interval=0.1))
        assert np.array_equal(many.t, alone.t)
        for name, values in alone.state.items():
            np.testing.assert_allclose(many.state(name)[i], values, rtol=0, atol=1e-12)
    assert np.abs(many.state("psi")[0] - many.state("psi")[1]).max() > 1e-5


def test_late_commands_and_reports(lanes: int) -> None:
    vehicle = AUV
    for effect, values in (
        ("actuation_delay", {"input_delay": 0.05}),
        ("sensor_delay", {"pose_delay": 0.02}),
    ):
        cls = catalogue()[effect]
        names = [p.name for p in cls(tuple(t.name for t in AUV.thrusters)).parameters]
        vehicle = vehicle.with_effect(
            cls, {n: Value(v) for n, v in zip(names, values.values(), strict=False)}
        )
    late = ClosedLoop(load_gains("paper-pd", AUV), vehicle, compiled=True)
    dead, reports = late.parts.functions.late()
    assert dead == 0.05
    assert max(reports.values()) == 0.02
    scenario = Scenario(GOAL, 1.0, log_interval=0.1)
    found = late.run_many(scenario, starts=STARTS)
    virtual = ClosedLoop(load_gains("paper-pd", AUV), vehicle, compiled=False).run_many(
        scenario, starts=STARTS
    )
    np.testing.assert_allclose(found.states, virtual.states, rtol=0, atol=1e-12)


def test_threads_change_nothing(lanes: int) -> None:
    scenario = Scenario(GOAL, 1.0, noise={"x": 0.01})
    runs = [closed("paper-pid").run_many(scenario, parameters=MASS, threads=n).states for n in (1, 2, 3)]
    assert np.array_equal(runs[0], runs[1])
    assert np.array_equal(runs[0], runs[2])


def test_a_run_that_diverges_leaves_the_others_alone(lanes: int) -> None:
    scenario, loops = Scenario(GOAL, 2.0, log_interval=0.1), closed("paper-pd")
    damped = next(n for n in loops.parts.functions.parameter_names if n.startswith("X_uabsu"))
    value = loops.parts.parameters[loops.parts.functions.parameter_names.index(damped)]
    pushed = {**MASS, damped: np.full(RUNS, value)}
    pushed[damped][2] = 1e9
    starts = {"u": np.full(RUNS, 0.1)}
    reference = loops.run_many(scenario, parameters=MASS, starts=starts)
    found = loops.run_many(scenario, parameters=pushed, starts=starts)
    assert list(np.flatnonzero(found.diverged)) == [2]
    assert not reference.diverged.any()
    others = np.arange(RUNS) != 2
    assert np.array_equal(found.states[others], reference.states[others])
    assert np.isnan(found.states[2, -1]).all()
    assert np.isnan(found.commands[2, -1]).all()
    assert np.isfinite(found.states[2, 0]).all()


def test_depth_by_its_linear_channel(lanes: int) -> None:
    """Heave alone: what comes to rest is where the gains say, whatever the mass."""
    scenario = Scenario((0.0, 0.0, 1.0), 120.0, 0.01)
    found = closed("paper-pd").run_many(scenario, gains=GAINS)
    np.testing.assert_allclose(found.state("z")[:, -1], 1.0, atol=1e-3)
    assert np.ptp(found.state("z")[:, len(found.t) // 20]) > 0.01


def test_continuous_laws_are_not_sampled(lanes: int) -> None:
    scenario = Scenario(GOAL, 2.0, 0.01, continuous=True)
    found, expected = (
        closed("paper-pid", compiled=c).run_many(scenario, starts=STARTS).states for c in (True, False)
    )
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("asked", "complaint"),
    [
        ({}, "the runs are all the same"),
        ({"parameters": {"mm": np.ones(3)}}, "parameter 'mm' is not known"),
        ({"gains": {"K_P_q": np.ones(3)}}, "gain 'K_P_q' is not known"),
        ({"starts": {"phi": np.ones(3)}}, "'phi' is not known"),
        ({"starts": {"x": np.ones(3)}, "parameters": {"m": np.ones(4)}}, "one value for every run"),
        ({"starts": {"x": np.array([1.0, np.nan])}}, "'x' has values that are not finite"),
        ({"starts": {"x": np.array(1.0)}}, "one value for every run"),
    ],
)
def test_what_cannot_be_meant_is_reported(asked: dict, complaint: str) -> None:
    with pytest.raises(UndertowError, match=complaint):
        loop("paper-pd").run_many(Scenario(GOAL, 1.0), **asked)


def test_progress_counts_runs() -> None:
    reported: list[float] = []
    loop("paper-pd").run_many(
        Scenario(GOAL, 0.1), parameters=MASS, progress=lambda done, words: reported.append(done)
    )
    assert reported[-1] == RUNS
    assert reported == sorted(reported)


def test_commands_by_name() -> None:
    found = law_of("pd", K_P=5, K_V=5).run_many(Scenario(GOAL, 0.1), starts={"z": np.zeros(3)})
    assert found.command(found.command_names[0]).shape == (3, len(found.t))
