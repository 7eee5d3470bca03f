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
    rows_per_coefficient: int = 10


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
    """An autoregressive model of a whitened residual.

    statsmodels fits one to a single series without gaps; here all segments are fitted together.

    coefficients: (order,), of the residuals before, the nearest first.
    scale: rms of the innovations.
    """

    coefficients: Array
    scale: float

    @classmethod
    def of(cls, series: Sequence[Array], most: int = AUTOREGRESSION.most_order) -> AutoregressiveNoise:
        """From whitened residuals, an array (K,) for each segment; of an order up to `most`."""
        pieces = [np.lib.stride_tricks.sliding_window_view(r, most + 1) for r in series if len(r) > most]
        rows = np.concatenate(pieces)[:, ::-1] if pieces else np.zeros((0, most + 1))
        count, least, found = len(rows), np.inf, cls(np.zeros(0), 1.0)
        for order in range(most + 1):
            if count < AUTOREGRESSION.rows_per_coefficient * order + 1:
                break
            c = np.linalg.lstsq(rows[:, 1 : order + 1], rows[:, 0], rcond=None)[0]
            square = float(np.mean((rows[:, 0] - rows[:, 1 : order + 1] @ c) ** 2)) + 1e-300
            # Schwarz's criterion
            criterion = count * np.log(square) + order * np.log(count)
            if criterion < least:
                least, found = criterion, cls(np.asarray(c, dtype=float), float(np.sqrt(square)))
        return found

    def innovations(self, table: Array) -> Array:
        """One-step prediction errors of a segment, (m,) or (m, k), of variance one; the first are zero."""
        found = np.array(table, dtype=float)
        for lag, c in enumerate(self.coefficients, start=1):
            found[lag:] -= c * table[:-lag]
        found[: len(self.coefficients)] = 0.0
        return np.asarray(found / self.scale)


class Whitening:
    """Turns residuals into ones of unit variance, by a banded Cholesky factor.

    Rows are ordered by test function, then by equation. `covariance` (b, m) is that from the noise of the
    channels, and `overlap` (b, m) the products of test functions of one equation, the covariance of a white
    disturbance; lower halves in LAPACK's banded storage. `intensity` (m,) is that of the disturbance: the
    residual above the noise.
    """

    def __init__(self, covariance: Array, overlap: Array, intensity: Array) -> None:
        self._bands = covariance, overlap
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
        return solved(self._factor, table.reshape(len(table), -1)).reshape(table.shape)

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
