"""Adaptive integration: as fixed steps that are fine, over changes of the inputs, and where it is stiff."""

from __future__ import annotations

import numpy as np
import pytest

from tests.codegen.support import functions_of, random_parameters, vehicle_with
from undertow import UndertowError
from undertow.codegen import AdaptiveSimulator, Functions, Simulator


def six_degrees(seed: int) -> tuple[Functions, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A bundled vehicle pushed about: functions, start, uneven times, inputs that jump, parameters."""
    functions = functions_of("bluerov2")
    rng = np.random.default_rng(seed)
    t = np.cumsum(np.append(0.0, rng.uniform(0.02, 0.6, 30)))
    u = rng.uniform(-5, 5, (31, functions.u.numel()))
    x0 = np.append(np.zeros(6), rng.uniform(-0.3, 0.3, 6))
    return functions, x0, t, u, np.array(functions.values())


def lagging(seconds: float) -> tuple[Functions, np.ndarray]:
    """A vehicle in surge whose thrusters follow their commands with a lag, and its parameters."""
    functions = Functions(vehicle_with("thruster_lag", dofs=("surge",), thrusters=1))
    p = random_parameters(functions, 3)
    lags = [i for i, n in enumerate(functions.parameter_names) if "lag" in n.lower() or n.startswith("T_")]
    assert lags, functions.parameter_names
    p[lags] = seconds
    return functions, p


def test_it_agrees_with_fine_fixed_steps() -> None:
    functions, x0, t, u, p = six_degrees(1)
    fine = Simulator(functions).run(x0, t, u, p, max_step=5e-4)
    found = AdaptiveSimulator(functions).run(x0, t, u, p)
    np.testing.assert_allclose(found, fine, rtol=1e-6, atol=2e-6)


def test_a_tighter_tolerance_is_nearer() -> None:
    functions, x0, t, u, p = six_degrees(2)
    fine = Simulator(functions).run(x0, t, u, p, max_step=2e-4)
    loose, tight = (
        np.abs(AdaptiveSimulator(functions, relative=r, absolute=r).run(x0, t, u, p) - fine).max()
        for r in (1e-4, 1e-9)
    )
    assert tight < 1e-6 < loose


def test_a_short_push_is_not_stepped_over() -> None:
    """At rest a solver takes ever longer steps; a push of 10 ms after a minute has to be seen."""
    functions = Functions(vehicle_with(dofs=("surge",), thrusters=1))
    p = random_parameters(functions, 1)
    t = np.array([0.0, 60.0, 60.01, 61.0])
    u = np.zeros((4, functions.u.numel()))
    u[1, 0] = 100.0
    found = AdaptiveSimulator(functions).run(np.zeros(2), t, u, p)
    fine = Simulator(functions).run(np.zeros(2), t, u, p, max_step=1e-3)
    assert abs(fine[2, 1]) > 1e-4
    np.testing.assert_allclose(found, fine, rtol=1e-6, atol=1e-9)


def test_a_stiff_lag_is_followed() -> None:
    """A lag of 20 microseconds: what is left is the vehicle with thrust at once."""
    functions, p = lagging(2e-5)
    t = np.linspace(0.0, 5.0, 26)
    u = np.sign(np.sin(t + 0.1))[:, None] * np.ones(functions.u.numel())
    found = AdaptiveSimulator(functions).run(np.zeros(len(functions.state_names)), t, u, p)
    fine = Simulator(functions).run(np.zeros(len(functions.state_names)), t, u, p, max_step=2e-5)
    assert np.isfinite(found).all()
    np.testing.assert_allclose(found[:, :2], fine[:, :2], rtol=1e-5, atol=1e-7)


def test_batches_share_what_they_share_and_repeated_times_stand_still() -> None:
    functions, x0, t, u, p = six_degrees(3)
    t = np.insert(t, 5, t[5])
    u = np.insert(u, 5, u[5], axis=0)
    simulator = AdaptiveSimulator(functions)
    both = simulator.run(np.stack([x0, 0.5 * x0]), t, u, p)
    np.testing.assert_array_equal(both[0], simulator.run(x0, t, u, p))
    np.testing.assert_array_equal(both[:, 5], both[:, 6])


def test_time_runs_on_within_an_interval() -> None:
    functions = functions_of("supply_droop")
    p, t = random_parameters(functions, 4), np.array([3.0, 4.0, 9.0])
    u = np.full((3, functions.u.numel()), 1.0)
    x0 = np.zeros(len(functions.state_names))
    fine = Simulator(functions).run(x0, t, u, p, max_step=1e-3)
    np.testing.assert_allclose(AdaptiveSimulator(functions).run(x0, t, u, p), fine, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("tolerance", [0.0, 1.0, -1e-6])
def test_a_tolerance_that_means_nothing_is_refused(tolerance: float) -> None:
    with pytest.raises(UndertowError, match="tolerance relative"):
        AdaptiveSimulator(functions_of("bluerov2"), relative=tolerance)


def test_a_wrong_shape_is_refused() -> None:
    functions, x0, t, u, p = six_degrees(4)
    with pytest.raises(UndertowError, match="u has shape"):
        AdaptiveSimulator(functions).run(x0, t, u[:-1], p)
