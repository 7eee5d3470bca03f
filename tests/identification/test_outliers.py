"""Gross outliers: what they do to estimates, and what robust losses make of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.identification.long_surge import EXACT
from tests.identification.surge import surge_run, surge_vehicle
from undertow.identification.estimation.data import prepare
from undertow.identification.estimation.fitted import Fitted
from undertow.identification.estimation.output_error import LOSSES, fit_output_error
from undertow.identification.estimation.residual import despiked, without_spikes
from undertow.identification.estimation.weak_form import fit_weak
from undertow.identification.logs.run import Run

DRAWS = 12
VEHICLE = surge_vehicle()


def spoilt(run: Run, seed: int, share: float = 0.01, size: float = 20.0) -> Run:
    """The run with gross outliers: a share of the samples is off by 20 standard deviations of the noise."""
    rng = np.random.default_rng([seed, 1])
    sigma = float(np.std(run.channels["u"] - surge_run().channels["u"]))
    hit = rng.random(len(run.t)) < share
    off = hit * size * sigma * rng.choice([-1.0, 1.0], len(run.t))
    return replace(run, channels={**run.channels, "u": run.channels["u"] + off})


def rmse(fits: list[Fitted]) -> np.ndarray:
    return np.sqrt(np.mean((np.array([list(f.values.values()) for f in fits]) - EXACT) ** 2, axis=0))


def claimed(fits: list[Fitted]) -> np.ndarray:
    return np.median([list(f.standard_errors.values()) for f in fits], axis=0)


@pytest.mark.slow
def test_robust_losses_hold_output_error_where_squares_do_not() -> None:
    runs = [surge_run(0.02, seed) for seed in range(DRAWS)]
    bad = [spoilt(run, seed) for seed, run in enumerate(runs)]
    clean = rmse([fit_output_error(VEHICLE, [r], horizon=None) for r in runs])
    squares = rmse([fit_output_error(VEHICLE, [r], horizon=None) for r in bad])
    assert np.all(squares > 1.3 * clean)
    for loss in ("huber", "student-t"):
        fits: list[Fitted] = [fit_output_error(VEHICLE, [r], horizon=None, loss=loss) for r in bad]
        assert np.all(rmse(fits) < 1.3 * clean), loss
        np.testing.assert_allclose(claimed(fits), rmse(fits), rtol=0.35, err_msg=loss)


def test_a_robust_loss_costs_little_where_all_is_gaussian() -> None:
    run = surge_run(0.02, 5)
    plain = fit_output_error(VEHICLE, [run], horizon=None)
    for loss in ("huber", "student-t"):
        fit = fit_output_error(VEHICLE, [run], horizon=None, loss=loss)
        for name, error in plain.standard_errors.items():
            assert fit.values[name] == pytest.approx(plain.values[name], abs=0.7 * error)
            assert 0.85 < fit.standard_errors[name] / error < 1.25


def test_corrections_are_those_of_gaussian_errors() -> None:
    """Huber's loss at 1.345 has an efficiency of 95%, Student's t with four degrees of freedom of 93%."""
    z = np.random.default_rng(0).standard_normal(400_000)
    for loss, efficiency in (("huber", 0.95), ("student-t", 0.93)):
        variance, _ = LOSSES[loss].correction(z)
        assert np.mean(LOSSES[loss].weight(z)) / variance == pytest.approx(efficiency, abs=0.015)


def test_spikes_are_doubted_before_the_weak_form() -> None:
    runs = [surge_run(0.02, seed) for seed in range(DRAWS)]
    clean = [prepare([run], VEHICLE) for run in runs]
    bad = [prepare([spoilt(run, seed)], VEHICLE) for seed, run in enumerate(runs)]
    best = rmse([fit_weak(VEHICLE, d) for d in clean])
    assert np.all(rmse([fit_weak(VEHICLE, d) for d in bad]) > 1.5 * best)
    fits: list[Fitted] = [fit_weak(VEHICLE, without_spikes(d)) for d in bad]
    assert np.all(rmse(fits) < 1.3 * best)
    np.testing.assert_allclose(claimed(fits), rmse(fits), rtol=0.4)
    # Without spikes nothing is touched.
    assert all(without_spikes(d).segments[0] is d.segments[0] for d in clean[:5])


def test_a_kink_is_no_spike() -> None:
    t = np.arange(0.0, 20.0, 0.1)
    kinked = np.abs((t % 4.0) - 2.0)
    assert not despiked(t, kinked + 1e-3 * np.random.default_rng(0).standard_normal(len(t)), 1e-3)[1].any()
    kinked[[50, 90, 120]] += [0.5, -0.5, 0.3]
    clean, spike = despiked(t, kinked, 1e-3)
    assert np.array_equal(np.flatnonzero(spike), [50, 90, 120])
    np.testing.assert_allclose(clean[[50, 90]], np.abs((t[[50, 90]] % 4.0) - 2.0), atol=0.12)
