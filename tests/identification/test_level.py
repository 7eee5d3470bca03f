"""What counts as noise: mean squares by the number of rows, and simulation errors quick and slow."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.identification.surge import surge_run, surge_vehicle
from tests.quick import first_quick
from undertow.identification.diagnosis.bench import is_noise
from undertow.identification.diagnosis.validation import SimulationValidator, means_over, simulates_to_noise
from undertow.identification.estimation.data import prepare
from undertow.identification.estimation.weak_form import fit_weak


def _shooting(errors: np.ndarray, step: float = 0.05) -> SimpleNamespace:
    """What a simulation of windows comes to."""
    t = np.tile(step * np.arange(errors.shape[1]), (len(errors), 1))
    return SimpleNamespace(errors=lambda *_: errors, windows=SimpleNamespace(t=t), used=~np.isnan(errors))


def _white(seed: int, channels: int = 6) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((5, 400, channels))


def _parts(count: int = 5) -> np.ndarray:
    """Seconds of windows of 20 s at 20 Hz."""
    return np.tile(np.arange(400) // 20, (count, 1))


_STARTS = np.zeros((5, 12))


def test_means_of_white_noise_have_unit_variance() -> None:
    found = means_over(_white(1), _parts())
    assert found.shape == (5, 20, 6)
    assert np.mean(found**2) == pytest.approx(1.0, abs=4 * np.sqrt(2 / found.size))


def test_means_of_few_samples_have_unit_variance_too() -> None:
    """A channel at a tenth of the clock has two samples in twenty."""
    errors = _white(2)
    errors[:, np.arange(400) % 10 > 0] = np.nan
    errors[0, :20, 1] = np.nan
    found = means_over(errors, _parts())
    assert np.isnan(found[0, 0, 1])
    assert np.count_nonzero(np.isnan(found)) == 1
    assert np.nanmean(found**2) == pytest.approx(1.0, abs=4 * np.sqrt(2 / found.size))


def test_windows_of_different_rates_are_cut_into_seconds() -> None:
    """The slower ones are padded with their last instant, which is no sample."""
    errors, t = _white(6), np.tile(0.05 * np.arange(400), (5, 1))
    t[1:] = np.minimum(0.2 * np.arange(400), 19.8)
    errors[1:, 100:] = np.nan
    shooting = _shooting(errors)
    shooting.windows.t = t
    assert simulates_to_noise(shooting, np.zeros(0), _STARTS)  # type: ignore[arg-type]
    errors[:, :, 3] += 1.0 * np.sin(2 * np.pi * t / 10.0)
    assert not simulates_to_noise(shooting, np.zeros(0), _STARTS)  # type: ignore[arg-type]


@pytest.mark.parametrize("seed", first_quick(range(20), 3))
def test_white_noise_passes(seed: int) -> None:
    assert simulates_to_noise(_shooting(_white(seed)), np.zeros(0), _STARTS)  # type: ignore[arg-type]


@pytest.mark.parametrize("seed", first_quick(range(5)))
def test_a_slow_error_of_a_third_of_the_noise_does_not_pass(seed: int) -> None:
    """It adds a tenth to the mean square of single samples of one channel, and doubles that of means."""
    errors = _white(seed)
    errors[:, :, 2] += 0.33 * np.sqrt(2) * np.sin(2 * np.pi * np.arange(400) / 200)
    assert np.max(np.mean(errors**2, axis=(0, 1))) < 1.3
    assert not simulates_to_noise(_shooting(errors), np.zeros(0), _STARTS)  # type: ignore[arg-type]


@pytest.mark.parametrize("value", [np.inf, 1e200])
def test_a_simulation_that_runs_away_does_not_pass(value: float) -> None:
    errors = _white(3)
    errors[1, 100:, 0] = value
    with np.errstate(over="ignore"):
        assert not simulates_to_noise(_shooting(errors), np.zeros(0), _STARTS)  # type: ignore[arg-type]


def test_a_simulation_that_ends_in_no_number_does_not_pass() -> None:
    shooting = _shooting(_white(4))
    broken = _white(4)
    broken[2, 50:, 3] = np.nan
    shooting.errors = lambda *_: broken
    assert not simulates_to_noise(shooting, np.zeros(0), _STARTS)  # type: ignore[arg-type]


def test_channels_that_are_not_there_have_no_say() -> None:
    errors = _white(5)
    errors[:, :, 4] = np.nan
    assert simulates_to_noise(_shooting(errors), np.zeros(0), _STARTS)  # type: ignore[arg-type]


@pytest.mark.parametrize(("rows", "level", "expected"), [
    (400, 1.3, True), (400, 1.45, False), (40, 1.45, True), (40, 1.9, True), (40, 2.1, False),
])  # fmt: skip
def test_few_rows_leave_more_to_chance(rows: int, level: float, expected: bool) -> None:
    assert is_noise(np.array([1.0, level]), np.array([rows, rows])) is expected


def test_the_right_model_simulates_to_noise_and_one_without_square_drag_does_not() -> None:
    vehicle, run = surge_vehicle(), surge_run(0.02, 3)
    data = prepare([run], vehicle)
    right = fit_weak(vehicle, data)
    nil = replace(vehicle.value_of("X_uabsu"), value=0.0, estimate=False)
    lacking = fit_weak(vehicle.with_values({"X_uabsu": nil}), data)
    validator = SimulationValidator(vehicle, [run], [run], data.sigma)
    assert validator.leaves_only_noise(right)
    assert not validator.leaves_only_noise(lacking)


def test_no_number_is_no_noise() -> None:
    ratio = np.array([1.0, np.nan, np.nan])
    assert not is_noise(ratio, np.array([50, 50, 0]))
    assert is_noise(ratio, np.array([50, 0, 0]))
