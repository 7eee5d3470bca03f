"""A run that a vehicle writes into several tables: each on its own clock, together one log."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from scipy.spatial.transform import Rotation

from undertow.cli.main import main
from undertow.errors import UndertowError
from undertow.identification.logs.formats.by_name import first_mapping
from undertow.identification.logs.formats.fieldlog import one_run, read_field_log
from undertow.identification.logs.guess import guess_mapping
from undertow.identification.logs.mapping import Column, LogMapping, read_mapping
from undertow.identification.logs.reading import read_log
from undertow.typing import Array

COMMANDS = ("left_motor", "right_motor")
BEGIN = 1_700_000_000.25


def _motion(t: Array) -> dict[str, Array]:
    """A vehicle that swings on its way, at any times."""
    turn = 0.8 * np.sin(0.3 * t)
    return {"x": t + 0.2 * np.sin(t), "y": 2 * np.cos(0.4 * t), "psi": turn, "r": 0.24 * np.cos(0.3 * t)}


def _thrust(t: Array) -> dict[str, Array]:
    return {"left_motor": np.sin(0.5 * t), "right_motor": np.cos(0.5 * t)}


def _folder(folder: Path, prefix: str = "") -> tuple[Array, Array, Array]:
    """Pose at 10, gyro at 25, motors at 4 samples a second: dates, nanoseconds, stamps in two parts."""
    rng = np.random.default_rng(3)
    pose, gyro, motor = np.arange(0, 40, 0.1), np.arange(0.013, 40, 0.04), np.arange(0.5, 40, 0.25)
    at = _motion(pose)
    turned = np.column_stack([at["psi"], 0 * pose, 0 * pose])
    quaternion = Rotation.from_euler("ZYX", turned).as_quat(scalar_first=True).T
    dates = np.datetime64("2023-11-14T22:13:20.250") + np.round(1e3 * pose).astype("timedelta64[ms]")
    columns = {"position.x": at["x"], "position.y": at["y"]}
    columns |= {f"orientation.{n}": q for n, q in zip("wxyz", quaternion, strict=True)}
    _write(folder / f"{prefix}pose.csv", {"time": dates.astype(str)} | columns)
    _write(folder / f"{prefix}gyro.csv", {"t_ns": _whole(gyro), "r [rad/s]": _motion(gyro)["r"]})
    arrival = motor + 0.2 * rng.random(len(motor))
    stamped = {"log_time_ns": _whole(arrival), "stamp.sec": _whole(motor) // 10**9}
    stamped |= {"stamp.nanosec": _whole(motor) % 10**9}
    _write(folder / f"{prefix}motors.csv", stamped | _thrust(motor))
    return pose, gyro, motor


def _whole(t: Array) -> Array:
    return (int(BEGIN * 1e9) + np.round(1e9 * t)).astype(np.int64)


def _write(path: Path, columns: Mapping[str, Array]) -> None:
    pl.DataFrame(dict(columns)).write_csv(path)


def test_tables_whose_names_begin_with_a_date_are_told_apart(tmp_path: Path) -> None:
    t = np.arange(0.0, 20.0, 0.1)
    _write(tmp_path / "2024.05.01_pose.csv", {"t": t, "x": t, "y": np.sin(t), "yaw": 0.1 * t})
    _write(tmp_path / "2024.05.01_motors.csv", {"t": t + 0.05} | _thrust(t))
    assert {*read_field_log(tmp_path).series} == {"pose", "motors"}


def test_a_depth_beside_positions_east_and_north_keeps_its_sign(tmp_path: Path) -> None:
    t = np.arange(0.0, 60.0, 0.2)
    psi = 0.08 * t
    east, north = (0.3 * np.cumsum(f(psi)) for f in (np.sin, np.cos))
    _write(
        tmp_path / "pose.csv", {"t": t, "x": east, "y": north, "yaw": psi, "u": 1.5 + 0.0 * psi + 0.01 * psi}
    )
    _write(tmp_path / "ctd.csv", {"t": t + 0.05, "depth": 3.0 + np.sin(0.1 * t)})
    run = read_log(tmp_path)
    assert np.nanmin(run.channels["z"]) > 1.9
    np.testing.assert_allclose(run.channels["x"][:50], np.interp(run.t[:50], t, north), atol=0.05)


def test_a_folder_is_one_log_with_every_sample_at_its_own_time(tmp_path: Path) -> None:
    pose, gyro, motor = _folder(tmp_path)
    log = read_field_log(tmp_path)
    assert [*log.series] == ["gyro", "motors", "pose"]
    for name, t in (("pose", pose), ("gyro", gyro), ("motors", motor)):
        np.testing.assert_allclose(log.series[name].t, t, atol=1e-6)
    run = read_log(tmp_path, channels=COMMANDS)
    for name, values in _motion(run.t).items():
        there = np.isfinite(run.reports(name))
        assert np.count_nonzero(there) > 0.9 * len(gyro if name == "r" else pose)
        np.testing.assert_allclose(run.reports(name)[there], values[there], atol=1e-6)
    held = np.searchsorted(motor, run.t + 1e-6) - 1
    for name, values in _thrust(motor).items():  # rows in which one changes have its mean
        assert np.mean(np.isclose(run.channels[name], values[held], atol=1e-9)) > 0.9


def test_several_files_are_the_same_log_whatever_they_are_called(tmp_path: Path) -> None:
    _folder(tmp_path, "dive 7_")
    files = [*tmp_path.glob("*.csv")]
    folder, alone = read_log(tmp_path, channels=COMMANDS), read_log(files, channels=COMMANDS)
    assert [*one_run(files).series] == ["gyro", "motors", "pose"], "what all names share is no part of them"
    assert folder.sha256 == alone.sha256
    for name, values in folder.channels.items():
        np.testing.assert_array_equal(values, alone.channels[name])


def test_map_and_import_make_one_table_of_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _folder(tmp_path)
    monkeypatch.chdir(tmp_path)
    files = ["pose.csv", "gyro.csv", "motors.csv"]
    assert main(["map", "new", *files, "--out", "log.toml"]) == 0
    assert "does the heading grow clockwise" in Path("log.toml").read_text()
    assert main(["import", *files, "--map", "log.toml", "--out", "own/dive.parquet"]) == 2, "no such folder"
    assert main(["import", *files, "--map", "log.toml", "--out", "dive.parquet"]) == 0
    imported = read_log(Path("dive.parquet"), read_mapping(Path("dive.toml")))
    direct = read_log([Path(file) for file in files], read_mapping(Path("log.toml")))
    assert {"x", "y", "psi", "r"} < {*imported.channels}
    for name, values in imported.channels.items():
        np.testing.assert_allclose(values, direct.channels[name], atol=1e-9)


def test_what_is_no_table_with_a_time_is_left_out_and_named(tmp_path: Path) -> None:
    _folder(tmp_path)
    (tmp_path / "parameters.csv").write_text("name,value\nm,12\nI_z,3\n")
    (tmp_path / "notes.txt").write_text("calm")
    (note,) = read_field_log(tmp_path).notes
    assert note.startswith("left out: parameters.csv (no column contains the time")


def test_fractions_of_a_second_without_their_zeros_are_read_and_named(tmp_path: Path) -> None:
    """Nanoseconds printed as they count, in every table of a bag that was written to text, some rows late."""
    for name, step, made in (("pose", 0.0521, _motion), ("motors", 0.1003, _thrust)):
        t = 10.0 + np.arange(0.0, 8.0, step)
        t[40], t[41] = t[41], t[40]  # two threads wrote into one file
        stamps = [f"2025/04/11 12:08:{int(s):02d}.{round(1e9 * (s % 1.0))}" for s in t]
        _write(tmp_path / f"{name}.csv", {"time": np.array(stamps)} | made(t) | {"true": t})
    log = read_field_log(tmp_path)
    for one in log.series.values():
        late = np.array(one.columns["true"]) - one.t
        np.testing.assert_allclose(late, late[0], atol=1e-6)
    assert log.notes[0].endswith("; so do 1 more tables")
    assert "lack zeros before the fraction of a second: read as 2025-04-11T12:08:10.0" in log.notes[0]


def test_runs_are_not_joined(tmp_path: Path) -> None:
    for name in ("monday.csv", "tuesday.csv"):
        _write(tmp_path / name, {"t": np.arange(9.0), "x": np.arange(9.0), "u": np.ones(9)})
    with pytest.raises(
        UndertowError, match=r"monday.csv and tuesday.csv have the same columns .* so they are separate"
    ):
        read_log(tmp_path)


def test_folders_in_a_folder_are_topics_of_its_run(tmp_path: Path) -> None:
    """Recorded in local time, two hours ahead of the stamps; what has no stamp is in local time alone."""
    t, zone = np.arange(0, 40, 0.1), 7200.0
    at = _motion(t)
    stamps = {"header_stamp_secs": _whole(t) // 10**9, "header_stamp_nsecs": _whole(t) % 10**9}
    for name, late, columns in (
        ("navigation/pose", 0.3, stamps | {"position_x": at["x"], "position_y": at["y"]}),
        ("navigation/twist_ned", 0.5, stamps | {"linear_x": np.gradient(at["x"], t)}),
        ("actuators/left/thruster", 0.0, {"throttle": np.sin(t), "current": np.cos(t)}),
        ("actuators/right/thruster", 0.0, {"throttle": np.cos(t), "current": np.sin(t)}),
    ):
        path = tmp_path / f"{name}.csv"
        path.parent.mkdir(parents=True, exist_ok=True)
        _write(path, {"time_ns": _whole(t + zone + late)} | columns)
    (tmp_path / "navigation" / "events.csv").write_text("")
    log = read_field_log(tmp_path)
    assert [*log.series] == [
        "actuators.left.thruster", "actuators.right.thruster", "navigation.pose", "navigation.twist_ned",
    ]  # fmt: skip
    for one in log.series.values():
        np.testing.assert_allclose(one.t, t, atol=1e-6)
    assert log.notes == ("left out: navigation/events.csv (empty (0 bytes))",)
    guessed = {g.column: g.channel for g in first_mapping(log).columns}
    assert guessed["navigation.pose.position_x"] == "x"
    assert not [column for column in guessed if column.endswith("current")]


def test_runs_in_folders_of_a_folder_are_not_joined(tmp_path: Path) -> None:
    for name in ("monday", "tuesday"):
        (tmp_path / name).mkdir()
        _folder(tmp_path / name)
    with pytest.raises(UndertowError, match="folders monday and tuesday have files of the same names, so"):
        read_log(tmp_path)
    assert read_log(tmp_path / "monday").name == "monday"
    late = pl.read_csv(tmp_path / "monday" / "gyro.csv").with_columns(pl.col("t_ns") + 3600 * 10**9)
    late.write_csv(tmp_path / "monday" / "gyro.csv")
    with pytest.raises(UndertowError, match=r"table 'pose' ends 3.56e.03 s before 'gyro' begins: they"):
        read_log(tmp_path / "monday")


def test_one_thruster_a_file_is_no_run_of_its_own(tmp_path: Path) -> None:
    """As topics with one number each are written: the columns are the same, the files are not."""
    pose, *_ = _folder(tmp_path)
    (tmp_path / "motors.csv").unlink()
    late = 0.05 * np.random.default_rng(1).random(len(pose))
    for k, (name, values) in enumerate(_thrust(pose).items()):
        stamps = {"%time": _whole(pose + late), "field.header.stamp": _whole(pose + 0.01 * k)}
        _write(tmp_path / f"{name}.csv", stamps | {"field.data": values})
    log = read_field_log(tmp_path)
    assert {"left_motor", "right_motor"} < {*log.series}
    np.testing.assert_allclose(log.series["right_motor"].t, pose + 0.01, atol=1e-6)
    assert [*log.series["right_motor"].columns] == ["field.data"]
    run = read_log(tmp_path, channels=COMMANDS)
    there = run.t > 0.02
    np.testing.assert_allclose(run.channels["left_motor"][there], np.sin(0.5 * run.t[there]), atol=0.06)


def test_only_tables_can_be_several_files(tmp_path: Path) -> None:
    _folder(tmp_path)
    (tmp_path / "dive.alog").write_text("%%% LOG FILE\n1.0 NAV_X a 2.0\n")
    with pytest.raises(
        UndertowError, match=r"dive.alog is MOOS, and only tables can be given as several files"
    ):
        read_log([tmp_path / "pose.csv", tmp_path / "dive.alog"])
    with pytest.raises(UndertowError, match="does not exist"):
        read_log([tmp_path / "pose.csv", tmp_path / "gone.csv"])
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(UndertowError, match="is a folder without tables: give the path of a log in it"):
        read_log(empty)


@pytest.mark.parametrize("begin", [0, 1_700_000_000])
def test_stamps_in_two_columns_are_the_clock_of_one_table_too(
    begin: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    t = np.arange(0.05, 40, 0.13)
    columns = {"stamp.sec": begin + t.astype(int), "stamp.nanosec": np.round(1e9 * (t % 1.0)).astype(int)}
    _write(tmp_path / "dive.csv", columns | _motion(t) | _thrust(t))
    assert main(["map", "new", "dive.csv", "--out", "log.toml"]) == 0
    mapping = read_mapping(tmp_path / "log.toml")
    time = mapping.time
    assert (time.column, time.nanoseconds, time.unit) == ("stamp.sec", "stamp.nanosec", "s")
    run = read_log(tmp_path / "dive.csv", mapping, channels=COMMANDS)
    np.testing.assert_allclose(np.diff(run.t), 0.13, atol=1e-9)
    np.testing.assert_allclose(run.channels["x"], _motion(t)["x"], atol=1e-6)
    (tmp_path / "folder").mkdir()
    _write(tmp_path / "folder" / "dive.csv", columns | _motion(t))
    np.testing.assert_allclose(np.diff(read_field_log(tmp_path / "folder").series["dive"].t), 0.13, atol=1e-6)
    text = (tmp_path / "log.toml").read_text(encoding="utf-8")
    (tmp_path / "ms.toml").write_text(text.replace('unit = "s"', 'unit = "ms"', 1), encoding="utf-8")
    with pytest.raises(UndertowError, match=r"nanoseconds belong to a column in s, but unit is 'ms'"):
        read_mapping(tmp_path / "ms.toml")


def test_what_reports_later_than_the_rows_that_are_looked_at_is_seen(tmp_path: Path) -> None:
    """A recorder of the motion that ran for minutes before the motors were switched on."""
    t = np.arange(0.0, 300.0, 0.01)
    late = t[t > 250.0]
    _write(tmp_path / "pose.csv", {"time": t} | _motion(t))
    _write(tmp_path / "motors.csv", {"time": late} | _thrust(late))
    found = {g.channel for g in first_mapping(read_field_log(tmp_path)).columns}
    assert {"x", "y", "psi", "r", "motors.left_motor", "motors.right_motor"} <= found


def test_clocks_that_do_not_all_count_since_1970_are_noted_once(tmp_path: Path) -> None:
    t = np.arange(0.0, 40.0, 0.1)
    late = np.where(t == t[200], t[199], t)
    _write(tmp_path / "pose.csv", {"time": BEGIN + late} | _motion(t))
    _write(tmp_path / "motors.csv", {"time": 5.0 + t} | _thrust(t))
    log = read_field_log(tmp_path)
    assert "since 1970: its first time is taken for 0 s of motors (first at 5 s)" in log.notes[0]
    assert len({*log.notes}) == len(log.notes) == 2
    assert {*log.series["pose"].t[:1]} == {0.0}


def test_a_table_of_another_name_is_no_unknown_format(tmp_path: Path) -> None:
    """As gliders number their files."""
    rows = "Timestamp;Depth\n23/07/2019 04:01:49;9.4\n23/07/2019 04:01:59;8.7\n"
    (tmp_path / "gli.sub.47").write_text(rows)
    with pytest.raises(UndertowError, match="is a table, which every command reads directly"):
        read_field_log(tmp_path / "gli.sub.47")
    (tmp_path / "notes.47").write_text("a dive\n\nof some length\n")
    with pytest.raises(UndertowError, match="has an unknown format"):
        read_field_log(tmp_path / "notes.47")


def test_units_in_cells_and_below_the_names_are_those_of_the_columns(tmp_path: Path) -> None:
    t = np.arange(0, 40, 0.1)
    at = _motion(t)
    pose = {"t": t, "x": 100 * at["x"], "y": 100 * at["y"], "yaw": np.degrees(at["psi"])}
    texts = {n: [f"{v:.5f}{unit}" for v in pose[n]] for n, unit in (("x", "cm"), ("y", "cm"), ("yaw", "deg"))}
    pl.DataFrame(pose | texts).write_csv(tmp_path / "pose.csv")
    rates = np.degrees(at["r"])
    (tmp_path / "imu.csv").write_text(
        "\n".join(["t,yaw_rate", "s,deg/s", *(f"{a:.2f},{r:.6f}" for a, r in zip(t, rates, strict=True))])
    )
    run = read_log(tmp_path)
    for name, values in at.items():
        np.testing.assert_allclose(run.channels[name], values, atol=1e-6)
    known = {"pose.x": Column(channel="x"), "pose.yaw": Column(channel="psi", unit="rad")}
    with pytest.raises(UndertowError, match=r"'pose\.yaw' state deg, but the mapping file rad: write unit"):
        read_log(tmp_path, LogMapping(columns=known))
    alone = read_log(tmp_path, LogMapping(columns={"pose.x": known["pose.x"]}))
    np.testing.assert_allclose(alone.channels["x"], at["x"], atol=1e-6)


def test_of_the_table_of_a_motor_only_what_can_be_a_command_is_one(tmp_path: Path) -> None:
    _folder(tmp_path)
    t = np.arange(0.5, 40, 0.25)
    swings = {n: 2.0 + np.sin(t + k) for k, n in enumerate(("volts1", "volts2", "mode", "id", "heat [degC]"))}
    drawn = {"drawn": [f"{2 + v:.3f}A" for v in np.sin(t)]}
    pl.DataFrame({"t_ns": _whole(t), **_thrust(t), **swings, **drawn}).write_csv(tmp_path / "motors.csv")
    guessed = first_mapping(one_run([tmp_path]))
    assert {g.channel for g in guessed.columns} - {"x", "y", "psi", "r", "phi", "theta"} == {
        f"motors.{name}" for name in COMMANDS
    }


def test_a_table_of_another_time_than_the_motions_is_noted(tmp_path: Path) -> None:
    _folder(tmp_path)
    assert not [note for note in one_run([tmp_path]).notes if "motions" in note]
    t = np.arange(60.0, 100.0, 0.25)
    _write(tmp_path / "motors.csv", {"t_ns": _whole(t), **_thrust(t)})
    (note,) = (note for note in one_run([tmp_path]).notes if "motions" in note)
    assert note.startswith("motors begins 20 s after the motions end: is it of this run?")


@pytest.mark.parametrize(("late", "asked"), [(0.0, False), (40.0, True), (-90.0, True)])
@pytest.mark.parametrize("place", ["x", "lat", ""])
def test_clocks_that_are_far_apart_are_asked_about(
    tmp_path: Path, late: float, place: str, *, asked: bool
) -> None:
    """By a heading and a yaw rate, or by a position and a speed; the delay that is proposed puts it right."""
    rng, t = np.random.default_rng(5), np.arange(0.0, 300.0, 0.1)
    width = np.exp(-0.5 * (np.arange(-100, 101) / 30.0) ** 2)
    r, u = (size * np.convolve(rng.normal(size=len(t)), width, "same") for size in (0.02, 0.05))
    psi, u = 0.1 * np.cumsum(r), 2.0 + u
    track = {"x": 0.1 * np.cumsum(u * np.cos(psi)), "y": 0.1 * np.cumsum(u * np.sin(psi))}
    if place == "lat":
        track = {"lat": 63.4 + track["x"] / 111_450.0, "lon": 10.4 + track["y"] / 49_990.0}
    _write(
        tmp_path / "pose.csv",
        {"t": t[::2]} | {n: v[::2] for n, v in (track if place else {"psi": psi}).items()},
    )
    _write(tmp_path / "imu.csv", {"t": t + late, **({"u": u} if place else {"r": r})})
    log = one_run([tmp_path])
    questions = [q for q in log.remarks if "its columns need delay" in q]
    assert bool(questions) is asked
    assert [q for q in first_mapping(log).questions if "its columns need delay" in q] == questions
    if asked:
        assert float(questions[0].split('delay = "')[1].split()[0]) == pytest.approx(late, abs=1.0)


def test_clocks_of_a_motion_that_repeats_itself_are_not_asked_about(tmp_path: Path) -> None:
    t = np.arange(0.0, 300.0, 0.1)
    _write(tmp_path / "pose.csv", {"t": t, "psi": np.sin(0.3 * t)})
    _write(tmp_path / "imu.csv", {"t": t + 40.0, "r": 0.3 * np.cos(0.3 * t)})
    assert not [q for q in one_run([tmp_path]).remarks if "its columns need delay" in q]


def test_rows_of_several_things_in_one_table_are_told_apart_by_their_number(tmp_path: Path) -> None:
    """As an LAUV writes the positions of its fins."""
    _folder(tmp_path)
    t = np.arange(0.0, 40.0, 0.1)
    turns = {k: 0.1 * np.sin(0.3 * t + k) for k in range(4)}
    rows = sorted((a, k, v) for k, values in turns.items() for a, v in zip(t + 1e-4 * k, values, strict=True))
    at, number, value = (np.array(column) for column in zip(*rows, strict=True))
    _write(tmp_path / "SetServoPosition.csv", {"t_ns": _whole(at), "id": number, "value (rad)": value})
    log = one_run([tmp_path])
    assert [name for name in log.series if "Servo" in name] == [f"SetServoPosition[{k}]" for k in range(4)]
    guessed = {g.column: g.entry["unit"] for g in first_mapping(log).columns if "Servo" in g.column}
    assert guessed == {f"SetServoPosition[{k}].value (rad)": "rad" for k in range(4)}
    (asked,) = guess_mapping(tmp_path / "SetServoPosition.csv").questions
    assert "'id' numbers several things whose rows take turns" in asked
    assert not log.actuators, "no motors that a vehicle with four thrusters takes for its own"
    for k, values in turns.items():
        np.testing.assert_allclose(log.series[f"SetServoPosition[{k}]"].columns["value (rad)"], values)
