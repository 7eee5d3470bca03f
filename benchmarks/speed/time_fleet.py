"""What it costs to work through a fleet's logs on a cluster of processes, beside one process."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

pytest.importorskip("distributed", reason="Dask is not installed: pip install undertow[fleet]")

from benchmarks.fleet.costs import Material, apart, material, ready, worked
from undertow.fleet.engine import InProcess

from .conftest import Speed

ROWS = "fleet: one row of a log reduced"
_WHO = {0: "undertow, one process", 1: "one worker of Dask", 2: "two workers of Dask"}


@pytest.fixture(scope="module")
def logs() -> Iterator[Material]:
    with material(8, 4000) as given:
        yield given


@pytest.mark.parametrize("workers", [0, 1, 2])
def time_fleet_rows(speed: Speed, logs: Material, workers: int) -> None:
    plain = worked(logs, InProcess())
    with ready(logs, workers) as doing:
        off = apart(worked(logs, doing), plain)
        speed(
            ROWS,
            _WHO[workers],
            lambda: worked(logs, doing),
            calls=logs.total,
            apart=off,
            limit=1e-10,
            rounds=3,
        )
