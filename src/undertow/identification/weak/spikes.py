"""Samples that stand far off what their neighbours say, taken out of the weak form.

A test function spans many samples, and a sample is seen by several: one spike spoils them all. So the sample
is what is doubted, not the residual: it counts as hardly known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from undertow.typing import Array

from .data import Segment, WeakData
from .lateness import lagrange

# Neighbours on each side that a sample is held against, by the cubic through them.
_REACH = 2
# Standard deviations from which a sample is a spike: noise alone gets there once in two million samples.
_FAR = 5.0
# Share of the change to the next sample that a cubic may miss: a kink where thrust jumps is no spike.
_BEND = 0.25
_ROUNDS = 30


def without_spikes(data: WeakData) -> WeakData:
    """The same data with spikes replaced by the cubic through their neighbours, and doubted.

    Angles and velocities that were derived from others are left alone.
    """
    return replace(data, segments=tuple(_cleaned(s, data.sigma, data.derived) for s in data.segments))


def _cleaned(segment: Segment, sigma: Array, derived: Sequence[int]) -> Segment:
    if len(segment.t) <= 4 * _REACH:
        return segment
    measured, doubted = segment.measured.copy(), np.zeros(segment.measured.shape, dtype=bool)
    for k in range(measured.shape[1]):
        if sigma[k] > 0 and k not in derived:
            measured[:, k], doubted[:, k] = despiked(segment.t, measured[:, k], float(sigma[k]))
    return replace(segment, measured=measured, doubted=doubted) if doubted.any() else segment


def despiked(t: Array, y: Array, sigma: float) -> tuple[Array, NDArray[np.bool_]]:
    """A signal with its spikes replaced by what their neighbours say, and where they were.

    Parameters
    ----------
    t, y : (N,) array
        Time in s, and signal.
    sigma : float
        Standard deviation of its noise, in the unit of y.
    """
    index, weight = _neighbours(t)
    spread = np.sqrt(1.0 + np.sum(weight**2, axis=1))
    clean, spike = y.copy(), np.zeros(len(y), dtype=bool)
    for _ in range(_ROUNDS):
        guess = np.sum(weight * clean[index], axis=1)
        bend = _BEND * np.median(np.abs(np.diff(clean[index], axis=1)), axis=1)
        far = np.where(spike, 0.0, np.abs(clean - guess) / (spread * sigma + bend))
        # A spike makes its neighbours look odd as well: the worst of each neighbourhood goes first.
        worst = (far > _FAR) & (far >= np.max(far[index], axis=1))
        clean[spike | worst] = guess[spike | worst]
        if not worst.any():
            break
        spike |= worst
    return clean, spike


def _neighbours(t: Array) -> tuple[NDArray[np.intp], Array]:
    """The samples beside each one without itself, and the weights of the cubic through them there."""
    count, width = len(t), 2 * _REACH + 1
    first = np.clip(np.arange(count) - _REACH, 0, count - width)
    whole = first[:, None] + np.arange(width)
    index = whole[whole != np.arange(count)[:, None]].reshape(count, width - 1)
    return index, lagrange(t[index], t)
