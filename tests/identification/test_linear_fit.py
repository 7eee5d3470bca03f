"""Least squares in one pass: as lstsq on all rows, by compiled code and without, however ill conditioned."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest

from tests.quick import first_quick, quick_if
from undertow.codegen.compiler import find_compiler
from undertow.codegen.functions import Functions
from undertow.errors import UndertowError
from undertow.identification.estimation.fitted import TriangularFactor
from undertow.model.catalogue import catalogue
from undertow.model.loading import load_vehicle
from undertow.paper.regression import LinearFit

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


def reduced(logs: Sequence[Samples], compiled: bool) -> TriangularFactor:
    """All samples of some logs as one triangle."""
    triangle = TriangularFactor(len(NAMES))
    for log in logs:
        triangle.add(*fit(compiled).triangle(log))
    return triangle


def estimates(triangle: TriangularFactor) -> np.ndarray:
    H, target = triangle.split()
    size = np.linalg.norm(H, axis=0)
    return np.linalg.lstsq(H / size, target, rcond=None)[0] / size


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


def by_lstsq(logs: Sequence[Samples]) -> np.ndarray:
    """Estimates from all rows as one dense matrix, columns scaled."""
    parts = [rows(log) for log in logs]
    H, target = (np.concatenate([part[i] for part in parts]) for i in (0, 1))
    H, target = H.reshape(-1, H.shape[2]), target.ravel()
    size = np.linalg.norm(H, axis=0)
    return np.linalg.lstsq(H / size, target, rcond=None)[0] / size


def assert_same(theta: np.ndarray, expected: np.ndarray, tolerance: float = 1e-8) -> None:
    assert np.max(np.abs(theta - expected) / np.abs(expected)) < tolerance


# --- estimates ------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", first_quick([37, 1024, 8200]))
def test_estimates_are_those_of_lstsq(count: int, compiled: bool) -> None:
    log = samples(count)
    factor, known = fit(compiled).triangle(log)
    assert known == count
    assert_same(estimates(reduced([log], compiled)), by_lstsq([log]), 1e-10)
    H, target = rows(log)
    table = np.column_stack([H.reshape(-1, len(NAMES)), target.ravel()])
    products = table.T @ table
    np.testing.assert_allclose(factor.T @ factor, products, atol=1e-12 * np.abs(products).max())


def test_several_logs_are_one(compiled: bool) -> None:
    logs = [samples(200, 1), samples(3, 2), nothing(), samples(131, 4)]
    found = reduced(logs, compiled)
    assert found.count == 334
    assert_same(estimates(found), by_lstsq([logs[0], logs[1], logs[3]]))


def test_the_truth_is_found_from_enough_samples() -> None:
    f = functions()
    found = reduced([samples(4000)], False)
    truth = np.array([f.vehicle.value_of(n).value for n in NAMES])
    H, squares = found.factor[:-1, :-1], found.factor[-1, -1] ** 2
    errors = np.sqrt(squares / (6 * 4000) * np.diag(np.linalg.inv(H.T @ H)))
    assert np.all(np.abs(estimates(found) - truth) < 5 * errors + 0.05 * np.abs(truth))


@pytest.mark.parametrize("count", LENGTHS)
def test_compiled_rows_are_those_of_the_virtual_machine(count: int) -> None:
    if find_compiler() is None:
        pytest.skip("no C compiler on this machine")
    log = samples(count, 5)
    # Private: rows before they are summed, where one that differs cannot hide.
    parts = [fit(c)._columns(log) for c in (True, False)]
    (ours, n), (theirs, m) = (
        fit(c)._rows.build(part, fit(c)._p) for c, part in zip((True, False), parts, strict=True)
    )
    assert n == m == count
    np.testing.assert_allclose(ours, theirs, rtol=1e-13, atol=1e-13)


# --- gaps ----------------------------------------------------------------------------------------


def test_a_sample_with_a_gap_counts_nothing(compiled: bool) -> None:
    log = {name: column.copy() for name, column in samples(203, 10).items()}
    gone = [0, 17, 18, 101, 202]
    for place, name in zip(gone, ("u", "q_dot", "theta", log_command(), "r"), strict=True):
        log[name][place] = np.nan if place != 101 else np.inf
    # A gap in what no row needs does not matter.
    log["x"][50] = np.nan
    kept = np.setdiff1d(np.arange(203), gone)
    whole = {name: column[kept] for name, column in samples(203, 10).items()}
    found = reduced([log], compiled)
    assert found.count == 198
    assert_same(estimates(found), by_lstsq([whole]))


def log_command() -> str:
    return functions().vehicle.command_names[2]


# --- what is ill conditioned ----------------------------------------------------------------------


def alike(count: int, apart: float) -> Samples:
    """Speeds of nearly one magnitude in surge, which linear and quadratic drag hardly tell apart."""
    log = {name: column.copy() for name, column in samples(count, 11).items()}
    rng = np.random.default_rng(12)
    log["u"] = np.sign(rng.uniform(-1, 1, count)) * (0.4 + apart * rng.uniform(-1, 1, count))
    return log


@pytest.mark.parametrize("apart", quick_if((0.3, 1e-8).__contains__, [0.3, 1e-4, 1e-6, 1e-8]))
def test_digits_are_kept_however_ill_conditioned(apart: float, compiled: bool) -> None:
    log = alike(3000, apart)
    found, expected = estimates(reduced([log], compiled)), by_lstsq([log])
    H = rows(log)[0].reshape(-1, len(NAMES))
    # In the forces that parameters make; each by itself is known to condition x rounding at best.
    assert np.linalg.norm(H @ (found - expected)) / np.linalg.norm(H @ expected) < 1e-10
    condition = np.linalg.cond(H / np.linalg.norm(H, axis=0))
    assert_same(found, expected, max(1e-8, 100 * condition * 2.2e-16 * 10))


def test_normal_equations_alone_would_not_do() -> None:
    """What the reflections are for."""
    log = alike(3000, 1e-5)
    H, target = (a.reshape(-1, *a.shape[2:]) for a in rows(log))
    size = np.linalg.norm(H, axis=0)
    gram = (H / size).T @ (H / size)
    plain = np.linalg.solve(gram, (H / size).T @ target) / size
    expected, found = by_lstsq([log]), estimates(reduced([log], False))
    off = [np.max(np.abs(theta - expected) / np.abs(expected)) for theta in (plain, found)]
    # The reference, too, knows each parameter to condition times rounding at best.
    known = 1000 * np.linalg.cond(H / size) * 2.2e-16
    assert off[0] > 10 * known > known > off[1]


# --- what is given --------------------------------------------------------------------------------


def test_only_what_rows_need_is_asked_for() -> None:
    needed = fit(compiled=False).used_inputs
    assert not {"x", "y", "z", "psi", "t"} & {*needed}
    log = samples(50)
    del log["q_dot"]
    with pytest.raises(UndertowError, match="lack channel 'q_dot'"):
        fit(compiled=False).triangle(log)


def test_columns_of_different_lengths_are_refused() -> None:
    log = samples(50)
    log["q"] = log["q"][:-1]
    with pytest.raises(UndertowError, match="differ in length"):
        fit(compiled=False).triangle(log)


def test_a_parameter_that_is_not_linear_is_refused() -> None:
    vehicle = load_vehicle("bluerov2").with_effect(catalogue()["ocean_current"], {})
    with pytest.raises(UndertowError, match="X_u does not enter the equations linearly"):
        LinearFit(Functions(vehicle), ["X_u", "V_N"], compiled=False)
