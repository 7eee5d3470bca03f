"""Velocities that are reported late: interpolation that leaves noise alone, and delays that are found."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from benchmarks.hidden_effects import Case, make_case
from tests.identification.logs_of import run_of, runs_of, true_vehicle, vehicle_of, with_effect
from tests.quick import first_quick
from undertow.codegen.functions import Functions
from undertow.identification.estimation.data import prepare, smooth_rate
from undertow.identification.estimation.output_error import fit_output_error
from undertow.identification.estimation.predictor import predict, reported_late
from undertow.identification.estimation.residual import WeakModel, interpolated, stencil, whitened
from undertow.identification.estimation.shooting import Shooting
from undertow.identification.estimation.test_functions import test_functions as functions_on
from undertow.identification.estimation.weak_form import fit_weak
from undertow.identification.estimation.windows import cut
from undertow.identification.logs.run import Run
from undertow.model.vehicle import Vehicle

STEP = 0.05
CLOCK = np.arange(0.0, 40.0, STEP)
UNEVEN = np.sort(CLOCK + np.random.default_rng(3).uniform(-0.25, 0.25, len(CLOCK)) * STEP)
LATE = 0.15


@cache
def usv(
    *effects: str, seed: int = 1, noise: float = 1.0, duration: float = 60.0, strength: float = 1.0
) -> Case:
    return make_case("usv", effects, seed, noise=noise, duration=duration, strength=strength)


def late_by(case: Case, seconds: float) -> Vehicle:
    return with_effect(vehicle_of(case), "sensor_delay", velocity_delay=seconds)


def delayed(run: Run, seconds: float) -> Run:
    """The run with u and v from a whole number of samples ago."""
    samples = round(seconds / STEP)
    late = {n: np.concatenate([np.full(samples, x[0]), x[:-samples]]) for n, x in run.channels.items()}
    return replace(run, channels=dict(run.channels) | {n: late[n] for n in ("u", "v")})


def training(case: Case) -> list[Run]:
    return [r for r in runs_of(case) if r.name != "holdout"]


# --- interpolation ----------------------------------------------------------------------------------------
@pytest.mark.parametrize("share", [0.1, 0.25, 0.5, 0.8])
def test_what_the_test_functions_see_is_not_dampened(share: float) -> None:
    when = CLOCK[len(CLOCK) // 2] + share * STEP
    index, weight = stencil(CLOCK, np.array([when]))

    def gain(frequency: float) -> float:
        """Of a wave with so many periods in a sampling interval."""
        wave = np.exp(2j * np.pi * frequency * (CLOCK[index[0]] - when) / STEP)
        return float(abs(weight[0] @ wave - 1.0))

    assert max(map(gain, np.linspace(0.0, 0.15, 31))) < 6e-4
    assert max(map(gain, np.linspace(0.0, 0.10, 21))) < 3e-5


def test_a_delay_takes_no_noise_out_of_the_weak_residual() -> None:
    """All that a whitened residual sees of white noise is there after a shift by half a sample, too."""
    functions = functions_on(CLOCK, 5 * STEP)
    assert functions is not None
    index, weight = stencil(CLOCK, CLOCK + 0.5 * STEP)
    shift = np.zeros((len(CLOCK), len(CLOCK)))
    np.add.at(shift, (np.arange(len(CLOCK))[:, None], index), weight)
    inner = slice(5, -5)  # the ends have fewer samples around them
    rate = functions.rate.toarray()[inner]
    shifted = rate @ shift
    kept = np.trace(np.linalg.solve(rate @ rate.T, shifted @ shifted.T)) / len(rate)
    assert kept == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize(("t", "error"), [(CLOCK, 1e-8), (UNEVEN, 1e-5)])
def test_between_samples_a_signal_is_what_it_is(t: np.ndarray, error: float) -> None:
    inner = t[10:-10] + 0.37 * STEP
    y = np.column_stack([np.sin(3.0 * t), np.cos(1.3 * t)])
    expected = np.column_stack([np.sin(3.0 * inner), np.cos(1.3 * inner)])
    np.testing.assert_allclose(interpolated(t, y, inner), expected, atol=error)


def test_samples_close_together_do_not_blow_up_noise() -> None:
    pairs = np.sort(np.concatenate([CLOCK[::2], CLOCK[::2] + 1e-4]))
    noise = np.random.default_rng(0).standard_normal((len(pairs), 1))
    assert (
        np.max(np.abs(interpolated(pairs, noise, pairs + 0.03))) <= 2.0**0.5 * np.max(np.abs(noise)) * 8**0.5
    )
    _, weight = stencil(pairs, pairs + 0.03)
    assert np.max(np.sum(weight**2, axis=1)) <= 2.0
    np.testing.assert_allclose(weight.sum(axis=1), 1.0, atol=1e-9)


def test_after_the_last_sample_its_value_holds() -> None:
    y = CLOCK[:, None] ** 2
    assert interpolated(CLOCK, y, np.array([CLOCK[-1] + 1.0]))[0, 0] == pytest.approx(CLOCK[-1] ** 2)


def test_rates_are_those_of_the_signal_and_not_of_its_noise() -> None:
    noise = 0.01 * np.random.default_rng(1).standard_normal(len(CLOCK))
    found = smooth_rate(CLOCK, (np.sin(CLOCK) + noise)[:, None])[:, 0]
    assert np.std(found - np.cos(CLOCK)) < 0.02  # differences of neighbours would be off by 0.14
    quiet = smooth_rate(UNEVEN, np.sin(UNEVEN)[:, None])[:, 0]
    np.testing.assert_allclose(quiet[5:-5], np.cos(UNEVEN)[5:-5], atol=2e-2)


# --- the weak form ----------------------------------------------------------------------------------------
def _raw(vehicle: Vehicle, runs: list[Run]) -> np.ndarray:
    data = prepare(runs, vehicle)
    parts = WeakModel(Functions(vehicle), ()).linearise(data, np.array(Functions(vehicle).values()))
    return np.concatenate([p.r[: p.known] for p in parts])


def test_the_true_delay_leaves_what_reading_between_samples_leaves() -> None:
    case = usv("sensor_delay", noise=0.0, duration=30.0)
    true, delay = true_vehicle(case), case.truth["values"]["sensor_delay"]["delay"]
    assert delay / STEP % 1 > 0.1  # between samples
    runs = runs_of(case)
    late = _raw(with_effect(true, "sensor_delay", velocity_delay=delay), runs)
    floor = _raw(true, runs_of(usv(noise=0.0, duration=30.0)))
    wrong = _raw(true, runs)
    # Between samples a signal is read off a smooth curve, which a kink is not.
    assert np.std(late) < 0.01 * np.std(wrong)
    assert np.std(floor) < 1e-4 * np.std(wrong)


def test_rows_that_reach_beyond_the_last_true_value_count_for_nothing() -> None:
    case = usv(duration=20.0)
    model = late_by(case, 0.6)
    data = prepare(runs_of(case)[:1], model)
    weak = WeakModel(Functions(model), ("X_u", "velocity_delay"))
    p = np.array(weak.functions.values())
    (part,) = weak.linearise(data, p)
    (segment,) = data.segments
    lost = segment.functions.centre + 2 * 0.25 > segment.t[-1] - 0.6 + 1e-9
    assert part.known == np.count_nonzero(~lost) * len(data.rows) < len(part.r)
    assert not np.any(part.r[part.known :])
    assert not np.any(part.J[part.known :])
    assert np.all(np.any(part.J[: part.known] != 0, axis=0))
    white = whitened([part], weak.whitening(data, p))
    assert not np.any(white.r[part.known :])
    assert np.all(white.r[: part.known])


@pytest.mark.slow
def test_a_long_delay_gains_nothing_by_the_rows_that_it_loses() -> None:
    """On pieces of 3 s a delay of 0.7 s loses a third of the test functions; noise stays what it is."""
    rng = np.random.default_rng(5)
    case = usv(duration=60.0)
    run = runs_of(case)[0]
    noise = {n: 0.01 * rng.standard_normal(len(run.t)) for n in ("x", "y", "psi", "u", "v", "r")}
    gaps = {n: np.where(run.t % 3.0 < 0.04, np.nan, 0.0 * run.t) for n in ("f1", "f2", "f3")}
    still = replace(run, channels=dict(run.channels) | noise | gaps)
    weak = WeakModel(Functions(late_by(case, 0.0)), ())
    data = prepare([still], weak.functions.vehicle)
    p = np.array(weak.functions.values())
    place = weak.functions.parameter_names.index("velocity_delay")
    white = weak.whitening(data, p)
    squares = []
    for seconds in (0.0, 0.7):
        p[place] = seconds
        squares.append(np.sum(whitened(weak.linearise(data, p), white).r ** 2))
    assert squares[1] / squares[0] == pytest.approx(1.0, abs=0.08)


@pytest.mark.parametrize("extra", [{}, {"radiation_memory": {"X_memu": -1.0, "T_memory": 2.0}}])
@pytest.mark.parametrize("seconds", [0.07, 0.325])
def test_derivative_in_the_delay_is_that_of_finite_differences(extra: dict, seconds: float) -> None:
    case = usv(noise=0.0, duration=20.0)
    model = late_by(case, seconds)
    for effect, values in extra.items():
        model = with_effect(model, effect, **values)
    data = prepare(runs_of(case)[:1], model)
    weak = WeakModel(Functions(model), ("velocity_delay",))
    p = np.array(weak.functions.values())
    ends = []
    for way in (1, -1):
        moved = p.copy()
        moved[weak.places[0]] += way * 2e-3
        ends.append(weak.linearise(data, moved)[0].r)
    difference = (ends[0] - ends[1]) / 4e-3
    found = weak.linearise(data, p)[0].J[:, 0]
    assert np.std(found - difference) < 0.02 * np.std(difference)


# --- finding it -------------------------------------------------------------------------------------------
@pytest.mark.parametrize("uneven", [False, True])
def test_a_delay_is_found_by_the_weak_form(uneven: bool) -> None:
    case = usv(seed=4, duration=40.0)
    runs = [delayed(r, LATE) for r in training(case)]
    if uneven:
        rng = np.random.default_rng(6)
        kept = np.sort(rng.permutation(len(runs[0].t))[: int(0.85 * len(runs[0].t))])
        runs = [run_of(r.name, {"t": r.t[kept]} | {n: x[kept] for n, x in r.channels.items()}) for r in runs]
    model = late_by(case, 0.05)
    fit = fit_weak(model, prepare(runs, model))
    assert fit.values["velocity_delay"] == pytest.approx(LATE, abs=3 * fit.standard_errors["velocity_delay"])
    assert fit.standard_errors["velocity_delay"] < 0.02


def test_a_delay_is_found_by_output_error() -> None:
    case = usv("sensor_delay", seed=3, duration=40.0)
    true = case.truth["values"]["sensor_delay"]["delay"]
    fit = fit_output_error(late_by(case, 0.05), training(case), start={})
    assert fit.values["velocity_delay"] == pytest.approx(true, abs=3 * fit.standard_errors["velocity_delay"])
    assert fit.standard_errors["velocity_delay"] < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("seed", first_quick([1, 8]))
def test_a_complete_model_gains_nothing_by_a_delay(seed: int) -> None:
    """Smoothing looks like an improvement to equation errors; here there is none to be had."""
    case = usv(seed=seed, duration=40.0)
    (kept,) = [r for r in runs_of(case) if r.name == "holdout"]
    model = vehicle_of(case)
    data, test = prepare(training(case), model), prepare([kept], model)
    complete = fit_weak(model, data)
    late = fit_weak(late_by(case, 0.05), data)
    noise = complete.model.whitening(test, complete.p)
    errors = [np.sum(whitened(f.model.linearise(test, f.p), noise).r ** 2) for f in (complete, late)]
    assert np.sqrt(errors[1] / errors[0]) > 0.99
    assert late.values["velocity_delay"] < 3 * late.standard_errors["velocity_delay"]
    assert late.standard_errors["velocity_delay"] < 0.01


# --- predictions ------------------------------------------------------------------------------------------
def test_late_reports_of_a_known_signal() -> None:
    t = np.tile(np.arange(0.0, 5.0, 0.05), (2, 1))
    values = np.stack([np.sin(t), np.cos(t)], axis=2)
    before = np.stack([np.sin(t[:, 0] - 0.12), np.cos(t[:, 0])], axis=1)
    late = reported_late(values, t, np.array([0.12, 0.0]), before)
    np.testing.assert_allclose(late[:, :, 0], np.sin(t - 0.12), atol=2e-3)
    np.testing.assert_array_equal(late[:, :, 1], values[:, :, 1])


def test_windows_are_predicted_with_late_sensors() -> None:
    """Without noise the true model with the true delay predicts 5 s to within a few per cent."""
    case = usv("sensor_delay", noise=0.0, seed=2, duration=30.0)
    true, delay = true_vehicle(case), case.truth["values"]["sensor_delay"]["delay"]
    runs = runs_of(case)
    late = predict(with_effect(true, "sensor_delay", velocity_delay=delay), runs)
    prompt = predict(true, runs)
    assert delay > 0.3
    assert max(late.relative.values()) < 0.04
    assert late.relative["u"] < 0.2 * prompt.relative["u"]


def test_sensitivity_to_the_delay_is_that_of_the_shifted_report() -> None:
    case = usv(noise=0.0, seed=2, duration=20.0)
    model = late_by(case, 0.2)
    windows = cut(runs_of(case), model, 5.0)
    shooting = Shooting(Functions(model), windows, ["velocity_delay"], np.ones(len(windows.names)))
    p = np.array(shooting.functions.values())
    starts = shooting.measured_starts(p)
    place = shooting.places[0]
    at = shooting.linearise(p, starts)
    costs = []
    for way in (1, -1):
        moved = p.copy()
        moved[place] += way * 1e-3
        costs.append(shooting.linearise(moved, starts + way * 1e-3 * at.start_slope[:, :, 0]).cost)
    assert (costs[0] - costs[1]) / 2e-3 == pytest.approx(2 * (at.J.T @ at.r)[0], rel=0.02)
