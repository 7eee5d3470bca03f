"""Models for MuJoCo: the numbers of the file, and where MuJoCo is installed what it makes of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from tests.export.support import cross, force_of, rotation
from tests.quick import first_quick
from undertow.cli.main import main
from undertow.codegen import Functions
from undertow.export.mjcf import Mjcf
from undertow.model.loading import bundled_vehicles, load_vehicle
from undertow.model.vehicle import Value

FLIP = np.array([1.0, -1.0, -1.0, 1.0, -1.0, -1.0])
WHOLE = ["bluerov2", "remus100", "bluerov2-6"]


def _numbers(element: ET.Element, name: str) -> np.ndarray:
    return np.array(element.get(name).split(), float)


def _mass_matrix(root: ET.Element) -> np.ndarray:
    """Sum of the bodies of a file about the origin, forward-left-up."""
    total = np.zeros((6, 6))
    for inertial in root.iter("inertial"):
        m, r, j = float(inertial.get("mass")), _numbers(inertial, "pos"), _numbers(inertial, "fullinertia")
        about, s = np.array([[j[0], j[3], j[4]], [j[3], j[1], j[5]], [j[4], j[5], j[2]]]), cross(r)
        total += np.block([[m * np.eye(3), -m * s], [m * s, about - m * s @ s]])
    return total


@pytest.mark.parametrize("name", first_quick(WHOLE))
def test_the_bodies_of_the_file_are_the_rigid_body_of_the_model(name: str) -> None:
    vehicle = load_vehicle(name)
    ours = force_of(vehicle, {"rigid_body"})
    n = Functions(vehicle).x.numel()
    expected = -np.array([ours(np.zeros(n), row) for row in np.eye(6)]).T
    found = _mass_matrix(ET.fromstring(Mjcf(vehicle).text)) * np.outer(FLIP, FLIP)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", ["bluerov2", "otter"])
def test_motors_at_their_sites_have_the_wrench_of_the_thrusters(name: str) -> None:
    vehicle = load_vehicle(name)
    root = ET.fromstring(Mjcf(vehicle).text)
    for thruster in vehicle.thrusters:
        arm = _numbers(root.find(f".//site[@name='{thruster.name}']"), "pos")
        gear = _numbers(root.find(f".//motor[@name='{thruster.name}']"), "gear")
        wrench = np.concatenate([gear[:3], gear[3:] + np.cross(arm, gear[:3])])
        np.testing.assert_allclose(FLIP * wrench, thruster.wrench, atol=1e-12)


@pytest.mark.parametrize("name", first_quick(WHOLE))
def test_mujoco_has_the_mass_matrix_restoring_forces_and_thrust_of_the_model(name: str) -> None:
    mujoco = pytest.importorskip("mujoco")
    vehicle = load_vehicle(name)
    loaded = mujoco.MjModel.from_xml_string(Mjcf(vehicle).text)
    data = mujoco.MjData(loaded)
    ours = force_of(vehicle, {"restoring", "net_buoyancy"})
    mass, n = force_of(vehicle, {"rigid_body"}), Functions(vehicle).x.numel()
    rng = np.random.default_rng(5)
    for phi, theta, psi in rng.uniform(-1.2, 1.2, (8, 3)):
        turned = rotation(phi, -theta, -psi)  # forward-left-up to ENU: angles about y and z change sign
        mujoco.mju_mat2Quat(data.qpos[3:], turned.ravel())
        data.ctrl[:] = rng.uniform(-1, 1, loaded.nu)
        mujoco.mj_forward(loaded, data)
        x = np.array([0, 0, 0, phi, theta, psi, *np.zeros(n - 6)])
        static = _in_body(data.qfrc_passive - data.qfrc_bias, turned)
        # The mass is the model's; MuJoCo's float carries a millionth of it, so digits go with it.
        np.testing.assert_allclose(static, ours(x, np.zeros(6)), rtol=1e-7, atol=1e-6)
        thrust = np.array([t.wrench for t in vehicle.thrusters], float).T @ data.ctrl
        np.testing.assert_allclose(_in_body(data.qfrc_actuator, turned), thrust, atol=1e-9)
    data.qpos[3:] = [1, 0, 0, 0]
    mujoco.mj_forward(loaded, data)
    full = np.zeros((6, 6))
    for row, unit in zip(full, np.eye(6), strict=True):
        mujoco.mj_mulM(loaded, data, row, unit)
    expected = -np.array([mass(np.zeros(n), row) for row in np.eye(6)]).T
    np.testing.assert_allclose(full * np.outer(FLIP, FLIP), expected, rtol=1e-8, atol=1e-8)


def _in_body(force: np.ndarray, turned: np.ndarray) -> np.ndarray:
    """A force on a free joint (force in the world, moment in the body), forward-starboard-down."""
    return FLIP * np.concatenate([turned.T @ force[:3], force[3:]])


def test_a_vehicle_of_four_motions_has_four_joints() -> None:
    model = Mjcf(load_vehicle("mini-auv"))
    joints = ET.fromstring(model.text).findall(".//joint")
    assert [j.get("name") for j in joints] == ["surge", "sway", "heave", "yaw"]
    losses = "; ".join(model.losses)
    assert "added_mass is left out" in losses
    assert "nothing damps the motion" in losses
    assert "free in MuJoCo" not in losses
    assert "its curve is left out" in "; ".join(Mjcf(load_vehicle("kvlcc2")).losses)


@pytest.mark.parametrize("name", first_quick(bundled_vehicles()))
def test_the_command_writes_a_model_and_says_what_is_lost(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "model.xml"
    assert main(["export", "mujoco", name, "--out", str(target)]) == 0
    assert "warning:" in capsys.readouterr().out
    assert ET.parse(target).getroot().tag == "mujoco"


@pytest.mark.slow
def test_mujoco_reads_every_bundled_vehicle() -> None:
    mujoco = pytest.importorskip("mujoco")
    for name in bundled_vehicles():
        vehicle = load_vehicle(name)
        loaded = mujoco.MjModel.from_xml_string(Mjcf(vehicle).text)
        assert loaded.nu == len(vehicle.thrusters)
        assert loaded.nv == len(vehicle.degrees_of_freedom)
        assert loaded.body_mass.sum() == pytest.approx(Functions(vehicle).vehicle.values["m"].value)


def test_a_motor_that_pushes_backwards_has_a_range_that_rises() -> None:
    """Thrust per command of -2 N and a limit of 20 leave 40 N either way."""
    vehicle = load_vehicle("bluerov2")
    first, *others = vehicle.thrusters
    turned = replace(first, thrust_per_command=Value(-2.0), limit=20.0)
    root = ET.fromstring(Mjcf(replace(vehicle, thrusters=(turned, *others))).text)
    np.testing.assert_array_equal(_numbers(root.find("actuator/motor"), "ctrlrange"), [-40.0, 40.0])
