"""Sums of products for Gauss-Newton steps: as those of simulated sensitivities, compiled and not."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
import sympy as sm

from tests.codegen.support import functions_of, random_parameters, vehicle_with
from tests.quick import first_quick
from undertow.codegen import Functions, Simulator
from undertow.codegen.compiler import Compiler

# Private: counts of windows beside a multiple of the lanes.
from undertow.codegen.engine import Products, shares, tangents_source
from undertow.model.effect import Wrench
from undertow.model.symbols import Signals
from undertow.model.vehicle import Vehicle

# A vehicle of six motions, one with states of its own, one whose forces depend on time, and every effect.
VEHICLES = ("bluerov2", "radiation_memory", "supply_droop", "full")


@dataclass
class Case:
    """Two windows of one vehicle."""

    functions: Functions
    x0: np.ndarray
    t: np.ndarray
    u: np.ndarray
    p: np.ndarray
    places: list[int]
    measured: np.ndarray
    weight: np.ndarray
    group: np.ndarray

    def products(self, compiled: bool) -> Products:
        simulator = Simulator(self.functions, compiled=compiled)
        problem = (self.x0, self.t, self.u, self.p, self.places)
        return simulator.products(*problem, self.measured, self.weight, self.group)


def case(name: str, free: int = 11, seed: int = 0) -> Case:
    functions, rng = functions_of(name), np.random.default_rng(seed)
    size, n = 2 * functions.nu_dot.numel(), 14
    t = np.cumsum(rng.uniform(0.02, 0.12, (2, n)), axis=1)
    t[1, 10:] = t[1, 9]  # a window that is shorter, padded
    measured = rng.uniform(-0.4, 0.4, (2, n, size))
    weight = rng.uniform(0.5, 2.0, (2, n, size))
    weight[1, 10:] = 0.0
    weight[0, 3, 1] = 0.0
    measured[0, 3, 1] = np.nan
    return Case(
        functions,
        rng.uniform(-0.3, 0.3, (2, len(functions.state_names))),
        t,
        rng.uniform(-1, 1, (2, n, functions.u.numel())),
        random_parameters(functions, seed),
        [int(i) for i in rng.choice(functions.p.numel(), min(free, functions.p.numel()), replace=False)],
        measured,
        weight,
        np.repeat([0, 0, 1, 2], [4, 3, 4, 3])[None].repeat(2, axis=0),
    )


def rows(given: Case) -> np.ndarray:
    """Weighted derivatives and error at every sample, (b, n, channels, m + 1)."""
    size = given.measured.shape[2]
    x, s = Simulator(given.functions, compiled=False).run_with_sensitivities(
        given.x0, given.t, given.u, given.p, given.places, initial=range(size)
    )
    error = np.where(given.weight > 0, (x[..., :size] - given.measured) * given.weight, 0.0)
    return np.concatenate([s[:, :, :size] * given.weight[..., None], error[..., None]], axis=3)


@pytest.mark.parametrize("name", first_quick(VEHICLES, 2))
@pytest.mark.parametrize("compiled", [True, False])
def test_sums_are_those_of_sensitivities(name: str, compiled: bool, c_compiler: Compiler) -> None:
    given = case(name)
    table = rows(given)
    found = given.products(compiled)
    assert not found.diverged
    assert found.table.shape[1] == 3
    for g in range(3):
        own = np.where((given.group == g)[:, :, None, None], table, 0.0).reshape(2, -1, table.shape[3])
        expected = np.swapaxes(own, 1, 2) @ own
        # Motions that one part of a window does not feel are rounding.
        scale = np.maximum(np.sqrt(np.einsum("bii->bi", expected)), 1e-9)
        apart = np.abs(found.table[:, g] - expected) / (scale[:, :, None] * scale[:, None, :])
        assert apart.max() < 1e-11
    np.testing.assert_allclose(found.squares, np.sum(table[..., -1] ** 2, axis=1), rtol=1e-11)


@pytest.mark.parametrize("free", first_quick([0, 1, 20]))
def test_any_number_of_parameters(free: int, c_compiler: Compiler) -> None:
    given = case("bluerov2", free)
    ours, theirs = given.products(True), given.products(False)
    np.testing.assert_allclose(ours.table, theirs.table, rtol=1e-10, atol=1e-12 * np.abs(theirs.table).max())


@pytest.mark.parametrize("threads", ["1", "3"])
def test_windows_in_threads_are_summed_as_one_by_one(
    threads: str, c_compiler: Compiler, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("UNDERTOW_JOBS", threads)
    few, names, times = case("bluerov2"), ("x0", "t", "u", "measured", "weight", "group"), 200
    given = replace(few, **{n: np.concatenate([getattr(few, n)] * times) for n in names})
    given.x0 += np.linspace(0.0, 0.1, 2 * times)[:, None]
    calls = shares(2 * times, 13.0 * (len(given.places) + 12), None, 8)
    assert len(calls) > 2, "not all in one call"
    found = given.products(True)
    for k in (0, 1, calls[1].start, 2 * times - 1):
        one = {n: getattr(given, n)[k : k + 1] for n in names}
        alone = replace(given, **one).products(True)
        np.testing.assert_array_equal(found.table[k], alone.table[0])
        np.testing.assert_array_equal(found.squares[k], alone.squares[0])


@pytest.mark.parametrize("compiled", [True, False])
def test_a_window_that_diverges_is_reported(compiled: bool, c_compiler: Compiler) -> None:
    given = case("bluerov2")
    given.x0[1, 6:] = 1e200
    assert given.products(compiled).diverged


@pytest.mark.parametrize("compiled", [True, False])
def test_sums_that_overflow_are_reported_as_divergence(compiled: bool, c_compiler: Compiler) -> None:
    """Finite states and finite derivatives whose products are not."""
    given = case("bluerov2")
    given.weight[0, 1] = 1e160
    assert given.products(compiled).diverged


class Swelling(Wrench):
    """A mass that grows with the speed, which the catalogue has none of."""

    id = "swelling"
    family = "inertia"
    reference = "none: for a test"

    def wrench(self, s: Signals) -> sm.Matrix:
        return sm.Matrix([-3 * s.nu[0] ** 2 * s.nu_dot[0], 0, 0, 0, 0, 0])


def test_a_mass_matrix_that_moves_is_inverted_at_every_stage(c_compiler: Compiler) -> None:
    steady = "#define STEADY"
    assert all(steady in tangents_source(functions_of(name), [0])[0] for name in VEHICLES)
    base = vehicle_with(dofs=("surge",), thrusters=1)
    vehicle = Vehicle("swelling", ("surge",), (*base.effects, Swelling(())), {}, base.thrusters)
    functions = Functions(vehicle)
    assert steady not in tangents_source(functions, [0])[0]
    given = replace(
        case("bluerov2"),
        functions=functions,
        x0=np.array([[0.0, 0.4], [0.0, -0.7]]),
        u=np.random.default_rng(1).uniform(-9, 9, (2, 14, functions.u.numel())),
        p=random_parameters(functions, 5),
        places=[0, 1],
        measured=np.zeros((2, 14, 2)),
        weight=np.ones((2, 14, 2)),
    )
    ours, theirs = given.products(True), given.products(False)
    np.testing.assert_allclose(ours.table, theirs.table, rtol=1e-10, atol=1e-12 * np.abs(theirs.table).max())


def test_shared_inputs_are_read_for_every_window(c_compiler: Compiler) -> None:
    given = case("bluerov2")
    given.t, given.u = given.t[:1], given.u[:1]
    given.p = given.p[None]
    given.weight[1] = given.weight[0]
    ours, theirs = given.products(True), given.products(False)
    np.testing.assert_allclose(ours.table, theirs.table, rtol=1e-10, atol=1e-12 * np.abs(theirs.table).max())
