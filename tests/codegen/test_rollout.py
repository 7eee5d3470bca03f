"""Runs side by side: lanes and threads against runs one by one, and runs that diverge."""

from __future__ import annotations

import logging
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.codegen.support import BUNDLED, functions_of, random_parameters
from tests.quick import first_quick
from undertow import UndertowError
from undertow.codegen import Functions, Simulator
from undertow.codegen.compiler import LANES, Compiler, plain_c
from undertow.codegen.engine import (
    LANES_HEADER,
    in_threads,
    packed,
    processors,
    rollout_source,
    shares,
    unpacked,
)
from undertow.codegen.simulate import StepSettings

RUNS = 11


def simulator(functions: Functions, lanes: int, monkeypatch: pytest.MonkeyPatch) -> Simulator:
    """A simulator that puts so many runs side by side, whatever the processor has."""
    monkeypatch.setattr(Compiler, "lanes", property(lambda self: lanes))
    return Simulator(functions, compiled=True)


def batch(functions: Functions, samples: int = 8) -> tuple[np.ndarray, ...]:
    """First states, times, inputs and parameters of runs that share nothing."""
    rng = np.random.default_rng(RUNS)
    t = np.cumsum(rng.uniform(0, 0.2, (RUNS, samples)), axis=1)
    x0 = 0.2 * rng.normal(size=(RUNS, len(functions.state_names)))
    u = rng.normal(size=(RUNS, samples, functions.u.numel()))
    return x0, t, u, np.array([random_parameters(functions, k) for k in range(RUNS)])


@pytest.mark.parametrize("lanes", first_quick([8, 4]))
@pytest.mark.parametrize("name", first_quick([*BUNDLED, "full"]))
def test_lanes_are_runs_one_by_one(
    name: str, lanes: int, c_compiler: Compiler, monkeypatch: pytest.MonkeyPatch
) -> None:
    functions = functions_of(name)
    x0, t, u, p = batch(functions)
    found = simulator(functions, lanes, monkeypatch).run(x0, t, u, p)
    # As a batch, too: the fastest run decides how short the steps of all are.
    alone = simulator(functions, 1, monkeypatch).run(x0, t, u, p)
    assert np.isfinite(alone).all()
    np.testing.assert_allclose(found, alone, rtol=1e-12, atol=1e-12 * np.abs(alone).max())
    virtual = Simulator(functions, compiled=False).run(x0, t, u, p)
    np.testing.assert_allclose(found, virtual, rtol=1e-11, atol=1e-11 * np.abs(virtual).max())


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_threads_change_nothing(threads: int, c_compiler: Compiler, monkeypatch: pytest.MonkeyPatch) -> None:
    functions = functions_of("bluerov2")
    x0, t, u, p = batch(functions)
    runs = simulator(functions, 4, monkeypatch)
    expected = runs.run(x0, t, u, p, threads=1)
    assert np.array_equal(runs.run(x0, t, u, p, threads=threads), expected)


def test_what_runs_share_may_be_given_once(c_compiler: Compiler, monkeypatch: pytest.MonkeyPatch) -> None:
    functions = functions_of("mini-auv")
    x0, t, u, p = batch(functions)
    runs = simulator(functions, 8, monkeypatch)
    repeated = [np.repeat(a[:1], RUNS, axis=0) for a in (t, u, p)]
    assert np.array_equal(runs.run(x0, t[0], u[0], p[0]), runs.run(x0, *repeated))


@pytest.mark.parametrize("lanes", first_quick([8, 4, 1]))
def test_a_run_that_diverges_leaves_the_others_alone(
    lanes: int, c_compiler: Compiler, monkeypatch: pytest.MonkeyPatch
) -> None:
    functions = functions_of("bluerov2")
    x0, t, u, p = batch(functions)
    runs = simulator(functions, lanes, monkeypatch)
    good = runs.run(x0, t, u, p)
    p[3, functions.parameter_names.index("X_u")] = 1e6
    x0[5] = np.nan
    found = runs.run(x0, t, u, p)
    others = [i for i in range(RUNS) if i not in (3, 5)]
    assert np.array_equal(found[others], good[others])
    assert np.isnan(found[3, -1]).all()
    assert np.isnan(found[5, 1:]).all()
    gone = np.isnan(found[3]).any(axis=1)
    assert not gone[0]
    assert np.array_equal(gone, np.isnan(found[3]).all(axis=1))
    assert (np.diff(gone.astype(int)) >= 0).all()


def test_a_run_that_is_cut_short_is_the_same(c_compiler: Compiler, monkeypatch: pytest.MonkeyPatch) -> None:
    functions = functions_of("mini-auv")
    x0, t, u, p = batch(functions)
    runs = simulator(functions, 4, monkeypatch)
    at_once = runs.run(x0, t, u, p)
    monkeypatch.setattr("undertow.codegen.simulate.SETTINGS", StepSettings(per_call=20))
    assert np.array_equal(runs.run(x0, t, u, p), at_once)


def test_no_thread_is_refused() -> None:
    with pytest.raises(UndertowError, match="threads = 0: give one at least"):
        in_threads(lambda part: None, [1], 0)


def test_a_fault_in_a_thread_is_reported() -> None:
    def work(part: int) -> None:
        if part == 3:
            raise UndertowError("no")

    with pytest.raises(UndertowError, match="no"):
        in_threads(work, range(8), 2)


@pytest.mark.parametrize("lanes", first_quick([8, 4, 1]))
def test_packing_is_undone(lanes: int) -> None:
    array = np.arange(11 * 3 * 2, dtype=float).reshape(11, 3, 2)
    side_by_side = packed(array, lanes)
    assert side_by_side.shape == (-(-11 // lanes), 3, 2, lanes)
    assert np.array_equal(unpacked(side_by_side, 11), array)


@pytest.mark.parametrize(("runs", "work"), [(1, 10), (1000, 2000), (17, 1e9), (10_000, 1)])
def test_shares_are_whole_groups_of_all_runs(runs: int, work: float) -> None:
    found = shares(runs, work, 2, 8)
    assert [i for s in found for i in range(s.start, s.stop)] == list(range(runs))
    assert all((s.stop - s.start) % 8 == 0 for s in found[:-1])


def test_compilers_without_vectors_have_one_lane(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        assert Compiler(("cl",), "Microsoft").lanes == 1
        assert Compiler(("no-such-compiler",), "").lanes == 1
    assert not caplog.records


def test_code_for_this_machine_has_a_name_of_its_own(c_compiler: Compiler) -> None:
    local = c_compiler.for_this_machine()
    assert local.identity != c_compiler.identity
    assert replace(local, more=()).identity != c_compiler.identity


def test_the_environment_says_how_many_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    for said, taken in (("1", 1), ("7", 7), ("0", 1)):
        monkeypatch.setenv("UNDERTOW_JOBS", said)
        assert processors() == taken
    monkeypatch.setenv("UNDERTOW_JOBS", "many")
    assert 1 <= processors() <= (os.cpu_count() or 1)


@pytest.mark.parametrize("part", ["dynamics", "rollout"])
def test_one_run_keeps_out_of_512_bit_registers(part: str, c_compiler: Compiler, tmp_path: Path) -> None:
    """Also on a processor that GCC does not know: a single 512-bit instruction halves the speed on Intel."""
    functions = functions_of("bluerov2")
    sources = {
        "dynamics": lambda: (
            LANES_HEADER + plain_c(functions.prepared.dynamics, "f", words=LANES, shared=("t",))
        ),
        "rollout": lambda: rollout_source(functions, 1)[0],
    }
    (tmp_path / "model.c").write_text(sources[part](), encoding="utf-8")
    stranger = replace(c_compiler, command=(*c_compiler.command, "-mtune=generic")).for_this_machine("-S")
    if stranger.lanes < 8:
        pytest.skip("a processor without 512-bit vectors")
    stranger.build(tmp_path / "model.c", tmp_path / "model.s")
    assembly = (tmp_path / "model.s").read_text(encoding="utf-8")
    assert "%ymm" in assembly
    assert "%zmm" not in assembly
