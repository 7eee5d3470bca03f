"""The frequency at which a residual swings most."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from undertow.identification.diagnosis.candidates import dominant_frequency
from undertow.identification.estimation.data import WeakData, prepare
from undertow.identification.logs.run import Run
from undertow.model.effects.rigid_body import RigidBody
from undertow.model.effects.waves import Waves
from undertow.model.vehicle import Value, Vehicle

VESSEL = Vehicle(
    "vessel", ("surge", "sway", "yaw"), (RigidBody(),), {"m": Value(20.0), "I_z": Value(2.0)}, signs="sname"
)


def turning(seconds: float, *, runs: int = 2) -> WeakData:
    """Runs in which the vessel turns all the time."""
    t = np.arange(0.0, seconds, 0.05)
    rng = np.random.default_rng(7)
    channels = {n: 0.01 * rng.standard_normal(len(t)) for n in ("x", "y", "u", "v", "r")}
    return prepare([Run(f"run {i}", t, {**channels, "psi": 0.3 * t}) for i in range(runs)], VESSEL)


def swinging(data: WeakData, frequency: float, size: float) -> NDArray[np.float64]:
    """Noise of unit size and a force to the east that swings."""
    r = np.random.default_rng(8).standard_normal(len(data.time)).reshape(-1, len(data.rows))
    t = data.time.reshape(r.shape)[:, 0]
    force = size * np.cos(frequency * t + 0.4)
    r[:, 0] += force * np.sin(0.3 * t)
    r[:, 1] += force * np.cos(0.3 * t)
    return r.ravel()


@pytest.mark.parametrize("frequency", [0.7, 1.9, 4.2])
def test_a_swing_over_ground_is_found_although_the_vessel_turns(frequency: float) -> None:
    data = turning(100.0)
    found = dominant_frequency(swinging(data, frequency, 0.4), data)
    assert found is not None
    assert found[0] < frequency < found[1]
    assert found[1] - found[0] == pytest.approx(4 * np.pi / 100, rel=0.02)


def test_a_force_that_turns_with_the_vessel_is_no_swing() -> None:
    data = turning(100.0)
    r = swinging(data, 1.9, 0.4) + 3.0 * np.repeat(data.time.reshape(-1, len(data.rows))[:, 0] / 100, 6)
    found = dominant_frequency(r, data)
    assert found is not None
    assert found[0] < 1.9 < found[1]


def test_short_runs_have_no_frequency() -> None:
    data = turning(8.0)
    assert dominant_frequency(np.ones(len(data.time)), data) is None


def test_waves_begin_where_something_swings() -> None:
    starts = Waves.starts_near({"x": (0.0, 1.0), "dominant_frequency": (1.0, 1.2)})
    assert sorted({s["wave_frequency"] for s in starts}) == pytest.approx([1.05, 1.1, 1.15])
    assert len(starts) == 12
    assert Waves.starts_near({"x": (0.0, 1.0)}) == []


@pytest.mark.parametrize("gap", [0.0, 40.0])
def test_a_stretch_with_a_single_test_function_hides_no_swing(gap: float) -> None:
    """Between two gaps, or before the first, there may be a second or so."""
    t = np.arange(0.0, 100.0, 0.05)
    lost = np.zeros(len(t), dtype=bool)
    for begin in {gap, gap + 1.9} - {0.0}:
        lost |= (t > begin - 0.87) & (t < begin)
    rng = np.random.default_rng(7)
    channels = {n: 0.01 * rng.standard_normal(len(t)) for n in ("x", "y", "u", "v", "r")} | {"psi": 0.3 * t}
    data = prepare([Run("torn", t[~lost], {n: c[~lost] for n, c in channels.items()})], VESSEL)
    assert 1 in [s.functions.count for s in data.segments]
    found = dominant_frequency(swinging(data, 1.9, 0.8), data)
    assert found is not None
    assert found[0] < 1.9 < found[1]
