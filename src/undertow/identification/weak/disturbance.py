"""What a model leaves beyond the noise of the sensors, as a white disturbance in each equation."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from undertow.typing import Array

from .data import WeakData
from .noise import Whitening
from .residual import Linearised, WeakModel, whitened

if TYPE_CHECKING:
    from .fit import WeakFit

_MATCHING_STEPS = 4
# Largest mean square of an equation that still counts as noise of the channels.
_NOISE_EXPLAINS = 1.6


def mean_square(r: Array, data: WeakData) -> Array:
    """Mean square of a whitened residual for each of the 2n equations; 1 is the noise floor."""
    size = len(data.names)
    total = np.bincount(data.equation, weights=r**2, minlength=size)
    count = np.bincount(data.equation, minlength=size)
    return np.divide(total, count, out=np.full(size, np.nan), where=count > 0)


def disturbed(quiet: list[Whitening], disturbance: Array, data: WeakData) -> list[Whitening]:
    """A noise model with a disturbance of the given intensity in each equation."""
    level = disturbance[list(data.rows)]
    return [
        w.with_disturbance(np.tile(level, s.functions.count))
        for w, s in zip(quiet, data.segments, strict=True)
    ]


def first_guess(model: WeakModel, data: WeakData, p: Array) -> Array:
    """Intensity that would explain the raw residual of the unfitted model all by itself."""
    raw = np.concatenate([part.r for part in model.linearise(data, p)])
    lengths = [float(np.mean(s.functions.held.sum(axis=1))) for s in data.segments]
    return np.nan_to_num(mean_square(raw, data)) / float(np.mean(lengths))


def matched_disturbance(fit: WeakFit, quiet: list[Whitening]) -> Array:
    """Intensity in each equation that makes the whitened residual of a fit have unit mean square.

    Zero where the noise of the channels explains the residual by itself.
    """
    data = fit.data
    parts = fit.model.linearise(data, fit.p)
    if fits_noise(whitened(parts, quiet), data):
        return np.zeros(len(data.names))
    level = np.maximum(fit.disturbance, 1e-12 * np.max(fit.disturbance, initial=1e-30))
    for _ in range(_MATCHING_STEPS):
        square = mean_square(whitened(parts, disturbed(quiet, level, data)).r, data)
        level = level * np.clip(np.nan_to_num(square, nan=1.0) ** 1.5, 0.02, 50.0)
    return np.asarray(level)


def fits_noise(at: Linearised, data: WeakData) -> bool:
    return bool(np.nanmax(mean_square(at.r, data)) < _NOISE_EXPLAINS)
