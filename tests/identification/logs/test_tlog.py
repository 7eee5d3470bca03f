"""MAVLink telemetry: the vehicle's own messages on the vehicle's own clock, bad checksums left out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.identification.logs.ardusub import ARMED, DISARMED, DIVES, FULL, vehicle_for, write_tlog
from tests.identification.logs.dive import dive
from tests.identification.logs.field import FIELD
from undertow.errors import UndertowError
from undertow.identification.logs.formats import tlog
from undertow.identification.logs.formats.ardupilot import vehicle_text
from undertow.identification.logs.formats.fieldlog import FieldLog, format_of, read_field_log, rising
from undertow.identification.logs.reading import read_log

SMALL = FIELD / "small.tlog"
"""testing/small.tlog of clydemcqueen/ardusub_log_tools; its tests are skipped where it is not there."""
FLOAT32 = 2.0**-23

pytest.importorskip("pymavlink")


def written(folder: Path) -> Path:
    """The dive, for the fixtures `log_path` and `log`."""
    return write_tlog(folder / "dive.tlog")


def _in_dive(log: FieldLog, name: str, columns: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Times from the begin of the dive, and columns, of the samples within it."""
    series = log.series[name]
    t = series.t - (series.t[0] + DIVES)
    inside = (t > -0.01) & (t < DISARMED - DIVES + 0.01)
    return t[inside], np.column_stack([series.columns[c][inside] for c in columns])


def test_the_dive_is_read_back_on_the_clock_of_the_vehicle(log: FieldLog) -> None:
    d = dive()
    for name, columns, expected in (
        ("ATTITUDE", ("roll", "pitch", "yaw"), d.pose[:, 3:]),
        ("ATTITUDE", ("rollspeed", "pitchspeed", "yawspeed"), d.rates),
        ("LOCAL_POSITION_NED", ("x", "y", "z"), d.pose[:, :3]),
        ("LOCAL_POSITION_NED", ("vx", "vy", "vz"), d.velocity_ned),
    ):
        t, values = _in_dive(log, name, columns)
        np.testing.assert_allclose(t, d.t, atol=1.1e-3)  # milliseconds; arrival comes in bursts
        np.testing.assert_allclose(values, expected, rtol=FLOAT32, atol=1e-9, err_msg=name)


def test_what_the_columns_mean_is_known(log: FieldLog, tmp_path: Path) -> None:
    vehicle = vehicle_for(tmp_path)[1]
    meaning = log.mapping_for(vehicle.command_names)
    found = {column.channel for column in meaning.columns.values()}
    assert found == {*"xyzuvwpqr", "phi", "theta", "psi", "voltage", *vehicle.command_names}
    assert meaning.frames.velocity == "NED"
    t, commands = log.drive() or (np.zeros(0), np.zeros((0, 0)))
    inside = (t >= log.intervals[0][0]) & (t < DISARMED - 0.01)
    np.testing.assert_allclose(commands[inside] * FULL, dive().thrust[: inside.sum()], atol=1e-9)


def test_only_the_autopilot_is_heard(log: FieldLog) -> None:
    assert np.abs(log.series["ATTITUDE"].columns["roll"]).max() < 1.0  # the ground station says 3
    assert len(log.series["HEARTBEAT"].t) == 81


def test_armed_and_moving_is_the_stretch(log: FieldLog) -> None:
    ((first, last),) = log.intervals
    assert (first, last) == (pytest.approx(DIVES, abs=0.2), pytest.approx(DISARMED, abs=0.2))
    assert f"({ARMED:g}" not in log.notes[-1]
    assert log.notes[-1].startswith("left out: 0.0 to 10.")


def test_the_vehicle_file_is_that_of_the_parameters(log: FieldLog) -> None:
    text = vehicle_text(log, "rov")
    assert text.count('curve = "t200-16v"') == 8
    assert "MOT_6_DIRECTION 1; T200 at 16 V, battery at 15.9 V" in text


def test_degrees_become_metres_where_there_are_no_others(tmp_path: Path) -> None:
    log = read_field_log(write_tlog(tmp_path / "world.tlog", local=False))
    assert log.mapping.columns["GLOBAL_POSITION_INT.north"].channel == "x"
    t, places = _in_dive(log, "GLOBAL_POSITION_INT", ("north", "east", "down"))
    moved = places - places[0]
    # Degrees are logged to 1e-7, a centimetre; altitudes to a millimetre.
    np.testing.assert_allclose(moved, dive().pose[:, :3] - dive().pose[0, :3], atol=0.021)
    assert any("positions are metres from the first fix, 48.38614" in note for note in log.notes)
    assert log.mapping.columns["GLOBAL_POSITION_INT.vx"].scale == 0.01
    assert len(t) == len(dive().t)


def test_a_vehicle_without_a_fix_has_its_depth(tmp_path: Path) -> None:
    """Of an ROV without a Doppler log or satellites, latitude, longitude and altitude are zero."""
    log = read_field_log(write_tlog(tmp_path / "plain.tlog", local=False, aided=False))
    channels = {column.channel for column in log.mapping.columns.values()}
    assert channels == {"z", "phi", "theta", "psi", "p", "q", "r", "voltage"}
    assert "the vehicle has no position: depth, angles and rates only" in log.notes
    run = read_log(log.path)
    assert np.nanmax(run.channels["z"]) == pytest.approx(np.max(dive().pose[:, 2]), abs=2e-3)


def test_messages_with_a_bad_checksum_are_counted_and_left_out(log_path: Path, log: FieldLog) -> None:
    data = bytearray(log_path.read_bytes())
    for place in (150_000, 200_000, 250_000):  # one byte each, wherever it falls
        data[place] ^= 0x55
    path = log_path.with_name("bad.tlog")
    path.write_bytes(data)
    found = read_field_log(path)
    count = [note for note in found.notes if "bad checksum" in note]
    before, after = (sum(len(s.t) for s in one.series.values()) for one in (log, found))
    assert len(count) == 1
    assert 1 <= int(count[0].split()[0]) <= 3
    assert before - 6 <= after < before
    for column in ("x", "y", "z"):
        one, two = (dict(zip(f.series["LOCAL_POSITION_NED"].columns["time_boot_ms"],
                             f.series["LOCAL_POSITION_NED"].columns[column], strict=True))
                    for f in (log, found))  # fmt: skip
        assert all(one[t] == value for t, value in two.items())


def test_a_time_of_arrival_that_cannot_be_costs_its_message_only(log_path: Path, log: FieldLog) -> None:
    data = bytearray(log_path.read_bytes())
    place = data.index((1_683_000_000_000_000 + 30_130_000).to_bytes(8, "big"))
    data[place + 2] += 1
    path = log_path.with_name("stamp.tlog")
    path.write_bytes(data)
    found = read_field_log(path)
    assert "1 messages with a bad checksum or time, or cut off, are left out" in found.notes
    assert found.intervals == log.intervals


def test_a_log_that_is_cut_off_loses_its_last_message(log_path: Path, log: FieldLog) -> None:
    path = log_path.with_name("cut.tlog")
    path.write_bytes(log_path.read_bytes()[:-5])
    found = read_field_log(path)
    before, after = (sum(len(s.t) for s in one.series.values()) for one in (log, found))
    assert after == before - 1


def test_a_vehicle_that_boots_anew_goes_on_in_time(tmp_path: Path, log_path: Path) -> None:
    data = log_path.read_bytes()
    path = tmp_path / "twice.tlog"
    path.write_bytes(data + _later(data, 120.0))
    found = read_field_log(path)
    series = found.series["ATTITUDE"]
    assert len(rising(series.t)) == len(series.t)
    half = len(series.t) // 2
    np.testing.assert_allclose(series.t[half:] - series.t[:half], 120.0, atol=0.06)
    assert len(found.intervals) == 2


def _later(data: bytes, seconds: float) -> bytes:
    """The same messages, received later."""
    out, place = [], 0
    while place < len(data):
        size = 12 + data[place + 9]
        stamp = int.from_bytes(data[place : place + 8], "big") + round(seconds * 1e6)
        out += [stamp.to_bytes(8, "big"), data[place + 8 : place + 8 + size]]
        place += 8 + size
    return b"".join(out)


def test_a_ground_station_alone_is_no_vehicle(tmp_path: Path) -> None:
    mavlink = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega")
    ground = mavlink.MAVLink(None, 255, 190)
    beat = mavlink.MAVLink_heartbeat_message(6, 8, 192, 0, 4, 3).pack(ground)
    path = tmp_path / "ground.tlog"
    path.write_bytes(b"".join(round((1.6e9 + k) * 1e6).to_bytes(8, "big") + beat for k in range(9)))
    with pytest.raises(UndertowError, match="heartbeat of an autopilot"):
        read_field_log(path)


def test_without_pymavlink_one_line_says_what_to_install(
    log_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pymavlink.dialects.v20.ardupilotmega", None)
    with pytest.raises(UndertowError, match=r'needs the library pymavlink: pip install "undertow\[field\]"'):
        read_field_log(log_path)


def test_it_is_known_by_its_bytes(log_path: Path, tmp_path: Path) -> None:
    renamed = tmp_path / "flight.raw"
    renamed.write_bytes(log_path.read_bytes()[:20_000])
    assert format_of(renamed) is tlog.FORMAT


_HITS = st.lists(st.tuples(st.floats(0, 1), st.binary(min_size=1, max_size=64)), max_size=8)


@settings(max_examples=40, deadline=None)
@given(hits=_HITS, length=st.floats(0.0, 1.0), insert=st.booleans())
def test_damaged_bytes_never_give_a_traceback(
    log_path: Path, hits: list[tuple[float, bytes]], length: float, insert: bool
) -> None:
    data = bytearray(log_path.read_bytes()[: 20 + int(length * 30_000)])
    for where, junk in hits:
        place = int(where * (len(data) - 1))
        data[place : place if insert else place + len(junk)] = junk
    path = log_path.with_name("fuzzed.tlog")
    path.write_bytes(data)
    for read in (lambda p: (f := read_field_log(p)).table(f.mapping.columns), read_log):
        said = ""
        try:
            read(path)
        except UndertowError as error:
            said = str(error)
        assert "\n" not in said


def test_every_message_of_a_real_log_is_that_of_pymavlink() -> None:
    if not SMALL.exists():
        pytest.skip(f"{SMALL} is not there")
    mavutil = pytest.importorskip("pymavlink.mavutil")
    found, link = read_field_log(SMALL), mavutil.mavlink_connection(str(SMALL), robust_parsing=True)
    theirs: dict[str, list[object]] = {}
    bad = 0
    while (message := link.recv_match()) is not None:
        bad += message.get_type() == "BAD_DATA"
        if (message.get_srcSystem(), message.get_srcComponent()) == (1, 1):
            theirs.setdefault(message.get_type(), []).append(message)
    link.close()
    assert f"{bad} messages with a bad checksum or time, or cut off, are left out" in found.notes
    for name, messages in theirs.items():
        parts = [s for s in found.series.values() if s.name.split("[")[0] == name]
        assert sum(len(s.t) for s in parts) == len(messages), name
        if len(parts) == 1:
            for column, values in parts[0].columns.items():
                if hasattr(messages[0], column):
                    expected = [float(getattr(m, column)) for m in messages]
                    np.testing.assert_array_equal(values, expected, err_msg=f"{name}.{column}")
