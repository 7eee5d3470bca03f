"""Output error: the paper's baseline, starts eliminated exactly, and effects on the way of a command."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.integrate import cumulative_simpson

from benchmarks.hidden_effects import Case, make_case
from tests.identification.logs_of import runs_of, true_vehicle, vehicle_of, with_effect
from tests.identification.surge import M_X, TRUTH, surge_from_positions, surge_run, surge_vehicle
from tests.quick import first_quick
from undertow.codegen.engine import Products
from undertow.codegen.functions import Functions
from undertow.errors import UndertowError
from undertow.identification.estimation import shooting as multiple_shooting
from undertow.identification.estimation.data import prepare
from undertow.identification.estimation.fitted import correlation, cramer_rao, remarks, t_values, verdicts
from undertow.identification.estimation.output_error import OutputErrorFit, channel_weights, fit_output_error

# Private: sums as large as these, or with a column of rounding, come from no log that is worth a test.
from undertow.identification.estimation.shooting import Shooting, _condensed, eliminated
from undertow.identification.estimation.weak_form import fit_weak, free_parameters
from undertow.identification.estimation.windows import cut
from undertow.identification.logs.pose_velocity import velocities_from_pose
from undertow.identification.logs.run import Run
from undertow.model.vehicle import Vehicle

SIZES = np.array([M_X, TRUTH["X_u"], TRUTH["X_uabsu"]])
"""What the paper's table gives errors relative to: mass with added mass, linear and quadratic drag."""

CRAMER_RAO = np.array([0.40, 18.0, 2.6])
WEAK_BASELINE = np.array([0.41, 20.0, 2.9])
DRAWS = 24


def _off(fit: OutputErrorFit, truth: Vehicle) -> dict[str, float]:
    """Distance of every fitted value from the truth in standard errors."""
    return {n: (v - truth.value_of(n).value) / fit.standard_errors[n] for n, v in fit.values.items()}


# --- the paper's surge experiment -------------------------------------------------------------------------


@pytest.mark.parametrize("horizon", [None, 5.0])
def test_without_noise_the_truth_is_found(horizon: float | None) -> None:
    fit = fit_output_error(surge_vehicle(), [surge_run()], horizon=horizon)
    for name, value in TRUTH.items():
        assert fit.values[name] == pytest.approx(-value, rel=1e-6)


@pytest.mark.slow
def test_errors_at_two_per_cent_noise_are_near_the_bound() -> None:
    vehicle = surge_vehicle()
    truth = -np.array(list(TRUTH.values()))
    by_weak, by_output = [], []
    for seed in range(DRAWS):
        run = surge_run(0.02, seed)
        weak = fit_weak(vehicle, prepare([run], vehicle))
        by_weak.append(list(weak.values.values()))
        by_output.append(
            list(fit_output_error(vehicle, [run], horizon=None, start=weak.values).values.values())
        )
    for found, reference in ((by_output, CRAMER_RAO), (by_weak, WEAK_BASELINE)):
        rmse = 100 * np.sqrt(np.mean((np.array(found) - truth) ** 2, axis=0)) / SIZES
        # 24 draws know a standard deviation to about 15%.
        np.testing.assert_allclose(rmse, reference, rtol=0.35)


def test_what_the_experiment_cannot_show_is_said() -> None:
    fit = fit_output_error(surge_vehicle(), [surge_run(0.1, 3)], horizon=None)
    said = remarks(fit, surge_vehicle())
    assert t_values(fit)["X_u"] < 2.0
    assert any("not identifiable" in text for text in said["X_u"])
    assert not any("not identifiable" in text for text in said["X_udot"])


def test_the_bound_is_the_cramer_rao_bound_and_hardly_less_than_the_errors() -> None:
    fit = fit_output_error(surge_vehicle(), [surge_run(0.02, 4)], horizon=None)
    least = np.array(list(cramer_rao(fit).values()))
    # The noise of the channel is itself known to some ten per cent from 150 samples.
    np.testing.assert_allclose(100 * least / SIZES, CRAMER_RAO, rtol=0.2)
    assert np.all(np.array(list(fit.standard_errors.values())) >= 0.999 * least)
    weak = fit_weak(surge_vehicle(), prepare([surge_run(0.02, 4)], surge_vehicle()))
    # Test functions of a second see a little less than the whole record.
    assert np.all(np.array(list(cramer_rao(weak).values())) > 0.95 * least)


def test_the_bound_is_that_of_the_noise_even_where_the_model_lacks_something() -> None:
    run = surge_run(0.01, 6)
    lacking = replace(run, channels={**run.channels, "tau_X": run.channels["tau_X"] + 0.05 * np.sin(run.t)})
    fits = [
        fit_output_error(surge_vehicle(), [lacking], horizon=None),
        fit_weak(surge_vehicle(), prepare([lacking], surge_vehicle())),
    ]
    whole = cramer_rao(fit_output_error(surge_vehicle(), [run], horizon=None))
    for fit in fits:
        least = cramer_rao(fit)
        assert least["X_udot"] == pytest.approx(whole["X_udot"], rel=0.5)
        assert fit.standard_errors["X_udot"] > 3 * least["X_udot"]


def test_every_parameter_gets_a_verdict() -> None:
    exact, noisy = (fit_output_error(surge_vehicle(), [surge_run(n, 3)], horizon=None) for n in (1e-3, 0.1))
    assert set(verdicts(exact).values()) == {"identified"}
    assert verdicts(noisy) == {
        "X_udot": "identified",
        "X_u": "not identifiable",
        "X_uabsu": "weakly identified",  # only together with X_u
    }
    between = correlation(noisy)
    np.testing.assert_allclose(np.diag(between), 1.0)
    # At one speed the linear and the quadratic drag are one number; P has little else.
    assert between[1, 2] < -0.9


def test_what_the_pose_says_of_a_sensor_holds_where_the_forces_are_poorly_modelled() -> None:
    """Beside drag that is wrong a bias moves to make up for it, unless the pose weighs as it fits."""
    run = surge_run()
    u, bias = run.channels["u"], 0.02
    x = cumulative_simpson(u, x=run.t, initial=0)
    run = replace(run, channels={**run.channels, "x": x, "u": u + bias})
    vehicle = with_effect(surge_vehicle(), "sensor_bias", b_u=0.0)
    start = {"X_udot": -TRUTH["X_udot"], "b_u": 0.9 * bias}
    fit = fit_output_error(vehicle, [run], ("X_udot", "b_u"), 2.0, start=start)
    assert fit.values["b_u"] == pytest.approx(bias, rel=0.01)


def test_several_runs_are_fitted_jointly() -> None:
    one = fit_output_error(surge_vehicle(), [surge_run(0.02, 1)], horizon=None)
    both = fit_output_error(surge_vehicle(), [surge_run(0.02, 1), surge_run(0.02, 2)], horizon=None)
    ratio = [both.standard_errors[n] / one.standard_errors[n] for n in TRUTH]
    np.testing.assert_allclose(ratio, np.sqrt(0.5), rtol=0.25)


def test_a_physical_bound_holds() -> None:
    run = surge_run(0.02, 1)
    pushed = replace(run, channels={**run.channels, "tau_X": run.channels["tau_X"] - 0.3 * run.channels["u"]})
    fit = fit_output_error(surge_vehicle(), [pushed], horizon=None)
    assert fit.values["X_u"] <= 0.0
    assert any("limit" in text for text in remarks(fit, surge_vehicle())["X_u"])


def test_a_simulation_that_diverges_at_the_start_is_reported() -> None:
    vehicle = surge_vehicle()
    wild = vehicle.with_values({"X_uabsu": replace(vehicle.value_of("X_uabsu"), value=5e4, estimate=False)})
    with pytest.raises(UndertowError, match="diverges with the initial parameter values"):
        fit_output_error(wild, [surge_run(0.02)], horizon=None, start={})


@pytest.mark.parametrize("rounding", [0.0, -1e-9])
def test_a_column_that_lies_in_the_starts_is_nil(rounding: float) -> None:
    """Sums of a simulation that nearly diverged are huge, and what is left of such a column is rounding."""
    columns = 1e80 * np.random.default_rng(5).standard_normal((30, 3))
    gram = np.zeros((4, 4))
    gram[np.ix_([0, 1, 3], [0, 1, 3])] = columns.T @ columns
    gram[2, 2], gram[2, 0], gram[0, 2] = rounding, 1e140, 1e140
    rows = _condensed(gram)
    kept = [0, 1, 3]
    assert np.allclose((rows.T @ rows)[np.ix_(kept, kept)], columns.T @ columns, rtol=1e-12)
    assert np.max(np.abs(rows[:, 2])) < 1e-150


def test_sums_beyond_all_numbers_count_as_diverged() -> None:
    huge = Products(np.ones((2, 1, 5, 5)), np.full((2, 2), 1e308), diverged=False)
    found = eliminated([huge], np.array([10, 10]), 2)
    assert found.cost == np.inf
    assert np.all(np.isfinite(found.r))


@pytest.mark.slow
def test_a_window_that_runs_away_from_a_wrong_start_finds_the_right_one() -> None:
    """A torpedo-shaped hull turns away from its course by itself: the error of a start grows."""
    case = make_case("mini-auv", (), 15967740, closed_loop=True)
    vehicle = true_vehicle(case)
    windows = cut(runs_of(case), vehicle, 20.0)
    functions = Functions(vehicle)
    p = np.array([vehicle.value_of(n).value for n in functions.parameter_names])
    shooting = Shooting(functions, windows, (), channel_weights(windows), compiled=False)
    first = shooting.measured_starts(p)
    at_once = shooting.mean_squares(p, first + shooting.linearise(p, first).start_step)
    assert np.max(at_once) > 3.0  # else this shows nothing
    assert np.max(shooting.mean_squares(p, shooting.fitted_starts(p))) < 1.2


def test_a_derived_velocity_takes_no_part_but_the_pose_does() -> None:
    fit = fit_output_error(surge_vehicle(), [surge_from_positions()], horizon=None)
    assert np.isnan(fit.mean_square()[1])
    assert fit.mean_square()[0] == pytest.approx(1.0, abs=0.35)
    assert fit.values["X_udot"] == pytest.approx(-TRUTH["X_udot"], abs=0.02 * M_X)


# --- the starts -------------------------------------------------------------------------------------------


def test_eliminating_the_starts_gives_the_slope_of_the_best_cost() -> None:
    vehicle = surge_vehicle()
    functions = Functions(vehicle)
    windows = cut([surge_run(0.02, 1)], vehicle, 5.0)
    shooting = Shooting(functions, windows, list(TRUTH), np.array([0.0, 1.0 / windows.sigma[1]]))
    p = np.array(functions.values())

    def best(p: np.ndarray) -> tuple[float, np.ndarray]:
        starts = shooting.measured_starts(p)
        for _ in range(6):
            at = shooting.linearise(p, starts)
            starts = starts + at.start_step
        return shooting.cost(p, starts), starts

    at = shooting.linearise(p, best(p)[1])
    assert np.max(np.abs(at.start_step)) < 1e-9
    for k, place in enumerate(shooting.places):
        step = 1e-4 * abs(p[place]) * np.eye(len(p))[place]
        slope = (best(p + step)[0] - best(p - step)[0]) / (2 * step[place])
        assert 2 * at.J[:, k] @ at.r == pytest.approx(slope, rel=1e-4)


def test_batches_of_windows_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = fit_output_error(surge_vehicle(), [surge_run(0.02, 1)])
    settings = replace(multiple_shooting.SETTINGS, batch=1)
    monkeypatch.setattr(multiple_shooting, "SETTINGS", settings)
    pieces = fit_output_error(surge_vehicle(), [surge_run(0.02, 1)])
    assert pieces.values == pytest.approx(whole.values, rel=1e-8)
    np.testing.assert_allclose(pieces.covariance, whole.covariance, rtol=1e-6)


# --- several degrees of freedom, and effects on the way from a command to a measurement --------------------


def test_three_degrees_of_freedom_come_out_within_their_errors() -> None:
    case = make_case("usv", (), 4, duration=40.0, runs=("steps", "multisine"))
    fit = fit_output_error(vehicle_of(case), runs_of(case))
    assert max(map(abs, _off(fit, true_vehicle(case)).values())) < 4.0
    np.testing.assert_allclose(fit.mean_square(), 1.0, atol=0.2)


def test_a_delay_is_found_by_its_effect_on_the_commands() -> None:
    case = make_case("box", ("actuation_delay",), 2, duration=40.0, runs=("steps", "multisine"))
    model = with_effect(vehicle_of(case), "actuation_delay", delay=0.1)
    fit = fit_output_error(model, runs_of(case))
    true = case.truth["values"]["actuation_delay"]["delay"]
    assert fit.values["delay"] == pytest.approx(true, abs=max(4 * fit.standard_errors["delay"], 0.01))


def test_a_lag_is_found_though_nobody_knows_the_thrust_at_the_beginning() -> None:
    case = make_case("box", ("thruster_lag",), 2, duration=40.0, runs=("steps", "multisine"))
    model = with_effect(vehicle_of(case), "thruster_lag", T_lag=0.3)
    fit = fit_output_error(model, runs_of(case))
    true = case.truth["values"]["thruster_lag"]["T"]
    assert fit.values["T_lag"] == pytest.approx(true, abs=4 * fit.standard_errors["T_lag"])
    assert np.nanmax(fit.mean_square()) < 1.3


@cache
def _drifting() -> Case:
    runs = ("steps", "multisine")
    return make_case("catamaran", ("ocean_current",), 5, noise=0.02, strength=3.0, duration=40.0, runs=runs)


@pytest.mark.parametrize("share", first_quick([0.3, 1.0]))
def test_windows_in_which_a_step_fails_do_not_hold_the_parameters(share: float) -> None:
    """In a current that the model lacks, long windows run away: the descent still ends where it does from
    elsewhere.
    """
    case = _drifting()
    vehicle = vehicle_of(case)
    start = {n: share * vehicle.value_of(n).value for n in free_parameters(vehicle)}
    fit = fit_output_error(vehicle, runs_of(case), horizon=15.0, start=start)
    assert np.log(fit.dispersion[fit.at.counts > 0]).sum() < 90.0


def test_a_lever_arm_is_found_by_what_the_sensor_reports() -> None:
    case = make_case("usv", ("velocity_lever_arm",), 2, duration=40.0, runs=("steps", "multisine"))
    fit = fit_output_error(
        with_effect(vehicle_of(case), "velocity_lever_arm", x_s=0.0, y_s=0.0), runs_of(case)
    )
    true = case.truth["values"]["velocity_lever_arm"]
    for name in ("x_s", "y_s"):
        assert fit.values[name] == pytest.approx(true[name], abs=4 * fit.standard_errors[name])


@pytest.mark.slow
def test_starts_of_long_windows_without_velocities_are_found() -> None:
    """What a pose says of the velocity at one sample makes a nimble vehicle run away within 20 s."""
    case = make_case("micro-auv", (), 91071820, duration=60.0)
    vehicle = true_vehicle(case)

    def pose_only(run: Run) -> Run:
        kept = {k: v for k, v in run.channels.items() if k not in "uvwpqr"}
        return velocities_from_pose(replace(run, channels=kept), vehicle.degrees_of_freedom)

    runs = list(map(pose_only, runs_of(case)))
    shooting = Shooting(Functions(vehicle), windows := cut(runs, vehicle, 20.0), (), channel_weights(windows))
    p = np.array(Functions(vehicle).values())
    assert np.max(shooting.mean_squares(p, shooting.measured_starts(p))) > 100.0
    assert np.max(shooting.mean_squares(p, shooting.fitted_starts(p))) < 1.3
