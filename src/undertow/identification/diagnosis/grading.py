"""The candidates of one round: which improve predictions, which one leads, and what speaks against it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from undertow.identification.estimation.fitted import Fitted
from undertow.identification.estimation.output_error import NO_WORSE
from undertow.identification.estimation.weak_form import WeakFit
from undertow.typing import Array

from .bench import Bench, noise_in_more_equations
from .consistency import (
    SPRING,
    disagreement,
    is_spring,
    left_open,
    never_turned,
    no_step,
    own_variables,
    vanished_inertia,
    without_size,
)
from .evidence import (
    FoundEffect,
    as_good,
    fitted,
    in_its_place,
    inclusion,
    linear,
    reconciles_sensors,
)
from .parallel import mapped
from .reference import captured
from .rounds import Round
from .settings import DEFAULT, Settings
from .validation import SimulationValidator
from .worth import Worth, best_in_resamples, compared, error_ahead, explained_motions, gained


@dataclass(frozen=True)
class Graded:
    """An effect that improves predictions of the validation data.

    chosen: the effect; rivals: those that do as well in its place.
    worth: its improvement of predictions in addition to those before it.
    doubt: why it is not established as the cause; empty if it is.
    """

    chosen: FoundEffect
    rivals: list[FoundEffect]
    worth: Worth
    doubt: str


def found_beside(effect: str) -> str:
    """Doubt about an effect that may only compensate for another one in doubt."""
    return f"it was identified together with {effect}, which is not established either"


def _stands(finding: FoundEffect, doubt: str, bench: Bench) -> bool:
    """Whether there is no evidence against an effect: its force is present, whatever the cause.

    A current on a constant heading is not refuted: these logs do not contain what distinguishes it. Nor is
    an effect that may be a slow disturbance.
    """
    return not doubt or doubt in (never_turned(finding, bench), by_slow_disturbance(finding, bench.settings))


def by_slow_disturbance(finding: FoundEffect, settings: Settings = DEFAULT) -> str:
    """That an effect may be a slow disturbance, in words; empty if not."""
    if not finding.by_slow_disturbance(settings):
        return ""
    return f"a slow disturbance would score as well by chance in {finding.slow_p_value:.1%} of such logs"


def _is_series_of(finding: FoundEffect, other: FoundEffect) -> bool:
    """Whether an effect is a polynomial approximation of another: that the series fits better, as it will
    with more coefficients, is no evidence against the physics.
    """
    return other.id in finding.trial.candidate.effect.series_of


#: What the second of two effects is worth on top of the first.
Beside = Callable[[FoundEffect, FoundEffect], Worth]


def alternatives(
    chosen: FoundEffect,
    alone: Worth,
    rivals: Sequence[FoundEffect],
    beside: Beside,
    settings: Settings = DEFAULT,
) -> list[FoundEffect]:
    """The rivals that take over what the chosen effect explains: with them in the model, its gain is small.

    With others in the model it gains as much as `alone`: they explain something else.
    """
    return [r for r in rivals if beside(r, chosen).gain < settings.kept_gain * alone.gain]


def dominated(
    best: FoundEffect,
    others: Sequence[FoundEffect],
    better: Callable[[FoundEffect, FoundEffect], float],
    beside: Beside,
    settings: Settings = DEFAULT,
) -> dict[str, str]:
    """Why other effects are not established if a better one is in doubt, by their ids.

    Whatever causes the better one, an effect that adds nothing to it only compensates for that in part.

    better: fraction of the resamples in which the first of two is better.
    """
    found = {}
    for f in others:
        clearly = better(best, f) >= settings.best_share
        if clearly and not beside(best, f).enough(settings.worth):
            found[f.id] = f"{best.id}, also not established, predicts better, and this adds nothing to it"
    return found


def open_in_a_fit(
    finding: FoundEffect, predicts: Fitted, settings: Settings = DEFAULT, *, alternative: bool = False
) -> str:
    """Which parameter of an effect a fit leaves undetermined or impossible, in words; empty if none.

    No fit of an established effect may do so. An alternative to one is excluded only by the fit that
    predicts: that of the weak form may have ended in a local minimum which this one has left.
    """
    if (words := left_open(finding, predicts, settings)) or alternative:
        return words
    words = left_open(finding, finding.trial.fit, settings)
    return words and f"{words} (fitted to the residual force alone)"


_NOT_BEST = "other effects are better in nearly all resamples of the logs"
_OTHER_MINIMUM = "its fit predicts as well with it set to zero: it has only reached another local minimum"

#: Squares of the predictions of a model, by horizon.
_Squares = Mapping[float, Array]


class Predicting:
    """Predictions of the validation data by models, each fitted like the final result.

    report: progress, from 0 to 1.
    """

    def __init__(self, validator: SimulationValidator, report: Callable[[float, str], None]) -> None:
        self.validator, self._report = validator, report

    def ahead(self, fits: Sequence[WeakFit]) -> list[dict[float, Array]]:
        """Squares of the predictions of velocities and pose, for each model; on all cores."""

        def done(count: int, of: int) -> None:
            if len(fits) > 1:  # else one of many pairs
                self._report(count / of, f"refitted and simulated candidates: {count} of {of}")

        self.validator.finish(fits, done)
        return [self.validator.squares_ahead(self.validator.final(f)[0]) for f in fits]


class Grading:
    """The candidates of one round, by how the model with each of them predicts the validation data.

    graded: the effects that are in the model already.
    later: effects found after this one in an earlier pass.
    """

    def __init__(
        self,
        current: Round,
        graded: Sequence[Graded],
        predicting: Predicting,
        later: Sequence[FoundEffect] = (),
    ) -> None:
        self._round, self._graded, self._later = current, graded, later
        self._bench, self._settings = current.bench, current.bench.settings
        self._validator, self._predicted = predicting.validator, predicting.ahead
        self._found = {f.id: f for f in self._screened()}
        fits = [self._bench.base, *(f.trial.fit for f in self._found.values())]
        self._before, *after = self._predicted(fits)
        self._ahead: dict[str, dict[float, Array]] = dict(zip(self._found, after, strict=True))
        self.worth = {i: self._gained([f], self._before, self._ahead[i]) for i, f in self._found.items()}
        self._needless: dict[str, bool] = {}

    def best(self) -> Graded | None:
        """The best candidate that improves predictions enough, with its rivals; an established one leads.

        After a refuted effect, or one of too many equivalents, none is established: it may compensate for
        that. A contradiction between pose and velocities is due to the sensors, whatever forces are missing.
        """
        if not self._worthy:
            return None
        chosen = next((f for f in self._unaffected if not self._doubts[f.id]), None)
        if chosen is not None:
            return Graded(chosen, self._rivals_of(chosen), self.worth[chosen.id], "")
        first = self._worthy[0]
        doubt = found_beside(self._doubtful) if self._doubtful else self._doubts[first.id]
        return Graded(first, [], self.worth[first.id], doubt)

    @property
    def reasons(self) -> dict[str, str]:
        """Why significant candidates were not chosen, by their ids."""
        doubts = self._doubts | dict.fromkeys(self._springs, SPRING)
        known = {
            i: worth.lacking(self._settings.worth) or doubts.get(i) or self._other_minimum(self._found[i])
            for i, worth in self.worth.items()
        }
        return {f.id: known.get(f.id) or _NOT_BEST for f in beyond_chance(self._round)}

    # --- which improve predictions, and which one leads -----------------------------------------------
    def _screened(self) -> list[FoundEffect]:
        """The significant candidates that lead as fitted by the weak form, by simulation and by residual.

        If a record was filtered, the leader by residual may not improve predictions; if the weak form fits
        poorly, the reverse holds: the first of both orders are taken alternately.
        """
        found = beyond_chance(self._round)
        most = self._settings.simulated_candidates
        if len(found) <= most:
            return found
        work = mapped(lambda i: self._validator.squares_ahead(found[i].trial.fit), len(found))
        squares = [error_ahead(compared(each, found, self._validator)) for each in work]
        by_simulation = np.argsort(np.argsort(squares, kind="stable"))
        turn = np.minimum(2 * by_simulation, 2 * np.arange(len(found)) + 1)  # they come in order of residual
        return [found[k] for k in np.argsort(turn, kind="stable")[:most]]

    def _gained(self, findings: Sequence[FoundEffect], before: _Squares, after: _Squares) -> Worth:
        return gained(before, after, findings, self._validator)

    def _is_enough(self, finding: FoundEffect) -> bool:
        return self.worth[finding.id].enough(self._settings.worth) and not self._other_minimum(finding)

    def _other_minimum(self, finding: FoundEffect) -> str:
        """That the fit predicts as well with the effect set to zero, in words; empty if not."""
        if finding.id not in self._needless:
            self._needless[finding.id] = self._predicts_without(finding)
        return _OTHER_MINIMUM if self._needless[finding.id] else ""

    def _predicts_without(self, finding: FoundEffect) -> bool:
        without = without_size(finding, self._validator.judged_fit(finding.trial.fit))
        if without is None:
            return False
        squares = self._validator.squares_ahead(without)
        return not self._gained([finding], squares, self._ahead[finding.id]).something(self._settings.worth)

    @cached_property
    def _able(self) -> list[FoundEffect]:
        """Those that improve predictions over any horizon by enough to matter."""
        return [f for i, f in self._found.items() if self.worth[i].something(self._settings.worth)]

    @cached_property
    def _springs(self) -> set[str]:
        """Ids of memory effects that are springs, if another candidate does at least half as much."""
        fall = {f.id: float(np.mean([*self.worth[f.id].falls.values()])) for f in self._able}
        springs = {f.id for f in self._able if is_spring(f)}
        most = max((fall[i] for i in springs), default=0.0)
        enough = any(fall[i] >= self._settings.own_share * most for i in fall.keys() - springs)
        return springs if enough else set()

    @cached_property
    def _leading(self) -> tuple[list[FoundEffect], list[FoundEffect]]:
        """The candidates of which one is the best in nearly all resamples, the best first; and others that
        the data cannot tell from it.
        """
        findings = [f for f in self._able if f.id not in self._springs]
        if not findings:
            return [], []
        often = self._often(findings)
        order = np.argsort(-often, kind="stable")
        enough = int(np.searchsorted(np.cumsum(often[order]), self._settings.best_share)) + 1
        leading = [findings[k] for k in order[:enough]]
        others = [findings[k] for k in order[enough:]]
        best = leading[0].trial.score
        near = [f for f in others if as_good(best, f.trial.score, self._bench)]
        return leading, near[: self._settings.rivals]

    def _often(self, findings: Sequence[FoundEffect]) -> Array:
        """How often each candidate is the best in resamples, shape (len(findings),).

        Resamples of the weak-form residual respond to quick forces, those of the simulation to slow ones.
        """
        return 0.5 * (self._by_residual(findings) + self._by_prediction(findings))

    def _by_residual(self, findings: Sequence[FoundEffect]) -> Array:
        return inclusion([linear(f.trial.fit, self._bench) for f in findings], self._settings)

    def _by_prediction(self, findings: Sequence[FoundEffect]) -> Array:
        squares = [compared(self._ahead[f.id], findings, self._validator) for f in findings]
        return best_in_resamples(squares, self._settings)

    @cached_property
    def _worthy(self) -> list[FoundEffect]:
        """The leading ones that improve predictions enough.

        What has run into a bound is not what it is called: to predict, too, others come first.
        """
        worthy = filter(self._is_enough, self._leading[0])
        return sorted(worthy, key=lambda f: bool(self._left_open(f)))

    @cached_property
    def _doubtful(self) -> str:
        """Id of the first effect in the model that is refuted or has too many equivalents; empty for none."""
        many = self._settings.most_equivalent
        refuted = (
            g.chosen.id
            for g in self._graded
            if not _stands(g.chosen, g.doubt, self._bench) or len(g.rivals) >= many
        )
        return next(refuted, "")

    @cached_property
    def _unaffected(self) -> list[FoundEffect]:
        """Those of them that a refuted effect in the model leaves as they are."""
        return [f for f in self._worthy if not self._doubtful or reconciles_sensors(f, self._bench)]

    # --- what speaks against them ---------------------------------------------------------------------
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
            self._left_open(finding, alternative=alternative)
            or never_turned(finding, bench)
            or no_step(finding, bench)
            or self._in_place_of_inertia(finding)
            or disagreement(finding, bench, self._later)
            or self._not_by_own_variables(finding)
        ):
            return words
        # Last, for unlike the others it does not refute a rival of another effect.
        return by_slow_disturbance(finding, self._settings)

    def _left_open(self, finding: FoundEffect, *, alternative: bool = False) -> str:
        predicts = self._validator.judged_fit(finding.trial.fit)
        return open_in_a_fit(finding, predicts, self._settings, alternative=alternative)

    def _in_place_of_inertia(self, finding: FoundEffect) -> str:
        """Which added mass an effect replaces, in words; empty if none."""
        bench, final = self._bench, self._validator.final
        before, after = (final(f)[0] for f in (bench.base, finding.trial.fit))
        names = vanished_inertia(before, after)
        if not names:
            return ""
        vehicle = bench.base.model.functions.vehicle
        known = {n: replace(vehicle.values[n], value=before.values[n], estimate=False) for n in names}
        held = final(fitted(vehicle.with_values(known), [finding], bench).fit)[0]
        base, with_it = (self._validator.squares_ahead(f) for f in (before, held))
        return without_inertia(names, self._gained([finding], base, with_it), self._settings)

    def _not_by_own_variables(self, finding: FoundEffect) -> str:
        """That an effect explains little of what depends on its variables, in words; empty if not.

        What explains none of the forces is not judged by them.
        """
        bench, fit = self._bench, finding.trial.fit
        vehicles = (m.model.functions.vehicle for m in (bench.base, fit))
        variables = own_variables(finding.trial.candidate, *vehicles)
        if not variables or not self._shows_in_forces(finding):
            return ""
        share = captured(bench.base, fit, bench.train, bench.test, variables)
        if share >= self._settings.own_share:
            return ""
        return (
            f"it explains only {share:.0%} of the residual that depends on its variables "
            f"({', '.join(variables)})"
        )

    def _shows_in_forces(self, finding: FoundEffect) -> bool:
        """Whether an effect changes predicted velocities, and not only the pose."""
        if not finding.of_sensors:
            return True
        without, with_it = self._velocities(self._before, self._ahead[finding.id])
        return Worth.of(without, with_it, self._settings).something(self._settings.worth)

    def _velocities(self, *squares: _Squares) -> list[dict[float, Array]]:
        return [self._validator.velocities(s) for s in squares]

    def _dominated(self, doubts: Mapping[str, str]) -> dict[str, str]:
        """Doubts about effects that add nothing to the best one, which is in doubt itself."""

        def better(best: FoundEffect, other: FoundEffect) -> float:
            return float(self._often([best, other])[0])

        sure = [f for f in self._unaffected if not doubts[f.id]]
        doubted = [f for f in self._unaffected if not _stands(f, doubts[f.id], self._bench)]
        found: dict[str, str] = {}
        for best in reversed(doubted):  # what is said is of the best of them
            found |= dominated(best, sure, better, self._beside, self._settings)
        return found

    def _beside(self, first: FoundEffect, then: FoundEffect) -> Worth:
        """Improvement by a candidate in addition to another."""
        vehicle = self._bench.base.model.functions.vehicle
        both = self._predicted([fitted(vehicle, [first, then], self._bench).fit])[0]
        return self._gained([first, then], self._ahead[first.id], both)

    # --- what does as well in its place ---------------------------------------------------------------
    def _rivals_of(self, chosen: FoundEffect) -> list[FoundEffect]:
        """What does as well in place of an established effect; series that approximate it come first."""
        others = [f for f in self._found.values() if f is not chosen and self._is_enough(f)]
        others += self._ties(chosen, {chosen.id, *(f.id for f in others)})
        closed = [f for f in others if f.id in self._doubts and self._closed_where_it_predicts(f)]
        doubts = self._doubts | {f.id: self._doubt(f, alternative=True) for f in closed}
        plain = {chosen.id, *(f.id for f in others if not doubts.get(f.id))}
        in_part = self._in_its_place(chosen, (f for f in self._round.findings if f.id not in plain))
        replaced = {f.id for f in in_part}
        doubts = {i: doubt for i, doubt in doubts.items() if i not in replaced}
        others = [*(f for f in others if f.id not in replaced), *in_part]
        asked = (f for f in others if f.id not in doubts and self._as_good_where_it_acts(f, chosen))
        doubts |= {f.id: self._doubt(f, alternative=True) for f in asked}
        series = [f for f in others if _is_series_of(chosen, f)]
        standing = [f for f in others if f.id in doubts and _stands(f, doubts[f.id], self._bench)]
        rivals = [f for f in standing if f not in series]
        alike = alternatives(chosen, self.worth[chosen.id], rivals, self._beside, self._settings)
        return [f for f in (*series, *alike) if not self._leaves_more(f, chosen)]

    def _leaves_more(self, finding: FoundEffect, chosen: FoundEffect) -> bool:
        """Whether an effect leaves noise alone in fewer equations than one with no more parameters."""
        if len(finding.trial.kept) < len(chosen.trial.kept):
            return False
        fits = chosen.trial.fit, finding.trial.fit
        return noise_in_more_equations(*fits, self._bench.test, self._settings)

    def _closed_where_it_predicts(self, finding: FoundEffect) -> bool:
        """Whether only another fit than the one that predicts leaves a parameter of an effect open."""
        return bool(self._left_open(finding)) and not self._left_open(finding, alternative=True)

    def _ties(self, chosen: FoundEffect, known: Collection[str]) -> list[FoundEffect]:
        """Effects as good as the chosen one, although their gain may be by chance.

        They leave no more of the residual, or resamples of residual and predictions do not tell them apart.
        That something is missing is established by the chosen one; what does as well may be what is missing.
        """
        settings, rare = self._settings, 1.0 - self._settings.best_share
        no_worse = {f.id for f in self._round.findings if f.trial.score.error <= chosen.trial.score.error}
        others = [f for f in self._round.findings if f.id not in known]
        near = [f for f in others if f.id in no_worse or self._by_residual([chosen, f])[1] > rare]
        near = sorted(near, key=lambda f: f.trial.score.error)[: settings.rivals]
        near = self._improving(near, lambda worth: worth.something(settings.worth) and not worth.worse)
        near = [f for f in near if f.id in no_worse or self._by_prediction([chosen, f])[1] > rare]
        return [f for f in near if not self._other_minimum(f)]

    def _improving(
        self, findings: Sequence[FoundEffect], enough: Callable[[Worth], bool]
    ) -> list[FoundEffect]:
        """Those that improve predictions enough; what they predict is in `_ahead` from then on."""
        found = []
        for f, squares in zip(findings, self._predicted([f.trial.fit for f in findings]), strict=True):
            if enough(self._gained([f], self._before, squares)):
                self._ahead[f.id] = squares
                found.append(f)
        return found

    def _in_its_place(self, chosen: FoundEffect, candidates: Iterable[FoundEffect]) -> list[FoundEffect]:
        """Effects that improve predictions with only those terms that reproduce the chosen one's force.

        Their predictions replace those with all terms.
        """
        tried = (in_its_place(f, chosen, self._bench) for f in candidates)
        least = self._settings.worth
        return self._improving([f for f in tried if f is not None], lambda worth: worth.enough(least))

    def _as_good_where_it_acts(self, finding: FoundEffect, chosen: FoundEffect) -> bool:
        """Whether an effect predicts the motions that it explains no worse than the chosen one.

        An effect with terms in all motions beats one with a term in surge by its improvement in the others,
        which is no evidence about surge.
        """
        settings = self._settings
        old, new, best = self._velocities(self._before, self._ahead[finding.id], self._ahead[chosen.id])
        own = explained_motions(old, new, settings.worth)
        # By the noise at the starts of windows alone a model predicts a little better or worse.
        allowed = (1.0 + NO_WORSE) ** 2
        pair = [{h: new[h][:, own] / allowed for h in old}, {h: best[h][:, own] for h in old}]
        return bool(own) and float(best_in_resamples(pair, settings)[1]) < settings.best_share


def without_inertia(names: Sequence[str], held: Worth, settings: Settings = DEFAULT) -> str:
    """Doubt about an effect with which added mass falls to zero, in words; empty if there is none.

    No body moves in water without added mass: such an effect may only scale forces relative to the inertia.
    Then it brings nothing with the added mass held at its value without it.

    names: parameters that fall to zero.
    held: improvement by the effect with these held.
    """
    if held.enough(settings.worth):
        return ""
    return f"with it, {', '.join(names)} would be zero, which is unphysical for added mass"


def beyond_chance(current: Round) -> list[FoundEffect]:
    """Significant candidates, however little of the residual they explain.

    A small steady force in one equation hardly shows sample by sample, but adds up over a long simulation,
    which therefore decides how much an effect matters.
    """
    error, limit = current.bench.base_score.error, current.bench.settings.false_alarm_rate
    return [f for f in current.findings if f.p_value < limit and f.trial.score.error < error]
