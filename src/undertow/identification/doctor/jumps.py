"""Positions that jump farther from one sample to the next than any vehicle moves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from undertow.identification.findings import Finding
from undertow.identification.logs.run import UNITS, Run
from undertow.model.symbols import POSE, VELOCITY
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
    # Acceleration, in g, below which a vehicle may have moved what was taken for a shift of the origin, from
    # rest to rest: a change of cameras by 5 cm in 20 ms needs 50, one of satellites by 0.5 m in 1 s 0.2; a
    # glider that is logged every 10 s and pitches by 30 degrees in between 0.001.
    attainable: float = 0.1
    # Share of the motion (mean square) that they would be, from which they are reported: of a glider that is
    # logged every 10 s they are far more than all of the rest, small glitches of a heading 0.02 and less.
    missed: float = 0.1
    # Share of the rows that repeat the position of the one before, and factor by which velocities derived
    # from it exceed the way made good over `changes` of it, from which they are those of its resolution.
    repeated: float = 0.5
    too_fast: float = 2.0
    changes: int = 10


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


def pose_steps(vehicle: Vehicle, runs: Sequence[Run]) -> Iterator[Finding]:
    """Steps of a pose that were taken for shifts of its origin, and that its vehicle may have moved."""
    size = size_of(vehicle)
    if size is None:
        return
    own = dict(zip(vehicle.pose_names, vehicle.velocity_names, strict=True))  # psi may be there without yaw
    shifted = ((run, name) for run in runs for name in run.shifts if name in own)
    found = [(run, n, s) for run, n in shifted if len(s := _attainable(vehicle, run, n, size))]
    for name in dict.fromkeys(n for _, n, s in found if len(s) >= SETTINGS.fewest):
        run, _, steps = max((f for f in found if f[1] == name), key=lambda f: len(f[2]))
        velocity, (largest, step) = VELOCITY[POSE.index(name)], steps[np.argmax(steps[:, 0])]
        yield Finding(
            id="pose_steps",
            severity="warning",
            text=f"{run.name}: {name} changes {len(steps)} times by up to {largest:.2g} {UNITS[name]} from "
            f"one sample to the next ({step:.3g} s), too suddenly for the samples around it: they count "
            f"as shifts of its origin, and {velocity} has nothing of them; but a vehicle of "
            f"{vehicle.values['m'].value:.4g} kg can move so fast: if it did, map a measured {velocity}, or "
            "log faster",
            evidence={"count": float(len(steps)), "largest": float(largest), "step": float(step)},
        )


def _attainable(vehicle: Vehicle, run: Run, name: str, size: float) -> Array:
    """Shifts of a pose that need little acceleration from rest to rest, (k, 2); none if all are small."""
    lever = 1.0 if name in ("x", "y", "z") else size
    needed = 4.0 * lever * run.shifts[name][:, 0] / run.shifts[name][:, 1] ** 2
    slow = run.shifts[name][needed < SETTINGS.attainable * vehicle.environment["g"]]
    velocity = run.channels[VELOCITY[POSE.index(name)]]
    moved = float(np.nanmean(velocity**2)) * (run.t[-1] - run.t[0])
    return slow if np.sum(slow[:, 0] ** 2 / slow[:, 1]) > SETTINGS.missed * moved else slow[:0]


def coarse_positions(runs: Sequence[Run]) -> Iterator[Finding]:
    """Positions that stay and jump by their resolution: velocities from them are those of the jumps."""
    found = [one for run in runs if {"u", "v"} <= run.derived and (one := _coarse(run)) is not None]
    if found:
        yield max(found, key=lambda one: one.evidence["derived"])


def _coarse(run: Run) -> Finding | None:
    """What is wrong with a position whose velocity exceeds the way made good; None of others."""
    there = np.isfinite(run.reports("x")) & np.isfinite(run.reports("y"))
    t, place = run.t[there], run.channels["x"][there] + 1j * run.channels["y"][there]
    jump = np.abs(np.diff(place))
    new = jump > 0.0
    if np.sum(new) <= 2 * SETTINGS.changes or np.mean(new) > 1.0 - SETTINGS.repeated:
        return None
    span = SETTINGS.changes * (t[-1] - t[0]) / np.sum(new)
    later = np.searchsorted(t, t + span)
    inside = later < len(t)
    far = np.abs(place[later[inside]] - place[inside]) / (t[later[inside]] - t[inside])
    made_good = float(np.sqrt(np.mean(far**2)))
    derived = float(np.sqrt(np.nanmean(run.channels["u"] ** 2 + run.channels["v"] ** 2)))
    if derived < SETTINGS.too_fast * made_good:
        return None
    return Finding(
        id="coarse_position",
        severity="warning",
        text=f"{run.name}: x, y repeat in {1.0 - np.mean(new):.0%} of the rows and then jump, by up to "
        f"{jump.max():.2g} m: u, v derived from them are {derived:.2g} m/s rms, though it makes good "
        f"{made_good:.2g} m/s over {span:.2g} s; log the position with more digits and where it is new, or "
        "map measured velocities",
        evidence={"derived": derived, "made_good": made_good, "repeated": float(1.0 - np.mean(new))},
    )


def _jumps(run: Run, limit: float) -> Array:
    """Changes of position from sample to sample, m, that are too fast for a vehicle."""
    there = np.isfinite(run.reports("x")) & np.isfinite(run.reports("y"))
    t, place = run.t[there], run.channels["x"][there] + 1j * run.channels["y"][there]
    change = np.abs(np.diff(place))
    usual = float(np.median(change)) if len(change) else 0.0
    return change[(change > limit * np.diff(t)) & (change > SETTINGS.outlying * usual)]
