"""The standard error of a sensor's delay: as large as the error, from 1 Hz on and between samples."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from benchmarks.hidden_effects import Case, make_case
from tests.identification.logs_of import run_of, vehicle_of
from undertow.identification.doctor.clocks import latencies
from undertow.identification.doctor.examine import examine
from undertow.identification.doctor.kinematics import Kinematics
from undertow.identification.logs.run import Run
from undertow.model.symbols import POSE, VELOCITY

NOISE = {"x": 0.006, "y": 0.006, "z": 0.003, "psi": 0.001, "u": 0.003, "v": 0.003, "w": 0.003, "r": 0.001}
SOURCES = (("u", "v", "w"), ("r",))


def _sampled(case: Case, rate: float, delay: float, late: tuple[str, ...], seed: int) -> Run:
    """A log at a lower rate, some of its channels late by a time that is no multiple of the steps."""
    (columns,) = case.runs.values()
    rng, t = np.random.default_rng(seed), columns["t"]
    at = np.arange(8.0 + rng.uniform(0.0, 1.0 / rate), t[-1], 1.0 / rate)
    found = {"t": at - at[0]}
    for name, values in columns.items():
        if name in (*POSE, *VELOCITY):
            exact = CubicSpline(t, values)(at - (delay if name in late else 0.0))
            found[name] = exact + NOISE.get(name, 0.001) * rng.standard_normal(len(at))
        elif name != "t":
            found[name] = values[np.searchsorted(t, at + 1e-9, side="right") - 1]
    return run_of("late", found)


@pytest.mark.slow
def test_a_delay_lies_within_two_standard_errors_in_nineteen_of_twenty_logs() -> None:
    off = []
    for seed in range(8):
        case = make_case(("usv", "mini-auv")[seed % 2], (), seed, duration=150.0, noise=0.0, runs=("steps",))
        vehicle = vehicle_of(case)
        for rate in (1.0, 2.0, 5.0):
            for late in SOURCES:
                delay = (0.37, 0.8, 1.5, 2.4)[(seed + len(off)) % 4]
                run = _sampled(case, rate, delay, late, seed)
                kinematics = Kinematics([run], vehicle)
                found = (one for one in latencies(kinematics, [run]) if {*one.names} <= {*late})
                off += [(one.delay - delay) / one.error for one in found]
    assert len(off) > 40
    assert np.mean(np.abs(off) < 2.0) > 0.88
    assert np.sqrt(np.mean(np.square(off))) < 1.3


def _one_turn(rate_ahead: float, heading_late: float, seed: int = 0) -> Run:
    """A minute at 10 Hz with one turn of 25 degrees, after a burst of thrust; u, v and psi agree with x, y
    but for a heading that is late. The yaw rate is that of so many seconds later, and rises more steeply.
    """
    rng, t = np.random.default_rng(seed), np.arange(0.0, 60.0, 0.1)

    def turned(at: np.ndarray, steep: float) -> np.ndarray:
        return np.asarray(1.0 - 0.01 * at + 0.42 / (1.0 + np.exp(-steep * (at - 33.0))))

    def going(start: float, gone: float) -> np.ndarray:
        """Speed up from `start` on, and slowing down once the thrust has ended after 7 s."""
        rise = 1.0 - np.exp(-np.clip(t - start, 0.0, 7.0) / 0.7)
        return np.asarray(rise * np.exp(-np.clip(t - start - 7.0, 0.0, None) / gone))

    psi, u, v = turned(t, 0.45), 2.3 * going(24.0, 4.0), -0.3 * going(26.0, 6.0)
    north, east = u * np.cos(psi) - v * np.sin(psi), u * np.sin(psi) + v * np.cos(psi)
    r = np.gradient(turned(t + rate_ahead, 0.45 + 0.05 * rate_ahead), t)
    motion = {"x": np.cumsum(north) * 0.1, "y": np.cumsum(east) * 0.1, "u": u, "v": v, "r": r}
    motion["psi"] = turned(t - heading_late, 0.45)
    noise = {"x": 0.003, "y": 0.003, "psi": 2e-5, "u": 5e-4, "v": 5e-4, "r": 1e-5}
    noisy = {n: y + noise[n] * rng.standard_normal(len(t)) for n, y in motion.items()}
    pushed = np.where((t > 24.0) & (t < 31.0), 30.0, 0.0)
    return run_of("turn", {"t": t, **noisy, "f1": pushed, "f2": 0.0 * pushed, "f3": 0.0 * pushed})


def test_a_heading_that_the_position_shows_to_be_in_time_is_not_late() -> None:
    # By rate and heading alone it would be late by 3.8 s; turned by the heading as it was 3.8 s later, the
    # velocities would no longer be those with which the position changes.
    vehicle = vehicle_of(make_case("usv", (), 0, duration=20.0, runs=("steps",)))
    found = {f.id for f in examine(vehicle, [_one_turn(3.9, 0.0)]).result.findings}
    assert not found & {"late_pose", "late_velocity", "latencies", "velocity_sensor"}
    assert "inconsistent" in found


@pytest.mark.parametrize("late", [1.5, 3.9])
def test_a_heading_that_is_late_for_the_position_too_is_late(late: float) -> None:
    vehicle = vehicle_of(make_case("usv", (), 0, duration=20.0, runs=("steps",)))
    found = {f.id: f for f in examine(vehicle, [_one_turn(0.0, late)]).result.findings}
    assert found["late_pose"].text.startswith("psi is")
    assert found["late_pose"].evidence["delay"] == pytest.approx(late, abs=0.02)


@pytest.mark.parametrize("seed", range(4))
def test_a_late_rate_is_found_where_the_position_does_not_show_when_the_heading_was(seed: int) -> None:
    """A boat at 1 Hz whose gyroscope is 2.3 s late, and whose fixes scatter by ten times its way in a second.

    The delay of the heading against them, of which nothing is known, takes nothing from what is.
    """
    rng, t = np.random.default_rng(seed), np.arange(0.0, 320.0, 1.0)
    fine = np.arange(-5.0, 320.0, 0.05)
    psi = 0.15 * np.sin(fine / 17) + 0.1 * np.sin(fine / 9 + seed) + 0.05 * np.sin(fine / 4)
    north, east = (np.cumsum(0.1 * turned(psi)) * 0.05 for turned in (np.cos, np.sin))
    exact = {"x": north, "y": east, "psi": psi, "u": 0.1 + 0.0 * fine, "v": 0.0 * fine}
    columns = {n: np.interp(t, fine, y) for n, y in exact.items()}
    columns["r"] = np.interp(t - 2.3, fine, np.gradient(psi, fine))
    noise = {"x": 1.0, "y": 1.0, "psi": 5e-4, "u": 0.01, "v": 0.01, "r": 2e-4}
    noisy = {n: y + noise[n] * rng.standard_normal(len(t)) for n, y in columns.items()}
    rests = {n: np.zeros(len(t)) for n in ("f1", "f2", "f3")}
    run = run_of("slow", {"t": t, **noisy, **rests})
    vehicle = vehicle_of(make_case("usv", (), 0, duration=20.0, runs=("steps",)))
    (late,) = [one for one in latencies(Kinematics([run], vehicle), [run]) if one.names == ("r",)]
    assert late.clear(1.0)
    assert late.delay == pytest.approx(2.3, abs=4 * late.error)
