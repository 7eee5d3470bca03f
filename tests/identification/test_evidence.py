"""Evidence: what chance does, what is superfluous, what stands up to simulation, what acts like another."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from scipy.signal import lfilter

from benchmarks.hidden_effects import make_case
from tests.identification.logs_of import prepared, runs_of, vehicle_of
from tests.quick import first_quick
from undertow.errors import UndertowError
from undertow.identification.diagnosis.bench import Bench, comparable_mean_squares, open_bench
from undertow.identification.diagnosis.candidates import Candidate, candidates, possible, possible_in
from undertow.identification.diagnosis.evidence import (
    Blocks,
    Comparison,
    FoundEffect,
    Linearisation,
    NullDistributions,
    fitted,
    inclusion,
    null_distribution,
    p_value,
    rank_p_value,
    reduced_to_same_force,
    with_longer_blocks,
    without_redundant_effects,
)
from undertow.identification.diagnosis.search import search
from undertow.identification.diagnosis.settings import Settings
from undertow.identification.diagnosis.splitting import repeats
from undertow.identification.diagnosis.trial import best_start, screen, try_candidate
from undertow.identification.diagnosis.validation import SimulationValidator, worse_by_rank_test
from undertow.identification.diagnosis.verdict import equivalents, moved_parameters
from undertow.identification.estimation.data import WeakData, clustered, prepare, summed_scores
from undertow.identification.estimation.residual import whitened
from undertow.identification.estimation.weak_form import fit_weak, mean_square
from undertow.identification.logs.pose_velocity import velocities_from_pose
from undertow.identification.result_builder import validated
from undertow.model.catalogue import catalogue
from undertow.model.vehicle import Value

_ROWS, _PER_BLOCK = 600, 20
_INERTIA = ("added_mass", "added_mass_coriolis")


def _candidates(rng: np.random.Generator, sizes: list[float]) -> list[Linearisation]:
    """Candidates of two columns beside two of the model; `size` times the first is in the residual."""
    base, r = rng.standard_normal((2 * _ROWS, 2)), rng.standard_normal(2 * _ROWS)
    own = [rng.standard_normal((2 * _ROWS, 2)) for _ in sizes]
    for size, columns in zip(sizes, own, strict=True):
        r += size * columns[:, 0]
    block = np.arange(_ROWS) // _PER_BLOCK
    found = []
    for columns in own:
        J = np.hstack([base, columns])
        halves = (slice(0, _ROWS), slice(_ROWS, 2 * _ROWS))
        train, test = (Blocks.of(J[h], np.zeros(_ROWS), r[h], block) for h in halves)
        found.append(Linearisation(train, test, 2, np.zeros(4)))
    return found


def _observed(candidate: Linearisation) -> float:
    ones = [np.ones((1, b.count)) for b in (candidate.train, candidate.test)]
    return float(candidate.falls(*ones)[0])


def _best_p(rng: np.random.Generator, sizes: list[float]) -> float:
    found = _candidates(rng, sizes)
    return p_value(max(_observed(c) for c in found), null_distribution(found))


def test_tables_of_blocks_give_what_the_columns_give() -> None:
    rng = np.random.default_rng(1)
    J, shift, r = rng.standard_normal((60, 3)), rng.standard_normal(60), rng.standard_normal(60)
    block = np.repeat(np.arange(6), 10)
    signs, delta = rng.choice([-1.0, 1.0], (4, 6)), rng.standard_normal((4, 3))
    found = Blocks.of(J, shift, r, block).squares(signs, delta)
    direct = [np.sum((s[block] * r + shift + J @ d) ** 2) for s, d in zip(signs, delta, strict=True)]
    np.testing.assert_allclose(found, direct, rtol=1e-12)


def test_when_nothing_is_missing_the_best_of_ten_is_rarely_sure() -> None:
    rng = np.random.default_rng(2)
    chances = np.array([_best_p(rng, [0.0] * 10) for _ in range(60)])
    # Uniform between 0 and 1 in the ideal case: 6 of 60 below 0.1, with 1 to 13 within chance.
    assert np.count_nonzero(chances < 0.1) <= 13
    assert np.count_nonzero(chances < 0.01) <= 3
    assert np.median(chances) > 0.25


def test_an_effect_that_is_there_is_sure() -> None:
    rng = np.random.default_rng(3)
    assert _best_p(rng, [0.0, 0.3, 0.0]) < 0.01


def test_the_effect_that_is_there_is_the_best_one_in_nearly_all_resamples() -> None:
    share = inclusion(_candidates(np.random.default_rng(4), [0.3, 0.0]))
    assert share.sum() == pytest.approx(1.0)
    assert share[0] > 0.95


def test_falls_of_blocks_left_out_are_those_of_models_fitted_to_all_others() -> None:
    rng, rows, per_block = np.random.default_rng(12), 60, 10
    J, shift, r = rng.standard_normal((rows, 4)), rng.standard_normal(rows), rng.standard_normal(rows)
    block, prior = np.arange(rows) // per_block, np.array([0.0, 1.0, 0.0, 2.0])
    tables = (
        Blocks.of(J[h], shift[h], r[h], block[h] - block[h][0]) for h in (slice(0, 40), slice(40, rows))
    )

    def left(out: np.ndarray, columns: np.ndarray, y: np.ndarray, weight: np.ndarray) -> float:
        rows_, target = np.vstack([columns[~out], np.diag(weight)]), np.append(y[~out], np.zeros(len(weight)))
        return float(np.sum((y[out] - columns[out] @ np.linalg.lstsq(rows_, target, rcond=None)[0]) ** 2))

    expected = [
        left(block == b, J[:, :2], r, prior[:2]) - left(block == b, J, r + shift, prior) for b in range(6)
    ]
    assert Linearisation(*tables, 2, prior).left_out_falls() == pytest.approx(np.array(expected))


@cache
def _minutes_of_a_usv() -> tuple[WeakData, WeakData]:
    case = make_case("usv", (), 21, duration=100.0)
    model, runs = vehicle_of(case), runs_of(case)
    return prepared(model, runs[:3], runs[3:])


def _wandering(data: WeakData, memory: float, rng: np.random.Generator, columns: int) -> np.ndarray:
    """Rows of unit variance in every equation, (m, columns), with a time constant of so many s."""
    step = float(np.median(np.diff(data.time[:: len(data.rows)])))
    keep = np.exp(-step / memory)
    white = rng.standard_normal((len(data.time) // len(data.rows), len(data.rows), columns))
    return lfilter([np.sqrt(1 - keep**2)], [1.0, -keep], white, axis=0).reshape(-1, columns)


def test_blocks_are_as_long_as_what_they_hold_needs_to_forget_itself() -> None:
    data, rng = _minutes_of_a_usv()[0], np.random.default_rng(6)
    rows = len(data.rows)
    for memory, longest in ((0.01, 5.0), (4.0, 20.0)):
        series = _wandering(data, memory, rng, 100).reshape(-1, rows, 100).sum(axis=1)
        lengths = [data.uncorrelated_seconds(s) for s in series.T]
        assert np.median(lengths) <= longest
        assert np.median(lengths) > 0.5 * longest


def test_standard_errors_know_of_a_slow_disturbance() -> None:
    """Of the mean of a series with a time constant, from groups of 5 s that do not forget each other."""
    data, rng = _minutes_of_a_usv()[0], np.random.default_rng(8)
    block, rows = data.block, len(data.time)
    information = np.array([[float(rows)]])

    def variance(memory: float) -> float:
        draws = _wandering(data, memory, rng, 100).T
        found = [clustered(information, summed_scores(r, np.ones((rows, 1)), block)) for r in draws]
        return rows * float(np.mean(found))

    step = data.seconds * len(data.rows) / rows
    assert variance(0.01) == pytest.approx(1.0, abs=0.35)
    # White noise has a variance of 1, one that forgets with T of 2 T over the step.
    assert variance(6.0) == pytest.approx(2 * 6.0 / step, rel=0.35)
    blocks = [np.bincount(block, weights=r) for r in _wandering(data, 6.0, rng, 100).T]
    assert np.mean([np.sum(b**2) for b in blocks]) / rows < 0.55 * 2 * 6.0 / step


def _chance_of_slow(rng: np.random.Generator, size: float, *, longer: bool) -> float:
    """p-value of the best of five slow effects under a slow disturbance; one is there with this size."""
    train, test = _minutes_of_a_usv()
    bench = cast("Bench", SimpleNamespace(train=train, test=test, settings=Settings(null_draws=400)))
    r, own = ([_wandering(d, 6.0, rng, k) for d in (train, test)] for k in (1, 5))
    r = [left[:, 0] + size * columns[:, 0] for left, columns in zip(r, own, strict=True)]
    found = []
    for k in range(5):
        tables = (
            Blocks.of(own[i][:, [k]], np.zeros(len(d.time)), r[i], d.block)
            for i, d in enumerate((train, test))
        )
        found.append(Linearisation(*tables, 1, np.zeros(1)))
    falls = [_observed(c) for c in found]
    best = int(np.argmax(falls))
    x = own[0][:, best]
    change = (x @ r[0]) / (x @ x) * x
    score = ((r[0] - change) * change).reshape(-1, len(train.rows)).sum(axis=1)
    times = round(train.uncorrelated_seconds(score) / train.block_seconds)
    return NullDistributions(found, bench).p_value(falls[best], max(1, times) if longer else 1)


@pytest.mark.slow
def test_a_slow_disturbance_is_no_evidence_for_a_slow_effect() -> None:
    rng = np.random.default_rng(7)
    often = [
        np.mean([_chance_of_slow(rng, 0.0, longer=longer) < 0.05 for _ in range(100)])
        for longer in (False, True)
    ]
    assert often[0] > 0.2
    assert often[1] <= 0.12


def test_a_slow_effect_that_is_there_shows_beside_a_slow_disturbance() -> None:
    rng = np.random.default_rng(9)
    assert np.mean([_chance_of_slow(rng, 2.0, longer=True) < 0.01 for _ in range(30)]) > 0.9


def _by_rank(rng: np.random.Generator, memory: float, size: float) -> float:
    """p-value by ranks of a steady force of this size under a disturbance of this time constant, s."""
    train, test = _minutes_of_a_usv()
    bench = cast("Bench", SimpleNamespace(train=train, test=test))
    r = [_wandering(d, memory, rng, 1)[:, 0] + size for d in (train, test)]
    left = (r[0] - r[0].mean()).reshape(-1, len(train.rows)).sum(axis=1)
    times = max(1, round(train.uncorrelated_seconds(left) / train.block_seconds))
    tables = (
        Blocks.of(np.ones((len(d.time), 1)), np.zeros(len(d.time)), y, d.block)
        for d, y in zip((train, test), r, strict=True)
    )
    force = with_longer_blocks(Linearisation(*tables, 1, np.zeros(1)), times, bench)
    return rank_p_value(force.left_out_falls())


@pytest.mark.parametrize(("memory", "level"), first_quick([(5.0, 1e-3), (1.0, 1e-3), (20.0, 1e-2)]))
def test_a_steady_force_shows_under_a_slow_disturbance_only_if_it_is_there(
    memory: float, level: float
) -> None:
    """Every block counts, each against models fitted to the others: those of validation data are too few."""
    rng = np.random.default_rng(11)
    by_chance, there = ([_by_rank(rng, memory, size) for _ in range(60)] for size in (0.0, 3.0))
    assert np.mean(np.array(by_chance) < 0.01) <= 0.05
    assert np.mean(np.array(there) < level) > 0.9


def test_one_window_in_twenty_does_not_make_a_model_clearly_worse() -> None:
    rng = np.random.default_rng(5)
    squares = 1.0 + 0.1 * rng.standard_normal(20)
    one_bad = squares.copy()
    one_bad[3] += 5.0
    assert not worse_by_rank_test(one_bad, squares)
    assert worse_by_rank_test(squares + 0.5, squares)
    assert worse_by_rank_test(np.full(20, np.inf), squares)
    assert not worse_by_rank_test(squares, squares)


@pytest.mark.parametrize(("strength", "needed"), first_quick([(0.03, False), (0.3, True)]))
def test_an_effect_beside_another_has_to_improve_predictions_by_enough_to_matter(
    strength: float, needed: bool
) -> None:
    """A steady force of 7 or 70 mN beside missing drag: both are significant, sensors are that precise."""
    case = make_case(
        "box", ("quadratic_damping", "constant_force"), 7, strength=strength, noise=0.3, duration=50
    )
    runs, vehicle = runs_of(case), vehicle_of(case)
    train, test = prepared(vehicle, runs[:3], runs[3:])
    known = {name: catalogue()[name] for name in ("quadratic_damping", "constant_force")}
    found = search(vehicle, train, test, known, residual_is_noise=lambda fit, data: False)
    assert [f.id for f in found.winners] == ["quadratic_damping", "constant_force"]
    validator = SimulationValidator(found.vehicle, train.runs, test.runs, train.sigma)
    kept = [f.id for f in validated(found, validator).winners]
    assert kept == ["quadratic_damping", "constant_force"][: 1 + needed]


@pytest.mark.parametrize(("windows", "worse"), [(4, False), (5, True), (6, True), (7, True)])
def test_a_few_windows_have_to_say_all_the_same(windows: int, worse: bool) -> None:
    """No rank test of six windows gives one per cent, however gross the difference."""
    squares = 10.0 + np.arange(windows)
    assert worse_by_rank_test(3.0 * squares, squares) is worse
    but_one = 3.0 * squares
    but_one[0] = 9.0
    assert not worse_by_rank_test(but_one, squares)


def test_water_in_the_hull_acts_like_added_mass_that_is_wrong_by_as_much_in_surge_and_sway() -> None:
    case = make_case("usv", (), 21, duration=40.0)
    model, runs = vehicle_of(case), runs_of(case)
    true = {n: case.truth["parameters"][n] for n in ("X_udot", "Y_vdot")}
    # Both stated 6 kg too small, and said to be known well.
    stated = {n: replace(model.value_of(n), value=v + 6.0, sigma=0.5) for n, v in true.items()}
    off = model.with_values(stated)
    bench = open_bench(off, *prepared(off, runs[:3], runs[3:]))
    assert set(moved_parameters(off, bench.base)) == {"X_udot", "Y_vdot"}
    tried = [Candidate(catalogue()[n], off) for n in ("entrained_water", "dry_friction", "lift")]
    (found,) = equivalents(off, bench, tried)
    assert found.effects == ["entrained_water"]
    assert found.parameters == ["X_udot", "Y_vdot"]
    assert "determine X_udot and Y_vdot by other means" in found.separated_by
    right = open_bench(model, bench.train, bench.test)
    assert equivalents(model, right, tried) == []


@pytest.mark.slow
def test_water_in_the_hull_is_said_where_added_masses_are_only_guessed() -> None:
    """A mass of two thirds: every guess is off by its own few per cent, and all must go the same way.

    The weight is that of the trimmed vehicle, and not the mass times g.
    """
    case = make_case("mini-auv", (), 21, duration=60.0)
    model, runs = replace(vehicle_of(case), follows={}), runs_of(case)
    dry = model.with_values({"m": replace(model.value_of("m"), value=0.67 * model.value_of("m").value)})
    bench = open_bench(dry, *prepared(dry, runs[:3], runs[3:]))
    assert {"X_udot", "Y_vdot", "Z_wdot"} <= set(moved_parameters(dry, bench.base))
    listed = ("entrained_water", "dry_friction", "lift", "constant_force", "thruster_lag")
    (found,) = equivalents(dry, bench, [Candidate(catalogue()[n], dry) for n in listed])
    assert found.effects == ["entrained_water"]


@pytest.mark.slow
def test_velocities_taken_from_the_pose_leave_only_noise_and_no_velocity_sensor_to_blame() -> None:
    case = make_case("usv", (), 22)
    model, runs = vehicle_of(case), runs_of(case)
    pose = [replace(r, channels={k: v for k, v in r.channels.items() if k not in "uvwpqr"}) for r in runs[:3]]
    derived = [velocities_from_pose(r) for r in pose]
    data = prepare(derived, model)
    fit = fit_weak(model, data)
    np.testing.assert_allclose(fit.mean_square()[:3], 1.0, atol=0.5)
    for name in ("X_udot", "N_r"):
        error = fit.standard_errors[name]
        assert abs(fit.values[name] - case.truth["parameters"][name]) < 4 * error, name
    assert data.derived_names == ("u", "v", "r")
    ids = {c.id for c in possible_in(data, model, catalogue())}
    of_velocity = "sensor_scale sensor_bias sensor_delay velocity_lever_arm velocity_misalignment"
    assert ids.isdisjoint(of_velocity.split())
    assert {"position_lever_arm", "attitude_bias"} <= ids


def test_a_rate_that_no_gyro_measured_has_no_scale_and_no_bias() -> None:
    model = vehicle_of(make_case("usv", (), 22, duration=1.0))
    listed = {c.id: {p.name for p in c.parameters} for c in possible(model, catalogue(), derived=("r",))}
    assert listed["sensor_scale"] == {"scale_velocity"}
    assert listed["sensor_bias"] == {"b_u", "b_v"}
    assert listed["sensor_delay"] == {"velocity_delay"}
    free = {c.id: {p.name for p in c.parameters} for c in candidates(model, catalogue())}
    assert free["sensor_scale"] == {"scale_velocity", "scale_rate"}


def test_effects_that_the_vehicle_file_excludes_are_not_tried() -> None:
    model = vehicle_of(make_case("usv", (), 22, duration=1.0))
    free = replace(model, excluded_effects=("tether_drag", "tether_tension"))
    out = {c.id for c in possible(model, catalogue())} - {c.id for c in possible(free, catalogue())}
    assert out == {"tether_drag", "tether_tension"}
    with pytest.raises(UndertowError, match=r"excluded_effects of vehicle .* names 'tether_drag'"):
        free.with_effect(catalogue()["tether_drag"], {})


def test_without_a_pose_beside_it_no_velocity_is_blamed_for_its_scale() -> None:
    """Speed and rate alone: a factor of the speed is one of mass and drag, which nothing contradicts."""
    case = make_case("usv", (), 22, duration=20.0)
    model, runs = vehicle_of(case), runs_of(case)
    bare = [replace(r, channels={k: v for k, v in r.channels.items() if k not in "xy"}) for r in runs]
    missing = prepare(bare, model)
    assert (missing.derived_names, missing.names_without_pose) == ((), ("u", "v"))
    listed = {c.id: {p.name for p in c.parameters} for c in possible_in(missing, model, catalogue())}
    assert listed["sensor_scale"] == {"scale_rate"}
    assert listed["sensor_bias"] == {"b_u", "b_v", "b_r"}
    assert prepare(runs, model).names_without_pose == ()


def test_an_unknown_first_state_wins_nothing_on_kept_aside_data() -> None:
    case = make_case("usv", (), 23, duration=40.0)
    model, runs = vehicle_of(case), runs_of(case)
    bench = open_bench(model, *prepared(model, runs[:3], runs[3:]))
    memory = Candidate(catalogue()["radiation_memory"], model)
    # As slow as a log is long: its unknown first state could pass for a constant force.
    slow = bench.fit(memory.model(()), start={"T_memory": 40.0, "X_memu": -20.0, "N_memr": -5.0})
    won = bench.score(slow).r - bench.base_score.r
    assert np.linalg.norm(won) > 1.0
    first = 0
    for part, whitening in zip(slow.model.linearise(bench.test, slow.p), bench.test_whitening, strict=True):
        start = whitening(part.start)
        felt = start[:, np.linalg.norm(start, axis=0) > 0.0]
        assert felt.shape[1] == 2
        here, first = won[first : first + len(part.r)], first + len(part.r)
        size = np.linalg.norm(felt) * np.linalg.norm(here)
        np.testing.assert_allclose(felt.T @ here, 0.0, atol=1e-8 * size)

    # What is left of both models without it is what each leaves when the first states are projected out.
    before, after = comparable_mean_squares(bench.base_score, bench.score(slow), bench.test)
    alone = whitened(slow.model.linearise(bench.test, slow.p), bench.test_whitening).r
    np.testing.assert_allclose(after, mean_square(alone, bench.test), rtol=1e-9)
    assert np.nansum(before) < np.nansum(bench.base_score.mean_square)


def test_a_lag_far_below_the_time_between_samples_leaves_the_model_as_it_is() -> None:
    """Its states are integrated without growing, whatever the step; a start with an influence is better."""
    case = make_case("usv", ("thruster_lag",), 3, duration=60.0, runs=("steps", "multisine"))
    vehicle = vehicle_of(case)
    train, test = ([replace(r, t=10.0 * r.t)] for r in runs_of(case)[:2])
    bench = open_bench(vehicle, prepare(train, vehicle), prepare(test, vehicle))
    lag = Candidate(catalogue()["thruster_lag"], vehicle)
    (name,) = (p.name for p in lag.parameters)
    stiff, slow = ({**bench.base.values, name: value} for value in (0.01, 3.0))
    fit = bench.fit(lag.model_from(stiff), start=stiff, tolerance=0.1)
    assert fit.cost == pytest.approx(bench.base.cost, rel=2e-3)
    assert best_start(lag, bench, [stiff, slow], 0.1)[name] > 0.1


def test_terms_that_give_the_force_of_another_effect_are_tried_alone() -> None:
    """Near upright, a centre of buoyancy off its place is a steady moment, whatever else is steady."""
    case = make_case("heavy-rov", ("trim_offset",), 4, duration=30.0, runs=("steps", "multisine"))
    vehicle = vehicle_of(case)
    train, test = (prepare([r], vehicle) for r in runs_of(case)[:2])
    bench = open_bench(vehicle, train, test)
    effects = ("trim_offset", "constant_force", "added_mass_coupling")
    tried = (Candidate(catalogue()[i], vehicle) for i in effects)
    trials = (try_candidate(candidate, bench, bench.base.values) for candidate in tried)
    trim, steady, coupling = (FoundEffect(trial, *NO_EVIDENCE) for trial in trials)
    whole = replace(steady, trial=replace(steady.trial, fit=steady.trial.full))  # with all of its six terms
    alone = reduced_to_same_force(whole, trim, bench)
    assert alone is not None
    assert set(alone.parameters) <= {"K_0", "M_0"}
    before, by_trim, by_force = (s.error for s in (bench.base_score, trim.trial.score, alone.trial.score))
    assert before - by_force > 0.75 * (before - by_trim)
    assert reduced_to_same_force(coupling, trim, bench) is None


NO_EVIDENCE = (Comparison(0.0, (0.0, 0.0), 1.0), 0.0, 1.0, False)


def test_a_vehicle_without_commands_has_no_actuation_to_blame() -> None:
    usv = vehicle_of(make_case("usv", (), 24, duration=1.0))
    towed = replace(usv, thrusters=())
    ids = {c.id for c in candidates(towed, catalogue())}
    assert "lift" in ids
    actuation = {n for n, e in catalogue().items() if e.family == "actuation"}
    assert actuation & {c.id for c in candidates(usv, catalogue())}
    assert not actuation & ids


def test_a_repeated_manoeuvre_is_no_independent_judge() -> None:
    case = make_case("usv", (), 25, duration=20.0)
    model, runs = vehicle_of(case), runs_of(case)
    again = replace(runs[0], name="again", t=runs[0].t + 100.0)
    assert repeats(model, runs[:2], runs[2:]) == []
    assert repeats(model, runs[:2], [runs[3], again]) == [("again", runs[0].name)]
    noisy = {n: c + 1e-3 * (n in model.command_names) * np.ptp(c) for n, c in runs[1].channels.items()}
    assert repeats(model, runs[:2], [replace(runs[1], name="noisy", channels=noisy)]) == [
        ("noisy", runs[1].name)
    ]
    still = {n: np.ones_like(c) if n in model.command_names else c for n, c in runs[0].channels.items()}
    steady = replace(runs[0], channels=still)
    assert repeats(model, [steady], [replace(steady, name="other")]) == []


def test_an_effect_leaves_with_the_one_whose_parameters_it_shares() -> None:
    """A memory of the flow has the added mass of the vehicle: a model without that has no memory either."""
    case = make_case("box", ("radiation_memory",), 21, duration=40.0)
    model, runs = vehicle_of(case), runs_of(case)
    bare = replace(model, effects=tuple(e for e in model.effects if e.id not in _INERTIA))
    bench = open_bench(bare, *prepared(bare, runs[:3], runs[3:]))

    def found(name: str, on: Bench) -> FoundEffect:
        candidate = Candidate(catalogue()[name], on.base.model.functions.vehicle)
        starts = [look.values for look in screen(candidate, on)]
        trial = try_candidate(candidate, on, best_start(candidate, on, starts, 0.1))
        return FoundEffect(trial, Comparison(1.0, (0.5, 1.5), 0.0), 1.0, 0.0, True)

    mass = found("added_mass", bench)
    with_mass = fitted(bare, [mass], bench)
    memory = found("radiation_memory", replace(bench, base=with_mass.fit))
    both = fitted(bare, [mass, memory], bench)
    assert [f.id for f in both.findings] == ["added_mass", "radiation_memory"]
    assert both.score.error < with_mass.score.error
    assert fitted(bare, [memory], bench).findings == ()
    assert [f.id for f in without_redundant_effects(bare, both, bench).findings] == [
        "added_mass",
        "radiation_memory",
    ]


def test_a_coupling_that_only_an_asymmetric_hull_has_is_not_proposed() -> None:
    """D of a ship with port-starboard symmetry has Y_r and N_v and no other coupling (Fossen, chapter 6)."""
    model = vehicle_of(make_case("usv", (), 22, duration=1.0))
    effects = catalogue()
    coupling = Candidate(effects["linear_damping_coupling"], model)
    assert {p.name for p in coupling.parameters} == {"Y_r", "N_v"}
    inertia = Candidate(effects["added_mass_coupling"], model)
    assert {p.name for p in inertia.parameters} == {"Y_rdot"}
    rov = vehicle_of(make_case("rov", (), 22, duration=1.0))
    six = {p.name for p in Candidate(effects["linear_damping_coupling"], rov).parameters}
    assert len(six) == 12
    assert {"K_v", "Y_p", "K_r", "N_p", "X_w", "Z_u", "X_q", "M_u", "Z_q", "M_w"} <= six
    stated = model.with_effect(effects["linear_damping_coupling"], {"N_u": Value(-0.1, estimate=True)})
    assert "N_u" in stated.parameter_names, "a vehicle file may say otherwise"
