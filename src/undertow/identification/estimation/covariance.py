"""Covariances of estimates, and what counts as independent in a series of time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from undertow.typing import Array, Index


@dataclass(frozen=True)
class ClusterSettings:
    """Numbers by which stretches of time count as independent."""

    forgotten: float = 0.3  # autocorrelation below which a series has forgotten its past
    spreads: float = 2.0  # the same for short series, in standard deviations of that of white noise
    memories: float = 3.0  # length of an independent stretch in units of that time
    fewest: int = 6  # stretches that there have to be, however long the memory


SETTINGS = ClusterSettings()


def inverse_of(information: Array) -> Array:
    """Inverse of an information matrix; a direction that nothing determines gets a very large variance."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-100))
    scaled = information * np.outer(scale, scale) + 1e-12 * np.eye(len(scale))
    return np.linalg.inv(scaled) * np.outer(scale, scale)


def memory(series: Array) -> int:
    """Lag by which a series (K,) has forgotten its past; 1 for white noise."""
    limit = max(SETTINGS.forgotten, SETTINGS.spreads / np.sqrt(max(len(series), 1)))
    covariance = np.correlate(series, series, "full")[len(series) - 1 :]
    return int(np.argmax(covariance < limit * covariance[0])) or len(series)


def summed_scores(r: Array, J: Array, block: Index) -> Array:
    """J' r of the rows of each block, (blocks, k)."""
    scores = np.zeros((int(block.max(initial=0)) + 1, J.shape[1]))
    np.add.at(scores, block, J * r[:, None])
    return scores


def clustered(information: Array, scores: Array) -> Array:
    """Covariance of an estimate: never less than noise alone gives, and robust to correlated residuals.

    A sandwich estimator with clusters. `information` is J' J with what priors add; `scores` (groups, k) holds
    J' r of groups of residuals in the order of time. Neighbours are one cluster where what a parameter learns
    from one is correlated with what it learns from the next, as under a slow disturbance.
    """
    inverse = inverse_of(information)
    robust = np.array([_variance(part) for part in (scores @ inverse).T])
    inflation = np.sqrt(np.maximum(1.0, robust / np.maximum(np.diag(inverse), 1e-300)))
    return np.asarray(inverse * np.outer(inflation, inflation))


def _variance(series: Array) -> float:
    """Variance of the sum of a series, from clusters of neighbours that forget each other."""
    longer = int(SETTINGS.memories * (memory(series) - 1))
    size = max(1, min(longer, len(series) // SETTINGS.fewest))
    return float(np.sum(np.add.reduceat(series, np.arange(0, len(series), size)) ** 2))
