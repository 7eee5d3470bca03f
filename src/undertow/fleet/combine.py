"""Partitions put together: one least-squares problem from many triangular factors, errors from day to day."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from undertow.typing import Array

from .reduction import Reduced

# Singular value of the scaled factor, relative to the greatest, below which nothing is determined.
_OPEN = 1e-7
# The same for products of columns, whose rounding is that much coarser.
_LEAST = 1e-13
# Share of a parameter that may lie in what is not determined.
_TOUCHED = 1e-3


@dataclass(frozen=True)
class Day:
    """All partitions of a vehicle and day.

    Attributes
    ----------
    day : date
        Of which day.
    factor : (q, k + 1) array
        Their factors stacked in the order of their files.
    samples, entries : int
        Rows of the logs and of the regression.
    seconds : float
        Time that they cover, s.
    """

    day: date
    factor: Array
    samples: int
    entries: int
    seconds: float

    @cached_property
    def gram(self) -> Array:
        """Products of the columns."""
        return self.factor.T @ self.factor

    @property
    def month(self) -> str:
        """Year and month."""
        return f"{self.day:%Y-%m}"


def days_of(parts: Iterable[tuple[date, Reduced]]) -> list[Day]:
    """Days in order, whatever order the partitions of each came in.

    Parameters
    ----------
    parts : iterable of (date, Reduced)
        Partitions of one vehicle in the order of their files.
    """
    found: dict[date, list[Reduced]] = {}
    for day, reduced in parts:
        found.setdefault(day, []).append(reduced)
    return [
        Day(
            day,
            np.vstack([r.factor for r in own]),
            sum(r.samples for r in own),
            sum(r.entries for r in own),
            sum(r.seconds for r in own),
        )
        for day, own in sorted(found.items())
    ]


@dataclass(frozen=True)
class Prior:
    """What is known of unknowns beforehand: rows of weight (unknown - centre)."""

    centre: Array
    weight: Array


@dataclass(frozen=True)
class Solved:
    """Least squares over days.

    Attributes
    ----------
    theta : (m,) array
        Unknowns.
    covariance : (m, m) array
        Of the noise alone.
    determined : (m,) array of bool
        Whether the days determine each.
    shifts : (days, m) array
        What leaving out each day does to the unknowns.
    fall : float
        How much less the sum of squares is than at zero.
    """

    theta: Array
    covariance: Array
    determined: NDArray[np.bool_]
    shifts: Array
    fall: float

    def variance_of(self, days: Sequence[int] | slice = slice(None)) -> Array:
        """Jackknife variance by these days; they count as independent of each other."""
        count = len(self.shifts)
        return np.asarray(np.sum(self.shifts[days] ** 2, axis=0) * (count - 1) / max(count, 1))

    @property
    def errors(self) -> Array:
        """Standard errors: the scatter from day to day, and never less than noise alone gives."""
        least = np.diag(self.covariance)
        error = np.sqrt(np.maximum(self.variance_of(), least))
        return np.where(self.determined, error, np.inf)


def solve(days: Sequence[Day], designs: Sequence[Array], prior: Prior) -> Solved:
    """Least squares for unknowns that stand for the columns of every day.

    Parameters
    ----------
    days : sequence of Day
        In order: the order decides the last digits.
    designs : sequence of (k, m) arrays
        For every day, what turns unknowns into coefficients of its columns.
    prior : Prior
        Of the unknowns, shape (m,).
    """
    wide = [_widened(design) for design in designs]
    rows = [day.factor @ w for day, w in zip(days, wide, strict=True)]
    known = np.column_stack([np.diag(prior.weight), prior.weight * prior.centre])
    factor = np.asarray(np.linalg.qr(np.vstack([*rows, known]), mode="r"))
    H, target = factor[:, :-1], factor[:, -1]
    size = np.linalg.norm(H, axis=0)
    scale = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0)
    U, s, V = np.linalg.svd(H * scale, full_matrices=False)
    kept = s > _OPEN * s.max(initial=0.0)
    theta = scale * (V[kept].T @ ((U.T @ target)[kept] / s[kept]))
    covariance = np.outer(scale, scale) * (V[kept].T @ (V[kept] / s[kept, None] ** 2))
    determined = (size > 0) & (np.linalg.norm(V[~kept], axis=0) < _TOUCHED)
    grams = np.array([row.T @ row for row in rows])
    whole = np.sum(grams, axis=0) + known.T @ known
    shifts = _without(whole - grams, scale) - theta
    fall = float(2 * theta @ whole[:-1, -1] - theta @ whole[:-1, :-1] @ theta)
    return Solved(theta, covariance, determined, shifts, fall)


def _widened(design: Array) -> Array:
    k, m = design.shape
    wide = np.zeros((k + 1, m + 1))
    wide[:k, :m], wide[k, m] = design, 1.0
    return wide


def _without(grams: Array, scale: Array) -> Array:
    """Unknowns by the products of the columns with one day left out, for every day."""
    value, vector = np.linalg.eigh(grams[:, :-1, :-1] * np.outer(scale, scale))
    kept = value > _LEAST * value.max(axis=1, keepdims=True, initial=0.0)
    along = np.einsum("dji,dj->di", vector, scale * grams[:, :-1, -1])
    solution = np.divide(along, value, out=np.zeros_like(along), where=kept)
    return np.asarray(scale * np.einsum("dij,dj->di", vector, solution))


def choosing(names: Sequence[str], wanted: Sequence[str]) -> Array:
    """Design in which the unknowns are the coefficients of some of the columns."""
    table = np.zeros((len(names), len(wanted)))
    table[[names.index(n) for n in wanted], np.arange(len(wanted))] = 1.0
    return table


def no_prior(count: int) -> Prior:
    """Nothing known beforehand."""
    return Prior(np.zeros(count), np.zeros(count))


def joined(*parts: Prior) -> Prior:
    """Priors of unknowns side by side."""
    return Prior(
        np.concatenate([p.centre for p in parts]),
        np.concatenate([p.weight for p in parts]),
    )


def by_month(days: Sequence[Day]) -> Mapping[str, list[Day]]:
    """Days of every month, in order."""
    found: dict[str, list[Day]] = {}
    for day in days:
        found.setdefault(day.month, []).append(day)
    return found
