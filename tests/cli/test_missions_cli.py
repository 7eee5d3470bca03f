"""Missions in commands: simulate --path, gains --path and export c --path; what they write and refuse."""

from __future__ import annotations

import json
import shutil
from importlib import resources
from pathlib import Path

import pytest

from tests.cli.bad import refusal
from undertow.cli.main import main

Capture = pytest.CaptureFixture[str]
EXAMPLES = Path(__file__).parents[2] / "examples" / "missions"
MISSION = """\
schema = "undertow/mission/1"
name = "square"
kind = "{kind}"
speed = "0.3 m/s"
[[waypoints]]
x = "0 m"
[[waypoints]]
x = "{x}"
y = "2 m"
"""
GAINS = """\
schema = "undertow/gains/1"
name = "ship"
law = "pd"
[gains]
K_P = 20.0
K_V = 30.0
[schedule]
order = "{order}"
"""


@pytest.fixture
def here(here: Path) -> Path:
    """A folder, the current one, with a mission and gains."""
    Path("m.toml").write_text(MISSION.format(kind="setpoints", x="4 m"))
    Path("g.toml").write_text(GAINS.format(order="together"))
    return here


def test_a_mission_is_simulated_and_told(here: Path, capsys: Capture) -> None:
    words = ["simulate", "cybership2", "g.toml", "--path", "m.toml", "--dt", "0.05"]
    assert main([*words, "--json", "r.json", "--out", "log.csv", "--figures", "figures"]) == 0
    said = capsys.readouterr().out
    (result,) = json.loads((here / "r.json").read_text())
    followed = result["followed"]
    assert f"its end is reached after {followed['arrived']:.4g} s" in said
    assert all(error["largest"] < 0.02 for error in followed["errors"])
    assert result["duration"] == pytest.approx(1.1 * followed["arrived"] + 5, abs=0.1)
    assert sorted(p.name for p in Path("figures").iterdir()) == ["commands.png", "errors.png", "track.png"]
    assert Path("log.csv").read_text().startswith("t,x,y,psi,u,v,r,")


def test_legs_within_the_acceptance_are_said_to_be_none(here: Path, capsys: Capture) -> None:
    """A way of sqrt(5) m, and an acceptance of 3 m: the mission ends before it begins."""
    Path("near.toml").write_text(MISSION.format(kind="legs", x="1 m"))
    assert main(["simulate", "cybership2", "g.toml", "--path", "near.toml", "--dt", "0.05"]) == 0
    assert "reached at the start: the way is shorter than [guidance] acceptance" in capsys.readouterr().out


def test_the_conditions_on_a_mission_are_reported(here: Path, capsys: Capture) -> None:
    # Cubic drag in surge is straight in u^2, whose ends are known.
    assert main(["gains", "cybership2", "g.toml", "--path", "m.toml"]) == 0
    assert "K_V + D_q(nu) ≻ 0: holds" in capsys.readouterr().out
    ship = (resources.files("undertow") / "vehicles" / "cybership2.toml").read_text()
    both_ways = 'X_udot = { forward = "-2.0 kg", backward = "-1.5 kg", '
    Path("ship.toml").write_text(ship.replace('X_udot = { value = "-2.0 kg", ', both_ways))
    assert main(["gains", "ship.toml", "g.toml", "--path", "m.toml"]) == 1
    assert "not proved" in capsys.readouterr().out


@pytest.mark.slow
def test_the_conditions_on_a_mission_hold_and_are_reported_in_json(here: Path, capsys: Capture) -> None:
    for name in ("bluerov2-gains.toml", "bluerov2-spline.toml"):
        shutil.copy(EXAMPLES / name, here)
    words = ["gains", "bluerov2", "bluerov2-gains.toml", "--path", "bluerov2-spline.toml", "--json"]
    assert main(words) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["schema"] == "undertow/mission-report/2"
    assert [r["verdict"] for r in found["rows"]] == ["holds"] * 3


def test_a_controller_for_a_mission_is_written(here: Path, capsys: Capture) -> None:
    words = ["export", "c", "cybership2", "--controller", "g.toml", "--path", "m.toml", "--out", "out"]
    assert main(words) == 0
    header = next(Path("out").rglob("cybership2_ship.h")).read_text()
    assert "extern const cybership2_ship_mission cybership2_ship_mission_default;" in header
    assert "mission_time" in header
    assert main([*words, "--check"]) == 0
    assert main([*words[:5], "--out", "out", "--check"]) == 1  # the one without a mission is another one


SHIP = ["simulate", "cybership2", "g.toml"]
BAD = {
    "neither": (SHIP, ["--to X,Y,Z"]),
    "both": ([*SHIP, "--to", "1,1", "--path", "m.toml"], ["give either a set-point"]),
    "no file": ([*SHIP, "--path", "none.toml"], ["mission 'none.toml' is not a file"]),
    "another file": ([*SHIP, "--path", "g.toml"], ["g.toml"]),
    "a kind": ([*SHIP, "--path", "kind.toml"], ["kind", "legs"]),
    "a unit": ([*SHIP, "--path", "unit.toml"], ["unit.toml: way-point 2 x", "kg"]),
    "turns": (["simulate", "cybership2", "turns.toml", "--path", "m.toml"], ["order", "--order together"]),
    "legs without sampling": ([*SHIP, "--path", "legs.toml", "--continuous"], ["leave out --continuous"]),
    "an observer on legs": (
        ["gains", "cybership2", "g.toml", "--path", "m.toml", "--observer", "o.toml"],
        ["--observer o.toml", "true states", "simulate"],
    ),
    "code without a law": (["export", "c", "cybership2", "--path", "m.toml"], ["give --controller GAINS"]),
}


@pytest.mark.parametrize("fault", BAD)
def test_what_cannot_be_followed_is_refused(fault: str, here: Path, capsys: Capture) -> None:
    Path("kind.toml").write_text(MISSION.format(kind="leg", x="4 m"))
    Path("unit.toml").write_text(MISSION.format(kind="legs", x="4 kg"))
    Path("legs.toml").write_text(MISSION.format(kind="legs", x="4 m"))
    Path("turns.toml").write_text(GAINS.format(order="yaw-first"))
    words, expected = BAD[fault]
    line = refusal(words, capsys, here)
    for part in expected:
        assert part in line
