"""The paper's surge experiment, simulated with known truth: force profile P and its mirror."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from undertow.identification.logs import Run
from undertow.model.catalogue import catalogue
from undertow.model.loading import vehicle_from_table
from undertow.model.vehicle import Vehicle
from undertow.model.vehicle_schema import VehicleTable

Array = NDArray[np.float64]
MASS = 7.5
#: Table 4 of the paper, forward; magnitudes.
TRUTH = {"X_udot": 1.630825, "X_u": 0.142306, "X_uabsu": 5.153776}
#: m_x, X_u, X_u|u|.
EXACT = np.array([MASS + TRUTH["X_udot"], TRUTH["X_u"], TRUTH["X_uabsu"]])
JUMPS, LEVELS = (0.65, 18.45, 21.95), (0.0, 0.32, -0.48, 0.22)
DURATION, INTERVAL, STEP = 30.0, 0.2, 0.01
#: Noise of the velocity in shares of its rms, and of the acceleration, m/s^2.
NOISES, ACCELERATION_NOISE = (0.005, 0.02, 0.05, 0.10), 0.025


def vehicle() -> Vehicle:
    """The surge model with poor guesses, in the paper's sign convention."""
    guesses = {
        "added_mass": ("X_udot", 1.0),
        "linear_damping": ("X_u", 0.3),
        "quadratic_damping": ("X_uabsu", 4.0),
    }
    effects: dict[str, object] = {"rigid_body": {"m": MASS}}
    effects |= {e: {n: {"value": v, "estimate": True}} for e, (n, v) in guesses.items()}
    table = {
        "schema": "undertow/vehicle/1",
        "name": "surge",
        "degrees_of_freedom": ["surge"],
        "signs": "magnitudes",
        "generalised_forces": ["tau_X"],
        "effects": effects,
    }
    return vehicle_from_table(VehicleTable.model_validate(table), catalogue())


def force(t: Array) -> Array:
    """Force at t, N; a jump belongs to the level before it."""
    return np.select([t <= jump for jump in JUMPS], LEVELS[:-1], LEVELS[-1])


def mean_force(t: Array) -> Array:
    """Mean force from each sample to the next, N."""
    edges = np.array([0.0, *JUMPS, 10 * DURATION])
    impulse = np.concatenate([[0.0], np.cumsum(np.diff(edges) * np.array(LEVELS))])
    total = np.interp(np.append(t, t[-1] + INTERVAL), edges, impulse)
    return np.diff(total) / INTERVAL


def _drag(u: Array) -> Array:
    return EXACT[1] * u + EXACT[2] * np.abs(u) * u


def motion() -> tuple[Array, Array, Array]:
    """Time, velocity and acceleration without noise at t = 0.2 s ... 30 s."""
    grid = np.arange(round(DURATION / STEP) + 1) * STEP
    u = np.zeros(1)
    path = [u]
    for push in force(grid[:-1] + STEP / 2):
        k1 = (push - _drag(u)) / EXACT[0]
        k2 = (push - _drag(u + STEP / 2 * k1)) / EXACT[0]
        k3 = (push - _drag(u + STEP / 2 * k2)) / EXACT[0]
        k4 = (push - _drag(u + STEP * k3)) / EXACT[0]
        u = u + STEP / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        path.append(u)
    every = round(INTERVAL / STEP)
    places = np.arange(every, len(grid), every)
    t, clean = grid[places], np.concatenate(path)[places]
    return t, clean, (force(t) - _drag(clean)) / EXACT[0]


def logs(noise: float, seed: int, mirrored: bool) -> tuple[Run, Run]:
    """One draw as the paper's chain logs it (force at the sample, acceleration), and with the held force.

    Parameters
    ----------
    noise : float
        Standard deviation of the velocity noise over the rms of the velocity.
    seed : int
        Of the noise.
    mirrored : bool
        Whether all goes backward.
    """
    t, u, u_dot = motion()
    rng = np.random.default_rng([seed, round(1e4 * noise)])
    sigma = noise * float(np.sqrt(np.mean(u**2)))
    sign = -1.0 if mirrored else 1.0
    speed = sign * u + sigma * rng.standard_normal(len(t))
    rate = sign * u_dot + ACCELERATION_NOISE * rng.standard_normal(len(t))
    sampled = Run("P", t, {"u": speed, "u_dot": rate, "tau_X": sign * force(t)})
    return sampled, Run("P", t, {"u": speed, "tau_X": sign * mean_force(t)})
