"""Simulated dives of the mini-AUV whose sensors report at rates and clocks of their own, in one table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl

from undertow.codegen.functions import Functions
from undertow.codegen.simulate import Simulator
from undertow.model.catalogue import catalogue
from undertow.model.loading import load_vehicle
from undertow.model.vehicle import Value, Vehicle

FINE = 0.005  # s, of the simulation
NOISE = {"x": 0.02, "y": 0.02, "z": 0.02, "psi": 2e-3, "u": 5e-3, "v": 5e-3, "w": 5e-3, "r": 2e-3}
SOURCES = {"position": ("x", "y", "z"), "dvl": ("u", "v", "w"), "imu": ("psi", "r")}
RATES = {"position": 5.0, "dvl": 7.0, "imu": 50.0}
COMMANDS = 10.0  # a second
CURRENT = {"V_N": 0.12, "V_E": -0.08}


def model() -> Vehicle:
    """What the fits begin with: the bundled vehicle."""
    return load_vehicle("mini-auv")


def truth(current: bool = True) -> Vehicle:
    """The vehicle that dives: some values differ from those of the model, and there is a current."""
    vehicle = model()
    moved = {"X_uabsu_forward": 1.15, "Z_w_forward": 0.95, "N_r": 1.2, "X_udot_forward": 1.1}
    values = {n: Value(factor * vehicle.value_of(n).value) for n, factor in moved.items()}
    vehicle = vehicle.with_values(values)
    if not current:
        return vehicle
    return vehicle.with_effect(catalogue()["ocean_current"], {n: Value(v) for n, v in CURRENT.items()})


class Dive:
    """One dive, known at every instant."""

    def __init__(self, seed: int, seconds: float = 80.0, vehicle: Vehicle | None = None) -> None:
        vehicle = truth() if vehicle is None else vehicle
        self.seed, self.random = seed, np.random.default_rng(seed)
        self.t = np.arange(0.0, seconds, FINE)
        self.at_command = np.arange(0.0, seconds, 1 / COMMANDS)
        self.commands = self._commands(vehicle)
        functions = Functions(vehicle)
        held = np.searchsorted(self.at_command, self.t + 1e-9, side="right") - 1
        u = np.column_stack([c[held] for c in self.commands.values()])
        start = np.zeros((1, len(functions.state_names)))
        p = np.array(functions.values())
        states = Simulator(functions, compiled=False).run(start, self.t[None], u[None], p)
        names = (*vehicle.pose_names, *vehicle.velocity_names)
        self.motion = dict(zip(names, states[0].T[: len(names)], strict=True))

    def _commands(self, vehicle: Vehicle) -> dict[str, np.ndarray]:
        """Sines with steps on top: ahead, in turn, and up and down around what carries the weight."""
        ahead, turn = self._signal(2.0, 0.05, 4.0), self._signal(0.1, 0.2, 2.0)
        down = [7.15 * np.ones_like(ahead) + self._signal(0.8, 0.07, 5.0) for _ in range(2)]
        level = {"f1": -down[0], "f2": ahead + turn, "f3": -down[1], "f4": ahead - turn}
        return {n: level[n] for n in vehicle.command_names}

    def _signal(self, size: float, frequency: float, hold: float) -> np.ndarray:
        t, random = self.at_command, self.random
        sines = sum(np.sin(2 * np.pi * f * frequency * t + random.uniform(0, 6)) for f in (1.0, 1.7, 2.9))
        return size * (0.5 * sines + random.uniform(-1, 1, 1000)[(t // hold).astype(int)])

    def _clock(self, rate: float) -> np.ndarray:
        """Times of a sensor: its own phase, and steps that vary by a tenth."""
        count = int(self.t[-1] * rate) - 1
        phase, jitter = self.random.uniform(0, 1), self.random.uniform(-0.05, 0.05, count)
        return (np.arange(count) + phase + jitter) / rate

    def reports(self, name: str, when: np.ndarray) -> np.ndarray:
        """What a sensor reports at some times."""
        return np.interp(when, self.t, self.motion[name]) + self.random.normal(0, NOISE[name], len(when))

    def table(self, late: dict[str, float] | None = None, rates: dict[str, float] = RATES) -> pl.DataFrame:
        """All series in one table: a row for every time of any, blank where a series has no report.

        Reports of a source in `late` are stamped that many seconds after what they report.
        """
        self.random = np.random.default_rng([self.seed, 1])
        late = late or {}
        parts = [pl.DataFrame({"t": self.at_command + late.get("commands", 0.0), **self.commands})]
        for source, names in SOURCES.items():
            when = self._clock(rates[source])
            columns = {n: self.reports(n, when) for n in names if n in self.motion}
            parts.append(pl.DataFrame({"t": when + late.get(source, 0.0), **columns}))
        return pl.concat(parts, how="diagonal").group_by("t").agg(pl.all().drop_nulls().first()).sort("t")

    def dense(self, rate: float = 50.0) -> pl.DataFrame:
        """A log on one clock, every channel in every row."""
        self.random = np.random.default_rng([self.seed, 2])
        t = np.arange(0.0, self.t[-1], 1 / rate)
        held = np.searchsorted(self.at_command, t + 1e-9, side="right") - 1
        columns = {n: self.reports(n, t) for names in SOURCES.values() for n in names if n in self.motion}
        return pl.DataFrame({"t": t, **columns, **{n: c[held] for n, c in self.commands.items()}})


def written(table: pl.DataFrame, path: Path) -> Path:
    """The table as a log file."""
    table.write_csv(path) if path.suffix == ".csv" else table.write_parquet(path)
    return path
