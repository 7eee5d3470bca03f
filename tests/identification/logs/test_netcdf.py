"""NetCDF and gliders: the dive comes back, standard names and units are taken, dbdreader is run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from undertow.errors import UndertowError
from undertow.identification.logs.formats import glider
from undertow.identification.logs.formats.by_name import first_mapping
from undertow.identification.logs.formats.fieldlog import format_of, read_field_log
from undertow.identification.logs.mapping import north_east
from undertow.identification.logs.reading import read_log, read_logs
from undertow.model.catalogue import catalogue
from undertow.model.loading import load_vehicle

from .dive import dive
from .field import FIELD
from .written import assert_the_dive, cut_off, netcdf, refusal

netcdf4 = pytest.importorskip("netCDF4")
_REAL = FIELD / "glider" / "amadeus-2014-204-05-000.dbd"
_KINDS = ["NETCDF4", "NETCDF3_CLASSIC", "NETCDF3_64BIT_DATA"]


@pytest.mark.parametrize("kind", _KINDS)
def test_the_dive_comes_back(tmp_path: Path, kind: str) -> None:
    path = netcdf(tmp_path / "dive.nc", dive(), kind)
    (run,) = read_logs([path], load_vehicle("bluerov2"))
    assert_the_dive(run, dive(), 1e-12)
    assert list(read_field_log(path).series) == ["time", "time_cmd"]


def _file(path: Path, variables: dict[str, tuple[Any, dict[str, Any]]], begin: str = "1970-01-01") -> Path:
    """A file with a dimension of time, variables and their attributes."""
    with netcdf4.Dataset(path, "w") as file:
        file.createDimension("N", len(next(iter(variables.values()))[0]))
        for name, (values, attributes) in variables.items():
            values = np.asarray(values)
            kind = "i1" if name.endswith("QC") else "f8"
            variable = file.createVariable(name, kind, ("N",), fill_value=-99 if kind == "f8" else None)
            variable.setncatts(attributes)
            variable[:] = values
    return path


def test_the_volume_that_a_glider_pumps_is_its_net_buoyancy(tmp_path: Path) -> None:
    """Not what its engine consumes and counts; a mapping of the format is completed by it."""
    t = np.arange(0.0, 600.0, 4.0)
    volume = 200.0 * np.sign(np.sin(0.02 * t))
    path = _file(tmp_path / "dive.nc", {
        "time": (t, {"units": "seconds since 2020-01-01", "standard_name": "time"}),
        "depth": (10.0 - 8.0 * np.cos(0.02 * t), {"standard_name": "depth", "units": "m"}),
        "gc_vbd_volts": (24.0 + 0.1 * np.sin(t), {}),
        "eng_vbdCC": (volume, {}),
    })  # fmt: skip
    glider = replace(load_vehicle("glider"), inputs={"B_net": "N"}, degrees_of_freedom=("heave",))
    glider = glider.with_effect(catalogue()["net_buoyancy"], {})
    found = first_mapping(read_field_log(path), glider)
    (force,) = (g for g in found.columns if g.channel == "B_net")
    assert force.column.endswith("eng_vbdCC")
    run = read_log(path, found.meaning, channels=["B_net"])
    np.testing.assert_allclose(run.channels["B_net"], 1025 * 9.816 * 1e-6 * volume, rtol=1e-5)


def test_standard_names_give_meaning_sign_and_unit(tmp_path: Path) -> None:
    t = np.arange(12.0)
    log = read_field_log(_file(tmp_path / "a.nc", {
        "clock": (t / 60, {"units": "minutes since 2020-01-01", "standard_name": "time"}),
        "a": (np.full(12, 10.0), {"standard_name": "platform_pitch_fore_down", "units": "degree"}),
        "b": (np.full(12, 250.0), {"standard_name": "depth", "units": "cm", "positive": "down"}),
        "c": (np.full(12, 90.0), {"standard_name": "platform_orientation", "units": "degrees_true"}),
    }))  # fmt: skip
    run = read_log(log.path)
    assert log.series["N"].t == pytest.approx(t)
    assert run.channels["theta"] == pytest.approx(np.radians(-10.0))
    assert run.channels["z"] == pytest.approx(2.5)
    assert run.channels["psi"] == pytest.approx(np.pi / 2)


def test_bad_interpolated_and_missing_values_are_blank(tmp_path: Path) -> None:
    log = read_field_log(_file(tmp_path / "og1.nc", {
        "TIME": (np.arange(5.0), {"units": "seconds since 1970-01-01"}),
        "PITCH": ([0.1, 0.2, 0.3, 0.4, -99.0], {"units": "rad"}),
        "PITCH_QC": ([1, 4, 8, 1, 1], {}),
    }))  # fmt: skip
    assert log.series["N"].columns["PITCH"] == pytest.approx([0.1, np.nan, np.nan, 0.4, np.nan], nan_ok=True)
    assert log.mapping.columns["N.PITCH"].channel == "theta"


def test_variables_of_slocum_gliders_are_known_by_name(tmp_path: Path) -> None:
    t = np.arange(10.0) * 4
    log = read_field_log(_file(tmp_path / "unit.nc", {
        "m_present_time": (1.4e9 + t, {"units": "timestamp"}),
        "m_depth": (t / 10, {"units": "m"}),
        "m_pitch": (np.full(10, -0.4), {"units": "rad"}),
        "m_heading": (np.full(10, 0.5), {}),
        "sci_water_temp": (np.full(10, 12.0), {"units": "degC"}),
    }))  # fmt: skip
    known = {name: column.channel for name, column in log.mapping.columns.items()}
    assert known == {"N.m_depth": "z", "N.m_pitch": "theta", "N.m_heading": "psi"}
    assert log.series["N"].t == pytest.approx(t)


def test_latitudes_and_longitudes_become_metres(tmp_path: Path) -> None:
    lat, lon = np.array([43.0, 43.01, np.nan, 43.0]), np.array([9.0, 9.0, np.nan, 9.01])
    north, east = north_east(lat, lon)
    # WGS 84 at 43 degrees: a minute of latitude is 1851.77 m, one of longitude 1360.2 m
    assert north[[0, 1, 3]] == pytest.approx([0.0, 0.6 * 1851.77, 0.0], abs=0.2)
    assert east[[0, 1, 3]] == pytest.approx([0.0, 0.0, 0.6 * 1359.8], abs=0.5)
    assert np.isnan(north[2])
    log = read_field_log(_file(tmp_path / "gps.nc", {
        "time": (np.arange(4.0), {"units": "s"}),
        "a": (np.where(np.isnan(lat), -99, lat), {"standard_name": "latitude", "units": "degrees_north"}),
        "b": (np.where(np.isnan(lon), -99, lon), {"standard_name": "longitude", "units": "degrees_east"}),
    }))  # fmt: skip
    assert log.series["N"].columns["north"] == pytest.approx(north, nan_ok=True)
    assert {c.channel for c in log.mapping.columns.values()} == {"x", "y"}


def test_a_unit_that_cannot_be_is_not_taken(tmp_path: Path) -> None:
    log = read_field_log(_file(tmp_path / "odd.nc", {
        "time": (np.arange(4.0), {"units": "s"}),
        "depth": (np.arange(4.0), {"standard_name": "depth", "units": "dbar"}),
        "speed_u": (np.arange(4.0), {"units": "cm s-1"}),
    }))  # fmt: skip
    assert "z" not in {column.channel for column in log.mapping.columns.values()}


def test_a_file_without_time_is_refused(tmp_path: Path) -> None:
    path = _file(tmp_path / "map.nc", {"depth": (np.arange(4.0), {})})
    with pytest.raises(UndertowError, match="no time variable along a dimension"):
        read_log(path)
    assert format_of(path) is not None


@pytest.mark.parametrize("kind", _KINDS[:2])
def test_files_that_are_cut_off_are_read_or_refused_in_a_line(tmp_path: Path, kind: str) -> None:
    cut_off(netcdf(tmp_path / "dive.nc", dive(), kind), read_log)


def test_a_glider_without_dbdreader_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "unit.dbd"
    path.write_bytes(b"dbd_label:    DBD_ASC(dinkum_binary_data_ascii)file\n")
    monkeypatch.setattr(glider, "find_spec", lambda name: None)
    with pytest.raises(UndertowError, match=r"unit\.dbd of a glider .* pip install dbdreader"):
        read_log(path)


@pytest.mark.parametrize("name", ["unit.dcd", "unit.ECD"])
def test_compressed_files_of_gliders_are_given_to_dbdreader(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    path = tmp_path / name
    path.write_bytes(b"\x30\xbf\xf1\x27dbd_label:")  # a block of LZ4
    monkeypatch.setattr(glider, "find_spec", lambda name: True)
    found = np.arange(4.0), {"m_depth": np.arange(4.0)}, {"m_depth": "m"}
    monkeypatch.setattr(glider, "_sensors", lambda path, messages: found)
    assert read_log(path).channels["z"] == pytest.approx(np.arange(4.0))


def test_the_depth_of_a_science_file_is_that_of_its_pressure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "unit.ebd"
    path.write_bytes(b"dbd_label:    DBD(dinkum_binary_data)file\n")
    bar = np.array([0.0, 2.0, np.nan, 5.0])
    found = np.arange(4.0), {"sci_water_pressure": bar}, {"sci_water_pressure": "bar"}
    monkeypatch.setattr(glider, "find_spec", lambda name: True)
    monkeypatch.setattr(glider, "_sensors", lambda path, messages: found)
    run = read_log(path)
    assert run.channels["z"] == pytest.approx(bar * 1e5 / (1025.0 * 9.81), nan_ok=True)
    assert any("sci_water_pressure in bar, with 1025 kg/m^3" in note for note in run.reader_notes)
    found[1]["m_depth"] = np.ones(4)
    assert read_log(path).channels["z"] == pytest.approx(1.0)


def test_dbdreader_is_never_imported() -> None:
    import subprocess
    import sys

    code = "import sys; from undertow.identification.logs.formats.fieldlog import formats; formats()\n"
    code += "print([n for n in ('dbdreader', 'pyulog', 'rosbags', 'matio', 'netCDF4') if n in sys.modules])"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout.strip() == "[]"


@pytest.mark.skipif(not _REAL.exists(), reason=f"the sample of dbdreader is not at {_REAL}")
def test_the_sample_of_dbdreader_is_read(tmp_path: Path) -> None:
    pytest.importorskip("dbdreader")
    log = read_field_log(_REAL)
    assert len(log.series["dbd"].t) == 897
    assert {"z", "theta", "psi", "x", "y"} <= {c.channel for c in log.mapping.columns.values()}
    alone = tmp_path / "alone.dbd"
    whole = _REAL.read_bytes()
    alone.write_bytes(whole)
    with pytest.raises(UndertowError, match=r"alone\.dbd .*\.cac.* --messages FOLDER"):
        read_log(alone)
    deep = [read_log(_REAL.with_suffix(end)).channels["z"] for end in (".dbd", ".ebd")]
    assert np.nanmax(deep[1]) == pytest.approx(np.nanmax(deep[0]), rel=0.03)  # CTD and glider's own sensor
    plain, packed = (read_field_log(_REAL.with_name(f"01600001.{end}")) for end in ("dbd", "dcd"))
    assert packed.series["dcd"].columns.keys() == plain.series["dbd"].columns.keys()
    assert np.array_equal(packed.series["dcd"].t, plain.series["dbd"].t)
    cut = read_field_log(alone, _REAL.parent / "cac")
    assert np.array_equal(cut.series["dbd"].t, log.series["dbd"].t)
    for share in (0.001, 0.3, 0.9):
        alone.write_bytes(whole[: round(share * len(whole))])
        assert "\n" not in refusal(lambda: read_field_log(alone, _REAL.parent / "cac"))


def test_groups_of_plain_hdf5_are_series_by_their_names(tmp_path: Path) -> None:
    """As scripts write them: no names of dimensions, a time in each group, three columns of a position."""
    h5py = pytest.importorskip("h5py")
    t, path = 0.1 * np.arange(300), tmp_path / "run.h5"
    place = np.column_stack([t, np.sin(t), np.cos(t)])
    with h5py.File(path, "w") as file:
        file.update({"pose/time": t, "pose/position": place, "pose/yaw": np.sin(t / 5)})
        file.update({"motors/timestamp": t[::3] + 0.01, "motors/left": t[::3], "motors/right": -t[::3]})
    log = read_field_log(path)
    assert {n: [*one.columns] for n, one in log.series.items()} == {
        "motors": ["left", "right"],
        "pose": ["position_x", "position_y", "position_z", "yaw"],
    }
    np.testing.assert_array_equal(log.series["pose"].columns["position_y"], place[:, 1])
    guessed = first_mapping(log)
    assert {"x", "y", "z", "psi", "motors.left", "motors.right"} == {g.channel for g in guessed.columns}
    assert any("does it grow with depth?" in question for question in guessed.asked)
