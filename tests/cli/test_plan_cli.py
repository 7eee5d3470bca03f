"""`undertow plan` on a short case: what it prints and writes, and what it refuses in one line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.cli.bad import refusal
from undertow.cli.main import main
from undertow.identification.planning.problem import Plan

QUICK = ["--duration", "12", "--rate", "10", "--tries", "4"]
Capture = pytest.CaptureFixture[str]


def _table(path: str) -> tuple[list[str], np.ndarray]:
    head, *rows = Path(path).read_text().splitlines()
    return head.split(","), np.array([[float(cell) for cell in row.split(",")] for row in rows])


def test_a_plan_is_printed_and_written(case: Path, capsys: Capture) -> None:
    words = ["plan", "usv.toml", "train.csv", *QUICK, "--max-distance", "4", "--seed", "5"]
    assert main([*words, "--out", "plan.csv", "--picture", "plan.png", "--json", "plan.json"]) == 0
    out = capsys.readouterr().out
    plan = Plan.model_validate_json(Path("plan.json").read_text())
    assert out.startswith(f"usv: {plan.manoeuvre}")
    assert "Standard errors, expected if the model is right" in out
    assert all(f"\n  {p.name} " in out for p in plan.parameters)
    assert all(f"wrote plan.{kind}" in out for kind in ("csv", "png", "json"))
    assert Path("plan.png").read_bytes().startswith(b"\x89PNG")
    names, table = _table("plan.csv")
    assert names == ["t", "f1", "f2", "f3"]
    assert table.shape == (120, 4)
    assert np.max(np.abs(table[:, 1:])) <= 2.0
    np.testing.assert_allclose(table[[0, -1], 1:], 0.0, atol=1e-9)
    assert plan.extremes["distance"] <= 4.0
    assert plan.logs == ["train"]
    assert {c.source for c in plan.noise} == {"from the logs"}


def test_the_same_seed_writes_the_same_bytes(case: Path) -> None:
    words = ["plan", "usv.toml", *QUICK, "--seed", "3"]
    for name in ("a", "b"):
        assert main([*words, "--out", f"{name}.csv", "--json", f"{name}.json"]) == 0
    assert Path("a.csv").read_bytes() == Path("b.csv").read_bytes()
    assert Path("a.json").read_bytes() == Path("b.json").read_bytes()


def test_options_reach_the_plan(case: Path, capsys: Capture) -> None:
    options = ["--limit", "f1=1.5,f2=0.5", "--limit", "f3=1", "--noise", "x=none,y=none", "--noise", "u=0.05"]
    words = [
        "plan",
        "usv.toml",
        *QUICK,
        *options,
        "--max-rate",
        "30",
        "--max-speed",
        "0.4",
        "--only",
        "X_u,N_r",
    ]
    assert main([*words, "--json", "plan.json"]) == 0
    out = capsys.readouterr().out
    plan = Plan.model_validate_json(Path("plan.json").read_text())
    assert {c.name: (c.limit, c.limit_from) for c in plan.commands} == {
        "f1": (1.5, "asked for"), "f2": (0.5, "asked for"), "f3": (1.0, "asked for"),
    }  # fmt: skip
    assert all(max(abs(c.lowest), abs(c.highest)) <= c.limit for c in plan.commands)
    assert {c.name: c.sigma for c in plan.noise if c.name in "xyu"} == {"x": None, "y": None, "u": 0.05}
    assert plan.extremes["rate"] <= plan.limits["rate"] == pytest.approx(np.radians(30))
    assert plan.extremes["speed"] <= 0.4
    assert "not measured: x, y" in out
    assert "the commands were not written" in out


@pytest.mark.slow
def test_effects_are_told_apart(case: Path, capsys: Capture) -> None:
    words = ["plan", "usv.toml", "train.csv", *QUICK, "--between", "ocean_current,constant_force"]
    assert main([*words, "--picture", "plan.png", "--json", "plan.json"]) == 0
    out = capsys.readouterr().out
    plan = Plan.model_validate_json(Path("plan.json").read_text())
    (pair,) = plan.separations
    assert pair.pair == ("ocean_current", "constant_force")
    assert pair.chi_square_now is not None
    assert pair.chi_square > pair.chi_square_now
    assert f"{pair.deviations:.3g}" in out
    assert {r.source for r in plan.rivals} == {"fitted to the logs"}


def test_one_effect_is_told_from_none(case: Path) -> None:
    assert main(["plan", "usv.toml", *QUICK, "--between", "dry_friction", "--json", "plan.json"]) == 0
    plan = Plan.model_validate_json(Path("plan.json").read_text())
    assert plan.separations[0].pair == ("dry_friction", "none")
    assert plan.goal == "separate"


def _diagnosis(**changes: object) -> str:
    content = {
        "schema_id": "undertow/diagnosis/1",
        "vehicle": "usv",
        "signs": "sname",
        "verdict": "indistinguishable",
        "effects": ["ocean_current"],
        "ranking": [
            {"effect": "ocean_current", "significant": True, "parameters": [{"name": "V_E", "value": 0.2}]},
            {"effect": "constant_force", "significant": True, "parameters": [{"name": "X_0", "value": 0.3}]},
            {"effect": "lift", "significant": False, "parameters": []},
        ],
        "indistinguishable": [{"effects": ["ocean_current", "constant_force"], "reason": "alike"}],
        "parameters": [{"name": "X_u", "value": -0.7}, {"name": "V_E", "value": 0.2}],
        "something": "newer",
    }
    return json.dumps(content | changes)


def test_a_diagnosis_says_what_to_tell_apart(case: Path) -> None:
    Path("found.json").write_text(_diagnosis())
    assert main(["plan", "usv.toml", *QUICK, "--diagnosis", "found.json", "--json", "plan.json"]) == 0
    current, force = Plan.model_validate_json(Path("plan.json").read_text()).rivals
    assert (current.name, current.source) == ("ocean_current", "diagnosis")
    assert current.values == {"V_N": 0.0, "V_E": 0.2}
    assert force.values == {"X_0": 0.3, "Y_0": 0.0, "N_0": 0.0}


@pytest.mark.slow
def test_a_diagnosis_that_named_one_effect_is_asked_again(case: Path) -> None:
    Path("found.json").write_text(_diagnosis(indistinguishable=[], verdict="missing_effect"))
    assert main(["plan", "usv.toml", *QUICK, "--diagnosis", "found.json", "--json", "plan.json"]) == 0
    plan = Plan.model_validate_json(Path("plan.json").read_text())
    assert [r.name for r in plan.rivals] == ["ocean_current", "constant_force"]


REFUSED = {
    "no number": (["--limit", "much"], "'much' is not a number"),
    "no such command": (["--limit", "f9=1"], "'f9'"),
    "limit above the file's": (["--limit", "5"], "beyond its limit in the vehicle file, 2"),
    "limit of zero": (["--limit", "0"], "--limit"),
    "no such channel": (["--noise", "w=0.1"], "'w'"),
    "noise without a name": (["--noise", "0.1"], "NAME=VALUE"),
    "negative noise": (["--noise", "u=-1"], "u = -1"),
    "no velocity": (["--noise", "u=none"], "velocities"),
    "no time": (["--duration", "0"], "0 s"),
    "too short": (["--duration", "1"], "samples"),
    "no room": (["--max-speed", "0"], "--max-speed 0"),
    "no such parameter": (["--only", "Z_w"], "'Z_w'"),
    "no such effect": (["--between", "ocean_curent,lift"], "did you mean 'ocean_current'"),
    "an effect that is there": (["--between", "linear_damping,lift"], "adds no parameter"),
    "goal without models": (["--goal", "separate"], "--between"),
    "goal without a name": (["--goal", "separate", "--between", " ,"], "--goal separate needs the effects"),
    "models without the goal": (["--goal", "parameters", "--between", "lift"], "--goal separate"),
    "two sources of models": (["--between", "lift", "--diagnosis", "found.json"], "give only one"),
    "parameters and models": (["--between", "lift", "--only", "X_u"], "--only"),
    "no diagnosis": (["--diagnosis", "usv.toml"], "is not a diagnosis"),
    "a missing diagnosis": (["--diagnosis", "nothing.json"], "nothing.json"),
    "output over an input": (["--out", "usv.toml"], "usv.toml"),
    "the same output twice": (["--out", "plan.x", "--json", "plan.x"], "plan.x"),
    "a folder that is not there": (["--picture", "nowhere/plan.png"], "nowhere"),
}


@pytest.mark.parametrize("fault", REFUSED)
def test_bad_input_is_refused(fault: str, case: Path, capsys: Capture) -> None:
    (case / "found.json").write_text(_diagnosis())
    options, words = REFUSED[fault]
    given = QUICK if "--duration" not in options else QUICK[2:]
    line = refusal(["plan", "usv.toml", *given, *options], capsys, case)
    assert words in line, line


def test_the_diagnosis_of_another_vehicle_is_refused(case: Path, capsys: Capture) -> None:
    (case / "found.json").write_text(_diagnosis(vehicle="auv"))
    line = refusal(["plan", "usv.toml", *QUICK, "--diagnosis", "found.json"], capsys, case)
    assert "'auv'" in line


def test_an_adequate_model_leaves_nothing_to_tell_apart(case: Path, capsys: Capture) -> None:
    nothing: dict[str, object] = {
        "effects": [],
        "ranking": [],
        "indistinguishable": [],
        "verdict": "adequate",
    }
    (case / "found.json").write_text(_diagnosis(**nothing))
    line = refusal(["plan", "usv.toml", *QUICK, "--diagnosis", "found.json"], capsys, case)
    assert "adequate" in line


def test_a_vehicle_without_limits_needs_some(case: Path, capsys: Capture) -> None:
    line = refusal(["plan", "mini-auv", *QUICK], capsys, case)
    assert "--limit f1=VALUE" in line


def test_nothing_to_estimate_is_refused(case: Path, capsys: Capture) -> None:
    text = (case / "usv.toml").read_text().replace("estimate = true", "estimate = false")
    (case / "known.toml").write_text(text)
    line = refusal(["plan", "known.toml", *QUICK], capsys, case)
    assert "no parameter of 'usv' is marked for estimation" in line
