"""Velocities that were divided by steps of a clock that jitters: named as such, and as nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.quick import first_quick
from undertow.errors import UndertowError
from undertow.identification.doctor.examine import examine, refuse_impossible
from undertow.identification.logs.pose_velocity import velocities_from_pose
from undertow.identification.logs.run import Run
from undertow.model.loading import load_vehicle
from undertow.model.vehicle import Vehicle

MATTERS = {"speed_unit", "inconsistent", "measures_nothing", "divided_by_jitter", "degrees_for_radians"}


@pytest.fixture(scope="module")
def ship() -> Vehicle:
    return load_vehicle("cybership2")


def _stamped(vehicle: Vehicle, late: float) -> Run:
    """Ten seconds at 250 samples a second whose stamps are late by up to so many steps; noise of 0.2 mm."""
    t, rng = np.arange(0.0, 10.0, 0.004), np.random.default_rng(8)
    u, v, psi = 1.0 + 0.3 * np.sin(0.9 * t), 0.1 * np.cos(1.3 * t), 0.8 * np.sin(0.5 * t)
    place = 0.004 * np.cumsum((u + 1j * v) * np.exp(1j * psi))
    pose = {"x": place.real, "y": place.imag, "psi": psi}
    noisy = {n: data + 2e-4 * rng.standard_normal(len(t)) for n, data in pose.items()}
    speeds = {"u": u, "v": v, "r": 0.4 * np.cos(0.5 * t)}
    measured = {n: data + 1e-3 * rng.standard_normal(len(t)) for n, data in speeds.items()}
    commands = {n: np.sin((0.3 + 0.1 * k) * t) for k, n in enumerate(vehicle.command_names)}
    return Run("dive", t + 0.004 * late * rng.random(len(t)), noisy | measured | commands)


def _divided(run: Run) -> Run:
    """The same, its velocities the differences of its pose over each step."""
    pose = {n: np.gradient(run.channels[n], run.t) for n in ("x", "y", "psi")}
    body = (pose["x"] + 1j * pose["y"]) * np.exp(-1j * run.channels["psi"])
    return replace(run, channels=run.channels | {"u": body.real, "v": body.imag, "r": pose["psi"]})


def test_steps_that_jitter_are_no_divisors(ship: Vehicle) -> None:
    """A logger that divides by them has speeds of 1/dt: no other unit, and the pose has it all."""
    run = _divided(_stamped(ship, 0.99))
    examined = examine(ship, [run])
    (finding,) = [f for f in examined.result.findings if f.id in MATTERS]
    assert (finding.id, finding.severity) == ("divided_by_jitter", "mistake")
    assert finding.text.startswith("u, v, r are differences of x, y, psi over single time steps")
    assert {"u", "v", "r"} <= examined.mended[0].derived
    anew, true = (
        velocities_from_pose(run.without(("u", "v", "r")), ship.degrees_of_freedom),
        _stamped(ship, 0.0),
    )
    for name in ("u", "v", "r"):
        before, after = (np.nanstd(one.channels[name] - true.channels[name]) for one in (run, anew))
        assert after < 0.01 * before
        assert np.mean(np.isfinite(anew.channels[name])) > 0.95
    with pytest.raises(UndertowError, match=r"u, v, r are differences of x, y, psi .+ to `ignore`"):
        refuse_impossible(ship, [run])
    refuse_impossible(ship, [run], trust_log=True)


@pytest.mark.parametrize("kind", first_quick(["measured", "even"]))
def test_what_was_measured_or_divided_by_even_steps_is_left_alone(ship: Vehicle, kind: str) -> None:
    """Stamps that jitter spoil no velocity that a sensor reported; even steps spoil none at all."""
    run = _stamped(ship, 0.99) if kind == "measured" else _divided(_stamped(ship, 0.0))
    examined = examine(replace(ship, thrusters=()), [run])  # commands would only cost time
    assert [f.text for f in examined.result.findings if f.id in MATTERS] == []
    assert not examined.mended[0].derived
