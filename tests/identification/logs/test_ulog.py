"""Logs of PX4: the dive comes back, arming and resets cut it, real files are read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from undertow.errors import UndertowError
from undertow.identification.logs.formats.fieldlog import read_field_log
from undertow.identification.logs.reading import read_log, read_logs
from undertow.model.loading import load_vehicle

from .dive import dive
from .field import FIELD
from .written import assert_the_dive, cut_off, in_newtons, ulog

pyulog = pytest.importorskip("pyulog")
_REAL = FIELD / "px4" / "sample_log_small.ulg"
_COMMANDS = load_vehicle("bluerov2").command_names


def test_the_bytes_are_those_of_the_format(tmp_path: Path) -> None:
    path = ulog(dive()).write(tmp_path / "dive.ulg")
    log = pyulog.ULog(str(path))
    assert not log.file_corruption
    position = log.get_dataset("vehicle_local_position").data
    assert np.array_equal(position["x"], dive().pose[:, 0].astype(np.float32))
    assert log.initial_parameters == {"CA_ROTOR_COUNT": 8.0}


def test_the_dive_comes_back_to_the_precision_of_the_file(tmp_path: Path) -> None:
    path = ulog(dive()).write(tmp_path / "dive.ulg")
    log = read_field_log(path)
    mapping = in_newtons(log.mapping_for(_COMMANDS))
    (run,) = read_logs([path], load_vehicle("bluerov2"), mapping)
    largest = max(np.max(np.abs(c)) for c in dive().run.channels.values())
    assert_the_dive(run, dive(), 4 * largest * np.finfo(np.float32).eps)
    assert log.parameters["CA_ROTOR_COUNT"] == 8.0
    assert [log.series[n].columns["voltage_v"][0] for n in ("battery_status", "battery_status[1]")] == [
        15.5,
        12,
    ]
    assert np.nanmax(np.abs(run.channels["voltage"] - 15.5)) == 0.0


def test_only_what_was_armed_is_used_and_a_reset_cuts_it(tmp_path: Path) -> None:
    path = ulog(dive(), resets=(30.0,), armed=(10.0, 50.0)).write(tmp_path / "dive.ulg")
    log = read_field_log(path)
    mapping = in_newtons(log.mapping_for(_COMMANDS))
    before, after = read_logs([path], load_vehicle("bluerov2"), mapping)
    assert log.intervals[0][0] == pytest.approx(10.0)
    assert before.t[-1] - before.t[0] == pytest.approx(19.95, abs=1e-6)
    assert after.t[-1] - after.t[0] == pytest.approx(20.0, abs=1e-6)
    assert "cut at 30.0 s, where the estimator was reset" in log.notes
    assert "left out: 0.0 to 10.0 s (disarmed), 50.0 to 60.0 s (disarmed)" in log.notes


def test_what_the_estimator_does_not_vouch_for_is_blank(tmp_path: Path) -> None:
    writer = ulog(dive())
    path = writer.write(tmp_path / "dive.ulg")
    position = pyulog.ULog(str(path)).get_dataset("vehicle_local_position").data
    raw = bytearray(path.read_bytes())
    # the last but fourth byte of the first such message is xy_valid: 4 flags, then the counter of resets
    row = np.float32(position["vz"][0]).tobytes()
    at = raw.index(row + b"\x01\x01\x01\x01") + 4
    raw[at] = 0
    path.write_bytes(raw)
    columns = read_field_log(path).series["vehicle_local_position"].columns
    assert np.isnan(columns["x"][0])
    assert columns["x"][1] == np.float32(dive().pose[1, 0])
    assert columns["z"][0] == np.float32(dive().pose[0, 2])


def test_other_motors_than_the_vehicle_has_are_refused_by_name(tmp_path: Path) -> None:
    path = ulog(dive()).write(tmp_path / "dive.ulg")
    with pytest.raises(UndertowError, match=r"has 8 motors \(actuator_motors\.control\[0\].* f1, f2"):
        read_log(path, channels=["f1", "f2"])


def test_files_that_are_cut_off_are_read_or_refused_in_a_line(tmp_path: Path) -> None:
    cut_off(ulog(dive()).write(tmp_path / "dive.ulg"), read_log)


@pytest.mark.skipif(not _REAL.exists(), reason=f"the sample of pyulog is not at {_REAL}")
def test_the_sample_of_pyulog_is_read() -> None:
    log = read_field_log(_REAL)
    attitude = log.series["vehicle_attitude"]
    assert len(attitude.t) == 1298
    assert {c.channel for c in log.mapping.columns.values()} >= {
        "z",
        "w",
        "phi",
        "theta",
        "psi",
        "p",
        "q",
        "r",
    }
    assert len(log.parameters) == 980
    assert log.intervals[0][1] == pytest.approx(25.829736 - 20.309082, abs=1e-5)
