"""Rates of measured signals with outliers and gaps: from a signal to lanes of the smoother, and back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from undertow.identification.logs.smoother import ORDER, Lanes, States, most_likely_ratio, smooth
from undertow.typing import Array, Flags

LOST = 0.5  # s; a longer time without a sample is lost tracking, and what happened in it is unknown
_LOST_STEPS = 4.0  # ... or this many usual steps, for slow logs
_CORE = 1000  # samples of a lane that are kept
_LIKELY_LANES = 6  # lanes the likelihood is taken from
_SMALL = 0.01  # of the usual change between samples: an error too small to matter
_LIMIT = 6.0  # robust standard deviations beyond which a sample is an outlier
_ROUNDS = 40
_APART = 3  # samples; what is found at once lies at least this far apart
_ESTIMATES = 6  # times the noise is estimated anew after outliers were taken out
_LANES_AT_ONCE = 96
_UNCERTAIN = 10.0  # times the median standard deviation: such a rate is as good as unknown
_NORMAL = 1.4826  # standard deviation of a normal distribution over its median absolute deviation

Stretch = tuple[int, int]


@dataclass(frozen=True)
class Track:
    """A smoothed signal.

    Attributes
    ----------
    value, rate : (n,) arrays
        The signal and its time derivative; the rate is NaN where tracking was lost.
    value_sd, rate_sd : (n,) arrays
        Standard deviations of both.
    outlier : (n,) bool array
        Samples that were not believed.
    jump : (n,) bool array
        Samples where the signal was shifted since the sample before (a change of camera, a new satellite).
    lost : list of (float, float)
        Start and end in s of the times without samples.
    noise : float
        Standard deviation of the measurement noise.
    resolution : float
        Time constant of the smoother in s: a sine of angular frequency w is passed on by the factor
        1 / (1 + (w resolution)^6).
    """

    value: Array
    rate: Array
    value_sd: Array
    rate_sd: Array
    outlier: Flags
    jump: Flags
    lost: list[tuple[float, float]]
    noise: float
    resolution: float


@dataclass
class _Signal:
    """The samples that are believed so far, and the jumps found."""

    t: Array
    y: Array
    jump: Flags

    def _breaks(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        index = np.flatnonzero(np.isfinite(self.y))
        step = np.diff(self.t[index])
        return index, np.flatnonzero(step > max(LOST, _LOST_STEPS * float(np.median(step))))

    def lost(self) -> list[tuple[float, float]]:
        """Return the times without a sample for too long, at the ends of the signal too."""
        index, breaks = self._breaks()
        spells = [(float(self.t[index[k]]), float(self.t[index[k + 1]])) for k in breaks]
        ends = [(float(self.t[0]), float(self.t[index[0]])), (float(self.t[index[-1]]), float(self.t[-1]))]
        before, after = ([spell] if spell[1] - spell[0] > LOST else [] for spell in ends)
        return before + spells + after

    def stretches(self) -> list[Stretch]:
        """Return what lies between them; what is too short for a rate is left out."""
        index, breaks = self._breaks()
        parts = [part for part in np.split(index, breaks + 1) if len(part) > 2 * ORDER]
        if not parts:
            raise ValueError(f"no {2 * ORDER + 1} samples without a gap of more than {LOST:g} s between them")
        return [(int(part[0]), int(part[-1]) + 1) for part in parts]

    def lanes(self, cuts: list[Stretch]) -> Lanes:
        step = np.diff(self.t, prepend=self.t[0]) / _usual_step(self.t)
        shape = (max(stop - start for start, stop in cuts), len(cuts))
        result = Lanes(np.full(shape, np.nan), np.ones(shape), np.zeros(shape, dtype=bool))
        for lane, (start, stop) in enumerate(cuts):
            for part, whole in ((result.y, self.y), (result.step, step), (result.jump, self.jump)):
                part[: stop - start, lane] = whole[start:stop]
        return result

    def likely(self) -> tuple[float, float]:
        """Return ratio and noise variance, from some long pieces spread over the signal."""
        cuts = sorted(_cut(self.stretches(), _CORE), key=lambda cut: cut[0] - cut[1])[: 4 * _LIKELY_LANES]
        spread = np.linspace(0, len(cuts) - 1, min(_LIKELY_LANES, len(cuts))).round().astype(int)
        return most_likely_ratio(self.lanes([cuts[k] for k in spread]))

    def smoothed(self, ratio: float) -> tuple[States, Array]:
        """Smooth all stretches, long ones in pieces that overlap by many times the memory of the smoother."""
        overlap = int(np.clip(12 * ratio ** (-1 / (2 * ORDER)), 30, 1000))
        cores = [
            (core, stretch)
            for stretch in self.stretches()
            for core in _cut([stretch], max(_CORE, 2 * overlap))
        ]
        wide = [
            (max(low, start - overlap), min(high, stop + overlap)) for (start, stop), (low, high) in cores
        ]
        n = len(self.y)
        mean, covariance, shock = (np.full(shape, np.nan) for shape in ((n, ORDER), (n, ORDER, ORDER), (n,)))
        for first in range(0, len(cores), _LANES_AT_ONCE):
            group = range(first, min(first + _LANES_AT_ONCE, len(cores)))
            state, shocks = smooth(self.lanes([wide[k] for k in group]), np.full(len(group), ratio))
            for lane, k in enumerate(group):
                (start, stop), skip = cores[k][0], wide[k][0]
                for whole, part in ((mean, state.mean), (covariance, state.covariance), (shock, shocks)):
                    whole[start:stop] = part[start - skip : stop - skip, lane]
        return States(mean, covariance), shock


def track(t: Array, y: Array) -> Track:
    """Smooth a signal and take its rate.

    Parameters
    ----------
    t : (n,) array
        Time in s.
    y : (n,) array
        Signal, NaN where there is no sample.

    Raises
    ------
    ValueError
        If there are too few samples together.
    """
    signal = _Signal(t, y.copy(), np.zeros(len(y), dtype=bool))
    signal.y[_gross_outliers(t, y)] = np.nan
    for _ in range(_ESTIMATES):
        ratio, variance = signal.likely()
        changed, state = _cleaned(signal, ratio, max(float(np.sqrt(variance)), _SMALL * _usual_change(y)))
        if not changed:
            break
    step = _usual_step(t)
    spread = np.sqrt(variance * np.maximum(np.diagonal(state.covariance, axis1=-2, axis2=-1), 0.0))
    rate, rate_sd = state.mean[:, 1] / step, spread[:, 1] / step
    unknown = ~(rate_sd <= _UNCERTAIN * np.nanmedian(rate_sd))
    rate[unknown] = rate_sd[unknown] = np.nan
    outlier = np.isnan(signal.y) & np.isfinite(y)
    return Track(
        state.mean[:, 0],
        rate,
        spread[:, 0],
        rate_sd,
        outlier,
        signal.jump,
        signal.lost(),
        float(np.sqrt(variance)),
        step * ratio ** (-1 / (2 * ORDER)),
    )


def _usual_step(t: Array) -> float:
    return float(np.median(np.diff(t)))


def _usual_change(y: Array) -> float:
    return float(np.median(np.abs(np.diff(y[np.isfinite(y)]))))


def _gross_outliers(t: Array, y: Array) -> Flags:
    """Find single wild samples by comparing each with the cubic through its four neighbours.

    They would spoil the likelihood. A shift, which stands out on either side alike, is left to it.
    """
    index = np.flatnonzero(np.isfinite(y))
    seen, result = y[index], np.zeros(len(y), dtype=bool)
    if len(seen) < 2 * ORDER:
        return result
    close = t[index[4:]] - t[index[:-4]] < 6 * _usual_step(t)
    odd = np.zeros(len(seen))
    odd[2:-2] = np.abs(seen[2:-2] - (4 * (seen[1:-3] + seen[3:-1]) - seen[:-4] - seen[4:]) / 6) * close
    limit = max(5 * _LIMIT * _NORMAL * float(np.median(odd[2:-2])), 2 * _usual_change(y))
    beside = np.maximum(np.roll(odd, 1), np.roll(odd, -1))
    result[index[_peaks(odd, limit, _APART) & (odd > 1.25 * beside)]] = True
    return result


def _peaks(size: Array, limit: float, apart: int) -> Flags:
    """Tell which entries are above the limit and the largest among `apart` neighbours on either side."""
    padded = np.pad(size, apart, constant_values=-np.inf)
    around = np.lib.stride_tricks.sliding_window_view(padded, 2 * apart + 1).max(axis=-1)
    return (size > limit) & (size >= around) & (limit > 0)


def _cleaned(signal: _Signal, ratio: float, noise: float) -> tuple[bool, States]:
    """Take out what cannot be motion, the worst of each neighbourhood first, until nothing stands out."""
    # A wild sample or a shift bends the smoother on both sides, as far as its memory reaches.
    apart = int(np.clip(4 * ratio ** (-1 / (2 * ORDER)), _APART, 20 * _APART))
    changed = False
    for _ in range(_ROUNDS):
        state, shock = signal.smoothed(ratio)
        outlier, jump = _odd(signal, state, shock, noise, apart)
        if not (outlier | jump).any():
            break
        changed = True
        signal.y[outlier] = np.nan
        signal.jump |= jump
    return changed, state


def _odd(signal: _Signal, state: States, shock: Array, noise: float, apart: int) -> tuple[Flags, Flags]:
    """Find samples that the others contradict, and jumps: whichever of the two explains more at its place."""
    residual = np.nan_to_num(signal.y - state.mean[:, 0])
    # the residual of a sample has variance 1 - P; over its square root it is the deletion residual,
    # standardised
    own = np.nan_to_num(1.0 - state.covariance[:, 0, 0], nan=1.0)
    alone = np.abs(residual) / np.sqrt(np.maximum(own, 1e-3))
    shift = np.where(signal.jump, 0.0, np.abs(np.nan_to_num(shock)))
    limit = _LIMIT * max(noise, _NORMAL * float(np.median(alone[np.isfinite(signal.y)])))
    peak = _peaks(np.maximum(alone, shift), limit, apart)
    return peak & (alone >= shift) & np.isfinite(signal.y), peak & (shift > alone)


def _cut(stretches: list[Stretch], length: int) -> list[Stretch]:
    return [(at, min(at + length, stop)) for start, stop in stretches for at in range(start, stop, length)]
