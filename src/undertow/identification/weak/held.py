"""Signals that are held between samples: gaps filled, means of what arrives late."""

from __future__ import annotations

import numpy as np

from undertow.typing import Array, Index


def change(values: Array) -> Array:
    """Change since the sample before."""
    return np.diff(values, axis=0, prepend=values[:1])


def share_of_step(t: Array, delay: float) -> tuple[Array, Array]:
    """Where in the step after each sample a jump that is so late arrives, and its rate in the delay."""
    step = np.append(np.diff(t), np.inf)
    index = np.minimum(_at_work(t, delay), len(t) - 2)
    return np.clip((t[index + 1] + delay - t) / step, 0.0, 1.0), 1.0 / step


def _at_work(t: Array, delay: float) -> Index:
    """From which sample on was held what was at work just before each sample, `delay` seconds late.

    Just before, for a delay that is a multiple of the step can only grow where it is zero.
    """
    slack = 1e-12 * float(t[-1] - t[0])
    return np.maximum(np.searchsorted(t, t - delay - slack) - 1, 0)


def without_gaps(u: Array) -> Array:
    """Commands with the last known value where one is missing; nothing is judged inside such gaps."""
    known = np.where(np.isfinite(u), np.arange(len(u))[:, None], 0)
    filled = np.take_along_axis(u, np.maximum.accumulate(known, axis=0), axis=0)
    return np.nan_to_num(filled, nan=0.0)


def shifted_mean(t: Array, held: Array, delay: float) -> Array:
    """Mean over each interval of a held signal that arrives `delay` seconds late; before the log, its first
    value.
    """
    total = _integral(t, held)
    late = _at(t, total, held, t - delay)
    step = np.diff(t)[:, None]
    return np.vstack([np.diff(late, axis=0) / step, held[-1:]])


def shift_rate(t: Array, held: Array, delay: float) -> Array:
    """Minus the derivative of `shifted_mean` in the delay."""
    start = held[_at_work(t, delay)]
    step = np.diff(t)[:, None]
    return np.vstack([np.diff(start, axis=0) / step, np.zeros_like(held[:1])])


def _integral(t: Array, held: Array) -> Array:
    return np.vstack([np.zeros_like(held[:1]), np.cumsum(held[:-1] * np.diff(t)[:, None], axis=0)])


def _at(t: Array, total: Array, held: Array, when: Array) -> Array:
    index = np.clip(np.searchsorted(t, when, side="right") - 1, 0, len(t) - 1)
    return total[index] + held[index] * (when - t[index])[:, None]
