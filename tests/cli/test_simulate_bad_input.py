"""undertow simulate and undertow export c --controller: what they refuse, in one line."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.bad import refusal
from undertow.model.loading import bundled_vehicles

Capture = pytest.CaptureFixture[str]
TO = ["--to", "-1,1,1", "--for", "2", "--dt", "0.01"]
GAINS = """\
schema = "undertow/gains/1"
name = "mine"
law = "pd"
unactuated = ["sway"]
[gains]
K_P = 1.0
K_V = 2.0
"""


# --- bad input -----------------------------------------------------------------------------------
BAD = {
    "dt too long": (["--dt", "2"], ["dt = 2 s", "limit is 0.275 s"]),
    "dt zero": (["--dt", "0"], ["dt = 0 s", "above zero"]),
    "dt negative": (["--dt", "-0.1"], ["dt = -0.1 s"]),
    "dt no number": (["--dt", "nan"], ["dt = nan s"]),
    "dt longer than the run": (["--dt", "0.5", "--for", "0.1"], ["dt = 0.5 s", "0.1 s"]),
    "no length": (["--for", "0"], ["length of the run = 0 s"]),
    "endless": (["--for", "inf"], ["length of the run = inf s"]),
    "too many samples": (["--for", "1e6", "--dt", "0.001"], ["1e+09 samples", "5e+07"]),
    "too few values": (["--to", "1,2"], ["set-point has 2 values", "x,y,z,psi"]),
    "too many values": (["--to", "1,2,3,4,5"], ["set-point has 5 values"]),
    "empty value": (["--to", "1,,2"], ["--to 1,,2", "empty"]),
    "no quantity": (["--to", "a,b,c"], ["set-point x", "'a'"]),
    "wrong unit": (["--to", "1,1,1,2m"], ["set-point psi", "rad"]),
    "infinite": (["--to", "inf,1,1"], ["set-point x", "inf"]),
    "start too short": (["--from", "1"], ["start has 1 values"]),
    "unknown effect": (["--without", "adedd_mass"], ["'adedd_mass'", "'added_mass'"]),
    "effect that is needed": (["--without", "linear_damping", "--without", "x" * 9], ["'xxxxxxxxx'"]),
    "gate of no size": (["--gate", "0deg"], ["gate", "above zero"]),
    "gate that is none": (["--gate", "5m"], ["--gate", "rad"]),
    "current in one direction": (["--current", "0.1"], ["--current 0.1", "two"]),
    "noise of nothing": (["--noise", "x"], ["--noise x", "x=0.01"]),
    "noise of what is not reported": (["--noise", "phi=0.1"], ["'phi'", "x, y, z, psi"]),
    "negative noise": (["--noise", "x=-1"], ["noise of x = -1"]),
    "noise without samples": (["--noise", "x=1", "--continuous"], ["noise", "sampled law"]),
    "push of no axis": (["--push", "Q=1"], ["--push Q=1", "AXIS=VALUE"]),
    "push in a locked direction": (["--push", "K=1"], ["force K", "surge, sway, heave, yaw"]),
    "push backwards in time": (["--push", "X=1:5:2"], ["push X = 1 from 5 to 2 s", "ends before it begins"]),
    "push in a wrong unit": (["--push", "X=1kg"], ["--push X=1kg", "N"]),
    "velocity that is none": (["--moving", "p=1"], ["velocity 'p'", "u, v, w, r"]),
    "sway that is actuated": (["--sway", "unactuated", "--plant", "usv"], ["'usv'"]),
    "log faster than dt": (["--log", "0.001"], ["interval of the log = 0.001 s"]),
    "negative seed": (["--seed", "-1"], ["seed -1"]),
    "plant that is another": (["--plant", "cybership2"], ["lacks degree of freedom 'heave'"]),
    "log in no folder": (["--out", "no/log.csv"], ["no/log.csv"]),
    "json over the gains": (["--json", "mine.toml"], ["mine.toml", "input"]),
}


@pytest.mark.parametrize("fault", BAD)
def test_what_cannot_be_simulated_is_refused(fault: str, here: Path, capsys: Capture) -> None:
    (here / "mine.toml").write_text(GAINS)
    options, words = BAD[fault]
    line = refusal(["simulate", "mini-auv", "mine.toml", *TO, *options], capsys, here)
    assert all(word in line for word in words), line


def test_a_vehicle_without_thrusters_is_refused(here: Path, capsys: Capture) -> None:
    (here / "mine.toml").write_text(GAINS)
    text = bundled_vehicles()["mini-auv"].read_text()
    (here / "bare.toml").write_text(text[: text.index("[[thrusters]]")])
    line = refusal(["simulate", "bare.toml", "mine.toml", "--to", "1,1,1"], capsys, here)
    assert "needs a force in surge, heave, yaw" in line
    line = refusal(["export", "c", "bare.toml", "--controller", "mine.toml"], capsys, here)
    assert "no thruster" in line


def test_thrusters_that_cannot_push_independently_are_refused(here: Path, capsys: Capture) -> None:
    """One pair of thrusters gives surge and yaw; a third below the origin pushes surge, and so pitches."""
    text = bundled_vehicles()["mini-auv"].read_text()
    text = text.replace('["0 m", "-0.16 m", "0 m"]\ndirection = [1', '["0 m", "0 m", "0 m"]\ndirection = [1')
    (here / "one.toml").write_text(
        text.replace('["0 m", "0.16 m", "0 m"]\ndirection = [1', '["0 m", "0 m", "0.1 m"]\ndirection = [1')
    )
    (here / "mine.toml").write_text(GAINS)
    line = refusal(["simulate", "one.toml", "mine.toml", "--to", "1,1,1"], capsys, here)
    assert "yaw" in line


def test_two_runs_have_no_place_in_one_log(here: Path, capsys: Capture) -> None:
    words = ["simulate", "mini-auv", "paper-pd", "paper-pid", "--to", "1,1,1", "--out", "log.csv"]
    assert "2 gain files" in refusal(words, capsys, here)


def test_gains_that_are_not_there_are_refused(here: Path, capsys: Capture) -> None:
    assert "'paper-pd'" in refusal(["simulate", "mini-auv", "papr-pd", "--to", "1,1,1"], capsys, here)
    assert "'paper-pd'" in refusal(["export", "c", "mini-auv", "--controller", "papr-pd"], capsys, here)
    assert not (here / "build").exists()
