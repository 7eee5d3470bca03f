"""Validation by simulation: multiple shooting on the validation data, in units of the sensors' noise."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, wilcoxon

from undertow.errors import UndertowError
from undertow.identification.estimation.data import WeakData
from undertow.identification.estimation.fitted import Fitted
from undertow.identification.estimation.output_error import (
    OutputErrorFit,
    channel_weights,
    final_fit,
    fit_output_error,
)
from undertow.identification.estimation.predictor import Predictor, predict_each
from undertow.identification.estimation.shooting import Shooting
from undertow.identification.estimation.step import bounds_of, prior_of
from undertow.identification.estimation.weak_form import (
    WeakFit,
    adapted,
    estimation_part_factor,
    in_runs,
    used_in_estimation,
)
from undertow.identification.estimation.windows import (
    HORIZONS,
    Prediction,
    Windows,
    cut,
    horizons,
    longest_segment,
    position_error,
    prediction_error,
    shortest_horizon,
)
from undertow.identification.logs.run import Run
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .bench import only_noise
from .evidence import EffectSet
from .parallel import mapped
from .result import Step
from .settings import DEFAULT, Settings


def simulates_to_noise(shooting: Shooting, p: Array, starts: Array, settings: Settings = DEFAULT) -> bool:
    """Whether the error of a simulation is noise, on short and long time scales.

    p: (n_parameters,), parameters.
    starts: (b, 2n), the best start of every window.
    """
    errors = shooting.errors(p, starts)
    used = shooting.used
    if not np.any(used) or not np.all(np.isfinite(errors[used])):
        return False
    errors = errors[:, :, np.any(used, axis=(0, 1))]
    means = means_over(errors, _part_of_window(shooting.windows.t, settings.slow_error_window))
    return all(_is_noise(e, starts.size, settings) for e in (errors, means))


def means_over(errors: Array, part: NDArray[np.intp]) -> Array:
    """Means over parts of windows, times the square root of the number of samples present.

    errors: (b, k, c), errors by window, sample and channel, in units of the noise; NaN where there is none.
    part: (b, k), part of its window that a sample belongs to.
    Returns (b, parts, c): of unit variance if the errors are white noise; NaN if there is no sample.
    """
    windows, _, channels = errors.shape
    shape = windows, int(part.max(initial=0)) + 1, channels
    place = np.broadcast_to(np.arange(windows)[:, None], part.shape), part
    total, present = np.zeros(shape), np.zeros(shape)
    np.add.at(total, place, np.nan_to_num(errors))
    np.add.at(present, place, np.isfinite(errors).astype(float))
    return np.divide(total, np.sqrt(present), out=np.full(shape, np.nan), where=present > 0)


def _part_of_window(t: Array, length: float) -> NDArray[np.intp]:
    """Part of its window in which a sample falls, each this many seconds long or half of a short window."""
    since = t - t[:, :1]
    return np.asarray(since // min(length, max(float(since.max()) / 2.0, 1e-9)), dtype=np.intp)


def _is_noise(errors: Array, starts: int, settings: Settings) -> bool:
    """Whether mean squares by channel and overall are those of noise; estimated starts absorb a part."""
    count = np.maximum(np.count_nonzero(np.isfinite(errors), axis=(0, 1)), 1)
    left = 1.0 - starts / float(count.sum())
    level = np.nansum(errors**2, axis=(0, 1)) / count / max(left, LIMITS.least_left)
    channel_limit = settings.channel_noise_limit + settings.chance_errors * np.sqrt(2.0 / count)
    mean_limit = settings.mean_noise_limit + settings.chance_errors * np.sqrt(2.0 / count.sum())
    return bool(np.all(level < channel_limit) and np.average(level, weights=count) < mean_limit)


def refitted_within_errors(
    fit: OutputErrorFit, shooting: Shooting, starts: Array, settings: Settings = DEFAULT
) -> tuple[Array, Array] | None:
    """The parameters that simulate other windows best, with the fit as prior.

    They minimise the sum of squares over these windows plus the squared distance from the fit, in units of
    its errors, as if both data had been fitted at once.

    starts: (b, 2n), start of every window to begin with.
    Returns all parameters and the starts; None if the fit excludes such parameters, or a simulation diverges.
    """
    places, fitted = list(fit.model.places), np.asarray(fit.p)
    information = fit.noise_gram + np.diag(prior_of(fit.model)[1] ** 2)
    p = fitted.copy()
    for _ in range(settings.transfer_steps):
        at = shooting.linearise(p, starts)
        if not np.isfinite(at.cost):
            return None
        change = p[places] - fitted[places]
        slope = at.J.T @ at.r + information @ change
        step = np.linalg.lstsq(at.J.T @ at.J + information, -slope, rcond=None)[0]
        step = np.clip(p[places] + step, *bounds_of(fit.model)) - p[places]
        starts = starts + at.start_step + at.start_slope @ step
        p[places] += step
    change = p[places] - fitted[places]
    likely = change @ information @ change < chi2.isf(settings.transfer_chance, max(len(change), 1))
    return (p, starts) if likely else None


F = TypeVar("F", bound=Fitted | Vehicle)
T = TypeVar("T")


@dataclass(frozen=True)
class ValidationSettings:
    """Extremes of simulations that are compared; `Settings` holds what decides a verdict."""

    # Mean square, in units of the noise, where the simulation of one model diverges and the other's does not.
    diverged: float = 1e12
    # Longest window as a share of the shortest run: a little less.
    of_shortest: float = 0.9
    least_left: float = 0.1  # share of the samples that estimated starts leave, at least
    same: float = 1e-9  # difference of mean squares that is none


LIMITS = ValidationSettings()


def _longest_window(runs: Sequence[Run]) -> float:
    """A little less than the shortest run, s."""
    return LIMITS.of_shortest * min(float(r.t[-1] - r.t[0]) for r in runs)


@dataclass(frozen=True)
class Contender:
    """A model on the short list.

    effect_set: its effects.
    fit: its fit by output error, or by the weak form where a simulation diverged.
    squares: (b,), mean square of the simulation error in every validation window, in units of the noise.
    """

    effect_set: EffectSet
    fit: Fitted
    squares: Array

    @property
    def error(self) -> float:
        """Root mean square over all windows; 1 is sensor noise."""
        return float(np.sqrt(np.mean(self.squares)))


def relative_squares(prediction: Prediction) -> Array:
    """Mean squared error of every channel by window, relative to that of its motion in all, (b, n + m).

    The n velocities come first, then the m measured channels of the pose, whose motion is that since the
    start of the window. A window in which a slow sensor has no report counts as the average of the others.
    """
    half = len(prediction.names) // 2
    windows = prediction.windows
    pose = [i for i in range(half) if np.any(np.isfinite(windows.measured[:, :, i]))]
    columns = [*range(half, 2 * half), *pose]
    motion = windows.measured - np.where(np.arange(2 * half) < half, windows.start, 0.0)[:, None]
    measured, error = motion[:, 1:, columns], prediction.residual[:, 1:, columns]
    lost = np.any(~np.isfinite(prediction.predicted).all(axis=2) & windows.inside, axis=1)
    with np.errstate(over="ignore", invalid="ignore"):
        total, count = np.nansum(error**2, axis=1), np.count_nonzero(np.isfinite(measured), axis=1)
        mean = np.where(count > 0, total / np.maximum(count, 1), total.sum(axis=0) / count.sum(axis=0))
        square = mean / np.nanmean(measured**2, axis=(0, 1))
    return np.where(
        np.isfinite(square) & ~lost[:, None], np.minimum(square, LIMITS.diverged), LIMITS.diverged
    )


def _corrected(fit: Fitted, squares: Array, windows: Windows) -> Array:
    """Squares by window, (b,) or (b, n), raised to the average in those used for estimation."""
    first = used_in_estimation(fit, windows.runs, windows.run, windows.t[:, 0])
    return squares * estimation_part_factor(squares, first, windows.run)


class _Errors(NamedTuple):
    """Errors of the predictions of a model over windows of one length."""

    velocity: float  # error of the velocities, as a share of their rms
    position: float  # that of the position, m
    # (b, n + m), see `SimulationValidator.squares_ahead`; raised where a fit has used the data itself
    squares: Array

    @classmethod
    def of(cls, model: Fitted | Vehicle, found: Prediction) -> _Errors:
        squares = relative_squares(found)
        if isinstance(model, Fitted):
            squares = _corrected(model, squares, found.windows)
        return cls(float(prediction_error(found)), float(position_error(found)), squares)


class SimulationValidator:
    """Scores models by simulating the validation runs in windows with estimated initial states.

    sigma: (2n,), noise of the channels.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        train: Sequence[Run],
        test: Sequence[Run],
        sigma: Array,
        settings: Settings = DEFAULT,
    ) -> None:
        self._vehicle, self.train, self.test, self.sigma = vehicle, train, test, sigma
        self.settings = settings
        self._cache: dict[tuple[str, int], tuple[Fitted | Vehicle, Any]] = {}

    @cached_property
    def shortest(self) -> float:
        """A little less than the shortest validation run, s; no window is longer than every segment."""
        whole = _longest_window(self.test)
        return min(whole, max(longest_segment(self._vehicle, run) for run in self.test))

    @cached_property
    def windows(self) -> Windows:
        """The short windows, in which models are compared."""
        return self._cut(self.settings.short_windows)

    @cached_property
    def _long_windows(self) -> Windows:
        return self._cut(self.settings.long_windows)

    def _cut(self, horizon: float) -> Windows:
        # In a log with a low sampling rate, windows that have more samples than the start.
        if horizon < shortest_horizon(self.test):
            horizon = shortest_horizon(self.test, HORIZONS.fewest_samples)
        # A lag can fit commands before the log, since its initial state is free; a dead time cannot.
        skip = min(self.settings.unknown_past, self.settings.unknown_share * self.shortest)
        return cut(self.test, self._vehicle, min(horizon, self.shortest), sigma=self.sigma, skip=skip)

    def cached(self, key: str, fit: F, work: Callable[[F], T]) -> T:
        """What some work makes of a fit, done once; the fit is kept, since its identity is the key."""
        entry = key, id(fit)
        if entry not in self._cache:
            self._cache[entry] = fit, work(fit)
        found: T = self._cache[entry][1]
        return found

    def squares(self, fit: Fitted) -> Array:
        """Mean square of the simulation error in every window at its best start; inf where it diverges."""
        return self.cached("squares", fit, self._squares)

    def _squares(self, fit: Fitted, horizon: float | None = None) -> Array:
        shooting, starts = self._shooting_at_best_starts(fit, horizon or self.settings.short_windows)
        return _corrected(fit, shooting.mean_squares(np.asarray(fit.p), starts), shooting.windows)

    def _shooting_at_best_starts(self, fit: Fitted, horizon: float) -> tuple[Shooting, Array]:
        """A model in the windows of one length, and the best start of each."""
        return self.cached(f"shooting over {horizon:g} s", fit, lambda fit: self._fit_starts(fit, horizon))

    def _fit_starts(self, fit: Fitted, horizon: float) -> tuple[Shooting, Array]:
        shooting = self._shooting(fit, horizon)
        return shooting, shooting.fitted_starts(np.asarray(fit.p))

    def _shooting(self, fit: Fitted, horizon: float, free: Sequence[str] = ()) -> Shooting:
        windows = self.windows if horizon == self.settings.short_windows else self._long_windows
        weights = channel_weights(windows)
        return Shooting(fit.model.functions, windows, free, weights, compiled=False, values=fit.model.values)

    @cached_property
    def horizons(self) -> tuple[float, ...]:
        """Horizons of predictions: fractions and multiples of the vehicle's own time constants, s."""
        wanted = horizons(self._vehicle, self.test)
        return tuple(dict.fromkeys(float(f"{min(h, self.shortest):.2g}") for h in wanted))

    @cached_property
    def _prediction_windows(self) -> dict[float | None, Windows]:
        lengths = (*self.horizons, None)
        return {h: cut(self.test, self._vehicle, h, sigma=self.sigma) for h in lengths}

    def ahead(self, model: Fitted | Vehicle) -> tuple[dict[str, float], dict[str, float]]:
        """Errors of predictions by horizon and over whole runs: of velocities in shares of their rms, and of
        the position in m.
        """
        found = self._errors(model, (*self.horizons, None))
        names = {h: "free run" if h is None else f"{h:g} s" for h in self._prediction_windows}
        return {n: found[h].velocity for h, n in names.items()}, {
            n: found[h].position for h, n in names.items()
        }

    def step(self, added: list[str], model: Fitted | Vehicle, error: float) -> Step:
        """A model with these effects and this error of the weak form, with the errors of its predictions."""
        ahead, position = self.ahead(model)
        (short,) = self._predicted(model, [self.windows])
        channels = {n: float(e) if np.isfinite(e) else None for n, e in short.relative.items()}
        prediction = float(prediction_error(short))
        return Step(
            added=added, error=error, prediction=prediction, channels=channels, ahead=ahead, position=position
        )

    def _predicted(self, model: Fitted | Vehicle, windows: Sequence[Windows]) -> Iterator[Prediction]:
        """Predictions by the model as given in each validation run."""
        if isinstance(model, Vehicle):
            vehicles = [adapted(model, run)[0] for run in self.test]
        else:
            vehicles = in_runs(model, self.test)[0]
        predictor = Predictor(vehicles[0], compiled=False)
        return (predict_each(vehicles, w, predictor) for w in windows)

    def _errors(
        self, model: Fitted | Vehicle, lengths: Sequence[float | None]
    ) -> dict[float | None, _Errors]:
        """Predictions over windows of such lengths (None: whole runs), each judged once."""
        known: dict[float | None, _Errors] = self.cached("ahead", model, lambda _: {})
        if new := [h for h in lengths if h not in known]:
            found = self._predicted(model, [self._prediction_windows[h] for h in new])
            known |= {h: _Errors.of(model, p) for h, p in zip(new, found, strict=True)}
        return known

    def squares_ahead(self, fit: Fitted) -> dict[float, Array]:
        """Mean square of the error of predictions by horizon, window and channel, (b, n + m).

        The velocities come first, then the measured channels of the pose, each in units of the mean square of
        its motion in all windows (`relative_squares`); very large where a simulation diverged.
        """
        found = self._errors(fit, self.horizons)
        return {h: found[h].squares for h in self.horizons}

    def velocities(self, squares: Mapping[float, Array]) -> dict[float, Array]:
        """The columns of the velocities, (b, n), of `squares_ahead`."""
        count = len(self._vehicle.velocity_names)
        return {horizon: each[:, :count] for horizon, each in squares.items()}

    def contender(self, effect_set: EffectSet) -> Contender:
        """A set of effects fitted by output error, started from the weak form, and scored."""
        return Contender(effect_set, *self.refined(effect_set.fit))

    def final(self, weak: WeakFit) -> Fitted:
        """A model after the final step of `fit`."""
        return self.cached("final", weak, lambda fit: final_fit(fit, self.train, self.test))

    def predicting_fit(self, weak: WeakFit) -> Fitted:
        """The fit by which a model was judged: the final one if it predicted, else that of the weak form."""
        fit: Fitted = self._cache.get(("final", id(weak)), (weak, weak))[1]
        return fit

    def compute_final_fits(self, models: Sequence[WeakFit], done: Callable[[int, int], None]) -> None:
        """Compute `final` of models, and their predictions, on all cores; `done` receives the progress.

        A fit is returned without its model, which cannot be sent between processes; it is that of the start.
        """
        new = [weak for weak in models if ("final", id(weak)) not in self._cache]

        def work(i: int) -> tuple[dict[str, Any], dict[float | None, _Errors]]:
            fit = self.final(new[i])
            own = fields(fit) if isinstance(fit, OutputErrorFit) else ()
            parts = {f.name: getattr(fit, f.name) for f in own if f.name != "model"}
            return parts, self._errors(fit, self.horizons)

        for i, (parts, ahead) in enumerate(mapped(work, len(new))):
            fit = OutputErrorFit(new[i].model, **parts) if parts else new[i]
            self._cache["final", id(new[i])] = new[i], fit
            self._cache["ahead", id(fit)] = fit, ahead
            done(i + 1, len(new))

    def refined(self, weak: WeakFit) -> tuple[Fitted, Array]:
        """A model fitted by output error, and how it simulates; by the weak form if that does better.

        The weak form is biased if noise is as large as the signal that it multiplies; the simulation is not.
        A poor model is not refined: that is expensive, and no fit corrects it.
        """
        before = self.squares(weak)
        if not np.mean(before) < self.settings.output_error_limit:
            return weak, before
        fit = self._refined(weak)
        after = before if fit is weak else self.squares(fit)
        return (weak, before) if self.worse_by_rank_test(after, before) else (fit, after)

    def residual_is_noise(self, weak: WeakFit, test: WeakData) -> bool:
        """Whether a model leaves only noise, by its weak-form residual or by simulation."""
        if self.cached(f"noise in {id(test)}", weak, lambda fit: only_noise(fit, test, self.settings)):
            return True
        return self.leaves_only_noise(weak)

    def leaves_only_noise(self, weak: WeakFit) -> bool:
        """Whether a model, fitted by output error, simulates the validation runs to within the noise.

        This is free of errors of the weak form itself: its quadrature error if there is almost no noise, and
        the bias of |v|v of a noisy v if the noise is large. In long windows even a small force shows, and so
        does a small error of a parameter, which may therefore move within its errors.
        """
        return self.cached("noise", weak, self._leaves_only_noise)

    def _within_reach(self, weak: WeakFit) -> bool:
        """Whether a fit by output error may bring a model down to the noise: it is expensive, and useless for
        one that is far off in short windows, or in long ones, whose starts absorb less.
        """
        limit = self.settings.output_error_reach
        if not np.mean(self.squares(weak)) < limit:
            return False
        return bool(np.median(self._squares(weak, self.settings.long_windows)) < limit)

    def _leaves_only_noise(self, weak: WeakFit) -> bool:
        if not self._within_reach(weak):
            return False
        settings, long = self.settings, self.settings.long_windows
        fit = self._refined(weak, long)
        if not isinstance(fit, OutputErrorFit):
            return False
        shooting, starts = self._shooting_at_best_starts(fit, long)
        if simulates_to_noise(shooting, np.asarray(fit.p), starts, settings):
            return True
        adjusted = refitted_within_errors(fit, self._shooting(fit, long, fit.model.free), starts, settings)
        return adjusted is not None and simulates_to_noise(shooting, *adjusted, settings)

    def significantly_worse(self, weak: WeakFit, than: WeakFit) -> bool:
        """Whether a model simulates significantly worse than another, in short windows or long ones.

        For models that leave little but noise, for which the sum of squares is a likelihood. Long windows
        show slow errors, which the estimated starts of short ones absorb. The worst window is ignored: where
        a vehicle is about to turn, a small parameter error grows to many times the noise. A residual above
        the noise counts as noise. If short and long windows contradict each other, neither model is better.
        """
        costs = self._costs(weak), self._costs(than), self._levels(than)
        return significantly_worse_in_windows(*costs, self.settings)

    @property
    def _lengths(self) -> tuple[float, float]:
        return self.settings.short_windows, self.settings.long_windows

    def _costs(self, weak: WeakFit) -> list[Array]:
        """Sum of squares in units of the noise, in each of the short windows and of the long ones."""
        return self.cached("costs", weak, self._compute_costs)

    def _compute_costs(self, weak: WeakFit) -> list[Array]:
        return [
            min((self._cost(fit, horizon) for fit in (weak, self._refined(weak, horizon))), key=np.sum)
            for horizon in self._lengths
        ]

    def _levels(self, weak: WeakFit) -> list[float]:
        """Mean square in units of the noise, for short and long windows."""
        return self.cached("levels", weak, self._compute_levels)

    def _compute_levels(self, weak: WeakFit) -> list[float]:
        used = [self._shooting_at_best_starts(weak, horizon)[0].used for horizon in self._lengths]
        left = [
            cost / np.maximum(u.sum(axis=(1, 2)), 1) for cost, u in zip(self._costs(weak), used, strict=True)
        ]
        return [float(np.clip(np.mean(square), 1.0, LIMITS.diverged)) for square in left]

    def _cost(self, fit: Fitted, horizon: float) -> Array:
        shooting, starts = self._shooting_at_best_starts(fit, horizon)
        return shooting.squares(np.asarray(fit.p), starts)

    def surviving(self, contenders: Sequence[Contender]) -> list[EffectSet]:
        """The short list without models that simulate worse than the best.

        Where they leave little but noise, windows short and long together separate them. Of those that do
        equally well, the one with the fewest declared parameters leads: a good fit by a more flexible effect
        is weaker evidence.
        """
        ordered = sorted(contenders, key=lambda c: c.error)
        near = ordered[0].error ** 2 < self.settings.near_noise
        if near:
            ordered.sort(key=lambda c: float(sum(map(np.sum, self._costs(c.effect_set.fit)))))
        best = ordered[0]

        def worse(c: Contender) -> bool:
            if near and self.significantly_worse(c.effect_set.fit, best.effect_set.fit):
                return True
            # Smaller differences, however regular, show how both compensate for what neither explains.
            notable = near or c.error > self.settings.notably_worse * best.error
            return notable and self.worse_by_rank_test(c.squares, best.squares)

        equals = [best.effect_set, *(c.effect_set for c in ordered[1:] if not worse(c))]
        return sorted(equals, key=_parameter_count)

    def worse_by_rank_test(self, squares: Array, reference: Array) -> bool:
        """Whether one model simulates the windows significantly worse than another."""
        return worse_by_rank_test(squares, reference, self.settings)

    def _refined(self, weak: WeakFit, horizon: float | None = None) -> Fitted:
        horizon = horizon or self.settings.short_windows
        return self.cached(f"{horizon:g} s", weak, lambda fit: self._by_output_error(fit, horizon))

    def _by_output_error(self, weak: WeakFit, horizon: float) -> Fitted:
        # Over long windows a fit may end in a local minimum of its own unless it begins close by.
        begin = weak if horizon == self.settings.short_windows else self._refined(weak)
        try:
            refined: OutputErrorFit = fit_output_error(
                weak.model.functions.vehicle,
                self.train,
                weak.model.free,
                min(horizon, _longest_window(self.train)),
                start=begin.values,
            )
        except UndertowError:  # the simulation of a poor model may diverge
            return weak
        # Values estimated from the validation runs themselves remain.
        return replace(refined, model=refined.model.with_known_values(weak.model.values.known))


def _parameter_count(effect_set: EffectSet) -> int:
    """Number of parameters that its effects declare for this vehicle, needed or not."""
    return sum(len(f.trial.candidate.parameters) for f in effect_set.findings)


def significantly_worse_in_windows(
    costs: Sequence[Array], others: Sequence[Array], levels: Sequence[float], settings: Settings = DEFAULT
) -> bool:
    """Whether sums of squares by window, short ones and long, are larger than those of another model.

    `levels` are mean squares of the other model: its residual counts as noise.
    """
    with np.errstate(invalid="ignore"):
        gaps = [
            np.nan_to_num((worse - better) / level, posinf=LIMITS.diverged, neginf=-LIMITS.diverged)
            for worse, better, level in zip(costs, others, levels, strict=True)
        ]
    behind, ahead = (max(_without_largest(sign * g) for g in gaps) for sign in (1.0, -1.0))
    return behind > settings.more_than_chance and ahead < settings.more_than_chance


def _without_largest(gaps: Array) -> float:
    return float(np.sum(gaps) - np.max(gaps))


def worse_by_rank_test(squares: Array, reference: Array, settings: Settings = DEFAULT) -> bool:
    """Whether one model simulates the windows significantly worse than another."""
    gap = squares - reference
    if not np.all(np.isfinite(squares)):
        return bool(np.all(np.isfinite(reference)))
    if np.allclose(gap, 0.0, atol=LIMITS.same):
        return False
    if len(gap) < settings.testable_windows:
        return len(gap) >= settings.unanimous_windows and bool(np.all(gap > 0.0))
    return bool(wilcoxon(gap, alternative="greater").pvalue < settings.worse_chance and np.mean(gap) > 0.0)
