"""A frequency that stands out of a residual: found on the data of a fit, confirmed on data kept aside."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import gamma

from undertow.typing import Array, Index

# Points of the grid for each frequency that a run of that length can tell from the next.
_FINE = 8
_FEWEST_PERIODS = 3.0
# Median over mean of a power that is scattered like that of noise.
_MEDIAN = float(np.log(2.0))
_BAND = 0.1


@dataclass(frozen=True)
class Series:
    """A series on the clock of its runs.

    Attributes
    ----------
    t, r : (K,) array
        Time, s, and value, in units of its noise.
    run : (K,) array of int
        Run of each entry.
    """

    t: Array
    r: Array
    run: Index

    @property
    def runs(self) -> list[Series]:
        """Every run by itself."""
        chosen = [self.run == i for i in np.unique(self.run)]
        return [Series(self.t[k], self.r[k], self.run[k]) for k in chosen]

    @property
    def length(self) -> float:
        """Length of the longest run, s."""
        return max(float(np.ptp(s.t)) for s in self.runs)


@dataclass(frozen=True)
class Peak:
    """A frequency that stands out.

    Attributes
    ----------
    frequency : float
        Hz.
    gain : float
        Sum of squares of the kept-aside series in its band, above that of the neighbouring frequencies.
    chance : float
        Chance of so high a power at this frequency on kept-aside data when it does not stand out.
    """

    frequency: float
    gain: float
    chance: float


def highest_peak(fitted: Series, aside: Series, fastest: float) -> Peak | None:
    """The frequency with most power above that of its neighbours; None where no run is long enough.

    Parameters
    ----------
    fitted, aside : Series
        Data of a fit, and data kept aside; phases may differ from run to run.
    fastest : float
        Highest frequency that the series resolve, Hz.
    """
    slowest = _FEWEST_PERIODS / min(fitted.length, aside.length)
    if slowest >= 0.5 * fastest:
        return None
    grid = np.arange(slowest, fastest, 1.0 / (_FINE * max(fitted.length, aside.length)))
    first, second = power(fitted, grid), power(aside, grid)
    place = int(np.argmax(first / _neighbours(first, grid)))
    frequency = _summit(grid, first + second, place)
    gain = _band_gain(second, frequency, grid, aside.length)
    return Peak(frequency, gain, _chance(second, grid, place, len(aside.runs)))


def power(series: Series, grid: Array) -> Array:
    """Sum of squares that a sine of each frequency takes away, over all runs, phases free."""
    return np.asarray(sum(_power(s, grid) for s in series.runs))


def _power(s: Series, grid: Array) -> Array:
    wave = np.exp(-2j * np.pi * np.outer(grid, s.t - s.t[0]))
    return np.asarray(2.0 / len(s.t) * np.abs(wave @ s.r) ** 2)


def _neighbours(power: Array, grid: Array) -> Array:
    """Mean power that the neighbourhood suggests: from the median within a factor of two in frequency."""
    coarse = grid[::_FINE]
    low, high = np.searchsorted(grid, coarse / 2), np.searchsorted(grid, coarse * 2)
    medians = [np.median(power[a:b]) for a, b in zip(low, high, strict=True)]
    return np.asarray(np.interp(grid, coarse, medians) / _MEDIAN)


def _summit(grid: Array, power: Array, place: int) -> float:
    """Highest point of both data sets together within the width of the line."""
    near = slice(max(place - _FINE, 0), place + _FINE + 1)
    return float(grid[near][np.argmax(power[near])])


def _chance(power: Array, grid: Array, place: int, runs: int) -> float:
    """Chance of the highest power within the width of the line, about three independent draws."""
    near = slice(max(place - _FINE, 0), place + _FINE + 1)
    ratio = np.max(power[near]) / _neighbours(power, grid)[place]
    return float(min(1.0, 3 * gamma.sf(runs * ratio, runs)))


def _band_gain(power: Array, frequency: float, grid: Array, length: float) -> float:
    """Sum of squares in the band around a frequency, above that of the neighbours."""
    excess = power - _neighbours(power, grid)
    wide = max(_BAND * frequency, 1.5 / length)
    return max(float(np.sum(excess[np.abs(grid - frequency) < wide])) / _FINE, 0.0)


def without_waves(r: Array, waves: Array, run: Index) -> tuple[Array, Array]:
    """A series less what a cosine and a sine take away in every run, and their coefficients.

    Parameters
    ----------
    r : (K,) array
        Series.
    waves : (K, 2) array
        What a cosine and a sine of unit amplitude add to it.
    run : (K,) array of int
        Run of each entry.

    Returns
    -------
    (K,) array, (runs, 2) array
        What is left, and the coefficients in each run.
    """
    left, found = r.copy(), []
    for i in np.unique(run):
        k = run == i
        coefficients = -np.linalg.lstsq(waves[k], r[k], rcond=None)[0]
        left[k] += waves[k] @ coefficients
        found.append(coefficients)
    return left, np.array(found)
