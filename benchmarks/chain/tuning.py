"""PID gains for surge by loop shaping on whatever the model says."""

from __future__ import annotations

from math import atan, degrees, hypot, radians, tan

from undertow.control.linear.numeric import in_direction
from undertow.control.plant import Plant
from undertow.model.vehicle import Vehicle

CROSSOVER = 0.1
"""Where the loop gain is to be one, rad/s."""
PHASE_MARGIN = 50.0
"""Degrees."""
INERTIA_LAG = 20.0
"""Most phase that inertia may cost at the crossover, degrees: what damping is needed for."""
LEAST = 0.005
"""The least gain on the velocity, N s/m: its sensor is noisy, so the law uses no more than it has to."""


def surge_of(vehicle: Vehicle) -> tuple[float, float]:
    """Inertia, kg, and damping at rest, kg/s, forward."""
    plant = Plant(in_direction(vehicle, {"u": 1, "w": 1}))
    at_rest = {**dict.fromkeys(plant.nu, 0), **plant.numbers}
    return float(plant.M[0, 0].xreplace(at_rest)), float(plant.D[0, 0].xreplace(at_rest))


def tuned(mass: float, damping: float) -> tuple[float, float, float]:
    """K_P, K_V and K_I of surge for the crossover and the phase margin.

    The loop is (K_P s + K_I) / (s^2 (M s + D + K_V)). Damping that the model does not have comes from K_V.
    """
    needed = mass * CROSSOVER / tan(radians(INERTIA_LAG))
    k_v = max(LEAST, needed - damping)
    lag = degrees(atan(mass * CROSSOVER / (damping + k_v)))
    ratio = CROSSOVER / tan(radians(PHASE_MARGIN + lag))
    size = CROSSOVER**2 * hypot(mass * CROSSOVER, damping + k_v)
    k_p = size / hypot(CROSSOVER, ratio)
    return k_p, k_v, k_p * ratio


def gain_file(vehicle: Vehicle) -> str:
    """A gain file with surge tuned on a model of the vehicle; heave and yaw are given."""
    k_p, k_v, k_i = tuned(*surge_of(vehicle))
    gains = {
        "K_P": (k_p, 3.0, 0.4, "N/m", "N m/rad"),
        "K_V": (k_v, 6.0, 0.5, "N s/m", "N m s/rad"),
        "K_I": (k_i, 0.05, 0.02, "N/(m s)", "N m/(rad s)"),
    }
    rows = [
        f'{name} = {{ x = "{x:.4g} {f}", y = "{x:.4g} {f}", z = "{z:g} {f}", psi = "{psi:g} {m}" }}'
        for name, (x, z, psi, f, m) in gains.items()
    ]
    head = ['schema = "undertow/gains/1"', 'name = "tuned"', 'law = "pid"']
    return "\n".join([*head, "", "[gains]", *rows, ""])
