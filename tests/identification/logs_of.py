"""Cases of the independent generator as runs, the model with its true values, and runs of any vehicle."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache

import numpy as np

import undertow as ut
from benchmarks.hidden_effects import Case
from undertow.identification.estimation.data import WeakData, prepare
from undertow.identification.logs.run import Run
from undertow.model.catalogue import catalogue
from undertow.model.loading import VehicleTable, vehicle_from_table
from undertow.model.vehicle import Value, Vehicle


def runs_of(case: Case) -> list[Run]:
    """The runs of a case."""
    return [run_of(name, columns) for name, columns in case.runs.items()]


def run_of(name: str, columns: Mapping[str, np.ndarray]) -> Run:
    """Columns with a time column as a run."""
    channels = {k: v for k, v in columns.items() if k != "t"}
    return Run(name, columns["t"], channels, sha256=name)


def vehicle_of(case: Case) -> Vehicle:
    """The model that a user would start from."""
    return _vehicle(json.dumps(case.vehicle))


@cache
def _vehicle(table: str) -> Vehicle:
    """The vehicle of a table as JSON: to state its equations takes longer than most of what is tested."""
    return vehicle_from_table(VehicleTable.model_validate(json.loads(table)), catalogue())


def true_vehicle(case: Case) -> Vehicle:
    """The same model with the true values of its parameters."""
    vehicle = vehicle_of(case)
    true = {n: v for n, v in case.truth["parameters"].items() if n in vehicle.values}
    return vehicle.with_values({n: replace(vehicle.value_of(n), value=v) for n, v in true.items()})


def prepared(vehicle: Vehicle, runs: Sequence[Run], aside: Sequence[Run]) -> tuple[WeakData, WeakData]:
    """Runs to fit and runs kept aside, both with the noise of the first."""
    data = prepare(runs, vehicle)
    return data, prepare(aside, vehicle, sigma=data.sigma)


def with_effect(vehicle: Vehicle, effect: str, **values: float) -> Vehicle:
    """The model with one more effect at given values, which may be refitted."""
    return vehicle.with_effect(catalogue()[effect], {n: Value(v, estimate=True) for n, v in values.items()})


def simulated_runs(
    vehicle: Vehicle,
    count: int,
    seconds: float,
    *,
    seed: int,
    size: float,
    hold: int,
    noise: float,
    unlogged: float = 0.0,
) -> list[Run]:
    """Runs of a vehicle at 10 Hz under random commands, each held for `hold` samples.

    size: of the largest command; noise: of each channel, as a share of its standard deviation; unlogged:
    steps of a slow random force in each command that the log does not contain.
    """
    model, rng, step = ut.compile(vehicle), np.random.default_rng(seed), 0.1
    steps, half, inputs = round(seconds / step), len(vehicle.pose_names), len(model.inputs)
    runs = []
    for i in range(count):
        u = np.repeat(rng.uniform(-size, size, (steps // hold + 1, inputs)), hold, axis=0)[:steps]
        slow = np.zeros((steps, inputs))
        for k in range(1, steps if unlogged else 0):
            slow[k] = 0.97 * slow[k - 1] + unlogged * rng.standard_normal(inputs)
        x = model.simulate(np.zeros(len(model.states)), u + slow, step)[:steps, : 2 * half]
        motion = dict(zip((*vehicle.pose_names, *vehicle.velocity_names), x.T, strict=True))
        noisy = {n: y + noise * np.std(y) * rng.standard_normal(steps) for n, y in motion.items()}
        commands = dict(zip(vehicle.command_names, u.T, strict=True))
        name = f"{vehicle.name} {i}"
        runs.append(Run(name, step * np.arange(steps), noisy | commands, sha256=name))
    return runs
