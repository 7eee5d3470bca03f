"""DataFlash logs of ArduPilot: every value as pymavlink reads it, the dive as it was, damage without harm."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.identification.logs.ardusub import (
    ARMED,
    BOOTED,
    DISARMED,
    DIVES,
    END,
    OUTPUT_OF_MOTOR,
    PARAMETERS,
    STEP,
    vehicle_for,
    write_bin,
)
from tests.identification.logs.dive import FULL, dive
from tests.identification.logs.field import FIELD
from tests.quick import first_quick
from undertow.cli.main import main
from undertow.errors import UndertowError
from undertow.identification.logs.formats.ardupilot import FRAMES, vehicle_text
from undertow.identification.logs.formats.fieldlog import FieldLog, format_of, read_field_log
from undertow.identification.logs.mapping import read_mapping
from undertow.identification.logs.reading import read_log, read_logs
from undertow.identification.logs.run import Run
from undertow.model.loading import load_vehicle
from undertow.model.tables import bundled_curves

SMALL = FIELD / "small.BIN"
FLOAT32 = 2.0**-23


def written(folder: Path) -> Path:
    """The dive, for the fixtures `log_path` and `log`."""
    return write_bin(folder / "dive.bin")


@pytest.fixture(scope="module")
def run(log_path: Path) -> Run:
    vehicle = vehicle_for(log_path.parent)[1]
    (only,) = read_logs([log_path], vehicle)
    return only


# --- against pymavlink ----------------------------------------------------------------------------


def _by_pymavlink(path: Path) -> dict[str, list[Any]]:
    reader = pytest.importorskip("pymavlink.DFReader").DFReader_binary(str(path))
    found: dict[str, list[Any]] = {}
    while (message := reader.recv_msg()) is not None:
        found.setdefault(message.get_type(), []).append(message)
    reader.close()
    return found


@pytest.mark.parametrize("path", [None, SMALL], ids=["dive", "small.BIN"])
def test_every_number_is_that_of_pymavlink(path: Path | None, log_path: Path) -> None:
    path = path or log_path
    if not path.exists():
        pytest.skip(f"{path} is not there")
    theirs, ours = _by_pymavlink(path), read_field_log(path)
    compared = 0
    for name, messages in theirs.items():
        parts = [s for s in ours.series.values() if s.name.split("[")[0] == name]
        if "TimeUS" not in messages[0].get_fieldnames():
            continue
        assert sum(len(s.t) for s in parts) == len(messages), name
        for column in set(parts[0].columns) & set(messages[0].get_fieldnames()):
            expected = np.array([getattr(m, column) for m in messages], dtype=float)
            found = np.concatenate([s.columns[column] for s in parts])
            order = np.argsort(np.concatenate([s.columns["TimeUS"] for s in parts]), kind="stable")
            sequence = np.argsort([m.TimeUS for m in messages], kind="stable")
            np.testing.assert_array_equal(found[order], expected[sequence], err_msg=f"{name}.{column}")
            compared += len(expected)
    assert compared > 30_000


@pytest.mark.skipif(not SMALL.exists(), reason=f"{SMALL} is not there")
def test_a_real_log_on_the_bench_is_understood() -> None:
    log = read_field_log(SMALL)
    assert log.notes[0] == "ArduSub V4.1.0 (89639005)"
    assert log.parameters["FRAME_CONFIG"] == 1.0
    assert [name for name, _ in log.actuators] == [f"RCOU.C{k}" for k in range(1, 7)]
    known = {column.channel for column in log.mapping.columns.values()}
    assert known == {"z", "phi", "theta", "psi", "p", "q", "r", "voltage"}
    # By quaternion and trim it is the attitude of the autopilot, which logs hundredths of a degree.
    for angle, name in (("phi", "Roll"), ("theta", "Pitch")):
        off = np.degrees(log.series["XKQ"].columns[angle]) - log.series["XKF1"].columns[name]
        assert np.abs(off).max() < 0.01
    rates = [log.series["IMU"].columns[name] for name in "pqr"]
    assert np.abs(np.median(rates, axis=1)).max() < 1e-3  # rad/s: it stands still


def test_units_are_those_of_fmtu(log: FieldLog) -> None:
    series = log.series
    assert series["IMU"].units["GyrX"] == "rad/s"
    assert series["IMU"].units["AccX"] == "m/s^2"
    assert (series["XKF1"].units["TimeUS"], series["XKF1"].units["Yaw"]) == ("us", "deg")
    assert "C" not in series["XKF1"].units


# --- the dive -------------------------------------------------------------------------------------


def test_the_dive_is_read_back(run: Run) -> None:
    d = dive()
    np.testing.assert_allclose(run.t, DIVES + d.t, atol=1e-6)
    expected = d.run.channels
    for name in ("x", "y", "z"):
        np.testing.assert_allclose(run.channels[name], expected[name], rtol=FLOAT32, atol=1e-7, err_msg=name)
    for name in ("phi", "theta", "psi", "u", "v", "w", "p", "q", "r"):
        np.testing.assert_allclose(run.channels[name], expected[name], atol=5e-7, err_msg=name)
    for name in d.vehicle.command_names:
        np.testing.assert_allclose(run.channels[name][:-1] * FULL, expected[name][:-1], atol=1e-9)


def test_battery_and_range_finder_are_read(run: Run) -> None:
    np.testing.assert_allclose(run.channels["voltage"][::2], 15.9, rtol=FLOAT32)
    np.testing.assert_allclose(run.channels["altitude"][::4], 10.0 - dive().pose[::4, 2], atol=0.006)


def test_what_is_left_out_is_said(log: FieldLog) -> None:
    ((first, last),) = log.intervals
    assert (first, last) == (pytest.approx(DIVES), pytest.approx(DISARMED))
    assert log.notes == (
        "ArduSub V4.1.0 (89639005)",
        f"left out: 0.0 to {ARMED} s (disarmed), {ARMED} to {DIVES} s (motors at rest, or estimator without "
        f"an aid), {DISARMED} to {END} s (disarmed)",
    )


# --- the autopilot --------------------------------------------------------------------------------


def test_the_primary_core_is_read(tmp_path: Path) -> None:
    def second(now: float, cells: list[Any]) -> list[Any]:
        return [*cells[:-1], 1]

    twice = [("XKF1", t, [1, 0.0, 0.0, 0.0, *[0.5] * 4, t, t, 3.0, 0.0, 0.0, 0.0, 0.0]) for t in (20.0, 21.0)]
    log = read_field_log(write_bin(tmp_path / "cores.bin", {"XKF4": second}, twice))
    assert {"XKF1[0]", "XKF1[1]"} <= set(log.series)
    assert log.mapping.columns["XKF1[1].PN"].channel == "x"
    assert log.series["XKF1[1]"].columns["PN"].tolist() == [20.0, 21.0]
    assert any("core 1" in note for note in log.notes)


def test_a_reset_of_the_estimator_cuts_the_log(tmp_path: Path) -> None:
    def moved(now: float, cells: list[Any]) -> list[Any]:
        return [*cells[:7], 0.7 if now >= 40.0 else 0.0, *cells[8:]]

    said = [("MSG", 60.0, ["EKF3 IMU0 MAG0 in-flight yaw alignment complete"])]
    log = read_field_log(write_bin(tmp_path / "reset.bin", {"XKF4": moved}, said))
    starts = [first for first, _ in log.intervals]
    assert starts == pytest.approx([DIVES, 40.0, 60.0])
    assert [last for _, last in log.intervals] == pytest.approx([40.0, 60.0, DISARMED], abs=1e-6)
    assert "cut at 40.0, 60.0 s, where the estimator was reset" in log.notes


def test_an_estimator_without_aid_knows_depth_and_attitude_only(tmp_path: Path) -> None:
    def held(now: float, cells: list[Any]) -> list[Any]:
        return [*cells[:11], 128 + 831, *cells[12:]]

    log = read_field_log(write_bin(tmp_path / "held.bin", {"XKF4": held}))
    found = {column.channel for column in log.mapping.columns.values()}
    assert found == {"z", "phi", "theta", "psi", "p", "q", "r", "voltage", "altitude"}
    assert any("no horizontal aid" in note for note in log.notes)
    assert len(log.intervals) == 1


def test_a_spell_without_aid_is_left_out(tmp_path: Path) -> None:
    def held(now: float, cells: list[Any]) -> list[Any]:
        return [*cells[:11], 831 + 128 * (30.0 <= now < 50.0), *cells[12:]]

    log = read_field_log(write_bin(tmp_path / "spell.bin", {"XKF4": held}))
    (a, b), (c, e) = log.intervals
    assert (a, b, c, e) == pytest.approx((DIVES, 30.0, 50.0, DISARMED), abs=1e-6)
    assert "left out where the estimator held its position without an aid" in log.notes


def test_without_parameters_it_is_said_that_the_motors_are_not_known(tmp_path: Path) -> None:
    path = write_bin(tmp_path / "cut.bin", {"PARM": lambda now, cells: []})
    with pytest.raises(UndertowError, match=r"no recognised motors .*SERVOn_FUNCTION.* commands f1, f2"):
        read_logs([path], vehicle_for(tmp_path)[1])


def test_a_log_that_never_moves_is_used_where_it_is_armed(tmp_path: Path) -> None:
    log = read_field_log(write_bin(tmp_path / "still.bin", {"RCOU": lambda t, cells: [1500] * 8 + [0] * 6}))
    assert log.intervals == (pytest.approx((ARMED, DISARMED)),)
    assert "armed, but no motor leaves neutral: all of the armed time is used" in log.notes


def test_attitude_without_quaternions_is_that_of_xkf1(tmp_path: Path) -> None:
    run = read_log(write_bin(tmp_path / "euler.bin", {"XKQ": lambda t, cells: []}))
    for name, k in (("phi", 3), ("theta", 4)):
        off = np.degrees(run.channels[name] - dive().pose[:, k])
        assert 1e-4 < np.max(np.abs(off)) < 0.0101  # hundredths of a degree


def _with(**parameters: float) -> dict[str, Any]:
    def stated(now: float, cells: list[Any]) -> list[Any]:
        return [cells[0], parameters.get(cells[0], cells[1])]

    return {"PARM": stated}


def test_the_trim_of_an_output_is_where_its_motor_rests(tmp_path: Path) -> None:
    output = OUTPUT_OF_MOTOR[0]

    def shifted(now: float, cells: list[Any]) -> list[Any]:
        cells[output - 1] += 20
        return cells

    changes = {**_with(**{f"SERVO{output}_TRIM": 1520.0}), "RCOU": shifted}
    vehicle = vehicle_for(tmp_path)[1]
    (run,) = read_logs([write_bin(tmp_path / "trim.bin", changes)], vehicle)
    np.testing.assert_allclose(run.channels["f1"][:-1] * FULL, dive().thrust[:-1, 0], atol=1e-9)
    assert f"motor 1 rests at 1520 µs, the trim of output {output}" in run.reader_notes


def test_an_output_that_is_switched_off_gives_no_thrust(tmp_path: Path) -> None:
    """0 µs is no pulse: neither a command of -3.75 nor a motor that has left its rest."""

    def cut(now: float, cells: list[Any]) -> list[Any]:
        return [0] * len(cells) if now < DIVES or 30.0 <= now < 31.0 else cells

    path, vehicle = write_bin(tmp_path / "off.bin", {"RCOU": cut}), vehicle_for(tmp_path)[1]
    (run,) = read_logs([path], vehicle)
    assert run.t[0] == pytest.approx(DIVES, abs=0.1)  # the motors move from then on
    assert all(np.all(run.channels[n][_off(run)] == 0.0) for n in vehicle.command_names)
    early = run.t < 29.9
    np.testing.assert_allclose(run.channels["f1"][early] * FULL, dive().thrust[: early.sum(), 0], atol=1e-9)
    assert any("give no pulse (0 µs)" in note for note in run.reader_notes)
    table = tmp_path / "table.parquet"
    assert main(["import", str(path), "--vehicle", str(tmp_path / "rov.toml"), "--out", str(table)]) == 0
    (again,) = read_logs([table], vehicle, read_mapping(tmp_path / "table.toml"))
    assert np.all(again.channels["f1"][_off(again)] == 0.0)


def _off(run: Run) -> Any:
    return (run.t > 30.1) & (run.t < 30.9)


def test_a_reversal_is_heeded_where_the_autopilot_heeds_it(tmp_path: Path) -> None:
    reversed_, vehicle = _with(**{f"SERVO{OUTPUT_OF_MOTOR[2]}_TRIM": 1500.0}), vehicle_for(tmp_path)[1]
    set_ = [("PARM", 1.0, [f"SERVO{OUTPUT_OF_MOTOR[2]}_REVERSED", 1.0])]
    sub = write_bin(tmp_path / "sub.bin", reversed_, set_)
    other = write_bin(tmp_path / "other.bin", {**reversed_, "MSG": lambda t, c: ["ArduRover V4.5.0"]}, set_)
    for path, sign, reported in ((sub, 1.0, "ignores it"), (other, -1.0, "is turned")):
        (run,) = read_logs([path], vehicle)
        np.testing.assert_allclose(run.channels["f3"][:-1] * FULL, sign * dive().thrust[:-1, 2], atol=1e-9)
        assert any("REVERSED" in note and reported in note for note in run.reader_notes)


# --- the vehicle ----------------------------------------------------------------------------------


def _written(log: FieldLog, folder: Path) -> Any:
    path = folder / "made.toml"
    path.write_text(vehicle_text(log, "made"), encoding="utf-8")
    return load_vehicle(path)


def test_frame_and_directions_of_motors_give_the_thrusters(log: FieldLog, tmp_path: Path) -> None:
    made, bundled = _written(log, tmp_path), load_vehicle("bluerov2")
    assert made.command_names == bundled.command_names
    for ours, theirs in zip(made.thrusters, bundled.thrusters, strict=True):
        np.testing.assert_allclose(ours.wrench, theirs.wrench, atol=1e-12)
        assert ours.law is not None
        assert ours.law.at(1.0) == pytest.approx(51.4362)  # 5.245 kgf at 16 V; the battery has 15.9
        assert (ours.law.at(0.0), ours.law.at(0.06)) == pytest.approx((0.0, 0.0), abs=1e-9)  # dead band


def test_a_motor_that_is_set_the_other_way_pushes_the_other_way(tmp_path: Path) -> None:
    changes = _with(MOT_3_DIRECTION=1.0, MOT_8_DIRECTION=1.0)
    made = _written(read_field_log(write_bin(tmp_path / "turned.bin", changes)), tmp_path)
    for ours, theirs in zip(made.thrusters, load_vehicle("bluerov2").thrusters, strict=True):
        sign = -1.0 if ours.name in ("f3", "f8") else 1.0
        np.testing.assert_allclose(ours.wrench, sign * np.array(theirs.wrench), atol=1e-12)


def test_the_frame_with_six_thrusters_is_its_own_vehicle(tmp_path: Path) -> None:
    ways = {f"MOT_{k}_DIRECTION": way for k, way in enumerate((-1.0, -1.0, -1.0, -1.0, -1.0, -1.0), 1)}
    log = read_field_log(write_bin(tmp_path / "six.bin", _with(FRAME_CONFIG=1.0, **ways)))
    made = _written(log, tmp_path)
    for ours, theirs in zip(made.thrusters, load_vehicle("bluerov2-6").thrusters, strict=True):
        np.testing.assert_allclose(ours.wrench, theirs.wrench, atol=1e-12)


@pytest.mark.parametrize(("frame", "reported"), [(7.0, r"7 \(Custom\)"), (9.0, "9")])
def test_a_frame_that_is_not_known_is_refused(log: FieldLog, frame: float, reported: str) -> None:
    other = replace(log, parameters={**log.parameters, "FRAME_CONFIG": frame})
    with pytest.raises(
        UndertowError, match=rf"states FRAME_CONFIG {reported}, and motors are known for 0 BlueROV1"
    ):
        vehicle_text(other, "made")


@pytest.mark.parametrize("number", first_quick(sorted(FRAMES), 2))
def test_thrusters_of_a_frame_do_what_its_firmware_means_them_to(
    log: FieldLog, tmp_path: Path, number: int
) -> None:
    """A demand, mixed by the factors, moves the vehicle that way: the moments have the signs of the mixer."""
    ways = {f"MOT_{k}_DIRECTION": 1.0 for k in range(1, 9)}
    made = _written(replace(log, parameters={**log.parameters, **ways, "FRAME_CONFIG": number}), tmp_path)
    frame = FRAMES[number]
    assert len(made.thrusters) == len(frame.motors)
    for thruster, factors in zip(made.thrusters, frame.motors, strict=True):
        force, moment = np.split(np.array(thruster.wrench, dtype=float), 2)
        assert np.linalg.norm(force) == pytest.approx(1.0)
        np.testing.assert_array_equal(
            np.sign(force.round(9)), np.sign([factors.forward, factors.lateral, -factors.throttle])
        )
        asked = np.array(factors[:3], dtype=float)
        assert all(np.sign(moment[asked != 0]) == np.sign(asked[asked != 0])), (frame.name, thruster.name)


def test_curves_of_the_t200_have_the_published_ends() -> None:
    kgf = 9.80665
    published = {12: (-2.904, 3.714), 14: (-3.517, 4.524), 16: (-4.069, 5.245), 18: (-4.590, 6.016)}
    for volts, (back, ahead) in published.items():
        path = bundled_curves()[f"t200-{volts}v"]
        rows = [line.split(",") for line in path.read_text().splitlines() if line[0] in "-01"]
        command, thrust = np.array(rows, dtype=float).T
        assert (command[0], command[-1], len(command)) == (-1.0, 1.0, 201)
        assert (thrust[0], thrust[-1]) == (
            pytest.approx(back * kgf, abs=0.08),
            pytest.approx(ahead * kgf, abs=0.08),
        )
        assert np.all(thrust[np.abs(command) < 0.0699] == 0.0)
        assert np.all(np.diff(thrust) >= 0.0)


def test_outputs_that_are_taken_for_newtons_are_reported(log_path: Path) -> None:
    (run,) = read_logs([log_path], load_vehicle("bluerov2"))
    assert any("the vehicle takes them as newtons" in note for note in run.reader_notes)


# --- damage ---------------------------------------------------------------------------------------


def _same_where_both(found: FieldLog, whole: FieldLog, name: str, column: str) -> Iterator[float]:
    times = {
        round(t, 4): v for t, v in zip(whole.series[name].t, whole.series[name].columns[column], strict=True)
    }
    for t, value in zip(found.series[name].t, found.series[name].columns[column], strict=True):
        assert times[round(t, 4)] == value
        yield value


@pytest.mark.parametrize("fill", [0x00, 0xFF, 0xA3])
def test_a_damaged_stretch_costs_its_messages_only(fill: int, log_path: Path, log: FieldLog) -> None:
    data = bytearray(log_path.read_bytes())
    data[200_000:204_096] = bytes([fill]) * 4096
    path = log_path.with_name(f"hole{fill}.bin")
    path.write_bytes(data)
    found = read_field_log(path)
    assert any("damaged segments" in note for note in found.notes)
    for name, column in (("XKF1", "PN"), ("XKQ", "phi"), ("RCOU", "C3")):
        kept = sum(1 for _ in _same_where_both(found, log, name, column))
        assert len(log.series[name].t) - 30 <= kept < len(log.series[name].t)


def test_bytes_that_look_like_a_head_inside_a_message_are_none(tmp_path: Path) -> None:
    number = np.frombuffer(b"\xa3\x95\x4c\x00", "<f4")[0]  # a head of XKF1 in the cell of a position

    def odd(now: float, cells: list[Any]) -> list[Any]:
        return [*cells[:10], float(number), *cells[11:]]

    log = read_field_log(write_bin(tmp_path / "heads.bin", {"XKF1": odd}))
    assert not any("damaged" in note for note in log.notes)
    assert np.all(log.series["XKF1"].columns["PD"] == number)
    assert len(log.series["XKF1"].t) == round(END / STEP) + 1


def test_a_time_that_cannot_be_costs_its_message_only(log_path: Path, log: FieldLog) -> None:
    data = bytearray(log_path.read_bytes())
    stamp = round((BOOTED + 30.0) * 1e6).to_bytes(8, "little")
    place = data.index(stamp)
    data[place + 6] = 0x7F
    path = log_path.with_name("late.bin")
    path.write_bytes(data)
    found = read_field_log(path)
    assert "1 messages with an impossible time are left out" in found.notes
    assert sum(len(s.t) for s in found.series.values()) == sum(len(s.t) for s in log.series.values()) - 1


@pytest.mark.parametrize("keep", [3, 89, 1000, 9000, 300_000])
def test_a_log_that_is_cut_off_is_read_or_refused_in_one_line(keep: int, log_path: Path) -> None:
    path = log_path.with_name(f"cut{keep}.bin")
    path.write_bytes(log_path.read_bytes()[:keep])
    _read_or_refused(path)


def _read_or_refused(path: Path) -> None:
    """Read a log in both ways; each has to do it, or to refuse in one line."""
    for read in (_table, read_log):
        said = ""
        try:
            read(path)
        except UndertowError as error:
            said = str(error)
        assert "\n" not in said


def _table(path: Path) -> None:
    log = read_field_log(path)
    log.table(log.mapping.columns)


_HITS = st.lists(st.tuples(st.floats(0, 1), st.binary(min_size=1, max_size=64)), min_size=1, max_size=8)


@settings(max_examples=40, deadline=None)
@given(hits=_HITS, length=st.floats(0.0, 1.0), insert=st.booleans())
def test_damaged_bytes_never_give_a_traceback(
    log_path: Path, hits: list[tuple[float, bytes]], length: float, insert: bool
) -> None:
    whole, head = log_path.read_bytes(), 8_000  # of descriptions: half of the hits fall there
    data = bytearray(whole[: head + int(length * 60_000)])
    for k, (where, junk) in enumerate(hits):
        place = int(where * (head if k % 2 else len(data) - 1))
        data[place : place if insert else place + len(junk)] = junk
    path = log_path.with_name("fuzzed.bin")
    path.write_bytes(data)
    _read_or_refused(path)


# --- which files ----------------------------------------------------------------------------------


def test_it_is_known_by_its_bytes(log_path: Path, tmp_path: Path) -> None:
    renamed = tmp_path / "00000042.log"
    renamed.write_bytes(log_path.read_bytes()[:20_000])
    found = format_of(renamed)
    assert found is not None
    assert found.name == "ArduPilot DataFlash"


def test_parameters_are_the_last_ones(log: FieldLog) -> None:
    for name, value in PARAMETERS.items():
        assert math.isclose(float(log.parameters[name]), value, rel_tol=1e-6), name


# --- other estimators and sensors -----------------------------------------------------------------


def test_velocities_of_a_camera_are_steps_over_their_time(tmp_path: Path) -> None:
    def held(now: float, cells: list[Any]) -> list[Any]:
        return [*cells[:11], 128, *cells[12:]]

    steps = [("VISO", t, [0.1, 0.0, 0.0, 0.0, 0.02, -0.01, 0.005, 100.0]) for t in np.arange(20.0, 60.0, 0.1)]
    log = read_field_log(write_bin(tmp_path / "viso.bin", {"XKF4": held}, steps))
    channels = {name: column.channel for name, column in log.mapping.columns.items()}
    assert {channels[f"VISO.{name}"] for name in "uvw"} == {"u", "v", "w"}
    for name, speed in (("u", 0.2), ("v", -0.1), ("w", 0.05)):
        np.testing.assert_allclose(log.series["VISO"].columns[name], speed, rtol=1e-6)
    assert log.mapping.frames.velocity == "body"
    assert channels["XKF1.PD"] == "z"


def test_without_an_estimator_the_attitude_is_that_of_att(tmp_path: Path) -> None:
    gone = {name: lambda t, cells: [] for name in ("XKF1", "XKF4", "XKQ")}
    angles = [("ATT", t, [0.0, 3.0, 0.0, -4.0, 0.0, 350.0, 0.0, 0.0, 3]) for t in np.arange(15.0, 75.0, 0.1)]
    run = read_log(write_bin(tmp_path / "att.bin", gone, angles))
    for name, degrees in (("phi", 3.0), ("theta", -4.0), ("psi", 350.0)):
        there = np.isfinite(run.channels[name])
        assert there.sum() > 500
        np.testing.assert_allclose(run.channels[name][there], np.radians(degrees), rtol=1e-12)
    assert not run.has("x")
    there = np.isfinite(run.channels["p"])
    assert np.std(run.channels["p"][there]) > 0.05


def test_the_second_estimator_is_read_where_the_autopilot_uses_it(tmp_path: Path) -> None:
    two = [("NKF1", t, [0, 1.0, 2.0, 3.0, *[0.1] * 4, t, 2 * t, 3.0, 0.0, 0.0, 0.0, 0.0])
           for t in np.arange(15.0, 75.0, 0.1)]  # fmt: skip
    log = read_field_log(write_bin(tmp_path / "two.bin", _with(AHRS_EKF_TYPE=2.0), two))
    assert log.mapping.columns["NKF1.PN"].channel == "x"
    assert log.mapping.columns["NKF1.Roll"].unit == "deg"
    assert not any(name.startswith("XKF1") for name in log.mapping.columns)
