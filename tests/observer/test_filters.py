"""Filters against exact ones, and their certainty against errors that are known."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import block_diag, expm, solve_discrete_are
from scipy.stats import chi2

from benchmarks.observer_log import CURRENT, DRIVE, auv, log
from undertow.errors import UndertowError
from undertow.identification.observe import first_guess, reports_of
from undertow.model.loading import load_vehicle
from undertow.observer.consistency import SETTINGS, ljung_box, nis, whiteness
from undertow.observer.filters import Estimate, Method, Observer, Reports, added_noise, most_likely, smoothed
from undertow.observer.process import UNKNOWN, Prior, Process, process_of

A = np.array([[0.0, 1.0], [-0.09, -0.3]])
B = np.array([[0.0], [0.5]])
C = np.array([[1.0, 0.0], [0.2, 1.0]])
DT, DENSITY, VARIANCE = 0.01, 0.04, np.array([0.01, 0.09])


def linear() -> Process:
    x, u, p, t = ca.SX.sym("x", 2), ca.SX.sym("u"), ca.SX.sym("p"), ca.SX.sym("t")
    names = (("x", "u"), ("x", "u"), (1,))
    equations = (A @ x + B @ u, C @ x, np.zeros(1), np.zeros(2), 0.0)
    return Process(load_vehicle("mini-auv"), "model", *names, x, u, p, t, *equations)


def nees(found: Estimate, truth: np.ndarray, rows: slice) -> np.ndarray:
    """Normalised estimation error squared of some rows, for each state; rows far apart are independent."""
    error = (found.mean - truth)[rows]
    solved = np.linalg.solve(found.covariance[rows], error[..., None])[..., 0]
    return (error * solved).sum(axis=1) / error.shape[1]


def nees_bounds(states: int, count: int) -> tuple[float, float]:
    """Bounds of the mean of so many independent NEES values, for each state."""
    k, tail = states * count, (1 - SETTINGS.level) / 2
    return float(chi2.ppf(tail, k)) / k, float(chi2.ppf(1 - tail, k)) / k


def discrete() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """F, G and Q of a step, Q by Van Loan."""
    noise = np.diag([0.0, DENSITY])
    whole = expm(DT * np.block([[-A, noise], [np.zeros((2, 2)), A.T]]))
    f = whole[2:, 2:].T
    held = expm(DT * np.block([[A, B], [np.zeros((1, 3))]]))
    return f, held[:2, 2:], f @ whole[:2, 2:]


def reports(n: int = 400) -> Reports:
    rng, t = np.random.default_rng(3), DT * np.arange(n)
    y = rng.standard_normal((n, 2)) * np.sqrt(VARIANCE) + np.sin(t)[:, None]
    y[np.arange(n) % 3 > 0, 1] = np.nan
    return Reports(t, np.cos(2 * t)[:, None], y, VARIANCE)


def by_hand(r: Reports, x: np.ndarray, P: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    f, g, q = discrete()
    means, covariances = [], []
    for k in range(len(r.t)):
        if k:
            x, P = f @ x + g @ r.u[k - 1], f @ P @ f.T + q
        there = np.isfinite(r.y[k])
        h, s = C[there], C[there] @ P @ C[there].T + np.diag(VARIANCE[there])
        gain = P @ h.T @ np.linalg.inv(s)
        x, P = x + gain @ (r.y[k, there] - h @ x), P - gain @ s @ gain.T
        means.append(x)
        covariances.append(P)
    return np.array(means), np.array(covariances)


@pytest.mark.parametrize("speed", [0.0, 3.0])
@pytest.mark.parametrize("step", [0.1, 1.0])
def test_process_noise_is_a_covariance_however_fast_the_vehicle_moves(speed: float, step: float) -> None:
    """A boat by kinematics: noise on the acceleration of its turn moves it sideways by way of its heading."""
    process = process_of(load_vehicle("otter"), kind="kinematics")
    names = [*process.x.shape, len(process.driven)]
    x = np.zeros(names[0])
    x[[process.index(n) for n in ("psi", "u", "r")]] = 0.7, speed, 0.4
    q = ca.SX.sym("q", len(process.driven))
    given = (process.x, process.u, process.p, process.t)
    dt = ca.SX.sym("dt")
    added = ca.Function(
        "added", [*given, q, dt], [added_noise(process, process.x, process.u, process.p, q, process.t, dt)]
    )
    density = np.full(len(process.driven), 10.0)
    values = (x, np.zeros(process.u.numel()), process.values, 0.0)
    found = added(*values, density, step).toarray()
    size = np.sqrt(np.diag(found))
    assert np.linalg.eigvalsh(found / np.outer(size, size)).min() > 0.0
    a = ca.Function("a", list(given), [process.system(*given)[1]])(*values).toarray()
    noise = np.zeros_like(a)
    noise[process.driven, process.driven] = density
    whole = expm(step * np.block([[-a, noise], [np.zeros_like(a), a.T]]))
    n = len(a)
    exact = whole[n:, n:].T @ whole[:n, n:]
    np.testing.assert_allclose(found / np.outer(size, size), exact / np.outer(size, size), atol=0.02 * step)


@pytest.mark.parametrize("method", ["ekf", "ukf"])
def test_filters_of_a_linear_system_are_the_kalman_filter(method) -> None:
    given, P = reports(), np.diag([0.5, 0.2])
    found = Observer(linear(), [DENSITY]).run(given, np.array([0.1, -0.1]), P, method)
    means, covariances = by_hand(given, np.array([0.1, -0.1]), P)
    np.testing.assert_allclose(found.mean, means, atol=1e-9)
    np.testing.assert_allclose(found.covariance, covariances, atol=1e-9)


def test_the_covariance_settles_where_the_riccati_equation_says() -> None:
    n = 6000
    given = Reports(DT * np.arange(n), np.zeros((n, 1)), np.zeros((n, 2)), VARIANCE)
    found = Observer(linear(), [DENSITY]).run(given, np.zeros(2), np.eye(2))
    f, _, q = discrete()
    settled = solve_discrete_are(f.T, C.T, q, np.diag(VARIANCE))
    np.testing.assert_allclose(found.predicted_covariance[-1], settled, rtol=1e-8)


@pytest.mark.parametrize("method", ["ekf", "ukf"])
def test_the_smoother_is_the_least_squares_solution_of_all_rows_at_once(method) -> None:
    given, x0, P = reports(12), np.array([0.1, -0.1]), np.diag([0.5, 0.2])
    found = smoothed(Observer(linear(), [DENSITY]).run(given, x0, P, method))
    f, g, q = discrete()
    n = len(given.t)
    steps = np.eye(2 * n) - np.kron(np.eye(n, k=-1), f)
    drift = np.concatenate([x0, *(g @ given.u[k] for k in range(n - 1))])
    weight = np.linalg.inv(block_diag(P, *[q] * (n - 1)))
    there = np.isfinite(given.y).ravel()
    seen, r = np.kron(np.eye(n), C)[there], np.tile(1 / VARIANCE, n)[there]
    information = steps.T @ weight @ steps + seen.T @ (r[:, None] * seen)
    mean = np.linalg.solve(information, steps.T @ weight @ drift + seen.T @ (r * given.y.ravel()[there]))
    np.testing.assert_allclose(found.mean.ravel(), mean, atol=1e-7)
    np.testing.assert_allclose(found.covariance[5], np.linalg.inv(information)[10:12, 10:12], atol=1e-8)


def test_an_angle_is_the_same_after_a_turn() -> None:
    process = process_of(load_vehicle("mini-auv"), (), "kinematics")
    n, psi = 60, process.channels.index("psi")
    y = np.full((n, len(process.channels)), np.nan)
    y[:, psi] = np.angle(np.exp(1j * (3.0 + 0.02 * np.arange(n))))
    given = Reports(0.1 * np.arange(n), np.zeros((n, 4)), y, np.full(len(process.channels), 1e-6))
    mean, covariance = first_guess(process, given)
    for method in ("ekf", "ukf"):
        found = Observer(process, np.full(4, 1e-3)).run(given, mean, covariance, method)
        assert found.used[:, psi].all()
        assert found.state("psi")[-1] == pytest.approx(3.0 + 0.02 * (n - 1), abs=2e-3)


def test_a_report_beyond_the_gate_changes_nothing() -> None:
    given = reports(200)
    wild = given.y.copy()
    wild[150, 0] += 5.0
    observer = Observer(linear(), [DENSITY])
    mean, P = np.zeros(2), np.eye(2)
    found = observer.run(Reports(given.t, given.u, wild, VARIANCE), mean, P)
    assert not found.used[150, 0]
    wild[150, 0] = np.nan
    without = observer.run(Reports(given.t, given.u, wild, VARIANCE), mean, P)
    np.testing.assert_allclose(found.mean, without.mean, atol=1e-14)


EVERY = {"x": 10, "y": 10, "z": 2, "psi": 1, "r": 1}


@pytest.fixture(scope="module")
def estimates():
    """Logs of a vehicle in a current, filtered with the noise that is true: process, estimate, truth.

    The first state is as far from the mean as the prior says. A wider one would break the bounds: quadratic
    drag linearised at a velocity that is unknown is none.
    """
    prior = Prior(velocity=0.05, rate=0.05, current=0.15)
    process = process_of(auv(), ("V_N", "V_E"), "model")
    q = np.array([DRIVE.get(n, 0.0) for n in process.driven_names]) ** 2
    found = []
    for seed in range(10):
        run, x, _ = log(auv(**CURRENT), 30.0, seed, EVERY)
        given, rows = reports_of(run, process)
        truth = np.column_stack([x, np.tile(list(CURRENT.values()), (len(x), 1))])
        mean, _ = first_guess(process, given)
        mean[4:] = 0.0
        estimate = Observer(process, q).run(given, mean, prior.covariance(process))
        assert len(rows) == len(given.t) == len(truth)
        found.append((process, estimate, truth))
    return found


def test_errors_and_innovations_are_as_large_as_the_filter_says(estimates) -> None:
    process = estimates[0][0]
    values = np.array([nees(found, truth, slice(200, 201))[0] for _, found, truth in estimates])
    low, high = nees_bounds(len(process.state_names), len(values))
    assert low < values.mean() < high
    squares = [nis([found], process.channels)[-1] for _, found, _ in estimates]
    assert sum(one.consistent for one in squares) >= 8
    white = [one.white for _, found, _ in estimates for one in whiteness([found], process.channels)]
    assert len(white) == 50
    assert sum(white) >= 46


def test_sigma_points_stay_honest_where_the_first_velocity_is_unknown() -> None:
    process = process_of(auv(), ("V_N", "V_E"), "model")
    q = np.array([DRIVE.get(n, 0.0) for n in process.driven_names]) ** 2
    values: dict[Method, list[float]] = {"ekf": [], "ukf": []}
    for seed in range(5):
        run, x, _ = log(auv(**CURRENT), 12.0, seed, EVERY)
        given, _ = reports_of(run, process)
        truth = np.column_stack([x, np.tile(list(CURRENT.values()), (len(x), 1))])
        for method, found in values.items():
            estimate = Observer(process, q).run(given, *first_guess(process, given), method)
            found.append(nees(estimate, truth, slice(100, 101))[0])
    low, high = nees_bounds(len(process.state_names), 5)
    assert low < np.mean(values["ukf"]) < high
    assert np.mean(values["ekf"]) > high


def test_the_smoother_is_never_less_certain_and_closer_to_the_truth(estimates) -> None:
    for process, found, truth in estimates[:3]:
        all_rows = smoothed(found)
        assert (all_rows.deviation <= found.deviation * (1 + 1e-6) + 1e-9).all()
        u = process.index("u")
        errors = [np.std((e.mean - truth)[100:-20, u]) for e in (all_rows, found)]
        assert errors[0] < errors[1]
        assert abs(found.mean[-1] - truth[-1])[-2:] == pytest.approx(
            0, abs=3 * found.deviation[-1, -2:].max()
        )


def test_a_wrong_model_is_seen_in_the_innovations() -> None:
    right = auv()
    buoyancy = right.value_of("B_net")
    wrong = right.with_values({"B_net": replace(buoyancy, value=0.9 * buoyancy.value)})
    run, _, _ = log(right, 60.0, 1, {"x": 1, "y": 1, "z": 1, "psi": 1, "w": 1})
    verdicts = []
    for vehicle in (right, wrong):
        process = process_of(vehicle, (), "model")
        given, _ = reports_of(run, process)
        q = np.array([DRIVE[n] for n in process.driven_names]) ** 2
        found = Observer(process, q).run(given, *first_guess(process, given))
        verdicts.append({one.name: one.p_value for one in whiteness([found], process.channels)}["w"])
    assert verdicts[0] > 0.01
    assert verdicts[1] < 1e-6


def test_ljung_box_holds_its_level() -> None:
    rng = np.random.default_rng(0)
    p = np.array([ljung_box(rng.standard_normal(300), SETTINGS.lags).p_value for _ in range(400)])
    assert 0.02 < np.mean(p < 0.05) < 0.09
    walk = np.convolve(rng.standard_normal(301), [1.0, 0.4], "valid")
    assert ljung_box(walk, SETTINGS.lags).p_value < 1e-4


@pytest.mark.parametrize(
    ("estimated", "kind", "words"),
    [
        (("V_N",), "kinematics", "does not show in kinematics"),
        (("b_p",), "model", "does not occur"),
        (("X_u",), "model", "cannot be estimated as a state"),
    ],
)
def test_what_cannot_be_estimated_is_refused(estimated, kind, words) -> None:
    with pytest.raises(UndertowError, match=words):
        process_of(load_vehicle("mini-auv"), estimated, kind)


def test_process_noise_must_fit() -> None:
    with pytest.raises(UndertowError, match="one, zero or above"):
        Observer(linear(), [1.0, 2.0])


@pytest.mark.slow
def test_the_noise_is_found_from_a_guess_with_which_the_filter_loses_its_track() -> None:
    """A turn by an exact gyro: with too little noise all reports are rejected, and less noise is cheaper."""
    what = process_of(auv(), (), "kinematics")
    t, rng = 0.04 * np.arange(500), np.random.default_rng(3)
    y = np.full((500, len(what.channels)), np.nan)
    y[:, :3] = [0.05, 0.05, 0.01] * rng.standard_normal((500, 3))
    y[:, what.channels.index("psi")] = 0.8 * (1 - np.exp(-t / 4)) + 0.01 * rng.standard_normal(500)
    y[:, what.channels.index("r")] = 0.2 * np.exp(-t / 4)
    noise = dict(zip(what.channels, [0.05, 0.05, 0.01, 0.01, 1, 1, 1, 6e-5], strict=True))
    reports = Reports(t, np.zeros((500, 4)), y, np.array([noise[n] for n in what.channels]) ** 2)
    first = np.zeros(len(what.state_names)), UNKNOWN.covariance(what)
    free = np.ones(4, dtype=bool)
    lost = Observer(what, np.full(4, 1e-10)).run(reports, *first)
    assert (reports.present & ~lost.used).sum() > 500
    found = Observer(what, most_likely(what, reports, *first, np.full(4, 1e-10), free)).run(reports, *first)
    assert found.used[reports.present].all()
    usual = Observer(what, most_likely(what, reports, *first, np.full(4, 1e-2), free)).run(reports, *first)
    assert abs(found.log_likelihood - usual.log_likelihood) < 5
