"""NEES, the squared error of an estimate by its covariance, along a run whose true states are known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.stats import chi2

from undertow.model.symbols import POSE, VELOCITY
from undertow.typing import Array, Flags, Index

from .consistency import SETTINGS as TESTS
from .consistency import Normalised
from .filters import Estimate, smoother_gains


@dataclass(frozen=True)
class NeesSettings:
    """Numbers of the test."""

    most_rows: int = 200  # evenly spread, that it takes of a run: their correlations need all pairs
    fewest_rows: int = 10


SETTINGS = NeesSettings()

GROUPS: Mapping[str, tuple[str, ...]] = {
    "position": POSE[:3],
    "attitude": POSE[3:],
    "velocity": VELOCITY[:3],
    "rates": VELOCITY[3:],
}


@dataclass(frozen=True)
class Nees(Normalised):
    """The mean of normalised estimation errors squared of a group of states; its count is that of squares."""

    states: tuple[str, ...]
    # squares that would vary as much if they were independent: errors of a filter last, so that those of
    # neighbouring rows are nearly one
    independent: float


@dataclass(frozen=True)
class Truth:
    """True states at the rows of an estimate."""

    names: tuple[str, ...]
    values: Array  # (n, k): NaN where there is none
    variance: Array  # (k,): of the noise that the reference itself has


@dataclass(frozen=True)
class _Part:
    """What a group has of one run."""

    total: float  # sum of e' S^-1 e over rows
    count: int  # squares in it
    spread: float  # its variance, if the filter is consistent


def nees(found: Sequence[tuple[Estimate, Truth]]) -> tuple[Nees, ...]:
    """NEES of position, attitude, velocity and rates, and of all, as far as true states are known.

    The estimates are filtered ones: e' P^-1 e by degree of freedom is one in the mean for a consistent filter
    (Bar-Shalom et al. 2001, section 5.4). Errors of neighbouring rows are correlated, as the filter itself
    says: E[e_j e_k'] = G_j ... G_{k-1} P_k with the gains G of its smoother. From it follows the variance of
    the mean, and the bounds are those of the chi-squared distribution with that variance.

    `found` are filtered estimates of some runs, and the truth at their rows. The groups are those with rows
    enough in any run, then "all"; none without one.
    """
    known = [n for n in (*POSE, *VELOCITY) if any(n in truth.names for _, truth in found)]
    groups = {g: tuple(n for n in names if n in known) for g, names in GROUPS.items()} | {"all": tuple(known)}
    each = {g: [_part(*one, names) for one in found] for g, names in groups.items() if names}
    return tuple(
        _test(g, groups[g], kept)
        for g, parts in each.items()
        if (kept := [p for p in parts if p is not None])
    )


def _test(name: str, states: tuple[str, ...], parts: Sequence[_Part]) -> Nees:
    """The mean over runs; a chi-squared variable of k degrees of freedom by k has the variance 2 / k."""
    total, count, spread = (sum(getattr(p, n) for p in parts) for n in ("total", "count", "spread"))
    k, tail = 2 * count**2 / spread, (1 - TESTS.level) / 2
    low, high = (float(chi2.ppf(q, k)) / k for q in (tail, 1 - tail))
    return Nees(name, total / count, low, high, count, states, k)


def _part(found: Estimate, truth: Truth, states: tuple[str, ...]) -> _Part | None:
    """Squares of a run and the variance of their sum; None without rows enough."""
    if not set(states) <= set(truth.names):
        return None
    own, columns = ([names.index(n) for n in states] for names in (found.names, truth.names))
    there: Flags = np.asarray(np.isfinite(truth.values[:, columns]).all(axis=1))
    there[: _first_row(found)] = False
    rows = _evenly_spaced(np.flatnonzero(there))
    if len(rows) < SETTINGS.fewest_rows:
        return None
    error = found.mean[rows][:, own] - truth.values[rows][:, columns]
    angles = [i for i, n in enumerate(states) if n in POSE[3:]]
    error[:, angles] = np.remainder(error[:, angles] + np.pi, 2 * np.pi) - np.pi
    covariance = found.covariance[rows][:, own][:, :, own] + np.diag(truth.variance[columns])
    white = np.linalg.inv(np.linalg.cholesky(covariance))
    squares = np.sum((white @ error[..., None]) ** 2, axis=(1, 2))
    return _Part(float(squares.sum()), len(rows) * len(own), _variance(found, rows, own, white))


def _first_row(found: Estimate) -> int:
    """The row after the burn-in, from which on the reports say more than the first guess."""
    counts = np.cumsum(found.used, axis=0)
    many = counts[-1] >= TESTS.burn_in
    return int(np.argmax((counts[:, many] >= TESTS.burn_in).all(axis=1))) if many.any() else 0


def _evenly_spaced(rows: Index) -> Index:
    """As many of them as are taken, evenly."""
    if len(rows) <= SETTINGS.most_rows:
        return rows
    return rows[np.linspace(0, len(rows) - 1, SETTINGS.most_rows).astype(np.intp)]


def _variance(found: Estimate, rows: Index, own: Sequence[int], white: Array) -> float:
    """Variance of the sum of squares of errors that are as the filter says.

    Of Gaussian e_j and e_k whitened by L_j and L_k it is the sum of 2 |L_j E[e_j e_k'] L_k'|^2.
    """
    total = 2.0 * len(rows) * len(own)
    covariance, back = found.covariance[rows], _backward_gains(found, rows)
    reach = np.broadcast_to(np.eye(covariance.shape[1]), covariance.shape)
    for lag in range(1, len(rows)):
        reach = reach[:-1] @ back[lag - 1 :]
        shared = (reach @ covariance[lag:])[:, own][:, :, own]
        correlation = white[:-lag] @ shared @ white[lag:].transpose(0, 2, 1)
        total += 4.0 * float(np.sum(correlation**2))
    return total


def _backward_gains(found: Estimate, rows: Index) -> Array:
    """Products of the smoother's gains from each of the rows to the next, shape (len(rows) - 1, nx, nx)."""
    gains = smoother_gains(found)
    products = []
    for begin, end in pairwise(rows):
        product = gains[begin]
        for gain in gains[begin + 1 : end]:
            product = product @ gain
        products.append(product)
    return np.array(products)
