"""From a world to logs: start, commands, integration, readings, noise."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .drawing import Vehicle
from .manoeuvres import MANOEUVRES, Hold, to_commands
from .plant import RATE, STEP, SUBSTEPS, Plant
from .world import World

CHANNELS = ("x", "y", "z", "phi", "theta", "psi", "u", "v", "w", "p", "q", "r")
#: Standard deviation of the white noise on each channel, m, rad, m/s, rad/s.
NOISE = np.array([0.02, 0.02, 0.005, 0.003, 0.003, 0.003, 0.01, 0.01, 0.01, 0.002, 0.002, 0.002])
RUNS = ("steps", "cruise", "multisine", "holdout")

Feed = Callable[[int, np.ndarray], np.ndarray]  # sample, readings (12, R) -> commands (n, R)


@dataclass(frozen=True)
class Conduct:
    """How the runs are done: factor on the noise, seconds, feedback or not, and which manoeuvres."""

    noise: float = 1.0
    duration: float = 100.0
    closed_loop: bool = False
    runs: tuple[str, ...] = RUNS


def stream(seed: int, purpose: str) -> np.random.Generator:
    """An own stream of random numbers for every purpose, so that one does not shift another."""
    return np.random.default_rng([seed, zlib.crc32(purpose.encode())])


def simulate(world: World, seed: int, conduct: Conduct) -> dict[str, dict[str, np.ndarray]]:
    """Logs of all runs: run -> column -> (n,) values; columns are t, the twelve channels and the commands."""
    vehicle, runs, n = world.vehicle, conduct.runs, round(conduct.duration * RATE)
    demand = np.stack([MANOEUVRES[run](n, stream(seed, "commands " + run)) for run in runs])
    start = np.stack([_start(vehicle, stream(seed, "start " + run)) for run in runs], axis=1)
    errors = np.stack([_noise(vehicle, n, stream(seed, "noise " + run)) for run in runs], axis=2)
    feed = Hold(vehicle, demand, start[5]) if conduct.closed_loop else _open_loop(vehicle, demand)
    readings, commands, _ = integrate(world, start, conduct.noise * errors, feed)
    return {run: _columns(vehicle, readings[:, :, i], commands[:, :, i]) for i, run in enumerate(runs)}


def integrate(
    world: World, start: np.ndarray, errors: np.ndarray, feed: Feed
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Step the world at 80 Hz; commands hold for 1/20 s.

    Parameters
    ----------
    start : (12, R) pose and velocity of R runs
    errors : (n, 12, R) what the readings are wrong by
    feed : commands from the number of the sample and its readings

    Returns
    -------
    readings (n, 12, R) and commands (n, thrusters, R) at 20 Hz, true states (4 n + 1, 12, R) at 80 Hz

    Raises
    ------
    ValueError
        If the vehicle runs away.
    """
    plant, n, runs = Plant(world), len(errors), start.shape[1]
    late = round(world.command_delay / STEP)
    states = np.empty((n * SUBSTEPS + 1, 12, runs))
    states[0] = start
    y = np.concatenate([start, np.zeros((plant.extra, runs))])
    readings, commands = np.empty_like(errors), np.zeros((n, world.allocation.shape[1], runs))
    for k in range(n):
        readings[k] = _read(world, states, k * SUBSTEPS) + errors[k]
        commands[k] = feed(k, readings[k])
        for i in range(k * SUBSTEPS, (k + 1) * SUBSTEPS):
            active = commands[(i - late) // SUBSTEPS] if i >= late else np.zeros_like(commands[k])
            with np.errstate(over="ignore", invalid="ignore"):  # a runaway is told below, in plain words
                y = plant.step(i * STEP, y, active)
            states[i + 1] = y[:12]
        _refuse_runaway(y)
    return readings, commands, states


def _refuse_runaway(y: np.ndarray) -> None:
    """A vehicle at 10 m/s, or standing upright, is outside of what these equations are for."""
    speed, tilt = np.max(np.abs(y[6:9])), np.max(np.abs(y[4]))
    if not (speed < 10.0 and tilt < 1.5):
        raise ValueError(f"the vehicle ran away ({speed:.3g} m/s, pitch {tilt:.3g} rad): lower the strength")


def _read(world: World, states: np.ndarray, now: int) -> np.ndarray:
    """Noise-free readings (12, R) at simulation step `now`."""
    reading = states[now].copy()
    reading[6:9] = states[max(now - round(world.velocity_delay / STEP), 0), 6:9]
    for sensor in world.sensors:
        reading = sensor(reading)
    return reading


def _open_loop(vehicle: Vehicle, demand: np.ndarray) -> Feed:
    commands = to_commands(vehicle, demand)
    return lambda sample, reading: commands[:, sample].T


def _start(vehicle: Vehicle, rng: np.random.Generator) -> np.ndarray:
    """(12,) start: at the origin and the starting depth, any heading that it can have, nearly at rest."""
    state, own = np.zeros(12), list(vehicle.dofs)
    heading = rng.uniform(-np.pi, np.pi)
    state[2], state[5] = vehicle.depth, heading if 5 in own else 0.0
    state[6:][own] = (0.1 * vehicle.pace * rng.uniform(-1, 1, 6))[own]
    return state


def _noise(vehicle: Vehicle, n: int, rng: np.random.Generator) -> np.ndarray:
    """(n, 12) white noise; nothing on channels of motions that the vehicle does not have."""
    own = np.isin(np.arange(6), vehicle.dofs)
    return rng.standard_normal((n, 12)) * NOISE * np.concatenate([own, own])


def _columns(vehicle: Vehicle, readings: np.ndarray, commands: np.ndarray) -> dict[str, np.ndarray]:
    """One run as named columns."""
    columns = {"t": np.arange(len(readings)) / RATE}
    columns |= {name: column.copy() for name, column in zip(CHANNELS, readings.T, strict=True)}
    return columns | {name: column.copy() for name, column in zip(vehicle.thrusters, commands.T, strict=True)}
