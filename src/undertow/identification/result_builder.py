"""The result of a search: verdict, wording and numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from undertow.errors import UndertowError
from undertow.identification.diagnosis.splitting import repeats
from undertow.identification.estimation.fitted import Fitted, notes
from undertow.identification.estimation.weak_form import WeakFit
from undertow.identification.planning.search import suggest
from undertow.model.catalogue import Catalogue
from undertow.model.vehicle import Vehicle
from undertow.typing import Array
from undertow.version import __version__

from .diagnosis.bench import (
    Bench,
    Score,
    comparable_mean_squares,
    error_falls,
    error_of,
    noise_ratio,
    score_of,
)
from .diagnosis.candidates import possible_in
from .diagnosis.consistency import depends_on_time, kept_with, may_depend_on_time, own_variables
from .diagnosis.evidence import EffectSet, FoundEffect, fitted, too_fast_to_distinguish, with_effects
from .diagnosis.floors import noise_floors
from .diagnosis.grading import Graded, doubt_of_companion
from .diagnosis.predictability import is_disturbance, predictable
from .diagnosis.prediction_gain import PredictionGain, gain_of_effects
from .diagnosis.residual import remaining, unrelated_to
from .diagnosis.result import (
    AddedEffect,
    Diagnosis,
    Equivalent,
    Indistinguishable,
    Predictability,
    Ranked,
    Remaining,
    RunInfo,
    Step,
    share_of_excess,
)
from .diagnosis.rounds import try_all
from .diagnosis.search import Search, last_fit
from .diagnosis.selection import Selection
from .diagnosis.validation import Contender, SimulationValidator
from .diagnosis.verdict import (
    ONLY_SIMULATIONS,
    ImprovedModel,
    Judgement,
    Remainder,
    changed_values,
    compensation_warnings,
    equivalents,
    error_of_sensors,
    estimate,
    estimates,
    improved_models,
    judge,
    judge_selection,
    only_disturbance,
    share_explained,
    unique_ids,
    values_by_run,
    values_instead_of_effects,
    with_changed_values,
    with_contradiction,
    without_damping,
)
from .doctor.kinematics import Kinematics
from .report.scaffold import effect_of
from .report.sentences import refit_is_worse


class ResultBuilder:
    """The outcome of a search, evaluated under one noise model for all steps and by simulation."""

    def __init__(
        self,
        vehicle: Vehicle,
        found: Search,
        validator: SimulationValidator,
        known: Catalogue,
        selection: Selection | None = None,
    ) -> None:
        self.vehicle, self.validator, self._known = vehicle, validator, known
        self._selection = selection
        self.found = found = (validated if selection is None else _as_selected)(found, validator)
        self.bench, self.settings = found.bench, found.bench.settings
        weak = found.steps()
        # The refitted model is that of `fit` and `add`: under the noise model of a better model, the fit of
        # an incomplete one would differ.
        self.fits = [validator.final(f) for f in (found.base, *weak[1:])]
        self.simulated = [validator.squares(f) for f in self.fits]
        self.base, final = self.fits[0], self.fits[-1]
        #: The model as given, refitted: `base` where no fixed value was found to be another.
        self.given = validator.final(found.given)
        # All models are shown in units of the same noise, that of the sensors alone.
        self._whitening = final.model.whitening(self.bench.test, np.asarray(final.p))
        self._residual_is_noise = validator.residual_is_noise(weak[-1], self.bench.test)
        self._weak = weak

    @cached_property
    def judgement(self) -> Judgement:
        """The verdict with its reasons."""
        selection, left = self._selection, self._remainder
        explained = left.residual_is_noise and left.explained >= self.settings.excess_share
        if selection is not None and not (explained and selection.all_but_one_established):
            judged = self._judged(selection)
            doubted = self._contradicted(judged.effects, selection.graded)
            if doubted != selection.graded:
                self._selection = replace(selection, graded=doubted)
                judged = self._judged(self._selection)
            return judged
        return judge(self.found, self._scores(-1), self.bench.noise_level, left)

    @property
    def _remainder(self) -> Remainder:
        errors = [self._error(fit) for fit in (self.fits[0], self.fits[-1])]
        last = noise_ratio(self._weak[-1], self.bench.test)
        return Remainder(
            residual_is_noise=self._residual_is_noise,
            confirmed=not self.validator.worse_by_rank_test(self.simulated[-1], self.simulated[0]),
            nearly=bool(np.nanmax(last) < self.settings.nearly_noise),
            explained=share_of_excess(*errors) if self.found.winners else 1.0,
        )

    def _judged(self, selection: Selection) -> Judgement:
        """The judgement of a selection; what is explained is that by the effects that it names, if any."""
        scores = self._scores(len(selection.established) or -1)
        return judge_selection(self.found, scores, self.bench.noise_level, selection)

    def _scores(self, count: int) -> tuple[Score, Score]:
        """Scores without effects and with so many of them."""
        return self.bench.score(self._weak[0]), self.bench.score(self._weak[count])

    def _contradicted(self, named: Sequence[FoundEffect], graded: list[Graded]) -> list[Graded]:
        """The effects with doubts about the first named one that a force contradicts, and those after it.

        Each is evaluated in addition to those before it, which remain named whatever was found later.
        """
        for i, effect in enumerate(named):
            bench = replace(self.bench, base=self._weak[i])
            doubt = contradiction(effect, (self._weak[i], self._weak[i + 1]), bench, self.validator)
            if doubt:
                words = [doubt, *[doubt_of_companion(effect.id)] * (len(graded) - i - 1)]
                later = [replace(g, doubt=g.doubt or w) for g, w in zip(graded[i:], words, strict=True)]
                return [*graded[:i], *later]
        return graded

    @property
    def superfluous(self) -> int | None:
        """Place of an effect that is not needed for only noise to remain; None if there is none."""
        found = _superfluous(self.found, self.validator) if self._residual_is_noise else None
        return None if found is None else found[0]

    def gains(self) -> list[PredictionGain]:
        """Improvement of predictions by every added effect, from the fits of the result."""
        ahead = [self.validator.squares_ahead(fit) for fit in self.fits]
        steps = zip(pairwise(ahead), self.found.effect_set.findings, strict=True)
        return [gain_of_effects(before, after, [f], self.validator) for (before, after), f in steps]

    def gain_within_all(self, place: int) -> PredictionGain:
        """Improvement of predictions by one effect in addition to all others."""
        findings = self.found.effect_set.findings
        without = self.fits[-2]
        if place < len(findings) - 1:
            others = [f for i, f in enumerate(findings) if i != place]
            without = self.validator.final(fitted(self.found.vehicle, others, self.bench).fit)
        before, after = (self.validator.squares_ahead(fit) for fit in (without, self.fits[-1]))
        return gain_of_effects(before, after, [findings[place]], self.validator)

    def regrade(self, gains: Sequence[PredictionGain]) -> None:
        """Update the benefit of the selected effects from the fits of the result."""
        if self._selection is not None:
            graded = [replace(g, gain=new) for g, new in zip(self._selection.graded, gains, strict=True)]
            self._selection = replace(self._selection, graded=graded)

    @property
    def leaves_only_noise(self) -> bool:
        """Whether the model with the named effects, or as given if nothing is missing, leaves only noise."""
        named = bool(self.judgement.effects) or self.judgement.verdict == "adequate"
        return named and self._residual_is_noise

    @property
    def after(self) -> Fitted:
        """The fit with the named effects, or the refitted model if none is named."""
        return self.fits[len(self.judgement.effects)]

    @property
    def tried(self) -> dict[str, Fitted]:
        """The fits with the candidates of the first round that have parameters other than zero."""
        return {f.id: f.trial.fit for f in self.found.rounds[0].findings if f.trial.kept}

    @cached_property
    def _remaining(self) -> list[Remaining]:
        return remaining(self.after, self.bench.train, self.bench.test)

    @cached_property
    def _predictable(self) -> list[Predictability]:
        """How much of the remaining forces depends on logged signals, if the residual exceeds the noise."""
        if self._residual_is_noise:
            return []
        return predictable(self.after, self.bench.train, self.bench.test)

    @cached_property
    def _verdict(self) -> Judgement:
        """The judgement; where no cause is named, whether sensors contradict each other.

        If `unexplained`, also whether all that remains is a disturbance.
        """
        if self.judgement.verdict not in ("unexplained", "helps_prediction"):
            return self.judgement
        contradiction = self._contradiction
        if self.judgement.verdict == "helps_prediction":
            return with_contradiction(self.judgement, contradiction)
        if contradiction:
            return contradiction
        noise_only = {r.degree_of_freedom for r in self._remaining if not r.excess_rms}
        depends = any(r.depends_on or r.spectrum or r.between_runs for r in self._remaining)
        if depends or not is_disturbance(self._predictable, noise_only):
            return self.judgement
        return only_disturbance(self._predictable, self.judgement.share, without_damping(self.after))

    @property
    def _contradiction(self) -> Judgement | None:
        """That pose and velocities contradict each other, if one of the candidates shows it."""
        comparable = max(self.bench.test.rows) >= len(self.vehicle.dof_indices)
        if comparable and not self._sensors_disagree:
            return None
        return error_of_sensors(self._harmless, comparable, self.settings)

    @property
    def _harmless(self) -> list[FoundEffect]:
        """The candidates for the model as given, without those known to make predictions worse."""
        gains, least = {} if self._selection is None else self._selection.gains, self.settings.worth
        harmful = {i for i, gain in gains.items() if gain.harms(least)}
        return [f for f in self.found.rounds[0].findings if f.id not in harmful]

    @property
    def _sensors_disagree(self) -> bool:
        """Whether pose and velocities are further apart than noise explains.

        Whitened together with the forces, their relation has a part in what disturbs these.
        """
        runs = [*self.bench.train.runs, *self.bench.test.runs]
        relation, settings = Kinematics(runs, self.vehicle), self.settings
        return bool(relation) and relation.chance(runs, settings.equation_noise_limit) < settings.worse_chance

    def build(self, infos: list[RunInfo], seconds: float) -> Diagnosis:
        """The diagnosis."""
        equivalent = self._equivalents()
        doubts = [f"But {e.reason}: {_either(e)}. {e.separated_by}." for e in equivalent]
        doubts += self._repeated_commands() if self.judgement.effects else []
        doubts += self._nowhere_above_noise(self._remaining)
        return Diagnosis(
            undertow=__version__,
            vehicle=self.vehicle.name,
            degrees_of_freedom=list(self.vehicle.degrees_of_freedom),
            signs=self.vehicle.signs,
            runs=infos,
            verdict=self._verdict.verdict,
            headline=" ".join([self._headline(), *doubts]),
            effects=unique_ids(self.judgement.effects),
            helps=unique_ids(self.judgement.helps),
            added=self._added(),
            ranking=[self._ranked(f) for f in self._ordered_candidates()],
            steps=self._steps(),
            indistinguishable=self._sets(),
            equivalent=equivalent,
            warnings=self._warnings(equivalent),
            remaining=self._remaining,
            predictable=self._predictable,
            parameters=estimates(self.after, self.vehicle),
            by_run=values_by_run(self.after, self.vehicle),
            false_alarm_rate=self.settings.false_alarm_rate,
            noise=dict(zip(self.bench.train.names, self.bench.train.sigma.tolist(), strict=True)),
            floors=noise_floors(self.after, self.bench.train),
            seconds=seconds,
        )

    def _added(self) -> list[AddedEffect]:
        graded = [] if self._selection is None else self._selection.graded
        return [
            AddedEffect(effect=winner.id, falls=g.gain.by_horizon, doubt=g.doubt)
            for winner, g in zip(self.found.winners, graded, strict=False)
        ]

    def _headline(self) -> str:
        values = changed_values(self.vehicle, self.after, self.found.freed)
        return with_changed_values(self._verdict, values, self._residual_is_noise)

    def _equivalents(self) -> list[Equivalent]:
        model, bench = self.found.vehicle, self.bench
        if self.judgement.effects and self._residual_is_noise:
            return values_instead_of_effects(
                self.found.effect_set, model, bench, self.validator.residual_is_noise
            )
        if self.judgement.verdict != "adequate":
            return []
        return equivalents(self.vehicle, bench, possible_in(bench.train, model, self._known))

    def _nowhere_above_noise(self, left: Sequence[Remaining]) -> list[str]:
        nothing_found = self._verdict.verdict == "unexplained" and not self.found.winners
        if not nothing_found or any(r.excess_rms > 0.0 for r in left):
            return []
        return ["In no single degree of freedom does the residual force exceed its noise."]

    def _repeated_commands(self) -> list[str]:
        return [
            f"But {kept} repeats the commands of {fitted}, so that an effect fitted to this manoeuvre alone "
            "would look as good: validate on another one."
            for kept, fitted in repeats(
                self.vehicle, self.validator.train, self.validator.test, self.settings
            )
        ]

    def _sets(self) -> list[Indistinguishable]:
        """The sets, each with the manoeuvre that would tell its effects apart."""
        places = [i for i, rivals in enumerate(self.found.rivals) if rivals]
        return [
            s.model_copy(update=dict(zip(("separated_by", "separable"), self._separating(i, s), strict=True)))
            for i, s in zip(places, self.judgement.sets, strict=False)
        ]

    def _separating(self, place: int, equals: Indistinguishable) -> tuple[str, bool | None]:
        others = [f for i, f in enumerate(self.found.winners) if i != place]
        effect_sets = [self.found.effect_set, *self.found.rivals[place]]
        values = {c.findings[place].id: c.findings[place].trial.fit.values for c in effect_sets}
        try:
            return suggest(
                with_effects(self.found.vehicle, others),
                equals.effects,
                self.validator.train,
                values,
                known=self._known,
                tries=self.settings.manoeuvres,
            )
        except UndertowError as error:
            return f"No manoeuvre can be suggested: {error}", False

    def _error(self, fit: Fitted) -> float:
        """Error of a model that was chosen, in units of the noise, as `add` gives it."""
        return score_of(fit, self.bench.test, self._whitening).error

    def _normalised(self, fit: Fitted) -> float:
        """Error in units of the noise; states with unknown initial values are no advantage over others."""
        before, data = self._base_score, self.bench.test
        after = score_of(fit, data, self._whitening, before.r)
        without, with_it = map(error_of, comparable_mean_squares(before, after, data))
        return self._base_score.error * with_it / without

    @cached_property
    def _base_score(self) -> Score:
        return score_of(self.base, self.bench.test, self._whitening)

    def _steps(self) -> list[Step]:
        ids, freed = [w.id for w in self.found.winners], list(self.found.freed)
        steps = [self._step(ids[:i], fit, self.simulated[i], freed) for i, fit in enumerate(self.fits)]
        first = [self._step([], self.given, self.validator.squares(self.given))] if freed else []
        return [*first, *steps]

    def _step(self, added: list[str], fit: Fitted, squares: Array, freed: Sequence[str] = ()) -> Step:
        simulation = float(np.sqrt(np.mean(squares)))
        more = {"simulation": simulation if math.isfinite(simulation) else None, "freed": list(freed)}
        return self.validator.step(added, fit, self._error(fit)).model_copy(update=more)

    def _ordered_candidates(self) -> list[FoundEffect]:
        """The chosen effects in the order found, and the others added to the model as given.

        Those that could replace a chosen one follow it. If simulation decided, those simulated are in the
        order of their improvement of long predictions.
        """
        chosen: dict[str, FoundEffect] = {}
        for found in [*self.judgement.effects, *self.judgement.helps]:
            chosen.setdefault(found.id, found)
        alike = {i: found for i, (found, _) in self._alike.items()}
        gains = {} if self._selection is None else self._selection.gains
        falls = {i: gain.falls[max(gain.falls)] for i, gain in gains.items()}
        others = (alike.get(f.id, f) for f in self.found.rounds[0].findings if f.id not in chosen)
        last = -math.inf
        rest = sorted(
            others, key=lambda f: (f.id not in alike, not self._is_significant(f), -falls.get(f.id, last))
        )
        return [*chosen.values(), *rest]

    @cached_property
    def _alike(self) -> dict[str, tuple[FoundEffect, Fitted]]:
        """The effects that could replace a named one, as found in its place, with the model that has them."""
        sets = zip(self.found.winners, self.found.rivals, strict=True) if self.judgement.sets else ()
        return {
            c.findings[i].id: (c.findings[i], c.fit) for i, (_, rivals) in enumerate(sets) for c in rivals
        }

    def _place(self, finding: FoundEffect) -> int | None:
        """How many effects the model has once a chosen effect is in it; None for other candidates."""
        chosen = [*self.judgement.effects, *self.judgement.helps]
        return next((i for i, f in enumerate(chosen, start=1) if f is finding), None)

    def _model_for_values(self, finding: FoundEffect) -> Fitted:
        """The model that tells the values of a candidate; those of a chosen one are handed on."""
        place = self._place(finding)
        if place is not None:
            return self.fits[max(place, len(self.judgement.effects))]
        return self.validator.predicting_fit(finding.trial.fit)

    def _error_with(self, finding: FoundEffect) -> float:
        """Error with a candidate; a chosen one has that of the steps."""
        place = self._place(finding)
        if place is not None:
            return self._error(self.fits[place])
        alike = self._alike.get(finding.id)
        return self._normalised(finding.trial.fit if alike is None else alike[1])

    def _share_by(self, finding: FoundEffect) -> float:
        """Share of the excess that a candidate explains; of a chosen one, under the noise of the headline."""
        place = self._place(finding)
        if place is None:
            return finding.explained
        scores = self.bench.score(self._weak[place - 1]), self.bench.score(self._weak[place])
        return share_explained(scores, self.bench.noise_level, self.bench)

    def _ranked(self, finding: FoundEffect) -> Ranked:
        trial = finding.trial
        helps = self._is_significant(finding) or (
            bool(trial.kept) and trial.score.error < self.bench.base_score.error
        )
        fit = self._model_for_values(finding)
        names = [n for n in finding.parameters if n in fit.standard_errors] if helps and trial.kept else []
        return Ranked(
            effect=finding.id,
            family=trial.candidate.effect.family,
            about=trial.candidate.effect.about(),
            parameters=[estimate(fit, n, self.vehicle) for n in names],
            error_before=self._base_score.error,
            error_after=self._error_with(finding) if helps else self._base_score.error,
            explained=max(self._share_by(finding), 0.0),
            improvement=finding.evidence.mean,
            interval=finding.evidence.interval,
            # If nothing is missing the simulation, which decides, needs none of them.
            significant=self._is_significant(finding)
            and not finding.may_be_slow_disturbance(self.settings)
            and self.judgement.verdict != "adequate",
            p_value=max(finding.p_value, finding.slow_p_value) if helps else None,
            inclusion=finding.inclusion if math.isfinite(finding.inclusion) else None,
            not_named=self._reason(finding.id),
            falls=self._falls(finding.id),
        )

    def _is_significant(self, finding: FoundEffect) -> bool:
        """Whether a candidate is significant, by the residual alone or confirmed by simulation."""
        return finding.significant or (self._selection is not None and finding.id in self._selection.gains)

    @cached_property
    def _named(self) -> set[str]:
        """Effects that the verdict names, alone or in a set."""
        return {*unique_ids(self.judgement.effects), *(e for s in self.judgement.sets for e in s.effects)}

    def _reason(self, effect: str) -> str:
        if self._selection is None or effect in self._named:
            return ""
        doubts = {g.chosen.id: g.doubt for g in self._selection.graded if g.doubt}
        return doubts.get(effect) or self._selection.reasons.get(effect, "")

    def _falls(self, effect: str) -> dict[str, float]:
        if self._selection is None:
            return {}
        # Of an added effect as the models of the result show it, as in `added` and in the doubts about it.
        gains = self._selection.gains | {g.chosen.id: g.gain for g in self._selection.graded}
        return gains[effect].by_horizon if effect in gains else {}

    def _warnings(self, equivalent: Sequence[Equivalent]) -> list[str]:
        named = tuple(unique_ids(self.judgement.effects))
        helpers = [
            h for h in improved_models(self.found.rounds[0].findings) if self._named.issuperset(h.effects)
        ]
        if len(named) > 1:
            helpers.append(
                ImprovedModel(named, self.after.values, min((h.error for h in helpers), default=0.0))
            )
        alike = {name: e.effects for e in equivalent for name in e.parameters}
        stated, refitted = (self.validator.ahead(m)[0] for m in (self.vehicle, self.given))
        worse = refit_is_worse(stated, refitted, self.settings.notably_worse)
        return [
            *([worse] if worse else []),
            *compensation_warnings(self.vehicle, self.base, helpers, alike, self.settings),
            *(f"{line[:1].upper()}{line[1:]}." for line in notes(self.after)),
        ]


def _either(equivalent: Equivalent) -> str:
    return " or ".join(["wrong stated values", *equivalent.effects])


# --- the search as far as simulation confirms it -------------------------------------------------
def validated(found: Search, validator: SimulationValidator) -> Search:
    """The search as far as simulation confirms it.

    An effect is dropped if the model simulates the validation runs to within the noise without it. All of a
    set of equally good effects are fitted by output error, started from the weak form, and simulate the
    validation runs; the best of them leads, and is fitted once more.
    """
    return _with_last_fit(_best_of_equals(_without_superfluous(found, validator), validator))


def _as_selected(found: Search, validator: SimulationValidator) -> Search:
    """The search with what simulation selected; if only noise remains, with the rivals that do as well."""
    found = _with_last_fit(found)
    if found.winners and validator.residual_is_noise(found.effect_set.fit, found.bench.test):
        return _with_last_fit(_best_of_equals(found, validator))
    return found


def _best_of_equals(found: Search, validator: SimulationValidator) -> Search:
    """The search with the best of every set by simulation, and the others of it that do as well."""
    bench = found.bench
    for place in range(len(found.rivals)):
        if found.rivals[place]:
            equals = [found.effect_set, *found.rivals[place]]
            contenders = [_contender(found, c, place, validator) for c in equals]
            best, *others = validator.surviving(contenders)
            ids = {c.findings[place].id for c in (best, *others)}
            dropped = [c for c in equals if c.findings[place].id not in ids]
            chosen = best.findings[place]
            others += [c for c in dropped if too_fast_to_distinguish(chosen, c.findings[place], bench)]
            rivals: list[list[EffectSet]] = list(found.rivals)
            rivals[place] = others
            found = replace(found, effect_set=best, rivals=rivals)
    return found


def _contender(found: Search, effect_set: EffectSet, place: int, validator: SimulationValidator) -> Contender:
    """A set of effects for the short list, with values common to all runs unless these simulate worse.

    That values differ between runs is a finding of the weak form, which large noise biases in each run.
    """
    contender, findings = validator.contender(effect_set), list(effect_set.findings)
    common = findings[place].trial.with_common_values(found.bench)
    if common is None:
        return contender
    findings[place] = replace(findings[place], trial=common)
    simpler = validator.contender(fitted(found.vehicle, findings, found.bench))
    fits = simpler.effect_set.fit, effect_set.fit
    worse = validator.worse_by_rank_test(simpler.squares, contender.squares)
    return contender if worse or validator.significantly_worse(*fits) else simpler


def _with_last_fit(found: Search) -> Search:
    """The search with its effects fitted once more."""
    if not found.winners:
        return found
    effect_set, bench = found.effect_set, found.bench
    fit = last_fit(effect_set.fit, [f.trial.candidate for f in effect_set.findings], bench.settings)
    return replace(found, effect_set=replace(effect_set, fit=fit, score=bench.score(fit)))


def _without_superfluous(found: Search, validator: SimulationValidator) -> Search:
    """The search without effects that the simulation does not need."""
    if _unnecessary(found, validator):
        return replace(found, effect_set=fitted(found.vehicle, [], found.bench), rivals=[])
    superfluous = _superfluous(found, validator)
    if superfluous is None:
        return found
    place, shorter = superfluous
    kept = [i for i in range(len(found.winners)) if i != place]
    rivals = [[_subset(c, kept) for c in found.rivals[i]] for i in kept]
    return _without_superfluous(replace(found, effect_set=shorter, rivals=rivals), validator)


def _superfluous(found: Search, validator: SimulationValidator) -> tuple[int, EffectSet] | None:
    """Place of the first of several effects that the others do without, and those; None if all are needed.

    They leave only noise without it, and simulate as well; or predictions hardly improve by it.
    """
    winners = found.winners if len(found.winners) > 1 else []
    for place, effect in enumerate(winners):
        others = [f for f in winners if f is not effect]
        # With the parameters that the others need only without it.
        candidates, shorter = [f.trial.candidate for f in others], fitted(found.vehicle, others, found.bench)
        whole = last_fit(shorter.fit, candidates, found.bench.settings)
        complete = validator.leaves_only_noise(whole) and not validator.significantly_worse(
            whole, found.effect_set.fit
        )
        if complete or not _is_worth_adding(effect, whole, found.effect_set.fit, validator):
            return place, shorter
    return None


def _is_worth_adding(
    effect: FoundEffect, without: WeakFit, with_it: WeakFit, validator: SimulationValidator
) -> bool:
    """Whether an effect improves predictions by enough to matter.

    Where sensors are precise, errors of the weak form itself are significant and resemble small effects.
    """
    before, after = (validator.squares_ahead(validator.final(fit)) for fit in (without, with_it))
    gain = gain_of_effects(before, after, [effect], validator)
    return gain.suffices(validator.settings.worth)


def _unnecessary(found: Search, validator: SimulationValidator) -> bool:
    """Whether the model as given leaves only noise, and simulates no worse than with the effects found.

    If a motion is nearly as fast as the sampling, or there is almost no noise, the weak form has an error of
    its own that an effect can absorb.
    """
    if not found.winners or not validator.residual_is_noise(found.bench.base, found.bench.test):
        return False
    without = fitted(found.vehicle, [], found.bench)
    squares = [validator.contender(c).squares for c in (without, found.effect_set)]
    return not (
        validator.worse_by_rank_test(*squares)
        or validator.significantly_worse(without.fit, found.effect_set.fit)
    )


def _subset(effect_set: EffectSet, places: list[int]) -> EffectSet:
    return replace(effect_set, findings=tuple(effect_set.findings[i] for i in places))


# --- evidence in the forces against effects that would be named -----------------------------------
def contradiction(
    effect: FoundEffect, fits: tuple[WeakFit, WeakFit], bench: Bench, validator: SimulationValidator
) -> str:
    """Why an effect is not established as the cause, in words; empty if no force contradicts it.

    Forces carry no information about sensors.

    fits: the models without it and with it.
    """
    if effect.of_sensors:
        return ""
    without, with_it = (bench.score(f) for f in fits)
    if share_explained((without, with_it), bench.noise_level, bench) <= 0.0:
        return ONLY_SIMULATIONS
    if not error_falls(*fits, bench.test):
        return "relative to sensor noise alone, the residual is no smaller"
    return _is_proxy(effect, validator.final(fits[0]), bench, validator)


def _unrelated_to(effect: FoundEffect, left: list[Remaining], vehicle: Vehicle) -> list[Remaining]:
    """Residual forces that depend on variables other than those of an effect."""
    candidate, grown = effect.trial.candidate, effect.trial.fit.model.functions.vehicle
    own = {*own_variables(candidate, vehicle, grown)}
    own |= {"t"} if may_depend_on_time(candidate, vehicle, grown) else set()
    # A missing mass is equivalent to a fraction of the driving force.
    own |= {*vehicle.command_names} if grown.mass_matrix != vehicle.mass_matrix else set()
    return unrelated_to(own, left, vehicle, periodic=depends_on_time(candidate, vehicle, grown))


def _is_proxy(effect: FoundEffect, before: Fitted, bench: Bench, validator: SimulationValidator) -> str:
    """Whether an effect loses size or benefit to a force built from the residual; empty if not.

    It is the force that `undertow effects new` would write, from variables that the effect does not have,
    found on the training data. A mere proxy for such a force loses its size or benefit with it in the model;
    a cause keeps them.
    """
    left = _unrelated_to(effect, remaining(before, bench.train, bench.train), before.model.functions.vehicle)
    if not left:
        return ""
    template = effect_of(left, max(float(r.t[-1] - r.t[0]) for r in bench.train.runs))
    other = try_all(bench, {template.id: template}, lambda done, words: None).findings[0]
    if not other.trial.kept:
        return ""
    kept, force = kept_with(effect, other, before, bench, validator), template.about().rstrip(".")
    if kept.size < 1.0 - bench.settings.size_spread:
        lost = f"its size would drop to {max(kept.size, 0.0):.0%} of the fitted value"
    elif kept.gain < bench.settings.kept_gain:
        lost = f"predictions would improve by only {max(kept.gain, 0.0):.0%} of what it achieves alone"
    else:
        return ""
    return f"with {force} in the model, {lost} (undertow effects new turns that force into an effect)"
