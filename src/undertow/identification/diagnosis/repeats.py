"""Whether data kept aside repeat the manoeuvre that a model was fitted to."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from undertow.model.vehicle import Vehicle

from ..logs import Run

# Rms difference of the commands of two runs, as a share of their rms, up to which they are the same: clocks
# may be half a sample apart at every step. Unrelated manoeuvres differ by more than their size.
_SAME = 0.15
# Share of the shorter run in which both must be under way for their commands to be compared.
_LONG = 0.5


def repeats(vehicle: Vehicle, train: Sequence[Run], test: Sequence[Run]) -> list[tuple[str, str]]:
    """Runs kept aside that repeat the commands of a run that was fitted, with that run.

    A model that has learned the manoeuvre by heart does as well on them as the right one.

    Parameters
    ----------
    vehicle : Vehicle
        Whose commands are compared.
    train, test : sequence of Run
        What models are fitted to, and what they are judged by.
    """
    names = vehicle.command_names
    pairs = ((kept, fitted) for kept in test for fitted in train)
    return [(kept.name, fitted.name) for kept, fitted in pairs if names and _same(kept, fitted, names)]


def _same(one: Run, other: Run, names: Sequence[str]) -> bool:
    """Whether two runs have the same commands, each counted from its own beginning."""
    first, second = one.t - one.t[0], other.t - other.t[0]
    common = first[first <= second[-1]]
    if common[-1] < _LONG * min(first[-1], second[-1]):
        return False
    mine = np.nan_to_num(one.matrix(names)[: len(common)])
    place = np.searchsorted(second, common, side="right") - 1
    theirs = np.nan_to_num(other.matrix(names)[place])
    size = float(np.sqrt(np.mean(mine**2)))
    changes = bool(np.any(np.ptp(mine, axis=0) > 0.0))
    return changes and float(np.sqrt(np.mean((mine - theirs) ** 2))) < _SAME * size
