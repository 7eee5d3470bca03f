"""The chosen estimates of all motions, as one set of values of the whole vehicle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.linalg import block_diag

from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from ..weak.estimated import estimated
from .axis import Axis
from .chain import Estimation, Experiment

# Standard deviations between two estimates of one parameter from which they contradict each other.
_APART = 3.0


@dataclass(frozen=True)
class Chosen:
    """Values for a vehicle file.

    Attributes
    ----------
    names : tuple of str
        Parameters of the whole vehicle.
    values : (k,) array
        SI and SNAME signs.
    covariance : (k, k) array
        Of the values; zero between motions, which were logged apart.
    contradictions : tuple of str
        What motions or directions say differently of a parameter that they share, one line each.
    """

    names: tuple[str, ...]
    values: Array
    covariance: Array
    contradictions: tuple[str, ...]

    def vehicle(self, stated: Vehicle) -> Vehicle:
        """The vehicle with these values and their standard errors."""
        errors = np.sqrt(np.diag(self.covariance)).tolist()
        return estimated(
            stated,
            dict(zip(self.names, self.values.tolist(), strict=True)),
            dict(zip(self.names, errors, strict=True)),
        )


def chosen(stated: Vehicle, found: Sequence[tuple[Experiment, Estimation]]) -> Chosen:
    """Put the estimates of several motions together.

    What several motions or directions share is weighted by the inverse of its variances.

    Parameters
    ----------
    stated : Vehicle
        The whole vehicle.
    found : sequence of (Experiment, Estimation)
        The chosen estimate of each motion and direction.
    """
    labels = [_whole_name(stated, e.axis, n) for e, estimation in found for n in estimation.names]
    theta = np.concatenate([estimation.theta for _, estimation in found])
    covariance = block_diag(*(estimation.covariance for _, estimation in found))
    names = tuple(dict.fromkeys(labels))
    weights = np.array([[float(label == n) for label in labels] for n in names]) / np.diag(covariance)
    weights /= weights.sum(axis=1, keepdims=True)
    axes = [str(e.axis) for e, estimation in found for _ in estimation.names]
    told = [line for n in names if (line := _apart(n, labels, axes, theta, covariance))]
    return Chosen(names, weights @ theta, weights @ covariance @ weights.T, tuple(told))


def _whole_name(stated: Vehicle, axis: Axis, name: str) -> str:
    own = axis.name_of(name)
    return own if own in stated.values else name


def _apart(
    name: str, labels: Sequence[str], axes: Sequence[str], theta: Array, covariance: Array
) -> str | None:
    places = [i for i, label in enumerate(labels) if label == name]
    if len(places) < 2:
        return None

    def away(pair: tuple[int, int]) -> float:
        i, j = pair
        return float(abs(theta[i] - theta[j]) / np.sqrt(covariance[i, i] + covariance[j, j]))

    i, j = worst = max(combinations(places, 2), key=away)
    if away(worst) <= _APART:
        return None
    return (
        f"{name} is {theta[i]:.6g} by {axes[i]} and {theta[j]:.6g} by {axes[j]}, {away(worst):.1f} standard "
        "deviations apart: one value cannot stand for both"
    )
