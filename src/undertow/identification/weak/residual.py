"""The weak residual of a model on prepared logs, with its derivative in the free parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from undertow.codegen.functions import Functions

from .data import Segment, WeakData
from .drive import Chain, Driven, Memory, without_gaps
from .noise import Whitening, overlap, residual_covariance
from .pointwise import Pointwise, mapped

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Linearised:
    """A residual and its derivatives.

    Attributes
    ----------
    r : (m,) array
        Residual.
    J : (m, n_free) array
        Derivative in the free parameters.
    start : (m, n_states) array
        Derivative in the effects' own states at the start of the segment.
    """

    r: Array
    J: Array
    start: Array


class WeakModel:
    """Weak residuals of one vehicle for a choice of free parameters.

    Parameters
    ----------
    functions : Functions
        The model.
    free : sequence of str
        Names of the parameters that may change.
    """

    def __init__(self, functions: Functions, free: Sequence[str]) -> None:
        self.functions = functions
        self.free = tuple(free)
        self.places = tuple(functions.parameter_names.index(n) for n in self.free)
        self._points = Pointwise(functions, self.places)
        self._chain = Chain(functions, self.places)
        self._memory = Memory(functions, self.places, self._points.measured, self._points.true_motion)

    def linearise(self, data: WeakData, p: Array) -> list[Linearised]:
        """Residual and derivative of every segment, rows ordered by test function, then by equation."""
        driven = [self._chain.along(r.t, without_gaps(r.matrix(data.commands)), p) for r in data.runs]
        return [self._segment(s, _cut(driven[s.run], s), data.rows, p) for s in data.segments]

    def _segment(self, s: Segment, actuation: Driven, rows: tuple[int, ...], p: Array) -> Linearised:
        memory = self._memory.along(s.t, s.measured, actuation.value, s.u, p)
        inputs = self._inputs(s.measured, actuation.value, memory.value, s.u, p)
        table = self._total(inputs, actuation, memory, p, s.t)
        if self._points.held_depends_on_motion:
            table = self._averaged_over_steps(table, s, actuation, memory, p)
        return self._tested(table, s, rows)

    def _inputs(self, measured: Array, actuation: Array, memory: Array, u: Array, p: Array) -> list[Array]:
        constant = self._points.mass_inverse(p)
        return [measured, actuation, memory, u, np.tile(constant, (len(u), 1))]

    def _total(self, inputs: list[Array], actuation: Driven, memory: Driven, p: Array, t: Array) -> Array:
        """Pointwise rows beside their total derivatives in the free parameters and in the first states."""
        value, free, by_actuation, by_memory = mapped(self._points.value_and_derivatives, inputs, p, t)
        total = free + by_actuation @ actuation.slope + by_memory @ memory.slope
        return np.concatenate(
            [value, total, by_actuation @ actuation.start, by_memory @ memory.start], axis=2
        )

    def _averaged_over_steps(
        self, table: Array, s: Segment, actuation: Driven, memory: Driven, p: Array
    ) -> Array:
        """Take the force of the commands at both ends of the interval in which they are held."""
        n = self._points.size
        later = [np.vstack([a[1:], a[-1:]]) for a in (s.measured, memory.value)]
        inputs = self._inputs(later[0], actuation.value, later[1], s.u, p)
        end = self._total(inputs, actuation, memory, p, s.t)
        table[:, 4 * n :] = 0.5 * (table[:, 4 * n :] + end[:, 4 * n :])
        return table

    def _tested(self, table: Array, s: Segment, rows: tuple[int, ...]) -> Linearised:
        n, f = self._points.size, s.functions
        width = table.shape[2]
        flat = table.reshape(len(s.t), -1)
        blocks = [flat[:, i * n * width : (i + 1) * n * width] for i in range(5)]
        force = f.rate @ blocks[0] + f.value @ blocks[1] + f.held @ blocks[4]
        kinematic = f.rate @ blocks[2] + f.value @ blocks[3]
        both = np.concatenate([force, kinematic], axis=1).reshape(f.count, 2 * n, width)[:, list(rows)]
        stacked = both.reshape(-1, width)
        last = 1 + len(self.free)
        return Linearised(stacked[:, 0].copy(), stacked[:, 1:last].copy(), stacked[:, last:].copy())

    def whitening(self, data: WeakData, p: Array) -> list[Whitening]:
        """Whitening of every segment under the noise of the channels, at parameters p."""
        driven = [self._chain.along(r.t, without_gaps(r.matrix(data.commands)), p) for r in data.runs]
        return [self._segment_whitening(s, _cut(driven[s.run], s), data, p) for s in data.segments]

    def _segment_whitening(self, s: Segment, actuation: Driven, data: WeakData, p: Array) -> Whitening:
        memory = self._memory.along(s.t, s.measured, actuation.value, s.u, p)
        inputs = self._inputs(s.measured, actuation.value, memory.value, s.u, p)
        (slope,) = mapped(self._points.noise, inputs, p, s.t)
        noise = residual_covariance(s.functions, slope, data.sigma, list(data.rows))
        rows = len(data.rows)
        return Whitening(noise, overlap(s.functions, s.t, rows), np.zeros(rows * s.functions.count))


def _cut(driven: Driven, s: Segment) -> Driven:
    return Driven(driven.value[s.samples], driven.slope[s.samples], driven.start[s.samples])


def whitened(parts: list[Linearised], whitening: list[Whitening]) -> Linearised:
    """All segments together, in units of their noise, free of what the unknown first states of effects
    contribute.
    """
    tables = [_without_start(part, w) for part, w in zip(parts, whitening, strict=True)]
    table = np.vstack(tables)
    return Linearised(table[:, 0], table[:, 1:], np.zeros((len(table), 0)))


def _without_start(part: Linearised, whitening: Whitening) -> Array:
    """Project out the directions of the first states: the rest of the residual does not depend on them."""
    table = whitening(np.column_stack([part.r, part.J, part.start]))
    last = 1 + part.J.shape[1]
    kept, start = table[:, :last], table[:, last:]
    size = np.linalg.norm(start, axis=0)
    # A start long ago is forgotten: what is left of it would underflow in the product below.
    felt = size > max(1e-9 * size.max(initial=0.0), 1e-9)
    if not felt.any():
        return kept
    start = start[:, felt] / size[felt]
    return np.asarray(kept - start @ (np.linalg.pinv(start.T @ start, hermitian=True) @ (start.T @ kept)))
