"""Whether what a model leaves is noise: its correlation with itself and with the inputs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from undertow.typing import Array

LAGS = 20


@dataclass(frozen=True)
class Whiteness:
    """Autocorrelation of a series and the test of Ljung and Box (1978) on it.

    Attributes
    ----------
    autocorrelation : (lags,) array
        At lags 1, 2 ...
    statistic : float
        Q = n (n + 2) sum of autocorrelation^2 / (n - lag).
    p_value : float
        Chance of a Q at least as large if the series is white.
    """

    autocorrelation: Array
    statistic: float
    p_value: float


def whiteness(r: Array, segment: NDArray[np.intp], lags: int = LAGS) -> Whiteness:
    """Test a series for whiteness; products never reach across a gap.

    Parameters
    ----------
    r : (K,) array
        Series.
    segment : (K,) array of int
        Stretch without gaps that each entry belongs to.
    lags : int
        Lags that are looked at, at most a quarter of the series.
    """
    count = len(r)
    lags = min(lags, count // 4)
    centred = r - r.mean()
    power = float(np.sum(centred**2))
    if lags < 1 or power == 0.0:
        return Whiteness(np.zeros(0), 0.0, 1.0)
    rho = np.array([_product(centred, segment, k) for k in range(1, lags + 1)]) / power
    q = float(count * (count + 2) * np.sum(rho**2 / (count - np.arange(1, lags + 1))))
    return Whiteness(rho, q, float(chdtrc(lags, q)))


def _product(r: Array, segment: NDArray[np.intp], lag: int) -> float:
    return float(np.sum((r[lag:] * r[:-lag])[segment[lag:] == segment[:-lag]]))


def correlation(a: Array, b: Array) -> float:
    """Correlation coefficient of two series; zero where one is constant."""
    x, y = a - a.mean(), b - b.mean()
    power = float(np.sqrt(np.sum(x**2) * np.sum(y**2)))
    return float(np.sum(x * y)) / power if power > 0 else 0.0
