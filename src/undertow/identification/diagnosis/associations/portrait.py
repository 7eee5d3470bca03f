"""What one residual force goes with, strongest first: variables, a period, time, the run.

Associations only: that a force goes with a product of motions does not say what makes it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from undertow.typing import Array

from ..result import BetweenRuns, Dependence, Spectrum, Trend
from .between_runs import difference
from .clock import Clock
from .force_rows import ForceRow, ForceRows
from .residual import Association, Found, Sample, Samples
from .spectrum import Peak, highest_peak, without_waves
from .terms import coefficient_unit, label_of

MOST_TERMS = 4
# Chance, over all terms of a degree of freedom, above which an association is not told.
_CHANCE = 0.002
_CHANCE_OF_A_LINE = 1e-4
_CHANCE_OF_RUNS = 1e-4
_SMALLEST_SHARE = 0.1
# Share of what a line takes away with a phase of its own in every run, from which it keeps its phase.
_IN_STEP = 0.7
# Frequencies that are tried around a line for a phase that all runs have in common, per width of the line.
_FINE = 8
_TREND_SECONDS = 100.0


@dataclass
class Character:
    """What is known of the residual force of one degree of freedom."""

    depends_on: list[Dependence] = field(default_factory=list)
    spectrum: Spectrum | None = None
    trend: Trend | None = None
    between_runs: list[BetweenRuns] = field(default_factory=list)


@dataclass(frozen=True)
class Sitting:
    """One residual force, ready to be looked at.

    Attributes
    ----------
    association : Association
        The residual with the terms that it may go with.
    clocks : (Clock, Clock)
        Clock of the data of the fit, and of those kept aside.
    rows : three of (ForceRows, ForceRow, float)
        Where each of the three samples comes from, with the disturbance that it was whitened with.
    unit : str
        Unit of the force.
    """

    association: Association
    clocks: tuple[Clock, Clock]
    rows: tuple[tuple[ForceRows, ForceRow, float], ...]
    unit: str

    def waves(self, frequency: float) -> list[Array]:
        """What a cosine and a sine in time add to each of the three samples, shape (K, 2)."""
        return [row.whitened(level, rows.waves(frequency)).J[:, -2:] for rows, row, level in self.rows]


class Portrait:
    """The search for what one residual goes with."""

    def __init__(self, sitting: Sitting) -> None:
        self._sitting, self._left = sitting, sitting.association
        shown = self._left.samples.shown
        self._excess = max(shown.square - len(shown.r), 1e-9)
        self._character = Character()

    def drawn(self) -> Character:
        """Everything that is found."""
        while len(self._character.depends_on) < MOST_TERMS and self._next():
            pass
        self._character.between_runs = list(filter(None, map(self._between_runs, _COMPARED)))
        return self._character

    def _next(self) -> bool:
        term, peak = self._left.strongest(), self._peak()
        if term is not None and term.chance > _CHANCE:
            term = None
        if peak is not None and (term is None or peak.gain > term.gain):
            return self._take_line(peak)
        return term is not None and self._take(term)

    def _accept(self, after: Association) -> float:
        """Go on with what is left; the share that went away, or zero where it is too small to be told."""
        fall = self._left.samples.shown.square - after.samples.shown.square
        share = float(np.clip(fall / self._excess, 0.0, 1.0))
        if share < _SMALLEST_SHARE:
            return 0.0
        self._left = after
        return share

    # --- variables ----------------------------------------------------------------------------
    def _take(self, found: Found) -> bool:
        share = self._accept(self._left.without(found))
        if share:
            told = _dependence(found, share, self._sitting.unit)
            self._character.depends_on.append(told)
            self._character.trend = self._character.trend or _trend(told)
        return share > 0.0

    # --- a line -------------------------------------------------------------------------------
    def _peak(self) -> Peak | None:
        if self._character.spectrum is not None:
            return None
        samples, clocks = self._left.samples, self._sitting.clocks
        # A test function is four steps wide: of what is faster than that it leaves nothing.
        fastest = 1.0 / (4.0 * clocks[0].step)
        peak = highest_peak(clocks[0].series(samples.fitted.r), clocks[1].series(samples.aside.r), fastest)
        return peak if peak is not None and peak.chance < _CHANCE_OF_A_LINE else None

    def _take_line(self, peak: Peak) -> bool:
        frequency, in_step = self._phase(peak.frequency)
        after, amplitude = self._without_line(frequency)
        share = self._accept(after)
        if share:
            self._character.spectrum = Spectrum(
                period=1.0 / frequency, amplitude=amplitude, share=share, chance=peak.chance, in_step=in_step
            )
        return share > 0.0

    def _without_line(self, frequency: float) -> tuple[Association, float]:
        samples, clocks = self._left.samples, self._sitting.clocks
        logs = (clocks[0].log, clocks[1].log, clocks[1].log)
        kept, sizes = [], []
        for s, waves, log in zip(_three(samples), self._sitting.waves(frequency), logs, strict=True):
            left, coefficients = without_waves(s.r, waves, log)
            kept.append(replace(s, r=left))
            sizes.append(np.linalg.norm(coefficients, axis=1))
        amplitude = float(np.mean(np.concatenate(sizes[:2])))
        return replace(self._left, samples=Samples(*kept)), amplitude

    def _phase(self, frequency: float) -> tuple[float, bool]:
        """Whether all runs have the same phase since their start; then the frequency that suits them best."""
        width = 1.0 / max(c.series(c.t).length for c in self._sitting.clocks)
        near = frequency + width * np.arange(-_FINE, _FINE + 1) / _FINE
        fits = [self._common(f) for f in near]
        best = int(np.argmax([fall for fall, _ in fits]))
        aside = self._left.samples.aside
        own = aside.square - _square(
            without_waves(aside.r, self._sitting.waves(frequency)[1], self._sitting.clocks[1].log)[0]
        )
        in_step = fits[best][1] > _IN_STEP * own
        return (float(near[best]) if in_step else frequency), in_step

    def _common(self, frequency: float) -> tuple[float, float]:
        """Fall of the sum of squares by one wave for all runs: on the data of the fit, and kept aside."""
        waves = self._sitting.waves(frequency)
        samples = self._left.samples
        coefficients = -np.linalg.lstsq(waves[0], samples.fitted.r, rcond=None)[0]
        falls = [
            s.square - _square(s.r + w @ coefficients)
            for s, w in zip((samples.fitted, samples.aside), waves, strict=False)
        ]
        return falls[0], falls[1]

    # --- the run ------------------------------------------------------------------------------
    def _between_runs(self, compared: tuple[str, str]) -> BetweenRuns | None:
        label, of = compared
        places = self._left.places
        if label not in places:
            return None
        pair, clocks = (self._left.samples.fitted, self._left.samples.aside), self._sitting.clocks
        names = tuple(dict.fromkeys((*clocks[0].names, *clocks[1].names)))
        logs = [np.array([names.index(c.names[k]) for k in c.log], dtype=np.intp) for c in clocks]
        found = difference(
            np.concatenate([s.r for s in pair]),
            np.vstack([s.columns[:, places[label]] for s in pair]),
            np.concatenate(logs),
            np.concatenate([pair[0].block, pair[1].block + pair[0].blocks]),
        )
        if found is None or found.chance > _CHANCE_OF_RUNS:
            return None
        values = {n: v.tolist() for n, v in zip(names, found.values, strict=True)}
        return BetweenRuns(of=of, values=values, unit=self._sitting.unit, chance=found.chance)


_COMPARED = (("a constant", "mean force"), ("sin and cos of psi", "force that turns with the heading"))


def _three(samples: Samples) -> tuple[Sample, Sample, Sample]:
    return samples.fitted, samples.aside, samples.shown


def _square(r: Array) -> float:
    return float(np.sum(r**2))


def _dependence(found: Found, share: float, unit: str) -> Dependence:
    return Dependence(
        term=found.term.label,
        columns=[list(c) for c in found.term.columns],
        coefficients=found.coefficients.tolist(),
        standard_errors=found.errors.tolist(),
        units=[coefficient_unit(unit, c) for c in found.term.columns],
        share=share,
        chance=found.chance,
        alike=list(found.alike),
    )


def _trend(told: Dependence) -> Trend | None:
    """What a term that grows with time says about 100 s."""
    column = tuple(told.columns[0])
    if "t" not in column:
        return None
    rest = tuple(f for f in column if f != "t")
    unit = coefficient_unit(told.units[0].partition("/")[0], rest)
    return Trend(of=label_of(rest), change=_TREND_SECONDS * told.coefficients[0], unit=unit, share=told.share)
