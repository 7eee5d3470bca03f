"""Logs in the wrong units: the doctor names each mistake, and what cannot be is refused before a fit."""

from __future__ import annotations

import re
from collections.abc import Mapping as TypingMapping
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from benchmarks.hidden_effects import Case, make_case
from benchmarks.hidden_effects.conversion import convert_vehicles
from tests.identification import broken
from tests.identification.broken import Break, both, scaled
from tests.identification.logs_of import run_of, runs_of, vehicle_of
from tests.quick import first_quick, quick_if
from undertow.errors import UndertowError
from undertow.identification.api import Estimator
from undertow.identification.comparison import compare
from undertow.identification.diagnose import diagnose
from undertow.identification.doctor.examine import examine, refuse_impossible
from undertow.identification.doctor.forces import Forces
from undertow.identification.logs.mapping import LogMapping, read_mapping
from undertow.identification.logs.pose_velocity import velocities_from_pose
from undertow.identification.logs.reading import read_log
from undertow.identification.logs.run import Run
from undertow.model.effect import Curve
from undertow.model.loading import load_vehicle
from undertow.model.vehicle import Vehicle

DATA = Path(__file__).parents[3] / "shared" / "data"
EXAMPLES = Path(__file__).parents[2] / "examples"
POSE, VELOCITY = ("x", "y", "z", "phi", "theta", "psi"), ("u", "v", "w", "p", "q", "r")
QUICK = ("usv", "mini-auv", "box")  # what `make test` takes
QUICK_EFFECTS = (("ocean_current",),)
_FORCES = r"needs ([\d.]+) times .*\(([\d.e+-]+) N against ([\d.e+-]+) N rms"
MMPS, CMPS, KNOTS, KMH, FTPS = 1000.0, 100.0, 1 / 0.514444, 3.6, 1 / 0.3048


@cache
def _case(name: str) -> Case:
    return make_case(name, (), 4, duration=40.0, runs=("multisine",))


def _vehicle(name: str) -> Vehicle:
    return vehicle_of(_case(name))


def _commands(name: str, by: float, plus: float = 0.0) -> Break:
    # The vehicle is asked for when a log is broken, not when the cases are listed.
    return lambda columns: scaled(*_vehicle(name).command_names, by=by, plus=plus)(columns)


def _speeds(by: float) -> Break:
    return scaled("u", "v", "w", by=by)


def _positions(by: float) -> Break:
    return scaled("x", "y", "z", by=by)


def _late(name: str, seconds: float) -> Break:
    """Commands as they are logged that much after (or, negative, before) they acted."""

    def write(c: TypingMapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        t = c["t"]
        then = np.clip(np.searchsorted(t, t - seconds + 1e-9, side="right") - 1, 0, len(t) - 1)
        return {n: d[then] if n in _vehicle(name).command_names else d for n, d in c.items()}

    return write


def _log(name: str, wrong: Break, left_out: tuple[str, ...] = ()) -> Run:
    """A log of a vehicle with a mistake, with the channels that it would have."""
    vehicle, (columns,) = _vehicle(name), _case(name).runs.values()
    own = {"t", *vehicle.pose_names, *vehicle.velocity_names, *vehicle.command_names} - {*left_out}
    kept = {n: data for n, data in wrong(columns).items() if n in own}
    return velocities_from_pose(run_of(name, kept), vehicle.degrees_of_freedom)


def _refusal(vehicle: Vehicle, *runs: Run) -> str:
    """What a log is refused with; empty where it is not."""
    try:
        refuse_impossible(vehicle, runs)
    except UndertowError as error:
        return str(error)
    return ""


# --- what cannot be is refused -----------------------------------------------------------------------------
NO_XY, NO_POSE, NO_VELOCITY = ("x", "y"), POSE, VELOCITY
ALL: tuple[str, ...] = ()
REFUSED: list[tuple[str, str, Break, tuple[str, ...], str, str]] = [
    # pose rates against velocities
    ("mm/s", "usv", _speeds(MMPS), ALL, "u, v are in mm/s, read as m/s", 'unit = "mm/s"'),
    ("mm/s", "rov", _speeds(MMPS), ALL, "u, v, w are in mm/s", 'w = { channel = "w", unit = "mm/s" }'),
    ("cm/s", "mini-auv", _speeds(CMPS), ALL, "u, v, w are in cm/s", 'unit = "cm/s"'),
    ("knots", "usv", _speeds(KNOTS), ALL, "u, v are in knot", 'u = { channel = "u", unit = "knot" }'),
    ("knots", "rov", _speeds(KNOTS), ALL, "u, v, w are in knot", 'unit = "knot"'),
    ("km/h", "catamaran", _speeds(KMH), ALL, "u, v are in km/h", 'unit = "km/h"'),
    ("ft/s", "mini-auv", _speeds(FTPS), ALL, "u, v, w are in ft/s", 'unit = "ft/s"'),
    ("u in mm/s", "usv", scaled("u", by=MMPS), ALL, "u is in mm/s", 'u = { channel = "u", unit = "mm/s" }'),
    ("mm", "ship", _positions(1000.0), ALL, "x, y are in mm, read as m", 'unit = "mm"'),
    ("cm", "box", _positions(100.0), ALL, "x is in cm", 'x = { channel = "x", unit = "cm" }'),
    ("feet", "rov", _positions(1 / 0.3048), ALL, "x, y, z are in ft", 'unit = "ft"'),
    ("z in feet", "mini-auv", scaled("z", by=1 / 0.3048), ALL, "z is in ft", 'unit = "ft"'),
    ("globe", "usv", broken.on_the_globe("x", "y"), ALL, "x is the latitude and y", 'scale = 111468.0'),
    ("globe", "rov", broken.on_the_globe("y", "x"), ALL, "y is the latitude and x", '{ channel = "y", scale'),
    ("globe", "usv", broken.on_the_globe("y", "x"), NO_VELOCITY, "y is the latitude", 'scale = 111468.0'),
    ("psi in deg", "usv", broken.in_degrees("psi"), ALL, "psi is in degrees", 'unit = "deg" }'),
    ("r in deg", "usv", broken.in_degrees("r"), ALL, "r is in degrees", 'unit = "deg/s" }'),
    ("psi, r in deg", "mini-auv", broken.in_degrees("psi", "r"), ALL, "psi, r are in degrees", '"deg/s"'),
    ("z up", "mini-auv", scaled("z", by=-1.0), ALL, "z is positive upwards", "scale = -1.0"),
    ("world", "mini-auv", broken.north_east_velocity, ALL, "north, east, down", 'velocity = "NED"'),
    ("t in ms", "usv", scaled("t", by=1e3), ALL, "the times are in ms", '[time] unit = "ms"'),
    ("t in min", "rov", scaled("t", by=1 / 60), ALL, "the times are in min", '[time] unit = "min"'),
    ("hhmmss", "usv", broken.time_of_day, ALL, "(hhmmss), read as s: 1259", '[time] unit = "iso"'),
    ("hhmmss", "rov", broken.time_of_day, NO_VELOCITY, "followed by 130000", '[time] unit = "iso"'),
    # both wrong alike, one of them not measured, or commands: the force that the motion needs
    ("all mm", "usv", both(_speeds(1e3), _positions(1e3)), ALL, "in mm and mm/s, read as m", '"mm/s"'),
    ("all cm", "rov", both(_speeds(1e2), _positions(1e2)), ALL, "in cm and cm/s, read as m", '"cm/s"'),
    ("mm/s", "box", _speeds(MMPS), NO_POSE, "u is in mm/s", 'u = { channel = "u", unit = "mm/s" }'),
    ("cm/s", "float", _speeds(CMPS), NO_POSE, "w is in cm/s", 'unit = "cm/s"'),
    ("u in mm/s", "usv", scaled("u", by=MMPS), NO_POSE, "u is in mm/s", 'unit = "mm/s"'),
    ("mm", "usv", _positions(1000.0), NO_VELOCITY, "x, y are in mm", 'unit = "mm"'),
    ("r in deg", "catamaran", broken.in_degrees("r"), NO_POSE, "r is in degrees", '"deg/s"'),
    ("psi, r in deg", "usv", broken.in_degrees("psi", "r"), NO_XY, "psi, r are in degrees", '"deg/s"'),
    ("t in ms", "box", scaled("t", by=1e3), NO_POSE, "the times are in ms", '[time] unit = "ms"'),
    ("t in us", "usv", scaled("t", by=1e6), NO_VELOCITY, "the times are in us", '[time] unit = "us"'),
    ("t in min", "usv", scaled("t", by=1 / 60), NO_POSE, "the times are in min", '[time] unit = "min"'),
    ("one command", "usv", scaled("f1", by=1e3), ALL, "f1 is 1000 times too large", "scale = 0.001"),
    ("one command", "rov", scaled("f1", by=1e3), ALL, "f1 is 1000 times too large", "scale = 0.001"),
    ("one command", "box", scaled("f2", by=1e3), NO_POSE, "f2 is 1000 times too large", "scale = 0.001"),
    ("commands", "catamaran", _commands("catamaran", 1e3), ALL, "f1, f2 are 1000 times", "scale = 0.001"),
    ("kN", "usv", _commands("usv", 1e-3), NO_POSE, "f1, f2, f3 are 1000 times too small", "scale = 1000.0"),
    ("pulse widths", "mini-auv", _commands("mini-auv", 400 / 6, 1500.0), ALL, "pulse", "offset = -22.5"),
    ("pulse widths", "heavy-rov", _commands("heavy-rov", 5.0, 1500.0), ALL, "pulse", "offset = -300.0"),
    # several at once
    ("mm/s, world", "usv", both(broken.north_east_velocity, _speeds(1e3)), ALL, "u, v are in mm/s", '"NED"'),
    ("mm/s, deg", "mini-auv", both(_speeds(1e3), broken.in_degrees("psi", "r")), ALL, "mm/s", '"deg/s"'),
    ("knots, command", "usv", both(_speeds(KNOTS), scaled("f1", by=1e3)), ALL, "knot", "scale = 0.001"),
]  # fmt: skip

# Of `make test`: every kind of mistake on one of its vehicles; units of the same channels are alike.
ALIKE = (
    "cm/s",
    "ft/s",
    "u in mm/s",
    "z in feet",
    "cm",
    "psi in deg",
    "r in deg",
    "t in us",
    "t in min",
    "kN",
)
ONCE = {m[0]: m for m in REFUSED if m[1] in QUICK and m[0] not in ALIKE}.values()


@pytest.mark.parametrize(
    ("what", "name", "wrong", "left_out", "reported", "line"),
    quick_if(lambda m: m in ONCE and m[:2] != ("mm/s, deg", "mini-auv"), REFUSED),
    ids=[f"{m[0]}-{m[1]}-{len(m[3])}" for m in REFUSED],
)
def test_what_cannot_be_is_refused_with_value_limit_and_line(
    what: str, name: str, wrong: Break, left_out: tuple[str, ...], reported: str, line: str
) -> None:
    log = _log(name, wrong, left_out)
    message = _refusal(_vehicle(name), log)
    assert message.startswith(f"log '{name}' is impossible: ")
    assert reported in message
    assert line in message
    assert "\n" not in message
    assert "--trust-log" in message
    refuse_impossible(_vehicle(name), [log], trust_log=True)


def test_a_refusal_tells_sizes_and_limit() -> None:
    message = _refusal(_vehicle("usv"), _log("usv", _speeds(MMPS)))
    assert "x, y change by 0.1" in message
    assert "and the velocities say 1" in message
    assert "sensor errors explain at most 12%" in message
    message = _refusal(_vehicle("usv"), _log("usv", scaled("f1", by=1e3)))
    assert "the surge of the log needs 0.00" in message
    # A vehicle whose added mass is not well known may answer with less than one fortieth of what it is given.
    (least,) = re.findall(r"; at least ([0-9.]+) can be", message)
    assert 0.015 < float(least) < 0.025


def test_the_forces_of_a_refusal_have_the_ratio_that_it_states() -> None:
    """Two thrusters that work against each other, logged as a thirtieth: what is told is beside the other."""
    rng = np.random.default_rng(5)
    t = np.arange(0.0, 60.0, 0.05)
    waves = rng.uniform(0.5, 6.0, (2, 8, 1)) * t + rng.uniform(0.0, 6.0, (2, 8, 1))
    ahead, apart = np.sin(waves).sum(axis=1)
    vehicle = load_vehicle("otter")
    beside = tuple(replace(one, wrench=(1.0, 0.0, 0.0, 0.0, 0.0, 0.0)) for one in vehicle.thrusters)
    names, mass = [one.name for one in beside], vehicle.values["m"].value - vehicle.values["X_udot"].value
    forces = dict(zip(names, (ahead + 10 * apart, ahead - 10 * apart), strict=True))
    speed = np.cumsum(np.append(0.0, sum(forces.values())[:-1])) * 0.05 / mass
    run = Run("a", t, {n: force / 30 for n, force in forces.items()} | {"u": speed})
    hull = replace(vehicle, thrusters=beside, degrees_of_freedom=("surge",))
    message = _refusal(hull, run)
    factor, needed, given = map(float, re.search(_FORCES, message).groups())  # type: ignore[union-attr]
    assert factor == pytest.approx(30, rel=0.1)
    assert needed / given == pytest.approx(30, rel=0.1)


def test_thrusters_with_a_curve_push_as_their_curve_says() -> None:
    """The commands of a log as those of thrusters with a curve and a dead band, as of a T200."""
    vehicle, run = _vehicle("usv"), _log("usv", dict, NO_POSE)
    most = max(float(np.max(np.abs(run.channels[n]))) for n in vehicle.command_names)
    curve = Curve.through([(-1.0, -most), (-0.07, 0.0), (0.07, 0.0), (1.0, most)])
    curved = replace(vehicle, thrusters=tuple(replace(t, law=curve, limit=1.0) for t in vehicle.thrusters))
    outputs = {n: np.vectorize(curve.inverse)(run.channels[n]) for n in vehicle.command_names}
    driven = replace(run, channels={**run.channels, **outputs})
    wanted, given = Forces(vehicle).commanded(run), Forces(curved).commanded(driven)
    assert np.ptp(wanted) > most
    np.testing.assert_allclose(given, wanted, atol=1e-6 * most)
    assert not _refusal(curved, driven)
    scaled_speeds = {n: MMPS * driven.channels[n] for n in ("u", "v")}
    reported = _refusal(curved, replace(driven, channels={**driven.channels, **scaled_speeds}))
    assert "u, v are in mm/s" in reported
    assert "of the log needs" in reported  # by the force, and not by the speed alone


def test_a_vehicle_that_only_drifts_is_known_by_its_size() -> None:
    """Nothing is commanded, so no force can tell: 300 m/s and 15 rad/s are beyond any vehicle of 24 kg."""
    t = np.arange(0.0, 40.0, 0.05)
    still = {n: np.zeros(len(t)) for n in ("f1", "f2", "f3")}
    drift = {"u": 300.0 + 20 * np.sin(t), "v": 30 * np.cos(t), "r": 0.1 * np.sin(t)}
    message = _refusal(_vehicle("usv"), Run("drift", t, {**still, **drift}))
    assert "u, v reach 3" in message
    assert "no vehicle of 23.8 kg exceeds 20.2 m/s" in message
    assert 'u = { channel = "u", unit = "mm/s" }' in message
    turning = {"u": 0.3 + 0.02 * np.sin(t), "v": 0.03 * np.cos(t), "r": 15.0 + np.sin(t)}
    message = _refusal(_vehicle("usv"), Run("spin", t, {**still, **turning}))
    assert "no vehicle of 23.8 kg exceeds 5.84 rad/s" in message
    assert 'r = { channel = "r", unit = "deg/s" }' in message


def test_one_bad_log_among_good_ones_is_named() -> None:
    good, bad = _log("usv", dict), _log("usv", _speeds(MMPS))
    runs = [good, Run("second", bad.t, bad.channels), Run("third", good.t, good.channels)]
    assert _refusal(_vehicle("usv"), *runs).startswith("log 'second' is impossible: u, v are in mm/s")
    (mistake, *_) = examine(_vehicle("usv"), runs).result.mistakes
    assert mistake.text.startswith("second, but not all of the logs: u, v are in mm/s")


def test_commands_as_the_curve_of_a_thruster_counts_them_are_not_those_from_rest() -> None:
    curve = Curve.through([(-1.0, -40.0), (0.0, 0.0), (1.0, 40.0)])
    ship = _vehicle("usv")
    pulses = [replace(t, law=curve, limit=None, normalised_by=(1500.0, 400.0)) for t in ship.thrusters]
    vehicle, run = replace(ship, thrusters=tuple(pulses)), _log("usv", _commands("usv", 10.0, 1500.0))
    message = _refusal(vehicle, run)
    assert "commands f1, f2, f3 are not normalised" in message
    assert 'f1 = { channel = "f1", scale = 0.0025, offset = -3.75 }' in message
    # With that line, and what it makes of an output that is switched off.
    shares = {n: (run.channels[n] - 1500.0) / 400.0 for n in vehicle.command_names}
    shares["f1"] = np.where(np.arange(len(run.t)) % 5 == 0, -3.75, shares["f1"])
    found = examine(vehicle, [replace(run, channels={**run.channels, **shares})]).result.findings
    assert not any("not normalised" in f.text for f in found)


def test_the_line_mends_a_mapping_that_is_itself_the_mistake(tmp_path: Path) -> None:
    """The log is in m/s, and its mapping file says mm/s."""
    (columns,) = _case("usv").runs.values()
    path = tmp_path / "log.csv"
    rows = zip(*(c.tolist() for c in columns.values()), strict=True)
    path.write_text("\n".join([",".join(columns), *(",".join(map(repr, r)) for r in rows)]) + "\n")
    said = {"columns": {n: {"channel": n, "unit": "mm/s"} for n in ("u", "v")}}
    run = read_log(path, LogMapping.model_validate(said), _vehicle("usv").command_names)
    message = _refusal(_vehicle("usv"), run)
    assert "u, v are in m/s, read as mm/s" in message
    assert 'u = { channel = "u", unit = "m/s" }' in message


# --- what may be is left to the doctor ---------------------------------------------------------------------
SUSPECT: list[tuple[str, str, Break, tuple[str, ...], str, str, str]] = [
    ("knots", "usv", _speeds(KNOTS), NO_POSE, "speed_unit", "mistake", 'unit = "knot"'),
    ("km/h", "usv", _speeds(KMH), NO_POSE, "speed_unit", "mistake", 'unit = "km/h"'),
    ("km/h", "box", _speeds(KMH), NO_POSE, "speed_unit", "warning", 'unit = "km/h"'),
    ("all feet", "usv", both(_speeds(FTPS), _positions(FTPS)), ALL, "motion_unit", "mistake", '"ft/s"'),
    ("percent", "mini-auv", _commands("mini-auv", 100 / 6), ALL, "command_unit", "mistake", "scale = 0.06"),
    ("reversed", "usv", _commands("usv", -1.0), ALL, "reversed_thruster", "mistake", "scale = -1.0"),
    ("early", "usv", _late("usv", -0.5), ALL, "late_commands", "warning", ""),
    ("late", "mini-auv", _late("mini-auv", 0.5), ALL, "late_commands", "mistake", ""),
]  # fmt: skip


@pytest.mark.parametrize(
    ("what", "name", "wrong", "left_out", "kind", "severity", "line"),
    first_quick(SUSPECT, 4),
    ids=[f"{m[0]}-{m[1]}-{len(m[3])}" for m in SUSPECT],
)
def test_what_may_be_is_found_by_the_doctor_and_not_refused(
    what: str, name: str, wrong: Break, left_out: tuple[str, ...], kind: str, severity: str, line: str
) -> None:
    run = _log(name, wrong, left_out)
    assert _refusal(_vehicle(name), run) == ""
    findings = examine(_vehicle(name), [run]).result.findings
    (found,) = [f for f in findings if f.id == kind]
    assert found.severity == severity
    assert line in found.mapping


@pytest.mark.parametrize("seconds", [0.5, -0.5])
def test_the_doctor_tells_how_late_commands_are(seconds: float) -> None:
    """A motion after its command may be a dead time; a motion before it cannot."""
    findings = examine(_vehicle("usv"), [_log("usv", _late("usv", seconds))]).result.findings
    (found,) = [f for f in findings if f.id == "late_commands"]
    assert found.evidence["delay"] == pytest.approx(-seconds, abs=0.15)
    assert ("actuation_delay" in found.text) is (seconds < 0)
    assert ("precedes the commands" in found.text) is (seconds > 0)


DOCTORED = [
    ("mm/s", "usv", _speeds(MMPS), "speed_unit"),
    ("knots", "usv", _speeds(KNOTS), "speed_unit"),
    ("psi, r in deg", "usv", broken.in_degrees("psi", "r"), "degrees_for_radians"),
    ("one command", "usv", scaled("f1", by=1e3), "command_unit"),
    ("all mm", "usv", both(_speeds(1e3), _positions(1e3)), "motion_unit"),
    ("hhmmss", "usv", broken.time_of_day, "time_unit"),
]


@pytest.mark.parametrize(
    ("what", "name", "wrong", "kind"), first_quick(DOCTORED, 3), ids=[m[0] for m in DOCTORED]
)
def test_the_doctor_names_what_is_refused_and_mends_it(what: str, name: str, wrong: Break, kind: str) -> None:
    examined = examine(_vehicle(name), [_log(name, wrong)])
    assert [m.id for m in examined.result.mistakes] == [kind]
    (sound,) = _case(name).runs.values()
    (mended,) = examined.mended
    for channel in ("u", "v", "r", "psi", "x", "f1"):
        np.testing.assert_allclose(mended.channels[channel], sound[channel], rtol=1e-3, atol=1e-6)


# --- sound logs --------------------------------------------------------------------------------------------
HIDDEN = {
    "usv": "ocean_current thruster_gain thruster_lag thruster_deadband actuation_delay sensor_scale "
    "sensor_bias velocity_misalignment water_speed_log waves",
    "mini-auv": "velocity_lever_arm attitude_bias supply_droop net_buoyancy",
    "rov": "tether_drag sensor_delay thruster_asymmetry",
}
NOTHING_HIDDEN = ("usv", "mini-auv", "rov", "box", "float", "catamaran", "ship", "micro-auv", "torpedo")
SOUND: list[tuple[str, tuple[str, ...]]] = [(name, ()) for name in NOTHING_HIDDEN]
SOUND += [(name, (effect,)) for name, effects in HIDDEN.items() for effect in effects.split()]


@pytest.mark.parametrize(
    ("name", "hidden"),
    quick_if(lambda m: m in [(n, ()) for n in QUICK] or m[1] in QUICK_EFFECTS, SOUND),
    ids=[f"{n}-{'-'.join(h)}" for n, h in SOUND],
)
def test_hidden_physics_is_not_refused(name: str, hidden: tuple[str, ...]) -> None:
    case = make_case(name, hidden, 21, duration=25.0, runs=("steps",), strength=2.0 if hidden else 1.0)
    vehicle = vehicle_of(case)
    for run in runs_of(case):
        for left_out in (ALL, NO_POSE):
            kept = {n: d for n, d in run.channels.items() if n not in left_out}
            refuse_impossible(vehicle, [Run(run.name, run.t, kept)])


def test_a_current_as_fast_as_the_vehicle_is_not_refused() -> None:
    (columns,) = _case("usv").runs.values()
    for north, east in ((1.0, 0.0), (-0.6, 0.8)):
        drifting = {
            **columns,
            "x": columns["x"] + north * columns["t"],
            "y": columns["y"] + east * columns["t"],
        }
        assert _refusal(_vehicle("usv"), run_of("through the water", drifting)) == ""


@pytest.mark.parametrize(
    "case", first_quick(["auv-current", "auv-null", "auv-lag", "rov-dvl-lever-arm", "rov-tether-drag"])
)
def test_logs_with_hidden_effects_of_others_are_not_refused(case: str, tmp_path: Path) -> None:
    if not (DATA / "hidden-effects").exists():
        pytest.skip("the data set hidden-effects is not here")
    convert_vehicles(DATA / "hidden-effects" / "vehicles.json", tmp_path)
    vehicle = load_vehicle(str(tmp_path / f"{'rov' if case.startswith('rov') else 'mini-auv'}.toml"))
    for path in sorted((DATA / "hidden-effects" / case).glob("*.csv"))[:2]:
        refuse_impossible(vehicle, [read_log(path, LogMapping(), vehicle.command_names)])


REAL = [
    ("sf30k/vehicle-4dof.toml", "sf30k/log.toml", "ntnu-rov-sf30k/sf30k_20150518_1829.csv"),
    ("cse1/vehicle.toml", "cse1/log.toml", "ntnu-cse1/freerun/manual_run1.csv"),
]


@pytest.mark.parametrize(("vehicle_file", "map_file", "log"), first_quick(REAL), ids=[r[2] for r in REAL])
def test_real_logs_are_not_refused(vehicle_file: str, map_file: str, log: str) -> None:
    if not (DATA / log).exists():
        pytest.skip(f"the data set {log} is not here")
    vehicle, mapping = load_vehicle(str(EXAMPLES / vehicle_file)), read_mapping(EXAMPLES / map_file)
    run = read_log(DATA / log, mapping, vehicle.command_names, missing_commands="hold")
    refuse_impossible(vehicle, [velocities_from_pose(run, vehicle.degrees_of_freedom)])


@pytest.mark.slow
def test_no_minute_of_a_real_log_is_refused() -> None:
    """Its sway and its attitude have errors; one of hundreds of pairs of mistakes helps there by chance."""
    log = DATA / "ntnu-rov-sf30k" / "sf30k_20150518_1829.csv"
    if not log.exists():
        pytest.skip(f"the data set {log} is not here")
    vehicle = load_vehicle(str(EXAMPLES / "sf30k/vehicle.toml"))
    mapping = read_mapping(EXAMPLES / "sf30k/log.toml")
    run = read_log(log, mapping, vehicle.command_names, missing_commands="hold")
    for begin in (872.6, 1025.0, 1101.3, 1253.7):
        refuse_impossible(vehicle, [run.slice(begin, begin + 60.0)])


# --- the functions behind the commands ---------------------------------------------------------------------
def test_fit_compare_and_diagnose_refuse_and_can_be_told_to_trust() -> None:
    vehicle, bad = _vehicle("box"), _log("box", _speeds(MMPS))
    for function in (Estimator().fit, compare, diagnose):
        with pytest.raises(UndertowError, match=r"is impossible: u is in mm/s, read as m/s"):
            function(vehicle, [bad])
    trusted = Estimator().fit(vehicle, [bad], trust_log=True)
    assert np.isfinite([*trusted.values.values()]).all()


@pytest.mark.parametrize("sigma", ["", ', sigma = "25 kg"'], ids=["stated", "by rules of thumb"])
def test_a_unit_is_doubted_only_where_the_inertia_is_known(tmp_path: Path, sigma: str) -> None:
    """A hull of 20 kg whose file has 40 kg of added mass, and that has next to none: 2.9 times the force."""
    added = f'X_udot = {{ value = "-40 kg", estimate = true{sigma} }}'
    (tmp_path / "hull.toml").write_text(_HULL.replace("# added", added))
    vehicle = load_vehicle(tmp_path / "hull.toml")
    rng, t = np.random.default_rng(4), np.arange(0.0, 240.0, 0.1)
    force = np.repeat(rng.uniform(-20.0, 20.0, len(t) // 20), 20)
    u = np.zeros(len(t))
    for k in range(1, len(t)):
        u[k] = u[k - 1] + 0.1 * (force[k - 1] - 12.0 * u[k - 1]) / 20.8
    noise = 1e-3 * rng.standard_normal((2, len(t)))
    channels = {"x": np.cumsum(u) * 0.1 + noise[0], "u": u + noise[1], "thrust": force}
    findings = examine(vehicle, [run_of("hull", {"t": t} | channels)]).result.findings
    doubts = [f.text for f in findings if f.id in ("motion_unit", "command_unit")]
    assert all("at most 2.5 can be" in text for text in doubts)
    assert bool(doubts) is (not sigma)


_HULL = """
schema = "undertow/vehicle/1"
name = "hull"
degrees_of_freedom = ["surge"]
signs = "sname"
[effects.rigid_body]
m = "20 kg"
[effects.added_mass]
# added
[effects.linear_damping]
X_u = { value = "-12 kg/s", estimate = true }
[[thrusters]]
name = "thrust"
position = [0, 0, 0]
direction = [1, 0, 0]
"""
