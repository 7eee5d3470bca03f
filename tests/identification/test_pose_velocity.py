"""Velocities from pose, for a known motion with noise, outliers, shifts and gaps, and for real logs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.hidden_effects import make_case
from tests.identification.logs_of import runs_of, vehicle_of
from tests.quick import first_quick
from undertow.errors import UndertowError
from undertow.identification.api import diagnose
from undertow.identification.logs.mapping import LogMapping, read_mapping
from undertow.identification.logs.pose_velocity import as_reported, track, velocities_from_pose
from undertow.identification.logs.reading import read_log
from undertow.identification.logs.run import Run
from undertow.model.loading import load_vehicle

ROOT = Path(__file__).parents[2]
CSE1 = ROOT.parent / "shared" / "data" / "ntnu-cse1" / "freerun"
ALL = ("surge", "sway", "heave", "roll", "pitch", "yaw")
NOISE = {"x": 2e-3, "y": 1e-3, "z": 1e-3, "phi": 2e-3, "theta": 1e-3, "psi": 2e-3}


@pytest.mark.parametrize(("velocity", "along"), [("NED", True), ("ENU", True), ("body", False)])
def test_a_log_with_velocities_along_the_earth_says_so_to_the_model(velocity: str, *, along: bool) -> None:
    mapping = LogMapping.model_validate({"frames": {"velocity": velocity}})
    t = np.arange(3.0)
    run = Run("log", t, dict.fromkeys(("psi", "u", "v", "r"), t), mapping=mapping)
    vehicle = load_vehicle("otter")
    assert as_reported(vehicle, [run]).velocity_along_earth is along
    assert not as_reported(vehicle, [run, Run("other", t, run.channels)]).velocity_along_earth


def test_a_pose_of_few_digits_that_mostly_rests_has_the_noise_of_its_digits() -> None:
    t, digit = np.arange(1200.0), 0.1
    heading = np.where(t > 900, 30 * np.sin((t - 900) / 30), 0.0)
    found = track(t, np.round(heading / digit) * digit)
    assert found.noise == pytest.approx(digit / np.sqrt(12), rel=0.3)
    true = np.where(t > 900, np.cos((t - 900) / 30), 0.0)
    assert np.sqrt(np.mean((found.rate - true)[950:] ** 2)) < 0.02


def test_velocities_that_no_log_has_are_derived_in_the_model_too() -> None:
    t, vehicle = np.arange(3.0), load_vehicle("otter")
    measured = Run("measured", t, dict.fromkeys(("psi", "u", "v", "r"), t))
    pose = Run("pose", t, dict.fromkeys(("x", "y", "psi", "r"), t))
    derived = replace(measured, derived=frozenset({"u", "v"}))
    assert as_reported(vehicle, [measured]).derived_velocities == ()
    assert as_reported(vehicle, [pose, derived]).derived_velocities == ("u", "v")
    assert as_reported(vehicle, [pose, measured]).derived_velocities == ()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("vessel", "effect"), [("usv", "attitude_bias"), ("catamaran", "position_lever_arm")]
)
def test_an_error_of_the_pose_is_not_called_one_of_a_velocity_sensor_that_is_not_there(
    vessel: str, effect: str
) -> None:
    case = make_case(vessel, (effect,), 7100003, strength=1.0, noise=1.0, duration=100.0)
    runs = [run.without({"u", "v", "r"}) for run in runs_of(case)]
    assert diagnose(vehicle_of(case), runs[:-1], runs[-1:]).diagnosis.effects == [effect]


def _waves(t, parts):
    """Return a sum of sines and its derivative; `parts` are (size, rate, phase)."""
    value = sum(size * np.sin(rate * t + phase) for size, rate, phase in parts)
    return value, sum(size * rate * np.cos(rate * t + phase) for size, rate, phase in parts)


def _motion(t):
    """Return pose and body velocities (analytic: R^T and T^-1 written out by hand)."""
    (x, dx), (y, dy), (z, dz) = (
        _waves(t, [(1.0, 0.3, 0), (0.2, 1.1, 1)]),
        _waves(t, [(0.8, 0.37, 2), (0.1, 1.4, 0)]),
        _waves(t, [(0.3, 0.2, 1), (0.02, 2.0, 0)]),
    )
    (phi, dphi), (theta, dtheta) = _waves(t, [(0.2, 1.3, 0)]), _waves(t, [(0.15, 0.9, 1)])
    psi, dpsi = _waves(t, [(2.0, 0.15, 0), (0.1, 1.2, 1)])
    cf, sf, ct, st, cp, sp = (f(a) for a in (phi, theta, psi) for f in (np.cos, np.sin))
    velocity = {
        "u": ct * cp * dx + ct * sp * dy - st * dz,
        "v": (sf * st * cp - cf * sp) * dx + (sf * st * sp + cf * cp) * dy + sf * ct * dz,
        "w": (cf * st * cp + sf * sp) * dx + (cf * st * sp - sf * cp) * dy + cf * ct * dz,
        "p": dphi - st * dpsi,
        "q": cf * dtheta + ct * sf * dpsi,
        "r": -sf * dtheta + cf * ct * dpsi,
    }
    return {"x": x, "y": y, "z": z, "phi": phi, "theta": theta, "psi": psi}, velocity


@pytest.fixture(scope="module")
def noisy():
    """Return times, a noisy pose at uneven times, and the true velocities."""
    rng = np.random.default_rng(7)
    t = np.cumsum(0.05 * rng.uniform(0.8, 1.2, 3000))
    pose, velocity = _motion(t)
    return t, {name: data + NOISE[name] * rng.normal(size=len(t)) for name, data in pose.items()}, velocity


def test_velocity_errors_are_as_large_as_sigma_says(noisy):
    t, pose, truth = noisy
    run = velocities_from_pose(Run("sim", t, pose), ALL)
    assert run.derived == set("uvwpqr")
    for name, true in truth.items():
        error = run.channels[name] - true
        rms = np.sqrt(np.nanmean(error**2))
        assert run.sigma[name] / 1.6 < rms < 1.5 * run.sigma[name], name
        assert abs(np.nanmean(error)) < 0.1 * run.sigma[name], name
        assert np.isfinite(error).all()
    clean = [note for note in run.notes if "outlier" in note or "shift" in note]
    assert clean == []


def test_the_noise_is_estimated_and_told(noisy):
    t, pose, _ = noisy
    run = velocities_from_pose(Run("sim", t, pose))
    reported = {
        note.split(":")[0]: float(note.split("noise ")[1].split()[0]) for note in run.notes if "noise" in note
    }
    assert reported == {name: pytest.approx(NOISE[name], rel=0.1) for name in ("x", "y", "psi")}


def test_outliers_are_found_and_taken_out_of_the_pose(noisy):
    t, pose, _ = noisy
    spoilt = {name: data.copy() for name, data in pose.items()}
    places = np.array([100, 500, 501, 900, 1400, 2200, 2900])
    spoilt["x"][places] += np.array([0.03, 0.5, -0.4, -5.0, 0.04, 30.0, -0.05])
    level = ("surge", "sway", "yaw")
    clean, run = (velocities_from_pose(Run("sim", t, one), level) for one in (pose, spoilt))
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(run.channels["x"])), places)
    assert not np.isnan(run.channels["y"]).any()
    assert run.outliers == {"x": 7, "y": 0, "psi": 0}
    assert any(note.startswith("x: ") and "7 outliers dropped (t = " in note for note in run.notes)
    difference = run.channels["u"] - clean.channels["u"]
    assert np.abs(difference).max() < 4 * run.sigma["u"]


@pytest.mark.parametrize("seed", first_quick([1, 3]))
def test_what_stands_out_everywhere_is_noise(seed: int) -> None:
    """A heading polled from a sender that is uneven repeats itself or skips, all along every turn."""
    rng = np.random.default_rng(seed)
    sent, t = np.arange(0.0, 90.0, 0.1), np.arange(0.1, 90.0, 0.1)
    came = np.sort(sent + rng.exponential(0.08, len(sent)))
    last = np.maximum(np.searchsorted(came, t) - 1, 0)
    psi = _turns(sent[last]) + 1e-4 * rng.standard_normal(len(sent))[last]
    run = velocities_from_pose(Run("polled", t, {"psi": psi}), ["yaw"])
    assert run.outliers == {"psi": 0}
    assert np.isfinite(run.channels["r"]).all()
    true = (_turns(t + 1e-4) - _turns(t - 1e-4)) / 2e-4
    assert np.std(run.channels["r"] - true) < 0.12 * np.std(true)


def _turns(t: np.ndarray) -> np.ndarray:
    """Heading of a boat that turns by 90 degrees now and then, rad."""
    return sum(sign * 0.8 * np.tanh((t - at) / 1.2) for at, sign in ((15, 1), (32, -1), (50, 1), (68, 1)))


@pytest.mark.parametrize("seed", range(3))
def test_wide_steps_after_the_first_samples_leave_the_noise_what_it_is(seed: int) -> None:
    """Twice lost, and after two samples nearly so: with a gap of 0.4 s behind."""
    rng = np.random.default_rng(seed)
    there = np.r_[0:30, 103, 104, 146:170, 240, 241, 285:1500]
    t = np.sort(0.01 * there + 0.0002 * rng.standard_normal(len(there)))
    one = track(t, 0.5 * np.sin(2.0 * t) + 0.002 * rng.standard_normal(len(t)))
    assert one.noise == pytest.approx(0.002, rel=0.1)
    assert not one.jump.any()
    settled = t > 3.0
    np.testing.assert_allclose(one.rate[settled], np.cos(2.0 * t[settled]), atol=0.05)


def test_a_shift_of_the_origin_is_no_velocity(noisy):
    t, pose, _ = noisy
    shifted = {**pose, "y": pose["y"] + 0.05 * (t > 40) - 0.2 * (t > 90)}
    clean, run = (velocities_from_pose(Run("sim", t, one)) for one in (pose, shifted))
    assert any(note.startswith("y: ") and "2 shifts of up to 0.2 m bridged" in note for note in run.notes)
    for name in "uv":
        assert np.abs(run.channels[name] - clean.channels[name]).max() < 6 * run.sigma[name]


def test_lost_tracking_leaves_no_velocity_and_short_gaps_do(noisy):
    t, pose, _ = noisy
    holed = {name: data.copy() for name, data in pose.items()}
    lost, short = (t > 30) & (t < 33), (t > 60) & (t < 60.3)
    for data in holed.values():
        data[lost | short] = np.nan
    run = velocities_from_pose(Run("sim", t, holed))
    for name in "uvr":
        there = np.isfinite(run.channels[name])
        assert not there[lost].any()
        assert there[~lost].all()
        error = (run.channels[name] - _level_truth(t)[name])[short]
        assert np.abs(error).max() < 10 * run.sigma[name]
    assert any(
        "not tracked for more than 0.5 s at t = 29.9" in note or "t = 30" in note for note in run.notes
    )
    assert np.isnan(run.channels["x"][short]).all()


def _level_truth(t):
    """Return the velocities a vehicle has whose roll and pitch are not looked at: turned by heading alone."""
    step = 1e-5
    (pose, _), (later, _), (before, _) = _motion(t), _motion(t + step), _motion(t - step)
    dx, dy, dpsi = ((later[name] - before[name]) / (2 * step) for name in ("x", "y", "psi"))
    c, s = np.cos(pose["psi"]), np.sin(pose["psi"])
    return {"u": c * dx + s * dy, "v": c * dy - s * dx, "r": dpsi}


def test_three_degrees_of_freedom_use_the_heading_only(noisy):
    t, pose, _ = noisy
    level = {name: pose[name] for name in ("x", "y", "psi")}
    run = velocities_from_pose(Run("sim", t, level))
    for name, true in _level_truth(t).items():
        assert np.sqrt(np.mean((run.channels[name] - true) ** 2)) < 1.5 * run.sigma[name]


def test_measured_velocities_stay_and_only_the_others_are_derived(noisy):
    t, pose, velocity = noisy
    run = Run("sim", t, {**pose, "u": velocity["u"], "v": velocity["v"]}, sigma={"u": 0.01})
    done = velocities_from_pose(run)
    np.testing.assert_array_equal(done.channels["u"], velocity["u"])
    assert done.derived == {"r"}
    assert done.sigma["u"] == 0.01
    assert velocities_from_pose(done) is done


def test_surge_alone_needs_no_heading():
    t = np.arange(0, 20, 0.1)
    run = velocities_from_pose(Run("tow", t, {"x": 0.5 * t**1.5 / 1.5}), ["surge"])
    np.testing.assert_allclose(run.channels["u"][5:-5], 0.5 * np.sqrt(t)[5:-5], atol=2e-3)


def test_a_channel_that_stands_still_does_not_blur_the_others():
    t = np.arange(0, 100, 0.05)
    x = np.sin(0.5 * t) + 0.01 * np.random.default_rng(4).standard_normal(len(t))
    still = {"y": np.zeros_like(t), "psi": np.full_like(t, 0.3)}
    alone, beside = (velocities_from_pose(Run("tow", t, {"x": x, **more}), ["surge"]) for more in ({}, still))
    assert 0.0 < beside.resolution == pytest.approx(alone.resolution)


@pytest.mark.parametrize("seed", range(4))
def test_a_channel_of_mere_noise_does_not_blur_the_others_nor_hide_what_it_may_contain(seed: int) -> None:
    rng, t = np.random.default_rng(seed), np.arange(0.0, 60.0, 0.1)
    z = 1.0 + 0.5 * np.sin(0.8 * t) + 0.2 * np.sin(2.1 * t) + 2e-3 * rng.standard_normal(len(t))
    rolling, noise = 2e-3 * np.sin(3.0 * t), 0.02 * rng.standard_normal(len(t))
    alone = velocities_from_pose(Run("log", t, {"z": z}), ("heave",))
    beside = velocities_from_pose(Run("log", t, {"z": z, "phi": rolling + noise}), ("heave", "roll"))
    assert 0.0 < beside.resolution == pytest.approx(alone.resolution)
    off = (beside.channels["p"] - 6e-3 * np.cos(3.0 * t)) / beside.sigma["p"]
    assert np.sqrt(np.mean(off[50:-50] ** 2)) < 1.6  # of its uncertainty


def test_a_slow_motion_that_shows_still_decides() -> None:
    rng, t = np.random.default_rng(0), np.arange(0.0, 120.0, 0.1)
    z = 1.0 + 0.5 * np.sin(0.8 * t) + 0.2 * np.sin(2.1 * t) + 2e-3 * rng.standard_normal(len(t))
    phi = 0.3 * np.sin(0.2 * t) + 0.03 * rng.standard_normal(len(t))
    alone = velocities_from_pose(Run("log", t, {"z": z}), ("heave",))
    beside = velocities_from_pose(Run("log", t, {"z": z, "phi": phi}), ("heave", "roll"))
    assert beside.resolution > 1.5 * alone.resolution


def test_a_pose_that_never_moves_has_no_velocity():
    t = np.arange(0, 10, 0.1)
    still = velocities_from_pose(Run("moored", t, dict.fromkeys(("x", "y", "psi"), np.ones_like(t))))
    for name in "uvr":
        np.testing.assert_allclose(still.channels[name], 0, atol=1e-12)


def test_a_speed_log_and_a_compass_are_enough_for_surge_and_yaw():
    t = np.arange(0, 60, 0.1)
    psi = 0.8 * np.sin(0.2 * t) + 1e-3 * np.random.default_rng(5).standard_normal(len(t))
    given = {"u": 1.0 + 0.2 * np.sin(0.1 * t), "psi": psi}
    run = velocities_from_pose(Run("boat", t, given), ["surge", "yaw"])
    assert run.derived == {"r"}
    np.testing.assert_array_equal(run.channels["u"], given["u"])
    np.testing.assert_allclose(run.channels["r"][20:-20], 0.16 * np.cos(0.2 * t)[20:-20], atol=0.01)
    with pytest.raises(
        UndertowError, match="neither v nor the pose x, y for sway: map these columns, leave it"
    ):
        velocities_from_pose(Run("boat", t, given))


def test_what_cannot_be_done_is_reported():
    t = np.arange(0, 10, 0.1)
    with pytest.raises(UndertowError, match="neither u, v nor the pose y for surge, sway"):
        velocities_from_pose(Run("a", t, {"x": t, "psi": t}))
    few = np.where(t < 0.5, t, np.nan)
    with pytest.raises(UndertowError, match="channel 'x' has 5 samples, at least 10"):
        velocities_from_pose(Run("a", t, {"x": few}), ["surge"])
    scattered = np.where(np.arange(100) % 10 < 4, t, np.nan)
    with pytest.raises(UndertowError, match="no velocity from channel 'x'"):
        velocities_from_pose(Run("a", t, {"x": scattered}), ["surge"])


@pytest.mark.slow
@pytest.mark.skipif(not CSE1.is_dir(), reason=f"the CSE1 logs are not shipped; put them into {CSE1}")
@pytest.mark.parametrize("name", first_quick(["manual_random_run1", "manual_random_run3", "dp_dptest2"]))
def test_real_motion_capture(name):
    mapping = read_mapping(ROOT / "examples" / "cse1" / "log.toml")
    raw = read_log(CSE1 / f"{name}.csv", mapping, [f"u{k}" for k in range(1, 6)])
    run = velocities_from_pose(raw)
    velocity = run.matrix(["u", "v", "r"])
    tracked = np.isfinite(raw.channels["x"])
    assert np.isfinite(velocity[tracked]).all(axis=1).mean() > 0.985
    assert np.nanmax(np.hypot(velocity[:, 0], velocity[:, 1])) < 1.0
    assert np.nanmax(np.abs(velocity[:, 2])) < 1.0
    # The logged roll outlier near 240 s and the shifts of the cameras must not be left in the accelerations.
    step = np.diff(run.t)[:, None]
    assert np.nanmax(np.abs(np.diff(velocity[:, :2], axis=0) / step)) < 1.5
