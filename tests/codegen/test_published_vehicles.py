"""Bundled vehicles against what their sources publish: equations of motion, steady speeds, turns, glides."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from undertow.codegen import Functions, Simulator
from undertow.model.loading import bundled_vehicles, load_vehicle

Array = NDArray[np.float64]
KNOT = 1852 / 3600


@cache
def functions_of(name: str) -> Functions:
    return Functions(load_vehicle(name))


def acceleration(name: str, nu: Array, commands: Mapping[str, float]) -> Array:
    """Rates of the velocities of a vehicle, level at the origin."""
    functions = functions_of(name)
    vehicle = functions.vehicle
    n = len(vehicle.degrees_of_freedom)
    x = np.zeros(len(functions.state_names))
    x[n : 2 * n] = nu
    u = [commands.get(c, 0.0) for c in vehicle.command_names]
    rates = np.array(functions.dynamics(x, u, functions.values(), 0.0)).ravel()
    return np.asarray(rates[n : 2 * n])


def manoeuvre(
    name: str, commands: Mapping[str, float], seconds: float, step: float = 0.1, **first: float
) -> dict[str, Array]:
    """Time histories of a vehicle with held commands."""
    functions = functions_of(name)
    x0 = np.array([first.get(n, 0.0) for n in functions.state_names])
    t = np.arange(0.0, seconds + step / 2, step)
    u = np.tile([commands.get(c, 0.0) for c in functions.vehicle.command_names], (len(t), 1))
    x = Simulator(functions, compiled=False).run(x0, t, u, np.array(functions.values()), max_step=step)
    return {"t": t} | dict(zip(functions.state_names, x.T, strict=True))


# --- REMUS 100 ------------------------------------------------------------------------------------
def prestero(nu: Array, delta_s: float, delta_r: float, thrust: float) -> Array:
    """Equations of motion of Prestero (2001), level; Y_vv and the surplus of buoyancy as in our file."""
    u, v, w, p, q, r = nu
    m, zg, surplus = 30.48, 0.0196, 0.75 * 4.4482
    ixx, iyy, izz = 0.177, 3.45, 3.45
    x = -1.62 * u * abs(u) + (-35.5 - m) * w * q + (-1.93) * q**2 + (35.5 + m) * v * r - 1.93 * r**2
    x += -m * zg * p * r + thrust
    y = -131 * v * abs(v) + 0.632 * r * abs(r) - 28.6 * u * v + (35.5 + m) * w * p + (5.22 - m) * u * r
    y += -m * zg * q * r + 1.93 * p * q + 9.64 * u**2 * delta_r
    z = -surplus - 131 * w * abs(w) - 0.632 * q * abs(q) - 28.6 * u * w + (-5.22 + m) * u * q
    z += (-35.5 - m) * v * p + m * zg * (p**2 + q**2) + 1.93 * r * p - 9.64 * u**2 * delta_s
    k = -0.13 * p * abs(p) - (izz - iyy) * q * r + m * zg * (u * r - w * p) - 0.141 * thrust
    mm = 3.18 * w * abs(w) - 188 * q * abs(q) + (4.81 - (ixx - izz)) * r * p + m * zg * (v * r - w * q)
    mm += -2.0 * u * q + 24.0 * u * w - 1.93 * v * p - 6.15 * u**2 * delta_s
    n = -3.18 * v * abs(v) - 94 * r * abs(r) - 24.0 * u * v + (-4.81 - (iyy - ixx)) * p * q
    n += -1.93 * w * p - 2.0 * u * r - 6.15 * u**2 * delta_r
    mass = np.diag([m + 0.93, m + 35.5, m + 35.5, ixx + 0.0704, iyy + 4.88, izz + 4.88])
    mass[0, 4] = mass[4, 0] = m * zg
    mass[1, 3] = mass[3, 1] = -m * zg
    mass[1, 5] = mass[5, 1] = -1.93
    mass[2, 4] = mass[4, 2] = 1.93
    return np.linalg.solve(mass, [x, y, z, k, mm, n])


@pytest.mark.parametrize("seed", range(3))
def test_remus_moves_by_the_equations_of_its_source(seed: int) -> None:
    """Every term of the thesis, those that follow from the added mass here included."""
    draw = np.random.default_rng(seed)
    nu = np.array([1.5, *draw.uniform(-0.3, 0.3, 2), *draw.uniform(-0.4, 0.4, 3)])
    fins = {"stern_plane": 0.1, "rudder": -0.08, "propeller": 3.86}
    found = acceleration("remus100", nu, fins)
    assert found == pytest.approx(prestero(nu, 0.1, -0.08, 3.86), rel=2e-3, abs=2e-3)


def test_remus_makes_three_knots_at_the_thrust_of_1500_rpm() -> None:
    """Prestero: 3.86 N at 1500 rpm, 1.54 m/s (3 knots)."""
    found = manoeuvre("remus100", {"propeller": 3.86, "stern_plane": 0.0}, 1.0, u=1.54)
    rate = acceleration("remus100", np.array([1.54, 0, 0, 0, 0, 0]), {"propeller": 3.86})
    assert abs(rate[0]) < 1e-3
    assert found["u"][-1] == pytest.approx(3 * KNOT, rel=0.01)


def test_remus_turns_and_dives_by_its_fins() -> None:
    turn = manoeuvre("remus100", {"propeller": 3.86, "rudder": np.radians(-4)}, 20.0, u=1.54)
    dive = manoeuvre("remus100", {"propeller": 3.86, "stern_plane": np.radians(4)}, 20.0, u=1.54)
    assert turn["psi"][-1] > 0.5
    assert dive["z"][-1] > 2.0, "deeper than it floats up by its surplus"


# --- Otter ----------------------------------------------------------------------------------------
def otter(nu: Array, port: float, starboard: float) -> Array:
    """The equations of otter.m (MSS) in surge, sway and yaw, without payload; strips summed finely."""
    u, v, r = nu
    m, x_g, inertia = 55.0, 0.2, 55 * 0.25 * 2.0 * 0.25 * 2.0
    a11, a22, a66 = 2.7 * 1025 * (m / 1025) ** (5 / 3) / 2.0**2, 1.5 * m, 1.7 * inertia
    i_z = inertia + m * x_g**2
    mass = np.array([[m + a11, 0, 0], [0, m + a22, m * x_g], [0, m * x_g, i_z + a66]])
    turning = [m * r * (v + x_g * r) + a22 * v * r, -m * u * r - a11 * u * r]
    turning += [-m * x_g * u * r - (a22 - a11) * u * v]
    damping = [-24.4 * 9.81 / (6 * 0.5144) * u, -(m + a22) * v, -(i_z + a66) * (1 + 10 * abs(r)) * r]
    x = np.linspace(-1, 1, 2001)
    strips = -1025 / 2 * 0.847 * 0.1341 * np.abs(v + x * r) * (v + x * r)
    across = [0.0, np.trapezoid(strips, x), np.trapezoid(x * strips, x)]
    thrust = [port + starboard, 0.0, 0.395 * (port - starboard)]
    return np.linalg.solve(mass, np.sum([turning, damping, across, thrust], axis=0))


@pytest.mark.parametrize("nu", [(1.2, 0.3, -0.4), (0.5, -0.2, 0.3), (-0.4, 0.1, 0.6)])
def test_otter_moves_by_the_equations_of_its_source(nu: tuple[float, float, float]) -> None:
    found = acceleration("otter", np.array(nu), {"port": 60.0, "starboard": 20.0})
    assert found == pytest.approx(otter(np.array(nu), 60.0, 20.0), rel=5e-3, abs=2e-3)


def test_otter_makes_six_knots_at_full_thrust() -> None:
    full = manoeuvre("otter", {"port": 119.7, "starboard": 119.7}, 30.0)
    assert full["u"][-1] == pytest.approx(6 * KNOT, rel=0.01)


# --- glider ---------------------------------------------------------------------------------------
def test_glider_comes_to_the_glide_of_its_source() -> None:
    """Graver: 25 degrees down at 0.3 m/s with 47 g of surplus weight, at an angle of attack of 2 degrees."""
    dive = manoeuvre("glider", {}, 400.0, 0.2, u=0.1)
    u, w, theta = (dive[n][-1] for n in ("u", "w", "theta"))
    attack = np.degrees(np.arctan2(w, u))
    assert np.hypot(u, w) == pytest.approx(0.3, rel=0.02)
    assert np.degrees(theta) - attack == pytest.approx(-25, abs=0.5)
    assert attack == pytest.approx(2.02, abs=0.1)
    assert abs(dive["u"][-1] - dive["u"][-50]) < 1e-4, "steady by then"


# --- BlueROV2 -------------------------------------------------------------------------------------
def test_bluerov2_with_six_thrusters_cannot_pitch_and_has_the_speed_of_its_drag() -> None:
    """40 N ahead, the limit of programs that use this set, against 0.09 u + 34.96 u^2; it floats up."""
    level = 40.0 / (4 * np.sqrt(0.5))
    ahead = {"f1": level, "f2": level, "f3": -level, "f4": -level}
    run = manoeuvre("bluerov2-6", ahead, 20.0)
    assert run["u"][-1] == pytest.approx(np.roots([34.96, 0.09, -40.0]).max(), rel=0.05)
    rows = np.array(functions_of("bluerov2-6").vehicle.allocation.tolist(), dtype=float)
    assert np.linalg.matrix_rank(rows[[0, 1, 2, 3, 5]]) == 5
    assert np.linalg.matrix_rank(rows) == 5, "pitch comes with surge, as the level thrusters stand low"


# --- CyberShip II ---------------------------------------------------------------------------------
def cybership(nu: Array) -> Array:
    """Sway and yaw rates of Skjetne, Smogeli and Fossen (2004) without thrust, all of their damping."""
    u, v, r = nu
    m, x_g, i_z, a11, a22, a66 = 23.8, 0.046, 1.76, 2.0, 10.0, 1.0
    mass = np.array([[m + a22, m * x_g], [m * x_g, i_z + a66]])
    turning = [-(m + a11) * u * r, (a11 - a22) * u * v - m * x_g * u * r]
    d22 = 0.88965 + 36.47287 * abs(v) + 0.805 * abs(r)
    d23 = 7.250 + 0.845 * abs(v) + 3.450 * abs(r)
    d32 = -0.03130 - 3.95645 * abs(v) - 0.130 * abs(r)
    d33 = 1.900 - 0.080 * abs(v) + 0.750 * abs(r)
    damping = [-d22 * v - d23 * r, -d32 * v - d33 * r]
    return np.linalg.solve(mass, np.add(turning, damping))


def test_cybership_with_the_table_of_its_comment_is_the_whole_published_model(tmp_path: Path) -> None:
    text = bundled_vehicles()["cybership2"].read_text(encoding="utf-8")
    table = [line[4:] for line in text.splitlines() if line.startswith(("#   [", "#   Y_", "#   N_"))]
    whole = tmp_path / "cybership2.toml"
    whole.write_text("\n".join([text, *table]) + "\n", encoding="utf-8")
    for nu in ([0.4, 0.1, -0.2], [0.3, -0.2, 0.1]):
        found = acceleration(str(whole), np.array(nu), {})
        assert found[1:] == pytest.approx(cybership(np.array(nu)), rel=1e-9)


# --- KVLCC2 ---------------------------------------------------------------------------------------
LENGTH, HULL = 7.0, 500 * 7.0 * 0.455  # m, and rho/2 L d in kg/m
PASSING, DIAMETER, REVOLUTIONS = 0.6, 0.216, 11.8  # 1 - w_P0; m; 1/s, which keep 1.18 m/s


def thrust_of(u: Array) -> Array:
    """Thrust of the propeller of KVLCC2 at constant revolutions, N."""
    advance = PASSING * u / (REVOLUTIONS * DIAMETER)
    k_t = 0.2931 - 0.2753 * advance - 0.1385 * advance**2
    return np.asarray(1000 * REVOLUTIONS**2 * DIAMETER**4 * k_t)


def mmg(state: Array, delta: float, straightening: tuple[float, float] = (0.395, 0.640)) -> Array:
    """Equations of the MMG standard method (Yasukawa and Yoshimura 2015) with the numbers of KVLCC2."""
    u, v, r, psi = state[:4]
    speed = np.hypot(u, v)
    vp, rp = v / speed, r * LENGTH / speed
    thrust = float(thrust_of(u))
    ahead = PASSING * u
    jet = np.sqrt(ahead**2 + 8 * thrust / (1000 * np.pi * DIAMETER**2)) - ahead
    flow = 1.09 * np.sqrt(0.626 * (ahead + 0.5 * jet) ** 2 + 0.374 * ahead**2)
    inflow = np.arctan2(-v, u) + 0.710 * rp
    across = speed * straightening[int(inflow > 0)] * inflow
    normal = 500 * 0.0539 * 2.747 * (flow**2 + across**2) * np.sin(delta - np.arctan2(across, flow))
    surge = -0.022 - 0.040 * vp**2 + 0.002 * vp * rp + 0.011 * rp**2 + 0.771 * vp**4
    sway = -0.315 * vp + 0.083 * rp - 1.607 * vp**3 + 0.379 * vp**2 * rp - 0.391 * vp * rp**2 + 0.008 * rp**3
    yaw = -0.137 * vp - 0.049 * rp - 0.030 * vp**3 - 0.294 * vp**2 * rp + 0.055 * vp * rp**2 - 0.013 * rp**3
    x = HULL * speed**2 * surge - (1 - 0.387) * normal * np.sin(delta) + 0.78 * thrust
    y = HULL * speed**2 * sway - 1.312 * normal * np.cos(delta)
    n = HULL * LENGTH * speed**2 * yaw + (3.5 + 0.312 * 3.248) * normal * np.cos(delta)
    m, x_g = 3270.0, 0.25
    m_x, m_y, j_z = 0.022 * HULL * LENGTH, 0.223 * HULL * LENGTH, 0.011 * HULL * LENGTH**3
    inertia = m * (0.25 * LENGTH) ** 2 + m * x_g**2 + j_z
    mass = np.array([[m + m_y, x_g * m], [x_g * m, inertia]])
    v_dot, r_dot = np.linalg.solve(mass, [y - (m + m_x) * u * r, n - x_g * m * u * r])
    u_dot = (x + (m + m_y) * v * r + x_g * m * r**2) / (m + m_x)
    c, s = np.cos(psi), np.sin(psi)
    return np.array([u_dot, v_dot, r_dot, r, u * c - v * s, u * s + v * c])


def turn(x: Array, y: Array, psi: Array) -> tuple[float, float]:
    """Advance and tactical diameter of a turning circle, over the length."""
    quarter, half = (np.argmax(np.abs(psi) >= angle) for angle in (np.pi / 2, np.pi))
    return float(x[quarter]) / LENGTH, abs(float(y[half])) / LENGTH


@pytest.mark.parametrize("side", [1, -1])
def test_kvlcc2_turns_as_the_mmg_standard_method_says(side: int) -> None:
    """Rudder at 35 degrees: advance and tactical diameter, and the speed that is left."""
    delta, step, steps = side * np.radians(35), 0.1, 1500
    published = [np.array([1.18, 0, 0, 0, 0, 0])]
    for _ in range(steps):
        state = published[-1]
        middle = state + step / 2 * mmg(state, delta)
        published.append(state + step * mmg(middle, delta))
    u, _, r, psi, x, y = np.array(published).T
    found = manoeuvre("kvlcc2", {"propeller": REVOLUTIONS, "rudder": delta}, steps * step, step, u=1.18)
    assert turn(found["x"], found["y"], found["psi"]) == pytest.approx(turn(x, y, psi), rel=0.06)
    assert found["u"][-1] == pytest.approx(u[-1], rel=0.1)
    assert found["r"][-1] == pytest.approx(r[-1], rel=0.1)
    # What IMO asks of a ship (MSC.137(76)): advance below 4.5 and tactical diameter below 5 lengths.
    assert turn(found["x"], found["y"], found["psi"]) < (4.5, 5.0)
