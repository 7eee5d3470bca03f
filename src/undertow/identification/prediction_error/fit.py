"""Fitting parameters where something pushes the vehicle that no log holds: waves, a tether, turbulence.

Output error takes the motion of the model for the true one, so that a disturbance adds up over its windows.
Here the start of every window is free, and how far it may be from the end of the one before is what a white
disturbance of the accelerations does in between. The strength of that disturbance, and the noise of the
channels, are estimated with the parameters, by their likelihood.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from undertow.errors import UndertowError
from undertow.identification.logs import Run
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Progress

from ..compare.cutting import Windows, cut_by_samples
from ..output_error.descent import channel_weights
from ..output_error.fit import started, weak_start
from ..weak.constraints import Constraints
from ..weak.fit import free_parameters
from ..weak.residual import Linearised, WeakModel
from ..weak.solution import Solution, clustered, require_rows
from ..weak.step import bounds_of, limited_step, prior_cost, prior_of
from .filtering import Filtered, Noise, Smoothed, filtered, smoothed
from .linear import Chained, LinearWindows

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
    require_rows(model, _told(chained), runs, "prediction-error")
    return _Search(model, chained, progress).fit(p)


def _told(chained: Chained) -> int:
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
