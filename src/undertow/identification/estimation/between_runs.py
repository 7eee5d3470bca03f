"""Whether what nature changes differs between runs, and the table of what was found.

A current is sought as one value for all runs first. Values by run take its place where they differ by more
than chance: a Wald test of equality, with errors that are robust to what the model leaves. So runs that agree
cost nothing, neither precision nor power, and runs that do not are not averaged. A common mean with a spread
that is estimated would shrink in between, but two or three runs say next to nothing of a spread.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from undertow.identification.logs.run import Run
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .by_run import origins, plain, run_of
from .residual import WeakModel


@dataclass(frozen=True)
class BetweenRunsSettings:
    """Numbers of the test."""

    # Chance that an effect whose runs agree gets values by run all the same. A diagnosis tries some ten such
    # effects: one in a hundred has one too many then, which costs a little precision and no wrong name.
    chance: float = 1e-3


SETTINGS = BetweenRunsSettings()


@dataclass(frozen=True)
class BetweenRuns:
    """A parameter with a value in every run, and how far these differ."""

    parameter: str
    values: dict[str, float]  # by run, SI and SNAME signs
    standard_errors: dict[str, float]
    weights: dict[str, float]  # of the runs in the mean
    spread: float  # standard deviation between the runs beyond the errors
    q: float  # Cochran's Q, by the joint covariance; chi-square with one degree less than runs if all agree
    p_value: float

    @property
    def mean(self) -> float:
        """Mean over the runs, weighted by how well each knows it."""
        return sum(self.weights[run] * value for run, value in self.values.items())


def heterogeneity(values: Array, variance: Array) -> tuple[float, float]:
    """How far independent estimates of one value differ, (k,) with their variances.

    Cochran's Q, and the standard deviation between them beyond their errors (DerSimonian and Laird,
    Controlled Clinical Trials 7, 1986).
    """
    weight = 1.0 / variance
    mean = float(weight @ values / weight.sum())
    q = float(weight @ (values - mean) ** 2)
    scale = max(float(weight.sum() - weight @ weight / weight.sum()), 1e-300)
    return q, float(np.sqrt(max(q - (len(values) - 1), 0.0) / scale))


def between_runs(parameter: str, runs: Sequence[str], values: Array, covariance: Array) -> BetweenRuns:
    """The table of one parameter: values (r,) in r runs, and their covariance (r, r)."""
    variance = np.maximum(np.diag(covariance), 1e-300)
    spread = heterogeneity(values, variance)[1]
    weight = 1.0 / (variance + spread**2)
    q = _wald(values, covariance, [list(range(len(values)))])
    columns = values, np.sqrt(variance), weight / weight.sum()
    own_values, errors, weights = (dict(zip(runs, c.tolist(), strict=True)) for c in columns)
    chance = float(chi2.sf(q, len(values) - 1))
    return BetweenRuns(parameter, own_values, errors, weights, spread, q, chance)


def _wald(values: Array, covariance: Array, groups: Sequence[Sequence[int]]) -> float:
    """Squared distance of values from being equal within each group, in units of their errors."""
    rows = []
    for first, *others in groups:
        for other in others:
            row = np.zeros(len(values))
            row[first], row[other] = -1.0, 1.0
            rows.append(row)
    contrast = np.array(rows)
    apart = contrast @ values
    return float(apart @ np.linalg.pinv(contrast @ covariance @ contrast.T, hermitian=True) @ apart)


def stated_by_run(vehicle: Vehicle, free: Sequence[str]) -> list[str]:
    """Free parameters that the file says belong to each run."""
    return [n for n in free if vehicle.value_of(n).per_run]


def may_differ(
    model: WeakModel, runs: Sequence[Run], among: Collection[str] | None = None
) -> list[tuple[str, ...]]:
    """Free parameters, common to all runs so far, that nature may have changed between them, by effect.

    All of an effect or none: the direction of a current says little without its speed.
    """
    if len(origins(runs)) < 2:
        return []
    vehicle, equal = model.functions.vehicle, model.functions.equal
    tied = {*equal, *(other for other, _ in equal.values())}
    asked = [n for n in model.free if among is None or n in among]
    names = [n for n in asked if n not in tied and not run_of(n) and vehicle.differs_between_runs(n)]
    owners = {vehicle.declaration(n).name: n for n in names}
    groups = (tuple(owners[q.name] for q in e.parameters if q.name in owners) for e in vehicle.all_effects)
    return [group for group in groups if group]


def least_differing(
    model: WeakModel, values: Array, covariance: Array, groups: Sequence[Sequence[str]]
) -> tuple[int, float]:
    """Group of parameters whose values by run differ least, and the chance of that if they were the same.

    values, covariance: of the free parameters, (n_free,) and (n_free, n_free).
    """
    chances = []
    for group in groups:
        places = [[model.free.index(n) for n in model.values.by_run[name]] for name in group]
        freedom = sum(len(own) - 1 for own in places)
        chances.append(float(chi2.sf(_wald(values, covariance, places), freedom)))
    worst = int(np.argmax(chances))
    return worst, chances[worst]


def table_of(model: WeakModel, values: Array, covariance: Array) -> tuple[BetweenRuns, ...]:
    """The parameters of a fit that have a value in every run; values (n_free,) with their covariance."""
    found = []
    for name, there in model.values.by_run.items():
        places = [model.free.index(n) for n in there]
        runs = [run_of(n) for n in there]
        found.append(between_runs(name, runs, values[places], covariance[np.ix_(places, places)]))
    return tuple(found)


def of_the_vehicle(model: WeakModel, table: Sequence[BetweenRuns]) -> Array:
    """Matrix (n_names, n_free) that takes values by run to their means, and leaves all others as they are."""
    rows = {t.parameter: t.weights for t in table}
    matrix = np.zeros((len(model.values.names), len(model.free)))
    for column, name in enumerate(model.free):
        weights = rows.get(plain(name), {})
        matrix[model.values.names.index(plain(name)), column] = weights.get(run_of(name), 1.0)
    return matrix
