"""What is small and steady passes for a disturbance; searching under the sensors' noise alone finds it."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from benchmarks.hidden_effects import make_case
from tests.identification.logs_of import prepared, runs_of, vehicle_of
from undertow.identification.diagnosis.bench import Bench, only_noise, open_bench
from undertow.identification.diagnosis.evidence import (
    explains_all,
    hidden_by_disturbance,
    slightly_above_noise,
)
from undertow.identification.diagnosis.search import search
from undertow.identification.estimation.residual import whitened
from undertow.identification.estimation.weak_form import fit_weak, mean_square
from undertow.model.catalogue import catalogue
from undertow.model.vehicle import Vehicle

_FORCES = {n: catalogue()[n] for n in ("net_buoyancy", "cubic_damping", "drag_asymmetry", "radiation_memory")}


@cache
def _bench() -> tuple[Vehicle, Bench, float]:
    """A profiling float 15 mN out of trim, which is what the drag of 7.6 N/(m/s) gives at 2 mm/s."""
    case = make_case("float", ("net_buoyancy",), 71149101, strength=0.15)
    vehicle, runs = vehicle_of(case), runs_of(case)
    bench = open_bench(vehicle, *prepared(vehicle, runs[:-1], runs[-1:]))
    return vehicle, bench, case.truth["values"]["net_buoyancy"]["B_net"]


@pytest.mark.slow
def test_the_model_without_the_force_calls_it_a_disturbance() -> None:
    _, bench, _ = _bench()
    assert np.any(bench.base.disturbance)
    assert bench.base_score.error < 1.1  # by its own noise model nothing is amiss
    assert hidden_by_disturbance(bench)
    assert not hidden_by_disturbance(bench.without_disturbance())


def test_a_bench_without_disturbance_weighs_by_the_noise_of_the_sensors() -> None:
    _, bench, _ = _bench()
    bare = bench.without_disturbance()
    assert not np.any(bare.base.disturbance)
    for data, whitening in ((bare.train, bare.train_whitening), (bare.test, bare.test_whitening)):
        expected = bare.base.model.whitening(data, bare.base.p)
        parts = bare.base.model.linearise(data, bare.base.p)
        found, right = (mean_square(whitened(parts, w).r, data) for w in (whitening, expected))
        assert np.allclose(found, right, rtol=0.02)
    assert np.allclose(bare.noise_level, 1.0, atol=0.2)


@pytest.mark.slow
def test_the_steady_force_is_found_at_its_size() -> None:
    vehicle, bench, truth = _bench()
    found = search(vehicle, bench.train, bench.test, _FORCES, residual_is_noise=only_noise)
    assert [f.id for f in found.winners] == ["net_buoyancy"]
    fit = found.effect_set.fit
    error = fit.values["B_net"] - truth
    spread = float(np.sqrt(fit.covariance[(k := fit.model.free.index("B_net")), k]))
    assert abs(error) < 3.5 * spread < 0.1 * abs(truth)


@pytest.mark.slow
def test_what_does_not_explain_all_is_not_found_by_the_second_look() -> None:
    """Without the truth among the candidates none may take its place."""
    vehicle, bench, _ = _bench()
    others = {n: e for n, e in _FORCES.items() if n in ("cubic_damping", "radiation_memory")}
    assert search(vehicle, bench.train, bench.test, others, residual_is_noise=only_noise).winners == []


def test_the_truth_explains_all_and_the_model_as_it_was_nothing() -> None:
    vehicle, bench, truth = _bench()
    bare = bench.without_disturbance()
    grown = vehicle.with_effect(catalogue()["net_buoyancy"], {})
    right = fit_weak(grown, bare.train, start={"B_net": truth})
    assert explains_all(bare, right, only_noise)
    assert not explains_all(bare, bare.base, only_noise)


@pytest.mark.parametrize(
    ("disturbance", "left", "expected"),
    [(0.0, 5.0, False), (1.0, 1.1, False), (1.0, 5.0, True), (1.0, 5000.0, False)],
)
def test_when_it_is_worth_a_second_look(disturbance: float, left: float, expected: bool) -> None:
    """Not without a disturbance, not where noise is all there is, not where the model is far off."""
    ratio, rows = np.array([1.0, left]), np.array([400, 400])
    assert slightly_above_noise(np.array([disturbance]), ratio, rows) is expected
