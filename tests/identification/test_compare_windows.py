"""Windows and predictions: starts from the measurement, gaps, dead time, states that nobody measures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import undertow as ut
from benchmarks.hidden_effects import make_case
from tests.identification.logs_of import runs_of, simulated_runs, true_vehicle, vehicle_of, with_effect
from tests.identification.surge import M_X, TRUTH, surge_run, surge_vehicle, true_surge
from undertow.codegen.functions import Functions
from undertow.codegen.simulate import LONGEST_STEP
from undertow.errors import UndertowError
from undertow.identification.diagnosis.validation import relative_squares
from undertow.identification.estimation.predictor import Predictor, StartProblem, predict
from undertow.identification.estimation.shooting import Shooting
from undertow.identification.estimation.windows import SETTINGS as STEPS
from undertow.identification.estimation.windows import (
    Prediction,
    cut,
    delayed_commands,
    horizons,
    local_value,
    position_error,
    prediction_error,
    start_values,
    time_constants,
)
from undertow.identification.logs.run import Run
from undertow.model.vehicle import Thruster, Vehicle

CLOCK = np.arange(0.0, 20.0, 0.05)
SIGMA = 0.01


def _noise(seed: int = 0) -> np.ndarray:
    return SIGMA * np.random.default_rng(seed).standard_normal(len(CLOCK))


# --- the start of a window --------------------------------------------------------------------------------


def test_a_smooth_signal_is_known_better_than_a_sample() -> None:
    signal = np.sin(CLOCK)
    at = np.arange(5, 395)
    error = local_value(CLOCK, signal + _noise(), at, SIGMA) - signal[at]
    assert np.sqrt(np.mean(error**2)) < 0.55 * SIGMA


def test_a_kink_and_a_jump_are_not_smoothed_away() -> None:
    kink = np.maximum(CLOCK - 10.0, 0.0) * 3.0
    jump = np.where(CLOCK >= 10.0, 1.0, 0.0)
    at = np.arange(190, 211)
    for signal in (kink, jump):
        errors = [local_value(CLOCK, signal + _noise(s), at, SIGMA) - signal[at] for s in range(30)]
        assert np.max(np.sqrt(np.mean(np.square(errors), axis=0))) < 1.6 * SIGMA


def test_a_lone_outlier_is_no_start() -> None:
    signal = np.sin(CLOCK) + _noise()
    signal[100] += 3.0
    value = local_value(CLOCK, signal, np.array([99, 100, 101]), SIGMA)
    np.testing.assert_allclose(value, np.sin(CLOCK[99:102]), atol=5 * SIGMA)
    nowhere = np.zeros(0, dtype=np.intp)  # a stretch that holds no window
    assert local_value(CLOCK, signal, nowhere, SIGMA).shape == (0,)


def test_without_noise_the_sample_itself_is_taken() -> None:
    signal = np.exp(np.sin(3 * CLOCK))
    np.testing.assert_allclose(local_value(CLOCK, signal, np.arange(400), 0.0), signal, rtol=1e-12)


def test_a_signal_too_short_to_smooth_is_taken_as_it_is() -> None:
    short = np.array([1.0, 2.0, 4.0])
    np.testing.assert_array_equal(local_value(CLOCK[:3], short, np.array([0, 2]), SIGMA), [1.0, 4.0])


def test_angles_are_smoothed_over_longer_by_their_rates() -> None:
    phi, theta = 0.3 * np.sin(2 * CLOCK), 0.2 * np.cos(1.5 * CLOCK)
    psi = np.sin(CLOCK) + 0.4 * CLOCK
    phi_dot, theta_dot, psi_dot = (np.gradient(a, CLOCK, edge_order=2) for a in (phi, theta, psi))
    # Euler rates to body rates (Fossen 2021, section 2.2).
    p = phi_dot - np.sin(theta) * psi_dot
    q = np.cos(phi) * theta_dot + np.cos(theta) * np.sin(phi) * psi_dot
    r = -np.sin(phi) * theta_dot + np.cos(theta) * np.cos(phi) * psi_dot
    clean = np.column_stack([phi, theta, psi, p, q, r])
    noise = SIGMA * np.random.default_rng(1).standard_normal(clean.shape)
    noise[:, 3:] *= 0.1
    names, at = ("phi", "theta", "psi", "p", "q", "r"), np.arange(0, 400, 7)
    value = start_values(CLOCK, clean + noise, names, np.array([SIGMA] * 3 + [0.1 * SIGMA] * 3), at)
    rms = np.sqrt(np.mean((value - clean[at])[:, :3] ** 2, axis=0))
    assert np.all(rms < np.array([0.45, 0.25, 0.25]) * SIGMA)


def test_what_is_not_measured_starts_at_zero() -> None:
    measured = np.column_stack([np.full(len(CLOCK), np.nan), np.cos(CLOCK)])
    value = start_values(CLOCK, measured, ("x", "u"), np.array([0.0, 0.0]), np.array([0, 40]))
    np.testing.assert_allclose(value, [[0.0, 1.0], [0.0, np.cos(2.0)]])


def test_a_channel_without_a_report_in_a_stretch_starts_on_its_curve() -> None:
    """Its reports lie before and after, and the stretch between two gaps of another sensor is short."""
    t = CLOCK[:6]
    measured = np.column_stack([np.cos(t), np.sin(t)])
    one, none = np.full(6, np.nan), np.full(6, np.nan)
    one[2] = np.sin(t[2])
    at, names, noise = np.array([0, 3]), ("v", "u"), np.array([SIGMA, SIGMA])
    start = start_values(t, measured, names, noise, at, np.column_stack([np.cos(t), none]))
    np.testing.assert_allclose(start, np.column_stack([np.cos(t[at]), np.sin(t[at])]), atol=2 * SIGMA)
    start = start_values(t, measured, names, noise, at, np.column_stack([np.cos(t), one]))
    np.testing.assert_allclose(start[:, 1], np.sin(t[2]))


# --- windows ----------------------------------------------------------------------------------------------


def test_windows_follow_each_other_and_a_last_one_may_lack_a_sample() -> None:
    windows = cut([surge_run()], surge_vehicle(), 5.0)
    np.testing.assert_array_equal(windows.first, np.arange(0, 150, 25))
    np.testing.assert_array_equal(windows.count, 26)
    shorter = cut([surge_run().slice(None, 29.8)], surge_vehicle(), 5.0)
    assert shorter.count.tolist() == [26] * 5 + [25]
    assert np.isnan(shorter.measured[-1, -1]).all()
    assert len(cut([surge_run().slice(None, 27.0)], surge_vehicle(), 5.0)) == 5


def test_a_gap_is_not_crossed() -> None:
    run = surge_run()
    u = run.channels["u"].copy()
    u[60:70] = np.nan
    windows = cut([replace(run, channels={**run.channels, "u": u})], surge_vehicle(), 5.0)
    inside = windows.samples[windows.inside]
    assert not set(range(60, 70)) & set(inside.tolist())
    assert set(windows.segment.tolist()) == {0, 70}
    assert np.isfinite(predict(true_surge(), windows).predicted).any()


def test_a_log_shorter_than_the_horizon_is_refused_with_its_length() -> None:
    with pytest.raises(UndertowError, match=r"predict over 40 s.*lasts 30 s.*shorter horizon"):
        cut([surge_run()], surge_vehicle(), 40.0)
    with pytest.raises(UndertowError, match="horizon = -1 s"):
        cut([surge_run()], surge_vehicle(), -1.0)


# --- predictions ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("horizon", [1.0, 5.0, 20.0, None])
def test_the_true_model_predicts_a_log_without_noise(horizon: float | None) -> None:
    prediction = predict(true_surge(), [surge_run()], horizon)
    assert prediction.rms["u"] < 1e-7
    assert prediction_error(prediction) < 1e-6
    assert prediction.fit["u"] == pytest.approx(100.0, abs=1e-3)


def test_five_per_cent_off_is_reported_as_five_per_cent() -> None:
    prediction = predict(true_surge(), [surge_run()], None)
    off = np.nan_to_num(prediction.windows.measured * 1.05)
    reported = replace(prediction, predicted=off)
    assert prediction_error(reported) == pytest.approx(0.05, rel=1e-9)


def test_noise_alone_gives_an_error_of_the_noise() -> None:
    case = make_case("usv", (), 5, duration=60.0, runs=("steps", "multisine"))
    prediction = predict(true_vehicle(case), runs_of(case), 1.0)
    assert prediction.normalised["u"] == pytest.approx(1.0, abs=0.15)
    assert prediction.normalised["psi"] == pytest.approx(1.0, abs=0.3)
    assert predict(vehicle_of(case), runs_of(case), 5.0).relative["r"] > prediction.relative["r"]


def test_a_simulation_that_diverges_is_counted_and_infinite() -> None:
    vehicle = true_surge()
    wild = vehicle.with_values({"X_uabsu": replace(vehicle.value_of("X_uabsu"), value=5e4)})
    prediction = predict(wild, [surge_run(0.02)], None)
    assert prediction.diverged == 1
    assert prediction_error(prediction) == np.inf


@pytest.mark.parametrize("delay", [0.0125, 0.05, 0.18])
def test_a_dead_time_that_is_no_multiple_of_a_sample_is_simulated_exactly(delay: float) -> None:
    """Against the same model without it, its command switched on a clock of half a millisecond."""
    rng = np.random.default_rng(1)
    t, fine = np.arange(200) * 0.05, np.arange(199 * 100 + 1) * 0.0005
    u = np.repeat(rng.uniform(-3, 3, 100), 2)[:, None]
    vehicle = _with_thruster()
    plain, late = Predictor(vehicle), Predictor(with_effect(vehicle, "actuation_delay", delay=delay))
    arrived = u[np.maximum(np.floor((fine - delay) / 0.05 + 1e-9).astype(int), 0)]
    x = plain.simulator.run(np.zeros(2), fine, arrived, plain.values)[::100]
    run = Run("run", t, {"x": x[:, 0], "u": x[:, 1], "f1": u[:, 0]})
    windows = cut([run], vehicle, 2.0)
    starts = x[windows.first]
    assert np.nanmax(np.abs(late.reports(windows, late.values, starts) - windows.measured)) < 1e-6
    shooting = Shooting(late.functions, windows, ("X_u",), np.ones(2))
    found = shooting.linearise(late.values, starts)
    assert found.cost < 1e-9
    fed = replace(windows, measured=windows.measured + rng.normal(0, 0.1, windows.measured.shape))
    by_states, by_reports = (Shooting(late.functions, fed, ("X_u",), np.ones(2)) for _ in range(2))
    vars(by_reports)["_reports_states"] = False
    one, other = (s.linearise(late.values, starts) for s in (by_states, by_reports))
    assert one.cost == pytest.approx(other.cost, rel=1e-9)
    np.testing.assert_allclose(one.start_step, other.start_step, rtol=1e-9)
    np.testing.assert_allclose(one.start_slope, other.start_slope, rtol=1e-9)


def test_late_commands_arrive_between_samples_that_are_not_regular() -> None:
    t = np.array([0.0, 0.1, 0.15, 0.4, 0.5, 0.62])
    u = np.arange(6.0)[:, None]
    run = Run("run", t, {"x": t, "u": t, "f1": u[:, 0]})
    windows = cut([run], _with_thruster(), None)
    drive = delayed_commands(windows, 0.1)
    np.testing.assert_allclose(drive.t[0], [0, 0.1, 0.15, 0.2, 0.25, 0.4, 0.5, 0.6, 0.62])
    np.testing.assert_allclose(drive.held[0, :, 0], [0, 0, 0, 1, 2, 2, 3, 4, 4])
    np.testing.assert_allclose(drive.at_samples(drive.t)[0], t)
    np.testing.assert_allclose(drive.u[0, :, 0], [0, 0, 0, 2, 3, 4])
    ones = drive.zero_filled(np.ones((1, 6, 2)))
    assert ones.sum() == 12
    assert np.all(drive.at_samples(ones) == 1.0)


def test_no_window_covers_what_is_skipped() -> None:
    windows = cut([surge_run()], surge_vehicle(), 5.0, skip=1.0)
    whole = cut([surge_run()], surge_vehicle(), 5.0)
    assert windows.t[:, 0].min() == pytest.approx(whole.t[0, 0] + 1.0)
    assert np.all(windows.segment == whole.segment[0])
    assert len(cut([surge_run().slice(None, 5.0)], surge_vehicle(), 3.0, skip=1.0)) == 1
    with pytest.raises(UndertowError, match="no gap-free segment"):
        cut([surge_run()], surge_vehicle(), 5.0, skip=1e3)


def _with_thruster() -> Vehicle:
    ahead = Thruster("f1", (1.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    return replace(true_surge(), force_channels=(), thrusters=(ahead,))


# --- states that nobody measures --------------------------------------------------------------------------


def test_a_lag_is_followed_from_an_estimated_beginning() -> None:
    case = make_case("usv", ("thruster_lag",), 2, noise=0.0, duration=40.0, runs=("steps",))
    true = case.truth["values"]["thruster_lag"]["T"]
    lagged = with_effect(true_vehicle(case), "thruster_lag", T_lag=true)
    prediction = predict(lagged, runs_of(case), 5.0)
    # The thrusters stood still when the log began, which it does not say.
    assert prediction_error(prediction) < 5e-3
    start, _ = Predictor(lagged).start_and_commands(prediction.windows, np.array(Predictor(lagged).values))
    assert np.max(np.abs(start[0, 6:])) < 0.02 * np.max(np.abs(start[:, 6:]))


def test_what_windows_inherit_is_that_of_these_parameters_whatever_was_asked_before() -> None:
    """Kept from call to call, also past what is kept, and for windows that are not the same."""
    case = make_case("usv", ("thruster_lag",), 2, duration=20.0, runs=("steps",))
    lagged = with_effect(true_vehicle(case), "thruster_lag", T_lag=0.5)
    runs, old = runs_of(case), Predictor(lagged)
    place = old.functions.parameter_names.index("T_lag")
    asked = [(cut(runs, lagged, h), lag) for h in (5.0, 2.0) for lag in (0.5, 0.6, *np.linspace(1, 2, 30))]
    for windows, lag in [*asked, *asked[:2], *asked[32:34]]:
        p = old.values
        p[place] = lag
        fresh = Predictor(lagged).start_and_commands(windows, p) if lag < 1.0 else None
        found = old.start_and_commands(windows, p)
        again = old.start_and_commands(windows, p, np.ones((len(windows), 6)))
        assert np.all(again[0][:, :6] == 1.0)
        assert np.array_equal(again[0][:, 6:], found[0][:, 6:])
        assert fresh is None or np.array_equal(found[0], fresh[0])


@pytest.mark.slow
def test_the_slope_of_what_windows_inherit_is_found_from_close_by() -> None:
    """Searched from the states of parameters close by, it is that between two searches from rest.

    A Gauss-Newton step leaves out curvature times residual: the model is the true one, the noise small.
    """
    case = make_case("usv", ("thruster_lag",), 2, duration=20.0, runs=("steps",), noise=0.01)
    lag = case.truth["values"]["thruster_lag"]["T"]
    lagged = with_effect(true_vehicle(case), "thruster_lag", T_lag=lag)
    windows, p = cut(runs_of(case), lagged, 5.0), Predictor(lagged).values
    step = 1e-2 * p * (np.array(Predictor(lagged).functions.parameter_names) == "T_lag")

    def slope(near: np.ndarray | None) -> np.ndarray:
        ends = [Predictor(lagged).start_and_commands(windows, p + s, None, near)[0] for s in (step, -step)]
        return (ends[0] - ends[1])[:, 6:] / (2.0 * np.max(step))

    assert np.max(np.abs(slope(None))) > 0.1
    np.testing.assert_allclose(slope(p), slope(None), atol=0.02 * np.max(np.abs(slope(None))))


@pytest.mark.parametrize(
    ("effect", "values", "number"),
    [
        ("thruster_lag", {"T_lag": 0.6}, 1),
        ("slosh", {"m_slosh": 3.0, "slosh_frequency": 2.0, "slosh_damping": 0.1}, 2),
        ("radiation_memory", {"X_memu": -5.0, "N_memr": -2.0, "T_memory": 1.5}, 1),
    ],
)
def test_derivatives_include_what_parameters_do_before_a_window(
    effect: str, values: dict[str, float], number: int
) -> None:
    """The states of its own that a model has at the starts depend on its parameters: simulations from the
    states that parameters close by lead to say by how much.
    """
    case = make_case("usv", (), 2, duration=20.0, runs=("steps",))
    vehicle = with_effect(true_vehicle(case), effect, **values)
    windows, free = cut(runs_of(case), vehicle, 5.0), [*values, "X_u", "N_r"]
    by_sums, by_reports = (Shooting(Functions(vehicle), windows, free, 1.0 / windows.sigma) for _ in range(2))
    vars(by_reports)["_reports_states"] = False
    predictor, p = by_sums.predictor, by_sums.predictor.values
    starts = by_sums.measured_starts(p)
    start, commands = predictor.start_and_commands(windows, p, starts)
    inherited = by_sums.inherited_slopes(p, starts)
    found = by_sums.sensitivities(start, commands, p, inherited)[1][..., :6, : len(free)]
    acting = np.flatnonzero(np.any(inherited, axis=(0, 1)))
    assert len(acting) == number
    for k, place in ((k, by_sums.places[k]) for k in acting):
        step = 1e-4 * np.abs(p[place]) * (np.arange(p.size) == place)
        high, low = (predictor.reports(windows, p + s, starts, near=p) for s in (step, -step))
        slope = (high - low) / (2.0 * step[place])
        inside = np.isfinite(slope)
        np.testing.assert_allclose(
            found[..., k][inside], slope[inside], atol=2e-3 * np.max(np.abs(slope[inside])), err_msg=free[k]
        )
    one, other = (s.linearise(p, starts) for s in (by_sums, by_reports))
    assert one.cost == pytest.approx(other.cost, rel=1e-9)
    np.testing.assert_allclose(one.start_slope, other.start_slope, rtol=1e-6, atol=1e-9)


def test_the_best_start_of_a_line_is_its_least_squares_fit() -> None:
    t = np.linspace(0.0, 1.0, 30)
    measured = (2.0 + 3.0 * t)[None, :, None] / SIGMA

    def report(starts: np.ndarray) -> np.ndarray:
        return (starts[:, :1] + starts[:, 1:] * t)[:, :, None] / SIGMA

    found, _ = StartProblem(report, measured, np.zeros((1, 2)), np.array([10.0, 10.0])).solved()
    np.testing.assert_allclose(found, [[2.0, 3.0]], atol=1e-5)


def test_a_start_that_cannot_be_simulated_stays_where_it_is() -> None:
    nowhere = StartProblem(
        lambda s: np.full((len(s), 4, 1), np.nan), np.ones((1, 4, 1)), np.ones((1, 2)), np.ones(2)
    )
    found, _ = nowhere.solved()
    np.testing.assert_array_equal(found, 1.0)


# --- how long windows have to be --------------------------------------------------------------------------


def _damped(**damping: float) -> Vehicle:
    vehicle = surge_vehicle()
    return vehicle.with_values({n: replace(vehicle.value_of(n), value=v) for n, v in damping.items()})


def _steady_run(seconds: float, speed: float = 0.2, interval: float = 0.1) -> Run:
    t = np.arange(0.0, seconds, interval)
    return Run("steady", t, {"u": np.full(len(t), speed), "tau_X": np.zeros(len(t))})


def test_time_constant_is_inertia_over_the_damping_at_the_speeds_seen() -> None:
    run = surge_run()
    speed = float(np.mean(np.abs(run.channels["u"])))
    expected = M_X / (TRUTH["X_u"] + 2.0 * TRUTH["X_uabsu"] * speed)
    stated = true_surge().value_of("X_udot").value
    assert time_constants(true_surge(), [run]) == pytest.approx([expected], rel=0.02)
    assert stated == pytest.approx(-TRUTH["X_udot"])


def test_horizons_are_a_quarter_one_and_four_times_the_slowest_time_constant() -> None:
    vehicle = _damped(X_udot=-0.5, X_u=-0.4, X_uabsu=0.0)
    (slowest,) = time_constants(vehicle, [_steady_run(1000.0)])
    assert slowest == pytest.approx((M_X - TRUTH["X_udot"] + 0.5) / 0.4)
    assert horizons(vehicle, [_steady_run(1000.0)]) == pytest.approx((slowest / 4, slowest, 4 * slowest))


def test_horizons_are_bounded_by_the_record() -> None:
    vehicle = _damped(X_udot=-0.5, X_u=-0.4, X_uabsu=0.0)
    short, middle, long = horizons(vehicle, [_steady_run(30.0)] * 3)
    assert long == pytest.approx(89.7 / 4, rel=0.01)
    assert short <= middle / 2 <= long / 4


def test_windows_of_a_log_whose_position_drops_out_are_as_short_as_the_stretches_between() -> None:
    vehicle, run = _damped(X_udot=-0.5, X_u=-0.4, X_uabsu=0.0), _steady_run(200.0)
    x = 0.2 * run.t
    x[::250] = np.nan  # every 25 s
    gappy = replace(run, channels={**run.channels, "x": x})
    *_, long = horizons(vehicle, [gappy])
    assert long <= 25.0
    assert len(cut([gappy], vehicle, long)) >= 4


@pytest.mark.parametrize("damping", [0.0, 0.3])
def test_without_a_time_constant_horizons_are_shares_of_the_record(damping: float) -> None:
    vehicle = _damped(X_u=damping, X_uabsu=0.0)
    runs = [_steady_run(100.0)] * 4
    assert len(time_constants(vehicle, runs)) == 0
    assert horizons(vehicle, runs) == pytest.approx((2.0, 9.0, 36.0), rel=0.12)


def test_shortest_windows_have_samples_enough() -> None:
    vehicle = _damped(X_u=-50.0, X_uabsu=0.0)
    short, middle, long = horizons(vehicle, [_steady_run(100.0, interval=0.5)] * 4)
    assert short >= 20 * 0.5
    assert middle >= 2 * short
    assert long >= 2 * middle


def test_squares_of_the_pose_are_those_of_the_way_since_the_window_began() -> None:
    """A kilometre from the origin half a metre is as much as close to it."""
    x, u = 1000.0 + CLOCK + np.sin(CLOCK), 1.0 + np.cos(CLOCK)
    windows = cut([Run("far", CLOCK, {"x": x, "u": u, "tau_X": u})], surge_vehicle(), 5.0)
    predicted = windows.measured * [1.0, 1.1] + [0.5, 0.0]
    squares = relative_squares(Prediction(windows, predicted))  # velocity first
    way = (windows.measured[:, :, 0] - windows.start[:, None, 0])[:, 1:]
    np.testing.assert_allclose(squares[:, 1], 0.25 / np.nanmean(way**2), rtol=1e-9)
    assert np.mean(squares[:, 0]) == pytest.approx(0.01, rel=0.05)
    assert position_error(Prediction(windows, predicted)) == pytest.approx(0.5)


# --- steps of the simulation ------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["box-hull", "cybership2", "mini-auv", "bluerov2"])
def test_steps_resolve_the_fastest_motion(name: str) -> None:
    vehicle = ut.load_vehicle(name)
    runs = _with_few_samples(vehicle)
    resolving = STEPS.reach * time_constants(vehicle, runs)[0]
    windows, predictor = cut(runs, vehicle, 10.0), Predictor(vehicle, compiled=False)
    start, commands = predictor.start_and_commands(windows, predictor.values)
    assert LONGEST_STEP <= commands.longest_step <= max(2.0 * resolving, LONGEST_STEP)
    exact, usual, resolved = (
        predictor.simulated(start, windows.t, replace(commands, longest_step=step), predictor.values)
        for step in (LONGEST_STEP / 10, LONGEST_STEP, commands.longest_step)
    )
    # Where drag has a kink, steps of no length are exact.
    errors = [np.max(np.abs(y - exact) / np.ptp(exact, axis=(0, 1))) for y in (usual, resolved)]
    assert errors[1] < max(1e-5, 1.01 * errors[0])


def _with_few_samples(vehicle: Vehicle) -> list[Run]:
    """A run with a sample every half a second."""
    size = 0.1 * vehicle.value_of("m").value
    (run,) = simulated_runs(vehicle, 1, 60.0, seed=5, size=size, hold=20, noise=0.0)
    kept = slice(None, None, 5)
    return [replace(run, t=run.t[kept], channels={n: y[kept] for n, y in run.channels.items()})]
