"""Validation by simulation: multiple shooting on the validation data, in units of the sensors' noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, wilcoxon

from undertow.errors import UndertowError
from undertow.identification.estimation.data import WeakData, Whitening
from undertow.identification.estimation.fitted import MORE_THAN_CHANCE, Fitted
from undertow.identification.estimation.output_error import OutputErrorFit, channel_weights, fit_output_error
from undertow.identification.estimation.predictor import Predictor, predict
from undertow.identification.estimation.residual import whitened
from undertow.identification.estimation.shooting import Shooting
from undertow.identification.estimation.step import bounds_of, prior_of
from undertow.identification.estimation.weak_form import WeakFit
from undertow.identification.estimation.windows import Windows, cut, prediction_error
from undertow.identification.logs.run import Run
from undertow.model.parameter import Parameter
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .evidence import Chain
from .trial import only_noise

# Mean square, in units of the noise, that still counts as noise: in the worst channel and over all of them.
# The noise of a channel is known to a few per cent.
_ANY_CHANNEL, _ALL_CHANNELS = 1.3, 1.1
# Standard errors of a mean square of as many values by which it may exceed that.
_BY_CHANCE = 4.0
_SLOW = 1.0  # s


def simulates_to_noise(shooting: Shooting, p: Array, starts: Array) -> bool:
    """Whether the error of a simulation is noise, quick or slow.

    Parameters
    ----------
    shooting : Shooting
        Windows of logs and the model that simulates them.
    p : (n_parameters,) array
        Parameters.
    starts : (b, 2n) array
        The best start of every window.
    """
    errors = shooting.errors(p, starts)
    used = shooting.used
    if not np.any(used) or not np.all(np.isfinite(errors[used])):
        return False
    errors = errors[:, :, np.any(used, axis=(0, 1))]
    means = means_over(errors, _seconds(shooting.windows.t))
    return _is_noise(errors, starts.size) and _is_noise(means, starts.size)


def means_over(errors: Array, part: NDArray[np.intp]) -> Array:
    """Means over parts of windows, times the square root of the number of samples that are there.

    Parameters
    ----------
    errors : (b, k, c) array
        Errors by window, sample and channel, in units of the noise; NaN where there is none.
    part : (b, k) array of int
        Part of its window that a sample belongs to.

    Returns
    -------
    (b, parts, c) array
        Of unit variance where the errors are white noise; NaN where no sample is there.
    """
    windows, _, channels = errors.shape
    shape = windows, int(part.max(initial=0)) + 1, channels
    place = np.broadcast_to(np.arange(windows)[:, None], part.shape), part
    total, there = np.zeros(shape), np.zeros(shape)
    np.add.at(total, place, np.nan_to_num(errors))
    np.add.at(there, place, np.isfinite(errors).astype(float))
    return np.divide(total, np.sqrt(there), out=np.full(shape, np.nan), where=there > 0)


def _seconds(t: Array) -> NDArray[np.intp]:
    """Second of its window that a sample falls in; halves of windows that are shorter than two seconds."""
    since = t - t[:, :1]
    return np.asarray(since // min(_SLOW, max(float(since.max()) / 2.0, 1e-9)), dtype=np.intp)


def _is_noise(errors: Array, starts: int) -> bool:
    """Whether the mean squares by channel and of all are those of noise; estimated starts take some up."""
    count = np.maximum(np.count_nonzero(np.isfinite(errors), axis=(0, 1)), 1)
    left = 1.0 - starts / float(count.sum())
    level = np.nansum(errors**2, axis=(0, 1)) / count / max(left, 0.1)
    any_one = _ANY_CHANNEL + _BY_CHANCE * np.sqrt(2.0 / count)
    over_all = _ALL_CHANNELS + _BY_CHANCE * np.sqrt(2.0 / count.sum())
    return bool(np.all(level < any_one) and np.average(level, weights=count) < over_all)


# How often errors of the fit may be larger by chance than what parameters are moved by here.
_TRANSFER_BY_CHANCE = 1e-3
_STEPS = 3


def within_errors(fit: OutputErrorFit, shooting: Shooting, starts: Array) -> tuple[Array, Array] | None:
    """The parameters that simulate other windows best, held by how well the fit knows them.

    The sum of squares over these windows and the squared distance from the fit, in units of its errors, are
    least together, as if both data had been fitted at once.

    Parameters
    ----------
    fit : OutputErrorFit
        The fit; its errors are those that the noise of the sensors gives, whatever else it leaves.
    shooting : Shooting
        The other windows, with derivatives in the free parameters of the fit.
    starts : (b, 2n) array
        Start of every window to begin with.

    Returns
    -------
    (array, array) or None
        All parameters and the starts; None if the fit rules such parameters out, or a simulation diverges.
    """
    places, fitted = list(fit.model.places), np.asarray(fit.p)
    information = fit.noise_gram + np.diag(prior_of(fit.model)[1] ** 2)
    p = fitted.copy()
    for _ in range(_STEPS):
        at = shooting.linearise(p, starts)
        if not np.isfinite(at.cost):
            return None
        moved = p[places] - fitted[places]
        slope = at.J.T @ at.r + information @ moved
        step = np.linalg.lstsq(at.J.T @ at.J + information, -slope, rcond=None)[0]
        step = np.clip(p[places] + step, *bounds_of(fit.model)) - p[places]
        starts = starts + at.start_step + at.start_slope @ step
        p[places] += step
    moved = p[places] - fitted[places]
    likely = moved @ information @ moved < chi2.isf(_TRANSFER_BY_CHANCE, max(len(moved), 1))
    return (p, starts) if likely else None


F = TypeVar("F", bound=Fitted)
T = TypeVar("T")
# Windows of a free run diverge in heading even for the true model: short ones decide.
HORIZONS = (1.0, 5.0, 20.0)
DECIDING = 5.0
THOROUGH = 20.0
# What was commanded before a log is not known: seconds at its beginning, and share of the shortest run at the
# most, that judge nothing. A lag would fit them, for its past is free, and a dead time would not.
_UNKNOWN_PAST, _SMALL_SHARE = 1.0, 0.05
# Mean square of the simulation error below which it is nearly noise, from which no fit by output error brings
# it down to that, and from which none is made.
_NEAR_NOISE = 2.0
_WITHIN_REACH = 10.0
_FAR_OFF = 100.0
_SURE = 0.01
# Windows from which a rank test can be as sure as that; of fewer, but so many, all have to say the same.
_TESTABLE, _UNANIMOUS = 7, 5
# Times the error of the best from which another is worse where more than noise is left. Smaller gaps may be
# ever so regular: they say how the two bend to what neither explains.
_NOTABLY = 1.025
# Where the simulation of one model diverges and that of the other does not.
_BEYOND = 1e12


@dataclass(frozen=True)
class Contender:
    """A model of the short list.

    Attributes
    ----------
    chain : Chain
        Its effects.
    fit : Fitted
        Its fit by output error, or by the weak form where a simulation diverged.
    squares : (b,) array
        Mean square of the simulation error in every kept-aside window, in units of the noise.
    """

    chain: Chain
    fit: Fitted
    squares: Array

    @property
    def error(self) -> float:
        """Root mean square over all windows; 1 is the noise of the sensors."""
        return float(np.sqrt(np.mean(self.squares)))


class Referee:
    """Judges models by simulating the kept-aside runs in windows whose starts are estimated.

    Parameters
    ----------
    vehicle : Vehicle
        Whose channels and commands are simulated.
    train, test : sequence of Run
        What models are fitted to, and what they are judged by.
    sigma : (2n,) array
        Noise of the channels.
    """

    def __init__(self, vehicle: Vehicle, train: Sequence[Run], test: Sequence[Run], sigma: Array) -> None:
        self._vehicle, self.train, self.test, self._sigma = vehicle, train, test, sigma
        self._known: dict[tuple[str, int], tuple[Fitted, Any]] = {}

    @cached_property
    def shortest(self) -> float:
        """A little less than the shortest kept-aside run, s."""
        return 0.9 * min(float(r.t[-1] - r.t[0]) for r in self.test)

    @cached_property
    def windows(self) -> Windows:
        """The windows that decide."""
        return self._cut(DECIDING)

    @cached_property
    def _long_windows(self) -> Windows:
        return self._cut(THOROUGH)

    def _cut(self, horizon: float) -> Windows:
        length = min(horizon, self.shortest)
        return cut(self.test, self._vehicle, length, sigma=self._sigma, skip=self._unknown)

    @property
    def _unknown(self) -> float:
        return min(_UNKNOWN_PAST, _SMALL_SHARE * self.shortest)

    def _once(self, what: str, fit: F, work: Callable[[F], T]) -> T:
        """What is worked out of a fit, once; the fit is kept, for its identity is the key."""
        key = what, id(fit)
        if key not in self._known:
            self._known[key] = fit, work(fit)
        found: T = self._known[key][1]
        return found

    def squares(self, fit: Fitted) -> Array:
        """Mean square of the simulation error in every window at its best start; inf where it diverges."""
        return self._once("squares", fit, self._squares)

    def _squares(self, fit: Fitted, horizon: float = DECIDING) -> Array:
        shooting, starts = self._shot(fit, horizon)
        return shooting.mean_squares(np.asarray(fit.p), starts)

    def _shot(self, fit: Fitted, horizon: float) -> tuple[Shooting, Array]:
        """A model in the windows of a length, and the best start of each."""
        return self._once(f"shot over {horizon:g} s", fit, lambda fit: self._settled(fit, horizon))

    def _settled(self, fit: Fitted, horizon: float) -> tuple[Shooting, Array]:
        shooting = self._shooting(fit, horizon)
        return shooting, shooting.fitted_starts(np.asarray(fit.p))

    def _shooting(self, fit: Fitted, horizon: float, free: Sequence[str] = ()) -> Shooting:
        windows = self.windows if horizon == DECIDING else self._long_windows
        return Shooting(fit.model.functions, windows, free, channel_weights(windows), compiled=False)

    def ahead(self, vehicle: Vehicle) -> dict[str, float]:
        """Error of predicted velocities by horizon, and over whole runs, in shares of their rms."""
        predictor = Predictor(vehicle, compiled=False)
        found = {
            f"{horizon:g} s": prediction_error(
                predict(predictor, cut(self.test, self._vehicle, horizon, sigma=self._sigma))
            )
            for horizon in HORIZONS
            if horizon <= self.shortest
        }
        whole = cut(self.test, self._vehicle, None, sigma=self._sigma)
        return found | {"free run": prediction_error(predict(predictor, whole))}

    def contender(self, chain: Chain) -> Contender:
        """A chain fitted by output error from where the weak form left it, and judged."""
        return Contender(chain, *self.refined(chain.fit))

    def refined(self, weak: WeakFit) -> tuple[Fitted, Array]:
        """A model fitted by output error, and how it simulates; by the weak form where that does better.

        The weak form is biased where noise is as large as what it multiplies; the simulation is not. What
        the simulation of a poor model comes to is left alone: it is dear, and no fit mends it.
        """
        before = self.squares(weak)
        if not np.mean(before) < _FAR_OFF:
            return weak, before
        fit = self._refined(weak)
        after = before if fit is weak else self.squares(fit)
        return (weak, before) if clearly_worse(after, before) else (fit, after)

    def quiet(self, weak: WeakFit, test: WeakData) -> bool:
        """Whether a model leaves only noise, by its weak residual or by simulation."""
        if self._once(f"noise in {id(test)}", weak, lambda fit: only_noise(fit, test)):
            return True
        return self.leaves_only_noise(weak)

    def leaves_only_noise(self, weak: WeakFit) -> bool:
        """Whether a model, fitted by output error, simulates the kept-aside runs to within the noise.

        This is free of what the weak form adds of its own: the error of its quadrature where the noise is
        next to nothing, and the bias of |v|v of a noisy v where the noise is large. Windows are long, in
        which even a small force shows; and so does a parameter that the fit leaves a little open, which is
        let move within its errors.
        """
        return self._once("noise", weak, self._leaves_only_noise)

    def _within_reach(self, weak: WeakFit) -> bool:
        """Whether a fit by output error may bring a model down to the noise: it is dear, and no help to one
        that is far off in short windows, or in long ones, whose starts take less of it up.
        """
        if not np.mean(self.squares(weak)) < _WITHIN_REACH:
            return False
        return bool(np.median(self._squares(weak, THOROUGH)) < _WITHIN_REACH)

    def _leaves_only_noise(self, weak: WeakFit) -> bool:
        if not self._within_reach(weak):
            return False
        fit = self._refined(weak, THOROUGH)
        if not isinstance(fit, OutputErrorFit):
            return False
        shooting, starts = self._shot(fit, THOROUGH)
        if simulates_to_noise(shooting, np.asarray(fit.p), starts):
            return True
        moved = within_errors(fit, self._shooting(fit, THOROUGH, fit.model.free), starts)
        return moved is not None and simulates_to_noise(shooting, *moved)

    def outdone(self, weak: WeakFit, by: WeakFit) -> bool:
        """Whether a model simulates worse than another by more than chance, in short windows or long ones.

        For models that leave little but noise: there the sum of squares is a likelihood. Long windows show
        what is slow, which the estimated starts of short ones take up. The worst window has no say: where a
        vehicle is about to turn, a small error of a parameter grows to many times the noise. Where more than
        noise is left, all of it passes for noise. Where short and long windows contradict each other, neither
        model outdoes the other.
        """
        pairs = zip(self._costs(weak), self._costs(by), self._levels(by), strict=True)
        with np.errstate(invalid="ignore"):
            gaps = [
                np.nan_to_num((worse - better) / level, posinf=_BEYOND, neginf=-_BEYOND)
                for worse, better, level in pairs
            ]
        behind, ahead = (max(_without_largest(sign * g) for g in gaps) for sign in (1.0, -1.0))
        return behind > MORE_THAN_CHANCE and ahead < MORE_THAN_CHANCE

    def _costs(self, weak: WeakFit) -> list[Array]:
        """Sum of squares in units of the noise, in each of the short windows and of the long ones."""
        return self._once("costs", weak, self._worked_out_costs)

    def _worked_out_costs(self, weak: WeakFit) -> list[Array]:
        return [
            min((self._cost(fit, horizon) for fit in (weak, self._refined(weak, horizon))), key=np.sum)
            for horizon in (DECIDING, THOROUGH)
        ]

    def _levels(self, weak: WeakFit) -> list[float]:
        """Mean square in units of the noise, short windows and long: what is left beyond it is no noise."""
        return self._once("levels", weak, self._worked_out_levels)

    def _worked_out_levels(self, weak: WeakFit) -> list[float]:
        used = [self._shot(weak, horizon)[0].used for horizon in (DECIDING, THOROUGH)]
        left = [
            cost / np.maximum(u.sum(axis=(1, 2)), 1) for cost, u in zip(self._costs(weak), used, strict=True)
        ]
        return [float(np.clip(np.mean(square), 1.0, _BEYOND)) for square in left]

    def _cost(self, fit: Fitted, horizon: float) -> Array:
        shooting, starts = self._shot(fit, horizon)
        return shooting.squares(np.asarray(fit.p), starts)

    def standing(self, chains: Sequence[Chain]) -> list[Chain]:
        """The short list without what the simulation shows to be worse than the best of it.

        All are fitted by output error, from where the weak form left them. Where they leave little but noise,
        windows short and long together tell them apart. Of those that do equally well the one leads whose
        declaration is the plainest: what has more freedom would fit more that did not happen, and that it
        fits says less.
        """
        ordered = sorted((self.contender(c) for c in chains), key=lambda c: c.error)
        near = ordered[0].error ** 2 < _NEAR_NOISE
        if near:
            ordered.sort(key=lambda c: float(sum(map(np.sum, self._costs(c.chain.fit)))))
        best = ordered[0]

        def worse(c: Contender) -> bool:
            if near and self.outdone(c.chain.fit, best.chain.fit):
                return True
            return (near or c.error > _NOTABLY * best.error) and clearly_worse(c.squares, best.squares)

        equals = [best.chain, *(c.chain for c in ordered[1:] if not worse(c))]
        return sorted(equals, key=_freedom)

    def _refined(self, weak: WeakFit, horizon: float = DECIDING) -> Fitted:
        return self._once(f"{horizon:g} s", weak, lambda fit: self._by_output_error(fit, horizon))

    def _by_output_error(self, weak: WeakFit, horizon: float) -> Fitted:
        # Over long windows a fit may end in a dale of its own unless it begins close by.
        begin = weak if horizon == DECIDING else self._refined(weak)
        try:
            refined: OutputErrorFit = fit_output_error(
                weak.model.functions.vehicle,
                self.train,
                weak.model.free,
                min(horizon, 0.9 * min(float(r.t[-1] - r.t[0]) for r in self.train)),
                start=begin.values,
            )
        except UndertowError:  # the simulation of a poor model may diverge
            return weak
        return refined


def _freedom(chain: Chain) -> int:
    """Number of parameters that its effects declare for this vehicle, whether they were needed or not."""
    return sum(len(f.trial.candidate.parameters) for f in chain.findings)


def _without_largest(gaps: Array) -> float:
    return float(np.sum(gaps) - np.max(gaps))


def clearly_worse(squares: Array, than: Array) -> bool:
    """Whether one model simulates the windows worse than another by more than chance."""
    gap = squares - than
    if not np.all(np.isfinite(squares)):
        return bool(np.all(np.isfinite(than)))
    if np.allclose(gap, 0.0, atol=1e-9):
        return False
    if len(gap) < _TESTABLE:
        return len(gap) >= _UNANIMOUS and bool(np.all(gap > 0.0))
    return bool(wilcoxon(gap, alternative="greater").pvalue < _SURE and np.mean(gap) > 0.0)


_STRETCHES = 8
# Standard error of a size from which a stretch says nothing about it.
_POORLY_KNOWN = 0.1
_FEWEST = 3
# Standard deviation of the size over the stretches, and share of what is left that goes with it, from which
# the size is not steady.
_CHANGING, _MOST = 0.25, 0.5


@dataclass(frozen=True)
class Sizes:
    """Size of an effect by stretch of the kept-aside data, in units of the fitted one.

    Attributes
    ----------
    value, error : (k,) array
        Size in every stretch, and its standard error by the noise of the sensors.
    share : float
        Share of what exceeds the noise that goes away when the size is free in every stretch.
    """

    value: Array
    error: Array
    share: float

    @property
    def known(self) -> Array:
        """Sizes in the stretches that show it."""
        return np.asarray(self.value[self.error < _POORLY_KNOWN])

    @property
    def change(self) -> str:
        """How far the size changes, in words; empty where it is steady."""
        known = self.known
        if len(known) < _FEWEST or self.share < _MOST or np.std(known) < _CHANGING:
            return ""
        return f"its size would have to go from {known.min():.0%} to {known.max():.0%} of the fitted one"


def sizes(fit: Fitted, own: Sequence[Parameter], data: WeakData, noise: list[Whitening]) -> Sizes:
    """Size of an effect in stretches of the kept-aside data, all else being as fitted.

    Parameters
    ----------
    fit : Fitted
        The model with the effect.
    own : sequence of Parameter
        What the effect brings in; those that it is linear in make its size. One without such has none.
    data : WeakData
        Data kept aside.
    noise : list of Whitening
        Noise of the sensors alone in them.
    """
    p = np.asarray(fit.p)
    at = whitened(fit.model.linearise(data, p), noise)
    names = {q.name for q in own if q.linear}
    chosen = [k for k, n in enumerate(fit.model.free) if n in names]
    whole = at.J[:, chosen] @ p[[fit.model.places[k] for k in chosen]]
    stretch = _stretches(data)
    power, slope = (np.bincount(stretch, weights=whole * other) for other in (whole, at.r))
    felt = power > 0.0
    power, slope = power[felt], slope[felt]
    excess = float(at.r @ at.r) - len(at.r)
    gained = float(np.sum(slope**2 / power)) - len(power)
    return Sizes(1.0 - slope / power, 1.0 / np.sqrt(power), gained / excess if excess > 0.0 else 0.0)


def _stretches(data: WeakData) -> NDArray[np.intp]:
    """Stretch of every row: blocks of a run that follow each other, alike in number."""
    block = data.block
    return np.asarray(block * _STRETCHES // (int(block.max(initial=0)) + 1))


# Rms difference of the commands of two runs, as a share of their rms, up to which they are the same: clocks
# may be half a sample apart at every step. Unrelated manoeuvres differ by more than their size.
_SAME = 0.15
# Share of the shorter run in which both must be under way for their commands to be compared.
_LONG = 0.5


def repeats(vehicle: Vehicle, train: Sequence[Run], test: Sequence[Run]) -> list[tuple[str, str]]:
    """Runs kept aside that repeat the commands of a run that was fitted, with that run.

    A model that has learned the manoeuvre by heart does as well on them as the right one.

    Parameters
    ----------
    vehicle : Vehicle
        Whose commands are compared.
    train, test : sequence of Run
        What models are fitted to, and what they are judged by.
    """
    names = vehicle.command_names
    pairs = ((kept, fitted) for kept in test for fitted in train)
    return [(kept.name, fitted.name) for kept, fitted in pairs if names and _same(kept, fitted, names)]


def _same(one: Run, other: Run, names: Sequence[str]) -> bool:
    """Whether two runs have the same commands, each counted from its own beginning."""
    first, second = one.t - one.t[0], other.t - other.t[0]
    common = first[first <= second[-1]]
    if common[-1] < _LONG * min(first[-1], second[-1]):
        return False
    mine = np.nan_to_num(one.matrix(names)[: len(common)])
    place = np.searchsorted(second, common, side="right") - 1
    theirs = np.nan_to_num(other.matrix(names)[place])
    size = float(np.sqrt(np.mean(mine**2)))
    changes = bool(np.any(np.ptp(mine, axis=0) > 0.0))
    return changes and float(np.sqrt(np.mean((mine - theirs) ** 2))) < _SAME * size


_PIECES = 6
_ASIDE = (1, 4)
_GAP_SECONDS = 1.0
# Samples of a run with fewer than which some of its pieces may hold none.
_FEWEST = 10


def keep_blocks_aside(runs: Sequence[Run]) -> tuple[list[Run], list[Run]]:
    """Cut every run into six pieces and keep the second and the fifth aside.

    Returns
    -------
    (list of Run, list of Run)
        What models are fitted to, and what they are judged by.

    Raises
    ------
    UndertowError
        If a run is too short to be cut.
    """
    for run in runs:
        if len(run.t) < _FEWEST:
            raise UndertowError(
                f"run {run.name!r} has {len(run.t)} samples, too few to keep stretches of it aside "
                f"({_FEWEST} at the very least): give longer logs, or another run to judge by with --holdout"
            )
    pieces = [(i, piece) for run in runs for i, piece in enumerate(_pieces(run))]
    train = [piece for i, piece in pieces if i not in _ASIDE]
    return train, [piece for i, piece in pieces if i in _ASIDE]


def _pieces(run: Run) -> list[Run]:
    start, length = float(run.t[0]), float(run.t[-1] - run.t[0]) / _PIECES
    edges = [start + i * length for i in range(_PIECES + 1)]
    gap = min(_GAP_SECONDS, 0.1 * length)
    return [
        replace(run.slice(a, b if i == _PIECES - 1 else b - gap), name=f"{run.name} [{a:.0f}-{b:.0f} s]")
        for i, (a, b) in enumerate(pairwise(edges))
    ]


# Noise alone has a standard deviation of once its own; a velocity below this many times that was not moved.
_EXCITED = 2.0


def check_excitation(vehicle: Vehicle, runs: Sequence[Run], sigma: NDArray[np.float64]) -> None:
    """Refuse logs in which no velocity of the vehicle stands out of its noise.

    Parameters
    ----------
    vehicle : Vehicle
        Whose velocities are looked at.
    runs : sequence of Run
        Logs that hold them.
    sigma : (2n,) array
        Noise of the channels, pose then velocity of the degrees of freedom, in their units.

    Raises
    ------
    UndertowError
        If nothing moves; the velocities are told with their noise.
    """
    noise = dict(zip((*vehicle.pose_names, *vehicle.velocity_names), sigma, strict=True))
    largest = {n: max(float(np.nanstd(r.channels[n])) for r in runs) for n in vehicle.velocity_names}
    if all(largest[n] < _EXCITED * noise[n] or largest[n] == 0.0 for n in largest):
        seen = ", ".join(f"{n} {v:.2g} (noise {noise[n]:.2g})" for n, v in largest.items())
        raise UndertowError(
            f"nothing moves in these logs: standard deviation of {seen}; "
            "log a manoeuvre in which the vehicle moves"
        )
