"""Logs of any length of the bundled BlueROV2 in a current that its file lacks, by our own simulation."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl

from benchmarks.hidden_effects.manoeuvres import cruise, multisine, random_steps
from benchmarks.hidden_effects.plant import RATE as COMMANDS_PER_SECOND
from benchmarks.hidden_effects.simulation import CHANNELS, NOISE
from undertow.codegen import Functions, Simulator
from undertow.model.catalogue import catalogue
from undertow.model.loading import load_vehicle

VEHICLE = "bluerov2"


@dataclass(frozen=True)
class Dive:
    """How a dive goes."""

    rate: int = 100  # rows per second; commands change 20 times a second
    current: tuple[float, float] = (0.12, -0.08)  # m/s north and east: what the vehicle file lacks
    # Relative differences of the truth from the values that the file marks as estimated.
    spread: float = 0.2
    # Shares of the time: hovering, cruising, steps and sines of all motions. Most of a long log is dull.
    hovering: float = 0.7
    cruising: float = 0.2
    piece: int = 100  # s of one kind
    noise: float = 1.0  # of the sensors, in that of the hidden effects
    # Largest demands, N and N m, and what holds the vehicle, which is 2 N too light, at its depth.
    reach: tuple[float, ...] = (12.0, 12.0, 12.0, 0.15, 0.15, 0.8)
    ballast: float = 2.0


def truth(dive: Dive, seed: int) -> dict[str, float]:
    """True values by parameter, where they differ from the file's."""
    vehicle, random = load_vehicle(VEHICLE), np.random.default_rng([seed, 1])
    names = [n for n in vehicle.parameter_names if vehicle.value_of(n).estimate]
    factors = 1 + dive.spread * random.uniform(-1, 1, len(names))
    values = {n: f * vehicle.value_of(n).value for n, f in zip(names, factors, strict=True)}
    return {**values, "V_N": dive.current[0], "V_E": dive.current[1]}


def write(path: Path, seconds: int, dive: Dive | None = None, seed: int = 0) -> Path:
    """Write a log as CSV or Parquet, by the ending of its name."""
    table = pl.DataFrame(columns(seconds, dive or Dive(), seed))
    if path.suffix == ".csv":
        table.write_csv(path, float_precision=6)
    else:
        table.write_parquet(path)
    return path


def columns(seconds: int, dive: Dive, seed: int) -> dict[str, np.ndarray]:
    """Columns of a log: t, the twelve channels and the commands, with the noise of the hidden effects."""
    vehicle = load_vehicle(VEHICLE).with_effect(catalogue()["ocean_current"], {})
    functions = Functions(vehicle)
    p, true = np.array(functions.values(), dtype=float), truth(dive, seed)
    for name, value in true.items():
        p[functions.parameter_names.index(name)] = value
    t = np.arange(seconds * dive.rate) / dive.rate
    u = np.repeat(_commands(seconds, dive, seed), dive.rate // COMMANDS_PER_SECOND, axis=0)
    start = np.zeros(len(functions.state_names))
    start[2] = 20.0
    motion = Simulator(functions).run(start, t, u, p)[:, :12]
    motion += dive.noise * NOISE * np.random.default_rng([seed, 2]).standard_normal(motion.shape)
    return {"t": t, **dict(zip(CHANNELS, motion.T, strict=True)), **_named(u)}


def _named(u: np.ndarray) -> dict[str, np.ndarray]:
    return dict(zip(load_vehicle(VEHICLE).command_names, u.T, strict=True))


def _commands(seconds: int, dive: Dive, seed: int) -> np.ndarray:
    """Commands of the thrusters at 20 Hz, N."""
    random, count = np.random.default_rng([seed, 3]), dive.piece * COMMANDS_PER_SECOND
    pieces = [_demand(count, random, dive) for _ in range(-(-seconds // dive.piece))]
    force = np.concatenate(pieces)[: seconds * COMMANDS_PER_SECOND] * np.array(dive.reach)
    force[:, 2] += dive.ballast
    wrench = np.array([t.wrench for t in load_vehicle(VEHICLE).thrusters], dtype=float).T
    return np.asarray(np.round(force @ np.linalg.pinv(wrench).T, 4))


def _demand(count: int, random: np.random.Generator, dive: Dive) -> np.ndarray:
    """Demands (count, 6) of one piece, as shares of the reach."""
    kind = random.random()
    if kind < dive.hovering:
        return np.zeros((count, 6))
    if kind < dive.hovering + dive.cruising:
        return cruise(count, random)
    return (random_steps, multisine)[random.integers(2)](count, random)
