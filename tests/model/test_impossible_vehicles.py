"""Vehicles that cannot be: refused in one line with the value, what is possible, and the remedy."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from undertow.errors import UndertowError
from undertow.model.catalogue import catalogue
from undertow.model.loading import load_vehicle
from undertow.model.plausibility import check_vehicle
from undertow.model.vehicle import Thruster, Value, Vehicle

Load = Callable[[str], Vehicle]

# Half a metre, 7.5 kg; every case is one change of it.
FILE = """\
schema = "undertow/vehicle/1"
name = "auv"
degrees_of_freedom = ["surge", "sway", "heave", "roll", "pitch", "yaw"]
signs = "sname"
water_density = 1000.0
gravity = 9.81
generalised_forces = ["tau_Y"]

[effects.rigid_body]
m = 7.5
I_x = 0.11
I_y = 0.199
I_z = 0.251
z_g = 0.01

[effects.added_mass]
X_udot = { value = -1.6, estimate = true, sigma = 0.3 }
N_rdot = -5.0

[effects.restoring]
W = 73.6
B = 75.0
z_b = -0.02

[effects.velocity_lever_arm]
x_s = 0.2

[effects.thruster_saturation]
saturation_limit = 6.0

[[thrusters]]
name = "f1"
position = [0.0, 0.16, 0.0]
direction = [1, 0, 0]
limit = 10.0

[[thrusters]]
name = "f2"
wrench = [1, 0, 0, 0, 0, 0.16]
thrust_per_command = 2.0
"""


@pytest.fixture
def load(tmp_path: Path) -> Load:
    def from_text(text: str) -> Vehicle:
        file = tmp_path / "vehicle.toml"
        file.write_text(text, encoding="utf-8")
        return load_vehicle(file)

    return from_text


def test_the_vehicle_itself_can_be(load: Load, caplog: pytest.LogCaptureFixture) -> None:
    assert load(FILE).name == "auv"
    assert caplog.messages == []


# what stands in the file, what is written instead, and what the line must say
IMPOSSIBLE = [
    # mass and inertia
    ("m = 7.5", "m = 0", r"rigid_body\] m = 0 kg is impossible \(possible: 1e-06 to 1e\+10 kg\): correct it"),
    ("m = 7.5", "m = 1e-300", "m = 1e-300 kg is impossible"),
    ("m = 7.5", "m = 7.5e12", r"m = 7\.5e\+12 kg is impossible"),
    ("m = 7.5", "m = { value = -7.5, allow_sign = true }", "m = -7.5 kg is impossible"),
    ("I_z = 0.251", "I_z = 0.0", r"I_z = 0 kg m\^2 is impossible: every body has some"),
    ("I_z = 0.251", "I_z = 1e-300", "I_z = 1e-300 .* the radius of gyration"),
    ("I_z = 0.251", "I_z = 2510.0", r"I_z = 2510 kg m\^2 makes 18.3 m the radius of gyration of 7.5 kg"),
    ("I_x = 0.11", "I_x = 0.6", r"I_x = 0.5992 .* more than I_y \+ I_z = 0.4493, which is impossible"),
    ("I_y = 0.199", "I_y = 0.5", "I_y = 0.4993 .* more than I_x"),
    ("I_z = 0.251", "I_z = 0.4", "I_z = 0.4 .* more than I_x"),
    ("z_g = 0.01", "z_g = 0.2", r"I_x = 0.11 .* leaves -0.19 about the centre of gravity: .*m r\^2 = 0.3"),
    ("z_g = 0.01", "mz_g = 1.5", "I_x = 0.11 .* leaves -0.19 about the centre of gravity"),
    ("z_g = 0.01", "x_g = 0.2", r"I_y = 0.199 .* leaves -0.101"),
    ("z_g = 0.01", "I_xz = 0.3", "products of inertia"),
    ("z_g = 0.01", "I_xy = 0.14", "products of inertia"),
    # weight and buoyancy
    ("W = 73.6", "W = 7.5", r"m g = 73.575 N does not fit W = 7.5 N \(possible: 0.938 to 60 N\)"),
    ("W = 73.6", "W = 200.0", r"W = 200 N, but m g = 73.575 N by \[effects.rigid_body\].*factor of 2"),
    ("W = 73.6", "W = 0.0", "W = 0 N is impossible"),
    ("W = 73.6", "W = { value = 7360.0, override = true }", "m g = 73.575 N does not fit W = 7360 N"),
    ("B = 75.0", "B = 750.0", r"B = 750 N does not fit W = 73.6 N \(possible: 9.2 to 589 N\)"),
    ("B = 75.0", "B = 7.5", "B = 7.5 N does not fit W"),
    ("B = 75.0", "B = 0.0", "B = 0 N does not fit W"),
    # water and gravity
    ("gravity = 9.81", "gravity = 981.0", r"gravity = 981 m/s\^2 .*possible: 9.7 to 9.9.*981 cm/s\^2"),
    ("gravity = 9.81", "gravity = 0.0", r"gravity = 0 m/s\^2 is impossible"),
    ("gravity = 9.81", 'gravity = "32.2 m/s^2"', "gravity = 32.2"),
    ("water_density = 1000.0", "water_density = 1.0", r"water_density = 1 kg/m\^3 .*1 g/cm\^3 is 1000"),
    ("water_density = 1000.0", "water_density = 1e6", "water_density = 1e.06"),
    # places
    ("[0.0, 0.16, 0.0]", "[0.0, 160.0, 0.0]", "'f1' is 160 m off the body origin of a vehicle of 7.5 kg"),
    ("[0.0, 0.16, 0.0]", "[0.0, 16.0, 0.0]", "thruster 'f1' is 16 m off .*lengths are in m, or have a unit"),
    ("0, 0, 0.16]", "0, 0, 160]", "thruster 'f2' is 160 m off"),
    ("x_s = 0.2", "x_s = 200.0", r"velocity_lever_arm\] x_s is 200 m off the body origin"),
    ("z_b = -0.02", "z_b = -20.0", r"restoring\] S_z is 20.4 m off"),
    # other numbers
    ("[1, 0, 0, 0, 0, 0.16]", "[1e300, 0, 0, 0, 0, 0.16]", r"'f2' wrench, its largest entry = 1e\+300"),
    ("[1, 0, 0, 0, 0, 0.16]", "[1e-300, 0, 0, 0, 0, 0]", "thruster 'f2' wrench, its largest entry = 1e-300"),
    ("[1, 0, 0, 0, 0, 0.16]", "[1e7, 0, 0, 0, 0, 0]", r"'f2' pushes with 2e\+07 N at a command of 1"),
    ("thrust_per_command = 2.0", "thrust_per_command = 1e300", r"thrust_per_command = 1e\+300 N is impossible"),
    ("thrust_per_command = 2.0", "thrust_per_command = 1e-300", "thrust_per_command = 1e-300 N is impossible"),
    ("limit = 10.0", "limit = 1e-300", "thruster 'f1' limit = 1e-300 is impossible"),
    ("limit = 10.0", "limit = 1e300", r"thruster 'f1' limit = 1e\+300 is impossible"),
    ("limit = 10.0", "limit = 1e9", r"'f1' pushes with 1e\+09 N at a command of 1e\+09"),
    ("saturation_limit = 6.0", "saturation_limit = 1e-300", "saturation_limit = 1e-300 is impossible"),
    ("N_rdot = -5.0", "N_rdot = -1e300", r"added_mass\] N_rdot = -1e\+300 is impossible"),
    ("sigma = 0.3", "sigma = 1e-300", r"added_mass\] X_udot sigma = 1e-300 is impossible"),
    ("sigma = 0.3", "sigma = 1e300", r"added_mass\] X_udot sigma = 1e\+300 is impossible"),
    ("sigma = 0.3", "sigma = 0.3, sigma_forward = 0.1", "X_udot has a sigma that holds for nothing"),
    # names
    *(
        ('name = "f1"', f'name = "{name}"', f"'{name}' has the name of a measured channel: rename it")
        for name in ("u_dot", "r_dot", "psi", "phi", "t", "u", "x", "tau_X", "tau_N")
    ),
    ('name = "f2"', 'name = "f1"', "two thrusters are called 'f1': rename one"),
    ('"pitch", "yaw"', '"pitch", "surge"', "degrees_of_freedom has 'surge' twice: keep one"),
    ('["tau_Y"]', '["tau_Y", "tau_X", "tau_Y"]', "generalised_forces has 'tau_Y' twice: keep one"),
    ("wrench = [", "position = [0, 0, 0]\nwrench = [", "'f2' needs either 'wrench' or 'position' and"),
]  # fmt: skip


@pytest.mark.parametrize(("before", "after", "message"), IMPOSSIBLE, ids=[c[1] for c in IMPOSSIBLE])
def test_refused(before: str, after: str, message: str, load: Load) -> None:
    assert before in FILE
    with pytest.raises(UndertowError) as caught:
        load(FILE.replace(before, after, 1))
    assert re.search(message, str(caught.value)), str(caught.value)
    assert str(caught.value).isprintable()


# --- what may be, although it looks odd -----------------------------------------------------------
@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("I_z = 0.251", "I_z = 0.3075"),  # a flat plate, I_z = I_x + I_y about its centre
        ("B = 75.0", "B = 370.0"),  # an empty hull with the displacement of five
        ("W = 73.6", "W = 60.0"),  # a mass that is wrong by a fifth, which a diagnosis can study
        ("water_density = 1000.0", "water_density = 1240.0"),  # the Dead Sea
        ("gravity = 9.81", "gravity = 9.764"),  # Huascaran
        ("[1, 0, 0, 0, 0, 0.16]", "[0.7071, 0.7071, 6e-17, 0, 0, 0.16]"),  # cosines of a right angle
        ("thrust_per_command = 2.0", "thrust_per_command = 0.0"),  # a rudder gives nothing at rest
        ("x_s = 0.2", "x_s = 2.5"),  # a sensor on a pole
        ("x_s = 0.2", "x_s = { value = 200.0, estimate = true }"),  # what a fit makes of it is the fit's
    ],
)
def test_accepted(before: str, after: str, load: Load) -> None:
    load(FILE.replace(before, after, 1))


def test_added_mass_does_not_hide_an_inertia_that_cannot_be(load: Load) -> None:
    """With N_rdot = -5 the whole mass matrix is positive for any I_z above -5 kg m^2."""
    with pytest.raises(UndertowError, match=r"I_z = 1e-06 kg m\^2 makes .* the radius of gyration"):
        load(FILE.replace("I_z = 0.251", "I_z = 1e-6"))


def test_only_the_moments_that_a_file_states_are_judged(load: Load) -> None:
    """A planar vehicle has I_z alone; a moment of zero that no equation uses is a blank, not a claim."""
    planar = FILE.replace(', "heave", "roll", "pitch"', "")
    assert load(planar.replace("I_x = 0.11\nI_y = 0.199\n", "")).values["I_z"].value == 0.251
    load(planar.replace("I_x = 0.11", "I_x = 0.0").replace("I_y = 0.199", "I_y = 0.0"))


# --- vehicles made in a program -------------------------------------------------------------------
def test_names_are_judged_whenever_a_vehicle_is_made(load: Load) -> None:
    vehicle = load(FILE)
    with pytest.raises(UndertowError, match="'w_dot' has the name of a measured channel"):
        replace(vehicle, thrusters=(Thruster("w_dot", (1.0, 0, 0, 0, 0, 0)),))
    with pytest.raises(UndertowError, match="degrees_of_freedom has 'yaw' twice"):
        replace(vehicle, degrees_of_freedom=("surge", "yaw", "yaw"))


def test_a_vehicle_from_a_program_faces_the_same_checks(load: Load) -> None:
    vehicle = load(FILE)
    check_vehicle(vehicle)
    with pytest.raises(UndertowError, match="B = 900 N does not fit W"):
        check_vehicle(vehicle.with_values({"B": Value(900.0)}))
    with pytest.raises(UndertowError, match="gravity = 1"):
        check_vehicle(replace(vehicle, environment={"rho": 1000.0, "g": 1.0}))


@pytest.mark.parametrize("surplus", [1430.0, -1430.0])
def test_a_net_buoyancy_of_many_weights_is_refused(surplus: float, load: Load) -> None:
    with pytest.raises(UndertowError, match=r"possible: up to 515 N either way"):
        check_vehicle(load(FILE).with_effect(catalogue()["net_buoyancy"], {"B_net": Value(surplus)}))


def test_two_quantities_of_one_name_are_refused(load: Load) -> None:
    class Twin(catalogue()["net_buoyancy"]):  # type: ignore[misc]
        """A second effect with a parameter of the first one's name."""

        id = "twin"

    vehicle = load(FILE).with_effect(catalogue()["net_buoyancy"], {"B_net": Value(1.0)})
    with pytest.raises(UndertowError, match="two quantities of the vehicle are called 'B_net'"):
        vehicle.with_effect(Twin, {})
