"""The result of every estimator: estimates, their uncertainty, and differences between runs."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, Protocol, Self, cast

import numpy as np
from scipy.stats import chi2

from undertow.identification.logs.run import Run
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Flags

from .data import inverse_of
from .pointwise import scale_directions
from .residual import WeakModel, base_name, origins, run_of
from .step import at_bounds, default_weights, estimated, follower_errors, followers, prior_of

# --- whether environmental parameters differ between runs -----------------------------------------
# A current is estimated as one value for all runs first. It is replaced by values by run if these differ
# significantly: a Wald test of equality, with errors that are robust to the residual. Thus runs that agree
# cost neither precision nor power, and runs that do not are not averaged. A random-effects model with an
# estimated spread would shrink the values, but two or three runs hardly determine a spread.


@dataclass(frozen=True)
class BetweenRunsSettings:
    """Settings of the test."""

    # False-alarm rate of the test for one effect. A diagnosis tries some ten such effects: in one of a
    # hundred diagnoses an effect gets values by run needlessly, which costs a little precision.
    chance: float = 1e-3


BETWEEN_RUNS = BetweenRunsSettings()


@dataclass(frozen=True)
class BetweenRuns:
    """A parameter with a value in every run, and their heterogeneity."""

    parameter: str
    values: dict[str, float]  # by run, SI and SNAME signs
    standard_errors: dict[str, float]
    weights: dict[str, float]  # of the runs in the mean
    spread: float  # standard deviation between the runs beyond the errors
    q: float  # Cochran's Q, by the joint covariance; chi-square with one degree less than runs if all agree
    p_value: float

    @property
    def mean(self) -> float:
        """Mean over the runs, weighted by their precision."""
        return sum(self.weights[run] * value for run, value in self.values.items())


def heterogeneity(values: Array, variance: Array) -> tuple[float, float]:
    """Heterogeneity of independent estimates of one value, (k,) with their variances.

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
    """Free parameters, common to all runs so far, that may vary between them, by effect.

    All of an effect or none: the direction of a current is useless without its speed.
    """
    if len(origins(runs)) < 2:
        return []
    vehicle, equal = model.functions.vehicle, model.functions.equal
    tied = {*equal, *(other for other, _ in equal.values())}
    candidates = [n for n in model.free if among is None or n in among]
    names = [n for n in candidates if n not in tied and not run_of(n) and vehicle.differs_between_runs(n)]
    owners = {vehicle.declaration(n).name: n for n in names}
    groups = (tuple(owners[q.name] for q in e.parameters if q.name in owners) for e in vehicle.all_effects)
    return [group for group in groups if group]


def least_differing(
    model: WeakModel, values: Array, covariance: Array, groups: Sequence[Sequence[str]]
) -> tuple[int, float]:
    """Group of parameters whose values by run differ least, and the p-value of equality.

    values, covariance: of the free parameters, (n_free,) and (n_free, n_free).
    """
    chances = []
    for group in groups:
        places = [[model.free.index(n) for n in model.values.by_run[name]] for name in group]
        freedom = sum(len(own) - 1 for own in places)
        chances.append(float(chi2.sf(_wald(values, covariance, places), freedom)))
    worst = int(np.argmax(chances))
    return worst, chances[worst]


def run_tables(model: WeakModel, values: Array, covariance: Array) -> tuple[BetweenRuns, ...]:
    """The parameters of a fit that have a value in every run; values (n_free,) with their covariance."""
    found = []
    for name, there in model.values.by_run.items():
        places = [model.free.index(n) for n in there]
        runs = [run_of(n) for n in there]
        found.append(between_runs(name, runs, values[places], covariance[np.ix_(places, places)]))
    return tuple(found)


def averaging_matrix(model: WeakModel, table: Sequence[BetweenRuns]) -> Array:
    """Matrix (n_names, n_free) that takes values by run to their means, and leaves all others as they are."""
    rows = {t.parameter: t.weights for t in table}
    matrix = np.zeros((len(model.values.names), len(model.free)))
    for column, name in enumerate(model.free):
        weights = rows.get(base_name(name), {})
        matrix[model.values.names.index(base_name(name)), column] = weights.get(run_of(name), 1.0)
    return matrix


# --- fits -----------------------------------------------------------------------------------------
@dataclass(frozen=True)
class IdentifiabilitySettings:
    """Limits for calling parameters identified."""

    # Share of the largest eigenvalue of the scaled information below which a direction is unobservable.
    unobservable: float = 1e-10
    membership: float = 1e-3  # part of a parameter in such directions from which it belongs to their group
    rounding: float = 1e-6
    zero: float = 2.0  # |t| below which a parameter could as well be zero
    weak_t: float = 5.0  # |t| below which a parameter is known, but not well
    # Correlation between the errors of two parameters beyond which only a combination of both is known,
    # unless each is this many standard errors from zero all the same.
    correlated: float = 0.95
    correlated_t: float = 10.0
    # Share of the information on a parameter from which the default prior determines it, not the data.
    prior_share: float = 0.5
    # Relative standard error, all else known, from which the common scale of the forces in a degree of
    # freedom is not found.
    scale: float = 0.5
    # Standard deviations of prior and fit together beyond which a value is far from what was stated.
    far_from_prior: float = 3.0
    # Fall of the sum of squares, in units of the noise, that is more than chance: twice the logarithm of a
    # likelihood ratio, which white noise brings above this once in 18 000 times at most on validation data.
    more_than_chance: float = 15.0


SETTINGS = IdentifiabilitySettings()
SIGNIFICANT_T, MORE_THAN_CHANCE = SETTINGS.zero, SETTINGS.more_than_chance


@dataclass(frozen=True)
class Combination:
    """A sum of parameters that the data determine."""

    coefficients: dict[str, float]  # Factor of each parameter in it; one for the first

    def __str__(self) -> str:
        (first, _), *others = self.coefficients.items()
        return " ".join([first, *(_term(name, factor) for name, factor in others)])


def _term(name: str, factor: float) -> str:
    size = abs(factor)
    return f"{'-' if factor < 0 else '+'} {'' if abs(size - 1.0) < 1e-4 else f'{size:.4g} '}{name}"


def undetermined(gram: Array, free: Sequence[str], limit: float = SETTINGS.unobservable) -> list[list[str]]:
    """Parameters that data with information J'J (without priors) do not determine, in groups.

    A group of one is not identifiable at all; of a larger one only combinations are. `limit` is the share
    of the largest eigenvalue of the scaled information below which a direction is not seen.
    """
    _, vectors, unobservable = _directions(gram, limit)
    null = vectors[:, unobservable]
    projector = null @ null.T
    groups: list[list[int]] = []
    left = [i for i in range(len(free)) if projector[i, i] > SETTINGS.membership]
    while left:
        group = [left.pop(0)]
        for i in group:
            group += [j for j in left if abs(projector[i, j]) > SETTINGS.membership]
            left = [j for j in left if j not in group]
        groups.append(sorted(group))
    return [[free[i] for i in group] for group in groups]


def base_parameters(
    gram: Array, free: Sequence[str], limit: float = SETTINGS.unobservable
) -> list[Combination]:
    """The combinations of parameters that data determine only jointly.

    They span the identifiable subspace of each group of `undetermined`, in reduced row echelon form: each
    begins with a parameter that is in no other.
    """
    size, vectors, unobservable = _directions(gram, limit)
    found = []
    for group in undetermined(gram, free, limit):
        places = [list(free).index(name) for name in group]
        # A functional is seen if it vanishes along every direction that is not.
        null = vectors[places][:, unobservable] / np.where(size > 0, size, 1.0)[places, None]
        basis, weight, _ = np.linalg.svd(null)
        rank = int(np.sum(weight > SETTINGS.rounding * max(weight.max(initial=0.0), 1e-300)))
        found += [_combination(row, group) for row in _echelon(basis[:, rank:].T)]
    return found


def _directions(gram: Array, limit: float) -> tuple[Array, Array, Flags]:
    """Scale of the parameters, eigenvectors of the scaled information, and which of them are not seen."""
    size = np.sqrt(np.diag(gram))
    scale = np.where(size > 0, 1.0 / np.where(size > 0, size, 1.0), 1.0)
    weight, vectors = np.linalg.eigh(gram * np.outer(scale, scale))
    return size, vectors, weight < limit * max(float(weight.max(initial=0.0)), 1e-300)


def _echelon(rows: Array) -> Array:
    """Reduced row echelon form."""
    table = rows.copy()
    done = 0
    for column in range(table.shape[1]):
        if done == len(table):
            break
        pivot = done + int(np.argmax(np.abs(table[done:, column])))
        if abs(table[pivot, column]) < SETTINGS.rounding:
            continue
        table[[done, pivot]] = table[[pivot, done]]
        table[done] /= table[done, column]
        others = np.arange(len(table)) != done
        table[others] -= np.outer(table[others, column], table[done])
        done += 1
    return table[:done]


def _combination(row: Array, group: Sequence[str]) -> Combination:
    return Combination({n: float(c) for n, c in zip(group, row, strict=True) if abs(c) > SETTINGS.rounding})


class Estimates(Protocol):
    """Values with their standard errors, SI and SNAME signs."""

    @property
    def values(self) -> dict[str, float]: ...

    @property
    def standard_errors(self) -> dict[str, float]: ...


class Fitted(ABC):
    """A fit of the free parameters of a model by least squares, whatever the estimator."""

    model: WeakModel  # model and names of the free parameters
    p: Array  # (n_parameters,)

    @property
    @abstractmethod
    def gram(self) -> Array:
        """Information J'J of the data as they were weighted, without priors, (n_free, n_free)."""

    @property
    @abstractmethod
    def noise_gram(self) -> Array:
        """The same if nothing but sensor noise were in the data."""

    @property
    @abstractmethod
    def covariance(self) -> Array:
        """Covariance of the free parameters."""

    @cached_property
    def information(self) -> Array:
        """Information of data and stated priors: J'J plus the weight of the priors."""
        return self.gram + np.diag(prior_of(self.model)[1] ** 2)

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle with fitted values and standard errors, those of tied parameters included.

        Parameters that differ between runs have their mean, and as error the spread of a further run.
        """
        names, covariance = self.vehicle_covariance
        values = {n: self.values[n] for n in names}
        errors = dict(zip(names, np.sqrt(np.diag(covariance)).tolist(), strict=True))
        tied = followers(self.model, values), follower_errors(self.model, errors)
        found = estimated(self.model.functions.vehicle, values | tied[0], errors | tied[1])
        split = {t.parameter: replace(found.value_of(t.parameter), per_run=True) for t in self.between_runs}
        return found.with_values(split) if split else found

    @cached_property
    def between_runs(self) -> tuple[BetweenRuns, ...]:
        """Values by run with their mean and spread, of every parameter that has them."""
        if not self.model.values.split:
            return ()
        return run_tables(self.model, self.p[list(self.model.places)], self.covariance)

    @property
    def vehicle_covariance(self) -> tuple[tuple[str, ...], Array]:
        """Names and covariance of what the vehicle has for the free parameters.

        If values by run are averaged, their spread counts as error.
        """
        names, table = self.model.values.names, self.between_runs
        if not table:
            return names, self.covariance
        average = averaging_matrix(self.model, table)
        spread = {t.parameter: t.spread**2 for t in table}
        return names, average @ self.covariance @ average.T + np.diag([spread.get(n, 0.0) for n in names])

    @property
    def runs_with_values(self) -> set[str]:
        """Names of the runs that have values of their own."""
        return {run for table in self.between_runs for run in table.values}

    def vehicle_in(self, run: Run) -> Vehicle:
        """The vehicle with the values of one run that was fitted; of another run, with the means."""
        own = self.model.values.of_run(self.p, run)
        place, vehicle = self.model.functions.parameter_names.index, self.vehicle
        split = (t.parameter for t in self.between_runs)
        return vehicle.with_values(
            {n: replace(vehicle.value_of(n), value=float(own[place(n)])) for n in split}
        )

    @property
    def values(self) -> dict[str, float]:
        """Fitted values of the free parameters, SI and SNAME signs; of values by run the mean as well."""
        own = {n: float(self.p[k]) for n, k in zip(self.model.free, self.model.places, strict=True)}
        return own | {t.parameter: t.mean for t in self.between_runs}

    def with_parameters(self, p: Array) -> Self:
        """The same model and logs with other parameters, (n_parameters,), which are no minimum."""
        return cast(Self, replace(cast(Any, self), p=p))

    @property
    def standard_errors(self) -> dict[str, float]:
        """Standard error of every one of these values."""
        own = dict(zip(self.model.free, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))
        if not self.between_runs:
            return own
        average = averaging_matrix(self.model, self.between_runs)
        errors = np.sqrt(np.diag(average @ self.covariance @ average.T)).tolist()
        return own | dict(zip(self.model.values.names, errors, strict=True))

    @property
    def condition(self) -> float:
        """Condition number of the scaled regressor."""
        scale = np.sqrt(np.maximum(np.diag(self.gram), 1e-300))
        return float(np.sqrt(np.linalg.cond(self.gram / np.outer(scale, scale)))) if len(scale) else 1.0

    @property
    def active(self) -> list[str]:
        """Active constraints, by name: bounds, then matrices at their limit."""
        bounds = [f"{name} at its bound {bound:g}" for name, bound in at_bounds(self.model, self.p).items()]
        return [*bounds, *self.model.limits.active(self.p)]


Verdict = Literal["identified", "weakly identified", "not identifiable"]


def verdicts(fit: Fitted) -> dict[str, Verdict]:
    """Whether this experiment determines each parameter.

    Not identifiable: within two standard errors of zero, or without effect on the data. Weakly identified:
    within five, known only together with another, or at a physical limit.
    """
    t = t_values(fit)
    undetermined_names = {name for group in undetermined(fit.gram, fit.model.free) for name in group}
    doubtful = {*_correlated(fit), *_at_bound(fit)}
    return {n: _verdict(t[n], n in undetermined_names, n in doubtful) for n in fit.model.free}


def _verdict(t: float, undetermined: bool, doubtful: bool) -> Verdict:
    if t < SIGNIFICANT_T or undetermined:
        return "not identifiable"
    return "weakly identified" if t < SETTINGS.weak_t or doubtful else "identified"


def cramer_rao(fit: Fitted) -> dict[str, float]:
    """Cramér-Rao bound on the standard errors due to sensor noise, by parameter.

    Standard errors exceed it because of the residual above the noise. Stated priors are not data, and do not
    count. For the weak form the data are the products with its test functions.
    """
    return dict(zip(fit.model.free, np.sqrt(np.diag(inverse_of(fit.noise_gram))).tolist(), strict=True))


def correlation(fit: Fitted) -> Array:
    """Correlation of the errors of the free parameters, shape (k, k)."""
    spread = np.sqrt(np.maximum(np.diag(fit.covariance), 1e-300))
    return np.asarray(fit.covariance / np.outer(spread, spread))


def t_values(fit: Estimates) -> dict[str, float]:
    """Magnitude of every estimate over its standard error."""
    errors = fit.standard_errors
    return {n: t_value(v, errors[n]) for n, v in fit.values.items()}


def t_value(value: float, error: float) -> float:
    """Magnitude of a value over its standard error."""
    return abs(value) / error if error > 0 else float("inf")


def remarks(fit: Fitted, stated: Vehicle) -> dict[str, list[str]]:
    """Doubts about fitted values: not identifiable, at a bound, far from the stated prior."""
    found: dict[str, list[str]] = {n: [] for n in fit.model.free}
    for part in (_insignificant(fit), _correlated(fit), _at_bound(fit), _far_from_prior(fit, stated)):
        for name, text in part.items():
            found[name].append(text)
    return found


def held_by_default_prior(fit: Fitted) -> list[str]:
    """Parameters determined more by the default prior, from mass, inertia and length, than by the data."""
    weight = default_weights(fit.model) ** 2
    share = weight * np.diag(inverse_of(fit.information + np.diag(weight)))
    return [n for n, part in zip(fit.model.free, share, strict=True) if part > SETTINGS.prior_share]


def unknown_scales(fit: Fitted) -> dict[str, list[str]]:
    """Degrees of freedom in which no known force sets the scale, with the parameters that share it.

    The logs determine only their ratios; their scale stays as stated.
    """
    free, values = fit.model.free, fit.model.values
    found = {}
    for dof, local in scale_directions(fit.model.functions, values.names, fit.p[: values.size]).items():
        direction = local[values.name_index]
        if direction @ fit.gram @ direction < SETTINGS.scale**-2:
            found[dof] = [n for n, change in zip(free, direction, strict=True) if change]
    return found


def notes(fit: Fitted) -> list[str]:
    """Constraints on a fit other than the data, in words."""
    lines = [
        f"no known force in these logs determines the scale of the forces in {dof}: {', '.join(names)} are "
        "known up to a common factor, which stays as stated"
        for dof, names in unknown_scales(fit).items()
    ]
    prior_share = held_by_default_prior(fit)
    if prior_share:
        lines.append(
            "these logs determine these parameters so poorly that a weak prior from the vehicle's mass, "
            f"inertia and length keeps them near the stated values: {', '.join(prior_share)}"
        )
    return lines


def _insignificant(fit: Fitted) -> dict[str, str]:
    return {n: f"not identifiable: |t| = {t:.1f}" for n, t in t_values(fit).items() if t < SIGNIFICANT_T}


def _correlated(fit: Fitted) -> dict[str, str]:
    between, names, t = correlation(fit), fit.model.free, t_values(fit)
    np.fill_diagonal(between, 0.0)
    partner = np.argmax(np.abs(between), axis=1).tolist() if len(names) > 1 else []
    return {
        names[i]: f"known only together with {names[j]}: correlation {between[i, j]:.3f}"
        for i, j in enumerate(partner)
        if abs(between[i, j]) > SETTINGS.correlated and t[names[i]] < SETTINGS.correlated_t
    }


def _at_bound(fit: Fitted) -> dict[str, str]:
    return dict.fromkeys(at_bounds(fit.model, fit.p), "at a physical limit")


def _far_from_prior(fit: Fitted, stated: Vehicle) -> dict[str, str]:
    found = {}
    for name in fit.model.free:
        value, prior = fit.values[name], stated.value_of(base_name(name))
        if prior.sigma:
            distance = abs(value - prior.value) / np.hypot(prior.sigma, fit.standard_errors[name])
            if distance > SETTINGS.far_from_prior:
                found[name] = f"{distance:.1f} standard deviations from its prior"
    return found


class TriangularFactor:
    """Any number of rows of a regression as the triangular factor of their QR decomposition.

    Rows are added in blocks and not kept: what is held are (k + 1)^2 numbers for k parameters. The solution
    is that of all rows together, with the precision of a QR decomposition (not that of normal equations).
    """

    def __init__(self, parameters: int) -> None:
        self.factor, self.count = np.zeros((0, parameters + 1)), 0

    def add(self, rows: Array, count: int) -> None:
        """Take in rows, target in the last column, or few rows with the products of `count` samples."""
        self.factor = np.asarray(np.linalg.qr(np.vstack([self.factor, rows]), mode="r"), dtype=float)
        self.count += count

    def split(self) -> tuple[Array, Array]:
        """Regressor and target with few rows that have the same products as all."""
        return self.factor[:, :-1], self.factor[:, -1]
