"""If the residual exceeds the noise: effects are added as long as they reduce the simulation error.

No model of a real vehicle reduces the residual to sensor noise. An effect can still be required to be
significant, to be the best one, to improve predictions of the validation data by enough to matter and worsen
none, and to be consistent over all runs and regimes.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import takewhile

import numpy as np

from undertow.identification.estimation.output_error import NO_WORSE
from undertow.identification.estimation.weak_form import WeakFit, free_parameters
from undertow.model.catalogue import Catalogue
from undertow.typing import Array, Progress

from .bench import Bench
from .consistency import (
    SPRING,
    disagreement,
    is_spring,
    left_open,
    never_turned,
    no_step,
    own_variables,
    vanished_inertia,
)
from .evidence import (
    FoundEffect,
    as_good,
    fitted,
    in_its_place,
    inclusion,
    linear,
    reconciles_sensors,
    with_effects,
)
from .parallel import mapped
from .reference import captured
from .rounds import Round, try_all
from .search import Search
from .settings import DEFAULT, Settings
from .validation import SimulationValidator
from .worth import Worth, best_in_resamples, compared, error_ahead, explained_motions, gained

_log = logging.getLogger("undertow.diagnosis")


# --- the selection --------------------------------------------------------------------------------
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


@dataclass(frozen=True)
class Selection:
    """Effects that were added one by one, each because it improves predictions.

    rounds: the rounds.
    reasons: why significant candidates of the first round were not chosen in it.
    worth: improvement of predictions by those of its candidates that were simulated.
    """

    graded: list[Graded]
    rounds: list[Round]
    reasons: dict[str, str]
    worth: dict[str, Worth]

    def without(self, effect: Graded) -> Selection:
        """All effects but one."""
        return replace(self, graded=[g for g in self.graded if g is not effect])

    @property
    def established(self) -> list[Graded]:
        """The effects that are not in doubt."""
        return [g for g in self.graded if not g.doubt]

    @property
    def established_first(self) -> Selection:
        """The same, the effects in doubt after the others."""
        return replace(self, graded=sorted(self.graded, key=lambda g: bool(g.doubt)))

    def doubted_before(self, effect: Graded) -> str:
        """Id of the first effect in doubt that was found before one; empty for none."""
        before = takewhile(lambda g: g is not effect, self.graded)
        return next((g.chosen.id for g in before if g.doubt), "")

    def doubting(self, effect: Graded, doubt: str) -> Selection:
        """The same, with one more effect in doubt."""
        doubted = replace(effect, doubt=doubt)
        return replace(self, graded=[doubted if g is effect else g for g in self.graded])

    @property
    def all_but_one_established(self) -> bool:
        """Whether no effect was added after one in doubt."""
        return len(self.graded) - len(self.established) <= 1


def select(
    found: Search,
    validator: SimulationValidator,
    known: Catalogue,
    report: Progress = lambda done, words: None,
) -> Selection:
    """Add effects as long as predictions of the validation data improve by enough to matter."""
    return _Selector(found, validator, known, report).run()


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


_NOT_BEST = "other effects are better in nearly all resamples of the logs"


# Share of the time of a round for trying candidates by the weak form; most goes into their simulation.
_TRYING = 0.3


def rivals_beside_later(graded: Sequence[Graded]) -> list[Graded]:
    """The effects, each without rivals that stand for one found after it and needed in addition to it."""
    later: set[str] = set()
    found = []
    for g in reversed(graded):
        found.append(replace(g, rivals=[r for r in g.rivals if r.id not in later]))
        later |= {f.id for f in (g.chosen, *g.rivals)} if not g.doubt else set()
    return found[::-1]


def merged(graded: Sequence[Graded]) -> list[Graded]:
    """Every effect once, where it was found first: one that was found in two parts as it was found last.

    What does as well in place of one part only is no rival of the whole.
    """
    found: dict[str, Graded] = {}
    for g in graded:
        part = found.get(g.chosen.id)
        if part is not None:
            known = {r.id for r in part.rivals}
            g = replace(g, rivals=[r for r in g.rivals if r.id in known], doubt=part.doubt or g.doubt)
        found[g.chosen.id] = g
    return list(found.values())


class _Selector:
    def __init__(
        self, found: Search, validator: SimulationValidator, known: Catalogue, report: Progress
    ) -> None:
        self._found, self._validator, self._known, self._said = found, validator, known, report
        self._share = self._done = 0.0
        self._settings = found.bench.settings
        self._reasons: dict[str, str] = {}
        self._worth: dict[str, Worth] = {}
        self._rounds = list(found.rounds)
        self._later: list[FoundEffect] = []

    def run(self) -> Selection:
        """The effects; if the first is in doubt, it is reassessed with those found after it."""
        found = self._forward()
        self._later = [g.chosen for g in found.graded[1:]]
        if self._later and found.graded[0].doubt:
            again = self._forward()
            found = max(found, again, key=lambda s: len(s.established))
        return found

    def _forward(self) -> Selection:
        self._reasons, self._worth = {}, {}
        graded: list[Graded] = []
        rounds: list[Round] = []
        while len(graded) < self._settings.most_effects:
            self._share = len(graded) / self._settings.most_effects
            current, best = self._step(graded, rounds)
            rounds.append(current)
            if best is None:
                break
            _log.info("worth adding: %s (%s)", best.chosen.id, best.doubt or "established")
            graded.append(best)
        kept = self._without_superfluous(merged(graded), rounds[0].bench)
        return Selection(rivals_beside_later(kept), rounds, self._reasons, self._worth)

    def _without_superfluous(
        self, graded: list[Graded], bench: Bench, whole: dict[float, Array] | None = None
    ) -> list[Graded]:
        """Backward elimination: effects without those that bring nothing once later ones are in the model.

        A proxy for an effect found later brings nothing once that is in the model. Effects in doubt stay:
        later ones are evaluated in addition to them. `whole`: squares of predictions with all, if known.
        """
        findings = [g.chosen for g in graded]
        open_ = [i for i, g in enumerate(graded[:-1]) if not g.doubt]
        if not open_:
            return graded
        sets = [[f for f in findings if f is not findings[i]] for i in open_]
        sets += [findings] if whole is None else []
        ahead = self._ahead([fitted(self._found.vehicle, s, bench).fit for s in sets])
        whole = ahead.pop() if whole is None else whole
        worth = [gained(squares, whole, findings, self._validator) for squares in ahead]
        spare = [(w.gain, k) for k, w in enumerate(worth) if not w.enough(self._settings.worth)]
        if not spare:
            return graded
        _, least = min(spare)
        superfluous = graded[open_[least]]
        _log.info("redundant given the others: %s", superfluous.chosen.id)
        return self._without_superfluous([g for g in graded if g is not superfluous], bench, ahead[least])

    def _report(self, done: float, words: str) -> None:
        self._done = max(self._done, self._share + done / self._settings.most_effects)
        self._said(self._done, words)

    def _tried(self, done: float, words: str) -> None:
        self._report(_TRYING * done, words)

    def _step(self, graded: Sequence[Graded], rounds: Sequence[Round]) -> tuple[Round, Graded | None]:
        """The next round and its best candidate.

        A noise model that includes a disturbance absorbs slow forces. If nothing at all is found, candidates
        are tried under sensor noise alone: since whole blocks of the logs are resampled, chance findings
        remain as rare as before.
        """
        current = self._round([g.chosen for g in graded], rounds)
        best = self._best(current, graded)
        if best is not None or graded or not np.any(current.bench.base.disturbance):
            return current, best
        slow = try_all(current.bench.without_disturbance(), self._known, self._tried)
        best = self._best(slow, graded)
        if best is not None:
            return slow, best
        seen = {f.id for f in _beyond_chance(current)}
        more = [f for f in _beyond_chance(slow) if f.id not in seen]
        known = {f.id for f in more}
        others = [f for f in current.findings if f.id not in known]
        return replace(current, findings=[*others[: len(seen)], *more, *others[len(seen) :]]), None

    def _round(self, chosen: Sequence[FoundEffect], rounds: Sequence[Round]) -> Round:
        """Candidates in addition to the chosen effects; an identical earlier round is reused."""
        grown = with_effects(self._found.vehicle, chosen)
        for done in self._rounds:
            if done.bench.base.vehicle.parameter_names == grown.parameter_names:
                return done
        bench = rounds[-1].bench
        base = bench.fit(grown, free_parameters(grown), chosen[-1].trial.fit.values)
        self._rounds.append(try_all(replace(bench, base=base), self._known, self._tried))
        return self._rounds[-1]

    def _best(self, current: Round, graded: Sequence[Graded]) -> Graded | None:
        """The best candidate that improves predictions enough, with its rivals; an established one leads.

        After a refuted effect, or one of too many equivalents, none is established: it may compensate for
        that. A contradiction between pose and velocities is due to the sensors, whatever forces are missing.
        """
        bench, least = current.bench, self._settings.worth
        found = {f.id: f for f in self._screened(current)}
        before, *after = self._ahead([bench.base, *(f.trial.fit for f in found.values())])
        ahead = dict(zip(found, after, strict=True))
        worth = {i: gained(before, squares, [found[i]], self._validator) for i, squares in ahead.items()}
        able = [f for i, f in found.items() if worth[i].something(least)]
        springs = self._springs(able, worth)
        leading, near = self._leading([f for f in able if f.id not in springs], ahead, bench)
        worthy = [f for f in leading if worth[f.id].enough(least)]
        # What has run into a bound is not what it is called: to predict, too, others come first.
        worthy.sort(key=lambda f: bool(left_open(f, f.trial.fit, self._settings)))
        many = self._settings.most_equivalent
        doubtful = next(
            (g.chosen.id for g in graded if not _stands(g.chosen, g.doubt, bench) or len(g.rivals) >= many),
            "",
        )
        if worthy and doubtful:
            in_doubt = Graded(worthy[0], [], worth[worthy[0].id], found_beside(doubtful))
            worthy = [f for f in worthy if reconciles_sensors(f, bench)]
            if not worthy:
                return in_doubt
        doubts = {}
        for f in (*leading, *near) if worthy else ():
            forces = self._shows_in_forces(f, before, ahead[f.id])
            doubts[f.id] = self._doubt(f, bench, forces=forces)
        doubts |= self._dominated(worthy, doubts, ahead, bench)
        if not graded:
            self._worth |= worth
            doubts |= dict.fromkeys(springs, SPRING)
            reasons = {i: worth[i].lacking(least) or doubts.get(i, "") for i in found}
            shown = (f.id for f in _beyond_chance(current))
            self._reasons |= {i: reasons.get(i) or _NOT_BEST for i in shown}
        if not worthy:
            return None
        chosen = next((f for f in worthy if not doubts[f.id]), worthy[0])
        doubt = doubts[chosen.id]
        if doubt:
            return in_doubt if doubtful else Graded(chosen, [], worth[chosen.id], doubt)
        others = [f for i, f in found.items() if f is not chosen and worth[i].enough(least)]
        plain = {chosen.id, *(f.id for f in others if not doubts.get(f.id))}
        alone = self._in_its_place(chosen, current, plain, before, ahead)
        doubts = {i: doubt for i, doubt in doubts.items() if i not in {f.id for f in alone}}
        others = [f for f in others if f.id not in {f.id for f in alone}] + alone
        series = [f for f in others if _is_series_of(chosen, f)]
        for f in others:
            if f.id not in doubts and self._as_good_where_it_acts(f, chosen, before, ahead):
                forces = self._shows_in_forces(f, before, ahead[f.id])
                doubts[f.id] = self._doubt(f, bench, forces=forces)
        rivals = [f for f in others if f not in series and f.id in doubts and _stands(f, doubts[f.id], bench)]
        alike = alternatives(chosen, worth[chosen.id], rivals, self._beside(ahead, bench), self._settings)
        return Graded(chosen, [*series, *alike], worth[chosen.id], "")

    def _in_its_place(
        self,
        chosen: FoundEffect,
        current: Round,
        plain: Collection[str],
        before: Mapping[float, Array],
        ahead: dict[str, dict[float, Array]],
    ) -> list[FoundEffect]:
        """Effects that improve predictions with only those terms that reproduce the chosen one's force.

        Their predictions replace those with all terms in `ahead`.

        plain: ids of effects that need no such trial.
        """
        tried = (in_its_place(f, chosen, current.bench) for f in current.findings if f.id not in plain)
        found = [f for f in tried if f is not None]
        worthy = []
        for f, squares in zip(found, self._ahead([f.trial.fit for f in found]), strict=True):
            if gained(before, squares, [f], self._validator).enough(self._settings.worth):
                ahead[f.id] = squares
                worthy.append(f)
        return worthy

    def _as_good_where_it_acts(
        self,
        finding: FoundEffect,
        chosen: FoundEffect,
        before: Mapping[float, Array],
        ahead: Mapping[str, dict[float, Array]],
    ) -> bool:
        """Whether an effect predicts the motions that it explains no worse than the chosen one.

        An effect with terms in all motions beats one with a term in surge by its improvement in the others,
        which is no evidence about surge.
        """
        settings = self._settings
        old, new, best = (
            self._validator.velocities(s) for s in (before, ahead[finding.id], ahead[chosen.id])
        )
        own = explained_motions(old, new, settings.worth)
        # By the noise at the starts of windows alone a model predicts a little better or worse.
        allowed = (1.0 + NO_WORSE) ** 2
        pair = [{h: new[h][:, own] / allowed for h in old}, {h: best[h][:, own] for h in old}]
        return bool(own) and float(best_in_resamples(pair, settings)[1]) < settings.best_share

    def _dominated(
        self,
        worthy: Sequence[FoundEffect],
        doubts: Mapping[str, str],
        ahead: Mapping[str, dict[float, Array]],
        bench: Bench,
    ) -> dict[str, str]:
        """Doubts about effects that add nothing to the best one, which is in doubt itself."""

        def better(best: FoundEffect, other: FoundEffect) -> float:
            return float(self._often([best, other], ahead, bench)[0])

        sure, beside = [f for f in worthy if not doubts[f.id]], self._beside(ahead, bench)
        doubted = [f for f in worthy if not _stands(f, doubts[f.id], bench)]
        found: dict[str, str] = {}
        for best in reversed(doubted):  # what is said is of the best of them
            found |= dominated(best, sure, better, beside, self._settings)
        return found

    def _beside(self, ahead: Mapping[str, dict[float, Array]], bench: Bench) -> Beside:
        """Improvement by a candidate in addition to another."""
        vehicle = bench.base.model.functions.vehicle

        def worth(first: FoundEffect, then: FoundEffect) -> Worth:
            both = self._ahead([fitted(vehicle, [first, then], bench).fit])[0]
            return gained(ahead[first.id], both, [first, then], self._validator)

        return worth

    def _springs(self, findings: list[FoundEffect], worth: Mapping[str, Worth]) -> set[str]:
        """Ids of memory effects that are springs, if another candidate does at least half as much."""
        gained = {f.id: float(np.mean([*worth[f.id].falls.values()])) for f in findings}
        springs = {f.id for f in findings if is_spring(f)}
        most = max((gained[i] for i in springs), default=0.0)
        enough = any(gained[i] >= self._settings.own_share * most for i in gained.keys() - springs)
        return springs if enough else set()

    def _screened(self, current: Round) -> list[FoundEffect]:
        """The significant candidates that lead as fitted by the weak form, by simulation and by residual.

        If a record was filtered, the leader by residual may not improve predictions; if the weak form fits
        poorly, the reverse holds: the first of both orders are taken alternately.
        """
        found = _beyond_chance(current)
        most = self._settings.simulated_candidates
        if len(found) <= most:
            return found
        work = mapped(lambda i: self._validator.squares_ahead(found[i].trial.fit), len(found))
        squares = [error_ahead(compared(each, found, self._validator)) for each in work]
        by_simulation = np.argsort(np.argsort(squares, kind="stable"))
        turn = np.minimum(2 * by_simulation, 2 * np.arange(len(found)) + 1)  # they come in order of residual
        return [found[k] for k in np.argsort(turn, kind="stable")[:most]]

    def _ahead(self, fits: Sequence[WeakFit]) -> list[dict[float, Array]]:
        """How models predict velocities and pose once each is fitted like the final result, on all cores."""

        def done(count: int, of: int) -> None:
            if len(fits) > 1:  # else one of many pairs
                share = _TRYING + (1.0 - _TRYING) * count / of
                self._report(share, f"refitted and simulated candidates: {count} of {of}")

        self._validator.finish(fits, done)
        return [self._validator.squares_ahead(self._validator.final(f)[0]) for f in fits]

    def _leading(
        self, findings: list[FoundEffect], ahead: Mapping[str, dict[float, Array]], bench: Bench
    ) -> tuple[list[FoundEffect], list[FoundEffect]]:
        """The candidates of which one is the best in nearly all resamples, the best first; and others that
        the data cannot tell from it.
        """
        if not findings:
            return [], []
        often = self._often(findings, ahead, bench)
        order = np.argsort(-often, kind="stable")
        enough = int(np.searchsorted(np.cumsum(often[order]), self._settings.best_share)) + 1
        leading = [findings[k] for k in order[:enough]]
        others = [findings[k] for k in order[enough:]]
        best = leading[0].trial.score
        near = [f for f in others if as_good(best, f.trial.score, bench)]
        return leading, near[: self._settings.rivals]

    def _often(
        self, findings: Sequence[FoundEffect], ahead: Mapping[str, dict[float, Array]], bench: Bench
    ) -> Array:
        """How often each candidate is the best in resamples, shape (len(findings),).

        Resamples of the weak-form residual respond to quick forces, those of the simulation to slow ones.
        """
        by_residual = inclusion([linear(f.trial.fit, bench) for f in findings], self._settings)
        squares = [compared(ahead[f.id], findings, self._validator) for f in findings]
        return 0.5 * (by_residual + best_in_resamples(squares, self._settings))

    def _shows_in_forces(
        self, finding: FoundEffect, before: Mapping[float, Array], after: Mapping[float, Array]
    ) -> bool:
        """Whether an effect changes predicted velocities, and not only the pose."""
        if not finding.of_sensors:
            return True
        without, with_it = (self._validator.velocities(s) for s in (before, after))
        return Worth.of(without, with_it, self._settings).something(self._settings.worth)

    def _doubt(self, finding: FoundEffect, bench: Bench, *, forces: bool) -> str:
        """Why an effect is not established as the cause of what it explains; empty if it is.

        forces: whether it explains any of the forces; otherwise they carry no information about it.
        """
        if words := (
            left_open(finding, finding.trial.fit, self._settings)
            or never_turned(finding, bench)
            or no_step(finding, bench)
        ):
            return words
        if words := self._in_place_of_inertia(finding, bench):
            return words
        if words := disagreement(finding, bench, self._later):
            return words
        fit = finding.trial.fit
        vehicles = (m.model.functions.vehicle for m in (bench.base, fit))
        variables = own_variables(finding.trial.candidate, *vehicles)
        if variables and forces:
            share = captured(bench.base, fit, bench.train, bench.test, variables)
            if share < self._settings.own_share:
                on = ", ".join(variables)
                return f"it explains only {share:.0%} of the residual that depends on its variables ({on})"
        # Last, for unlike the others it does not refute a rival of another effect.
        return by_slow_disturbance(finding, self._settings)

    def _in_place_of_inertia(self, finding: FoundEffect, bench: Bench) -> str:
        """Which added mass an effect replaces, in words; empty if none."""
        before, after = (self._validator.final(f)[0] for f in (bench.base, finding.trial.fit))
        names = vanished_inertia(before, after)
        if not names:
            return ""
        vehicle = bench.base.model.functions.vehicle
        known = {n: replace(vehicle.values[n], value=before.values[n], estimate=False) for n in names}
        held = self._validator.final(fitted(vehicle.with_values(known), [finding], bench).fit)[0]
        base, with_it = (self._validator.squares_ahead(f) for f in (before, held))
        return without_inertia(names, gained(base, with_it, [finding], self._validator), self._settings)


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


def _beyond_chance(current: Round) -> list[FoundEffect]:
    """Significant candidates, however little of the residual they explain.

    A small steady force in one equation hardly shows sample by sample, but adds up over a long simulation,
    which therefore decides how much an effect matters.
    """
    error, limit = current.bench.base_score.error, current.bench.settings.false_alarm_rate
    return [f for f in current.findings if f.p_value < limit and f.trial.score.error < error]


def selected(found: Search, selection: Selection) -> Search:
    """The search with the selected effects instead of those that it found."""
    findings = [g.chosen for g in selection.graded]
    vehicle, bench = found.vehicle, selection.rounds[0].bench
    rivals = [
        [fitted(vehicle, [*findings[:i], r, *findings[i + 1 :]], bench) for r in graded.rivals]
        for i, graded in enumerate(selection.graded)
    ]
    effect_set = fitted(vehicle, findings, bench)
    return replace(found, rounds=selection.rounds, bench=bench, effect_set=effect_set, rivals=rivals)
