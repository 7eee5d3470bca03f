"""Families of manoeuvres: which shape goes on which axis, together or one after the other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .axes import Axis, actuator_axes, motion_axes
from .shapes import REVERSAL, SHAPES, STEADY, STEPS, Shape

_ENDS = 2.0
_SHARE_OF_ENDS = 0.1
_AHEAD = ("surge",)
_TURN = ("yaw",)


@dataclass(frozen=True)
class Family:
    """Manoeuvres of one kind.

    Attributes
    ----------
    name : str
        As reports call it.
    axes : tuple of Axis
        What is driven.
    shapes : tuple of Shape
        The shape on every axis.
    reach : (n_axes,) array
        Largest useful deflection of every axis, 0 to 1.
    in_turn : bool
        Whether the axes are driven one after the other.
    """

    name: str
    axes: tuple[Axis, ...]
    shapes: tuple[Shape, ...]
    reach: Array
    in_turn: bool = False

    @property
    def size(self) -> int:
        """How many numbers between 0 and 1 a manoeuvre of the family takes."""
        return sum(1 + s.size for s in self.shapes)

    def excitation(self, t: Array, numbers: Array, sizes: Array | float = 1.0) -> Array:
        """Commands beside the trim, shape (n, k); ends smoothly, may still exceed what actuators can do.

        Parameters
        ----------
        t : (n,) array
            Time from 0, s, evenly spaced.
        numbers : (size,) array
            Between 0 and 1.
        sizes : (n_axes,) array
            Share of every axis that is kept.
        """
        duration = float(t[-1] + (t[1] - t[0]))
        waves = [self._wave(t / duration, duration, i, own) for i, own in enumerate(self._split(numbers))]
        patterns = np.array([a.pattern for a in self.axes]) * np.reshape(sizes, (-1, 1))
        return np.asarray(_ends(t, duration)[:, None] * (np.column_stack(waves) @ patterns))

    def _split(self, numbers: Array) -> list[Array]:
        return np.split(numbers, np.cumsum([1 + s.size for s in self.shapes])[:-1])

    def _wave(self, share: Array, duration: float, i: int, own: Array) -> Array:
        count = len(self.axes) if self.in_turn else 1
        local = share * count - (i if self.in_turn else 0)
        inside = (local >= 0) & (local < 1)
        wave = self.shapes[i].signal(np.clip(local, 0.0, 1.0 - 1e-9), duration / count, own[1:])
        return np.asarray(np.where(inside, wave, 0.0) * own[0] * self.reach[i])


def _ends(t: Array, duration: float) -> Array:
    """From 0 to 1 and back to 0 without a jump."""
    length = min(_ENDS, _SHARE_OF_ENDS * duration)
    nearest = np.clip(np.minimum(t, t[-1] - t) / length, 0.0, 1.0)
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * nearest))


@dataclass(frozen=True)
class Design:
    """One manoeuvre: its family and its numbers between 0 and 1."""

    family: Family
    numbers: Array


def every_axis(vehicle: Vehicle, room: Array) -> tuple[list[Axis], list[Axis]]:
    """Axes of motions, and axes of single actuators where these are something else.

    Parameters
    ----------
    vehicle : Vehicle
        What is driven.
    room : (k,) array
        How far every command may go from its value at rest.
    """
    motions, actuators = motion_axes(vehicle, room), actuator_axes(vehicle, room)
    if len(motions) == len(actuators) and all(np.count_nonzero(a.pattern) == 1 for a in motions):
        return motions, []
    return motions, actuators


def families(bases: Sequence[tuple[list[Axis], Array]]) -> list[Family]:
    """Every family for axes that come in groups, each with the reach of its axes."""
    return [family for axes, reach in bases if axes for family in _of_group(axes, reach)]


def _of_group(axes: list[Axis], reach: Array) -> Iterator[Family]:
    names = _listed([a.name for a in axes])
    for shape in SHAPES:
        shapes = (shape,) * len(axes)
        if len(axes) == 1:
            yield Family(f"{shape.name} of {names}", tuple(axes), shapes, reach)
            continue
        yield Family(f"{shape.name} of {names} together", tuple(axes), shapes, reach)
        yield Family(f"{shape.name} of {names} in turn", tuple(axes), shapes, reach, in_turn=True)
    yield from _turning(axes, reach)


def _turning(axes: list[Axis], reach: Array) -> Iterator[Family]:
    """Circles and zigzags, for what can go ahead and turn."""
    ahead = next((i for i, a in enumerate(axes) if a.name in _AHEAD), None)
    turn = next((i for i, a in enumerate(axes) if a.name in _TURN), None)
    if ahead is None or turn is None:
        return
    pair = (axes[ahead], axes[turn])
    both = reach[[ahead, turn]]
    yield Family("circles (steady surge, yaw one way and the other)", pair, (STEADY, STEADY), both)
    yield Family("circles with steps of surge", pair, (STEPS, STEADY), both)
    yield Family("zigzag (steady surge, yaw to and fro)", pair, (STEADY, REVERSAL), both)


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
