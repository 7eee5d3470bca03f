"""A model on runs that go faster than those it was fitted to: errors of parameters are no missing effect."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from tests.identification.long_surge import simulated, steps
from tests.identification.surge import surge_vehicle
from undertow.identification.diagnosis.settings import DEFAULT
from undertow.identification.diagnosis.validation import (
    SimulationValidator,
    refitted_within_errors,
    simulates_to_noise,
)
from undertow.identification.estimation.data import prepare
from undertow.identification.estimation.output_error import OutputErrorFit, channel_weights, fit_output_error
from undertow.identification.estimation.shooting import Shooting
from undertow.identification.estimation.weak_form import fit_weak
from undertow.identification.estimation.windows import cut
from undertow.identification.logs.run import Run

NOISE = 2e-3  # m/s
SLOW, FAST = 0.1, 0.4  # N


def _run(force: float, seed: int, more_drag: float = 0.0) -> Run:
    noise = NOISE * np.random.default_rng(seed).standard_normal(600)
    # A strut lowered into the water for this run, say.
    return simulated(steps(600, seed, size=force), noise, disturbance=lambda i, u: -more_drag * abs(u) * u)


def _sigma() -> np.ndarray:
    return prepare([_run(SLOW, 1)], surge_vehicle()).sigma


@cache
def _fit() -> OutputErrorFit:
    return fit_output_error(surge_vehicle(), [_run(SLOW, 1)], horizon=DEFAULT.long_windows)


def _fast(more_drag: float) -> tuple[Shooting, np.ndarray]:
    fit = _fit()
    windows = cut([_run(FAST, 2, more_drag)], surge_vehicle(), DEFAULT.long_windows, sigma=_sigma())
    shooting = Shooting(fit.model.functions, windows, fit.model.free, channel_weights(windows))
    return shooting, shooting.fitted_starts(fit.p)


def test_parameters_move_to_where_both_data_together_have_them() -> None:
    fit = _fit()
    shooting, starts = _fast(0.0)
    assert not simulates_to_noise(shooting, fit.p, starts)
    found = refitted_within_errors(fit, shooting, starts)
    assert found is not None
    assert simulates_to_noise(shooting, *found)
    both = fit_output_error(surge_vehicle(), [_run(SLOW, 1), _run(FAST, 2)], horizon=DEFAULT.long_windows)
    moved, together = (np.array([p[i] for i in fit.model.places]) for p in (found[0], both.p))
    errors = np.array(list(both.standard_errors.values()))
    # The noise of a channel is estimated, by a few per cent otherwise for each set of runs.
    np.testing.assert_array_less(np.abs(moved - together), 0.1 * errors)
    assert np.max(np.abs(together - list(fit.values.values())) / errors) > 3.0


def test_a_drag_that_the_fit_rules_out_is_no_error_of_its_parameters() -> None:
    shooting, starts = _fast(3.0)
    assert refitted_within_errors(_fit(), shooting, starts) is None


@pytest.mark.parametrize(("more_drag", "noise"), [(0.0, True), (3.0, False)])
def test_faster_runs_kept_aside_speak_against_a_model_only_beyond_its_errors(
    more_drag: float, noise: bool
) -> None:
    train, test = [_run(SLOW, 1)], [_run(FAST, 2, more_drag)]
    weak = fit_weak(surge_vehicle(), prepare(train, surge_vehicle()))
    assert SimulationValidator(surge_vehicle(), train, test, _sigma()).leaves_only_noise(weak) is noise
