"""What a model predicts over windows, beside what was measured."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from undertow.typing import Array

from .cutting import Windows


@dataclass(frozen=True)
class Prediction:
    """What a model predicts over windows, beside what was measured.

    Attributes
    ----------
    windows : Windows
        The windows, with the measurement.
    predicted : (b, k, 2n) array
        Reported pose and velocity by the model; NaN in the padding and from where a simulation diverged.
    """

    windows: Windows
    predicted: Array

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the 2n channels, pose then velocity."""
        return self.windows.names

    @cached_property
    def residual(self) -> Array:
        """Measured minus predicted, shape (b, k, 2n); NaN where there is nothing to compare."""
        return self.windows.measured - self.predicted

    @cached_property
    def diverged(self) -> int:
        """Number of windows in which the simulation diverged."""
        lost = ~np.isfinite(self.predicted).all(axis=2) & self.windows.inside
        return int(lost.any(axis=1).sum())

    @cached_property
    def rms(self) -> dict[str, float]:
        """Root mean square of the residual by channel, in its unit; inf if a window diverged."""
        return self._by_channel(np.inf if self.diverged else _rms(self.residual[:, 1:]))

    @cached_property
    def normalised(self) -> dict[str, float]:
        """`rms` over the noise of the channel: 1 is as good as can be."""
        noise = np.maximum(self.windows.sigma, 1e-300)
        pairs = zip(self.rms.items(), noise[self._there].tolist(), strict=True)
        return {name: rms / sigma for (name, rms), sigma in pairs}

    @cached_property
    def relative(self) -> dict[str, float]:
        """`rms` over the root mean square of the measurement, for the velocities: 0.05 is five per cent."""
        size = _rms(self.windows.measured[:, 1:])
        half = len(self.names) // 2
        sizes = dict(zip(self.names[half:], size[half:], strict=True))
        return {n: self.rms[n] / float(s) for n, s in sizes.items() if s > 0}

    @cached_property
    def fit(self) -> dict[str, float]:
        """Share of the variation that is predicted, by channel, %: 100 is perfect, 0 is as a mean."""
        centred = self.windows.measured[:, 1:].copy()
        for run in np.unique(self.windows.run):
            inside = self.windows.run == run
            centred[inside] -= _mean(centred[inside])
        size = self._by_channel(_rms(centred))
        return {n: 100.0 * (1.0 - self.rms[n] / s) for n, s in size.items() if s > 0}

    @cached_property
    def _there(self) -> NDArray[np.intp]:
        return np.flatnonzero(np.isfinite(self.windows.measured).any(axis=(0, 1)))

    def _by_channel(self, values: Array | float) -> dict[str, float]:
        table = np.broadcast_to(values, len(self.names))
        return {self.names[i]: float(table[i]) for i in self._there}


def prediction_error(prediction: Prediction) -> float:
    """One number: geometric mean over the degrees of freedom of the relative error of the velocities.

    0.05 is five per cent; the noise of the sensors is in it. `Prediction.relative` holds the parts.
    """
    parts = np.array(list(prediction.relative.values()))
    return float(np.exp(np.mean(np.log(np.maximum(parts, 1e-12))))) if len(parts) else float("nan")


def _mean(values: Array) -> Array:
    """Mean of each channel over what there is; NaN for a channel with nothing."""
    there = np.isfinite(values)
    count = there.sum(axis=(0, 1))
    total = np.sum(np.where(there, values, 0.0), axis=(0, 1))
    return np.divide(total, count, out=np.full(count.shape, np.nan), where=count > 0)


def _rms(values: Array) -> Array:
    with np.errstate(over="ignore"):  # a simulation on its way to infinity
        return np.sqrt(_mean(values**2))
