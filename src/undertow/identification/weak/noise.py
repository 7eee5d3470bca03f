"""How noisy the channels are, and what that noise does to the weak residual."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from math import comb

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky_banded
from scipy.linalg.lapack import dtbtrs
from scipy.sparse import csr_array, diags_array, eye_array, kron

from .entries import Entries
from .testfunctions import TestFunctions

Array = NDArray[np.float64]
_ORDERS = range(3, 9)
_GAUSSIAN_MAD = 1.4826
# Standard deviations from which a difference is no noise, and the variance of a Gaussian cut off there.
_OUTLYING, _SHARE_WITHIN = 3.5, 0.9939
# Standard errors, in units of 1 / sqrt(samples), by which a higher order has to be lower.
_CLEARLY = 4.0


def white_noise(t: Array, y: Array) -> float:
    """Standard deviation of the white noise on a smooth signal, robust to kinks and jumps.

    A difference of order k amplifies white noise by sqrt(binomial(2k, k)) and suppresses what is
    smooth. The lowest order is taken, which knows the noise best, unless a higher one leaves clearly
    less: then the lower one takes a fast signal for noise.
    """
    if len(t) <= 4 * _ORDERS[0]:
        return 0.0  # too few samples to tell noise from motion
    steps = np.diff(t)
    even = np.abs(steps - np.median(steps)) < 0.2 * np.median(steps)
    found = [_by_difference(y, even, k) for k in _ORDERS if len(y) > 4 * k]
    known = [f for f in found if np.isfinite(f)]
    clearly = 1.0 + _CLEARLY / np.sqrt(len(y))
    return next((f for f in known if f <= clearly * min(known)), 0.0)


def _by_difference(y: Array, even: NDArray[np.bool_], order: int) -> float:
    difference = np.diff(y, n=order)
    usable = np.convolve(even, np.ones(order), mode="valid") > order - 0.5
    kept = difference[usable & np.isfinite(difference)]
    if len(kept) < 10:
        return np.inf
    rough = _GAUSSIAN_MAD * float(np.median(np.abs(kept)))
    # Of what is not a kink or a jump the mean square is known twice as well as the median.
    within = kept[np.abs(kept) <= _OUTLYING * rough]
    return float(np.sqrt(np.mean(within**2) / _SHARE_WITHIN / comb(2 * order, order)))


class Whitening:
    """Turns residuals into ones of unit variance, by a banded Cholesky factor.

    Parameters
    ----------
    covariance : sparse (m, m)
        Covariance of the residual from the noise of the channels, rows ordered by test function,
        then by equation.
    overlap : sparse (m, m)
        Integrals of products of test functions of the same equation: the covariance of a white disturbance.
    intensity : (m,) array
        Intensity of the disturbance in each row's equation: what the model leaves beyond the noise.
    """

    def __init__(self, covariance: csr_array, overlap: csr_array, intensity: Array) -> None:
        self._covariance, self._overlap = covariance, overlap
        self._bands = _banded(covariance), _banded(overlap)
        self._take(intensity)

    def _take(self, intensity: Array) -> None:
        """Factor with a disturbance."""
        measured, white = self._bands
        if not np.any(intensity):
            self._factor = _cholesky(measured)
            return
        total = np.zeros((max(len(measured), len(white)), measured.shape[1]))
        total[: len(measured)] = measured
        spread = np.sqrt(intensity)
        for offset, diagonal in enumerate(white):
            last = len(spread) - offset
            total[offset, :last] += spread[offset:] * diagonal[:last] * spread[:last]
        self._factor = _cholesky(total)

    @property
    def covariance(self) -> csr_array:
        """Covariance of the residual from the noise of the channels alone, in the order of its rows."""
        return self._covariance

    def with_disturbance(self, intensity: Array) -> Whitening:
        """The same noise with another disturbance."""
        other = copy(self)
        other._take(intensity)
        return other

    def __call__(self, right: Array) -> Array:
        """Whitened residuals or Jacobian columns, shape (m,) or (m, k)."""
        solution, info = dtbtrs(self._factor, np.asarray(right), uplo="L")
        assert info == 0
        return np.asarray(solution.reshape(np.shape(right)))

    def noise_sample(self, rng: np.random.Generator) -> Array:
        """What the noise of the channels alone would look like after whitening: one draw, shape (m,)."""
        factor = _cholesky(self._bands[0])
        draw = np.asarray(rng.standard_normal(factor.shape[1]))
        return self(_times(factor, draw))


def _banded(matrix: csr_array) -> Array:
    """Lower half of a symmetric banded matrix in LAPACK's storage: a row for each diagonal."""
    coordinates = matrix.tocoo()
    offset = coordinates.row - coordinates.col
    banded = np.zeros((int(np.max(offset, initial=0)) + 1, matrix.shape[0]))
    lower = offset >= 0
    banded[offset[lower], coordinates.col[lower]] = coordinates.data[lower]
    return banded


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


def overlap(functions: TestFunctions, t: Array, equations: int) -> csr_array:
    """Covariance of the weak residual under a white disturbance of unit intensity, shape (m, m)."""
    step = np.append(np.diff(t), 1.0)
    gram = functions.held @ diags_array(1.0 / step) @ functions.held.T
    return csr_array(kron(gram, eye_array(equations)))


def residual_covariance(
    functions: TestFunctions,
    slopes: Entries,
    sigma: Array,
    rows: Sequence[int],
    derived: Sequence[int] = (),
    t: Array | None = None,
) -> csr_array:
    """Covariance of the weak residual from noise on the measured channels.

    Parameters
    ----------
    functions : TestFunctions
        K test functions over N samples.
    slopes : Entries
        Derivative of the 5n pointwise rows in the 2n measured poses and velocities, at the samples.
    sigma : (2n,) or (N, 2n) array
        Standard deviations of the measured channels, the same at all samples or not.
    rows : sequence of int
        Equations that are used, among the 2n (forces first, then kinematics).
    derived : sequence of int
        Channels that are the time derivative of a pose: their noise is that of the pose, differentiated.
    t : (N,) array, optional
        Time of the samples, s; needed with `derived`.

    Returns
    -------
    sparse (K len(rows), K len(rows))
        Ordered by test function, then by equation.
    """
    n = sigma.shape[-1] // 2
    block = slopes.row // n
    equation = slopes.row % n + np.where((block == 2) | (block == 3), n, 0)
    weights = _on_one_pattern(functions)
    pattern = weights[0]
    felt: list[list[tuple[int, int, Array]]] = [[], []]
    for row in rows:
        for channel in range(2 * n):
            chosen = np.flatnonzero((equation == row) & (slopes.column == channel))
            level = sigma[..., channel - n if channel in derived else channel]
            if level.ndim:
                level = level[pattern.indices]
            if np.all(level > 0) and len(chosen):
                terms = (weights[_WEIGHTS[block[e]]].data * slopes.data[pattern.indices, e] for e in chosen)
                felt[channel in derived].append((rows.index(row), channel, level * sum(terms)))
    measured = _stacked(felt[0], pattern, len(rows), 2 * n)
    covariance = measured @ measured.T
    if felt[1] and t is not None:
        rates = _stacked(felt[1], pattern, len(rows), 2 * n) @ kron(_difference(t), eye_array(2 * n))
        covariance = covariance + rates @ rates.T
    return csr_array(covariance)


def _difference(t: Array) -> csr_array:
    """Central differences of a signal at the samples, shape (N, N)."""
    count = len(t)
    after, before = np.minimum(np.arange(count) + 1, count - 1), np.maximum(np.arange(count) - 1, 0)
    step = 1.0 / (t[after] - t[before])
    place = np.tile(np.arange(count), 2)
    return csr_array((np.concatenate([step, -step]), (place, np.concatenate([after, before]))))


# Which test weights (value, rate, held) a block of pointwise rows meets.
_WEIGHTS = (1, 0, 1, 0, 2)


def _on_one_pattern(functions: TestFunctions) -> list[csr_array]:
    """Weights of value, rate and held with explicit zeros, so that all have the same nonzeros."""
    parts = [functions.value, functions.rate, functions.held]
    one = csr_array(sum(abs(w) for w in parts))
    one.sort_indices()
    one.data[:] = 1.0  # some weights are so small that a share of them would be lost as zero
    found = []
    for w in parts:
        padded = csr_array((1e-300 * one) + w)
        padded.sort_indices()
        found.append(padded)
    return found


def _stacked(felt: list[tuple[int, int, Array]], pattern: csr_array, rows: int, channels: int) -> csr_array:
    """Sensitivities of all rows (K rows) to all samples (N channels), stacked from their blocks."""
    count, samples = pattern.shape
    shape = (count * rows, samples * channels)
    if not felt:
        return csr_array(shape)
    function = np.repeat(np.arange(count), np.diff(pattern.indptr))
    place = np.concatenate([function * rows + row for row, _, _ in felt])
    across = np.concatenate([pattern.indices * channels + channel for _, channel, _ in felt])
    return csr_array((np.concatenate([d for _, _, d in felt]), (place, across)), shape=shape)
