"""`undertow map new`: a first mapping file for a log, from names, units, ranges and what the motion says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from scipy.spatial.transform import Rotation

from undertow.cli.main import main
from undertow.errors import UndertowError
from undertow.identification.logs.guess import guess_mapping, guess_table
from undertow.identification.logs.guess_frames import Guess, GuessedMapping
from undertow.identification.logs.guess_names import Name
from undertow.identification.logs.mapping import read_mapping
from undertow.identification.logs.reading import in_vehicle_units, read_log
from undertow.identification.logs.run import Run
from undertow.model.catalogue import catalogue
from undertow.model.loading import VehicleTable, load_vehicle, vehicle_from_table
from undertow.typing import Array

from .bad import SURGE, text_of

DEGREES = 180 / np.pi


def _read(case: Path, log: str) -> dict[str, np.ndarray]:
    commands = load_vehicle(case / "usv.toml").command_names
    run = read_log(case / log, read_mapping(case / "log.toml"), commands)
    return {"t": run.t, **run.channels}


def _read_by(guessed: GuessedMapping, log: Path, *commands: Sequence[str], **channels: Sequence[str]) -> Run:
    """A log as its draft reads it, once that is a file."""
    mapping = log.with_name("log.toml")
    mapping.write_text(guessed.text())
    return read_log(log, read_mapping(mapping), *commands, **channels)


def _renamed(case: Path, **columns: pl.Expr) -> None:
    table = pl.read_csv(case / "train.csv")
    kept = load_vehicle(case / "usv.toml").command_names
    table.select(*(e.alias(n) for n, e in columns.items()), *kept).write_csv(case / "own.csv")


def test_names_units_and_ranges_are_understood(case: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _renamed(
        case,
        **{
            "timestamp": 1.6e12 + 1000 * pl.col("t"),
            "North [m]": pl.col("x"),
            "east_mm": 1000 * pl.col("y"),
            "Heading": (DEGREES * pl.col("psi")) % 360,
            "surgeVelocity_kn": pl.col("u") / 0.514444,
            "v_des_mps": 0 * pl.col("u"),
            "v_meas_mps": pl.col("v"),
            "yawRate": DEGREES * pl.col("r"),
            "note": pl.lit("calm"),
        },
    )
    assert main(["map", "new", "own.csv", "--vehicle", "usv.toml", "--out", "log.toml"]) == 0
    found, true = _read(case, "own.csv"), read_log(case / "train.csv")
    np.testing.assert_allclose(found["t"] - found["t"][0], true.t - true.t[0], atol=1e-3)
    for name in ("x", "y", "u", "v", "r"):
        np.testing.assert_allclose(found[name], true.channels[name], atol=1e-4 * np.ptp(true.channels[name]))
    turn = found["psi"] - true.channels["psi"]
    np.testing.assert_allclose(turn, 2 * np.pi * round(turn[0] / (2 * np.pi)), atol=1e-6)
    out = capsys.readouterr().out
    assert "timestamp: 50 from row to row: that is 20 rows a second if it is in ms; is it?" in " ".join(
        out.split()
    )
    text = (case / "log.toml").read_text()
    assert '"v_des_mps"' in text.partition("[time]")[0], "what was wanted is left out"
    assert '"note"' in text.partition("[time]")[0]


@pytest.mark.parametrize(
    ("columns", "frames"),
    [
        ({}, {"position": "NED", "body": "FRD"}),
        (
            {"x": pl.col("y"), "y": pl.col("x")},
            {"position": "ENU", "body": "FRD", "attitude": "NED"},
        ),
        ({"v": -pl.col("v")}, {"position": "NED", "body": "FLU", "attitude": "NED"}),
        (
            {
                "u": pl.col("u") * pl.col("psi").cos() - pl.col("v") * pl.col("psi").sin(),
                "v": pl.col("u") * pl.col("psi").sin() + pl.col("v") * pl.col("psi").cos(),
            },
            {"position": "NED", "body": "FRD", "velocity": "NED"},
        ),
        (
            {
                "v": pl.col("u") * pl.col("psi").cos() - pl.col("v") * pl.col("psi").sin(),
                "u": pl.col("u") * pl.col("psi").sin() + pl.col("v") * pl.col("psi").cos(),
            },
            {"position": "NED", "body": "FRD", "velocity": "ENU"},
        ),
    ],
)
def test_axes_are_those_in_which_position_and_velocity_agree(
    case: Path, columns: dict[str, pl.Expr], frames: dict[str, str]
) -> None:
    plain = {name: pl.col(name) for name in ("t", "x", "y", "psi", "u", "v", "r")}
    _renamed(case, **{**plain, **columns})
    guessed = guess_mapping(case / "own.csv")
    assert guessed.axes.entry == frames
    assert "Hence these axes" in guessed.axes.questions[0]


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("sway", [1, -1])
@pytest.mark.parametrize("quaternion", [False, True])
def test_the_yaw_rate_has_the_sign_of_the_change_of_the_heading(
    case: Path, sign: int, sway: int, quaternion: bool
) -> None:
    """A gyro that counts turns to port, beside a heading that grows to starboard, in whatever axes v is."""
    half = pl.col("psi") / 2
    heading = {"psi": pl.col("psi")} if not quaternion else {
        "att.orientation.w": half.cos(), "att.orientation.x": 0.0 * half,
        "att.orientation.y": 0.0 * half, "att.orientation.z": half.sin(),
    }  # fmt: skip
    plain = {name: pl.col(name) for name in ("t", "x", "y", "u")}
    _renamed(case, **plain, v=sway * pl.col("v"), r=sign * pl.col("r"), **heading)
    guessed = guess_mapping(case / "own.csv")
    assert guessed.axes.entry["body"] == ("FRD" if sway > 0 else "FLU")
    (rate,) = (g for g in guessed.columns if g.channel == "r")
    assert ("reversed" in rate.doubt) == (sign != sway)
    (case / "log.toml").write_text(guessed.text())
    found, true = _read(case, "own.csv"), read_log(case / "train.csv")
    np.testing.assert_allclose(found["r"], true.channels["r"], atol=1e-6)
    np.testing.assert_allclose(found["v"], true.channels["v"], atol=1e-6)


def test_speeds_ahead_and_to_the_left_are_u_and_minus_v(case: Path) -> None:
    """And the axes are found from them as they are read."""
    _renamed(
        case,
        **{
            "t": pl.col("t"),
            "North (m)": pl.col("x"),
            "East (m)": pl.col("y"),
            "Heading (rad)": pl.col("psi"),
            "SOG fwd (kn)": pl.col("u") / 0.514444,
            "SOG left (m/s)": -pl.col("v"),
            "Yaw rate (rad/s)": pl.col("r"),
        },
    )
    assert main(["map", "new", "own.csv", "--vehicle", "usv.toml", "--out", "log.toml"]) == 0
    found, true = _read(case, "own.csv"), read_log(case / "train.csv")
    for name in ("x", "y", "u", "v", "r"):
        np.testing.assert_allclose(found[name], true.channels[name], atol=1e-4 * np.ptp(true.channels[name]))


def test_a_flag_tells_a_sensor_that_is_slower_than_its_log(case: Path) -> None:
    table = pl.read_csv(case / "train.csv").with_row_index("k")
    held = pl.when(pl.col("k") % 8 == 0).then(pl.col("u")).forward_fill().alias("u")
    flag = (pl.col("k") % 8 == 0).cast(pl.Int8).alias("dvl_new")
    table.with_columns(held, flag).drop("k").write_csv(case / "own.csv")
    guessed = guess_mapping(case / "own.csv")
    (entry,) = [g.entry for g in guessed.columns if g.channel == "u"]
    assert entry["fresh"] == "dvl_new"
    assert not [g for g in guessed.columns if g.channel == "v" and "fresh" in g.entry]


def test_true_and_false_flag_a_sensor_with_rows_of_its_own(tmp_path: Path) -> None:
    """Positions that are repeated with False while none is known, beside a compass in other rows."""
    k = np.arange(900)
    place, valid = k // 10 * 0.3, k % 10 == 0
    fixes = pl.DataFrame(
        {"t": 0.2 * k, "x": place, "y": 0.5 * place, "valid": np.where(valid, "True", "False")}
    )
    compass = pl.DataFrame({"t": 0.2 * k + 0.1, "yaw": 40.0 + k % 50, "roll": (358.0 + k % 5) % 360.0})
    pl.concat([fixes, compass], how="diagonal").sort("t").write_csv(tmp_path / "own.csv")
    guessed = guess_mapping(tmp_path / "own.csv")
    entries = {g.channel: g.entry for g in guessed.columns}
    assert entries["x"]["fresh"] == entries["y"]["fresh"] == "valid"
    assert entries["phi"]["wrapped"] is True
    run = read_log(tmp_path / "own.csv", guessed.meaning)
    assert np.nanmax(np.abs(run.reports("phi"))) == pytest.approx(np.radians(2.0))
    known = np.isfinite(run.reports("x"))
    np.testing.assert_allclose(np.diff(run.t[known]), 2.0)


def test_many_flags_make_one_question() -> None:
    flags = {f"state{chr(97 + k)}": (np.arange(200) // (3 + k)) % 2 for k in range(9)}
    found = guess_table(pl.DataFrame(_swinging() | flags), Path("own.csv"))
    (asked,) = [question for question in found.asked if "0 or 1" in question]
    assert "'statea', " in asked
    assert "'statef', 3 more 0 or 1" in asked


def test_what_cannot_be_known_is_asked(case: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plain = {name: pl.col(name) for name in ("t", "psi", "u")}
    off = pl.when(pl.col("t") < 1.0).then(0.0)  # no pulse before the vehicle is armed
    _renamed(case, **plain, pwm_bow=off.otherwise(1500 + 300 * pl.col("u").sin()))
    (case / "own.csv").write_text((case / "own.csv").read_text().replace(",", ";"))
    assert main(["map", "new", "own.csv", "--out", "log.toml"]) == 0
    text = (case / "log.toml").read_text()
    assert 'delimiter = ";"' in text
    assert "# ? pulses from" in text
    assert "scale = 0.0025, offset = -3.75, off = 0.0" in text
    assert "are not both logged" in text
    read_mapping(case / "log.toml")
    assert main(["map", "new", "own.csv", "--out", "log.toml"]) == 2
    assert "exists already" in capsys.readouterr().err


def test_a_table_without_a_clock_is_refused_in_one_line(
    case: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (case / "own.csv").write_text("u,v\n1,2\n0,1\n1,1\n")
    assert main(["map", "new", "own.csv", "--out", "log.toml"]) == 2
    assert "no column contains the time" in capsys.readouterr().err
    assert not (case / "log.toml").exists()


@pytest.mark.parametrize(("rows", "count"), [("", "no row"), ("0,1,2\n", "1 row")])
def test_a_table_that_ends_below_its_header_is_refused_for_that(
    rows: str, count: str, tmp_path: Path
) -> None:
    (tmp_path / "own.csv").write_text("t,u,v\n" + rows)
    with pytest.raises(UndertowError, match=f"has {count} below its header: check that the log is complete"):
        guess_mapping(tmp_path / "own.csv")


@pytest.mark.parametrize(
    ("column", "channel", "unit"),
    [
        ("N_meas_m", "x", "m"),
        ("gyro_z [rad/s]", "r", "rad/s"),
        ("roll_rate_dps", "p", "deg/s"),
        ("vel.y", "v", ""),
        ("depth", "z", ""),
        ("psi_des_rad", "", "rad"),
        ("acc_x", "", ""),
        ("u1", "", ""),
        ("vm_velo [m/s]", "v", "m/s"),
        ("n_prop [rps]", "", "rev/s"),
        ("n [rps]", "", "rev/s"),
        ("rudder_angle_deg", "", "deg"),
        ("wind_speed_x", "", ""),
        ("p [rps]", "p", "rev/s"),
        ("field.orientation.x", "phi", ""),
        ("rpy.z [deg]", "psi", "deg"),
        ("twist.angular.y", "q", ""),
        ("wrench.force.x", "", ""),
        ("Vx_body(mm_s)", "u", "mm/s"),
        ("vE_mps", "v", "m/s"),
        ("v_n", "u", ""),
        ("vel_n_m_s", "u", "m/s"),
        ("thrust_n", "", "N"),
        ("vU_mps", "w", "m/s"),
        ("North_Vel(m_s)", "u", "m/s"),
        ("Up_Vel(m_s)", "w", "m/s"),
        ("u_velo", "u", ""),
        ("roll_rate", "p", ""),
        ("Heave [m]", "z", "m"),
        ("sway_m", "y", "m"),
        ("surge", "u", ""),
        ("tau_diff.x", "", ""),
        ("heading.header_frame_id", "", ""),
        ("heading.covariance_0", "", ""),
        ("heading.data", "psi", ""),
        ("body_frame.vx", "u", ""),
        ("IMU_GYROZ", "r", ""),
        ("GyrX", "p", ""),
        ("mavlink_attitude_t.rollspeed", "p", ""),
        ("mavlink_attitude_t.yawspeed", "r", ""),
        ("imu.omegaz_rad_s", "r", "rad/s"),
        ("u_ms", "u", "m/s"),
        ("sog_ms", "", "m/s"),
        ("time_ms", "", "ms"),
        ("rot_dps", "r", "deg/s"),
        ("ROT", "r", ""),
        ("Rate of Turn", "r", ""),
        ("HEEL", "phi", ""),
        ("rpm1", "", "rpm"),
        ("rot (deg/min)", "r", "deg/min"),
        ("thrust_kN", "", "kN"),
        ("Thrust [kN]", "", "kN"),
        ("torque_kNm", "", "kN m"),
        ("sog_kn", "", "knot"),
        ("SOG [kn]", "", "knot"),
        ("cap", "psi", ""),
        ("Longitude E/W", "", ""),
        ("speed (km/h)", "", "km/h"),
        ("u_kmh", "u", "km/h"),
        ("v [cm/s]", "v", "cm/s"),
        ("heading (°)", "psi", "deg"),
        ("yaw rate [°/s]", "r", "deg/s"),
        ("distance_r0", "", ""),
        ("y0", "y", ""),
        ("battery_cap", "", ""),
        ("current_yaw", "psi", ""),
        ("pH", "", ""),
        ("pCO2", "", ""),
        ("cond_uS", "", "us"),
        ("dO_mg_L", "", "mg/l"),
        ("P [mbar]", "", "mbar"),
        ("p_dbar", "", "dbar"),
        ("w_temp", "", ""),
        ("M1ATTITUDEyaw", "psi", ""),
        ("M1ATTITUDEyawspeed", "r", ""),
        ("compassheadingdeg", "psi", "deg"),
        ("desyaw", "", ""),
        ("portcmd", "", ""),
    ],
)
def test_a_name_is_taken_apart(column: str, channel: str, unit: str) -> None:
    name = Name.of(column)
    assert (name.motion(), name.unit) == (channel, unit)


SPEEDS = {"vE_mps": 0.4, "vN_mps": 0.3, "vU_mps": 0.1}


def _guessed(**amplitudes: float) -> GuessedMapping:
    t = np.arange(0.0, 20.0, 0.1)
    swings = {n: a * np.sin(t + k) for k, (n, a) in enumerate(amplitudes.items())}
    return guess_table(pl.DataFrame({"t_s": t} | swings), Path("own.csv"))


@pytest.mark.parametrize(
    ("column", "command", "sure"),
    [
        ("f1", "f1", True),
        ("/thrusters/f1.data", "f1", True),
        ("port_cmd", "port", True),
        ("FTN.DnF1", "f1", False),
        ("left_force", "port", False),
    ],
)
def test_a_column_with_other_words_beside_those_of_a_command_is_asked_about(
    column: str, command: str, sure: bool
) -> None:
    """The frequency of a filter is called DnF1 by an autopilot."""
    assert Name.of(column).is_surely(command, {}) is sure


def test_speeds_to_north_and_east_are_along_the_earth() -> None:
    found = _guessed(N_m=5.0, E_m=4.0, yaw_deg=90.0, **SPEEDS)
    entries = {g.channel: g.entry for g in found.columns}
    assert {g.channel: g.column for g in found.columns if g.channel in "uvw"} == {
        **{"u": "vN_mps", "v": "vE_mps", "w": "vU_mps"}
    }
    assert (entries["w"]["scale"], entries["u"].get("scale")) == (-1, None)
    assert found.axes.entry == {"position": "NED", "body": "FRD", "velocity": "NED"}
    (asked,) = found.axes.questions
    assert "heading grow clockwise" in asked


def test_velocities_of_a_series_called_ned_are_along_the_earth() -> None:
    """And what a motor consumes is no command, nor is how far a force was missed."""
    found = _guessed(**{"twist_ned.linear.x": 0.4, "twist_ned.linear.y": 0.3, "twist_body.linear.x": 0.2})
    assert [(g.column, g.channel) for g in found.columns] == [("twist_body.linear.x", "u")]
    found = _guessed(**{"twist_ned.linear.x": 0.4, "twist_ned.linear.y": 0.3})
    assert found.axes.entry["velocity"] == "NED"
    found = _guessed(**{"thruster.speed_rpm": 90.0, "thruster.motor_current": 9.0, "thruster.voltage": 2.0})
    assert [g.column for g in found.columns] == ["thruster.speed_rpm"]
    found = _guessed(**{"tau_actual.force_x": 4.0, "tau_diff.force_x": 0.1, "tau.cmd.force_x": 5.0})
    assert [g.column for g in found.columns if g.channel == "tau_X"] == ["tau_actual.force_x"]


def test_speeds_along_the_body_come_before_those_along_the_earth() -> None:
    found = _guessed(**SPEEDS, Vx_body=0.5)
    assert {g.channel: g.column for g in found.columns} == {"u": "Vx_body"}
    assert "velocity" not in found.axes.entry


def test_of_two_velocities_the_one_named_like_the_channel_is_read(tmp_path: Path) -> None:
    velocity = {"vel_x": np.full(50, 0.2), "u": np.full(50, 0.1)}
    table = pl.DataFrame({"t": np.arange(50) / 10, **{n: v + np.arange(50) for n, v in velocity.items()}})
    assert _from_table(tmp_path, CATAMARAN + PAIR, table)[0]["u"].column == "u"


def test_commands_are_counted_from_rest_as_the_curve_of_their_thruster_says(tmp_path: Path) -> None:
    (tmp_path / "own.csv").write_text("0,-40\n100,0\n200,50\n")
    curve = PAIR.replace("[[thrusters]]\n", '[[thrusters]]\ncurve = "own.csv"\n')
    shares = {"port": 100 + 50 * np.sin(np.arange(50)), "starboard": np.full(50, 100.0)}
    guesses, _ = _from_table(tmp_path, CATAMARAN + curve, pl.DataFrame({"t": np.arange(50) / 10, **shares}))
    assert guesses["port"].entry == {"channel": "port", "scale": 0.01, "offset": -1.0}
    assert guesses["port"].doubt == "from 50 to 150, read as -1 ... 1 about 100, as its curve: is that right?"


def test_topics_below_each_other_have_one_clock(tmp_path: Path) -> None:
    t, nothing = np.arange(50) / 10, np.full(50, np.nan)
    topics = [pl.DataFrame({"t": t, "u": t, "r": nothing}), pl.DataFrame({"t": t, "u": nothing, "r": t})]
    guessed = _from_table(tmp_path, CATAMARAN + PAIR, pl.concat(topics).sort("t"))[1]
    assert guessed.time.entry == {"column": "t", "unit": "s"}


def test_a_last_letter_beside_another_direction_is_a_direction_and_not_a_unit() -> None:
    found = _guessed(gps_n=5.0, gps_e=4.0, dvl_u=0.4, dvl_v=0.3, force_n=3.0, bus_v=24.0)
    channels = {g.column: g.channel for g in found.columns}
    assert {c: channels.get(c, "") for c in ("gps_n", "gps_e", "dvl_u", "dvl_v", "bus_v")} == {
        **{"gps_n": "x", "gps_e": "y", "dvl_u": "u", "dvl_v": "v", "bus_v": ""}
    }


def test_a_rate_of_turn_may_be_in_degrees_a_minute() -> None:
    """As the heading has it, or else it is asked."""
    t = np.arange(0.0, 600.0)
    heading, rate = 30.0 * np.sin(t / 40.0), 30.0 / 40.0 * 60.0 * np.cos(t / 40.0)
    table = pl.DataFrame({"t_s": t, "heading": heading % 360.0, "ROT": rate})
    with_heading, alone = (guess_table(each, Path("own.csv")) for each in (table, table.drop("heading")))
    (known,), (asked,) = ([g for g in m.columns if g.channel == "r"] for m in (with_heading, alone))
    assert (known.entry["unit"], known.doubt) == ("deg/min", "")
    assert "or a minute" in asked.doubt


def test_latitude_and_longitude_become_metres_from_the_first_fix(tmp_path: Path) -> None:
    t = np.arange(0.0, 60.0, 0.5)
    north, east = 30.0 * np.sin(0.1 * t), 20.0 * np.cos(0.1 * t) - 20.0
    # 111 030 m in a degree of latitude at 39.94 degrees, 85 490 m in one of longitude (WGS 84).
    table = {"t": t, "gps.latitude": 39.94 + north / 111_030, "gps.longitude": -75.2 + east / 85_490}
    table |= {"heading_deg": 90.0 + t, "left_pwm": 1500.0 + t, "right_pwm": 1500.0 - t}
    (tmp_path / "own.csv").write_text(text_of(table))
    found = guess_mapping(tmp_path / "own.csv")
    run = _read_by(found, tmp_path / "own.csv")
    np.testing.assert_allclose(run.channels["x"], north, atol=0.02)
    np.testing.assert_allclose(run.channels["y"], east, atol=0.02)
    assert sum("metres from the first fix" in question for question in found.asked) == 1
    assert {"left_pwm", "right_pwm"} <= {g.channel for g in found.columns}
    nowhere = {"t": t, "latitude": 0.0 * t, "longitude": 0.0 * t}
    assert not guess_table(pl.DataFrame(nowhere), Path("own.csv")).columns
    beyond = {"t": t, "Lat": 4864.595 + 0.001 * north, "Lon": -13036.243 + 0.001 * east}
    (reason,) = guess_table(pl.DataFrame(beyond), Path("own.csv")).ignored
    assert "not in degrees" in reason


def test_columns_that_begin_after_the_rows_that_are_examined_are_seen(tmp_path: Path) -> None:
    rows = np.arange(30_000.0)
    late = pl.Series(np.where(rows < 25_000, np.nan, np.sin(rows / 50)), nan_to_null=True)
    table = pl.DataFrame({"t": rows / 100, "u": np.cos(rows / 70), "port": late, "starboard": -late})
    table.write_parquet(tmp_path / "run.parquet")
    found = {g.channel for g in guess_mapping(tmp_path / "run.parquet", load_vehicle("otter")).columns}
    assert {"u", *load_vehicle("otter").command_names} <= found


def test_north_is_not_ahead_of_a_vehicle_without_a_heading() -> None:
    t = np.arange(0.0, 200.0, 5.0)
    columns = {"t": t, "lat": 48.8 + 1e-6 * t, "lon": -130.4 + 1e-6 * t, "depth": 20 + 10 * np.sin(t / 30)}
    glider = guess_table(pl.DataFrame(columns), Path("own.csv"), load_vehicle("glider"))
    assert [g.channel for g in glider.columns] == ["z"]
    assert {"lat", "lon"} <= {*glider.ignored["a motion that the vehicle does not have"]}
    assert any("no column looks like surge (u or x)" in asked for asked in glider.asked)


def test_latitude_and_longitude_may_be_in_degrees_and_minutes(tmp_path: Path) -> None:
    """As in sentences of NMEA 0183, across a whole degree: 48 degrees 59.999' is followed by 49 degrees."""
    t = np.arange(0.0, 60.0, 0.5)
    north, east = 30.0 * np.sin(0.1 * t), 20.0 * np.cos(0.1 * t) - 20.0
    degrees = 48.99995 + north / 111_210, -130.60405 + east / 73_170  # metres in a degree at 49 degrees
    lat, lon = (np.sign(d) * (100.0 * np.floor(abs(d)) + 60.0 * (abs(d) % 1.0)) for d in degrees)
    (tmp_path / "own.csv").write_text(text_of({"t": t, "Lat": lat, "Lon": lon}))
    found = guess_mapping(tmp_path / "own.csv")
    assert any("if these are degrees and minutes (4854.6 for" in question for question in found.asked)
    run = _read_by(found, tmp_path / "own.csv")
    np.testing.assert_allclose(run.channels["x"], north, atol=0.05)
    np.testing.assert_allclose(run.channels["y"], east, atol=0.05)


@pytest.mark.parametrize(("place", "unit"), [((1.12, 0.157), "radians"), ((0.01, 0.02), "degrees")])
def test_latitude_and_longitude_may_be_in_radians(
    place: tuple[float, float], unit: str, tmp_path: Path
) -> None:
    """As in the messages of DUNE; near zero and zero, where simulators are, nothing can be told."""
    t = np.arange(0.0, 60.0, 0.5)
    north = 30.0 * np.sin(0.1 * t)
    size = 110_574.0 if unit == "degrees" else 6_383_700.0  # metres in one, at 0 and at 64 degrees north
    table = {"t": t, "lat": place[0] + north / size, "lon": place[1] + 0.0 * t}
    (tmp_path / "own.csv").write_text(text_of(table))
    found = guess_mapping(tmp_path / "own.csv")
    assert any(f"if these are {unit}: are they?" in question for question in found.asked)
    run = _read_by(found, tmp_path / "own.csv")
    np.testing.assert_allclose(run.channels["x"], north, atol=0.1)


@pytest.mark.parametrize("latitude", ["x", "y"])
def test_latitude_and_longitude_may_be_called_x_and_y(latitude: str) -> None:
    """In m they would hardly move; which of them is which shows by where the vehicle heads."""
    t = np.arange(0.0, 120.0, 0.2)
    psi = 0.04 * t + 0.5 * np.sin(0.1 * t)
    north, east = (0.2 * np.cumsum(1.5 * f(psi)) for f in (np.cos, np.sin))
    degrees = {latitude: 63.4 + north / 111_468, "xy".replace(latitude, ""): 10.4 + east / 49_978}
    table = pl.DataFrame({"t": t, **degrees, "heading": psi, "u": 1.5 + 0.0 * t + 0.01 * np.sin(t)})
    found = guess_table(table, Path("own.csv"))
    by_channel = {g.channel: g.entry for g in found.columns}
    assert f"({latitude} - 63.4" in str(by_channel["x"]["expression"])
    assert by_channel["psi"]["unit"] == "rad"
    asked = f"if these are degrees, '{latitude}' the latitude: are they?"
    assert any(asked in question for question in found.asked)
    assert not any("position would change" in question for question in found.asked)
    plain = guess_table(
        table.select("t", x=39.9 + pl.col(latitude) - 63.4, y=-75.2 - 1e-7 * pl.col("t")), Path("own.csv")
    )
    assert "(x - 39.9" in str({g.channel: g.entry for g in plain.columns}["x"]["expression"])
    # A vehicle that is held in a tank moves as little: its position drifts, and has the noise of cameras.
    drift = 1e-4 * t + 1e-4 * np.random.default_rng(2).standard_normal((2, len(t)))
    held = guess_table(pl.DataFrame({"t": t, "x": 3.2 + drift[0], "y": 2.1 + drift[1]}), Path("own.csv"))
    assert {g.channel: g.column for g in held.columns} == {"x": "x", "y": "y"}


@pytest.mark.parametrize(("size", "asked"), [(1.0, False), (1 / 0.3048, True)])
def test_positions_that_contradict_latitude_and_longitude_are_asked_about(size: float, asked: bool) -> None:
    """In feet, beside fixes that scatter by 2 m and are missing in most rows."""
    rng, t = np.random.default_rng(4), np.arange(0.0, 120.0, 0.2)
    x, y = 40.0 * np.sin(0.05 * t), 60.0 * np.cos(0.05 * t)
    north, east = (c + 2.0 * rng.standard_normal(len(t)) for c in (-y, x))  # x and y have axes of their own
    known = np.arange(len(t)) % 5 == 0
    fixes = {"lat": 63.4 + north / 111_468, "lon": 10.4 + east / 49_978}
    fixes = {n: np.where(known, c, np.nan) for n, c in fixes.items()}
    found = guess_table(pl.DataFrame({"t": t, "x": size * x, "y": size * y, **fixes}), Path("own.csv"))
    said = [question for question in found.asked if "lead away from their first place" in question]
    assert bool(said) is asked
    assert not asked or "which is right?" in said[0]


@pytest.mark.parametrize(("column", "sign"), [("depth", 1.0), ("height_msl", -1.0), ("depth", -1.0)])
def test_depth_keeps_its_sign_where_x_is_east_and_y_north(column: str, sign: float, tmp_path: Path) -> None:
    """A depth, a height, and a depth that is written as a height; the side needs no sideways speed."""
    t = np.arange(0.0, 120.0, 0.2)
    psi = 0.04 * t + 0.5 * np.sin(0.1 * t)
    north, east = (0.2 * np.cumsum(1.5 * f(psi)) for f in (np.cos, np.sin))
    depth = 5.0 + np.sin(0.1 * t)
    table = {"t": t, "x": east, "y": north, column: sign * depth, "yaw": psi, "u": 1.5 + 0.01 * np.sin(t)}
    (tmp_path / "own.csv").write_text(text_of(table))
    found = guess_mapping(tmp_path / "own.csv")
    assert found.axes.entry["position"] == "ENU"
    assert "Hence these axes" in found.axes.questions[0]
    run = read_log(tmp_path / "own.csv", found.meaning)
    np.testing.assert_allclose(run.channels["z"], depth, atol=1e-6)
    np.testing.assert_allclose(run.channels["x"], north, atol=1e-6)
    asked = any("mostly negative, as no depth is" in question for question in found.asked)
    assert asked == (column == "depth" and sign < 0)


def test_the_place_of_an_origin_is_not_that_of_the_vehicle() -> None:
    t = np.arange(0.0, 60.0, 0.5)
    given = {"origin_lat": 39.9 + 0 * t, "origin_lon": -75.2 + 0 * t, "wp_lat": 39.9 + t, "wp_lon": t}
    given |= {"lat0": 39.9 + 0 * t, "lon0": -75.2 + 0 * t}
    own = {"latitude": 39.94 + 1e-5 * np.sin(t), "longitude": -75.2 + 1e-5 * np.cos(t)}
    found = guess_table(pl.DataFrame({"t": t} | given | own), Path("own.csv"))
    assert {g.column for g in found.columns} == {"latitude, longitude"}
    assert not guess_table(pl.DataFrame({"t": t} | given), Path("own.csv")).columns


def test_latitude_and_longitude_may_count_sevenths_of_degrees(tmp_path: Path) -> None:
    """Whole numbers of 1e-7 degrees, as MAVLink counts."""
    t = np.arange(0.0, 60.0, 0.5)
    north = 30.0 * np.sin(0.1 * t)
    table = {"t": t, "msg.lat": np.round(1e7 * (39.94 + north / 111_030)), "msg.lon": -752000000.0 + 0 * t}
    (tmp_path / "own.csv").write_text(text_of(table))
    (tmp_path / "log.toml").write_text(guess_mapping(tmp_path / "own.csv").text())
    run = read_log(tmp_path / "own.csv", read_mapping(tmp_path / "log.toml"))
    np.testing.assert_allclose(run.channels["x"], north, atol=0.03)
    np.testing.assert_allclose(run.channels["y"], 0.0, atol=0.03)


@pytest.mark.parametrize(
    ("column", "seconds", "unit"), [("Time (min)", 60, "min"), ("t_hours", 3600, "h"), ("t", 60, "s")]
)
def test_a_clock_has_the_unit_that_its_name_states_or_is_asked_about(
    column: str, seconds: float, unit: str
) -> None:
    t = np.arange(0.0, 20.0, 0.05)
    time = guess_table(pl.DataFrame({column: t / seconds, "u": np.sin(t)}), Path("log.csv")).time
    assert (time.column, time.entry["unit"]) == (column, unit)
    rates = "0.0008333 from row to row: that is 1.2e+03 rows a second if it is in s, 20 in min"
    assert time.doubt.startswith("" if column != "t" else rates)
    assert not time.doubt or column == "t"


def test_a_time_of_day_to_the_second_is_a_clock_with_repeats(tmp_path: Path) -> None:
    """As ground stations write it, the date apart: four rows have the same second."""
    t = np.arange(0.0, 100.0, 0.25)
    day = [f"{9 + int(s // 60 + 59) // 60}:{int(s // 60 + 59) % 60:02d}:{int(s) % 60:02d} " for s in t]
    table = pl.DataFrame({"Date": ["10/6/2020"] * len(t), "Time": day, "yaw": np.sin(t)})
    table.write_csv(tmp_path / "own.csv")
    found = guess_mapping(tmp_path / "own.csv")
    assert found.time.entry == {"column": "Time", "unit": "iso", "disorder": "drop"}
    assert found.time.doubt.startswith("75% of its times repeat the one before: it has too few digits")
    run = _read_by(found, tmp_path / "own.csv")
    np.testing.assert_allclose(run.t, np.arange(100.0))


def test_a_heading_in_degrees_that_turns_by_six_of_them_a_row_is_not_in_radians() -> None:
    """A drifting boat turns by about 2 pi degrees in a second, and seldom through north."""
    t = np.arange(0.0, 300.0)
    heading = 180.0 + 150.0 * np.sin(2 * np.pi / 150.0 * t) + 3.0 * (-1.0) ** t
    found = guess_table(pl.DataFrame({"t": t, "heading": heading % 360.0}), Path("own.csv"))
    (psi,) = found.columns
    assert psi.entry["unit"] == "deg"
    turning = guess_table(pl.DataFrame({"t": t, "heading": np.angle(np.exp(0.3j * t))}), Path("own.csv"))
    assert turning.columns[0].entry["unit"] == "rad"


def test_a_clock_with_few_repeats_and_without_its_last_time_is_a_clock() -> None:
    t = np.arange(0.0, 100.0, 0.1)
    t[500], t[-1] = t[499], np.nan
    found = guess_table(pl.DataFrame({"Timestamp(s)": t, "u": np.arange(1000.0)}), Path("own.csv"))
    assert found.time.entry == {"column": "Timestamp(s)", "unit": "s", "disorder": "drop"}
    assert found.time.doubt == "0.10% of the rows are not later than an earlier one: leave them out?"


SHIP = """
schema = "undertow/vehicle/1"
name = "ship"
degrees_of_freedom = ["surge", "sway", "yaw"]
signs = "sname"
inputs = ["apparent_wind_speed", "apparent_wind_angle"]
[effects.rigid_body]
m = 250
I_z = 140
[[thrusters]]
name = "propeller"
position = [-1.4, 0, 0]
direction = [1, 0, 0]
{thrust}
[[surfaces]]
name = "rudder"
position = [-1.5, 0, 0]
axis = "rudder"
area = 0.01
aspect_ratio = 1.5
"""
PROPELLER = (
    "propeller = {{ diameter = 0.08, K_T0 = 0.3, K_T1 = -0.3, wake_fraction = 0.3, thrust_deduction = 0.2, "
    'revolutions = "{}" }}'
)


def _guesses(folder: Path, vehicle: str, **columns: float) -> tuple[dict[str, Guess], GuessedMapping]:
    """Guesses by channel for columns that swing with these amplitudes."""
    (folder / "own.toml").write_text(vehicle)
    t = np.arange(0.0, 20.0, 0.1)
    table = {"t [s]": t} | {n: a * np.sin(t + k) for k, (n, a) in enumerate(columns.items())}
    found = guess_table(pl.DataFrame(table), folder / "own.csv", load_vehicle(folder / "own.toml"))
    return {g.channel: g for g in found.columns}, found


TANK = {
    **{"x_mid [m]": 5.0, "y_mid [m]": 5.0, "psi_hat [rad]": 3.0, "u_velo [m/s]": 0.5, "vm_velo [m/s]": 0.1},
    **{"r_angvelo [rad/s]": 0.1, "roll_rate [rad/s]": 0.1, "n_prop [rps]": 10.0, "delta_rudder [rad]": 0.6},
    **{"wind_velo_true [m/s]": 2.0, "wind_dir_true [rad]": 3.0},
    **{"wind_velo_relative [m/s]": 2.0, "wind_dir_relative [rad]": 3.0},
}


def test_a_clock_that_stands_still_is_named_with_its_row(
    case: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (case / "own.csv").write_text("t,u,v\n998,1,2\n1000,0,1\n1000,1,1\n1010,1,0\n")
    assert main(["map", "new", "own.csv", "--out", "log.toml"]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "column 't' does not increase in 1 of 4 rows, first from 1000 to 1000 in row 3" in said


@pytest.mark.parametrize(("unit", "scale"), [("rev/s", None), ("rpm", 60.0), ("rad/s", 2 * np.pi)])
def test_what_a_vehicle_has_is_looked_for_and_nothing_else(
    unit: str, scale: float | None, tmp_path: Path
) -> None:
    guesses, found = _guesses(tmp_path, SHIP.format(thrust=PROPELLER.format(unit)), **TANK)
    columns = {channel: guess.column.split(" ")[0] for channel, guess in guesses.items()}
    assert columns == {
        **{"x": "x_mid", "y": "y_mid", "psi": "psi_hat", "u": "u_velo", "v": "vm_velo", "r": "r_angvelo"},
        **{"propeller": "n_prop", "rudder": "delta_rudder"},
        **{"apparent_wind_speed": "wind_velo_relative", "apparent_wind_angle": "wind_dir_relative"},
    }
    assert found.ignored["a motion that the vehicle does not have"] == ("roll_rate [rad/s]",)
    assert guesses["propeller"].entry.get("scale") == pytest.approx(scale), "turns a second in its own unit"
    assert "unit" not in guesses["propeller"].entry, "a unit would make rad/s of it"
    assert guesses["propeller"].doubt == "is it command 'propeller'?"
    assert "apparent wind direction" in guesses["apparent_wind_angle"].doubt


def test_a_quaternion_and_numbered_thrusters_of_another_name_are_read(case: Path) -> None:
    """As tables out of ROS have them; a sample stands in every other row."""
    vehicle = load_vehicle(case / "usv.toml")
    table = pl.read_csv(case / "train.csv")
    half, zero = pl.col("psi") / 2, pl.lit(0.0)
    turned = {"x": zero, "y": zero, "z": half.sin(), "w": half.cos()}
    own = table.select(
        pl.col("t").alias("stamp"),
        *(pl.col(n).alias(f"pose.position.{n}") for n in ("x", "y")),
        *(e.alias(f"pose.orientation.{n}") for n, e in turned.items()),
        *(pl.col(n).alias(f"thrust{k}") for k, n in enumerate(vehicle.command_names)),
    )
    late = own.select(pl.col("stamp") + 0.01)  # of another sensor, which is not used
    both = pl.concat([own, late], how="diagonal").sort("stamp")
    both.write_csv(case / "own.csv")
    found = guess_mapping(case / "own.csv", vehicle)
    (case / "log.toml").write_text(found.text())
    commands = [g.column for g in found.columns if g.channel in vehicle.command_names]
    assert commands == [f"thrust{k}" for k in range(len(vehicle.command_names))]
    assert found.time.doubt.startswith("0.05 from sample to sample")
    assert "every" not in found.time.doubt
    run = read_log(case / "own.csv", read_mapping(case / "log.toml"), vehicle.command_names)
    psi = run.channels["psi"][np.isfinite(run.channels["psi"])]
    turn = psi - table["psi"].to_numpy()
    np.testing.assert_allclose(turn, turn[0], atol=1e-6)


@pytest.mark.parametrize(
    "names", [("q0", "q1", "q2", "q3"), ("att[1]", "att[2]", "att[3]", "att[4]"), "abcd"]
)
@pytest.mark.parametrize("last", [False, True], ids=["scalar first", "scalar last"])
@pytest.mark.parametrize("north", [0.05, 2.0])
def test_a_quaternion_shows_by_its_length(
    names: tuple[str, ...], last: bool, north: float, tmp_path: Path
) -> None:
    """And the order of its parts by roll and pitch, which are small; commands that are flags are none."""
    t = np.arange(0.0, 60.0, 0.1)
    true = {"phi": 0.1 * np.sin(t), "theta": 0.05 * np.cos(0.7 * t), "psi": north * np.sin(0.2 * t)}
    turns = np.column_stack([true["psi"], true["theta"], true["phi"]])
    parts = Rotation.from_euler("ZYX", turns).as_quat(scalar_first=not last).T
    gear = {f"gear{k}": (np.floor(t / 10) % 4 == k) * 1.0 for k in range(4)}
    table = pl.DataFrame({"t": t, **gear, **dict(zip(names, parts, strict=True)), "u": np.sin(t)})
    table.write_csv(tmp_path / "own.csv")
    found = guess_mapping(tmp_path / "own.csv")
    assert any("squares sum to one" in question for question in found.asked)
    run = _read_by(found, tmp_path / "own.csv")
    for name, values in true.items():
        np.testing.assert_allclose(run.channels[name], values, atol=1e-9)
    assert not {"q", *gear} & {*run.channels}


def test_a_height_above_a_level_grows_upwards(tmp_path: Path) -> None:
    """And one above the bottom, or of any kind beside a depth, is no depth."""
    t = np.arange(0.0, 60.0, 0.1)
    height = -2.0 - np.sin(t / 9)
    table = pl.DataFrame({"t": t, "altitudeRelative": height, "altitude": 3.0 - height, "u": np.sin(t)})
    found = guess_table(table, Path("own.csv"))
    (depth,) = [g for g in found.columns if g.channel == "z"]
    assert (depth.column, depth.entry["scale"]) == ("altitudeRelative", -1)
    assert "read as a height above a fixed level (z = -height): is it?" in depth.doubt
    both = guess_table(table.with_columns(depth=-pl.col("altitudeRelative")), Path("own.csv"))
    assert [g.column for g in both.columns if g.channel == "z"] == ["depth"]


def _sailed(speed: float) -> dict[str, np.ndarray]:
    """A position that changes with a speed, m/s."""
    t = np.arange(0.0, 200.0, 0.5)
    u = speed * (1.0 + 0.3 * np.sin(t / 7))
    return {"x": 0.5 * np.cumsum(u), "y": 0.0 * t + np.sin(t / 50), "u": u, "seconds": t}


@pytest.mark.parametrize(("unit", "length"), [("min", 60.0), ("h", 3600.0), ("s", 1.0)])
@pytest.mark.parametrize("without", ["nothing", "u"])
def test_a_clock_has_the_unit_in_which_position_and_speed_agree(
    unit: str, length: float, without: str
) -> None:
    columns = _sailed(1.5)
    columns = {"clock": columns.pop("seconds") / length} | columns
    columns.pop(without, None)
    found = guess_table(pl.DataFrame(columns), Path("own.csv"))
    assert found.time.entry["unit"] == unit
    assert ("the position would change by" in found.time.doubt) == (unit != "s")


def test_a_clock_in_no_known_unit_is_asked_about_with_what_contradicts_it() -> None:
    columns = _sailed(1.5)
    columns = {"clock": columns.pop("seconds") / 17.0} | columns
    found = guess_table(pl.DataFrame(columns), Path("own.csv"))
    assert found.time.entry["unit"] == "s"
    asked = "change by 26.8 m/s, and the speed column says 1.56: is the time, the position or the speed in"
    assert asked in found.time.doubt


def test_a_count_of_the_rows_is_no_clock_beside_what_is_as_even() -> None:
    """The index that pandas writes in front of all columns, of another name than that of a clock."""
    columns = _sailed(1.5)
    seconds = columns.pop("seconds")
    found = guess_table(
        pl.DataFrame({"": np.arange(len(seconds)), "tvec": seconds} | columns), Path("own.csv")
    )
    assert found.time.column == "tvec"
    alone = guess_table(pl.DataFrame({"": np.arange(len(seconds))} | columns), Path("own.csv"))
    assert alone.time.column == ""


def test_the_unit_of_the_yaw_rate_shows_beside_a_heading_that_was_resampled_as_it_jumped() -> None:
    """Between 359 and 1 degrees lie samples through which no vehicle has turned."""
    t = np.arange(0.0, 400.0, 0.5)
    psi = 6.0 + 8.0 * np.sin(t / 9.0)
    coarse = t[::2]
    columns = {"t": t, "psi": np.interp(t, coarse, psi[::2] % 360.0), "r": 8.0 / 9.0 * np.cos(t / 9.0)}
    (rate,) = (g for g in guess_table(pl.DataFrame(columns), Path("own.csv")).columns if g.channel == "r")
    assert (rate.entry["unit"], rate.doubt) == ("deg/s", "")


def test_a_noisy_fix_says_nothing_of_the_clock() -> None:
    """At 2 samples a second 8 m of noise are 60 times as fast as the vehicle is."""
    columns, rng = _sailed(0.02), np.random.default_rng(2)
    columns["x"] = columns["x"] + 8.0 * rng.standard_normal(len(columns["x"]))
    found = guess_table(pl.DataFrame({"t": columns.pop("seconds")} | columns), Path("own.csv"))
    assert found.time.entry["unit"] == "s"
    assert "position would change" not in found.time.doubt


ROV = """
schema = "undertow/vehicle/1"
name = "rov"
degrees_of_freedom = ["surge", "sway", "heave", "roll", "pitch", "yaw"]
signs = "sname"
[effects.rigid_body]
m = 30
I_x = 1
I_y = 2
I_z = 2
"""
FORCES = ("tau_X", "tau_Y", "tau_Z", "tau_K", "tau_M", "tau_N")


def test_a_wrench_is_read_or_asked_about(tmp_path: Path) -> None:
    """As ROS logs what a controller asked for; attitudes by three angles; gyros that measure nothing."""
    columns = {f"wrench.{kind}.{axis}": 5.0 for kind in ("force", "torque") for axis in "xyz"}
    turned = {f"orientation.{axis}": 0.3 for axis in "xyz"}
    still = {f"angular_velocity.{axis}": 1e-7 for axis in "xyz"}
    known = ROV.replace("signs", f"generalised_forces = {list(FORCES)}\nsigns")
    guesses, _ = _guesses(tmp_path, known, **columns, **turned, **still)
    assert [guesses[f].column for f in FORCES] == [*columns]
    assert [guesses[f].entry["unit"] for f in FORCES] == ["N"] * 3 + ["N m"] * 3
    assert [guesses[n].column for n in ("phi", "theta", "psi")] == [*turned]
    assert "less than the earth's rotation" in guesses["r"].doubt
    lettered = {f"wrench.{kind}{axis}": 5.0 for kind in "ft" for axis in "xyz"}
    assert [_guesses(tmp_path, known, **lettered)[0][f].column for f in FORCES] == [*lettered]
    thruster = '[[thrusters]]\nname = "bow"\nwrench = [1, 0, 0, 0, 0, 0]\n'
    _, found = _guesses(tmp_path, ROV + thruster, **columns)
    assert any("a thruster with a wrench for each" in q for q in found.questions)


def test_forces_and_moments_are_those_of_one_series(tmp_path: Path) -> None:
    """As a ferry logs what was asked for (first) and what its thrusters gave."""
    asked = {f"control.{kind}_{axis}": 5.0 for kind in ("force", "torque") for axis in "xyz"}
    given = {f"tau.wrench_{kind}_{axis}": 4.0 for kind in ("force", "torque") for axis in "xyz"}
    known = ROV.replace("signs", f"generalised_forces = {list(FORCES)}\nsigns")
    guesses, _ = _guesses(tmp_path, known, **asked, **given)
    assert [guesses[f].column for f in FORCES] == [*given]


@pytest.mark.parametrize("largest", [30.0, 2.4])
def test_a_rudder_beyond_a_right_angle_is_in_degrees(largest: float, tmp_path: Path) -> None:
    columns = {"rudder": largest, "n_prop [rps]": 10.0}
    guesses, _ = _guesses(tmp_path, SHIP.format(thrust=PROPELLER.format("rev/s")), **columns)
    assert (guesses["rudder"].entry["unit"], guesses["rudder"].doubt) == ("deg", "")


def test_an_angle_in_no_known_unit_is_not_asked_about_as_a_force() -> None:
    t = np.arange(0.0, 20.0, 0.1)
    table = pl.DataFrame({"t": t, "Rudder": 3.0 * np.sin(t), "thrust_1": 9.0 * np.sin(t)})
    doubts = {g.column: g.doubt for g in guess_table(table, Path("log.csv")).columns}
    assert "degrees, per cent or something else" in doubts["Rudder"]
    assert "newtons, per cent or something else" in doubts["thrust_1"]


def test_what_only_a_unit_says_is_asked(tmp_path: Path) -> None:
    ship = SHIP.format(thrust=PROPELLER.format("rev/s"))
    guesses, _ = _guesses(tmp_path, ship, **{"yaw [deg/s]": 5.0, "engine [rpm]": 600.0, "north_mps": 1.0})
    assert guesses["r"].doubt == "its unit is that of a velocity: is it r?"
    assert guesses["u"].doubt == "its unit is that of a velocity: is it u?"
    assert guesses["propeller"].column == "engine [rpm]"
    assert guesses["propeller"].doubt == "is it command 'propeller'?"
    assert guesses["propeller"].entry["scale"] == pytest.approx(1 / 60)
    guesses, _ = _guesses(tmp_path, ship, **{"yaw_rate_rps": 0.1})
    assert guesses["r"].entry["unit"] == "rad/s"
    assert "rps: radians a second, or revolutions?" in guesses["r"].doubt


@pytest.mark.parametrize(
    "speed", ["speed", "SOG (kn)", "gps_groundspeed_mps", "gps_spd", "sog_1", "Speed(km/h)"]
)
def test_a_vehicle_without_sway_has_its_speed_ahead_and_its_place_in_north_and_east(
    speed: str, tmp_path: Path
) -> None:
    own = SHIP.format(thrust=PROPELLER.format("rev/s")).replace('"sway", ', "")
    columns = {"x": 30.0, "y": 40.0, "heading_deg": 90.0, speed: 1.0, "wind_speed": 5.0}
    guesses, _ = _guesses(tmp_path, own, **columns)
    found = {channel: guess.column for channel, guess in guesses.items()}
    assert found == {"x": "x", "y": "y", "psi": "heading_deg", "u": speed}
    assert "read as the speed ahead" in guesses["u"].doubt
    assert "u" not in _guesses(tmp_path, SHIP.format(thrust=PROPELLER.format("rev/s")), **columns)[0]


@pytest.mark.parametrize("speed", ["STW [kn]", "speed_through_water_mps", "Speed through water (m/s)"])
def test_a_speed_through_the_water_is_the_speed_ahead_where_there_is_none_over_ground(
    speed: str, tmp_path: Path
) -> None:
    own = SHIP.format(thrust=PROPELLER.format("rev/s")).replace('"sway", ', "")
    columns = {"heading_deg": 90.0, speed: 1.0, "water_speed": 0.3, "water_temperature": 11.0}
    found = _guesses(tmp_path, own, **columns)[0]["u"]
    assert found.column == speed
    assert "[water] with the velocity of the water makes it one over ground" in found.doubt
    over_ground = _guesses(tmp_path, own, **columns, sog_kn=1.1)[0]["u"]
    assert over_ground.column == "sog_kn"
    assert "[water]" not in over_ground.doubt


@pytest.mark.parametrize(
    ("thrust", "column"), [("", "left_force"), ("thrust_per_command = 20", "thr_left_pwm")]
)
def test_columns_that_count_what_the_vehicle_counts_come_first(
    thrust: str, column: str, tmp_path: Path
) -> None:
    boat = SHIP.format(thrust=thrust).replace('"propeller"', '"port"')
    guesses, _ = _guesses(tmp_path, boat, thr_left_pwm=1.0, left_force=20.0)
    assert guesses["port"].column == column
    assert guesses["port"].doubt.startswith("is it command 'port'?")
    assert guesses["port"].entry.get("unit") == (None if thrust else "N")


def test_axes_that_have_to_be_turned_keep_what_turns_them(tmp_path: Path) -> None:
    """A hull that only surges, logged in east and north: its x is the y of the log."""
    t = np.arange(0.0, 60.0, 0.1)
    psi, u, v = 0.5 * np.sin(0.2 * t), 1.0 + 0.3 * np.sin(0.5 * t), 0.5 * np.cos(0.4 * t)
    track = np.cumsum((u + 1j * v) * np.exp(1j * psi)) * 0.1
    north, east = track.real, track.imag
    (tmp_path / "hull.toml").write_text(SURGE)
    hull = load_vehicle(tmp_path / "hull.toml")
    table = pl.DataFrame({"t": t, "x": east, "y": north, "psi": psi, "u": u, "v": v, "tau_X": u})
    found = guess_table(table, tmp_path / "own.csv", hull)
    assert found.axes.entry["position"] == "ENU"
    assert {g.channel for g in found.columns} == {"x", "y", "psi", "u", "v", "tau_X"}
    plain = guess_table(table.rename({"x": "y", "y": "x"}), tmp_path / "own.csv", hull)
    assert {g.channel for g in plain.columns} == {"x", "u", "tau_X"}


CATAMARAN = """
schema = "undertow/vehicle/1"
name = "boat"
degrees_of_freedom = ["surge", "sway", "yaw"]
signs = "sname"
[effects.rigid_body]
m = 55
I_z = 14
"""
PAIR = "".join(
    f'[[thrusters]]\nname = "{name}"\nposition = [-1, {side}, 0]\ndirection = [1, 0, 0]\n'
    for name, side in (("port", -0.4), ("starboard", 0.4))
)


def _from_table(folder: Path, vehicle: str, table: pl.DataFrame) -> tuple[dict[str, Guess], GuessedMapping]:
    (folder / "own.toml").write_text(vehicle)
    found = guess_table(table, folder / "own.csv", load_vehicle(folder / "own.toml"))
    return {g.channel: g for g in found.columns}, found


def _swinging(rows: int = 200) -> dict[str, np.ndarray]:
    t = np.arange(rows) / 10
    return {"t": t, "psi": 0.5 * np.sin(0.3 * t), "u": 1.0 + 0.2 * np.sin(t), "n": 900 + 50 * np.cos(t)}


def test_numbered_columns_of_a_vector_are_its_axes_and_dead_ones_are_none(tmp_path: Path) -> None:
    """As a catamaran's interface wrote them: three of a vector by number, speeds that stayed zero."""
    c = _swinging()
    table = pl.DataFrame(
        {
            "current_time": 1.7e9 + c["t"],
            **{f"orientation_{k}": a * DEGREES * c["psi"] for k, a in ((1, 0.01), (2, 0.02), (3, 1.0))},
            **{f"rotational_velocities_{k}": 5 * np.sin(k * c["t"]) for k in (1, 2)},
            "rotational_velocities_3": DEGREES * np.gradient(c["psi"], 0.1),
            "north_m": 5 * c["t"],
            "east_m": np.sin(c["t"]),
            "speed_surge": 0.0 * c["t"],
            "n1": c["n"],
            "n2": c["n"] + 20,
            "tau_N": np.sin(c["t"]),
            "servo_position_0": c["u"],
        }
    )
    guesses, found = _from_table(tmp_path, CATAMARAN + PAIR, table)
    columns = {channel: guess.column for channel, guess in guesses.items()}
    assert columns == {
        **{"x": "north_m", "y": "east_m", "psi": "orientation_3", "r": "rotational_velocities_3"},
        **{"port": "n1", "starboard": "n2"},
    }
    assert (guesses["psi"].entry["unit"], guesses["r"].entry["unit"]) == ("deg", "deg/s")
    assert guesses["port"].entry["power"] == 2
    assert guesses["port"].doubt.endswith("as scale, or state [thrusters.propeller] in the vehicle file")
    reasons = {column: reason for reason, names in found.ignored.items() for column in names}
    assert reasons["speed_surge"].startswith("never changes")
    assert reasons["tau_N"].startswith("a force on the vehicle")
    assert reasons["orientation_1"] == "a motion that the vehicle does not have"


def test_a_log_with_dates_has_axes_like_any_other(tmp_path: Path) -> None:
    """Dates are no numbers: axes need the times all the same. The quaternion's w is no heave."""
    c = _swinging()
    dates = [f"2025/04/09 11:15:{s:06.3f}" for s in c["t"]]
    psi, v = c["psi"], 0.3 * np.cos(c["t"])
    track = np.cumsum((c["u"] + 1j * v) * np.exp(1j * psi)) * 0.1
    turned = {"w": np.cos(psi / 2), "x": 0 * psi, "y": 0 * psi, "z": np.sin(psi / 2)}
    table = pl.DataFrame(
        {
            "time": dates,
            "pose_position_x": track.real,
            "pose_position_y": track.imag,
            **{f"pose_orientation_{letter}": column for letter, column in turned.items()},
            "twist_linear_x": c["u"],
            "twist_linear_y": v,
            "vibration_z": c["u"],
        }
    )
    found = guess_table(table, tmp_path / "own.csv")
    assert found.time.entry == {"column": "time", "unit": "iso"}
    assert found.axes.entry == {"position": "NED", "body": "FRD"}
    assert "Hence these axes" in found.axes.questions[0]
    assert {g.channel for g in found.columns} == {"x", "y", "phi", "theta", "psi", "u", "v"}
    odd = table.with_columns(time=pl.col("time").str.replace(" ", "_").str.replace(":15:", "h15m"))
    with pytest.raises(UndertowError, match="not an ISO 8601 time stamp"):
        guess_table(odd.drop("pose_position_x"), tmp_path / "own.csv")


@pytest.mark.parametrize("digits", ["{:.1f}", "{:.0f}", "{:.0f}000"])
def test_hours_minutes_and_seconds_in_six_digits_are_a_time_of_day(digits: str, tmp_path: Path) -> None:
    """As GPS receivers write them: 0:59:59 is followed by 1:00:00, not 41 or 4041 seconds later."""
    t = 34790.0 + np.arange(200.0)
    stamps = [digits.format(10000 * (s // 3600) + 100 * (s // 60 % 60) + s % 60) for s in t]
    pl.DataFrame({"h": stamps, "u": np.sin(t)}).write_csv(tmp_path / "log.csv")
    guessed = guess_mapping(tmp_path / "log.csv")
    assert guessed.time.entry == {"column": "h", "unit": "iso"}
    assert "hhmmss" in guessed.time.doubt
    assert read_log(tmp_path / "log.csv", guessed.meaning).t == pytest.approx(t - t[0])


def test_milliseconds_of_a_time_of_day_that_repeat_are_no_clock_of_few_digits(tmp_path: Path) -> None:
    """122159900 is followed by 122200000: rows of one interval are 20 s off."""
    t = np.round(44_500.0 + 0.1 * (np.arange(3000) // 1.15), 1)
    stamps = [f"{10_000_000 * (s // 3600) + 100_000 * (s // 60 % 60) + 1000 * (s % 60):.0f}" for s in t]
    pl.DataFrame({"time": stamps, "u": np.sin(t)}).write_csv(tmp_path / "log.csv")
    guessed = guess_mapping(tmp_path / "log.csv")
    assert guessed.time.entry["unit"] == "iso"
    assert np.ptp(read_log(tmp_path / "log.csv", guessed.meaning).t) == pytest.approx(np.ptp(t))


def test_seconds_that_happen_to_look_like_a_time_of_day_are_seconds(tmp_path: Path) -> None:
    table = pl.DataFrame({"t": [f"{t}" for t in range(12000, 12050)], "u": np.sin(np.arange(50.0))})
    table.write_csv(tmp_path / "log.csv")
    assert guess_mapping(tmp_path / "log.csv").time.entry == {"column": "t", "unit": "s"}


def test_a_command_without_a_column_may_be_a_constant(case: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = pl.read_csv(case / "train.csv")
    table.drop("f1").write_csv(case / "own.csv")
    assert main(["doctor", "usv.toml", "own.csv"]) == 2
    assert 'or a constant under [channels], such as f1 = "0"' in capsys.readouterr().err
    (case / "log.toml").write_text('schema = "undertow/mapping/1"\n[channels]\nf1 = "0"\n')
    assert np.all(_read(case, "own.csv")["f1"] == 0.0)


@pytest.mark.parametrize(
    ("stamp", "second"),
    [
        ("2024-03-07_15:26:15:129472", "2024-03-07_15:26:15:229472"),
        ("2024/03/07 15:26:15", "2024/03/07 15:26:16"),
    ],
)
def test_dates_with_the_year_first_are_times_whatever_their_column_is_called(
    stamp: str, second: str, tmp_path: Path
) -> None:
    """As loggers write them: a column without a name, other signs between the numbers."""
    (tmp_path / "log.csv").write_text(f"n;u\n{stamp};0.1\n{second};0.3\n".replace("n;u", ";u"))
    guessed = guess_mapping(tmp_path / "log.csv")
    assert guessed.time.entry == {"column": "", "unit": "iso"}
    run = read_log(tmp_path / "log.csv", guessed.meaning)
    assert run.t == pytest.approx([0.0, 0.1 if "_" in stamp else 1.0])


def test_what_never_changes_is_no_command_and_a_vector_has_one_unit() -> None:
    t = np.arange(0.0, 30.0, 0.1)
    columns = {
        "t": t,
        "imu_angle_1": 3 * np.sin(t),
        "imu_angle_2": np.cos(t),
        "imu_angle_3": 100 * np.sin(0.1 * t),
        "thr_left": 1500 + 300 * np.sin(t),
        "thr_left_zero": np.full_like(t, 1511.0),
    }
    names = {f"imu_angle_{k}": f"attitude_{k}" for k in (1, 2, 3)}
    found = guess_table(pl.DataFrame(columns).rename(names), Path("log.csv"))
    units = {g.channel: g.entry.get("unit") for g in found.columns}
    assert units == {"phi": "deg", "theta": "deg", "psi": "deg", "thr_left": None}
    assert "thr_left_zero" in found.ignored["never changes: measured by nothing, or held"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "0,1,0\n0.1,1.1,0.01\n0.2,1.2,0.02\n",
            "begins with numbers (0, 1, 0 …): write a line with the names",
        ),
        (
            "48.2,-3.0,120,[-10.0]\n48.3,-3.0,119,[-10.1]\n48.4,-3.0,118,[-10.2]\n",
            "begins with numbers (48.2, -3.0, 120 …): write a line with the names of its 4 columns",
        ),
        (
            "2026-02-04 15:38:48,853 - INFO - (1.2)\n2026-02-04 15:38:49,827 - INFO - (1.3)\n",
            "begins with numbers (2026-02-04 15:38:48, 853 - INFO - (1.2) …): write a line with the names",
        ),
        (
            "A tank\n1.2 m/s\n" + "0\t1.5\t2\n1\t2.5\t3\n" * 9,
            "has numbers in line 3 (0, 1.5, 2 …): write a line with the names of its 3 columns right above",
        ),
    ],
)
def test_a_table_without_a_line_of_names_is_refused_for_that(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "log.dat").write_text(text)
    with pytest.raises(UndertowError) as refused:
        guess_mapping(tmp_path / "log.dat")
    assert words in str(refused.value)


def test_columns_below_each_other_and_a_line_of_units_are_read(tmp_path: Path) -> None:
    """As towing tanks write them: several blanks between the cells, units below the names."""
    rows = "".join(f"  {0.1 * k:.1f}    {k}   {2 * k}\r\n" for k in range(20))
    (tmp_path / "log.txt").write_text(f" t     u     r\r\n[s]   [mm/s]   [deg/s]\r\n{rows}")
    guessed = guess_mapping(tmp_path / "log.txt")
    assert guessed.reading.delimiter == " "
    assert {g.channel: g.entry["unit"] for g in guessed.columns} == {"u": "mm/s", "r": "deg/s"}
    (tmp_path / "log.txt").write_text(f" t     u     r\r\n{rows}")
    run = read_log(tmp_path / "log.txt", guessed.meaning)
    assert run.channels["u"] == pytest.approx(1e-3 * np.arange(20))


def test_motions_without_a_column_are_asked_for_and_the_unit_of_commands_counted_in_newtons(
    case: Path,
) -> None:
    t = np.arange(0.0, 20.0, 0.1)
    table = pl.DataFrame({"t": t, "kfspd": np.sin(t), **{f"f{k}": 0.5 * np.sin(k * t) for k in (1, 2, 3)}})
    found = guess_table(table, Path("log.csv"), load_vehicle(case / "usv.toml"))
    asked = "no column looks like surge (u or x), sway (v or y), yaw (r or psi) of the vehicle"
    assert any(question.startswith(asked) for question in found.questions)
    assert all("newtons, per cent or something else?" in g.doubt for g in found.columns)


def test_a_first_mapping_reads_a_log_whose_commands_have_gaps(case: Path) -> None:
    table = pl.read_csv(case / "train.csv")
    gaps = pl.when(pl.int_range(pl.len()) % 7 > 0).then(pl.col("f1"))
    table.with_columns(f1=gaps).write_csv(case / "own.csv")
    assert main(["map", "new", "own.csv", "--vehicle", "usv.toml", "--out", "log.toml"]) == 0
    assert read_mapping(case / "log.toml").missing_commands == "hold"
    assert "commands without a value in some rows (f1)" in (case / "log.toml").read_text()
    assert np.all(np.isfinite(_read(case, "own.csv")["f1"]))


def test_texts_among_numbers_are_asked_about(tmp_path: Path) -> None:
    c = _swinging()
    rate = [f"{r:.3f}" for r in np.gradient(c["psi"], 0.1)]
    rate[7], rate[9] = "jan.45", "mai.67"
    table = pl.DataFrame({"t": c["t"], "r_rad/s": rate, "throttle": [f"{100 * u:.1f}%" for u in c["u"]]})
    found = guess_table(table, tmp_path / "own.csv")
    assert any("such as 'jan.45' (2 of them)" in question for question in found.questions)
    assert 'not_numbers = "missing"' in found.text()
    (tmp_path / "log.toml").write_text(found.text())
    table.write_csv(tmp_path / "own.csv")
    run = read_log(tmp_path / "own.csv", read_mapping(tmp_path / "log.toml"), ["throttle"])
    assert np.isnan(run.channels["r"]).sum() == 2
    np.testing.assert_allclose(run.channels["throttle"], c["u"], atol=1e-3)


def test_of_two_clocks_the_one_with_a_time_in_every_row_is_the_time(tmp_path: Path) -> None:
    """As bags are written as text (rostopic echo -p) and put together: one topic alone has stamps."""
    header = "field.header.stamp,%time,field.velocity.x,field.torque.z\n"
    rows = [
        f"{1669909199900000000 + 50_000_000 * k},{1669909200000000000 + 50_000_000 * k},{0.01 * k},"
        if k % 2
        else f",{1669909200000000000 + 50_000_000 * k},,{k % 7}"
        for k in range(400)
    ]
    (tmp_path / "both.csv").write_text(header + "\n".join(rows) + "\n")
    guessed = guess_mapping(tmp_path / "both.csv")
    assert (guessed.time.column, guessed.time.entry["unit"]) == ("%time", "ns")
    assert guessed.time.doubt.startswith("1e+08 from sample to sample: that is 10 samples a second")


def test_a_wrench_is_that_of_the_axis_whatever_the_order_of_columns(tmp_path: Path) -> None:
    wrench = {"surge_force": 0, "sway_force": 1, "yaw_moment": 5}
    own = CATAMARAN + "".join(
        f'[[thrusters]]\nname = "{n}"\nwrench = {[float(i == k) for i in range(6)]}\n'
        for n, k in wrench.items()
    )
    columns = ("wrench_torque_z", "wrench_force_y", "wrench_force_x")
    guesses, found = _guesses(tmp_path, own, **dict.fromkeys(columns, 50.0))
    assert {n: guesses[n].column for n in wrench} == dict(zip(wrench, reversed(columns), strict=True))
    assert guesses["yaw_moment"].doubt.endswith("is it in N m?")
    assert [guesses[n].entry["unit"] for n in wrench] == ["N", "N", "N m"]
    assert not any(name in question for question in found.questions for name in wrench)
    assert not any("too: which columns have what acted on it" in question for question in found.questions)
    both = dict.fromkeys(
        [*columns, *(f"{kind}.{n}" for kind in ("zz_given", "desired") for n in columns)], 50.0
    )
    _, found = _guesses(tmp_path, own, **both)
    (asked,) = (question for question in found.questions if "have what acted on it" in question)
    assert asked.startswith(
        f"{', '.join(f'zz_given.{n}' for n in columns)} may be the force on the vehicle, too"
    )


def test_a_moment_that_a_draft_reads_in_newton_metres_is_read(tmp_path: Path) -> None:
    """A thruster may be a moment alone: 1 per N m; one with a lever takes newtons."""
    text = SURGE.replace('["surge"]', '["surge", "yaw"]').replace("m = 100", "m = 100\nI_z = 5")
    text += '[[thrusters]]\nname = "yaw_moment"\nwrench = [0, 0, 0, 0, 0, 1]\n'
    (tmp_path / "boat.toml").write_text(text)
    vehicle = load_vehicle(tmp_path / "boat.toml")
    t = np.arange(0.0, 10.0, 0.1)
    columns = {"t": t, "u": np.sin(t), "r": np.cos(t), "cmd.torque.z": 2.0 + np.sin(t)}
    pl.DataFrame(columns).write_csv(tmp_path / "log.csv")
    mapping = guess_mapping(tmp_path / "log.csv", vehicle).meaning
    assert mapping.columns["cmd.torque.z"].unit == "N m"
    mapping = in_vehicle_units(mapping, vehicle, "log")
    run = read_log(tmp_path / "log.csv", mapping, vehicle.actuator_names)
    np.testing.assert_allclose(run.channels["yaw_moment"], columns["cmd.torque.z"], rtol=1e-12)
    (tmp_path / "boat.toml").write_text(text.replace("0, 1]", "0, 0.3]"))
    couple = load_vehicle(tmp_path / "boat.toml")
    with pytest.raises(UndertowError, match=r"but N .* is needed"):
        in_vehicle_units(mapping, couple, "log")


@pytest.mark.parametrize("pair", [("u_L", "u_R"), ("motor_l", "motor_r"), ("Thrust L", "Thrust R")])
def test_a_column_for_each_side_is_a_command_of_that_side(tmp_path: Path, pair: tuple[str, str]) -> None:
    """Of a vehicle with propellers on both sides; u is its speed where no other u stands beside it."""
    own = CATAMARAN + "".join(
        f'[[thrusters]]\nname = "{n}"\nposition = ["0 m", "{y} m", "0 m"]\ndirection = [1, 0, 0]\n'
        for n, y in (("port", -0.4), ("starboard", 0.4))
    )
    guesses, _ = _guesses(tmp_path, own, psi=1.0, **dict.fromkeys(pair, 1.0))
    assert [guesses[n].column for n in ("port", "starboard")] == list(pair)
    assert "u" not in guesses
    assert guesses["port"].doubt.startswith("is it command 'port'?")
    alone, _ = _guesses(tmp_path, CATAMARAN, u_l=1.0, psi=1.0)
    assert alone["u"].column == "u_l"


def test_a_speed_is_no_command_of_the_side_that_it_names() -> None:
    usv = load_vehicle("otter")
    t = np.arange(0.0, 20.0, 0.1)
    columns = {"t": t, "Speed left (kn)": np.sin(t), "PWM L": 1500 + np.round(100 * np.sin(0.7 * t))}
    columns |= {"PWM R": 1500 + np.round(100 * np.cos(0.7 * t)), "psi": 0.2 * np.sin(t)}
    guess = guess_table(pl.DataFrame(columns), Path("log.csv"), usv)
    read = {g.column: g.channel for g in guess.columns}
    assert (read["PWM L"], read["PWM R"]) == ("port", "starboard")
    assert read["Speed left (kn)"] == "v"


def test_what_a_thruster_consumes_is_not_its_command() -> None:
    """A boat that logs power and current of its thrusters: no force, whatever the columns are called."""
    t = np.arange(60.0)
    table = {"time": t, "Port thruster (kW)": np.sin(t), "Starboard thruster [A]": np.cos(t)}
    assert not guess_table(pl.DataFrame(table), Path("log.csv"), load_vehicle("otter")).columns
    forces = {
        column.split(" ")[0] + " thruster (N)": cells for column, cells in table.items() if cells is not t
    }
    found = guess_table(pl.DataFrame({"time": t} | forces), Path("log.csv"), load_vehicle("otter"))
    assert {guess.channel for guess in found.columns} == {"port", "starboard"}


def test_rows_of_a_clock_with_too_few_digits_are_taken_as_evenly_spaced(case: Path) -> None:
    """A log of 7.4 rows a second whose times have three significant digits, as of a tanker of MARIN."""
    t = 0.1353 * np.arange(4000)
    rows = "\n".join(f"{a:.2e},{np.sin(0.1 * a):.6f}" for a in t)
    (case / "own.csv").write_text(f"time[s],u[m/s]\n{rows}\n")
    assert main(["map", "new", "own.csv", "--out", "log.toml"]) == 0
    mapping = read_mapping(case / "log.toml")
    assert mapping.time.spacing == pytest.approx(0.1353, rel=2e-4)
    assert "# ? 70% of its times repeat the one before" in (case / "log.toml").read_text()
    run = read_log(case / "own.csv", mapping)
    np.testing.assert_allclose(run.t, t, atol=0.1)
    np.testing.assert_allclose(run.channels["u"], np.sin(0.1 * t), atol=1e-6)


def test_a_table_without_times_is_read_by_its_sampling_interval(
    case: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (case / "own.csv").write_text("u,v\n1,2\n0,1\n1,1\n")
    assert main(["map", "new", "own.csv", "--interval", "50 ms", "--out", "log.toml"]) == 0
    run = read_log(case / "own.csv", read_mapping(case / "log.toml"))
    np.testing.assert_allclose(run.t, [0.0, 0.05, 0.1], atol=1e-15)
    assert "rows taken as 0.05 s apart, as stated" in run.notes
    for interval, said in (("0 s", "is not above zero"), ("3 m", "has the dimension [length]")):
        assert main(["map", "new", "own.csv", "--interval", interval, "--force"]) == 2
        assert said in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    ("column", "channel", "along_earth"),
    [
        *[(name, "r", False) for name in ("psi_dot", "psidot[deg/s]", "dpsi/dt [rad/s]", "yawDot")],
        *[(name, "u", True) for name in ("x_dot", "xdot[m/s]", "dx/dt")],
        *[(name, "", False) for name in ("u_dot", "udot[m/s2]", "dr/dt", "psi_dot_ref")],
    ],
)
def test_derivatives_by_time_are_velocities_of_the_pose_and_no_velocities_of_velocities(
    column: str, channel: str, along_earth: bool
) -> None:
    name = Name.of(column)
    assert (name.motion(), name.along_earth) == (channel, along_earth)


def test_a_clock_in_whole_seconds_with_gaps_is_read_by_the_first_row_of_each(tmp_path: Path) -> None:
    t = np.append(np.arange(0.0, 50.0, 0.1), np.arange(130.0, 180.0, 0.1))  # an interval would close the gap
    pl.DataFrame({"Time": np.floor(t + 1e9).astype(int), "depth": t}).write_csv(tmp_path / "dive.csv")
    found = guess_mapping(tmp_path / "dive.csv")
    assert found.time.entry == {"column": "Time", "unit": "s", "disorder": "drop"}
    assert "90% of its times repeat the one before: it has too few digits" in found.time.doubt
    run = _read_by(found, tmp_path / "dive.csv")
    np.testing.assert_allclose(run.t, np.append(np.arange(50.0), np.arange(130.0, 180.0)))
    np.testing.assert_allclose(run.channels["z"], run.t)


def test_a_column_called_like_a_thruster_is_its_command_and_no_motion() -> None:
    """Of a pilot's stick: the thruster file has a wrench for each axis. Without a name it is a motion."""
    t = np.arange(0.0, 20.0, 0.05)
    table = pl.DataFrame(
        {"t": t, "Heave": np.sin(t), "Depth": np.cos(t), "Yaw Angle": np.full(len(t), np.nan)}
    )
    vehicle = vehicle_from_table(
        VehicleTable.model_validate(
            {
                "schema": "undertow/vehicle/1",
                "name": "rov",
                "degrees_of_freedom": ["heave"],
                "signs": "magnitudes",
                "effects": {"rigid_body": {"m": 9.0}},
                "thrusters": [{"name": "heave", "wrench": [0, 0, 1, 0, 0, 0]}],
            }
        ),
        catalogue(),
    )
    by_channel = {g.channel: g.column for g in guess_table(table, Path("log.csv"), vehicle).columns}
    assert by_channel == {"z": "Depth", "heave": "Heave"}
    commanded = table.with_columns(pl.lit(0.5).alias("heave_cmd") * pl.col("Depth"))
    by_channel = {g.channel: g.column for g in guess_table(commanded, Path("log.csv"), vehicle).columns}
    assert by_channel == {"z": "Depth", "w": "Heave", "heave": "heave_cmd"}
    assert "w" in {g.channel for g in guess_table(table, Path("log.csv")).columns}


def test_dates_whose_year_comes_last_are_a_clock(tmp_path: Path) -> None:
    """Day or month first: within a day it makes no difference."""
    rows = [f"03/11/2025 09:13:{k:02} +00:00,{abs(k - 20)}" for k in range(40)]
    (tmp_path / "dive.csv").write_text("\n".join(["Ts,Depth", *rows]))
    guessed = guess_mapping(tmp_path / "dive.csv")
    assert guessed.time.entry == {"column": "Ts", "unit": "iso"}
    assert read_log(tmp_path / "dive.csv", guessed.meaning).t == pytest.approx(np.arange(40.0))
    (tmp_path / "dive.csv").write_text("\n".join(["Ts,Depth", *rows, "13/13/2025 09:14:00,1"]))
    with pytest.raises(UndertowError, match=r"time '13/13/2025 09:14:00' in row 41 is not an ISO 8601"):
        guess_mapping(tmp_path / "dive.csv")


def test_latitude_and_longitude_that_repeat_between_fixes_are_read_where_they_are_new(tmp_path: Path) -> None:
    t = np.arange(0.0, 60.0, 0.1)
    fix = np.floor(t + 1e-9)
    table = {"t": t, "lat": 48.0 + 1e-5 * fix, "lon": -3.0 + 2e-5 * fix, "yaw_rate": 0.1 * np.sin(t)}
    (tmp_path / "own.csv").write_text(text_of(table))
    found = guess_mapping(tmp_path / "own.csv")
    by_channel = {g.channel: g.entry.get("fresh") for g in found.columns}
    assert by_channel == {"x": "lat", "y": "lon", "r": None}
    run = _read_by(found, tmp_path / "own.csv")
    north = run.reports("x")
    np.testing.assert_allclose(run.t[np.isfinite(north)], np.arange(60.0), atol=1e-9)
    np.testing.assert_allclose(np.diff(north[np.isfinite(north)]), 1.112, atol=1e-3)


def test_the_position_of_a_buoyancy_engine_is_its_volume() -> None:
    assert Name.of("BallastPos").is_pumped_volume
    assert not Name.of("BallastCmd").is_pumped_volume


def test_the_volume_that_a_glider_pumps_is_its_net_buoyancy(tmp_path: Path) -> None:
    t = np.arange(0.0, 600.0, 4.0)
    volume = 200.0 * np.sign(np.sin(0.02 * t))
    table = {"t": t, "m_depth": 10.0 + 5.0 * np.sin(0.02 * t), "c_ballast_pumped": 230.0 + 0.1 * t}
    (tmp_path / "own.csv").write_text(text_of(table | {"m_ballast_pumped": volume}))
    glider = load_vehicle("glider")
    heaving = replace(glider, inputs={"B_net": "N"}, degrees_of_freedom=("heave",))
    with_engine = heaving.with_effect(catalogue()["net_buoyancy"], {})
    found = guess_mapping(tmp_path / "own.csv", with_engine)
    assert any("m_ballast_pumped: B_net: weight of the water displaced" in q for q in found.asked)
    run = _read_by(found, tmp_path / "own.csv", channels=["B_net"])
    np.testing.assert_allclose(run.channels["B_net"], 1025 * 9.816 * 1e-6 * volume, rtol=1e-5)
    assert "B_net" not in {g.channel for g in guess_mapping(tmp_path / "own.csv", glider).columns}


def _turning(**units: float) -> dict[str, Array]:
    """A boat that rolls and turns; angles and rates in so many of their unit to one of SI."""
    t = np.arange(0.0, 120.0, 0.1)
    roll, rolling = 0.05 * np.sin(0.7 * t), 0.035 * np.cos(0.7 * t)
    columns = {"t": t, "yaw": 1.2 * np.sin(0.1 * t), "roll": roll, "p": rolling, "r": 0.12 * np.cos(0.1 * t)}
    return {name: units.get(name, 1.0) * values for name, values in columns.items()}


@pytest.mark.parametrize(("size", "unit"), [(1.0, "rad/s"), (180 / np.pi, "deg/s")])
def test_a_roll_rate_has_the_unit_in_which_roll_changes(size: float, unit: str) -> None:
    in_degrees = _turning(p=size, roll=180 / np.pi, yaw=180 / np.pi)
    found = {g.channel: g for g in guess_table(pl.DataFrame(in_degrees), Path("own.csv")).columns}
    assert (found["p"].entry["unit"], found["p"].doubt) == (unit, "")
    assert found["r"].entry["unit"] == "rad/s", "that of the heading, whatever p is in"


def test_a_roll_rate_is_asked_about_where_roll_may_be_in_either_unit() -> None:
    alike = {"roll": 5.0, "p": 5.0}  # of 0.25 radians, or of a quarter of a degree
    found = {g.channel: g for g in guess_table(pl.DataFrame(_turning(**alike)), Path("own.csv")).columns}
    assert "rad/s, or slow turns in deg/s?" in found["p"].doubt
    for size, unit, doubt in (
        (20.0, "rad/s", "rad/s, or slow"),
        (57.3, "deg/s", "would turn the vehicle over"),
    ):
        table = pl.DataFrame(_turning(p=size)).drop("roll")  # to and fro by 57 or by 164 of its degrees
        alone = {g.channel: g for g in guess_table(table, Path("own.csv")).columns}
        assert alone["p"].entry["unit"] == unit
        assert doubt in alone["p"].doubt


def test_names_of_trials_of_ships_are_known() -> None:
    t = np.arange(0.0, 120.0, 0.1)
    place = {
        "Xg": 3.0 * t,
        "Yg": 20.0 * np.sin(0.1 * t),
        "Fi": 2.0 * np.sin(t),
        "Psi": 30.0 * np.cos(0.1 * t),
    }
    driven = {"Del": 20.0 * np.sin(0.1 * t), "Azimuth1": 9.0 * np.sin(t), "RPM": 90.0 + np.sin(t)}
    found = guess_table(pl.DataFrame({"Time": t} | place | driven), Path("own.csv"))
    by_column = {g.column: g.channel for g in found.columns}
    assert by_column == {"Xg": "x", "Yg": "y", "Fi": "phi", "Psi": "psi"} | {n: n for n in driven}
    alone = guess_table(pl.DataFrame({"Time": t, "Azimuth1": t**2, "imu.xg": t} | place), Path("own.csv"))
    assert {g.column for g in alone.columns} == {*place}, "an azimuth without revolutions may be a bearing"


@pytest.mark.parametrize(("channel", "largest", "unit"), [("roll", 6.3, "deg"), ("pitch", 2.5, "deg")])
def test_roll_and_pitch_that_would_be_upside_down_are_in_degrees(
    channel: str, largest: float, unit: str
) -> None:
    t = np.arange(0.0, 60.0, 0.1)
    for angle, expected in (
        (largest * np.sin(t), unit),
        ((0.3 * np.sin(t)) % (2 * np.pi), "rad"),  # from 0 to 2 pi
    ):
        (found,) = guess_table(pl.DataFrame({"t": t, channel: angle}), Path("own.csv")).columns
        assert found.entry["unit"] == expected
        assert ("upside down" in found.doubt) is (expected == "deg")


def test_a_change_is_no_rudder_and_volts_are_asked_about() -> None:
    t = np.arange(0.0, 60.0, 0.1)
    names = ("delta_distance", "delta_tof", "delta", "delta_r", "left_motor [V]")
    found = guess_table(pl.DataFrame({"t": t} | {n: np.sin(t + len(n)) for n in names}), Path("own.csv"))
    doubts = {g.column: g.doubt for g in found.columns}
    assert doubts.keys() == {"delta", "delta_r", "left_motor [V]"}
    assert "what was commanded, or what was measured?" in doubts["left_motor [V]"]


def test_theta_beside_x_and_y_alone_is_the_heading() -> None:
    t = np.arange(0.0, 60.0, 0.1)
    plane = {f"position.{n}": v for n, v in (("x", t), ("y", np.sin(t)), ("theta", 3.0 * np.sin(0.2 * t)))}
    found = {g.channel: g for g in guess_table(pl.DataFrame({"t": t} | plane), Path("own.csv")).columns}
    assert found.keys() == {"x", "y", "psi"}
    assert "read as the heading: is it?" in found["psi"].doubt
    for more in ({"position.z": np.cos(t)}, {"position.psi": np.sin(t)}, {"roll": np.sin(t)}):
        columns = guess_table(pl.DataFrame({"t": t} | plane | more), Path("own.csv")).columns
        assert "theta" in {g.channel for g in columns}


def test_a_roll_beside_a_heading_in_degrees_is_in_degrees_for_certain() -> None:
    t = np.arange(0.0, 60.0, 0.1)
    table = pl.DataFrame({"t": t, "roll": 6.0 * np.sin(t), "yaw": 90.0 * np.sin(0.1 * t)})
    found = {g.channel: g for g in guess_table(table, Path("own.csv")).columns}
    assert (found["phi"].entry["unit"], found["phi"].doubt) == ("deg", "")
