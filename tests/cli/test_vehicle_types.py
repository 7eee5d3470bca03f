"""`undertow vehicle new --type`: files by rules, against vehicles that were measured."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.cli.bad import refusal
from undertow.cli.main import main
from undertow.codegen.functions import Functions
from undertow.codegen.simulate import Simulator
from undertow.errors import UndertowError
from undertow.model.loading import load_vehicle
from undertow.model.plausibility import hints
from undertow.model.vehicle import Value, Vehicle
from undertow.shape.types import MainDimensions, typed_vehicle

Capture = pytest.CaptureFixture[str]
SIZES = {  # length, beam, height and mass of vehicles whose parameters are published
    "rov6": (0.457, 0.338, 0.254, 11.5),  # BlueROV2
    "rov8": (0.457, 0.575, 0.254, 11.5),
    "torpedo": (1.33, 0.191, 0.191, 30.48),  # REMUS 100
    "glider": (1.5, 0.22, 0.22, 52.0),
    "ship": (7.0, 1.27, 0.455, 3272.0),  # KVLCC2, model
    "asv": (2.0, 1.08, 0.134, 55.0),  # Otter
    "azimuth": (5.0, 2.8, 0.3, 1667.0),  # milliAmpere
}


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def words(kind: str) -> list[str]:
    length, beam, height, mass = (f"{x:g}" for x in SIZES[kind])
    sides = ["--length", length, "--beam", beam, "--height", height]
    return ["vehicle", "new", "--type", kind, *sides, "--mass", mass]


def made(kind: str) -> Vehicle:
    assert main([*words(kind), "--out", "my.toml", "--force"]) == 0
    return load_vehicle("my.toml")


@pytest.mark.parametrize("kind", SIZES)
def test_a_file_of_a_type_is_complete_and_says_where_its_numbers_are_from(kind: str, capsys: Capture) -> None:
    vehicle = made(kind)
    assert capsys.readouterr().err == ""
    assert [n for n, v in vehicle.values.items() if not v.source] == []
    assert [n for n, v in vehicle.values.items() if v.estimate and not v.sigma] == []
    said = [n for n, v in vehicle.values.items() if v.source and v.source.startswith("assumed")]
    assert [n for n in said if not vehicle.values[n].assumed] == [], "the place of the weight, too"
    assert {"rigid_body", "added_mass", "quadratic_damping"} <= {e.id for e in vehicle.effects}
    assert not any("nothing damps" in line or "absent" in line for line in hints(vehicle))
    assert vehicle.force_channels == ()
    limits = {n: np.degrees(vehicle.command_limits.get(n, np.inf)) for n in vehicle.angle_names}
    assert limits == pytest.approx(dict.fromkeys(limits, 35.0 if kind == "ship" else 20.0), abs=0.1)
    assert len(vehicle.thrusters) == {"rov6": 6, "rov8": 8, "torpedo": 3, "glider": 1, "azimuth": 4}.get(
        kind, 2
    )


def off(vehicle: Vehicle, published: dict[str, float]) -> dict[str, float]:
    """How many standard deviations of the rules lie between them and published values."""
    stated = {n: vehicle.values[n] for n in published}
    return {n: abs(v.value - published[n]) / (v.sigma or 1e-9) for n, v in stated.items()}


@pytest.mark.parametrize(
    ("kind", "published"),
    [
        ("torpedo", "remus100"),
        ("asv", "otter"),
        ("rov8", "bluerov2"),
    ],
)
def test_rules_are_as_far_off_a_measured_vehicle_as_they_say(kind: str, published: str) -> None:
    known = load_vehicle(published).values
    rules = made(kind)
    # Prestero raised the damping of turning far above what strips give, to fit his runs; the three that Wu
    # has for BlueROV2 are all the same, von Benzon's in pitch is a third of it.
    apart = {"torpedo": {"K_pabsp", "M_qabsq", "N_rabsr", "K_pdot"}, "rov8": {"M_qabsq"}}.get(kind, set())
    names = [n for n, v in rules.values.items() if v.estimate and n in known and n not in apart]
    assert len(names) >= 5
    distance = off(rules, {n: known[n].value for n in names})
    assert {n: d for n, d in distance.items() if d > 3} == {}
    assert np.median(list(distance.values())) < 1.5


def test_the_rules_for_ships_give_the_hull_of_kvlcc2() -> None:
    """MMG standard (Yasukawa and Yoshimura 2015), with the Munk moment of the added mass taken off N_v."""
    scale, length = 500 * 7.0 * 0.455, 7.0
    added = {"Y_vdot": -0.223 * scale * length, "X_udot": -0.022 * scale * length}
    added["N_rdot"] = -0.011 * scale * length**3
    lift = {"Y_uv": -0.315 * scale, "Y_ur": 0.083 * scale * length, "N_ur": -0.049 * scale * length**2}
    lift["N_uv"] = (-0.137 + 0.223 - 0.022) * scale * length
    resistance = {"X_uabsu": -0.022 * scale}
    distance = off(made("ship"), added | lift | resistance)
    assert {n: d for n, d in distance.items() if d > 2} == {}


def run(vehicle: Vehicle, commands: dict[str, float], seconds: float, **first: float) -> dict[str, float]:
    """Last state of a vehicle with held commands."""
    functions = Functions(vehicle)
    t = np.arange(0.0, seconds, 0.1)
    x0 = np.array([first.get(n, 0.0) for n in functions.state_names])
    u = np.tile([commands.get(c, 0.0) for c in vehicle.command_names], (len(t), 1))
    x = Simulator(functions, compiled=False).run(x0, t, u, np.array(functions.values()), max_step=0.05)
    return dict(zip(functions.state_names, x[-1], strict=True))


def test_vehicles_of_every_type_go_where_they_are_steered() -> None:
    straight = run(made("ship"), {"propeller": 40.0}, 60.0, u=1.2)
    turning = run(made("ship"), {"propeller": 40.0, "rudder": np.radians(20)}, 60.0, u=1.2)
    assert turning["psi"] > 0.5
    assert turning["u"] < 0.9 * straight["u"], "steering costs speed"
    assert run(made("asv"), {"port": 30.0, "starboard": 10.0}, 10.0)["r"] > 0.05
    diving = run(made("torpedo"), {"propeller": 6.0, "stern_plane": np.radians(3)}, 10.0, u=1.5)
    assert diving["z"] > 0.5
    down = run(made("rov6"), {"v1": 5.0, "v2": 5.0}, 10.0)
    assert down["z"] > 1.0
    assert abs(down["phi"]) + abs(down["theta"]) < 0.05
    glider = made("glider")
    heavier = Value(glider.value_of("B").value - 2.0)
    sunk = run(glider.with_values({"B": heavier, "S_x": Value(2.0)}), {}, 60.0)
    assert sunk["theta"] < -0.1, "bow down"
    assert sunk["u"] > 3 * abs(sunk["w"]), "it glides, and does not drop"


@pytest.mark.parametrize(
    ("length", "beam", "draught", "mass"),
    [(4.9, 2.4, 0.17, 180.0), (1.19, 0.93, 0.15, 15.0), (2.0, 1.08, 0.1341, 55.0)],
    ids=["WAM-V", "BlueBoat", "Otter"],
)
def test_catamarans_float_on_two_slim_hulls(length: float, beam: float, draught: float, mass: float) -> None:
    size = MainDimensions(length, beam, draught, mass)
    text = typed_vehicle("asv", size, "cat")
    assert f'm = {{ value = "{mass:g} kg"' in text
    hollow = replace(size, mass=mass / 5)
    with pytest.raises(UndertowError, match=r"possible: 0.045 to 0.98.*beam is overall.*height the draught"):
        typed_vehicle("asv", hollow, "cat")
    ship = replace(size, beam=0.2 * length, mass=0.09 * size.density * 0.2 * length**2 * draught)
    with pytest.raises(UndertowError, match=r"block coefficient of 0.09 \(possible: 0.1 to 0.98\)"):
        typed_vehicle("ship", ship, "mono")


def test_a_short_boat_with_a_rudder_follows_it() -> None:
    """An open boat of 4 m: the ships of the regression are longer for their beam, so it is a small craft."""
    text = typed_vehicle("ship", MainDimensions(4.0, 1.6, 0.25, 350.0), "boat")
    Path("boat.toml").write_text(text)
    boat = load_vehicle("boat.toml")
    assert boat.value_of("Y_vdot").value == pytest.approx(-1.5 * 350.0)
    left, right = (run(boat, {"propeller": 150.0, "rudder": angle}, 30.0)["r"] for angle in (-0.2, 0.2))
    assert right > 0.05
    assert left == pytest.approx(-right)


def test_azimuth_thrusters_push_sideways_and_turn() -> None:
    ferry = made("azimuth")
    aside = run(ferry, {"bow_y": 100.0, "stern_y": 100.0}, 20.0)
    assert aside["v"] > 0.05
    assert abs(aside["r"]) < 1e-9
    assert run(ferry, {"bow_y": 100.0, "stern_y": -100.0}, 20.0)["r"] > 0.02
    assert run(ferry, {"bow_x": 100.0, "stern_x": 100.0}, 20.0)["u"] > 0.3


def test_of_roll_and_pitch_alone_the_righting_moment_remains() -> None:
    """Buoyancy moves nothing there, and is not to be estimated: the moment has to be given with it."""
    assert main([*words("rov6"), "--dof", "roll,pitch,yaw", "--out", "my.toml"]) == 0
    vehicle = load_vehicle("my.toml")
    assert vehicle.value_of("S_z").value > 0.0
    assert not vehicle.value_of("B").estimate


@pytest.mark.parametrize(("kind", "dof"), [("asv", "surge,yaw"), ("torpedo", "surge,yaw"), ("rov6", "heave")])
def test_what_is_to_be_estimated_is_of_the_motions_that_are_asked_for(kind: str, dof: str) -> None:
    """No log of a vehicle without sway determines its damping in sway."""
    assert main([*words(kind), "--dof", dof, "--out", "my.toml"]) == 0
    vehicle = load_vehicle(Path("my.toml"))
    estimated = {n for n, v in vehicle.values.items() if v.estimate}
    assert estimated
    assert estimated <= {*vehicle.parameter_names}


def test_a_type_has_the_motions_that_are_asked_for(capsys: Capture, tmp_path: Path) -> None:
    assert main([*words("asv"), "--dof", "yaw,surge", "--out", "my.toml"]) == 0
    assert load_vehicle("my.toml").degrees_of_freedom == ("surge", "yaw")
    assert load_vehicle("my.toml").name == "my"
    message = "--type asv has no heave: choose from surge, sway, yaw"
    assert message in refusal([*words("asv"), "--dof", "surge,heave"], capsys, tmp_path)


@pytest.mark.parametrize(
    ("kind", "dof", "names"),
    [
        ("glider", "surge,heave,pitch", ()),
        ("glider", "heave,pitch", ()),
        ("torpedo", "surge,yaw", ("propeller", "rudder")),
        ("torpedo", "surge,heave,pitch", ("propeller", "stern_plane")),
        ("rov6", "surge,yaw", ("h1", "h2", "h3", "h4")),
        ("ship", "surge", ("propeller", "rudder")),
    ],
)
def test_a_file_has_the_commands_that_act_in_the_motions_that_are_asked_for(
    kind: str, dof: str, names: tuple[str, ...]
) -> None:
    """Every command of a vehicle is required of its logs; the rudder of a ship brakes it, too."""
    assert main([*words(kind), "--dof", dof, "--out", "my.toml"]) == 0
    vehicle = load_vehicle("my.toml")
    assert vehicle.command_names == names


@pytest.mark.parametrize(("mass", "what"), [(5, "rises"), (70, "sinks")])
def test_a_mass_that_no_hull_of_the_dimensions_has_is_refused(
    mass: float, what: str, capsys: Capture, tmp_path: Path
) -> None:
    size = ["--length", 1.5, "--beam", 0.22, "--height", 0.22, "--mass", mass]
    said = refusal(["vehicle", "new", "--type", "glider", *size], capsys, tmp_path)
    assert f"mass = {mass} kg {what}: a hull of these dimensions displaces" in said


def test_a_rudder_is_refused_without_a_speed_that_gives_it_force(capsys: Capture, tmp_path: Path) -> None:
    """A model in yaw alone has no speed ahead, whose square the force of a rudder grows with."""
    said = refusal([*words("ship"), "--dof", "yaw"], capsys, tmp_path)
    assert "without whose speed 'rudder' makes no force: give --dof surge,yaw" in said
    assert main([*words("asv"), "--dof", "yaw", "--out", "my.toml"]) == 0, "propellers push at rest"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"--height": "0.2"}, "is a block coefficient of 1.84 (possible: 0.1 to 0.98)"),
        ({"--mass": "0"}, "mass = 0 must be a positive number"),
        ({"--beam": "9"}, "beam = 9 m exceeds length = "),
        ({"--length": None}, "--type ship lacks dimensions"),
        ({"--type": None}, "give the shape only once"),
        ({"--type": "boat"}, "boat"),
    ],
)
def test_what_cannot_be_is_refused(
    change: dict[str, str | None], message: str, capsys: Capture, tmp_path: Path
) -> None:
    given = words("ship")
    for option, value in change.items():
        i = given.index(option)
        given[i : i + 2] = [] if value is None else [option, value]
    assert message in refusal(given, capsys, tmp_path)
    torpedo = words("torpedo")
    torpedo[-1] = "100"
    assert "a hull of these dimensions displaces" in refusal(torpedo, capsys, tmp_path)


def test_a_misspelt_type_is_refused_with_those_that_there_are(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["vehicle", "new", "--type", "asvv", "--length", 2, "--beam", 1, "--height", 0.1, "--mass", 50]
    line = refusal([*words, "--out", tmp_path / "boat.toml"], capsys, tmp_path)
    assert line.startswith("error: Invalid value for '--type': 'asvv' is not one of 'rov6', 'rov8'")
