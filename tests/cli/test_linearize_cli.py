"""`undertow linearize` and `design`: what they print and write, and what they refuse in one line."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from tests.cli.bad import refusal
from tests.quick import first_quick
from undertow.cli.main import main

Capture = pytest.CaptureFixture[str]


def _content(words: list[str], capsys: Capture) -> dict:
    capsys.readouterr()
    assert main([*words, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


# --- linearize ------------------------------------------------------------------------------------
def test_poles_margins_and_what_can_be_moved_are_printed(folder: Path, capsys: Capture) -> None:
    assert main(["linearize", "mini-auv", "--gains", "paper-pid"]) == 0
    out = capsys.readouterr().out
    assert re.search(r"0\.003198 ± 0\.038054i +0\.038188 +-0\.083752 +-312\.66 +x, u, integral_x: grows", out)
    assert "the closed loop is unstable in x, u, integral_x" in out
    assert re.search(r"force_surge +no +17\.19 +-10\.40 +0 ", out)
    assert "commands move 6 of 8 state directions\n  no command moves y, v" in out
    assert "parameters for u=1, w=1 are taken" in out


def test_json_holds_the_numbers(folder: Path, capsys: Capture) -> None:
    words = ["linearize", "mini-auv", "--gains", "paper-pd", "--direction", "u=-1", "--sensors", "x,y,z,psi"]
    content = _content(words, capsys)
    (surge,) = [m for m in content["modes"] if m["pole"][1]]
    assert surge["damping"] == pytest.approx(0.761194, abs=5e-7)
    assert content["stable"] is True
    assert content["observability"]["rank"] == 8
    assert content["trim"]["direction"]["u"] == -1
    assert content["margins"]["force_surge"]["gain"] is None  # any: JSON has no infinity
    assert _content(["linearize", "mini-auv", "--at", "u=0.5"], capsys)["stable"] is False


def test_units_are_understood(folder: Path, capsys: Capture) -> None:
    plain = _content(["linearize", "bluerov2", "--at", "u=0.5,theta=0.1"], capsys)
    said = _content(
        ["linearize", "bluerov2", "--at", "u=50 cm/s", "--at", f"theta={float(np.degrees(0.1))!r} deg"],
        capsys,
    )
    assert said["trim"]["states"] == pytest.approx(plain["trim"]["states"])


@pytest.mark.parametrize(
    "words",
    first_quick(
        [
            ["bode", "--gains", "paper-pid", "--family", "3"],
            ["nyquist", "--gains", "paper-pd", "--family", "3"],
            ["root-locus", "--gains", "paper-pid"],
            ["nichols", "--gains", "paper-pd"],
            ["disk-margins", "--gains", "paper-pd"],
            ["singular-values"],
            ["bode"],
            ["step", "--family", "3"],
            ["poles", "--gains", "paper-pid", "--family", "3"],
        ],
    ),
)
def test_pictures_are_written(folder: Path, words: list[str]) -> None:
    assert main(["linearize", "mini-auv", "--out", "a.png", "--plot", *words]) == 0
    assert Path("a.png").read_bytes().startswith(b"\x89PNG")


def test_a_channel_is_chosen(folder: Path, capsys: Capture) -> None:
    words = ["linearize", "mini-auv", "--at", "u=0.5", "--input", "f2", "--output", "r"]
    assert list(_content(words, capsys)["zeros"]) == ["f2 to r"]
    words = ["linearize", "mini-auv", "--at", "u=0.5", "--input", "yaw"]
    assert list(_content(words, capsys)["zeros"]) == ["force_yaw to r"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--at", "u"], "--at u: write NAME=VALUE"),
        (["--at", "u=fast"], "--at u: "),
        (["--at", "u=0.5 kg"], "--at u: "),
        (["--at", "u=nan"], "'nan' is not a finite quantity"),
        (["--at", "u=1,u=2"], "--at names u twice"),
        (["--at", "u=0.5,v=0,r=0.1"], "no steady motion of 'mini-auv' has these values: v keeps"),
        (["--free", "psi"], "'psi' cannot be left free"),
        (["--current", "0.2"], "give two velocities"),
        (["--current", "0.2,0.1", "--at", "u=0.5,r=0.1"], "forces change with psi"),
        (["--direction", "u=2"], "write 1 (forward) or -1"),
        (["--gains", "paper-smc"], "is discontinuous at its set-point"),
        (["--gains", "paper-pd", "--at", "r=0.1"], "cannot hold a turn"),
        (["--gains", "nothing"], "are neither a file nor a bundled set"),
        (["--gains", "paper-pid", "--require-stable"], "the loop with 'paper-pid' of 'mini-auv' is unstable"),
        (
            ["--at", "u=0.5", "--require-stable"],
            "this steady motion of 'mini-auv' is unstable: a mode in r, v",
        ),
        (["--input", "f9"], "'f9' is not an input"),
        (["--output", "q"], "'q' is not an output"),
        (["--sensors", "q"], "sensor 'q' is not an output"),
        (["--plot", "bode"], "needs a file"),
        (["--plot", "disk-margins", "--out", "a.png"], "state --gains"),
        (["--out", "a.png"], "--out needs a picture"),
        (["--plot", "bode", "--out", "missing/a.png"], "does not exist"),
        (["--plot", "bode", "--out", "auv.toml"], "is the input"),
        (["--plot", "step", "--out", "a.png", "--input", "f1", "--output", "u"], "is not connected"),
    ],
)
def test_what_cannot_be_is_refused(folder: Path, capsys: Capture, words: list[str], said: str) -> None:
    assert said in refusal(["linearize", "auv.toml", *words], capsys, folder)


def test_a_vehicle_without_a_steady_motion_is_refused(folder: Path, capsys: Capture) -> None:
    waves = '\n[effects.supply_droop]\ndroop_rate = "1e-4 1/s"\n'
    text = Path("auv.toml").read_text()
    Path("fading.toml").write_text(text.replace("\n[[thrusters]]", f"{waves}\n[[thrusters]]", 1))
    said = refusal(["linearize", "fading.toml"], capsys, folder)
    assert "depend on time" in said


@pytest.mark.slow
def test_a_vehicle_without_thrusters_has_poles_only(folder: Path, capsys: Capture) -> None:
    text = Path("auv.toml").read_text()
    buoyant = text.replace('B_net = { value = "-14.309872 N"', 'B_net = { value = "0 N"')
    Path("float.toml").write_text(buoyant[: buoyant.index("[[thrusters]]")])
    content = _content(["linearize", "float.toml"], capsys)
    assert content["controllability"]["rank"] == 0
    assert len(content["modes"]) == 8
    assert main(["linearize", "float.toml", "--plot", "poles", "--out", "a.png"]) == 0
    for words in (["linearize", "float.toml", "--plot", "bode", "--out", "b.png"], ["design", *DESIGN[1:]]):
        said = refusal([w.replace("auv.toml", "float.toml") for w in words], capsys, folder)
        assert "has no thruster" in said
    assert main(["update", "float.toml"]) == 0


# --- design ---------------------------------------------------------------------------------------
DESIGN = ["design", "auv.toml", "--error", "x=0.5,z=0.2,psi=10deg", "--force", "surge=1,heave=2,yaw=0.1"]


@pytest.mark.slow
@pytest.mark.parametrize("law", first_quick(["pid", "pd"]))
def test_a_design_becomes_a_gain_file(folder: Path, capsys: Capture, law: str) -> None:
    assert main([*DESIGN, "--law", law, "--out", "gains.toml"]) == 0
    assert "wrote gains.toml" in capsys.readouterr().out
    content = _content(["linearize", "auv.toml", "--gains", "gains.toml"], capsys)
    assert content["stable"]
    assert min(m["phase"] for m in content["margins"].values()) > 55  # an optimal loop has at least 60


def test_a_design_without_weights_is_refused(folder: Path, capsys: Capture) -> None:
    words = ["design", "auv.toml", "--error", "x=1", "--force", "surge=1"]
    assert "error of z is missing" in refusal(words, capsys, folder)
    assert "--error x: " in refusal(
        ["design", "auv.toml", "--error", "x=1 kg", "--force", "surge=1"], capsys, folder
    )
