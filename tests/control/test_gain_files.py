"""Gain files with a fault: one clear line."""

from __future__ import annotations

from pathlib import Path

import pytest

from undertow.control.gains import load_gains
from undertow.errors import UndertowError
from undertow.model.loading import load_vehicle

GOOD = """
schema = "undertow/gains/1"
name = "mine"
law = "pid"
unactuated = ["sway"]
[gains]
K_P = { x = "0.2 N/m", y = "0.2 N/m", z = "1 N/m", psi = "0.1 N m/rad" }
K_V = { x = "2 N s/m", y = "2 N s/m", z = "5 N s/m", psi = "0.5 N m s/rad" }
K_I = [0.001, 0.001, 0.001, 0.0001]
"""

FAULTS = {
    "a gain missing": ("K_I = [0.001, 0.001, 0.001, 0.0001]", "", ["K_I", "missing", "[gains.K_I]"]),
    "one value missing": ('x = "0.2 N/m", ', "", ["K_P", "no value for x", "N/m"]),
    "negative": ('z = "1 N/m"', 'z = "-1 N/m"', ["K_P for z", "-1 N/m", "positive"]),
    "zero": ('z = "1 N/m"', "z = 0", ["K_P for z", "positive"]),
    "infinite": ('z = "1 N/m"', "z = inf", ["K_P for z", "finite"]),
    "not a number": ('z = "1 N/m"', "z = nan", ["K_P for z", "finite"]),
    "too large a number": ('z = "1 N/m"', 'z = "1e999 N/m"', ["K_P for z", "finite"]),
    "wrong unit": ('z = "1 N/m"', 'z = "1 N s/m"', ["K_P for z", "N/m", "matching unit"]),
    "kg/s^2 as printed for K_I": ("0.001, 0.001, 0.001", '"0.001 kg/s^2", 1, 1', ["K_I for x", "N/(m s)"]),
    "no unit at all": ('z = "1 N/m"', 'z = "1 furlongs"', ["K_P for z", "furlongs"]),
    "no quantity": ('z = "1 N/m"', "z = true", ["K_P"]),
    "too few in a list": ("[0.001, 0.001, 0.001, 0.0001]", "[0.001]", ["K_I has 1 values", "4 pose"]),
    "too many in a list": ("0.001, 0.0001]", "0.001, 0.0001, 1]", ["K_I has 5 values", "x, y, z, psi"]),
    "a coordinate that is none": ("z = ", "depth = ", ["depth"]),
    "a coordinate of other vehicles": ('z = "1 N/m"', 'phi = "1 N m", z = 1', ["K_P has a value for phi"]),
    "a gain of another law": ("K_I = ", "K_Z = ", ["'K_Z'", "law 'pid'", "K_P, K_V, K_I"]),
    "an unknown law": ('"pid"', '"pidd"', ["'pidd'", "'pid'", "laws are"]),
    "an axis without thrust": ('unactuated = ["sway"]', "", ["sway", "no thruster", 'unactuated = ["sway"]']),
    "an axis with thrust": ('["sway"]', '["sway", "surge"]', ["surge", "can push in", "remove it"]),
    "an axis that is not there": ('["sway"]', '["sway", "roll"]', ["roll", "does not have"]),
    "another schema": ("gains/1", "gains/2", ["schema"]),
    "a key that is none": ('name = "mine"', 'nam = "mine"', ["'nam'", "'name'"]),
    "no TOML": ("[gains]", "[gains", ["TOML"]),
    "a weight of nothing": ("[gains]", "[allocation.weights]\nf9 = 1\n[gains]", ["f9", "f1, f2, f3, f4"]),
    "a weight of zero": ("[gains]", "[allocation.weights]\nf1 = 0\n[gains]", ["f1", "above zero"]),
    "a weight next to nothing": (
        "[gains]",
        "[allocation.weights]\nf1 = 1e-300\n[gains]",
        ["'f1' is 1e-300", "1e-09 to 1e+09"],
    ),
    "a huge weight": ("[gains]", "[allocation.weights]\nf1 = 1e10\n[gains]", ["'f1' is 1e+10", "to 1e+09"]),
    "a huge gain": ("5 N s/m", "1e308 N s/m", ["K_V for z is 1e308 N s/m", "1e-12 to 1e+12 N s/m"]),
    "a huge integral": ("[0.001,", "[1e300,", ["K_I for x is 1e+300", "1e-12 to 1e+12 N/(m s)"]),
    "a gain next to nothing": ('"1 N/m"', "1e-300", ["K_P for z is 1e-300", "1e-12 to 1e+12"]),
}


def test_the_file_without_a_fault_is_read(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(GOOD)
    assert load_gains(tmp_path / "mine.toml", load_vehicle("mini-auv")).values["K_I_psi"] == 0.0001


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_named_in_one_line(fault: str, tmp_path: Path) -> None:
    old, new, words = FAULTS[fault]
    assert old in GOOD
    path = tmp_path / "bad.toml"
    path.write_text(GOOD.replace(old, new, 1))
    with pytest.raises(UndertowError) as caught:
        load_gains(path, load_vehicle("mini-auv"))
    message = str(caught.value)
    assert message.isprintable()
    assert all(word in message for word in ["bad.toml", *words]), message


def test_a_bundled_set_that_does_not_fit_is_called_by_its_name() -> None:
    with pytest.raises(
        UndertowError, match=r"^paper-pd: gain K_P has a value for z, which the vehicle does not"
    ):
        load_gains("paper-pd", load_vehicle("otter"))


@pytest.mark.parametrize("name", ["nothing.toml", "paper-pdi", "", ".", "x" * 5000, "new\nline", "nul\0"])
def test_gains_that_are_not_there(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UndertowError, match="bundled are paper-pd, paper-pid, paper-smc"):
        load_gains(name, load_vehicle("mini-auv"))
