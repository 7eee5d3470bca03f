"""The candidates of one round: which improve predictions, which one leads, and the doubts about it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from undertow.errors import UndertowError
from undertow.identification.estimation.fitted import Fitted
from undertow.identification.estimation.output_error import NO_WORSE
from undertow.identification.estimation.weak_form import WeakFit
from undertow.typing import Array

from .bench import Bench, noise_in_more_equations
from .consistency import (
    SPRING,
    constant_heading,
    is_spring,
    own_variables,
    size_inconsistency,
    step_wider_than_motion,
    undetermined_by_fit,
    vanished_inertia,
    with_effect_zero,
)
from .evidence import (
    FoundEffect,
    as_good,
    fitted,
    inclusion,
    linearised,
    p_value_by_prediction_error,
    reconciles_sensors,
    reduced_to_same_force,
)
from .parallel import mapped
from .predictability import share_of_predictable
from .prediction_gain import (
    PredictionGain,
    Squares,
    best_in_resamples,
    compared_channels,
    error_ahead,
    gain_of_effects,
    improved_velocities,
)
from .rounds import Round
from .search import last_fit
from .settings import DEFAULT, Settings
from .validation import SimulationValidator


@dataclass(frozen=True)
class Graded:
    """An effect that improves predictions of the validation data.

    chosen: the effect; rivals: those that do as well in its place.
    gain: its improvement of predictions in addition to those before it.
    doubt: why it is not established as the cause; empty if it is.
    significant: whether its force is; else predictions alone show it.
    """

    chosen: FoundEffect
    rivals: list[FoundEffect]
    gain: PredictionGain
    doubt: str
    significant: bool = True


def doubt_of_companion(effect: str) -> str:
    """Doubt about an effect that may only compensate for another one in doubt."""
    return f"it was identified together with {effect}, which is not established either"


def _is_refuted(finding: FoundEffect, doubt: str, bench: Bench) -> bool:
    """Whether there is evidence against an effect; otherwise its force is present, whatever the cause.

    A current on a constant heading is not refuted: these logs do not contain what distinguishes it. Nor is
    an effect that may be a slow disturbance.
    """
    exempt = constant_heading(finding, bench), slow_disturbance_doubt(finding, bench.settings)
    return bool(doubt) and doubt not in exempt


def slow_disturbance_doubt(finding: FoundEffect, settings: Settings = DEFAULT) -> str:
    """That an effect may be a slow disturbance, in words; empty if not."""
    if not finding.may_be_slow_disturbance(settings):
        return ""
    return f"a slow disturbance would score as well by chance in {finding.slow_p_value:.1%} of such logs"


def feedback_doubt(finding: FoundEffect, bench: Bench, among: int) -> str:
    """That an effect of the commands may be the response of a controller, in words; empty if not.

    Commands in a closed loop oppose the disturbance, and look like thrust that is lost or late. The effect is
    the best of so many candidates.
    """
    if finding.trial.candidate.effect.family != "actuation":
        return ""
    try:
        chance = min(1.0, among * p_value_by_prediction_error(finding, bench))
    except UndertowError:  # a delayed sensor, or segments too short for windows
        return ""
    if chance < bench.settings.false_alarm_rate:
        return ""
    return (
        "commands that oppose a disturbance look like this: with process noise in the model, predictions one "
        f"step ahead improve no more than by chance (p = {chance:.2g})"
    )


def _is_series_of(finding: FoundEffect, other: FoundEffect) -> bool:
    """Whether an effect is a polynomial approximation of another: that the series fits better, as it will
    with more coefficients, is no evidence against the physics.
    """
    return other.id in finding.trial.candidate.effect.series_of


#: Gain of predictions by the second of two effects when the first is in the model already.
GainOnTop = Callable[[FoundEffect, FoundEffect], PredictionGain]


def substitutes(
    chosen: FoundEffect,
    alone: PredictionGain,
    rivals: Sequence[FoundEffect],
    gain_on_top: GainOnTop,
    settings: Settings = DEFAULT,
) -> list[FoundEffect]:
    """The rivals that take over what the chosen effect explains: with them in the model, its gain is small.

    With others in the model it gains as much as `alone`: they explain something else.
    """
    return [r for r in rivals if gain_on_top(r, chosen).log_fall < settings.kept_gain * alone.log_fall]


def dominated(
    best: FoundEffect,
    others: Sequence[FoundEffect],
    better: Callable[[FoundEffect, FoundEffect], float],
    gain_on_top: GainOnTop,
    settings: Settings = DEFAULT,
) -> dict[str, str]:
    """Why other effects are not established if a better one is in doubt, by their ids.

    Whatever causes the better one, an effect that adds nothing to it only compensates for that in part.

    better: fraction of the resamples in which the first of two is better.
    """
    found = {}
    for f in others:
        clearly = better(best, f) >= settings.best_share
        if clearly and not gain_on_top(best, f).suffices(settings.worth):
            found[f.id] = f"{best.id}, also not established, predicts better, and this adds nothing to it"
    return found


def undetermined_by_fits(
    finding: FoundEffect, predicts: Fitted, settings: Settings = DEFAULT, *, alternative: bool = False
) -> str:
    """Which parameter of an effect a fit leaves undetermined or impossible, in words; empty if none.

    No fit of an established effect may do so. An alternative to one is excluded only by the fit that
    predicts: that of the weak form may have ended in a local minimum which this one has left.
    """
    if (words := undetermined_by_fit(finding, predicts, settings)) or alternative:
        return words
    words = undetermined_by_fit(finding, finding.trial.fit, settings)
    return words and f"{words} (fitted to the residual force alone)"


def insignificance(finding: FoundEffect) -> str:
    """Doubt about an effect that improves predictions, but whose force is not significant."""
    return f"the residual alone does not show its force (p = {finding.p_value:.2g})"


ONLY_TOGETHER = "it improves predictions only together with other effects that were added"
"""Doubt about an effect whose own improvement depends on the local minimum that a fit ends in."""
_NOT_BEST = "other effects are better in nearly all resamples of the logs"
_OTHER_MINIMUM = "its fit predicts as well with it set to zero: it has only reached another local minimum"


class Predictions:
    """Predictions of the validation data by models, each fitted like the final result.

    report: progress, from 0 to 1.
    """

    def __init__(self, validator: SimulationValidator, report: Callable[[float, str], None]) -> None:
        self.validator, self._report = validator, report

    def squares_ahead(self, fits: Sequence[WeakFit]) -> list[dict[float, Array]]:
        """Squares of the predictions of velocities and pose, for each model; on all cores."""

        def done(count: int, total: int) -> None:
            if len(fits) > 1:  # else one of many pairs
                self._report(count / total, f"refitted and simulated candidates: {count} of {total}")

        self.validator.compute_final_fits(fits, done)
        return [self.validator.squares_ahead(self.validator.final(f)) for f in fits]


class Grading:
    """The candidates of one round, by how the model with each of them predicts the validation data.

    graded: the effects that are in the model already.
    later: effects found after this one in an earlier pass.
    significant: whether the candidates are those whose force is significant, or the others.
    """

    def __init__(
        self,
        current: Round,
        graded: Sequence[Graded],
        predictions: Predictions,
        later: Sequence[FoundEffect] = (),
        *,
        significant: bool = True,
    ) -> None:
        self._round, self._graded, self._later = current, graded, later
        self._significant = significant
        self._bench, self._settings = current.bench, current.bench.settings
        self._validator, self._squares_of = predictions.validator, predictions.squares_ahead
        self._found: dict[str, FoundEffect] = {}
        self._squares: dict[str, dict[float, Array]] = {}
        self._before = self._predicted(self._screened())
        self.gains = {i: self._gain([f], self._before, self._squares[i]) for i, f in self._found.items()}
        self._other_minima: dict[str, PredictionGain | None] = {}

    def best(self) -> Graded | None:
        """The best candidate that improves predictions enough, with its rivals; an established one leads.

        After a refuted effect, or one of too many equivalents, none is established: it may compensate for
        that. A contradiction between pose and velocities is due to the sensors, whatever forces are missing.
        """
        if not self._sufficient:
            return None
        chosen = next((f for f in self._unaffected if not self._doubts[f.id]), None)
        if chosen is not None and self._significant:
            return Graded(chosen, self._rivals_of(chosen), self.gains[chosen.id], "")
        first = chosen or self._sufficient[0]
        doubt = doubt_of_companion(self._refuted) if self._refuted else self._doubts[first.id]
        doubt = doubt or insignificance(first)
        return Graded(first, [], self.gains[first.id], doubt, significant=self._significant)

    @property
    def reasons(self) -> dict[str, str]:
        """Why significant candidates were not chosen, by their ids."""
        doubts = self._doubts | dict.fromkeys(self._springs, SPRING)
        known = {
            i: gain.shortfall(self._settings.worth) or doubts.get(i) or self._other_minimum(self._found[i])
            for i, gain in self.gains.items()
        }
        return {f.id: known.get(f.id) or _NOT_BEST for f in beyond_chance(self._round)}

    @property
    def net_gains(self) -> dict[str, PredictionGain]:
        """Improvements of predictions, by id, without what is due to another local minimum of the fit."""
        return self.gains | {i: gain for i, gain in self._other_minima.items() if gain and i in self.gains}

    # --- which improve predictions, and which one leads -----------------------------------------------
    def _screened(self) -> list[FoundEffect]:
        """The significant candidates that lead as fitted by the weak form, by simulation and by residual.

        If a record was filtered, the leader by residual may not improve predictions; if the weak form fits
        poorly, the reverse holds: the first of both orders are taken alternately.
        """
        if not self._significant:
            return self._improving_as_they_are()
        found = beyond_chance(self._round)
        most = self._settings.simulated_candidates
        if len(found) <= most:
            return found
        work = mapped(lambda i: self._validator.squares_ahead(found[i].trial.fit), len(found))
        squares = [error_ahead(compared_channels(each, found, self._validator)) for each in work]
        by_simulation = np.argsort(np.argsort(squares, kind="stable"))
        turn = np.minimum(2 * by_simulation, 2 * np.arange(len(found)) + 1)  # they come in order of residual
        return [found[k] for k in np.argsort(turn, kind="stable")[:most]]

    def _improving_as_they_are(self) -> list[FoundEffect]:
        """Candidates whose force is not significant, but improves predictions as fitted by the weak form."""
        known = {f.id for f in beyond_chance(self._round)}
        found = [f for f in self._round.findings if f.trial.kept and f.id not in known]
        fits = [self._bench.base, *(f.trial.fit for f in found)]
        before, *squares = mapped(lambda i: self._validator.squares_ahead(fits[i]), len(fits))
        gains = [self._gain([f], before, after) for f, after in zip(found, squares, strict=True)]
        order = sorted(range(len(found)), key=lambda i: -gains[i].log_fall)
        helpful = [found[i] for i in order if gains[i].suffices(self._settings.worth)]
        return helpful[: self._settings.simulated_candidates]

    def _predicted(self, findings: Sequence[FoundEffect]) -> dict[float, Array]:
        """Predict with each finding, and without any; the squares of the latter.

        A parameter that is significant in the force may be left out where something else is missing as well:
        of the parameters that the search keeps and those that a last fit would keep, as of `add`, those with
        which predictions are better.
        """
        wider = {f.id: w for f in findings if (w := self._with_last_fit(f)) is not None}
        tried = [*findings, *wider.values()]
        before, *squares = self._squares_of([self._bench.base, *(f.trial.fit for f in tried)])
        for finding, after in zip(tried, squares, strict=True):
            known = self._squares.get(finding.id)
            if known is None or self._error_ahead(after) <= self._error_ahead(known) + np.log1p(NO_WORSE):
                self._found[finding.id], self._squares[finding.id] = finding, after
        return before

    def _error_ahead(self, squares: Squares) -> float:
        """Logarithm of the error of predicted velocities."""
        return error_ahead(self._validator.velocities(squares)) / 2.0

    def _with_last_fit(self, finding: FoundEffect) -> FoundEffect | None:
        """The finding with the parameters that a last fit would keep; None if these are the same."""
        # Rounds are evaluated again in a second pass.
        return self._validator.cached("last fit", finding.trial.fit, lambda _: self._last_fitted(finding))

    def _last_fitted(self, finding: FoundEffect) -> FoundEffect | None:
        trial = finding.trial
        if not {*trial.candidate.removable} - {*trial.fit.model.values.names}:
            return None
        fit = last_fit(trial.fit, [trial.candidate], self._settings)
        if fit.model.free == trial.fit.model.free:
            return None
        kept = tuple(n for n in trial.candidate.sizes if n in fit.model.values.names)
        return replace(finding, trial=replace(trial, fit=fit, kept=kept, score=self._bench.score(fit)))

    def _gain(self, findings: Sequence[FoundEffect], before: Squares, after: Squares) -> PredictionGain:
        return gain_of_effects(before, after, findings, self._validator)

    def _is_sufficient(self, finding: FoundEffect) -> bool:
        gain, settings = self.gains[finding.id], self._settings
        enough = gain.suffices(settings.worth) and not self._other_minimum(finding)
        return enough and (self._significant or self._predicts_for_certain(finding))

    def _predicts_for_certain(self, finding: FoundEffect) -> bool:
        """Whether predictions improve beyond chance, and also as the result is fitted: without a significant
        force they are all there is.
        """
        if self.gains[finding.id].better[0] < 1.0 - self._settings.false_alarm_rate:
            return False
        reported = fitted(self._bench.base.model.functions.vehicle, [finding], self._bench).fit
        gain = self._gain([finding], self._before, self._squares_of([reported])[0])
        return gain.suffices(self._settings.worth)

    def _other_minimum(self, finding: FoundEffect) -> str:
        """That the fit predicts as well with the effect set to zero, in words; empty if not."""
        if finding.id not in self._other_minima:
            self._other_minima[finding.id] = self._gain_in_other_minimum(finding)
        return _OTHER_MINIMUM if self._other_minima[finding.id] else ""

    def _gain_in_other_minimum(self, finding: FoundEffect) -> PredictionGain | None:
        """Improvement over the same fit with the effect set to zero, where that is too little to matter."""
        without = with_effect_zero(finding, self._validator.predicting_fit(finding.trial.fit))
        if without is None:
            return None
        gain = self._gain([finding], self._validator.squares_ahead(without), self._squares[finding.id])
        return None if gain.helps(self._settings.worth) else gain

    @cached_property
    def _predictive(self) -> list[FoundEffect]:
        """Those that improve predictions over any horizon by enough to matter."""
        return [f for i, f in self._found.items() if self.gains[i].helps(self._settings.worth)]

    @cached_property
    def _springs(self) -> set[str]:
        """Ids of memory effects that are springs, if another candidate does at least half as much."""
        fall = {f.id: float(np.mean([*self.gains[f.id].falls.values()])) for f in self._predictive}
        springs = {f.id for f in self._predictive if is_spring(f)}
        most = max((fall[i] for i in springs), default=0.0)
        enough = any(fall[i] >= self._settings.own_share * most for i in fall.keys() - springs)
        return springs if enough else set()

    @cached_property
    def _leading(self) -> tuple[list[FoundEffect], list[FoundEffect]]:
        """The candidates of which one is the best in nearly all resamples, the best first; and others that
        the data cannot tell from it.
        """
        findings = [f for f in self._predictive if f.id not in self._springs]
        if not findings:
            return [], []
        inclusion_frequency = self._inclusion(findings)
        order = np.argsort(-inclusion_frequency, kind="stable")
        count = int(np.searchsorted(np.cumsum(inclusion_frequency[order]), self._settings.best_share)) + 1
        leading = [findings[k] for k in order[:count]]
        others = [findings[k] for k in order[count:]]
        best = leading[0].trial.score
        near = [f for f in others if as_good(best, f.trial.score, self._bench)]
        return leading, near[: self._settings.rivals]

    def _inclusion(self, findings: Sequence[FoundEffect]) -> Array:
        """How often each candidate is the best in resamples, shape (len(findings),).

        Resamples of the weak-form residual respond to quick forces, those of the simulation to slow ones.
        """
        return 0.5 * (self._inclusion_by_residual(findings) + self._inclusion_by_prediction(findings))

    def _inclusion_by_residual(self, findings: Sequence[FoundEffect]) -> Array:
        return inclusion([linearised(f.trial.fit, self._bench) for f in findings], self._settings)

    def _inclusion_by_prediction(self, findings: Sequence[FoundEffect]) -> Array:
        squares = [compared_channels(self._squares[f.id], findings, self._validator) for f in findings]
        return best_in_resamples(squares, self._settings)

    @cached_property
    def _sufficient(self) -> list[FoundEffect]:
        """The leading ones that improve predictions enough.

        One with a parameter at its bound is not confirmed: others come first, also for predictions alone.
        """
        sufficient = filter(self._is_sufficient, self._leading[0])
        return sorted(sufficient, key=lambda f: bool(self._undetermined(f)))

    @cached_property
    def _refuted(self) -> str:
        """Id of the first effect in the model that is refuted or has too many equivalents; empty for none."""
        many = self._settings.most_equivalent
        refuted = (
            g.chosen.id
            for g in self._graded
            if _is_refuted(g.chosen, g.doubt, self._bench) or len(g.rivals) >= many
        )
        return next(refuted, "")

    @cached_property
    def _unaffected(self) -> list[FoundEffect]:
        """Those of them that a refuted effect in the model does not affect."""
        return [f for f in self._sufficient if not self._refuted or reconciles_sensors(f, self._bench)]

    # --- doubts ---------------------------------------------------------------------------------------
    @cached_property
    def _doubts(self) -> dict[str, str]:
        """Why the leading ones are not established, by their ids; empty for those that are."""
        asked = (*self._leading[0], *self._leading[1]) if self._unaffected else ()
        doubts = {f.id: self._doubt(f) for f in asked}
        return doubts | self._dominated(doubts)

    def _doubt(self, finding: FoundEffect, *, alternative: bool = False) -> str:
        """Why an effect is not established as the cause of what it explains; empty if it is.

        alternative: whether it is only to take the place of an established one.
        """
        bench = self._bench
        if words := (
            self._undetermined(finding, alternative=alternative)
            or constant_heading(finding, bench)
            or step_wider_than_motion(finding, bench)
            or self._replaces_added_mass(finding)
            or size_inconsistency(finding, bench, self._later)
            or self._unexplained_variables(finding)
            or feedback_doubt(finding, bench, len(self._round.findings))
        ):
            return words
        # Last, for unlike the others it does not refute a rival of another effect.
        return slow_disturbance_doubt(finding, self._settings)

    def _undetermined(self, finding: FoundEffect, *, alternative: bool = False) -> str:
        predicts = self._validator.predicting_fit(finding.trial.fit)
        return undetermined_by_fits(finding, predicts, self._settings, alternative=alternative)

    def _replaces_added_mass(self, finding: FoundEffect) -> str:
        """Which added mass an effect replaces, in words; empty if none."""
        bench, final = self._bench, self._validator.final
        before, after = (final(f) for f in (bench.base, finding.trial.fit))
        vehicle = bench.base.model.functions.vehicle
        values = vanished_inertia(before, after, vehicle)
        if not values:
            return ""
        known = {n: replace(vehicle.values[n], value=v, estimate=False) for n, v in values.items()}
        fits = (fitted(vehicle.with_values(known), f, bench).fit for f in ([], [finding]))
        base, with_it = (self._validator.squares_ahead(final(fit)) for fit in fits)
        return added_mass_doubt([*values], self._gain([finding], base, with_it), self._settings)

    def _unexplained_variables(self, finding: FoundEffect) -> str:
        """That an effect explains little of what depends on its variables, in words; empty if not.

        An effect that explains none of the forces is not tested by them.
        """
        bench, fit = self._bench, finding.trial.fit
        vehicles = (m.model.functions.vehicle for m in (bench.base, fit))
        variables = own_variables(finding.trial.candidate, *vehicles)
        if not variables or not self._changes_velocities(finding):
            return ""
        weak, final = (bench.base, fit), [self._validator.predicting_fit(f) for f in (bench.base, fit)]
        # Without the effect, the values with the least residual force may not be those that predict best.
        for without, with_it in (weak, final):
            share = share_of_predictable(without, with_it, bench.train, bench.test, variables)
            if share >= self._settings.own_share:
                return ""
        return (
            f"it explains only {share:.0%} of the residual that depends on its variables "
            f"({', '.join(variables)})"
        )

    def _changes_velocities(self, finding: FoundEffect) -> bool:
        """Whether an effect changes predicted velocities, and not only the pose."""
        if not finding.of_sensors:
            return True
        without, with_it = self._velocities(self._before, self._squares[finding.id])
        return PredictionGain.of(without, with_it, self._settings).helps(self._settings.worth)

    def _velocities(self, *squares: Squares) -> list[dict[float, Array]]:
        return [self._validator.velocities(s) for s in squares]

    def _dominated(self, doubts: Mapping[str, str]) -> dict[str, str]:
        """Doubts about effects that add nothing to the best one, which is in doubt itself."""

        def better(best: FoundEffect, other: FoundEffect) -> float:
            return float(self._inclusion([best, other])[0])

        established = [f for f in self._unaffected if not doubts[f.id]]
        doubted = [f for f in self._unaffected if _is_refuted(f, doubts[f.id], self._bench)]
        found: dict[str, str] = {}
        for best in reversed(doubted):  # what is said is of the best of them
            found |= dominated(best, established, better, self._gain_on_top, self._settings)
        return found

    def _gain_on_top(self, first: FoundEffect, second: FoundEffect) -> PredictionGain:
        """Improvement by a candidate in addition to another."""
        vehicle = self._bench.base.model.functions.vehicle
        both = self._squares_of([fitted(vehicle, [first, second], self._bench).fit])[0]
        return self._gain([first, second], self._squares[first.id], both)

    # --- rivals ---------------------------------------------------------------------------------------
    def _rivals_of(self, chosen: FoundEffect) -> list[FoundEffect]:
        """What does as well in place of an established effect; series that approximate it come first."""
        others = [f for f in self._found.values() if f is not chosen and self._is_sufficient(f)]
        others += self._ties(chosen, {chosen.id, *(f.id for f in others)})
        determined = [f for f in others if f.id in self._doubts and self._determined_by_predicting_fit(f)]
        doubts = self._doubts | {f.id: self._doubt(f, alternative=True) for f in determined}
        undoubted = {chosen.id, *(f.id for f in others if not doubts.get(f.id))}
        reduced = self._reduced_rivals(chosen, (f for f in self._round.findings if f.id not in undoubted))
        replaced = {f.id for f in reduced}
        doubts = {i: doubt for i, doubt in doubts.items() if i not in replaced}
        others = [*(f for f in others if f.id not in replaced), *reduced]
        asked = (f for f in others if f.id not in doubts and self._as_good_where_it_acts(f, chosen))
        doubts |= {f.id: self._doubt(f, alternative=True) for f in asked}
        series = [f for f in others if _is_series_of(chosen, f)]
        unrefuted = [f for f in others if f.id in doubts and not _is_refuted(f, doubts[f.id], self._bench)]
        rivals = [f for f in unrefuted if f not in series]
        alike = substitutes(chosen, self.gains[chosen.id], rivals, self._gain_on_top, self._settings)
        return [f for f in (*series, *alike) if not self._is_noise_in_fewer_equations(f, chosen)]

    def _is_noise_in_fewer_equations(self, finding: FoundEffect, chosen: FoundEffect) -> bool:
        """Whether an effect leaves noise alone in fewer equations than one with no more parameters."""
        if len(finding.trial.kept) < len(chosen.trial.kept):
            return False
        fits = chosen.trial.fit, finding.trial.fit
        return noise_in_more_equations(*fits, self._bench.test, self._settings)

    def _determined_by_predicting_fit(self, finding: FoundEffect) -> bool:
        """Whether only another fit than the one that predicts leaves a parameter of an effect open."""
        return bool(self._undetermined(finding)) and not self._undetermined(finding, alternative=True)

    def _ties(self, chosen: FoundEffect, known: Collection[str]) -> list[FoundEffect]:
        """Effects as good as the chosen one, although their gain may be by chance.

        They leave no more of the residual, or resamples of residual and predictions do not tell them apart.
        The chosen effect establishes that something is missing; one that is as good may be the missing one.
        """
        settings, rare = self._settings, 1.0 - self._settings.best_share
        no_worse = {f.id for f in self._round.findings if f.trial.score.error <= chosen.trial.score.error}
        others = [f for f in self._round.findings if f.id not in known]
        near = [f for f in others if f.id in no_worse or self._inclusion_by_residual([chosen, f])[1] > rare]
        near = sorted(near, key=lambda f: f.trial.score.error)[: settings.rivals]
        near = self._with_improvement(near, lambda gain: gain.helps(settings.worth) and not gain.worse)
        near = [f for f in near if f.id in no_worse or self._inclusion_by_prediction([chosen, f])[1] > rare]
        return [f for f in near if not self._other_minimum(f)]

    def _with_improvement(
        self, findings: Sequence[FoundEffect], condition: Callable[[PredictionGain], bool]
    ) -> list[FoundEffect]:
        """Those that improve predictions enough; their squared errors are kept in `_squares`."""
        found = []
        for f, squares in zip(findings, self._squares_of([f.trial.fit for f in findings]), strict=True):
            if condition(self._gain([f], self._before, squares)):
                self._squares[f.id] = squares
                found.append(f)
        return found

    def _reduced_rivals(self, chosen: FoundEffect, candidates: Iterable[FoundEffect]) -> list[FoundEffect]:
        """Effects that improve predictions with only those terms that reproduce the chosen one's force.

        Their predictions replace those with all terms.
        """
        tried = (reduced_to_same_force(f, chosen, self._bench) for f in candidates)
        least = self._settings.worth
        return self._with_improvement([f for f in tried if f is not None], lambda gain: gain.suffices(least))

    def _as_good_where_it_acts(self, finding: FoundEffect, chosen: FoundEffect) -> bool:
        """Whether an effect predicts the motions that it explains no worse than the chosen one.

        An effect with terms in all motions beats one with a term in surge by its improvement in the others,
        which is no evidence about surge.
        """
        settings = self._settings
        old, new, best = self._velocities(self._before, self._squares[finding.id], self._squares[chosen.id])
        velocities = improved_velocities(old, new, settings.worth)
        # The noise of the initial states of the windows alone changes the prediction error a little.
        allowed = (1.0 + NO_WORSE) ** 2
        pair = [{h: new[h][:, velocities] / allowed for h in old}, {h: best[h][:, velocities] for h in old}]
        return bool(velocities) and float(best_in_resamples(pair, settings)[1]) < settings.best_share


def added_mass_doubt(names: Sequence[str], held: PredictionGain, settings: Settings = DEFAULT) -> str:
    """Doubt about an effect with which added mass falls to zero, in words; empty if there is none.

    No body moves in water without added mass: such an effect may only scale forces relative to the inertia.
    Then it improves nothing with the added mass held at its value without it.

    names: parameters that fall to zero.
    held: improvement by the effect with these held.
    """
    if held.suffices(settings.worth):
        return ""
    return f"with it, {', '.join(names)} would be zero, which is unphysical for added mass"


def beyond_chance(current: Round) -> list[FoundEffect]:
    """Significant candidates, however little of the residual they explain.

    A small steady force in one equation hardly shows sample by sample, but adds up over a long simulation,
    which therefore decides how much an effect matters.
    """
    error, limit = current.bench.base_score.error, current.bench.settings.false_alarm_rate
    return [f for f in current.findings if f.p_value < limit and f.trial.score.error < error]
