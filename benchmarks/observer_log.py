"""Logs for observers: a mini-AUV that white noise drives, seen by sensors with rates of their own."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from undertow.codegen.compiler import Evaluator
from undertow.codegen.functions import Functions
from undertow.codegen.simulate import runge_kutta
from undertow.identification.logs.run import Run
from undertow.model.catalogue import catalogue
from undertow.model.loading import load_vehicle
from undertow.model.vehicle import Value, Vehicle

STEP, PER_ROW = 0.02, 5
DRIVE = {"u": 0.02, "v": 0.02, "w": 0.02, "r": 0.02}
NOISE = {"x": 0.05, "y": 0.05, "z": 0.02, "psi": 0.01, "u": 0.01, "v": 0.01, "w": 0.01, "r": 0.005}
CURRENT, BIAS = {"V_N": 0.12, "V_E": -0.08}, {"b_r": 0.03}


def auv(**values: float) -> Vehicle:
    """The mini-AUV, with the current, bias or delay that values state."""
    vehicle = load_vehicle("mini-auv")
    ids = {"V": "ocean_current", "b": "sensor_bias", "v": "sensor_delay"}
    for name, value in values.items():
        vehicle = vehicle.with_effect(catalogue()[ids[name[0]]], {name: Value(value)})
    return vehicle


def commands(t: np.ndarray, seed: int) -> np.ndarray:
    """Steps of the thrusters, shape (n, 4)."""
    levels = np.random.default_rng(1000 + seed).uniform(-1, 1, (int(t[-1] / 4) + 2, 4)) * [1, 0.5, 1, 0.5]
    return levels[(t / 4).astype(int)] + [-7.15, 0.3, -7.15, 0.3]


def motion(vehicle: Vehicle, seconds: float, seed: int, drive: Mapping[str, float] = DRIVE) -> tuple:
    """Times, states and commands at the rows; white noise on the accelerations in every small step."""
    f, rng = Functions(vehicle), np.random.default_rng(seed)
    p, names = np.array(f.values()), list(f.state_names)
    size = np.array([drive.get(n, 0.0) for n in names])
    t = STEP * PER_ROW * np.arange(round(seconds / STEP / PER_ROW) + 1)
    u, x = commands(t, seed), np.zeros((len(t), len(names)))
    now, dynamics = x[0], Evaluator(f.dynamics)
    for k in range(len(t) - 1):
        for _ in range(PER_ROW):
            rates = lambda z, reach, u=u[k]: [dynamics(z[0], u, p, 0.0)[0][:, 0]]  # noqa: E731
            now = runge_kutta(rates, [now], [STEP])[0]
            now = now + size * np.sqrt(STEP) * rng.standard_normal(len(names))
        x[k + 1] = now
    return t, x, u, names


def log(vehicle: Vehicle, seconds: float, seed: int, every: Mapping[str, int], late: float = 0.0) -> tuple:
    """A run in which channels report every so many rows, u, v and w late, and the true states at its rows."""
    t, x, u, names = motion(vehicle, seconds, seed)
    rng, n = np.random.default_rng(500 + seed), len(t)
    channels, reported = {}, {}
    bias = vehicle.values["b_r"].value if "b_r" in vehicle.values else 0.0
    for name, rows in every.items():
        true = x[:, names.index(name)] + (bias if name == "r" else 0.0)
        if name in "uvw" and late:
            true = np.interp(t - late, t, true)
        channels[name] = true + NOISE[name] * rng.standard_normal(n)
        if rows > 1:
            reported[name] = np.arange(n) % rows == 0
    channels |= {c: u[:, i] for i, c in enumerate(vehicle.command_names)}
    run = Run(f"seed {seed}", t, channels, reported=reported, sigma={c: NOISE[c] for c in every})
    return run, x, names
