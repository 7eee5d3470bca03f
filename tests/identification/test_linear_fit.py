"""Least squares in one pass: as lstsq on all rows, by compiled code and without, however ill conditioned."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest

from undertow.codegen.compiler import find_compiler
from undertow.codegen.functions import Functions
from undertow.errors import UndertowError
from undertow.model.catalogue import catalogue
from undertow.model.loading import load_vehicle
from undertow.paper import linear_fit
from undertow.paper.linear_fit import LinearFit

NAMES = (
    *("X_udot", "Y_vdot", "Z_wdot", "K_pdot", "M_qdot", "N_rdot", "X_u", "Y_v", "Z_w", "K_p", "M_q", "N_r"),
    *("X_uabsu", "Y_vabsv", "Z_wabsw", "K_pabsp", "M_qabsq", "N_rabsr", "W", "S_z"),
)
# Whole groups of lanes, parts of one, and past the number of samples after which sums are handed on.
LENGTHS = (3, 8, 37, 1024, 8200)
Samples = dict[str, np.ndarray]


@pytest.fixture(params=["compiled", "virtual"])
def compiled(request: pytest.FixtureRequest) -> bool:
    if request.param == "compiled" and find_compiler() is None:
        pytest.skip("no C compiler on this machine")
    return request.param == "compiled"


@cache
def functions() -> Functions:
    return Functions(load_vehicle("bluerov2"))


@cache
def fit(compiled: bool) -> LinearFit:
    return LinearFit(functions(), NAMES, compiled=compiled)


def samples(count: int, seed: int = 0, size: float = 1.0) -> Samples:
    """Random motion and commands; accelerations by the model, with noise."""
    rng, f = np.random.default_rng(seed), functions()
    x = rng.uniform(-0.5, 0.5, (len(f.state_names), count)) * size
    u = rng.uniform(-10, 10, (f.u.numel(), count))
    p = np.tile(np.array(f.values())[:, None], count)
    rates = np.asarray(f.dynamics.map(count)(x, u, p, np.zeros((1, count))))[6:12]
    rates = rates + 0.05 * rng.standard_normal(rates.shape)
    names = (*f.state_names, *(f"{n}_dot" for n in f.vehicle.velocity_names), *f.vehicle.command_names)
    return dict(zip(names, np.vstack([x, rates, u]), strict=True))


def nothing() -> Samples:
    """A log without samples."""
    return {name: column[:0] for name, column in samples(1).items()}


def rows(log: Samples, names: Sequence[str] = NAMES) -> tuple[np.ndarray, np.ndarray]:
    """Regressor (n, 6, k) and target (n, 6) by the model's own functions, sample by sample."""
    f, count = functions(), len(log["u"])
    places = [f.parameter_names.index(n) for n in names]
    p = np.array(f.values())
    p[places] = 0.0
    inputs = [
        np.array([log[n] for n in group])
        for group in (f.state_names, [f"{n}_dot" for n in f.vehicle.velocity_names], f.vehicle.command_names)
    ]
    given = (*inputs, np.tile(p[:, None], count), np.zeros((1, count)))
    slope = np.asarray(f.regressor.map(count)(*given)).reshape(6, count, -1).transpose(1, 0, 2)
    residual = np.asarray(f.residual_function.map(count)(*given)).T
    return slope[:, :, places], -residual


def by_lstsq(logs: Sequence[Samples], weights: Sequence[np.ndarray] | None = None) -> np.ndarray:
    """Estimates from all rows as one dense matrix, columns scaled."""
    parts = [rows(log) for log in logs]
    H, target = (np.concatenate([part[i] for part in parts]) for i in (0, 1))
    if weights is not None:
        root = np.sqrt(np.concatenate(weights))
        H, target = H * root[:, :, None], target * root
    H, target = H.reshape(-1, H.shape[2]), target.ravel()
    size = np.linalg.norm(H, axis=0)
    return np.linalg.lstsq(H / size, target, rcond=None)[0] / size


def assert_same(theta: np.ndarray, expected: np.ndarray, tolerance: float = 1e-8) -> None:
    assert np.max(np.abs(theta - expected) / np.abs(expected)) < tolerance


# --- estimates ------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [37, 1024, 8200])
def test_estimates_are_those_of_lstsq(count: int, compiled: bool) -> None:
    log = samples(count)
    found = fit(compiled).solve([log])
    assert (found.way, found.count) == ("normal", count)
    assert_same(found.theta, by_lstsq([log]), 1e-10)
    H, target = rows(log)
    left = target.ravel() - H.reshape(-1, len(NAMES)) @ found.theta
    assert found.squares == pytest.approx(left @ left, rel=1e-9)
    products = H.reshape(-1, len(NAMES)).T @ H.reshape(-1, len(NAMES))
    np.testing.assert_allclose(found.factor.T @ found.factor, products, atol=1e-12 * np.abs(products).max())


def test_several_logs_are_one(compiled: bool) -> None:
    logs = [samples(200, 1), samples(3, 2), nothing(), samples(131, 4)]
    found = fit(compiled).solve(logs)
    assert found.count == 334
    assert_same(found.theta, by_lstsq([logs[0], logs[1], logs[3]]))


def test_the_truth_is_found_from_enough_samples() -> None:
    f = functions()
    found = fit(compiled=False).solve([samples(4000)])
    truth = np.array([f.vehicle.value_of(n).value for n in NAMES])
    errors = np.sqrt(found.squares / (6 * 4000) * np.diag(np.linalg.inv(found.factor.T @ found.factor)))
    assert np.all(np.abs(found.theta - truth) < 5 * errors + 0.05 * np.abs(truth))


@pytest.mark.parametrize("count", LENGTHS)
def test_compiled_rows_are_those_of_the_virtual_machine(count: int) -> None:
    if find_compiler() is None:
        pytest.skip("no C compiler on this machine")
    log = samples(count, 5)
    parts = [fit(c)._part(log, None)[0] for c in (True, False)]
    (ours, n), (theirs, m) = (
        fit(c)._rows.build(part, fit(c)._p, None) for c, part in zip((True, False), parts, strict=True)
    )
    assert n == m == count
    np.testing.assert_allclose(ours, theirs, rtol=1e-13, atol=1e-13)


# --- weights and gaps -----------------------------------------------------------------------------


def test_weights_of_motions(compiled: bool) -> None:
    log, weights = samples(300, 6), np.array([1.0, 4.0, 0.25, 100.0, 0.0, 9.0])
    found = fit(compiled).triangle(log, weights)
    H, target = rows(log)
    table = np.concatenate([H, target[:, :, None]], axis=2) * np.sqrt(weights)[:, None]
    expected = table.reshape(-1, len(NAMES) + 1).T @ table.reshape(-1, len(NAMES) + 1)
    np.testing.assert_allclose(found[0].T @ found[0], expected, rtol=1e-9, atol=1e-11 * expected.max())


def test_weights_of_samples(compiled: bool) -> None:
    logs = [samples(150, 7), samples(61, 8)]
    rng = np.random.default_rng(9)
    weights = [rng.uniform(0.1, 3.0, (6, len(log["u"]))) for log in logs]
    found = fit(compiled).solve(logs, weights)
    assert_same(found.theta, by_lstsq(logs, [w.T for w in weights]))


@pytest.mark.parametrize(
    ("weights", "message"), [(-1.0, "negative"), (np.nan, "negative"), (np.inf, "finite")]
)
def test_a_weight_that_means_nothing_is_refused(weights: float, message: str) -> None:
    with pytest.raises(UndertowError, match=message):
        fit(compiled=False).solve([samples(50)], np.array([1.0, 1.0, weights, 1.0, 1.0, 1.0]))


def test_a_sample_with_a_gap_counts_nothing(compiled: bool) -> None:
    log = {name: column.copy() for name, column in samples(203, 10).items()}
    gone = [0, 17, 18, 101, 202]
    for place, name in zip(gone, ("u", "q_dot", "theta", log_command(), "r"), strict=True):
        log[name][place] = np.nan if place != 101 else np.inf
    # A gap in what no row needs does not matter.
    log["x"][50] = np.nan
    kept = np.setdiff1d(np.arange(203), gone)
    whole = {name: column[kept] for name, column in samples(203, 10).items()}
    found = fit(compiled).solve([log])
    assert found.count == 198
    assert_same(found.theta, by_lstsq([whole]))


def log_command() -> str:
    return functions().vehicle.command_names[2]


# --- what is ill conditioned ----------------------------------------------------------------------


def alike(count: int, apart: float) -> Samples:
    """Speeds of nearly one magnitude in surge, which linear and quadratic drag hardly tell apart."""
    log = {name: column.copy() for name, column in samples(count, 11).items()}
    rng = np.random.default_rng(12)
    log["u"] = np.sign(rng.uniform(-1, 1, count)) * (0.4 + apart * rng.uniform(-1, 1, count))
    return log


@pytest.mark.parametrize(
    ("apart", "way"), [(0.3, "normal"), (1e-4, "refined"), (1e-6, "triangular"), (1e-8, "triangular")]
)
def test_digits_are_kept_however_ill_conditioned(apart: float, way: str, compiled: bool) -> None:
    log = alike(3000, apart)
    found = fit(compiled).solve([log])
    assert found.way == way
    H, target = rows(log)
    H, target = H.reshape(-1, len(NAMES)), target.ravel()
    expected = by_lstsq([log])
    # In the forces that parameters make; each by itself is known to condition x rounding at best.
    apart_ = np.linalg.norm(H @ (found.theta - expected)) / np.linalg.norm(H @ expected)
    assert apart_ < 1e-10
    assert_same(found.theta, expected, max(1e-8, 100 * found.condition * 2.2e-16 * 10))


def test_normal_equations_alone_would_not_do() -> None:
    """What the corrections are for."""
    log = alike(3000, 1e-5)
    H, target = (a.reshape(-1, *a.shape[2:]) for a in rows(log))
    size = np.linalg.norm(H, axis=0)
    gram = (H / size).T @ (H / size)
    plain = np.linalg.solve(gram, (H / size).T @ target) / size
    expected, found = by_lstsq([log]), fit(compiled=False).solve([log])
    off = [np.max(np.abs(theta - expected) / np.abs(expected)) for theta in (plain, found.theta)]
    # The reference, too, knows each parameter to condition times rounding at best.
    known = 1000 * found.condition * 2.2e-16
    assert off[0] > 10 * known > known > off[1]


def test_a_solution_that_does_not_settle_is_found_by_reflections(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(linear_fit, "_CORRECTIONS", 0)
    log = alike(2000, 1e-4)
    found = fit(compiled=False).solve([log])
    assert found.way == "triangular"
    assert_same(found.theta, by_lstsq([log]))


def test_parameters_that_no_sample_tells_apart_are_named(compiled: bool) -> None:
    log = {name: column.copy() for name, column in samples(100, 13).items()}
    log["u"] = np.full(100, 0.3)
    with pytest.raises(UndertowError, match="do not determine X_udot"):
        fit(compiled).solve([log])


@pytest.mark.parametrize("count", [0, 1, 3])
def test_logs_that_are_too_short_are_refused(count: int, compiled: bool) -> None:
    with pytest.raises(UndertowError, match=f"{count} samples do not determine"):
        fit(compiled).solve([samples(count) if count else nothing()])


# --- what is given --------------------------------------------------------------------------------


def test_only_what_rows_need_is_asked_for() -> None:
    needed = fit(compiled=False).needed
    assert not {"x", "y", "z", "psi", "t"} & {*needed}
    log = samples(50)
    del log["q_dot"]
    with pytest.raises(UndertowError, match="lack channel 'q_dot'"):
        fit(compiled=False).solve([log])


def test_columns_of_different_lengths_are_refused() -> None:
    log = samples(50)
    log["q"] = log["q"][:-1]
    with pytest.raises(UndertowError, match="differ in length"):
        fit(compiled=False).solve([log])


def test_weights_of_another_shape_are_refused() -> None:
    with pytest.raises(UndertowError, match=r"weights have shape \(3,\)"):
        fit(compiled=False).solve([samples(50)], np.ones(3))


def test_a_parameter_that_is_not_linear_is_refused() -> None:
    vehicle = load_vehicle("bluerov2").with_effect(catalogue()["ocean_current"], {})
    with pytest.raises(UndertowError, match="X_u does not enter the equations linearly"):
        LinearFit(Functions(vehicle), ["X_u", "V_N"], compiled=False)
