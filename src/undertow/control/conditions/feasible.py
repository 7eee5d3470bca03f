"""Where a margin is positive: the values of iota, or of one gain, that satisfy conditions are an interval."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.optimize import brentq, minimize_scalar

Span = tuple[float, float]
_LOW, _HIGH, _POINTS = 1e-9, 1e9, 181


def where_positive(margin: Callable[[float], float], low: float = _LOW, high: float = _HIGH) -> Span | None:
    """The interval on which a margin of one positive number is positive, or None.

    Parameters
    ----------
    margin : callable
        Rises and then falls (either part may be missing); conditions are concave in iota and in each gain.
    low, high : float
        Where to look; an interval that reaches an end is open there, and 0 or infinity is returned for it.
    """
    peak = _peak(margin, math.log(low), math.log(high))
    if not margin(math.exp(peak)) > 0:
        return None
    return _edge(margin, peak, math.log(low), 0.0), _edge(margin, peak, math.log(high), math.inf)


def peak_of(margin: Callable[[float], float], low: float = _LOW, high: float = _HIGH) -> float:
    """Where such a margin is largest."""
    return math.exp(_peak(margin, math.log(low), math.log(high)))


def _peak(margin: Callable[[float], float], low: float, high: float) -> float:
    grid = np.linspace(low, high, _POINTS)
    values = [margin(math.exp(x)) for x in grid]
    best = int(np.argmax(values))
    around = float(grid[max(best - 1, 0)]), float(grid[min(best + 1, _POINTS - 1)])
    found = minimize_scalar(
        lambda x: -margin(math.exp(x)), bounds=around, method="bounded", options={"xatol": 1e-10}
    )
    return float(found.x) if -found.fun > values[best] else float(grid[best])


def _edge(margin: Callable[[float], float], peak: float, end: float, beyond: float) -> float:
    if margin(math.exp(end)) > 0:
        return beyond
    return math.exp(brentq(lambda x: margin(math.exp(x)), end, peak, xtol=1e-14, rtol=1e-14))


def inside(span: Span) -> float:
    """A number well within an interval."""
    low, high = span
    if low == 0.0 and math.isinf(high):
        return 1.0
    if low == 0.0:
        return high / 2
    return 2 * low if math.isinf(high) else math.sqrt(low * high)
