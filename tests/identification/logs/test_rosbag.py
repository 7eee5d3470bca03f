"""Bags of ROS: the dive comes back from every kind, frames and message types are what they say."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.quick import first_quick
from undertow.cli.main import main
from undertow.errors import UndertowError
from undertow.identification.doctor.examine import examine
from undertow.identification.logs.formats import rosbag
from undertow.identification.logs.formats.by_name import first_mapping
from undertow.identification.logs.formats.fieldlog import format_of, read_field_log
from undertow.identification.logs.mapping import read_mapping
from undertow.identification.logs.reading import read_log, read_logs
from undertow.model.loading import load_vehicle

from .dive import dive
from .field import FIELD
from .written import BAGS, BagWriter, assert_the_dive, bag, cut_off, enu

pytest.importorskip("rosbags")
_REAL = FIELD / "ros2"
_BAGS = sorted(BAGS)


@pytest.mark.parametrize("name", _BAGS)
def test_the_dive_comes_back(tmp_path: Path, name: str) -> None:
    path = bag(tmp_path / name, dive())
    (run,) = read_logs([path], load_vehicle("bluerov2"))
    assert_the_dive(run, dive(), 1e-9)
    assert run.mapping is not None
    assert (run.mapping.frames.position, run.mapping.frames.body) == ("ENU", "FLU")


def test_messages_are_decoded_a_few_at_a_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = bag(tmp_path / "dive.mcap", dive())
    monkeypatch.setattr(rosbag, "SETTINGS", replace(rosbag.SETTINGS, together=7))
    (run,) = read_logs([path], load_vehicle("bluerov2"))
    assert_the_dive(run, dive(), 1e-9)
    monkeypatch.setattr(rosbag, "SETTINGS", replace(rosbag.SETTINGS, kept=100_000))
    with pytest.raises(UndertowError, match=r"more than 0.1 MB of messages .* rosbags-convert --src"):
        read_field_log(path)


def test_a_folder_of_rosbag2_is_one_log(tmp_path: Path) -> None:
    path = bag(tmp_path / "dive.mcap", dive()).parent
    assert (path / "metadata.yaml").exists()
    (run,) = read_logs([path], load_vehicle("bluerov2"))
    assert_the_dive(run, dive(), 1e-9)
    assert read_field_log(path).format == "ROS bag"  # `undertow import` reads it by this
    assert format_of(tmp_path) is None


def test_frames_that_say_ned_and_frd_are_taken_so(tmp_path: Path) -> None:
    path = bag(tmp_path / "dive.db3", dive(), down=True)
    (run,) = read_logs([path], load_vehicle("bluerov2"))
    assert_the_dive(run, dive(), 1e-9)
    assert run.mapping is not None
    assert (run.mapping.frames.position, run.mapping.frames.body) == ("NED", "FRD")


@pytest.mark.slow
def test_a_twist_along_the_axes_of_the_world_is_found_by_the_doctor(tmp_path: Path) -> None:
    path, vehicle = bag(tmp_path / "dive.mcap", dive(), world=True), load_vehicle("bluerov2")
    found = examine(vehicle, read_logs([path], vehicle))
    (mistake,) = [finding for finding in found.result.findings if finding.severity == "mistake"]
    assert mistake.mapping == '[frames]\nvelocity = "ENU"'
    assert_the_dive(found.mended[0], dive(), 1e-9)
    right = examine(vehicle, read_logs([bag(tmp_path / "body.mcap", dive())], vehicle))
    assert not [finding for finding in right.result.findings if finding.severity == "mistake"]


def test_a_twist_in_the_frame_of_the_pose_is_taken_along_its_axes(tmp_path: Path) -> None:
    position, q, twist, east_north_up = enu(dive())
    with BagWriter(tmp_path / "dive.mcap") as out:
        for k, t in enumerate(dive().t):
            moved = np.hstack([east_north_up[k], twist[k, 3:]])
            out.write("/odom", t, out.odometry(float(t), ("map", "map"), position[k], q[k], moved))
    run = read_log(out.path)
    for name, values in zip("uvw", dive().velocity.T, strict=True):
        assert run.channels[name] == pytest.approx(values, abs=1e-9)
    assert "p" not in run.channels


def test_of_two_odometries_the_one_that_reports_most_is_taken(tmp_path: Path) -> None:
    position, q, twist, _ = enu(dive())
    with BagWriter(tmp_path / "dive.bag") as out:
        for k, t in enumerate(dive().t):
            frames = ("odom", "base_link")
            out.write("/fast", t, out.odometry(float(t), frames, position[k], q[k], twist[k]))
            if k % 4 == 0:
                out.write("/slow", t, out.odometry(float(t), frames, 2 * position[k], q[k], twist[k]))
    log = read_field_log(out.path)
    assert {name.split(".")[0] for name in log.mapping.columns} == {"/fast"}
    assert any("/slow" in note and "not used" in note for note in log.remarks)


def test_angles_in_the_place_of_a_quaternion_are_no_attitude_and_commands_no_measurement(
    tmp_path: Path,
) -> None:
    """Small programs put what they have into the message at hand: angles, percentages, nothing."""
    position, _, twist, _ = enu(dive())
    with BagWriter(tmp_path / "dive.bag") as out:
        for k, t in enumerate(dive().t):
            at, heading = float(t), float(dive().pose[k, 5])
            turned, rest = np.array([heading, 0.01, -0.02, heading + 6.0]), np.zeros(4)
            percent = np.array([40.0, -10.0, 5.0])
            out.write("/rov_odometry", at, out.odometry(at, ("ok", "base"), position[k], turned, twist[k]))
            for again in (0.0, 0.01):
                sent = out.odometry(at + again, ("manual", "base"), percent, rest, 0 * twist[k])
                out.write("/rov_commands", at + again, sent)
    log = read_field_log(out.path)
    run = read_log(out.path)
    assert run.channels["z"] == pytest.approx(-position[:, 2], abs=1e-9)
    assert "psi" not in run.channels
    said = [note for note in log.remarks if "is no quaternion" in note]
    assert len(said) == 1, "nothing is said of what is left empty"
    assert said[0].startswith("/rov_odometry: pose.pose.orientation is no quaternion (length up to ")


@pytest.mark.parametrize(("frame", "known"), [("odom", True), ("HEALTHY", False), ("rov1/base_link", True)])
def test_the_state_of_a_vehicle_in_place_of_a_frame_says_nothing_of_axes(
    tmp_path: Path, frame: str, known: bool
) -> None:
    position, q, twist, _ = enu(dive())
    with BagWriter(tmp_path / "dive.mcap") as out:
        for k, t in enumerate(dive().t):
            out.write("/odom", t, out.odometry(float(t), (frame, ""), position[k], q[k], twist[k]))
    assert any("which says nothing of axes" in note for note in read_log(out.path).reader_notes) is not known


@pytest.mark.parametrize(("topic", "position"), [("/ins/NED_pose", "NED"), ("/ins_pose", "ENU")])
@pytest.mark.parametrize("suffix", ["bag", "mcap"])
def test_a_pose_in_the_plane_is_read(tmp_path: Path, suffix: str, topic: str, position: str) -> None:
    """As boats have it: x, y and an angle, without a header; its axes are those of the topic's name."""
    north, east, heading = dive().pose[:, 0], dive().pose[:, 1], dive().pose[:, 5]
    down = position == "NED"
    x, y, angle = (north, east, heading) if down else (east, north, np.pi / 2 - heading)
    with BagWriter(tmp_path / f"boat.{suffix}") as out:
        for k, t in enumerate(dive().t):
            pose = dict(zip(("x", "y", "theta"), map(float, (x[k], y[k], angle[k])), strict=True))
            out.write(topic, float(t), out.message("geometry_msgs/msg/Pose2D", **pose))
            out.write("/thrusters/input", float(t), out.commands(dive().thrust[k]))
    run = read_log(out.path)
    assert run.mapping is not None
    assert run.mapping.frames.position == position
    np.testing.assert_allclose(run.channels["x"], north, atol=1e-9)
    np.testing.assert_allclose(run.channels["y"], east, atol=1e-9)
    np.testing.assert_allclose(np.exp(1j * run.channels["psi"]), np.exp(1j * heading), atol=1e-9)
    assert any("names no frame" in note for note in run.reader_notes) is not down


def _boat(path: Path) -> Path:
    """As a boat in a pool logs itself: degrees, a set-point and the pose of one type; thrusters by side."""
    north, east, heading = dive().pose[:, 0], dive().pose[:, 1], dive().pose[:, 5]
    with BagWriter(path) as out:
        float_ = out.store.types["std_msgs/msg/Float64"]
        for k, t in enumerate(map(float, dive().t)):
            for delay in (0.0, 0.01):  # of the three the most frequent, though no place in metres
                degrees = {"x": 25.65 + north[k] / 111e3, "y": -100.29 + east[k] / 100e3, "theta": heading[k]}
                out.write("/ins_2d/ins_pose", t + delay, out.message("geometry_msgs/msg/Pose2D", **degrees))
            pose = {"x": north[k], "y": east[k], "theta": heading[k]}
            out.write("/ins_2d/NED_pose", t, out.message("geometry_msgs/msg/Pose2D", **pose))
            still = {"x": 1.0, "y": 2.0, "theta": 0.0}
            out.write("/ned/trajectory", t, out.message("geometry_msgs/msg/Pose2D", **still))
            out.write("/ned/trajectory", t + 0.01, out.message("geometry_msgs/msg/Pose2D", **still))
            for side, thrust in (("left", 5.0 + k % 7), ("right", 30.0)):
                out.write(f"/controller/{side}_thruster", t, float_(data=thrust))
    return path


def test_a_pose_that_names_its_axes_is_believed_before_one_that_does_not_and_before_a_set_point(
    tmp_path: Path,
) -> None:
    log = read_field_log(_boat(tmp_path / "boat.bag"))
    assert {name.split(".")[0] for name in log.mapping.columns} == {"/ins_2d/NED_pose"}
    assert log.mapping.frames.position == "NED"
    for other in ("/ins_2d/ins_pose", "/ned/trajectory"):
        because = "is not used: x, y, psi are those of /ins_2d/NED_pose"
        assert f"{other} (geometry_msgs/msg/Pose2D) {because}" in log.remarks


def test_a_first_mapping_of_a_bag_finds_the_commands_of_a_vehicle_and_asks_whether_they_are(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "300")
    monkeypatch.chdir(tmp_path)
    _boat(tmp_path / "boat.bag")
    size = ["--length", "1", "--beam", "0.4", "--height", "0.1", "--mass", "30"]
    assert main(["vehicle", "new", "--type", "asv", *size, "--out", "v.toml"]) == 0
    vehicle = load_vehicle("v.toml")
    with pytest.raises(UndertowError, match=r"no recognised motors, but .* port, starboard: .*map new boat"):
        read_logs([Path("boat.bag")], vehicle)
    assert main(["map", "new", "boat.bag", "--vehicle", "v.toml", "--out", "log.toml"]) == 0
    said = capsys.readouterr()
    assert "/controller/left_thruster.data: is it command 'port'? from 0 to 11:" in said.out
    # what the mapping file is to be checked for: no command that reads the log with it repeats that
    assert "/ned/trajectory (geometry_msgs/msg/Pose2D) is not used" in said.out + said.err
    (run,) = read_logs([Path("boat.bag")], vehicle, read_mapping("log.toml"))
    assert run.channels["port"][:3] == pytest.approx([5.0, 6.0, 7.0])
    assert run.channels["x"] == pytest.approx(dive().pose[:, 0])
    assert run.reader_notes == ("read as ROS bag",)  # not what would have been chosen without it
    assert main(["import", "boat.bag", "--vehicle", "v.toml", "--out", "table.parquet"]) == 0
    (same,) = read_logs([Path("table.parquet")], vehicle, read_mapping("table.toml"))
    assert same.channels["starboard"] == pytest.approx(run.channels["starboard"])


def test_commands_that_no_column_is_called_like_are_asked_for(tmp_path: Path) -> None:
    vehicle = load_vehicle("mini-auv")
    found = first_mapping(read_field_log(_boat(tmp_path / "boat.bag")), vehicle)
    heave, commands = found.questions
    assert heave.startswith("no column looks like heave (w or z) of the vehicle")
    assert commands.startswith("no column looks like f1, f2, f3, f4 of the vehicle: which ones are they")
    (others,) = found.ignored.values()
    assert others == ("/controller/left_thruster.data", "/controller/right_thruster.data")
    assert found.meaning.ignore == others


def test_velocities_in_plain_vectors_are_asked_about(tmp_path: Path) -> None:
    """A vector says neither unit nor axes; one that no name calls a velocity, or of zeros, is none."""
    with BagWriter(tmp_path / "boat.bag") as out:
        for k, t in enumerate(map(float, dive().t)):
            pose = {"x": dive().pose[k, 0], "y": dive().pose[k, 1], "theta": dive().pose[k, 5]}
            out.write("/NED_pose", t, out.message("geometry_msgs/msg/Pose2D", **pose))
            out.write("/local_vel", t, out.vector(*dive().velocity[k, :2], 0.0))
            out.write("/magnetic_field", t, out.vector(0.2, 0.1 * k, 0.4))
    found = first_mapping(read_field_log(out.path))
    (asked,) = found.questions
    assert asked.startswith("/local_vel.x, /local_vel.y: judging by their names, velocities")
    assert found.meaning.ignore == ("/local_vel.x", "/local_vel.y"), "an import writes them, too"


_DVL = """
uint8 DVL_MODE_BOTTOM=1
uint8 DVL_MODE_WATER=2
std_msgs/Header header
uint8 velocity_mode
geometry_msgs/Vector3 velocity
float64 altitude
bool beam_velocities_valid
"""


def _sensors(path: Path) -> BagWriter:
    """An inertial unit, a pressure sensor in hPa and a Doppler log that loses the bottom for 10 s."""
    _, q, twist, _ = enu(dive())
    none = np.zeros(9)
    with BagWriter(path) as out:
        out.define(_DVL, "marine_acoustic_msgs/msg/Dvl")
        for k, t in enumerate(dive().t):
            at: dict[str, Any] = {"header": (float(t), "imu_link")}
            imu = out.message(
                "sensor_msgs/msg/Imu", **at, orientation=out.quaternion(*map(float, q[k])),
                angular_velocity=out.vector(*twist[k, 3:]), linear_acceleration=out.vector(0, 0, 9.81),
                orientation_covariance=none, angular_velocity_covariance=none,
                linear_acceleration_covariance=none)  # fmt: skip
            pressure = 1013.25 + dive().pose[k, 2] * 1025.0 * 9.81 / 100.0
            baro = out.message(
                "sensor_msgs/msg/FluidPressure", header=(float(t), ""), fluid_pressure=pressure, variance=0.0
            )
            water = 20.0 <= t < 30.0
            lost = 40.0 <= t < 41.0
            dvl = out.message(
                "marine_acoustic_msgs/msg/Dvl", header=(float(t), "dvl"), velocity_mode=2 if water else 1,
                velocity=out.vector(*(dive().velocity[k] + (0.5 if water else 0.0))), altitude=7.5,
                beam_velocities_valid=not lost)  # fmt: skip
            for topic, message in (("/imu/data", imu), ("/baro", baro), ("/dvl", dvl)):
                out.write(topic, float(t), message)
    return out


@pytest.mark.parametrize("name", first_quick(_BAGS))
def test_sensors_without_odometry(tmp_path: Path, name: str) -> None:
    log = read_field_log(_sensors(tmp_path / name).path)
    run = read_log(log.path)
    t = dive().t
    bottom = ((t < 20.0) | (t >= 30.0)) & ((t < 40.0) | (t >= 41.0))
    for channel, values in zip("uvw", dive().velocity.T, strict=True):
        assert run.channels[channel][bottom] == pytest.approx(values[bottom], abs=1e-9)
        assert np.isnan(run.channels[channel][~bottom]).all()
    assert run.channels["z"] == pytest.approx(dive().pose[:, 2], abs=1e-6)
    assert run.channels["r"] == pytest.approx(dive().rates[:, 2], abs=1e-9)
    assert run.channels["theta"] == pytest.approx(dive().pose[:, 4], abs=1e-9)
    assert run.channels["altitude"] == pytest.approx(7.5)
    water = log.series["/dvl"].columns["water.x"]
    assert np.array_equal(np.isfinite(water), (t >= 20.0) & (t < 30.0))
    assert any("hPa" in note and "1025 kg/m^3" in note for note in log.remarks)


def test_a_twist_that_no_sensor_fills_gives_way(tmp_path: Path) -> None:
    """An inertial unit sends a twist without speeds, a Doppler log one with them; 0.2 bar is no hPa."""
    none = np.zeros(36)
    with BagWriter(tmp_path / "dive.bag") as out:
        make = out.store.types
        for k, t in enumerate(dive().t):
            speed, turn = (out.vector(*row[k]) for row in (dive().velocity, dive().rates))
            still = out.vector(0.0, 0.0, 0.0)
            imu = make["geometry_msgs/msg/Twist"](linear=still, angular=turn)
            imu = make["geometry_msgs/msg/TwistWithCovariance"](twist=imu, covariance=none)
            dvl = make["geometry_msgs/msg/Twist"](linear=speed, angular=still)
            at: dict[str, Any] = {"header": (float(t), "base_frd")}
            out.write(
                "/imu", float(t), out.message("geometry_msgs/msg/TwistWithCovarianceStamped", **at, twist=imu)
            )
            out.write("/dvl", float(t), out.message("geometry_msgs/msg/TwistStamped", **at, twist=dvl))
            baro = out.message("sensor_msgs/msg/FluidPressure", **at, fluid_pressure=0.2, variance=0.0)
            out.write("/pressure", float(t), baro)
    log = read_field_log(out.path)
    run = read_log(out.path)
    assert run.channels["u"] == pytest.approx(dive().velocity[:, 0], abs=1e-9)
    assert run.channels["r"] == pytest.approx(dive().rates[:, 2], abs=1e-9)
    assert "z" not in run.channels
    assert any("/pressure: a pressure of 0.2 is neither Pa nor hPa" in note for note in log.remarks)
    assert any("no topic is recognised as thruster commands" in note for note in log.remarks)


def test_commands_one_by_one_are_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "dive.mcap") as out:
        float_ = out.store.types["std_msgs/msg/Float64"]
        for t in np.arange(20) * 0.1:
            for k in (10, 2, 0):
                out.write(f"/rov/thrusters/{k}/input", float(t), float_(data=float(k)))
    actuators = read_field_log(out.path).actuators
    assert [name for name, _ in actuators] == [f"/rov/thrusters/{k}/input.data" for k in (0, 2, 10)]


def test_messages_of_ones_own_are_read_by_their_definition_from_a_folder(tmp_path: Path) -> None:
    text = "std_msgs/Header header\nfloat32 rpm\nuint8[3] state\nmy_msgs/Cell[] cells\n"
    with BagWriter(tmp_path / "esc.db3") as out:
        out.define("float32 volt\n", "my_msgs/msg/Cell")
        out.define(text, "my_msgs/msg/Esc")
        cell = out.store.types["my_msgs/msg/Cell"]
        for k in range(5):
            message = out.message(
                "my_msgs/msg/Esc", header=(0.1 * k, "esc"), rpm=float(k), state=np.array([1, 2, k], np.uint8),
                cells=[cell(volt=4.0)] * (k % 3))  # fmt: skip
            out.write("/esc", 0.1 * k, message)
    _forget_definitions(out.path)
    with pytest.raises(
        UndertowError, match=r"no message with numbers.*/esc .* unknown type my_msgs.*--messages"
    ):
        read_field_log(out.path)
    folder = tmp_path / "ws" / "my_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Esc.msg").write_text(text, encoding="utf-8")
    (folder / "Cell.msg").write_text("float32 volt\n", encoding="utf-8")
    columns = read_field_log(out.path, tmp_path / "ws").series["/esc"].columns
    assert columns["rpm"] == pytest.approx(np.arange(5.0))
    assert columns["state[2]"] == pytest.approx(np.arange(5.0))
    assert columns["cells[1].volt"] == pytest.approx([np.nan, np.nan, 4.0, np.nan, np.nan], nan_ok=True)


@pytest.mark.parametrize("name", ["dive.db3", "dive.mcap"])
def test_events_of_services_do_not_hide_the_rest(tmp_path: Path, name: str) -> None:
    """Since Iron, bags hold them, by a definition that is none of a message."""
    with BagWriter(tmp_path / name) as out:
        out.write("/depth", 0.0, out.store.types["std_msgs/msg/Float32"](data=1.0))
        event = out.writer.add_connection(
            "/arm/_service_event",
            "my_msgs/srv/Arm_Event",
            msgdef="bool on\n---\nbool done",
            rihs01="RIHS01_0",
        )
        out.writer.write(event, out.begin * 1_000_000_000, b"\x00\x01\x00\x00")
    log = read_field_log(out.path)
    assert list(log.series) == ["/depth"]
    assert log.notes == ()


def _forget_definitions(path: Path) -> None:
    """As ROS 2 wrote bags before Iron: without the definitions of messages."""
    import sqlite3

    base = sqlite3.connect(path)
    base.execute("DELETE FROM message_definitions")
    base.commit()
    base.close()


def test_stamps_of_another_clock_are_not_mixed_with_that_of_the_bag(tmp_path: Path) -> None:
    position, q, twist, _ = enu(dive())
    with BagWriter(tmp_path / "dive.bag", begin=0) as out:
        for k, t in enumerate(dive().t[:50]):
            message = out.odometry(float(t) + 0.1, ("odom", "base_link"), position[k], q[k], twist[k])
            out.write("/odom", 1000.0 + 2.0 * float(t), message)
    log = read_field_log(out.path)
    assert log.series["/odom"].t == pytest.approx(2.0 * dive().t[:50])
    assert any("off the clock of the bag" in note for note in log.notes)


@pytest.mark.parametrize("name", _BAGS)
def test_bags_that_are_cut_off_are_read_or_refused_in_a_line(tmp_path: Path, name: str) -> None:
    cut_off(bag(tmp_path / name, dive()), read_log)


@pytest.mark.parametrize(
    ("name", "series"),
    [("wbag/wbag_0.db3", 8), ("wbag", 8), ("cdr_test/cdr_test_0.mcap", 2), ("cdr_test", 2)],
)
def test_bags_of_ros2_itself_are_read(name: str, series: int) -> None:
    if not (_REAL / name).exists():
        pytest.skip(f"the bag of rosbag2 is not at {_REAL / name}")
    log = read_field_log(_REAL / name)
    assert len(log.series) == (2 if "cdr" in name else 8)
    with pytest.raises(UndertowError, match=r"none of its series is recognised as a motion.*--out"):
        read_log(log.path)
    if "cdr" in name:
        assert list(log.series["/test_topic"].columns["int32_value"]) == [123.0] * 3


def test_messages_that_are_damaged_are_blank(tmp_path: Path) -> None:
    path = bag(tmp_path / "dive.db3", dive())
    raw = path.read_bytes()
    # the frame of one message in the middle is no text any more
    at = raw.index(b"base_link", len(raw) // 2)
    path.write_bytes(raw[:at] + b"\xff\xfe" + raw[at + 2 :])
    columns = read_field_log(path).series["/odometry"].columns
    assert np.isnan(columns["pose.pose.position.x"]).sum() == 1
    assert np.isnan(columns["pose.pose.orientation.psi"]).sum() == 1


def test_an_import_without_a_motion_has_all_columns_and_asks_what_they_are(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Lists of numbers have no names: which of them is a rate only those know who made the log."""
    monkeypatch.setenv("COLUMNS", "300")
    path = tmp_path / "own.bag"
    with BagWriter(path) as out:
        for k in range(30):
            out.write("/thrusters", 0.1 * k, out.commands(np.array([1.0, k])))
            out.write("/imu/list", 0.1 * k, out.commands(np.arange(4.0)))
    table, meaning = tmp_path / "own.parquet", tmp_path / "own.toml"
    assert main(["import", str(path), "--out", str(table)]) == 0
    assert "no column is recognised as a motion" in capsys.readouterr().out
    asked = meaning.read_text()
    assert all(f'"/imu/list.data[{k}]",' in asked for k in range(4))
    said = '"/imu/list.data[3]" = { channel = "r", unit = "deg/s" }'
    meaning.write_text(
        asked.replace('    "/imu/list.data[3]",\n', "").replace("[columns]", f"[columns]\n{said}")
    )
    run = read_log(table, read_mapping(meaning))
    np.testing.assert_allclose(run.channels["r"], np.radians(3.0))
    np.testing.assert_allclose(run.channels["/thrusters.data[0]"], 1.0)
