"""How strong the evidence is: paired comparison of two models over blocks of kept-aside data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student
from scipy.stats import wilcoxon

from ..weak.data import WeakData
from .trial import Score

Array = NDArray[np.float64]
_BLOCKS = 24
_LONGEST_BLOCK = 5.0
_SHORTEST_BLOCK = 1.0


@dataclass(frozen=True)
class Comparison:
    """Fall of the mean square from one model to another, block by block.

    Attributes
    ----------
    mean : float
        Mean fall, in units of what the better model leaves (its own mean square for each equation).
    interval : (float, float)
        95 % interval of the mean over blocks.
    p_value : float
        Chance of so consistent a fall when the models are equally good (Wilcoxon signed-rank test, one-sided).
    """

    mean: float
    interval: tuple[float, float]
    p_value: float


def block_seconds(data: WeakData) -> float:
    """Length of blocks: long against the memory of vehicles, short enough that there are enough of them."""
    total = sum(float(s.t[-1] - s.t[0]) for s in data.segments)
    return float(np.clip(total / _BLOCKS, _SHORTEST_BLOCK, _LONGEST_BLOCK))


def compare_scores(worse: Score, better: Score, data: WeakData) -> Comparison:
    """Compare two models on the same data.

    Every equation is weighed by what the better model leaves in it, at least by the noise.
    """
    scale = np.maximum(1.0, np.nan_to_num(better.mean_square, nan=1.0))[data.equation]
    fall = (worse.r**2 - better.r**2) / scale
    block = data.block(block_seconds(data))
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


def explained(before: float, after: float) -> float:
    """Share of the mean square above the noise floor that went away, from two normalised errors."""
    excess = before**2 - 1.0
    return float(np.clip((before**2 - max(after, 1.0) ** 2) / excess, -1.0, 1.0)) if excess > 0 else 0.0
