"""What the vehicle is told to do: demands as shares (-1..1) of its reach, or heading and depth hold."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .drawing import Vehicle
from .plant import RATE

Demand = np.ndarray  # (n, 6), each in -1..1


def _held(
    n: int, rng: np.random.Generator, shortest: float, longest: float, level: Callable[[], float]
) -> np.ndarray:
    """(n,) levels, each held for a random time between `shortest` and `longest` seconds."""
    out, start = np.empty(n), 0
    while start < n:
        stop = start + int(RATE * rng.uniform(shortest, longest))
        out[start:stop], start = level(), stop
    return out


def random_steps(n: int, rng: np.random.Generator) -> Demand:
    """Independent steps of every motion, held 2 to 8 s; one in five is zero."""

    def level() -> float:
        return float(rng.uniform(-1, 1) * (rng.random() > 0.2))

    return np.column_stack([_held(n, rng, 2.0, 8.0, level) for _ in range(6)])


def cruise(n: int, rng: np.random.Generator) -> Demand:
    """Steady thrust ahead that changes every 15 to 30 s, turns of 4 to 10 s, other demands small."""

    def turn() -> float:
        return float(rng.uniform(-0.8, 0.8) * (rng.random() > 0.4))

    small = [_held(n, rng, 8.0, 20.0, lambda: float(rng.uniform(-0.3, 0.3))) for _ in range(4)]
    ahead = _held(n, rng, 15.0, 30.0, lambda: float(rng.uniform(0.3, 0.9)))
    return np.column_stack([ahead, *small, _held(n, rng, 4.0, 10.0, turn)])


def multisine(n: int, rng: np.random.Generator) -> Demand:
    """Six sines per motion between 0.02 and 0.5 Hz, random phases, clipped at the reach."""
    t = np.arange(n)[:, None, None] / RATE
    frequency = np.exp(rng.uniform(np.log(0.02), np.log(0.5), (6, 6)))
    waves = np.sin(2 * np.pi * (frequency * t + rng.uniform(0, 1, (6, 6))))
    return np.clip(0.26 * waves.sum(axis=1), -1.0, 1.0)


#: Name of a run -> how its demands are made. The held-out run differs from the steps by its seed only.
MANOEUVRES: dict[str, Callable[[int, np.random.Generator], Demand]] = {
    "steps": random_steps, "cruise": cruise, "multisine": multisine, "holdout": random_steps,
}  # fmt: skip


def to_commands(vehicle: Vehicle, demand: np.ndarray) -> np.ndarray:
    """(..., 6) demands as (..., thrusters) commands in N, within the limit, rounded to four decimals."""
    commands = (demand * vehicle.reach) @ vehicle.mixer.T
    return np.round(np.clip(commands, -vehicle.command_limit, vehicle.command_limit), 4)


@dataclass(frozen=True)
class Hold:
    """PD heading and depth hold on the measured state; the demands of yaw and heave become set-points.

    Heading follows psi_0 + 2 rad x demand, depth z_0 + 2 m x demand; the other demands stay open-loop. A
    vehicle that has neither heading nor depth holds its speed instead: 1.5 times the typical one x demand.
    """

    vehicle: Vehicle
    demand: np.ndarray
    heading: np.ndarray

    def __call__(self, sample: int, reading: np.ndarray) -> np.ndarray:
        """Commands (n, R) at this sample from the readings (12, R)."""
        demand = self.demand[:, sample].copy()
        error = self.heading + 2.0 * demand[:, 5] - reading[5]
        demand[:, 5] = np.clip(1.5 * np.sin(error / 2) - 0.6 * reading[11] / self.vehicle.pace[5], -1, 1)
        low = self.vehicle.depth + 2.0 * demand[:, 2] - reading[2]
        demand[:, 2] = np.clip(0.8 * low - 0.5 * reading[8] / self.vehicle.pace[2], -1, 1)
        if not {2, 5} & set(self.vehicle.dofs):
            demand[:, 0] = np.clip(2.0 * (1.5 * demand[:, 0] - reading[6] / self.vehicle.pace[0]), -1, 1)
        return to_commands(self.vehicle, demand).T
