"""Noise of the weak residual: that of the sensors, a disturbance, and what their past predicts."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cholesky_banded
from scipy.sparse import csr_array, dia_array, diags_array, eye_array, kron, tril

from undertow.typing import Array

from .test_functions import TestFunctions, solved


@dataclass(frozen=True)
class AutoregressionSettings:
    """Settings of autoregressive models of whitened residuals."""

    most_order: int = 6  # a slow force needs one, waves two, sensor noise beside them a few more
    rows_per_coefficient: int = 10  # residuals of an equation for each of its coefficients


AUTOREGRESSION = AutoregressionSettings()


def banded(matrix: csr_array) -> Array:
    """Lower half of a symmetric banded matrix in LAPACK's storage: a row for each diagonal."""
    coordinates = matrix.tocoo()
    offset = coordinates.row - coordinates.col
    bands = np.zeros((int(np.max(offset, initial=0)) + 1, matrix.shape[0]))
    lower = offset >= 0
    bands[offset[lower], coordinates.col[lower]] = coordinates.data[lower]
    return bands


def banded_sum(one: Array, other: Array) -> Array:
    """Sum of two symmetric banded matrices in LAPACK's storage."""
    total = np.zeros((max(len(one), len(other)), one.shape[1]))
    total[: len(one)] = one
    total[: len(other)] += other
    return total


def unbanded(bands: Array) -> csr_array:
    """The whole symmetric matrix of LAPACK's banded storage."""
    size = bands.shape[1]
    lower = dia_array((bands, -np.arange(len(bands))), shape=(size, size)).tocsr()
    lower.eliminate_zeros()
    return csr_array(lower + tril(lower, -1).T)


@dataclass(frozen=True)
class AutoregressiveNoise:
    """A vector autoregressive model of the whitened residuals of all equations.

    statsmodels fits one to a single series without gaps; here all segments are fitted together.

    coefficients: (order, e, e), of each of e equations in all of them, the nearest residuals first.
    scale: (e,), rms of the innovations.
    """

    coefficients: Array
    scale: Array

    @classmethod
    def of(cls, tables: Sequence[Array], most: int = AUTOREGRESSION.most_order) -> AutoregressiveNoise:
        """From whitened residuals, a table (K, e) for each segment; of an order up to `most`."""
        size = tables[0].shape[1]
        pieces = [
            np.lib.stride_tricks.sliding_window_view(t, most + 1, axis=0) for t in tables if len(t) > most
        ]
        rows = np.concatenate(pieces)[:, :, ::-1] if pieces else np.zeros((0, size, most + 1))
        now, past = rows[:, :, 0], rows[:, :, 1:].transpose(0, 2, 1)
        count, least = len(rows), np.inf
        found = cls(np.zeros((0, size, size)), np.ones(size))
        for order in range(most + 1):
            if count < AUTOREGRESSION.rows_per_coefficient * order * size + 1:
                break
            known = past[:, :order].reshape(count, -1)
            c = np.linalg.lstsq(known, now, rcond=None)[0]
            scale = np.sqrt(np.maximum(np.mean((now - known @ c) ** 2, axis=0), 1e-300))
            # Schwarz's criterion, per equation
            criterion = 2.0 * count * np.mean(np.log(scale)) + order * size * np.log(count)
            if criterion < least:
                blocks = np.asarray(c, dtype=float).reshape(order, size, size)
                least, found = criterion, cls(blocks.swapaxes(1, 2), scale)
        return found

    @property
    def order(self) -> int:
        """How many residuals before it a prediction of the next one needs."""
        return len(self.coefficients)

    def innovations(self, table: Array) -> Array:
        """One-step prediction errors of rows (m, k) in a segment, variance one; the first are zero."""
        rows = table.reshape(-1, len(self.scale), table.shape[1])
        found = rows.copy()
        for lag, c in enumerate(self.coefficients, start=1):
            found[lag:] -= np.einsum("ef,tfk->tek", c, rows[:-lag])
        found[: self.order] = 0.0
        return np.asarray((found / self.scale[:, None]).reshape(table.shape))


class Whitening:
    """Turns residuals into ones of unit variance, by a banded Cholesky factor.

    Rows are ordered by test function, then by equation. `covariance` (b, m) is that from the noise of the
    channels, and `overlap` (b, m) the products of test functions of one equation, the covariance of a white
    disturbance; lower halves in LAPACK's banded storage. `intensity` (m,) is that of the disturbance: the
    residual above the noise.
    """

    def __init__(self, covariance: Array, overlap: Array, intensity: Array) -> None:
        self._bands = covariance, overlap
        self._autoregression: AutoregressiveNoise | None = None
        self._factorise(intensity)

    def _factorise(self, intensity: Array) -> None:
        """Cholesky factor with a disturbance."""
        measured, white = self._bands
        if not np.any(intensity):
            self._factor = _cholesky(measured)
            return
        spread, disturbance = np.sqrt(intensity), np.zeros_like(white)
        for offset, diagonal in enumerate(white):
            last = len(spread) - offset
            disturbance[offset, :last] = spread[offset:] * diagonal[:last] * spread[:last]
        self._factor = _cholesky(banded_sum(measured, disturbance))

    @cached_property
    def covariance(self) -> csr_array:
        """Covariance of the residual from the noise of the channels alone, in the order of its rows."""
        return unbanded(self._bands[0])

    def with_disturbance(self, intensity: Array) -> Whitening:
        """The same noise with another disturbance."""
        other = copy(self)
        other._factorise(intensity)
        return other

    def __call__(self, right: Array) -> Array:
        """Whitened residuals or Jacobian columns, shape (m,) or (m, k)."""
        table = np.asarray(right)
        found = solved(self._factor, table.reshape(len(table), -1))
        if self._autoregression is not None:
            found = self._autoregression.innovations(found)
        return found.reshape(table.shape)

    def with_autoregressive(self, noise: AutoregressiveNoise) -> Whitening:
        """The same less what the residuals before predict of each one."""
        other = copy(self)
        other._autoregression = noise
        return other

    def noise_sample(self, rng: np.random.Generator) -> Array:
        """Whitened channel noise alone: one draw, shape (m,)."""
        factor = _cholesky(self._bands[0])
        draw = np.asarray(rng.standard_normal(factor.shape[1]))
        return self(_times(factor, draw))


def _cholesky(bands: Array) -> Array:
    """Lower Cholesky factor of a banded matrix in LAPACK's banded storage."""
    banded = bands.copy()
    # A noise-free log has a singular covariance; the floor is far below any noise that a sensor has.
    banded[0] += 1e-10 * banded[0] + 1e-14 * banded[0].max() + 1e-30
    return np.asarray(cholesky_banded(banded, lower=True, check_finite=False))


def _times(factor: Array, vector: Array) -> Array:
    """Product of a lower banded factor and a vector."""
    size = factor.shape[1]
    result = np.zeros(size)
    for offset, diagonal in enumerate(factor):
        result[offset:] += diagonal[: size - offset] * vector[: size - offset]
    return result


def overlap(functions: TestFunctions, t: Array, equations: int) -> Array:
    """Covariance of the weak residual under a white disturbance of unit intensity, in bands."""
    step = np.append(np.diff(t), 1.0)
    gram = functions.held @ diags_array(1.0 / step) @ functions.held.T
    return banded(csr_array(kron(gram, eye_array(equations))))
