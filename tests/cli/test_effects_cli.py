"""`undertow effects` and `undertow vehicles`: what they list, show and find wrong."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from matplotlib.mathtext import MathTextParser

from tests.cli.bad import Undertow
from tests.quick import first_quick
from undertow.model.catalogue import catalogue
from undertow.model.describe import describe, latex_name
from undertow.model.loading import bundled_vehicles

GOOD = '''
import sympy as sm
from undertow.model.effect import Wrench
from undertow.model.parameter import Parameter


class KeelDrag(Wrench):
    """Drag of a [bold]keel[/bold] in sway."""

    id = "keel_drag"
    family = "damping"
    reference = "Hoerner (1965)"
    signature = "sway dies out too fast"
    dissipative = True

    Y_keel = Parameter("N/(m/s)", "sway force per sway velocity", (-1e6, 0))

    def wrench(self, s):
        return sm.Matrix([0, self.Y_keel * s.nu_r[1], 0, 0, 0, 0])
'''


@pytest.fixture
def keel(tmp_path: Path) -> Path:
    file = tmp_path / "keel.py"
    file.write_text(GOOD, encoding="utf-8")
    return file


# --- the list -------------------------------------------------------------------------------------
def test_the_list_names_every_effect_with_family_and_meaning(undertow: Undertow) -> None:
    code, out, _ = undertow("effects")
    assert code == 0
    for effect_id, cls in catalogue().items():
        assert re.search(rf"\b{effect_id}\b +{re.escape(cls.about()[:40])}", out), effect_id
    families = [line.split()[0] for line in out.splitlines()[1:] if not line.startswith(" ")]
    first, last = ("inertia", "damping", "statics", "water"), ("tether", "actuation", "measurement", "memory")
    assert families == [*first, *last]


def test_the_list_as_json(undertow: Undertow) -> None:
    listed = {e["id"]: e for e in json.loads(undertow("effects", "--json")[1])}
    assert set(listed) == set(catalogue())
    assert listed["thruster_lag"]["kind"] == "actuation"
    assert listed["thrusters"]["built_in"] is True
    assert listed["lift"]["family"] == "damping"


def test_effects_of_ones_own_join_the_list_where_they_are_named(undertow: Undertow, keel: Path) -> None:
    assert "keel_drag" not in undertow("effects")[1]
    code, out, _ = undertow("effects", "--effects", keel)
    assert code == 0
    assert re.search(r"keel_drag +Drag of a \[bold\]keel\[/bold\] in sway", out), (
        "text of a file is no markup"
    )


# --- one effect -----------------------------------------------------------------------------------
def test_show_prints_all_there_is_to_know(undertow: Undertow) -> None:
    code, out, _ = undertow("effects", "show", "quadratic_damping")
    assert code == 0
    assert "quadratic_damping (damping, wrench)" in out
    assert "Drag proportional to the speed times its magnitude" in out
    assert re.search(r"^ *X += +X_uabsu\*u_r\*\|u_r\|", out, re.MULTILINE)
    assert r"Y = Y_{|v|v} v_{r} \left|{v_{r}}\right|" in out
    assert re.search(r"X_uabsu +kg/m +0 +linear +surge force per surge velocity times its magnitude", out)
    assert "velocity through the water" in out
    assert "Never feeds power in." in out
    assert "too fast at high speed" in out
    assert "Fossen (2021), chapter 6" in out


def test_show_says_what_an_effect_shares(undertow: Undertow) -> None:
    out = undertow("effects", "show", "trim_offset")[1]
    assert "Shares parameters of restoring" in out
    assert re.search(r"^ *B +buoyancy, N", out, re.MULTILINE)
    assert re.search(r"^ *K += +-B\*dy_B", out, re.MULTILINE)
    assert not re.search(r"^ *X +=", out, re.MULTILINE), "rows that are zero are left out"


def test_show_lists_the_other_ways_to_write_a_parameter(undertow: Undertow) -> None:
    assert re.search(r"x_g +m +in files +another way", undertow("effects", "show", "rigid_body")[1])


def test_show_as_json(undertow: Undertow) -> None:
    shown = json.loads(undertow("effects", "show", "thruster_lag", "--json")[1])
    (lag,) = shown["parameters"]
    assert lag["name"] == "T_lag"
    assert (lag["low"], lag["high"], lag["unit"], lag["linear"]) == (0.01, 20.0, "s", False)
    rows = {e["left"]: e["plain"] for e in shown["equations"]}
    assert rows["output_port"] == "lagged_port"
    assert rows["d(lagged_port)/dt"] == "(command_port - lagged_port)/T_lag"


@pytest.mark.parametrize("effect_id", first_quick(sorted(catalogue()), 8))
def test_every_effect_can_be_shown(effect_id: str, undertow: Undertow) -> None:
    code, out, _ = undertow("effects", "show", effect_id)
    assert code == 0
    assert catalogue()[effect_id].reference in out
    shown = json.loads(undertow("effects", "show", effect_id, "--json")[1])
    hardware = {"<thruster>": "port", "<surface>": "rudder"}
    names = {p["name"].replace(k, n) for p in shown["parameters"] for k, n in hardware.items()}
    assert names >= {
        p.name for p in catalogue()[effect_id].specimen().parameters if "starboard" not in p.name
    }
    assert shown["equations"]


@pytest.mark.parametrize("effect_id", first_quick(sorted(catalogue()), 3))
def test_the_latex_of_every_effect_can_be_typeset(effect_id: str) -> None:
    for equation in describe(catalogue()[effect_id]).equations:
        box = MathTextParser("path").parse(f"${equation.latex}$")
        assert box.width > 10
    assert "dot}" not in describe(catalogue()[effect_id]).equations[0].latex.replace(r"\dot}", "")


@pytest.mark.parametrize(
    ("name", "latex"),
    [
        ("X_uabsu", "X_{|u|u}"),
        ("Y_rdot", r"Y_{\dot{r}}"),
        ("N_uv", "N_{uv}"),
        ("w_r_dot", r"\dot{w}_{r}"),
        ("p_dot", r"\dot{p}"),
        ("phi", r"\phi"),
        ("tau_X", r"\tau_{X}"),
        ("mx_g", "m x_{g}"),
        ("dz_B", r"\Delta z_{B}"),
        ("I_xy", "I_{xy}"),
        ("T_lag", r"T_{\mathrm{lag}}"),
        ("gain_error_port", r"\mathrm{gain}_{\mathrm{error\_port}}"),
    ],
)
def test_names_in_latex(name: str, latex: str) -> None:
    assert latex_name(name) == latex


# --- the check of a user's file -------------------------------------------------------------------
def test_check_passes_a_good_effect(undertow: Undertow, keel: Path) -> None:
    code, out, _ = undertow("effects", "check", keel)
    assert code == 0
    assert "KeelDrag: keel_drag" in out
    assert re.search(r"ok +dissipative +it never feeds power in", out)
    assert "all checks passed" in out
    assert "FAIL" not in out


def test_check_names_what_is_wrong_and_exits_with_one(undertow: Undertow, keel: Path) -> None:
    keel.write_text(GOOD.replace('"Hoerner (1965)"', '""'), encoding="utf-8")
    code, out, _ = undertow("effects", "check", keel)
    assert code == 1
    assert re.search(r"FAIL +documentation +reference is missing: name the book or paper", out)
    assert out.endswith("1 complaint\n")


def test_check_names_everything_that_is_wrong_at_once(undertow: Undertow, keel: Path) -> None:
    keel.write_text(GOOD.replace("(-1e6, 0)", "(0, 1e6)").replace("N/(m/s)", "N/(m/s)^2"), encoding="utf-8")
    code, out, _ = undertow("effects", "check", keel)
    assert code == 1
    assert re.search(r"FAIL +units +Y: the term 'Y_keel\*v_r' is in kg/s where N is wanted", out)
    assert re.search(r"FAIL +dissipative +declared dissipative, but it feeds", out)
    assert out.endswith("2 complaints\n")


def test_check_looks_at_every_effect_of_the_file(undertow: Undertow, keel: Path) -> None:
    second = (
        GOOD.replace("KeelDrag", "FinDrag").replace("keel", "fin").replace("s.nu_r[1]", "s.nu_r[1] * s.g")
    )
    keel.write_text(GOOD + second, encoding="utf-8")
    code, out, _ = undertow("effects", "check", keel)
    assert code == 1
    assert re.search(r"FinDrag: fin_drag\n(.*\n)*? +FAIL +units(.*\n)*KeelDrag: keel_drag", out)


def test_check_sees_two_effects_of_one_file_with_the_same_id(undertow: Undertow, keel: Path) -> None:
    keel.write_text(GOOD + GOOD.replace("KeelDrag", "OtherDrag"), encoding="utf-8")
    code, out, _ = undertow("effects", "check", keel)
    assert code == 1
    assert re.search(r"FAIL +id +id 'keel_drag' belongs to \w+ already", out)


def test_help_says_that_the_file_is_executed(undertow: Undertow) -> None:
    for words in (("effects", "check"), ("effects",), ("effects", "show"), ("vehicles", "show")):
        code, out, _ = undertow(*words, "--help")
        assert code == 0
        assert "executed" in out


# --- vehicles ---------------------------------------------------------------------------------------
def test_vehicles_lists_what_is_bundled(undertow: Undertow) -> None:
    code, out, _ = undertow("vehicles")
    assert code == 0
    for name in bundled_vehicles():
        assert re.search(rf"^{name} +surge", out, re.MULTILINE)
    listed = json.loads(undertow("vehicles", "--json")[1])
    assert [v["name"] for v in listed] == list(bundled_vehicles())


def test_a_vehicle_is_shown_in_the_signs_of_its_file(undertow: Undertow) -> None:
    code, out, _ = undertow("vehicles", "show", "mini-auv")
    assert code == 0
    assert "surge sway heave yaw; positive magnitudes; water 1000 kg/m^3" in out
    assert re.search(r"X_udot_forward +1\.630825 kg +± 0\.28 +estimate +Table 4", out)
    assert re.search(r"B_net +-14\.309872 N", out)
    assert re.search(r"Y_vdot +2\.588308 kg +± 2\.6 +assumed +assumed: the paper prints no sway value", out)
    assert re.search(r"^ +f4 +1 +0 +0 +0 +0 +-0\.16 +1", out, re.MULTILINE)
    assert re.search(r"X_udot +-20\.6 kg", undertow("vehicles", "show", "box-hull")[1]), "SNAME signs"


def shown(undertow: Undertow, vehicle: object) -> dict[str, Any]:
    code, out, err = undertow("vehicles", "show", vehicle, "--json")
    assert code == 0, err
    return json.loads(out)


def test_a_vehicle_as_json(undertow: Undertow) -> None:
    content = shown(undertow, "cybership2")
    effects = {e["id"]: {p["name"]: p for p in e["parameters"]} for e in content["effects"]}
    assert effects["added_mass"]["Y_vdot"]["value"] == -10.0
    assert effects["added_mass"]["Y_vdot"]["unit"] == "kg"
    assert effects["rigid_body"]["mx_g"]["value"] == pytest.approx(23.8 * 0.046)
    assert content["thrusters"][0]["name"] == "T1"
    assert content["environment"]["g"] == 9.81


def test_the_sway_values_that_the_paper_lacks_are_found(undertow: Undertow, tmp_path: Path) -> None:
    """Without the two assumed values the file holds what the paper prints, and the gap is named."""
    text = bundled_vehicles()["mini-auv"].read_text(encoding="utf-8")
    assumed = "assumed, without a source: Y_vdot, Y_v"
    assert assumed in shown(undertow, "mini-auv")["hints"]
    paper = tmp_path / "paper.toml"
    paper.write_text(re.sub(r"(?m)^Y_v(dot)? = .*\n", "", text), encoding="utf-8")
    hints = shown(undertow, paper)["hints"]
    assert "added_mass has no Y_vdot although sway is a degree of freedom: it counts as zero" in hints
    assert "linear_damping has no Y_v although sway is a degree of freedom: it counts as zero" in hints
    assert "nothing damps sway" in hints
    assert assumed not in hints
    assert "nothing damps sway" in undertow("vehicles", "show", paper)[1]


@pytest.mark.parametrize(
    ("removed", "hint"),
    [
        ("rigid_body_coriolis", "rigid_body_coriolis is absent although the vehicle turns"),
        ("added_mass_coriolis", "added_mass_coriolis is absent although the vehicle turns"),
        ("restoring", "restoring is absent: nothing returns roll and pitch back to level"),
        ("restoring", "weight and buoyancy are taken as equal"),
        ("linear_damping", None),
    ],
)
def test_hints_on_absent_effects(removed: str, hint: str | None, undertow: Undertow, tmp_path: Path) -> None:
    text = bundled_vehicles()["bluerov2"].read_text(encoding="utf-8")
    assert shown(undertow, "bluerov2")["hints"] == [], "nothing is missing there"
    file = tmp_path / "rov.toml"
    file.write_text(re.sub(rf"\[effects\.{removed}\]\n([^\[]+\n)*?\n", "", text), encoding="utf-8")
    hints = shown(undertow, file)["hints"]
    assert any(hint in line for line in hints) if hint else hints == []


def test_a_value_without_influence_is_named(undertow: Undertow, tmp_path: Path) -> None:
    text = bundled_vehicles()["box-hull"].read_text(encoding="utf-8")
    file = tmp_path / "box.toml"
    file.write_text(
        text.replace("[effects.added_mass]", "[effects.added_mass]\nN_rdot = -1.0"), encoding="utf-8"
    )
    assert shown(undertow, file)["hints"] == ["has no influence in these degrees of freedom: N_rdot"]


def test_names_out_of_files_do_not_steer_the_terminal(undertow: Undertow, tmp_path: Path) -> None:
    text = bundled_vehicles()["box-hull"].read_text(encoding="utf-8")
    text = re.sub('description = ".*"', r'description = "[red]a\\u001b[2Jb"', text)
    file = tmp_path / "box.toml"
    file.write_text(text, encoding="utf-8")
    code, out, _ = undertow("vehicles", "show", file)
    assert code == 0
    assert r"[red]a\x1b[2Jb" in out
    assert "\x1b" not in undertow("vehicles")[1] + out


def test_an_unknown_vehicle_gets_the_nearest_one(undertow: Undertow) -> None:
    code, out, err = undertow("vehicles", "show", "bluerov")
    assert (code, out) == (2, "")
    assert "did you mean 'bluerov2'?" in err


def test_what_an_effect_of_ones_own_raises_is_one_line_with_file_effect_and_line(
    undertow: Undertow, keel: Path, tmp_path: Path
) -> None:
    text = keel.read_text().replace("s.nu_r[1]", "s.speed")
    line = next(i for i, written in enumerate(text.splitlines(), start=1) if "s.speed" in written)
    keel.write_text(text)
    log = tmp_path / "log.csv"
    log.write_text("t,u,tau_X\n" + "".join(f"{0.1 * i:.1f},{0.01 * i},1\n" for i in range(200)))
    code, _, err = undertow("add", "keel_drag", "box-hull", str(log), "--effects", str(keel))
    assert code == 2
    assert err.count("\n") == 1
    assert (
        f"effect file '{keel}', line {line}: wrench() of effect 'keel_drag' fails with AttributeError" in err
    )
