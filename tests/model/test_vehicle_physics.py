"""Whole vehicles obey physics: conservation laws, power balances, invariances, cases in closed form."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pytest
import sympy as sm
from numpy.typing import NDArray

from tests.quick import first_quick
from undertow.errors import UndertowError
from undertow.model.catalogue import catalogue
from undertow.model.composition import statement_of
from undertow.model.effect import Actuation, Effect, Wrench, kinds_of
from undertow.model.loading import bundled_vehicles, load_vehicle
from undertow.model.parameter import PerThruster
from undertow.model.plausibility import mass_matrix_at
from undertow.model.symbols import DOFS, Signals, rotation, skew, symbol
from undertow.model.vehicle import Thruster, Value, Vehicle

Array = NDArray[np.float64]
MOTIONS = ("eta", "nu", "nu_dot")


@dataclass
class Numbers:
    """A vehicle's equations as functions of numbers, by SymPy's own printer and nothing of ours."""

    vehicle: Vehicle
    overrides: Mapping[str, float] = ()  # type: ignore[assignment]

    @cached_property
    def known(self) -> dict[sm.Symbol, float]:
        values = {symbol(n): self.vehicle.value_of(n).value for n in self.vehicle.parameter_names}
        return values | {symbol(n): v for n, v in dict(self.overrides).items()}

    def function(self, expression: sm.Matrix) -> Callable[..., Array]:
        c = self.vehicle.composition
        free = [c.eta, c.nu, c.nu_dot, c.actuation]
        names = [x for m in free for x in m]
        compiled = sm.lambdify(names, list(expression.xreplace(self.known)), "numpy", cse=True)
        sizes = [m.rows for m in free]

        def call(*columns: Array) -> Array:
            padded = [*columns, *(np.zeros(n) for n in sizes[len(columns) :])]
            return (
                np.array(compiled(*np.concatenate(padded)), dtype=float).reshape(expression.shape).squeeze()
            )

        return call

    @cached_property
    def residual(self) -> Callable[..., Array]:
        return self.function(self.vehicle.residual)

    @cached_property
    def forcing(self) -> Callable[..., Array]:
        return self.function(self.vehicle.forcing)

    @cached_property
    def pose_rate(self) -> Callable[..., Array]:
        return self.function(self.vehicle.composition.pose_rate)

    @cached_property
    def mass(self) -> Callable[..., Array]:
        return self.function(self.vehicle.mass_matrix)

    def acceleration(self, eta: Array, nu: Array, actuation: Array) -> Array:
        zero = np.zeros_like(nu)
        return np.linalg.solve(self.mass(eta, nu), self.forcing(eta, nu, zero, actuation))


def integrate(rate: Callable[[Array], Array], state: Array, seconds: float, step: float) -> Array:
    """Runge-Kutta of fourth order."""
    for _ in range(round(seconds / step)):
        a = rate(state)
        b = rate(state + step / 2 * a)
        c = rate(state + step / 2 * b)
        d = rate(state + step * c)
        state = state + step / 6 * (a + 2 * b + 2 * c + d)
    return state


def vehicle_with(
    values: Mapping[str, float], *ids: str, dofs: tuple[str, ...] = DOFS, thrusters: int = 0
) -> Vehicle:
    wrench = (1.0, 0.0, 0.0, 0.0, 0.0, 0.2)
    hardware = tuple(Thruster(f"f{i + 1}", wrench, Value(1.0 + i)) for i in range(thrusters))
    names = tuple(t.name for t in hardware)
    effects = tuple(catalogue()[i](names) for i in ids)
    return Vehicle("test", dofs, effects, {k: Value(v) for k, v in values.items()}, hardware)


# --- bodies with every term ---------------------------------------------------------------------------
def cloud() -> tuple[Array, Array]:
    """Point masses (kg) and places (m) of a lopsided body."""
    draw = np.random.default_rng(7)
    return draw.uniform(0.5, 2.0, 12), draw.uniform(-0.5, 0.5, (12, 3)) + np.array([0.05, -0.1, 0.08])


def force_on_cloud(nu: Array, nu_dot: Array) -> Array:
    """Sum of m a and r x m a with a = v_dot + omega_dot x r + omega x (v + omega x r)."""
    masses, places = cloud()
    velocity = nu[:3] + np.cross(nu[3:], places)
    acceleration = nu_dot[:3] + np.cross(nu_dot[3:], places) + np.cross(nu[3:], velocity)
    force = masses[:, None] * acceleration
    return np.concatenate([force.sum(axis=0), np.cross(places, force).sum(axis=0)])


def cloud_values() -> dict[str, float]:
    masses, places = cloud()
    x, y, z = places.T
    return {
        "m": masses.sum(),
        **{f"m{a}_g": masses @ c for a, c in zip("xyz", (x, y, z), strict=True)},
        "I_x": masses @ (y**2 + z**2),
        "I_y": masses @ (x**2 + z**2),
        "I_z": masses @ (x**2 + y**2),
        "I_xy": masses @ (x * y),
        "I_xz": masses @ (x * z),
        "I_yz": masses @ (y * z),
    }


def added_mass_values() -> dict[str, float]:
    draw = np.random.default_rng(8)
    root = draw.uniform(-0.8, 0.8, (6, 6))
    inertia = root @ root.T + np.diag([4, 9, 12, 0.5, 1, 1.5])
    names = [(f, v) for f in "XYZKMN" for v in "uvwpqr"]
    entries = dict(zip([f"{f}_{v}dot" for f, v in names], inertia.ravel(), strict=True))
    wanted = {p.name for i in ("added_mass", "added_mass_coupling") for p in catalogue()[i]().parameters}
    return {n: -e for n, e in entries.items() if n in wanted}


INERTIA = ("rigid_body", "rigid_body_coriolis", "added_mass", "added_mass_coupling", "added_mass_coriolis")
BODY = cloud_values() | added_mass_values()
STATICS = {"W": 160.0, "B": 155.0, "S_x": 3.0, "S_y": -2.0, "S_z": 6.0}
START = np.array([0.3, -0.2, 5.0, 0.4, -0.3, 1.1, 1.2, -0.7, 0.4, 0.5, -0.6, 0.8])


@pytest.fixture(scope="module")
def free_body() -> Numbers:
    return Numbers(vehicle_with(BODY, *INERTIA))


@pytest.fixture(scope="module")
def floating_body() -> Numbers:
    return Numbers(vehicle_with(BODY | STATICS, *INERTIA, "restoring"))


def motion(body: Numbers) -> Callable[[Array], Array]:
    def rate(state: Array) -> Array:
        eta, nu = state[:6], state[6:]
        return np.concatenate([body.pose_rate(eta, nu), body.acceleration(eta, nu, np.zeros(0))])

    return rate


def turned(eta: Array) -> Array:
    return np.array(rotation(sm.Matrix(eta[3:])).evalf(), dtype=float)


def impulse(body: Numbers, state: Array) -> Array:
    """Linear and angular momentum of body and fluid, NED, about the fixed origin."""
    eta, nu = state[:6], state[6:]
    momentum, turn = body.mass(eta, nu) @ nu, turned(eta)
    linear = turn @ momentum[:3]
    return np.concatenate([linear, turn @ momentum[3:] + np.cross(eta[:3], linear)])


def energy(body: Numbers, state: Array) -> float:
    """Kinetic energy, and potential energy of weight and buoyancy (z is down)."""
    eta, nu = state[:6], state[6:]
    arms = np.array([STATICS[f"S_{a}"] for a in "xyz"])
    potential = -(STATICS["W"] - STATICS["B"]) * eta[2] - arms @ turned(eta)[2]
    return float(nu @ body.mass(eta, nu) @ nu / 2 + potential)


def test_inertia_of_a_body_is_that_of_its_particles(free_body: Numbers) -> None:
    masses, places = cloud()
    vehicle = vehicle_with(BODY, "rigid_body")
    rows = np.array(mass_matrix_at(vehicle))
    expected = np.zeros((6, 6))
    for m, r in zip(masses, places, strict=True):
        s = np.array(skew(sm.Matrix(r)), dtype=float)
        expected += m * np.block([[np.eye(3), -s], [s, -s @ s]])
    assert rows == pytest.approx(expected, rel=1e-12)


def test_force_on_a_body_is_that_on_its_particles() -> None:
    body = Numbers(vehicle_with(BODY, "rigid_body", "rigid_body_coriolis"))
    nu, nu_dot = START[6:], np.array([0.3, -0.4, 0.2, 0.9, -0.8, 0.7])
    assert -body.residual(START[:6], nu, nu_dot) == pytest.approx(force_on_cloud(nu, nu_dot), rel=1e-12)


def test_a_free_body_in_ideal_fluid_keeps_its_impulse_and_energy(free_body: Numbers) -> None:
    end = integrate(motion(free_body), START, 1.0, 0.005)
    assert np.abs(end - START).max() > 0.5, "it has moved"
    assert impulse(free_body, end) == pytest.approx(impulse(free_body, START), abs=1e-7)
    kinetic = [s[6:] @ free_body.mass(s[:6], s[6:]) @ s[6:] / 2 for s in (START, end)]
    assert kinetic[1] == pytest.approx(kinetic[0], rel=1e-8)


def test_a_floating_body_keeps_its_energy_and_what_gravity_cannot_change(floating_body: Numbers) -> None:
    end = integrate(motion(floating_body), START, 1.0, 0.005)
    assert energy(floating_body, end) == pytest.approx(energy(floating_body, START), rel=1e-8)
    before, after = impulse(floating_body, START), impulse(floating_body, end)
    kept = [0, 1, 5]  # north, east, and the moment about the vertical
    assert after[kept] == pytest.approx(before[kept], abs=1e-7)
    assert after[2] - before[2] == pytest.approx(STATICS["W"] - STATICS["B"], rel=1e-6), "W - B for 1 s"


def test_righting_moment_and_period_of_small_roll() -> None:
    values = {"m": 10.0, "I_x": 0.4, "W": 98.1, "B": 98.1, "S_z": 2.5, "K_pdot": -0.1}
    vehicle = vehicle_with(values, "rigid_body", "added_mass", "restoring", dofs=("roll",))
    phi = vehicle.composition.eta[0]
    moment = vehicle.power()["restoring"] / symbol("p")
    assert sm.simplify(moment.subs(symbol("S_y"), 0) + symbol("S_z") * sm.sin(phi)) == 0
    body = Numbers(vehicle)

    def rate(state: Array) -> Array:
        return np.array([state[1], np.ravel(body.forcing(state[:1], state[1:]))[0] / 0.5])

    half_period = np.pi * np.sqrt(0.5 / 2.5)
    end = integrate(rate, np.array([1e-3, 0.0]), half_period, half_period / 400)
    assert end == pytest.approx([-1e-3, 0.0], abs=1e-8)


# --- power --------------------------------------------------------------------------------------------
CLAIMS = [i for i, c in catalogue().items() if issubclass(c, Wrench) and (c.workless or c.dissipative)]


@pytest.mark.parametrize("name", sorted(bundled_vehicles()))
def test_bundled_vehicles_have_positive_definite_inertia(name: str) -> None:
    for direction in (1, -1):
        rows = np.array(mass_matrix_at(load_vehicle(name), direction))
        assert rows == pytest.approx(rows.T, abs=1e-12)
        assert np.linalg.eigvalsh(rows).min() > 0


@pytest.mark.parametrize("name", first_quick(sorted(bundled_vehicles()), 4))
def test_bundled_vehicles_balance_their_power(name: str) -> None:
    """What the effects do to the vehicle in 0.2 s is what its kinetic energy gains."""
    vehicle = load_vehicle(name)
    body, n = Numbers(vehicle, {"tau_X": 3.0}), len(vehicle.degrees_of_freedom)
    shares = vehicle.power()
    power = body.function(sm.Matrix(list(shares.values())))
    actuation = np.linspace(0.5, 1.5, len(vehicle.thrusters) + len(vehicle.surfaces))

    def rate(state: Array) -> Array:
        eta, nu = state[:n], state[n : 2 * n]
        done = power(eta, nu, np.zeros(n), actuation)
        return np.concatenate(
            [np.atleast_1d(body.pose_rate(eta, nu)), acceleration(eta, nu), np.atleast_1d(done)]
        )

    def acceleration(eta: Array, nu: Array) -> Array:
        mass = np.reshape(body.mass(eta, nu), (n, n))
        return np.linalg.solve(mass, np.atleast_1d(body.forcing(eta, nu, np.zeros(n), actuation)))

    nu = np.linspace(0.9, 0.6, n)  # clear of the switch between forward and backward values
    start = np.concatenate([np.linspace(0.1, 0.3, n), nu, np.zeros(len(shares))])
    end = integrate(rate, start, 0.2, 0.002)
    assert end[n] > 0.1, "still ahead, where the values of ahead apply"
    kinetic = [
        s[n : 2 * n] @ np.reshape(body.mass(s[:n], s[n : 2 * n]), (n, n)) @ s[n : 2 * n] / 2
        for s in (start, end)
    ]
    work = dict(zip(shares, end[2 * n :], strict=True))
    assert kinetic[1] - kinetic[0] == pytest.approx(sum(work.values()), rel=1e-6)
    for effect_id in {"rigid_body", "added_mass", "rigid_body_coriolis", "added_mass_coriolis"} & set(work):
        assert work[effect_id] == pytest.approx(0, abs=1e-12)
    for effect_id in {"linear_damping", "quadratic_damping"} & set(work):
        assert work[effect_id] < 0


# --- invariances --------------------------------------------------------------------------------------
def _is_a_wrench_of_the_motion(effect: type[Effect]) -> bool:
    """Whether an effect is a wrench, a function of pose and motion through the water, and nothing else."""
    wrench = kinds_of(effect) == ("wrench",) and not effect.built_in and not effect.specimen().states
    return (
        wrench and "thrusters" not in effect.requires and effect.id not in ("dry_friction", "wave_excitation")
    )


STILL = tuple(i for i, c in catalogue().items() if _is_a_wrench_of_the_motion(c))


def _feels(effect_id: str, coordinates: str) -> bool:
    """Whether the wrench of an effect contains a pose coordinate."""
    used = statement_of(catalogue()[effect_id].specimen(), catalogue()).free_symbols
    return bool({str(x) for x in used} & set(coordinates.split()))


def any_values(*ids: str) -> dict[str, float]:
    """A value inside the bounds for every parameter of the effects."""
    draw = np.random.default_rng(5)
    values = {}
    for p in (p for i in ids for p in catalogue()[i](("f1", "f2")).parameters):
        low, high = p.bounds
        size = draw.uniform(0.2, 2.0)
        values[p.name] = size if low >= 0 else -size if high <= 0 else size * draw.choice([-1, 1])
    return values


def test_in_a_uniform_current_everything_is_as_in_still_water() -> None:
    """Seen from the water: the residual with a current equals that of the relative motion without one."""
    values = any_values(*STILL) | BODY | {"V_N": 0.7, "V_E": -0.4}
    still = Numbers(vehicle_with(values, *STILL))
    moved = Numbers(vehicle_with(values, *STILL, "ocean_current"))
    eta, nu, nu_dot = START[:6], START[6:], np.array([0.3, -0.4, 0.2, 0.9, -0.8, 0.7])
    water = turned(eta).T @ [0.7, -0.4, 0.0]
    relative = nu - [*water, 0, 0, 0]
    relative_dot = nu_dot + np.array([*np.cross(nu[3:], water), 0, 0, 0])
    expected = still.residual(eta, relative, relative_dot)
    assert moved.residual(eta, nu, nu_dot) == pytest.approx(expected, rel=1e-10)
    assert np.abs(still.residual(eta, nu, nu_dot) - expected).max() > 1, "the current matters"


def test_a_rolling_ship_without_heave_feels_a_current_as_it_feels_its_own_way() -> None:
    hull = ("added_mass", "added_mass_coriolis", "linear_damping", "quadratic_damping", "lift")
    values = any_values(*hull) | {"V_N": 0.7, "V_E": -0.4}
    ship = ("surge", "sway", "roll", "yaw")
    still = Numbers(vehicle_with(values, *hull, dofs=ship))
    moved = Numbers(vehicle_with(values, *hull, "ocean_current", dofs=ship))
    eta, nu, nu_dot = (
        np.array([1.0, -2, 0.4, 0.9]),
        np.array([0.5, -0.3, 0.6, -0.2]),
        np.array([0.3, -0.4, 0.9, 0.7]),
    )
    water = turned(np.array([*eta[:2], 0, eta[2], 0, eta[3]])).T @ [0.7, -0.4, 0.0]
    over = np.cross([nu[2], 0.0, nu[3]], water)
    assert abs(water[2]) > 0.05, "a rolled hull has the current flowing along its mast"
    relative = nu - np.array([*water[:2], 0, 0])
    relative_dot = nu_dot + np.array([*over[:2], 0, 0])
    assert moved.residual(eta, nu, nu_dot) == pytest.approx(
        still.residual(eta, relative, relative_dot), rel=1e-10
    )


def test_place_and_heading_matter_to_those_alone_that_say_so() -> None:
    anywhere = [i for i in STILL if not _feels(i, "x y z psi")]
    assert {"restoring", "rigid_body_coriolis", "quadratic_damping"} <= set(anywhere)
    values = any_values(*anywhere) | BODY
    still = Numbers(vehicle_with(values, *anywhere))
    turned_by = START[:6] + np.array([4, -3, 2, 0, 0, 0.8])
    nu_dot = np.ones(6)
    assert still.residual(turned_by, START[6:], nu_dot) == pytest.approx(
        still.residual(START[:6], START[6:], nu_dot)
    )


def test_fewer_degrees_of_freedom_are_rows_of_six() -> None:
    values = any_values(*STILL) | BODY
    six = Numbers(vehicle_with(values, *STILL))
    three = Numbers(vehicle_with(values, *STILL, dofs=("surge", "sway", "yaw")))
    rows = [0, 1, 5]

    def spread(column: Array) -> Array:
        full = np.zeros(6)
        full[rows] = column
        return full

    columns = np.array([0.2, -0.4, 0.9]), np.array([1.0, -0.3, 0.5]), np.array([0.1, 0.2, -0.6])
    expected = six.residual(*map(spread, columns))[rows]
    assert three.residual(*columns) == pytest.approx(expected, rel=1e-12)


def test_the_residual_is_linear_in_its_linear_parameters() -> None:
    """Regressor times parameters gives the residual back, for the effects that carry parameters alone."""
    alone = [i for i in STILL if not catalogue()[i].requires and not catalogue()[i].shares]
    alone = [i for i in alone if all(p.linear for p in catalogue()[i]().parameters)]
    vehicle = vehicle_with(any_values(*alone) | BODY, *alone)
    theta = sm.Matrix([symbol(n) for n in vehicle.parameter_names])
    difference = (vehicle.residual.jacobian(theta) * theta - vehicle.residual).applyfunc(sm.expand)
    assert difference.is_zero_matrix


# --- forward and backward -----------------------------------------------------------------------------
def drag(values: Mapping[str, float], *ids: str) -> Callable[[float], float]:
    body = Numbers(vehicle_with({"m": 1.0} | dict(values), "rigid_body", *ids, dofs=("surge",)))
    return lambda u: float(body.forcing(np.zeros(1), np.array([u])))


def test_forward_and_backward_values_apply_by_the_sign_of_the_motion() -> None:
    force = drag({"X_u_forward": -2.0, "X_u_backward": -3.0}, "linear_damping")
    assert [force(0.5), force(-0.5), force(0.0)] == pytest.approx([-1.0, 1.5, 0.0])


def test_in_a_current_the_motion_through_the_water_decides() -> None:
    values = {"X_u_forward": -2.0, "X_u_backward": -3.0, "V_N": 1.0, "V_E": 0.0}
    force = drag(values, "linear_damping", "ocean_current")
    assert force(0.5) == pytest.approx(1.5), "ahead over ground, astern through the water"


def test_drag_asymmetry_is_the_same_as_two_values() -> None:
    two = drag(
        {"X_u_forward": -2.0, "X_u_backward": -2.7, "X_uabsu_forward": -5.0, "X_uabsu_backward": -4.6},
        *("linear_damping", "quadratic_damping"),
    )
    extra = {"X_u": -2.0, "X_u_back": -0.7, "X_uabsu": -5.0, "X_uabsu_back": 0.4}
    one = drag(extra, "linear_damping", "quadratic_damping", "drag_asymmetry")
    for u in (-1.3, -0.2, 0.0, 0.4, 2.0):
        assert one(u) == pytest.approx(two(u))


def test_damping_laws_at_one_speed() -> None:
    values = {"X_u": -2.0, "X_uabsu": -3.0, "X_uuu": -5.0, "X_signu": -0.7}
    cases = {"linear_damping": -4.0, "quadratic_damping": -12.0, "cubic_damping": -40.0, "dry_friction": -0.7}
    for effect_id, force in cases.items():
        assert drag(values, effect_id)(2.0) == pytest.approx(force)
        assert drag(values, effect_id)(-2.0) == pytest.approx(-force)


# --- statics ------------------------------------------------------------------------------------------
def test_arms_in_a_file_become_static_moments() -> None:
    entries = {"W": 100.0, "B": 110.0, "x_g": 0.1, "z_g": 0.05, "z_b": -0.02}
    converted = catalogue()["restoring"].from_file(entries)
    assert converted == pytest.approx({"W": 100.0, "B": 110.0, "S_x": 10.0, "S_z": 7.2})


def test_restoring_is_weight_and_buoyancy_at_their_places() -> None:
    weight, buoyancy, at_g, at_b = 100.0, 110.0, np.array([0.1, -0.2, 0.3]), np.array([-0.1, 0.05, -0.2])
    arms = {f"S_{a}": weight * g - buoyancy * b for a, g, b in zip("xyz", at_g, at_b, strict=True)}
    body = Numbers(vehicle_with(BODY | arms | {"W": weight, "B": buoyancy}, "rigid_body", "restoring"))
    down = turned(START[:6]).T @ [0, 0, 1]
    force = (weight - buoyancy) * down
    moment = np.cross(at_g, weight * down) - np.cross(at_b, buoyancy * down)
    found = body.forcing(START[:6], np.zeros(6))
    assert found == pytest.approx(np.concatenate([force, moment]))


def test_trim_offset_is_a_shift_of_the_centre_of_buoyancy() -> None:
    base = {"W": 100.0, "B": 110.0, "S_x": 1.0, "S_y": 2.0, "S_z": 3.0}
    shift = {"dx_B": 0.01, "dy_B": -0.02, "dz_B": 0.03}
    moved = base | {f"S_{a}": base[f"S_{a}"] - 110.0 * shift[f"d{a}_B"] for a in "xyz"}
    with_offset = Numbers(vehicle_with(BODY | base | shift, "rigid_body", "restoring", "trim_offset"))
    expected = Numbers(vehicle_with(BODY | moved, "rigid_body", "restoring"))
    still = np.zeros(6)
    assert with_offset.forcing(START[:6], still) == pytest.approx(expected.forcing(START[:6], still))


def test_net_buoyancy_is_restoring_without_arms() -> None:
    net = Numbers(vehicle_with(BODY | {"B_net": 10.0}, "rigid_body", "net_buoyancy"))
    full = Numbers(vehicle_with(BODY | {"W": 100.0, "B": 110.0}, "rigid_body", "restoring"))
    still = np.zeros(6)
    assert net.forcing(START[:6], still) == pytest.approx(full.forcing(START[:6], still))
    assert net.forcing(still, still) == pytest.approx([0, 0, -10.0, 0, 0, 0]), "upward is negative"


# --- from command to thrust, from motion to measurement -----------------------------------------------
def chain_at(vehicle: Vehicle, commands: list[float], values: Mapping[str, float]) -> list[float]:
    known = {symbol(n): v for n, v in values.items()}
    known |= {symbol(f"command_{t.name}"): c for t, c in zip(vehicle.thrusters, commands, strict=True)}
    return [float(x.subs(known)) for x in vehicle.composition.chain[0]]


def test_dead_band_and_gain_of_each_thruster() -> None:
    vehicle = vehicle_with(BODY, "rigid_body", "thruster_deadband", "thruster_gain", thrusters=2)
    values = {"gain_error_f1": -0.5, "gain_error_f2": 0.0, "deadband_width": 0.1}
    # The gain comes before the dead band: 0.5 * 0.4 - 0.1.
    assert chain_at(vehicle, [0.4, 0.4], values) == pytest.approx([0.1, 0.3])
    assert chain_at(vehicle, [0.1, -0.05], values) == pytest.approx([0.0, 0.0])
    assert chain_at(vehicle, [-0.4, -0.4], values) == pytest.approx([-0.1, -0.3])


def test_lag_follows_the_command_and_rests_on_it() -> None:
    vehicle = vehicle_with(BODY, "rigid_body", "thruster_gain", "thruster_lag", thrusters=1)
    output, rates, rest = vehicle.composition.chain
    state, command, gain = symbol("lagged_f1"), symbol("command_f1"), symbol("gain_error_f1")
    assert list(output) == [state]
    assert sm.expand(rates[state] * symbol("T_lag") - (command + command * gain - state)) == 0
    assert rates[state].subs(state, rest[state]).expand() == 0


def test_delays_add_up() -> None:
    vehicle = vehicle_with(BODY, "rigid_body", "actuation_delay", thrusters=1)
    assert vehicle.composition.dead_time == symbol("delay")
    assert "delay" in vehicle.parameter_names


def test_thrusters_push_by_their_wrench_times_thrust_per_command() -> None:
    body = Numbers(vehicle_with(BODY, "rigid_body", thrusters=2))
    found = body.forcing(np.zeros(6), np.zeros(6), np.zeros(6), np.array([3.0, -1.0]))
    # thrusts 1 N and 2 N per command, each along x with 0.2 m to the side
    assert found == pytest.approx([1.0, 0, 0, 0, 0, 0.2])


class _ThrustLoss(Actuation):
    """Thrust falls with the speed of advance."""

    id = "_thrust_loss"
    reference = "test"
    loss = PerThruster("1/(m/s)", "share lost per speed")

    def output(self, upstream: sm.Matrix, s: Signals) -> sm.Matrix:
        return upstream - s.nu_r[0] * upstream.multiply_elementwise(self.loss)


def test_an_actuation_step_that_feels_the_flow_is_stated_in_the_vehicles_own_motion() -> None:
    base = vehicle_with(BODY | {"V_N": 0.5}, "rigid_body", "ocean_current", dofs=("surge",), thrusters=1)
    vehicle = base.with_effect(_ThrustLoss, {"loss_f1": Value(0.2)})
    (output,) = vehicle.composition.chain[0]
    expected = symbol("command_f1") * (1 - symbol("loss_f1") * (symbol("u") - symbol("V_N")))
    assert sm.expand(output - expected) == 0


def test_lever_arm_is_the_velocity_of_the_sensors_place() -> None:
    vehicle = vehicle_with(BODY, "rigid_body", "velocity_lever_arm")
    arm = sm.Matrix([symbol(f"{a}_s") for a in "xyz"])
    c = vehicle.composition
    place = sm.Matrix(c.eta[:3]) + rotation(sm.Matrix(c.eta[3:])) * arm
    moving = place.jacobian(c.eta) * c.pose_rate
    pose, velocity = c.reported
    in_body = rotation(sm.Matrix(c.eta[3:])).T * moving
    point = dict(zip([*c.eta, *c.nu, *arm], [*START, 0.4, -0.3, 0.2], strict=True))
    difference = (sm.Matrix(velocity[:3]) - in_body).subs(point)
    assert max(abs(float(x)) for x in difference) < 1e-12
    assert pose == c.eta
    assert list(velocity[3:]) == list(c.nu[3:])


def test_fluid_memory_settles_at_speed_times_time_constant() -> None:
    values = {"X_memu": -4.0, "T_memory": 2.0, "m": 1.0, "X_udot": -20.0}
    vehicle = vehicle_with(values, "rigid_body", "added_mass", "radiation_memory", dofs=("surge",))
    ((state, rate),) = vehicle.composition.wrench_states.items()
    assert sm.solve(rate, state) == [symbol("T_memory") * symbol("u")]
    assert vehicle.residual.jacobian([state])[0] == symbol("X_memu")
    assert str(state) == "memory_u", "states of motions that the vehicle lacks are left out"


# --- sign conventions ---------------------------------------------------------------------------------
def as_file(signs: str) -> str:
    """A vehicle with every effect that has derivatives, written in one of the two conventions."""
    ids = ("rigid_body", "added_mass", "added_mass_coupling", "linear_damping", "linear_damping_coupling")
    ids += (
        "quadratic_damping",
        "cubic_damping",
        "lift",
        "drag_asymmetry",
        "dry_friction",
        "radiation_memory",
    )
    values = any_values(*ids) | BODY | {"friction_speed": 0.05, "friction_rate": 0.05}
    text = f'schema = "undertow/vehicle/1"\nname = "t"\nsigns = "{signs}"\n'
    text += f"degrees_of_freedom = {list(DOFS)}\n"
    for effect_id in ids:
        text += f"[effects.{effect_id}]\n"
        for p in catalogue()[effect_id]().parameters:
            printed = -values[p.name] if signs == "magnitudes" and p.on_left_side else values[p.name]
            text += f"{p.name} = {printed!r}\n".replace("np.float64(", "").replace(")", "")
    return text


def test_both_sign_conventions_mean_the_same_vehicle(tmp_path: Path) -> None:
    found = {}
    for signs in ("sname", "magnitudes"):
        (tmp_path / f"{signs}.toml").write_text(as_file(signs), encoding="utf-8")
        vehicle = load_vehicle(tmp_path / f"{signs}.toml")
        memory = {f"memory_{v}": 0.1 for v in "uvwpqr"}
        found[signs] = Numbers(vehicle, memory).residual(START[:6], START[6:], np.ones(6))
    assert found["sname"] == pytest.approx(found["magnitudes"], rel=1e-14)
    assert np.abs(found["sname"]).min() > 0.1


def test_magnitudes_in_a_file_are_sname_inside() -> None:
    vehicle = load_vehicle("mini-auv")
    derivatives = [n for n in vehicle.values if n.startswith(("X_u", "Y_v", "Z_w", "N_r"))]
    assert len(derivatives) == 14, "ahead and astern in surge and heave"
    assert all(vehicle.values[n].value < 0 for n in derivatives)
    text = bundled_vehicles()["mini-auv"].read_text(encoding="utf-8")
    assert '= "-' not in text.split("[effects.net_buoyancy]")[0], "magnitudes in the file"


# --- vehicles from vehicles ---------------------------------------------------------------------------
def test_an_effect_without_the_one_it_shares_with_is_refused() -> None:
    with pytest.raises(UndertowError, match="'added_mass_coriolis' shares parameters of 'added_mass'"):
        vehicle_with(BODY, "rigid_body", "added_mass_coriolis")


def test_with_effect_adds_and_completes() -> None:
    vehicle = vehicle_with({"m": 1.0}, "rigid_body", dofs=("surge", "sway"))
    cls = catalogue()["linear_damping"]
    once = vehicle.with_effect(cls, {"X_u": Value(-1.0)})
    twice = once.with_effect(cls, {"Y_v": Value(-2.0)})
    assert [e.id for e in twice.effects] == ["rigid_body", "linear_damping"]
    assert {n: v.value for n, v in twice.values.items()} == {"m": 1.0, "X_u": -1.0, "Y_v": -2.0}
    assert [e.id for e in vehicle.effects] == ["rigid_body"], "the first one is as it was"


def test_with_values_reaches_thrusters_and_parameters() -> None:
    vehicle = vehicle_with(BODY, "rigid_body", thrusters=2)
    changed = vehicle.with_values({"m": Value(3.0), "thrust_f2": Value(9.0)})
    assert changed.value_of("m").value == 3.0
    assert changed.value_of("thrust_f2").value == 9.0
    assert changed.thrusters[1].thrust_per_command.value == 9.0
    assert vehicle.value_of("thrust_f2").value == 2.0


def test_values_that_no_file_gives_come_from_default_and_environment() -> None:
    vehicle = vehicle_with(BODY, "rigid_body", "dry_friction")
    assert vehicle.value_of("friction_speed").value == 0.02
    assert vehicle.value_of("X_signu").value == 0.0
    assert vehicle.value_of("rho").value == 1000.0
