"""Noise and an unknown current in the regressors: the bias they cause, and what takes it away."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from benchmarks.identification.profile import EXACT, vehicle
from benchmarks.identification.variables import Bias, numbers, run, with_current
from tests.identification.surge import TRUTH, surge_run, surge_vehicle
from undertow.errors import UndertowError
from undertow.identification.api import Estimator
from undertow.identification.estimation.data import prepare
from undertow.identification.estimation.fitted import cramer_rao, verdicts
from undertow.identification.estimation.weak_form import fit_instrumental, fit_weak
from undertow.paper.least_squares import estimate, experiments
from undertow.paper.regression import CASES

DRAWS = 6


def bias(method: str, noise: float, found: list[np.ndarray]) -> Bias:
    return Bias(noise, 0.0, method, 100 * (np.array(found) - EXACT) / EXACT)


@cache
def at_ten_per_cent() -> dict[str, Bias]:
    runs = [run(0.10, seed) for seed in range(DRAWS)]
    squares = [numbers(estimate(experiments(vehicle(), [r])[0], CASES["11"]).values) for r in runs]
    weak = [numbers(fit_weak(vehicle(), prepare([r], vehicle())).values) for r in runs]
    instruments = [numbers(fit_instrumental(vehicle(), [r]).values) for r in runs]
    named = {"squares": squares, "weak": weak, "instruments": instruments}
    return {name: bias(name, 0.10, found) for name, found in named.items()}


@pytest.mark.slow
def test_least_squares_is_drawn_to_zero() -> None:
    off = at_ten_per_cent()["squares"].mean
    assert off[0] < -10  # % of the mass
    assert off[2] < -3


def test_instruments_take_the_bias_away_that_the_weak_form_has() -> None:
    weak, instruments = at_ten_per_cent()["weak"], at_ten_per_cent()["instruments"]
    assert abs(weak.mean[1]) > 2.0 * abs(instruments.mean[1])
    assert np.all(np.abs(instruments.mean) < 3.5 * instruments.unsure)
    assert np.all(instruments.unsure < 1.3 * weak.unsure)


def test_a_current_biases_all_that_do_not_know_it() -> None:
    log = run(0.02, 1, 0.2)
    for method in ("weak", "instrumental"):
        lacking = numbers(Estimator(method, None).fit(vehicle(), [log]).values)
        assert abs(lacking[2] / EXACT[2] - 1) > 0.3, method
        fit = Estimator(method, None).fit(with_current(), [log])
        np.testing.assert_allclose(numbers(fit.values)[[0, 2]], EXACT[[0, 2]], rtol=0.02)
        assert fit.values["V_N"] == pytest.approx(0.2, abs=0.003)


def test_without_noise_instruments_change_nothing() -> None:
    fit = fit_instrumental(surge_vehicle(), [surge_run()])
    plain = fit_weak(surge_vehicle(), prepare([surge_run()], surge_vehicle()))
    for name, value in plain.values.items():
        assert fit.values[name] == pytest.approx(value, rel=1e-3)


def test_results_are_those_of_every_estimator() -> None:
    fits = [fit_instrumental(surge_vehicle(), [surge_run(0.02, seed)]) for seed in range(12)]
    off = np.array([[f.values[n] + v for n, v in TRUTH.items()] for f in fits])
    claimed = np.median([list(f.standard_errors.values()) for f in fits], axis=0)
    np.testing.assert_allclose(claimed, np.sqrt(np.mean(off**2, axis=0)), rtol=0.45)
    plain = fit_weak(surge_vehicle(), prepare([surge_run(0.02, 0)], surge_vehicle()))
    for name, error in cramer_rao(plain).items():
        assert cramer_rao(fits[0])[name] == pytest.approx(error, rel=0.2)
    assert set(verdicts(fits[0])) == set(TRUTH)
    assert fits[0].condition > 1


def test_a_method_without_robust_losses_says_so() -> None:
    with pytest.raises(UndertowError, match="'huber' does not apply to --method instrumental"):
        Estimator("instrumental", loss="huber").fit(surge_vehicle(), [surge_run(0.02)])
