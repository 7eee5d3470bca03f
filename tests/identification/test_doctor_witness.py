"""The doctor on logs that say less, or nothing: what is mended still, and what is not claimed."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from benchmarks.hidden_effects import Case, make_case
from tests.cli.bad import text_of
from tests.identification.logs_of import runs_of, vehicle_of
from tests.quick import first_quick, quick_if
from undertow.codegen.simulate import Model
from undertow.codegen.simulate import compile as compile_model
from undertow.identification.doctor.clocks import Latency, late_source
from undertow.identification.doctor.dynamics import (
    decisive_mistake,
    dynamic_mistakes,
    dynamics_of,
    other_units,
    reversed_commands,
    swapped_commands,
    without_refuted,
)
from undertow.identification.doctor.examine import Examined, examine
from undertow.identification.doctor.kinematics import Kinematics
from undertow.identification.doctor.mistakes import (
    in_degrees,
    reading_mistakes,
    with_channels,
    wrapped_angles,
)
from undertow.identification.doctor.signs import SignEvidence, _remaining
from undertow.identification.findings import Examination, Finding
from undertow.identification.logs.mapping import LogMapping, edited
from undertow.identification.logs.pose_velocity import velocities_from_pose
from undertow.identification.logs.reading import read_log
from undertow.identification.logs.run import Run
from undertow.model.catalogue import catalogue
from undertow.model.loading import load_vehicle
from undertow.model.vehicle import Value, Vehicle
from undertow.typing import Array

POSE = ("x", "y", "z", "phi", "theta", "psi")
Columns = dict[str, np.ndarray]


@pytest.fixture(scope="module")
def auv() -> Case:
    """An underwater vehicle with four thrusters, 40 s of sines."""
    return make_case("mini-auv", (), 6, duration=40.0, runs=("multisine",))


@pytest.fixture
def examined(auv: Case, tmp_path: Path) -> Callable[..., Examined]:
    """Return a function that writes columns, reads them by a mapping and examines them."""

    def look(columns: Columns, mapping: LogMapping | None = None) -> Examined:
        vehicle, path = vehicle_of(auv), tmp_path / "log.csv"
        path.write_text(text_of(columns))
        run = read_log(path, mapping, vehicle.command_names)
        return examine(vehicle, [velocities_from_pose(run, vehicle.degrees_of_freedom)], mapping=mapping)

    return look


def _by_id(result: Examined) -> dict[str, Finding]:
    return {f.id: f for f in result.result.findings}


def _pose_only(case: Case) -> Columns:
    (columns,) = case.runs.values()
    return {n: c for n, c in columns.items() if n not in ("u", "v", "w", "p", "q", "r")}


# --- angles without velocities ---------------------------------------------------------------------------
@pytest.mark.parametrize("wrapped", first_quick([True, False]))
def test_a_heading_in_degrees_shows_without_velocities(
    auv: Case, examined: Callable[..., Examined], wrapped: bool
) -> None:
    columns = _pose_only(auv)
    degrees = np.degrees(columns["psi"]) % 360 if wrapped else np.degrees(columns["psi"])
    found = examined(columns | {"psi": degrees})
    (mistake,) = found.result.mistakes
    assert mistake.mapping == '[columns]\npsi = { channel = "psi", unit = "deg" }'
    assert "in an ordinary second" in mistake.text
    r = next(iter(auv.runs.values()))["r"]
    assert np.nanstd(found.mended[0].channels["r"] - r) < 0.1 * np.std(r)
    assert not examined(columns | {"psi": degrees}, edited(LogMapping(), found.edits)).result.mistakes


def test_an_attitude_beyond_upright_is_in_degrees() -> None:
    t = np.arange(0.0, 20.0, 0.05)
    tilted = {"phi": 3.0 * np.sin(t), "theta": 6.0 * np.cos(t), "psi": 20.0 * np.sin(0.1 * t)}
    found = in_degrees([Run("tilted", t, tilted)], LogMapping(), POSE)
    assert found is not None
    assert "phi, theta" in found.text
    assert "theta reaches 6 in the log" in found.text
    np.testing.assert_allclose(
        found.mistake.undo(Run("tilted", t, tilted)).channels["theta"], np.radians(tilted["theta"])
    )
    # Level, and rolling on and on like a spent torpedo: radians both.
    level = {n: 0.05 * a for n, a in tilted.items()}
    assert in_degrees([Run("level", t, level)], LogMapping(), POSE) is None
    assert in_degrees([Run("rolling", t, level | {"phi": 3.0 * t})], LogMapping(), POSE) is None
    assert in_degrees([Run("no pitch", t, tilted)], LogMapping(), ("x", "y", "psi")) is None


TURNING = """schema = "undertow/vehicle/1"
name = "turning"
degrees_of_freedom = ["roll", "pitch", "yaw"]
signs = "magnitudes"
[effects.rigid_body]
I_x = "0.2 kg m^2"
I_y = "0.3 kg m^2"
I_z = "0.3 kg m^2"
[effects.linear_damping]
K_p = { value = 0.2, estimate = true }
M_q = { value = 0.3, estimate = true }
N_r = { value = 0.3, estimate = true }
"""


def _rolling(t: np.ndarray) -> dict[str, np.ndarray]:
    """A vehicle that rolls over and over."""
    phi, theta, psi = 0.5 * t + np.sin(t), 0.8 * np.sin(0.7 * t), 0.8 * np.sin(0.5 * t)
    phi_dot, theta_dot, psi_dot = 0.5 + np.cos(t), 0.56 * np.cos(0.7 * t), 0.4 * np.cos(0.5 * t)
    p = phi_dot - np.sin(theta) * psi_dot  # Euler rates to body rates (Fossen 2021, section 2.2)
    q = np.cos(phi) * theta_dot + np.cos(theta) * np.sin(phi) * psi_dot
    r = -np.sin(phi) * theta_dot + np.cos(theta) * np.cos(phi) * psi_dot
    forces = {"tau_K": np.sin(t), "tau_M": np.cos(t), "tau_N": np.sin(0.5 * t)}
    return {"t": t, "phi": phi, "theta": theta, "psi": psi, "p": p, "q": q, "r": r, **forces}


@pytest.mark.parametrize("slow", first_quick([False, True]))
def test_degrees_that_jump_are_found_beside_turning_rates(tmp_path: Path, slow: bool) -> None:
    """A vehicle that rolls over: no rate of phi agrees before both the unit and the jumps are mended."""
    columns = _rolling(np.arange(0.0, 30.0, 0.02))
    t, phi, theta = (columns[n] for n in ("t", "phi", "theta"))
    roll = np.degrees(np.angle(np.exp(1j * phi)))
    attitude = {"phi": roll, "theta": np.degrees(theta), "psi": np.degrees(columns["psi"])}
    if slow:  # every third row: in between are curves, which go through the jumps
        attitude = {n: np.where(np.arange(len(t)) % 3 == 0, a, np.nan) for n, a in attitude.items()}
    (tmp_path / "vehicle.toml").write_text(TURNING)
    (tmp_path / "log.csv").write_text(text_of(columns | attitude))
    vehicle = load_vehicle(tmp_path / "vehicle.toml")
    mapping = LogMapping.model_validate({"channels": {"phi": "phi", "theta": "theta", "psi": "psi"}})
    found = examine(vehicle, [read_log(tmp_path / "log.csv", mapping)], mapping=mapping)
    assert [m.id for m in found.result.mistakes] == ["degrees_for_radians", "wrapped_angle"]
    mended = edited(mapping, found.edits)
    assert all(channel.unit == "deg" for channel in mended.channels.values())
    assert mended.channels["phi"].wrapped
    run = read_log(tmp_path / "log.csv", mended)
    np.testing.assert_allclose(run.reports("phi")[::3], phi[::3], atol=1e-4)
    assert not examine(vehicle, [run], mapping=mended).result.mistakes


@pytest.mark.parametrize(("rows", "minutes"), first_quick([(270, False), (100, True), (1000, True)], 2))
def test_a_radian_has_other_degrees_than_a_minute_has_seconds(
    tmp_path: Path, rows: int, minutes: bool
) -> None:
    """Where the steps are so short that the clock may be wrong, 57.3 and 60 are told apart by the nearer."""
    columns = _rolling(np.arange(0.0, 15.0, 1 / rows))
    (tmp_path / "vehicle.toml").write_text(TURNING)
    entries = {} if minutes else {n: {"channel": n, "unit": "deg/s"} for n in "pqr"}
    clock = {"t": columns["t"] / 60} if minutes else {}
    (tmp_path / "log.csv").write_text(text_of(columns | clock))
    mapping = LogMapping.model_validate({"columns": entries})
    run = read_log(tmp_path / "log.csv", mapping)
    found = examine(load_vehicle(tmp_path / "vehicle.toml"), [run], mapping=mapping)
    assert [m.id for m in found.result.mistakes][:1] == ["time_unit" if minutes else "radians_for_degrees"]


def test_pulses_beyond_the_end_of_a_curve_are_no_commands_of_it(tmp_path: Path) -> None:
    columns = _rolling(np.arange(0.0, 30.0, 0.05))
    place = 'name = "side"\nposition = [0, 0.2, 0]\ndirection = [1, 0, 0]\n'
    thruster = f'[[thrusters]]\n{place}curve = "t200-16v"\n'
    (tmp_path / "vehicle.toml").write_text(TURNING + thruster)
    vehicle = load_vehicle(tmp_path / "vehicle.toml")
    assert vehicle.largest_commands == {"side": 1.0}
    share = 0.8 * np.sin(1.3 * columns["t"])
    (tmp_path / "log.csv").write_text(text_of(columns | {"side": 1500.0 + 400.0 * share}))
    run = read_log(tmp_path / "log.csv", None, ["side"])
    (mistake,) = [m for m in examine(vehicle, [run]).result.mistakes if m.id == "command_unit"]
    assert "scale = 0.0025, offset = -3.75" in mistake.mapping
    right = [m.undo(run) for m in other_units(vehicle, [run])]
    np.testing.assert_allclose(right[0].channels["side"], share, atol=1e-9)
    read_right = [m.clause for m in other_units(vehicle, right)]
    assert not [clause for clause in read_right if "a share of the limit" in clause]  # as it is read


def test_of_readings_as_simple_the_one_that_explains_most_comes_first() -> None:
    """An exchange with a thruster that does nothing there takes the contradiction away, too."""
    vehicle = load_vehicle("bluerov2-6")
    reversed_, swapped = reversed_commands(vehicle)[0], next(iter(swapped_commands(vehicle)))
    weights = [(swapped, SignEvidence(np.zeros(1), 0.5, 3)), (reversed_, SignEvidence(np.zeros(1), 0.6, 3))]
    assert _remaining(weights, [w for _, w in weights]) == [reversed_, swapped]


def test_steps_of_a_turn_among_large_ones_are_no_jumps() -> None:
    t = np.arange(0.0, 30.0, 0.05)
    spinning = 60.0 * t + 60.0 * np.cos(t)
    steps = np.abs(np.diff(spinning))
    assert np.any(np.abs(steps - 2 * np.pi) < 0.3)
    assert not list(wrapped_angles([Run("spinning", t, {"psi": spinning})]))


# --- a log that is no witness ----------------------------------------------------------------------------
@pytest.mark.parametrize(("unit", "seconds"), first_quick([("ms", 1e-3), ("us", 1e-6)]))
def test_times_in_another_unit_are_mended_and_blamed_for_nothing_else(
    auv: Case, examined: Callable[..., Examined], unit: str, seconds: float
) -> None:
    (columns,) = auv.runs.values()
    found = examined(columns | {"t": columns["t"] / seconds})
    (mistake,) = found.result.mistakes
    assert mistake.mapping == f'[time]\nunit = "{unit}"'
    np.testing.assert_allclose(found.mended[0].t, columns["t"], atol=1e-9)
    assert not examined(
        columns | {"t": columns["t"] / seconds}, edited(LogMapping(), found.edits)
    ).result.mistakes


def test_a_log_whose_pose_and_velocities_disagree_blames_no_thruster(auv: Case) -> None:
    """Read in milliseconds, it would fit better with a thruster reversed."""
    vehicle, (run,) = vehicle_of(auv), runs_of(auv)
    slow = [replace(run, t=1e3 * run.t)]
    kinematics, at = Kinematics(slow, vehicle), dynamics_of(vehicle, slow)
    assert at is not None
    assert np.all(kinematics.mismatch(slow).excess > 0.5)
    blamed = decisive_mistake(at, reversed_commands(vehicle))
    assert blamed is not None
    assert dynamic_mistakes(vehicle, at, kinematics, slow, LogMapping()) is None


def test_commands_that_stand_still_are_reported(auv: Case) -> None:
    vehicle, (run,) = vehicle_of(auv), runs_of(auv)

    def reported(*names: str) -> Finding | None:
        still = {n: np.zeros(len(run.t)) for n in names}
        found = examine(vehicle, [replace(run, channels={**run.channels, **still})])
        return _by_id(found).get("still_commands")

    assert reported() is None
    one, all_ = reported("f4"), reported(*vehicle.command_names)
    assert one is not None
    assert (one.severity, one.text[:16]) == ("note", "f4 never changes")
    assert all_ is not None
    assert all_.severity == "warning"
    assert "nothing that acts on surge, heave, yaw changes although the vehicle moves there" in all_.text


def test_what_could_not_be_compared_is_said(auv: Case, examined: Callable[..., Examined]) -> None:
    (columns,) = auv.runs.values()
    assert "not_compared" not in _by_id(examined(columns))
    assert "no pose rate could be compared" in _by_id(examined(_pose_only(auv)))["not_compared"].text
    without_z = {n: c for n, c in columns.items() if n != "z"}
    vehicle, (run,) = vehicle_of(auv), runs_of(auv)
    lacking = replace(run, channels={n: c for n, c in run.channels.items() if n in without_z})
    assert "w with the rate of z" in _by_id(examine(vehicle, [lacking]))["not_compared"].text


@pytest.mark.parametrize(("names", "effect"), [(("u", "v", "w"), True), (("r",), False), (("x", "y"), False)])
def test_the_remedy_for_a_late_source_is_one_that_works(names: tuple[str, ...], effect: bool) -> None:
    """The effect sensor_delay delays u, v, w and nothing else; the mapping file moves any column."""
    mapping = LogMapping.model_validate({"columns": {n: {"channel": n, "delay": "50 ms"} for n in names}})
    finding = late_source(Latency(names, ("psi",), 0.2, 1e-3), mapping)
    assert ("sensor_delay" in finding.text) is effect
    mended = LogMapping.model_validate(tomllib.loads(finding.mapping))
    assert {n: c.delay for n, c in mended.columns.items()} == dict.fromkeys(names, "0.25 s")


# --- the mass --------------------------------------------------------------------------------------------
@cache
def _two_runs() -> Case:
    return make_case("mini-auv", (), 6, duration=60.0, runs=("multisine", "steps"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("factor", "found"),
    quick_if(lambda case: case[0] == 0.8, [(0.7, True), (0.8, True), (0.95, False), (1.05, False)]),
)
def test_a_dry_mass_shows_in_added_masses_that_are_known_to_fifteen_per_cent(
    factor: float, found: bool
) -> None:
    case = _two_runs()
    vehicle = vehicle_of(case)
    stated = vehicle.value_of("m")
    wrong = vehicle.with_values({"m": replace(stated, value=factor * stated.value)})
    findings = [f for f in examine(wrong, runs_of(case)).result.findings if f.id == "dry_mass"]
    assert len(findings) == found
    for finding in findings:
        assert "looks like the dry mass" in finding.text
        assert abs(finding.evidence["found"] - stated.value) < 2.0 * finding.evidence["error"]


# --- what the model lacks is no unit ------------------------------------------------------------------------
def _ten_per_cent_off(vehicle: Vehicle) -> Vehicle:
    """A vehicle whose estimated values are off by chance."""
    rng = np.random.default_rng(115)
    guessed = {n: v for n, v in vehicle.values.items() if v.estimate}
    return vehicle.with_values(
        {n: replace(v, value=v.value * (1 + 0.1 * rng.standard_normal())) for n, v in guessed.items()}
    )


def _torpedo_in(current: tuple[float, float]) -> tuple[Vehicle, list[Run]]:
    """A bundled torpedo whose values are some per cent off, and runs of it in a current to north and east."""
    vehicle = load_vehicle("remus100")
    water = dict(zip(("V_N", "V_E"), map(Value, current), strict=True))
    model = compile_model(_ten_per_cent_off(vehicle).with_effect(catalogue()["ocean_current"], water))
    return vehicle, [_sailed(vehicle, model, np.random.default_rng(seed)) for seed in range(1150, 1153)]


def _sailed(vehicle: Vehicle, model: Model, rng: np.random.Generator) -> Run:
    dt, count = 0.05, 2000
    steps = rng.uniform([2.5, -0.12, -0.04], [5.0, 0.12, 0.04], (count // 60 + 1, 3))
    u = np.repeat(steps, 60, axis=0)[:count]
    noise = {"x": 0.02, "y": 0.02, "z": 0.02, "u": 0.005, "v": 0.005, "w": 0.005}
    return _logged(vehicle, model, u, dt, {"u": 1.5, "z": 10.0}, noise, rng)


def _logged(
    vehicle: Vehicle,
    model: Model,
    u: Array,
    dt: float,
    start: dict[str, float],
    noise: dict[str, float],
    rng: np.random.Generator,
) -> Run:
    """A run with these commands, with sensors whose noise is 0.002 where nothing is stated."""
    x = model.simulate(np.array([start.get(n, 0.0) for n in model.states]), u, dt)
    pose_and_velocity = model.states[: 2 * len(vehicle.degrees_of_freedom)]
    read = {
        n: x[:, i] + rng.normal(0.0, noise.get(n, 0.002), len(u)) for i, n in enumerate(pose_and_velocity)
    }
    return Run("sailed", dt * np.arange(len(u)), read | dict(zip(vehicle.command_names, u.T, strict=True)))


def test_a_current_that_the_model_lacks_is_no_other_unit() -> None:
    vehicle, runs = _torpedo_in((0.15, -0.1))
    examined = examine(vehicle, runs).result
    assert not examined.mistakes
    (doubt,) = (f for f in examined.findings if f.id == "motion_unit")
    assert doubt.severity == "warning"
    assert any("ocean_current" in other for other in doubt.alternatives)


@pytest.mark.slow
def test_a_velocity_sensor_in_the_bow_is_no_axis_with_the_opposite_sign() -> None:
    """In a turn a ship drifts outwards and its bow does not."""
    vehicle = load_vehicle("kvlcc2")
    model = compile_model(_ten_per_cent_off(vehicle))
    zigzags = [_zigzag(vehicle, model, np.random.default_rng(seed)) for seed in range(1150, 1152)]
    runs = [with_channels(r, {"v": r.channels["v"] + 2.8 * r.channels["r"]}) for r in zigzags]
    examined = examine(vehicle, runs).result
    assert not examined.mistakes
    (doubt,) = (f for f in examined.findings if f.id == "flipped_axis")
    assert any("velocity_lever_arm" in other for other in doubt.alternatives)
    (arm,) = (f for f in examined.findings if f.id == "velocity_sensor")
    assert arm.evidence["x_s"] == pytest.approx(2.8, abs=0.02)


def _zigzag(vehicle: Vehicle, model: Model, rng: np.random.Generator) -> Run:
    dt, count = 0.1, 2400
    half = int(rng.uniform(100, 250))
    rudder = np.where((np.arange(count) // half) % 2 == 0, 1.0, -1.0) * rng.uniform(0.15, 0.5)
    u = np.column_stack([np.full(count, 10.0), rudder])
    noise = {"x": 0.01, "y": 0.01, "u": 0.002, "v": 0.002, "psi": 0.001, "r": 0.0005}
    return _logged(vehicle, model, u, dt, {"u": 1.2}, noise, rng)


def test_feet_are_found_all_the_same() -> None:
    vehicle, runs = _torpedo_in((0.0, 0.0))
    feet = [with_channels(r, {n: r.channels[n] / 0.3048 for n in "xyzuvw"}) for r in runs[:1]]
    (mistake,) = examine(vehicle, feet).result.mistakes
    assert mistake.id == "motion_unit"
    assert "are in ft and ft/s" in mistake.text


def test_a_mistake_is_refuted_by_a_model_that_leaves_only_noise() -> None:
    """What a mistake would leave is more than what the model leaves of the log as it is."""
    examined = Examination(undertow="", vehicle="", runs=[], findings=[], excitation=[], seconds=0.0)
    leaving = {"surge": 300.0, "surge_undone": 20.0}
    wrong = Finding(id="reversed_thruster", severity="mistake", text="", evidence=leaving)
    right = wrong.model_copy(update={"evidence": {"surge": 300.0, "surge_undone": 1.1}})
    seen = examined.model_copy(update={"findings": [wrong, right]})
    assert without_refuted(seen).mistakes == [right]


@pytest.mark.parametrize(("pitch", "offered"), [(0.02, True), (0.5, False)])
def test_radians_beyond_upright_are_not_offered(pitch: float, offered: bool) -> None:
    """Pitch of up to 29 degrees cannot be one of 29 rad; of up to 1.1 degrees it may be 1.1 rad."""
    t = np.arange(0.0, 60.0, 0.5)
    run = Run("dive", t, {"z": t, "theta": pitch * np.sin(t), "psi": 0.1 * np.sin(t)})
    mapping = LogMapping.model_validate(
        {"columns": {n: {"channel": n, "unit": "deg"} for n in ("theta", "psi")}}
    )
    known = [m for m in reading_mistakes(mapping, [run]) if m.id == "radians_for_degrees"]
    assert any("theta" in m.clause for m in known) == offered
    assert any(m.clause.startswith("psi is") for m in known)
