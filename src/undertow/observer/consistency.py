"""Whether a filter is as good as it says: NEES, NIS and the whiteness of innovations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from undertow.typing import Array

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
    """A mean of normalised squared errors, which is one for an honest filter."""

    name: str  # the channel, or "all"
    # mean of the squares for each degree of freedom: above the bounds the filter thinks itself better than it
    # is, below them worse
    mean: float
    # low, high: bounds of the chi-squared distribution for an honest filter
    low: float
    high: float
    count: int  # squares that it is taken of

    @property
    def honest(self) -> bool:
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

    Over all of some logs: statistics of logs that do not know each other add up, and so do their degrees of
    freedom.
    """
    tests = []
    for i, name in enumerate(channels):
        each = [ljung_box(name, e) for e in (innovations(one, i) for one in found) if _enough(e)]
        if each:
            lags, statistic = sum(one.lags for one in each), sum(one.statistic for one in each)
            tests.append(Whiteness(name, lags, statistic, float(chi2.sf(statistic, lags))))
    return tuple(tests)


def _enough(e: Array) -> bool:
    return len(e) >= 2 * SETTINGS.per_lag


def ljung_box(name: str, e: Array) -> Whiteness:
    """The test of one series, shape (n,), whose mean is zero if the filter is right."""
    n = len(e)
    lags = max(min(SETTINGS.lags, n // SETTINGS.per_lag), 1)
    power = float(e @ e) or 1.0
    r = np.array([e[k:] @ e[:-k] for k in range(1, lags + 1)]) / power
    statistic = float(n * (n + 2) * np.sum(r**2 / (n - np.arange(1, lags + 1))))
    return Whiteness(name, lags, statistic, float(chi2.sf(statistic, lags)))
