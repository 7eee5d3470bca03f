"""Conditions over the uncertainty of an identification: all values in a box, and all in an ellipsoid."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from scipy.special import chdtri, ndtri

from undertow.model.parameter import printed
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Flags

from .case import SignSet

Margins = Callable[[Array], Array]
"""From parameters of shape (k, n_parameters) to margins of shape (k,), concave in them."""

ALL, SOME, NOMINAL, OPEN = "holds for all", "fails for some", "fails at the values of the file", "not settled"
SAMPLED, NO_IOTA_THERE = "not settled (attitudes sampled)", "no iota at the values of the file"
_MOST_CORNERS = 12
_SIDES = 96


@dataclass(frozen=True)
class Range:
    """A verdict over a set of parameter values.

    Attributes
    ----------
    verdict : str
        `ALL`, `SOME`, `NOMINAL`, `NO_IOTA_THERE`, or `OPEN` or `SAMPLED` (neither proved nor refuted).
    margin : float
        Least margin found at a point of the set.
    counterexample : dict of float
        Values that the condition fails with, SI, in the sign convention of the vehicle file.
    """

    verdict: str
    margin: float
    counterexample: dict[str, float]


class Uncertainty:
    """How far the parameters of a vehicle are known.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle, with standard deviations where they are known.
    confidence : float
        Probability of the interval of each parameter, and of the ellipsoid of all of them.
    covariance : (names, matrix)
        Covariance of an identification, SI, SNAME signs; standard deviations alone where it has none.
    """

    def __init__(
        self, vehicle: Vehicle, confidence: float = 0.95, covariance: tuple[Sequence[str], Any] = ((), ())
    ) -> None:
        self.vehicle, self.confidence = vehicle, confidence
        self._names, self._matrix = list(covariance[0]), np.array(covariance[1], dtype=float)

    @property
    def source(self) -> str:
        """Where the uncertainty is from."""
        return "covariance of the last fit" if self._names else "standard deviations of the vehicle file"

    def covariance(self, names: Sequence[str]) -> Array:
        """Covariance of some parameters, shape (n, n)."""
        spread = [self.vehicle.value_of(n).sigma or 0.0 for n in names]
        result = np.diag(np.square(spread))
        known = [i for i, n in enumerate(names) if n in self._names]
        places = [self._names.index(names[i]) for i in known]
        if known:
            result[np.ix_(known, known)] = self._matrix[np.ix_(places, places)]
        return result

    def over_box(self, margins: Margins, one: SignSet, matters: Flags) -> Range:
        """Over every value within its own interval and its physical bounds.

        Parameters
        ----------
        margins : callable
            The margin of a condition.
        one : SignSet
            Whose parameters.
        matters : array of bool
            The parameters that the margin depends on.
        """
        if np.count_nonzero(matters) > _MOST_CORNERS:
            return self._range(margins(one.theta[None]), one.theta[None], one, settled=False)
        corners = self._corners(one, matters, float(ndtri(0.5 + self.confidence / 2)))
        return self._range(margins(corners), corners, one, margins(one.theta[None])[0])

    def over_ellipsoid(self, margins: Margins, one: SignSet, features: Array) -> Range:
        """Over the ellipsoid of all uncertain parameters together.

        Parameters
        ----------
        margins : callable
            The margin of a condition.
        one : SignSet
            Whose parameters.
        features : array, shape (m, n_parameters)
            Linear combinations of parameters that the margin depends on; with two of them the verdict is
            practically exact, with more the bound is that of a box around the ellipsoid.
        """
        covariance = self.covariance(one.names)
        count = int(np.count_nonzero(np.diag(covariance)))
        if count == 0:
            return self._range(margins(one.theta[None]), one.theta[None], one)
        reach = float(np.sqrt(chdtri(count, 1 - self.confidence)))
        seen = features @ covariance @ features.T
        values, vectors = np.linalg.eigh(seen)
        kept = values > 1e-14 * max(values[-1], 1e-300)
        # Columns: how the parameters move along each axis of the ellipse of the features.
        axes = reach * (covariance @ features.T @ vectors[:, kept]) / np.sqrt(values[kept])
        around, on = _around(axes.shape[1])
        if around is None:
            return self._range(margins(one.theta + on @ axes.T), one.theta + on @ axes.T, one, settled=False)
        points = np.concatenate([one.theta[None], one.theta + on @ axes.T])
        physical = self._within(points, covariance, reach, one)
        found = self._range(margins(physical), physical, one)
        if found.verdict != ALL:
            return found
        # Concave margins are least at a corner of any polytope around the set: of two, either will do.
        for corners in (
            one.theta + around @ axes.T,
            self._corners(one, np.any(features != 0, axis=0), reach),
        ):
            if float(margins(corners).min()) > 0:
                return found
        return Range(OPEN, found.margin, {})

    def _within(self, points: Array, covariance: Array, reach: float, one: SignSet) -> Array:
        """Points moved to physical values, those of them that are still in the ellipsoid."""
        bounds = self._all_bounds(one)
        moved = np.clip(points, bounds[:, 0], bounds[:, 1])
        away = moved - one.theta
        distance = np.einsum("ij,jk,ik->i", away, np.linalg.pinv(covariance, hermitian=True), away)
        return moved[distance <= reach**2 * (1 + 1e-9)]

    def _corners(self, one: SignSet, matters: Flags, reach: float) -> Array:
        """Corners of the box of all physical values within `reach` standard deviations."""
        low, high = self._intervals(one, reach)
        free = [j for j in np.flatnonzero(matters) if high[j] > low[j]]
        corners = np.tile(one.theta, (2 ** len(free), 1))
        for row, choice in zip(corners, product(*[(low[j], high[j]) for j in free]), strict=True):
            row[free] = choice
        return corners

    def _intervals(self, one: SignSet, reach: float) -> tuple[Array, Array]:
        spread = reach * np.sqrt(np.diag(self.covariance(one.names)))
        bounds = self._all_bounds(one)
        return np.maximum(one.theta - spread, bounds[:, 0]), np.minimum(one.theta + spread, bounds[:, 1])

    def _all_bounds(self, one: SignSet) -> Array:
        return np.array([self._bounds(n) for n in one.names]).reshape(-1, 2)

    def _bounds(self, name: str) -> tuple[float, float]:
        parameter = self.vehicle.parameter_of(name)
        return parameter.bounds if parameter else (-np.inf, np.inf)

    def _range(
        self, values: Array, points: Array, one: SignSet, nominal: float | None = None, settled: bool = True
    ) -> Range:
        worst = int(np.argmin(values))
        least = float(values[worst])
        if least > 0:
            return Range(ALL if settled else OPEN, least, {})
        if nominal is not None and nominal <= 0:
            return Range(NOMINAL, least, {})
        return Range(SOME, least, self._stated(points[worst], one))

    def _stated(self, theta: Array, one: SignSet) -> dict[str, float]:
        """The parameters that differ from the file's, as the file would write them."""
        signs = self.vehicle.signs
        told = {}
        for name, value, own in zip(one.names, theta, one.theta, strict=True):
            if abs(value - own) > 1e-9 * max(abs(own), 1e-9):
                told[name] = printed(self.vehicle.declaration(name), float(value), signs)
        return told


def _around(size: int) -> tuple[Array | None, Array]:
    """Corners of a polytope around the unit ball, and points on the ball, shape (k, size)."""
    if size == 1:
        ends = np.array([[-1.0], [1.0]])
        return ends, ends
    if size == 2:
        turn = 2 * np.pi * np.arange(_SIDES) / _SIDES
        circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
        return circle / np.cos(np.pi / _SIDES), circle
    on = np.concatenate([np.eye(size), -np.eye(size)])
    if size > _MOST_CORNERS:
        return None, on
    corners = np.array(list(product((-1.0, 1.0), repeat=size)))
    return corners, np.concatenate([on, corners / np.sqrt(size)])
