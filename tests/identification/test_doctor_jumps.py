"""Positions that jump beside velocities that were measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.identification.logs_of import run_of
from undertow.identification.doctor.examine import examine
from undertow.identification.doctor.jumps import coarse_positions, pose_steps, position_jumps
from undertow.identification.logs.pose_velocity import velocities_from_pose
from undertow.model.loading import load_vehicle

DOFS = ("surge", "sway", "yaw")
Columns = dict[str, np.ndarray]


def _log(away: tuple[int, ...] = (), noise: float = 0.01) -> Columns:
    """A boat at 1 m/s in a circle, 5 m away from itself in some samples."""
    t = np.arange(0.0, 60.0, 0.1)
    psi = 0.1 * t
    x, y = 10.0 * np.sin(psi), 10.0 * (1.0 - np.cos(psi))
    x[list(away)] += 5.0
    errors = noise * np.random.default_rng(1).standard_normal((2, len(t)))
    steady = {"u": np.ones_like(t), "v": np.zeros_like(t), "r": np.full_like(t, 0.1)}
    commands = {n: np.full_like(t, 50.0) for n in ("port", "starboard")}
    return {"t": t, "x": x + errors[0], "y": y + errors[1], "psi": psi, **steady, **commands}


def test_positions_that_no_vehicle_reaches_are_counted() -> None:
    vehicle = replace(load_vehicle("otter"), thrusters=())
    runs = [run_of(name, _log(away=(100, 250, 400))) for name in ("one", "other")]
    (found,) = [f for f in examine(vehicle, runs).result.findings if f.id == "position_jumps"]
    assert found.severity == "warning"
    assert found.evidence["count"] == 6
    assert found.evidence["largest"] == pytest.approx(5.1, abs=0.1)
    assert "one: x, y jump 6 times" in found.text
    assert found.text.endswith("1 more of the logs has such jumps")


@pytest.mark.parametrize("columns", [_log(), _log(away=(100,)), _log(noise=1.0)])
def test_a_single_outlier_and_plain_noise_are_no_jumps(columns: Columns) -> None:
    assert not list(position_jumps(load_vehicle("otter"), [run_of("log", columns)]))


def test_velocities_from_the_pose_are_free_of_jumps() -> None:
    columns = _log(away=(100, 250, 400))
    pose = {n: c for n, c in columns.items() if n not in ("u", "v", "r")}
    run = velocities_from_pose(run_of("log", pose), DOFS)
    assert not list(position_jumps(load_vehicle("otter"), [run]))


@pytest.mark.parametrize(("step", "found"), [(10.0, ["theta"]), (0.02, [])])
def test_steps_that_a_vehicle_may_have_moved_are_no_sure_shifts_of_the_origin(
    step: float, found: list[str]
) -> None:
    """A glider that is logged every 10 s pitches by 30 degrees from one sample to the next."""
    t = step * np.arange(300)
    pitch = 0.25 * np.sign(np.sin(2.0 * np.pi * (np.arange(300) + 0.5) / 100.0))
    noise = np.random.default_rng(2).standard_normal((2, 300))
    pose = {"z": 0.1 * t + 0.01 * noise[0], "theta": pitch + 0.001 * noise[1]}
    run = velocities_from_pose(run_of("dive", {"t": t, **pose}), ("heave", "pitch"))
    assert len(run.shifts["theta"]) == 5
    np.testing.assert_allclose(run.shifts["theta"], np.tile([0.5, step], (5, 1)), atol=0.01)
    findings = list(pose_steps(load_vehicle("glider"), [run]))
    assert [f.text.split()[1] for f in findings] == found
    assert {f.id for f in findings} <= {"pose_steps"}
    assert all("theta changes 5 times by up to 0.5 rad" in f.text for f in findings)


def test_a_heading_that_jumps_beside_a_vehicle_without_yaw_is_no_motion_of_it() -> None:
    columns = _log()
    heading = columns["psi"] + 0.5 * np.sign(np.sin(2.0 * np.pi * (np.arange(600) + 0.5) / 100.0))
    noise = 0.001 * np.random.default_rng(2).standard_normal(600)
    pose = {n: columns[n] for n in ("t", "x", "y", "port", "starboard")} | {"psi": heading + noise}
    vehicle = replace(load_vehicle("otter"), degrees_of_freedom=("surge", "sway"))
    run = velocities_from_pose(run_of("log", pose), vehicle.degrees_of_freedom)
    assert "psi" in run.shifts
    assert not run.has("r")
    assert not list(pose_steps(vehicle, [run]))


@pytest.mark.parametrize(("digits", "found"), [(0.4, True), (0.001, False)])
def test_a_position_in_steps_of_its_resolution_is_no_velocity(digits: float, found: bool) -> None:
    """Latitude in single precision has steps of 0.4 m: at 0.3 m/s it stays for more than a second."""
    t = np.arange(0.0, 120.0, 0.04)
    psi = 0.05 * t
    north, east = (digits * np.round(6.0 * f(psi) / digits) for f in (np.sin, lambda a: 1.0 - np.cos(a)))
    jitter = 0.01 * np.random.default_rng(5).uniform(size=len(t))
    run = velocities_from_pose(run_of("boat", {"t": t + jitter, "x": north, "y": east, "psi": psi}), DOFS)
    warnings = list(coarse_positions([run]))
    assert bool(warnings) == found
    assert all("though it makes good 0.3" in f.text for f in warnings)
