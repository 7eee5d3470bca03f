"""Long logs in parts: the same answer as in one piece, and nothing that grows with the log."""

from __future__ import annotations

import gzip
import tracemalloc
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from tests.identification.surge import surge_vehicle
from tests.quick import first_quick
from undertow.errors import UndertowError
from undertow.identification.estimation.fitted import TriangularFactor
from undertow.identification.logs.chunks import LogPart, LongLog, long_logs
from undertow.identification.logs.mapping import LogMapping
from undertow.identification.logs.reading import read_log, read_logs
from undertow.identification.logs.run import Run
from undertow.paper.least_squares import (
    estimate,
    estimate_streaming,
    experiments,
    identify,
    identify_in_parts,
)
from undertow.paper.regression import CASES

VEHICLE = surge_vehicle()
STEP = 0.2


def long_log(count: int, gaps: bool = False) -> pl.DataFrame:
    """A velocity that is a sum of sines, the force that the truth needs for it, noise on both."""
    rng, t = np.random.default_rng(8), STEP * np.arange(count)
    waves = ((0.2, 0.31), (0.1, 1.17), (0.05, 2.9))
    u = sum(a * np.sin(w * t) for a, w in waves)
    rate = sum(a * w * np.cos(w * t) for a, w in waves)
    force = 9.13 * rate + 0.14 * u + 5.15 * np.abs(u) * u
    u = u + 0.003 * rng.standard_normal(count)
    if gaps:
        u[1000:1010] = np.nan
        u[count // 2 : count // 2 + 3] = np.nan
    return pl.DataFrame({"t": t, "u": u, "tau_X": force}, nan_to_null=True)


def written(frame: pl.DataFrame, path: Path) -> Path:
    if path.suffix == ".parquet":
        frame.write_parquet(path)
    elif path.suffix == ".gz":
        path.write_bytes(gzip.compress(frame.write_csv().encode()))
    else:
        frame.write_csv(path)
    return path


@pytest.mark.parametrize("name", first_quick(["long.csv", "long.csv.gz", "long.parquet"]))
def test_parts_give_the_answer_of_one_piece(tmp_path: Path, name: str) -> None:
    path = written(long_log(20_000, gaps=True), tmp_path / name)
    cases = list(CASES.values())
    (surge,) = experiments(VEHICLE, [read_log(path)])
    ((_, found),) = estimate_streaming(VEHICLE, [LongLog(path, LogMapping(), ("tau_X",))], cases, rows=3_000)
    for case, streamed in zip(cases, found, strict=True):
        whole = estimate(surge, case)
        assert streamed.samples == whole.samples
        np.testing.assert_allclose(streamed.theta, whole.theta, rtol=1e-10)
        np.testing.assert_allclose(streamed.covariance, whole.covariance, rtol=1e-9, atol=1e-20)
        assert streamed.residual_variance == pytest.approx(whole.residual_variance, rel=1e-10)


@pytest.mark.parametrize("edges", ["drop", "mirror"])
def test_what_filters_do_at_the_ends_is_done_at_the_ends_only(tmp_path: Path, edges) -> None:
    path = written(long_log(4_000), tmp_path / "long.csv")
    (surge,) = experiments(VEHICLE, [read_log(path)])
    log = LongLog(path, LogMapping(), ("tau_X",), window=(50.0, 700.0))
    whole = experiments(VEHICLE, [read_log(path, window=(50.0, 700.0))])[0]
    ((_, found),) = estimate_streaming(VEHICLE, [log], [CASES["11"]], edges, rows=700)
    np.testing.assert_allclose(found[0].theta, estimate(whole, CASES["11"], edges).theta, rtol=1e-10)
    assert found[0].samples < estimate(surge, CASES["11"], edges).samples


# Parts of 500 rows, of which the second shares 72 with the first for these cases.
_AROUND_A_BORDER = (429, 464, 500, 427, 445, 463, 465, 482, 498, 499, 501)


@pytest.fixture(scope="module")
def thousand(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(long_log(1_000), tmp_path_factory.mktemp("logs") / "long.parquet")


@pytest.mark.parametrize("side", ["from", "to"])
@pytest.mark.parametrize("row", first_quick(_AROUND_A_BORDER, 3))
def test_a_window_may_begin_and_end_where_parts_overlap(thousand: Path, row: int, side: str) -> None:
    cases = [CASES["2"], CASES["11"]]
    window = (STEP * (row - 0.5), None) if side == "from" else (None, STEP * (row + 0.5))
    log = LongLog(thousand, LogMapping(), ("tau_X",), window=window)
    (surge,) = experiments(VEHICLE, [read_log(thousand, window=window)])
    ((_, found),) = estimate_streaming(VEHICLE, [log], cases, rows=500)
    for case, streamed in zip(cases, found, strict=True):
        whole = estimate(surge, case)
        assert streamed.samples == whole.samples
        np.testing.assert_allclose(streamed.theta, whole.theta, rtol=1e-9)


@pytest.mark.parametrize("policy", ["hold", "gap"])
@pytest.mark.parametrize(
    ("channel", "first", "stop"),
    [
        ("tau_X", 452, 460),
        ("tau_X", 297, 303),
        ("tau_X", 90, 1400),
        ("tau_X", 0, 5),
        ("u", 400, 1300),
        ("v", 3, 1500),
    ],
)
def test_what_is_missing_for_long_is_missing_in_parts_too(
    tmp_path: Path, policy, channel: str, first: int, stop: int
) -> None:
    """Across a border of two parts, over whole parts, and in a channel that nobody needs."""
    frame = long_log(1_500).with_columns(v=pl.lit(0.01))
    values = frame[channel].to_numpy().copy()
    values[first:stop] = np.nan
    path = written(frame.with_columns(pl.Series(channel, values, nan_to_null=True)), tmp_path / "long.csv")
    (surge,) = experiments(VEHICLE, [read_log(path, missing_commands=policy)])
    log = LongLog(path, LogMapping(), ("tau_X",), missing_commands=policy)
    ((_, (streamed,)),) = estimate_streaming(VEHICLE, [log], [CASES["11"]], rows=300)
    whole = estimate(surge, CASES["11"])
    assert streamed.samples == whole.samples
    np.testing.assert_allclose(streamed.theta, whole.theta, rtol=1e-8)


def test_what_a_log_in_parts_lacks_is_reported_as_for_the_whole(tmp_path: Path) -> None:
    frame = long_log(1_500)
    force = frame["tau_X"].to_numpy().copy()
    force[700:705] = np.nan
    lacking = frame.with_columns(pl.Series("tau_X", force, nan_to_null=True))
    for table, fill, said in (
        (
            frame.with_columns(v=pl.lit(None, dtype=pl.Float64)),
            None,
            "channel 'v' has no value in any of 1500",
        ),
        (lacking, None, r"part from t = 120 to 179.8 s: command 'tau_X' is missing in 5 of 300 rows"),
        (frame.rename({"t": "seconds"}), None, "has no time column 't'"),
    ):
        log = LongLog(written(table, tmp_path / "long.csv"), LogMapping(), ("tau_X",), missing_commands=fill)
        with pytest.raises(UndertowError, match=said):
            estimate_streaming(VEHICLE, [log], [CASES["11"]], rows=300)


@pytest.mark.slow
def test_two_hundred_thousand_rows_in_constant_memory(tmp_path: Path) -> None:
    frame = long_log(200_000)
    cases = [CASES["2"], CASES["11"]]
    peaks = []
    for count in (100_000, 200_000):
        path = written(frame.head(count), tmp_path / f"long{count}.csv")
        log = LongLog(path, LogMapping(), ("tau_X",))
        tracemalloc.start()
        ((_, found),) = estimate_streaming(VEHICLE, [log], cases, rows=2_500)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    # Twice the rows, the same memory; in one piece they would take twice as much.
    assert peaks[1] < 1.15 * peaks[0]
    (surge,) = experiments(VEHICLE, [read_log(path)])
    for case, streamed in zip(cases, found, strict=True):
        whole = estimate(surge, case)
        assert streamed.samples == whole.samples == 200_000
        np.testing.assert_allclose(streamed.theta, whole.theta, rtol=1e-10)


def test_a_triangle_holds_no_more_than_its_factor() -> None:
    rng = np.random.default_rng(0)
    triangle, H, y = TriangularFactor(3), [], []
    for _ in range(50):
        H.append(rng.standard_normal((40, 3)) * [1.0, 1e4, 1e-3])
        y.append(rng.standard_normal(40))
        triangle.add(np.column_stack([H[-1], y[-1]]), 40)
        assert triangle.factor.shape == (4, 4)
    left, right = triangle.split()
    exact = np.linalg.lstsq(np.vstack(H), np.concatenate(y), rcond=None)[0]
    np.testing.assert_allclose(np.linalg.lstsq(left, right, rcond=None)[0], exact, rtol=1e-10)
    assert triangle.count == 2000


@pytest.mark.parametrize("name", first_quick(["long.csv", "long.csv.gz", "long.parquet"]))
def test_every_so_many_th_row_in_parts_is_that_of_the_whole(tmp_path: Path, name: str) -> None:
    path = written(long_log(3_001), tmp_path / name)
    mapping = LogMapping.model_validate({"time": {"every": 7}})
    whole = read_log(path, mapping, ["tau_X"])
    for rows, overlap in ((100, 0), (64, 10), (1000, 0)):
        _assert_parts_are_the_whole(LongLog(path, mapping, ("tau_X",)).parts(rows, overlap), overlap, whole)


def _assert_parts_are_the_whole(parts: Iterable[LogPart], overlap: int, whole: Run) -> None:
    first, *others = (part.run for part in parts)
    fresh = [first, *(p.slice(p.t[overlap]) for p in others)]
    np.testing.assert_array_equal(np.concatenate([p.t for p in fresh]), whole.t)
    np.testing.assert_array_equal(np.concatenate([p.channels["u"] for p in fresh]), whole.channels["u"])


@pytest.mark.parametrize("name", ["long.csv", "long.csv.gz", "long.parquet"])
def test_rows_of_a_stated_interval_are_counted_over_the_whole_log(tmp_path: Path, name: str) -> None:
    path = written(long_log(1_001).drop("t"), tmp_path / name)
    for every in (1, 3):
        mapping = LogMapping.model_validate({"time": {"interval": "0.05 s", "every": every}})
        whole = read_log(path, mapping, ["tau_X"])
        np.testing.assert_allclose(whole.t, 0.05 * np.arange(0, 1_001, every), rtol=1e-12)
        for rows, overlap in ((90, 0), (100, 20)):
            parts = LongLog(path, mapping, ("tau_X",)).parts(rows, overlap)
            _assert_parts_are_the_whole(parts, overlap, whole)


@pytest.mark.parametrize("name", ["long.csv", "long.parquet"])
def test_dates_in_parts_count_from_the_first_of_the_log(tmp_path: Path, name: str) -> None:
    table = long_log(500).with_columns(
        t=pl.datetime(2026, 3, 1, time_unit="ns") + pl.duration(milliseconds=pl.col("t") * 1e3)
    )
    path = written(table, tmp_path / name)
    mapping = LogMapping.model_validate({"time": {"unit": "iso"}})
    parts = [part.run for part in LongLog(path, mapping, ("tau_X",)).parts(90, 0)]
    np.testing.assert_array_equal(np.concatenate([p.t for p in parts]), read_log(path, mapping).t)


@pytest.mark.parametrize("overlap", [0, 60])
def test_times_of_day_in_parts_go_on_after_midnight(tmp_path: Path, overlap: int) -> None:
    table = long_log(500)
    times = pl.datetime(2025, 11, 12, 23, 59, 50) + pl.duration(milliseconds=pl.col("t") * 1e3)
    path = written(table.with_columns(t=times.dt.strftime("%H:%M:%S%.3f")), tmp_path / "long.csv")
    mapping = LogMapping.model_validate({"time": {"unit": "iso"}})
    whole = read_log(path, mapping).t
    np.testing.assert_allclose(whole, table["t"].to_numpy(), atol=1e-3)
    for part in LongLog(path, mapping, ("tau_X",)).parts(200, overlap):
        np.testing.assert_array_equal(part.run.t, whole[np.isin(whole, part.run.t)])


def test_dates_that_are_read_in_another_order_from_part_to_part_are_refused(tmp_path: Path) -> None:
    """12 November, month first; 13 November shows only in the second part that the day is not 11."""
    table = long_log(500)
    times = pl.datetime(2025, 11, 12, 23, 59) + pl.duration(milliseconds=pl.col("t") * 1e3)
    table = table.with_columns(t=times.dt.strftime("%m/%d/%Y %H:%M:%S%.3f"))
    path = written(table, tmp_path / "long.csv")
    mapping = LogMapping.model_validate({"time": {"unit": "iso"}})
    assert np.all(np.diff(read_log(path, mapping).t) > 0)
    for overlap in (0, 60):
        with pytest.raises(UndertowError, match="time column 't' goes back"):
            list(LongLog(path, mapping, ("tau_X",)).parts(200, overlap))


def test_reports_now_and_then_are_in_parts_what_they_are_in_the_whole(tmp_path: Path) -> None:
    table = long_log(3_000)
    held = table["u"].gather(np.arange(3_000) // 6 * 6)
    path = written(table.with_columns(u=held), tmp_path / "held.csv")
    mapping = LogMapping.model_validate({"columns": {"u": {"channel": "u", "fresh": "u"}}})
    run = read_log(path, mapping, ["tau_X"])
    t, whole = run.t, run.channels["u"]
    begin, count = -np.inf, 0
    for run, border in LongLog(path, mapping, ("tau_X",)).parts(500, 60):
        own = (run.t > begin) & (run.t <= border) & np.isfinite(run.channels["u"])
        places = np.searchsorted(t, run.t[own])
        np.testing.assert_allclose(run.channels["u"][own], whole[places], rtol=1e-12)
        begin, count = border, count + int(np.sum(own))
    assert count >= 3_000 - 60 - 6  # the end of the last part belongs to a part after it


def test_rows_out_of_order_between_parts_are_left_out_or_refused(tmp_path: Path) -> None:
    table = long_log(400)
    again = pl.concat([table.head(200), table.slice(150)])  # fifty rows twice, across the end of a part
    path = written(again, tmp_path / "again.csv")
    drop = LogMapping.model_validate({"time": {"disorder": "drop"}})
    parts = [part.run for part in LongLog(path, drop, ("tau_X",)).parts(100, 0)]
    np.testing.assert_array_equal(np.concatenate([p.t for p in parts]), table["t"])
    assert sum(p.dropped for p in parts) == read_log(path, drop).dropped == 50
    with pytest.raises(UndertowError, match=r"goes back from 39\.8 to 30 s"):
        list(LongLog(path, LogMapping(), ("tau_X",)).parts(100, 0))


def test_a_log_that_is_not_there_is_reported(tmp_path: Path) -> None:
    with pytest.raises(UndertowError, match="does not exist"):
        estimate_streaming(VEHICLE, [LongLog(tmp_path / "no.csv", LogMapping(), ())], [CASES["2"]])


def test_stretches_of_a_log_are_taken_apart_in_parts_too(tmp_path: Path) -> None:
    table = long_log(6_000).with_row_index("leg").with_columns(pl.col("leg") // 3_000)
    path, mapping = (
        written(table, tmp_path / "long.parquet"),
        LogMapping.model_validate({"time": {"stretch": "leg"}}),
    )
    logs = long_logs(path, mapping, ("tau_X",))
    ((experiment, streamed),) = identify_in_parts(VEHICLE, logs, "2").found
    assert [run.name for run in experiment.runs] == ["long-1", "long-2"]
    (whole,) = identify(VEHICLE, read_logs([path], VEHICLE, mapping, one_motion=True), "2").found[0][1]
    np.testing.assert_allclose(streamed[0].theta, whole.theta, rtol=1e-10)
    with pytest.raises(UndertowError, match="is given twice"):
        identify_in_parts(VEHICLE, [*logs, logs[0]], "2")
