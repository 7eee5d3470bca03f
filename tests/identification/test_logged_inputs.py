"""Wind and voltage that a log holds drive the effects that need them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import undertow as ut
from undertow.codegen.functions import Functions
from undertow.codegen.simulate import Simulator
from undertow.identification.doctor.examine import refuse_impossible
from undertow.identification.logs.mapping import read_mapping
from undertow.identification.logs.reading import read_log
from undertow.identification.logs.run import Run
from undertow.model.catalogue import catalogue
from undertow.model.loading import load_vehicle
from undertow.model.plausibility import hints
from undertow.model.saving import save_vehicle
from undertow.model.vehicle import Value, Vehicle

BOAT = """
schema = "undertow/vehicle/1"
name = "boat"
degrees_of_freedom = ["surge", "sway", "yaw"]
signs = "sname"
inputs = ["wind_speed", "wind_from", "voltage"]

[effects.rigid_body]
m = "60 kg"
I_z = "8 kg m^2"

[effects.rigid_body_coriolis]

[effects.linear_damping]
X_u = "-30 kg/s"
Y_v = "-90 kg/s"
N_r = "-20 kg m^2/s"

[effects.wind]
area_frontal = {{ value = {frontal}, estimate = true }}
area_lateral = {{ value = {lateral}, estimate = true }}
x_wind = 0.2

[effects.supply_droop]
voltage_exponent = {{ value = {exponent}, estimate = true }}
voltage_nominal = "16 V"

[[thrusters]]
name = "port"
position = [-0.5, -0.3, 0]
direction = [1, 0, 0]

[[thrusters]]
name = "starboard"
position = [-0.5, 0.3, 0]
direction = [1, 0, 0]
"""
MAPPING = """
schema = "undertow/mapping/1"
[columns]
anemometer = { channel = "wind_speed", unit = "knot" }
vane = { channel = "wind_from", unit = "deg" }
battery = { channel = "voltage", unit = "mV" }
"""
KNOT = 1852.0 / 3600.0
TRUTH = {"frontal": 0.4, "lateral": 1.1, "exponent": 2.0}


def _boat(folder: Path, **values: float) -> Vehicle:
    file = folder / "boat.toml"
    file.write_text(BOAT.format(**values))
    return load_vehicle(file)


def _log(folder: Path) -> Path:
    """A minute with gusts and a battery that sags; the vane reports once a second."""
    functions, rng = Functions(_boat(folder, **TRUTH)), np.random.default_rng(2)
    t = np.arange(0.0, 60.0, 0.1)
    seconds = np.floor(t + 1e-9).astype(int)
    wind = 8.0 + 3.0 * rng.standard_normal(60)[seconds]
    place = np.radians(200.0 + 30.0 * rng.standard_normal(60)[seconds])
    volt = 16.0 - 3.0 * t / 60.0
    thrust = np.repeat(rng.uniform(-20, 40, (12, 2)), 50, axis=0)
    u = np.column_stack([thrust, wind, place, volt])
    x = Simulator(functions, compiled=False).run(np.zeros(6), t, u, np.array(functions.values()))
    x[:, 3:] += 1e-3 * rng.standard_normal(x[:, 3:].shape)
    rows = ["t,x,y,psi,u,v,r,port,starboard,anemometer,vane,battery"]
    for i, (now, state, given) in enumerate(zip(t, x, u, strict=True)):
        report = f"{given[2] / KNOT:.9g},{np.degrees(given[3]):.9g}" if i % 10 == 0 else ","
        numbers = ",".join(f"{v:.9g}" for v in (now, *state, *given[:2]))
        rows.append(f"{numbers},{report},{1000 * given[4]:.9g}")
    (folder / "log.toml").write_text(MAPPING)
    (folder / "log.csv").write_text("\n".join(rows) + "\n")
    return folder / "log.csv"


def test_areas_and_the_exponent_of_the_voltage_are_found_from_logged_wind_and_voltage(tmp_path: Path) -> None:
    log, mapping = _log(tmp_path), read_mapping(tmp_path / "log.toml")
    vehicle = _boat(tmp_path, frontal=0.1, lateral=0.1, exponent=0.0)
    run = read_log(log, mapping, vehicle.command_names)
    assert run.channels["wind_from"][5] == run.channels["wind_from"][0], "held until the next report"
    found = ut.fit(vehicle, [run]).vehicle
    assert found.value_of("area_frontal").value == pytest.approx(0.4, rel=0.05)
    assert found.value_of("area_lateral").value == pytest.approx(1.1, rel=0.05)
    assert found.value_of("voltage_exponent").value == pytest.approx(2.0, abs=0.1)


def test_what_a_log_holds_is_an_input_and_no_parameter(tmp_path: Path) -> None:
    vehicle = _boat(tmp_path, **TRUTH)
    assert vehicle.command_names == ("port", "starboard", "wind_speed", "wind_from", "voltage")
    assert not {"wind_speed", "wind_from", "voltage", "droop_rate"} & {*vehicle.parameter_names}
    current = vehicle.with_effect(catalogue()["ocean_current"], {"V_N": Value(0.1)})
    assert {"V_N", "V_E"} <= {*current.parameter_names}, "which inputs does not name"


@pytest.mark.parametrize(
    ("inputs", "complaint"),
    [
        ('["wind_sped"]', "inputs names 'wind_sped', which no effect reads from a log (did you mean"),
        ('["apparent_wind_speed"]', "names 'apparent_wind_speed' without 'apparent_wind_angle'"),
    ],
)
def test_unknown_inputs_are_refused(inputs: str, complaint: str, tmp_path: Path) -> None:
    file = tmp_path / "boat.toml"
    text = BOAT.format(**TRUTH).replace('["wind_speed", "wind_from", "voltage"]', inputs)
    file.write_text(text)
    with pytest.raises(ut.UndertowError) as caught:
        load_vehicle(file)
    assert complaint in str(caught.value)


GLIDER = """
schema = "undertow/vehicle/1"
name = "glider"
degrees_of_freedom = [{dofs}]
signs = "sname"
{inputs}

[effects.rigid_body]
m = "60 kg"
I_y = "15 kg m^2"

[effects.rigid_body_coriolis]

[effects.added_mass]
X_udot = -5.0
Z_wdot = -60.0
M_qdot = -9.0

[effects.added_mass_coriolis]

[effects.linear_damping]
X_u = "-4 kg/s"
Z_w = "-80 kg/s"
M_q = "-30 kg m^2/s"

[effects.lift]
Z_uw = "-90 kg/m"

[effects.net_buoyancy]
B_net = "-6 N"
"""


def _glider(folder: Path, inputs: str, *dofs: str) -> Vehicle:
    file = folder / "glider.toml"
    file.write_text(GLIDER.format(dofs=", ".join(f'"{d}"' for d in dofs), inputs=inputs))
    return load_vehicle(file)


def test_a_pitch_that_is_measured_but_not_modelled_is_prescribed(tmp_path: Path) -> None:
    """Surge and heave with the pitch of the log accelerate as the model with pitch does at its motion."""
    whole = Functions(_glider(tmp_path, "", "surge", "heave", "pitch"))
    part = Functions(_glider(tmp_path, 'inputs = ["theta", "q"]', "surge", "heave"))
    rng = np.random.default_rng(0)
    for _ in range(5):
        x, z, theta, u, w, q = rng.uniform(-1, 1, 6)
        full = np.array(whole.dynamics([x, z, theta, u, w, q], [], whole.values(), 0.0)).ravel()
        alone = part.dynamics([x, z, u, w], [theta, q], part.values(), 0.0)
        prepared = part.prepared.dynamics([x, z, u, w], [theta, q], part.prepared.prepare(part.values()), 0.0)
        np.testing.assert_allclose(np.array(alone).ravel(), full[[0, 1, 3, 4]], rtol=1e-9)
        np.testing.assert_allclose(np.array(prepared).ravel(), full[[0, 1, 3, 4]], rtol=1e-9)


def test_a_state_of_the_model_is_no_input(tmp_path: Path) -> None:
    with pytest.raises(ut.UndertowError, match="inputs names 'theta', but pitch is a degree of freedom"):
        _glider(tmp_path, 'inputs = ["theta"]', "surge", "heave", "pitch")


SURFACE = """
[[surfaces]]
name = "rudder"
position = [-1, 0, 0]
axis = "rudder"
area = 0.02
aspect_ratio = 1.5
"""
FIN = """
[effects.rudder_force]
rudder_rudder = { value = 10.0, estimate = true }
rudder_port = 0
rudder_starboard = 0
[[thrusters]]
name = "rudder"
position = [-1, 0, 0]
direction = [0, -1, 0]
thrust_per_command = 0
"""


@pytest.mark.parametrize("hardware", [SURFACE, FIN])
def test_a_rudder_in_degrees_turns_farther_than_any_does(hardware: str, tmp_path: Path) -> None:
    """Five degrees read as radians are most of a turn; half a radian is what rudders do."""
    (tmp_path / "boat.toml").write_text(BOAT.format(**TRUTH) + hardware)
    vehicle, t = load_vehicle(tmp_path / "boat.toml"), np.arange(0.0, 20.0, 0.1)
    assert vehicle.command_units["rudder"] == "rad"
    swing = 0.1 * np.sin(t)
    values = {n: swing for n in (*vehicle.command_names, "x", "y", "psi", "u", "v", "r")}
    run = Run("degrees", t, values | {"rudder": 5.0 * np.sign(np.sin(t))})
    with pytest.raises(ut.UndertowError, match="rudder is in degrees, read as radians"):
        ut.fit(vehicle, [run])
    refuse_impossible(vehicle, [Run("radians", t, values | {"rudder": 0.5 * np.sign(np.sin(t))})])


def test_inputs_that_no_effect_takes_yet_are_written_and_taken_by_the_effect_that_is_added(
    tmp_path: Path,
) -> None:
    text = BOAT.format(**TRUTH)
    wind = text[text.index("[effects.wind]") : text.index("[effects.supply_droop]")]
    template, out = tmp_path / "boat.toml", tmp_path / "new.toml"
    template.write_text(text.replace(wind, ""))
    boat = load_vehicle(template)
    unused = [line for line in hints(boat) if line.startswith("input ")]
    assert [line.split()[1] for line in unused] == ["wind_speed", "wind_from"], "the voltage has its effect"
    assert "(wind would)" in unused[0]
    save_vehicle(boat, template, out)
    assert load_vehicle(out).inputs == boat.inputs
    windy = boat.with_effect(catalogue()["wind"], {"area_frontal": Value(0.4), "area_lateral": Value(1.1)})
    assert windy.inputs == boat.inputs
    assert "wind_speed" not in windy.parameter_names, "it comes from the log"
    save_vehicle(windy, template, out)
    assert load_vehicle(out).value_of("area_lateral").value == 1.1
    assert not [line for line in hints(load_vehicle(out)) if line.startswith("input ")]


OWN_EFFECT = """
import sympy as sm
from undertow import Parameter, Wrench


class Ice(Wrench):
    \"\"\"Ice that drags.\"\"\"

    id = "ice"
    family = "water"
    reference = "none"
    ice_cover = Parameter("1", "share of the water that is ice", (0, 1), logged=True)

    def wrench(self, s):
        return sm.Matrix([-self.ice_cover * s.nu[0], 0, 0, 0, 0, 0])
"""


def test_an_input_of_an_effect_of_the_user_that_the_vehicle_lacks_is_written(tmp_path: Path) -> None:
    template, own, out = tmp_path / "boat.toml", tmp_path / "ice.py", tmp_path / "new.toml"
    template.write_text(BOAT.format(**TRUTH).replace('"voltage"]', '"voltage", "ice_cover"]'))
    own.write_text(OWN_EFFECT)
    boat = load_vehicle(template, effect_files=[own])
    save_vehicle(boat, template, out)
    assert load_vehicle(out, effect_files=[own]).inputs == boat.inputs
