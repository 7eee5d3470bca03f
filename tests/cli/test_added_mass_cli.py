"""`undertow added-mass` on the command line."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

from tests.cli.bad import refusal
from tests.identification.test_panels import BOX, needs_capytaine
from undertow.cli.main import main
from undertow.model.loading import load_vehicle
from undertow.shape.bodies import cylinder, ellipsoid, transformed

Capture = pytest.CaptureFixture[str]


def answer(capsys: Capture, *words: object) -> dict[str, object]:
    capsys.readouterr()
    assert main([*map(str, words), "--json"]) == 0
    found: dict[str, object] = json.loads(capsys.readouterr().out)
    return found


# added-mass -------------------------------------------------------------------------------------------------


def test_an_ellipsoid_in_any_direction_and_place(hulls: Path, capsys: Capture) -> None:
    words = ["added-mass", "ellipsoid", "--a", 0.6, "--b", 0.3, "--c", 0.2, "--density", 1025]
    found = answer(capsys, *words, "--turn", "0,90,0", "--at", "0,0,0.5")
    # Nose up: the body's x points up, its z forward.
    turn = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    expected = transformed(ellipsoid(0.6, 0.3, 0.2, 1025.0).matrix, turn, [0.0, 0.0, 0.5])
    np.testing.assert_allclose(np.array(found["matrix"]), expected, atol=1e-9)
    assert "Lamb" in str(found["source"])


@pytest.mark.parametrize("turn", ["0,0,90", "0,0,-90", "30,180,90"])
def test_a_cylinder_across(turn: str, hulls: Path, capsys: Capture) -> None:
    found = np.array(
        answer(capsys, "added-mass", "cylinder", "--length", 2, "--diameter", 0.2, "--turn", turn)["matrix"]
    )
    own = np.diag(cylinder(2.0, 0.2).matrix)
    np.testing.assert_allclose(np.diag(found), own[[1, 0, 2, 4, 3, 5]], atol=1e-9)


def test_what_is_printed_names_the_derivatives(hulls: Path, capsys: Capture) -> None:
    assert main(["added-mass", "box", "--length", "0.6", "--beam", "0.42", "--height", "0.24"]) == 0
    out = capsys.readouterr().out
    rows = {line.split()[0]: line.split()[1:] for line in out.splitlines() if line.startswith("-")}
    assert float(rows["-Z_wdot"][0]) == pytest.approx(BOX[2], rel=0.01)
    assert rows["-N_rdot"][3:] == ["kg", "m^2"]
    assert "source: box of 0.6 x 0.42 x 0.24 m; table" in out
    assert "limits: sharp edges" in out


def test_into_a_vehicle_as_priors(hulls: Path, capsys: Capture) -> None:
    words = ["added-mass", "spheroid", "--length", "1.2", "--diameter", "0.4", "--at", "0.1,0,0"]
    assert main([*words, "--into", "mini-auv", "--out", "new.toml"]) == 0
    new, old = load_vehicle("new.toml"), load_vehicle("mini-auv")
    lamb = transformed(ellipsoid(0.6, 0.2, 0.2).matrix, np.eye(3), [0.1, 0, 0])
    for name, i in (("X_udot_forward", 0), ("X_udot_backward", 0), ("Y_vdot", 1), ("N_rdot", 5)):
        value = new.value_of(name)
        assert value.value == pytest.approx(-lamb[i, i], rel=1e-9)
        assert value.sigma == pytest.approx(0.1 * lamb[i, i], rel=1e-6)
        assert (value.estimate, value.assumed) == (True, False)
        assert value.source.startswith("ellipsoid with semi-axes 0.6, 0.2, 0.2 m; Lamb")
    assert new.value_of("Y_rdot").value == pytest.approx(-lamb[1, 5], rel=1e-9)
    assert not new.value_of("Y_rdot").estimate
    # The file prints magnitudes.
    stated = tomllib.loads((hulls / "new.toml").read_text())
    assert float(stated["effects"]["added_mass"]["Y_vdot"]["value"].split()[0]) > 0
    assert stated["history"][-1]["command"] == "undertow added-mass"
    kept = set(old.values) - {"X_udot_forward", "X_udot_backward", "Z_wdot_forward", "Z_wdot_backward"}
    for name in kept - {"Y_vdot", "N_rdot"}:
        assert new.values[name] == old.values[name]


def test_a_spinning_sphere_leaves_nothing_to_be_estimated(hulls: Path) -> None:
    words = ["added-mass", "sphere", "--diameter", "0.5", "--into", "bluerov2", "--out", "new.toml"]
    assert main(words) == 0
    spin = load_vehicle("new.toml").value_of("K_pdot")
    assert (spin.value, spin.estimate, spin.sigma) == (0.0, False, None)


def test_in_place_twice_is_the_same(hulls: Path) -> None:
    assert main(["added-mass", "sphere", "--diameter", "0.5", "--into", "bluerov2", "--out", "a.toml"]) == 0
    words = ["added-mass", "sphere", "--diameter", "0.4", "--into", "a.toml", "--in-place"]
    assert main(words) == 0
    first = load_vehicle("a.toml")
    assert main(words) == 0
    assert dict(load_vehicle("a.toml").values) == dict(first.values)


@needs_capytaine
def test_a_mesh_by_panels(hulls: Path, capsys: Capture) -> None:
    found = answer(capsys, "added-mass", "mesh", "box.stl", "--unit", "mm", "--panels", 800)
    np.testing.assert_allclose(np.diag(np.array(found["matrix"])), BOX, rtol=0.02)
    assert np.all(np.array(found["sigma"]) >= np.array(found["error"]))
    assert str(found["source"]).startswith("box.stl; capytaine")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["sphere", "--diameter", "-1"], "diameter = -1 must be a positive number"),
        (["sphere", "--diameter", "1", "--at", "1,2"], "--at '1,2' is not three numbers"),
        (["sphere", "--diameter", "1", "--at", "1,2,inf"], "every number must be finite"),
        (["sphere", "--diameter", "1", "--density", "0"], "density = 0 must be a positive number"),
        (["sphere", "--diameter", "1", "--out", "x.toml"], "--out and --in-place are for --into VEHICLE"),
        (["sphere", "--diameter", "1", "--sigma", "-1"], "--sigma -1 is not a share"),
        (["sphere", "--diameter", "1", "--sigma", "0"], "--sigma 0 is not a share: give a number above 0"),
        (["sphere", "--diameter", "1", "--sigma", "nan"], "--sigma nan is not a share"),
        (["sphere", "--diameter", "1", "--into", "none.toml"], "neither a file nor a bundled vehicle"),
        (["sphere", "--diameter", "1", "--into", "mini-auv", "--in-place"], "is bundled with undertow"),
        (["cylinder", "--length", "1", "--diameter", "1"], "strips need 5"),
        (["box", "--length", "9", "--beam", "1", "--height", "1"], "the table ends at 5.66"),
        (["mesh", "none.stl"], "none.stl: cannot be read"),
        (["mesh", "box.stl"], "600 x 420 x 240 m is an unlikely hull size"),
    ],
)
def test_one_line_for_each_mistake(words: list[str], message: str, hulls: Path, capsys: Capture) -> None:
    assert message in refusal(["added-mass", *words], capsys, hulls)


@pytest.mark.parametrize("out", ["box.stl", "link.stl"])
def test_the_hull_is_not_written_over(out: str, hulls: Path, capsys: Capture) -> None:
    (hulls / "link.stl").symlink_to(hulls / "box.stl")
    words = ["mesh", "box.stl", "--unit", "mm", "--into", "mini-auv", "--out", out]
    assert f"output '{out}' is the input 'box.stl'" in refusal(["added-mass", *words], capsys, hulls)


def test_without_the_extra_it_is_said_what_to_install(no_extra: None, hulls: Path, capsys: Capture) -> None:
    line = refusal(["added-mass", "mesh", "spheroid.stl"], capsys, hulls)
    assert line.endswith('pip install "undertow[bem]"')
    line = refusal(
        ["vehicle", "new", "--mesh", "spheroid.stl", "--mass", "98", "--added-mass", "panels"], capsys, hulls
    )
    assert line.endswith('pip install "undertow[bem]"')
