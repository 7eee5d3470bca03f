"""Consistency of a filter: NEES, NIS and whiteness of innovations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import chdtrc
from scipy.stats import chi2

from undertow.typing import Array, Index

if TYPE_CHECKING:
    from .filters import Estimate


@dataclass(frozen=True)
class ConsistencySettings:
    """Numbers of the tests."""

    level: float = 0.95  # of the bounds
    rejected: float = 0.01  # probability below which innovations are not white
    lags: int = 20  # of the Ljung-Box test at most
    per_lag: int = 5  # reports for every lag at least
    burn_in: int = 10  # reports of a channel at first, which say more about the first guess than the filter


SETTINGS = ConsistencySettings()


@dataclass(frozen=True)
class Normalised:
    """A mean of normalised squared errors, which is one for a consistent filter."""

    name: str  # the channel, or "all"
    # mean of the squares for each degree of freedom: above the bounds the filter thinks itself better than it
    # is, below them worse
    mean: float
    # low, high: bounds of the chi-squared distribution for an honest filter
    low: float
    high: float
    count: int  # squares that it is taken of

    @property
    def consistent(self) -> bool:
        """Whether the mean is within the bounds."""
        return self.low <= self.mean <= self.high


@dataclass(frozen=True)
class Whiteness:
    """The Ljung-Box test of the innovations of a channel."""

    name: str  # the channel
    lags: int  # lags that are looked at
    # statistic, p_value: the sum, chi-squared with as many degrees of freedom as lags for white innovations,
    # and the probability that chance gives as much
    statistic: float
    p_value: float

    @property
    def white(self) -> bool:
        """Whether chance explains the correlations."""
        return self.p_value >= SETTINGS.rejected


def _normalised(name: str, squares: Array) -> Normalised:
    k = len(squares)
    tail = (1 - SETTINGS.level) / 2
    low, high = (float(chi2.ppf(tail, k)) / k, float(chi2.ppf(1 - tail, k)) / k) if k else (0.0, np.inf)
    return Normalised(name, float(np.mean(squares)) if k else np.nan, low, high, k)


def innovations(found: Estimate, channel: int) -> Array:
    """Normalised innovations of the accepted reports of a channel, in order of time, without the first."""
    used = found.used[:, channel]
    e, s = found.innovation[used, channel], found.variance[used, channel]
    return (e / np.sqrt(s))[SETTINGS.burn_in :]


def nis(found: Sequence[Estimate], channels: tuple[str, ...]) -> tuple[Normalised, ...]:
    """Normalised innovation squared of every channel that reports, and of all (Bar-Shalom et al. 2001).

    Over all of some logs.
    """
    each = {n: np.concatenate([innovations(one, i) for one in found]) ** 2 for i, n in enumerate(channels)}
    each = {n: squares for n, squares in each.items() if len(squares)}
    whole = np.concatenate(list(each.values())) if each else np.empty(0)
    return (*(_normalised(n, squares) for n, squares in each.items()), _normalised("all", whole))


def whiteness(found: Sequence[Estimate], channels: tuple[str, ...]) -> tuple[Whiteness, ...]:
    """The Ljung-Box test for every channel with reports enough (Ljung and Box 1978).

    Over all of some logs: statistics of logs that are independent add up, and so do their degrees of freedom.
    """
    tests = []
    for i, name in enumerate(channels):
        series = [e for e in (innovations(one, i) for one in found) if len(e) >= 2 * SETTINGS.per_lag]
        each = [ljung_box(e, min(SETTINGS.lags, len(e) // SETTINGS.per_lag)) for e in series]
        if each:
            lags, statistic = sum(len(t.autocorrelation) for t in each), sum(t.statistic for t in each)
            tests.append(Whiteness(name, lags, statistic, float(chdtrc(lags, statistic))))
    return tuple(tests)


@dataclass(frozen=True)
class LjungBox:
    """The test of a series for whiteness by Ljung and Box (1978)."""

    autocorrelation: Array  # (lags,) at lags 1, 2, ...
    statistic: float  # Q = n (n + 2) sum of autocorrelation^2 / (n - lag)
    p_value: float  # chance of a Q at least as large if the series is white


def ljung_box(r: Array, lags: int, piece: Index | None = None) -> LjungBox:
    """Test a series of mean zero, shape (n,); products never reach from one piece to another."""
    n, power = len(r), float(r @ r)
    if lags < 1 or power == 0.0:
        return LjungBox(np.zeros(0), 0.0, 1.0)
    of = np.zeros(n, dtype=np.intp) if piece is None else piece
    products = [float(np.sum((r[k:] * r[:-k])[of[k:] == of[:-k]])) for k in range(1, lags + 1)]
    rho = np.array(products) / power
    q = float(n * (n + 2) * np.sum(rho**2 / (n - np.arange(1, lags + 1))))
    return LjungBox(rho, q, float(chdtrc(lags, q)))
