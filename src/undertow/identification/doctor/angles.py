"""Angles that jump by a turn, which no vehicle does from one sample to the next."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ..logs import Run
from .findings import Finding
from .kinematics import Array
from .mending import column_edit
from .mistake import Mistake, with_channels
from .reading_mistakes import ANGLES, unwrapped

_TURN = 2 * np.pi
_NEAR = 0.3
_QUIET = 0.5


def wrapped_angles(runs: Sequence[Run]) -> Iterator[tuple[Mistake, int]]:
    """Angles that jump by a whole turn, and how often."""
    for name in ANGLES:
        count = sum(_jumps(run, name) for run in runs)
        if count:
            yield (
                Mistake(
                    "wrapped_angle",
                    f"{name} jumps by a turn {count} times",
                    lambda run, name=name: _unwrapped(run, name),  # type: ignore[misc]
                    lambda m, name=name: (column_edit(m, name, wrapped=True),),  # type: ignore[misc]
                ),
                count,
            )


def _unwrapped(run: Run, name: str) -> Run:
    return with_channels(run, {name: unwrapped(run.channels[name])}) if run.has(name) else run


def _jumps(run: Run, name: str) -> int:
    step = np.diff(_present(run, name))
    return int(np.sum(np.abs(np.abs(step) - _TURN) < _NEAR))


def _present(run: Run, name: str) -> Array:
    data = run.channels.get(name, np.zeros(0))
    return data[np.isfinite(data)]


def halfway(runs: Sequence[Run]) -> Iterator[Finding]:
    """An angle that takes a turn in two steps: it was interpolated, or averaged, across its jump."""
    for run in runs:
        for name in ANGLES:
            step = np.diff(_present(run, name))
            if len(step) < 10 or np.median(np.abs(step)) > _QUIET:
                continue
            two = np.abs(step[1:] + step[:-1])
            split = np.minimum(np.abs(step[1:]), np.abs(step[:-1])) > _QUIET
            count = int(np.sum((np.abs(two - _TURN) < _NEAR) & split))
            if count:
                yield Finding(
                    id="angle_across_its_jump",
                    severity="warning",
                    text=f"{run.name}: {name} takes a whole turn in two samples, {count} times: it was "
                    "averaged or interpolated across its jump; log it as it is measured",
                    evidence={"times": float(count)},
                )
