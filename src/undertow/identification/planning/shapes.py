"""Shapes of a command over time, each from a few numbers between 0 and 1.

A shape takes the time since its start as a share of its length, (n,) in [0, 1), its length in s and its
numbers, and answers with a signal in [-1, 1]. It leaves out size and smooth ends, which are the manoeuvre's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from undertow.typing import Array

_LEVELS = 8
_BITS = 24
_HARMONICS = np.array([1, 2, 3, 5, 8, 13])
_PULSES = 3
# Nothing faster than this, Hz: thrusters do not follow, and a log at 10 Hz would not show it.
_FASTEST = 1.0


@dataclass(frozen=True)
class Shape:
    """A kind of signal.

    Attributes
    ----------
    name : str
        As reports call it.
    size : int
        How many numbers it takes.
    signal : callable
        The signal from (share of time, length in s, numbers).
    """

    name: str
    size: int
    signal: Callable[[Array, float, Array], Array]


def _steps(share: Array, length: float, q: Array) -> Array:
    """Steps between levels, each held for as long: a coast-down or a reversal where the levels say so."""
    return np.asarray((2 * q - 1)[(share * _LEVELS).astype(int)])


def _two_levels(share: Array, length: float, q: Array) -> Array:
    """Full one way or the other, changing at random instants (pseudo-random binary sequence)."""
    return np.where(q[(share * _BITS).astype(int)] > 0.5, 1.0, -1.0)


def _doublet(share: Array, length: float, q: Array) -> Array:
    """The 3-2-1-1 input of flight tests, once each way."""
    unit = 0.02 + 0.05 * q[0]
    pattern = np.array([1, 1, 1, -1, -1, 1, -1, 0.0])
    first = pattern[np.minimum((share / unit).astype(int), 7)]
    begin = 0.5 + 0.1 * q[1]
    later = pattern[np.clip(((share - begin) / unit).astype(int), 0, 7)] * (share >= begin)
    return np.asarray(np.where(share < begin, first, -later * (0.3 + 0.7 * q[2])))


def _multisine(share: Array, length: float, q: Array) -> Array:
    """Sines with 1 to 13 periods, sizes and phases free, scaled to the full deflection."""
    size, phase = np.split(q, 2)
    angle = 2 * np.pi * (share[:, None] * _HARMONICS + phase)
    wave = np.sin(angle) @ (size + 1e-3)
    return np.asarray(wave / np.max(np.abs(wave)))


def _chirp(share: Array, length: float, q: Array) -> Array:
    """A sine that becomes quicker, from 1 to 3 periods per length up to at most 1 Hz."""
    slow = (1 + 2 * q[0]) / length
    quick = max(slow * (_FASTEST / slow) ** q[1], slow)
    growth = np.log(quick / slow) + 1e-9
    return np.asarray(np.sin(2 * np.pi * slow * length * np.expm1(growth * share) / growth))


def _reversal(share: Array, length: float, q: Array) -> Array:
    """Ahead and astern in turn, the two with their own size."""
    periods = 1 + np.floor(5.99 * q[0])
    ahead = (share * periods) % 1.0 < 0.3 + 0.4 * q[1]
    return np.where(ahead, 1.0, -q[2])


def _coast(share: Array, length: float, q: Array) -> Array:
    """Pulses of thrust, each followed by a stretch without, in which the vehicle coasts down."""
    pulse = (share * _PULSES).astype(int)
    on = (share * _PULSES) % 1.0 < 0.2 + 0.5 * q[-1]
    return np.where(on, (2 * q - 1)[pulse], 0.0)


def _sweep(share: Array, length: float, q: Array) -> Array:
    """Slowly up and down through all speeds, both ways."""
    cycles = 1 + np.floor(2.99 * q[0])
    ramp = 1 - 4 * np.abs((share * cycles + 0.25) % 1.0 - 0.5)
    return np.asarray(np.sign(ramp) * np.abs(ramp) ** (0.5 + q[1]))


def _steady(share: Array, length: float, q: Array) -> Array:
    """Held, with another level in the second half."""
    return np.where(share < 0.5, 1.0, 2 * q[0] - 1)


STEPS = Shape("steps", _LEVELS, _steps)
TWO_LEVELS = Shape("random binary steps", _BITS, _two_levels)
DOUBLET = Shape("doublets (3-2-1-1)", 3, _doublet)
MULTISINE = Shape("multisine", 2 * len(_HARMONICS), _multisine)
CHIRP = Shape("chirp", 2, _chirp)
REVERSAL = Shape("reversals", 3, _reversal)
COAST = Shape("pulses and coast-downs", _PULSES + 1, _coast)
SWEEP = Shape("slow sweeps", 2, _sweep)
STEADY = Shape("steady", 1, _steady)
SHAPES = (STEPS, TWO_LEVELS, DOUBLET, MULTISINE, CHIRP, REVERSAL, COAST, SWEEP)
