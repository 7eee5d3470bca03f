"""Logs for a vehicle, as the command line reads them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from undertow.identification.logs.mapping import LogMapping
from undertow.identification.logs.pose_velocity import velocities_from_pose
from undertow.identification.logs.reading import read_log
from undertow.identification.logs.run import Run
from undertow.model.vehicle import Vehicle


def quiet(done: float, words: str) -> None:
    """Nobody is looking."""


def read(paths: Sequence[Path], vehicle: Vehicle, mapping: LogMapping | None = None) -> list[Run]:
    """Read logs; velocities are derived where a log has only pose."""
    runs = [read_log(path, mapping, vehicle.command_names) for path in paths]
    return [velocities_from_pose(run, vehicle.degrees_of_freedom) for run in runs]
