"""Fitting parameters to the weak residual: Gauss-Newton with bounds, generalised least squares, honest errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from undertow.codegen.functions import Functions
from undertow.model.vehicle import Vehicle

from .data import WeakData
from .noise import Whitening
from .residual import Linearised, WeakModel, whitened

Array = NDArray[np.float64]
BLOCK_SECONDS = 5.0
_MAX_ITERATIONS = 15
# A step that promises less than this in chi-square cannot change any judgement.
_ENOUGH = 0.05
# A stated prior only holds what the data leave open: at five of its standard deviations it does not bias.
_PRIOR_WIDTH = 5.0


@dataclass(frozen=True)
class WeakFit:
    """A model fitted to logs in the weak form.

    Attributes
    ----------
    model : WeakModel
        Model and names of the free parameters.
    p : (n_parameters,) array
        All parameters.
    data : WeakData
        What it was fitted to.
    whitening : list of Whitening
        Noise model that was used.
    at : Linearised
        Whitened residual and derivative at p.
    dispersion : (2n,) array
        Mean square of the whitened residual for each equation that the fit was weighted with, at least 1.
    iterations : int
        Gauss-Newton steps taken.
    """

    model: WeakModel
    p: Array
    data: WeakData
    whitening: list[Whitening]
    at: Linearised
    dispersion: Array
    iterations: int

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle with the fitted values and their standard errors."""
        old = self.model.functions.vehicle
        errors = self.standard_errors
        values = {}
        for name, place in zip(self.model.free, self.model.places, strict=True):
            known = old.value_of(name)
            values[name] = replace(known, value=float(self.p[place]), sigma=float(errors[name]), estimate=True)
        return old.with_values(values)

    @cached_property
    def _weight(self) -> Array:
        return 1.0 / np.sqrt(self.dispersion[self.data.equation])

    @cached_property
    def gram(self) -> Array:
        """J' J in weighted units, shape (n_free, n_free)."""
        weighted = self.at.J * self._weight[:, None]
        return weighted.T @ weighted

    @cached_property
    def information(self) -> Array:
        """What data and stated priors say together: J' J plus the prior's weight."""
        return self.gram + np.diag(_prior(self.model)[1] ** 2)

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the free parameters: never less than noise alone gives, and robust to autocorrelation.

        Blocks of `BLOCK_SECONDS` are taken as independent (sandwich estimator with clusters).
        """
        inverse = inverse_of(self.information)
        scores = self.at.J * (self.at.r * self._weight**2)[:, None]
        block = self.data.block(BLOCK_SECONDS)
        summed = np.zeros((int(block.max(initial=0)) + 1, scores.shape[1]))
        np.add.at(summed, block, scores)
        robust = inverse @ (summed.T @ summed) @ inverse
        inflation = np.sqrt(np.maximum(1.0, np.diag(robust) / np.maximum(np.diag(inverse), 1e-300)))
        return inverse * np.outer(inflation, inflation)

    @property
    def standard_errors(self) -> dict[str, float]:
        """Standard error of every free parameter."""
        return dict(zip(self.model.free, np.sqrt(np.diag(self.covariance)), strict=True))

    @property
    def condition(self) -> float:
        """Condition number of the scaled regressor."""
        scale = np.sqrt(np.maximum(np.diag(self.gram), 1e-300))
        return float(np.sqrt(np.linalg.cond(self.gram / np.outer(scale, scale)))) if len(scale) else 1.0

    @property
    def values(self) -> dict[str, float]:
        """Fitted values of the free parameters."""
        return {n: float(self.p[k]) for n, k in zip(self.model.free, self.model.places, strict=True)}

    @property
    def cost(self) -> float:
        """Weighted sum of squares."""
        return _squares(self.at.r, self._weight)

    def mean_square(self) -> Array:
        """Mean square of the whitened residual for each of the 2n equations (NaN where not used)."""
        return mean_square(self.at.r, self.data)


def inverse_of(information: Array) -> Array:
    """Inverse of an information matrix; a direction that nothing determines gets a very large variance."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    scaled = information * np.outer(scale, scale) + 1e-12 * np.eye(len(scale))
    return np.linalg.inv(scaled) * np.outer(scale, scale)


def mean_square(r: Array, data: WeakData) -> Array:
    """Mean square of a whitened residual for each of the 2n equations; 1 is the noise floor."""
    size = len(data.names)
    total = np.bincount(data.equation, weights=r**2, minlength=size)
    count = np.bincount(data.equation, minlength=size)
    return np.divide(total, count, out=np.full(size, np.nan), where=count > 0)


def free_parameters(vehicle: Vehicle) -> tuple[str, ...]:
    """Parameters that the vehicle file marks as to be estimated and that the equations contain."""
    return tuple(n for n in vehicle.parameter_names if vehicle.value_of(n).estimate)


def fit_weak(
    vehicle: Vehicle,
    data: WeakData,
    free: Sequence[str] | None = None,
    *,
    start: Mapping[str, float] | None = None,
    whitening: list[Whitening] | None = None,
    dispersion: Array | None = None,
    max_iterations: int = _MAX_ITERATIONS,
) -> WeakFit:
    """Fit the free parameters of a vehicle.

    Parameters
    ----------
    vehicle : Vehicle
        Model with starting values.
    data : WeakData
        Prepared logs.
    free : sequence of str, optional
        Names of the parameters to fit; by default those that the vehicle marks with `estimate`.
    start : mapping, optional
        Starting values that differ from the vehicle's.
    whitening, dispersion : optional
        Noise model to use; worked out from the first fit where not given.
    """
    functions = Functions(vehicle)
    model = WeakModel(functions, free_parameters(vehicle) if free is None else free)
    p = np.array(functions.values(), dtype=float)
    for name, value in (start or {}).items():
        p[functions.parameter_names.index(name)] = value
    if whitening is not None and dispersion is not None:
        return _solved(model, p, data, whitening, dispersion, max_iterations)
    fit = _solved(model, p, data, model.whitening(data, p), np.ones(len(data.names)), max_iterations)
    for _ in range(2):
        spread = np.maximum(1.0, np.nan_to_num(fit.mean_square(), nan=1.0))
        fit = _solved(model, fit.p, data, model.whitening(data, fit.p), spread, max_iterations)
    return fit


def _solved(
    model: WeakModel, p: Array, data: WeakData, whitening: list[Whitening], dispersion: Array, max_iterations: int
) -> WeakFit:
    bounds = _bounds(model)
    prior = _prior(model)
    weight = 1.0 / np.sqrt(dispersion[data.equation])
    places = list(model.places)
    p = p.copy()
    p[places] = np.clip(p[places], *bounds)
    at = whitened(model.linearise(data, p), whitening)
    iteration = 0
    for iteration in range(1, max_iterations + 1):
        step = _step(at, weight, p[places], bounds, prior)
        promised = _squares(at.r, weight) - _squares(at.r + at.J @ step, weight)
        p, at = _line_search(model, p, places, step, at, weight, data, whitening, bounds)
        if promised < _ENOUGH:
            break
    return WeakFit(model, p, data, whitening, at, dispersion, iteration)


def _squares(r: Array, weight: Array) -> float:
    return float(np.sum((r * weight) ** 2))


def _bounds(model: WeakModel) -> tuple[Array, Array]:
    vehicle = model.functions.vehicle
    pairs = []
    for name in model.free:
        bare = name.removesuffix("_forward").removesuffix("_backward")
        low, high = vehicle.declared_parameters[bare].bounds
        value = vehicle.value_of(name).value
        # A value that the user allowed against its sign keeps its freedom.
        pairs.append((min(low, value) if value else low, max(high, value) if value else high))
    table = np.array(pairs).reshape(-1, 2)
    return table[:, 0], table[:, 1]


def _prior(model: WeakModel) -> tuple[Array, Array]:
    """Where stated priors are and how much they weigh."""
    values = [model.functions.vehicle.value_of(n) for n in model.free]
    centre = np.array([v.value for v in values])
    weight = np.array([0.0 if v.sigma is None else 1.0 / (_PRIOR_WIDTH * v.sigma) for v in values])
    return centre, weight


def _step(
    at: Linearised, weight: Array, now: Array, bounds: tuple[Array, Array], prior: tuple[Array, Array]
) -> Array:
    """Bounded least-squares step of the linearised problem."""
    if not len(now):
        return np.zeros(0)
    weighted = at.J * weight[:, None]
    centre, stiffness = prior
    gram = weighted.T @ weighted + np.diag(stiffness**2)
    slope = weighted.T @ (at.r * weight) + stiffness**2 * (now - centre)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
    scaled = gram * np.outer(scale, scale) + 1e-11 * np.eye(len(now))
    factor = np.linalg.cholesky(scaled).T
    target = np.linalg.solve(factor.T, -slope * scale)
    low, high = ((b - now) / scale for b in bounds)
    if np.all(np.isinf(low)) and np.all(np.isinf(high)):
        return np.linalg.solve(factor, target) * scale
    return lsq_linear(factor, target, bounds=(low - 1e-12, high + 1e-12), tol=1e-12).x * scale


def _line_search(
    model: WeakModel,
    p: Array,
    places: list[int],
    step: Array,
    at: Linearised,
    weight: Array,
    data: WeakData,
    whitening: list[Whitening],
    bounds: tuple[Array, Array],
) -> tuple[Array, Linearised]:
    """Halve the step until the weighted error falls."""
    before = _squares(at.r, weight)
    for share in (1.0, 0.5, 0.25, 0.1, 0.02):
        tried = p.copy()
        tried[places] = np.clip(p[places] + share * step, *bounds)
        after = whitened(model.linearise(data, tried), whitening)
        if _squares(after.r, weight) <= before * (1 + 1e-12):
            return tried, after
    return p, at


