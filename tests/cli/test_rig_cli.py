"""`undertow fit` and `diagnose` on logs in which a rig holds all motions but one."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.cli.bad import refusal
from tests.identification.test_experiments import AXES, FILE, TRUTH, towing_log
from undertow.cli.main import main
from undertow.model.loading import load_vehicle

Capture = pytest.CaptureFixture[str]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A vehicle whose numbers are 30% off, and a log for each of its motions."""
    text = FILE
    for name, value in TRUTH.items():
        text = text.replace(f'{name} = {{ value = "{value:g} ', f'{name} = {{ value = "{0.7 * value:.6g} ')
    (tmp_path / "small.toml").write_text(text, encoding="utf-8")
    for seed, axis in enumerate(AXES):
        towing_log(tmp_path, axis, seed)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_fit_takes_logs_of_one_motion_each(folder: Path, capsys: Capture) -> None:
    logs = [f"{axis}.csv" for axis in AXES]
    words = ["fit", "small.toml", *logs, "--held", "unlogged", "--method", "weak"]
    assert main([*words, "--json", "o.json", "--out", "new.toml"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "heave free; surge, sway and yaw held at rest; driven by external forces (heave)" in out
    fitted = load_vehicle("new.toml")
    assert fitted.degrees_of_freedom == AXES
    for name, value in TRUTH.items():
        assert fitted.values[name].value == pytest.approx(value, rel=0.03), name
        assert fitted.values[name].sigma == pytest.approx(0.0, abs=0.05 * abs(value)), name
    # A file for each experiment; the vehicle file says where all values are from.
    assert {p.name for p in folder.glob("o*.json")} == {f"o-{axis}-forced.json" for axis in AXES}
    assert json.loads((folder / "o-yaw-forced.json").read_text())["runs"][0]["name"].startswith("yaw")
    assert set(fitted.fitted_to) == set(TRUTH)


@pytest.mark.slow
def test_diagnose_finds_what_one_of_the_motions_lacks(folder: Path, capsys: Capture) -> None:
    file = folder / "small.toml"
    lines = [line for line in file.read_text().splitlines() if not line.startswith("Z_wabsw")]
    file.write_text("\n".join(lines), encoding="utf-8")
    words = ["diagnose", "small.toml", "surge.csv", "heave.csv", "--held", "unlogged"]
    assert main([*words, "--json", "o.json", "--apply", "new.toml"]) == 0
    verdicts = {
        axis: json.loads((folder / f"o-{axis}-forced.json").read_text()) for axis in ("surge", "heave")
    }
    assert verdicts["surge"]["verdict"] == "adequate"
    assert verdicts["heave"]["effects"] == ["quadratic_damping"]
    better = load_vehicle("new.toml")
    assert better.values["Z_wabsw"].value == pytest.approx(TRUTH["Z_wabsw"], rel=0.03)
    assert better.values["X_udot"].value == pytest.approx(TRUTH["X_udot"], rel=0.03)


def test_what_cannot_be_is_refused_in_one_line(folder: Path, capsys: Capture) -> None:
    assert "--held heav is no motion (did you mean 'heave'?)" in refusal(
        ["fit", "small.toml", "surge.csv", "--held", "heav"], capsys, folder
    )
    (folder / "surge.toml").write_text('schema = "undertow/mapping/1"\nheld = "unlogged"\n')
    assert "a rig holds sway, heave, yaw of 'small': undertow fit and diagnose take such a log" in refusal(
        ["compare", "small.toml", "surge.csv"], capsys, folder
    )
