"""The common basis on which candidates are compared: data, noise model, and the model without a candidate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from undertow.codegen.functions import Functions
from undertow.identification.estimation.data import WeakData, group_numbers
from undertow.identification.estimation.fitted import Fitted, stated_by_run
from undertow.identification.estimation.prediction_error import (
    PredictionErrorFit,
    refit_by_prediction_error,
)
from undertow.identification.estimation.residual import (
    Linearised,
    WeakModel,
    base_name,
    origins,
    whitened,
    with_values_by_run,
)
from undertow.identification.estimation.step import Constraints, prior_distance
from undertow.identification.estimation.test_functions import Whitening
from undertow.identification.estimation.weak_form import (
    WeakFit,
    estimation_part_factor,
    first_part,
    fit_under_noise,
    fit_weak_by_run,
    free_parameters,
    mean_square,
    used_in_estimation,
    values_in_runs,
    with_process_noise,
    with_reestimated_noise,
)
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Flags

from .candidates import dominant_frequency
from .settings import DEFAULT, Settings


@dataclass(frozen=True)
class Score:
    """A model evaluated on data that it was not fitted to.

    r: (m,), whitened residual.
    mean_square: (2n,), mean square for each equation.
    initial_states: (m,), part of the residual due to unknown initial states of effects, which no model
    could predict, in the model with which this one is compared.
    error: normalised error: geometric mean over the equations of the whitened rms.
    """

    r: Array
    mean_square: Array
    initial_states: Array | float = 0.0

    @property
    def error(self) -> float:
        return error_of(self.mean_square)


def comparable_mean_squares(before: Score, after: Score, data: WeakData) -> tuple[Array, Array]:
    """Mean squares of two models for each equation, without the part due to unknown initial states."""
    unknown = after.initial_states
    return mean_square(before.r - unknown, data), mean_square(after.r - unknown, data)


def error_of(mean_squares: Array) -> float:
    """Geometric mean over the equations of the whitened rms."""
    return float(np.exp(0.5 * np.nanmean(np.log(np.maximum(mean_squares, 1e-12)))))


def score_of(fit: Fitted, data: WeakData, noise: list[Whitening], reference: Array | None = None) -> Score:
    """Score of a model on data, relative to the residual of a reference (see `whitened`)."""
    parts = fit.model.linearise(data, fit.p)
    r = whitened(parts, noise, reference).r
    compensated = reference is not None and any(np.any(part.start) for part in parts)
    return Score(r, mean_square(r, data), r - whitened(parts, noise).r if compensated else 0.0)


@dataclass(frozen=True)
class Bench:
    """Data and noise model common to all candidates.

    train, test: training and validation data.
    train_whitening, test_whitening: noise of both, the same for all candidates.
    base: the model without any candidate, fitted to the training data.
    settings: the decision thresholds.
    """

    train: WeakData
    test: WeakData
    train_whitening: list[Whitening]
    test_whitening: list[Whitening]
    base: WeakFit
    settings: Settings = DEFAULT

    @cached_property
    def base_score(self) -> Score:
        """Score of the model without any candidate on the validation data."""
        return self.score(self.base)

    @cached_property
    def stated_start(self) -> dict[str, float]:
        """Stated values of the free parameters, if the refit of the model as given moved one of them far.

        That indicates a missing effect; with it, the stated values are the better start. Else empty.
        """
        model = self.base.model
        if not np.any(prior_distance(model, self.base.p) > self.settings.far_from_prior):
            return {}
        values = {n: model.functions.vehicle.value_of(base_name(n)).value for n in model.free}
        return {n: v for n, v in values.items() if np.isfinite(v)}

    def precompute(self) -> None:
        """Compute once what all candidates use, before processes share this bench."""
        for name in ("base_score", "observed_ranges", "stated_start"):
            getattr(self, name)

    def score(self, fit: WeakFit) -> Score:
        """Score of a fitted model on the validation data."""
        reference = None if fit is self.base else self.base_score.r
        score = score_of(fit, self.test, self.test_whitening, reference)
        if not fit.model.values.known:
            return score
        r = self._corrected(fit, score.r)
        return Score(r, mean_square(r, self.test), score.initial_states)

    def _corrected(self, fit: WeakFit, r: Array) -> Array:
        """A residual, raised where a fit used data of a run to the level of the rest of that run."""
        data = self.test
        first = used_in_estimation(fit, data.runs, data.run_of, data.time)
        return r * np.sqrt(estimation_part_factor(r**2, first, group_numbers(data.run_of, data.equation)))

    @cached_property
    def _first_parts(self) -> list[WeakData]:
        """First parts of the validation runs that are not segments of training runs."""
        fitted, vehicle = origins(self.train.runs), self.base.model.functions.vehicle
        others = (r for r in self.test.runs if r.origin not in fitted)
        parts = (first_part(r, vehicle, self.train.sigma) for r in others)
        return [part for part in parts if part is not None]

    def in_all_runs(self, fit: WeakFit) -> WeakFit:
        """A fit with values in the validation runs for the parameters with a value per run."""
        if not fit.model.values.split:
            return fit
        return replace(fit, model=fit.model.with_known_values(values_in_runs(fit, self._first_parts)))

    def on_train(self, fit: WeakFit) -> Linearised:
        """A fitted model on the training data, under the noise model of the bench."""
        if fit.whitening is self.train_whitening:
            return fit.at
        return whitened(fit.model.linearise(self.train, fit.p), self.train_whitening)

    def on_test(self, fit: WeakFit) -> Linearised:
        """A fitted model on the validation data; unknown initial states bring no advantage over the base."""
        parts = fit.model.linearise(self.test, fit.p)
        at = whitened(parts, self.test_whitening, self.base_score.r)
        return replace(at, r=self._corrected(fit, at.r)) if fit.model.values.known else at

    def fit(
        self,
        model: Vehicle | WeakModel,
        free: Sequence[str] | None = None,
        start: Mapping[str, float] | None = None,
        *,
        tolerance: float = 0.0,
    ) -> WeakFit:
        """Fit a model to the training data under the noise model of the base."""
        if isinstance(model, Vehicle):
            names = free_parameters(model) if free is None else free
            free = with_values_by_run(names, stated_by_run(model, names), origins(self.train.runs))
            model = Constraints().model(model, free)
        noise = self.train_whitening, self.base.disturbance
        return self.in_all_runs(fit_under_noise(model, self.train, start or {}, *noise, tolerance=tolerance))

    def with_model(self, vehicle: Vehicle, start: Mapping[str, float]) -> Bench:
        """The bench whose base is another model, fitted from a start."""
        return replace(self, base=self.fit(vehicle, start=start))

    @cached_property
    def noise_level(self) -> Array:
        """Mean square that channel noise alone would have on the validation data, for each equation."""
        rng = np.random.default_rng(0)
        return mean_square(np.concatenate([w.noise_sample(rng) for w in self.test_whitening]), self.test)

    def with_noise_model_of(self, fit: WeakFit) -> Bench:
        """The bench with the noise model of a better fit, so that the remainder is weighted correctly."""
        fit = with_reestimated_noise(fit, most=self.settings.noise_rounds)
        test = with_process_noise(fit.model.whitening(self.test, fit.p), fit.disturbance, self.test)
        refitted = self._refitted_base(fit.whitening, fit.disturbance, self.settings.rough_step)
        return replace(self, train_whitening=fit.whitening, test_whitening=test, base=refitted)

    @cached_property
    def base_by_prediction_error(self) -> PredictionErrorFit:
        """The model without any candidate, fitted to the training data with process noise."""
        return refit_by_prediction_error(self.base, self.train.runs)

    def without_disturbance(self) -> Bench:
        """The bench under sensor noise alone."""
        base = self.base
        sensor_noise = base.model.whitening(self.train, base.p)
        refitted = self._refitted_base(sensor_noise, np.zeros_like(base.disturbance))
        on_test = refitted.model.whitening(self.test, refitted.p)
        return replace(self, train_whitening=sensor_noise, test_whitening=on_test, base=refitted)

    def _refitted_base(self, noise: list[Whitening], disturbance: Array, tolerance: float = 0.0) -> WeakFit:
        """The model without any candidate, fitted under another noise model."""
        start = self.base.model, self.train, self.base.values
        return fit_under_noise(*start, noise, disturbance, tolerance=tolerance)

    @property
    def command_scale(self) -> float:
        """Typical large command, for starting values in units of the command."""
        commands = [np.abs(s.u) for s in self.train.segments if s.u.size]
        return float(np.quantile(np.concatenate(commands), 0.9)) if commands else 1.0

    @cached_property
    def observed_ranges(self) -> dict[str, tuple[float, float]]:
        """Range of each pose coordinate, and of the dominant frequency of the residual."""
        names = self.base.model.functions.vehicle.pose_names
        poses = np.vstack([s.measured[:, : len(names)] for s in self.train.segments])
        low, high = np.nanmin(poses, axis=0).tolist(), np.nanmax(poses, axis=0).tolist()
        found = dict(zip(names, zip(low, high, strict=True), strict=True))
        line = dominant_frequency(self.base.at.r, self.train, self.settings)
        return found if line is None else found | {"dominant_frequency": line}


def open_bench(vehicle: Vehicle, train: WeakData, test: WeakData, settings: Settings = DEFAULT) -> Bench:
    """Fit the model as given and use its noise model for both parts of the data."""
    base = _marked_by_run(fit_weak_by_run(vehicle, train))
    sensor_noise = base.model.whitening(test, base.p)
    noise = base.whitening, with_process_noise(sensor_noise, base.disturbance, test)
    bench = Bench(train, test, *noise, base, settings)
    return replace(bench, base=bench.in_all_runs(base))


def _marked_by_run(fit: WeakFit) -> WeakFit:
    """The fit of a vehicle, with the parameters marked that have a value in every run."""
    if not fit.model.values.split:
        return fit
    vehicle = fit.model.functions.vehicle
    by_run = {n: replace(vehicle.value_of(n), per_run=True) for n in fit.model.values.by_run}
    return replace(fit, model=WeakModel(Functions(vehicle.with_values(by_run)), fit.model.free))


def noise_ratio(fit: Fitted, data: WeakData) -> Array:
    """Mean square of the residual for each equation, relative to that of sensor noise alone.

    The noise model includes no disturbance here, so a slow model error counts fully.
    """
    whitening = fit.model.whitening(data, fit.p)
    return mean_square(whitened(fit.model.linearise(data, fit.p), whitening).r, data)


def error_falls(before: Fitted, after: Fitted, data: WeakData) -> bool:
    """Whether one model leaves less than another in units of sensor noise, all equations weighted equally.

    Under a noise model with a disturbance, the equations that are disturbed least decide.
    """
    return error_of(noise_ratio(after, data)) < error_of(noise_ratio(before, data))


def only_noise(fit: Fitted, data: WeakData, settings: Settings = DEFAULT) -> bool:
    """Whether sensor noise explains the residual of a model in each equation, given the number of rows."""
    return is_noise(noise_ratio(fit, data), rows_of(data), settings)


def rows_of(data: WeakData) -> NDArray[np.intp]:
    """Number of rows of each equation."""
    return np.bincount(data.equation, minlength=len(data.names))


def is_noise(ratio: Array, rows: NDArray[np.intp], settings: Settings = DEFAULT) -> bool:
    """Whether mean squares over so many rows each are those of noise; equations without rows are ignored."""
    return not _above_noise(ratio, rows, settings).any()


def _above_noise(ratio: Array, rows: NDArray[np.intp], settings: Settings) -> Flags:
    limit = 1.0 + settings.noise_uncertainty + settings.chance_errors * np.sqrt(2.0 / np.maximum(rows, 1))
    return np.asarray(~(ratio <= limit) & (rows > 0))  # what cannot be computed is no noise


def noise_in_more_equations(fit: Fitted, other: Fitted, data: WeakData, settings: Settings) -> bool:
    """Whether a model leaves only noise in each equation in which another one does, and in some more."""
    own, others = (_above_noise(noise_ratio(f, data), rows_of(data), settings) for f in (fit, other))
    return bool(np.all(others[own]) and own.sum() < others.sum())
