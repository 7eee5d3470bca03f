"""The paper's surge experiment, simulated in plain NumPy: m_x u' = X - X_u u - X_uu |u| u."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.identification.profile import INTERVAL, MASS, TRUTH
from benchmarks.identification.profile import vehicle as surge_vehicle
from undertow.identification.logs.pose_velocity import velocities_from_pose
from undertow.identification.logs.run import Run
from undertow.model.vehicle import Vehicle

__all__ = [
    "INTERVAL",
    "MASS",
    "M_X",
    "TRUTH",
    "surge_from_positions",
    "surge_run",
    "surge_vehicle",
    "true_surge",
]

M_X = MASS + TRUTH["X_udot"]


def true_surge() -> Vehicle:
    """The surge model with the true values of its parameters."""
    vehicle = surge_vehicle()
    return vehicle.with_values({n: replace(vehicle.value_of(n), value=-v) for n, v in TRUTH.items()})


def surge_run(noise: float = 0.0, seed: int = 0) -> Run:
    """Profile P, 30 s: velocity with noise in shares of its rms; the force is logged as its interval mean."""
    t = np.arange(0.0, 30.0 + 1e-9, INTERVAL)
    force = _mean_force(t)
    u = np.zeros(len(t))
    for i in range(len(t) - 1):
        u[i + 1] = _advanced(u[i], force[i])
    sigma = noise * float(np.sqrt(np.mean(u**2)))
    error = sigma * np.random.default_rng(seed).standard_normal(len(t))
    return Run("P", t, {"u": u + error, "tau_X": force}, sha256=f"{seed}")


def surge_from_positions() -> Run:
    """The run without noise in its velocity, which is now taken from a position with noise of 1 mm."""
    clean = surge_run()
    x = np.concatenate([[0.0], np.cumsum(0.1 * (clean.channels["u"][1:] + clean.channels["u"][:-1]))])
    noisy = x + 1e-3 * np.random.default_rng(2).standard_normal(len(x))
    run = replace(clean, channels={"x": noisy, "tau_X": clean.channels["tau_X"]})
    return velocities_from_pose(run, ["surge"])


def _mean_force(t: np.ndarray) -> np.ndarray:
    """Mean over [t_i, t_i+1) of X = 0.32, -0.48, 0.22 N from 0.65, 18.45, 21.95 s."""

    def impulse(time: np.ndarray) -> np.ndarray:
        steps = ((0.65, 0.32), (18.45, -0.80), (21.95, 0.70))
        return sum((jump * np.maximum(time - at, 0.0) for at, jump in steps), np.zeros_like(time))

    return np.asarray((impulse(t + INTERVAL) - impulse(t)) / INTERVAL)


def _advanced(u: float, force: float, steps: int = 20) -> float:
    h = INTERVAL / steps

    def rate(x: float) -> float:
        return (force - TRUTH["X_u"] * x - TRUTH["X_uabsu"] * abs(x) * x) / M_X

    for _ in range(steps):
        k1 = rate(u)
        k2 = rate(u + h / 2 * k1)
        k3 = rate(u + h / 2 * k2)
        k4 = rate(u + h * k3)
        u += h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return u
