"""Times, positions and velocities in another unit than they are read in.

Pose rates and velocities then differ by a factor that no sensor has. Where both are wrong alike, or only one
of them was measured, the force tells that the motion would need.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from undertow.model.units import scale_offset

from ..logs import Mapping, Run
from .kinematics import Kinematics
from .mending import Edit, Edits, column_edit, column_of
from .mistake import SETTINGS, Mistake, scaling, with_channels

_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}
# Units that people log in, the likelier first; the unit of a velocity stands below that of its position.
_LENGTHS = {"m": "m/s", "mm": "mm/s", "cm": "cm/s", "ft": "ft/s"}
_SPEEDS = ("m/s", "mm/s", "cm/s", "knot", "km/h", "ft/s")
POSITIONS, SPEEDS = ("x", "y", "z"), ("u", "v", "w")
UNITS_OF_MOTION = frozenset({"length_unit", "speed_unit", "motion_unit"})
"""Ids of the mistakes in units of position and velocity."""


# --- time ---------------------------------------------------------------------------------------
def other_time_unit(kinematics: Kinematics, runs: Sequence[Run], mapping: Mapping) -> Mistake | None:
    """The unit of the time column in which pose rates and velocities have the same size.

    Where only positions, or only angles, can be held against velocities, a unit of those explains the same; a
    usual step that is far too short or too long then speaks for the time.

    Parameters
    ----------
    kinematics : Kinematics
        What pose rates are held against.
    runs : sequence of Run
        Logs with velocities that were measured, not derived from the pose.
    mapping : Mapping
        How they were read.
    """
    if not kinematics or any(run.derived for run in runs):
        return None
    ratio = _pose_rate_over_velocity(kinematics, runs)
    linear = {*kinematics.rows} & {*POSITIONS}
    both = bool(linear) and len(linear) < len(kinematics.rows)
    units = _time_units(mapping) if both else _likely(runs, mapping)
    return next((m for m, factor in units if abs(ratio / factor - 1.0) < SETTINGS.ratio), None)


def likely_time_units(runs: Sequence[Run], mapping: Mapping) -> Iterator[Mistake]:
    """Units of the time column in which logs have a usual step, where they have none as they are read."""
    return (mistake for mistake, _ in _likely(runs, mapping))


def _likely(runs: Sequence[Run], mapping: Mapping) -> Iterator[tuple[Mistake, float]]:
    step = float(np.median(np.concatenate([np.diff(run.t) for run in runs])))
    if SETTINGS.quick <= step <= SETTINGS.slow:
        return
    for mistake, factor in _time_units(mapping):
        if SETTINGS.quick <= factor * step <= SETTINGS.slow:
            yield mistake, factor


def _time_units(mapping: Mapping) -> Iterator[tuple[Mistake, float]]:
    """Every other unit of the time column, and what it multiplies times by."""
    unit = mapping.time.unit
    for other, seconds in _SECONDS.items():
        if unit in _SECONDS and other != unit:
            factor = seconds / _SECONDS[unit]
            yield (
                Mistake(
                    "time_unit",
                    f"the times are in {other}, read as {unit}",
                    lambda run, factor=factor: _slower(run, factor),  # type: ignore[misc]
                    lambda m, other=other: (Edit("time", "unit", other),),  # type: ignore[misc]
                ),
                factor,
            )


def _slower(run: Run, factor: float) -> Run:
    """A run whose clock goes by a factor; what was derived from its pose is slower by it."""
    moved = with_channels(run, {n: run.channels[n] / factor for n in run.derived})
    return replace(moved, t=factor * run.t, resolution=factor * run.resolution)


def _pose_rate_over_velocity(kinematics: Kinematics, runs: Sequence[Run]) -> float:
    """Ratio of the rms of both, the same for every pose rate; NaN where they differ in it."""
    rates = kinematics.rates(runs)
    pose, velocity = (np.sqrt(np.mean(a**2, axis=0)) for a in (rates.pose, rates.velocity))
    ratios = pose / np.maximum(velocity, 1e-30)
    middle = float(np.median(ratios))
    return middle if np.all(np.abs(ratios / middle - 1.0) < SETTINGS.ratio) else float("nan")


# --- lengths and speeds -------------------------------------------------------------------------
def other_units_of_motion(mapping: Mapping, moving: set[str]) -> Iterator[Mistake]:
    """Velocities, positions or both in another unit; all of a kind, or some of them."""
    for names in _present((SPEEDS, *((n,) for n in SPEEDS)), moving):
        yield from (_in_unit("speed_unit", mapping, names, unit, unit) for unit in _SPEEDS)
    for names in _present((POSITIONS, ("x", "y"), ("z",)), moving):
        yield from (_in_unit("length_unit", mapping, names, unit, unit) for unit in _LENGTHS)
    positions, speeds = (tuple(n for n in group if n in moving) for group in (POSITIONS, SPEEDS))
    if positions and speeds:
        names = (*positions, *speeds)
        yield from (_in_unit("motion_unit", mapping, names, *both) for both in _LENGTHS.items())


def _present(groups: Sequence[tuple[str, ...]], moving: set[str]) -> Iterator[tuple[str, ...]]:
    """What there is of each group, each set once."""
    found = (tuple(n for n in group if n in moving) for group in groups)
    yield from dict.fromkeys(names for names in found if names)


def _in_unit(kind: str, mapping: Mapping, names: tuple[str, ...], length: str, speed: str) -> Mistake:
    """Some channels in a unit of length, or of speed, that the mapping does not say."""
    units = {n: length if n in POSITIONS else speed for n in names}
    read_as = {n: _read_as(mapping, n) for n in names}
    factors = {n: scale_offset(units[n], read_as[n])[0] for n in names}

    def edits(m: Mapping) -> Edits:
        return tuple(column_edit(m, n, unit=unit) for n, unit in units.items())

    told = " and ".join(dict.fromkeys(units.values()))
    was = " and ".join(dict.fromkeys(read_as.values()))
    verb = "is" if len(names) == 1 else "are"
    return Mistake(kind, f"{', '.join(names)} {verb} in {told}, read as {was}", scaling(factors), edits)


def _read_as(mapping: Mapping, name: str) -> str:
    return column_of(mapping, name)[1].unit or ("m" if name in POSITIONS else "m/s")
