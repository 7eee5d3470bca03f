"""Commands on control and odd vehicles, gains and values: an answer, or one line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.cli.bad import refusal
from tests.quick import first_quick
from undertow.cli.main import main
from undertow.control.gains import load_gains
from undertow.model.loading import load_vehicle

Capture = pytest.CaptureFixture[str]

HEAVE = """\
schema = "undertow/vehicle/1"
name = "heaver"
degrees_of_freedom = ["heave"]
signs = "magnitudes"
water_density = "1000 kg/m^3"
[effects.rigid_body]
m = "7.5 kg"
[effects.added_mass]
Z_wdot = "2.5 kg"
[effects.linear_damping]
Z_w = "1 kg/s"
"""
THRUSTER = """
[[thrusters]]
name = "f1"
position = ["0 m", "0 m", "0 m"]
direction = [0, 0, 1]
"""
GAINS = """\
schema = "undertow/gains/1"
name = "mine"
law = "pd"
[gains]
K_P = { z = "20 N/m" }
K_V = { z = "3 N s/m" }
"""
LEFT_OUT = GAINS.replace("[gains]", 'unactuated = ["heave"]\n[gains]')
SIMULATE = ["simulate", "mini-auv", "paper-pd", "--for", "1", "--dt", "0.01"]


@pytest.fixture
def here(here: Path) -> Path:
    """A folder, the current one, with a vehicle that heaves, without (bare.toml) and with a thruster."""
    (here / "bare.toml").write_text(HEAVE)
    (here / "heave.toml").write_text(HEAVE + THRUSTER)
    (here / "gains.toml").write_text(GAINS)
    (here / "left-out.toml").write_text(LEFT_OUT)
    return here


# --- without thrusters ----------------------------------------------------------------------------
def test_poles_of_a_vehicle_that_has_nothing_to_be_found(here: Path, capsys: Capture) -> None:
    """Hovering holds z and w, and there is no command: no unknown is left."""
    assert main(["linearize", "bare.toml"]) == 0
    assert "-0.1 " in capsys.readouterr().out  # Z_w / (m - Z_wdot) = 1 / 10
    assert "has no thruster" in refusal(
        ["design", "bare.toml", "--error", "z=1", "--force", "heave=1"], capsys, here
    )


@pytest.mark.parametrize(
    "words",
    [
        ["linearize", "bare.toml", "--gains", "left-out.toml"],
        ["export", "c", "bare.toml", "--controller", "left-out.toml"],
        ["simulate", "bare.toml", "left-out.toml", "--to", "1", "--for", "1", "--dt", "0.01"],
        ["update", "bare.toml", "--gains", "left-out.toml"],
    ],
    ids=lambda words: words[0],
)
def test_a_controller_without_thrusters_is_refused(here: Path, capsys: Capture, words: list[str]) -> None:
    said = refusal(words, capsys, here)
    assert "no thruster of 'heaver' pushes in heave; add [[thrusters]]" in said


# --- design with thrusters that are not ideal -----------------------------------------------------
DESIGN = ["design", "lazy.toml", "--error", "z=1", "--force", "heave=10"]


@pytest.mark.parametrize(
    "effect",
    ['[effects.thruster_lag]\nT_lag = "0.05 s"\n', "[effects.thruster_deadband]\ndeadband_width = 0.1\n"],
    ids=["lag", "dead band"],
)
def test_the_law_is_designed_for_ideal_thrust(here: Path, capsys: Capture, effect: str) -> None:
    Path("lazy.toml").write_text(HEAVE + THRUSTER + effect)
    assert main([*DESIGN, "--out", "new.toml"]) == 0
    found = load_gains("new.toml", load_vehicle("lazy.toml")).values
    assert found["K_P_z"] == pytest.approx(10.0)  # force / error
    assert found["K_V_z"] == pytest.approx(201**0.5 - 1.0, rel=1e-5)  # sqrt(D^2 + 2 M K_P) - D


def test_a_lag_that_the_design_does_not_bear_is_reported(here: Path, capsys: Capture) -> None:
    Path("lazy.toml").write_text(HEAVE + THRUSTER + '[effects.thruster_lag]\nT_lag = "10 s"\n')
    assert "does not hold the vehicle" in refusal(DESIGN, capsys, here)


@pytest.mark.parametrize("words", [DESIGN, ["gains", "lazy.toml", "gains.toml"]], ids=lambda words: words[0])
def test_thrust_by_a_curve_is_to_be_stated_in_newtons(here: Path, capsys: Capture, words: list[str]) -> None:
    Path("lazy.toml").write_text(HEAVE + THRUSTER + 'curve = "t200-16v"\n')
    assert "thrust of f1 is not proportional to the command" in (said := refusal(words, capsys, here))
    assert "give these thrusters a limit in N instead" in said


# --- what design says is what gains says ----------------------------------------------------------
FULL = ["--error", "x=0.5,z=0.2,psi=0.2", "--force", "surge=1,heave=2,yaw=0.1"]


@pytest.mark.parametrize(
    ("vehicle", "weights", "alone"),
    first_quick([("heave.toml", ["--error", "z=1", "--force", "heave=10"], False), ("mini-auv", FULL, True)]),
)
def test_an_axis_left_alone_is_told_by_design_as_by_gains(
    here: Path, capsys: Capture, vehicle: str, weights: list[str], alone: bool
) -> None:
    assert main(["design", vehicle, *weights, "--out", "new.toml"]) == 0
    out = capsys.readouterr().out
    assert "conditions derived from the model: all hold" in out
    assert ("sway: unactuated, its speed decays" in out) == alone
    assert main(["gains", vehicle, "new.toml"]) == 0
    reported = "all conditions hold, but sway is unactuated and comes to rest"
    assert (reported in capsys.readouterr().out) == alone


# --- numbers that no vehicle has ------------------------------------------------------------------
@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["linearize", "heave.toml", "--at", "w=1e9"], "w = 1e+09 (SI) is too large"),
        (["linearize", "heave.toml", "--at", "f1=1e200"], "stay within 1e+06"),
        (["linearize", "heave.toml", "--current", "1e200,0"], "1e+200 m/s to the north exceeds the limit"),
        (
            ["simulate", "heave.toml", "gains.toml", "--to", "1", "--current", "0,-101"],
            "-101 m/s to the east exceeds the limit of 100 m/s: correct it or its unit",
        ),
        (["design", "heave.toml", "--error", "z=1e-200", "--force", "heave=1"], "error of z is 1e-200"),
        (["design", "heave.toml", "--error", "z=1", "--force", "heave=1e200"], "1e-09 to 1e+09"),
        (["linearize", "heave.toml", "--plot", "poles", "--out", "a.txt"], "name it a.png"),
        (["linearize", "heave.toml", "--plot", "poles", "--out", "a"], "name it a.png"),
        ([*SIMULATE, "--to", "1,1,1", "--gate", "181deg", "--order", "yaw-first"], "beyond 180 deg"),
        ([*SIMULATE, "--to", "1,1,1", "--gate", "5", "--order", "yaw-first"], "without a unit is in rad"),
    ],
)
def test_values_beyond_all_bounds_and_names_that_cannot_be_meant_are_refused(
    here: Path, capsys: Capture, words: list[str], said: str
) -> None:
    assert said in refusal(words, capsys, here)


def test_weights_that_are_too_far_apart_are_refused(here: Path, capsys: Capture) -> None:
    weights = ["--error", "x=1e-9,z=1e9,psi=1", "--force", "surge=1e-9,heave=1e9,yaw=1e9"]
    said = refusal(["design", "mini-auv", "--law", "pid", *weights], capsys, here)
    assert "numerically singular; give errors and forces of more similar size" in said


def test_failing_linear_algebra_ends_in_one_line(
    here: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing of the report is printed before it is whole."""

    def fails(*_: object) -> None:
        raise np.linalg.LinAlgError("SVD did not converge.")

    monkeypatch.setattr("undertow.control.linear.report.observability", fails)
    capsys.readouterr()
    assert main(["linearize", "heave.toml"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("error: linear algebra fails on these numbers: SVD did not converge; look for")


# --- places and angles ----------------------------------------------------------------------------
@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="needs a folder that takes no files")
def test_a_place_without_files_is_refused_before_the_run(here: Path, capsys: Capture) -> None:
    capsys.readouterr()
    assert main([*SIMULATE, "--to", "1,1,1", "--json", "/proc/result.json"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert "cannot write '/proc/result.json'" in err


@pytest.mark.parametrize(
    ("goal", "asks"),
    first_quick([("1,1,1,90", True), ("1,1,1,1.5", False), ("1,1,1,900deg", False), ("90,1,1", False)], 2),
)
def test_a_heading_of_many_turns_is_asked_about(here: Path, capsys: Capture, goal: str, asks: bool) -> None:
    assert main([*SIMULATE, "--to", goal]) == 0
    said = "the heading 90 is in radians, 14.3 turns; write 90deg if degrees are meant"
    assert (said in capsys.readouterr().err) == asks
