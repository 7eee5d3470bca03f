"""Cases of the independent generator as runs, and the model with its true values."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np

from benchmarks.hidden_effects import Case
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


def with_effect(vehicle: Vehicle, effect: str, **values: float) -> Vehicle:
    """The model with one more effect at given values, which may be refitted."""
    return vehicle.with_effect(catalogue()[effect], {n: Value(v, estimate=True) for n, v in values.items()})
