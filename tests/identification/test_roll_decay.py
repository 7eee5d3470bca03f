"""A ship in free roll: only the ratio of stiffness and inertia shows; the file may have either one wrong."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.identification.logs_of import run_of
from tests.quick import first_quick
from undertow.identification.api import diagnose
from undertow.identification.logs.run import Run
from undertow.model.loading import load_vehicle
from undertow.model.vehicle import Vehicle

SHIP = Path(__file__).parents[2] / "examples" / "kvlcc2" / "vehicle.toml"
INERTIA, ADDED, DAMPING = 115.7, 20.0, 3.0
NOISE = 2e-4  # rad


@cache
def _ship() -> Vehicle:
    return load_vehicle(SHIP)


@cache
def _decay(heel: float, seed: int) -> Run:
    """Two minutes of free roll, 10 Hz."""
    arm = _ship().values["S_z"].value

    def rates(t: float, x: np.ndarray) -> tuple[float, float]:
        return x[1], (-arm * np.sin(x[0]) - DAMPING * x[1]) / (INERTIA + ADDED)

    t = np.arange(0.0, 120.0, 0.1)
    phi = solve_ivp(rates, (0.0, 120.0), (heel, 0.0), t_eval=t, method="DOP853", rtol=1e-10, atol=1e-12).y[0]
    noise = NOISE * np.random.default_rng(seed).standard_normal(t.size)
    return run_of(f"roll_{seed}", {"t": t, "phi": phi + noise})


def _with_arm(share: float) -> Vehicle:
    """The ship with a share of its righting arm in the file."""
    value = _ship().values["S_z"]
    return _ship().with_values({"S_z": replace(value, value=share * value.value)})


@pytest.mark.slow
@pytest.mark.parametrize("share", first_quick([0.4, 0.8, 0.6]))
def test_a_righting_arm_too_short_in_the_file_is_found_and_no_memory_of_the_water(share: float) -> None:
    found = diagnose(_with_arm(share), [_decay(0.15, 1), _decay(0.1, 2)], [_decay(0.12, 3)]).diagnosis
    assert found.effects == ["trim_offset"]
    # A memory that takes no more inertia from slow motion than the water has is no spring.
    assert not any("radiation_memory" in group.effects for group in found.indistinguishable)
    before, after = (max(step.ahead.values()) for step in (found.steps[0], found.steps[-1]))
    assert before > 0.4
    assert after < 0.06


def test_nothing_is_missing_where_the_arm_is_right() -> None:
    found = diagnose(_ship(), [_decay(0.15, 1), _decay(0.1, 2)], [_decay(0.12, 3)]).diagnosis
    assert found.verdict == "adequate"
