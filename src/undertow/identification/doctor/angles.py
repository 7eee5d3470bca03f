"""Angles that jump by a turn, which no vehicle does from one sample to the next."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from undertow.typing import Array

from ..logs import Mapping, Run
from .findings import Finding
from .mending import column_edit
from .mistake import Mistake, with_channels
from .reading_mistakes import ANGLES, reading_mistakes, unwrapped

_TURN = 2 * np.pi
_NEAR = 0.3
_QUIET = 0.5
# Pitch ends upright: a share of the samples beyond that is none; and rad that no vehicle turns in a second.
_UPRIGHT, _OFTEN, _FASTEST = 1.05 * np.pi / 2, 0.01, np.pi


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


def in_degrees(runs: Sequence[Run], mapping: Mapping, names: Sequence[str]) -> Mistake | None:
    """Pitch that is too large, or a heading that turns too fast, to be in radians.

    Parameters
    ----------
    runs : sequence of Run
        Logs without velocities to ask.
    mapping : Mapping
        How they were read.
    names : sequence of str
        Pose coordinates that matter.
    """
    tilted = "theta" in names and any(_beyond_upright(run) > _OFTEN for run in runs)
    turning = max((_turned_in_a_second(run) for run in runs if "psi" in names), default=0.0)
    if not tilted and turning < _FASTEST:
        return None
    known = [m for m in reading_mistakes(mapping, runs) if m.id == "degrees_for_radians"]
    wanted = {n for n in (ANGLES if tilted else ("psi",)) if runs[0].has(n)}
    found = next((m for m in known if _changed(m, runs[0]) == wanted), None)
    if found is None:
        return None
    reason = (
        f"theta reaches {max(float(np.max(np.abs(_present(r, 'theta')))) for r in runs):.3g} in the log"
        if tilted
        else f"psi changes by {turning:.3g} in an ordinary second"
    )
    return replace(found, told=f"{found.told}: {reason}")


def _changed(mistake: Mistake, run: Run) -> set[str]:
    """Channels that undoing a mistake changes."""
    after = mistake.undo(run)
    return {n for n in run.channels if not np.array_equal(after.channels[n], run.channels[n], equal_nan=True)}


def _beyond_upright(run: Run) -> float:
    data = _present(run, "theta")
    return float(np.mean(np.abs(data) > _UPRIGHT)) if len(data) else 0.0


def _turned_in_a_second(run: Run) -> float:
    """Median change of the heading in a second, as it is in the log: jumps of a wrapped angle are few."""
    given = run.wrapped.get("psi", run.channels.get("psi", np.zeros(0)))
    there = np.flatnonzero(np.isfinite(given))
    if len(there) < 3:
        return 0.0
    t, psi = run.t[there], given[there]
    later = np.searchsorted(t, t + 1.0)
    inside = later < len(t)
    return float(np.median(np.abs(psi[later[inside]] - psi[inside]))) if np.any(inside) else 0.0


def _unwrapped(run: Run, name: str) -> Run:
    return with_channels(run, {name: unwrapped(run.channels[name])}) if run.has(name) else run


def _jumps(run: Run, name: str) -> int:
    """Steps by a turn between small ones: where those beside them are large, too, it only turns fast."""
    step = np.abs(np.diff(_present(run, name)))
    beside = np.pad(step, 1)
    alone = np.maximum(beside[:-2], beside[2:]) < 2 * _QUIET
    return int(np.sum((np.abs(step - _TURN) < _NEAR) & alone))


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
