"""Control laws on a vehicle with a rudder and a logged wind: they know neither."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from undertow.control.gains import GainTable, gains_from_table
from undertow.control.linear.family import family
from undertow.control.linear.systems import close_loop, forces_of
from undertow.control.plant import Plant
from undertow.model.loading import load_vehicle

BOAT = """
schema = "undertow/vehicle/1"
name = "boat"
degrees_of_freedom = ["surge", "sway", "yaw"]
signs = "sname"
inputs = [{inputs}]

[effects.rigid_body]
m = 60
I_z = 8

[effects.linear_damping]
X_u = -30
Y_v = -90
N_r = -20

[effects.wind]
area_frontal = 0.3
area_lateral = 0.8
wind_speed = {speed}

[[thrusters]]
name = "port"
position = [-0.5, -0.3, 0]
direction = [1, 0, 0]

[[thrusters]]
name = "starboard"
position = [-0.5, 0.3, 0]
direction = [1, 0, 0]
"""
RUDDER = """
[[surfaces]]
name = "rudder"
position = [-1, 0, 0]
axis = "rudder"
area = 0.02
aspect_ratio = 1.5
rate = 0.2
"""


def test_a_law_commands_thrusters_and_takes_a_logged_wind_as_none(tmp_path: Path) -> None:
    logged = BOAT.format(inputs='"wind_speed", "wind_from"', speed=0.0).replace("wind_speed = 0.0\n", "")
    texts = {"calm": BOAT.format(inputs="", speed=0.0), "steered": logged + RUDDER}
    plants, vehicles = {}, {}
    for name, text in texts.items():
        (tmp_path / f"{name}.toml").write_text(text)
        vehicles[name] = load_vehicle(tmp_path / f"{name}.toml")
        plants[name] = Plant(vehicles[name])
    calm, steered = plants["calm"], plants["steered"]
    np.testing.assert_allclose(steered.thrust_matrix, calm.thrust_matrix)
    for matrix in ("M", "D", "g"):
        one, other = (getattr(p, matrix).xreplace(p.numbers) for p in (calm, steered))
        assert (one - other).applyfunc(abs).norm() == pytest.approx(0.0)
    assert {"rudder", "wind_speed", "wind_from"} <= steered.left_out.keys()
    names, commands = forces_of(vehicles["steered"])
    assert names == ["force_surge", "force_yaw"]
    np.testing.assert_allclose(commands[2:], 0.0)


def test_the_members_of_a_family_under_a_law_leave_the_rudder_alone(tmp_path: Path) -> None:
    path = tmp_path / "boat.toml"
    calm = BOAT.format(inputs="", speed=0.0) + RUDDER
    path.write_text(calm.replace("X_u = -30", "X_u = { value = -30, sigma = 3 }"))
    vehicle = load_vehicle(path)
    table = {"schema": "undertow/gains/1", "name": "boat", "law": "pd", "unactuated": ["sway"]}
    gains = gains_from_table(GainTable.model_validate(table | {"gains": {"K_P": 10.0, "K_V": 20.0}}), vehicle)
    stated, *_ = family(vehicle, {"u": 0.0}, 0, gains=gains).members
    loop = close_loop(vehicle, gains, {"u": 0.0})
    np.testing.assert_allclose(stated.system.A, loop.closed.A, atol=1e-9)
