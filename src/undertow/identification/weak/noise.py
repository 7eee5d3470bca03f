"""How noisy the channels are, and what that noise does to the weak residual."""

from __future__ import annotations

from copy import copy
from functools import cached_property
from math import comb

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky_banded
from scipy.sparse import csr_array, diags_array, eye_array, kron

from undertow.typing import Array

from .covariance import banded, banded_sum, unbanded
from .sums import solved
from .testfunctions import TestFunctions

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
    covariance : (b, m) array
        Covariance of the residual from the noise of the channels, rows ordered by test function,
        then by equation; its lower half in LAPACK's banded storage.
    overlap : (b, m) array
        Integrals of products of test functions of the same equation: the covariance of a white disturbance.
    intensity : (m,) array
        Intensity of the disturbance in each row's equation: what the model leaves beyond the noise.
    """

    def __init__(self, covariance: Array, overlap: Array, intensity: Array) -> None:
        self._bands = covariance, overlap
        self._take(intensity)

    def _take(self, intensity: Array) -> None:
        """Factor with a disturbance."""
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
        other._take(intensity)
        return other

    def __call__(self, right: Array) -> Array:
        """Whitened residuals or Jacobian columns, shape (m,) or (m, k)."""
        table = np.asarray(right)
        return solved(self._factor, table.reshape(len(table), -1)).reshape(table.shape)

    def noise_sample(self, rng: np.random.Generator) -> Array:
        """What the noise of the channels alone would look like after whitening: one draw, shape (m,)."""
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
