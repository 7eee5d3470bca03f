"""`undertow tank` on the command line, with a stand-in for the solver."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.shape.hulls import box_mesh, stl
from tests.cli.bad import refusal
from tests.tank.stand_ins import ADDED, stand_ins
from undertow.cli.main import main
from undertow.model.loading import load_vehicle
from undertow.shape.mesh import Mesh

Capture = pytest.CaptureFixture[str]
NEW = ["tank", "new", "box.stl", "--mass", "60.48", "--prescribed", "--grids", "2"]


@pytest.fixture
def hull(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    stl(box_mesh((0.60, 0.42, 0.24)), tmp_path / "box.stl")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_from_a_hull_to_a_vehicle_file(hull: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    monkeypatch.setenv("PATH", f"{stand_ins(hull / 'bin', copies=4)}:/usr/bin:/bin")
    assert main(NEW) == 0
    said = capsys.readouterr().out
    assert "hull 0.6 x 0.42 x 0.24 m, displaces 60.48 kg, weighs 60.48 kg" in said
    assert "then: undertow tank run tank" in said
    assert main(["tank", "run", "tank", "--grids", "2", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert len(answer["written"]) == 4
    assert {c["name"] for c in answer["coefficients"]} == {"X_udot", "X_u", "X_uabsu"}
    assert main(["tank", "run", "tank"]) == 0
    out = capsys.readouterr().out
    assert "nothing left to compute" in out
    assert "-X_udot" in out
    assert main(["vehicle", "new", "--tank", "tank", "--out", "my.toml"]) == 0
    assert load_vehicle("my.toml").values["X_udot"].value == pytest.approx(-ADDED, rel=0.02)
    # Of a mesh the motions that were tested come from the tank, the others from the shape.
    words = [
        "vehicle",
        "new",
        "--mesh",
        "box.stl",
        "--mass",
        "60.48",
        "--tank",
        "tank",
        "--added-mass",
        "box",
    ]
    assert main([*words, "--dof", "surge,heave", "--out", "both.toml"]) == 0
    both = load_vehicle("both.toml").values
    assert both["X_udot"].value == load_vehicle("my.toml").values["X_udot"].value
    assert both["Z_wdot"].value == pytest.approx(-74.6, rel=0.02)
    assert "leave out --origin mesh" in refusal(
        [*words, "--origin", "mesh", "--out", "no.toml"], capsys, hull
    )
    stl(box_mesh((0.61, 0.42, 0.24)), hull / "other.stl")
    words[3] = "other.stl"
    assert "made with a different hull (box.stl)" in refusal([*words, "--out", "no.toml"], capsys, hull)
    # A log of the tank is a log as any other.
    logs = hull / "tank" / "logs"
    words = ["fit", "my.toml", logs / "surge-step-grid1.csv", "--map", logs / "surge-step-grid1.toml"]
    assert main([str(w) for w in words]) == 0
    assert "X_uabsu" in capsys.readouterr().out
    line = refusal(NEW, capsys, hull)
    assert "tank with logs: choose another folder" in line


def test_layers_on_part_of_the_hull_are_told(
    hull: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    """What snappyHexMesh prints of its layers: faces, layers on average, thickness in m and %."""
    programs = stand_ins(hull / "bin", copies=4)
    monkeypatch.setenv("PATH", f"{programs}:/usr/bin:/bin")
    table = "patch faces    layers   overall thickness\nhull 656      10.3     0.00691   83      "
    (programs / "snappyHexMesh").write_text(f"#!/bin/sh\necho '{table}\n\n  cells: 1234'\n")
    assert main(NEW) == 0
    capsys.readouterr()
    assert main(["tank", "run", "tank"]) == 0
    (line,) = capsys.readouterr().err.splitlines()  # a push has no layers
    assert "surge-step, grid 1: layers cover 83% of the hull, less than 95%" in line
    assert "inner corners" in line
    assert main(["tank", "run", "tank"]) == 0  # also when all is there
    assert "layers cover 83%" in capsys.readouterr().err


def test_a_hole_is_refused(hull: Path, capsys: Capture) -> None:
    box = box_mesh((0.60, 0.42, 0.24))
    stl(Mesh(box.vertices, box.faces[:-1]), hull / "box.stl")
    assert "box.stl: the hull is open: 3 edges" in refusal(NEW, capsys, hull)
    assert not (hull / "tank").exists()


def test_refusals_are_one_line(hull: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    assert "profile paper is a series of forces" in refusal([*NEW, "--profile", "paper"], capsys, hull)
    assert "neither paper, step, sine, push nor a CSV file" in refusal(
        [*NEW, "--profile", "stairs"], capsys, hull
    )
    assert "choose from surge" in refusal([*NEW, "--motion", "sideways"], capsys, hull)
    assert "speed = -1 m/s: give a positive number" in refusal([*NEW, "--speed", "-1"], capsys, hull)
    assert "no towing tank" in refusal(["tank", "run", "tank"], capsys, hull)
    assert main(NEW) == 0
    assert "is a tank already" in refusal(NEW, capsys, hull)
    assert main([*NEW, "--force"]) == 0
    assert "tank has 2" in refusal(["tank", "run", "tank", "--grids", "3"], capsys, hull)
    assert "nothing to draw yet" in refusal(["tank", "look", "tank"], capsys, hull)
    assert "did you mean 'surge-push'" in refusal(
        ["tank", "look", "tank", "--case", "surge-pusk"], capsys, hull
    )
    assert "no logs yet" in refusal(["vehicle", "new", "--tank", "tank"], capsys, hull)
    monkeypatch.setenv("PATH", str(hull))
    line = refusal(["tank", "run", "tank"], capsys, hull)
    assert "OpenFOAM is not installed" in line
    assert "apt-get install openfoam" in line
