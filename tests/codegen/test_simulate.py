"""Simulation: closed forms, order of the method, sensitivities, compiled code against the virtual machine."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
import sympy as sm

from tests.codegen.support import BUNDLED, functions_of, random_parameters, vehicle_with
from tests.quick import first_quick, quick_if
from undertow import UndertowError
from undertow.codegen import Functions, Simulator, simulate
from undertow.codegen.compiler import Compiler, find_compiler
from undertow.model.catalogue import catalogue
from undertow.model.effect import Wrench
from undertow.model.symbols import Signals
from undertow.model.vehicle import Thruster, Vehicle


@pytest.fixture(params=["compiled", "uncompiled", "virtual"])
def compiled(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> bool | None:
    if request.param in ("compiled", "uncompiled"):
        if find_compiler() is None:
            pytest.skip("no C compiler on this machine")
        return bool(request.param == "compiled")
    monkeypatch.setenv("UNDERTOW_NO_COMPILER", "1")
    return False


def surge(*effects: str) -> Functions:
    """A vehicle that moves in surge only, driven by one known force."""
    vehicle = vehicle_with(*effects, dofs=("surge",), thrusters=0)
    return Functions(Vehicle(vehicle.name, ("surge",), vehicle.effects, {}, (), ("tau_X",)))


def parameters(functions: Functions, **values: float) -> np.ndarray:
    assert set(values) <= set(functions.parameter_names)
    return np.array([values.get(n, 0.0) for n in functions.parameter_names])


# --- closed forms -------------------------------------------------------------------------------


def test_coasting_against_linear_drag_is_exponential(compiled: bool | None) -> None:
    functions = surge()
    p = parameters(functions, m=8.0, X_udot=-2.0, X_u=-5.0)
    t = np.linspace(0, 4, 9)
    x = Simulator(functions, compiled=compiled).run(
        np.array([0.0, 1.5]), t, np.zeros((9, 1)), p, max_step=0.01
    )
    np.testing.assert_allclose(x[:, 1], 1.5 * np.exp(-t / 2), rtol=1e-10)
    np.testing.assert_allclose(x[:, 0], 3.0 * (1 - np.exp(-t / 2)), rtol=1e-10)


def test_inputs_are_held_from_their_sample_to_the_next(compiled: bool | None) -> None:
    functions = surge()
    p = parameters(functions, m=2.0)
    t = np.array([0.0, 0.3, 1.0, 1.1, 2.0])
    force = np.array([[4.0], [-2.0], [0.0], [6.0], [1e9]])
    x = Simulator(functions, compiled=compiled).run(np.zeros(2), t, force, p, max_step=10.0)
    speed = np.concatenate([[0.0], np.cumsum(force[:-1, 0] / 2 * np.diff(t))])
    np.testing.assert_allclose(x[:, 1], speed, rtol=1e-13, atol=1e-15)


class Tide(Wrench):
    """A force that depends on time."""

    id = "tide"
    family = "water"
    reference = "none: for a test"

    def wrench(self, s: Signals) -> sm.Matrix:
        return sm.Matrix([sm.sin(3 * s.t), 0, 0, 0, 0, 0])


def test_time_runs_on_within_a_step(compiled: bool | None) -> None:
    base = surge().vehicle
    functions = Functions(
        Vehicle("tide", base.degrees_of_freedom, (*base.effects, Tide(())), {}, (), ("tau_X",))
    )
    p = parameters(functions, m=2.0)
    t = np.array([1.0, 1.7, 2.0, 4.0])
    x = Simulator(functions, compiled=compiled).run(np.zeros(2), t, np.zeros((4, 1)), p, max_step=0.01)
    np.testing.assert_allclose(x[:, 1], (math.cos(3.0) - np.cos(3 * t)) / 6, atol=1e-10)


def test_the_method_is_of_fourth_order(compiled: bool | None) -> None:
    functions = functions_of("full")
    p = random_parameters(functions, 16)  # with these no motion passes zero on the way
    # Memory and lag are smooth; dead band and asymmetries have kinks, at which every method loses its order.
    names = functions.parameter_names
    p[[i for i, n in enumerate(names) if "back" in n or n == "deadband_width" or "abs" in n]] = 0.0
    p[names.index("rate_rudder")] = 100.0
    x0 = np.full(len(functions.state_names), 0.1)
    u = np.full((2, functions.u.numel()), 0.5)
    simulator = Simulator(functions, compiled=compiled)
    ends = [simulator.run(x0, np.array([0, 0.1]), u, p, max_step=h)[-1] for h in (0.01, 0.005, 0.0025)]
    ratio = np.linalg.norm(ends[1] - ends[0]) / np.linalg.norm(ends[2] - ends[1])
    assert 14 < ratio < 18


# --- both ways ----------------------------------------------------------------------------------


def _batch(functions: Functions, runs: int, samples: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(runs)
    t = np.cumsum(rng.uniform(0, 0.2, (runs, samples)), axis=1)
    x0 = 0.2 * rng.normal(size=(runs, len(functions.state_names)))
    return x0, t, rng.normal(size=(runs, samples, functions.u.numel()))


@pytest.mark.parametrize("compiled", first_quick([True, False]))
@pytest.mark.parametrize("runs", first_quick([21, 3]))  # in two groups and in one
@pytest.mark.parametrize("name", quick_if(BUNDLED.__contains__, [*BUNDLED, "full"]))
def test_the_driver_in_c_and_the_virtual_machine_agree(
    name: str, runs: int, compiled: bool, c_compiler: Compiler, monkeypatch: pytest.MonkeyPatch
) -> None:
    functions = functions_of(name)
    p = random_parameters(functions, 1)
    wrt = range(0, p.size, 3)
    x0, t, u = _batch(functions, runs, 12)
    simulator, asked = Simulator(functions, compiled=compiled), (x0, t, u, p, wrt)
    in_c = simulator.run_with_sensitivities(*asked, initial=[0, x0.shape[1] - 1])
    monkeypatch.setenv("UNDERTOW_NO_COMPILER", "1")
    virtual = Simulator(functions, compiled=False).run_with_sensitivities(
        *asked, initial=[0, x0.shape[1] - 1]
    )
    for found, expected in zip(in_c, virtual, strict=True):
        assert np.isfinite(expected).all()
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())
    x = simulator.run(x0, t, u, p)
    np.testing.assert_allclose(x, in_c[0], rtol=1e-12, atol=1e-12 * np.abs(x).max())


def test_a_batch_is_its_runs_one_by_one(compiled: bool | None) -> None:
    functions = functions_of("mini-auv")
    p = np.array([random_parameters(functions, k) for k in range(3)])
    x0, t, u = _batch(functions, 3, 20)
    simulator = Simulator(functions, compiled=compiled)
    together = simulator.run(x0, t, u, p)
    alone = [simulator.run(x0[k], t[k], u[k], p[k]) for k in range(3)]
    assert np.array_equal(together, alone)
    shared = simulator.run(x0, t[0], u[0], p[0])
    assert np.array_equal(shared[0], together[0])
    assert shared.shape == together.shape


def test_runs_that_share_times_have_steps_of_their_own(compiled: bool | None) -> None:
    functions = functions_of("thruster_lag")
    lag = functions.parameter_names.index("T_lag")
    p = np.tile(random_parameters(functions, 0), (2, 1))
    p[:, lag] = 0.5, 0.01
    x0, t, u = _batch(functions, 2, 12)
    simulator, asked = Simulator(functions, compiled=compiled), [lag, 0]
    together = simulator.run_with_sensitivities(x0, t[0], u, p, asked)
    alone = [simulator.run_with_sensitivities(x0[k], t[0], u[k], p[k], asked) for k in range(2)]
    for found, expected in zip(together, zip(*alone, strict=True), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-14)


def test_a_long_simulation_comes_back_to_python_unnoticed(
    compiled: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    functions = functions_of("box-hull")
    p = np.array(functions.values())
    x0, t, u = _batch(functions, 2, 30)
    simulator = Simulator(functions, compiled=compiled)
    whole = simulator.run_with_sensitivities(x0, t, u, p, [0, 1])
    monkeypatch.setattr(simulate, "SETTINGS", simulate.StepSettings(per_call=7))
    for a, b in zip(whole, simulator.run_with_sensitivities(x0, t, u, p, [0, 1]), strict=True):
        assert np.array_equal(a, b)


# --- sensitivities ------------------------------------------------------------------------------


def _difference(run, step: float) -> np.ndarray:
    """Central difference of fourth order."""
    # The step is small because |v| v has a kink in its slope, which a run may pass.
    return (8 * (run(step) - run(-step)) - (run(2 * step) - run(-2 * step))) / (12 * step)


def test_sensitivities_are_the_derivatives_of_the_simulation(compiled: bool | None) -> None:
    functions = functions_of("cybership2")
    p = np.array(functions.values())
    t = np.cumsum(np.random.default_rng(1).uniform(0.02, 0.2, 40))
    u = np.random.default_rng(2).normal(size=(40, functions.u.numel()))
    x0 = np.array([0.1, -0.2, 0.3, 0.4, 0.05, -0.02])
    wrt, initial = range(p.size), range(x0.size)
    simulator = Simulator(functions, compiled=compiled)
    _, s = simulator.run_with_sensitivities(x0, t, u, p, wrt, initial=initial)
    for k, i in enumerate(wrt):
        expected = _difference(lambda h, i=i: simulator.run(x0, t, u, _moved(p, i, h)), 1e-6)
        np.testing.assert_allclose(s[:, :, k], expected, atol=1e-7 * max(1.0, np.abs(expected).max()))
    for k, i in enumerate(initial):
        expected = _difference(lambda h, i=i: simulator.run(_moved(x0, i, h), t, u, p), 1e-6)
        np.testing.assert_allclose(
            s[:, :, p.size + k], expected, atol=1e-7 * max(1.0, np.abs(expected).max())
        )


def _moved(values: np.ndarray, index: int, by: float) -> np.ndarray:
    moved = values.copy()
    moved[index] += by
    return moved


def test_columns_follow_the_order_that_is_asked_for(compiled: bool | None) -> None:
    functions = functions_of("mini-auv")
    p = np.array(functions.values())
    x0, t, u = (a[0] for a in _batch(functions, 1, 10))
    simulator = Simulator(functions, compiled=compiled)
    _, s = simulator.run_with_sensitivities(x0, t, u, p, range(p.size), initial=range(x0.size))
    _, some = simulator.run_with_sensitivities(x0, t, u, p, [9, 2, 9], initial=[4])
    np.testing.assert_allclose(some, s[:, :, [9, 2, 9, p.size + 4]], rtol=1e-13, atol=1e-15)
    _, none = simulator.run_with_sensitivities(x0, t, u, p, [])
    assert none.shape == (10, x0.size, 0)


# --- what may go wrong --------------------------------------------------------------------------


def test_a_run_that_diverges_is_nan_from_there_on(compiled: bool | None) -> None:
    functions = surge("cubic_damping")
    p = parameters(functions, m=1.0, X_uuu=50.0)
    x0 = np.array([[0.0, 2.0], [0.0, 0.0]])
    t = np.linspace(0, 1, 21)
    x, s = Simulator(functions, compiled=compiled).run_with_sensitivities(x0, t, np.zeros((21, 1)), p, [0])
    lost = np.isnan(x[0]).any(axis=1)
    first = int(np.argmax(lost))
    assert 0 < first < 20
    assert np.isnan(x[0, first:]).all()
    assert np.isnan(s[0, first:]).all()
    assert np.isfinite(x[0, :first]).all()
    assert np.array_equal(x[1], np.zeros((21, 2)))


def test_a_gap_in_the_inputs_loses_what_comes_after(compiled: bool | None) -> None:
    functions = surge()
    p = parameters(functions, m=1.0)
    force = np.array([[1.0], [1.0], [np.nan], [1.0], [1.0]])
    x = Simulator(functions, compiled=compiled).run(np.zeros(2), np.arange(5.0), force, p)
    assert np.isfinite(x[:3]).all()
    assert np.isnan(x[3:]).all()


def test_one_sample_is_its_initial_state(compiled: bool | None) -> None:
    functions = surge()
    p = parameters(functions, m=1.0)
    x = Simulator(functions, compiled=compiled).run(np.array([1.0, 2.0]), np.zeros(1), np.zeros((1, 1)), p)
    assert np.array_equal(x, [[1.0, 2.0]])


def test_samples_at_the_same_time_have_the_same_state(compiled: bool | None) -> None:
    functions = surge()
    p = parameters(functions, m=1.0)
    t = np.array([0.0, 1.0, 1.0, 2.0])
    x = Simulator(functions, compiled=compiled).run(np.zeros(2), t, np.ones((4, 1)), p)
    assert np.array_equal(x[1], x[2])


BAD: dict[str, tuple[dict[str, object], str]] = {
    "time goes back": ({"t": np.array([0.0, 2.0, 1.0])}, "go back"),
    "time is not finite": ({"t": np.array([0.0, np.nan, 1.0])}, "not finite"),
    "no samples": ({"t": np.zeros(0)}, "no samples"),
    "too few states": ({"x0": np.zeros(1)}, r"x0 has shape \(1,\)"),
    "too few inputs": ({"u": np.zeros((2, 1))}, r"u has shape \(2, 1\)"),
    "too few parameters": ({"p": np.zeros(1)}, r"p has shape \(1,\)"),
    "another number of runs": ({"x0": np.zeros((2, 2)), "u": np.zeros((3, 3, 1))}, "each of 2 runs"),
    "no step": ({"max_step": 0.0}, "max_step"),
    "a step that is not a number": ({"max_step": math.nan}, "max_step"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_does_not_fit_is_reported(case: str) -> None:
    functions = surge()
    given = {"x0": np.zeros(2), "t": np.arange(3.0), "u": np.zeros((3, 1)), "p": parameters(functions, m=1.0)}
    changed, message = BAD[case]
    with pytest.raises(UndertowError, match=message):
        Simulator(functions, compiled=False).run(**(given | changed))


@pytest.mark.parametrize(("wrt", "initial"), [([99], []), ([-1], []), ([], [2])])
def test_indices_that_do_not_exist_are_reported(wrt: Sequence[int], initial: Sequence[int]) -> None:
    functions = surge()
    simulator = Simulator(functions, compiled=False)
    with pytest.raises(UndertowError, match="index"):
        simulator.run_with_sensitivities(
            np.zeros(2), np.arange(3.0), np.zeros((3, 1)), parameters(functions, m=1.0), wrt, initial=initial
        )


def _lagging(seconds: float) -> tuple[Functions, np.ndarray]:
    """A mass pushed by a thruster that follows its command late, and its parameters."""
    stern = Thruster("f1", (1.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    effects = (catalogue()["rigid_body"](("f1",)), catalogue()["thruster_lag"](("f1",)))
    functions = Functions(Vehicle("pushed", ("surge",), effects, {}, (stern,)))
    return functions, parameters(functions, m=8.0, T_lag=seconds, thrust_f1=1.0)


@pytest.mark.parametrize("seconds", [1e-3, 5e-5])
def test_a_lag_too_fast_to_be_followed_stays_stable(seconds: float, compiled: bool | None) -> None:
    functions, p = _lagging(seconds)
    t = np.arange(0.0, 0.3, 0.05)
    x = Simulator(functions, compiled=compiled).run(np.zeros(3), t, np.ones((len(t), 1)), p)
    np.testing.assert_allclose(x[1:, functions.state_names.index("lagged_f1")], 1.0, atol=1e-6)
    np.testing.assert_allclose(x[:, 1], np.maximum(t - seconds, 0.0) / 8.0, atol=seconds / 8.0)


def test_a_lag_faster_than_the_samples_is_followed(compiled: bool | None) -> None:
    """Commands change every 0.05 s, the thrust follows in 0.02 s: steps of 0.05 s would slur it."""
    functions, p = _lagging(0.02)
    t = np.arange(0.0, 1.0, 0.05)
    x = Simulator(functions, compiled=compiled).run(np.zeros(3), t, np.ones((len(t), 1)), p)
    lagged = functions.state_names.index("lagged_f1")
    np.testing.assert_allclose(x[:, lagged], 1 - np.exp(-t / 0.02), atol=1e-3)
    impulse = t - 0.02 * (1 - np.exp(-t / 0.02))
    np.testing.assert_allclose(x[:, 1], impulse / 8.0, atol=2e-5)


def test_friction_that_stops_a_vehicle_dead_is_followed(compiled: bool | None) -> None:
    """m u_dot = -F tanh(u/c) has sinh(u/c) = sinh(u_0/c) exp(-F t / (m c)); it ends 80 times a second."""
    functions = surge("dry_friction")
    m, F, c = 10.0, 4.0, 0.005
    p = parameters(functions, m=m, X_signu=-F, friction_speed=c)
    t = np.linspace(0.0, 0.5, 11)
    x = Simulator(functions, compiled=compiled).run(np.array([0.0, 0.1]), t, np.zeros((11, 1)), p)
    exact = c * np.arcsinh(np.sinh(0.1 / c) * np.exp(-F * t / (m * c)))
    np.testing.assert_allclose(x[:, 1], exact, atol=2e-3 * c)


def test_a_vehicle_that_friction_holds_creeps(compiled: bool | None) -> None:
    functions = surge("dry_friction")
    p = parameters(functions, m=10.0, X_signu=-4.0, friction_speed=0.005)
    held = 0.4
    x = Simulator(functions, compiled=compiled).run(
        np.zeros(2), np.arange(60) / 20, np.full((60, 1), held), p
    )
    assert x[-1, 1] == pytest.approx(0.005 * math.atanh(held / 4.0), rel=1e-6)


def test_a_stiff_run_leaves_the_steps_of_the_others_alone(compiled: bool | None) -> None:
    functions = surge("dry_friction")
    plain = parameters(functions, m=10.0, X_u=-5.0, X_signu=-0.01, friction_speed=0.01)
    stiff = parameters(functions, m=10.0, X_u=-5.0, X_signu=-4.0, friction_speed=0.005)
    runs, t, u = Simulator(functions, compiled=compiled), np.arange(40) / 20, np.full((40, 1), 2.0)
    alone = runs.run(np.zeros((1, 2)), t, u, plain[None])
    beside = runs.run(np.zeros((2, 2)), t, np.stack([u, u]), np.stack([plain, stiff]))
    np.testing.assert_array_equal(beside[0], alone[0])
