"""The doctor: every usual mistake is told first and mended by its line; logs without one come out fine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import sympy as sm

from benchmarks.hidden_effects import Case, make_case
from tests.cli.bad import text_of
from tests.identification import broken
from tests.identification.broken import Break
from tests.identification.logs_of import run_of, runs_of, true_vehicle, vehicle_of
from tests.identification.surge import surge_run, surge_vehicle
from tests.quick import first_quick, quick_if
from undertow.errors import UndertowError
from undertow.identification import diagnose as diagnose_module
from undertow.identification.doctor import dynamics
from undertow.identification.doctor.clocks import shifts
from undertow.identification.doctor.examine import Examined, examine, refuse_impossible
from undertow.identification.doctor.kinematics import Kinematics
from undertow.identification.doctor.mistakes import (
    angles_across_jumps,
    heading_off_by,
    reading_mistakes,
    wrapped_angles,
)
from undertow.identification.doctor.sensors import inconsistent
from undertow.identification.findings import Finding
from undertow.identification.logs.mapping import Edit, LogMapping, edited
from undertow.identification.logs.pose_velocity import velocities_from_pose
from undertow.identification.logs.reading import read_log
from undertow.identification.logs.run import Run
from undertow.model.effect import Wrench
from undertow.model.loading import load_vehicle
from undertow.model.parameter import Parameter
from undertow.model.symbols import Signals
from undertow.model.vehicle import Value, Vehicle

HEADING = {"columns": {"heading": {"channel": "psi"}}}
Columns = dict[str, np.ndarray]


@pytest.fixture(scope="module")
def usv() -> Case:
    """A surface vehicle without anything hidden: 25 s of sines."""
    return make_case("usv", (), 4, duration=25.0, runs=("multisine",))


@pytest.fixture(scope="module")
def auv() -> Case:
    """An underwater vehicle with four thrusters, 25 s of steps."""
    return make_case("mini-auv", (), 6, duration=25.0, runs=("steps",))


@pytest.fixture
def read(tmp_path: Path) -> Callable[..., Run]:
    """Return a function that writes a log and reads it by a mapping."""

    def reader(columns: Columns, vehicle: Vehicle, mapping: LogMapping | None = None) -> Run:
        path = tmp_path / "log.csv"
        path.write_text(text_of(columns))
        return read_log(path, mapping, vehicle.command_names)

    return reader


def _doctored(
    case: Case, wrong: Break, read: Callable[..., Run], mapping: LogMapping | None = None
) -> Examined:
    vehicle = vehicle_of(case)
    (columns,) = case.runs.values()
    return examine(vehicle, [read(wrong(columns), vehicle, mapping)])


def _mended_run(case: Case, wrong: Break, examined: Examined, read: Callable[..., Run]) -> Run:
    (columns,) = case.runs.values()
    before = examined.given[0].mapping or LogMapping()
    return read(wrong(columns), vehicle_of(case), edited(before, examined.edits))


# --- mistakes in reading, seen in the kinematics ---------------------------------------------------------
READING = [
    (broken.in_degrees("psi"), "degrees_for_radians", ['psi = { channel = "psi", unit = "deg" }']),
    (broken.in_degrees("r"), "degrees_for_radians", ['r = { channel = "r", unit = "deg/s" }']),
    (
        broken.in_degrees("psi", "r"),
        "degrees_for_radians",
        ['psi = { channel = "psi", unit = "deg" }', 'r = { channel = "r", unit = "deg/s" }'],
    ),
    (broken.enu_position, "frame", ["[frames]", 'position = "ENU"', 'attitude = "NED"']),
    (broken.enu_attitude, "frame", ["[frames]", 'attitude = "ENU"']),
    (broken.flu_body, "frame", ["[frames]", 'body = "FLU"', 'attitude = "NED"']),
    (broken.scaled("v", by=-1), "flipped_axis", ["[columns]", 'v = { channel = "v", scale = -1.0 }']),
    (broken.scaled("psi", by=-1), "flipped_axis", ['psi = { channel = "psi", scale = -1.0 }']),
    (broken.scaled("psi", by=1, plus=np.pi / 2), "heading_offset", ["offset = -1.5708"]),
    (broken.scaled("psi", by=1, plus=-0.7), "heading_offset", ["offset = 0.7"]),
    (broken.north_east_velocity, "velocity_in_ned", ["[frames]", 'velocity = "NED"']),
    (broken.swapped("u", "v"), "swapped_velocity", ['v = { channel = "u" }', 'u = { channel = "v" }']),
    (broken.through_water(0.1, -0.07), "velocity_through_water", ["[water]", "velocity = [0.1", ", -0.0"]),
]

ONCE = {m[1]: m for m in READING}.values()


@pytest.mark.parametrize(
    ("wrong", "kind", "lines"), quick_if(lambda m: m in ONCE, READING), ids=[m[1] for m in READING]
)
def test_a_mistake_in_reading_is_reported_first_and_its_line_mends_it(
    usv: Case, read: Callable[..., Run], wrong: Break, kind: str, lines: list[str]
) -> None:
    examined = _doctored(usv, wrong, read)
    (mistake,) = examined.result.mistakes
    assert examined.result.findings[0] is mistake
    assert mistake.id == kind
    assert all(line in mistake.mapping for line in lines), mistake.mapping
    assert not mistake.alternatives
    run = _mended_run(usv, wrong, examined, read)
    kinematics = Kinematics([run], vehicle_of(usv))
    assert not inconsistent(kinematics.mismatch([run])).any()
    for name in ("psi", "u", "v", "r"):  # the line does what the doctor did
        np.testing.assert_allclose(run.channels[name], examined.mended[0].channels[name], atol=1e-3)


def test_velocities_through_the_water_give_the_velocity_of_the_water(
    usv: Case, read: Callable[..., Run]
) -> None:
    examined = _doctored(usv, broken.through_water(0.1, -0.07), read)
    (edit,) = examined.edits
    np.testing.assert_allclose(edit.value, [0.1, -0.07, 0.0], atol=0.003)


def test_a_mended_log_is_fine(usv: Case, read: Callable[..., Run]) -> None:
    wrong = broken.both(broken.in_degrees("psi"), broken.scaled("v", by=-1))
    examined = _doctored(usv, wrong, read)
    assert [m.id for m in examined.result.mistakes] == ["degrees_for_radians", "flipped_axis"]
    after = examine(vehicle_of(usv), [_mended_run(usv, wrong, examined, read)]).result
    assert not after.mistakes
    assert [f.id for f in after.findings if f.severity == "warning"] == []


def test_the_line_is_for_the_column_of_the_mapping_in_use(usv: Case, read: Callable[..., Run]) -> None:
    def wrong(columns: Columns) -> Columns:
        found = broken.in_degrees("psi")(columns)
        return {"heading" if n == "psi" else n: data for n, data in found.items()}

    examined = _doctored(usv, wrong, read, LogMapping.model_validate(HEADING))
    (mistake,) = examined.result.mistakes
    assert mistake.mapping == '[columns]\nheading = { channel = "psi", unit = "deg" }'


@pytest.mark.slow
def test_a_mapping_that_is_itself_the_mistake(usv: Case, read: Callable[..., Run]) -> None:
    wrong = {
        "frames": {"position": "ENU", "attitude": "NED"},
        "columns": {"r": {"channel": "r", "unit": "deg/s"}},
    }
    examined = _doctored(usv, lambda columns: columns, read, LogMapping.model_validate(wrong))
    lines = "\n".join(m.mapping for m in examined.result.mistakes)
    assert 'position = "NED"' in lines
    assert 'r = { channel = "r", unit = "rad/s" }' in lines
    assert len(examined.result.mistakes) == 2


def test_height_for_depth(auv: Case, read: Callable[..., Run]) -> None:
    (mistake,) = _doctored(auv, broken.scaled("z", by=-1), read).result.mistakes
    assert "z is positive upwards" in mistake.text
    assert mistake.mapping == '[columns]\nz = { channel = "z", scale = -1.0 }'


def test_an_angle_that_jumps_is_unwrapped() -> None:
    t = np.arange(0.0, 30.0, 0.05)
    phi = 0.4 * t
    run = Run("roll", t, {"phi": np.angle(np.exp(1j * phi)), "theta": 0.1 * phi})
    (found,) = wrapped_angles([run])
    mistake = found.mistake
    assert found.evidence == {"times": 2.0}
    assert mistake.edits(LogMapping()) == (Edit("columns", "phi", {"channel": "phi", "wrapped": True}),)
    np.testing.assert_allclose(mistake.undo(run).channels["phi"], phi)


def test_an_angle_that_was_averaged_across_its_jump() -> None:
    t = np.arange(0.0, 30.0, 0.05)
    psi = np.angle(np.exp(0.4j * t))
    jumps = np.flatnonzero(np.abs(np.diff(psi)) > 6)
    psi[jumps] = 0.1
    (found,) = angles_across_jumps([Run("yaw", t, {"psi": psi})])
    assert found.severity == "warning"
    assert f"{len(jumps)} of its samples are wrong" in found.text


def test_a_small_offset_of_the_heading_is_that_of_a_sensor_whatever_else_disagrees(
    usv: Case, read: Callable[..., Run]
) -> None:
    def wrong(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        other = np.std(columns["r"]) * np.sin(0.8 * columns["t"])
        return {**columns, "psi": columns["psi"] - 0.2, "r": columns["r"] + other}

    found = _doctored(usv, wrong, read).result
    assert not found.mistakes
    (sensor,) = [f for f in found.findings if f.id == "velocity_sensor"]
    assert sensor.evidence["alpha"] == pytest.approx(0.2, abs=0.02)
    assert "undertow add velocity_misalignment or attitude_bias" in sensor.text


def test_a_vehicle_that_is_carried_backwards_by_the_water_has_no_axis_reversed() -> None:
    """Half as fast through the water as the water over ground, it seems to go the other way."""
    t, vehicle = np.arange(0.0, 120.0, 0.1), load_vehicle("otter")
    rng = np.random.default_rng(4)
    north, east, psi = 0.35 + 0.1 * np.sin(0.4 * t), 0.05 * np.sin(0.7 * t), np.sin(0.2 * t)
    c, d = np.cos(psi), np.sin(psi)
    water = {"psi": psi, "u": c * north + d * east, "v": c * east - d * north, "r": 0.2 * np.cos(0.2 * t)}
    motion = {"x": np.cumsum(north - 0.7) * 0.1, "y": np.cumsum(east) * 0.1, **water}
    channels = {n: data + 1e-3 * rng.standard_normal(len(t)) for n, data in motion.items()}
    run = Run(
        "carried", t, channels | {n: np.zeros(len(t)) for n in vehicle.command_names}, mapping=LogMapping()
    )
    (mistake,) = examine(vehicle, [run]).result.mistakes
    assert mistake.id == "velocity_through_water"
    assert "-0.7 m/s north" in mistake.text


# --- mistakes seen in the fit of the model ---------------------------------------------------------------
COMMANDS = [
    (broken.scaled("f1", by=-1), "reversed_thruster", 'f1 = { channel = "f1", scale = -1.0 }'),
    (broken.swapped("f1", "f2"), "swapped_thrusters", 'f2 = { channel = "f1" }\nf1 = { channel = "f2" }'),
    (broken.scaled("f1", "f2", "f3", by=50.0), "command_unit", 'f1 = { channel = "f1", scale = 0.02 }'),
    (
        broken.scaled("f1", "f2", "f3", by=200.0, plus=1500.0),
        "command_unit",
        "scale = 0.005, offset = -7.5 }",
    ),
]


@pytest.mark.parametrize(
    ("wrong", "kind", "line"),
    quick_if(lambda m: m is not COMMANDS[2], COMMANDS),  # the last one has a factor, too
    ids=[m[1] for m in COMMANDS],
)
def test_a_mistake_in_commands_is_reported_and_its_line_mends_it(
    usv: Case, read: Callable[..., Run], wrong: Break, kind: str, line: str
) -> None:
    examined = _doctored(usv, wrong, read)
    (mistake,) = examined.result.mistakes
    assert mistake.id == kind
    assert line in mistake.mapping
    (columns,) = usv.runs.values()
    run = _mended_run(usv, wrong, examined, read)
    for name in ("f1", "f2", "f3"):
        np.testing.assert_allclose(run.channels[name], columns[name], atol=1e-9)


def test_a_reversed_thruster_can_be_mended_in_the_vehicle_file(usv: Case, read: Callable[..., Run]) -> None:
    (mistake,) = _doctored(usv, broken.scaled("f1", by=-1), read).result.mistakes
    assert mistake.vehicle == "[[thrusters]] f1: direction (or wrench) with the opposite sign"
    assert mistake.evidence["surge"] > 100 * mistake.evidence["surge_undone"]


def test_a_mirrored_log_is_consistent_in_itself_and_given_away_by_the_commands(
    usv: Case, auv: Case, read: Callable[..., Run]
) -> None:
    (mistake,) = _doctored(usv, broken.ros, read).result.mistakes
    assert mistake.mapping == '[frames]\nposition = "ENU"\nbody = "FLU"'
    # On this vehicle the same would follow from two reversed thrusters, and that is said.
    assert any("f2, f3 are reversed" in other for other in mistake.alternatives)
    (mistake,) = _doctored(auv, broken.ros, read).result.mistakes
    assert mistake.mapping == '[frames]\nposition = "ENU"\nbody = "FLU"'


@pytest.mark.parametrize(("sway", "decides"), [(2.6, True), (6.0, False)])
def test_a_little_more_left_of_one_equation_does_not_outweigh_another_that_is_explained(
    sway: float, decides: bool
) -> None:
    """A boat in a current that its model lacks, read mirrored: in the right axes its sway is no better."""
    names, moved = ("surge", "sway", "yaw"), np.ones(3, dtype=bool)
    before, after = np.array([123.0, 1.9, 121.0]), np.array([119.0, sway, 0.6])
    assert dynamics.Gain(names, before, after, moved).decisive == decides


def test_velocities_along_the_earth_turn_with_the_position(usv: Case, read: Callable[..., Run]) -> None:
    """Gazebo's ground truth: pose and twist east-north-up, rates forward-left-up, read as north-east-down."""

    def gazebo(columns: Columns) -> Columns:
        along = broken.north_east_velocity(columns)
        return {**broken.ros(columns), "u": along["v"], "v": along["u"]}

    mapping = LogMapping.model_validate({"frames": {"velocity": "NED"}})
    examined = _doctored(usv, gazebo, read, mapping)
    (mistake,) = examined.result.mistakes
    assert mistake.mapping == '[frames]\nposition = "ENU"\nbody = "FLU"\nvelocity = "ENU"'
    mended = _mended_run(usv, gazebo, examined, read)
    (true,) = usv.runs.values()
    for name in ("x", "y", "u", "v", "r"):
        np.testing.assert_allclose(mended.channels[name], true[name], atol=1e-9)
    np.testing.assert_allclose(examined.mended[0].channels["v"], true["v"], atol=1e-9)


def _swaying_gyros(case: Case) -> Run:
    """A mirrored log in which roll and its rate have nothing in common."""
    (columns,) = case.runs.values()
    drift = {n: 1e-3 * np.sin(0.3 * columns["t"] + k) for n, k in (("phi", 0.0), ("p", 3.0))}
    return run_of("mirrored", broken.ros({**columns, **drift}))


def test_a_roll_that_hardly_moves_is_no_reason_to_stop() -> None:
    case = make_case("ship", (), 4, duration=60.0, runs=("multisine",))
    run = _swaying_gyros(case)
    kinematics = Kinematics([run], vehicle_of(case))
    found = kinematics.mismatch([run])
    assert [kinematics.rows[b[0]] for b in kinematics.blocks] == ["x", "phi", "psi"]
    np.testing.assert_array_equal(inconsistent(found), [False, True, False])
    np.testing.assert_array_equal(found.moves, [True, False, True])


@pytest.mark.slow
def test_a_roll_that_hardly_moves_spoils_no_evidence() -> None:
    case = make_case("ship", (), 4, duration=60.0, runs=("multisine",))
    (mistake,) = examine(vehicle_of(case), [_swaying_gyros(case)]).result.mistakes
    assert "the log is in ENU and FLU axes, read as NED and FRD" in mistake.text


def test_a_log_with_pose_only_shows_its_frame_by_the_model(read: Callable[..., Run]) -> None:
    case = make_case("usv", (), 4, duration=60.0, runs=("multisine",))
    vehicle, columns = vehicle_of(case), broken.enu_attitude(case.runs["multisine"])
    kept = {n: columns[n] for n in ("t", "x", "y", "psi", "f1", "f2", "f3")}
    run = velocities_from_pose(read(kept, vehicle), vehicle.degrees_of_freedom)
    (mistake,) = examine(vehicle, [run]).result.mistakes
    assert mistake.mapping == '[frames]\nattitude = "ENU"'


# --- the vehicle file ------------------------------------------------------------------------------------
def _with_mass(vehicle: Vehicle, factor: float) -> Vehicle:
    known = vehicle.value_of("m")
    return vehicle.with_values({"m": replace(known, value=factor * known.value)})


def _finding(vehicle: Vehicle, case: Case, kind: str) -> Finding | None:
    return next((f for f in examine(vehicle, runs_of(case)).result.findings if f.id == kind), None)


def test_the_dry_mass_is_found_where_added_masses_are_known(usv: Case) -> None:
    vehicle = true_vehicle(usv)
    known = {n: replace(vehicle.value_of(n), estimate=False) for n in ("X_udot", "Y_vdot", "N_rdot")}
    found = _finding(_with_mass(vehicle.with_values(known), 0.7), usv, "dry_mass")
    assert found is not None
    assert found.severity == "mistake"
    assert "looks like the dry mass" in found.text
    assert found.evidence["found"] == pytest.approx(23.8, abs=3 * found.evidence["error"])


def test_a_mass_that_is_known_to_five_percent_is_no_mistake(usv: Case) -> None:
    for factor in (0.95, 1.05):
        assert _finding(_with_mass(vehicle_of(usv), factor), usv, "dry_mass") is None


class SquareDrag(Wrench):
    """Drag as a table with X_uu has it: the square of the speed without its sign."""

    id, family, reference = "square_drag", "damping", "a mistake"
    X_uu = Parameter("N/(m/s)^2", "surge force per square of the surge velocity", bounds=(-np.inf, 0))

    def wrench(self, s: Signals) -> sm.Matrix:
        return sm.Matrix([self.X_uu * s.nu_r[0] ** 2, 0, 0, 0, 0, 0])


def test_a_square_without_its_sign_is_found_by_moving_astern(usv: Case) -> None:
    vehicle = vehicle_of(usv).with_values({"X_uabsu": Value(0.0), "X_u": Value(-0.2)})
    squared = vehicle.with_effect(SquareDrag, {"X_uu": Value(-1.3, estimate=True)})
    found = _finding(squared, usv, "lost_sign")
    assert found is not None
    assert found.severity == "mistake"
    assert "effect square_drag has a square without its sign (X: u^2)" in found.text
    assert "sm.Abs(u) * u" in found.vehicle
    assert _finding(vehicle_of(usv), usv, "lost_sign") is None


# --- logs without a mistake ------------------------------------------------------------------------------
FINE = [
    ("usv", ()),
    ("usv", ("ocean_current",)),
    ("usv", ("thruster_gain",)),
    ("usv", ("thruster_lag",)),
    ("mini-auv", ("velocity_lever_arm",)),
    ("mini-auv", ("net_buoyancy",)),
    ("mini-auv", ("sensor_bias",)),
]


@pytest.mark.parametrize(
    ("vehicle", "hidden"), first_quick(FINE, 2), ids=[f"{v}-{'-'.join(h)}" for v, h in FINE]
)
def test_hidden_physics_is_no_mistake(vehicle: str, hidden: tuple[str, ...]) -> None:
    case = make_case(vehicle, hidden, 21, duration=25.0, runs=("multisine",))
    assert not examine(vehicle_of(case), runs_of(case)).result.mistakes


def test_a_misaligned_sensor_is_a_warning_and_no_frame() -> None:
    case = make_case("usv", ("velocity_misalignment",), 3, duration=30.0, runs=("multisine",), strength=2.0)
    result = examine(vehicle_of(case), runs_of(case)).result
    assert not result.mistakes
    (warning,) = [f for f in result.findings if f.id == "velocity_sensor"]
    true = case.truth["values"]["velocity_misalignment"]["alpha"]
    assert warning.evidence["alpha"] == pytest.approx(true, rel=0.1)
    assert "undertow add velocity_misalignment" in warning.text


@pytest.mark.parametrize("driven", [False, True])
def test_a_motion_without_a_force_says_nothing_of_units(
    usv: Case, driven: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A drifting glider: what makes the motion smaller needs less of the forces that are not there."""
    asked: list[int] = []
    monkeypatch.setattr(dynamics, "decisive_mistake", lambda at, known: asked.append(len(known)))
    t, vehicle = np.arange(0.0, 60.0, 0.1), vehicle_of(usv)
    forces = {n: driven * np.sin(0.7 * t) for n in vehicle.command_names}
    pose = {"x": 10 * np.sin(0.2 * t), "y": 8 * np.cos(0.3 * t), "psi": 2.5 * np.sin(0.1 * t)}
    noise = np.random.default_rng(3).standard_normal((3, len(t)))
    noisy = {n: pose[n] + 0.01 * e for n, e in zip(pose, noise, strict=True)}
    run = velocities_from_pose(Run("drift", t, {**noisy, **forces}), vehicle.degrees_of_freedom)
    mistakes = examine(vehicle, [run]).result.mistakes
    assert bool(asked) is driven
    assert driven or not mistakes


@pytest.mark.parametrize(("written", "named"), [(1.0, False), (100.0, True)])
def test_a_unit_in_which_commands_would_push_nothing_is_not_named(
    written: float, named: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Estimated thrust that goes away with the motion: then any smaller motion is explained as well."""
    monkeypatch.setattr(dynamics.Gain, "decisive", True)
    lenient = replace(dynamics.SETTINGS, least_predicted_fall=0.0)
    monkeypatch.setattr(dynamics, "SETTINGS", lenient)
    case = make_case("usv", (), 3, duration=30.0, runs=("multisine",))
    vehicle = vehicle_of(case)
    guess = Value(1.0, sigma=10.0, estimate=True)
    vehicle = vehicle.with_values({f"thrust_{t.name}": guess for t in vehicle.thrusters})
    vehicle = replace(vehicle, degrees_of_freedom=("surge",))
    (columns,) = case.runs.values()
    logged = {n: columns[n] for n in ("t", "psi", *vehicle.command_names)}
    logged |= {n: written * columns[n] for n in ("x", "y")}
    run = velocities_from_pose(run_of("log", logged), vehicle.degrees_of_freedom)
    at = dynamics.dynamics_of(vehicle, [run])
    assert at is not None
    in_cm = [m for m in reading_mistakes(LogMapping(), [run]) if m.clause == "x, y are in cm, read as m"]
    assert bool(dynamics.decisive_mistake(at, in_cm)) is named


def test_a_heading_that_would_turn_all_motion_away_is_not_tried() -> None:
    """Speed ahead of a boat without sway: a quarter turn would leave none of it to explain."""
    case = make_case("usv", (), 3, duration=30.0, runs=("multisine",))
    vehicle = replace(vehicle_of(case), degrees_of_freedom=("surge", "yaw"))
    (columns,) = case.runs.values()
    pose = {n: c for n, c in columns.items() if n not in ("u", "v", "w", "p", "q", "r")}
    at = dynamics.dynamics_of(
        vehicle, [velocities_from_pose(run_of("log", pose), vehicle.degrees_of_freedom)]
    )
    assert at is not None
    for angle, tried in ((np.pi / 2, False), (-np.pi / 2, False), (np.pi, True)):
        assert (at.without(heading_off_by(angle, LogMapping())) is not None) is tried


def test_a_reading_in_which_nothing_moves_explains_no_late_velocity() -> None:
    """A hull with surge alone: with east for north, x stands still, and any velocity agrees with that."""
    case = make_case("box", (), 3, duration=60.0, runs=("multisine",))
    (columns,) = case.runs.values()
    late = broken.late(1.2)(columns)
    findings = examine(vehicle_of(case), [run_of("late", late)]).result.findings
    assert [f.id for f in findings if f.severity != "note"] == ["late_velocity"]
    assert findings[0].evidence["delay"] == pytest.approx(1.2, abs=0.05)


@pytest.mark.parametrize(("hidden", "agree"), [("white_force_10", True), ("velocity_lever_arm", False)])
def test_a_disturbance_of_forces_is_no_contradiction_between_pose_and_velocity(
    hidden: str, agree: bool
) -> None:
    case = make_case("mini-auv", (hidden,), 6, duration=25.0, runs=("steps",))
    runs = [run_of("log", columns) for columns in case.runs.values()]
    chance = Kinematics(runs, vehicle_of(case)).chance(runs, 1.3)
    assert chance > 0.05 if agree else chance < 1e-6


# --- clocks ----------------------------------------------------------------------------------------------
def test_velocities_that_are_late(auv: Case) -> None:
    (columns,) = auv.runs.values()
    result = examine(vehicle_of(auv), [run_of("late", broken.late(0.3)(columns))]).result
    (found,) = [f for f in result.findings if f.id == "late_velocity"]
    assert found.evidence["delay"] == pytest.approx(0.3, abs=0.02)


def test_a_slow_sensor_that_is_late_gets_fresh_beside_its_delay(usv: Case, read: Callable[..., Run]) -> None:
    """Half of the time between new values is no delay of the sensor, and must not be written as one."""
    (columns,) = usv.runs.values()
    t, late = columns["t"], 0.3
    new = np.arange(len(t)) // 8 * 8
    held = np.interp(t[new] - late, t, columns["psi"])
    examined = _doctored(usv, lambda c: {**c, "psi": held}, read)
    psi = edited(LogMapping(), examined.edits).columns["psi"]
    assert psi.fresh == "psi"
    assert float(str(psi.delay).split(" ")[0]) == pytest.approx(late, abs=0.03)


def test_clocks_that_drift_apart(auv: Case) -> None:
    (columns,) = auv.runs.values()
    result = examine(vehicle_of(auv), [run_of("drifting", broken.late(0.1, drift=0.5)(columns))]).result
    (found,) = [f for f in result.findings if f.id == "two_clocks"]
    # 25 s have nine test functions, which also have to show the offsets of four velocities.
    assert found.evidence["drift"] == pytest.approx(0.5, abs=0.12)


def test_a_steady_offset_of_a_gyroscope_is_no_drift_of_its_clock() -> None:
    """A ship in slow turns: an offset alone would look like a delay that changes along the run."""
    t = np.arange(0.0, 606.0, 1.08)
    phase = 2 * np.pi * t / 400.0 + 0.8
    psi, r = 0.55 * np.sin(phase), 0.55 * (2 * np.pi / 400.0) * np.cos(phase)
    ahead = {"u": np.full(len(t), 6.0) + 0.2 * np.sin(phase), "v": 0.8 * np.cos(phase)}
    run = run_of("zigzag", {"t": t, "psi": np.round(psi, 4), **ahead, "r": r + 1e-4})
    (shift,) = shifts(Kinematics([run], load_vehicle("kvlcc2")), [run])
    assert (shift.delay, shift.drift) == pytest.approx((0.0, 0.0), abs=0.02)


def test_clocks_are_not_judged_where_commands_are_missing(auv: Case) -> None:
    """At another time, the gap would lie among samples that are used."""
    columns = broken.late(0.1, drift=0.5)(*auv.runs.values())
    gap = np.where((columns["t"] > 8.0) & (columns["t"] < 8.2), np.nan, 0.0)
    patchy = {n: c + gap if n.startswith("f") else c for n, c in columns.items()}
    result = examine(vehicle_of(auv), [run_of("patchy", patchy)]).result
    assert not [f for f in result.findings if f.text.startswith("commands and motion are on two clocks")]


def test_forces_that_nothing_takes_are_named_and_no_delay_of_them_is_reported() -> None:
    undriven = replace(surge_vehicle(), force_channels=())
    run = surge_run(0.02)
    found = examine(undriven, [replace(run, reported={"u": np.full(len(run.t), True)})]).result.findings
    one = next(f for f in found if f.id == "unused_forces")
    assert one.severity == "warning"
    assert 'generalised_forces = ["tau_X"]' in one.text
    assert all(f.id != "command_latency" for f in found)


def test_commands_on_a_clock_of_their_own(auv: Case) -> None:
    (columns,) = auv.runs.values()
    t = columns["t"]
    then = t - 0.8 * (t - t[0]) / (t[-1] - t[0])
    held = np.clip(np.searchsorted(t, then + 1e-9, side="right") - 1, 0, None)
    shifted = {n: c[held] if n.startswith("f") else c for n, c in columns.items()}
    result = examine(vehicle_of(auv), [run_of("shifted", shifted)]).result
    (found,) = [f for f in result.findings if f.id == "two_clocks"]
    assert found.evidence["drift"] == pytest.approx(-0.8, abs=0.3)
    assert not result.mistakes


# --- logs that hold a part of the pose ----------------------------------------------------------


@pytest.mark.parametrize("left_out", first_quick(["y", "x", "x psi"]))
@pytest.mark.parametrize(
    "frames", first_quick([{}, {"position": "ENU", "attitude": "ENU"}, {"body": "FLU", "attitude": "NED"}])
)
def test_a_mistake_that_a_log_has_not_the_channels_for_is_not_tried(
    left_out: str, frames: dict[str, str], usv: Case, read: Callable[..., Run]
) -> None:
    """With x but no y in other axes there is nothing left to compare; a rate in degrees is found."""
    (columns,) = usv.runs.values()
    turned = {**columns, "r": np.degrees(columns["r"])}
    kept = {n: a for n, a in turned.items() if n not in left_out.split()}
    found = examine(
        vehicle_of(usv), [read(kept, vehicle_of(usv), LogMapping.model_validate({"frames": frames}))]
    )
    in_degrees = [f for f in found.result.findings if f.id == "degrees_for_radians"]
    assert all(np.isfinite(list(f.evidence.values())).all() for f in found.result.findings)
    assert in_degrees or "psi" in left_out or frames


@pytest.mark.slow
def test_a_channel_in_the_place_of_another_is_no_reason_to_stop(usv: Case, read: Callable[..., Run]) -> None:
    (columns,) = usv.runs.values()
    mapping = LogMapping.model_validate({"columns": {"x": "v", "v": "y", "y": {"channel": "zz"}}})
    found = examine(vehicle_of(usv), [read(columns, vehicle_of(usv), mapping)])
    assert found.result.findings


@pytest.mark.slow
@pytest.mark.parametrize("roll", first_quick([0.4, 0.6]))
def test_what_a_zero_would_mend_as_well_is_no_other_unit(roll: float) -> None:
    """A tilted compass lets sway leak into heave and turns the track: v in km/h would hide the first only."""
    case = make_case("mini-auv", (), 6, duration=60.0, runs=("steps",))
    (run,) = runs_of(case)
    tilted = {"phi": run.channels["phi"] + roll, "psi": run.channels["psi"] + 0.6}
    examined = examine(vehicle_of(case), [replace(run, channels={**run.channels, **tilted})])
    assert [f.text for f in examined.result.findings if "unit" in f.id] == []


def test_a_heading_that_is_blank_now_and_then_is_still_the_heading(usv: Case) -> None:
    """As where the smoother of a log without r drops single headings: north is not ahead for that."""
    (columns,), vehicle = usv.runs.values(), vehicle_of(usv)
    run = run_of("dive", columns)
    blank = np.where(np.arange(len(run.t)) % 200 == 100, np.nan, run.channels["psi"])
    without = replace(run, channels={**run.channels, "psi": blank}, derived=frozenset({"r"}))
    kinematics = Kinematics([without], vehicle)
    assert [kinematics.rows[i] for i in kinematics.blocks[0]] == ["x", "y"]
    assert kinematics.mismatch([without]).excess[0] < 1e-3


@pytest.mark.parametrize("dead", first_quick([0.0, 1e-6]))
def test_a_velocity_that_measures_nothing_is_named_and_refused(usv: Case, dead: float) -> None:
    """As odometry that leaves its turning rates empty: a fit would take it that the vehicle never turns."""
    (columns,), vehicle = usv.runs.values(), vehicle_of(usv)
    run = run_of("dive", columns)
    still = replace(run, channels={**run.channels, "r": dead * run.channels["r"]})
    (finding,) = [f for f in examine(vehicle, [still]).result.findings if f.id == "measures_nothing"]
    assert finding.severity == "mistake"
    assert finding.text.startswith("r measures nothing: psi changes by ")
    with pytest.raises(UndertowError, match=r"r measures nothing: .+ into `ignore` of the mapping file"):
        refuse_impossible(vehicle, [still])
    refuse_impossible(vehicle, [still], trust_log=True)
    refuse_impossible(vehicle, [run])


def test_a_diagnosis_tells_mistakes_before_it_searches(
    usv: Case, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    (columns,), vehicle = usv.runs.values(), vehicle_of(usv)
    reversed_ = run_of("dive", columns | {"u": -columns["u"]})

    def searched(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(diagnose_module, "search", searched)
    with pytest.raises(KeyboardInterrupt):
        diagnose_module.diagnose(vehicle, [reversed_], trust_log=True)
    (told,) = [r.getMessage() for r in caplog.records if r.levelname == "WARNING"]
    assert told.startswith("u has the opposite sign")


def test_a_position_that_never_changes_is_a_warning(usv: Case) -> None:
    """As without a fix: it spoils no fit of the velocities."""
    (columns,), vehicle = usv.runs.values(), vehicle_of(usv)
    run = run_of("dive", columns)
    still = replace(run, channels={**run.channels, **{n: 1e-6 * run.channels[n] for n in ("x", "y")}})
    (finding,) = [f for f in examine(vehicle, [still]).result.findings if f.id == "measures_nothing"]
    assert finding.severity == "warning"
    refuse_impossible(vehicle, [still])


def test_on_one_course_knots_and_a_current_are_both_named() -> None:
    """At one speed to the north, velocities in knots that are 6% too small differ as in a current."""
    t, vehicle = np.arange(0.0, 200.0, 0.5), load_vehicle("otter")
    rng = np.random.default_rng(6)
    psi = 0.5 * np.sin(0.15 * t)
    speed = 0.6 + 0.03 * np.sin(0.05 * t)
    place = {"x": np.cumsum(speed * np.cos(psi)) * 0.5, "y": np.cumsum(speed * np.sin(psi)) * 0.5}
    pose = {n: data + 0.02 * rng.standard_normal(len(t)) for n, data in place.items()}
    commands = {n: 20.0 + 5.0 * np.sin((0.15 + 0.05 * k) * t) for k, n in enumerate(vehicle.command_names)}
    channels = pose | {"psi": psi, "u": 0.94 * speed / 0.514444} | commands
    run = velocities_from_pose(Run("course", t, channels, mapping=LogMapping()), vehicle.degrees_of_freedom)
    found = examine(vehicle, [run]).result.findings
    (doubt,) = [f for f in found if f.id in ("speed_unit", "velocity_through_water")]
    said = " ".join([doubt.text, *doubt.alternatives])
    assert "u is in knot, read as m/s" in said
    (note,) = [f for f in found if f.id == "agreement"]  # v is that of the pose
    assert {*note.evidence} == {"scale_u", "offset_u"}
