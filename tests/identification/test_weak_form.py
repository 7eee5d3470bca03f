"""The weak form: quadrature, noise, derivatives, and parameters recovered from simulated logs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.hidden_effects import make_case
from tests.identification.logs_of import runs_of, vehicle_of
from tests.identification.surge import TRUTH, surge_run, surge_vehicle
from tests.quick import first_quick
from undertow.codegen.functions import Functions
from undertow.identification.diagnosis.verdict import estimate
from undertow.identification.estimation.data import prepare, white_noise
from undertow.identification.estimation.inputs import shifted_mean
from undertow.identification.estimation.residual import WeakModel
from undertow.identification.estimation.step import at_bounds, prior_of
from undertow.identification.estimation.test_functions import boxes
from undertow.identification.estimation.test_functions import test_functions as functions_on
from undertow.identification.estimation.weak_form import (
    fit_under_noise,
    fit_weak,
    free_parameters,
    with_process_noise,
)
from undertow.identification.logs.run import Run
from undertow.model.catalogue import catalogue
from undertow.model.vehicle import Thruster, Value, Vehicle

CLOCK = np.arange(0.0, 20.001, 0.05)


def _ship(seed: int, duration: float) -> tuple[Vehicle, list[Run]]:
    """A surface vehicle from which nothing is hidden, and its runs."""
    case = make_case("usv", (), seed, duration=duration)
    return vehicle_of(case), runs_of(case)


def test_integration_by_parts_is_exact_to_the_order_of_the_splines() -> None:
    functions = functions_on(CLOCK, 0.25)
    assert functions is not None
    g, g_dot = np.sin(3 * CLOCK), 3 * np.cos(3 * CLOCK)
    np.testing.assert_allclose(functions.rate @ g, -(functions.value @ g_dot), atol=3e-6)


def test_one_thruster_gives_what_a_known_force_gives() -> None:
    """The force of one thruster, N for N, is that of a log that holds it: the same surge model comes out."""
    known = surge_vehicle()
    driven = replace(known, force_channels=(), thrusters=(Thruster("motor", (1.0, 0, 0, 0, 0, 0)),))
    run = surge_run(0.01)
    alike = replace(run, channels={"u": run.channels["u"], "motor": run.channels["tau_X"]})
    fits = [fit_weak(vehicle, prepare([log], vehicle)) for vehicle, log in ((known, run), (driven, alike))]
    for name in TRUTH:
        assert fits[1].values[name] == pytest.approx(fits[0].values[name], rel=1e-6)


def test_coefficients_of_the_size_of_a_large_ship_are_estimated_with_their_errors() -> None:
    """Yaw moments of a tanker are 1e12 to 1e17 in SI units: the same motion by forces so much larger."""
    size, vehicle, run = 1e15, surge_vehicle(), surge_run(0.01)
    values = {n: replace(v, value=size * v.value) for n, v in vehicle.values.items()}
    large = vehicle.with_values(values)
    loaded = replace(run, channels={"u": run.channels["u"], "tau_X": size * run.channels["tau_X"]})
    fits = [fit_weak(v, prepare([log], v)) for v, log in ((vehicle, run), (large, loaded))]
    for name in TRUTH:
        errors = [fit.standard_errors[name] for fit in fits]
        assert fits[1].values[name] == pytest.approx(size * fits[0].values[name], rel=1e-4)
        assert errors[1] == pytest.approx(size * errors[0], rel=1e-3)
        shown = estimate(fits[1], name, large).standard_error
        assert shown == pytest.approx(errors[1])
        assert fits[1].vehicle.value_of(name).sigma == pytest.approx(errors[1])


def test_uneven_samples_are_integrated_as_well() -> None:
    """A sixth of the samples is missing, and the signal is far from zero, as positions and headings are."""
    t = np.sort(np.random.default_rng(1).permutation(CLOCK)[: len(CLOCK) * 5 // 6])
    functions = functions_on(t, 0.25)
    assert functions is not None
    np.testing.assert_allclose(functions.rate @ np.ones(len(t)), 0.0, atol=1e-14)
    g, g_dot = 50.0 + np.sin(3 * t), 3 * np.cos(3 * t)
    assert np.std(functions.rate @ g + functions.value @ g_dot) < 1e-3  # of 0.5


def test_held_inputs_are_integrated_exactly() -> None:
    functions = functions_on(CLOCK, 0.25)
    assert functions is not None
    held = np.repeat(np.random.default_rng(0).standard_normal(41), 10)[: len(CLOCK)]
    ramp = np.concatenate([[0.0], np.cumsum(held[:-1] * np.diff(CLOCK))])
    np.testing.assert_allclose(functions.rate @ ramp, -(functions.held @ held), atol=1e-14)
    np.testing.assert_allclose(functions.held.sum(axis=1), 0.25, rtol=1e-12)


def test_a_segment_shorter_than_one_test_function_has_none() -> None:
    assert functions_on(CLOCK[:15], 0.25) is None


@pytest.mark.parametrize("sigma", [0.002, 0.01])
def test_noise_is_told_from_a_fast_signal_with_kinks(sigma: float) -> None:
    rng = np.random.default_rng(1)
    t = np.arange(0.0, 100.0, 0.05)
    signal = 0.5 * np.sin(5.8 * t) + np.abs((t % 4.0) - 2.0)
    found = white_noise(t, signal + sigma * rng.standard_normal(len(t)))
    # Kinks spoil a fifth of the differences here, which lifts a median by up to an eighth.
    assert found == pytest.approx(sigma, rel=0.15)


def test_noise_is_known_on_a_clock_without_two_steps_alike() -> None:
    rng = np.random.default_rng(4)
    t = np.cumsum(rng.exponential(0.08, 4000))
    signal = 2.0 * np.sin(0.3 * t) + np.abs((t % 20.0) - 10.0)
    found = white_noise(t, signal + 0.01 * rng.standard_normal(len(t)))
    assert found == pytest.approx(0.01, rel=0.05)


def test_a_sensor_of_few_digits_that_mostly_rests_has_the_noise_of_its_digits() -> None:
    """A heading in tenths of a degree, at rest for most of the log: the median difference is zero."""
    t, digit = np.arange(2000.0), 0.1
    heading = np.where(t > 1500, 30 * np.sin((t - 1500) / 30), 0.0)
    found = white_noise(t, np.round(heading / digit) * digit)
    assert found == pytest.approx(digit / np.sqrt(12), rel=0.3)


def test_a_position_that_mostly_rests_has_noise_on_an_uneven_clock_too() -> None:
    """Divided differences of what rests are nothing, and not their rounding."""
    rng = np.random.default_rng(2)
    t = np.cumsum(rng.uniform(0.2, 1.0, 200))
    fix = np.where(t > 90, np.round(0.3 * (t - 90) + 0.05 * rng.standard_normal(len(t)), 2), 0.0) - 36.59428
    assert white_noise(t, fix) == pytest.approx(0.05, rel=0.4)


def test_noise_of_a_constant_channel_is_zero() -> None:
    assert white_noise(CLOCK, np.zeros(len(CLOCK))) == 0.0


def test_a_delayed_held_signal_keeps_its_integral() -> None:
    held = np.random.default_rng(2).standard_normal((len(CLOCK), 2))
    late = shifted_mean(CLOCK, held, 0.12)
    step = np.diff(CLOCK)[:, None]
    # From t = 0 on: 0.12 s of the first value, then everything but the last 0.12 s (two whole samples
    # and 0.02 s).
    expected = 0.12 * held[0] + np.sum(held[:-4] * step[:-3], axis=0) + 0.03 * held[-4]
    np.testing.assert_allclose(np.sum(late[:-1] * step, axis=0), expected, rtol=1e-9)


def test_whole_sample_delays_shift_samples() -> None:
    held = np.random.default_rng(3).standard_normal((len(CLOCK), 1))
    np.testing.assert_allclose(shifted_mean(CLOCK, held, 0.1)[2:-1], held[:-3], atol=1e-9)


SHAPED = {
    "ocean_current": {"V_N": 0.1, "V_E": -0.05},
    "thruster_lag": {"T_lag": 0.3},
    "thruster_deadband": {"deadband_width": 0.2},
    "actuation_delay": {"delay": 0.13},
    "velocity_lever_arm": {"x_s": 0.2, "y_s": 0.1},
    "radiation_memory": {"X_memu": -1.0, "Y_memv": -0.5, "N_memr": -0.2, "T_memory": 2.0},
    "added_mass_coupling": {"Y_rdot": -0.4},
    "dry_friction": {"X_signu": -0.1},
}


@pytest.fixture(scope="module")
def ship() -> tuple[Vehicle, list[Run]]:
    return _ship(5, 20.0)


@pytest.mark.parametrize("effect", sorted(SHAPED))
def test_derivative_of_the_residual_is_that_of_finite_differences(
    effect: str, ship: tuple[Vehicle, list[Run]]
) -> None:
    model, runs = ship
    cls = catalogue()[effect]
    model = model.with_effect(cls, {n: Value(v, estimate=True) for n, v in SHAPED[effect].items()})
    data = prepare(runs[:1], model)
    weak = WeakModel(Functions(model), free_parameters(model))
    p = np.array(weak.functions.values())
    at = weak.linearise(data, p)[0]
    for k, place in enumerate(weak.places):
        if weak.free[k] == "delay":
            continue  # piecewise linear in the delay: its derivative has a test of its own
        step = 1e-6 * max(1.0, abs(p[place]))
        up, down = p.copy(), p.copy()
        up[place] += step
        down[place] -= step
        difference = (weak.linearise(data, up)[0].r - weak.linearise(data, down)[0].r) / (2 * step)
        scale = np.max(np.abs(difference)) + 1e-9
        np.testing.assert_allclose(at.J[:, k] / scale, difference / scale, atol=2e-5, err_msg=weak.free[k])


@pytest.mark.parametrize("delay", [0.0, 0.1, 0.13])
def test_derivative_in_the_delay(delay: float, ship: tuple[Vehicle, list[Run]]) -> None:
    """On from where it is: at a multiple of the step the derivative jumps, and no delay is below zero."""
    model, runs = ship
    model = model.with_effect(catalogue()["actuation_delay"], {"delay": Value(delay, estimate=True)})
    data = prepare(runs[:1], model)
    weak = WeakModel(Functions(model), ("delay",))
    p = np.array(weak.functions.values())
    place = weak.places[0]
    up, farther = p.copy(), p.copy()
    up[place], farther[place] = delay + 1e-5, delay + 2e-5
    at, once, twice = (weak.linearise(data, q)[0].r for q in (p, up, farther))
    difference = (4 * once - 3 * at - twice) / 2e-5
    np.testing.assert_allclose(weak.linearise(data, p)[0].J[:, 0], difference, atol=1e-9)


@pytest.mark.parametrize(("vehicle", "seed"), first_quick([("usv", 3), ("mini-auv", 4)]))
def test_a_complete_model_leaves_white_noise_and_true_parameters(vehicle: str, seed: int) -> None:
    case = make_case(vehicle, (), seed, duration=60.0)
    model = vehicle_of(case)
    fit = fit_weak(model, prepare(runs_of(case)[:3], model))
    np.testing.assert_allclose(fit.mean_square(), 1.0, atol=0.2)
    for name, value in fit.values.items():
        # Where the speed is near its noise (sway of the USV), |v|v of a noisy v is biased: a few
        # per cent remain.
        error = max(fit.standard_errors[name], 0.02 * abs(value))
        assert abs(value - case.truth["parameters"][name]) < 5 * error, name


def test_a_wrong_sign_is_not_fitted() -> None:
    model, runs = _ship(8, 30.0)
    fit = fit_weak(model, prepare(runs[:1], model))
    assert all(fit.values[n] <= 0 for n in fit.values if n != "delay")


def test_a_gap_in_the_commands_spoils_only_its_neighbourhood(ship: tuple[Vehicle, list[Run]]) -> None:
    model, runs = ship
    model = model.with_effect(catalogue()["actuation_delay"], {"delay": Value(0.13, estimate=True)})
    commands = {
        n: np.where(np.abs(runs[0].t - 8.0) < 0.2, np.nan, runs[0].channels[n]) for n in ("f1", "f2", "f3")
    }
    gappy = replace(runs[0], channels=dict(runs[0].channels) | commands)
    data = prepare([gappy], model)
    weak = WeakModel(Functions(model), ("delay",))
    parts = weak.linearise(data, np.array(weak.functions.values()))
    assert len(parts) == 2
    assert all(np.all(np.isfinite(p.r)) and np.all(np.isfinite(p.J)) for p in parts)


def test_a_place_that_the_data_do_not_feel_stays_where_it_is() -> None:
    case = make_case("float", ("tether_drag",), 31, duration=60.0)
    model, runs = vehicle_of(case), runs_of(case)
    tethered = model.with_effect(catalogue()["tether_drag"], {"z_winch": Value(8.0, estimate=True)})
    free = (*free_parameters(model), "c_tether", "x_winch", "z_winch")
    fit = fit_weak(tethered, prepare(runs, model), free, start={"c_tether": 1.0})
    # A float moves straight up and down below its winch: how far to the side that is cannot show.
    assert fit.values["x_winch"] == 0.0
    assert fit.values["c_tether"] == pytest.approx(case.truth["values"]["tether_drag"]["c"], rel=0.1)
    assert fit.vehicle.value_of("x_winch").sigma is None
    assert fit.vehicle.value_of("c_tether").sigma == fit.standard_errors["c_tether"]


# --- the integral form ------------------------------------------------------------------------------------


def test_a_box_gives_the_change_less_the_integral() -> None:
    t = np.sort(np.random.default_rng(1).permutation(CLOCK)[: len(CLOCK) * 5 // 6])
    functions = boxes(t, 0.25)
    assert functions is not None
    assert functions.count == len(t) - 5
    g, held = 50.0 + np.sin(3 * t), np.random.default_rng(2).standard_normal(len(t))
    np.testing.assert_allclose(-(functions.rate @ g), g[5:] - g[:-5], atol=1e-12)
    exact = 50.0 * t - np.cos(3 * t) / 3
    np.testing.assert_allclose(functions.value @ g, exact[5:] - exact[:-5], atol=2e-4)
    steps = np.array([np.sum((held * np.append(np.diff(t), 0))[i : i + 5]) for i in range(functions.count)])
    np.testing.assert_allclose(functions.held @ held, steps, atol=1e-12)
    assert boxes(CLOCK[:3], 0.25) is None


def test_the_integral_form_is_as_good_as_the_weak_form() -> None:
    vehicle = surge_vehicle()
    exact = fit_weak(vehicle, prepare([surge_run()], vehicle, family=boxes))
    for name, value in TRUTH.items():
        assert exact.values[name] == pytest.approx(-value, rel=3e-3)
    off: dict[str, list[list[float]]] = {"weak": [], "integral": []}
    claimed = []
    for seed in range(16):
        run = surge_run(0.02, seed)
        for name, family in (("weak", functions_on), ("integral", boxes)):
            fit = fit_weak(vehicle, prepare([run], vehicle, family=family))
            off[name].append([fit.values[n] + v for n, v in TRUTH.items()])
        claimed.append(list(fit.standard_errors.values()))
    rmse = {name: np.sqrt(np.mean(np.square(found), axis=0)) for name, found in off.items()}
    np.testing.assert_array_less(rmse["integral"], 1.15 * rmse["weak"])
    np.testing.assert_allclose(np.median(claimed, axis=0), rmse["integral"], rtol=0.4)


def test_a_fit_ends_where_data_and_stated_priors_balance(ship: tuple[Vehicle, list[Run]]) -> None:
    model, runs = ship
    tight = {
        n: Value(3.0 * model.value_of(n).value, estimate=True, sigma=1e-3) for n in ("X_u", "Y_v", "N_r")
    }
    weak = WeakModel(Functions(model.with_values(tight)), free_parameters(model))
    data = prepare(runs[:1], model)
    # A large disturbance leaves much to the priors, which the search begins far from.
    loud = np.full(len(data.names), 1e-2)
    whitening = with_process_noise(weak.whitening(data, np.array(weak.functions.values())), loud, data)
    start = {n: model.value_of(n).value for n in tight}
    fit = fit_under_noise(weak, data, start, whitening, loud)
    centre, stiffness = prior_of(weak)
    values = fit.p[list(weak.places)]
    slope = fit.at.J.T @ fit.at.r + stiffness**2 * (values - centre)
    inside = ~np.isin(weak.free, list(at_bounds(weak, fit.p)))
    errors = np.sqrt(np.diag(np.linalg.inv(fit.information)))
    # One more step would move no parameter by a tenth of its standard error.
    assert np.all(np.abs(slope[inside] * errors[inside] ** 2) < 0.1 * errors[inside])
    assert fit.values["X_u"] == pytest.approx(tight["X_u"].value, rel=0.05)
