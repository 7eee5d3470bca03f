"""Files of MATLAB: the dive comes back from structs of both versions, names say what is what."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

from undertow.errors import UndertowError
from undertow.identification.logs.formats.by_name import first_mapping
from undertow.identification.logs.formats.fieldlog import format_of, read_field_log
from undertow.identification.logs.mapping import LogMapping
from undertow.identification.logs.reading import read_log, read_logs
from undertow.model.loading import load_vehicle
from undertow.typing import Array

from .dive import Dive, dive
from .written import assert_the_dive, cut_off, mat, mat73

_WRITERS = [mat, mat73]
Write = Callable[[Path, Dive], Path]


@pytest.mark.parametrize("write", _WRITERS)
def test_the_dive_comes_back(tmp_path: Path, write: Write) -> None:
    path = write(tmp_path / "dive.mat", dive())
    (run,) = read_logs([path], load_vehicle("bluerov2"))
    assert_the_dive(run, dive(), 1e-12)
    log = read_field_log(path)
    assert list(log.series) == ["nav", "thruster"]
    assert [name for name, _ in log.actuators] == [f"thruster.f{k}" for k in range(1, 9)]


def _of_tables(path: Path, version: str) -> Path:
    """The dive as a timetable and a table, by mat-io."""
    matio, pandas = pytest.importorskip("matio"), pytest.importorskip("pandas")
    d = dive()
    blocks = {"eta": d.pose, "nu": np.hstack([d.velocity, d.rates])}  # of six columns each in MATLAB
    numbered = {f"{name}_{k}": a for name, block in blocks.items() for k, a in enumerate(block.T, 1)}
    rows = pandas.Index(np.round(1e3 * d.t).astype("timedelta64[ms]"), name="Time")
    commands = {"time": d.t, **{f"f{k}": a for k, a in enumerate(d.thrust.T, 1)}}
    content = {"nav": pandas.DataFrame(numbered, index=rows), "thruster": pandas.DataFrame(commands)}
    with pytest.warns(match="Defaulting to 's'"):  # how durations are shown
        matio.save_to_mat(str(path), content, version=version)
    return path


@pytest.mark.parametrize("version", ["v7", "v7.3"])
def test_tables_and_timetables_are_series(tmp_path: Path, version: str) -> None:
    (run,) = read_logs([_of_tables(tmp_path / "dive.mat", version)], load_vehicle("bluerov2"))
    assert_the_dive(run, dive(), 1e-9)


@pytest.mark.parametrize("version", ["v7", "v7.3"])
def test_tables_in_structs_are_series(tmp_path: Path, version: str) -> None:
    matio, pandas = pytest.importorskip("matio"), pytest.importorskip("pandas")
    t, path = 0.1 * np.arange(50), tmp_path / "log.mat"
    frame = pandas.DataFrame({"time": t, "u": np.sin(t)})
    content = {"dive": {"deep": {"dvl": frame}, "ctd": {"t": t, "z": t}, "name": "first"}}
    matio.save_to_mat(str(path), content, version=version)
    log = read_field_log(path)
    assert {name: list(s.columns) for name, s in log.series.items()} == {
        "dive.deep.dvl": ["u"],
        "dive.ctd": ["z"],
    }
    np.testing.assert_array_equal(log.series["dive.deep.dvl"].columns["u"], np.sin(t))


@pytest.mark.parametrize("version", ["v7", "v7.3"])
def test_an_object_in_a_struct_is_named(tmp_path: Path, version: str) -> None:
    matio = pytest.importorskip("matio")
    from matio.utils.matclass import MatlabContainerMap

    t, path = 0.1 * np.arange(50), tmp_path / "log.mat"
    content = {"dive": {"by_name": MatlabContainerMap({"a": 1.0}), "ctd": {"t": t, "z": t}}}
    matio.save_to_mat(str(path), content, version=version)
    reported = "dive.by_name is an object of MATLAB: save it as a struct"
    assert read_field_log(path).notes[0].startswith(reported)


def _timeseries(
    data: np.ndarray, clock: dict[str, np.ndarray], names: tuple[str, ...] = (), *, first: bool = True
) -> Any:
    """A timeseries as MATLAB saves it, with what its clock has."""
    matclass = pytest.importorskip("matio.utils.matclass")
    nothing, cells = np.zeros((0, 0)), np.empty((len(names), 1), dtype=object)
    cells[:, 0] = [np.array([name]) for name in names]
    info = {"Units": np.array(["seconds"]), "Time_": nothing, "Start_": nothing, "Increment_": nothing}
    parts = {
        "Data_": data,
        "IsTimeFirst_": np.array([[first]]),
        "TimeInfo": matclass.MatlabOpaque(info | clock, "tsdata.timemetadata"),
        "DataInfo": matclass.MatlabOpaque({"UserData": cells}, "tsdata.datametadata"),
    }
    return matclass.MatlabOpaque(parts, "timeseries")


@pytest.mark.parametrize("version", ["v7", "v7.3"])
def test_a_timeseries_is_a_series(tmp_path: Path, version: str) -> None:
    """As Simulink and the toolbox for ROS make them: with its times, or even ones in minutes, on its side."""
    matio = pytest.importorskip("matio")
    t = 1.5e9 + 0.1 * np.arange(60)
    speed = np.column_stack([np.sin(t), np.cos(t)])
    even = {"Start_": np.array([[0.5]]), "Increment_": np.array([[0.01]]), "Length": np.array([[60.0]])}
    content = {
        "odometry": _timeseries(speed, {"Time_": t[:, None]}, ("Twist.Linear.X", "Twist.Linear.Y")),
        "depth": _timeseries(
            speed[:, 0].reshape(1, 1, -1), even | {"Units": np.array(["minutes"])}, first=False
        ),
    }
    matio.save_to_mat(str(tmp_path / "log.mat"), content, version=version)
    log = read_field_log(tmp_path / "log.mat")
    assert {n: [*one.columns] for n, one in log.series.items()} == {
        "odometry": ["Twist.Linear.X", "Twist.Linear.Y"],
        "depth": ["depth"],
    }
    np.testing.assert_allclose(log.series["odometry"].t, t - t[0], atol=1e-6)
    np.testing.assert_allclose(log.series["depth"].t, 30.0 + 0.6 * np.arange(60))
    np.testing.assert_array_equal(log.series["depth"].columns["depth"], speed[:, 0])
    channels = {column.channel for column in log.mapping.columns.values()}
    assert channels == {"u", "v", "z"}


@pytest.mark.parametrize("version", ["v7", "v7.3"])
def test_dates_of_a_table_are_its_time_and_texts_are_passed_over(tmp_path: Path, version: str) -> None:
    matio, pandas = pytest.importorskip("matio"), pytest.importorskip("pandas")
    when = np.datetime64("2024-05-01T12:00:00.000") + 250 * np.arange(20).astype("timedelta64[ms]")
    frame = pandas.DataFrame({"when": when, "depth": np.arange(20.0), "mode": ["dive"] * 20})
    matio.save_to_mat(str(tmp_path / "log.mat"), {"ctd": frame}, version=version)
    log = read_field_log(tmp_path / "log.mat")
    assert log.series["ctd"].t == pytest.approx(0.25 * np.arange(20.0), abs=1e-6)
    assert list(log.series["ctd"].columns) == ["depth"]


def _written(folder: Path, content: dict[str, Any]) -> Path:
    savemat(folder / "log.mat", content, oned_as="row")
    return folder / "log.mat"


def test_vectors_of_the_workspace_are_columns_whichever_way_they_lie(tmp_path: Path) -> None:
    t = np.arange(40) * 0.1
    content = {"time": t, "pos": np.vstack([t, 2 * t, 3 * t]), "yaw_deg": 90 * np.sin(t), "gain": 3.0}
    log = read_field_log(_written(tmp_path, content))
    assert {c.channel: (n, c.unit) for n, c in log.mapping.columns.items()} == {
        "x": ("workspace.pos_x", "m"),
        "y": ("workspace.pos_y", "m"),
        "z": ("workspace.pos_z", "m"),
        "psi": ("workspace.yaw_deg", "deg"),
    }
    run = read_log(log.path)
    assert run.channels["y"] == pytest.approx(2 * t)
    assert run.channels["psi"] == pytest.approx(np.pi / 2 * np.sin(t))


def test_structs_have_clocks_of_their_own_and_those_inside_take_that_of_the_outer(tmp_path: Path) -> None:
    slow, fast = np.arange(10.0), np.arange(100) * 0.1
    simulink = {"time": fast, "signals": {"values": np.cos(fast)}}
    content = {"gps": {"t": slow, "x": slow**2}, "heading": simulink, "note": "text"}
    log = read_field_log(_written(tmp_path, content))
    assert {name: len(one.t) for name, one in log.series.items()} == {"gps": 10, "heading.signals": 100}
    assert log.series["heading.signals"].columns["signals"] == pytest.approx(np.cos(fast))


def test_dates_of_matlab_count_from_the_start(tmp_path: Path) -> None:
    t = 739_000.25 + np.arange(30) / 86400.0
    log = read_field_log(_written(tmp_path, {"time": t, "depth": np.linspace(0, 5, 30)}))
    assert log.series["workspace"].t == pytest.approx(np.arange(30.0), abs=1e-4)


@pytest.mark.parametrize("name", ["time_min", "Time_minutes"])
def test_the_unit_of_a_converted_clock_is_not_asked_for(tmp_path: Path, name: str) -> None:
    t = np.arange(30) * 0.5
    log = read_field_log(_written(tmp_path, {"tank": {name: t / 60, "carriage": np.sin(t)}}))
    assert log.series["tank"].t == pytest.approx(t)
    guessed = first_mapping(log)
    assert guessed.time.entry == {"column": "t", "unit": "s"}
    assert not [question for question in guessed.asked if question.startswith("t:")]


def test_a_clock_since_1970_counts_from_the_start(tmp_path: Path) -> None:
    t = 1.7e9 + np.arange(30) * 0.5
    log = read_field_log(
        _written(tmp_path, {"a": {"t": t, "x": t - 1.7e9}, "b": {"t": t + 2.0, "y": t - 1.7e9}})
    )
    assert log.series["a"].t[0] == 0.0
    assert log.series["b"].t[0] == 2.0


def test_what_is_wanted_of_a_vehicle_is_not_taken_for_its_motion(tmp_path: Path) -> None:
    t = np.arange(30.0)
    content = {"log": {"t": t, "depth": t / 10, "depth_des": t / 5, "psi_ref": t / 50, "psi": t / 60}}
    columns = read_field_log(_written(tmp_path, content)).mapping.columns
    assert {name: column.channel for name, column in columns.items()} == {"log.depth": "z", "log.psi": "psi"}


def test_commands_are_taken_by_their_names_where_these_are_those_of_the_vehicle(tmp_path: Path) -> None:
    t = np.arange(30.0)
    content = {"log": {"t": t, "starboard": t, "port": -t, "u": np.sin(t)}}
    mapping = read_field_log(_written(tmp_path, content)).mapping_for(["port", "starboard"])
    drives = {n: c.channel for n, c in mapping.columns.items() if c.channel in ("port", "starboard")}
    assert drives == {"log.port": "port", "log.starboard": "starboard"}


@pytest.mark.parametrize("names", [("cmd1", "cmd2"), ("port", "starboard")])
def test_commands_that_are_taken_by_their_numbers_are_asked_about(
    names: tuple[str, str], tmp_path: Path
) -> None:
    """Sensors of a motor may be numbered like commands, and count other sides first."""
    t = np.arange(30.0)
    content = {"log": {"t": t, "u": np.sin(t), names[0]: np.cos(t), names[1]: np.sin(2 * t)}}
    path = _written(tmp_path, content)
    said = " ".join(read_log(path, None, ["port", "starboard"]).reader_notes)
    asked = (
        "log.cmd1, log.cmd2 are taken for port, starboard by their numbers alone: are they, in this order?"
    )
    assert (asked in said) == (names[0] == "cmd1")
    mapping = read_field_log(path).mapping_for(["port", "starboard"])
    assert "by their numbers" not in " ".join(read_log(path, mapping, ["port", "starboard"]).reader_notes)


def test_a_clock_without_its_first_times_and_in_microseconds_is_one(tmp_path: Path) -> None:
    t = np.arange(40) * 0.1
    clock = np.where(t < 0.2, np.nan, 1e6 * t)
    log = read_field_log(_written(tmp_path, {"time_gps": clock, "depth": t / 10}))
    assert log.series["workspace"].t[2:] == pytest.approx(t[2:])
    assert read_log(log.path).t == pytest.approx(t[2:])


def test_clocks_since_1970_and_from_the_start_begin_together(tmp_path: Path) -> None:
    t = np.arange(30) * 0.5
    log = read_field_log(_written(tmp_path, {"a": {"t": t + 1.7e9, "x": t}, "b": {"t": t, "y": t}}))
    assert log.series["a"].t == pytest.approx(t)
    assert log.series["b"].t == pytest.approx(t)


def test_measurements_without_a_time_of_their_length_are_named(tmp_path: Path) -> None:
    """A recorder that stopped a sample later; gains and the like are no measurements."""
    t = 0.1 * np.arange(60)
    content = {"time": t, "heading": np.sin(t), "speed": np.ones(61), "gains": np.ones(3)}
    log = read_field_log(_written(tmp_path, content))
    assert list(log.series["workspace"].columns) == ["heading"]
    assert log.notes == ("no time has as many samples as speed (61), which was left out",)


def test_a_log_may_lack_an_optional_column(tmp_path: Path) -> None:
    """A boat that logged its heading in some runs alone."""
    t = 0.1 * np.arange(60)
    path = _written(tmp_path, {"time": t, "speed": np.sin(t), "cmd": np.cos(t)})
    columns = {"workspace.speed": {"channel": "u"}, "workspace.cmd": {"channel": "port"}}
    heading = {"workspace.heading": {"channel": "psi", "optional": True}}
    run = read_log(path, LogMapping.model_validate({"columns": columns | heading}), ["port"])
    assert run.has("u")
    assert not run.has("psi")
    needed = LogMapping.model_validate({"columns": {"workspace.heading": {"channel": "psi"}}})
    with pytest.raises(UndertowError, match=r"no 'workspace.heading'.*optional = true in the mapping file"):
        read_log(path, needed)


def test_runs_in_cells_without_a_time_are_refused(tmp_path: Path) -> None:
    cells = _cell_array([np.arange(50.0), np.arange(40.0)])
    with pytest.raises(
        UndertowError, match=r"no time vector .* \(it has tc, heading\): call one of them time"
    ):
        read_field_log(_written(tmp_path, {"tc": cells, "heading": cells}))


def _cell_array(runs: list[Array]) -> np.ndarray:
    cells = np.empty((1, len(runs)), dtype=object)
    cells[0, :] = runs
    return cells


@pytest.mark.parametrize("inside", [False, True])
def test_runs_in_cells_of_vectors_are_each_a_log(inside: bool, tmp_path: Path) -> None:
    """Each variable is a cell array with a vector for each run, in the file or in a struct."""
    runs = [_run(0.0, 40.0, 0.0), _run(0.0, 30.0, 1.0), _run(0.0, 20.0, 2.0)]
    content = {name: _cell_array([run[name] for run in runs]) for name in runs[0]}
    found = read_logs([_written(tmp_path, {"exp": content} if inside else content)], load_vehicle("otter"))
    assert [len(run.t) for run in found] == [len(run["t"]) for run in runs]
    for run, written in zip(found, runs, strict=True):
        np.testing.assert_allclose(run.channels["x"], written["x"])


def _run(begin: float, duration: float, phase: float) -> dict[str, Array]:
    """A boat on its way, with the commands of an otter."""
    t = np.arange(0.0, duration, 0.1)
    yaw = 1.2 * np.sin(0.1 * t + phase)
    track = {"x": np.cumsum(0.2 * np.cos(yaw)), "y": np.cumsum(0.2 * np.sin(yaw)), "yaw": yaw}
    track |= {"u": np.full(len(t), 2.0), "v": 0.0 * t, "r": 0.12 * np.cos(0.1 * t + phase)}
    return {"t": begin + t, **track, "port": 9.0 + np.sin(t + phase), "starboard": 9.0 - np.sin(t)}


@pytest.mark.parametrize(
    "runs",
    [
        {f"tack{k}": _run(100.0 * k, 60.0, k) for k in (1, 2)},
        {f"tack{k}": _run(0.0, 60.0, k) for k in (1, 2)},
        {"zigzag": _run(0.0, 40.0, 0.0), "turning": _run(0.0, 60.0, 1.0)},
        {"trials": np.array([_run(0.0, 60.0, 0.0), _run(0.0, 60.0, 1.0)])},
    ],
    ids=["later", "from zero", "of other names", "elements"],
)
def test_runs_in_structs_are_logs_of_their_own(tmp_path: Path, runs: dict[str, Any]) -> None:
    path = _written(tmp_path, runs)
    assert "runs with the same columns, each used as a log of its own" in " ".join(read_field_log(path).notes)
    read = read_logs([path], load_vehicle("otter"))
    given = [one for run in runs.values() for one in np.atleast_1d(run)]
    assert len(read) == len(given) == 2
    for one, run in zip(sorted(read, key=lambda r: r.name), given, strict=True):
        assert np.ptp(one.t) == pytest.approx(np.ptp(run["t"]))
        for name, column in (("x", "x"), ("psi", "yaw"), ("port", "port")):
            np.testing.assert_allclose(one.channels[name], run[column], atol=1e-9)
    mapping = first_mapping(read_field_log(path), load_vehicle("otter"))
    assert mapping.time.entry["stretch"] == "stretch"
    assert mapping.axes.entry["position"] == "NED", "by the motion in one run, and not from one to the next"


def test_structs_with_the_same_motion_at_the_same_times_are_sensors(tmp_path: Path) -> None:
    t, noise = np.arange(0.0, 30.0, 0.1), np.random.default_rng(3)
    both = {f"imu{k}": {"t": t, "yaw": np.sin(t) + 0.1 * noise.normal(size=len(t))} for k in (1, 2)}
    log = read_field_log(_written(tmp_path, both))
    assert (*log.series,) == ("imu1", "imu2")
    assert "imu1 is read, not imu2 of the same columns" in " ".join(log.remarks)


def test_a_file_without_time_is_refused_with_its_names(tmp_path: Path) -> None:
    path = _written(tmp_path, {"speed": np.ones(20), "depth": np.ones(20)})
    with pytest.raises(UndertowError, match=r"no time vector .*it has speed, depth.*call one of them"):
        read_log(path)


def test_hdf5_is_told_by_what_is_in_it(tmp_path: Path) -> None:
    path = mat73(tmp_path / "dive.mat", dive())
    other = path.rename(tmp_path / "dive.data")
    found = format_of(other)
    assert found is not None
    assert found.name == "MATLAB"


@pytest.mark.parametrize("write", _WRITERS)
def test_files_that_are_cut_off_are_read_or_refused_in_a_line(tmp_path: Path, write: Write) -> None:
    cut_off(write(tmp_path / "dive.mat", dive()), read_log)


@pytest.mark.parametrize("as_cells", [True, False])
def test_dates_as_texts_are_the_time(tmp_path: Path, as_cells: bool) -> None:
    texts = np.array([f"2015-10-30 17:{k // 60:02}:{k % 60:02}" for k in range(90)])
    stamps = texts.astype(object)[:, None] if as_cells else texts
    log = read_field_log(_written(tmp_path, {"gps_time": stamps, "heading": np.arange(90.0)}))
    (series,) = log.series.values()
    np.testing.assert_allclose(series.t - series.t[0], np.arange(90.0))


def test_times_as_texts_that_are_no_dates_are_named(tmp_path: Path) -> None:
    stamps = np.array(["1969-11-31 17:00:37"] * 50, dtype=object)[:, None]  # November has no 31st
    with pytest.raises(UndertowError, match="gps_time holds texts that are no dates"):
        read_field_log(_written(tmp_path, {"gps_time": stamps, "heading": np.arange(50.0)}))
