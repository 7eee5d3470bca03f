"""Control laws on a vehicle with a rudder and a logged wind: they know neither, but the rudder at a speed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from undertow.control.closed_loop import ClosedLoop, Overrides, Scenario
from undertow.control.conditions.full_loop import certify
from undertow.control.conditions.tracking import check_mission
from undertow.control.gains import GainSet, GainTable, allocation_of, gains_from_table, load_gains
from undertow.control.guidance.mission import MissionTable, mission_from_table
from undertow.control.linear.family import family
from undertow.control.linear.systems import close_loop, forces_of
from undertow.control.plant import Plant
from undertow.errors import UndertowError
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


# --- surfaces that a law steers by ------------------------------------------------------------------
TORPEDO = """
schema = "undertow/vehicle/1"
name = "torpedo"
degrees_of_freedom = ["surge", "sway", "yaw"]
signs = "sname"
water_density = 1000

[effects.rigid_body]
m = 30
I_z = 3.5

[effects.rigid_body_coriolis]

[effects.added_mass]
X_udot = -1
Y_vdot = -35
N_rdot = -5

[effects.added_mass_coriolis]

[effects.quadratic_damping]
X_uabsu = -5
Y_vabsv = -130
N_rabsr = -90

[[thrusters]]
name = "propeller"
position = [-0.67, 0, 0]
direction = [1, 0, 0]
limit = 30

[[surfaces]]
name = "rudder"
position = [-0.64, 0, 0]
axis = "rudder"
area = 0.013
aspect_ratio = 2.25
limit = "20 deg"
rate = "60 deg/s"
"""
STEERED = {
    "schema": "undertow/gains/1",
    "name": "autopilot",
    "law": "pid",
    "unactuated": ["sway"],
    "gains": {"K_P": 10.0, "K_V": {"x": 30.0, "y": 30.0, "psi": 20.0}, "K_I": 1.0},
}
LEG = {
    "schema": "undertow/mission/1",
    "name": "leg",
    "kind": "legs",
    "speed": 1.5,
    "current": {"east": 0.3},
    "limits": {"acceleration": 0.2, "turn_rate": "8 deg/s", "turn_acceleration": "8 deg/s^2"},
    "guidance": {"lookahead": 15, "integral": 0.3, "acceptance": 5},
    "waypoints": [{"x": 0.0, "y": 0.0}, {"x": 600.0, "y": 0.0}],
}


def steered(tmp_path: Path, **allocation: object) -> GainSet:
    (tmp_path / "torpedo.toml").write_text(TORPEDO)
    table = GainTable.model_validate(STEERED | {"allocation": allocation})
    return gains_from_table(table, load_vehicle(tmp_path / "torpedo.toml"))


def test_the_allocation_of_a_rudder_is_its_force_at_the_stated_speed(tmp_path: Path) -> None:
    """rho/2 A C_N U^2 across the hull per rad, C_N = 6.13 Lambda/(Lambda + 2.25), at its lever."""
    gains = steered(tmp_path, speed="2 m/s", limits={"rudder": "15 deg"})
    across = 0.5 * 1000 * 0.013 * 6.13 * 0.5 * 2.0**2
    np.testing.assert_allclose(
        gains.plant.thrust_matrix, [[1, 0], [0, -across], [0, 0.64 * across]], rtol=1e-9, atol=1e-12
    )
    np.testing.assert_allclose(allocation_of(gains).limits, [30.0, np.radians(15)])
    np.testing.assert_allclose(allocation_of(steered(tmp_path, speed=2.0)).limits, [30.0, np.radians(20)])
    assert {"control_surfaces", "steering_gear"} <= gains.plant.left_out.keys()


def test_fins_as_forces_with_the_motion_ask_for_a_speed_as_well() -> None:
    with pytest.raises(UndertowError, match=r"in heave, pitch, yaw.* state \[allocation\] speed"):
        load_gains("paper-pd", load_vehicle("remus100"))


def test_without_a_speed_a_law_has_no_rudder(tmp_path: Path) -> None:
    with pytest.raises(UndertowError, match=r"in yaw.* state \[allocation\] speed"):
        steered(tmp_path)


def test_a_torpedo_steered_by_a_surface_keeps_its_leg_across_a_current(tmp_path: Path) -> None:
    """The heading into the current is asin(0.3/1.5), as for any vehicle; the wrong sign runs away."""
    gains = steered(tmp_path, speed="1.5 m/s")
    mission = mission_from_table(MissionTable.model_validate(LEG))
    assert check_mission(gains, mission).ok
    vehicle = Overrides(current=(0.0, 0.3)).in_current(gains.plant.vehicle)
    loop = ClosedLoop(gains, vehicle, mission=mission)
    record = loop.run(Scenario(duration=300.0, dt=0.05, start=(0.0, 10.0, 0.0), moving={"u": 1.5}))
    assert record.followed is not None
    late = (record.t > 250) & ~record.followed.arrived
    assert np.abs(record.followed.errors["cross track"][late]).max() < 0.2
    assert record.state["psi"][late] == pytest.approx(-np.arcsin(0.3 / 1.5), abs=0.03)
    assert np.abs(record.commands["rudder"]).max() <= np.radians(20) + 1e-9
    turned = replace(gains, values={k: -v if k.endswith("psi") else v for k, v in gains.values.items()})
    assert not check_mission(turned, mission).ok


def test_a_rudder_holds_no_heading_at_rest(tmp_path: Path) -> None:
    """Nothing is left alone and the conditions hold, but without way on no rudder corrects an error."""
    path = tmp_path / "sideways.toml"
    path.write_text(TORPEDO + '[[thrusters]]\nname = "side"\nposition = [0, 0, 0]\ndirection = [0, 1, 0]\n')
    gains = {n: STEERED["gains"][n] for n in ("K_P", "K_V")}
    table = STEERED | {"law": "pd", "unactuated": [], "allocation": {"speed": 1.5}, "gains": gains}
    report = certify(gains_from_table(GainTable.model_validate(table), load_vehicle(path)), forms=["derived"])
    assert report.conditions_hold
    assert not report.ok
    assert report.full_loop is not None
    assert not report.full_loop.stable
