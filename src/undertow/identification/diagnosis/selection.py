"""If the residual exceeds the noise: effects are added as long as they reduce the simulation error.

No model of a real vehicle reduces the residual to sensor noise. An effect can still be required to be
significant, to be the best one, to improve predictions of the validation data by enough to matter and worsen
none, and to be consistent over all runs and regimes.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import takewhile

import numpy as np

from undertow.identification.estimation.residual import base_name
from undertow.identification.estimation.weak_form import free_parameters
from undertow.model.catalogue import Catalogue
from undertow.typing import Array, Progress

from .bench import Bench
from .evidence import FoundEffect, fitted, with_effects
from .grading import Graded, Grading, Predictions, beyond_chance
from .prediction_gain import PredictionGain, gain_of_effects
from .rounds import Round, try_all
from .search import Search
from .validation import SimulationValidator

_log = logging.getLogger("undertow.diagnosis")


@dataclass(frozen=True)
class Selection:
    """Effects that were added one by one, each because it improves predictions.

    rounds: the rounds.
    reasons: why significant candidates of the first round were not chosen in it.
    gains: improvement of predictions by those of its candidates that were simulated.
    """

    graded: list[Graded]
    rounds: list[Round]
    reasons: dict[str, str]
    gains: dict[str, PredictionGain]

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

    def with_doubt(self, effect: Graded, doubt: str) -> Selection:
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


# Share of the time of a round for trying candidates by the weak form; most goes into their simulation.
_WEAK_FORM_SHARE = 0.3


def without_rivals_found_later(graded: Sequence[Graded]) -> list[Graded]:
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
        earlier = found.get(g.chosen.id)
        if earlier is not None:
            known = {r.id for r in earlier.rivals}
            g = replace(g, rivals=[r for r in g.rivals if r.id in known], doubt=earlier.doubt or g.doubt)
        found[g.chosen.id] = g
    return list(found.values())


def least_useful(gains: Sequence[PredictionGain], least: float) -> int | None:
    """Place of the effect that improves predictions least, of those that do not enough; None if all do."""
    small = [k for k, gain in enumerate(gains) if not gain.suffices(least)]
    return min(small, key=lambda k: gains[k].log_fall, default=None)


class _Selector:
    def __init__(
        self, found: Search, validator: SimulationValidator, known: Catalogue, report: Progress
    ) -> None:
        self._found, self._known, self._report_progress = found, known, report
        self._predictions = Predictions(validator, self._report_simulation)
        self._share = self._done = 0.0
        self._settings = found.bench.settings
        self._reasons: dict[str, str] = {}
        self._gains: dict[str, PredictionGain] = {}
        self._rounds = list(found.rounds)
        self._later: list[FoundEffect] = []
        self._slow: Round | None = None

    def run(self) -> Selection:
        """The effects; if the first is in doubt, it is reassessed with those found after it."""
        found = self._forward()
        self._later = [g.chosen for g in found.graded[1:]]
        if self._later and found.graded[0].doubt:
            again = self._forward()
            found = max(found, again, key=lambda s: len(s.established))
        return found

    def _forward(self) -> Selection:
        self._reasons, self._gains = {}, {}
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
        return Selection(without_rivals_found_later(kept), rounds, self._reasons, self._gains)

    def _without_superfluous(
        self, graded: list[Graded], bench: Bench, all_squares: dict[float, Array] | None = None
    ) -> list[Graded]:
        """Backward elimination: effects that are not redundant given the later ones.

        A proxy for an effect found later is redundant once that is in the model. Effects in doubt stay, since
        later ones are evaluated in addition to them. `all_squares`: squared errors with all, if known.
        """
        findings = [g.chosen for g in graded]
        removable = [i for i, g in enumerate(graded[:-1]) if not g.doubt]
        if not removable:
            return graded
        sets = [[f for f in findings if f is not findings[i]] for i in removable]
        sets += [findings] if all_squares is None else []
        ahead = self._predictions.squares_ahead([fitted(self._found.vehicle, s, bench).fit for s in sets])
        all_squares = ahead.pop() if all_squares is None else all_squares
        validator = self._predictions.validator
        gains = [gain_of_effects(squares, all_squares, findings, validator) for squares in ahead]
        place = least_useful(gains, self._settings.worth)
        if place is None:
            return graded
        weakest = graded[removable[place]]
        _log.info("redundant given the others: %s", weakest.chosen.id)
        return self._without_superfluous([g for g in graded if g is not weakest], bench, ahead[place])

    def _report(self, done: float, words: str) -> None:
        self._done = max(self._done, self._share + done / self._settings.most_effects)
        self._report_progress(self._done, words)

    def _report_weak_form(self, done: float, words: str) -> None:
        self._report(_WEAK_FORM_SHARE * done, words)

    def _report_simulation(self, done: float, words: str) -> None:
        self._report(_WEAK_FORM_SHARE + (1.0 - _WEAK_FORM_SHARE) * done, words)

    def _step(self, graded: Sequence[Graded], rounds: Sequence[Round]) -> tuple[Round, Graded | None]:
        """The next round and its best candidate.

        A noise model that includes a disturbance absorbs slow forces. If nothing at all is found, candidates
        are tried under sensor noise alone: since whole blocks of the logs are resampled, chance findings
        remain as rare as before.
        """
        current = self._round([g.chosen for g in graded], rounds)
        best = self._best(current, graded)
        if best is not None:
            return current, best
        if graded or not np.any(current.bench.base.disturbance):
            return current, self._insignificant(current, graded)
        slow = self._without_disturbance(current)
        best = self._best(slow, graded)
        if best is not None:
            return slow, best
        found = {f.id for f in beyond_chance(current)}
        additional = [f for f in beyond_chance(slow) if f.id not in found]
        known = {f.id for f in additional}
        others = [f for f in current.findings if f.id not in known]
        current = replace(current, findings=[*others[: len(found)], *additional, *others[len(found) :]])
        return current, self._insignificant(current, graded)

    def _without_disturbance(self, current: Round) -> Round:
        """The first candidates under sensor noise alone: tried once, here or in the search."""
        if self._slow is None:
            again = self._found.second_look if current is self._found.rounds[-1] else None
            bench = current.bench.without_disturbance()
            self._slow = again or try_all(bench, self._known, self._report_weak_form)
        return self._slow

    def _insignificant(self, current: Round, graded: Sequence[Graded]) -> Graded | None:
        """The best candidate for prediction among those whose force is not significant.

        A slow force is hidden by quick ones in the residual of every sample, but adds up in simulations. Each
        is the best of many candidates on the same validation data: a second one would be chosen by chance.
        """
        if not all(g.significant for g in graded):
            return None
        return Grading(current, graded, self._predictions, self._later, significant=False).best()

    def _best(self, current: Round, graded: Sequence[Graded]) -> Graded | None:
        """The best candidate of a round; of the first one, with reasons against the others."""
        grading = Grading(current, graded, self._predictions, self._later)
        best = grading.best()
        if not graded:
            self._reasons |= grading.reasons
            self._gains |= grading.net_gains
        return best

    def _round(self, chosen: Sequence[FoundEffect], rounds: Sequence[Round]) -> Round:
        """Candidates in addition to the chosen effects; an identical earlier round is reused."""
        grown = with_effects(self._found.vehicle, chosen)
        free = free_parameters(grown)
        for done in self._rounds:
            # An effect may free a parameter that the file states: names alone are then those of before.
            base = done.bench.base
            same = {base_name(n) for n in base.model.free} == {*free}
            if same and base.vehicle.parameter_names == grown.parameter_names:
                return done
        bench = rounds[-1].bench.with_model(grown, chosen[-1].trial.fit.values)
        self._rounds.append(try_all(bench, self._known, self._report_weak_form))
        return self._rounds[-1]


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
