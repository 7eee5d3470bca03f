"""A state carried from sample to sample, with its derivatives in parameters and in where it started."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property, lru_cache
from typing import NamedTuple

import casadi as ca
import numpy as np
from scipy.linalg.lapack import dtbtrs

from undertow.codegen.virtual import runge_kutta
from undertow.typing import Array

from .mapping import call, mapped

_SUBSTEPS = 4
At = Callable[[ca.SX, float], ca.SX]


class Inputs(NamedTuple):
    """What drives a state over one interval: columns that vary from sample to sample, parameters, its begin
    and its length in seconds.
    """

    columns: list[ca.SX]
    p: ca.SX
    t: ca.SX
    dt: ca.SX


class Carried:
    """States under given rates over the intervals between samples, and the mean of an output along each.

    The states alone follow one after the other. At known states, the derivatives of all intervals are worked
    out side by side; what is then left of carrying derivatives along is one banded triangular solution.

    Parameters
    ----------
    z : (n,) expression
        The states.
    inputs : Inputs
        What drives them.
    free : (m,) expression
        Parameters that derivatives are taken in.
    rate, output : callable
        Rate of the states, and the output, from the states and the share of the interval that has passed.
    """

    def __init__(self, z: ca.SX, inputs: Inputs, free: ca.SX, rate: At, output: At) -> None:
        self._z, self._inputs, self._free = z, inputs, free
        self._end, self._mean = _integrated(rate, output, z, inputs.dt)

    @cached_property
    def _step(self) -> ca.Function:
        columns, p, t, dt = self._inputs
        return ca.Function("carried", [self._z, *columns, t, dt, p], ca.cse([self._end]))

    @cached_property
    def _slopes(self) -> ca.Function:
        columns, p, t, dt = self._inputs
        tables = [ca.jacobian(v, x) for v in (self._end, self._mean) for x in (self._z, self._free)]
        results = ca.cse([ca.densify(v) for v in (*tables, self._mean)])
        return ca.Function("slopes", [self._z, *columns, dt, p, t], results)

    def states(self, start: Array, columns: list[Array], p: Array, t: Array, dt: Array) -> Array:
        """States at the samples and after the last interval, shape (N + 1, n)."""
        count = len(t)
        fixed = np.tile(p, (count, 1))
        (flat,) = call(_accumulated(self._step, count), [start, *columns, t, dt, fixed])
        return np.vstack([start, flat.reshape(count, -1)])

    def along(
        self, start: Array, slope: Array, columns: list[Array], p: Array, t: Array, dt: Array
    ) -> tuple[Array, Array, Array, Array]:
        """States (N + 1, n) and means over the intervals (N, k), each with its derivatives.

        Derivatives are those in the free parameters, then in the first states: shapes (N + 1, n, m + n) and
        (N, k, m + n); `slope`, (n, m), has those of the first states in the free parameters.
        """
        states = self.states(start, columns, p, t, dt)
        inside = [states[:-1], *columns, dt[:, None]]
        by_state, free, mean_by_state, mean_free, mean = mapped(self._slopes, inside, p, t)
        first = np.hstack([slope, np.eye(len(start))])
        slopes = _carried_slopes(first, by_state, _with_start(free, len(start)))
        means = mean_by_state @ slopes[:-1] + _with_start(mean_free, len(start))
        return states, slopes, mean[:, :, 0], means


def _with_start(direct: Array, states: int) -> Array:
    """Derivatives in the parameters, and none in the first states."""
    return np.concatenate([direct, np.zeros((*direct.shape[:2], states))], axis=2)


def _carried_slopes(first: Array, factor: Array, added: Array) -> Array:
    """Solution of S_k+1 = A_k S_k + B_k from S_0, shapes (N, n, n) and (N, n, m): (N + 1, n, m)."""
    count, size, _ = factor.shape
    right = np.concatenate([first[None], added]).reshape((count + 1) * size, -1)
    bands = np.zeros((2 * size, (count + 1) * size))
    for i in range(size):
        for j in range(size):
            bands[size + i - j, j::size][:count] = -factor[:, i, j]
    solution, info = dtbtrs(bands, right, uplo="L", diag="U")
    assert info == 0
    return np.asarray(solution).reshape(count + 1, size, -1)


def _integrated(rate: At, output: At, z: ca.SX, dt: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Runge-Kutta over one interval, and Simpson's mean of an output along it."""
    h, share = dt / _SUBSTEPS, 1.0 / _SUBSTEPS
    mean = output(z, 0.0)
    for step in range(_SUBSTEPS):

        def rates(at: Sequence[ca.SX], reach: float, begin: float = step * share) -> list[ca.SX]:
            return [rate(at[0], begin + reach * share)]

        (z,) = runge_kutta(rates, [z], [h])
        weight = 1 if step == _SUBSTEPS - 1 else 4 if step % 2 == 0 else 2
        mean = mean + weight * output(z, (step + 1) * share)
    return z, mean / (3 * _SUBSTEPS)


@lru_cache(maxsize=64)
def _accumulated(function: ca.Function, count: int) -> ca.Function:
    return function.mapaccum("accumulated", count)
