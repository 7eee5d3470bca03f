"""A small fleet on disk, and one cluster of processes for the tests of a file."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import chdir
from pathlib import Path

import pytest

from benchmarks.fleet.made import days, folder_with_vehicle, fouling, write
from undertow.fleet.engine import DaskEngine, engine


@pytest.fixture(scope="session")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with craft.toml, and logs of alfa, which stays as it is, and of bravo, which fouls."""
    folder = tmp_path_factory.mktemp("fleet")
    vehicle, all_days = folder_with_vehicle(folder), days()
    length = (all_days[-1] - all_days[0]).days
    write(folder / "logs", vehicle, "alfa", [(d, {}) for d in all_days])
    shares = [(d, fouling(0.4 * (d - all_days[0]).days / length)) for d in all_days]
    write(folder / "logs", vehicle, "bravo", shares)
    return folder


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaskEngine]:
    """Two processes; they cost time, idle too, so they end with the tests that need them."""
    pytest.importorskip("distributed", reason="Dask is not installed: pip install undertow[fleet]")
    with chdir(tmp_path_factory.mktemp("dask")), engine(workers=2, patience=120.0) as doing:
        assert isinstance(doing, DaskEngine)
        yield doing
