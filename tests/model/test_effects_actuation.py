"""Actuation, waves and sensors: every effect against NumPy, and the laws that are its own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations

import casadi as ca
import numpy as np
import pytest
import sympy as sm
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from undertow.codegen.functions import Functions
from undertow.codegen.simulate import Simulator
from undertow.errors import UndertowError
from undertow.identification.estimation.inputs import ActuatorStates
from undertow.identification.estimation.pointwise import Pointwise
from undertow.model.catalogue import catalogue
from undertow.model.effect import Actuation, Effect, Measurement, Surface, kinds_of
from undertow.model.symbols import DOFS, POSE, Signals, pose_jacobian, signals, symbol
from undertow.model.vehicle import Thruster, Value, Vehicle

Array = NDArray[np.float64]
NAMES = ("port", "starboard")
# One thruster that points ahead beside the origin, one that is turned by 30 degrees in the vertical plane.
DIRECTIONS = np.array([[1.0, 0.0, 0.0], [np.cos(np.pi / 6), 0.0, np.sin(np.pi / 6)]])
PLACES = np.array([[-0.2, -0.3, 0.1], [0.4, 0.25, -0.05]])
ALLOCATION = np.vstack([DIRECTIONS.T, np.cross(PLACES, DIRECTIONS).T])
GAINS = np.array([1.5, 0.8])
RUDDER = Surface("rudder", (-0.8, 0.0, 0.1), (0.0, 0.0, -1.0), 0.02)
COMMANDS = np.array([[-3.0, 0.0, 0.4, 2.5], [1.2, -0.1, 0.0, -2.0]])


# --- numbers for symbols ------------------------------------------------------------------------
def stated(matrix: sm.Matrix, numbers: Mapping[str, float]) -> Array:
    """A column with numbers in it."""
    names = sorted(map(str, matrix.free_symbols))
    function = sm.lambdify([symbol(n) for n in names], list(matrix), "numpy")
    return np.array(function(*(numbers[n] for n in names)), dtype=float)


def motion(seed: int) -> dict[str, float]:
    """A pose, a velocity over ground and the same through the water, a time, water and gravity."""
    rng = np.random.default_rng(seed)
    s = signals(NAMES)
    names = [*map(str, s.eta), *map(str, s.nu), *map(str, s.nu_r[:3])]
    numbers = dict(zip(names, rng.uniform(-1, 1, len(names)), strict=True))
    return numbers | {"t": 7.3, "rho": 1025.0, "g": 9.81}


def turn(numbers: Mapping[str, float]) -> Array:
    """Body to NED."""
    return Rotation.from_euler("ZYX", [numbers[n] for n in ("psi", "theta", "phi")]).as_matrix()


def delivered(effect_id: str, parameters: dict[str, float], command: Array, t: float = 0.0) -> Array:
    """What a step of the chain makes of a command for each of the two thrusters."""
    effect = catalogue()[effect_id](NAMES)
    assert isinstance(effect, Actuation)
    upstream = sm.Matrix([symbol("port"), symbol("starboard")])
    numbers = parameters | {"t": t, "port": command[0], "starboard": command[1]}
    return stated(effect.output(upstream, signals(NAMES)), numbers)


def pressing(effect_id: str, parameters: dict[str, float], numbers: dict[str, float]) -> Array:
    """Wrench of an effect on the vehicle with the two thrusters."""
    s = signals(NAMES)
    effect = catalogue()[effect_id](NAMES).placed(sm.Matrix(ALLOCATION))
    wrench = effect.spelled_out(effect.wrench(s), s)  # type: ignore[attr-defined]
    gains = {f"thrust_{n}": k for n, k in zip(NAMES, GAINS, strict=True)}
    return stated(wrench, {**parameters, **gains, **numbers})


def under_thrust(seed: int, command: Array) -> dict[str, float]:
    return motion(seed) | {f"actuation_{n}": c for n, c in zip(NAMES, command, strict=True)}


def read(effect_id: str, parameters: dict[str, float], numbers: dict[str, float]) -> tuple[Array, Array]:
    """Pose and velocity that the sensors report."""
    s: Signals = signals()
    effect = catalogue()[effect_id]()
    assert isinstance(effect, Measurement)
    pose, velocity = effect.reported(s.eta, s.nu, s)
    return stated(pose, {**parameters, **numbers}), stated(velocity, {**parameters, **numbers})


def true(numbers: dict[str, float]) -> tuple[Array, Array]:
    eta, nu = (np.array([numbers[str(x)] for x in v]) for v in (signals().eta, signals().nu))
    return eta, nu


# --- the actuation chain --------------------------------------------------------------------------
@pytest.mark.parametrize("command", COMMANDS.T)
def test_saturation_clips(command: Array) -> None:
    np.testing.assert_allclose(
        delivered("thruster_saturation", {"saturation_limit": 1.1}, command), np.clip(command, -1.1, 1.1)
    )


def test_saturation_is_the_identity_within_the_limit() -> None:
    command = np.array([1.99, -1.99])
    assert (delivered("thruster_saturation", {"saturation_limit": 2.0}, command) == command).all()


def test_saturation_that_nothing_is_said_of_limits_nothing() -> None:
    vehicle = craft(("surge",), {}, "thruster_saturation")
    f = Functions(vehicle)
    assert vehicle.value_of("saturation_limit").value == np.inf
    output = ca.Function("output", [f.u, f.p], [f.actuator_output, ca.jacobian(f.actuator_output, f.u)])
    value, slope = output([1e6, -3.0], f.values())
    np.testing.assert_array_equal(np.array(value).ravel(), [1e6, -3.0])
    np.testing.assert_array_equal(np.array(slope), np.eye(2))


@pytest.mark.parametrize("command", COMMANDS.T)
def test_curve_adds_a_square(command: Array) -> None:
    # (1 - a) c + a c |c| / c_ref
    a, reference = 0.3, 2.0
    parameters = {"curve_linear": -a, "curve_square": a / reference}
    expected = (1 - a) * command + a * command * np.abs(command) / reference
    np.testing.assert_allclose(delivered("thruster_curve", parameters, command), expected, atol=1e-15)
    assert delivered("thruster_curve", parameters, np.array([reference, 0.0]))[0] == pytest.approx(reference)


@pytest.mark.parametrize("command", COMMANDS.T)
def test_asymmetry_weakens_reverse_thrust_only(command: Array) -> None:
    expected = np.where(command < 0, 0.6 * command, command)
    np.testing.assert_allclose(delivered("thruster_asymmetry", {"reverse_loss": 0.4}, command), expected)


def pairs_of(kind: type[Effect]) -> list[tuple[str, str]]:
    return list(combinations([i for i, e in catalogue().items() if issubclass(e, kind)], 2))


@pytest.mark.parametrize("ids", pairs_of(Actuation), ids="+".join)
def test_the_order_in_a_vehicle_file_means_nothing_to_the_thrust(ids: tuple[str, str]) -> None:
    one, other = (craft(("surge",), {}, *order).composition.chain for order in (ids, ids[::-1]))
    assert one[0] == other[0]


@pytest.mark.parametrize("ids", pairs_of(Measurement), ids="+".join)
def test_the_order_in_a_vehicle_file_means_nothing_to_the_sensors(ids: tuple[str, str]) -> None:
    one, other = (craft(DOFS, {}, *order).composition.reported for order in (ids, ids[::-1]))
    for report, same in zip(one, other, strict=True):
        assert sm.simplify(report - same) == sm.zeros(*report.shape)


def test_an_arm_turns_with_the_true_rate_and_a_bias_is_that_of_the_reading() -> None:
    vehicle = craft(("surge", "sway", "yaw"), {}, "sensor_bias", "sensor_scale", "velocity_lever_arm")
    values = {
        "b_u": 0.1,
        "b_v": 0.0,
        "b_r": 0.3,
        "scale_velocity": 0.5,
        "scale_rate": 0.0,
        "x_s": 2.0,
        "y_s": 1.0,
    }
    values |= {"z_s": 0.0, "u": 1.0, "v": 0.0, "r": 0.2}
    _, velocity = vehicle.composition.reported
    known = {x: values.get(str(x), 0.0) for x in velocity.free_symbols}
    u, v, r = (float(velocity[i].subs(known)) for i in range(3))
    assert (u, v, r) == pytest.approx((1.5 * (1.0 - 0.2 * 1.0) + 0.1, 1.5 * 0.2 * 2.0, 0.5))


def test_the_drive_limits_the_command_and_the_propeller_turns_it_into_thrust() -> None:
    """A reverse loss is that of the largest thrust, too: it comes after dead band, limit and curve."""
    values = {"deadband_width": 0.5, "saturation_limit": 2.0, "curve_linear": 0.0, "curve_square": 0.1}
    ids = ("thruster_asymmetry", "thruster_curve", "thruster_saturation", "thruster_deadband")
    vehicle = craft(("surge",), {}, *ids)
    numbers = values | {"reverse_loss": 0.4, "command_port": -9.0, "command_starboard": 1.5}
    astern, ahead = stated(vehicle.composition.chain[0], numbers)
    assert astern == pytest.approx(-0.6 * (2.0 + 0.1 * 2.0**2))
    assert ahead == pytest.approx(1.0 + 0.1)


def test_droop_fades_linearly_from_the_start() -> None:
    command = np.array([2.0, -1.0])
    for t, share in ((0.0, 1.0), (25.0, 0.9), (100.0, 0.6)):
        np.testing.assert_allclose(
            delivered("supply_droop", {"droop_rate": 0.004}, command, t), share * command
        )


# --- forces of thrusters --------------------------------------------------------------------------
@pytest.mark.parametrize("command", COMMANDS.T)
def test_thrust_loss_follows_inflow_and_shaft_speed(command: Array) -> None:
    numbers, length = under_thrust(1, command), 0.07
    linear = np.array([numbers[n] for n in ("u_r", "v_r", "w_r")])
    angular = np.array([numbers[n] for n in "pqr"])
    force, moment = np.zeros(3), np.zeros(3)
    for e, r, k, c in zip(DIRECTIONS, PLACES, GAINS, command, strict=True):
        speed = e @ (linear + np.cross(angular, r))
        lost = -length * np.sqrt(numbers["rho"] * k * abs(c)) * speed * e
        force, moment = force + lost, moment + np.cross(r, lost)
    found = pressing("thrust_loss", {"inflow_length": length, "inflow_least": 1e-6}, numbers)
    np.testing.assert_allclose(found, [*force, *moment], atol=1e-9)


def test_thrust_loss_is_that_of_a_propeller_with_a_falling_thrust_coefficient() -> None:
    rho, diameter, k0, k1, n, speed = 1025.0, 0.1, 0.45, 0.4, 12.0, 0.6
    at_rest = rho * n**2 * diameter**4 * k0
    thrust = rho * n**2 * diameter**4 * (k0 - k1 * speed / (n * diameter))
    numbers = under_thrust(0, np.array([at_rest / GAINS[0], 0.0]))
    numbers |= {"u_r": speed, "p": 0.0, "q": 0.0, "r": 0.0}
    parameters = {"inflow_length": diameter * k1 / np.sqrt(k0), "inflow_least": 1e-6}
    assert pressing("thrust_loss", parameters, numbers)[0] == pytest.approx(thrust - at_rest)


def test_a_pure_moment_is_no_propeller() -> None:
    s, moment = signals(("bow",)), sm.Matrix([0, 0, 0, 0, 0, 1])
    effect = catalogue()["thrust_loss"](("bow",)).placed(moment)
    assert effect.spelled_out(effect.wrench(s), s) == sm.zeros(6, 1)  # type: ignore[attr-defined]


@pytest.mark.parametrize("command", COMMANDS.T)
def test_reaction_torque_turns_about_the_axes_and_has_no_net_force(command: Array) -> None:
    parameters = {"d_reaction": 0.03, "hand_port": 1.0, "hand_starboard": -1.0}
    found = pressing("reaction_torque", parameters, under_thrust(2, command))
    assert (found[:3] == 0).all()
    np.testing.assert_allclose(found[3:], 0.03 * DIRECTIONS.T @ (np.array([1, -1]) * GAINS * command))


def test_propellers_of_opposite_hand_cancel() -> None:
    numbers = under_thrust(2, np.array([2.0, 2.0 * GAINS[0] / GAINS[1]]))
    effect = catalogue()["reaction_torque"](NAMES).placed(sm.Matrix([[1, 1], *[[0, 0]] * 5]))
    hands = {"d_reaction": 0.03, "hand_port": 1.0, "hand_starboard": -1.0}
    gains = {f"thrust_{n}": k for n, k in zip(NAMES, GAINS, strict=True)}
    wrench = effect.wrench(signals(NAMES))  # type: ignore[attr-defined]
    np.testing.assert_allclose(stated(wrench, numbers | gains | hands), 0.0, atol=1e-15)


@pytest.mark.parametrize("command", COMMANDS.T)
def test_propeller_walk_differs_astern(command: Array) -> None:
    parameters = {"Y_walk": 0.02, "N_walk": -0.1, "Y_walk_back": 0.15, "N_walk_back": 0.4}
    along = DIRECTIONS[:, 0] @ (GAINS * command)
    astern = min(along, 0.0)
    expected = [0, 0.02 * along + 0.15 * astern, 0, 0, 0, -0.1 * along + 0.4 * astern]
    np.testing.assert_allclose(pressing("propeller_walk", parameters, under_thrust(3, command)), expected)


# --- waves ----------------------------------------------------------------------------------------
WAVE = {"wave_cos": 0.4, "wave_sin": -0.7, "wave_frequency": 1.3, "wave_direction": 0.8}


def water(place: Array, t: float) -> Array:
    """Velocity of the water in a regular deep-water wave, NED, written down anew."""
    amplitude, phase0 = np.hypot(0.4, -0.7), np.arctan2(-0.7, 0.4)
    w, k = 1.3, 1.3**2 / 9.81
    ahead = np.array([np.cos(0.8), np.sin(0.8), 0.0])
    phase = k * ahead @ place - w * t + phase0
    size = amplitude * w * np.exp(-k * place[2])
    return np.asarray(size * (np.cos(phase) * ahead - np.sin(phase) * np.array([0, 0, 1])))


def wave_numbers(seed: int = 5) -> dict[str, float]:
    numbers = motion(seed)
    return numbers | {"z": 2.0 + numbers["z"], "m": 30.0}


def flow(part: str, numbers: dict[str, float]) -> Array:
    s, effect = signals(), catalogue()["waves"]()
    return stated(effect.spelled_out(getattr(effect, part)(s), s), WAVE | numbers)


def test_waves_move_the_water_on_circles_that_fade_with_depth() -> None:
    numbers = wave_numbers()
    place = np.array([numbers[n] for n in "xyz"])
    np.testing.assert_allclose(flow("velocity", numbers), water(place, 7.3))
    speed = [np.linalg.norm(flow("velocity", numbers | {"z": z, "t": t})) for z in (0, 3) for t in (0, 1)]
    assert speed[0] == pytest.approx(speed[1])
    assert speed[2] / speed[0] == pytest.approx(np.exp(-3 * 1.3**2 / 9.81))


def test_waves_solve_the_deep_water_equations() -> None:
    numbers, step = wave_numbers(), 1e-4
    gradient = np.array(
        [
            (
                flow("velocity", numbers | {n: numbers[n] + step})
                - flow("velocity", numbers | {n: numbers[n] - step})
            )
            / (2 * step)
            for n in "xyz"
        ]
    )
    assert np.trace(gradient) == pytest.approx(0.0, abs=1e-7)  # continuity
    np.testing.assert_allclose(gradient, gradient.T, atol=1e-7)  # no rotation
    # The pressure at the moving surface stays: w_tt = -g w_z for waves that run freely.
    beats = [flow("velocity", numbers | {"t": 7.3 + h})[2] for h in (-0.01, 0.0, 0.01)]
    second = (beats[0] - 2 * beats[1] + beats[2]) / 0.01**2
    assert second == pytest.approx(9.81 * gradient[2, 2], rel=1e-4)


def along(numbers: dict[str, float], velocity: Array) -> Array:
    """Rate of the water's velocity at a point that moves with a velocity, NED, by central differences."""
    place, step = np.array([numbers[n] for n in "xyz"]), 1e-4
    ends = [water(place + h * velocity, numbers["t"] + h) for h in (step, -step)]
    return np.asarray((ends[0] - ends[1]) / (2 * step))


def test_acceleration_of_the_water_is_its_rate_along_the_path_of_the_vehicle() -> None:
    numbers = wave_numbers()
    path = turn(numbers) @ [numbers[n] for n in "uvw"]
    np.testing.assert_allclose(flow("acceleration", numbers), along(numbers, path), rtol=1e-6)


def test_waves_push_with_the_acceleration_that_follows_the_water() -> None:
    numbers = wave_numbers()
    place = np.array([numbers[n] for n in "xyz"])
    expected = 30.0 * turn(numbers).T @ along(numbers, water(place, 7.3))
    found = flow("wrench", numbers)
    np.testing.assert_allclose(found[:3], expected, rtol=1e-6)
    assert (found[3:] == 0).all()


def test_a_hull_that_drifts_like_water_feels_no_force() -> None:
    values = {**WAVE, "m": 30.0, "X_udot": -6.0, "Y_vdot": -20.0, "Z_wdot": -25.0, "X_uabsu": -8.0}
    dofs = ("surge", "sway", "heave")
    vehicle = craft(dofs, values, "rigid_body", "added_mass", "quadratic_damping", "waves", thrusters=False)
    place, t = np.array([1.0, -2.0, 3.0]), 4.2
    rate = along(dict(zip("xyz", place, strict=True)) | {"t": t}, water(place, t))
    f = Functions(vehicle)
    state = [*place, *water(place, t)]
    residual = np.array(f.residual_function(state, rate, [], f.values(), t)).ravel()
    np.testing.assert_allclose(residual, 0.0, atol=1e-5)


def test_waves_are_of_two_kinds() -> None:
    assert kinds_of(catalogue()["waves"]) == ("flow", "wrench")


# --- sensors --------------------------------------------------------------------------------------
def test_misalignment_about_z_is_a_rotation() -> None:
    numbers = motion(8)
    _, nu = true(numbers)
    pose, velocity = read("velocity_misalignment", {"turn_z": 1.9, "tilt_x": 0.0, "tilt_y": 0.0}, numbers)
    np.testing.assert_allclose(velocity[:3], Rotation.from_euler("z", 1.9).as_matrix().T @ nu[:3])
    np.testing.assert_array_equal(velocity[3:], nu[3:])
    np.testing.assert_array_equal(pose, true(numbers)[0])
    assert np.linalg.norm(velocity[:3]) == pytest.approx(np.linalg.norm(nu[:3]))


def test_misalignment_tilts_are_a_rotation_to_first_order() -> None:
    numbers, size = motion(9), 1e-4
    parameters = {"turn_z": 0.3, "tilt_x": size, "tilt_y": -2 * size}
    mounted = (
        Rotation.from_rotvec([size, -2 * size, 0]).as_matrix() @ Rotation.from_euler("z", 0.3).as_matrix()
    )
    velocity = read("velocity_misalignment", parameters, numbers)[1]
    np.testing.assert_allclose(velocity[:3], mounted.T @ true(numbers)[1][:3], atol=10 * size**2)


def test_biases_add_and_scales_multiply() -> None:
    numbers = motion(10)
    eta, nu = true(numbers)
    bias = dict(zip([f"b_{n}" for n in "uvwpqr"], np.arange(1, 7) / 10, strict=True))
    np.testing.assert_allclose(read("sensor_bias", bias, numbers)[1], nu + np.arange(1, 7) / 10)
    scale = {"scale_velocity": 0.05, "scale_rate": -0.02}
    np.testing.assert_allclose(read("sensor_scale", scale, numbers)[1], nu * ([1.05] * 3 + [0.98] * 3))
    angles = {"b_phi": 0.01, "b_theta": -0.02, "b_psi": 0.3}
    pose, velocity = read("attitude_bias", angles, numbers)
    np.testing.assert_allclose(pose, eta + np.array([0, 0, 0, 0.01, -0.02, 0.3]))
    np.testing.assert_array_equal(velocity, nu)


def test_a_compass_turns_a_velocity_that_was_logged_along_the_earth() -> None:
    """The velocity over ground stays, and the body is thought to point elsewhere."""
    numbers, error = motion(13), {"b_psi": 0.3}
    plain = craft(("surge", "sway", "yaw"), error, "attitude_bias")
    along = replace(plain, velocity_along_earth=True)
    given, turned = (stated(v.composition.reported[1], numbers | error) for v in (plain, along))
    np.testing.assert_allclose(given, [numbers[n] for n in ("u", "v", "r")])
    (u, v, r), (cos, sin) = given, (np.cos(0.3), np.sin(0.3))
    np.testing.assert_allclose(turned, [cos * u + sin * v, cos * v - sin * u, r])


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        ("position_lever_arm", {"x_fix": 1.5, "y_fix": -0.2, "z_fix": -0.8}),
        ("attitude_bias", {"b_phi": 0.02, "b_theta": -0.03, "b_psi": 0.3}),
        ("velocity_lever_arm", {"x_s": 0.4, "y_s": 0.1, "z_s": -0.2}),
        ("sensor_bias", {"b_u": 0.1, "b_r": -0.03}),
    ],
)
def test_a_velocity_that_was_derived_has_the_errors_of_the_pose_and_no_others(
    effect: str, values: dict[str, float]
) -> None:
    numbers = motion(14)
    derived = replace(craft(DOFS, values, effect), derived_velocities=("u", "v", "w", "p", "q", "r"))
    eta, nu = true(numbers)
    rate = stated(sm.Matrix(derived.composition.pose_rate), numbers)
    step = 1e-6
    ahead, back = (
        stated(
            derived.composition.reported[0], numbers | dict(zip(POSE, eta + h * rate, strict=True)) | values
        )
        for h in (step, -step)
    )
    there = stated(derived.composition.reported[0], numbers | values)
    J = stated(pose_jacobian(sm.Matrix(there)), {}).reshape(6, 6)
    expected = np.linalg.solve(J, (ahead - back) / (2 * step))
    found = stated(derived.composition.reported[1], numbers | values)
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-8)
    if effect in ("velocity_lever_arm", "sensor_bias"):
        np.testing.assert_allclose(found, nu)
        assert not set(values) & set(derived.parameter_names)


def test_an_antenna_swings_about_the_origin() -> None:
    numbers, arm = motion(11), np.array([1.5, -0.2, -0.8])
    pose, _ = read("position_lever_arm", dict(zip(("x_fix", "y_fix", "z_fix"), arm, strict=True)), numbers)
    np.testing.assert_allclose(pose[:3], true(numbers)[0][:3] + turn(numbers) @ arm)


def test_a_log_through_the_water_reads_the_relative_velocity() -> None:
    numbers = motion(12)
    velocity = read("water_speed_log", {"V_N_log": 0.3, "V_E_log": -0.5}, numbers)[1]
    expected = true(numbers)[1][:3] - turn(numbers).T @ [0.3, -0.5, 0.0]
    np.testing.assert_allclose(velocity[:3], expected)
    vehicle = craft(DOFS, {"V_N_log": 0.3, "V_E_log": -0.5}, "water_speed_log", "quadratic_damping")
    relative = sm.Matrix([vehicle.composition.relative_motion[x] for x in signals(NAMES).nu_r[:3]])
    np.testing.assert_allclose(stated(relative, numbers | {"V_N_log": 0.3, "V_E_log": -0.5}), expected)


SENSORS = {
    "velocity_misalignment": {"turn_z": 0.4, "tilt_x": 0.05, "tilt_y": -0.03},
    "sensor_bias": {"b_u": 0.1, "b_v": -0.2, "b_w": 0.05, "b_p": 0.01, "b_q": 0.02, "b_r": -0.03},
    "sensor_scale": {"scale_velocity": 0.1, "scale_rate": -0.05},
    "attitude_bias": {"b_phi": 0.02, "b_theta": -0.04, "b_psi": 0.3},
    "position_lever_arm": {"x_fix": 1.0, "y_fix": 0.2, "z_fix": -0.5},
    "water_speed_log": {"V_N_log": 0.3, "V_E_log": -0.5},
    "velocity_lever_arm": {"x_s": 0.3, "y_s": -0.1, "z_s": 0.2},
}


@pytest.mark.parametrize("ids", [*((i,) for i in SENSORS), tuple(SENSORS)], ids=[*SENSORS, "all"])
@pytest.mark.parametrize("dofs", [DOFS, ("surge", "sway", "yaw")], ids=["six", "three"])
def test_the_true_motion_follows_from_what_sensors_report(
    ids: tuple[str, ...], dofs: tuple[str, ...]
) -> None:
    values = {n: v for i in ids for n, v in SENSORS[i].items()}
    f = Functions(craft(dofs, values, "quadratic_damping", *ids))
    points = Pointwise(f, ())
    state = ca.vertcat(f.eta, f.nu)
    back = ca.substitute(points.true_motion, points.measured, f.reported)
    number = np.random.default_rng(3).uniform(-1, 1, state.numel())
    found = ca.Function("back", [state, f.p], [back])(number, f.values())
    np.testing.assert_allclose(np.array(found).ravel(), number, atol=1e-12)


# --- on a vehicle ---------------------------------------------------------------------------------
def craft(dofs: tuple[str, ...], values: dict[str, float], *ids: str, thrusters: bool = True) -> Vehicle:
    """A vehicle with the two thrusters and the effects named."""
    hardware = tuple(
        Thruster(n, tuple(column), Value(k)) for n, column, k in zip(NAMES, ALLOCATION.T, GAINS, strict=True)
    )
    surfaces = (RUDDER,) if any("control_surfaces" in catalogue()[i].requires for i in ids) else ()
    effects = tuple(catalogue()[i](NAMES, surfaces) for i in ids)
    stated_values = {n: Value(v) for n, v in values.items()}
    return Vehicle("craft", dofs, effects, stated_values, hardware if thrusters else (), surfaces=surfaces)


BODY = {"m": 20.0, "I_z": 2.0, "X_u": -5.0, "Y_v": -8.0, "N_r": -1.0}


def test_simulation_and_weak_form_agree_on_thrust_that_fades() -> None:
    values = {**BODY, "droop_rate": 0.02, "T_lag": 0.3}
    ids = "rigid_body", "linear_damping", "supply_droop", "thruster_lag"
    f = Functions(craft(("surge", "sway", "yaw"), values, *ids))
    t, p = np.arange(0, 20, 0.1), np.array(f.values())
    u = np.repeat(np.random.default_rng(4).uniform(-2, 2, (10, 2)), 20, axis=0)
    mean = ActuatorStates(f, ()).along(t, u, p).value
    start = np.concatenate([np.zeros(6), u[0]])
    lagged = Simulator(f, compiled=False).run(start, t, u, p, max_step=0.01)[:, 6:]
    # T dx/dt = (1 - d t) u - x, so the mean of x over an interval follows from its ends.
    middle = 1 - 0.02 * (t[:-1, None] + 0.05)
    np.testing.assert_allclose(mean[:-1], middle * u[:-1] - 0.3 * np.diff(lagged, axis=0) / 0.1, atol=1e-6)


@pytest.mark.parametrize("lag", [0.01, 0.05, 0.3, 2.0])
def test_a_lag_is_carried_on_whatever_the_time_between_samples(lag: float) -> None:
    """The servo of a fin in the log of a slow recorder: classical Runge-Kutta grows beyond 0.7 of its step.

    Within an interval the mean is that of Simpson: a lag that it cannot resolve counts as a twelfth of it.
    """
    f = Functions(craft(("surge", "yaw"), {**BODY, "T_lag": lag}, "rigid_body", "thruster_lag"))
    place = f.parameter_names.index("T_lag")
    t, u = np.arange(40.0), np.repeat(np.random.default_rng(2).uniform(-2, 2, (10, 2)), 4, axis=0)
    driven = ActuatorStates(f, (place,)).along(t, u, np.array(f.values()))
    thrust, fade = [u[0]], np.exp(-1.0 / lag)
    for held in u[:-1]:
        thrust.append(held + (thrust[-1] - held) * fade)
    means = u + (np.array(thrust) - u) * lag * (1.0 - fade)
    largest = np.max(np.abs(np.array(thrust) - u))
    np.testing.assert_allclose(driven.value[:-1], means[:-1], atol=2e-3 if lag >= 0.3 else largest / 12)
    assert np.all(np.isfinite(driven.slope))


def test_fading_thrust_without_lag_is_the_mean_over_each_interval() -> None:
    f = Functions(craft(("surge", "yaw"), {**BODY, "droop_rate": 0.02}, "rigid_body", "supply_droop"))
    place = f.parameter_names.index("droop_rate")
    t, u = np.array([0.0, 1.0, 3.0, 4.0]), np.array([[1.0, -1.0], [2.0, 0.0], [3.0, 1.0], [0.0, 0.0]])
    driven = ActuatorStates(f, (place,)).along(t, u, np.array(f.values()))
    middle = np.array([0.5, 2.0, 3.5, 4.0])[:, None]
    np.testing.assert_allclose(driven.value, (1 - 0.02 * middle) * u)
    np.testing.assert_allclose(driven.slope[:, :, 0], -middle * u)


class Windmilling(Actuation):
    """A step of the chain that feels the motion."""

    id = "windmilling"
    reference = signature = "none"

    def output(self, upstream: sm.Matrix, s: Signals) -> sm.Matrix:
        return upstream - s.nu_r[0] * sm.ones(*upstream.shape)


def test_a_chain_that_feels_the_motion_is_refused_by_the_fit() -> None:
    f = Functions(craft(("surge",), BODY, "rigid_body").with_effect(Windmilling, {}))
    with pytest.raises(UndertowError, match=r"depends on the motion.*as a Wrench in s\.actuation"):
        ActuatorStates(f, ())


def test_effects_of_the_thrusters_need_thrusters() -> None:
    with pytest.raises(
        UndertowError, match=r"'thrusters', which vehicle 'craft' lacks: add \[\[thrusters\]\]"
    ):
        craft(("surge",), {}, "reaction_torque", thrusters=False)


def test_every_effect_of_a_vehicle_knows_the_allocation() -> None:
    vehicle = craft(("surge", "yaw"), BODY, "rigid_body", "linear_damping")
    for effect in vehicle.all_effects:
        np.testing.assert_allclose(np.array(effect.allocation, dtype=float), ALLOCATION)


ADDED = {
    *("thruster_saturation", "thruster_curve", "thruster_asymmetry", "thrust_loss", "supply_droop"),
    *("reaction_torque", "propeller_walk", "waves", "velocity_misalignment", "sensor_bias", "sensor_scale"),
    *("attitude_bias", "position_lever_arm", "water_speed_log"),
}


@pytest.mark.parametrize("effect_id", sorted(ADDED))
def test_searches_start_where_derivatives_are_finite(effect_id: str) -> None:
    cls: type[Effect] = catalogue()[effect_id]
    needs = [i for i in cls.requires if i != "thrusters"]
    vehicle = craft(
        DOFS, {**BODY, "I_x": 1.0, "I_y": 2.0}, *{"rigid_body", "linear_damping", *needs}, effect_id
    )
    f = Functions(vehicle)
    own = {p.name: p for p in cls(NAMES).parameters}
    reported = ca.vertcat(f.residual, f.actuator_output, f.reported)
    slope = ca.jacobian(ca.substitute(reported, f.actuation, f.actuator_output), ca.vertcat(f.p, f.x))
    function = ca.Function("slope", [f.x, f.nu_dot, f.u, f.p, f.t], [slope])
    for pick in (0, -1):
        values = dict(zip(f.parameter_names, f.values(), strict=True))
        values |= {n: p.starts[pick] for n, p in own.items() if p.starts and n in values}
        for command in ([0.0, 0.0], [1.0, -2.0]):
            at = [np.zeros(f.x.numel()), np.zeros(6), command, list(values.values()), 3.0]
            assert np.isfinite(np.array(function(*at))).all()
