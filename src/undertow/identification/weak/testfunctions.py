"""Test functions: cubic B-splines on an even grid of knots, and the quadrature that goes with them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.sparse import csr_array

Array = NDArray[np.float64]
Index = NDArray[np.intp]
DEGREE = 3
SAMPLES_PER_KNOT = 5


@dataclass(frozen=True)
class TestFunctions:
    """Quadrature weights of K test functions phi over the N samples of a segment.

    Attributes
    ----------
    value : sparse (K, N)
        Weights for the integral of phi times a smooth signal.
    rate : sparse (K, N)
        Weights for the integral of d(phi)/dt times a smooth signal.
    held : sparse (K, N)
        Exact integrals of phi over [t_i, t_i+1), for signals held between samples.
    centre : (K,) array
        Middle of each support, s.
    """

    value: csr_array
    rate: csr_array
    held: csr_array
    centre: Array

    __test__ = False  # not a pytest class

    @property
    def count(self) -> int:
        """Number of test functions."""
        return len(self.centre)


def knot_spacing(t: Array) -> float:
    """Spacing of knots for a clock: a few samples, so that all that the sampling resolves is seen."""
    return float(SAMPLES_PER_KNOT * np.median(np.diff(t)))


def test_functions(t: Array, spacing: float) -> TestFunctions | None:
    """B-splines whose whole support lies within the segment; None if it is too short for a single one.

    Parameters
    ----------
    t : (N,) array
        Sample times, s.
    spacing : float
        Distance of the knots, s; the support of a function is four times that.
    """
    count = int((t[-1] - t[0]) / spacing + 1e-9) - DEGREE
    if count < 1:
        return None
    place = (t - t[0]) / spacing
    weight = _trapezoid(t)
    return TestFunctions(
        value=_banded(lambda s, i: _PHI(s) * weight[i], place, count),
        rate=_banded(lambda s, i: _PHI_RATE(s) * weight[i] / spacing, place, count),
        held=_banded(lambda s, i: spacing * _step_integral(s, place, i), place, count, reach=2),
        centre=t[0] + spacing * (np.arange(count) + (DEGREE + 1) / 2),
    )


test_functions.__test__ = False  # type: ignore[attr-defined]

_SUPPORT = np.arange(DEGREE + 2.0)
_PHI = BSpline.basis_element(_SUPPORT, extrapolate=False)
_PHI_RATE = _PHI.derivative()
_PHI_INTEGRAL = _PHI.antiderivative()


def _banded(entry: Callable[[Array, Index], Array], place: Array, count: int, reach: int = 0) -> csr_array:
    """Sparse (count, N) matrix of entry(s, i), s = place_i - k, for samples in the support of k."""
    rows, columns, values = [], [], []
    first = np.floor(place).astype(np.intp)
    for offset in range(-reach, DEGREE + 1):
        k = first - offset
        index = np.flatnonzero((k >= 0) & (k < count))
        rows.append(k[index])
        columns.append(index)
        values.append(np.nan_to_num(entry(place[index] - k[index], index)))
    shape = (count, len(place))
    return csr_array((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=shape)


def _step_integral(s: Array, place: Array, i: Index) -> Array:
    """Integral of phi from a sample to the next, in units of the spacing."""
    following = place[np.minimum(i + 1, len(place) - 1)] - place[i]
    return _total(s + following) - _total(s)


def _total(s: Array) -> Array:
    return np.asarray(_PHI_INTEGRAL(np.clip(s, 0.0, DEGREE + 1.0 - 1e-12)))


def _trapezoid(t: Array) -> Array:
    weight = np.zeros_like(t)
    step = np.diff(t)
    weight[:-1] += step / 2
    weight[1:] += step / 2
    return weight
