"""Gaps, coloured noise and closed loops: what they do to estimates, measured against known truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.identification.long_surge import EXACT, coloured, simulated, steps
from tests.identification.surge import TRUTH, surge_vehicle
from tests.quick import first_quick
from undertow.identification.estimation.data import inverse_of, prepare
from undertow.identification.estimation.fitted import Fitted
from undertow.identification.estimation.output_error import fit_output_error
from undertow.identification.estimation.weak_form import fit_weak
from undertow.paper.least_squares import estimate, experiments
from undertow.paper.regression import CASES

DRAWS, SAMPLES = 24, 1500
VEHICLE = surge_vehicle()


# --- gaps -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["weak", "output error"])
def test_gaps_cost_information_and_nothing_else(method: str) -> None:
    whole = simulated(steps(SAMPLES, 1), np.zeros(SAMPLES))
    noisy = whole.channels["u"] + 0.005 * np.random.default_rng(1).standard_normal(SAMPLES)
    lost = noisy.copy()
    for first in range(150, SAMPLES, 400):
        lost[first : first + 60] = np.nan

    def fit(u: np.ndarray) -> Fitted:
        run = replace(whole, channels={**whole.channels, "u": u})
        if method == "weak":
            return fit_weak(VEHICLE, prepare([run], VEHICLE))
        return fit_output_error(VEHICLE, [run], horizon=None)

    full, gappy = fit(noisy), fit(lost)
    for k, name in enumerate(TRUTH):
        assert abs(gappy.values[name] - EXACT[k]) < 3 * gappy.standard_errors[name]
        # 15% of the samples, and the states at the ends of five stretches.
        assert 0.9 < gappy.standard_errors[name] / full.standard_errors[name] < 2.0


# --- coloured noise ---------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("method", first_quick(["weak", "output error"]))
def test_errors_are_honest_in_coloured_noise(method: str) -> None:
    off, naive = [], []
    for seed in range(DRAWS):
        noise = coloured(SAMPLES, 0.005, 0.9, np.random.default_rng(seed))
        run = simulated(steps(SAMPLES, seed), noise)
        fit: Fitted = (
            fit_weak(VEHICLE, prepare([run], VEHICLE))
            if method == "weak"
            else fit_output_error(VEHICLE, [run], horizon=None)
        )
        error = np.array(list(fit.values.values())) - EXACT
        off.append(error / np.array(list(fit.standard_errors.values())))
        naive.append(error / np.sqrt(np.diag(inverse_of(fit.gram))))
    covered = np.mean(np.abs(off) < 1.96, axis=0)
    assert np.all(covered >= 0.75), covered
    assert np.all(np.sqrt(np.mean(np.square(off), axis=0)) < 1.6)
    if method == "output error":  # the weak form takes what the noise model lacks for a disturbance
        assert np.all(np.sqrt(np.mean(np.square(naive), axis=0)) > 2.5)


# --- closed loop ------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_feedback_of_the_noise_does_not_bias_the_fit_but_least_squares() -> None:
    by_weak, by_output, by_squares = [], [], []
    for seed in range(DRAWS):
        noise = 0.01 * np.random.default_rng(seed).standard_normal(SAMPLES)
        wanted = np.repeat(np.random.default_rng([seed, 3]).uniform(-0.25, 0.25, SAMPLES // 40 + 1), 40)
        run = simulated(lambda i, u, w=wanted: 12.0 * (w[i] - u), noise)
        by_weak.append(list(fit_weak(VEHICLE, prepare([run], VEHICLE)).values.values()))
        by_output.append(list(fit_output_error(VEHICLE, [run], horizon=None).values.values()))
        (surge,) = experiments(VEHICLE, [run])
        by_squares.append(list(estimate(surge, CASES["11"]).values.values()))

    def bias(found: list[list[float]]) -> np.ndarray:
        return np.abs(np.mean(found, axis=0) - EXACT) / np.std(found, axis=0)

    # 24 draws know a mean to a fifth of a standard deviation.
    assert np.all(bias(by_output) < 0.6)
    assert np.all(bias(by_weak) < 0.8)
    assert np.all(bias(by_squares) > 2)
