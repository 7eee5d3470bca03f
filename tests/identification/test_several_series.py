"""Logs whose sensors report at rates of their own: what was measured counts, where it was measured."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from benchmarks.hidden_effects import make_case
from tests.identification.logs_of import runs_of, vehicle_of
from tests.identification.several import CURRENT, NOISE, Dive, model, truth, written
from tests.quick import first_quick
from undertow.errors import UndertowError
from undertow.identification.comparison import compare
from undertow.identification.diagnose import diagnose
from undertow.identification.doctor.examine import examine
from undertow.identification.doctor.forces import Forces
from undertow.identification.estimation.data import prepare
from undertow.identification.estimation.output_error import fit_output_error
from undertow.identification.estimation.prediction_error import fit_prediction_error
from undertow.identification.estimation.weak_form import fit_weak
from undertow.identification.estimation.windows import cut
from undertow.identification.logs.chunks import LongLog
from undertow.identification.logs.mapping import LogMapping
from undertow.identification.logs.pose_velocity import velocities_from_pose
from undertow.identification.logs.reading import read_log
from undertow.identification.logs.run import Run
from undertow.identification.report.page import traces
from undertow.model.catalogue import catalogue
from undertow.model.vehicle import Value, Vehicle

MOTION = tuple(NOISE)


@pytest.fixture(scope="module")
def dives() -> list[Dive]:
    return [Dive(seed) for seed in range(3)]


@pytest.fixture(scope="module")
def union(dives: list[Dive], tmp_path_factory: pytest.TempPathFactory) -> list[Run]:
    """Every sensor on a clock of its own, blank cells in between."""
    folder = tmp_path_factory.mktemp("union")
    return [_read(written(d.table(), folder / f"union{i}.csv")) for i, d in enumerate(dives)]


@pytest.fixture(scope="module")
def dense(dives: list[Dive], tmp_path_factory: pytest.TempPathFactory) -> list[Run]:
    """The same dives with every channel in every row, 50 times a second."""
    folder = tmp_path_factory.mktemp("dense")
    return [_read(written(d.dense(), folder / f"dense{i}.parquet")) for i, d in enumerate(dives)]


def _read(path: Path, mapping: LogMapping | None = None) -> Run:
    return read_log(path, mapping, channels=model().command_names)


def _with_current() -> Vehicle:
    start = {n: Value(0.0, estimate=True) for n in CURRENT}
    return model().with_effect(catalogue()["ocean_current"], start)


# --- reading --------------------------------------------------------------------------------------
@pytest.mark.parametrize("late", [0.004, 0.012])
def test_topics_written_one_after_the_other_are_one_clock_whatever_is_derived(
    late: float, tmp_path: Path
) -> None:
    """Step and forces are those of the sensors, beside a sway velocity of all rows; no unit is doubted."""
    case = make_case("usv", (), 2, duration=60.0, runs=("multisine",))
    vehicle, (plain,) = vehicle_of(case), runs_of(case)
    whole = pl.DataFrame({"t": plain.t - plain.t[0], **plain.channels})
    topics = [("x", "y", "psi"), ("u", "r"), vehicle.command_names]
    parts = [whole.select(pl.col("t") + late * k, *names) for k, names in enumerate(topics)]
    table = pl.concat(parts, how="diagonal").sort("t")
    path = written(table, tmp_path / "log.parquet")
    run = velocities_from_pose(read_log(path, LogMapping(missing_commands="hold"), vehicle.command_names))
    assert run.derived == {"v"}
    assert run.step == pytest.approx(plain.step, rel=0.02)
    tables = [Forces(vehicle).table([one], 4000) for one in (run, plain)]
    sizes = [np.sqrt(np.mean(one.force**2, axis=0)) for one in tables if one is not None]
    np.testing.assert_allclose(sizes[0][::2], sizes[1][::2], rtol=0.03)  # surge and yaw
    found = examine(vehicle, [run]).result.findings
    assert [f.text for f in found if f.severity == "mistake"] == []


def test_rows_are_those_of_the_fastest_sensor_and_few_more(dives: list[Dive], union: list[Run]) -> None:
    run, table = union[0], dives[0].table()
    reports = run.reported["psi"].sum()
    assert run.step == pytest.approx(0.02, rel=0.02)
    assert reports == table["psi"].drop_nulls().len()
    assert len(run.t) < reports + 0.6 * (398 + 558)
    assert len(run.segments([*MOTION, "f1", "f2", "f3", "f4"])) == 1


def test_every_report_stands_within_reach_of_its_time(dives: list[Dive], union: list[Run]) -> None:
    """What a report is moved by can be seen in it by a third of its noise at most."""
    for name in ("x", "u", "r"):
        run = union[0]
        there = run.reported[name]
        values = dict(zip(run.channels[name][there], run.t[there], strict=True))
        table = dives[0].table().select("t", name).drop_nulls()
        moved = [abs(values[y] - t) for t, y in table.iter_rows() if y in values]
        assert len(moved) == there.sum()
        speed = np.sqrt(np.mean(np.gradient(dives[0].motion[name], dives[0].t) ** 2))
        assert max(moved) * speed < 0.35 * NOISE[name]


def test_the_noise_is_that_of_the_reports(union: list[Run]) -> None:
    for name, sigma in NOISE.items():
        assert union[0].sigma[name] == pytest.approx(sigma, rel=0.12)


def test_a_row_has_the_mean_of_what_was_commanded_until_the_next(dives: list[Dive], union: list[Run]) -> None:
    """So the impulse of a command is kept, whenever it was given."""
    run, dive = union[0], dives[0]
    given = np.concatenate([[0.0], np.cumsum(dive.commands["f2"] / 10.0)])
    edges = np.append(dive.at_command, dive.at_command[-1] + 0.1)
    impulse = np.interp(run.t, edges, given)
    found = np.append(0.0, np.cumsum(run.channels["f2"][:-1] * np.diff(run.t)))
    np.testing.assert_allclose(found, impulse - impulse[0], atol=1e-9)


def test_a_slow_column_with_blanks_is_the_same_as_one_with_a_flag(dives: list[Dive], tmp_path: Path) -> None:
    table = dives[0].dense(20.0).with_row_index("row")
    every = pl.col("row") % 4 == 0
    flagged = table.with_columns(*(pl.when(every).then(pl.col(n)).forward_fill().alias(n) for n in "uvw"))
    blank = table.with_columns(*(pl.when(every).then(pl.col(n)).alias(n) for n in "uvw"))
    flags = {n: {"channel": n, "fresh": "new"} for n in "uvw"}
    mapping = LogMapping.model_validate({"columns": flags, "ignore": ["row", "new"]})
    with_flag = _read(written(flagged.with_columns(every.alias("new")), tmp_path / "a.parquet"), mapping)
    with_blanks = _read(written(blank, tmp_path / "b.parquet"))
    assert with_flag.reported.keys() == with_blanks.reported.keys() == {*"uvw"}
    for name in with_blanks.channels:
        np.testing.assert_array_equal(with_flag.channels[name], with_blanks.channels[name])
    assert with_flag.sigma == with_blanks.sigma
    fits = [fit_weak(model(), prepare([run], model())) for run in (with_flag, with_blanks)]
    assert fits[0].values == fits[1].values


def test_a_sensor_with_hardly_a_report_is_left_out(dives: list[Dive], tmp_path: Path) -> None:
    surfaced = pl.col("t") < 1.0
    table = dives[0].table().with_columns(pl.when(surfaced).then(pl.col("x")).alias("x"))
    run = _read(written(table, tmp_path / "few.parquet"))
    assert not run.has("x")
    assert any(note.startswith("x: left out, as it has") for note in run.notes)


def test_a_dropout_of_one_sensor_stays_a_gap(dives: list[Dive], tmp_path: Path) -> None:
    lost = pl.col("t").is_between(30.0, 33.0)
    table = dives[0].table().with_columns(*(pl.when(~lost).then(pl.col(n)).alias(n) for n in "uvw"))
    run = _read(written(table, tmp_path / "gap.parquet"))
    inside = (run.t > 30.2) & (run.t < 32.8)
    assert np.isnan(run.channels["u"][inside]).all()
    assert np.isfinite(run.channels["psi"][inside]).all()
    assert len(run.segments(MOTION)) == 2


def test_few_blanks_in_a_dense_log_are_gaps_as_ever(dives: list[Dive], tmp_path: Path) -> None:
    table = dives[0].dense(20.0).with_row_index("row")
    table = table.with_columns(pl.when(pl.col("row") % 100 != 7).then(pl.col("u")).alias("u")).drop("row")
    run = _read(written(table, tmp_path / "few.parquet"))
    assert not run.reported
    assert np.isnan(run.channels["u"]).sum() == 16


def test_commands_that_stop_are_asked_about(dives: list[Dive], tmp_path: Path) -> None:
    silent = pl.col("t").is_between(40.0, 45.0)
    table = dives[0].table().with_columns(pl.when(~silent).then(pl.col("f2")).alias("f2"))
    path = written(table, tmp_path / "silent.parquet")
    with pytest.raises(UndertowError, match=r"command 'f2' is missing in .* rows .*missing_commands"):
        _read(path)
    held = _read(path, LogMapping(missing_commands="hold"))
    assert np.ptp(held.channels["f2"][(held.t > 40.1) & (held.t < 44.9)]) == 0.0


def test_a_log_in_parts_has_the_same_reports(dives: list[Dive], tmp_path: Path) -> None:
    path = written(dives[0].table(), tmp_path / "long.parquet")
    whole, names = _read(path), model().command_names
    parts = [part.run for part in LongLog(path, LogMapping(), names).parts(2000, 400)]
    assert len(parts) > 2
    for part in parts:
        for name in ("u", "psi"):
            there = part.reported[name] & (part.t > part.t[0] + 1.0) & (part.t < part.t[-1] - 1.0)
            assert there.any()
            assert np.isin(part.channels[name][there], whole.channels[name][whole.reported[name]]).all()
        assert np.isfinite(part.channels["f2"][part.t > part.t[0] + 1.0]).all()


def test_angles_go_on_across_a_turn_between_reports(dives: list[Dive], tmp_path: Path) -> None:
    table = dives[0].table()
    wrapped = table.with_columns(((pl.col("psi") + np.pi) % (2 * np.pi) - np.pi).alias("psi"))
    whole, again = (_read(written(t, tmp_path / f"{i}.parquet")) for i, t in enumerate((table, wrapped)))
    turns = (whole.channels["psi"] - again.channels["psi"]) / (2 * np.pi)
    known = turns[np.isfinite(turns)]
    np.testing.assert_allclose(known, np.round(known[0]), atol=1e-9)


def test_series_in_other_axes_are_the_same_series(
    dives: list[Dive], union: list[Run], tmp_path: Path
) -> None:
    east, north = pl.col("y").alias("x"), pl.col("x").alias("y")
    turned = (-pl.col(n) for n in ("z", "v", "w", "r"))
    table = dives[0].table().with_columns(east, north, (np.pi / 2 - pl.col("psi")).alias("psi"), *turned)
    axes = LogMapping.model_validate({"frames": {"position": "ENU", "body": "FLU"}})
    run = _read(written(table, tmp_path / "enu.parquet"), axes)
    for name in MOTION:
        np.testing.assert_array_equal(run.reported[name], union[0].reported[name])
        np.testing.assert_allclose(run.channels[name], union[0].channels[name], atol=1e-9)
        assert run.sigma[name] == pytest.approx(union[0].sigma[name])


def test_a_velocity_over_ground_without_a_heading_beside_it_is_no_report(tmp_path: Path) -> None:
    """After the last heading its axes are unknown; the noise is that of the other reports."""
    rng, t = np.random.default_rng(4), np.arange(0.0, 40.0, 0.1)
    rows = np.arange(len(t))
    heading = np.where((rows % 2 == 0) & (t < 39.0), np.degrees(0.4 * np.sin(t / 5)), np.nan)
    north, east = np.where(rows % 5 == 1, 0.03 * rng.standard_normal((2, len(t))) + np.sin(t / 7), np.nan)
    rate = np.where(rows % 2 == 0, 0.08 * np.cos(t / 5), np.nan)
    motion = {"psi": np.radians(heading), "u": north, "v": east, "r": rate}
    table = pl.DataFrame({"t": t, **motion, "f1": 0.0 * t})
    table.with_columns(pl.exclude("t").fill_nan(None)).write_csv(tmp_path / "boat.csv")
    run = read_log(tmp_path / "boat.csv", LogMapping.model_validate({"frames": {"velocity": "NED"}}))
    assert np.isfinite(run.channels["u"][run.reported["u"]]).all()
    assert [run.sigma[n] for n in "uv"] == pytest.approx([0.03, 0.03], rel=0.25)


def test_velocities_come_from_the_reports_of_a_slow_pose(dives: list[Dive], tmp_path: Path) -> None:
    path = written(dives[0].table().drop("u", "v", "w", "r"), tmp_path / "pose.parquet")
    run = velocities_from_pose(_read(path), model().degrees_of_freedom)
    assert not run.reported.keys() & {*"uvwr"}
    for name in "uvwr":
        true = np.interp(run.t, dives[0].t, dives[0].motion[name])
        error = np.sqrt(np.nanmean((run.channels[name] - true) ** 2))
        assert 0.5 * run.sigma[name] < error < 1.2 * run.sigma[name]


# --- fits and judgements --------------------------------------------------------------------------
def _errors_in_sigmas(fit: object) -> np.ndarray:
    true = truth()
    return np.array(
        [(fit.values[n] - true.value_of(n).value) / fit.standard_errors[n] for n in fit.values]  # type: ignore[attr-defined]
    )


@pytest.mark.parametrize("how", first_quick(["weak", "output", "prediction"]))
def test_the_truth_is_found_within_its_intervals(how: str, union: list[Run], dense: list[Run]) -> None:
    """As well as from a dense log, which has many more reports."""
    vehicle = _with_current()

    def fitted(runs: list[Run]) -> np.ndarray:
        if how == "weak":
            return _errors_in_sigmas(fit_weak(vehicle, prepare(runs, vehicle)))
        fit = fit_output_error if how == "output" else fit_prediction_error
        return _errors_in_sigmas(fit(vehicle, runs))

    own, other = fitted(union[:2]), fitted(dense[:2])
    assert np.sqrt(np.mean(own**2)) < 1.5
    assert np.max(np.abs(own)) < 3.5
    assert np.sqrt(np.mean(own**2)) < np.sqrt(np.mean(other**2)) + 0.5


def test_only_reports_are_judged(union: list[Run]) -> None:
    vehicle = _with_current()
    fit = fit_output_error(vehicle, union[:2])
    measured = np.isfinite(cut(union[:2], vehicle, 5.0).measured).sum(axis=(0, 1))
    assert np.all(fit.at.counts <= measured)
    assert fit.at.counts[3] > 6 * fit.at.counts[4] > 6 * fit.at.counts[0]  # 50, 7 and 5 a second
    np.testing.assert_allclose(fit.mean_square(), 1.0, atol=0.2)


def test_errors_of_the_true_model_are_the_noise_of_the_reports(union: list[Run]) -> None:
    found = compare(truth(), union[2:])
    for channel in found.result.channels:
        assert channel.noise == pytest.approx(NOISE[channel.channel], rel=0.12)
    assert all(0.7 < found.ahead.normalised[n] < 1.6 for n in "uvwr")
    (run,) = traces(found)
    for trace in run.traces:
        shown = np.isfinite(trace.measured)
        assert np.array_equal(shown, union[2].reported[trace.channel])


@pytest.mark.slow
def test_the_effect_is_named(union: list[Run]) -> None:
    found = diagnose(model(), union[:2], union[2:])
    assert (found.verdict, found.effects) == ("missing_effect", ["ocean_current"])


# --- latencies ------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def late(dives: list[Dive], tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("late")
    return [
        written(d.table(late={"position": 0.2}), folder / f"late{i}.parquet") for i, d in enumerate(dives)
    ]


@pytest.mark.slow
def test_a_late_position_is_found_and_mended(late: list[Path]) -> None:
    examined = examine(truth(), [_read(path) for path in late[:2]])
    (found,) = [f for f in examined.result.findings if f.id == "late_pose"]
    assert "x, y, z are" in found.text
    assert abs(found.evidence["delay"] - 0.2) < 3 * found.evidence["error"] < 0.05
    columns = {n: {"channel": n, "delay": "0.2 s"} for n in ("x", "y", "z")}
    mended = [_read(path, LogMapping.model_validate({"columns": columns})) for path in late[:2]]
    assert not [f for f in examine(truth(), mended).result.findings if f.id.startswith("late_")]
    before, after = (compare(truth(), runs).ahead.normalised for runs in ([_read(late[0])], mended[:1]))
    assert before["x"] > 1.5 * after["x"]
    assert after["x"] < 1.3


@pytest.mark.slow
def test_latencies_of_prompt_series_are_said_with_their_errors(union: list[Run]) -> None:
    findings = examine(truth(), union[:2]).result.findings
    assert not [f for f in findings if f.id.startswith("late_")]
    (said,) = [f for f in findings if f.id == "latencies"]
    assert all(abs(value) < 0.05 for value in said.evidence.values())


@pytest.mark.slow
def test_commands_of_another_clock_are_found_and_mended(dives: list[Dive], tmp_path: Path) -> None:
    """Stamped too late, they seem to come after the motion; no vehicle does that."""
    names = [*model().command_names]
    path = written(dives[0].table(late={"commands": 0.3}), tmp_path / "late.parquet")
    (found,) = [f for f in examine(truth(), [_read(path)]).result.findings if f.id == "late_commands"]
    assert abs(found.evidence["delay"] + 0.3) < max(3 * found.evidence["error"], 0.02)
    assert all(f'{n} = {{ channel = "{n}", delay = "0.3' in found.mapping for n in names)
    columns = {n: {"channel": n, "delay": "300 ms"} for n in names}
    mended = _read(path, LogMapping.model_validate({"columns": columns}))
    assert "f1 by 0.3 s" in " ".join(mended.notes)
    findings = examine(truth(), [mended]).result.findings
    (said,) = [f for f in findings if f.id == "command_latency"]
    assert abs(said.evidence["delay"]) < 0.02


def test_degrees_are_found_in_a_heading_that_is_a_series(dives: list[Dive], tmp_path: Path) -> None:
    degrees = np.degrees(pl.col("psi"))
    table = dives[0].table().with_columns((degrees - 360.0 * (degrees / 360.0).round()).alias("psi"))
    run = _read(written(table, tmp_path / "degrees.parquet"))
    (found,) = [f for f in examine(truth(), [run]).result.mistakes]
    assert found.id == "degrees_for_radians"


def test_a_delay_that_is_no_time_is_refused(late: list[Path]) -> None:
    columns = {"x": {"channel": "x", "delay": "3 m"}}
    with pytest.raises(UndertowError, match="delay of column 'x'"):
        _read(late[0], LogMapping.model_validate({"columns": columns}))


def test_reports_that_a_delay_moves_into_a_gap_of_the_log_are_left_out(tmp_path: Path) -> None:
    """Nothing was logged meanwhile: a row there has no command, which was never missing in the file."""
    t = np.arange(0.0, 30.0, 0.01)
    t = t[(t < 10.0) | (t > 10.5)]
    table = pl.DataFrame({"t": t, "psi": np.sin(t), "r": np.cos(t - 0.1), "n": np.cos(t)})
    table.write_csv(tmp_path / "gap.csv")
    mapping = LogMapping.model_validate({"columns": {"r": {"channel": "r", "delay": "0.1 s"}}})
    run = read_log(tmp_path / "gap.csv", mapping, ["n"])
    assert not ((run.t > 9.995) & (run.t < 10.505)).any()
    assert np.isfinite(run.channels["n"]).all()
    known = run.reported["r"]
    np.testing.assert_allclose(run.channels["r"][known], np.cos(run.t[known]), atol=1e-9)


def test_reports_with_a_delay_are_kept_where_only_a_faster_series_has_a_gap(tmp_path: Path) -> None:
    """The rows are as close as the commands, which come in bursts; the position goes on without them."""
    motion, burst = np.arange(0.0, 60.0, 0.25), np.arange(0.0, 60.0, 0.05)
    burst = burst[burst % 2.0 < 1.2]
    t = np.union1d(motion, burst)
    columns = {"x": np.sin(t), "u": np.cos(t - 0.4)}
    table = pl.DataFrame({"t": t, **{n: np.where(np.isin(t, motion), y, np.nan) for n, y in columns.items()}})
    table = table.with_columns(f1=np.where(np.isin(t, burst), np.cos(t), np.nan)).fill_nan(None)
    table.write_csv(tmp_path / "bursts.csv")
    mapping = {"columns": {"u": {"channel": "u", "delay": "0.4 s"}}, "missing_commands": "hold"}
    run = read_log(tmp_path / "bursts.csv", LogMapping.model_validate(mapping), ["f1"])
    assert np.sum(run.reported["u"]) == len(motion) - 2  # the first two are before the first position
    np.testing.assert_allclose(run.channels["u"][run.reported["u"]], np.cos(run.t[run.reported["u"]]))


def test_a_stretch_too_short_for_slow_velocities_counts_reports_and_not_rows(union: list[Run]) -> None:
    """Rows of other sensors in between make no stretch longer, and measured velocities are not derived."""
    first = union[0].t[0]
    with pytest.raises(UndertowError) as refused:
        prepare([union[0].slice(first, first + 0.8)], model())
    said = re.search(
        r"has (\d+) \(of (\d+) in .*, and (\d+) are needed .*reported every ([\d.]+) s", str(refused.value)
    )
    assert said is not None
    have, whole, needed = (int(said[i]) for i in (1, 2, 3))
    assert have <= whole < needed
    slowest = max(union[0].period(n) for n in model().velocity_names)
    assert float(said[4]) == pytest.approx(slowest, rel=0.2)
    assert "derived" not in str(refused.value)
