"""A rudder that turns no faster than its gear, in the log of a ship whose file has its rudder at once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import undertow as ut
from undertow.identification.logs.run import Run
from undertow.model.loading import load_vehicle
from undertow.model.vehicle import Vehicle

_SHIP = """
schema = "undertow/vehicle/1"
name = "ship"
degrees_of_freedom = ["surge", "sway", "yaw"]
signs = "sname"
[effects.rigid_body]
m = "100 kg"
I_z = "40 kg m^2"
[effects.rigid_body_coriolis]
[effects.linear_damping]
X_u = { value = "-10 kg/s", estimate = true }
Y_v = { value = "-200 kg/s", estimate = true }
N_r = { value = "-100 kg m^2/s", estimate = true }
[[thrusters]]
name = "prop"
position = ["-0.9 m", "0 m", "0 m"]
direction = [1, 0, 0]
[[surfaces]]
name = "rudder"
position = ["-1 m", "0 m", "0 m"]
axis = "rudder"
area = "0.02 m^2"
lift_coefficient = { value = 2.5, estimate = true }
"""
_RATE = np.radians(3.0)


@pytest.fixture
def ship(tmp_path: Path) -> Vehicle:
    """Surge, sway and yaw, a propeller and a rudder."""
    path = tmp_path / "ship.toml"
    path.write_text(_SHIP)
    return load_vehicle(path)


def _run(path: Path, seed: int) -> Run:
    """Rudder orders of up to 30 degrees for 10 to 25 s each, and what the motion sensors show."""
    path.write_text(_SHIP + f'rate = "{_RATE} rad/s"\nlag = "0.3 s"\n')
    model, rng, step = ut.compile(load_vehicle(path)), np.random.default_rng(seed), 0.2
    orders = np.repeat(rng.uniform(-0.5, 0.5, 6), rng.integers(50, 125, 6))
    commands = {"prop": np.full(len(orders), 20.0), "rudder": orders}
    x = model.simulate(np.zeros(len(model.states)), np.column_stack([*commands.values()]), step)
    noise = {"psi": 0.002, "u": 0.005, "v": 0.005, "r": 0.001}
    own = {n: x[:, model.states.index(n)] + s * rng.standard_normal(len(x)) for n, s in noise.items()}
    return Run(f"run{seed}", step * np.arange(len(orders)), own | commands)


def test_the_rate_of_a_gear_that_the_file_lacks_is_found(ship: Vehicle, tmp_path: Path) -> None:
    """Its default, 10 rad/s, limits nothing: a search from there alone never moves it."""
    runs = [_run(tmp_path / "true.toml", seed) for seed in (1, 2)]
    better = ut.add_effect(ship, "steering_gear", runs[:1], runs[1:])
    assert better.value_of("rate_rudder").value == pytest.approx(_RATE, rel=0.1)
    assert better.value_of("C_N_rudder").value == pytest.approx(2.5, rel=0.05)
