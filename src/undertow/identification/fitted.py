"""What every estimator hands back, and how far its parameters can be trusted."""

from __future__ import annotations

from typing import Literal, Protocol

import numpy as np

from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .base_parameters import undetermined
from .weak.residual import WeakModel
from .weak.step import at_bounds, inverse_of

#: |value| over its standard error below which a parameter could as well be zero.
SURE = 2.0
#: Fall of the sum of squares, in units of the noise, that is more than chance: twice the logarithm of a
#: likelihood ratio, which white noise brings above this once in 18 000 times at the most on kept-aside data.
MORE_THAN_CHANCE = 15.0
# The same for a parameter that is known, if not well.
_CLEAR = 5.0
# Correlation between the errors of two parameters beyond which only a combination of both is known, unless
# each is this many standard errors from zero all the same.
_TIED = 0.95
_WELL = 10.0
# Standard deviations of prior and fit together beyond which a value is far from what was stated.
_FAR = 3.0


class Estimates(Protocol):
    """Values with their errors."""

    @property
    def values(self) -> dict[str, float]:
        """Estimated values, SI and SNAME signs."""

    @property
    def standard_errors(self) -> dict[str, float]:
        """Standard errors, SI."""


class Fitted(Estimates, Protocol):
    """A fit of the free parameters of a model, whatever the estimator."""

    @property
    def model(self) -> WeakModel:
        """Model and names of the free parameters."""

    @property
    def p(self) -> Array:
        """All parameters of the model, in its order."""

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle with fitted values and standard errors."""

    @property
    def covariance(self) -> Array:
        """Covariance of the free parameters."""

    @property
    def gram(self) -> Array:
        """Information J'J of the data as they were weighed, without priors."""

    @property
    def noise_gram(self) -> Array:
        """The same if nothing but the noise of the sensors were in the data."""

    @property
    def condition(self) -> float:
        """Condition number of the scaled regressor."""

    @property
    def active(self) -> list[str]:
        """Constraints that hold the estimates back, by name."""


Verdict = Literal["identified", "weakly identified", "not identifiable"]


def verdicts(fit: Fitted) -> dict[str, Verdict]:
    """Whether this experiment determines each parameter.

    Not identifiable: within two standard errors of zero, or not felt by the data at all. Weakly identified:
    within five, known only together with another, or at the limit of what is physical.
    """
    sure = t_values(fit)
    open_ = {name for group in undetermined(fit.gram, fit.model.free) for name in group}
    doubtful = {*_tied(fit), *_bound(fit)}
    return {n: _verdict(sure[n], n in open_, n in doubtful) for n in fit.model.free}


def _verdict(t: float, undetermined: bool, doubtful: bool) -> Verdict:
    if t < SURE or undetermined:
        return "not identifiable"
    return "weakly identified" if t < _CLEAR or doubtful else "identified"


def cramer_rao(fit: Fitted) -> dict[str, float]:
    """Least standard error that an unbiased estimator can have by the noise of the sensors, by parameter.

    What comes on top of it in the standard errors is what the model leaves beyond the noise. Stated priors
    are no data, and do not count. For the weak form the data are the products with its test functions.
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
    """What speaks against a fitted value, by parameter: not identifiable, at a bound, far from its prior.

    Parameters
    ----------
    fit : Fitted
        The fit.
    stated : Vehicle
        The vehicle with the values and priors that were stated before.
    """
    found: dict[str, list[str]] = {n: [] for n in fit.model.free}
    for part in (_unsure(fit), _tied(fit), _bound(fit), _moved(fit, stated)):
        for name, text in part.items():
            found[name].append(text)
    return found


def _unsure(fit: Fitted) -> dict[str, str]:
    return {n: f"not identifiable: |t| = {t:.1f}" for n, t in t_values(fit).items() if t < SURE}


def _tied(fit: Fitted) -> dict[str, str]:
    between, names, sure = correlation(fit), fit.model.free, t_values(fit)
    np.fill_diagonal(between, 0.0)
    partner = np.argmax(np.abs(between), axis=1).tolist() if len(names) > 1 else []
    return {
        names[i]: f"known only together with {names[j]}: correlation {between[i, j]:.3f}"
        for i, j in enumerate(partner)
        if abs(between[i, j]) > _TIED and sure[names[i]] < _WELL
    }


def _bound(fit: Fitted) -> dict[str, str]:
    return dict.fromkeys(at_bounds(fit.model, fit.p), "at the limit of what is physical")


def _moved(fit: Fitted, stated: Vehicle) -> dict[str, str]:
    found = {}
    for name, value in fit.values.items():
        prior = stated.value_of(name)
        if prior.sigma:
            distance = abs(value - prior.value) / np.hypot(prior.sigma, fit.standard_errors[name])
            if distance > _FAR:
                found[name] = f"{distance:.1f} standard deviations from its prior"
    return found
