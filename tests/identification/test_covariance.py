"""Covariance of the weak residual against dense products, and carried states against exact solutions."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from undertow.codegen.compiler import Compiler
from undertow.identification.estimation import data
from undertow.identification.estimation.data import group_numbers, residual_covariance
from undertow.identification.estimation.inputs import Inputs, PropagatedState
from undertow.identification.estimation.test_functions import Entries, SumsInC, SumsInNumPy, boxes, unbanded
from undertow.identification.estimation.test_functions import test_functions as functions_on

N_DOF = 2
ROWS = (0, 1, 3)
EVEN = np.arange(0.0, 5.001, 0.05)
UNEVEN = np.sort(np.random.default_rng(1).permutation(EVEN)[:80])


def _entries(samples: int) -> Entries:
    """Derivatives of 5 n rows in 2 n channels, at random places and of random values."""
    rng = np.random.default_rng(2)
    places = np.argwhere(rng.random((5 * N_DOF, 2 * N_DOF)) < 0.7)
    data = rng.standard_normal((samples, len(places)))
    return Entries(places[:, 0], places[:, 1], data, 2 * N_DOF)


def _dense(functions, entries: Entries, samples: int) -> np.ndarray:
    """What every row feels of every channel at every sample, (K, rows, samples, channels)."""
    felt = np.zeros((functions.count, 2 * N_DOF, samples, 2 * N_DOF))
    weights = [functions.rate, functions.value, functions.rate, functions.value, functions.held]
    for row, column, values in zip(entries.row, entries.column, entries.data.T, strict=True):
        block = row // N_DOF
        equation = row % N_DOF + (N_DOF if block in (2, 3) else 0)
        felt[:, equation, :, column] += weights[block].toarray() * values
    return felt[:, list(ROWS)]


def _difference(t: np.ndarray) -> np.ndarray:
    """Central differences as a matrix, one-sided at the ends."""
    return np.gradient(np.eye(len(t)), axis=0) / np.gradient(t)[:, None]


@pytest.mark.parametrize("derived", [(), (2,), (2, 3)])
@pytest.mark.parametrize("varying", [False, True])
@pytest.mark.parametrize("make", [functions_on, boxes])
@pytest.mark.parametrize("t", [EVEN, UNEVEN])
def test_covariance_is_that_of_dense_products(t, make, varying: bool, derived: tuple[int, ...]) -> None:
    functions = make(t, 0.25)
    entries, count = _entries(len(t)), len(t)
    sigma = np.array([0.3, 0.5, 1.0, 2.0])
    if varying:
        sigma = sigma * np.random.default_rng(3).uniform(1.0, 5.0, (count, 1))
    bands = residual_covariance(functions, entries, sigma, ROWS, derived, t)
    felt = _dense(functions, entries, count)
    expected = 0.0
    for channel in range(2 * N_DOF):
        level = np.broadcast_to(sigma[..., channel - N_DOF if channel in derived else channel], count)
        one = (felt[..., channel] * level).reshape(-1, count)
        one = one @ _difference(t) if channel in derived else one
        expected = expected + one @ one.T
    np.testing.assert_allclose(unbanded(bands).toarray(), expected, atol=1e-13 * np.max(np.abs(expected)))


@pytest.mark.parametrize("t", [EVEN, UNEVEN])
@pytest.mark.parametrize("derived", [(), (2, 3)])
def test_pieces_of_windows_give_what_all_at_once_give(
    t: np.ndarray, derived: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = functions_on(t, 0.25), _entries(len(t)), np.array([0.3, 0.5, 1.0, 2.0]), ROWS, derived, t
    whole = residual_covariance(*asked)
    monkeypatch.setattr(data, "BLOCKS", replace(data.BLOCKS, bytes=1))
    np.testing.assert_allclose(residual_covariance(*asked), whole, rtol=1e-12, atol=1e-18)


def test_bands_are_no_wider_than_what_overlaps() -> None:
    functions = functions_on(EVEN, 0.25)
    bands = residual_covariance(functions, _entries(len(EVEN)), np.ones(2 * N_DOF), ROWS)
    assert len(bands) <= 4 * len(ROWS)  # a cubic spline meets the three that follow it
    assert np.all(np.any(bands[[0, -1]], axis=1))


def _lag() -> PropagatedState:
    """Two states that follow u, one behind the other: T z1' = u - z1, T z2' = z1 - c z2^3."""
    z, u, p, t, dt = (ca.SX.sym(n, k) for n, k in (("z", 2), ("u", 1), ("p", 2), ("t", 1), ("dt", 1)))

    def rate(state: ca.SX, share: float) -> ca.SX:
        return ca.vertcat(u - state[0], state[0] - p[1] * state[1] ** 3) / p[0]

    return PropagatedState(z, Inputs([u], p, t, dt), p, rate, lambda state, share: state[0] * state[1])


def _states(start: np.ndarray, u: np.ndarray, p: np.ndarray, t: np.ndarray, dt: np.ndarray) -> np.ndarray:
    return _lag().side_by_side(start[None], [(u, t, dt)], p)[0]


def test_a_first_order_lag_is_carried_as_it_is_solved() -> None:
    rng = np.random.default_rng(4)
    dt, u = rng.uniform(0.02, 0.05, 60), rng.standard_normal((60, 1))
    p = np.array([0.4, 1.0])
    states = _states(np.array([0.5, 0.0]), u, p, np.cumsum(dt) - dt, dt)
    exact = [0.5]
    for step, command in zip(dt, u[:, 0], strict=True):
        exact.append(command + (exact[-1] - command) * np.exp(-step / p[0]))
    np.testing.assert_allclose(states[:, 0], exact, atol=1e-8)


def test_states_that_decay_alone_follow_an_input_that_changes_linearly_exactly() -> None:
    """T z' = a + b t - z over one interval, for two time constants at once."""
    z, u, p, t, dt = (ca.SX.sym(n, k) for n, k in (("z", 2), ("u", 2), ("p", 2), ("t", 1), ("dt", 1)))

    def rate(state: ca.SX, share: float) -> ca.SX:
        return (u[0] + u[1] * (t + share * dt) - state) / p

    lags = PropagatedState(z, Inputs([u], p, t, dt), p, rate, lambda state, share: state)
    a, b, T, start, step = 0.7, -1.3, np.array([0.05, 3.0]), np.array([0.4, -0.2]), np.array([0.5])
    drive = np.array([[a, b]])
    states = lags.side_by_side(start[None], [(drive, np.zeros(1), step)], T)[0]

    def exact(T: np.ndarray) -> np.ndarray:
        steady = a - b * T
        return steady + b * step + (start - steady) * np.exp(-step / T)

    np.testing.assert_allclose(states[1], exact(T), atol=1e-13)
    slopes, _, _ = lags.along(states, np.zeros((2, 2)), [drive], T, np.zeros(1), step)
    np.testing.assert_allclose(np.diag(slopes[1]), (exact(T + 1e-6) - exact(T - 1e-6)) / 2e-6, rtol=1e-6)


def test_logs_side_by_side_are_carried_as_each_by_itself() -> None:
    rng = np.random.default_rng(6)
    lengths, starts, p = (40, 0, 17), rng.standard_normal((3, 2)), rng.uniform(0.5, 1.0, (3, 2))
    logs = [(rng.standard_normal((n, 1)), np.arange(n) / 20, rng.uniform(0.02, 0.05, n)) for n in lengths]
    for found, start, (u, t, dt), own in zip(
        _lag().side_by_side(starts, logs, p), starts, logs, p, strict=True
    ):
        assert np.array_equal(found, _states(start, u, own, t, dt))


def test_carried_derivatives_are_those_of_finite_differences() -> None:
    rng = np.random.default_rng(5)
    dt, u = rng.uniform(0.02, 0.05, 40), rng.standard_normal((40, 1))
    t, p, start = np.cumsum(dt) - dt, np.array([0.4, 1.3]), np.array([0.5, -0.2])
    start_slope, carried = np.array([[0.3, 0.0], [0.0, 0.7]]), _lag()

    def at(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        moved = start + start_slope @ (x[:2] - p) + x[2:]
        states = _states(moved, u, x[:2], t, dt)
        return states, carried.along(states, start_slope, [u], x[:2], t, dt)[1]

    x = np.concatenate([p, np.zeros(2)])
    slopes, _, means = carried.along(_states(start, u, p, t, dt), start_slope, [u], p, t, dt)
    for k, step in enumerate(1e-6 * np.eye(4)):
        for found, high, low in zip((slopes, means), at(x + step), at(x - step), strict=True):
            np.testing.assert_allclose(found[:, :, k], (high - low) / 2e-6, atol=1e-8)


# --- in C and in NumPy ------------------------------------------------------------------------------------


@pytest.mark.parametrize("t", [EVEN, UNEVEN])
def test_sums_in_c_are_those_in_numpy(t: np.ndarray, c_compiler: Compiler) -> None:
    rng, windows = np.random.default_rng(6), functions_on(t, 0.25).supports
    entries = _entries(len(t))
    kind = rng.integers(0, 3, len(entries.row))
    target = rng.integers(-1, 7, len(entries.row))  # several signals in one place, and some in none
    width = windows.weights.shape[2]
    felt = rng.standard_normal((len(windows.first), 3, width, 2))
    reach = max(np.searchsorted(windows.first, windows.first + width) - np.arange(len(windows.first)))
    bands = np.zeros((reach * 3, 3 * len(windows.first)))
    factor = np.asfortranarray(np.vstack([2.0 + rng.random((1, 50)), rng.standard_normal((4, 50))]))
    found = []
    for sums in (SumsInC(c_compiler), SumsInNumPy()):
        table, products = np.zeros((len(windows.first), 7)), bands.copy()
        sums.weighted(windows, entries, kind, target, table)
        sums.products(windows.first, felt, products)
        right = np.random.default_rng(7).standard_normal((50, 11))
        found.append((table, products, sums.solved(factor, right)))
    for in_c, in_numpy in zip(*found, strict=True):
        assert np.any(in_c)
        np.testing.assert_allclose(in_c, in_numpy, rtol=1e-12, atol=1e-12 * np.max(np.abs(in_numpy)))


def test_what_lies_outside_a_window_counts_for_nothing_whatever_it_is(c_compiler: Compiler) -> None:
    windows, entries = functions_on(EVEN, 0.25).supports, _entries(len(EVEN))
    entries.data[60:] = np.nan
    table = np.zeros((len(windows.first), 1))
    place = np.zeros(len(entries.row), dtype=np.intp)
    SumsInC(c_compiler).weighted(windows, entries, place, place, table)
    assert np.isfinite(table[windows.first + windows.weights.shape[2] <= 60]).all()


def test_groups_are_numbered_in_the_order_of_their_columns() -> None:
    run, block = np.array([1, 0, 1, 0, 1]), np.array([0.0, 2.0, -1.0, 2.0, 0.0])
    assert group_numbers(run, block).tolist() == [2, 0, 1, 0, 2]
    assert group_numbers(block).tolist() == [1, 2, 0, 2, 1]
    assert group_numbers(block[:0], run[:0]).size == 0
