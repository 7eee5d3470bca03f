"""Fitting the weak residual: Gauss-Newton, generalised least squares, instruments; and to a new run."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from undertow.errors import UndertowError
from undertow.identification.logs.run import Run
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Flags, Index

from .data import Segment, WeakData, clustered, prepare, summed_scores
from .fitted import BETWEEN_RUNS, Fitted, least_differing, may_differ, stated_by_run
from .predictor import Predictor
from .residual import Linearised, WeakModel, origins, run_of, value_name, whitened, with_values_by_run
from .step import Constraints, SearchSpace, damped, require_equations, squared
from .test_functions import Whitening
from .threads import one_thread
from .windows import Windows, cut


@dataclass(frozen=True)
class WeakFormSettings:
    """Settings of the fit in the weak form."""

    most_steps: int = 15
    # Predicted reduction of chi-square below which a step is negligible.
    least_reduction: float = 0.01
    # Damping of a step (Levenberg-Marquardt) after a full one that raised the cost, the factor by which more
    # failures raise and a success lowers it, and the largest tried.
    least_damping: float = 1e-3
    more_damping: float = 10.0
    most_damping: float = 1e3
    rounding: float = 1e-12  # relative rise of the cost that is rounding
    # Steps of the intensity of the disturbance, which makes the mean square of the whitened residual one, the
    # power of that mean square by which each multiplies it, and limits of this factor.
    matching_steps: int = 4
    matching_power: float = 1.5
    matching_limits: tuple[float, float] = (0.02, 50.0)
    # Largest mean square of an equation that still counts as noise of the channels.
    noise_limit: float = 1.6
    # The same, up to which a fit without any disturbance may bring it down to that.
    without_disturbance_limit: float = 30.0
    noise_rounds: int = 6
    noise_converged: float = 0.2  # change of the logarithm of an intensity with which the rounds end
    # Relative change of a parameter from which the covariance by the sensors' noise is recomputed.
    noise_update: float = 0.05


SETTINGS = WeakFormSettings()
_PLAIN = Constraints()


def mean_square(r: Array, data: WeakData) -> Array:
    """Mean square of a whitened residual for each of the 2n equations; 1 is the noise floor."""
    return mean_square_by(data.equation, r, len(data.names))


def mean_square_by(group: Index, r: Array, size: int) -> Array:
    """Mean square of the rows of each of `size` groups; NaN for a group without rows."""
    total, count = np.bincount(group, r**2, size), np.bincount(group, minlength=size)
    return np.divide(total, count, out=np.full(size, np.nan), where=count > 0)


def with_process_noise(sensor_noise: list[Whitening], disturbance: Array, data: WeakData) -> list[Whitening]:
    """A noise model with process noise of the given intensity in each equation."""
    level = disturbance[list(data.rows)]
    return [
        w.with_disturbance(np.tile(level, s.functions.count))
        for w, s in zip(sensor_noise, data.segments, strict=True)
    ]


def initial_disturbance(model: WeakModel, data: WeakData, p: Array) -> Array:
    """Intensity of process noise that would explain the whole residual of the unfitted model."""
    raw = np.concatenate([part.r for part in model.linearise(data, p)])
    lengths = [float(np.mean(s.functions.held.sum(axis=1))) for s in data.segments]
    return np.nan_to_num(mean_square(raw, data)) / float(np.mean(lengths))


def matched_disturbance(fit: WeakFit, sensor_noise: list[Whitening]) -> Array:
    """Intensity in each equation that makes the whitened residual of a fit have unit mean square.

    Zero where channel noise alone explains the residual.
    """
    data = fit.data
    parts = fit.model.linearise(data, fit.p)
    if fits_noise(whitened(parts, sensor_noise), data):
        return np.zeros(len(data.names))
    level = np.maximum(fit.disturbance, 1e-12 * np.max(fit.disturbance, initial=1e-30))
    for _ in range(SETTINGS.matching_steps):
        square = mean_square(whitened(parts, with_process_noise(sensor_noise, level, data)).r, data)
        level = level * matching_factor(np.nan_to_num(square, nan=1.0))
    return np.asarray(level)


def matching_factor(square: Array | float) -> Array:
    """Factor on the intensity of a disturbance with which a whitened residual has this mean square."""
    return np.asarray(np.clip(square**SETTINGS.matching_power, *SETTINGS.matching_limits))


def fits_noise(at: Linearised, data: WeakData) -> bool:
    return bool(np.nanmax(mean_square(at.r, data)) < SETTINGS.noise_limit)


@dataclass(frozen=True)
class WeakFit(Fitted):
    """A model fitted to logs in the weak form."""

    model: WeakModel  # Model and names of the free parameters
    p: Array  # (n_parameters,) all parameters
    data: WeakData  # What it was fitted to
    whitening: list[Whitening]  # Noise model that was used
    at: Linearised  # Whitened residual and derivative at p
    # (2n,) intensity of what the model leaves beyond the noise, for each equation, (m/s^2)^2 s and the
    # like
    disturbance: Array
    iterations: int  # Gauss-Newton steps taken

    @cached_property
    def gram(self) -> Array:
        """J' J of the whitened residual, shape (n_free, n_free)."""
        return self.at.J.T @ self.at.J

    @cached_property
    def noise_gram(self) -> Array:
        """J' J in units of sensor noise alone, without a disturbance."""
        sensor_noise = self.model.whitening(self.data, self.p)
        J = whitened(self.model.linearise(self.data, self.p), sensor_noise).J
        return np.asarray(J.T @ J)

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the free parameters: never less than noise alone gives, and robust to
        autocorrelation.

        Blocks of a few seconds are the groups of `clustered`.
        """
        return clustered(self.information, summed_scores(self.at.r, self.at.J, self.data.block))

    @property
    def cost(self) -> float:
        """Sum of squares of the whitened residual."""
        return float(np.sum(self.at.r**2))

    def mean_square(self) -> Array:
        """Mean square of the whitened residual for each of the 2n equations (NaN where not used)."""
        return mean_square(self.at.r, self.data)


def free_parameters(vehicle: Vehicle) -> tuple[str, ...]:
    """Parameters that the vehicle file marks as to be estimated and that the equations contain."""
    return tuple(n for n in vehicle.parameter_names if vehicle.value_of(n).estimate)


def required_free_parameters(vehicle: Vehicle) -> tuple[str, ...]:
    """The same; an UndertowError if there are none."""
    if free := free_parameters(vehicle):
        return free
    raise UndertowError(
        f"no parameter of '{vehicle.name}' is marked for estimation: write, for instance, "
        "X_u = { value = ..., estimate = true }"
    )


@one_thread()
def fit_weak(
    vehicle: Vehicle | WeakModel,
    data: WeakData,
    free: Sequence[str] | None = None,
    *,
    start: Mapping[str, float] | None = None,
    constraints: Constraints = _PLAIN,
) -> WeakFit:
    """Fit the free parameters of a vehicle, by default those that it marks with `estimate`.

    A `WeakModel` has its own free parameters and constraints. `start` has starting values that differ from
    the vehicle's. The noise model is estimated from the residual of the fit itself.
    """
    model = vehicle if isinstance(vehicle, WeakModel) else _model_of(vehicle, free, constraints)
    p = model.initial_p(start or {})
    model.require_defined(data, p)
    disturbance = initial_disturbance(model, data, p)
    noise = with_process_noise(model.whitening(data, p), disturbance, data)
    return with_reestimated_noise(_gauss_newton(model, p, data, noise, disturbance))


@one_thread()
def fit_under_noise(
    model: WeakModel,
    data: WeakData,
    start: Mapping[str, float],
    whitening: list[Whitening],
    disturbance: Array,
    *,
    steps: int = SETTINGS.most_steps,
    tolerance: float = 0.0,
) -> WeakFit:
    """Fit a model from starting values under a given noise model.

    The search ends where the predicted reduction is less than `tolerance`, as a share of the sum of squares.
    """
    return _gauss_newton(model, model.initial_p(start), data, whitening, disturbance, steps, tolerance)


def refitted(
    fit: WeakFit, model: WeakModel, start: Mapping[str, float] | None = None, *, tolerance: float = 0.0
) -> WeakFit:
    """Another model fitted to the data of a fit under its noise model, by default from its values."""
    begin = fit.values if start is None else start
    return fit_under_noise(model, fit.data, begin, fit.whitening, fit.disturbance, tolerance=tolerance)


@one_thread()
def fit_weak_by_run(vehicle: Vehicle | WeakModel, data: WeakData) -> WeakFit:
    """Fit like `fit_weak`, with values by run for parameters that differ between the runs.

    Those are the parameters that the vehicle file marks with `per_run`, and variable ones that differ
    significantly (see `split_between_runs`).
    """
    model = vehicle if isinstance(vehicle, WeakModel) else _model_of(vehicle, None, _PLAIN)
    stated = stated_by_run(model.functions.vehicle, model.values.names)
    model = model.with_free(with_values_by_run(model.free, stated, origins(data.runs)))
    return split_between_runs(fit_weak(model, data))


def split_between_runs(fit: WeakFit, among: Collection[str] | None = None) -> WeakFit:
    """The fit with values by run for those common parameters that differ significantly between runs.

    `among` are the parameters in question; by default all variable ones.
    """
    groups = may_differ(fit.model, fit.data.runs, among)
    while groups:
        names = [name for group in groups for name in group]
        model = fit.model.with_free(with_values_by_run(fit.model.free, names, origins(fit.data.runs)))
        split = refitted(fit, model)
        values = split.p[list(model.places)]
        worst, chance = least_differing(model, values, split.covariance, groups)
        if chance < BETWEEN_RUNS.chance:
            return split_between_runs(with_reestimated_noise(split), among)
        groups.pop(worst)
    return fit


def _model_of(vehicle: Vehicle, free: Sequence[str] | None, constraints: Constraints) -> WeakModel:
    return constraints.model(vehicle, free_parameters(vehicle) if free is None else free)


def with_reestimated_noise(fit: WeakFit, most: int = SETTINGS.noise_rounds) -> WeakFit:
    """Reestimate the noise from the residual of a fit, and fit again, until neither changes."""
    sensor_noise, at = fit.model.whitening(fit.data, fit.p), fit.p
    for _ in range(most):
        # The covariance by the sensors' noise is expensive, and depends on the parameters only weakly.
        if _noise_outdated(fit.p, at):
            sensor_noise, at = fit.model.whitening(fit.data, fit.p), fit.p
        disturbance = matched_disturbance(fit, sensor_noise)
        changed = np.max(np.abs(np.log((disturbance + 1e-30) / (fit.disturbance + 1e-30))))
        whitening = with_process_noise(sensor_noise, disturbance, fit.data)
        fit = _gauss_newton(fit.model, fit.p, fit.data, whitening, disturbance)
        if changed < SETTINGS.noise_converged or not np.any(disturbance):
            break
    return _without_disturbance(fit)


def _without_disturbance(fit: WeakFit) -> WeakFit:
    """The fit under sensor noise alone, if that explains what it leaves then.

    Process noise that explains a poor fit keeps it poor: where the residual is small, both are tried.
    """
    if not np.any(fit.disturbance):
        return fit
    sensor_noise = fit.model.whitening(fit.data, fit.p)
    left = mean_square(whitened(fit.model.linearise(fit.data, fit.p), sensor_noise).r, fit.data)
    if np.nanmax(left) > SETTINGS.without_disturbance_limit:
        return fit
    zero = np.zeros_like(fit.disturbance)
    other = _gauss_newton(fit.model, fit.p, fit.data, sensor_noise, zero)
    return other if fits_noise(other.at, fit.data) else fit


def _noise_outdated(p: Array, since: Array) -> bool:
    """Whether a parameter has changed so much that sensor noise enters differently."""
    return bool(np.any(np.abs(p - since) > SETTINGS.noise_update * np.abs(since)))


def predicted_cost(fit: WeakFit) -> tuple[float, dict[str, float]]:
    """Sum of squares that is predicted after one more Gauss-Newton step, and the parameters after it."""
    space = SearchSpace(fit.model, limited=True)
    step = space.step(fit.at, fit.p)
    after = space.after_step(fit.p, step)[space.places]
    return squared(fit.at.r + fit.at.J @ step), dict(zip(fit.model.free, after.tolist(), strict=True))


def _gauss_newton(
    model: WeakModel,
    p: Array,
    data: WeakData,
    whitening: list[Whitening],
    disturbance: Array,
    most_steps: int = SETTINGS.most_steps,
    tolerance: float = 0.0,
) -> WeakFit:
    """Gauss-Newton steps from p under a fixed noise model, damped where a full one raises the cost."""
    space = SearchSpace(model, limited=True)
    p = space.nearest(p)
    at = whitened(model.linearise(data, p), whitening)
    iteration, damping = 0, 0.0
    for _ in range(most_steps):
        step, cost = space.step(at, p), space.cost(p, squared(at.r))
        predicted = space.predicted_cost(p, step, at.r + at.J @ step)
        if cost - predicted < max(SETTINGS.least_reduction, tolerance * squared(at.r)):
            break
        iteration += 1
        limit, found = cost * (1.0 + SETTINGS.rounding), None
        while found is None and damping <= SETTINGS.most_damping:
            q = space.after_step(p, space.step(damped(at.r, at.J, damping), p) if damping else step)
            end = whitened(model.linearise(data, q), whitening)
            if space.cost(q, squared(end.r)) <= limit:
                found = q, end
            else:
                damping = max(SETTINGS.more_damping * damping, SETTINGS.least_damping)
        if found is None:  # no damping helps, and the next step would be the same
            break
        p, at = found
        # The next step may be freer, or free.
        damping = damping / SETTINGS.more_damping if damping > SETTINGS.least_damping else 0.0
    return WeakFit(model, p, data, whitening, at, disturbance, iteration)


@dataclass(frozen=True)
class InstrumentalSettings:
    """Numbers of the search with instrumental variables."""

    most_steps: int = 25
    shortest_step: float = 1e-3  # in standard deviations; a search ends with it
    # Outer nodes of a three-point Gauss-Hermite rule, in standard deviations, and their weight.
    node: float = float(np.sqrt(3.0))
    weight: float = 1.0 / 6.0


INSTRUMENTAL = InstrumentalSettings()


@one_thread()
def fit_instrumental(
    vehicle: Vehicle,
    runs: Sequence[Run],
    free: Sequence[str] | None = None,
    horizon: float | None = None,
    *,
    constraints: Constraints = _PLAIN,
) -> WeakFit:
    """Fit the free parameters of a vehicle by the weak form with simulated regressors as instruments.

    The parameters are those of `fit_output_error`; with `horizon` None each segment without gaps is simulated
    as a whole from its measured start.
    """
    model = constraints.model(vehicle, free_parameters(vehicle) if free is None else free)
    data = prepare(runs, vehicle)
    require_equations(model, data, "instrumental")
    weak = fit_weak(model, data)
    return _Instruments(model, weak, cut(runs, vehicle, horizon)).fit()


class _Instruments:
    """Solves J_s' W (r - e) = 0, J_s the regressor of the simulated motion, e the excess by noise."""

    def __init__(self, model: WeakModel, weak: WeakFit, windows: Windows) -> None:
        self._model, self._weak, self._windows = model, weak, windows
        self._predictor = Predictor(model.functions)

    def fit(self) -> WeakFit:
        space, p, iterations = SearchSpace(self._model), self._weak.p, 0
        while iterations < INSTRUMENTAL.most_steps:
            iterations += 1
            at = self._linearised(p)
            step = space.step(at, p)
            p = space.after_step(p, step)
            if np.linalg.norm(at.J @ step) < INSTRUMENTAL.shortest_step:
                break
        return replace(self._weak, p=p, at=self._linearised(p), iterations=iterations)

    def _linearised(self, p: Array) -> Linearised:
        """Whitened residual of the measured motion less its excess, and the instruments."""
        data = self._weak.data
        simulated = self._simulated(p)
        # Weights computed from the measured motion would be correlated with its noise.
        sensor_noise = self._model.whitening(simulated, p)
        whitening = with_process_noise(sensor_noise, self._weak.disturbance, simulated)
        noise_free = self._model.linearise(simulated, p)
        excess = self._noise_excess(simulated, [part.r for part in noise_free], p)
        measured = self._model.linearise(data, p)
        parts = [
            replace(s, r=m.r - e, known=m.known) for s, m, e in zip(noise_free, measured, excess, strict=True)
        ]
        return whitened(parts, whitening)

    def _simulated(self, p: Array) -> WeakData:
        """The data with the simulated motion for the measured one, where a window covers it."""
        windows, data = self._windows, self._weak.data
        reports = self._predictor.reports(windows, p)
        if not np.isfinite(reports[windows.inside]).all():
            raise UndertowError(
                "the simulation diverges with the values of the weak form: give a shorter horizon, or use "
                "--method weak"
            )
        motion = [np.full((len(run.t), len(data.names)), np.nan) for run in data.runs]
        for run, rows, inside, values in zip(
            windows.run, windows.samples, windows.inside, reports, strict=True
        ):
            motion[run][rows[inside]] = values[inside]
        return replace(data, segments=tuple(_replaced(s, motion[s.run]) for s in data.segments))

    def _noise_excess(self, simulated: WeakData, noise_free: list[Array], p: Array) -> list[Array]:
        """Mean of the residual over the noise of the channels, less the residual without noise."""
        found = [np.zeros(len(r)) for r in noise_free]
        for channel in np.flatnonzero(self._weak.data.sigma > 0):
            for sign in (INSTRUMENTAL.node, -INSTRUMENTAL.node):
                moved = self._model.linearise(_shifted(simulated, int(channel), sign), p)
                for total, part, r in zip(found, moved, noise_free, strict=True):
                    total += INSTRUMENTAL.weight * (part.r - r)
        return found


def _replaced(segment: Segment, motion: Array) -> Segment:
    own = motion[segment.samples]
    return replace(segment, measured=np.where(np.isfinite(own), own, segment.measured))


def _shifted(data: WeakData, channel: int, sigmas: float) -> WeakData:
    move = np.zeros(len(data.sigma))
    move[channel] = sigmas * data.sigma[channel]
    return replace(data, segments=tuple(replace(s, measured=s.measured + move) for s in data.segments))


# --- a vehicle in a run that it was not fitted to -------------------------------------------------
@dataclass(frozen=True)
class AdaptationSettings:
    """Numbers of the adaptation to a run."""

    # Share of a run from which its own values are estimated; the rest is for validation. A current or a trim
    # takes a few manoeuvres to show, and the validation part should be the larger one.
    share: float = 1.0 / 3.0


ADAPTATION = AdaptationSettings()


def per_run_parameters(vehicle: Vehicle) -> tuple[str, ...]:
    """Parameters that have a value in every run: those with ``per_run = true`` that may be estimated."""
    values = ((n, vehicle.value_of(n)) for n in vehicle.parameter_names)
    return tuple(n for n, value in values if value.per_run and value.estimate)


def adapted(vehicle: Vehicle, run: Run) -> tuple[Vehicle, Run]:
    """A vehicle with the values of a run, and the part of the run on which it may be scored.

    Parameters with a value per run (current, trim: ``per_run = true``) are estimated by the weak form from
    the first part of the run, with all others as stated; the stated value with its sigma (mean and spread of
    the fitted runs) is the prior. Nothing is estimated from the scored part. Without such parameters, vehicle
    and run are returned unchanged.
    """
    names = per_run_parameters(vehicle)
    if not names:
        return vehicle, run
    end = end_of_first_part(run)
    first, rest = run.slice(None, end), run.slice(end, None)
    rest = rest.with_notes(f"{', '.join(names)} from the run up to {end:.4g} s; the rest is for validation")
    try:
        return fit_weak(vehicle, prepare([first], vehicle), names).vehicle, rest
    except UndertowError:  # too short for the weak form, or without a finite force: the mean is used
        return vehicle, rest


def end_of_first_part(run: Run) -> float:
    """End of the part of a run from which its own values are estimated, s (see `adapted`)."""
    return float(run.t[0]) + ADAPTATION.share * float(run.t[-1] - run.t[0])


def first_part(run: Run, vehicle: Vehicle, sigma: Array | None = None) -> WeakData | None:
    """That part, prepared for the weak form; None where it is too short."""
    try:
        return prepare([run.slice(None, end_of_first_part(run))], vehicle, sigma)
    except UndertowError:
        return None


def values_in_runs(fit: Fitted, first_parts: Sequence[WeakData]) -> dict[str, float]:
    """Values in runs that a fit was not fitted to, by names such as V_N@dive2, from their first parts."""
    found: dict[str, float] = {}
    names = list(fit.model.values.by_run)
    model = WeakModel(fit.model.functions, names)
    for data in first_parts:
        own = fit_weak(model, data, start=fit.values).values
        found |= {value_name(name, data.runs[0].origin): own[name] for name in names}
    return found


def in_run(fit: Fitted, run: Run) -> tuple[Vehicle, Run]:
    """A fitted vehicle in a run, and the part of the run on which it may be scored (see `adapted`).

    A training run, or a segment of one, has the values found for it, and all of it is scored.
    """
    if run.origin in fit.runs_with_values:
        return fit.vehicle_in(run), run
    if run.origin in {run_of(name) for name in fit.model.values.known}:
        return fit.vehicle_in(run), run.slice(end_of_first_part(run), None)
    return adapted(fit.vehicle, run)


def used_in_estimation(fit: Fitted, runs: Sequence[Run], run: Index, time: Array) -> Flags:
    """Which rows or windows, of these runs and at these times, were used to estimate values of their run."""
    known = {run_of(name) for name in fit.model.values.known}
    ends = np.array([end_of_first_part(r) if r.origin in known else -np.inf for r in runs])
    return np.asarray(time < ends[run])


def estimation_part_factor(squares: Array, first: Flags, group: Index) -> Array:
    """Factor, at least 1, that raises squares in the part used for estimation to the level of the rest.

    squares: (m,) or (m, n), by row or window and quantity.
    first: (m,), what was used for estimation.
    group: (m,), groups that count by themselves, such as runs.
    """
    factor = np.ones(squares.shape)
    for number in np.unique(group[first]):
        used, rest = ((group == number) & rows for rows in (first, ~first))
        if rest.any():
            means = [np.mean(squares[rows], axis=0) for rows in (used, rest)]
            factor[used] = np.maximum(means[1] / np.maximum(means[0], 1e-300), 1.0)
    return factor


def in_runs(fit: Fitted, runs: Sequence[Run]) -> tuple[list[Vehicle], list[Run]]:
    """The same for several runs: a vehicle for each, and the part of each to be scored."""
    pairs = [in_run(fit, run) for run in runs]
    return [vehicle for vehicle, _ in pairs], [rest for _, rest in pairs]
