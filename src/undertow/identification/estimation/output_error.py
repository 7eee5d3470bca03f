"""Output error: parameters from simulations of many windows with estimated initial states."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from undertow.errors import UndertowError
from undertow.identification.logs.run import Run, robust_scale
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Progress

from .data import clustered, inverse_of, prepare, summed_scores
from .fitted import Fitted
from .predictor import Predictor, predict_each
from .residual import WeakModel, base_name
from .shooting import Reduced, Shooting
from .step import Constraints, SearchSpace, damped
from .threads import one_thread
from .weak_form import WeakFit, fit_weak_by_run, free_parameters, in_runs
from .windows import Windows, cut, horizons, prediction_error


@dataclass(frozen=True)
class OutputErrorSettings:
    """Settings of the fit by output error."""

    horizon: float = 5.0  # length of a window, s
    most_steps: int = 40
    # Fall of the sum of squares, in units of the mean square left times the inflation of the variances, below
    # which there is nothing left to gain: a tenth of a standard error.
    least_fall: float = 0.01
    # The same as a share of it, while the weights are still to be estimated from what is left.
    rough_fall: float = 0.01
    rounds: int = 3  # of weights by channel
    robust_rounds: int = 20  # of weights by sample
    # Change of a logarithm of a channel's weight, or of the parameters in standard deviations, with which
    # rounds end.
    converged: float = 0.05
    # Least noise of a channel, as a share of its rms: a log without noise would have infinite weight.
    least_noise: float = 1e-6
    damping: float = 1e-3
    least_damping: float = 1e-9
    most_damping: float = 1e9
    # Samples of a window where whole runs are fitted: what its derivatives take stays below 200 MB.
    most_samples: int = 20_000
    near_noise: float = 4.0  # mean square over noise up to which longer windows are more informative
    # Share by which a fit may predict validation data worse than another and still be as good: the effect of
    # the noise at the starts of windows.
    no_worse: float = 0.01
    # Standard deviations from which an error counts linearly: 95% efficiency if all is Gaussian (Huber,
    # Robust Statistics, 1981; Holland and Welsch, Communications in Statistics A6, 1977).
    huber: float = 1.345
    # Degrees of freedom, kept fixed (Lange, Little and Taylor, J. American Statistical Association 84, 1989).
    student: float = 4.0


SETTINGS = OutputErrorSettings()
NO_WORSE = SETTINGS.no_worse


@dataclass(frozen=True)
class OutputErrorFit(Fitted):
    """A model fitted to logs by its simulation error."""

    model: WeakModel  # Model and names of the free parameters
    p: Array  # (n_parameters,) all parameters
    windows: Windows  # What was simulated
    starts: Array  # (b, 2n) estimated true pose and velocity at the start of every window
    at: Reduced  # Linearised problem at p
    # (2n,) mean square of the simulation error over the noise that a channel was weighted with, at
    # least 1
    dispersion: Array
    iterations: int  # Steps taken in all
    # (n_free,) one over the standard error of a parameter from pose rates against velocities; zero where they
    # carry no information, and where the pose itself was fitted to
    known: Array

    @property
    def gram(self) -> Array:
        """J' J of the weighted error with the starts eliminated, shape (n_free, n_free)."""
        return self.at.J.T @ self.at.J + np.diag(self.known**2)

    @cached_property
    def noise_gram(self) -> Array:
        """J' J in units of sensor noise alone, the starts eliminated."""
        weight = channel_weights(self.windows)
        shooting = Shooting(
            self.model.functions,
            self.windows,
            self.model.free,
            weight,
            compiled=False,
            values=self.model.values,
        )
        J = shooting.linearise(self.p, self.starts).J
        return np.asarray(J.T @ J)

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the free parameters: robust to model error, and at least that due to noise.

        Windows (or five-second parts of longer ones) are taken as independent: a sandwich estimator
        with clusters inflates the covariance where the errors of one window are correlated.
        """
        groups = len(self.at.scores)
        return clustered(self.information, self.at.scores * np.sqrt(groups / max(groups - 1, 1)))

    def mean_square(self) -> Array:
        """Mean square of the simulation error over the noise, by channel; NaN where one is not used."""
        return _mean_square(self.at, self.starts, self.dispersion)


@dataclass(frozen=True)
class State:
    """A state of the minimisation."""

    p: Array  # (n_parameters,) all parameters
    starts: Array  # (b, 2n) true pose and velocity at the start of every window
    at: Reduced  # Linearised problem there
    damping: float  # Of the next step


class Descent:
    """Levenberg-Marquardt on the parameters, with the best starts for every step.

    With `kinematics` the error is that of velocities predicted from the measured motion at the start of a
    window, as in validation: the start of each window is known to sensor accuracy, and model errors
    accumulate after it. Of the pose only the start counts, since its errors are the accumulated velocity
    errors; velocities derived from it count like others. The information of the pose about the sensors, lost
    in this way, is in `kinematics` (see `kinematic_information`).
    """

    def __init__(
        self,
        model: WeakModel,
        windows: Windows,
        compiled: bool | None = None,
        progress: Progress = lambda done, words: None,
        *,
        kinematics: tuple[Array, Array] | None = None,
    ) -> None:
        self.model, self.windows, self._predicting = model, windows, kinematics is not None
        self._weight = channel_weights(windows, derived=self._predicting)
        self._shooting = Shooting(
            model.functions, windows, model.free, self._weight, compiled=compiled, values=model.values
        )
        self._space = SearchSpace(model, known=kinematics)
        self._known = np.zeros(len(model.free)) if kinematics is None else kinematics[1]
        self._progress = progress
        self._steps = 0

    def closest(self, candidates: Sequence[Array]) -> Array:
        """The parameters with which simulations from measured starts are closest to the logs."""
        if len(candidates) == 1:
            return candidates[0]
        self._set_weights(np.ones(len(self.windows.names)))
        cost = [self._shooting.cost(p, self._shooting.measured_starts(p)) for p in candidates]
        return candidates[int(np.argmin(cost))]

    def fit(self, p: Array) -> OutputErrorFit:
        """Minimise and reweight every channel by its residual, until the weights converge.

        The first weights are those at the start. With weights from sensor noise alone, a channel that the
        start fits well would be sacrificed to one that no parameters fit, and be down-weighted from then on.
        """
        dispersion = np.ones(len(self.windows.names))
        self._set_weights(dispersion)
        starts = self._first_starts(p)
        state = self._at(p, starts)
        for round_ in range(SETTINGS.rounds):
            self._progress(round_ / SETTINGS.rounds, "output error")
            found = np.maximum(1.0, np.nan_to_num(_mean_square(state.at, starts, dispersion), nan=1.0))
            if round_ and np.max(np.abs(np.log(found / dispersion))) < SETTINGS.converged:
                break
            dispersion = found
            self._set_weights(dispersion)
            # Until the residual, and hence the weights, hardly change.
            state = self._minimised(
                self._at(state.p, state.starts),
                lambda at: max(_negligible_fall(at), SETTINGS.rough_fall * at.cost),
            )
            self._scale_priors(state, dispersion)
        state = self._minimised(state, _negligible_fall)
        return OutputErrorFit(
            self.model, state.p, self.windows, state.starts, state.at, dispersion, self._steps, self._known
        )

    def _first_starts(self, p: Array) -> Array:
        """Where the search for the starts of the windows begins."""
        return self._shooting.measured_starts(p) if self._predicting else self._shooting.fitted_starts(p)

    def _set_weights(self, dispersion: Array, samples: Array | None = None) -> None:
        """Weight channels by the residual of a model, and samples, except starts, by `samples` (b, k, 2n)."""
        self._shooting.weight = self._weight / np.sqrt(dispersion)
        if self._predicting:
            ones = np.ones((*self.windows.t.shape, len(dispersion)))
            samples = ones if samples is None else samples.copy()
            samples[:, 1:, : len(dispersion) // 2] = 0.0
            samples[:, 0] = dispersion
        self._shooting.sample_weights = samples

    def _scale_priors(self, state: State, dispersion: Array) -> None:
        """Count correlated residuals once, if the residual exceeds the noise: that is independent."""
        left = float(np.max(dispersion)) >= SETTINGS.near_noise
        self._space.scale_priors(state.at.inflation if left else 1.0)

    def fit_robust(self, p: Array, loss: Loss) -> OutputErrorFit:
        """Minimise with weights for each sample by its error, until the parameters converge."""
        self._set_weights(np.ones(len(self.windows.names)))
        starts = self._first_starts(p)
        state = State(p, starts, self._shooting.linearise(p, starts), SETTINGS.damping)
        for round_ in range(SETTINGS.robust_rounds):
            self._progress(round_ / SETTINGS.robust_rounds, "output error, outliers down-weighted")
            scale = self._reweighted(state, loss)
            before, state = state.p, self.minimise(state.p, state.starts)
            self._scale_priors(state, scale**2)
            if self._relative_change(state, before) < SETTINGS.converged:
                break
        return self._robust(state, scale, loss)

    def _reweighted(self, state: State, loss: Loss) -> Array:
        """Weight channels and samples by their errors at a state; scale of the errors of each channel."""
        self._shooting.weight = self._weight
        errors = self._shooting.errors(state.p, state.starts)
        scale = np.array([robust_scale(e[np.isfinite(e)]) for e in np.moveaxis(errors, 2, 0)])
        scale = np.where(scale > 0, scale, 1.0)
        self._set_weights(scale**2, loss.weight(np.nan_to_num(errors / scale)))
        return scale

    def _relative_change(self, state: State, before: Array) -> float:
        """Change of the parameters, in standard deviations of the fit."""
        places = list(self.model.places)
        return float(np.linalg.norm(state.at.J @ (state.p[places] - before[places])))

    def _robust(self, state: State, scale: Array, loss: Loss) -> OutputErrorFit:
        """The fit with weights by which its covariance is that of an estimate by this loss."""
        errors = self._shooting.errors(state.p, state.starts)
        found = [
            loss.correction(e[np.isfinite(e)]) if used else (1.0, 1.0)
            for e, used in zip(np.moveaxis(errors, 2, 0), state.at.counts > 0, strict=True)
        ]
        variance, score = np.array(found).T
        self._shooting.weight = self._weight / (scale * np.sqrt(variance))
        at = self._shooting.linearise(state.p, state.starts)
        at = replace(at, scores=at.scores * float(np.average(score, weights=at.counts)))
        return OutputErrorFit(
            self.model, state.p, self.windows, state.starts, at, scale**2 * variance, self._steps, self._known
        )

    def minimise(self, p: Array, starts: Array) -> State:
        """Minimise from these parameters and starts, with the weights as they are."""
        return self._minimised(self._at(p, starts), _negligible_fall)

    def _at(self, p: Array, starts: Array) -> State:
        state = State(p, starts, self._shooting.linearise(p, starts), SETTINGS.damping)
        if not np.isfinite(state.at.cost):
            raise UndertowError(
                "the simulation diverges with the initial parameter values: give a shorter horizon, or "
                "better values"
            )
        return state

    def _minimised(self, state: State, threshold: Callable[[Reduced], float]) -> State:
        """Steps until one gains less than the threshold."""
        for _ in range(SETTINGS.most_steps):
            self._steps += 1
            state, fall = self._stepped(state)
            if fall < threshold(state.at):
                break
        return state

    def _stepped(self, state: State) -> tuple[State, float]:
        """The next state and the fall of the cost; the same state and zero where no step helps."""
        damping, before = state.damping, self._space.cost(state.p, state.at.cost)
        by_window = False
        while damping < SETTINGS.most_damping:
            step = self._space.step(damped(state.at.r, state.at.J, damping), state.p)
            p = self._space.after_step(state.p, step)
            starts = state.starts + state.at.start_slope @ step
            further = starts + state.at.start_step
            if by_window:
                further, squares = self._shooting.better_starts(p, starts, further)
            else:
                squares = self._shooting.cost(p, further)
            # Derivatives cost many simulations, and nearly half of the steps do not help.
            if self._space.cost(p, squares) < before:
                at = self._shooting.linearise(p, further)
                after = self._space.cost(p, at.cost)
                if after < before:
                    return State(p, further, at, max(damping / 10, SETTINGS.least_damping)), before - after
            predicted = self._space.predicted_cost(state.p, step, state.at.r + state.at.J @ step)
            if before - predicted < _negligible_fall(state.at):
                break
            # The steps of the starts are not damped: they may fail in a few windows.
            damping, by_window = damping * 10 if by_window else damping, True
        return state, 0.0


def _negligible_fall(at: Reduced) -> float:
    """Fall of the cost below which a descent has converged.

    The residual of a poor model is many times the noise, and correlated from sample to sample: a fraction of
    a noise variance then moves no parameter noticeably relative to its standard error.
    """
    return SETTINGS.least_fall * max(1.0, at.cost / max(float(at.counts.sum()), 1.0)) * at.inflation


def channel_weights(windows: Windows, *, derived: bool = False) -> Array:
    """Inverse noise of each channel; zero for channels not measured, or derived ones not used."""
    with_data = np.isfinite(windows.measured).any(axis=(0, 1))
    left_out = set() if derived else {name for run in windows.runs for name in run.derived}
    used = with_data & np.array([name not in left_out for name in windows.names])
    noise = np.maximum(windows.sigma, SETTINGS.least_noise * windows.rms)
    return np.where(used & (noise > 0), 1.0 / np.where(noise > 0, noise, 1.0), 0.0)


def _mean_square(at: Reduced, starts: Array, dispersion: Array) -> Array:
    """Mean square by channel in units of the noise; estimated starts and parameters take up part of it."""
    total = float(at.counts.sum())
    left = max(total - starts.size - at.J.shape[1], 1.0) / max(total, 1.0)
    found = np.full(len(dispersion), np.nan)
    used = at.counts > 0
    found[used] = at.squares[used] / (at.counts[used] * left)
    return found * dispersion


# --- what counts as an error ----------------------------------------------------------------------
LossName = Literal["gaussian", "huber", "student-t"]


@dataclass(frozen=True)
class Loss:
    """A loss function as needed for iterative reweighting."""

    weight: Callable[[Array], Array]  # Weight of an error z in standard deviations: influence over error
    slope: Callable[[Array], Array]  # Derivative of the influence

    def correction(self, z: Array) -> tuple[float, float]:
        """Correction of the covariance of weighted least squares for errors such as z.

        A factor on the variance where errors are independent, mean(w) mean(psi^2) / mean(psi')^2, and one on
        scores in a sandwich, mean(w) / mean(psi').
        """
        weight, slope = self.weight(z), max(float(np.mean(self.slope(z))), 0.1)
        mean = float(np.mean(weight))
        return mean * float(np.mean((weight * z) ** 2)) / slope**2, mean / slope


_HUBER, _STUDENT = SETTINGS.huber, SETTINGS.student
LOSSES: dict[str, Loss] = {
    "huber": Loss(
        weight=lambda z: _HUBER / np.maximum(np.abs(z), _HUBER),
        slope=lambda z: (np.abs(z) < _HUBER).astype(float),
    ),
    "student-t": Loss(
        weight=lambda z: (_STUDENT + 1) / (_STUDENT + z**2),
        slope=lambda z: (_STUDENT + 1) * (_STUDENT - z**2) / (_STUDENT + z**2) ** 2,
    ),
}


_PLAIN = Constraints()


@one_thread()
def fit_output_error(
    vehicle: Vehicle,
    runs: Sequence[Run],
    free: Sequence[str] | None = None,
    horizon: float | None = SETTINGS.horizon,
    *,
    start: Mapping[str, float] | None = None,
    compiled: bool | None = None,
    constraints: Constraints = _PLAIN,
    loss: LossName = "gaussian",
    progress: Progress = lambda done, words: None,
) -> OutputErrorFit:
    """Fit the free parameters of a vehicle to several logs at once by the error of their simulation.

    The logs are cut into windows. The parameters are shared, and the true motion at the start of every window
    is estimated with them. Channels are weighted by their noise, and by the model residual above it.

    Parameters
    ----------
    vehicle : Vehicle
        Model with priors.
    runs : sequence of Run
        Logs with the velocities and commands of the vehicle; velocities that were derived from a pose take no
        part, the pose itself does.
    free : sequence of str, optional
        Names of the parameters to fit; by default those that the vehicle marks with `estimate`.
    horizon : float or None
        Length of a window in s; None: each gap-free segment is one.
    start : mapping, optional
        Starting values; by default those of a weak-form fit.
    constraints : Constraints
        Constraints on the parameters.
    loss : str
        "gaussian" squares every error; "huber" and "student-t" reweight each sample until the parameters
        converge, so that the influence of outliers is bounded.
    """
    names = free_parameters(vehicle) if free is None else tuple(free)
    progress(0.0, "weak-form fit")
    model, begin = weak_start(constraints.model(vehicle, names), runs, start)
    return _fit_windows(model, runs, horizon, [begin], loss, compiled, progress)


def _fit_windows(
    model: WeakModel,
    runs: Sequence[Run],
    horizon: float | None,
    starts: Sequence[Mapping[str, float]],
    loss: LossName = "gaussian",
    compiled: bool | None = None,
    progress: Progress = lambda done, words: None,
    *,
    kinematics: tuple[Array, Array] | None = None,
) -> OutputErrorFit:
    windows = cut(runs, model.functions.vehicle, horizon)
    descent = Descent(model, windows, compiled, progress, kinematics=kinematics)
    p = descent.closest([physical_start(model, start) for start in starts])
    return descent.fit(p) if loss == "gaussian" else descent.fit_robust(p, LOSSES[loss])


def _stated_starts(model: WeakModel, values: Mapping[str, float]) -> list[dict[str, float]]:
    """Fitted values, but coefficients as in the vehicle file: with an effect that is tried, and without.

    Near an incomplete model, the weak form may end where simulations diverge, and so may a fit to free starts
    of short windows. An effect that is tried is not in the file: its coefficients are zero there.
    """
    vehicle = model.functions.vehicle
    linear = [n for n in model.free if vehicle.declaration(base_name(n)).linear]
    stated = {n: vehicle.value_of(base_name(n)).value for n in linear}
    stated = {n: value for n, value in stated.items() if np.isfinite(value)}
    nonzero = {n: value for n, value in stated.items() if value}
    different = [nonzero] if nonzero == stated else [nonzero, stated]
    return [dict(values) | coefficients for coefficients in different]


@one_thread()
def final_fit(
    weak: WeakFit,
    runs: Sequence[Run],
    validation: Sequence[Run],
    *,
    loss: LossName = "gaussian",
    progress: Progress = lambda done, words: None,
) -> WeakFit | OutputErrorFit:
    """The fit that every command ends with: the weak form, then output error over the vehicle's own horizons.

    Windows are a quarter of the slowest time constant at first (see `horizons`): a fit over long windows
    alone, started far away, ends in a local minimum. Each fit begins where the one before it ended, or at the
    stated values if simulations with these are closer to the logs. Where the residual is close to noise, one
    time constant follows, then the longest ones, and whole gap-free segments if theirs is close to it, too:
    estimated starts cost information about the parameters (standard errors over windows of a time constant
    are ten times those over a run of a minute). Otherwise free starts absorb model errors, and a pose
    accumulates all earlier errors; velocities are then predicted from measured starts, the error by which
    predictions are judged, over all three lengths. What is returned is the last of the fits whose
    `horizon_error` on validation data is no worse than the least.

    Parameters
    ----------
    weak : WeakFit
        Where to begin.
    runs, validation : sequence of Run
        Training and validation logs.
    loss : str
        That of `fit_output_error`.
    """
    model = weak.model
    fits: list[WeakFit | OutputErrorFit] = [weak]
    short, middle, longest = horizons(model.functions.vehicle, runs)

    def next_fit(
        at: Fitted, horizon: float | None, kinematics: tuple[Array, Array] | None = None
    ) -> OutputErrorFit | None:
        """The next fit; None where its simulation diverges, as that of a poor model may."""
        progress(0.12 * len(fits), f"output error over {f'{horizon:.3g} s' if horizon else 'whole runs'}")
        starts = [at.values, *_stated_starts(model, at.values)]
        try:
            return _fit_windows(model, runs, horizon, starts, loss, kinematics=kinematics)
        except UndertowError:
            return None

    for horizon in (short, middle, longest, _whole_run_length(runs)):
        fit = next_fit(fits[-1], horizon)
        if fit is None or (len(fits) > 3 and not _is_near_noise(fit)):
            break
        fits.append(fit)
        if not _is_near_noise(fit):
            break
    # Over a time constant, or over less where that diverges or leaves a large residual.
    if not _is_near_noise(fits[:3][-1]):
        begin, known = fits[:2][-1], kinematic_information(weak)
        for horizon in (short, middle, longest):
            if fit := next_fit(begin, horizon, known):
                begin = fit
                fits.append(fit)
    if len(fits) == 1:
        return weak
    errors = horizon_error(fits, validation)
    limit = (1.0 + NO_WORSE) * np.min(errors)
    return next((fit for fit, error in zip(fits[::-1], errors[::-1], strict=True) if error <= limit), weak)


def kinematic_information(weak: WeakFit) -> tuple[Array, Array]:
    """Information on the free parameters from pose rates and velocities, independent of forces.

    They determine sensor errors without a model of the forces. Values, (n_free,), and inverse standard
    errors, zero where undetermined.
    """
    rows = weak.data.equation >= len(weak.data.names) // 2
    r, J = weak.at.r[rows], weak.at.J[rows]
    observed = np.flatnonzero(np.any(J, axis=0))
    value, weight = weak.p[list(weak.model.places)], np.zeros(J.shape[1])
    if len(observed):
        J = J[:, observed]
        information = J.T @ J
        covariance = clustered(information, summed_scores(r, J, weak.data.block[rows]))
        value[observed] -= inverse_of(information) @ (J.T @ r)
        weight[observed] = 1.0 / np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    return value, weight


def _whole_run_length(runs: Sequence[Run]) -> float | None:
    """Length of windows over whole runs: None, or s where the longest one takes several."""
    longest = max(runs, key=lambda run: len(run.t))
    count = -(-len(longest.t) // SETTINGS.most_samples)
    return float(longest.t[-1] - longest.t[0]) / count if count > 1 else None


def _is_near_noise(fit: Fitted) -> bool:
    """Whether simulations leave little more than noise in every channel."""
    return isinstance(fit, OutputErrorFit) and bool(np.max(fit.dispersion) < SETTINGS.near_noise)


def horizon_error(fits: Sequence[Fitted], validation: Sequence[Run]) -> Array:
    """Error of predicted velocities of fits of one model, (k,), as shares of the motion.

    Geometric mean over windows of the three `horizons`; infinite where a simulation diverges. Runs are scored
    on the part not used to estimate their own values (see `in_run`).
    """
    functions = fits[0].model.functions
    predictor, judged = Predictor(functions, compiled=False), [in_runs(fit, validation) for fit in fits]
    rest = judged[0][1]
    windows = [cut(rest, functions.vehicle, h) for h in horizons(functions.vehicle, rest)]
    errors = [
        [prediction_error(predict_each(vehicles, w, predictor)) for w in windows] for vehicles, _ in judged
    ]
    return np.asarray(np.exp(np.mean(np.log(errors), axis=1)))


def weak_start(
    model: WeakModel, runs: Sequence[Run], start: Mapping[str, float] | None
) -> tuple[WeakModel, Mapping[str, float]]:
    """The model and the start of its fit: as given, else by the weak form, with values by run if needed.

    For runs too short for the weak form, model and values stay as in the file.
    """
    if start is not None:
        return model, start
    try:
        data = prepare(runs, model.functions.vehicle)
    except UndertowError:  # too short for test functions; the values of the file have to do
        return model, {}
    fit = fit_weak_by_run(model, data)
    return fit.model, fit.values


def physical_start(model: WeakModel, start: Mapping[str, float]) -> Array:
    """All parameters at the start of a search: those of the vehicle, some replaced, made physical."""
    return SearchSpace(model).nearest(model.initial_p(start))
