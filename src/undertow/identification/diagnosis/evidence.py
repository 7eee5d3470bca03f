"""How strong the evidence is: paired comparison of two models over blocks of kept-aside data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student
from scipy.stats import wilcoxon

from undertow.typing import Array

from ..weak.data import WeakData
from .trial import Score

# A fall of the mean square, in units of the noise, that is hidden in the noise.
SMALLEST_FALL = 0.05
# Chance below which the better of two models is held to be better.
_SURE = 0.01
# Mean square, in units of the noise, from which an equation counts as not explained by it.
_ABOVE_NOISE = 1.3


@dataclass(frozen=True)
class Comparison:
    """Fall of the mean square from one model to another, block by block.

    Attributes
    ----------
    mean : float
        Mean fall of the whitened mean square.
    interval : (float, float)
        95 % interval of the mean over blocks.
    p_value : float
        Chance of so consistent a fall when the models are equally good (Wilcoxon signed-rank test,
        one-sided).
    """

    mean: float
    interval: tuple[float, float]
    p_value: float

    def beyond_chance(self, rate: float, among: int = 1) -> bool:
        """Whether the fall is enough to matter and, the best among so many, no chance of this rate."""
        return among * self.p_value < rate and self.mean > SMALLEST_FALL


def compare_scores(worse: Score, better: Score, data: WeakData) -> Comparison:
    """Compare two models on the same data, both whitened by the same noise model."""
    fall = worse.r**2 - better.r**2
    block = data.block
    total, count = np.bincount(block, weights=fall), np.bincount(block)
    means = total / np.maximum(count, 1)
    return _summary(means)


def _summary(means: Array) -> Comparison:
    mean = float(np.mean(means))
    n = len(means)
    half = float(student.ppf(0.975, n - 1) * np.std(means, ddof=1) / np.sqrt(n)) if n > 1 else np.inf
    if np.allclose(means, 0.0):
        return Comparison(0.0, (0.0, 0.0), 1.0)
    return Comparison(mean, (mean - half, mean + half), float(wilcoxon(means, alternative="greater").pvalue))


def explained(before: Array, after: Array, noise: Array) -> float:
    """Share of what exceeds the noise of the sensors that went away, from mean squares by equation.

    Equations that the noise explains have no say; the others count by how far they are above it, in
    that one very bad equation does not hide the rest.
    """
    floor = np.maximum(noise, 1e-12)
    counted = np.nan_to_num(before / floor) > _ABOVE_NOISE
    if not np.any(counted):
        return 0.0
    first, last, floor = before[counted], after[counted], floor[counted]
    share = np.clip((first - np.maximum(last, floor)) / (first - floor), -1.0, 1.0)
    return float(np.average(share, weights=np.log(first / floor)))


def as_good(best: Score, other: Score, data: WeakData) -> bool:
    """Whether kept-aside data leave open which of two models is the better one."""
    gap = compare_scores(other, best, data)
    return gap.p_value > _SURE or gap.mean < SMALLEST_FALL
