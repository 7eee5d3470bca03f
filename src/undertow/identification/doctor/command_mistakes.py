"""The usual mistakes in commands: thrusters swapped or reversed, and commands in another unit."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from undertow.model.vehicle import Vehicle

from ..logs import Mapping, Run
from .mending import Edits, column_edit, reassigned
from .mistake import Mistake, scaling, with_channels

# Pulse widths of servo signals in microseconds: middle and travel to either side.
_PWM_MIDDLE, _PWM_TRAVEL = 1500.0, 400.0
_ALIKE = 0.02


def reversed_commands(vehicle: Vehicle) -> list[Mistake]:
    """One command with the opposite sign, all of them, or all that do not push ahead."""
    names = vehicle.command_names
    across = tuple(t.name for t in vehicle.thrusters if not t.wrench[0])
    several = {group for group in (names, across) if len(group) > 1}
    return [_reversed((n,)) for n in names] + [_reversed(group) for group in sorted(several)]


def _reversed(names: tuple[str, ...]) -> Mistake:
    def edits(mapping: Mapping) -> Edits:
        return tuple(column_edit(mapping, n, times=-1.0) for n in names)

    told = f"command {names[0]} is" if len(names) == 1 else f"commands {', '.join(names)} are"
    remedy = "; ".join(f"[[thrusters]] {n}: direction (or wrench) with the opposite sign" for n in names)
    undo = scaling(dict.fromkeys(names, -1.0))
    return Mistake("reversed_thruster", f"{told} reversed", undo, edits, len(names), remedy)


def together(first: Mistake, second: Mistake) -> Mistake:
    """Two thrusters reversed."""
    return _reversed(tuple(sorted(e.key for m in (first, second) for e in m.edits(Mapping()))))


def swapped_commands(vehicle: Vehicle) -> Iterator[Mistake]:
    """Two thrusters in each other's place, unless they do the same."""
    rows = list(vehicle.dof_indices)
    for one, other in combinations(vehicle.thrusters, 2):
        a, b = (np.array(t.wrench)[rows] * t.thrust_per_command.value for t in (one, other))
        if np.linalg.norm(a - b) > _ALIKE * (np.linalg.norm(a) + np.linalg.norm(b)):
            yield _swapped(one.name, other.name)


def _swapped(one: str, other: str) -> Mistake:
    places = {one: (other, 1.0), other: (one, 1.0)}

    def undo(run: Run) -> Run:
        return with_channels(run, {one: run.channels[other], other: run.channels[one]})

    return Mistake(
        "swapped_thrusters",
        f"commands {one} and {other} are in each other's place",
        undo,
        lambda mapping: reassigned(mapping, places),
        1,
        f"[[thrusters]]: exchange the names {one} and {other}",
    )


def other_units(vehicle: Vehicle, runs: list[Run]) -> Iterator[Mistake]:
    """Commands as percent, as a share of the largest, or as pulse widths, where the file has limits."""
    limits = {t.name: t.limit for t in vehicle.thrusters if t.limit is not None}
    if not limits:
        return
    largest = max(float(np.nanmax(np.abs(r.channels[n]))) for r in runs for n in limits)
    units = {
        "in percent of the limit": (0.01, 0.0, 100.0),
        "a share of the limit (-1 to 1)": (1.0, 0.0, 1.0),
        "pulse widths in microseconds": (1.0 / _PWM_TRAVEL, -_PWM_MIDDLE / _PWM_TRAVEL, 2200.0),
    }
    for told, (scale, offset, most) in units.items():
        if largest <= 1.05 * most:
            yield _in_unit(told, limits, scale, offset)


def _in_unit(told: str, limits: dict[str, float], scale: float, offset: float) -> Mistake:
    def undo(run: Run) -> Run:
        return with_channels(run, {n: top * (scale * run.channels[n] + offset) for n, top in limits.items()})

    def edits(mapping: Mapping) -> Edits:
        return tuple(
            column_edit(mapping, n, scale=top * scale, offset=top * offset) for n, top in limits.items()
        )

    return Mistake("command_unit", f"commands {', '.join(limits)} are {told}", undo, edits)
