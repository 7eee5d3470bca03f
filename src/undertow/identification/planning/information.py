"""What is known of the parameters: stated priors, logs, and a manoeuvre to come, as Fisher information."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from ..logs import Run
from ..weak.data import WeakData, prepare
from ..weak.fit import WeakFit, fit_weak
from ..weak.residual import WeakModel, whitened
from ..weak.step import inverse_of, prior_of

# A parameter of which nothing is known may be off by this many times its size.
_VAGUE = 100.0
# It counts as unknown as long as its standard error is a good part of that.
_UNKNOWN = 0.3
# Errors so many times wider than by noise alone are worth a remark.
_WIDE = 1.5
# Beyond this, fitted values make up for what is missing, and those of the vehicle file are better ones.
_MISFIT = 5.0


@dataclass(frozen=True)
class Knowledge:
    """What is known of the free parameters before a manoeuvre.

    Attributes
    ----------
    vehicle : Vehicle
        The model at the values that are planned with.
    free : tuple of str
        Parameters to be determined.
    prior : (k, k) array
        Information of the stated standard deviations.
    logs : (k, k) array
        Information in the logs, as far as what the model leaves in them allows.
    spread : (k,) array
        How many times wider errors were on the logs than noise alone would make them, at least 1.
    """

    vehicle: Vehicle
    free: tuple[str, ...]
    prior: Array
    logs: Array
    spread: Array

    @property
    def misfit(self) -> float:
        """Median of the spread."""
        return float(np.median(self.spread)) if len(self.spread) else 1.0

    @cached_property
    def scale(self) -> Array:
        """Size of every parameter: its value, else what is stated of its error, else one."""
        values = [self.vehicle.value_of(n) for n in self.free]
        return np.array([abs(v.value) or v.sigma or 1.0 for v in values])

    @cached_property
    def vague(self) -> Array:
        """Information that keeps what nothing determines finite, shape (k, k)."""
        return np.diag((_VAGUE * self.scale) ** -2.0)

    @cached_property
    def now(self) -> Array:
        """Information before the manoeuvre, shape (k, k)."""
        return self.prior + self.logs + self.vague

    def after(self, gram: Array) -> Array:
        """Information after a manoeuvre with the information `gram` by noise alone, shape (k, k)."""
        return np.asarray(self.now + gram / np.outer(self.spread, self.spread))

    def errors(self, information: Array) -> Array:
        """Standard errors, shape (k,); inf for a parameter that is not known."""
        found = np.sqrt(np.diag(inverse_of(information)))
        return np.where(found < _UNKNOWN * _VAGUE * self.scale, found, np.inf)


def knowledge(vehicle: Vehicle, free: Sequence[str], runs: Sequence[Run]) -> Knowledge:
    """What the vehicle file and logs say.

    With logs, the model is fitted to them and planned with at the fitted values, unless these make up for
    something that the model lacks.

    Raises
    ------
    UndertowError
        If the logs do not fit the vehicle or are too short.
    """
    if not runs:
        return stated(vehicle, free)
    known = knowledge_of(fit_weak(vehicle, prepare(runs, vehicle), free), runs)
    return replace(known, vehicle=vehicle) if known.misfit >= _MISFIT else known


def stated(vehicle: Vehicle, free: Sequence[str]) -> Knowledge:
    """What the vehicle file says."""
    nothing = np.zeros((len(free), len(free)))
    return Knowledge(vehicle, tuple(free), _prior(vehicle, free), nothing, np.ones(len(free)))


def knowledge_of(fit: WeakFit, runs: Sequence[Run]) -> Knowledge:
    """What a fit to logs says, with the priors of the vehicle file as far as these are no such fit."""
    logs, spread = _told_by(fit)
    before = fit.model.functions.vehicle
    new = [n if not _fitted_to(before, n, runs) else None for n in fit.model.free]
    return Knowledge(fit.vehicle, fit.model.free, _prior(before, new), logs, spread)


def _prior(vehicle: Vehicle, names: Sequence[str | None]) -> Array:
    sigma = [None if n is None else vehicle.value_of(n).sigma for n in names]
    return np.diag([0.0 if not s else s**-2.0 for s in sigma])


def remarks_on(known: Knowledge, runs: Sequence[Run]) -> list[str]:
    """What to know about the numbers before a manoeuvre."""
    if not runs:
        return ["no logs are given: what is known now is what the vehicle file states"]
    remarks = []
    twice = [n for n in known.free if _fitted_to(known.vehicle, n, runs)]
    if twice:
        names = ", ".join(twice)
        remarks.append(f"stated errors of {names} come from a fit to these logs and do not count again")
    widest = float(np.max(known.spread, initial=1.0))
    if known.misfit >= _MISFIT:
        remarks.append(
            "the model misses too much of these logs to fit it: planned with the values of its file"
        )
    if widest > _WIDE:
        remarks.append(
            f"the model leaves more than noise on these logs: errors are up to {widest:.2g} times as wide as "
            "by noise alone, now and after the manoeuvre; undertow diagnose looks for what is missing"
        )
    return remarks


def _fitted_to(vehicle: Vehicle, name: str, runs: Sequence[Run]) -> bool:
    """Whether the file says that a value comes from a fit to one of these logs."""
    told, _, _ = vehicle.value_of(name).source.partition("; before: ")
    return told.startswith("fit to ") and any(run.name in told for run in runs)


def _told_by(fit: WeakFit) -> tuple[Array, Array]:
    """Information of logs, and how much wider than by noise alone the errors are."""
    weak_prior = np.diag(prior_of(fit.model)[1] ** 2)
    robust = np.sqrt(np.diag(fit.covariance) / np.maximum(np.diag(inverse_of(fit.information)), 1e-300))
    logs = fit.gram / np.outer(robust, robust)
    parts = fit.model.linearise(fit.data, fit.p)
    quiet = whitened(parts, fit.model.whitening(fit.data, fit.p)).J
    best = np.diag(inverse_of(quiet.T @ quiet + weak_prior))
    spread = np.sqrt(np.diag(inverse_of(logs + weak_prior)) / np.maximum(best, 1e-300))
    return logs, np.maximum(spread, 1.0)


def gram_along(model: WeakModel, data: WeakData, p: Array) -> Array | None:
    """Information that a log will hold on the free parameters by noise alone, shape (k, k).

    Parameters
    ----------
    model : WeakModel
        The model and its free parameters.
    data : WeakData
        The log as it is predicted, without noise but with the noise that its channels will have.
    p : (n_parameters,) array
        All parameters.

    Returns
    -------
    (k, k) array or None
        None where the residual is not finite.
    """
    at = whitened(model.linearise(data, p), model.whitening(data, p))
    return np.asarray(at.J.T @ at.J) if np.isfinite(at.J).all() else None


def log_determinant(information: Array, wanted: Sequence[int]) -> float:
    """Logarithm of the determinant of the information on some parameters, the others being free, too."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    scaled = information * np.outer(scale, scale)
    others = [i for i in range(len(scale)) if i not in wanted]
    whole = np.linalg.slogdet(scaled)[1] - 2 * np.sum(np.log(scale))
    if not others:
        return float(whole)
    rest = np.linalg.slogdet(scaled[np.ix_(others, others)])[1] - 2 * np.sum(np.log(scale[others]))
    return float(whole - rest)
