"""A steady force and one that begins in the course of a run: only the first has the same size throughout."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.identification.surge import TRUTH, surge_run, surge_vehicle
from tests.quick import first_quick
from undertow.identification.diagnosis.candidates import Candidate
from undertow.identification.diagnosis.validation import Sizes, sizes
from undertow.identification.estimation.data import prepare
from undertow.identification.estimation.weak_form import fit_weak
from undertow.identification.logs.run import Run
from undertow.model.catalogue import catalogue
from undertow.model.vehicle import Value

FORCE, BEGIN = 0.1, 8.0


def _sizes(begin: float, seed: int) -> Sizes:
    """Size of a constant force where the logged force lacks 0.1 N from some time on."""
    run = surge_run(0.01, seed)
    logged = run.channels["tau_X"] - np.where(run.t >= begin, FORCE, 0.0)
    run = Run("P", run.t, run.channels | {"tau_X": logged}, sha256=f"{seed}")
    effect, vehicle = catalogue()["constant_force"], surge_vehicle()
    known = {n: replace(vehicle.value_of(n), value=-v, estimate=False) for n, v in TRUTH.items()}
    vehicle = vehicle.with_values(known).with_effect(effect, {"X_0": Value(0.0, estimate=True)})
    data = prepare([run], vehicle)
    fit = fit_weak(vehicle, data)
    own = Candidate(effect, surge_vehicle()).parameters
    return sizes(fit, own, data, fit.model.whitening(data, fit.p))


@pytest.mark.parametrize("seed", first_quick(range(4)))
def test_a_steady_force_has_one_size(seed: int) -> None:
    found = _sizes(0.0, seed)
    assert np.all(np.abs(found.value - 1.0) < 5.0 * found.error + 0.01)
    assert found.change() == ""


@pytest.mark.parametrize("seed", first_quick(range(4)))
def test_a_force_that_begins_later_has_none_before(seed: int) -> None:
    found = _sizes(BEGIN, seed)
    before, after = found.value[0], found.value[-3:]
    assert before == pytest.approx(0.0, abs=0.15)
    assert np.all(after > 1.1)
    assert "its size would have to go from" in found.change()


def test_what_says_nothing_about_the_size_has_no_say() -> None:
    values, errors = np.array([1.0, 5.0, 1.02, 0.97]), np.array([0.01, 0.5, 0.02, 0.01])
    assert Sizes(values, errors, 0.9).change() == ""
    assert Sizes(values, np.full(4, 0.01), 0.9).change().endswith("from 97% to 500% of the fitted one")


def test_a_change_that_explains_little_of_what_is_left_is_none() -> None:
    assert Sizes(np.array([0.0, 1.0, 1.5]), np.full(3, 0.01), 0.4).change() == ""


def test_an_effect_without_a_linear_parameter_has_no_size() -> None:
    run = surge_run(0.02, 1)
    effect = catalogue()["sensor_delay"]
    vehicle = surge_vehicle()
    data = prepare([run], vehicle)
    own = [p for p in Candidate(effect, vehicle).parameters if not p.linear]
    fit = fit_weak(vehicle, data)
    found = sizes(fit, own, data, fit.model.whitening(data, fit.p))
    assert own
    assert found.value.size == 0
    assert found.change() == ""
