"""Commands as they arrive in windows: at the samples, and late ones also between two of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from undertow.typing import Array, Index

from .cutting import Windows

S = TypeVar("S", bound=np.generic)
# Share of a sampling interval by which an arrival may miss a sample and still count as one with it.
_TOGETHER = 1e-6


@dataclass(frozen=True)
class Drive:
    """Commands of windows, side by side.

    Attributes
    ----------
    u : (b, k, n_commands) array
        Commands at work from each sample on.
    t : (b, m) array
        Instants from which on a command is held, s: the samples, and what arrives between them; the padding
        repeats the last.
    held : (b, m, n_commands) array
        Commands at work from each instant on.
    samples : (b, k) array of int, optional
        Which instants are the samples; None: all are.
    """

    u: Array
    t: Array
    held: Array
    samples: Index | None = None

    @classmethod
    def at_once(cls, t: Array, u: Array) -> Drive:
        """Commands that arrive when they are given: times (b, k) in s and commands (b, k, n_commands)."""
        return cls(u, t, u)

    def __getitem__(self, rows: slice | Index) -> Drive:
        """The commands of some of the windows."""
        samples = None if self.samples is None else self.samples[rows]
        return Drive(self.u[rows], self.t[rows], self.held[rows], samples)

    def at_samples(self, values: Array) -> Array:
        """What was worked out for every instant, (b, m, ...), at the samples alone, (b, k, ...)."""
        if self.samples is None:
            return values
        rest = (1,) * (values.ndim - 2)
        return np.take_along_axis(values, self.samples.reshape(*self.samples.shape, *rest), axis=1)

    def spread(self, values: Array) -> Array:
        """What there is at the samples, (b, k, ...), with zeros at all other instants, (b, m, ...).

        Where padding repeats the last sample, the first of these keeps its value.
        """
        if self.samples is None:
            return values
        found = np.zeros((*self.t.shape, *values.shape[2:]))
        rows = np.arange(len(found))[:, None]
        found[rows, self.samples[:, ::-1]] = values[:, ::-1]
        return found


def arriving(windows: Windows, held: Sequence[Array], delay: float) -> Drive:
    """Commands of windows that arrive late.

    Parameters
    ----------
    windows : Windows
        The windows.
    held : sequence of (N, n_commands) arrays
        Commands of every run, without gaps; before a run its first ones.
    delay : float
        How late, s.
    """
    if delay == 0.0:
        return Drive.at_once(windows.t, _along(windows, held, windows.samples))
    instants, places, arrived = zip(*(_instants(run.t, delay) for run in windows.runs), strict=True)
    samples = _along(windows, places, windows.samples)
    first, last = samples[:, :1], samples[:, -1:]
    steps = np.minimum(first + np.arange(np.max(last - first) + 1), last)
    late = _along(windows, [u[i] for u, i in zip(held, arrived, strict=True)], steps)
    samples = samples - first
    u = np.take_along_axis(late, samples[:, :, None], axis=1)
    return Drive(u, _along(windows, instants, steps), late, samples)


def late_by(delay: float, t: Array, u: Array) -> Drive:
    """Commands (b, k, n_commands) of the same times (k,) in s that arrive late; before, the first of each."""
    times = np.tile(t, (len(u), 1))
    if delay == 0.0:
        return Drive.at_once(times, u)
    instants, places, arrived = _instants(t, delay)
    late = u[:, arrived]
    return Drive(late[:, places], np.tile(instants, (len(u), 1)), late, np.tile(places, (len(u), 1)))


def _along(windows: Windows, of_runs: Sequence[NDArray[S]], rows: Index) -> NDArray[S]:
    """What there is of every run, in the rows that belong to each window."""
    return np.stack([of_runs[run][row] for run, row in zip(windows.run, rows, strict=True)])


def _instants(t: Array, delay: float) -> tuple[Array, Index, Index]:
    """Samples and arrivals in order of time, s; which of them are the samples; and what arrived by then."""
    slack = _TOGETHER * float(np.median(np.diff(t)))
    late = t + delay
    near = t[np.clip(np.searchsorted(t, late - slack), 0, len(t) - 1)]
    between = late[(late < t[-1]) & (np.abs(near - late) > slack)]
    instants = np.sort(np.concatenate([t, between]))
    arrived = np.maximum(np.searchsorted(late, instants + slack, side="right") - 1, 0)
    return instants, np.searchsorted(instants, t), arrived
