"""Commands on a log of ArduSub: what it holds, a table of it, a vehicle file from it, what is left out."""

from __future__ import annotations

from pathlib import Path

import polars as pl
import pytest

from tests.cli.bad import refusal
from tests.identification.logs.ardusub import vehicle_for, write_bin
from tests.identification.logs.dive import dive
from tests.identification.logs.written import ulog
from undertow.cli.main import main
from undertow.identification.logs.mapping import read_mapping
from undertow.model.loading import load_vehicle

pytest.importorskip("pymavlink")
Capture = pytest.CaptureFixture[str]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder, the current one, with dive.bin and rov.toml."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "300")
    write_bin(tmp_path / "dive.bin")
    vehicle_for(tmp_path)
    return tmp_path


def test_what_a_log_holds_is_listed(folder: Path, capsys: Capture) -> None:
    assert main(["import", "dive.bin", "--list"]) == 0
    out = capsys.readouterr().out
    rows = {words[0]: words[1:6] for line in out.splitlines() if (words := line.split())}
    assert rows["XKF1"] == ["1601", "20", "0.00", "80.00", "0.05"]
    assert rows["RFND"] == ["401", "5", "0.00", "80.00", "0.2"]
    assert "left out: 0.0 to 10.0 s (disarmed)" in out


@pytest.mark.parametrize(
    ("size", "words"), [(None, "does not exist or is not a file"), (0, "is empty (0 bytes)")]
)
def test_what_is_no_log_is_refused_by_every_command_in_the_same_words(
    size: int | None, words: str, capsys: Capture, tmp_path: Path
) -> None:
    log = tmp_path / "dive.bin"
    if size is not None:
        log.write_bytes(bytes(size))
    for command in (["import", str(log), "--list"], ["doctor", "bluerov2", str(log)]):
        assert f"log {log} {words}" in refusal(command, capsys)


def test_elements_of_an_array_are_listed_as_one(
    capsys: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pyulog")
    monkeypatch.setenv("COLUMNS", "300")
    ulog(dive()).write(tmp_path / "dive.ulg")
    assert main(["import", str(tmp_path / "dive.ulg"), "--list"]) == 0
    assert "control[0-11]" in capsys.readouterr().out


@pytest.mark.slow
def test_the_doctor_says_of_the_table_what_it_says_of_the_log(folder: Path, capsys: Capture) -> None:
    assert main(["import", "dive.bin", "--vehicle", "rov.toml", "--out", "dive.parquet"]) == 0
    assert read_mapping("dive.toml").columns["RCOU.C1"].channel == "f2"
    assert pl.read_parquet("dive.parquet")["stretch"].max() == 1.0
    capsys.readouterr()
    assert main(["doctor", "rov.toml", "dive.bin", "--plot", "used.png"]) == 0
    direct = capsys.readouterr().out
    assert main(["doctor", "rov.toml", "dive.parquet", "--map", "dive.toml"]) == 0
    imported = capsys.readouterr().out
    assert "dive.bin: left out: 0.0 to 10.0 s (disarmed), 10.0 to 15.0 s (motors at rest" in direct
    assert "no mistake found" in direct
    assert _table_in(imported) == _table_in(direct)
    assert Path("used.png").read_bytes()[:4] == b"\x89PNG"


def test_nothing_is_guessed_where_a_mapping_is_given(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    (folder / "log.toml").write_text(
        'schema = "undertow/mapping/1"\n[columns]\n"XKF1.PD" = { channel = "z", unit = "m" }\n'
    )

    def guess(*_: object) -> None:
        raise AssertionError("guessed")

    monkeypatch.setattr("undertow.identification.logs.formats.by_name.first_mapping", guess)
    assert main(["import", "dive.bin", "--map", "log.toml", "--out", "dive.csv"]) == 0
    assert pl.read_csv(folder / "dive.csv").columns == ["t", "stretch", "XKF1.PD"]


def test_motors_of_another_number_are_asked_about_and_nothing_else_is_taken_for_a_command(
    folder: Path, capsys: Capture
) -> None:
    assert main(["map", "new", "dive.bin", "--vehicle", "mini-auv", "--out", "log.toml"]) == 0
    assert "the log has 8 motors, the vehicle has 4 commands without a column" in capsys.readouterr().out
    meaning = read_mapping("log.toml")
    assert not {"f1", "f2", "f3", "f4"} & {column.channel for column in meaning.columns.values()}
    assert [name.split(".")[0] for name in meaning.ignore] == ["RCOU"] * 8


def _table_in(out: str) -> list[str]:
    return [line for line in out.splitlines() if line.strip().startswith(("surge", "sway", "heave", "yaw"))]


def test_a_vehicle_file_comes_out_of_a_log(folder: Path, capsys: Capture) -> None:
    assert main(["vehicle", "new", "--log", "dive.bin", "--out", "mine.toml"]) == 0
    assert "undertow doctor mine.toml dive.bin" in capsys.readouterr().out
    made = load_vehicle("mine.toml")
    assert (made.name, len(made.thrusters)) == ("mine", 8)


def test_a_log_and_a_shape_are_one_too_many(folder: Path, capsys: Capture) -> None:
    words = ["vehicle", "new", "--log", "dive.bin", "--mass", "12"]
    assert "--log takes mass and shape from a bundled vehicle" in refusal(words, capsys, folder)
    assert "give --mass in kg" in refusal(["vehicle", "new", "--mesh", "hull.stl"], capsys)
