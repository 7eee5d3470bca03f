"""Vehicles' own logs, and tables of several stretches, that are longer than is used: stretches are chosen."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from tests.identification.logs.ardusub import DIVES, vehicle_for, write_bin
from tests.quick import first_quick
from undertow.cli.main import main
from undertow.errors import UndertowError
from undertow.identification.logs.chunks import LongLog, long_logs
from undertow.identification.logs.formats import fieldlog
from undertow.identification.logs.formats.fieldlog import read_field_log
from undertow.identification.logs.mapping import LogMapping, mapping_text
from undertow.identification.logs.opening import columns_read
from undertow.identification.logs.reading import read_logs
from undertow.identification.long_logs import choosing
from undertow.identification.long_logs.choosing import Budget, choose, read_in_parts, too_long
from undertow.model.vehicle import Vehicle

RESET = 30.0  # s after the dive began
SMALL = Budget(400, 200)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with rov.toml, dive.bin with a reset of the estimator in it, and the same as Parquet."""
    folder = tmp_path_factory.mktemp("long")
    _, vehicle = vehicle_for(folder)

    def reset(now: float, cells: list[float]) -> list[float]:
        cells[7] = 3.0 if now >= DIVES + RESET - 1e-9 else 0.0  # OFN, how far it was moved
        return cells

    log = read_field_log(write_bin(folder / "dive.bin", {"XKF4": reset}))
    meaning = log.mapping_for(vehicle.command_names)
    log.table(columns_read(meaning)).write_parquet(folder / "dive.parquet")
    (folder / "dive.toml").write_text(mapping_text(meaning), encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def vehicle(place: Path) -> Vehicle:
    return vehicle_for(place)[1]


def _logs(place: Path, vehicle: Vehicle, name: str) -> list[LongLog]:
    mapping = None
    if name != "dive.bin":
        mapping = read_field_log(place / "dive.bin").mapping_for(vehicle.command_names)
    return long_logs(place / name, mapping, vehicle.command_names, required=True)


@pytest.mark.parametrize("name", ["dive.bin", "dive.parquet"])
def test_read_in_parts_it_is_what_it_is_as_a_whole(place: Path, vehicle: Vehicle, name: str) -> None:
    parts = [read_in_parts(log) for log in _logs(place, vehicle, name)]
    whole = read_logs([place / "dive.bin"], vehicle)
    assert [run.name for run in parts] == ["dive-1", "dive-2"] == [run.name for run in whole]
    for part, run in zip(parts, whole, strict=True):
        assert (part.origin, part.t[0], part.t[-1]) == (run.origin, run.t[0], run.t[-1])
        for channel, values in run.channels.items():
            turns = 2 * np.pi * np.round((part.channels[channel] - values)[0] / (2 * np.pi))
            np.testing.assert_allclose(part.channels[channel] - turns, values, atol=1e-12, err_msg=channel)
    assert (parts[0].reader_notes == whole[0].reader_notes) == (name == "dive.bin")


@pytest.mark.parametrize("name", first_quick(["dive.bin", "dive.parquet"]))
def test_chosen_stretches_lie_on_one_side_of_a_reset(place: Path, vehicle: Vehicle, name: str) -> None:
    logs = _logs(place, vehicle, name)
    assert too_long(logs, 1000)
    assert not too_long(logs, 5000)
    chosen = choose(vehicle, logs, budget=SMALL)
    assert 0 < sum(len(run.t) for run in chosen.runs) <= SMALL.work
    assert chosen.validation  # of a single file parts are kept, though it has two stretches
    for run in (*chosen.runs, *chosen.validation):
        assert run.origin == "dive"
        assert (run.t[-1] < DIVES + RESET) != (run.t[0] >= DIVES + RESET)
    used = np.concatenate([run.t for run in chosen.runs])
    judged = np.concatenate([run.t for run in chosen.validation])
    assert not set(used.round(3)) & set(judged.round(3))


def test_numbers_that_come_back_in_a_table_are_one_stretch(place: Path, tmp_path: Path) -> None:
    t = np.arange(60) / 10
    table = {"t": t, "leg": np.where((t < 2) | (t >= 4), 1.0, 2.0), "u": t, "tau_X": np.ones(60)}
    for name in ("log.parquet", "log.csv"):
        path = tmp_path / name
        rows = pl.DataFrame(table)
        rows.write_parquet(path) if path.suffix == ".parquet" else rows.write_csv(path)
        mapping = LogMapping.model_validate({"time": {"stretch": "leg"}})
        first, second = (read_in_parts(log) for log in long_logs(path, mapping, ("tau_X",)))
        assert list(first.t) == [*t[:20], *t[40:]]
        assert list(second.channels["u"]) == list(t[20:40])


@pytest.mark.slow
def test_a_log_too_long_for_a_fit_is_fitted_in_stretches(
    place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(place)
    monkeypatch.setenv("COLUMNS", "300")
    monkeypatch.setattr(choosing, "FIT", replace(choosing.FIT, whole=500))
    assert main(["fit", "rov.toml", "dive.bin", "--method", "weak"]) == 0
    out = capsys.readouterr().out
    assert "dive.bin: read as ArduPilot DataFlash" in out
    assert "segments of" in out


def test_what_is_too_large_is_refused_with_the_remedy(
    place: Path, vehicle: Vehicle, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = read_field_log(place / "dive.bin")
    columns = columns_read(log.mapping_for(vehicle.command_names))
    monkeypatch.setattr(fieldlog, "SETTINGS", replace(fieldlog.SETTINGS, cells=30_000, margin=1.0))
    with pytest.raises(
        UndertowError, match=r"table of 1601 rows of 24 columns, at most 1250 .*--from and --to"
    ):
        log.table(columns)
    part = log.table(columns, (40.0, 42.0))
    ends = [part["t"].min(), part["t"].max()]
    assert ends == pytest.approx([39.0, 43.0], abs=0.06)
    with pytest.raises(UndertowError, match=r"no sample in the time window"):
        log.table(columns, (500.0, 600.0))


def test_a_file_too_large_for_memory_is_refused_unread(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "huge.bin"
    path.write_bytes((place / "dive.bin").read_bytes())
    with path.open("r+b") as file:
        file.truncate(10**12)  # holds no block of the disk beyond the first
    monkeypatch.setattr(np, "fromfile", None)
    monkeypatch.setattr(np, "memmap", None)
    with pytest.raises(UndertowError, match=r"huge.bin has 1000000 MB, at most 400 MB of .* mavlogdump"):
        read_field_log(path)
