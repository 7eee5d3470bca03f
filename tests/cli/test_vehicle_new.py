"""`undertow vehicle new` on the command line, and the drag and added mass behind it."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from benchmarks.shape.hulls import box_mesh, spheroid_mesh, stl
from tests.cli.bad import refusal
from tests.identification.test_panels import BOX, needs_capytaine
from undertow.cli.main import main
from undertow.codegen.functions import Functions
from undertow.codegen.library import Library
from undertow.codegen.simulate import Simulator
from undertow.model.loading import load_vehicle
from undertow.model.plausibility import hints, mass_matrix_at
from undertow.model.vehicle import Vehicle
from undertow.shape.bodies import ellipsoid, equivalent, transformed
from undertow.shape.hull_vehicle import HullRules, drag_of_hull

Capture = pytest.CaptureFixture[str]
MESH = ["vehicle", "new", "--mesh", "box.stl", "--unit", "mm", "--mass", "60"]


# vehicle new ------------------------------------------------------------------------------------------------


def made(hulls: Path, *words: str) -> Vehicle:
    assert main([*MESH, "--out", "my.toml", *words]) == 0
    return load_vehicle(hulls / "my.toml")


def test_a_first_vehicle_without_the_extra(no_extra: None, hulls: Path, capsys: Capture) -> None:
    vehicle = made(hulls, "--cg", "0,0,0.02")
    out = capsys.readouterr().out
    assert "hull 0.6 x 0.42 x 0.24 m, 0.06048 m^3; displaces 60.48 kg, weighs 60 kg" in out
    assert 'pip install "undertow[bem]"' in out
    found = {name: value.value for name, value in vehicle.values.items()}
    assert found["m"] == 60.0
    assert found["mz_g"] == pytest.approx(1.2)
    assert found["I_x"] == pytest.approx(60 / 12 * (0.42**2 + 0.24**2) + 60 * 0.02**2, rel=1e-4)
    assert found["I_z"] == pytest.approx(60 / 12 * (0.60**2 + 0.42**2), rel=1e-4)
    names = ("X_udot", "Y_vdot", "Z_wdot", "K_pdot", "M_qdot", "N_rdot")
    np.testing.assert_allclose([-found[n] for n in names], BOX, rtol=0.01)
    assert found["X_uabsu"] == pytest.approx(-500 * 1.05 * 0.42 * 0.24, rel=1e-4)
    assert found["W"] == pytest.approx(60 * 9.81)
    assert found["B"] == pytest.approx(60.48 * 9.81, rel=1e-5)
    assert found["S_z"] == pytest.approx(0.02 * 60 * 9.81, rel=1e-5)


def test_every_value_has_a_source_and_what_is_uncertain_a_sigma(no_extra: None, hulls: Path) -> None:
    vehicle = made(hulls)
    for name, value in vehicle.values.items():
        assert value.source, name
        assert (value.sigma is not None) == (name[:2] not in {"m", "mx", "my", "mz", "W", "S_"}), name
    free = {n for n, v in vehicle.values.items() if v.estimate}
    assert {"X_udot", "X_u", "X_uabsu", "B"} <= free
    assert not {"m", "I_x", "I_z", "W"} & free
    (only,) = hints(vehicle)
    assert only.startswith("assumed, without a source: I_x")


def test_the_first_vehicle_is_shown_generated_and_simulated(
    no_extra: None, hulls: Path, capsys: Capture
) -> None:
    vehicle = made(hulls, "--cg", "0,0,0.02")
    assert main(["vehicles", "show", "my.toml"]) == 0
    assert "added_mass" in capsys.readouterr().out
    assert Library(vehicle).write(hulls / "build").folder.is_dir()
    heeled = np.zeros(12)
    heeled[3] = 0.2
    x = simulated(vehicle, heeled, np.zeros(6))
    assert np.abs(x[0, 3]) == 0.2
    assert np.max(np.abs(x[-50:, 3])) < 0.05  # it rights itself
    # Ahead, at the speed where drag is 10 N.
    ahead = made(hulls, "--dof", "surge", "--force")
    u = np.roots([52.92, 5.292, -10.0]).max()
    assert simulated(ahead, np.zeros(2), np.array([10.0]))[-1, 1] == pytest.approx(u, rel=1e-3)


def simulated(vehicle: Vehicle, start: np.ndarray, force: np.ndarray) -> np.ndarray:
    """States over 60 s under a steady force."""
    functions = Functions(vehicle)
    p = np.array([vehicle.value_of(n).value for n in functions.parameter_names])
    t = np.linspace(0.0, 60.0, 301)
    return Simulator(functions, compiled=False).run(start, t, np.tile(force, (len(t), 1)), p, max_step=0.05)


@pytest.mark.slow
def test_a_mesh_in_other_axes_about_another_point(no_extra: None, hulls: Path) -> None:
    stl(box_mesh().moved([1.0, 0.5, 0.3]), hulls / "off.stl")
    words = ["vehicle", "new", "--mesh", "off.stl", "--frame", "FLU", "--mass", "60", "--out", "my.toml"]
    assert main([*words, "--origin", "mesh", "--cg", "1,-0.5,-0.28"]) == 0
    about_mesh = load_vehicle("my.toml")
    stated = tomllib.loads((hulls / "my.toml").read_text())["effects"]["restoring"]
    place = [float(stated[f"{axis}_b"]["value"].removesuffix(" m")) for axis in "xyz"]
    np.testing.assert_allclose(place, [1.0, -0.5, -0.3], rtol=1e-5)
    assert main([*words, "--cg", "0,0,0.02", "--force"]) == 0
    about_buoyancy = np.array(mass_matrix_at(load_vehicle("my.toml")))
    expected = transformed(about_buoyancy, np.eye(3), [1.0, -0.5, -0.3])
    np.testing.assert_allclose(np.array(mass_matrix_at(about_mesh)), expected, rtol=1e-3, atol=0.01)


def test_motions_name_volume_and_coefficients(no_extra: None, hulls: Path, capsys: Capture) -> None:
    words = ["--dof", "yaw,surge,sway", "--name", "open frame", "--volume", "0.06", "--cd", "0.5,1,1"]
    vehicle = made(hulls, *words)
    assert vehicle.degrees_of_freedom == ("surge", "sway", "yaw")
    assert vehicle.force_channels == ("tau_X", "tau_Y", "tau_N")
    assert vehicle.name == "open frame"
    assert vehicle.value_of("m_w").value == pytest.approx(0.48, rel=1e-4)
    assert vehicle.value_of("X_uabsu").value == pytest.approx(-500 * 0.5 * 0.42 * 0.24, rel=1e-4)
    assert "restoring" not in {e.id for e in vehicle.effects}
    assert capsys.readouterr().err == ""


def test_a_mass_far_from_the_displacement_is_reported(no_extra: None, hulls: Path, capsys: Capture) -> None:
    assert main(["vehicle", "new", "--mesh", "box.stl", "--unit", "mm", "--mass", "12"]) == 0
    err = capsys.readouterr().err
    assert "mass 12 kg and displacement 60.48 kg are far apart" in err
    assert (hulls / "box.toml").is_file()


@pytest.mark.slow
@needs_capytaine
def test_with_the_extra_the_hull_itself_is_computed(hulls: Path) -> None:
    words = ["--mesh", "spheroid.stl", "--mass", "100", "--out", "my.toml", "--panels", "1600"]
    assert main(["vehicle", "new", *words]) == 0
    vehicle = load_vehicle("my.toml")
    lamb = np.diag(ellipsoid(0.6, 0.2, 0.2).matrix)
    found = np.array([-vehicle.value_of(n).value for n in ("X_udot", "Y_vdot", "M_qdot")])
    np.testing.assert_allclose(found, lamb[[0, 1, 4]], rtol=0.01)
    assert "capytaine" in vehicle.value_of("X_udot").source
    assert vehicle.value_of("X_udot").sigma == pytest.approx(0.1 * lamb[0], rel=0.05)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--mass", "0"], "mass = 0 kg is impossible"),
        (["--mass", "nan"], "mass = nan kg is impossible"),
        (["--density", "-1"], "density = -1"),
        (["--volume", "1"], "volume = 1 m^3 is impossible: the hull encloses 0.06048 m^3"),
        (["--dof", "surge,jaw"], "degrees of freedom: found 'jaw'"),
        (["--cg", "1"], "--cg '1' is not three numbers"),
        (["--cd", "a,b,c"], "--cd 'a,b,c' is not three numbers"),
        (["--cd", "1,-1,1"], "drag coefficient -1 is impossible"),
        (["--frame", "FLD"], "is not a right-handed set of axes"),
        (["--out", "box.stl"], "output 'box.stl' is the input"),
        (["--out", "spheroid.stl"], "'spheroid.stl' exists already"),
        (["--name", "a\nb"], "a name must be printable"),
        (["--added-mass", "panels", "--panels", "5"], "5 panels are out of reach"),
    ],
)
def test_one_line_for_each_wrong_wish(words: list[str], message: str, hulls: Path, capsys: Capture) -> None:
    if "panels" in words:
        pytest.importorskip("capytaine", reason="needs undertow[bem]")
    base = [*MESH, "--added-mass", "box"] if "--added-mass" not in words else MESH
    assert message in refusal([*base, *words], capsys, hulls)


# drag, bodies in place of hulls -----------------------------------------------------------------------------


def test_drag_of_a_box_by_strips(monkeypatch: pytest.MonkeyPatch) -> None:
    a, b, c = 0.60, 0.42, 0.24
    with monkeypatch.context() as without_friction:
        without_friction.setattr("undertow.shape.hull_vehicle._RULES", HullRules(friction=0.0))
        found = drag_of_hull(box_mesh(), 1000.0, cd=(0.9, 1.0, 1.2))
    forces = 500 * np.array([0.9 * b * c, 1.0 * a * c, 1.2 * a * b])
    np.testing.assert_allclose(found.coefficients[:3], forces, rtol=1e-6)
    # Sides along the length, and the ends along the beam: integrals of |x|^3 and |y|^3.
    yaw = 500 * (1.0 * c * a**4 / 32 + 0.9 * c * b**4 / 32)
    with_friction = drag_of_hull(box_mesh(), 1000.0, cd=(0.9, 1.0, 1.2)).coefficients[5]
    assert found.coefficients[5] == pytest.approx(yaw, rel=0.005)
    assert yaw < with_friction < 1.1 * yaw


def test_a_body_of_revolution_spins_against_friction_only() -> None:
    hull = spheroid_mesh(1.2, 0.4, 4)
    found = drag_of_hull(hull)
    assert found.coefficients[3] < 0.01 * found.coefficients[4]
    assert found.coefficients[4] == pytest.approx(found.coefficients[5], rel=1e-3)
    assert "streamlined" in found.sources[0]
    assert "rounded" in found.sources[1]


def test_a_body_of_the_same_extents() -> None:
    hull = spheroid_mesh(1.2, 0.4, 4)
    np.testing.assert_allclose(
        equivalent(hull).matrix[:3, :3], ellipsoid(0.6, 0.2, 0.2).matrix[:3, :3], rtol=0.01
    )
    full = equivalent(box_mesh())
    np.testing.assert_allclose(np.diag(full.matrix), BOX, rtol=0.01)
    # An ellipsoid for a box is far off, and says so.
    wrong = equivalent(box_mesh(), form="ellipsoid")
    off = np.abs(np.diag(wrong.matrix) - BOX)
    assert off[0] > 0.5 * BOX[0]
    assert np.all(off < 1.02 * np.diag(wrong.error) + 0.01 * BOX)


@needs_capytaine
def test_what_cannot_float_is_refused_in_one_line(hulls: Path, capsys: Capture) -> None:
    cases = {
        "--wave 3,0.1,0 is for a hull at the surface: give --floating": ["--wave", "3,0.1,0"],
        "is not three numbers": ["--floating", "--wave", "3,0.1"],
        "a hull floats level where its weight is above": ["--floating", "--cg", "0.1,0,0"],
        "--volume 0.001 is for hulls under water": ["--floating", "--volume", "0.001"],
        "the frequency has to be positive": ["--floating", "--wave", "-3,0.1,0"],
        "it sinks": ["--floating", "--mass", "61"],
    }
    for line, more in cases.items():
        assert line in refusal([*MESH, "--out", "floating.toml", *more], capsys, hulls)
