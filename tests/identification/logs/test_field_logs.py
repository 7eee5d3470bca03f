"""Logs as vehicles write them: series on clocks of their own become one table, stretches become runs."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import undertow as ut
from undertow.errors import UndertowError
from undertow.identification.logs.formats import fieldlog
from undertow.identification.logs.formats.by_name import first_mapping
from undertow.identification.logs.formats.fieldlog import (
    FieldLog,
    Series,
    cut_at,
    format_of,
    in_order,
    read_field_log,
    rising,
    union,
)
from undertow.identification.logs.mapping import Column, LogMapping, mapping_text, read_mapping
from undertow.identification.logs.reading import read_log, read_logs
from undertow.identification.logs.table import Helper
from undertow.model.loading import load_vehicle


def _alog(folder: Path, lines: str, name: str = "dive.alog") -> Path:
    path = folder / name
    path.write_text(f"%%%%\n%% LOG FILE: {name}\n{lines}", encoding="utf-8")
    return path


def test_samples_taken_together_stand_in_one_row() -> None:
    slow, fast = np.array([0.0, 1.0, 2.0]), np.arange(21) / 10 + 1e-4
    t, (at_slow, at_fast) = union([slow, fast])
    assert len(t) == 21
    assert list(at_slow) == [0, 10, 20]
    assert list(at_fast) == list(range(21))
    assert np.all(np.abs(t[at_fast] - fast) <= 1.01e-4)


def test_clocks_of_their_own_keep_their_times() -> None:
    rng = np.random.default_rng(1)
    clocks = [np.cumsum(rng.uniform(0.5, 1.5, n) * step) for n, step in ((50, 0.2), (300, 0.033), (90, 0.11))]
    t, places = union(clocks)
    assert np.all(np.diff(t) > 0)
    for clock, place in zip(clocks, places, strict=True):
        assert np.all(np.diff(place) > 0)
        assert np.max(np.abs(t[place] - clock)) < 0.05 * 0.04


def test_a_clock_that_goes_back_loses_those_samples_only() -> None:
    assert list(rising(np.array([0.0, 1.0, 0.5, np.nan, 2.0, 2.0, 3.0]))) == [0, 1, 4, 6]


def _nav(t: np.ndarray) -> FieldLog:
    mapping = LogMapping(columns={"nav.x": Column(channel="x")})
    return FieldLog(Path("dive.bin"), "some", {"nav": Series("nav", t, {"x": t})}, mapping)


def test_a_clock_that_goes_back_for_good_cuts_the_log() -> None:
    """By 20 s at 60 s; before and after it the vehicle is at different places."""
    t = np.concatenate([np.arange(0.0, 60.0, 0.5), np.arange(40.0, 90.0, 0.5)])
    log = in_order(_nav(t))
    (first, last), (after, end) = log.intervals
    assert (first, after, end) == (0.0, 60.0, 89.5)
    assert 59.5 <= last < 60.0
    assert log.notes == (
        "samples that are not later than earlier ones are left out: 40 of nav",
        "cut at 60.0 s, where the clock goes back",
    )


def test_a_time_twice_and_one_too_early_are_left_out_with_a_word() -> None:
    t = np.arange(0.0, 60.0, 0.5)
    log = in_order(_nav(np.insert(t, [20, 50], [9.5, 3.0])))
    assert log.intervals == ()
    assert log.notes == ("samples that are not later than earlier ones are left out: 2 of nav",)
    sound = _nav(t)
    assert in_order(sound) is sound


def test_a_reset_begins_a_new_stretch() -> None:
    (a, b), (c, d) = cut_at([(0.0, 10.0)], [4.0, 12.0])
    assert (a, c, d) == (0.0, 4.0, 10.0)
    assert 3.999 < b < 4.0


def test_moos_counts_east_north_and_clockwise(tmp_path: Path) -> None:
    lines = "{0} NAV_X a 3\n{0} NAV_Y a 7\n{0} NAV_HEADING a 90\n{0} NAV_DEPTH a 2\n"
    run = read_log(_alog(tmp_path, lines.format(0) + lines.format(1)))
    assert (run.channels["x"][0], run.channels["y"][0], run.channels["z"][0]) == (7.0, 3.0, 2.0)
    assert run.channels["psi"] == pytest.approx(np.pi / 2)


def test_a_moos_log_of_another_kind_is_refused_with_what_to_give(tmp_path: Path) -> None:
    text = "%% LOG FILE: dive\n%% TIME NAV_X NAV_Y\n0.0 NaN 1.5 1\n0.2 3.1 1.6 2\n"
    with pytest.raises(UndertowError, match=r"dive.slog is a synchronous MOOS log: give the \.alog"):
        read_log(_alog(tmp_path, text, "dive.slog"))
    with pytest.raises(UndertowError, match=r"dive.alog has no line of a time, a variable, its source and a"):
        read_log(_alog(tmp_path, "0.0 NAV_X 1.5\n0.1 NAV_X 1.6\n"))


def test_numbers_of_a_text_without_names_are_known_by_their_places(tmp_path: Path) -> None:
    lines = "".join(f"{k} PWM p !pwm, *, 1.{k}00, 1.5\n{k} RAW p $GPRMC,{k},7\n" for k in range(4))
    log = read_field_log(_alog(tmp_path, lines))
    assert {*log.series} == {"PWM[3]", "PWM[4]"}
    assert log.series["PWM[3]"].columns["value"] == pytest.approx([1.0, 1.1, 1.2, 1.3])


def test_texts_of_moos_with_several_numbers_are_as_many_variables(tmp_path: Path) -> None:
    """The report on the vehicle itself is its motion; those on others are told apart by their names."""
    line = "{0} NODE_REPORT_LOCAL p NAME=a,TYPE=auv,X={0},Y=-7.5,SPD=1e-1,HDG=90,MODE=1.2.3\n"
    line += "{0} NODE_REPORT p NAME=b,X=50\n{0} NODE_REPORT p NAME=c,X=60\n"
    path = _alog(tmp_path, "".join(line.format(k) for k in range(4)))
    run, log = read_log(path), read_field_log(path)
    assert run.channels["y"] == pytest.approx(np.arange(4.0))
    assert (run.channels["x"][0], run.channels["u"][0]) == (-7.5, 0.1)
    assert run.channels["psi"] == pytest.approx(np.pi / 2)
    assert {"NODE_REPORT[b].X", "NODE_REPORT[c].X"} < {*log.series}
    assert "NODE_REPORT_LOCAL.MODE" not in log.series


def test_python_reads_a_vehicles_own_log_as_the_commands_do(tmp_path: Path) -> None:
    path = _alog(tmp_path, "".join(f"{k} NAV_X a {k}\n{k} NAV_Y a 7\n" for k in range(5)))
    direct, shown = read_log(path), ut.read_log(path)
    assert {n: list(a) for n, a in shown.channels.items()} == {n: list(a) for n, a in direct.channels.items()}


def test_texts_and_lines_that_are_cut_off_are_left_out(tmp_path: Path) -> None:
    # A text may be empty, or have a line break in it: then its line is short, but not truncated.
    log = read_field_log(
        _alog(tmp_path, "0 NAV_X a 3\n0 MODE a on\n0 MODE a \n1 NMEA a $G\n\n1 NAV_X a 4\n2 NAV_X")
    )
    assert list(log.series) == ["NAV_X"]
    assert log.notes == ("truncated lines left out: 1",)


def test_what_the_table_of_a_log_means_is_written_beside_it(tmp_path: Path) -> None:
    log = read_field_log(_alog(tmp_path, "".join(f"{k} NAV_X a {k}\n{k}.2 NAV_Y a 1\n" for k in range(9))))
    meaning = log.mapping_for()
    log.table(meaning.columns).write_parquet(tmp_path / "dive.parquet")
    (tmp_path / "dive.toml").write_text(mapping_text(meaning), encoding="utf-8")
    direct = read_log(log.path)
    again = read_log(tmp_path / "dive.parquet", read_mapping(tmp_path / "dive.toml"))
    assert read_mapping(tmp_path / "dive.toml") == meaning
    assert np.array_equal(direct.t, again.t)
    for name, values in direct.channels.items():
        assert np.array_equal(values, again.channels[name], equal_nan=True)


def test_motors_become_the_commands_of_the_vehicle_in_their_order(tmp_path: Path) -> None:
    motors = tuple((f"OUT.C{k}", Column(channel=f"motor{k}", unit="N")) for k in (1, 2))
    outputs = Series("OUT", np.arange(3.0), {f"C{k}": np.full(3, k) for k in (1, 2)})
    log = FieldLog(tmp_path, "made here", {"OUT": outputs}, actuators=motors)
    driven = log.mapping_for(["port", "starboard"])
    assert {n: c.channel for n, c in driven.columns.items()} == {"OUT.C1": "port", "OUT.C2": "starboard"}
    assert driven.missing_commands == "hold"
    assert not log.mapping_for(["port", "starboard", "bow"]).columns  # as many as it has, or none


def test_stretches_are_runs_of_their_own(tmp_path: Path) -> None:
    t = np.arange(20.0)
    stretch = np.where(t < 8, 1.0, np.where(t < 12, np.nan, 2.0))
    table = {"t": t, "part": stretch, "u": np.sin(t), "f1": np.cos(t), "f2": np.cos(t)}
    pl.DataFrame(table, nan_to_null=True).write_parquet(tmp_path / "run.parquet")
    mapping = LogMapping.model_validate({"time": {"stretch": "part"}})
    first, second = read_logs([tmp_path / "run.parquet"], load_vehicle("box-hull"), mapping, one_motion=True)
    assert (list(first.t), list(second.t)) == (list(range(8)), list(range(12, 20)))
    assert (first.name, second.name, first.origin, second.origin) == ("run-1", "run-2", "run", "run")
    assert list(read_log(tmp_path / "run.parquet", mapping).t) == list(range(8))


def test_what_cannot_be_read_names_what_can(tmp_path: Path) -> None:
    picture = tmp_path / "dive.png"
    picture.write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(range(256)))
    assert format_of(picture) is None
    for read in (read_log, read_field_log):
        with pytest.raises(UndertowError, match=r"undertow reads CSV .*Parquet.*MOOS \(\.alog\)"):
            read(picture)


def test_a_column_that_is_not_there_is_named(tmp_path: Path) -> None:
    log = read_field_log(_alog(tmp_path, "0 NAV_X a 3\n1 NAV_X a 4\n"))
    with pytest.raises(UndertowError, match=r"no 'NAV_Y.value' \(did you mean 'NAV_X.value'\?\).*--list"):
        log.table(["NAV_Y.value"])


@pytest.mark.parametrize(
    ("name", "head", "library"),
    [
        ("dive.ulg", b"ULog\x01\x12\x35\x01", "pyulog"),
        ("dive.bag", b"#ROSBAG V2.0\n", "rosbags.typesys"),
        ("dive.mat", b"MATLAB 7.3 MAT-file".ljust(512) + b"\x89HDF\r\n\x1a\n", "matio"),
        ("dive.nc", b"CDF\x01", "netCDF4"),
    ],
)
def test_a_library_that_is_not_installed_is_one_line_with_the_command_for_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, head: bytes, library: str
) -> None:
    (tmp_path / name).write_bytes(head + bytes(64))
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(UndertowError, match=rf'{library.split(".")[0]}: pip install "undertow\[field\]"'):
        read_log(tmp_path / name)


def test_a_question_that_ends_its_process_does_not_end_ours() -> None:
    program = """
import json, signal, sys
for line in sys.stdin:
    signal.setitimer(signal.ITIMER_PROF, 0.2)
    while json.loads(line) == "hang":
        pass
    print(json.dumps("answered"), flush=True)
"""
    helper = Helper(program)
    asked = [helper.answer(question, "no helper", "ended") for question in ("go", "hang", "go")]
    helper.close()
    assert asked == ["answered", "ended", "answered"]


def test_a_file_with_which_its_reader_hangs_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    helper = Helper("import sys; sys.stdin.readline()")  # it ends with the first question
    monkeypatch.setattr(fieldlog, "_TRIES", helper)
    (tmp_path / "dive.nc").write_bytes(b"CDF\x01" + bytes(60))
    with pytest.raises(UndertowError, match=r"dive.nc cannot be read as NetCDF: its reader .* 20 s: copy it"):
        read_log(tmp_path / "dive.nc")
    helper.close()


def test_a_boat_of_which_a_log_knows_the_depth_alone_is_guessed(tmp_path: Path) -> None:
    t = np.arange(0.0, 40.0, 0.5)
    rows = (f"{s} NAV_DEPTH a 0\n{s} NAV_LAT a {48 + 1e-5 * s}\n{s} NAV_LONG a {-3 + 1e-5 * s}\n" for s in t)
    log = read_field_log(_alog(tmp_path, "".join(rows)))
    for name, channels in (("otter", {"x", "y"}), ("mini-auv", {"z"})):
        assert {g.channel for g in first_mapping(log, load_vehicle(name)).columns} == channels
