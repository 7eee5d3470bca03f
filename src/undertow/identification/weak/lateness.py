"""Channels that are reported late: put back in time before anything is made of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from undertow.codegen.functions import Functions
from undertow.typing import Array, Index

from .data import Segment

if TYPE_CHECKING:
    from .residual import Linearised

# Samples to either side of an instant. A kernel that dampens what the test functions see would dampen the
# noise with it, and a delay would be believed for that alone: with four the gain keeps within 0.001 of 1 up
# to 0.15 of the sampling rate, with three it does not.
_REACH = 4
# Sum of squared weights from which uneven samples amplify noise instead of interpolating.
_LOUDEST = 2.0
# Steps of finite differences, relative to a sampling interval.
_STEP = 1e-3


class Lateness:
    """How old every measured channel is, and what follows for a segment.

    Parameters
    ----------
    functions : Functions
        The model.
    free : tuple of int
        Places in p of the free parameters.
    """

    def __init__(self, functions: Functions, free: tuple[int, ...] = ()) -> None:
        self._functions, self._free = functions, free

    @cached_property
    def present(self) -> bool:
        """Whether any channel can be late."""
        return bool(self._functions.report_age.nnz())

    def seconds(self, p: Array) -> Array:
        """How old each of the 2n channels is when it is reported, s."""
        return np.asarray(self._dead_time(p)[0]).ravel()

    def at_its_time(self, t: Array, measured: Array, p: Array) -> Array:
        """Reported signals (N, 2n), each when it was true; the same array where nothing is late."""
        return _at_delays(t, measured, self.seconds(p)) if self.present else measured

    def in_time(self, s: Segment, p: Array) -> Segment:
        """The segment with each channel at the time that it was true; itself where nothing is late."""
        if not self.present:
            return s
        seconds = self.seconds(p)
        return _moved(s, seconds) if _known(s, seconds) else s

    def residual(self, s: Segment, p: Array, of: Callable[[Segment], Linearised]) -> Linearised:
        """Residual `of` a segment put in time, and its derivative in the delays as well.

        Test functions that reach beyond the last true value are marked as unknown.
        """
        if not self.present:
            return of(s)
        seconds = self.seconds(p)
        functions = _known(s, seconds)
        if not functions:
            return of(s)
        moved = _moved(s, seconds)
        at = of(moved)
        J = at.J.copy()
        step = _STEP * float(np.median(np.diff(s.t)))
        for k, slope in self._slopes(p):
            # Of the signal alone: differentiated noise would promise a precision that is not there.
            change = step * slope * _at_delays(s.t, s.rate, seconds)
            J[:, k] += (of(replace(moved, measured=moved.measured + change)).r - at.r) / step
        known = functions * (len(at.r) // s.functions.count)
        inside = np.arange(len(at.r)) < known
        r, J, start = at.r * inside, J * inside[:, None], at.start * inside[:, None]
        return replace(at, r=r, J=J, start=start, known=known)

    def _slopes(self, p: Array) -> list[tuple[int, Array]]:
        """Which free parameters are delays, with the derivative of every channel's delay."""
        slope = np.asarray(self._dead_time(p)[1])
        return [(k, slope[:, k]) for k in range(slope.shape[1]) if np.any(slope[:, k])]

    @cached_property
    def _dead_time(self) -> ca.Function:
        f = self._functions
        free = ca.vertcat(*[f.p[i] for i in self._free]) if self._free else ca.SX(0, 1)
        slope = ca.jacobian(f.report_age, free)
        return ca.Function("report_age", [f.p], [ca.densify(f.report_age), ca.densify(slope)])


def _known(s: Segment, seconds: Array) -> int:
    """How many test functions lie before the last instant at which all channels are known, or none.

    A stretch hardly longer than the delay tells nothing about it and counts as it was measured. If it dropped
    out, long delays would look good because little is left to be wrong about.
    """
    beyond = s.t + np.max(seconds) > s.t[-1]
    lost = int(np.count_nonzero(abs(s.functions.value) @ beyond > 1e-12))
    return s.functions.count - lost if 2 * lost < s.functions.count else 0


def _moved(s: Segment, seconds: Array) -> Segment:
    return replace(s, measured=_at_delays(s.t, s.measured, seconds))


def _at_delays(t: Array, signals: Array, seconds: Array) -> Array:
    """Each signal at the times t plus its own delay."""
    found = signals.copy()
    for delay in np.unique(seconds[seconds != 0]):
        columns = np.flatnonzero(seconds == delay)
        found[:, columns] = interpolated(t, signals[:, columns], t + delay)
    return found


def interpolated(t: Array, y: Array, when: Array) -> Array:
    """A sampled signal between its samples, by the polynomial through the eight samples around.

    Parameters
    ----------
    t : (N,) array
        Time, s; intervals may differ.
    y : (N, k) array
        Signals.
    when : (M,) array
        Where to evaluate, s; after the last sample its value is held.

    Returns
    -------
    (M, k) array
        In the unit of y.
    """
    if len(t) < 2:
        return np.repeat(y, len(when), axis=0)
    index, weight = stencil(t, when)
    return np.asarray(np.einsum("mj,mjk->mk", weight, y[index]))


def stencil(t: Array, when: Array) -> tuple[Index, Array]:
    """Samples around each instant and their weights, both of shape (M, 8).

    Near the ends, and where intervals differ so much that noise would be amplified, fewer samples are used.
    """
    when = np.minimum(when, t[-1])
    left = np.clip(np.searchsorted(t, when, side="right") - 1, 0, len(t) - 2)
    index = np.clip(left[:, None] + np.arange(1 - _REACH, 1 + _REACH), 0, len(t) - 1)
    weight = np.zeros(index.shape)
    waiting = np.ones(len(when), dtype=bool)
    for reach in range(_REACH, 0, -1):
        rows = np.flatnonzero(waiting & (left + 1 >= reach) & (left + reach < len(t)))
        columns = slice(_REACH - reach, _REACH + reach)
        found = lagrange(t[index[rows, columns]], when[rows])
        good = (np.sum(found**2, axis=1) <= _LOUDEST) | (reach == 1)
        weight[rows[good], columns] = found[good]
        waiting[rows[good]] = False
    return index, weight


def lagrange(nodes: Array, when: Array) -> Array:
    """Weights of the polynomial through values at `nodes` (M, k)."""
    weight = np.ones(nodes.shape)
    for j in range(nodes.shape[1]):
        for k in range(nodes.shape[1]):
            if k != j:
                weight[:, j] *= (when - nodes[:, k]) / (nodes[:, j] - nodes[:, k])
    return weight
