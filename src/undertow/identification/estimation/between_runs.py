"""Whether what nature changes differs between runs: a test on a common fit, and the table of what was found.

A current is sought as one value for all runs first. Values by run take its place where they lower the sum of
squares by more than chance: a Wald test of equality, with errors that are robust to what the model leaves.
So runs that agree cost nothing, neither precision nor power, and runs that do not are not averaged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .by_run import in_run, origins, plain, with_values_by_run
from .data import WeakData, Whitening
from .residual import WeakModel, whitened
from .step import clustered, normal_equations, prior_of, summed_scores


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
    # Standard deviation between the runs beyond the errors (DerSimonian and Laird, Controlled Clinical Trials
    # 7, 1986)
    spread: float
    q: float  # Cochran's Q, by the joint covariance; chi-square with one degree less than runs if all agree
    p_value: float

    @property
    def mean(self) -> float:
        """Mean over the runs, weighted by how well each knows it."""
        return sum(self.weights[run] * value for run, value in self.values.items())

    def __str__(self) -> str:
        shown = (f"{v:.3g} ± {self.standard_errors[run]:.2g} in {run}" for run, v in self.values.items())
        return f"{self.parameter}: {', '.join(shown)}; mean {self.mean:.3g}, spread {self.spread:.2g}"


def between_runs(parameter: str, runs: Sequence[str], values: Array, covariance: Array) -> BetweenRuns:
    """The table of one parameter: values (r,) in r runs, and their covariance (r, r)."""
    variance = np.maximum(np.diag(covariance), 1e-300)
    own = 1.0 / variance
    mean = float(own @ values / own.sum())
    apart = float(own @ (values - mean) ** 2) - (len(values) - 1)
    spread = np.sqrt(max(apart, 0.0) / max(own.sum() - float(own @ own) / own.sum(), 1e-300))
    weight = 1.0 / (variance + spread**2)
    q = _wald(values, covariance, [list(range(len(values)))])
    columns = ((dict(zip(runs, column.tolist(), strict=True))) for column in (values, np.sqrt(variance)))
    return BetweenRuns(
        parameter,
        *columns,
        dict(zip(runs, (weight / weight.sum()).tolist(), strict=True)),
        float(spread),
        q,
        float(chi2.sf(q, len(values) - 1)),
    )


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


def differing(
    model: WeakModel, p: Array, data: WeakData, whitening: list[Whitening], names: Sequence[str] | None = None
) -> tuple[str, ...]:
    """Parameters of a fit, common to all runs so far, whose values differ between the runs beyond chance.

    Parameters
    ----------
    model : WeakModel
        The model with its free parameters.
    p : array
        All parameters, fitted.
    data : WeakData
        What was fitted.
    whitening : list of Whitening
        Noise of every segment.
    names : sequence of str, optional
        Parameters that may differ; by default those that nature changes, as their effects declare and the
        vehicle file does not deny.

    Returns
    -------
    tuple of str
        All such parameters of an effect or none: the direction of a current says little without its speed.
    """
    vehicle = model.functions.vehicle
    if len(origins(data.runs)) < 2:
        return ()
    asked = model.free if names is None else names
    groups = {
        e.id: [q.name for q in e.parameters if q.name in asked and _may_differ(vehicle, q.name, model)]
        for e in vehicle.all_effects
    }
    groups = {key: own for key, own in groups.items() if own}
    while groups:
        chances = _chances(model, p, data, whitening, list(groups.values()))
        worst = int(np.argmax(chances))
        if chances[worst] < SETTINGS.chance:
            break
        groups.pop(list(groups)[worst])
    return tuple(name for own in groups.values() for name in own)


def _may_differ(vehicle: Vehicle, name: str, model: WeakModel) -> bool:
    tied = name in model.functions.equal or bool(model.functions.followers(name))
    return name in model.free and vehicle.differs_between_runs(name) and not tied


def _chances(
    model: WeakModel, p: Array, data: WeakData, whitening: list[Whitening], groups: Sequence[Sequence[str]]
) -> list[float]:
    """Chance of differences as large as found, one step from the common values, for groups of parameters."""
    split = [name for group in groups for name in group]
    other = model.with_free(with_values_by_run(model.free, split, data.runs))
    start = {n: float(p[k]) for n, k in zip(model.free, model.places, strict=True)}
    q = other.started(start)
    at = whitened(other.linearise(data, q), whitening)
    gram, slope = normal_equations(at, q[list(other.places)], prior_of(other))
    scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
    step = -scale * (np.linalg.pinv(gram * np.outer(scale, scale), hermitian=True) @ (scale * slope))
    covariance = clustered(gram, summed_scores(at.r + at.J @ step, at.J, data.block))
    return [_chance(other, step, covariance, group, data) for group in groups]


def _chance(model: WeakModel, step: Array, covariance: Array, group: Sequence[str], data: WeakData) -> float:
    runs = origins(data.runs)
    places = [[model.free.index(in_run(name, run)) for run in runs] for name in group]
    freedom = len(group) * (len(runs) - 1)
    return float(chi2.sf(_wald(step, covariance, places), freedom))


def table_of(model: WeakModel, values: Array, covariance: Array) -> tuple[BetweenRuns, ...]:
    """The parameters of a fit that have a value in every run; values (n_free,) with their covariance."""
    found = []
    for name, there in model.values.by_run.items():
        places = [model.free.index(n) for n in there]
        runs = [n.partition("@")[2] for n in there]
        found.append(between_runs(name, runs, values[places], covariance[np.ix_(places, places)]))
    return tuple(found)


def of_the_vehicle(model: WeakModel, table: Sequence[BetweenRuns]) -> Array:
    """Matrix (n_names, n_free) that takes values by run to their means, and leaves all others as they are."""
    rows = {t.parameter: t.weights for t in table}
    matrix = np.zeros((len(model.values.names), len(model.free)))
    for column, name in enumerate(model.free):
        weights = rows.get(plain(name), {})
        matrix[model.values.names.index(plain(name)), column] = weights.get(name.partition("@")[2], 1.0)
    return matrix
