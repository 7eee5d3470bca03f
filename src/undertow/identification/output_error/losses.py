"""Losses that outliers cannot pull at without limit: Huber's, and that of Student's t distribution."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from undertow.typing import Array

LossName = Literal["gaussian", "huber", "student-t"]
# Standard deviations from which an error counts linearly: 95 % efficiency if all is Gaussian (Huber, Robust
# Statistics, 1981; Holland and Welsch, Communications in Statistics A6, 1977).
_HUBER = 1.345
# Degrees of freedom, kept fixed (Lange, Little and Taylor, J. American Statistical Association 84, 1989).
_FREEDOM = 4.0
_GAUSSIAN_MAD = 1.4826


@dataclass(frozen=True)
class Loss:
    """A loss by what iterated reweighting needs of it.

    Attributes
    ----------
    weight : callable
        Weight of an error z in standard deviations: influence over error.
    slope : callable
        Derivative of the influence.
    """

    weight: Callable[[Array], Array]
    slope: Callable[[Array], Array]

    def correction(self, z: Array) -> tuple[float, float]:
        """What the covariance of weighted least squares lacks for errors such as z.

        Returns
        -------
        float, float
            Factor on the variance where errors are independent, mean(w) mean(psi^2) / mean(psi')^2, and on
            scores in a sandwich, mean(w) / mean(psi').
        """
        weight, slope = self.weight(z), max(float(np.mean(self.slope(z))), 0.1)
        mean = float(np.mean(weight))
        return mean * float(np.mean((weight * z) ** 2)) / slope**2, mean / slope


def _huber_weight(z: Array) -> Array:
    return np.asarray(_HUBER / np.maximum(np.abs(z), _HUBER))


def _huber_slope(z: Array) -> Array:
    return (np.abs(z) < _HUBER).astype(float)


def _student_weight(z: Array) -> Array:
    return np.asarray((_FREEDOM + 1) / (_FREEDOM + z**2))


def _student_slope(z: Array) -> Array:
    return np.asarray((_FREEDOM + 1) * (_FREEDOM - z**2) / (_FREEDOM + z**2) ** 2)


LOSSES: dict[str, Loss] = {
    "huber": Loss(_huber_weight, _huber_slope),
    "student-t": Loss(_student_weight, _student_slope),
}


def robust_scale(errors: Array) -> float:
    """Standard deviation of errors by their median magnitude: up to half of them may be anything."""
    return _GAUSSIAN_MAD * float(np.median(np.abs(errors))) if len(errors) else 1.0
