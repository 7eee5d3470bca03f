"""Prediction error: multiple shooting in which the motion may leave the model a little, at every window."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from undertow.codegen.functions import Functions
from undertow.errors import UndertowError
from undertow.identification.logs.run import Run
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Progress

from .output_error import channel_weights, started, weak_start
from .residual import Linearised, WeakModel
from .shooting import Shooting
from .step import (
    Constraints,
    Solution,
    bounds_of,
    clustered,
    inverse_of,
    limited_step,
    prior_cost,
    prior_of,
    require_rows,
)
from .weak_form import free_parameters
from .windows import Windows, cut_by_samples


@dataclass(frozen=True)
class LinearWindows:
    """All windows linearised at parameters p and starts, k samples of 2n channels each.

    The state of a window is its start, pose and velocity, and a slow disturbance of the n accelerations: 3n.

    Attributes
    ----------
    error : (b, k, 2n, 1 + n_free) array
        Simulation error, and its derivatives in the free parameters.
    by_start : (b, k, 2n, 3n) array
        Its derivative in the state.
    used : (b, k, 2n) array of bool
        What is measured; a sample that two windows share counts once.
    defect : (b, 3n, 1 + n_free) array
        How far the end of a window is from the start of the next, and its derivatives in the parameters.
    by_end : (b, 3n, 3n) array
        Derivative of the end in the state.
    """

    error: Array
    by_start: Array
    used: NDArray[np.bool_]
    defect: Array
    by_end: Array


class Chained:
    """Windows that follow each other, simulated by one model.

    Parameters
    ----------
    functions : Functions
        The model.
    windows : Windows
        Windows that share their last sample with the next, stretch by stretch.
    free : sequence of str
        Names of the parameters to differentiate by.
    compiled : bool, optional
        As for `Simulator`.
    """

    def __init__(
        self, functions: Functions, windows: Windows, free: tuple[str, ...], compiled: bool | None
    ) -> None:
        self.windows = windows
        size = len(windows.names)
        self._shooting = Shooting(functions, windows, free, np.ones(size), compiled=compiled)
        self._predictor, self._free, self._size = self._shooting.predictor, len(free), size
        #: Windows after which the next one is not the continuation.
        self.last = _last(windows)
        self.used = _counted_once(windows, self.last)

    @property
    def late(self) -> bool:
        """Whether a sensor reports late, so that windows hang together by more than the motion."""
        return self._predictor.lateness.present

    def first_starts(self, p: Array) -> Array:
        """True pose and velocity at the start of every window as measured, shape (b, 2n)."""
        return self._shooting.first_starts(p)

    def linearise(self, p: Array, starts: Array) -> LinearWindows:
        """Simulate every window with sensitivities."""
        shooting, predictor = self._shooting, self._predictor
        start, drive = predictor.start_and_drive(self.windows, p, starts)
        every = predictor.simulator.run_with_sensitivities(
            start, drive.t, drive.held, p, shooting.places, initial=range(self._size)
        )
        x, s = map(drive.at_samples, every)
        reported, slope = shooting.report_slopes(x, s, drive.u, self.windows.t, p)
        end, by_all = x[:, -1, : self._size], s[:, -1, : self._size].copy()
        both = shooting.differences(p, lambda moved: self._reports_and_ends(moved, starts))
        for k, values in both.items():
            slope[..., k], by_all[..., k] = values[:, :-1], values[:, -1]
        return self._assembled(reported, slope, end, by_all, starts)

    def _reports_and_ends(self, p: Array, starts: Array) -> Array:
        """Reports of every window, and as a last row its end, shape (b, k + 1, 2n)."""
        start, drive = self._predictor.start_and_drive(self.windows, p, starts)
        x = drive.at_samples(self._predictor.simulator.run(start, drive.t, drive.held, p))
        reported = self._predictor.reported(x, self.windows.t, drive.u, p)
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
        by_push = _pushed(ends, since[:, [0, -1]])[:, 1]
        nothing = np.zeros((count, size // 2, size))
        steady = np.broadcast_to(np.eye(size // 2), (count, size // 2, size // 2))
        return LinearWindows(
            error=np.concatenate([error[..., None], by_free], axis=3),
            by_start=np.concatenate([slope[..., n:], _pushed(slope[..., n:], since)], axis=3),
            used=self.used,
            defect=np.concatenate([defect, nothing[..., :1] * np.zeros(n + 1)], axis=1),
            by_end=np.block([[by_all[..., n:], by_push], [nothing, steady]]),
        )


def _pushed(by_start: Array, since: Array) -> Array:
    """Derivative in a steady acceleration from those in the start, (b, k, 2n, n), by the trapezoidal rule."""
    half = by_start.shape[3] // 2
    by_velocity = by_start[..., half:]
    return np.asarray((by_velocity + by_velocity[:, :1]) / 2 * since[:, :, None, None])


def _last(windows: Windows) -> NDArray[np.bool_]:
    following = windows.first + windows.count - 1
    goes_on = (windows.run[1:] == windows.run[:-1]) & (windows.first[1:] == following[:-1])
    return np.append(~(goes_on & (windows.segment[1:] == windows.segment[:-1])), True)


def _counted_once(windows: Windows, last: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Measured samples of every window, its last one only where no window goes on from there."""
    steps = np.arange(windows.t.shape[1])
    own = steps < (windows.count - 1 + last)[:, None]
    return np.asarray(np.isfinite(windows.measured) & own[..., None])


@dataclass(frozen=True)
class Noise:
    """What is random in the model.

    Attributes
    ----------
    variance : (2n,) array
        Of the noise of the channels, in the square of their units.
    intensity : (3n,) array
        Of what changes each state beside the model, its square per second: zero for a pose, the strength of
        the white disturbance of an acceleration for a velocity, the wander of its slow part at last.
    vague : (3n,) array
        Standard deviation of the state at the start of a stretch before anything is measured.
    """

    variance: Array
    intensity: Array
    vague: Array


@dataclass(frozen=True)
class Filtered:
    """What a pass leaves.

    Attributes
    ----------
    table : (m, 1 + n_free) array
        Whitened innovations with their derivatives.
    window, channel : (m,) array
        Where each of them is from.
    log_determinant : float
        Sum of the logarithms of the innovations' variances.
    predicted, seen : list of (array, array)
        State (3n, 1 + n_free) and its covariance, before and after each window's samples are seen.
    """

    table: Array
    window: NDArray[np.intp]
    channel: NDArray[np.intp]
    log_determinant: float
    predicted: list[tuple[Array, Array]]
    seen: list[tuple[Array, Array]]


def filtered(linear: LinearWindows, last: NDArray[np.bool_], seconds: Array, noise: Noise) -> Filtered:
    """One pass over all windows in order of time.

    Parameters
    ----------
    linear : LinearWindows
        The windows.
    last : (b,) array of bool
        Windows with which a stretch ends.
    seconds : (b,) array
        Their length, s.
    noise : Noise
        Of the channels and of the motion.
    """
    columns, size = linear.defect.shape[2], linear.defect.shape[1]
    rows, windows, channels, predicted, seen = [], [], [], [], []
    logarithm, fresh = 0.0, True
    mean, spread = np.zeros((size, columns)), np.diag(noise.vague**2)
    for j in range(len(linear.defect)):
        if fresh:
            mean, spread = np.zeros((size, columns)), np.diag(noise.vague**2)
        predicted.append((mean, spread))
        used = linear.used[j].ravel()
        H = linear.by_start[j].reshape(-1, size)[used]
        channel = np.tile(np.arange(linear.used.shape[2]), linear.used.shape[1])[used]
        innovation = linear.error[j].reshape(-1, columns)[used] + H @ mean
        across = H @ spread
        factor = np.linalg.cholesky(across @ H.T + np.diag(noise.variance[channel]))
        white = np.linalg.solve(factor, np.column_stack([innovation, across]))
        mean = mean - white[:, columns:].T @ white[:, :columns]
        spread = _symmetric(spread - white[:, columns:].T @ white[:, columns:])
        logarithm += 2.0 * float(np.sum(np.log(np.diag(factor))))
        seen.append((mean, spread))
        rows.append(white[:, :columns])
        windows.append(np.full(len(channel), j))
        channels.append(channel)
        fresh = bool(last[j])
        F = linear.by_end[j]
        mean = linear.defect[j] + F @ mean
        spread = _symmetric(F @ spread @ F.T) + np.diag(noise.intensity * seconds[j])
    table, window, channel = (np.concatenate(part) for part in (rows, windows, channels))
    return Filtered(table, window, channel, logarithm, predicted, seen)


def _symmetric(matrix: Array) -> Array:
    return np.asarray((matrix + matrix.T) / 2)


@dataclass(frozen=True)
class Smoothed:
    """The motion given all that is measured, and the noise that explains it.

    Attributes
    ----------
    motion : (b, 3n, 1 + n_free) array
        Change of every state, and its derivative in the free parameters.
    disturbance : (3n, 2) array
        Sum of the squared disturbances over their length, and how many of them the data tell, by state.
    errors : (2n, 2) array
        Sum of the squared errors of the channels, and how many are left to tell their noise.
    """

    motion: Array
    disturbance: Array
    errors: Array


def smoothed(
    linear: LinearWindows, last: NDArray[np.bool_], seconds: Array, noise: Noise, passed: Filtered
) -> Smoothed:
    """The way back, from the last window to the first (Rauch, Tung and Striebel)."""
    count, size, columns = linear.defect.shape
    motion = np.zeros((count, size, columns))
    disturbance, errors = np.zeros((size, 2)), np.zeros((len(noise.variance), 2))
    later = np.zeros((size, size))
    for j in reversed(range(count)):
        mean, spread = passed.seen[j]
        if not last[j]:
            ahead, cover = passed.predicted[j + 1]
            inverse = inverse_of(cover)
            change, shrink = motion[j + 1] - ahead, later - cover
            disturbance += _told(noise.intensity * seconds[j], seconds[j], inverse, change, shrink)
            gain = spread @ linear.by_end[j].T @ inverse
            mean, spread = mean + gain @ change, _symmetric(spread + gain @ shrink @ gain.T)
        motion[j], later = mean, spread
        errors += _left(linear, j, mean, spread, noise.variance)
    return Smoothed(motion, disturbance, errors)


def _told(intensity: Array, seconds: float, inverse: Array, change: Array, shrink: Array) -> Array:
    """Squared disturbance of one window over its length, and the share of it that the data tell, by state."""
    size = intensity * (inverse @ change[:, 0])
    share = -intensity * np.diag(inverse @ shrink @ inverse)
    return np.column_stack([size**2 / max(seconds, 1e-12), share])


def _left(linear: LinearWindows, j: int, mean: Array, spread: Array, variance: Array) -> Array:
    """Squared errors of one window's samples after smoothing, and how many of them are free, by channel."""
    H = linear.by_start[j]
    error = linear.error[j][..., 0] + H @ mean[:, 0]
    taken = np.einsum("kci,ij,kcj->kc", H, spread, H) / variance
    used = linear.used[j]
    return np.column_stack([np.sum(error**2 * used, axis=0), np.sum((1.0 - taken) * used, axis=0)])


# Sampling intervals in a window: the disturbance acts between windows.
_INTERVALS = 2
_MOST_SAMPLES = 60_000
_MAX_ITERATIONS = 60
# Promised fall of the sum of squares, and change of minus twice the log likelihood, with which a search ends.
_ENOUGH, _SETTLED = 0.02, 0.2
# How vague the motion at the start of a stretch is, in sizes of the motion that is measured.
_VAGUE = 30.0
# No channel counts as better known than this share of its rms: covariances would lose their digits.
_FINEST = 1e-4
# Disturbance over the interval between samples that the noise of a velocity hides entirely, as a share of it.
_LEAST = 1e-6
# A disturbance that is too strong falls slowly from step to step: it goes further, but not by leaps.
_FURTHER, _LEAP = 2.0, (0.05, 20.0)
# Time over which a slow and a white disturbance do the same before anything is known of them, s.
_SLOW = 3.0
_BLOCK = 5.0
_PLAIN = Constraints()


@dataclass(frozen=True)
class PredictionErrorFit(Solution):
    """A model fitted to logs by its innovations.

    Attributes
    ----------
    model : WeakModel
        Model and names of the free parameters.
    p : (n_parameters,) array
        All parameters.
    windows : Windows
        What was simulated.
    starts : (b, 2n) array
        Estimated true pose and velocity at the start of every window.
    passed : Filtered
        Whitened innovations at p, with their derivatives.
    quiet : Filtered
        The same without a disturbance.
    noise : Noise
        Estimated noise of the channels, and strength of the disturbance.
    iterations : int
        Steps taken.
    """

    model: WeakModel
    p: Array
    windows: Windows
    starts: Array
    passed: Filtered
    quiet: Filtered
    noise: Noise
    iterations: int

    @property
    def gram(self) -> Array:
        """J' J of the whitened innovations, shape (n_free, n_free)."""
        return _gram(self.passed)

    @property
    def noise_gram(self) -> Array:
        """J' J in units of the noise of the sensors alone, without a disturbance."""
        return _gram(self.quiet)

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the free parameters: at least what noise and disturbance give.

        Stretches of five seconds are taken as independent: a sandwich estimator with clusters inflates the
        covariance where innovations hang together.
        """
        table = self.passed.table
        t = self.windows.t[self.passed.window, 0]
        within = np.floor((t - t.min(initial=0.0)) / _BLOCK).astype(np.intp)
        pairs = np.column_stack([self.windows.run[self.passed.window], within])
        block = np.unique(pairs, axis=0, return_inverse=True)[1].ravel()
        scores = np.zeros((int(block.max(initial=0)) + 1, table.shape[1] - 1))
        np.add.at(scores, block, table[:, 1:] * table[:, :1])
        return clustered(self.gram + np.diag(prior_of(self.model)[1] ** 2), scores)

    @property
    def disturbance(self) -> dict[str, float]:
        """Intensity of the white disturbance of each acceleration, (m/s^2)^2 s or (rad/s^2)^2 s."""
        size = len(self.windows.names) // 2
        return dict(
            zip(self.windows.names[size:], self.noise.intensity[size : 2 * size].tolist(), strict=True)
        )

    @property
    def wander(self) -> dict[str, float]:
        """How fast a slow disturbance of each acceleration wanders, (m/s^2)^2 / s or (rad/s^2)^2 / s."""
        size = len(self.windows.names) // 2
        return dict(zip(self.windows.names[size:], self.noise.intensity[2 * size :].tolist(), strict=True))

    @property
    def cost(self) -> float:
        """Sum of squares of the whitened innovations."""
        return float(np.sum(self.passed.table[:, 0] ** 2))

    def mean_square(self) -> Array:
        """Mean square of the whitened innovations by channel; NaN where one is not used."""
        size = len(self.windows.names)
        total = np.bincount(self.passed.channel, self.passed.table[:, 0] ** 2, size)
        count = np.bincount(self.passed.channel, minlength=size)
        return np.divide(total, count, out=np.full(size, np.nan), where=count > 0)


def _gram(passed: Filtered) -> Array:
    J = passed.table[:, 1:]
    return np.asarray(J.T @ J)


def fit_prediction_error(
    vehicle: Vehicle,
    runs: Sequence[Run],
    free: Sequence[str] | None = None,
    *,
    start: Mapping[str, float] | None = None,
    compiled: bool | None = None,
    constraints: Constraints = _PLAIN,
    progress: Progress = lambda done, words: None,
) -> PredictionErrorFit:
    """Fit the free parameters of a vehicle that a disturbance pushes, by the errors of its predictions.

    Parameters
    ----------
    vehicle, runs, free, start, compiled, constraints, progress
        As for `fit_output_error`.

    Raises
    ------
    UndertowError
        If a channel is missing, a log is too short or too long, a sensor reports late, or the simulation
        diverges.
    """
    names = free_parameters(vehicle) if free is None else tuple(free)
    _refuse_long(runs)
    progress(0.0, "weak-form fit")
    model = constraints.model(vehicle, names)
    p = started(model, weak_start(model, runs) if start is None else start)
    windows = cut_by_samples(runs, vehicle, _INTERVALS)
    chained = Chained(model.functions, _without_derived(windows), model.free, compiled)
    if chained.late:
        raise UndertowError(
            f"vehicle '{vehicle.name}' has a sensor that reports late, which prediction error does not "
            "follow: use --method output-error, or shift the channel in the log"
        )
    require_rows(model, _fit_told(chained), runs, "prediction-error")
    return _Search(model, chained, progress).fit(p)


def _fit_told(chained: Chained) -> int:
    """Samples of the velocities, or of the pose where that tells more, beyond those that a start takes."""
    by_channel = np.sum(chained.used, axis=(0, 1))
    beyond = np.maximum(by_channel - np.count_nonzero(chained.last), 0)
    half = len(beyond) // 2
    return int(max(np.sum(beyond[:half]), np.sum(beyond[half:])))


def _refuse_long(runs: Sequence[Run]) -> None:
    samples = sum(len(run.t) for run in runs)
    if samples > _MOST_SAMPLES:
        raise UndertowError(
            f"the logs have {samples} samples, prediction error takes at most {_MOST_SAMPLES}: take a part "
            "of them with --from and --to, or use --method output-error"
        )


def _without_derived(windows: Windows) -> Windows:
    """The windows with those channels as missing that are made of others."""
    measured = windows.measured.copy()
    measured[..., channel_weights(windows) == 0] = np.nan
    return replace(windows, measured=measured)


@dataclass(frozen=True)
class _State:
    """Where a search has come to."""

    p: Array
    starts: Array
    linear: LinearWindows
    passed: Filtered


class _Search:
    """Gauss-Newton on parameters and starts together; the noise is matched to what each step leaves."""

    def __init__(self, model: WeakModel, chained: Chained, progress: Progress) -> None:
        self.model, self._chained, self._progress = model, chained, progress
        self._bounds, self._prior = bounds_of(model), prior_of(model)
        windows = chained.windows
        self._seconds = windows.t[:, -1] - windows.t[:, 0]
        self._noise = self._first_noise()
        self._least = _LEAST * self._noise.intensity

    def _first_noise(self) -> Noise:
        windows = self._chained.windows
        weight, size = channel_weights(windows), len(windows.names)
        rms = np.sqrt(np.mean(windows.start**2, axis=0))
        self._finest = (_FINEST * rms) ** 2
        known = np.where(weight > 0, 1.0 / np.where(weight > 0, weight, 1.0), 1.0) ** 2
        variance = np.maximum(known, self._finest)
        seconds = float(np.median(self._seconds))
        # What no sensor measures is known as well as differences of the pose tell it.
        lacking, pose = weight[size // 2 :] == 0, variance[: size // 2]
        velocity = np.where(lacking, pose / seconds**2, variance[size // 2 :]) / seconds
        intensity = np.concatenate([np.zeros(size // 2), velocity, velocity / _SLOW**2])
        return self._vague(Noise(variance, intensity, np.maximum(rms, np.sqrt(variance)) * _VAGUE))

    def _vague(self, noise: Noise) -> Noise:
        """The noise, with a slow disturbance that wandered for as long as a stretch before that starts."""
        size = len(noise.variance)
        length = float(np.sum(self._seconds)) / max(int(np.sum(self._chained.last)), 1)
        slow = np.sqrt(noise.intensity[size:] * length)
        return replace(noise, vague=np.concatenate([noise.vague[:size], slow]))

    def fit(self, p: Array) -> PredictionErrorFit:
        """Alternate steps and noise until neither changes."""
        state = self._at(p, self._chained.first_starts(p))
        if not np.isfinite(state.passed.table).all():
            raise UndertowError(
                "the simulation diverges with the starting values of the parameters: give values nearer to "
                "the truth"
            )
        for iteration in range(1, _MAX_ITERATIONS + 1):
            self._progress(iteration / _MAX_ITERATIONS, "prediction error")
            before = self._cost(state)
            back = smoothed(state.linear, self._chained.last, self._seconds, self._noise, state.passed)
            state, promised = self._stepped(state, back)
            self._match(back)
            state = replace(state, passed=self._pass(state.linear, self._noise))
            if promised < _ENOUGH and abs(self._cost(state) - before) < _SETTLED:
                break
        quiet = self._vague(replace(self._noise, intensity=0.0 * self._noise.intensity))
        passes = state.passed, self._pass(state.linear, quiet)
        return PredictionErrorFit(
            self.model, state.p, self._chained.windows, state.starts, *passes, self._noise, iteration
        )

    def _at(self, p: Array, starts: Array) -> _State:
        linear = self._chained.linearise(p, starts)
        return _State(p, starts, linear, self._pass(linear, self._noise))

    def _pass(self, linear: LinearWindows, noise: Noise) -> Filtered:
        return filtered(linear, self._chained.last, self._seconds, noise)

    def _stepped(self, state: _State, back: Smoothed) -> tuple[_State, float]:
        """The state after one step, and the fall of the sum of squares that it promised."""
        r, J = state.passed.table[:, 0], state.passed.table[:, 1:]
        at = Linearised(r, J, np.zeros((len(r), 0)))
        step = limited_step(self.model, at, state.p, self._bounds, self._prior)
        places = list(self.model.places)
        promised = float(np.sum(r**2) - np.sum((r + J @ step) ** 2))
        for share in (1.0, 0.5, 0.2, 0.05):
            p = state.p.copy()
            p[places] = np.clip(p[places] + share * step, *self._bounds)
            motion = back.motion[..., 0] + back.motion[..., 1:] @ (share * step)
            tried = self._at(p, state.starts + motion[:, : state.starts.shape[1]])
            if self._cost(tried) <= self._cost(state) + _ENOUGH:
                return tried, promised
        return state, 0.0

    def _cost(self, state: _State) -> float:
        """What the parameters are to make small while the noise is as it is."""
        stated = prior_cost(self._prior, state.p[list(self.model.places)])
        cost = float(np.sum(state.passed.table[:, 0] ** 2)) + state.passed.log_determinant + stated
        return cost if np.isfinite(cost) else np.inf

    def _match(self, back: Smoothed) -> None:
        """Bring the noise nearer to its most likely value.

        A sum of squares over how many of its terms the data tell is a fixed point where the likelihood is
        greatest, and is reached much faster than by expectation and maximisation.
        """
        known = self._noise.intensity
        ratio = _per(back.disturbance, 1e-9, known) / np.where(known > 0, known, 1.0)
        intensity = known * np.clip(ratio, *_LEAP) ** _FURTHER
        intensity = np.where(self._noise.intensity > 0, np.maximum(intensity, self._least), 0.0)
        variance = np.maximum(_per(back.errors, 1.0, self._noise.variance), self._finest)
        self._noise = self._vague(replace(self._noise, variance=variance, intensity=intensity))


def _per(told: Array, least: float, known: Array) -> Array:
    """Sums of squares per term that the data tell; what is known where they tell less than `least`."""
    there = told[:, 1] > least
    return np.where(there, told[:, 0] / np.where(there, told[:, 1], 1.0), known)
