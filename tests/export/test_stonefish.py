"""Scenarios for Stonefish: what its documentation and source say of such a file, against the model."""

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
from undertow.export.stonefish import Stonefish
from undertow.model.loading import bundled_vehicles, load_vehicle
from undertow.model.vehicle import Value, Vehicle

WHOLE = ["bluerov2", "remus100", "bluerov2-6"]
GRAVITY = 9.81  # of Stonefish
# Children that the parser knows, by what they stand in, and the attributes without which it gives up.
CHILDREN = {
    "scenario": {"environment", "materials", "looks", "robot"},
    "environment": {"ned", "ocean"},
    "ocean": {"waves", "water"},
    "materials": {"material"},
    "looks": {"look"},
    "robot": {"base_link", "actuator", "world_transform"},
    "base_link": {"dimensions", "origin", "material", "look", "mass", "inertia", "cg", "hydrodynamics"},
    "actuator": {"specs", "origin", "link"},
}
REQUIRED = {
    "ned": {"latitude", "longitude"},
    "robot": {"name", "fixed", "self_collisions"},
    "base_link": {"name", "type", "physics"},
    "actuator": {"name", "type"},
    **{name: {"xyz", "rpy"} for name in ("origin", "cg", "world_transform")},
    "dimensions": {"xyz"},
}


def _numbers(element: ET.Element, path: str, name: str = "xyz") -> np.ndarray:
    return np.array(element.find(path).get(name).split(), float)


def _link(vehicle: Vehicle) -> tuple[ET.Element, ET.Element]:
    root = ET.fromstring(Stonefish(vehicle).text)
    return root, root.find("robot/base_link")


@pytest.mark.parametrize("name", first_quick(WHOLE))
def test_the_link_is_the_rigid_body_of_the_model(name: str) -> None:
    vehicle = load_vehicle(name)
    _assert_rigid_body(vehicle)
    _assert_rigid_body(replace(vehicle, values={**vehicle.values, "I_xz": Value(0.02), "mx_g": Value(0.3)}))


def _assert_rigid_body(vehicle: Vehicle) -> None:
    link = _link(vehicle)[1]
    m, s = float(link.find("mass").get("value")), cross(_numbers(link, "cg"))
    turned = rotation(*_numbers(link, "cg", "rpy"))  # yaw, pitch, roll about the axes of the body
    about = turned @ np.diag(_numbers(link, "inertia")) @ turned.T
    found = np.block([[m * np.eye(3), -m * s], [m * s, about - m * s @ s]])
    ours, n = force_of(vehicle, {"rigid_body"}), Functions(vehicle).x.numel()
    expected = -np.array([ours(np.zeros(n), row) for row in np.eye(6)]).T
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", first_quick(WHOLE, 3))
def test_weight_and_displaced_water_give_the_restoring_force(name: str) -> None:
    """At Stonefish's gravity, also where that of the model is another (bluerov2-6)."""
    vehicle = load_vehicle(name)
    root, link = _link(vehicle)
    density = float(root.find("environment/ocean/water").get("density"))
    volume = _numbers(link, "dimensions").prod()
    weight, lift = float(link.find("mass").get("value")) * GRAVITY, volume * density * GRAVITY
    ours, n = force_of(vehicle, {"restoring"}), Functions(vehicle).x.numel()
    rng = np.random.default_rng(13)
    for angles in rng.uniform(-1.2, 1.2, (10, 3)):
        down = rotation(*angles).T @ [0.0, 0.0, 1.0]
        moment = np.cross(_numbers(link, "cg"), weight * down) - np.cross(
            _numbers(link, "origin"), lift * down
        )
        expected = ours(np.concatenate([np.zeros(3), angles, np.zeros(n - 6)]), np.zeros(6))
        found = np.concatenate([(weight - lift) * down, moment])
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-7)


def _drag(link: ET.Element, density: float, v: np.ndarray) -> np.ndarray:
    """Force on a box that moves without turning, summed over its faces as `SolidEntity.cpp` does.

    The coefficient of each sum is that of the axes, weighted by the direction of the sum.
    """
    size = _numbers(link, "dimensions")
    pressed, rubbed = np.zeros(3), np.zeros(3)
    for axis in range(3):
        area = np.delete(size, axis).prod()
        for normal in (np.eye(3)[axis], -np.eye(3)[axis]):
            towards = -v @ normal  # of the water's speed past the body, along the normal
            pressed += area * -v * np.linalg.norm(v) * max(-towards, 0.0)
            rubbed += area * (-v - towards * normal)
    factors = (("quadratic_drag", pressed, 0.5), ("viscous_drag", rubbed, 1.0))
    total = np.zeros(3)
    for name, summed, factor in factors:
        length = np.linalg.norm(summed)
        share = np.abs(summed) / length if length else np.zeros(3)
        total += factor * density * (share @ _numbers(link, "hydrodynamics", name)) * summed
    return total


@pytest.mark.parametrize("name", first_quick(WHOLE))
def test_drag_along_an_axis_is_that_of_the_model(name: str) -> None:
    """Linear drag at any speed, quadratic drag at 1 m/s; at another speed it is right times the speed."""
    vehicle = load_vehicle(name)
    root, link = _link(vehicle)
    density, n = float(root.find("environment/ocean/water").get("density")), Functions(vehicle).x.numel()
    by_order = [force_of(vehicle, {"linear_damping"}), force_of(vehicle, {"quadratic_damping"})]
    for speed in (-1.0, 1.0, 0.3, 2.0):
        for axis in range(3):
            v = speed * np.eye(3)[axis]
            x = np.concatenate([np.zeros(6), v, np.zeros(n - 9)])
            linear, quadratic = (f(x, np.zeros(6))[:3] for f in by_order)
            expected = linear + quadratic * abs(speed)
            np.testing.assert_allclose(_drag(link, density, v), expected, rtol=1e-9, atol=1e-9)
            assert v @ expected < 0


@pytest.mark.parametrize("name", ["bluerov2", "otter"])
def test_thrusters_push_where_they_stand(name: str) -> None:
    vehicle = load_vehicle(name)
    root = ET.fromstring(Stonefish(vehicle).text)
    for k, thruster in enumerate(vehicle.thrusters):
        push = root.find(f"robot/actuator[@name='{thruster.name}']")
        axis = rotation(*_numbers(push, "origin", "rpy"))[:, 0]
        wrench = np.concatenate([axis, np.cross(_numbers(push, "origin"), axis)])
        np.testing.assert_allclose(wrench, np.array(vehicle.allocation, float)[:, k], atol=1e-12)
    first, *others = vehicle.thrusters
    turned = replace(first, thrust_per_command=Value(-2.0), limit=20.0)
    specs = ET.fromstring(Stonefish(replace(vehicle, thrusters=(turned, *others))).text).find(".//specs")
    assert (specs.get("lower_limit"), specs.get("upper_limit")) == ("-40.0", "40.0")


def test_what_stonefish_cannot_say_is_listed() -> None:
    losses = "; ".join(Stonefish(load_vehicle("remus100")).losses)
    for lost in ("lift is left out", "added mass is left out", "right at 1 m/s", "rudder_force is left out"):
        assert lost in losses
    losses = "; ".join(Stonefish(load_vehicle("mini-auv")).losses)
    assert "roll, pitch are free in Stonefish" in losses
    assert "added mass differs" not in losses


@pytest.mark.parametrize("name", first_quick(bundled_vehicles()))
def test_the_command_writes_a_scenario_of_known_elements(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "scenario.scn"
    assert main(["export", "stonefish", name, "--out", str(target)]) == 0
    assert "warning:" in capsys.readouterr().out
    for element in ET.parse(target).getroot().iter():
        assert {e.tag for e in element} <= CHILDREN.get(element.tag, set())
        assert {*element.attrib} >= REQUIRED.get(element.tag, set())
        coefficients = element.get("viscous_drag", "") + " " + element.get("quadratic_drag", "")
        assert all(float(c) >= 0 for c in coefficients.split())  # the simulator ignores negative ones
