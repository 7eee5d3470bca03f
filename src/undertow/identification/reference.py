"""Reference states of a log, of motion capture or of a simulation: true states at the rows of an estimate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from undertow.errors import UndertowError
from undertow.model.symbols import MOTION_UNITS
from undertow.observer.filters import Estimate
from undertow.observer.nees import Truth
from undertow.typing import Array, Flags

from .logs.run import Run


@dataclass(frozen=True)
class ReferenceSettings:
    """Numbers of the interpolation."""

    # Longest step, s, of a reference that is interpolated: in between, an acceleration of 0.5 m/s^2 makes
    # an error of half a millimetre.
    longest: float = 0.1
    same_time: float = 1e-6  # s by which times may differ that are one


SETTINGS = ReferenceSettings()


def truth_at(estimate: Estimate, run: Run, references: Sequence[Run]) -> Truth:
    """True pose and velocities at the rows of an estimate, interpolated linearly in the reference.

    Parameters
    ----------
    estimate : Estimate
        Of a log, by an observer.
    run : Run
        The log.
    references : sequence of Run
        The segments of its reference, on the same clock.

    Raises
    ------
    UndertowError
        If the reference is the log itself, has none of the states, or no time in common with the log.
    """
    first = references[0]
    if run.sha256 and any(one.sha256 == run.sha256 for one in references):
        raise UndertowError(
            f"reference {first.source} is the log {run.source} itself: give a file with states that other "
            "sensors measured, or a simulation"
        )
    moving = [n for n in estimate.names if n in MOTION_UNITS]
    names = tuple(n for n in moving if any(_measured(one, n) for one in references))
    if not names:
        raise UndertowError(
            f"reference {first.source} has none of {', '.join(moving)}: name its columns in a mapping file "
            "beside it"
        )
    values = np.column_stack([_interpolated(estimate.t, references, n) for n in names])
    if not np.isfinite(values).any():
        raise UndertowError(_mismatch(estimate, run, references))
    noise = [max(one.sigma.get(n, 0.0) for one in references) for n in names]
    return Truth(names, values, np.array(noise) ** 2)


def _measured(run: Run, name: str) -> bool:
    return run.has(name) and name not in run.derived


def _interpolated(t: Array, references: Sequence[Run], name: str) -> Array:
    """A channel at times; NaN where no two samples that are close enough enclose them."""
    found = np.full(len(t), np.nan)
    for one in references:
        if not _measured(one, name):
            continue
        y = one.reports(name)
        own, y = one.t[np.isfinite(y)], y[np.isfinite(y)]
        if len(own) > 1:
            within = _enclosed(t, own)
            found[within] = np.interp(t[within], own, y)
    return found


def _enclosed(t: Array, own: Array) -> Flags:
    """Which times coincide with samples, or lie between two that are close."""
    after = np.clip(np.searchsorted(own, t), 1, len(own) - 1)
    before, step = t - own[after - 1], own[after] - own[after - 1]
    within = (before >= 0) & (before <= step) & (step <= SETTINGS.longest * (1 + SETTINGS.same_time))
    return within | (np.minimum(abs(before), abs(before - step)) <= SETTINGS.same_time)


def _mismatch(estimate: Estimate, run: Run, references: Sequence[Run]) -> str:
    """Why no row of an estimate has a true state."""
    begin, end = (min(one.t[0] for one in references), max(one.t[-1] for one in references))
    if end < estimate.t[0] or begin > estimate.t[-1]:
        return (
            f"reference {references[0].source} lasts from {begin:g} to {end:g} s, and log {run.source} from "
            f"{estimate.t[0]:g} to {estimate.t[-1]:g} s: put both on one clock ([time] in a mapping file)"
        )
    return (
        f"reference {references[0].source} has samples {references[0].step:.3g} s apart, and "
        f"{SETTINGS.longest:g} s is the limit between rows of the log: give one at a higher rate"
    )
