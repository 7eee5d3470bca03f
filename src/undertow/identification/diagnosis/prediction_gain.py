"""The benefit of an effect: how much it improves predictions of the validation data."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from undertow.typing import Array

from .evidence import FoundEffect
from .settings import DEFAULT, Settings
from .validation import SimulationValidator, worse_by_rank_test


@dataclass(frozen=True)
class Wording:
    """How changes of an error are put into words."""

    diverges: float = 10.0  # rise of an error, relative, above which its digits mean nothing


WORDING = Wording()
#: Mean squares of prediction errors by horizon, in s: (b, n) by window and channel.
Squares = Mapping[float, Array]


@dataclass(frozen=True)
class PredictionGain:
    """Change of predictions of the validation data by adding an effect.

    falls: fall of the error as a share of it, by horizon in s: of all velocities together (geometric mean).
    largest: the same of the velocity that gains most, among those predicted better than by no motion.
    worse: horizons over which the predictions become significantly worse.
    better: how often predictions over the most sensitive horizon improve when the windows are resampled, and
    how often they have to. Windows of several horizons are the same segments of the logs.
    useless: horizons over which predictions of all velocities are no better than no motion.
    """

    falls: dict[float, float]
    largest: dict[float, float]
    worse: tuple[float, ...]
    better: tuple[float, float] = (1.0, 0.0)
    useless: tuple[float, ...] = ()

    @property
    def log_fall(self) -> float:
        """Mean fall of the logarithm of the error over all horizons: successive gains add up."""
        left = np.maximum(1.0 - np.array([*self.falls.values()]), 1e-12)
        return -float(np.mean(np.log(left)))

    @property
    def by_horizon(self) -> dict[str, float]:
        """The falls by horizon in words, as they are written to JSON."""
        return {f"{h:g} s": fall for h, fall in self.falls.items()}

    @classmethod
    def of(cls, before: Squares, after: Squares, settings: Settings = DEFAULT) -> PredictionGain:
        """From mean squares by horizon, window and velocity, shape (b, n), relative to those of the motion.

        Where commands oppose an unknown force, a simulation with them alone is worse than no motion, and
        whatever makes the vehicle respond less improves it: that is no evidence.
        """
        falls, largest, worse, useless = {}, {}, [], []
        for horizon in before:
            old, new = before[horizon], after[horizon]
            ratio = np.sqrt(np.mean(new, axis=0) / np.maximum(np.mean(old, axis=0), 1e-300))
            falls[horizon] = 1.0 - float(np.exp(np.mean(np.log(np.maximum(ratio, 1e-12)))))
            useful = np.mean(new, axis=0) < 1.0
            largest[horizon] = 1.0 - float(np.min(ratio, where=useful, initial=1.0))
            if not useful.any():
                useless.append(horizon)
            unit = np.maximum(np.mean(old, axis=0), 1e-300)
            if worse_by_rank_test(np.sum(new / unit, axis=1), np.sum(old / unit, axis=1), settings):
                worse.append(horizon)
        pairs = [[{h: before[h]}, {h: after[h]}] for h in long_horizons(before)]
        better = max(float(best_in_resamples(pair, settings)[1]) for pair in pairs)
        return cls(falls, largest, tuple(worse), (better, settings.best_share), tuple(useless))

    def suffices(self, least: float) -> bool:
        """Whether long predictions improve by enough to matter, and none become worse."""
        enough = max(self.largest[h] for h in long_horizons(self.falls)) >= least
        by_chance = self.better[0] < self.better[1]
        return enough and not self.worse and not self._raised(least) and not by_chance

    def _raised(self, least: float) -> list[float]:
        """Horizons over which the error rises: over the shortest one by enough to matter."""
        long = long_horizons(self.falls)
        return [h for h, fall in sorted(self.falls.items()) if fall < (0.0 if h in long else -least)]

    def shortfall(self, least: float) -> str:
        """Why it does not improve predictions enough, in words; empty if it does."""
        if self.suffices(least):
            return ""
        if self.worse:
            over = " and ".join(f"{h:g} s" for h in self.worse)
            return f"makes predictions over {over} worse"
        longest = long_horizons(self.falls)[-1]
        if raised := self._raised(least):
            much = -self.falls[raised[-1]]
            if much > WORDING.diverges:
                return f"makes predictions over {raised[-1]:g} s diverge"
            words = f"{much:.0%}" if much > 0.005 else "a little"
            return f"increases the prediction error over {raised[-1]:g} s by {words}"
        if max(self.largest[h] for h in long_horizons(self.falls)) >= least:
            return f"reduces the prediction error in only {self.better[0]:.0%} of the resamples"
        if longest in self.useless:
            return f"with it, predictions over {longest:g} s are worse than no motion"
        largest = max(self.largest[longest], 0.0)
        return f"reduces the error of no velocity over {longest:g} s by {least:.0%} ({largest:.0%} at most)"

    def harms(self, least: float) -> bool:
        """Whether predictions over any horizon become worse, significantly or by enough to matter."""
        return bool(self.worse) or min(self.falls.values()) < -least

    def helps(self, least: float) -> bool:
        """Whether predictions over any horizon improve by enough to matter."""
        return max(self.largest.values()) >= least


def improved_velocities(before: Squares, after: Squares, least: float) -> list[int]:
    """Indices of the velocities whose long predictions improve by enough to matter.

    before, after: mean squares by horizon, window and velocity, (b, n), as of `PredictionGain.of`.
    """
    falls = []
    for horizon in long_horizons(before):
        old, new = (np.mean(squares[horizon], axis=0) for squares in (before, after))
        falls.append(1.0 - np.sqrt(new / np.maximum(old, 1e-300)))
    return [int(k) for k in np.flatnonzero(np.max(falls, axis=0) >= least)]


def long_horizons(horizons: Iterable[float]) -> list[float]:
    """Horizons except the shortest; for runs as short as that, the only one."""
    found = sorted(horizons)
    return found[1:] or found


def best_in_resamples(candidates: Sequence[Squares], settings: Settings = DEFAULT) -> Array:
    """How often each model predicts best when the windows are resampled, shape (len(candidates),).

    candidates: mean squares by horizon, window and velocity, (b, n), as of `PredictionGain.of`.
    """
    rng = np.random.default_rng(settings.seed)
    total = np.zeros((settings.resamples, len(candidates)))
    for horizon in candidates[0]:
        count = len(candidates[0][horizon])
        weight = rng.multinomial(count, np.full(count, 1.0 / count), settings.resamples) / count
        squares = np.stack([weight @ c[horizon] for c in candidates], axis=1)
        total += np.mean(np.log(np.maximum(squares, 1e-12)), axis=2)
    return np.bincount(np.argmin(total, axis=1), minlength=len(candidates)) / settings.resamples


def error_ahead(squares: Squares) -> float:
    """Error of predictions over all horizons and velocities, on a logarithmic scale."""
    means = [np.mean(each, axis=0) for each in squares.values()]
    return float(np.mean(np.log(np.maximum(means, 1e-12))))


def compared_channels(
    squares: Squares, findings: Sequence[FoundEffect], validator: SimulationValidator
) -> Squares:
    """Squares of the channels by which effects are compared: those of the velocities.

    A sensor error may show only as a contradiction between pose and velocity: if a measurement effect is
    among them, those of the pose, too.

    squares: as of `SimulationValidator.squares_ahead`.
    """
    return squares if any(f.of_sensors for f in findings) else validator.velocities(squares)


def gain_of_effects(
    before: Squares, after: Squares, findings: Sequence[FoundEffect], validator: SimulationValidator
) -> PredictionGain:
    """Improvement by effects, from the squares without and with them."""
    without, with_them = (compared_channels(s, findings, validator) for s in (before, after))
    return PredictionGain.of(without, with_them, validator.settings)
