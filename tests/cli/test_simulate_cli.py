"""undertow simulate and undertow export c --controller: what is written, and what is refused."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import matplotlib.image as mpimg
import numpy as np
import pytest

from tests.control.loops import run as simulated
from undertow.cli.control.simulate import show
from undertow.cli.main import main
from undertow.identification.logs.reading import read_log
from undertow.model.loading import bundled_vehicles

Capture = pytest.CaptureFixture[str]
RUN = ["simulate", "mini-auv", "paper-pd", "--to", "-1,1,1"]
SHORT = [*RUN, "--for", "2", "--dt", "0.01"]


def test_the_tables_tell_what_the_json_holds(here: Path, capsys: Capture) -> None:
    words = [*RUN, "--without", "rigid_body_coriolis", "--without", "added_mass_coriolis", "--json", "r.json"]
    assert main(words) == 0
    said = capsys.readouterr().out
    (result,) = json.loads((here / "r.json").read_text())
    by_name = {c["name"]: c for c in result["coordinates"]}
    assert result["gate_passed"] == pytest.approx(22.877)
    assert by_name["psi"]["settling"] == pytest.approx(18.376, abs=1e-3)
    assert re.search(r"psi +2\.356 rad +18\.38 +0\.00%", said)
    assert "heading within the gate after 22.877 s" in said
    assert [c["name"] for c in result["commands"]] == ["f1", "f2", "f3", "f4"]
    assert result["commands"][0]["rms"] == pytest.approx(7.15, abs=0.02)  # half the weight in water each


def test_whole_turns_are_reported(here: Path, capsys: Capture) -> None:
    words = ["simulate", "mini-auv", "paper-pd", "--to", "0,0,0,3.1", "--for", "120", "--dt", "0.01"]
    assert main([*words, "--moving", "r=30", "--json", "r.json"]) == 0
    turns = {c["name"]: c["turns"] for c in json.loads((here / "r.json").read_text())[0]["coordinates"]}
    assert turns.pop("psi") >= 2
    assert not any(turns.values())
    assert re.search(r"psi: errors are from the set-point \d whole turns on", capsys.readouterr().out)


def test_what_has_grown_beyond_measure_is_reported_in_a_few_digits(capsys: Capture) -> None:
    result = simulated("paper-pd", duration=1.0, dt=0.01).result
    grown = tuple(replace(c, overshoot=1.5e75) for c in result.coordinates)
    show([replace(result, coordinates=grown)])
    said = capsys.readouterr().out
    assert "1.5e+75%" in said
    assert not re.search(r"\d{20}", said)


LATE = """
[effects.actuation_delay]
delay = "1 s"
"""
STIFF = """
schema = "undertow/gains/1"
name = "stiff"
law = "pd"
unactuated = ["sway"]
[gains]
K_P = 30
K_V = 1
"""


@pytest.mark.slow
def test_a_run_that_diverges_ends_with_one_and_says_why(here: Path, capsys: Capture) -> None:
    """Also where the run stops while all numbers are finite."""
    (here / "late.toml").write_text(bundled_vehicles()["mini-auv"].read_text() + LATE)
    (here / "stiff.toml").write_text(STIFF)
    words = ["simulate", "mini-auv", "stiff.toml", "--plant", "late.toml", "--to", "0,0,1,0", "--dt", "0.05"]
    asked = ["--json", "r.json", "--out", "log.csv", "--figures", "pictures"]
    assert main([*words, "--for", "3000", *asked]) == 1
    said = capsys.readouterr().out
    (result,) = json.loads((here / "r.json").read_text())
    why = result["divergence"]
    assert f"DIVERGED: diverged at t = {why['time']:.6g} s: w = {why['value']:.4g} m/s" in said
    assert "above the limit of 100" in said
    assert result["diverged"] == why["time"]
    assert (why["name"], why["limit"]) == ("w", 100.0)
    rows = np.loadtxt(here / "log.csv", delimiter=",", skiprows=1)
    assert rows[-1, 0] < why["time"]
    assert np.isfinite(rows).all()
    assert (here / "pictures" / "z.png").is_file()
    assert main([*words, "--for", f"{why['time'] + 0.5:.1f}"]) == 1
    assert main([*words, "--for", f"{why['time'] / 2:.1f}"]) == 0  # swings ever more, but is a motion still


def test_the_log_is_one_that_undertow_reads(here: Path) -> None:
    assert (
        main([*SHORT, "--noise", "x=0.01", "--noise", "psi=1deg", "--log", "0.05", "--out", "log.csv"]) == 0
    )
    run = read_log(here / "log.csv", channels=("f1", "f2", "f3", "f4"))
    assert set(run.channels) >= {"x", "y", "z", "psi", "u", "v", "w", "r"}
    assert len(run.t) == 41
    assert np.ptp(np.diff(run.t)) < 1e-12
    assert 0.005 < run.channels["x"].std() < 0.02
    assert main(["compare", "mini-auv", "log.csv", "--horizon", "0.5"]) == 0


def test_a_log_of_an_exact_run_is_explained_by_its_own_model(here: Path) -> None:
    """Every sample in the log: simulating the model with its commands gives the same motion."""
    assert main([*SHORT, "--for", "6", "--out", "log.csv", "--log", "0.01"]) == 0
    assert main(["compare", "mini-auv", "log.csv", "--horizon", "1", "--json", "c.json"]) == 0
    for channel in json.loads((here / "c.json").read_text())["channels"]:
        assert channel["ahead_rms"] < 1e-9


@pytest.mark.slow
def test_pictures_of_three_controllers(here: Path, capsys: Capture) -> None:
    words = ["simulate", "mini-auv", "paper-pd", "paper-pid", "paper-smc", "--to", "-1,1,1", "--dt", "0.01"]
    assert main([*words, "--gate", "170deg", "--for", "30", "--figures", "pictures"]) == 0
    names = {p.name for p in (here / "pictures").iterdir()}
    assert names == {f"{n}.png" for n in ("x", "y", "z", "psi", "track", "commands", "strategy")}
    for name in names:
        image = mpimg.imread(here / "pictures" / name)[..., :3]
        assert image.shape[1] > 1000
        assert 0.005 < (image.min(axis=2) < 0.6).mean() < 0.7  # something is drawn, on white
    assert "7 pictures in pictures" in capsys.readouterr().out


def test_choices_are_those_of_the_line(here: Path) -> None:
    words = [*SHORT, "--heading", "atan", "--order", "together", "--sway", "actuated", "--json", "r.json"]
    assert main([*words, "--from", "0.5,0,0,10deg", "--current", "0.1,0", "--push", "X=1:0:1"]) == 0
    (result,) = json.loads((here / "r.json").read_text())
    assert result["to"]["psi"] == pytest.approx(np.arctan(1 / -1.5))
    assert result["start"]["psi"] == pytest.approx(np.deg2rad(10))
    assert result["gate_passed"] is None
    assert result["commands"][-1]["name"] == "tau_Y"
    assert result["commands"][-1]["peak"] > 0.1


def test_another_plant_moves(here: Path) -> None:
    text = bundled_vehicles()["mini-auv"].read_text()
    (here / "heavy.toml").write_text(text.replace('"-14.309872 N"', '"-15.309872 N"'))
    words = ["simulate", "mini-auv", "paper-pd", "--to", "0,0,1,0", "--for", "150", "--dt", "0.01"]
    assert main([*words, "--plant", "heavy.toml", "--json", "r.json"]) == 0
    (result,) = json.loads((here / "r.json").read_text())
    assert result["coordinates"][2]["final_error"] == pytest.approx(-1.0, abs=1e-3)


def test_thrusters_of_the_same_name_that_push_elsewhere_are_reported(here: Path, capsys: Capture) -> None:
    assert main([*SHORT, "--plant", "bluerov2"]) == 0
    assert (
        re.search(r"more than 45 deg from that in the controller's model: f", capsys.readouterr().out)
        is not None
    )
    assert main([*SHORT, "--plant", "mini-auv"]) == 0
    assert "45 deg" not in capsys.readouterr().out


@pytest.mark.slow
def test_without_a_compiler_it_runs_too(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert main([*SHORT, "--json", "a.json"]) == 0
    monkeypatch.setenv("UNDERTOW_NO_COMPILER", "1")
    assert main([*SHORT, "--json", "b.json"]) == 0
    a, b = (json.loads((here / f"{n}.json").read_text())[0]["coordinates"] for n in "ab")
    for one, other in zip(a, b, strict=True):
        assert one["final_error"] == pytest.approx(other["final_error"], abs=1e-12)


def test_the_controller_is_written_in_c_and_checked(here: Path, capsys: Capture) -> None:
    words = ["export", "c", "mini-auv", "--controller", "paper-pid"]
    assert main([*words, "--check"]) == 1
    assert main(words) == 0
    made = here / "build" / "mini-auv" / "src"
    assert (made / "mini_auv_vehicle.c").is_file()
    assert main([*words, "--check"]) == 0
    header = made / "mini_auv_paper_pid.h"
    header.write_text("")
    capsys.readouterr()
    assert main([*words, "--check"]) == 1
    said = capsys.readouterr().out
    assert "mini_auv_paper_pid.h is not as it was generated" in said
    assert "run undertow export c mini-auv --controller paper-pid" in said
