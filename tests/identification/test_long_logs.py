"""Long logs: decimated without delay or alias, the segments that tell most, and memory that does not grow."""

from __future__ import annotations

import itertools
import tracemalloc
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from scipy.signal import lfilter

import undertow as ut
from tests.cli.bad import SURGE
from undertow.errors import UndertowError
from undertow.identification.api import fit
from undertow.identification.logs.chunks import LongLog
from undertow.identification.logs.mapping import LogMapping
from undertow.identification.logs.reading import read_log
from undertow.identification.logs.run import Run
from undertow.identification.long_logs.choosing import (
    FIT,
    SEARCH,
    Budget,
    at_full_rate,
    choose,
    most_informative,
    read_in_parts,
    too_long,
    with_errors_on_rest,
)
from undertow.identification.long_logs.decimation import Spool, band, decimated
from undertow.model.loading import load_vehicle
from undertow.model.vehicle import Vehicle

M, X_U = 100.0, -25.0  # of SURGE
RATE = 50.0
SMALL = Budget(1_500, 500)


@pytest.fixture(scope="module")
def vehicle(tmp_path_factory: pytest.TempPathFactory) -> Vehicle:
    path = tmp_path_factory.mktemp("hull") / "hull.toml"
    path.write_text(SURGE)
    return load_vehicle(path)


def surge(force: np.ndarray, drag: float = X_U, noise: float = 0.005) -> pl.DataFrame:
    """The exact answer of a linear hull to a force that is held from row to row."""
    a = np.exp(drag / M / RATE)
    u = lfilter([0.0, (1 - a) / -drag], [1.0, -a], force)
    u += noise * np.random.default_rng(1).standard_normal(len(u))
    return pl.DataFrame({"t": np.arange(len(u)) / RATE, "u": u, "tau_X": force})


def dull_but_for(active: list[slice], count: int, seed: int = 2) -> np.ndarray:
    """A small steady force, with steps every 3 s in some places."""
    random, force = np.random.default_rng(seed), np.full(count, 1.0)
    for place in active:
        length = place.stop - place.start
        force[place] = np.repeat(random.uniform(-50, 50, length // 150 + 1), 150)[:length]
    return force


def long_log(path: Path) -> LongLog:
    return LongLog(path, LogMapping(), ("tau_X",), required=True)


def written(table: pl.DataFrame, path: Path) -> Path:
    table.write_parquet(path)
    return path


def joined(parts: list[Run]) -> Run:
    channels = {n: np.concatenate([p.channels[n] for p in parts]) for n in parts[0].channels}
    return replace(parts[0], t=np.concatenate([p.t for p in parts]), channels=channels)


def in_parts(run: Run, rows: int) -> list[Run]:
    return [run.slice(run.t[i], run.t[min(i + rows, len(run.t)) - 1]) for i in range(0, len(run.t), rows)]


# --- decimation -------------------------------------------------------------------------------------


def test_a_thinned_ramp_has_no_delay() -> None:
    t = np.arange(1000) / 100
    thin = joined(list(decimated(in_parts(Run("ramp", t, {"u": 3.0 * t}), 130), 5, 0.01, [])))
    np.testing.assert_allclose(thin.channels["u"], 3.0 * thin.t, atol=1e-12)
    assert np.diff(thin.t) == pytest.approx(0.05)


@pytest.mark.parametrize("jitter", [0.0, 0.4])
@pytest.mark.parametrize("by", [3, 7])
def test_a_thinned_command_moves_a_mass_as_the_log_says(by: int, jitter: float) -> None:
    random = np.random.default_rng(0)
    t = (np.arange(1000) + jitter * random.uniform(-1, 1, 1000)) / 100
    force = np.repeat(random.uniform(-1, 1, 100), 10)  # steps anywhere in the blocks
    u = np.append(0.0, np.cumsum(force[:-1] * np.diff(t))) / M
    thin = joined(
        list(decimated(in_parts(Run("mass", t, {"u": u, "tau_X": force}), 130), by, 0.01, ["tau_X"]))
    )
    push = thin.channels["tau_X"][:-1] * np.diff(thin.t)
    np.testing.assert_allclose(M * np.diff(thin.channels["u"]), push, atol=1e-13)


def test_of_a_hull_that_is_thinned_no_more_than_noise_is_left(vehicle: Vehicle) -> None:
    random = np.random.default_rng(5)
    table = surge(np.repeat(random.uniform(-50, 50, 700), 57), noise=0.002)
    run = Run("log", table["t"].to_numpy(), {n: table[n].to_numpy() for n in ("u", "tau_X")})
    thin = joined(list(decimated([run], 9, 1 / RATE, ["tau_X"])))
    decay = np.exp(X_U / M * np.diff(thin.t))
    u, force = thin.channels["u"], thin.channels["tau_X"][:-1]
    error = u[1:] - decay * u[:-1] + (1 - decay) * force / X_U
    assert np.std(error) < 1.1 * np.sqrt(2) * 0.002 / 3


def test_thinning_in_parts_is_thinning_of_the_whole() -> None:
    rng, t = np.random.default_rng(3), np.arange(2000) / 100
    t[900:] += 5.0  # a gap
    heading = np.where(t < 10, t, 20 - t) % (2 * np.pi)
    run = Run(
        "log", t, {"psi": np.unwrap(heading), "u": rng.standard_normal(2000), "f": rng.standard_normal(2000)}
    )
    whole = joined(list(decimated([run], 7, 0.01, ["f"])))
    for rows in (50, 333, 1000):
        parts = joined(list(decimated(in_parts(run, rows), 7, 0.01, ["f"])))
        for name in ("psi", "u", "f"):
            np.testing.assert_allclose(parts.channels[name], whole.channels[name], atol=1e-10)
    step = np.diff(whole.t)
    assert np.sum(step > 5) == 1  # nothing is averaged over the gap
    assert step[step < 5] == pytest.approx(0.07)


def test_thinning_averages_noise_away_and_leaves_it_white() -> None:
    noise = np.random.default_rng(4).standard_normal(100_000)
    thin = joined(list(decimated([Run("noise", np.arange(100_000) / 100, {"u": noise})], 9, 0.01, [])))
    u = thin.channels["u"]
    assert np.std(u) == pytest.approx(1 / 3, rel=0.02)
    assert abs(np.corrcoef(u[1:], u[:-1])[0, 1]) < 0.03


def test_reports_now_and_then_are_moved_along_their_slope_not_invented() -> None:
    t = np.arange(3000) / 100
    sparse = np.where(np.arange(3000) % 23 == 0, 0.7 * t, np.nan)
    thin = joined(list(decimated([Run("dvl", t, {"u": sparse})], 5, 0.01, [])))
    there = np.isfinite(thin.channels["u"])
    assert there.sum() == np.isfinite(sparse).sum()
    np.testing.assert_allclose(thin.channels["u"][there], 0.7 * thin.t[there], atol=1e-9)


def test_what_never_changes_still_does_not() -> None:
    run = Run("still", np.arange(1000) / 100, {"u": np.full(1000, 0.1), "f": np.full(1000, 0.3)})
    thin = joined(list(decimated([run], 7, 0.01, ["f"])))
    assert set(thin.channels["u"]) == {0.1}
    assert set(thin.channels["f"]) == {0.3}


def test_the_band_is_that_of_the_fastest_time_constant(vehicle: Vehicle, tmp_path: Path) -> None:
    log = long_log(written(surge(dull_but_for([slice(0, 20_000)], 20_000)), tmp_path / "a.parquet"))
    found = band(vehicle, [log])
    assert found.fastest == pytest.approx(M / -X_U, rel=1e-6)
    assert found.step == pytest.approx(1 / RATE)
    assert found.factor == 25  # 0.5 s, the longest step


# --- the choice -----------------------------------------------------------------------------------


def information(seed: int, count: int = 9) -> np.ndarray:
    """A^T A of segments with one to four good directions, for two equations."""
    random = np.random.default_rng(seed)
    rows = random.standard_normal((count, 2, 12, 3)) * random.uniform(0.02, 1.0, (count, 2, 1, 3)) ** 2
    return np.einsum("kemi,kemj->keij", rows, rows)


def log_det(information: np.ndarray, chosen: tuple[int, ...]) -> float:
    return float(np.sum(np.linalg.slogdet(information[list(chosen)].sum(axis=0))[1]))


def test_the_greedy_choice_reaches_the_determinant_of_the_best_one() -> None:
    shares = []
    for seed in range(12):
        every = information(seed)
        choice = most_informative(every, [10] * len(every), 40)
        best = max(log_det(every, chosen) for chosen in itertools.combinations(range(len(every)), 4))
        reached = log_det(every, tuple(choice.places))
        assert len(choice.places) == 4
        whole = log_det(every, tuple(range(len(every))))
        assert choice.total_share == pytest.approx(np.exp((reached - whole) / 6), rel=1e-4)
        shares.append(np.exp((reached - best) / 6))  # of what could be known of each of six directions
    assert min(shares) > 0.85
    assert np.mean(shares) > 0.96


def test_information_that_no_stretch_has_is_not_counted() -> None:
    every = information(0)
    every[:, 1, 2, :] = every[:, 1, :, 2] = 0.0
    choice = most_informative(every, [10] * len(every), 10 * len(every))
    assert choice.total_share == pytest.approx(1.0, abs=1e-4)
    assert sorted(choice.places) == list(range(len(every)))


def test_a_search_takes_fewer_samples_as_they_are_than_a_fit(tmp_path: Path) -> None:
    path = written(surge(dull_but_for([], 120_000), drag=-20.0), tmp_path / "a.parquet")
    assert [too_long([long_log(path)], budget.whole) for budget in (SEARCH, FIT)] == [True, False]


def test_the_stretches_that_move_are_taken_and_the_fit_is_the_truth(vehicle: Vehicle, tmp_path: Path) -> None:
    active = [slice(40_000, 52_000), slice(150_000, 165_000), slice(301_000, 316_000)]
    path = written(surge(dull_but_for(active, 400_000), drag=-20.0), tmp_path / "a.parquet")
    assert too_long([long_log(path)], FIT.whole)
    chosen = choose(vehicle, [long_log(path)], budget=SMALL)
    times = np.concatenate([run.t for run in chosen.runs]) * RATE
    moving = np.any([(times > a.start) & (times < a.stop + 500) for a in active], axis=0)
    assert np.mean(moving) > 0.5  # of the log, a tenth moves
    done = fit(vehicle, chosen.runs, chosen.validation)
    row = done.parameters.row(by_predicate=pl.col("parameter") == "X_u", named=True)
    assert row["value"] == pytest.approx(-20.0, rel=0.01)
    found = with_errors_on_rest(chosen, {"as given": vehicle, "refitted": done.vehicle})
    assert found.rest is not None
    given, refitted = (m.error for m in found.rest.models)
    assert refitted < 0.2 * given
    used = sum(len(run.t) for run in (*chosen.runs, *chosen.validation))
    thin = sum(spool.rows for spool in chosen.spools)
    assert found.rest.samples + used == pytest.approx(thin, rel=0.01)


def test_what_judges_lies_apart_from_what_is_fitted(vehicle: Vehicle, tmp_path: Path) -> None:
    path = written(surge(dull_but_for([slice(0, 400_000)], 400_000)), tmp_path / "a.parquet")
    chosen = choose(vehicle, [long_log(path)], budget=SMALL)
    assert chosen.validation
    for judge in chosen.validation:
        for run in chosen.runs:
            apart = max(judge.t[0] - run.t[-1], run.t[0] - judge.t[-1])
            assert apart > 0.9 * chosen.result.seconds


def test_of_several_logs_one_is_kept_as_a_whole(vehicle: Vehicle, tmp_path: Path) -> None:
    logs = [
        long_log(written(surge(dull_but_for([slice(0, 90_000)], 90_000, seed)), tmp_path / f"{seed}.parquet"))
        for seed in (5, 6, 7)
    ]
    chosen = choose(vehicle, logs, budget=SMALL)
    assert {run.origin for run in chosen.validation} == {"7"}
    assert {run.origin for run in chosen.runs} == {"5", "6"}
    assert [log.holdout for log in chosen.result.logs] == [False, False, True]
    text = "\n".join(chosen.result.sentences())
    assert "used only for validation: 7" in text
    assert "of the information on the parameters" in text


def test_at_full_rate_the_rows_are_those_of_the_log(vehicle: Vehicle, tmp_path: Path) -> None:
    table = surge(dull_but_for([slice(100_000, 120_000)], 330_000))
    log = long_log(written(table, tmp_path / "a.parquet"))
    chosen = choose(vehicle, [log], budget=Budget(9_000, raw=True))
    for run in at_full_rate(chosen, [log]):
        rows = np.round(run.t * RATE).astype(int)
        np.testing.assert_array_equal(run.channels["u"], table["u"].to_numpy()[rows])
        assert np.all(np.diff(rows) == 1)


# --- memory, and what is refused ------------------------------------------------------------------


@pytest.mark.slow
def test_memory_does_not_grow_with_the_log(vehicle: Vehicle, tmp_path: Path) -> None:
    peaks = []
    for count in (200_000, 800_000):
        log = long_log(
            written(surge(dull_but_for([slice(0, count // 9)], count)), tmp_path / f"{count}.parquet")
        )
        choose(vehicle, [log], budget=SMALL)  # what is compiled and loaded once
        tracemalloc.start()
        try:
            chosen = choose(vehicle, [log], budget=SMALL)
            with_errors_on_rest(chosen, {"as given": vehicle})
            peaks.append(tracemalloc.get_traced_memory()[1])
        finally:
            tracemalloc.stop()
    assert peaks[1] < 1.3 * peaks[0]


def test_a_part_of_a_file_that_is_too_large_is_read(tmp_path: Path) -> None:
    count = 1_700_000
    more = {f"c{i}": pl.repeat(0.5, count) for i in range(30)}
    pl.select(t=pl.int_range(count) / 100, **more).write_parquet(tmp_path / "long.parquet")
    mapping = LogMapping.model_validate({"columns": {"c0": "u"}})
    run = ut.read_log(tmp_path / "long.parquet", mapping, window=(10_000.0, 10_002.0))
    np.testing.assert_allclose(run.t, np.arange(10_000.0, 10_002.005, 0.01))
    with pytest.raises(UndertowError, match=r"1700000 rows.*--from and --to.*`every`"):
        read_log(tmp_path / "long.parquet", mapping)


def test_parts_give_what_reading_the_whole_gives(tmp_path: Path) -> None:
    table = surge(dull_but_for([slice(0, 250_000)], 250_000)).with_columns(psi=(pl.col("t") * 0.7) % 6.283)
    path = written(table, tmp_path / "a.parquet")
    whole, parts = read_log(path, channels=["tau_X"]), read_in_parts(long_log(path))
    for name in ("u", "tau_X", "psi"):
        np.testing.assert_allclose(parts.channels[name], whole.channels[name], atol=1e-9)
    assert parts.sha256 == whole.sha256


@pytest.mark.parametrize("size", [10**10, 10**12])
def test_a_huge_file_is_refused_before_it_is_read(tmp_path: Path, size: int) -> None:
    path = tmp_path / "huge.csv"
    with path.open("wb") as file:
        file.write(b"t,u,f\n0,0,0\n")
        file.truncate(size)  # holds no block of the disk beyond the first
    tracemalloc.start()
    try:
        with pytest.raises(UndertowError, match=r"more than 500 MB.*--from and --to.*`every`"):
            read_log(path)
        assert tracemalloc.get_traced_memory()[1] < 1_000_000
    finally:
        tracemalloc.stop()


def test_a_sensor_slower_than_its_log_keeps_its_reports_when_it_is_thinned(tmp_path: Path) -> None:
    """Every sixth row has a report: what is decimated and kept knows these, and curves between them only."""
    t = np.arange(40_000) * 0.01
    u = np.where(np.arange(len(t)) % 6 == 0, np.sin(t), np.nan)
    table = {"t": t, "u": u, "r": np.cos(t), "tau_X": np.cos(t)}
    pl.DataFrame(table, nan_to_null=True).write_parquet(tmp_path / "slow.parquet")
    log = LongLog(tmp_path / "slow.parquet", LogMapping(), ("tau_X",))
    whole = read_in_parts(log)
    assert np.count_nonzero(whole.reported["u"]) == np.count_nonzero(np.isfinite(u))
    spool = Spool(
        (part.run for part in log.parts(7_000, 0)), partial(decimated, by=5, step=0.01, commands=["tau_X"])
    )
    kept = spool.run(100, 4_100)
    there = kept.reported["u"]
    assert 0.8 < np.mean(there) < 0.9  # five sixths of the blocks of five rows
    np.testing.assert_allclose(kept.channels["u"][there], np.sin(kept.t[there]), atol=5e-4)
    inside = np.isfinite(kept.channels["u"])
    np.testing.assert_allclose(kept.channels["u"][inside], np.sin(kept.t[inside]), atol=2e-3)
