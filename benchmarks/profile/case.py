"""The diagnosis that is measured: six degrees of freedom, 4 x 100 s at 20 Hz, one effect hidden."""

from __future__ import annotations

from functools import cache

from benchmarks.hidden_effects import make_case
from benchmarks.trust.material import written_to_memory
from undertow.identification.logs.run import Run
from undertow.model.vehicle import Vehicle

VEHICLE, HIDDEN, SEED = "rov", "lift", 3
LONGER = 300.0  # s: four such runs are 20 minutes

Material = tuple[Vehicle, list[Run], list[Run]]


@cache
def material() -> Material:
    """The model as the user believes it, three runs to fit to, one to judge by."""
    return written_to_memory(make_case(VEHICLE, (HIDDEN,), SEED))


@cache
def long_material() -> Material:
    """The same in logs of 20 minutes."""
    return written_to_memory(make_case(VEHICLE, (HIDDEN,), SEED, duration=LONGER))
