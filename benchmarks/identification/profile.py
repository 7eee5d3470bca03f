"""The paper's surge experiment, simulated with known truth: force profile P and its mirror."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from undertow.identification.logs.run import Run
from undertow.model.catalogue import catalogue
from undertow.model.loading import VehicleTable, vehicle_from_table
from undertow.model.vehicle import Vehicle

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


def held_force(t: Array) -> Array:
    """Force from each sample to the next, N, where every jump has a sample."""
    return force(t + STEP / 2)


def _drag(u: Array) -> Array:
    return EXACT[1] * u + EXACT[2] * np.abs(u) * u


@cache
def _path() -> Array:
    """Velocity without noise every 0.01 s from rest, by the classical Runge-Kutta method."""
    grid = STEP * np.arange(round(DURATION / STEP) + 1, dtype=float)
    u = np.zeros(1)
    path = [u]
    for push in force(grid[:-1] + STEP / 2):
        k1 = (push - _drag(u)) / EXACT[0]
        k2 = (push - _drag(u + STEP / 2 * k1)) / EXACT[0]
        k3 = (push - _drag(u + STEP / 2 * k2)) / EXACT[0]
        k4 = (push - _drag(u + STEP * k3)) / EXACT[0]
        u = u + STEP / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        path.append(u)
    return np.concatenate(path)


def times(with_jumps: bool) -> Array:
    """t = 0.2 s ... 30 s, with a sample at every jump of the force or without."""
    grid = INTERVAL * np.arange(1.0, round(DURATION / INTERVAL) + 1)
    return np.union1d(np.round(grid, 6), JUMPS) if with_jumps else np.round(grid, 6)


def velocity(t: Array) -> Array:
    """Velocity without noise, m/s."""
    return _path()[np.round(t / STEP).astype(int)]


def logs(noise: float, seed: int, mirrored: bool) -> tuple[Run, Run]:
    """One draw as the paper's chain logs it (force at the sample, acceleration), and with the held force
    and a sample at each of its jumps.

    Parameters
    ----------
    noise : float
        Standard deviation of the velocity noise over the rms of the velocity.
    seed : int
        Of the noise.
    mirrored : bool
        Whether all goes backward.
    """
    rng = np.random.default_rng([seed, round(1e4 * noise)])
    sign = -1.0 if mirrored else 1.0
    t, every = times(False), times(True)
    u, sigma = velocity(t), spread(noise)
    rate = (force(t) - _drag(u)) / EXACT[0] + ACCELERATION_NOISE * (noise > 0) * rng.standard_normal(len(t))
    reading = velocity(every) + sigma * rng.standard_normal(len(every))
    sampled = {"u": reading[np.isin(every, t)], "u_dot": rate, "tau_X": force(t)}
    held = {"u": reading, "tau_X": held_force(every)}
    return tuple(  # type: ignore[return-value]
        Run("P", at, {n: sign * c for n, c in channels.items()})
        for at, channels in ((t, sampled), (every, held))
    )


def spread(noise: float) -> float:
    """Standard deviation of the velocity noise, m/s, for a share of the rms of the velocity."""
    return noise * float(np.sqrt(np.mean(velocity(times(False)) ** 2)))
