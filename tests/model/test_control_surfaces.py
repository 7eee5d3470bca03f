"""Rudders and fins: lift, the speed that steering costs, the slipstream, the gear, and their file."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import sympy as sm

import undertow as ut
from tests.quick import first_quick
from undertow.codegen.functions import Functions
from undertow.model.catalogue import catalogue
from undertow.model.loading import load_vehicle
from undertow.model.saving import save_vehicle
from undertow.model.symbols import symbol
from undertow.model.vehicle import Value, Vehicle

SHIP = """
schema = "undertow/vehicle/1"
name = "ship"
degrees_of_freedom = ["surge", "sway", "heave", "roll", "pitch", "yaw"]
signs = "sname"

[effects.rigid_body]
m = "100 kg"
I_x = "10 kg m^2"
I_y = "40 kg m^2"
I_z = "40 kg m^2"

[effects.rigid_body_coriolis]

[effects.linear_damping]
X_u = "-10 kg/s"
Y_v = "-200 kg/s"
Z_w = "-200 kg/s"
K_p = "-30 kg m^2/s"
M_q = "-100 kg m^2/s"
N_r = "-100 kg m^2/s"

[[thrusters]]
name = "prop"
position = ["-0.9 m", "0 m", "0 m"]
direction = [1, 0, 0]

[[surfaces]]
name = "fin"
position = ["-1 m", "0 m", "0.1 m"]
axis = {axis}
area = "0.02 m^2"
{more}
"""
LIFT = 'lift_coefficient = { value = 2.5, estimate = true, source = "tunnel" } # measured'
SLIPSTREAM = '\nslipstream_of = "prop"\npropeller_diameter = "15 cm"\n'
Build = Callable[..., Vehicle]


@pytest.fixture
def build(tmp_path: Path) -> Build:
    def made(axis: str = '"rudder"', more: str = LIFT) -> Vehicle:
        file = tmp_path / "ship.toml"
        file.write_text(SHIP.format(axis=axis, more=more))
        return load_vehicle(file)

    return made


def _force(vehicle: Vehicle, nu: np.ndarray, thrust: float, angle: float) -> np.ndarray:
    """Wrench of the surfaces alone, N and N m."""
    known = {n: vehicle.value_of(n).value for n in vehicle.parameter_names}
    wrench = next(w for e, w in vehicle.composition.wrenches.items() if e.id == "control_surfaces")
    at = known | dict(zip("uvwpqr", nu, strict=True)) | {"actuation_prop": thrust, "deflection_fin": angle}
    return np.array(wrench.xreplace({symbol(n): sm.Float(v) for n, v in at.items()}), dtype=float)[:, 0]


@pytest.mark.parametrize("seed", range(4))
def test_the_force_is_across_the_chord_in_the_flow_at_the_rudder(build: Build, seed: int) -> None:
    vehicle, rng = build(more=LIFT + "\ndrag_coefficient = 0.02"), np.random.default_rng(seed)
    nu, angle = rng.uniform(-1, 1, 6), rng.uniform(-0.6, 0.6)
    place = np.array([-1.0, 0.0, 0.1])
    at = nu[:3] + np.cross(nu[3:], place)
    # The trailing edge of a rudder goes to starboard with a positive angle, its leading edge to port.
    chord = np.array([np.cos(angle), -np.sin(angle), 0.0])
    across = np.array([-np.sin(angle), -np.cos(angle), 0.0])
    flat = at * [1.0, 1.0, 0.0]
    speed = np.hypot(*flat[:2])
    attack = np.arctan2(-flat @ across, flat @ chord)
    pressure = 0.5 * 1000.0 * 0.02 * speed**2
    force = pressure * 2.5 * np.sin(attack) * across - pressure * 0.02 * flat / speed
    expected = np.concatenate([force, np.cross(place, force)])
    np.testing.assert_allclose(_force(vehicle, nu, 3.0, angle), expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("axis", first_quick(["[0, 0.6, 0.8]", '"rudder"', '"stern_plane"']))
def test_a_surface_without_slipstream_takes_power_out(build: Build, axis: str) -> None:
    vehicle, rng = build(axis), np.random.default_rng(3)
    for _ in range(20):
        nu = rng.uniform(-2, 2, 6)
        assert nu @ _force(vehicle, nu, 0.0, rng.uniform(-1.5, 1.5)) <= 0.0


def test_a_rudder_to_starboard_turns_to_starboard_and_costs_speed(build: Build) -> None:
    ahead = np.array([2.0, 0, 0, 0, 0, 0])
    force = _force(build(), ahead, 0.0, 0.3)
    assert force[5] > 0 > force[1]
    # Without leading-edge suction drag is lift times the tangent of the angle.
    assert force[0] == pytest.approx(-abs(force[1]) * np.tan(0.3))
    dive = _force(build('"stern_plane"'), ahead, 0.0, 0.3)
    assert dive[4] < 0 > dive[2]


def test_the_slipstream_is_that_of_momentum_theory(build: Build) -> None:
    """At rest the water far behind a propeller has v^2 = 2 T/(rho A); a rudder at the limit feels a half."""
    vehicle = build(more=LIFT + SLIPSTREAM)
    still, disc, thrust, angle = np.zeros(6), np.pi * 0.15**2 / 4, 30.0, 0.2
    speed = 0.5 * np.sqrt(2 * thrust / (1000.0 * disc))
    side = 0.5 * 1000.0 * 0.02 * 2.5 * np.sin(angle) * np.cos(angle) * speed**2
    assert _force(vehicle, still, thrust, angle)[1] == pytest.approx(-side, rel=1e-4)
    assert _force(vehicle, still, -thrust, angle)[1] == pytest.approx(0.0, abs=1e-6)


def test_the_rate_of_the_gear_is_limited(build: Build) -> None:
    vehicle = build(more=LIFT + '\nrate = "5 deg/s"\nlag = "50 ms"\nlimit = "35 deg"\n')
    model = ut.compile(vehicle)
    t = np.arange(0.0, 9.0, 0.05)
    x = model.simulate(np.zeros(13), np.tile([0.0, np.radians(30.0)], (len(t), 1)), 0.05)
    angle = x[:, model.states.index("angle_fin")]
    assert angle[60] == pytest.approx(np.radians(15.0), abs=1e-6)
    assert angle[-1] == pytest.approx(np.radians(30.0), abs=1e-6)


def test_regressor_and_c_have_the_surface_from_its_one_declaration(build: Build) -> None:
    f = Functions(build(more=LIFT + SLIPSTREAM))
    rng = np.random.default_rng(1)
    x, a, u = (rng.uniform(-1, 1, n) for n in (len(f.state_names), 6, 2))
    p = np.array(f.values())
    place = f.parameter_names.index("C_N_fin")
    column = np.array(f.regressor(x, a, u, p, 0.0))[:, place]
    force = _force(f.vehicle, x[6:12], u[0], u[1])
    np.testing.assert_allclose(p[place] * column, force, rtol=1e-9, atol=1e-9)


def test_the_lift_of_a_slender_plate_follows_from_its_aspect_ratio(build: Build) -> None:
    value = build(more="aspect_ratio = 1.827").value_of("C_N_fin")
    assert value.value == pytest.approx(2.747, abs=1e-3)  # KVLCC2: Yasukawa and Yoshimura (2015), table 4
    assert "Fujii" in value.source


def test_a_fitted_surface_goes_back_into_its_own_table(build: Build, tmp_path: Path) -> None:
    vehicle = build(more=LIFT + '\nrate = "5 deg/s"\nlag = "50 ms"\n')
    fitted = vehicle.with_values({"C_N_fin": Value(3.5, estimate=True, sigma=0.1)})
    out = tmp_path / "out.toml"
    save_vehicle(fitted, tmp_path / "ship.toml", out)
    table = tomllib.loads(out.read_text())["surfaces"][0]
    assert table["lift_coefficient"]["value"] == 3.5
    assert (table["rate"], table["lag"]) == ("5 deg/s", "50 ms")
    assert "steering_gear" not in tomllib.loads(out.read_text())["effects"]
    assert load_vehicle(out).value_of("C_N_fin").sigma == 0.1


def test_a_gear_that_the_file_lacks_can_be_added(build: Build, tmp_path: Path) -> None:
    vehicle = build().with_effect(catalogue()["steering_gear"], {"lag_fin": Value(0.7, estimate=True)})
    out = tmp_path / "out.toml"
    save_vehicle(vehicle, tmp_path / "ship.toml", out)
    again = load_vehicle(out)
    assert again.value_of("lag_fin").value == 0.7
    assert "angle_fin" in Functions(again).state_names


@pytest.mark.parametrize(
    ("axis", "more", "complaint"),
    [
        ('"rudder"', "", "needs 'lift_coefficient' or 'aspect_ratio'"),
        ('"keel"', LIFT, "axis 'keel' is not known: give rudder, stern_plane or a unit vector"),
        ("[1, 0, 0]", LIFT, "give a unit vector across the x axis"),
        (
            '"rudder"',
            LIFT + '\nslipstream_of = "prop"',
            "needs both 'slipstream_of' and 'propeller_diameter'",
        ),
        ('"rudder"', LIFT + '\nslipstream_of = "x"\npropeller_diameter = 1', "the thrusters are prop"),
        ('"rudder"', LIFT + "\nlimit = -1", "surface 'fin' limit = -1 is impossible"),
        ('"rudder"', "lift_coefficient = -2", "surface 'fin' C_N_fin = -2 is impossible"),
    ],
)
def test_what_cannot_be_is_refused(build: Build, axis: str, more: str, complaint: str) -> None:
    with pytest.raises(ut.UndertowError) as caught:
        build(axis, more)
    assert complaint in str(caught.value)
