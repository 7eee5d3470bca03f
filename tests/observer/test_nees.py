"""NEES of runs with known states: bounds that hold for correlated errors, and noise that is misjudged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from tests.observer.test_filters import DENSITY, DT, VARIANCE, C, discrete, linear
from undertow.observer.filters import Estimate, Observer, Reports
from undertow.observer.nees import SETTINGS, Truth, nees

ROWS, RUNS = 600, 60
PRIOR = np.diag([0.5, 0.2])


def run(seed: int, misjudged: float = 1.0) -> tuple[Estimate, Truth]:
    """Truth drawn from the process, reports with noise, and a filter that takes their noise for another."""
    rng, (f, _, q) = np.random.default_rng(seed), discrete()
    root = np.linalg.cholesky(q + 1e-18 * np.eye(2))
    x = [rng.multivariate_normal(np.zeros(2), PRIOR)]
    for _ in range(ROWS - 1):
        x.append(f @ x[-1] + root @ rng.standard_normal(2))
    y = np.array(x) @ C.T + np.sqrt(VARIANCE) * rng.standard_normal((ROWS, 2))
    given = Reports(DT * np.arange(ROWS), np.zeros((ROWS, 1)), y, VARIANCE * misjudged**2)
    found = Observer(linear(), [DENSITY]).run(given, np.zeros(2), PRIOR)
    return found, Truth(("x", "u"), np.array(x), np.zeros(2))


@pytest.fixture(scope="module")
def runs() -> list[tuple[Estimate, Truth]]:
    return [run(seed) for seed in range(RUNS)]


@pytest.mark.slow
def test_a_consistent_filter_is_within_its_bounds_as_often_as_they_say(runs) -> None:
    tests = [nees([one]) for one in runs]
    assert [one.name for one in tests[0]] == ["position", "velocity", "all"]
    least = binom.ppf(0.005, RUNS, 0.95)
    for group in range(3):
        assert sum(test[group].consistent for test in tests) >= least
    assert nees(runs)[-1].consistent
    assert nees(runs)[-1].high < tests[0][-1].high


@pytest.mark.slow
def test_the_variance_of_the_mean_is_that_of_many_runs(runs) -> None:
    """Independent squares would vary far less: errors of a filter last."""
    tests = [nees([one])[-1] for one in runs]
    stated = np.mean([2 / test.independent for test in tests])
    assert np.var([test.mean for test in tests], ddof=1) == pytest.approx(stated, rel=0.45)  # 2.5 sigma
    assert tests[0].independent < 0.2 * tests[0].count


@pytest.mark.parametrize(("misjudged", "sure"), [(0.5, True), (2.0, False)])
def test_noise_misjudged_by_two_is_seen(misjudged: float, sure: bool) -> None:
    found = nees([run(seed, misjudged) for seed in range(20)])[-1]
    assert not found.consistent
    assert (found.mean > found.high) == sure


def test_errors_of_size_one_sigma_have_a_nees_of_one() -> None:
    """And noise of the reference itself counts, as do errors of whole turns, which are none."""
    found, _ = run(0)
    named = replace(found, names=("psi", "u"))
    one_sigma = found.mean[:, [0]] + found.deviation[:, [0]] - 2 * np.pi
    (heading, _) = nees([(named, Truth(("psi",), one_sigma, np.zeros(1)))])
    assert heading.mean == pytest.approx(1.0)
    twice = np.array([found.deviation[-1, 0] ** 2])
    steady = nees([(named, Truth(("psi",), one_sigma, twice))])[0]
    assert steady.mean == pytest.approx(0.5, rel=0.1)


def test_few_rows_of_truth_are_no_test() -> None:
    found, truth = run(0)
    some = np.where(np.arange(ROWS)[:, None] < ROWS - SETTINGS.fewest_rows + 1, np.nan, truth.values)
    assert nees([(found, replace(truth, values=some))]) == ()
