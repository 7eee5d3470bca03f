"""Worlds for Gazebo: the formulas of its plugins, evaluated on the file, against the model."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import casadi as ca
import numpy as np
import pytest

from tests.export.support import cross, force_of, rotation
from tests.quick import first_quick
from undertow import UndertowError
from undertow.cli.main import main
from undertow.codegen import Functions
from undertow.export.sdf import Sdf
from undertow.model.loading import bundled_vehicles, load_vehicle
from undertow.model.vehicle import Value, Vehicle

FLIP = np.diag([1.0, -1.0, -1.0, 1.0, -1.0, -1.0])
ROTATION = FLIP[:3, :3]
# Six degrees of freedom, and nothing in their damping that the plugin cannot say.
WHOLE = ["remus100", "bluerov2", "bluerov2-6"]


def _world(name: str) -> tuple[Vehicle, ET.Element]:
    vehicle = load_vehicle(name)
    return vehicle, ET.fromstring(Sdf(vehicle).text)


def _number(element: ET.Element, path: str) -> float:
    return float(element.findtext(path, "0"))


def _numbers(element: ET.Element, path: str) -> np.ndarray:
    return np.array((element.findtext(path) or "0 0 0 0 0 0").split(), float)


def _plugin_force(plugin: ET.Element, nu: np.ndarray) -> np.ndarray:
    """Damping force of the Hydrodynamics system as its documentation states it, forward-left-up."""
    value = {e.tag: float(e.text or 0) for e in plugin if e.tag[0] in "xyzkmn" and len(e.tag) < 8}
    force = np.zeros(6)
    for i, f in enumerate("xyzkmn"):
        for j, a in enumerate("UVWPQR"):
            force[i] += value.pop(f + a, 0.0) * nu[j]
            for k, b in enumerate("UVWPQR"):
                force[i] += value.pop(f + a + b, 0.0) * nu[j] * nu[k]
                force[i] += value.pop(f"{f}{a}abs{b}", 0.0) * nu[j] * abs(nu[k])
    assert not value
    return force


def _of_family(vehicle: Vehicle, family: str) -> Callable[[np.ndarray], np.ndarray]:
    """Sum of the wrenches of these effects without acceleration and commands."""
    force = force_of(vehicle, {e.id for e in vehicle.all_effects if e.family == family})
    return lambda x: force(x, np.zeros(6))


@pytest.mark.parametrize("name", WHOLE)
def test_the_plugin_damps_as_the_model_does(name: str) -> None:
    vehicle, world = _world(name)
    plugin = world.find(".//plugin[@name='gz::sim::systems::Hydrodynamics']")
    ours = _of_family(vehicle, "damping")
    rng = np.random.default_rng(11)
    for nu in rng.uniform(-2, 2, (25, 6)):
        expected = ours(np.concatenate([np.zeros(6), nu]))
        found = FLIP @ _plugin_force(plugin, FLIP @ nu)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
        assert nu @ found < 0 or name == "remus100"  # lift may push either way, drag may not


@pytest.mark.parametrize("name", WHOLE)
def test_mass_and_added_mass_are_those_of_the_model(name: str) -> None:
    vehicle, world = _world(name)
    inertial = world.find(".//link[@name='base_link']/inertial")
    m, r = _number(inertial, "mass"), _numbers(inertial, "pose")[:3]
    about = np.array([[_number(inertial, f"inertia/i{min(a, b)}{max(a, b)}") for a in "xyz"] for b in "xyz"])
    s = cross(r)
    body = np.block([[m * np.eye(3), -m * s], [m * s, about - m * s @ s]])
    order = {c: i for i, c in enumerate("xyzpqr")}
    added = np.zeros((6, 6))
    for element in inertial.find("fluid_added_mass"):
        i, j = (order[c] for c in element.tag)
        added[i, j] = added[j, i] = float(element.text)
    f = Functions(vehicle)
    mass = ca.Function("mass", [f.x, f.p, f.actuation, f.t], [ca.densify(f.mass_matrix)])
    ours = mass(np.zeros(f.x.numel()), f.values(), 0, 0).full()
    np.testing.assert_allclose(FLIP @ (body + added) @ FLIP, ours, rtol=1e-9, atol=1e-9)
    assert np.linalg.eigvalsh(added).min() >= -1e-12  # positive: the plugin's own xDotU would be negative
    plugin = world.find(".//plugin[@name='gz::sim::systems::Hydrodynamics']")
    assert plugin.findtext("disable_added_mass") == "true"
    assert not [e.tag for e in plugin if "Dot" in e.tag]


@pytest.mark.parametrize("name", WHOLE)
def test_weight_and_archimedes_give_the_restoring_force(name: str) -> None:
    vehicle, world = _world(name)
    link = world.find(".//link[@name='base_link']")
    density = _number(world, ".//uniform_fluid_density")
    g = -_numbers(world, ".//gravity")[2]
    size, centre = _numbers(link, "collision/geometry/box/size"), _numbers(link, "collision/pose")[:3]
    lift, weight = density * g * size.prod(), _number(link, "inertial/mass") * g
    gravity_centre = _numbers(link, "inertial/pose")[:3]
    ours = _of_family(vehicle, "statics")
    rng = np.random.default_rng(13)
    for phi, theta, psi in rng.uniform(-1.2, 1.2, (10, 3)):
        up = -ROTATION @ rotation(phi, theta, psi).T @ np.array([0.0, 0.0, 1.0])  # forward-left-up
        force = (lift - weight) * up
        moment = np.cross(centre, lift * up) - np.cross(gravity_centre, weight * up)
        expected = ours(np.array([0, 0, 0, phi, theta, psi, *np.zeros(6)]))
        np.testing.assert_allclose(FLIP @ np.concatenate([force, moment]), expected, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("name", ["bluerov2", "otter"])
def test_thrusters_stand_where_they_push(name: str) -> None:
    vehicle, world = _world(name)
    for k, thruster in enumerate(vehicle.thrusters):
        x, y, z, roll, pitch, yaw = _numbers(world, f".//link[@name='{thruster.name}_link']/pose")
        assert roll == 0
        axis = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), -np.sin(pitch)])
        wrench = FLIP @ np.concatenate([axis, np.cross([x, y, z], axis)])
        np.testing.assert_allclose(wrench, np.array(vehicle.allocation, float)[:, k], atol=1e-12)


def test_what_gazebo_cannot_say_is_listed() -> None:
    losses = "; ".join(Sdf(load_vehicle("mini-auv")).losses)
    assert "linear_damping differs forward and backward" in losses
    assert "roll, pitch are free in Gazebo" in losses
    assert "cubic_damping is left out" in "; ".join(Sdf(load_vehicle("cybership2")).losses)
    assert "rudder_force is left out" in "; ".join(Sdf(load_vehicle("remus100")).losses)
    ship = "; ".join(Sdf(load_vehicle("kvlcc2")).losses)
    assert "hull_cubic is left out" in ship
    assert "its curve is left out" in ship


def test_a_vehicle_without_mass_is_refused() -> None:
    vehicle = load_vehicle("bluerov2")
    with pytest.raises(UndertowError, match="no mass m: Gazebo needs one"):
        Sdf(replace(vehicle, values={**vehicle.values, "m": Value(0.0)}))
    with pytest.raises(UndertowError, match="is not positive"):
        Sdf(replace(vehicle, values={**vehicle.values, "mx_g": Value(20.0)}))


_CHECK = """
#include <sdf/sdf.hh>
#include <iostream>
int main(int, char **words) {
  sdf::Root root;
  const sdf::Errors errors = root.Load(words[1]);
  for (const auto &error : errors) std::cout << error << std::endl;
  const sdf::Model *model = root.WorldByIndex(0)->ModelByIndex(0);
  const auto &inertia = model->LinkByName("base_link")->Inertial();
  std::cout << model->LinkCount() << " " << model->JointCount() << std::endl;
  return errors.empty() && inertia.MassMatrix().IsValid() ? 0 : 1;
}
"""


def _parser(folder: Path) -> list[str] | None:
    """How a program is built with the sdformat of this machine (Debian: libsdformat-dev), if there is one."""
    if not (shutil.which("g++") and shutil.which("pkg-config")):
        return None
    for version in range(16, 11, -1):
        found = subprocess.run(
            ["pkg-config", "--cflags", "--libs", f"sdformat{version}"], capture_output=True, text=True
        )
        if found.returncode == 0:
            source = folder / "check.cc"
            source.write_text(_CHECK)
            return ["g++", "-std=c++17", str(source), "-o", str(folder / "check"), *found.stdout.split()]
    return None


@pytest.mark.slow  # for the compiler
def test_the_parser_of_sdformat_finds_no_fault(tmp_path: Path) -> None:
    command = _parser(tmp_path)
    if command is None:
        pytest.skip("needs libsdformat-dev")
    subprocess.run(command, check=True)
    for name in bundled_vehicles():
        vehicle = load_vehicle(name)
        target = tmp_path / f"{name}.sdf"
        # Debian's sdformat 12 knows SDF up to 1.9, which has all of it but the added mass.
        target.write_text(Sdf(vehicle).text.replace('<sdf version="1.10">', '<sdf version="1.9">'))
        done = subprocess.run([str(tmp_path / "check"), str(target)], capture_output=True, text=True)
        assert (done.returncode, done.stderr) == (0, ""), done.stdout + done.stderr
        links, joints = done.stdout.split()
        assert int(links) == int(joints) + 1 == len(vehicle.thrusters) + 1


@pytest.mark.parametrize("name", first_quick(bundled_vehicles()))
def test_the_command_writes_a_world_and_says_what_is_lost(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "world.sdf"
    assert main(["export", "sdf", name, "--out", str(target)]) == 0
    out = capsys.readouterr().out
    assert "warning:" in out
    assert ET.parse(target).getroot().find("world/model") is not None


def test_a_thruster_that_pushes_backwards_has_limits_that_rise() -> None:
    """Thrust per command of -2 N and a limit of 20 leave 40 N either way."""
    vehicle = load_vehicle("bluerov2")
    first, *others = vehicle.thrusters
    turned = replace(first, thrust_per_command=Value(-2.0), limit=20.0)
    plugin = next(
        p
        for p in ET.fromstring(Sdf(replace(vehicle, thrusters=(turned, *others))).text).iter("plugin")
        if p.findtext("joint_name") == f"{first.name}_joint"
    )
    assert (_number(plugin, "max_thrust_cmd"), _number(plugin, "min_thrust_cmd")) == (40.0, -40.0)
