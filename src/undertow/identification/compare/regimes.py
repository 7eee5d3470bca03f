"""Regimes: parts of logs that are alike in how the vehicle moves or is driven, by the data alone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Flags

from .forces import Forces

# Share of the largest command below which a command counts as none.
_NO_COMMAND = 0.01
# Test functions after the first command that count as starting up: four make one width of a function.
_STARTING = 8
_FAST_TURN = 0.7
# A velocity counts as reversed when it passes this many standard deviations of its noise on both sides.
_CLEAR = 3.0


@dataclass(frozen=True)
class Regime:
    """One part of the logs.

    Attributes
    ----------
    group : str
        What it is one part of: speed, reversal, turning, depth, thrust, commands, time.
    name : str
        Its name.
    phrase : str
        How a sentence names it: "when turning".
    inside : (K, n) array of bool
        Test functions that belong to it, for each degree of freedom.
    """

    group: str
    name: str
    phrase: str
    inside: Flags


def regimes(forces: Forces, vehicle: Vehicle, sigma: Array) -> list[Regime]:
    """All regimes that the degrees of freedom and the commands of a vehicle let one tell apart.

    Parameters
    ----------
    forces : Forces
        Averages over test functions.
    vehicle : Vehicle
        Whose degrees of freedom are meant.
    sigma : (2n,) array
        Noise of pose and velocity.
    """
    size = len(vehicle.dof_indices)
    parts = [_speeds, _reversal, _turning, _depths, _thrust, _commands, _thirds]
    found = [r for part in parts for r in part(forces, vehicle, sigma)]
    return [
        Regime(g, n, phrase, np.broadcast_to(m if m.ndim == 2 else m[:, None], (len(forces), size)))
        for g, n, phrase, m in found
    ]


_Found = Iterator[tuple[str, str, str, Flags]]


def _speeds(forces: Forces, vehicle: Vehicle, sigma: Array) -> _Found:
    linear = [i for i, dof in enumerate(vehicle.dof_indices) if dof < 3]
    chosen = linear or list(range(len(vehicle.dof_indices)))
    speed = np.linalg.norm(forces.velocity[:, chosen], axis=1)
    names = ("slow", "medium", "fast")
    phrases = ("at low speed", "at medium speed", "at high speed")
    yield from _bands("speed", names, phrases, speed)


def _bands(group: str, names: tuple[str, ...], phrases: tuple[str, ...], value: Array) -> _Found:
    """Parts of a variable with equally many test functions each."""
    limits = np.quantile(value, np.linspace(0, 1, len(names) + 1)[1:-1])
    band = np.searchsorted(limits, value, side="right")
    for i, (name, phrase) in enumerate(zip(names, phrases, strict=True)):
        yield group, name, phrase, band == i


def _reversal(forces: Forces, vehicle: Vehicle, sigma: Array) -> _Found:
    clear = _CLEAR * sigma[len(vehicle.dof_indices) :]
    low, high = forces.velocity.copy(), forces.velocity.copy()
    for step in (1, 2):
        for ahead, behind in (
            (slice(step, None), slice(None, -step)),
            (slice(None, -step), slice(step, None)),
        ):
            near = (forces.segment[ahead] == forces.segment[behind])[:, None]
            other = forces.velocity[behind]
            low[ahead] = np.where(near, np.minimum(low[ahead], other), low[ahead])
            high[ahead] = np.where(near, np.maximum(high[ahead], other), high[ahead])
    yield "reversal", "reversing", "when the motion reverses", (low < -clear) & (high > clear)


def _turning(forces: Forces, vehicle: Vehicle, sigma: Array) -> _Found:
    if "r" not in vehicle.velocity_names:
        return
    rate = np.abs(forces.velocity[:, vehicle.velocity_names.index("r")])
    fast = rate > max(np.quantile(rate, _FAST_TURN), _CLEAR * sigma[-1])
    yield "turning", "turning", "when turning", fast
    yield "turning", "straight", "when going straight", rate <= np.quantile(rate, 1 - _FAST_TURN)


def _depths(forces: Forces, vehicle: Vehicle, sigma: Array) -> _Found:
    if "z" not in vehicle.pose_names:
        return
    place = vehicle.pose_names.index("z")
    depth = forces.pose[:, place]
    if np.ptp(depth) > 2 * _CLEAR * sigma[place]:
        phrases = ("near its least depth", "at middle depth", "near its greatest depth")
        yield from _bands("depth", ("shallow", "middle", "deep"), phrases, depth)


def _thrust(forces: Forces, vehicle: Vehicle, sigma: Array) -> _Found:
    drive = forces.drive
    least = _NO_COMMAND * np.max(np.abs(drive), axis=0, initial=0.0)
    for name, side in (("positive", drive > least), ("negative", drive < -least)):
        if side.any():
            yield "thrust", f"thrust {name}", f"under {name} thrust", side


def _commands(forces: Forces, vehicle: Vehicle, sigma: Array) -> _Found:
    if forces.commands.size == 0:
        return
    largest = np.max(np.abs(forces.commands), axis=0)
    idle = np.all(np.abs(forces.commands) <= _NO_COMMAND * largest, axis=1)
    woken = np.zeros(len(idle), dtype=bool)
    for step in range(1, _STARTING + 1):
        woken[step:] |= idle[:-step] & (forces.segment[step:] == forces.segment[:-step])
    yield "commands", "start-up", "when starting up", woken & ~idle
    yield "commands", "coasting", "when coasting", idle


def _thirds(forces: Forces, vehicle: Vehicle, sigma: Array) -> _Found:
    third = np.zeros(len(forces), dtype=int)
    for run in np.unique(forces.run):
        inside = forces.run == run
        first, last = forces.t[inside].min(), forces.t[inside].max()
        third[inside] = np.clip(3 * (forces.t[inside] - first) / max(last - first, 1e-12), 0, 2)
    for i, name in enumerate(("first", "middle", "last")):
        yield "time", f"{name} third", f"in the {name} third of the runs", third == i
