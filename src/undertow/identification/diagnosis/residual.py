"""The residual force of each degree of freedom: how large, against the noise, and what it correlates with."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from undertow.identification.estimation.data import WeakData, measured_pose
from undertow.identification.estimation.fitted import Fitted
from undertow.identification.estimation.residual import Linearised
from undertow.identification.estimation.step import bounded_step, bounds_of, prior_of, squared
from undertow.model.symbols import DOFS, FORCE_UNITS, VELOCITY
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .associations import (
    AssociatedTerm,
    Association,
    Clock,
    Column,
    Peak,
    Sample,
    Samples,
    Term,
    coefficient_unit,
    command_of,
    difference,
    highest_peak,
    label_of,
    onset_terms,
    step_terms,
    step_time,
    terms_of,
    without_bars,
    without_waves,
)
from .force_rows import ForceRow, ForceRows
from .result import BetweenRuns, Dependence, Remaining, Spectrum, Trend
from .settings import DEFAULT


@dataclass(frozen=True)
class DescriptionSettings:
    """Thresholds for the description of a residual force."""

    most_terms: int = 4  # terms that are reported of one residual force
    line_chance: float = 1e-4  # p-value, for all frequencies tried, above which a period is not reported
    runs_chance: float = 1e-4  # p-value above which a difference between runs is not reported
    chance: float = 0.002  # p-value, over all terms of an equation, above which a term is not reported
    smallest_share: float = 0.1  # share of the excess over noise below which nothing is reported
    in_step: float = 0.7  # least share of what a line removes that one phase for all runs has to remove
    phase_steps: int = 8  # frequencies tried for a common phase, per width of the line
    trend_seconds: float = 100.0  # s over which the change of a coefficient is stated
    most_alike_named: int = 2  # similar terms that are named with a term
    # Mean square, in units of the noise, up to which a residual counts as noise.
    noise_limit: float = DEFAULT.equation_noise_limit
    noise_sigmas: float = 5.0  # its excess over one for short logs, in standard deviations of noise


SETTINGS = DescriptionSettings()


@dataclass
class ResidualDescription:
    """Description of the residual force of one degree of freedom."""

    depends_on: list[Dependence] = field(default_factory=list)
    spectrum: Spectrum | None = None
    trend: Trend | None = None
    between_runs: list[BetweenRuns] = field(default_factory=list)


@dataclass(frozen=True)
class ResidualForce:
    """One residual force with the data for its description.

    association: the residual with the terms that it may correlate with.
    clocks: times of the training and of the validation data.
    rows: source of each of the three samples, with the disturbance used to whiten it.
    unit: unit of the force.
    """

    association: Association
    clocks: tuple[Clock, Clock]
    rows: tuple[tuple[ForceRows, ForceRow, float], ...]
    unit: str

    def waves(self, frequency: float) -> list[Array]:
        """Contribution of a cosine and a sine in time to each of the three samples, shape (K, 2)."""
        return [row.whitened(level, rows.waves(frequency)).J[:, -2:] for rows, row, level in self.rows]


class Characterisation:
    """The search for terms that one residual correlates with."""

    def __init__(self, force: ResidualForce) -> None:
        self._force, self._association = force, force.association
        sample = self._association.samples.under_sensor_noise
        self._excess = max(sample.square - len(sample.r), 1e-9)
        self._description = ResidualDescription()

    def result(self) -> ResidualDescription:
        """Everything that is found."""
        while len(self._description.depends_on) < SETTINGS.most_terms and self._remove_next():
            pass
        self._description.between_runs = list(filter(None, map(self._between_runs, COMPARED_BETWEEN_RUNS)))
        return self._description

    def _remove_next(self) -> bool:
        term, peak = self._strongest(), self._peak()
        if peak is not None and (term is None or peak.excess > term.fall):
            return self._remove_line(peak)
        return term is not None and self._remove_term(term)

    def _strongest(self) -> AssociatedTerm | None:
        """The significant term that removes most, and is significant under autoregressive noise, too.

        A slow disturbance resembles a step, a trend, or the commands that oppose it.
        """
        lengths = [[s.functions.count for s in rows.data.segments] for rows, _, _ in self._force.rows]
        while (term := self._association.strongest()) is not None and term.chance <= SETTINGS.chance:
            if self._association.chance_in_autoregressive_noise(term, lengths) <= SETTINGS.chance:
                return term
            self._association = self._association.excluding(term)
        return None

    def _accept(self, after: Association) -> float:
        """Continue with the remainder; return the share removed, or zero if it is too small to report."""
        fall = self._association.samples.under_sensor_noise.square - after.samples.under_sensor_noise.square
        share = float(np.clip(fall / self._excess, 0.0, 1.0))
        if share < SETTINGS.smallest_share:
            return 0.0
        self._association = after
        return share

    # --- variables ----------------------------------------------------------------------------
    def _remove_term(self, found: AssociatedTerm) -> bool:
        share = self._accept(self._association.without(found))
        if share:
            dependence = _dependence(found, share, self._force.unit)
            self._description.depends_on.append(dependence)
            self._description.trend = self._description.trend or _trend(dependence)
        return share > 0.0

    # --- a line -------------------------------------------------------------------------------
    def _peak(self) -> Peak | None:
        if self._description.spectrum is not None:
            return None
        samples, clocks = self._association.samples, self._force.clocks
        # A test function is four steps wide: of what is faster than that it leaves nothing.
        fastest = 1.0 / (4.0 * clocks[0].step)
        peak = highest_peak(
            clocks[0].series(samples.fitted.r), clocks[1].series(samples.validation.r), fastest
        )
        return peak if peak is not None and peak.chance < SETTINGS.line_chance else None

    def _remove_line(self, peak: Peak) -> bool:
        frequency, in_step = self._phase(peak.frequency)
        after, amplitude = self._without_line(frequency)
        share = self._accept(after)
        if share:
            self._description.spectrum = Spectrum(
                period=1.0 / frequency, amplitude=amplitude, share=share, chance=peak.chance, in_step=in_step
            )
        return share > 0.0

    def _without_line(self, frequency: float) -> tuple[Association, float]:
        samples, clocks = self._association.samples, self._force.clocks
        logs = (clocks[0].log, clocks[1].log, clocks[1].log)
        kept, sizes = [], []
        for s, waves, log in zip(samples, self._force.waves(frequency), logs, strict=True):
            left, coefficients = without_waves(s.r, waves, log)
            kept.append(replace(s, r=left))
            sizes.append(np.linalg.norm(coefficients, axis=1))
        amplitude = float(np.mean(np.concatenate(sizes[:2])))
        return replace(self._association, samples=Samples(*kept)), amplitude

    def _phase(self, frequency: float) -> tuple[float, bool]:
        """Whether all runs have the same phase since their start; then the frequency that fits them best."""
        width = 1.0 / max(c.series(c.t).length for c in self._force.clocks)
        steps = SETTINGS.phase_steps
        near = frequency + width * np.arange(-steps, steps + 1) / steps
        fits = [self._common_phase_falls(f) for f in near]
        best = int(np.argmax([fall for fall, _ in fits]))
        validation = self._association.samples.validation
        own = validation.square - squared(
            without_waves(validation.r, self._force.waves(frequency)[1], self._force.clocks[1].log)[0]
        )
        in_step = fits[best][1] > SETTINGS.in_step * own
        return (float(near[best]) if in_step else frequency), in_step

    def _common_phase_falls(self, frequency: float) -> tuple[float, float]:
        """Fall of the sum of squares by one wave for all runs: on training and validation data."""
        waves = self._force.waves(frequency)
        samples = self._association.samples
        coefficients = -np.linalg.lstsq(waves[0], samples.fitted.r, rcond=None)[0]
        falls = [
            s.square - squared(s.r + w @ coefficients)
            for s, w in zip((samples.fitted, samples.validation), waves, strict=False)
        ]
        return falls[0], falls[1]

    # --- the run ------------------------------------------------------------------------------
    def _between_runs(self, of: str) -> BetweenRuns | None:
        slices = {t.columns: self._association.slices[t.label] for t in self._association.terms}
        columns = COMPARED_BETWEEN_RUNS[of]
        if columns not in slices:
            return None
        pair, clocks = self._association.samples[:2], self._force.clocks
        both = Sample(
            np.concatenate([s.r for s in pair]),
            np.vstack([s.J for s in pair]),
            np.vstack([s.columns for s in pair]),
            np.concatenate([pair[0].block, pair[1].block + pair[0].blocks]),
        )
        names = tuple(dict.fromkeys((*clocks[0].names, *clocks[1].names)))
        logs = [np.array([names.index(c.names[k]) for k in c.log], dtype=np.intp) for c in clocks]
        found = difference(both, slices[columns], self._association.stiffness, np.concatenate(logs))
        if found is None or found.chance > SETTINGS.runs_chance:
            return None
        values = {names[i]: v.tolist() for i, v in zip(found.runs, found.values, strict=True)}
        return BetweenRuns(of=of, values=values, unit=self._force.unit, chance=found.chance)


# Columns of the forces that are compared between runs, by name.
COMPARED_BETWEEN_RUNS: dict[str, tuple[Column, ...]] = {
    "mean force": ((),),
    "force that turns with the heading": (("sin(psi)",), ("cos(psi)",)),
}


def _dependence(found: AssociatedTerm, share: float, unit: str) -> Dependence:
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


def _trend(dependence: Dependence) -> Trend | None:
    """Effect over 100 s of a term that grows with time."""
    column = tuple(dependence.columns[0])
    if "t" not in column:
        return None
    rest = tuple(f for f in column if f != "t")
    unit = coefficient_unit(dependence.units[0].partition("/")[0], rest)
    return Trend(
        of=label_of(rest),
        change=SETTINGS.trend_seconds * dependence.coefficients[0],
        unit=unit,
        share=dependence.share,
    )


_FASTER = {
    "u": "the faster it moves ahead or astern",
    "v": "the faster it moves sideways",
    "w": "the faster it rises or sinks",
    "p": "the faster it rolls",
    "q": "the faster it pitches",
    "r": "the faster it turns",
    "t": "the longer the run lasts",
}


def sentence(left: Remaining, above_noise: bool) -> str:
    """One sentence: ``surge: 0.8 N rms remains above the noise; 71% of it correlates with |r| u``."""
    if not above_noise:
        return f"{left.degree_of_freedom}: {left.residual_rms:.2g} {left.unit} rms remains, which is noise"
    size = f"{left.excess_rms:.2g} {left.unit} rms remains above the noise"
    parts = list(_clauses(left)) or [
        "it correlates significantly with none of the logged variables, and no period stands out"
    ]
    return f"{left.degree_of_freedom}: {'; '.join([size, *parts])}"


def _clauses(left: Remaining) -> Iterator[str]:
    for dependence in left.depends_on:
        action = effect_on_motion(dependence, left.degree_of_freedom, left.unit)
        yield f"{dependence.share:.0%} of it correlates with {_term_in_words(dependence)} ({action})"
    if left.spectrum is not None:
        yield _period_in_words(left.spectrum, left.unit)
    yield from map(_run_difference_in_words, left.between_runs)


def effect_on_motion(dependence: Dependence, degree_of_freedom: str, unit: str) -> str:
    """Effect of a term on the motion, as far as its sign tells."""
    coefficients, column = dependence.coefficients, dependence.columns[0]
    if len(coefficients) > 1:
        return _joint_effect(dependence)
    if not column:
        return f"{coefficients[0]:.2g} {unit}"
    if step_time(column) is not None:
        rest = tuple(column[1:])
        if not rest:
            return f"{coefficients[0]:+.2g} {unit} from then on"
        begun = dependence.model_copy(update={"columns": [rest], "term": label_of(rest)})
        return effect_on_motion(begun, degree_of_freedom, unit)
    own = VELOCITY[DOFS.index(degree_of_freedom)]
    others = [f for f in column if f != own]
    even = all(f == "t" or f.startswith("|") for f in others)
    if column.count(own) == 1 and even:
        faster = [_FASTER[without_bars(f)] for f in others if without_bars(f) in _FASTER]
        action = f"slows {degree_of_freedom}" if coefficients[0] < 0 else f"drives {degree_of_freedom} on"
        return ", ".join([action, f"the more {' and '.join(faster)}"] if faster else [action])
    return f"{'falls' if coefficients[0] < 0 else 'rises'} as {dependence.term} grows"


def _joint_effect(dependence: Dependence) -> str:
    commands = [command_of(column[0]) for column in dependence.columns]
    if None in commands:
        return f"amplitude {float(np.linalg.norm(dependence.coefficients)):.2g} {dependence.units[0]}"
    each = zip(dependence.coefficients, commands, strict=True)
    return f"{', '.join(f'{value:.2g} for {name}' for value, name in each)}; {dependence.units[0]}"


def _term_in_words(dependence: Dependence) -> str:
    others = "".join(f" or {a}" for a in dependence.alike[: SETTINGS.most_alike_named])
    return f"{dependence.term}{others}"


def _period_in_words(spectrum: Spectrum, unit: str) -> str:
    phase = "" if spectrum.in_step else ", with a different phase in every run"
    size = f"amplitude {spectrum.amplitude:.2g} {unit}, {spectrum.share:.0%} of it{phase}"
    return f"period {spectrum.period:.3g} s stands out ({size})"


def _run_difference_in_words(difference: BetweenRuns) -> str:
    values = [float(np.linalg.norm(v)) if len(v) > 1 else v[0] for v in difference.values.values()]
    size = f"{min(values):.2g} to {max(values):.2g} {difference.unit}"
    return f"the {difference.of} differs from run to run ({size})"


def _without_inputs(terms: Iterable[Term], vehicle: Vehicle) -> Iterator[Term]:
    """Terms without logged inputs, which only the effects that declare them can contain."""
    for term in terms:
        if not {command_of(f) for c in term.columns for f in c} & {*vehicle.inputs}:
            yield term


class Characteriser:
    """Residual forces of a fitted model, on training and validation data."""

    def __init__(self, fit: Fitted, known: WeakData, validation: WeakData) -> None:
        vehicle = fit.model.functions.vehicle
        self._units = [FORCE_UNITS[i] for i in vehicle.dof_indices]
        self._fitted, self._validation = ForceRows(fit, known), ForceRows(fit, validation)
        self._steps = step_terms(self._clocks[0].t)
        terms = terms_of(vehicle, measured_pose(vehicle, validation.runs))
        self._terms = (*_without_inputs(terms, vehicle), *self._steps)
        self._fit, self._prior = fit, prior_of(fit.model)[1]

    @cached_property
    def rows(self) -> list[ForceRow]:
        """Force equations on the validation data."""
        return [self._validation.row(i) for i in range(len(self._units))]

    def above_noise(self, dof: int) -> bool:
        """Whether the residual of a degree of freedom exceeds the noise."""
        row = self.rows[dof]
        count = sum(len(p.r) for p in row.parts)
        return row.ratio > max(
            SETTINGS.noise_limit, 1.0 + SETTINGS.noise_sigmas * float(np.sqrt(2.0 / count))
        )

    def describe(self, dof: int) -> ResidualDescription:
        """Describe the residual of a degree of freedom, by its place among those of the vehicle.

        For growth with time, a sudden onset is tried as well.
        """
        found = self._describe(dof)
        growing = {t.label: t for d in found.depends_on for t in onset_terms(d.columns[0], self._steps)}
        return self._describe(dof, tuple(growing.values())) if growing else found

    def _describe(self, dof: int, further: tuple[Term, ...] = ()) -> ResidualDescription:
        fitted, validation = self._fitted_rows[dof], self.rows[dof]
        rows = (self._fitted, fitted, fitted.disturbance), (self._validation, validation, fitted.disturbance)
        force = ResidualForce(
            self._association(dof, further),
            self._clocks,
            (*rows, (self._validation, validation, 0.0)),
            self._units[dof],
        )
        return Characterisation(force).result()

    def _association(self, dof: int, further: tuple[Term, ...]) -> Association:
        level, own = self._fitted_rows[dof].disturbance, len(self._prior)
        more = [c for t in further for c in t.columns]
        first, second = (
            [np.hstack(pair) for pair in zip(known, rows.columns(more), strict=True)] if more else known
            for known, rows in zip(self._columns, (self._fitted, self._validation), strict=True)
        )
        tables = [
            self._fitted_rows[dof].whitened(level, first),
            self.rows[dof].whitened(level, second),
            self.rows[dof].whitened(0.0, second),
        ]
        seconds = self._validation.data.uncorrelated_seconds(tables[0].r)
        blocks = [c.blocks(seconds) for c in (*self._clocks, self._clocks[1])]
        samples = [
            Sample(t.r + t.J[:, :own] @ self._reestimation, t.J[:, :own], t.J[:, own:], b)
            for t, b in zip(tables, blocks, strict=True)
        ]
        return Association((*self._terms, *further), Samples(*samples), self._stiffness(dof))

    def _stiffness(self, dof: int) -> Array:
        """Information on the parameters from priors and from the equations of the other motions."""
        others = [self._information[i] for i in range(len(self._units)) if i != dof]
        return np.asarray(np.diag(self._prior**2) + sum(others, np.zeros((len(self._prior),) * 2)))

    @cached_property
    def _fitted_rows(self) -> list[ForceRow]:
        return [self._fitted.row(i) for i in range(len(self._units))]

    @cached_property
    def _clocks(self) -> tuple[Clock, Clock]:
        return Clock.of(self._fitted.data), Clock.of(self._validation.data)

    @cached_property
    def _whitened(self) -> list[Linearised]:
        return [row.whitened(row.disturbance) for row in self._fitted_rows]

    @cached_property
    def _information(self) -> list[Array]:
        return [w.J.T @ w.J for w in self._whitened]

    @cached_property
    def _reestimation(self) -> Array:
        """Change of the free parameters to the values with the least residual forces, (k,).

        Those that predict best differ. Forces that a change of them would remove are no sign of a term, and
        add to what terms explain by chance (Hemerik, Goeman and Finos 2020, doi:10.1111/rssb.12369).
        """
        model, each = self._fit.model, self._whitened
        r, J, start = (np.concatenate(a) for a in zip(*((w.r, w.J, w.start) for w in each), strict=True))
        now = self._fit.p[list(model.places)]
        return bounded_step(Linearised(r, J, start), now, bounds_of(model), prior_of(model))

    @cached_property
    def _columns(self) -> tuple[list[Array], list[Array]]:
        """Contribution of each term to a row, on training and validation data."""
        columns = [c for t in self._terms for c in t.columns]
        return self._fitted.columns(columns), self._validation.columns(columns)


def remaining(fit: Fitted, known: WeakData, validation: WeakData) -> list[Remaining]:
    """Residual force of every degree of freedom on validation data."""
    characteriser = Characteriser(fit, known, validation)
    return [_remaining(characteriser, fit, i) for i in range(len(fit.model.functions.vehicle.dof_indices))]


def unrelated_to(
    variables: Collection[str], left: Iterable[Remaining], vehicle: Vehicle, *, periodic: bool = False
) -> list[Remaining]:
    """Residual forces that depend on variables other than those of an effect.

    A drag that grows with time is such a force for thrust that fades with it, and so is a sudden onset.

    variables: velocities, pose, commands and time ("t"), as far as the effect depends on them.
    periodic: whether the effect itself oscillates in time, so that a period does not count.
    """
    found = []
    for r in left:
        others = [d for d in r.depends_on if not _variables(d, vehicle) <= {*variables}]
        line = None if periodic else r.spectrum
        if others or line:
            found.append(r.model_copy(update={"depends_on": others, "spectrum": line, "between_runs": []}))
    return found


def _variables(dependence: Dependence, vehicle: Vehicle) -> set[str]:
    """Pose, velocities, commands, time and a step in it, as far as a dependence contains them."""
    names = {*vehicle.pose_names, *vehicle.velocity_names, *vehicle.command_names, "t", "step"}
    return names & {word for columns in dependence.columns for c in columns for word in re.findall(r"\w+", c)}


def _remaining(characteriser: Characteriser, fit: Fitted, i: int) -> Remaining:
    vehicle, row = fit.model.functions.vehicle, characteriser.rows[i]
    above_noise = characteriser.above_noise(i)
    error = float(np.sqrt(row.ratio))
    left = Remaining(
        degree_of_freedom=vehicle.degrees_of_freedom[i],
        normalised_error=error,
        residual_rms=row.rms,
        noise_rms=row.noise_rms,
        unit=FORCE_UNITS[vehicle.dof_indices[i]],
        excess_rms=row.excess_rms if above_noise else 0.0,
        note="above the noise" if above_noise else "explained by the noise",
    )
    if above_noise:
        for name, found in vars(characteriser.describe(i)).items():
            setattr(left, name, found)
    left.summary = sentence(left, above_noise)
    return left
