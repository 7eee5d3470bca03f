"""`undertow gains` and `undertow audit` on the command line."""

from __future__ import annotations

import io
import json
import re
from contextlib import redirect_stdout
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.cli.bad import refusal
from tests.control.test_gain_files import FAULTS, GOOD
from tests.quick import first_quick
from undertow.cli.main import main

Capture = pytest.CaptureFixture[str]

SURGE = """
schema = "undertow/vehicle/1"
name = "sled"
degrees_of_freedom = ["surge"]
signs = "magnitudes"
generalised_forces = ["tau_X"]
[effects.rigid_body]
m = "7.5 kg"
[effects.added_mass]
X_udot = { value = "1.630825 kg", sigma = "0.1 kg" }
[effects.linear_damping]
X_u = { value = "0.142306 kg/s", sigma = "0.02 kg/s" }
"""
GAINS = """
schema = "undertow/gains/1"
name = "sled-pid"
law = "pid"
[gains]
K_P = 5
K_V = 4
K_I = 0.05
"""


@pytest.fixture
def sled(here: Path) -> Path:
    """A folder, the current one, with a vehicle in surge alone and gains that are good for it."""
    (here / "sled.toml").write_text(SURGE)
    (here / "gains.toml").write_text(GAINS)
    (here / "mine.toml").write_text(GOOD)
    return here


def content(capsys: Capture, *words: str) -> tuple[int, Any]:
    capsys.readouterr()
    code = main(["gains", *words, "--json"])
    return code, json.loads(capsys.readouterr().out)


@cache
def printed(*words: str) -> str:
    """Exit code and output of `undertow gains` for bundled files, worked out once."""
    with redirect_stdout(io.StringIO()) as stream:
        code = main(["gains", *words])
    return f"exit code {code}\n{stream.getvalue()}"


# --- verdicts ---------------------------------------------------------------------------------------
def test_the_published_pid_gains(sled: Path) -> None:
    out = printed("mini-auv", "paper-pid", "--repair", "routh")
    assert out.startswith("exit code 1\n")
    lines = [
        "the loop in x (forward) is linearly unstable: +0.003198 +- 0.038054i",
        "the loop in x (backward) is linearly unstable: +0.005482 +- 0.038392i",
        "all headings: J J' = I, so M_q = J M J' has the eigenvalues of M",
        "ι > 0.0857143",
        "ι 0.00537171 to 0.0695662",
        "equal to V_dot worked out from the model",
        "none is certified: sway is unactuated",
        "K_V alone never suffices",
        "K_I < 0.000193593",
        "Smallest change of all gains together (routh)",
    ]
    for line in lines:
        assert line in out
    assert out.count("there is none") == 3


@pytest.mark.parametrize(("gains", "law"), first_quick([("paper-pd", "pd"), ("paper-smc", "sliding-mode")]))
def test_other_published_gains(gains: str, law: str, sled: Path, capsys: Capture) -> None:
    """Every condition holds; sway, which the file names as unactuated, comes to rest by its own damping."""
    code, found = content(capsys, "mini-auv", gains)
    assert (code, found["ok"], found["law"]) == (0, True, law)
    assert found["schema"] == "undertow/gain-report/2"
    assert {r["verdict"] for r in found["rows"]} == {"holds"}
    assert found["zero_dynamics"]["axes"] == ["sway"]


def test_good_gains_end_with_zero(sled: Path, capsys: Capture) -> None:
    code, found = content(capsys, "sled.toml", "gains.toml", "--form", "derived")
    assert (code, found["ok"]) == (0, True)
    assert {r["form"] for r in found["rows"]} == {"derived"}
    routh = next(r for r in found["rows"] if r["condition"] == "Routh")
    assert routh["left"] == pytest.approx(5 * 4.142306)
    assert routh["right"] == pytest.approx(9.130825 * 0.05)
    assert routh["box"]["verdict"] == routh["ellipsoid"]["verdict"] == "holds for all"
    assert found["region"]["kind"] == "everywhere"
    assert main(["gains", "sled.toml", "gains.toml"]) == 1  # as printed they fail: K_V > M


SLOW = """
schema = "undertow/vehicle/1"
name = "heaver"
degrees_of_freedom = ["heave"]
signs = "magnitudes"
[effects.rigid_body]
m = "10 kg"
[effects.linear_damping]
Z_w = "1 kg/s"
[effects.thruster_lag]
T_lag = "LAG s"
[[thrusters]]
name = "f1"
position = ["0 m", "0 m", "0 m"]
direction = [0, 0, 1]
"""


@pytest.mark.parametrize(("lag", "stable"), [(0.1, True), (10.0, False)])
def test_what_is_left_out_is_looked_at(lag: float, stable: bool, sled: Path, capsys: Capture) -> None:
    """10 T s^3 + (10 + T) s^2 + 4 s + 20 with a lag T: Routh asks for 4 (10 + T) > 200 T."""
    (sled / "slow.toml").write_text(SLOW.replace("LAG", str(lag)))
    law = GAINS.partition("[gains]")[0].replace('"pid"', '"pd"')
    (sled / "pd.toml").write_text(law + "[gains]\nK_P = 20\nK_V = 3\n")
    assert main(["gains", "slow.toml", "pd.toml"]) == (0 if stable else 1)
    out = capsys.readouterr().out
    assert "all conditions hold, but thruster_lag is not in them" in out
    assert f"full loop linearised at rest: {'stable' if stable else 'UNSTABLE'}" in out
    _, found = content(capsys, "slow.toml", "pd.toml")
    growing = max(np.roots([10 * lag, 10 + lag, 4, 20]), key=lambda r: r.real)
    assert found["ok"] == (found["full_loop"]["verdict"] == "stable") == stable
    assert found["full_loop"]["pole"][0] == pytest.approx(growing.real, rel=1e-6)


PSI, NUMBER = "psi", r"[0-9.e-]+"


@pytest.mark.slow
@pytest.mark.parametrize("kind", first_quick(["lyapunov", "routh"]))
def test_printed_repairs_put_into_a_file_hold(kind: str, sled: Path, capsys: Capture) -> None:
    """Routh in every channel, and one iota for Q(iota) > 0 (V > 0 follows for a channel only)."""
    main(["gains", "mini-auv", "paper-pid", "--repair", kind])
    out = capsys.readouterr().out.partition("Smallest change")[2]
    new = re.findall(rf"(K_[PVI])_(\w+) +({NUMBER}) +{NUMBER}", out)
    assert {n for n, _, _ in new} == {"K_P", "K_V", "K_I"}
    gains: dict[str, dict[str, float]] = {
        "K_P": {"x": 0.012, "y": 0.012, "z": 1, "psi": 0.01},
        "K_V": {"x": 0.005, "y": 0.005, "z": 3, "psi": 0.5},
        "K_I": {"x": 0.0003, "y": 0.0003, "z": 0.0005, "psi": 0.00005},
    }
    for name, coordinate, value in new:
        gains[name][coordinate] = float(value)
    wanted = {"routh": {"Routh"}, "lyapunov": {"some iota", "V_dot"}}[kind]
    assert holding(sled, capsys, gains) >= wanted


@pytest.mark.slow
@pytest.mark.parametrize("gain", first_quick(["K_I", "K_V"]))
def test_a_printed_bound_of_one_gain_is_on_the_safe_side(gain: str, sled: Path, capsys: Capture) -> None:
    out = printed("mini-auv", "paper-pid")
    bounds = [float(b) for b in re.findall(rf"x: routh +\w+ +{gain} [<>] ({NUMBER})", out)]
    gains = {
        "K_P": {"x": 0.012, "y": 1.0, "z": 1, "psi": 0.01},
        "K_V": {"x": 0.005, "y": 1.0, "z": 3, "psi": 0.5},
        "K_I": {"x": 0.0003, "y": 0.0003, "z": 0.0005, "psi": 0.00005},
    }
    gains[gain]["x"] = max(bounds) if gain == "K_V" else min(bounds)
    assert "Routh" in holding(sled, capsys, gains)


def holding(folder: Path, capsys: Capture, gains: dict[str, dict[str, float]]) -> set[str]:
    """The derived conditions that hold everywhere for PID gains of the mini-AUV."""
    units = {"K_P": ("N/m", "N m/rad"), "K_V": ("N s/m", "N m s/rad"), "K_I": ("N/(m s)", "N m/(rad s)")}
    head = GAINS.partition("[gains]")[0] + 'unactuated = ["sway"]\n[gains]\n'
    lines = []
    for name, own in gains.items():
        cells = [f'{c} = "{v} {units[name][c == PSI]}"' for c, v in own.items()]
        lines.append(f"{name} = {{ {', '.join(cells)} }}")
    (folder / "new.toml").write_text(head + "\n".join(lines))
    _, found = content(capsys, "mini-auv", "new.toml", "--form", "derived")
    failing = {r["condition"] for r in found["rows"] if r["verdict"] != "holds"}
    return {r["condition"] for r in found["rows"]} - failing


LAWS = {
    "sliding-mode-boundary-layer": "K_Z = 0.5\nLambda = 0.5\nwidth = 0.05",
    "super-twisting": "K_1 = 0.5\nK_2 = 0.1\nLambda = 0.5",
}


@pytest.mark.parametrize("law", LAWS)
def test_other_sliding_laws(law: str, sled: Path, capsys: Capture) -> None:
    head = GAINS.partition("[gains]")[0].replace('"pid"', f'"{law}"')
    (sled / "other.toml").write_text(f"{head}[gains]\n{LAWS[law]}\n")
    code, found = content(capsys, "sled.toml", "other.toml")
    assert code == 0
    assert found["lyapunov"]["identity"].startswith("equal to V_dot")
    certified = "not certified" if law == "super-twisting" else "on the exact model"
    assert any(certified in r["about"] for r in found["rows"])


def test_an_iota_of_ones_own(sled: Path, capsys: Capture) -> None:
    code, found = content(capsys, "sled.toml", "gains.toml", "--form", "derived", "--iota", "0.1")
    assert code == 0
    assert {r["at_iota"] for r in found["rows"] if r["uses_iota"]} == {0.1}
    code, found = content(capsys, "sled.toml", "gains.toml", "--form", "derived", "--iota", "0.001")
    assert [a["verdict"] for a in found["agreements"]] == ["fails"]
    assert (code, found["ok"]) == (0, True), "another V is proved"
    assert found["region"]["quadratic"]


def test_more_confidence_finds_a_counterexample(sled: Path, capsys: Capture) -> None:
    weak = (
        GAINS.replace("K_V = 4", "K_V = 0.01").replace("K_P = 5", "K_P = 0.05").replace("0.05\n", "0.0005\n")
    )
    (sled / "weak.toml").write_text(weak.replace("K_P = 0.0005", "K_P = 0.05"))
    _, found = content(capsys, "sled.toml", "weak.toml", "--confidence", "0.9")
    rows = {c: next(r for r in f["rows"] if r["condition"] == "Routh") for c, f in (("0.9", found),)}
    _, found = content(capsys, "sled.toml", "weak.toml", "--confidence", "0.9999")
    rows["0.9999"] = next(r for r in found["rows"] if r["condition"] == "Routh")
    assert rows["0.9"]["box"]["verdict"] == "holds for all"
    assert rows["0.9999"]["box"]["verdict"] == "fails for some"
    example = rows["0.9999"]["box"]["counterexample"]
    mass, drag = 7.5 + example["X_udot"], example["X_u"]
    assert 0.05 * (0.01 + drag) < mass * 0.0005


def test_a_covariance_in_the_history_is_used(sled: Path, capsys: Capture) -> None:
    history = """
[[history]]
covariance = { parameters = ["X_udot", "X_u"], matrix = [[0.01, 0.0], [0.0, 0.0004]] }
"""
    (sled / "sled.toml").write_text(SURGE + history)
    _, found = content(capsys, "sled.toml", "gains.toml")
    assert found["uncertainty"] == "95%, from the covariance of the last fit"


# --- mistakes ---------------------------------------------------------------------------------------
@pytest.mark.parametrize("fault", first_quick(FAULTS, 2))  # all of them: tests/control/test_gain_files.py
def test_a_gain_file_with_a_fault_is_refused(fault: str, sled: Path, capsys: Capture) -> None:
    old, new, words = FAULTS[fault]
    (sled / "bad.toml").write_text(GOOD.replace(old, new, 1))
    line = refusal(["gains", "mini-auv", "bad.toml"], capsys, sled)
    assert all(word in line for word in ["bad.toml", *words]), line


BAD_VEHICLES = {
    "no inertia": ('[effects.rigid_body]\nm = "7.5 kg"', "", ["inertia"]),
    "no mass": ('m = "7.5 kg"', "", ["rigid_body", "m"]),
    "no damping": (
        '[effects.linear_damping]\nX_u = { value = "0.142306 kg/s", sigma = "0.02 kg/s" }',
        "",
        ["damp"],
    ),
    "no force": ('generalised_forces = ["tau_X"]', "", ["surge", "no thruster", "unactuated"]),
    "a broken covariance": (
        "[effects.rigid_body]",
        "[[history]]\ncovariance = { parameters = ['X_u'], matrix = [[1.0, 2.0]] }\n[effects.rigid_body]",
        ["covariance", "square"],
    ),
}


@pytest.mark.parametrize("fault", BAD_VEHICLES)
def test_a_vehicle_without_what_conditions_need_is_refused(fault: str, sled: Path, capsys: Capture) -> None:
    old, new, words = BAD_VEHICLES[fault]
    assert old in SURGE
    text = SURGE.replace(old, new, 1)
    if fault == "no inertia":
        text = text[: text.index("[effects.added_mass]")] + text[text.index("[effects.linear_damping]") :]
    (sled / "bad.toml").write_text(text)
    line = refusal(["gains", "bad.toml", "gains.toml"], capsys, sled)
    assert all(word in line for word in words), line


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["mini-avu", "paper-pid"], "bundled are bluerov2"),
        (["mini-auv", "paper-pdi"], "bundled are paper-pd"),
        (["mini-auv"], "GAINS"),
        (["mini-auv", "paper-pid", "--iota", "-1"], "--iota -1"),
        (["mini-auv", "paper-pid", "--iota", "nan"], "--iota nan"),
        (["mini-auv", "paper-pid", "--confidence", "2"], "--confidence"),
        (["mini-auv", "paper-pid", "--tilt", "90"], "--tilt"),
        (["mini-auv", "paper-pid", "--repair", "all"], "--repair"),
        (["mini-auv", "paper-pid", "--form", "new"], "--form"),
        (["mini-auv", "paper-pd", "--repair", "routh"], "PID"),
        (["mini-auv", "paper-pd", "--form", "units"], "no conditions of the form units"),
        (["bluerov2", "paper-pid"], "unactuated names sway"),
    ],
)
def test_a_mistake_on_the_line_is_named(words: list[str], named: str, sled: Path, capsys: Capture) -> None:
    assert named in refusal(["gains", *words], capsys, sled)


# --- audit ------------------------------------------------------------------------------------------
def test_audit_of_the_paper(capsys: Capture) -> None:
    assert main(["audit"]) == 1
    out = capsys.readouterr().out
    for line in (
        "C_q has the wrong sign",
        "-1.914966",
        "Munk moment",
        "units of K_V > M",
        "undertow audit-tables",
    ):
        assert line in out
    assert main(["audit", "--json"]) == 1
    assert {f["kind"] for f in json.loads(capsys.readouterr().out)} == {"wrong", "open"}


def test_audit_of_vehicles(sled: Path, capsys: Capture) -> None:
    assert main(["audit", "mini-auv"]) == 0
    assert "assumed, without a source: Y_vdot, Y_v" in capsys.readouterr().out
    assert main(["audit", "cybership2"]) == 1
    assert "feeds energy into a motion" in capsys.readouterr().out
    assert "bundled are" in refusal(["audit", "nothing.toml"], capsys, sled)


# --- notation ---------------------------------------------------------------------------------------
def test_matrix_conditions_are_in_the_notation_of_the_paper(sled: Path, capsys: Capture) -> None:
    """λmin K_V > λmax M_q with both numbers, Table 4 and 5: 0.005 against 10.088308 and 11.408386."""
    out = printed("mini-auv", "paper-pid", "--repair", "routh")
    for line in (
        "λmin(K_V) > λmax(M_q): 0.005 > 10.088 fails",
        "λmin(K_V) > λmax(M_q): 0.005 > 11.408 fails",
        "λmin(K_P) > λmax(K_V + 2 K_I/ι): no ι",
        "K_P - K_I/ι - ι² M_q ≻ 0: no ι",
        "Q(ι) ≻ 0: no ι",
        "K_I ≻ 0: λmin 5e-05 > 0 holds",
        "one ι for all of them, in every set of parameters: there is none",
    ):
        assert line in out
    assert "iota" not in out.partition("Linearised channels")[0]
    assert "K_V + D_q ≻ 0: λmin 0.513791 > 0 holds" in printed("mini-auv", "paper-pd")
    assert "Λ ≻ 0: λmin" in printed("mini-auv", "paper-smc")


@pytest.mark.slow
def test_no_iota_is_a_verdict_of_its_own(sled: Path, capsys: Capture) -> None:
    code, found = content(capsys, "mini-auv", "paper-pid")
    assert code == 1
    none = [r for r in found["rows"] if r["uses_iota"] and r["iota"] is None]
    assert {r["verdict"] for r in none} == {"no iota"}
    assert {(r["form"], r["condition"]) for r in none} >= {("printed", "K_P"), ("derived", "V_dot")}
    assert {r["box"]["verdict"] for r in none if r["box"]} == {"no iota at the values of the file"}
    assert all(r["iota"] or not r["uses_iota"] for r in found["rows"] if r["verdict"] == "fails")
    assert {a["verdict"] for a in found["agreements"]} == {"no iota"}
    reported = re.search(
        r"(\d+) fail at the values of the file, (\d+) have no ι there", printed("mini-auv", "paper-pid")
    )
    uncertain = [r["verdict"] for r in found["rows"] if r["box"]]
    assert reported is not None
    assert [int(n) for n in reported.groups()] == [uncertain.count("fails"), uncertain.count("no iota")]


def test_sides_that_differ_little_are_told_apart(sled: Path, capsys: Capture) -> None:
    """K_V = 9.13084 against an inertia of 9.130825 kg: five digits would print 9.1308 > 9.1308."""
    (sled / "close.toml").write_text(GAINS.replace("K_V = 4", "K_V = 9.13084"))
    main(["gains", "sled.toml", "close.toml", "--form", "printed"])
    assert "λmin(K_V) > λmax(M_q): 9.13084 > 9.13082 holds" in capsys.readouterr().out


def test_a_terminal_without_greek_letters_has_their_names(
    sled: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Private: a terminal with another encoding.
    monkeypatch.setattr("undertow.cli._terminal._encoding", lambda: "ascii")
    assert main(["gains", "sled.toml", "gains.toml"]) == 1
    out = capsys.readouterr().out
    assert out.isascii()
    assert "lambda_min(K_V) > lambda_max(M_q): 4 > 9.1308 fails" in out
    assert "lambda_min(K_P) > lambda_max(K_V + 2 K_I/iota)" in out
