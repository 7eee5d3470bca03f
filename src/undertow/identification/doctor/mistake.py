"""One usual mistake: how to undo it in a run, and what to write into the mapping file instead."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..logs import Mapping as LogMapping
from ..logs import Run
from .mending import Edits, edited

Array = NDArray[np.float64]
Channels = dict[str, Array]
Undo = Callable[[Run], Run]


@dataclass(frozen=True)
class Mistake:
    """A mistake in how a log is read.

    Attributes
    ----------
    id : str
        Name of the kind.
    told : str
        What is wrong, as a clause: "the heading is in degrees, read as radians".
    undo : callable
        Takes a run with the mistake and returns it as it would be without.
    edits : callable
        Takes the mapping that the log was read by and returns what to change in it.
    count : int
        How many single things would have had to go wrong: of two explanations the simpler one is believed.
    vehicle : str
        What to change in the vehicle file to the same end; empty where nothing there can.
    """

    id: str
    told: str
    undo: Undo
    edits: Callable[[LogMapping], Edits]
    count: int = 1
    vehicle: str = ""


def with_channels(run: Run, channels: Mapping[str, Array]) -> Run:
    """A run with some channels replaced."""
    return replace(run, channels={**run.channels, **channels})


def scaling(factors: Mapping[str, float]) -> Undo:
    """Multiply channels by factors."""
    return lambda run: with_channels(run, {n: f * run.channels[n] for n, f in factors.items() if run.has(n)})


def turning(swap: Callable[[Mapping[str, Array]], Channels]) -> Undo:
    """Apply a change of axes to all channels."""
    return lambda run: replace(run, channels=swap(run.channels))


def both(first: Mistake, second: Mistake) -> Mistake:
    """Two mistakes at once."""

    def edits(mapping: LogMapping) -> Edits:
        before = first.edits(mapping)
        return (*before, *second.edits(edited(mapping, before)))

    return Mistake(
        f"{first.id}+{second.id}",
        f"{first.told}, and {second.told}",
        lambda run: second.undo(first.undo(run)),
        edits,
        first.count + second.count,
    )
