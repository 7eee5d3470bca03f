"""Prediction error: what a disturbance does to it and to output error, and agreement where there is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from benchmarks.hidden_effects import make_case
from tests.identification.logs_of import runs_of, true_vehicle, vehicle_of, with_effect
from tests.identification.long_surge import EXACT, simulated, steps
from tests.identification.surge import surge_from_positions, surge_run, surge_vehicle
from tests.quick import first_quick
from undertow.errors import UndertowError
from undertow.identification.estimation.fitted import cramer_rao, verdicts
from undertow.identification.estimation.output_error import fit_output_error
from undertow.identification.estimation.prediction_error import (
    PredictionErrorFit,
    fit_prediction_error,
    refit_by_prediction_error,
)
from undertow.identification.logs.run import Run

VEHICLE = surge_vehicle()
SAMPLES, DRAWS, NOISE = 500, 6, 0.005


def logged(seed: int, kind: str) -> Run:
    """50 s at 10 Hz with a force that nobody logs: white, 0.3 N, or wandering by 0.08 N in 10 s."""
    rng = np.random.default_rng([seed, 5])
    white = rng.standard_normal(SAMPLES)
    push = {"white": 0.3 * white, "walk": 0.008 * np.cumsum(white), "none": 0.0 * white}[kind]
    noise = NOISE * rng.standard_normal(SAMPLES)
    return simulated(steps(SAMPLES, seed, size=2.0), noise, disturbance=lambda i, u: push[i])


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "gain"), first_quick([("walk", 4.0), ("white", 1.2)]))
def test_a_disturbance_is_told_from_what_the_parameters_do(kind: str, gain: float) -> None:
    off, claimed, others, fits = [], [], [], []
    for seed in range(DRAWS):
        run = logged(seed, kind)
        fits.append(fit_prediction_error(VEHICLE, [run]))
        off.append(np.array(list(fits[-1].values.values())) - EXACT)
        claimed.append(list(fits[-1].standard_errors.values()))
        by_output = fit_output_error(VEHICLE, [run], horizon=None)
        others.append(np.array(list(by_output.values.values())) - EXACT)
    rmse, other = (np.sqrt(np.mean(np.square(e), axis=0)) for e in (off, others))
    assert np.all(rmse * gain < other)
    size = np.sqrt(np.mean(np.square(np.array(off) / claimed), axis=0))
    # Six draws know a standard deviation to a third; X_u and X_uabsu are each other's mirror.
    assert np.all((size > 0.4) & (size < 1.6)), size
    # 0.3 N for 0.1 s on 9.13 kg.
    if kind == "white":
        strength = np.median([f.disturbance["u"] for f in fits])
        assert strength == pytest.approx((0.3 / 9.130825) ** 2 * 0.1, rel=0.35)
    else:
        random_walk = np.median([f.random_walk["u"] for f in fits])
        assert random_walk == pytest.approx((0.008 / 9.130825) ** 2 / 0.1, rel=1.0)


@pytest.mark.slow
def test_without_a_disturbance_it_is_output_error() -> None:
    for seed in range(3):
        run = logged(seed, "none")
        fit, other = fit_prediction_error(VEHICLE, [run]), fit_output_error(VEHICLE, [run], horizon=None)
        for name, error in other.standard_errors.items():
            assert fit.values[name] == pytest.approx(other.values[name], abs=0.8 * error)
            assert fit.standard_errors[name] == pytest.approx(error, rel=0.5)
            assert cramer_rao(fit)[name] == pytest.approx(cramer_rao(other)[name], rel=0.15)
        assert np.sqrt(fit.noise.variance[1]) == pytest.approx(NOISE, rel=0.1)
        assert fit.mean_square()[1] == pytest.approx(1.0, abs=0.15)
        assert verdicts(fit) == verdicts(other)


def test_runs_count_that_are_sampled_more_slowly() -> None:
    """Half of the samples at 10 Hz, half at 2.5 Hz: windows of each, and both tell of the parameters."""
    rng = np.random.default_rng(11)
    quick = simulated(steps(251, 3, size=2.0), NOISE * rng.standard_normal(251))
    slow = simulated(steps(251, 4, hold=6, size=2.0), NOISE * rng.standard_normal(251), dt=0.4, fine=16)
    alone, both = fit_prediction_error(VEHICLE, [quick]), fit_prediction_error(VEHICLE, [quick, slow])
    counted = [np.sum((both.windows.count - 1)[both.windows.run == k]) for k in range(2)]
    assert counted == [250, 250]
    for k, (name, error) in enumerate(both.standard_errors.items()):
        assert error < 0.75 * alone.standard_errors[name]
        assert both.values[name] == pytest.approx(EXACT[k], abs=4 * error)


def test_without_noise_the_truth_is_found() -> None:
    fit = fit_prediction_error(VEHICLE, [surge_run()])
    np.testing.assert_allclose(list(fit.values.values()), EXACT, rtol=2e-3)


@pytest.mark.slow
def test_three_degrees_of_freedom_with_pose_and_an_own_state() -> None:
    case = make_case("usv", ("thruster_lag",), 2, duration=25.0, runs=("steps", "multisine"))
    model = with_effect(vehicle_of(case), "thruster_lag", T_lag=0.3)
    fit = fit_prediction_error(model, runs_of(case))
    truth = true_vehicle(case)
    off = [
        abs(v - truth.value_of(n).value) / fit.standard_errors[n]
        for n, v in fit.values.items()
        if n != "T_lag"
    ]
    assert max(off) < 4.5
    true = case.truth["values"]["thruster_lag"]["T"]
    assert fit.values["T_lag"] == pytest.approx(true, abs=4 * fit.standard_errors["T_lag"])
    assert isinstance(fit, PredictionErrorFit)
    # Two runs: no window goes on from the end of one to the start of the other.
    assert int(np.sum(fit.innovations.window == 0)) == 12


def test_the_noise_of_a_filtered_record_is_that_of_the_greatest_likelihood() -> None:
    """The low-pass filter trades white for slow disturbances: steps that overshoot would go to and fro."""
    run = logged(0, "walk")
    slow = Run("filtered", run.t, {**run.channels, "u": lfilter([0.2], [1.0, -0.8], run.channels["u"])})
    fit = fit_prediction_error(VEHICLE, [slow])
    assert fit.iterations < 30
    again = refit_by_prediction_error(fit, [slow], near=fit)
    assert _deviance(again) == pytest.approx(_deviance(fit), abs=1.0)
    white, wander = fit.noise.intensity[1:]
    for other in ((1.5 * white, wander), (white, wander / 1.5)):
        noise = replace(fit.noise, intensity=np.array([0.0, *other]))
        moved = refit_by_prediction_error(fit, [slow], near=replace(fit, noise=noise))
        assert _deviance(moved) == pytest.approx(_deviance(fit), abs=1.0)


def _deviance(fit: PredictionErrorFit) -> float:
    """Minus twice the log likelihood, but for a constant."""
    return float(np.sum(fit.innovations.table[:, 0] ** 2) + np.sum(fit.innovations.log_variance))


def test_a_pose_alone_is_enough() -> None:
    run = surge_from_positions()
    fit, other = fit_prediction_error(VEHICLE, [run]), fit_output_error(VEHICLE, [run], horizon=None)
    assert np.isnan(fit.mean_square()[1])
    for name, error in other.standard_errors.items():
        assert fit.values[name] == pytest.approx(other.values[name], abs=4 * error)
        assert fit.standard_errors[name] < 5 * error


def test_what_it_cannot_follow_is_reported() -> None:
    case = make_case("usv", (), 4, duration=20.0, runs=("steps",))
    late = with_effect(vehicle_of(case), "sensor_delay", velocity_delay=0.05)
    with pytest.raises(UndertowError, match="delayed sensor"):
        fit_prediction_error(late, runs_of(case))
    t = np.arange(70_000) * 0.1
    long = Run("long", t, {"u": np.sin(t), "tau_X": np.cos(t)})
    with pytest.raises(UndertowError, match="at most 60000"):
        fit_prediction_error(VEHICLE, [long])


def test_a_model_that_diverges_is_refused_in_words() -> None:
    unstable = replace(VEHICLE.value_of("X_u"), value=2e6, estimate=False)
    with pytest.raises(UndertowError, match="diverges with the initial parameter values"):
        fit_prediction_error(VEHICLE.with_values({"X_u": unstable}), [logged(0, "none")])
