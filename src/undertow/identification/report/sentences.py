"""The result in one sentence, worded by the numbers that it shows, and what to run next."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import floor, inf, isfinite, log10, prod
from pathlib import PurePath

from undertow.errors import listed
from undertow.identification.diagnosis.result import (
    NO_EVIDENCE,
    Diagnosis,
    Predictability,
    Ranked,
    Remaining,
    Step,
    established,
)
from undertow.identification.diagnosis.settings import DEFAULT
from undertow.identification.findings import Finding
from undertow.model.symbols import DOFS, VELOCITY


@dataclass(frozen=True)
class CommandLine:
    """The arguments of a command line, for the command to run next."""

    vehicle: str = "VEHICLE"  # vehicle file, or the name of a bundled one
    logs: tuple[str, ...] = ("LOG",)  # that were fitted to
    validation: tuple[str, ...] = ()  # logs for validation
    options: tuple[str, ...] = ()  # how the logs are read, such as ("--map", "log.toml")
    json_file: str = ""  # the file with the result of a diagnosis, if one is written

    def with_validation(self, words: Sequence[str], *more: str) -> str:
        """A command with the vehicle, the logs and the validation logs."""
        validation = ["--validation", *self.validation] if self.validation else []
        return self._undertow([*words, self.vehicle, *self.logs, *validation, *self.options, *more])

    def on_logs(self, words: Sequence[str], *more: str) -> str:
        """A command with the vehicle and all logs, without a distinction between them."""
        return self._undertow([*words, self.vehicle, *self.logs, *self.validation, *self.options, *more])

    def vehicle_file(self, part: str) -> str:
        """Name of a vehicle file derived from this one."""
        return f"{PurePath(self.vehicle).stem}-{part}.toml"

    def _undertow(self, words: Iterable[str]) -> str:
        return f"undertow {shlex.join(words)}"


# --- errors, and how they change --------------------------------------------------------------------
def percentage(share: float | None, digits: int = 2) -> str:
    """A share in per cent, without the unit; "diverging" where it is not finite."""
    if share is None or not isfinite(share):
        return "diverging"
    return f"{100 * share:.{_places(share, digits)}f}"


def _places(share: float, digits: int = 2) -> int:
    """Decimals with which a share in per cent has so many digits."""
    return min(max(0, digits - 1 - floor(log10(100 * share))), 6) if share > 0 else 0


def rises(before: float | None, after: float | None) -> bool:
    """Whether an error rises in the digits that are printed of it, and by more than their rounding."""
    low, high = (inf if share is None else share for share in (before, after))
    return isfinite(low) and high > low and _differ(low, high, _digits(low, high))


def both(before: float | None, after: float | None) -> tuple[str, str]:
    """Two errors in per cent, with the digits that show whether one is larger."""
    digits = _digits(*(inf if share is None else share for share in (before, after)))
    return percentage(before, digits), percentage(after, digits)


@dataclass(frozen=True)
class SentenceSettings:
    """What sentences and tables tell apart."""

    least_change: float = 0.02  # relative, of an error, that tables show and sentences must not call none
    least_probability: float = 0.002  # that a few thousand draws determine
    most_motions: int = 3  # whose residual forces the headline describes
    # Share of the residual of a motion from which a term is mentioned beside an effect that explains less.
    large_share: float = 0.5


SETTINGS = SentenceSettings()
_MAKE = "undertow effects new"


def _digits(low: float, high: float) -> int:
    """Digits of two errors that are compared: two, or three where only these show a change."""
    same = isfinite(low) and isfinite(high) and not _differ(low, high, 2)
    return 3 if same and abs(high - low) >= SETTINGS.least_change * max(low, high) else 2


def _differ(low: float, high: float, digits: int) -> bool:
    if percentage(low, digits) == percentage(high, digits):
        return False
    larger = max(low, high)
    return not isfinite(larger) or 100 * abs(high - low) >= 0.5 * 10.0 ** -_places(larger, digits)


def changes(before: Mapping[str, float], after: Mapping[str, float]) -> str:
    """How errors change, by horizon: "lowers the 5-s error from 4.0 to 1.6% and ... ".

    The arguments are errors as shares by horizon ("5 s", "free run"), without those that diverge; the free
    run is left out where there are horizons.
    """
    horizons = _horizons([before, after])
    pairs = {h: (before.get(h), after.get(h)) for h in horizons}
    parts = [
        _clause("lowers", [_from_to(h, *pair) for h, pair in pairs.items() if rises(*reversed(pair))]),
        _clause("raises", [_from_to(h, *pair) for h, pair in pairs.items() if rises(*pair)]),
        _clause("leaves", [_at(h, a) for h, (b, a) in pairs.items() if not (rises(b, a) or rises(a, b))]),
    ]
    return listed([part for part in parts if part])


def step_changes(before: Step, after: Step) -> str:
    """How the errors of predictions change from one model to another."""
    # The position error is mentioned if it improves most: a sensor error may show in nothing else.
    velocities = changes(before.ahead, after.ahead)
    of_velocities, _ = _largest_fall(before.ahead, after.ahead)
    fall, horizon = _largest_fall(before.position, after.position)
    if fall < max(DEFAULT.worth, of_velocities):
        # Where sensor noise is most of the prediction errors, a missing force shows in the residual alone.
        residual_only = not velocities.startswith("lowers") and rises(after.error, before.error)
        residual = _lowers_residual(before.error, after.error) if residual_only else ""
        return listed([part for part in (residual, velocities) if part])
    sizes = " to ".join(f"{step.position[horizon]:.2g}" for step in (before, after))
    position = f"lowers the position error over {horizon} from {sizes} m"
    parts = [velocities, position] if velocities.startswith("lowers") else [position, velocities]
    return listed([part for part in parts if part])


def _lowers_residual(before: float, after: float) -> str:
    return f"lowers the residual from {before:.3g} to {after:.3g} times the noise"


def _largest_fall(before: Mapping[str, float], after: Mapping[str, float]) -> tuple[float, str]:
    """Fall of the error over the long horizon where it is largest, as a share of it, and that horizon."""
    both = [h for h in _horizons([before]) if h in after and before[h] > 0.0]
    falls = [(1.0 - after[h] / before[h], h) for h in both[1:] or both]
    return max(falls, default=(0.0, ""))


def useless(relative: Mapping[str, float | None], examined: Sequence[Finding] = ()) -> str:
    """A sentence on velocities predicted worse than by no model at all; empty if there are none.

    `relative`: errors of predicted velocities as shares of their rms, None or infinite where they diverge. A
    model of a vehicle that never moves has 1. `examined`: findings of the doctor on the logs.
    """
    worse = {n: e for n, e in relative.items() if e is None or not e <= 1.0}
    if not worse:
        return ""
    motions = listed([DOFS[VELOCITY.index(n)] for n in worse])
    texts = [percentage(e, 3) for e in worse.values()]
    sizes = ", ".join(t if t == "diverging" else f"{t}%" for t in texts)
    advice = "first check the signs of commands and axes (undertow doctor)"
    if examined and not any(f.severity == "mistake" for f in examined):
        advice = (
            "undertow doctor finds no mistake in the logs, so check the vehicle file: thrust per command, "
            "places and directions of the thrusters, inertia; unless a controller opposed a force that is "
            "not logged, as in station keeping: no simulation with its commands alone can predict that"
        )
        if doubts := [f.clause() for f in examined if f.text.startswith("perhaps ")]:
            advice = f"undertow doctor is not sure of the logs ({'; '.join(doubts)}): try that first"
    return f"Worse than no model at all in {motions} ({sizes}): {advice}."


def significance_text(candidate: Ranked, false_alarms: float) -> str:
    """Whether a candidate is significant, and by which criterion if not by its mean improvement.

    The p-value is that of the signs of the fall in blocks of data, or of simulation; the interval is that of
    the mean, which a few blocks may dominate. `false_alarms`: the p-value below which the blocks decide.
    """
    if not candidate.significant or candidate.interval[0] > 0.0:
        return candidate.sure
    by_blocks = candidate.p_value is not None and candidate.p_value < false_alarms
    why = "in most blocks of the data, though their mean is uncertain" if by_blocks else "by simulation"
    return f"{candidate.sure}: {why}"


def chance(p_value: float | None) -> str:
    """A probability in per cent, with the digits that resampling determines; empty for none."""
    if p_value is None:
        return ""
    least = SETTINGS.least_probability
    return f"< {least:.1%}" if p_value < least else f"{p_value:.1%}"


def errors(ahead: Mapping[str, float]) -> str:
    """Errors by horizon: "a 5-s error of 1.6% and a 20-s error of 3.3%"."""
    articles = {h: "an" if re.match(r"8|1[18]\D", h) else "a" for h in _horizons([ahead])}
    return listed([f"{a} {_error(h)} of {percentage(ahead.get(h))}%" for h, a in articles.items()])


def as_stated(given: Step, after: Step, changed: str) -> str:
    """A sentence on the error with the values of the vehicle file, and whether a changed model has less."""
    # A refit may be worse on validation data than the file: an improvement on the refit alone means little.
    if not given.ahead:
        return "With the values of the vehicle file, the model diverges."
    better = any(rises(after.ahead.get(h), given.ahead[h]) for h in _horizons([given.ahead]))
    doubt = "" if better else f"; {changed}, it predicts no better"
    return f"With the values of the vehicle file, the model has {errors(given.ahead)}{doubt}."


def refit_is_worse(stated: Mapping[str, float], refitted: Mapping[str, float], times: float) -> str:
    """A sentence where a refit has `times` the error of the vehicle file over every horizon; else empty."""
    finite = {h: e for h, e in stated.items() if isfinite(e)}
    if not finite or any(refitted[h] <= times * e for h, e in finite.items()):
        return ""
    return (
        "The refitted model predicts worse on validation data than the values of the vehicle file: "
        f"{errors(finite)} as stated, {errors(refitted)} refitted. The logs differ in ways that the model "
        "cannot represent: estimate fewer parameters, state how well they are known (sigma), or fit to "
        "more runs."
    )


def _horizons(found: Iterable[Mapping[str, float]]) -> list[str]:
    names = list(dict.fromkeys(h for ahead in found for h in ahead))
    return [h for h in names if h.endswith(" s")] or names


def _error(horizon: str) -> str:
    return f"{horizon.replace(' ', '-')} error"


def _from_to(horizon: str, before: float | None, after: float | None) -> str:
    old, new = both(before, after)
    return f"{_error(horizon)} from {old} to {new}{'' if new == 'diverging' else '%'}"


def _at(horizon: str, share: float | None) -> str:
    size = percentage(share)
    return f"{_error(horizon)} {size if size == 'diverging' else f'at {size}%'}"


def _clause(verb: str, parts: Sequence[str]) -> str:
    return f"{verb} {listed([f'the {part}' for part in parts])}" if parts else ""


# --- a diagnosis ------------------------------------------------------------------------------------
def summarised(diagnosis: Diagnosis) -> Diagnosis:
    """A diagnosis whose headline begins with the result in terms of prediction errors."""
    if not diagnosis.steps:
        return diagnosis
    parts = (
        useless(diagnosis.last_step.channels, diagnosis.doctor),
        first_sentence(diagnosis).replace("%", "% of the motion", 1),
        _rest_of_headline(diagnosis.headline),
        _explains_more(diagnosis),
    )
    return diagnosis.model_copy(update={"headline": " ".join(filter(None, parts))})


def _explains_more(diagnosis: Diagnosis) -> str:
    """What the residual correlates with, where that explains more of it than effects not established do."""
    if diagnosis.verdict != "helps_prediction" or _MAKE in diagnosis.headline:
        return ""
    helping = max((c.explained for c in diagnosis.ranking if c.effect in diagnosis.helps), default=1.0)
    least = max(SETTINGS.large_share, helping)
    found = _correlations(r for r in diagnosis.remaining if _described(r)[0] > least)
    if not found:
        return ""
    return f"Other terms explain more of the residual: {listed(found)}; {_MAKE} turns that into an effect."


def _correlations(left: Iterable[Remaining]) -> list[str]:
    """What each residual force correlates with most, those farthest above the noise first."""
    ordered = sorted((r for r in left if r.depends_on or r.spectrum), key=lambda r: -r.normalised_error)
    return [_described(r)[1] for r in ordered[: SETTINGS.most_motions]]


def _described(left: Remaining) -> tuple[float, str]:
    """The largest share of a residual force that a term or a period explains, and what that is."""
    motion = left.degree_of_freedom
    found = [(d.share, f"{d.share:.0%} of it in {motion} correlates with {d.term}") for d in left.depends_on]
    if line := left.spectrum:
        found.append((line.share, f"{line.share:.0%} of it in {motion} has a period of {line.period:.3g} s"))
    return max(found, default=(0.0, ""))


def _rest_of_headline(headline: str) -> str:
    """The headline without what the first sentence contains already."""
    if headline == NO_EVIDENCE:
        return ""
    text = headline.removeprefix("Unexplained: ")
    # A headline that begins with the id of an effect keeps it as it is.
    return headline if text == headline else text[:1].upper() + text[1:]


def first_sentence(diagnosis: Diagnosis) -> str:
    """The result in terms of prediction errors on the validation data, and what can be done about it."""
    whole = any(run.role == "holdout" for run in diagnosis.runs)
    on_validation = f"on {'validation runs' if whole else 'segments of the logs that were not fitted'}"
    now = errors(diagnosis.last_step.ahead)
    refitted = f"the refitted model has {now} {on_validation}" if now else "the refitted model fails"
    change = f"{_adding(diagnosis)} {_change(diagnosis)} {on_validation}"
    helping = listed(diagnosis.helps)
    also = f"; adding {helping} as well improves predictions further, without establishing a cause"
    disturbance = "; the rest is sensor noise and a disturbance that no model of these signals can predict"
    use = disturbance if diagnosis.predictable else ", and can be used as it is"
    alike = dict.fromkeys(e for s in diagnosis.indistinguishable for e in s.effects)
    others = " or ".join(e for e in alike if e not in diagnosis.effects) or "others"
    they, them = ("it is", "it") if len(diagnosis.helps) < 2 else ("they are", "them")
    not_the_cause = f"{they} not established as the cause: use {them} to predict, not to explain."
    leaders = listed(s.effects[0] for s in diagnosis.indistinguishable)
    certain = established(diagnosis.effects, diagnosis.indistinguishable)
    same = f"the same as {leaders}" if certain else "the same"
    apart = ": record the run that tells them apart before concluding that one of them is the cause"
    if not _separable(diagnosis):
        apart = (
            ", and no run is known that would tell them apart: use any of these for prediction, but do not "
            "regard any as the cause"
        )
    sentences: dict[str, str] = {
        "adequate": f"These logs show nothing missing: {refitted}{use}{_shows_too(diagnosis)}.",
        "missing_effect": f"{change}{also if helping else ''}.",
        "indistinguishable": f"{change}, but {others} would achieve {same}, or most of it{apart}.",
        "helps_prediction": f"{change}, but {not_the_cause}",
        "not_identifiable": f"Something is missing, but these logs do not say what: {refitted}; record a run "
        "with different motions.",
    }
    unexplained = _hardly_acts(diagnosis, refitted) or _only_disturbance(diagnosis, refitted)
    unexplained = unexplained or (
        f"No effect in the catalogue explains what is missing: {refitted}; {_where_to_look(diagnosis)}."
    )
    if diagnosis.freed and diagnosis.verdict == "adequate":
        return f"{change}, and nothing else is missing."
    if diagnosis.freed and diagnosis.verdict not in sentences:
        return f"{change}. {unexplained}"
    return sentences.get(diagnosis.verdict, unexplained)


def _separable(diagnosis: Diagnosis) -> bool:
    """Whether a run can be recorded that tells every set apart, as far as is known."""
    return all(s.separable is not False for s in diagnosis.indistinguishable)


def next_command(diagnosis: Diagnosis, line: CommandLine, *, plannable: bool = True) -> str:
    """The command that follows from the first sentence, with the files of this one.

    plannable: whether a manoeuvre can be planned, with commands that move the vehicle.
    """
    doubtful = (
        diagnosis.verdict == "helps_prediction" and _MAKE in diagnosis.headline and _has_terms(diagnosis)
    )
    effects, freed = [] if doubtful else _effects_mentioned(diagnosis), diagnosis.freed
    told_apart = plannable and diagnosis.indistinguishable and _separable(diagnosis)
    if diagnosis.verdict == "indistinguishable" and told_apart:
        between = ",".join(diagnosis.indistinguishable[0].effects)
        return line.on_logs(["plan"], "--goal", "separate", "--between", between, "--out", "plan.csv")
    improved = line.vehicle_file(effects[0] if len(effects) == 1 else "better" if effects else "fitted")
    if effects and not freed:
        # By itself `add` may refuse what the search, with all candidates, found to be a small improvement.
        force = ["--force"] if _fall(diagnosis) < DEFAULT.worth else []
        return line.with_validation(["add", ",".join(effects)], "--out", improved, *force)
    if effects or freed:
        return line.with_validation(["diagnose"], "--apply", improved)
    if diagnosis.verdict == "adequate":
        return line.with_validation(["fit"], "--out", line.vehicle_file("fitted"))
    if _has_terms(diagnosis):
        make = f"{_MAKE} my_force --from "
        if line.json_file:
            return make + shlex.quote(line.json_file)
        return f"{line.with_validation(['diagnose'], '--json', 'diagnosis.json')} && {make}diagnosis.json"
    if diagnosis.verdict == "not_identifiable" and plannable:
        return line.on_logs(["plan"], "--out", "plan.csv")
    reading = tuple(o for o in line.options if o != "--trust-log")  # doctor refuses nothing
    return replace(line, options=reading).on_logs(["doctor"])


def _effects_mentioned(diagnosis: Diagnosis) -> list[str]:
    """The effects of the first sentence: those named, else those that improve predictions."""
    return diagnosis.effects or diagnosis.helps


def _adding(diagnosis: Diagnosis) -> str:
    names = listed(_effects_mentioned(diagnosis))
    if not diagnosis.freed:
        return f"Adding {names}"
    return f"Fitting {listed(diagnosis.freed)} as well" + (f" and adding {names}" if names else "")


def _change(diagnosis: Diagnosis) -> str:
    """How the effects, and changed values, affect the error."""
    return step_changes(*_without_and_with(diagnosis)) or "changes no prediction"


def _without_and_with(diagnosis: Diagnosis) -> tuple[Step, Step]:
    """The models without and with the effects of the first sentence."""
    effects = set(_effects_mentioned(diagnosis))
    plain = diagnosis.steps[0] if diagnosis.freed else [s for s in diagnosis.steps if not s.added][-1]
    return plain, [s for s in diagnosis.steps if set(s.added) <= effects][-1]


def _fall(diagnosis: Diagnosis) -> float:
    """Fall of the error over all horizons together, as a share of it."""
    before, after = (step.ahead for step in _without_and_with(diagnosis))
    ratios = [after.get(h, inf) / before[h] for h in _horizons([before]) if before[h] > 0.0]
    return 1.0 - prod(ratios) ** (1.0 / len(ratios)) if ratios else 1.0


def _has_terms(diagnosis: Diagnosis) -> bool:
    return any(r.depends_on or r.spectrum for r in diagnosis.remaining)


def _hardly_acts(diagnosis: Diagnosis, refitted: str) -> str:
    """The first sentence where an effect explains most of the residual force, but few predictions change."""
    found = (c for c in diagnosis.ranking if c.sure == "yes" and c.falls and c.share_of_error > 0.5)
    first = next((c for c in found if 0.0 <= max(c.falls.values()) < DEFAULT.worth), None)
    if first is None:
        return ""
    return (
        f"No effect in the catalogue improves predictions enough to matter: {refitted}; "
        f"{_residual_lowered(first)}, but no prediction error by more than {max(first.falls.values()):.0%}, "
        "too little to establish it: record runs in which it would act more."
    )


def _only_disturbance(diagnosis: Diagnosis, refitted: str) -> str:
    """The first sentence where the residual may be a disturbance alone, as far as these logs show."""
    found, nothing_else = diagnosis.predictable, diagnosis.headline.startswith(NO_EVIDENCE)
    if not found or any(p.significant for p in found) or _has_terms(diagnosis) or not nothing_else:
        return ""
    most, shown = max(found, key=lambda p: p.at_most), _shows_too(diagnosis)
    nothing = "improves the model, and these logs do not show if any is missing"
    return (
        f"No effect in the catalogue {'could be added' if shown else nothing}: "
        f"{refitted}{shown}; that the residual depends on the logged signals is not significant, but up to "
        f"{most.at_most:.0%} of it in {most.degree_of_freedom} may do so: record longer runs, or treat it as "
        "a disturbance."
    )


def _shows_too(diagnosis: Diagnosis) -> str:
    """A clause on the effect that the residual shows most where none was added; empty if it shows none."""
    found = (c for c in diagnosis.ranking if c.sure == "yes")
    best = max(found, key=lambda c: c.share_of_error, default=None)
    if best is None:
        return ""
    why = f": {best.not_named}" if best.not_named else ""
    return f"; {_residual_lowered(best)}, by more than chance, but is not added{why}"


def _residual_lowered(c: Ranked) -> str:
    return f"{c.effect} {_lowers_residual(c.error_before, c.error_after)}"


def _predicted(part: Predictability) -> str:
    signals = f" (from {listed(list(part.variables))})" if part.variables else ""
    return f"{part.share:.0%} of it in {part.degree_of_freedom}{signals}"


def _where_to_look(diagnosis: Diagnosis) -> str:
    above = [r for r in diagnosis.remaining if r.excess_rms > 0.0]
    worst = max(above, key=lambda r: r.normalised_error, default=None)
    if worst is None:
        return "check the logs with undertow doctor"
    place = f"the residual exceeds the noise most in {worst.degree_of_freedom}"
    if some := [p for p in diagnosis.predictable if p.significant and not _has_terms(diagnosis)]:
        motions = [_predicted(p) for p in some]
        return (
            f"{place}, and no single logged variable clearly explains it, but several together predict "
            f"{listed(motions)}: more runs may show how; undertow doctor checks the logs"
        )
    if not _has_terms(diagnosis):
        return (
            f"{place}, and no logged variable clearly explains it: more runs may show what it depends on; "
            "undertow doctor checks the logs"
        )
    terms = listed(_correlations(diagnosis.remaining))
    return f"{place}; {terms}; {_MAKE} turns that into an effect"
