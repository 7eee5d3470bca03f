"""`undertow add`: one effect into a vehicle file, judged on validation data."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

from benchmarks.hidden_effects import Case
from undertow.cli.main import main
from undertow.model.loading import load_vehicle
from undertow.model.parameter import printed

from .bad import contents

Capture = pytest.CaptureFixture[str]
LOGS = ["train.csv", "--validation", "holdout.csv"]


#: Friction that is not there: to the last digit of the logs, its fit ends in one of two minima.
_NO_HELP = (
    r"Adding dry_friction .* the 5-s error.*(it has to fall by 10%|does not improve predictions enough)"
)


def add(effect: str, *words: str) -> int:
    return main(["add", effect, "usv.toml", *LOGS, "--no-codegen", *words])


def test_the_current_goes_into_a_new_file(case: Path, simulated: Case, capsys: Capture) -> None:
    before = (case / "usv.toml").read_bytes()
    words = ["--out", "new.toml", "--picture", "fall.png", "--json", "new.json", "--build", "code"]
    assert main(["add", "ocean_current", "usv.toml", *LOGS, *words]) == 0
    out = capsys.readouterr().out
    written = json.loads((case / "new.json").read_text())
    assert written["schema_id"] == "undertow/addition/1"
    assert out.splitlines()[0] == written["sentence"]
    assert written["steps"][2]["ahead"]["5 s"] < 0.3 * written["steps"][1]["ahead"]["5 s"]
    assert "model as given" in out
    assert "wrote new.toml" in out
    assert (case / "usv.toml").read_bytes() == before, "the file it came from stays as it is"
    assert (case / "fall.png").read_bytes().startswith(b"\x89PNG")
    vehicle = load_vehicle(case / "new.toml")
    for name, value in simulated.truth["values"]["ocean_current"].items():
        found = vehicle.value_of(name)
        assert found.estimate
        assert found.sigma is not None
        assert abs(found.value - value) < max(5 * found.sigma, 0.02 * abs(value)), name
    _assert_told_how(tomllib.loads((case / "new.toml").read_text(encoding="utf-8"))["history"])
    assert "wrote the code in" in out
    name = vehicle.name
    assert "V_N" in (case / "code" / name / f"src/{name}_vehicle.h").read_text(encoding="utf-8")
    assert main(["export", "c", "new.toml", "--check", "--out", "code"]) == 0


def _assert_told_how(reported: list[dict[str, Any]]) -> None:
    """The file says how its values came about."""
    (history,) = reported
    assert history["added"] == ["ocean_current"]
    assert history["helps"] is True
    assert [(log["name"], log["role"]) for log in history["logs"]] == [
        ("train", "train"),
        ("holdout", "holdout"),
    ]
    assert history["error_after"] < 0.3 * history["error_before"]
    assert {"V_N", "V_E"} <= set(history["covariance"]["parameters"])


@pytest.mark.slow
def test_without_a_target_nothing_is_written(case: Path, capsys: Capture) -> None:
    before = contents(case)
    assert add("ocean_current") == 0
    assert "nothing was written: --out NEW.toml or --in-place" in capsys.readouterr().out
    assert contents(case) == before


@pytest.mark.slow
def test_in_place_changes_the_file_itself(case: Path) -> None:
    before = contents(case)
    assert add("ocean_current", "--in-place") == 0
    after = contents(case)
    assert set(after) == set(before)
    assert {name for name in after if after[name] != before[name]} == {str(case / "usv.toml")}
    assert any(e.id == "ocean_current" for e in load_vehicle(case / "usv.toml").effects)
    assert add("ocean_current", "--out", "again.toml") == 2, "there is nothing left to add"


def test_what_does_not_help_is_not_written(case: Path, capsys: Capture) -> None:
    before = contents(case)
    assert add("dry_friction", "--out", "new.toml") == 1
    out, err = capsys.readouterr()
    assert re.search(_NO_HELP, out)
    assert err.splitlines() == ["dry_friction is not added to the vehicle file; --force writes it anyway"]
    assert contents(case) == before


@pytest.mark.slow
def test_what_does_not_help_is_written_by_force_and_said_so(case: Path, capsys: Capture) -> None:
    assert add("dry_friction", "--out", "new.toml", "--force") == 0
    assert re.search(_NO_HELP, capsys.readouterr().out)
    table = tomllib.loads((case / "new.toml").read_text(encoding="utf-8"))
    assert "dry_friction" in table["effects"]
    assert table["history"][0]["helps"] is False


def test_values_are_said_in_the_signs_of_the_vehicle_file(quick: Path, capsys: Capture) -> None:
    """As diagnose says them, and as they are written: positive magnitudes here."""
    text = (quick / "usv.toml").read_text().replace('"sname"', '"magnitudes"').replace("-25", "25")
    (quick / "usv.toml").write_text(text)
    words = ["--no-codegen", "--all", "--force", "--out", "new.toml"]
    assert main(["add", "cubic_damping", "usv.toml", "train.csv", *words]) == 0
    said = float(re.search(r"X_uuu = (\S+)", capsys.readouterr().out)[1])  # type: ignore[index]
    vehicle = load_vehicle(quick / "new.toml")
    declared = vehicle.declaration("X_uuu")
    written = printed(declared, vehicle.value_of("X_uuu").value, vehicle.signs)
    assert said == pytest.approx(written, rel=1e-3)
    assert said * vehicle.value_of("X_uuu").value < 0.0


def test_a_value_at_its_bound_is_said(quick: Path, capsys: Capture) -> None:
    log = "train.csv"
    assert main(["add", "dry_friction", "usv.toml", log, "--no-codegen", "--all", "--force"]) == 0
    assert "X_signu at its bound 0" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("effect", "words", "message"),
    [
        ("ocean_curent", [], "did you mean 'ocean_current'?"),
        ("thrusters", [], "part of every vehicle"),
        ("ocean_current", ["--out", "usv.toml"], "usv.toml"),
        ("ocean_current", ["--out", "new.toml", "--in-place"], "choose one"),
        ("ocean_current", ["--out", "nowhere/new.toml"], "nowhere"),
    ],
)
def test_a_mistake_is_one_line(
    case: Path, capsys: Capture, effect: str, words: list[str], message: str
) -> None:
    before = contents(case)
    assert add(effect, *words) == 2
    err = capsys.readouterr().err
    assert message in err
    assert err.count("\n") == 1
    assert contents(case) == before


def test_a_bundled_vehicle_is_not_changed_in_place(capsys: Capture) -> None:
    assert main(["add", "ocean_current", "box-hull", "log.csv", "--in-place"]) == 2
    assert "is bundled with undertow" in capsys.readouterr().err


def test_several_effects_are_added_in_one_step(case: Path, capsys: Capture) -> None:
    assert add("ocean_current, linear_damping_coupling", "--out", "new.toml", "--all", "--force") == 0
    out = capsys.readouterr().out
    assert "Adding ocean_current and linear_damping_coupling lowers the" in out.replace("\n", " ")
    table = tomllib.loads((case / "new.toml").read_text(encoding="utf-8"))
    assert {"ocean_current", "linear_damping_coupling"} <= table["effects"].keys()
    assert table["history"][0]["added"] == ["ocean_current", "linear_damping_coupling"]
