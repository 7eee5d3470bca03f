"""Prediction error: multiple shooting with process noise between windows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, fields, replace
from functools import cached_property, partial
from math import ceil

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtrs
from scipy.stats import t as student

from undertow.codegen.functions import Functions
from undertow.errors import UndertowError
from undertow.identification.logs.run import Run
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Flags, Index, Progress

from .data import blocks_of_time, clustered, inverse_of, summed_scores
from .fitted import Fitted
from .output_error import channel_weights, physical_start, weak_start
from .residual import Linearised, WeakModel
from .shooting import OneRun, Shooting
from .step import Constraints, SearchSpace, require_rows, squared
from .threads import one_thread
from .weak_form import free_parameters, mean_square_by
from .windows import Windows, cut_by_samples


@dataclass(frozen=True)
class AutoregressionSettings:
    """Settings of autoregressive models of whitened residuals."""

    most_order: int = 6  # a slow force needs one, waves two, sensor noise beside them a few more
    rows_per_coefficient: int = 10  # fewest residuals for each coefficient


AUTOREGRESSION = AutoregressionSettings()


@dataclass(frozen=True)
class AutoregressiveNoise:
    """An autoregressive model of a whitened residual.

    statsmodels fits one to a single series without gaps; here all segments are fitted together.

    coefficients: (order,), of the residuals before, the nearest first.
    scale: rms of the innovations.
    """

    coefficients: Array
    scale: float

    @classmethod
    def of(cls, series: Sequence[Array], most: int = AUTOREGRESSION.most_order) -> AutoregressiveNoise:
        """From whitened residuals, an array (K,) for each segment; of an order up to `most`."""
        pieces = [np.lib.stride_tricks.sliding_window_view(r, most + 1) for r in series if len(r) > most]
        rows = np.concatenate(pieces)[:, ::-1] if pieces else np.zeros((0, most + 1))
        count, least, found = len(rows), np.inf, cls(np.zeros(0), 1.0)
        for order in range(most + 1):
            if count < AUTOREGRESSION.rows_per_coefficient * order + 1:
                break
            c = np.linalg.lstsq(rows[:, 1 : order + 1], rows[:, 0], rcond=None)[0]
            square = float(np.mean((rows[:, 0] - rows[:, 1 : order + 1] @ c) ** 2)) + 1e-300
            # Schwarz's criterion
            criterion = count * np.log(square) + order * np.log(count)
            if criterion < least:
                least, found = criterion, cls(np.asarray(c, dtype=float), float(np.sqrt(square)))
        return found

    def innovations(self, table: Array) -> Array:
        """One-step prediction errors of a segment, (m,) or (m, k), of variance one; the first are zero."""
        found = np.array(table, dtype=float)
        for lag, c in enumerate(self.coefficients, start=1):
            found[lag:] -= c * table[:-lag]
        found[: len(self.coefficients)] = 0.0
        return np.asarray(found / self.scale)


@dataclass(frozen=True)
class LinearWindows:
    """All windows linearised at parameters p and starts, k samples of 2n channels each.

    The state of a window is its start, pose and velocity, and a slow disturbance of the n accelerations: 3n.
    """

    error: Array  # (b, k, 2n, 1 + n_free) simulation error, and its derivatives in the free parameters
    by_start: Array  # (b, k, 2n, 3n) its derivative in the state
    used: Flags  # (b, k, 2n) what is measured; a sample that two windows share counts once
    # (b, 3n, 1 + n_free) how far the end of a window is from the start of the next, and its
    # derivatives in the parameters
    defect: Array
    by_end: Array  # (b, 3n, 3n) derivative of the end in the state

    def expanded(self, columns: Callable[[Array], Array]) -> LinearWindows:
        """The same with derivatives in other free parameters."""
        error, defect = (
            np.concatenate([a[..., :1], columns(a[..., 1:])], axis=-1) for a in (self.error, self.defect)
        )
        return replace(self, error=error, defect=defect)

    @classmethod
    def joined(cls, parts: Sequence[LinearWindows]) -> LinearWindows:
        """The windows of all parts, one after the other."""
        return cls(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls)))

    @cached_property
    def measured(self) -> list[tuple[Array, Array, Index]]:
        """Of the measured samples of every window: `error`, `by_start` and their channels.

        A search for the noise passes over the same windows many times.
        """
        count, size, columns = self.defect.shape
        error, by_start = self.error.reshape(count, -1, columns), self.by_start.reshape(count, -1, size)
        places = [np.flatnonzero(used) for used in self.used.reshape(count, -1)]
        return [(error[j][own], by_start[j][own], own % self.used.shape[2]) for j, own in enumerate(places)]


class ChainedWindows:
    """Windows that share their last sample with the next, segment by segment, simulated by one model."""

    def __init__(self, functions: Functions, windows: Windows, free: tuple[str, ...]) -> None:
        self.windows = windows
        size = len(windows.names)
        self._shooting = Shooting(functions, windows, free, np.ones(size))
        self._predictor, self._free, self._size = self._shooting.predictor, len(self._shooting.places), size
        #: Windows after which the next one is not the continuation.
        self.last = _last(windows)
        self.used = _counted_once(windows, self.last)

    @property
    def has_sensor_delay(self) -> bool:
        """Whether a sensor reports late, so that windows depend on each other by more than the motion."""
        return self._predictor.sensor_delay.present

    def measured_starts(self, p: Array) -> Array:
        """True pose and velocity at the start of every window as measured, shape (b, 2n)."""
        return self._shooting.measured_starts(p)

    @cached_property
    def _by_run(self) -> list[tuple[OneRun, ChainedWindows]]:
        """The windows of every run, where some parameters have a value in each."""
        return [(one, self._with(one.shooting)) for one in self._shooting.by_run]

    def _with(self, shooting: Shooting) -> ChainedWindows:
        other = copy(self)
        other.windows, other._shooting, other._predictor = shooting.windows, shooting, shooting.predictor
        other.last = _last(other.windows)
        other.used = _counted_once(other.windows, other.last)
        other.__dict__["_by_run"] = []
        return other

    def linearise(self, p: Array, starts: Array) -> LinearWindows:
        """Simulate every window with sensitivities."""
        if not self._by_run:
            return self._linearised(p, starts)
        values, parts = self._shooting.values, []
        for one, chained in self._by_run:
            part = chained._linearised(values.of_run(p, one.run), starts[one.rows])
            parts.append(part.expanded(partial(values.expanded, run=one.run)))
        return LinearWindows.joined(parts)

    def _linearised(self, p: Array, starts: Array) -> LinearWindows:
        shooting, predictor = self._shooting, self._predictor
        start, commands = predictor.start_and_commands(self.windows, p, starts)
        x, s = shooting.sensitivities(start, commands, p, shooting.inherited_slopes(p, starts))
        reported, slope = shooting.report_slopes(x, s, commands.u, self.windows.t, p)
        end, by_all = x[:, -1, : self._size], s[:, -1, : self._size].copy()
        both = shooting.delay_slopes(p, lambda moved: self._reports_and_ends(moved, starts, near=p))
        for k, values in both.items():
            slope[..., k], by_all[..., k] = values[:, :-1], values[:, -1]
        return self._assembled(reported, slope, end, by_all, starts)

    def _reports_and_ends(self, p: Array, starts: Array, near: Array) -> Array:
        """Reports of every window, and as a last row its end, shape (b, k + 1, 2n)."""
        start, commands = self._predictor.start_and_commands(self.windows, p, starts, near)
        x = self._predictor.states(start, commands, p)
        reported = self._predictor.reported(x, self.windows.t, commands.u, p)
        return np.concatenate([reported, x[:, -1:, : self._size]], axis=1)

    def _assembled(
        self, reported: Array, slope: Array, end: Array, by_all: Array, starts: Array
    ) -> LinearWindows:
        n, size, count = self._free, self._size, len(end)
        error = np.where(self.used, reported - np.nan_to_num(self.windows.measured), 0.0)
        by_free = np.where(self.used[..., None], slope[..., :n], 0.0)
        following = np.vstack([starts[1:], starts[-1:]])
        defect = np.concatenate([(end - following)[..., None], by_all[..., :n]], axis=2)
        since = self.windows.t - self.windows.t[:, :1]
        first = np.broadcast_to(np.eye(size), (count, size, size))
        ends = np.stack([first, by_all[..., n:]], axis=1)
        by_acceleration = _acceleration_slopes(ends, since[:, [0, -1]])[:, 1]
        nothing = np.zeros((count, size // 2, size))
        steady = np.broadcast_to(np.eye(size // 2), (count, size // 2, size // 2))
        return LinearWindows(
            error=np.concatenate([error[..., None], by_free], axis=3),
            by_start=np.concatenate([slope[..., n:], _acceleration_slopes(slope[..., n:], since)], axis=3),
            used=self.used,
            defect=np.concatenate([defect, nothing[..., :1] * np.zeros(n + 1)], axis=1),
            by_end=np.block([[by_all[..., n:], by_acceleration], [nothing, steady]]),
        )


def _acceleration_slopes(by_start: Array, since: Array) -> Array:
    """Derivative in a steady acceleration from those in the start, (b, k, 2n, n), by the trapezoidal rule."""
    half = by_start.shape[3] // 2
    by_velocity = by_start[..., half:]
    return np.asarray((by_velocity + by_velocity[:, :1]) / 2 * since[:, :, None, None])


def _last(windows: Windows) -> Flags:
    following = windows.first + windows.count - 1
    continues = (windows.run[1:] == windows.run[:-1]) & (windows.first[1:] == following[:-1])
    return np.append(~(continues & (windows.segment[1:] == windows.segment[:-1])), True)


def _counted_once(windows: Windows, last: Flags) -> Flags:
    """Measured samples of every window, its last one only where no window goes on from there."""
    steps = np.arange(windows.t.shape[1])
    own = steps < (windows.count - 1 + last)[:, None]
    return np.asarray(np.isfinite(windows.measured) & own[..., None])


@dataclass(frozen=True)
class Noise:
    """The random part of the model."""

    variance: Array  # (2n,) of the noise of the channels, in the square of their units
    # (3n,) of what changes each state beside the model, its square per second: zero for a pose, the
    # strength of the white disturbance of an acceleration for a velocity, the wander of its slow part
    # at last
    intensity: Array
    # (3n,) standard deviation of the state at the start of a segment before anything is measured
    initial_std: Array


@dataclass(frozen=True)
class Filtered:
    """The outcome of a pass."""

    table: Array  # (m, 1 + n_free) whitened innovations with their derivatives
    window: Index  # (m,) where each of them is from
    channel: Index
    log_variance: Array  # (m,) logarithms of the innovations' variances
    # list of (array, array): State (3n, 1 + n_free) and its covariance, before and after each window's
    # samples are seen
    predicted: list[tuple[Array, Array]]
    updated: list[tuple[Array, Array]]


def filtered(linear: LinearWindows, last: Flags, seconds: Array, noise: Noise) -> Filtered:
    """One pass of a Kalman filter over all windows in order of time.

    `last` (b,) marks windows at the end of a segment; `seconds` (b,) is the length of each.
    """
    count, size, columns = linear.defect.shape
    drift = noise.intensity * seconds[:, None]
    whitened, logarithms, predicted, updated = [], [], [], []
    segment_start = True
    for j, (error, H, channels) in enumerate(linear.measured):
        if segment_start:
            mean, spread = np.zeros((size, columns)), np.diag(noise.initial_std**2)
        predicted.append((mean, spread))
        white, gain, logarithm = _whitened(error + H @ mean, H, spread, noise.variance[channels])
        by_gain = gain.T @ np.concatenate([white, gain], axis=1)
        mean, spread = mean - by_gain[:, :columns], _symmetric(spread - by_gain[:, columns:])
        updated.append((mean, spread))
        whitened.append(white)
        logarithms.append(logarithm)
        segment_start = bool(last[j])
        F = linear.by_end[j]
        mean, spread = linear.defect[j] + F @ mean, _symmetric(F @ spread @ F.T)
        spread.flat[:: size + 1] += drift[j]
    channels_of = [channels for _, _, channels in linear.measured]
    window, channel = np.repeat(np.arange(count), [*map(len, channels_of)]), np.concatenate(channels_of)
    table, logarithm = np.concatenate(whitened), np.concatenate(logarithms)
    return Filtered(table, window, channel, logarithm, predicted, updated)


def _whitened(innovation: Array, H: Array, spread: Array, variance: Array) -> tuple[Array, Array, Array]:
    """Whitened innovations (m, columns), whitened covariance with the state, and log variances (m,).

    LAPACK's own routines: NumPy solves a triangle as a full matrix, in four times the time.
    """
    if not len(H):
        return innovation, H, variance
    across = H @ spread
    covariance = across @ H.T
    covariance.flat[:: len(H) + 1] += variance
    factor, failed = dpotrf(covariance, lower=True, clean=True)
    if failed:
        raise np.linalg.LinAlgError("a covariance of innovations is not positive definite")
    white, _ = dtrtrs(factor, np.concatenate([innovation, across], axis=1), lower=True)
    columns = innovation.shape[1]
    return white[:, :columns], white[:, columns:], 2.0 * np.log(np.diag(factor))


def _symmetric(matrix: Array) -> Array:
    return np.asarray((matrix + matrix.T) / 2)


@dataclass(frozen=True)
class Smoothed:
    """The motion given all measurements, and the noise that explains it."""

    motion: Array  # (b, 3n, 1 + n_free) change of every state, and its derivative in the free parameters
    # (3n, 2) sum of the squared disturbances over their length, and how many of them the data determine, by
    # state
    disturbance: Array
    # (2n, 2) sum of the squared errors of the channels, and how many degrees of freedom are left
    errors: Array


def smoothed(
    linear: LinearWindows, last: Flags, seconds: Array, noise: Noise, innovations: Filtered
) -> Smoothed:
    """The backward pass, from the last window to the first (Rauch, Tung and Striebel)."""
    count, size, columns = linear.defect.shape
    motion, spreads = np.zeros((count, size, columns)), np.zeros((count, size, size))
    disturbance = np.zeros((size, 2))
    for j in reversed(range(count)):
        mean, spread = innovations.updated[j]
        if not last[j]:
            ahead, predicted_covariance = innovations.predicted[j + 1]
            inverse = inverse_of(predicted_covariance)
            change, covariance_change = motion[j + 1] - ahead, spreads[j + 1] - predicted_covariance
            disturbance += _disturbance_sums(noise.intensity, seconds[j], inverse, change, covariance_change)
            gain = spread @ linear.by_end[j].T @ inverse
            mean, spread = mean + gain @ change, _symmetric(spread + gain @ covariance_change @ gain.T)
        motion[j], spreads[j] = mean, spread
    return Smoothed(motion, disturbance, _error_sums(linear, motion[..., 0], spreads, noise.variance))


def _disturbance_sums(
    intensity: Array, seconds: float, inverse: Array, change: Array, covariance_change: Array
) -> Array:
    """Squared disturbance of one window over its length, and the share that the data determine, by state."""
    variance = intensity * seconds
    size = variance * (inverse @ change[:, 0])
    share = -variance * np.diag(inverse @ covariance_change @ inverse)
    return np.column_stack([size**2 / max(seconds, 1e-12), share])


def _error_sums(linear: LinearWindows, motion: Array, spreads: Array, variance: Array) -> Array:
    """Squared errors of the samples after smoothing, and how many of them are free, by channel."""
    H, used = linear.by_start, linear.used
    error = linear.error[..., 0] + (H @ motion[:, None, :, None])[..., 0]
    taken = np.sum((H @ spreads[:, None]) * H, axis=-1) / variance
    return np.column_stack([np.sum(a * used, axis=(0, 1)) for a in (error**2, 1.0 - taken)])


@dataclass(frozen=True)
class PredictionErrorSettings:
    """Settings of the fit by prediction error."""

    intervals: int = 2  # sampling intervals in a window: process noise acts between windows
    most_samples: int = 60_000
    quick_windows: int = 3000  # of a fit that only compares models: 10 to 30 s
    most_steps: int = 60
    # Predicted change of the sum of squares below which no step is tried, and change of minus twice the log
    # likelihood with which a search ends then.
    least_change: float = 0.1
    converged: float = 0.2
    shares: tuple[float, ...] = (1.0, 0.5, 0.2, 0.05)  # of a step, tried in turn until the cost falls
    # How vague the motion at the start of a segment is, in sizes of the motion that is measured.
    initial_std: float = 30.0
    # No channel counts as better known than this share of its rms: covariances would lose their digits.
    least_noise: float = 1e-4
    # Process noise over the interval between samples that the noise of a velocity hides entirely, as a share
    # of it.
    least_process_noise: float = 1e-6
    # Powers of the change of the noise, tried in turn until the likelihood does not fall: process noise that
    # is too strong falls slowly from step to step, and components that depend on each other may overshoot.
    noise_shares: tuple[float, ...] = (2.0, 1.0, 0.5, 0.2, 0.05)
    largest_change: tuple[float, float] = (0.05, 20.0)
    # Time over which slow and white process noise do the same before anything is known of them, s.
    slow_seconds: float = 3.0
    block: float = 5.0  # length of segments of innovations that count as independent, s
    innovation_order: int = 20  # most of an autoregressive model of innovations; waves need a few in a period


SETTINGS = PredictionErrorSettings()
_PLAIN = Constraints()


@dataclass(frozen=True)
class PredictionErrorFit(Fitted):
    """A model fitted to logs by its innovations."""

    model: WeakModel  # Model and names of the free parameters
    p: Array  # (n_parameters,) all parameters
    windows: Windows  # What was simulated
    starts: Array  # (b, 2n) estimated true pose and velocity at the start of every window
    innovations: Filtered  # Whitened innovations at p, with their derivatives
    without_process_noise: Filtered  # The same without a disturbance
    noise: Noise  # Estimated noise of the channels, and strength of the disturbance
    iterations: int  # Steps taken

    @property
    def gram(self) -> Array:
        """J' J of the whitened innovations, shape (n_free, n_free)."""
        return _gram(self.innovations)

    @property
    def noise_gram(self) -> Array:
        """J' J in units of sensor noise alone, without a disturbance."""
        return _gram(self.without_process_noise)

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the free parameters: at least what noise and disturbance give.

        Five-second blocks are taken as independent: a sandwich estimator with clusters inflates the
        covariance where innovations are correlated.
        """
        table = self.innovations.table
        return clustered(self.information, summed_scores(table[:, 0], table[:, 1:], self._block))

    @cached_property
    def _block(self) -> Index:
        """(m,) block of time of each innovation."""
        t = self.windows.t[self.innovations.window, 0]
        run = self.windows.run[self.innovations.window]
        return blocks_of_time(t - t.min(initial=0.0), SETTINGS.block, run)

    @cached_property
    def deviance(self) -> Array:
        """(blocks,) minus twice the log likelihood, but for a constant, of every block of time.

        An autoregressive model of each channel predicts what the noise model lacks, such as waves.
        """
        errors, order = self.innovations, SETTINGS.innovation_order
        run, terms = self.windows.run[errors.window], np.zeros(len(errors.table))
        for channel in np.unique(errors.channel):
            own = errors.channel == channel
            places = [np.flatnonzero(own & (run == k)) for k in np.unique(run)]
            series = [errors.table[place, 0] for place in places]
            noise = AutoregressiveNoise.of(series, order)
            for place, r in zip(places, series, strict=True):
                square = noise.innovations(r) ** 2 + 2.0 * np.log(noise.scale)
                terms[place[order:]] = (square + errors.log_variance[place])[order:]
        return np.bincount(self._block, terms).astype(float)

    @property
    def disturbance(self) -> dict[str, float]:
        """Intensity of the white disturbance of each acceleration, (m/s^2)^2 s or (rad/s^2)^2 s."""
        size = len(self.windows.names) // 2
        return dict(
            zip(self.windows.names[size:], self.noise.intensity[size : 2 * size].tolist(), strict=True)
        )

    @property
    def random_walk(self) -> dict[str, float]:
        """How fast a slow disturbance of each acceleration wanders, (m/s^2)^2 / s or (rad/s^2)^2 / s."""
        size = len(self.windows.names) // 2
        return dict(zip(self.windows.names[size:], self.noise.intensity[2 * size :].tolist(), strict=True))

    def mean_square(self) -> Array:
        """Mean square of the whitened innovations by channel; NaN where one is not used."""
        return mean_square_by(self.innovations.channel, self.innovations.table[:, 0], len(self.windows.names))


def _gram(innovations: Filtered) -> Array:
    J = innovations.table[:, 1:]
    return np.asarray(J.T @ J)


@one_thread()
def fit_prediction_error(
    vehicle: Vehicle,
    runs: Sequence[Run],
    free: Sequence[str] | None = None,
    *,
    constraints: Constraints = _PLAIN,
    progress: Progress = lambda done, words: None,
) -> PredictionErrorFit:
    """Fit the free parameters of a vehicle with process noise by the errors of its predictions.

    The parameters are those of `fit_output_error`.
    """
    names = free_parameters(vehicle) if free is None else tuple(free)
    _refuse_long(runs)
    progress(0.0, "weak-form fit")
    model, start = weak_start(constraints.model(vehicle, names), runs, None)
    p = physical_start(model, start)
    chained = _chained(model, runs, SETTINGS.intervals)
    require_rows(model, _informative_samples(chained), runs, "prediction-error")
    return _Search(model, chained, progress).fit(p)


@one_thread()
def refit_by_prediction_error(
    fit: Fitted, runs: Sequence[Run], near: PredictionErrorFit | None = None
) -> PredictionErrorFit:
    """A model that was fitted to the same runs, fitted by prediction error from the values that it has.

    Windows may be longer than usual, so that it takes seconds. `near` is a similar model on these runs, whose
    noise and motion begin the search.
    """
    model, samples = fit.model, sum(len(run.t) for run in runs)
    intervals = max(SETTINGS.intervals, ceil(samples / SETTINGS.quick_windows))
    search = _Search(model, _chained(model, runs, intervals), lambda done, words: None)
    if near is None:
        return search.fit(fit.p)
    shared = {n: v for n, v in near.values.items() if n in model.free}
    return search.fit(physical_start(model, fit.values | shared), near.starts, near.noise)


def vuong_p_value(one: PredictionErrorFit, other: PredictionErrorFit) -> float:
    """Probability that the likelihood of the other model is as much higher if both are as close to the truth.

    A test by blocks of time, with Akaike's correction for the number of parameters (Vuong 1989). An
    UndertowError if there is one block only.
    """
    fall = one.deviance - other.deviance
    if len(fall) < 2:
        raise UndertowError(f"logs of {SETTINGS.block:g} s or less cannot decide between models")
    excess = float(np.sum(fall)) - 2.0 * (len(other.model.free) - len(one.model.free))
    spread = np.sqrt(len(fall)) * np.std(fall, ddof=1) + 1e-300
    return float(student.sf(excess / spread, len(fall) - 1))


def _chained(model: WeakModel, runs: Sequence[Run], intervals: int) -> ChainedWindows:
    vehicle = model.functions.vehicle
    windows = cut_by_samples(runs, vehicle, intervals)
    chained = ChainedWindows(model.functions, _without_derived(windows), model.free)
    if chained.has_sensor_delay:
        raise UndertowError(
            f"vehicle '{vehicle.name}' has a delayed sensor, which prediction error cannot handle: use "
            "--method output-error, or shift the channel in the log"
        )
    return chained


def _informative_samples(chained: ChainedWindows) -> int:
    """Samples of the velocities, or of the pose if more, beyond those that determine the starts."""
    by_channel = np.sum(chained.used, axis=(0, 1))
    beyond = np.maximum(by_channel - np.count_nonzero(chained.last), 0)
    half = len(beyond) // 2
    return int(max(np.sum(beyond[:half]), np.sum(beyond[half:])))


def _refuse_long(runs: Sequence[Run]) -> None:
    samples = sum(len(run.t) for run in runs)
    if samples > SETTINGS.most_samples:
        raise UndertowError(
            f"the logs have {samples} samples, and prediction error takes at most {SETTINGS.most_samples}: "
            "use a part of them with --from and --to, or use --method output-error"
        )


def _without_derived(windows: Windows) -> Windows:
    """The windows with derived channels marked as missing."""
    measured = windows.measured.copy()
    measured[..., channel_weights(windows) == 0] = np.nan
    return replace(windows, measured=measured)


@dataclass(frozen=True)
class _State:
    """A state of the search."""

    p: Array
    starts: Array
    linear: LinearWindows
    innovations: Filtered


class _Search:
    """Gauss-Newton on parameters and starts together; the noise is matched to the residual of each step."""

    def __init__(self, model: WeakModel, chained: ChainedWindows, progress: Progress) -> None:
        self.model, self._chained, self._progress = model, chained, progress
        self._space = SearchSpace(model)
        windows = chained.windows
        self._seconds = windows.t[:, -1] - windows.t[:, 0]
        self._noise = self._first_noise()
        self._least = SETTINGS.least_process_noise * self._noise.intensity

    def _first_noise(self) -> Noise:
        windows = self._chained.windows
        weight, size = channel_weights(windows), len(windows.names)
        rms = np.sqrt(np.mean(windows.start**2, axis=0))
        self._least_variance = (SETTINGS.least_noise * rms) ** 2
        known = np.where(weight > 0, 1.0 / np.where(weight > 0, weight, 1.0), 1.0) ** 2
        variance = np.maximum(known, self._least_variance)
        seconds = float(np.median(self._seconds))
        # A velocity without a sensor is as uncertain as differences of the pose.
        lacking, pose = weight[size // 2 :] == 0, variance[: size // 2]
        velocity = np.where(lacking, pose / seconds**2, variance[size // 2 :]) / seconds
        intensity = np.concatenate([np.zeros(size // 2), velocity, velocity / SETTINGS.slow_seconds**2])
        return self._with_initial_std(
            Noise(variance, intensity, np.maximum(rms, np.sqrt(variance)) * SETTINGS.initial_std)
        )

    def _with_initial_std(self, noise: Noise) -> Noise:
        """The noise, with a slow disturbance that has evolved over the length of a segment before it."""
        size = len(noise.variance)
        length = float(np.sum(self._seconds)) / max(int(np.sum(self._chained.last)), 1)
        drift = np.sqrt(noise.intensity[size:] * length)
        return replace(noise, initial_std=np.concatenate([noise.initial_std[:size], drift]))

    def fit(self, p: Array, starts: Array | None = None, noise: Noise | None = None) -> PredictionErrorFit:
        """Alternate steps and noise until neither changes."""
        self._noise = noise or self._noise
        state = self._at(p, self._chained.measured_starts(p) if starts is None else starts)
        if state is None:
            raise UndertowError(
                "the simulation diverges with the initial parameter values: give better values"
            )
        for iteration in range(1, SETTINGS.most_steps + 1):
            self._progress(iteration / SETTINGS.most_steps, "prediction error")
            before = self._cost(state)
            smooth = smoothed(state.linear, self._chained.last, self._seconds, self._noise, state.innovations)
            state, predicted = self._stepped(state, smooth)
            state = self._with_likelier_noise(state, smooth)
            if predicted < SETTINGS.least_change and abs(self._cost(state) - before) < SETTINGS.converged:
                break
        sensor_noise = self._with_initial_std(replace(self._noise, intensity=0.0 * self._noise.intensity))
        passes = state.innovations, self._filtered(state.linear, sensor_noise)
        return PredictionErrorFit(
            self.model, state.p, self._chained.windows, state.starts, *passes, self._noise, iteration
        )

    def _at(self, p: Array, starts: Array) -> _State | None:
        """The state at parameters and starts; None where the simulation diverges."""
        linear = self._chained.linearise(p, starts)
        try:
            with np.errstate(over="ignore", invalid="ignore"):
                innovations = self._filtered(linear, self._noise)
        except np.linalg.LinAlgError:  # no covariance is finite there
            return None
        return _State(p, starts, linear, innovations) if np.isfinite(innovations.table).all() else None

    def _filtered(self, linear: LinearWindows, noise: Noise) -> Filtered:
        return filtered(linear, self._chained.last, self._seconds, noise)

    def _stepped(self, state: _State, smooth: Smoothed) -> tuple[_State, float]:
        """The state after one step, and the predicted fall of the sum of squares."""
        r, J = state.innovations.table[:, 0], state.innovations.table[:, 1:]
        step = self._space.step(Linearised(r, J, np.zeros((len(r), 0))), state.p)
        predicted = squared(r) - squared(r + J @ step)
        if abs(predicted) < SETTINGS.least_change:
            return state, predicted
        limit = self._cost(state)
        tried = (self._after_step(share * step, state, smooth) for share in SETTINGS.shares)
        found = next((after for after in tried if after is not None and self._cost(after) <= limit), None)
        return (state, 0.0) if found is None else (found, predicted)

    def _after_step(self, step: Array, state: _State, smooth: Smoothed) -> _State | None:
        """The state after a step of the parameters and the smoothed change of the starts with it, if any."""
        motion = smooth.motion[..., 0] + smooth.motion[..., 1:] @ step
        return self._at(
            self._space.after_step(state.p, step), state.starts + motion[:, : state.starts.shape[1]]
        )

    def _cost(self, state: _State) -> float:
        """The cost to be minimised by the parameters at fixed noise."""
        innovations = state.innovations
        deviance = squared(innovations.table[:, 0]) + float(np.sum(innovations.log_variance))
        cost = self._space.cost(state.p, deviance)
        return cost if np.isfinite(cost) else np.inf

    def _with_likelier_noise(self, state: _State, smooth: Smoothed) -> _State:
        """The state with noise nearer to its most likely value.

        The sum of squares over its effective degrees of freedom has its fixed point at the maximum
        likelihood, which is reached much faster than by expectation and maximisation.
        """
        limit = self._cost(state)
        for share in SETTINGS.noise_shares:
            noise = self._changed_noise(smooth, share)
            after = replace(state, innovations=self._filtered(state.linear, noise))
            if self._cost(after) <= limit:
                self._noise = noise
                return after
        return state

    def _changed_noise(self, smooth: Smoothed, share: float) -> Noise:
        """The noise changed by a power of the ratio to what it should be."""
        intensity, variance = self._noise.intensity, self._noise.variance
        matched = _mean_per_term(smooth.disturbance, 1e-9, intensity)
        ratio = matched / np.where(intensity > 0, intensity, 1.0)
        changed = intensity * np.clip(ratio, *SETTINGS.largest_change) ** share
        sensors = variance * (_mean_per_term(smooth.errors, 1.0, variance) / variance) ** min(share, 1.0)
        return self._with_initial_std(
            replace(
                self._noise,
                variance=np.maximum(sensors, self._least_variance),
                intensity=np.where(intensity > 0, np.maximum(changed, self._least), 0.0),
            )
        )


def _mean_per_term(sums: Array, least: float, known: Array) -> Array:
    """Sums of squares per term that the data determine; what is known where those are fewer than `least`."""
    there = sums[:, 1] > least
    return np.where(there, sums[:, 0] / np.where(there, sums[:, 1], 1.0), known)
