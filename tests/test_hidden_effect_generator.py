"""The generator of hidden-effect logs obeys physics, and its effects do what they say."""

from __future__ import annotations

import ast
import gzip
import json
import tomllib
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from benchmarks import hidden_effects
from benchmarks.hidden_effects import EFFECTS, Case, make_case, write_case
from benchmarks.hidden_effects.__main__ import main
from benchmarks.hidden_effects.cases import hidden_world
from benchmarks.hidden_effects.conversion import converted
from benchmarks.hidden_effects.demo import DEMO_DATA, DURATION, demo_case
from benchmarks.hidden_effects.files import FILES, csv_text, toml_text
from benchmarks.hidden_effects.hardships import TIMES, WITHIN
from benchmarks.hidden_effects.plant import STEP, SUBSTEPS, Plant
from benchmarks.hidden_effects.simulation import CHANNELS, NOISE, integrate
from benchmarks.hidden_effects.vehicles import NOMINAL, Vehicle
from benchmarks.hidden_effects.world import Moment, World, plain_world, to_ned

pytestmark = pytest.mark.docs

Run = dict[str, np.ndarray]

# Seconds and seed of effects that show only after a while: a weight that drops, a rope slack at first, a
# thruster that fails.
LATE = {"dropped_weight": (22.0, 13), "tether_tension": (20.0, 2), "failing_thruster": (24.0, 21)}
OLDEST = ("mini-auv", "rov", "usv")
# Seconds of the other vehicles.
LATER = {"dropped_weight": 62.0, "failing_thruster": 62.0, "tether_tension": 30.0, "drag_asymmetry": 25.0}


def able(number: int, name: str) -> list[str]:
    """The oldest vehicles that can have an effect, and one of the others, in turn."""
    able = EFFECTS[name].vehicles
    others = [v for v in able if v not in OLDEST] or list(able)
    return sorted({*(v for v in able if v in OLDEST), others[number % len(others)]})


ABLE = [(name, vehicle) for i, name in enumerate(EFFECTS) for vehicle in able(i, name)]


def world_of(vehicle: str, *effects: str, strength: float = 1.0, seed: int = 1) -> World:
    return hidden_world(NOMINAL[vehicle], effects, seed, strength)[0]


def coast(world: World, start: np.ndarray, seconds: float, command: np.ndarray | None = None) -> np.ndarray:
    """True states (n, 12, R) at 80 Hz under a constant command, by default none."""
    held = np.zeros(world.allocation.shape[1]) if command is None else command
    errors = np.zeros((round(20 * seconds), 12, start.shape[1]))
    return integrate(world, start, errors, lambda k, reading: np.tile(held[:, None], (1, start.shape[1])))[2]


def tumbling(vehicle: Vehicle, runs: int = 4, seed: int = 0) -> np.ndarray:
    """(12, R) starts at the usual depth with lively velocities."""
    rng, own = np.random.default_rng(seed), list(vehicle.dofs)
    start = np.zeros((12, runs))
    start[2] = vehicle.depth
    start[[6 + i for i in own]] = rng.uniform(-1, 1, (len(own), runs)) * vehicle.pace[own][:, None]
    return start


def energy(world: World, states: np.ndarray) -> np.ndarray:
    """Kinetic plus potential energy (n, R) of vehicle and carried water, J."""
    nu = states[:, 6:]
    kinetic = 0.5 * np.einsum("nir,ij,njr->nr", nu, world.rigid_mass + world.added_mass, nu)
    heavy, arm = world.gravity_wrench[0, 0], world.gravity_wrench[3:]
    moment = np.array([arm[2, 1], arm[0, 2], arm[1, 0]])  # W r_G - B r_B
    phi, theta = states[:, 3], states[:, 4]
    down = np.stack([-np.sin(theta), np.cos(theta) * np.sin(phi), np.cos(theta) * np.cos(phi)], axis=1)
    return kinetic - heavy * states[:, 2] - np.einsum("i,nir->nr", moment, down)


def undamped(vehicle: str, *effects: str) -> World:
    world = world_of(vehicle, *effects)
    return replace(world, linear=np.zeros((6, 6)), quadratic=np.zeros((6, 6)))


# --- conservation laws -------------------------------------------------------------------------------------


@pytest.mark.parametrize("vehicle", NOMINAL)
@pytest.mark.parametrize("effects", [(), ("added_mass_coupling",), ("entrained_water",)])
def test_without_drag_and_thrust_energy_is_kept(vehicle: str, effects: tuple[str, ...]) -> None:
    if not all(vehicle in EFFECTS[effect].vehicles for effect in effects):
        return
    world = undamped(vehicle, *effects)
    total = energy(world, coast(world, tumbling(world.vehicle), 3.0))
    assert total == pytest.approx(np.broadcast_to(total[0], total.shape), rel=1e-6, abs=1e-9)


def test_without_drag_and_gravity_momentum_is_kept() -> None:
    world = replace(undamped("rov", "added_mass_coupling"), gravity_wrench=np.zeros((6, 3)))
    states = coast(world, tumbling(world.vehicle), 3.0)
    mass = world.rigid_mass + world.added_mass
    found = []
    for state in states[::40]:
        turn = rotation_of(state[3:6])
        momentum = mass @ state[6:]
        linear, angular = to_ned(turn, momentum[:3]), to_ned(turn, momentum[3:])
        found.append(np.concatenate([linear, angular + np.cross(state[:3], linear, axis=0)]))
    assert np.ptp(found, axis=0) == pytest.approx(0.0, abs=1e-6)


def rotation_of(angles: np.ndarray) -> np.ndarray:
    """(3, 3, R) product of the three elementary rotations, written apart from the generator's."""
    return np.stack([turn_z(psi) @ turn_y(theta) @ turn_x(phi) for phi, theta, psi in angles.T], axis=2)


def turn_x(a: float) -> np.ndarray:
    return np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])


def turn_y(a: float) -> np.ndarray:
    return np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])


def turn_z(a: float) -> np.ndarray:
    return np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])


DISSIPATIVE = [
    "quadratic_damping",
    "cubic_damping",
    "linear_damping_coupling",
    "dry_friction",
    "drag_asymmetry",
    "crossflow_drag",
    "boundary_proximity",
    "tether_drag",
    "growing_drag",
    "turning_drag",
]


@pytest.mark.parametrize("effect", ["", *DISSIPATIVE])
@pytest.mark.parametrize("vehicle", NOMINAL)
def test_without_thrust_energy_never_grows(vehicle: str, effect: str) -> None:
    if effect and vehicle not in EFFECTS[effect].vehicles:
        return
    world = world_of(vehicle, *([effect] if effect else []))
    total = energy(world, coast(world, tumbling(world.vehicle), 3.0))
    assert np.diff(total, axis=0).max() <= 1e-9
    assert np.all(total[-1] < total[0])


# --- closed forms ------------------------------------------------------------------------------------------


def straight_ahead(command: float) -> np.ndarray:
    return np.array([0.0, command, 0.0, command])


def terminal_speed(vehicle: Vehicle, force: float) -> float:
    """Positive root of -X_uabsu u^2 - X_u u = F."""
    a, b = -vehicle.linear[0], -vehicle.quadratic[0]
    return float((-a + np.sqrt(a**2 + 4 * b * force)) / (2 * b))


def test_terminal_speed() -> None:
    vehicle = NOMINAL["mini-auv"]
    states = coast(plain_world(vehicle), np.zeros((12, 1)), 45.0, straight_ahead(0.6))
    assert states[-1, 6, 0] == pytest.approx(terminal_speed(vehicle, 1.2), rel=1e-9)
    assert states[:, 7:] == pytest.approx(0.0, abs=1e-12)


def test_a_current_along_the_course_adds_to_the_terminal_speed() -> None:
    vehicle = NOMINAL["mini-auv"]
    world, values = hidden_world(vehicle, ["ocean_current"], 1, 1.0)
    start = np.zeros((12, 1))
    start[5] = np.arctan2(values["ocean_current"]["V_E"], values["ocean_current"]["V_N"])
    speed = np.hypot(values["ocean_current"]["V_E"], values["ocean_current"]["V_N"])
    states = coast(world, start, 45.0, straight_ahead(0.6))
    assert states[-1, 6, 0] == pytest.approx(terminal_speed(vehicle, 1.2) + speed, rel=1e-9)


def test_linear_drag_and_thruster_lag_in_closed_form() -> None:
    """u = F/d (1 - (tau exp(-t/tau) - T exp(-t/T)) / (tau - T)) with tau = m/d."""
    world = replace(world_of("mini-auv"), quadratic=np.zeros((6, 6)), lag=0.7)
    states = coast(world, np.zeros((12, 1)), 10.0, straight_ahead(0.5))
    drag, mass = -world.linear[0, 0], world.vehicle.mass + world.added_mass[0, 0]
    t, tau = STEP * np.arange(len(states)), mass / drag
    shape = 1 - (tau * np.exp(-t / tau) - 0.7 * np.exp(-t / 0.7)) / (tau - 0.7)
    assert states[:, 6, 0] == pytest.approx(shape / drag, abs=1e-9)


def test_a_delay_shifts_the_motion_in_time() -> None:
    prompt, late = world_of("usv"), world_of("usv", "actuation_delay")
    steps = round(late.command_delay / STEP)
    assert steps > 0
    command = np.array([1.0, 0.3, -0.2])
    early, after = (coast(world, np.zeros((12, 1)), 10.0, command) for world in (prompt, late))
    assert np.array_equal(after[steps:], early[: len(early) - steps])
    assert not after[: steps + 1].any()


def test_a_trimmed_rov_rests_where_its_moment_points_down() -> None:
    world = world_of("rov", "trim_offset")
    arm = world.gravity_wrench[3:]
    moment = np.array([arm[2, 1], arm[0, 2], arm[1, 0]])
    start = np.zeros((12, 1))
    start[3] = np.arctan2(moment[1], moment[2])
    start[4] = np.arctan2(-moment[0], np.hypot(moment[1], moment[2]))
    assert abs(start[4, 0]) > 0.005
    assert coast(world, start, 2.0)[-1] == pytest.approx(start, abs=1e-12)
    settled = coast(world, np.zeros((12, 1)), 60.0)[-1]
    assert settled[3:5] == pytest.approx(start[3:5], abs=0.005)


def moment_at(world: World, nu: np.ndarray) -> Moment:
    still = np.zeros((6, 1))
    return Moment(0.0, still, nu, nu, np.eye(3)[:, :, None], np.zeros((4, 1)), still)


def test_crossflow_drag_in_closed_form() -> None:
    world, values = hidden_world(NOMINAL["usv"], ["crossflow_drag"], 1, 1.0)
    c, length, x0 = (values["crossflow_drag"][key] for key in ("c", "L", "x_0"))
    sway, yaw = np.zeros((6, 1)), np.zeros((6, 1))
    sway[1], yaw[5] = -0.3, 0.5
    drift, spin = (world.wrenches[0](moment_at(world, nu))[[1, 5], 0] for nu in (sway, yaw))
    assert drift == pytest.approx([c * length * 0.09, c * length * x0 * 0.09], rel=1e-9)
    ends = np.array([x0 - length / 2, x0 + length / 2])
    drag, moment = np.diff(np.abs(ends) ** 3)[0] / 3, np.sum(ends**4) / 4
    expected = [-c * 0.25 * drag, -c * 0.25 * moment]
    # The integrand has a kink at x = 0, which ten Gauss points see to half a per cent.
    assert spin == pytest.approx(expected, rel=5e-3, abs=5e-3 * c)


def test_a_weightless_hull_is_carried_along_by_waves() -> None:
    """As the wave's pressure acts on the displaced mass, a hull that starts with the water stays with it."""
    world = undamped("mini-auv", "waves")
    start = np.zeros((12, 1))
    start[2] = world.vehicle.depth
    start[6:9] = world.flows[0](0.0, start[:6], np.zeros((3, 1)))[0]
    for i, state in enumerate(coast(world, start, 10.0)):
        water = world.flows[0](i * STEP, state[:6], np.zeros((3, 1)))[0]
        assert state[6:9] == pytest.approx(water, abs=1e-8)


def test_hull_and_swinging_mass_exchange_momentum_and_swing_as_two_masses_on_a_spring() -> None:
    world, values = hidden_world(undamped("mini-auv").vehicle, ["slosh"], 1, 1.0)
    world = replace(world, linear=np.zeros((6, 6)), quadratic=np.zeros((6, 6)))
    load, omega, ratio = (values["slosh"][k] for k in ("m_slosh", "slosh_frequency", "slosh_damping"))
    hull = (world.rigid_mass + world.added_mass)[0, 0]
    start = np.zeros((12, 1))
    start[6] = 0.2
    u = coast(world, start, 12.0)[:, 6, 0]
    # Seen from their common centre: one oscillator, (1 + m_s / m) times as stiff and as damped.
    more, t = 1.0 + load / hull, STEP * np.arange(len(u))
    damped = omega * np.sqrt(more - (ratio * more) ** 2)
    fade, rest = np.exp(-ratio * omega * more * t), 0.2 * hull / (hull + load)
    swing = np.cos(damped * t) - ratio * omega * more / damped * np.sin(damped * t)
    assert u == pytest.approx(rest + (0.2 - rest) * fade * swing, abs=1e-7)


def test_wind_pushes_to_one_side_of_the_world() -> None:
    world, values = hidden_world(NOMINAL["usv"], ["wind"], 1, 1.0)
    aspect, blow = values["wind"]["wind_aspect"], [values["wind"][k] for k in ("W_N", "W_E")]
    for psi in np.linspace(-3.0, 3.0, 7):
        turn = turn_z(psi)[:, :, None]
        moment = replace(moment_at(world, np.zeros((6, 1))), turn=turn)
        force = world.wrenches[0](moment)[:3]
        force[1] /= aspect
        assert to_ned(turn, force)[:2, 0] == pytest.approx(blow)


def test_a_rudder_gives_nothing_at_rest_and_four_times_as_much_at_twice_the_speed() -> None:
    world, values = hidden_world(NOMINAL["torpedo"], ["rudder_force"], 1, 1.0)
    ((name, gain),) = values["rudder_force"].items()
    which = NOMINAL["torpedo"].thrusters.index(name.removeprefix("rudder_"))
    found = []
    for speed in (0.0, 0.4, 0.8, -0.4):
        nu = np.zeros((6, 1))
        nu[0] = speed
        moment = replace(moment_at(world, nu), thrust=np.full((len(world.allocation.T), 1), 2.0))
        found.append(world.wrenches[0](moment)[:, 0])
    once = gain * 0.16 * 2.0 * world.allocation[:, which]
    assert np.array(found) == pytest.approx(np.outer([0.0, 1.0, 4.0, -1.0], once), abs=1e-12)


def test_lever_arm_reads_the_velocity_of_its_place() -> None:
    seen, true = (quiet("rov", *names) for names in (("velocity_lever_arm",), ()))
    arm = make_case("rov", ("velocity_lever_arm",), 2, duration=1).truth["values"]["velocity_lever_arm"]
    omega = np.stack([true[c] for c in "pqr"], axis=1)
    shift = np.cross(omega, [arm["x_s"], arm["y_s"], arm["z_s"]])
    for i, channel in enumerate("uvw"):
        assert seen[channel] - true[channel] == pytest.approx(shift[:, i], abs=1e-12)


# --- every effect ------------------------------------------------------------------------------------------


@cache
def quiet(vehicle: str, *effects: str, strength: float = 1.0, seconds: float = 4.0, seed: int = 2) -> Run:
    """Noise-free multi-sine run."""
    runs = ("multisine",)
    case = make_case(vehicle, effects, seed, strength=strength, noise=0.0, duration=seconds, runs=runs)
    return case.runs["multisine"]


def same(a: Run, b: Run) -> bool:
    return all(np.array_equal(a[name], b[name]) for name in b)


@pytest.mark.parametrize(("name", "vehicle"), [pair for pair in ABLE if EFFECTS[pair[0]].kind != "prior"])
def test_an_effect_changes_the_motion_and_strength_zero_takes_it_away(name: str, vehicle: str) -> None:
    seconds, seed = LATE.get(name, (4.0, 2)) if vehicle in OLDEST else (LATER.get(name, 8.0), 5)
    full, none, null = (
        quiet(vehicle, *effects, strength=strength, seconds=seconds, seed=seed)
        for effects, strength in (((name,), 1.0), ((name,), 0.0), ((), 1.0))
    )
    change = max(np.max(np.abs(full[c] - none[c])) for c in CHANNELS)
    assert change > 1e-4, f"{name} moves nothing by more than {change:.1e}"
    left_out = make_case(vehicle, (name,), 2, duration=0.05).truth["left_out"]
    # What the prior model leaves out is part of the ordinary world: without it, that world is another.
    assert same(none, null) is not bool(left_out)


@pytest.mark.parametrize("name", ["wrong_drag", "wrong_added_mass"])
def test_a_wrong_guess_changes_the_prior_only(name: str) -> None:
    wrong, right = (make_case("rov", effects, 4, duration=1) for effects in ((name,), ()))
    ((parameter, factor),) = wrong.truth["values"][name].items()
    assert same(wrong.runs["steps"], right.runs["steps"])
    assert (wrong.truth["class"], wrong.truth["effects"]) == ("null", [])
    assert guesses(wrong)[parameter] == pytest.approx(factor * guesses(right)[parameter], rel=1e-3)
    assert factor in (0.5, 2.0)


def guesses(case: Case) -> dict[str, float]:
    tables = case.vehicle["effects"].values()
    return {
        key: entry["value"] for table in tables for key, entry in table.items() if isinstance(entry, dict)
    }


@pytest.mark.parametrize("vehicle", NOMINAL)
def test_guesses_are_good_to_15_per_cent(vehicle: str) -> None:
    for seed in range(20):
        case = make_case(vehicle, (), seed, duration=0.05)
        for name, guess in guesses(case).items():
            assert guess / case.truth["parameters"][name] == pytest.approx(1.0, abs=0.1505)


def test_classes() -> None:
    def verdict(*effects: str) -> tuple[str, list[str]]:
        truth = make_case("rov", effects, 1, duration=0.05).truth
        return truth["class"], truth["effects"]

    assert verdict() == ("null", [])
    assert verdict("thruster_deadband_jump") == ("library", ["thruster_deadband"])
    assert verdict("lift", "wrong_drag") == ("library", ["lift"])
    assert verdict("lift", "ocean_current") == ("double", ["lift", "ocean_current"])
    assert verdict("gusts") == ("alien", ["gusts"])
    assert sum(effect.kind == "alien" for effect in EFFECTS.values()) >= 5


def test_every_effect_states_its_equation() -> None:
    for effect in EFFECTS.values():
        assert len(effect.equation) > 20
        assert effect.equation.endswith(".")


# --- logs --------------------------------------------------------------------------------------------------


def test_noise_is_as_stated_and_absent_channels_are_zero() -> None:
    noisy, clean = (
        make_case("mini-auv", (), 5, noise=noise, duration=50, runs=("cruise",)) for noise in (2.0, 0.0)
    )
    for channel, sigma in zip(CHANNELS, NOISE, strict=True):
        error = noisy.runs["cruise"][channel] - clean.runs["cruise"][channel]
        absent = channel in ("phi", "theta", "p", "q")
        assert error.std() == pytest.approx(0.0 if absent else 2 * sigma, rel=0.08)
        assert not absent or not noisy.runs["cruise"][channel].any()


def test_the_stream_of_each_run_is_its_own() -> None:
    alone = make_case("usv", ("lift",), 3, duration=5, runs=("holdout",)).runs["holdout"]
    together = make_case("usv", ("lift",), 3, duration=5).runs
    for name, column in together["holdout"].items():
        assert alone[name] == pytest.approx(column, abs=1e-12)
    assert not np.allclose(together["holdout"]["f1"], together["steps"]["f1"])


@pytest.mark.parametrize("vehicle", NOMINAL)
def test_feedback_holds_heading_and_depth_within_the_limits(vehicle: str) -> None:
    case = make_case(vehicle, (), 6, closed_loop=True, duration=20, runs=("steps",))
    run, made = case.runs["steps"], NOMINAL[vehicle]
    assert np.abs(run["psi"] - run["psi"][0]).max() < 4.0
    assert np.abs(run["z"] - made.depth).max() < 3.0
    for name in made.thrusters:
        assert np.abs(run[name]).max() <= made.command_limit
    open_loop = make_case(vehicle, (), 6, duration=20, runs=("steps",)).runs["steps"]
    assert not same(run, open_loop)


def test_the_same_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    folders = [
        write_case(make_case("rov", ("lift", "waves"), seed, duration=3), tmp_path / name, compress=packed)
        for name, seed, packed in (("a", 1, True), ("b", 1, True), ("c", 2, True), ("d", 1, False))
    ]
    first, second, other, plain = ({p.name: p.read_bytes() for p in f.iterdir()} for f in folders)
    assert first == second
    assert all(first[name] != other[name] for name in first)
    assert sorted(plain) == sorted(
        [*(f"{name}.csv" for name in FILES.values()), "vehicle.toml", "truth.json"]
    )
    assert gzip.decompress(first["train_1.csv.gz"]) == plain["train_1.csv"]
    assert first["train_1.csv.gz"][4:8] == bytes(4)  # no time stamp


def test_vehicle_file_is_what_the_case_says() -> None:
    case = make_case("rov", ("restoring",), 1, duration=0.05)
    assert tomllib.loads(toml_text(case.vehicle)) == case.vehicle
    assert "restoring" not in case.vehicle["effects"]
    assert case.vehicle["effects"]["rigid_body_coriolis"] == {}
    columns = np.array([thruster["wrench"] for thruster in case.vehicle["thrusters"]]).T
    assert np.array_equal(columns, NOMINAL["rov"].allocation)


def test_demo_data_on_disk_is_what_the_generator_makes() -> None:
    case = demo_case()
    for run, name in FILES.items():
        with gzip.open(DEMO_DATA / "auv" / f"{name}.csv.gz", "rt", encoding="utf-8") as stream:
            kept = np.genfromtxt(stream, delimiter=",", names=True)
        assert len(kept) == 20 * DURATION
        assert kept.dtype.names == tuple(case.runs[run])
        for column, values in case.runs[run].items():
            assert kept[column] == pytest.approx(values, abs=1.1e-5)
    assert (DEMO_DATA / "auv" / "vehicle.toml").read_text(encoding="utf-8") == toml_text(case.vehicle)
    truth = json.loads((DEMO_DATA / "auv" / "truth.json").read_text(encoding="utf-8"))
    assert truth["values"]["ocean_current"] == pytest.approx(case.truth["values"]["ocean_current"])
    assert sum(path.stat().st_size for path in DEMO_DATA.rglob("*")) < 500_000


def test_csv_has_no_more_digits_than_needed() -> None:
    columns = {"t": np.array([0.0, 0.05]), "x": np.array([-1e-9, 123.4567891])}
    assert csv_text(columns) == "t,x\n0,0\n0.05,123.45679\n"


# --- the rest ----------------------------------------------------------------------------------------------


def test_inertia_of_a_converted_vehicle_is_about_the_origin() -> None:
    entry = {
        "degrees_of_freedom": ["u", "v", "r"],
        "signs": "sname",
        "rigid_body": {"m": 20.0, "I": np.diag([1.0, 1.0, 1.5]).tolist(), "r_G": [0.1, 0.0, 0.0]},
        "added_mass": {"X_udot": -2.0},
        "linear_damping": {"X_u": -1.0},
        "allocation": {"columns": ["f1"], "matrix": [[1.0], [0.0], [-0.0], [0.0], [0.0], [0.5]]},
        "command_limit_N": 2.0,
    }
    vehicle = converted("ship", entry)
    assert vehicle["degrees_of_freedom"] == ["surge", "sway", "yaw"]
    assert vehicle["effects"]["rigid_body"] == {"m": 20.0, "x_g": 0.1, "y_g": 0.0, "I_z": 1.7}
    assert vehicle["effects"]["added_mass"]["X_udot"]["sigma"] == pytest.approx(0.3)
    assert vehicle["thrusters"][0]["wrench"] == [1.0, 0.0, 0.0, 0.0, 0.0, 0.5]
    assert "restoring" not in vehicle["effects"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--vehicle", "rov"], "--out DIR is missing"),
        (["--out", "x", "--effect", "lifft"], "unknown effect 'lifft'"),
        (["--out", "x", "--vehicle", "usv", "--effect", "restoring"], "usv cannot have the effect restoring"),
        (["--out", "x", "--duration", "0"], "a case needs a run and a sample"),
        (["vehicles", "absent.json", "x"], "absent.json"),
    ],
)
def test_nonsense_is_one_line_and_exit_code_2(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main([str(tmp_path / a) if a == "x" else a for a in arguments]) == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_command_line_writes_a_case(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = str(tmp_path / "case")
    options = ["--vehicle", "usv", "--effect", "ocean_current", "--duration", "1", "--run", "holdout"]
    assert main(["--out", out, *options, "--seed", "3"]) == 0
    assert "library" in capsys.readouterr().out
    assert {p.name for p in Path(out).iterdir()} == {"holdout.csv", "vehicle.toml", "truth.json"}
    assert main(["list"]) == 0
    listed = capsys.readouterr().out
    assert all(name in listed for name in EFFECTS)


def test_a_vehicle_that_runs_away_is_refused() -> None:
    with pytest.raises(ValueError, match="lower the strength"):
        make_case("rov", ("ocean_current",), 1, strength=100.0, duration=5)
    with pytest.raises(ValueError, match="not positive definite"):
        Plant(replace(world_of("usv"), added_mass=-50.0 * np.eye(6)))


def test_the_generator_is_no_mirror_of_the_product() -> None:
    root = Path(hidden_effects.__file__).parent
    imported = set()
    for path in root.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                imported |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level:
                imported.add(str(node.module).split(".")[0])
    assert "numpy" in imported
    assert not imported & {"undertow", "sympy", "casadi", "scipy"}


@pytest.mark.parametrize("name", ["usv", "mini-auv"])
def test_a_vehicle_that_cannot_tilt_moves_by_the_equations_of_all(name: str) -> None:
    """The shorter kinematics gives the same numbers to the last digit."""
    world = world_of(name, "lift", "ocean_current")
    short, whole = Plant(world), Plant(world)
    assert short.level
    whole.level = False
    y = tumbling(world.vehicle)
    y[5] = np.linspace(-3.0, 3.0, y.shape[1])
    command = np.full((world.allocation.shape[1], y.shape[1]), 0.3)
    np.testing.assert_array_equal(short.step(0.0, y, command), whole.step(0.0, y, command))


def test_samples_are_four_steps_apart() -> None:
    assert pytest.approx(1 / 20) == STEP * SUBSTEPS


# --- as hard as real logs ----------------------------------------------------------------------------------


@pytest.mark.parametrize("times", TIMES)
def test_random_forces_change_velocities_by_a_multiple_of_the_noise(times: int) -> None:
    def changes(kind: str) -> np.ndarray:
        """Rms change of the velocities in 2 s that random forces make, without drag."""
        world = world_of("box", f"{kind}_force_{times}")
        world.linear[:], world.quadratic[:] = 0.0, 0.0
        states = coast(world, np.zeros((12, 8)), 100.0)[:: round(WITHIN / STEP), 6]
        return np.sqrt(np.mean(np.diff(states, axis=0) ** 2)) / NOISE[6]

    for kind in ("white", "slow"):
        assert changes(kind) == pytest.approx(times, rel=0.35)


def test_a_current_of_each_run_is_another_and_waves_have_phases_of_their_own() -> None:
    world = world_of("usv", "ocean_current_per_run")
    drifted = coast(world, np.zeros((12, 3)), 60.0)[-1, 6:8]
    assert len({tuple(np.round(v, 3)) for v in drifted.T}) == 3
    world = world_of("usv", "waves_per_run")
    moved = coast(world, np.zeros((12, 2)), 20.0)[:, 6]
    assert np.max(np.abs(moved[:, 0] - moved[:, 1])) > 1e-3
    assert not np.ptp(coast(world_of("usv", "waves"), np.zeros((12, 2)), 20.0)[:, 6], axis=1).any()
