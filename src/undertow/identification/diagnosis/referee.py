"""The final word by simulation: multiple shooting on the kept-aside data, in units of the sensors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from scipy.stats import wilcoxon

from undertow.errors import UndertowError
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from ..compare.cutting import Windows, cut
from ..compare.windows import Predictor, predict, prediction_error
from ..fitted import MORE_THAN_CHANCE, Fitted
from ..logs import Run
from ..output_error.descent import OutputErrorFit, channel_weights
from ..output_error.fit import fit_output_error
from ..output_error.shooting import Shooting
from ..weak.data import WeakData
from ..weak.fit import WeakFit
from .chain import Chain
from .level import simulates_to_noise
from .transfer import within_errors
from .trial import only_noise

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
        return shooting, shooting.settled_starts(np.asarray(fit.p))

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
