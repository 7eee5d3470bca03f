"""The end of a diagnosis: what is screened, the last fit of a model, and the last word by simulation."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.hidden_effects import make_case
from tests.identification.logs_of import prepared, runs_of, vehicle_of
from undertow.identification.diagnosis.bench import Bench, noise_ratio, open_bench
from undertow.identification.diagnosis.candidates import Candidate
from undertow.identification.diagnosis.evidence import EffectSet
from undertow.identification.diagnosis.search import last_fit
from undertow.identification.diagnosis.trial import screen, try_candidate, without_redundant
from undertow.identification.diagnosis.validation import (
    Contender,
    SimulationValidator,
    significantly_worse_in_windows,
    worse_by_rank_test,
)
from undertow.identification.estimation.weak_form import fit_weak
from undertow.identification.logs.run import Run
from undertow.model.catalogue import catalogue
from undertow.model.vehicle import Value, Vehicle


@cache
def _case() -> tuple[Vehicle, list[Run], dict[str, float]]:
    """A vessel with quadratic drag in surge, sway and yaw, a little of it in surge."""
    case = make_case("usv", ("quadratic_damping",), 67363788, strength=0.4, noise=0.3, duration=40.0)
    return vehicle_of(case), runs_of(case), case.truth["values"]["quadratic_damping"]


@cache
def _bench() -> Bench:
    vehicle, runs, _ = _case()
    return open_bench(vehicle, *prepared(vehicle, runs[:-1], runs[-1:]))


def test_a_part_that_thrust_per_command_stands_in_for_is_left_out() -> None:
    """Thrust c + a c + b |c| c: a is the scale of c, where that is estimated, too."""
    vehicle, runs, _ = _case()
    scaled = [replace(t, thrust_per_command=Value(1.0, estimate=True)) for t in vehicle.thrusters]
    for known, redundant in ((True, ()), (False, ("curve_linear",))):
        model = vehicle if known else replace(vehicle, thrusters=tuple(scaled))
        bench = open_bench(model, *prepared(model, runs[:1], runs[-1:]))
        candidate = without_redundant(Candidate(catalogue()["thruster_curve"], model), bench)
        assert candidate.redundant == redundant
        assert {p.name for p in candidate.parameters} == {"curve_linear", "curve_square"} - {*redundant}


def _candidate(effect: str) -> Candidate:
    return Candidate(catalogue()[effect], _case()[0])


def _validator() -> SimulationValidator:
    vehicle, runs, _ = _case()
    return SimulationValidator(vehicle, runs[:-1], runs[-1:], _bench().train.sigma)


def test_a_last_fit_drops_nothing_and_takes_back_what_is_more_likely_there() -> None:
    candidate = _candidate("quadratic_damping")
    whole = try_candidate(candidate, _bench(), {}).full
    kept = tuple(n for n in whole.model.free if n != "N_rabsr")
    without = fit_weak(candidate.model(kept), whole.data, start=whole.values)
    last = last_fit(without, [candidate])
    assert set(kept) <= set(last.model.free)
    truth = _case()[2]
    assert "N_rabsr" in last.model.free
    for name in ("N_rabsr", "Y_vabsv"):
        error = last.values[name] - truth[name]
        assert abs(error) < 4 * last.standard_errors[name], name


def test_the_model_with_the_truth_outdoes_the_one_without_and_not_the_other_way_round() -> None:
    validator, base = _validator(), _bench().base
    truth = last_fit(try_candidate(_candidate("quadratic_damping"), _bench(), {}).fit, [])
    assert validator.significantly_worse(base, truth)
    assert not validator.significantly_worse(truth, base)
    assert not validator.significantly_worse(truth, truth)


def test_output_error_has_the_last_word_and_its_errors_are_honest() -> None:
    candidate = _candidate("quadratic_damping")
    weak = last_fit(try_candidate(candidate, _bench(), {}).fit, [candidate])
    validator = _validator()
    fit, squares = validator.refined(weak)
    assert np.sqrt(np.mean(squares)) == pytest.approx(1.0, abs=0.06)
    assert np.mean(squares) <= 1.01 * np.mean(validator.squares(weak))
    truth = _case()[2]
    off = [(fit.values[n] - truth[n]) / fit.standard_errors[n] for n in fit.values if n in truth]
    assert len(off) >= 2
    assert np.max(np.abs(off)) < 4


def test_a_model_that_is_far_off_is_not_fitted_by_simulation() -> None:
    vehicle = _case()[0]
    heavy = vehicle.with_values({n: Value(-500.0, estimate=True) for n in ("X_udot", "N_rdot")})
    model = fit_weak(heavy, _bench().train, ())
    fit, squares = _validator().refined(model)
    assert fit is model
    assert np.mean(squares) > 100


def _spread(total: float, windows: int) -> np.ndarray:
    return np.full(windows, total / windows)


@pytest.mark.parametrize(
    ("short", "long", "significantly_worse"),
    [
        (_spread(20.0, 20), _spread(3.0, 5), True),
        (_spread(3.0, 20), _spread(20.0, 5), True),
        (_spread(10.0, 20), _spread(10.0, 5), False),
        (_spread(-90.0, 20), _spread(110.0, 5), False),
        (np.eye(20)[3] * 500.0, np.eye(5)[2] * 900.0, False),
        (np.append(np.inf, np.zeros(19)), _spread(3.0, 5), False),
        (np.append([np.inf, np.inf], np.zeros(18)), _spread(3.0, 5), True),
    ],
)
def test_windows_that_contradict_each_other_or_a_single_one_decide_nothing(
    short: np.ndarray, long: np.ndarray, significantly_worse: bool
) -> None:
    """Short and long windows each give twice a log-likelihood ratio; one that says the opposite is heard."""
    least = [_spread(5e3, 20), _spread(5e3, 5)]
    costs = [least[0] + short, least[1] + long]
    assert significantly_worse_in_windows(costs, least, [1.0, 1.0]) is significantly_worse
    # The same where eight times the noise is left: it passes for noise.
    diverged = not (np.isfinite(short).all() and np.isfinite(long).all())
    assert significantly_worse_in_windows(costs, least, [8.0, 8.0]) is (significantly_worse and diverged)


@pytest.mark.parametrize(("times", "stands"), [(1.004, True), (1.2, False)])
def test_a_regular_gap_of_little_tells_nothing_where_more_than_noise_is_left(
    times: float, stands: bool
) -> None:
    """As on a roll decay: a trim error and a compass that is off bend alike to what neither explains."""
    bench, validator = _bench(), _validator()
    left = np.full(20, 3.4)
    effect_sets = [EffectSet((), replace(bench.base), bench.base_score) for _ in range(2)]
    pairs = zip(effect_sets, (1.0, times), strict=True)
    contenders = [Contender(c, c.fit, left * level) for c, level in pairs]
    assert worse_by_rank_test(left * times, left)
    assert [id(c) for c in validator.surviving(contenders)] == [id(c) for c in effect_sets[: 1 + stands]]


def test_of_effects_that_simulate_alike_the_plainest_leads() -> None:
    """A force in each of three directions and one up only: where one up is enough, that is what it is."""
    bench, validator = _bench(), _validator()
    fit = try_candidate(_candidate("quadratic_damping"), bench, {}).fit
    candidates = [SimpleNamespace(parameters=range(n)) for n in (6, 1)]
    free, plain = (
        EffectSet((SimpleNamespace(trial=SimpleNamespace(candidate=c)),), replace(fit), bench.score(fit))
        for c in candidates
    )
    worse = EffectSet((), bench.base, bench.base_score)
    assert validator.surviving([validator.contender(c) for c in (free, worse, plain)]) == [plain, free]


@pytest.mark.slow
def test_a_boundary_in_a_small_part_of_a_wide_range_is_found() -> None:
    """One of the runs goes 28 m to the east, and drag rises by 0.2% over two metres at its beginning."""
    case = make_case(
        "catamaran", ("boundary_proximity",), 98222414, strength=9e-4, noise=0.3, closed_loop=True
    )
    vehicle, runs = vehicle_of(case), runs_of(case)
    bench = open_bench(vehicle, *prepared(vehicle, runs[:-1], runs[-1:]))
    candidate = Candidate(catalogue()["boundary_proximity"], vehicle)
    found = try_candidate(candidate, bench, screen(candidate, bench)[0].values)
    away = found.fit.values["fade_0"] / found.fit.values["fade_E"]
    assert away == pytest.approx(case.truth["values"]["boundary_proximity"]["y_w"], abs=0.5)
    assert np.nanmax(noise_ratio(bench.base, bench.test)) > 4.0
    assert np.nanmax(noise_ratio(found.fit, bench.test)) < 1.5
