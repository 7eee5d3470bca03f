"""Positions that jump farther from one sample to the next than any vehicle moves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from undertow.identification.findings import Finding
from undertow.identification.logs.run import Run
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .forces import fastest_speed, size_of


@dataclass(frozen=True)
class JumpSettings:
    """Which changes of position are jumps."""

    # Median changes from sample to sample that a jump exceeds, so that plain noise of a fast sensor is none:
    # of 100,000 changes by noise the largest has four.
    outlying: float = 8.0
    fewest: int = 3  # of them in a log from which they are reported: a reset or two is cut out by hand


SETTINGS = JumpSettings()


def position_jumps(vehicle: Vehicle, runs: Sequence[Run]) -> Iterator[Finding]:
    """Jumps of a position beside velocities that were measured; those from the pose are freed of them."""
    size = size_of(vehicle)
    compared = [run for run in runs if run.has("x") and run.has("y") and not run.derived & {"u", "v"}]
    if size is None or not compared:
        return
    limit = fastest_speed(vehicle, size)
    found = {run.name: jumps for run in compared if len(jumps := _jumps(run, limit)) >= SETTINGS.fewest}
    if not found:
        return
    worst = max(found, key=lambda name: len(found[name]))
    count, largest = len(found[worst]), float(np.max(found[worst]))
    others = len(found) - 1
    yield Finding(
        id="position_jumps",
        severity="warning",
        text=f"{worst}: x, y jump {count} times, by up to {largest:.3g} m from one sample to the next, and "
        f"no vehicle of {vehicle.values['m'].value:.4g} kg exceeds {limit:.3g} m/s: the position was lost, "
        "or is that of something else; leave these cells empty, or number the rows between them (stretch)"
        + (f"; {others} more of the logs {'has' if others == 1 else 'have'} such jumps" if others else ""),
        evidence={"count": float(count), "largest": largest, "limit": limit},
    )


def _jumps(run: Run, limit: float) -> Array:
    """Changes of position from sample to sample, m, that are too fast for a vehicle."""
    there = np.isfinite(run.reports("x")) & np.isfinite(run.reports("y"))
    t, place = run.t[there], run.channels["x"][there] + 1j * run.channels["y"][there]
    change = np.abs(np.diff(place))
    usual = float(np.median(change)) if len(change) else 0.0
    return change[(change > limit * np.diff(t)) & (change > SETTINGS.outlying * usual)]
