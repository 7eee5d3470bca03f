"""Descriptions for auv_controllers: the equations that its library documents, evaluated on the file."""

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
from undertow.export.auv_controllers import AuvControllers
from undertow.model.loading import bundled_vehicles, load_vehicle
from undertow.model.vehicle import Value

# Every element and attribute that the parser asks for, by its path.
PARSED = {
    "inertial/mass": ("value",),
    "inertial/inertia": ("ixx", "iyy", "izz"),
    "inertial/center_of_gravity": ("x", "y", "z"),
    "inertial/added_mass": ("Xdu", "Ydv", "Zdw", "Kdp", "Mdq", "Ndr"),
    "damping/linear": ("Xu", "Yv", "Zw", "Kp", "Mq", "Nr"),
    "damping/quadratic": ("Xuu", "Yvv", "Zww", "Kpp", "Mqq", "Nrr"),
    "hydrostatics/buoyancy": ("value",),
    "hydrostatics/center_of_buoyancy": ("x", "y", "z"),
}


def _parsed(text: str) -> dict[str, np.ndarray]:
    root = ET.fromstring(text)
    assert root.tag == "robot"
    found = {}
    for path, names in PARSED.items():
        element = root.find(f"hydrodynamics/{path}")
        assert tuple(element.attrib) == names
        found[path.rpartition("/")[2]] = np.array([float(element.get(n)) for n in names])
    leaves = [e for e in root.iter() if e.attrib and e is not root]
    assert len(leaves) == len(PARSED)
    return found


def _inverse_dynamics(v: dict[str, np.ndarray], acc: np.ndarray, nu: np.ndarray, r: np.ndarray) -> np.ndarray:
    """M acc + C(nu) nu + D(nu) nu + g(R), with the weight at 9.81 m/s^2; R turns the body into NED."""
    m, s = v["mass"][0], cross(v["center_of_gravity"])
    rigid = np.block([[m * np.eye(3), -m * s], [m * s, np.diag(v["inertia"])]])
    mass = rigid - np.diag(v["added_mass"])
    momentum = mass @ nu
    coriolis = -np.concatenate(
        [cross(momentum[:3]) @ nu[3:], cross(momentum[:3]) @ nu[:3] + cross(momentum[3:]) @ nu[3:]]
    )
    drag = -(v["linear"] + v["quadratic"] * np.abs(nu)) * nu
    down = r.T @ [0.0, 0.0, 1.0]
    weight, lift = m * 9.81 * down, -v["buoyancy"][0] * down
    moment = np.cross(v["center_of_gravity"], weight) + np.cross(v["center_of_buoyancy"], lift)
    return mass @ acc + coriolis + drag - np.concatenate([weight + lift, moment])


@pytest.mark.parametrize("name", first_quick(["bluerov2", "bluerov2-6", "remus100"]))
def test_the_documented_equations_are_those_of_the_model(name: str) -> None:
    """With gravity of 9.82 m/s^2 (bluerov2-6), too; without what is named as lost (remus100)."""
    vehicle = load_vehicle(name)
    written = AuvControllers(vehicle)
    lost = {e.id for e in vehicle.all_effects if f"{e.id} is left out" in written.losses} | {"thrusters"}
    ours = force_of(vehicle, {e.id for e in vehicle.all_effects} - lost - {"added_mass_coupling"})
    states, values = Functions(vehicle).x.numel(), _parsed(written.text)
    coupled = "added mass off the diagonal is left out" in written.losses
    assert coupled == (name == "remus100")
    rng = np.random.default_rng(17)
    for angles in rng.uniform(-1.2, 1.2, (20, 3)):
        nu, acc = rng.uniform(-2, 2, (2, 6))
        # The Coriolis forces of what is coupled are lost with it.
        nu = nu * ([1, 0, 0, 1, 0, 0] if coupled else [1] * 6)
        x = np.concatenate([np.zeros(3), angles, nu, np.zeros(states - 12)])
        expected = -ours(x, acc)
        found = _inverse_dynamics(values, acc, nu, rotation(*angles))
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


def test_what_the_description_cannot_say_is_listed() -> None:
    losses = "; ".join(AuvControllers(load_vehicle("remus100")).losses)
    for lost in ("lift is left out", "rudder_force is left out", "added mass off the diagonal", "is YAML"):
        assert lost in losses
    losses = "; ".join(AuvControllers(load_vehicle("mini-auv")).losses)
    assert "added mass differs forward and backward: its mean is taken" in losses
    assert "quadratic_damping: terms that auv_controllers has no place for are left out" in losses
    base = load_vehicle("bluerov2")
    skewed = replace(base, values={**base.values, "I_xz": Value(0.01)})
    assert "I_xy, I_xz, I_yz are left out" in "; ".join(AuvControllers(skewed).losses)
    assert "Coriolis" in "; ".join(AuvControllers(load_vehicle("box-hull")).losses)


@pytest.mark.parametrize("name", first_quick(bundled_vehicles()))
def test_the_command_writes_a_description_and_says_what_is_lost(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "robot.urdf"
    assert main(["export", "auv-controllers", name, "--out", str(target)]) == 0
    assert "warning:" in capsys.readouterr().out
    assert all(np.isfinite(v).all() for v in _parsed(target.read_text()).values())
