"""From the search to a verdict, worded to claim no more than was shown."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf

import numpy as np

from undertow.errors import UndertowError, listed
from undertow.identification.estimation.fitted import SIGNIFICANT_T, BetweenRuns, Fitted, t_values
from undertow.identification.estimation.residual import base_name
from undertow.identification.estimation.step import (
    PRIOR_WIDTH,
    UNDETERMINED,
    bounded_step,
    bounds_of,
    prior_of,
    step_limits,
    within_limits,
)
from undertow.identification.estimation.weak_form import WeakFit
from undertow.model.parameter import Parameter, printed
from undertow.model.plausibility import check_vehicle
from undertow.model.symbols import FORCE
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .bench import Bench, Score, comparable_mean_squares
from .candidates import Candidate
from .consistency import undetermined_by_fit
from .evidence import EffectSet, FoundEffect, IsNoise, explained, fitted
from .grading import Graded, doubt_of_companion
from .result import (
    NO_EVIDENCE,
    Equivalent,
    Estimate,
    Indistinguishable,
    Predictability,
    ValuesByRun,
    Verdict,
    established,
)
from .rounds import other_values
from .search import Search
from .selection import Selection
from .settings import DEFAULT, Settings
from .trial import screen


@dataclass(frozen=True)
class Judgement:
    """The verdict with its reasons.

    verdict: one of `Verdict`.
    headline: one sentence.
    effects: the effects that are named.
    sets: effects that the data cannot tell apart.
    share: share of the excess over the noise that the added effects explain.
    helps: effects that lower the error without being established as the cause.
    """

    verdict: Verdict
    headline: str
    effects: list[FoundEffect]
    sets: list[Indistinguishable]
    share: float
    helps: list[FoundEffect] = field(default_factory=list)


@dataclass(frozen=True)
class Remainder:
    """The residual of the final model, and the evidence against it.

    residual_is_noise: whether noise explains the residual.
    confirmed: whether the model does not simulate the validation runs worse than the incomplete one.
    nearly: whether less than twice the noise remains in every equation.
    explained: share of the whole excess over sensor noise that has been removed.
    """

    residual_is_noise: bool
    confirmed: bool
    nearly: bool = False
    explained: float = 1.0


#: Doubt about effects that do not reduce the residual force: a missing force is missing at every instant, and
#: an effect that improves predictions alone compensates for errors that accumulate for another reason.
ONLY_SIMULATIONS = "it improves only the simulations; the residual force itself is no smaller"


def share_explained(scores: tuple[Score, Score], noise: Array, bench: Bench) -> float:
    """Share of the excess over noise that effects remove, from the scores without and with them."""
    return explained(*comparable_mean_squares(*scores, bench.test), noise, bench.settings)


def judge(found: Search, scores: tuple[Score, Score], noise: Array, left: Remainder) -> Judgement:
    """Decide.

    noise: (2n,), mean square that sensor noise has under that noise model.
    """
    winners, share = found.winners, share_explained(scores, noise, found.bench)
    if not winners:
        return _without_effect(left.residual_is_noise, share)
    if doubt := _doubt(share, left, found.bench.settings):
        return _unexplained(winners, share, doubt)
    count, doubts = _established(found)
    named, helping = winners[:count], winners[count:]
    return _with_effects(found, named, helping, doubts, share, left.residual_is_noise)


def judge_selection(
    found: Search, scores: tuple[Score, Score], noise: Array, selection: Selection
) -> Judgement:
    """Decide if the residual exceeds the noise: each effect by its benefit and by the doubts about it.

    scores: without effects, and with those that the selection establishes.
    """
    share = share_explained(scores, noise, found.bench)
    count = len(selection.established)
    named, helping = found.winners[:count], found.winners[count:]
    if not found.winners:
        return _without_effect(residual_is_noise=False, share=share)
    doubts = [_doubt_in_words(f, g) for f, g in zip(helping, selection.graded[count:], strict=True)]
    return _with_effects(found, named, helping, doubts, share, residual_is_noise=False)


def _established(found: Search) -> tuple[int, list[str]]:
    """How many effects come before the first that its own values refute, and the doubts about the others.

    That the residual is noise shows that a model is sufficient, not that its parts exist.
    """
    winners, settings = found.winners, found.bench.settings
    refuted = [undetermined_by_fit(f, found.effect_set.fit, settings) for f in winners]
    count = next((k for k, words in enumerate(refuted) if words), None)
    if count is None:
        return len(winners), []
    first, *later = winners[count:]
    beside = [f"{f.id}: {doubt_of_companion(first.id)}." for f in later]
    return count, [f"{first.id} is not established: {refuted[count]}.", *beside]


def _with_effects(
    found: Search,
    named: list[FoundEffect],
    helping: list[FoundEffect],
    doubts: list[str],
    share: float,
    residual_is_noise: bool,
) -> Judgement:
    """That effects are missing, or only help, with the doubts about the latter."""
    if not named:
        return Judgement("helps_prediction", " ".join(doubts), [], [], share, helping)
    sets = [s for s in _indistinguishable_sets(found) if s.effects[0] in unique_ids(named)]
    verdict: Verdict = "indistinguishable" if sets else "missing_effect"
    if any(len(s.effects) > found.bench.settings.most_equivalent for s in sets):
        verdict = "not_identifiable"
    text = " ".join([_headline(named, helping, sets, share, residual_is_noise), *doubts])
    return Judgement(verdict, text, named, sets, share, helping)


def _doubt_in_words(finding: FoundEffect, graded: Graded) -> str:
    horizon = max(graded.gain.falls, key=lambda h: graded.gain.falls[h])
    return (
        f"{finding.id} ({graded.gain.falls[horizon]:.0%} less error over {horizon:g} s) is not established: "
        f"{graded.doubt}."
    )


def _without_effect(residual_is_noise: bool, share: float) -> Judgement:
    if residual_is_noise:
        text = "Nothing is missing: the residual of the refitted model is sensor noise."
        return Judgement("adequate", text, [], [], share)
    return Judgement("unexplained", NO_EVIDENCE, [], [], share)


def only_disturbance(left: Sequence[Predictability], share: float, undamped: Sequence[str] = ()) -> Judgement:
    """That nothing is missing that the logs could show, although the residual exceeds the noise.

    `undamped`: degrees of freedom in which they determine no damping.
    """
    rest = [f"{p.disturbance_rms:.2g} {p.unit} in {p.degree_of_freedom}" for p in left if p.disturbance_rms]
    text = (
        "The residual of the refitted model correlates with none of the logged signals. "
        f"A disturbance remains: {', '.join(rest)} (rms)."
    )
    if undamped:
        text += (
            f" But these logs determine no damping in {listed(undamped)}, and would not show another missing "
            "force there either: record runs at other speeds."
        )
    return Judgement("adequate", text, [], [], share)


def without_damping(fit: Fitted) -> list[str]:
    """Degrees of freedom with damping to be estimated, none of which the logs determine.

    Where speeds hardly change, forces that cancel and a body that coasts look alike.
    """
    vehicle, t = fit.model.functions.vehicle, t_values(fit)
    damping = {p.name for e in vehicle.effects if e.family == "damping" for p in e.parameters}
    declared = {name: vehicle.declaration(base_name(name)).name for name in fit.model.free}
    certainty = {name: t[name] for name, stated in declared.items() if stated in damping}
    found = []
    for motion, i in zip(vehicle.degrees_of_freedom, vehicle.dof_indices, strict=True):
        own = [name for name in certainty if declared[name].startswith(f"{FORCE[i]}_")]
        of_all = [name for name in certainty if declared[name][:2] not in {f"{force}_" for force in FORCE}]
        if own and max(certainty[name] for name in own + of_all) < SIGNIFICANT_T:
            found.append(motion)
    return found


def error_of_sensors(
    findings: Iterable[FoundEffect], compared: bool, settings: Settings = DEFAULT
) -> Judgement | None:
    """That the sensors contradict each other, if a measurement effect is significant.

    Pose and velocities are related without a force: a discrepancy is no disturbance, even if it changes no
    predicted velocity. If only one of them was measured they are not `compared`, and a sensor error cannot be
    told from a force. An error of unknown size is no evidence.
    """
    significant = (f for f in findings if f.significant and f.of_sensors and _has_determined_parameter(f))
    own = (f for f in significant if not f.may_be_slow_disturbance(settings))
    most = max(own, key=lambda f: f.explained, default=None)
    if most is None or most.explained < settings.sensor_share:
        return None
    found = f"{most.id} removes {most.explained:.0%} of the excess over noise"
    text = (
        f"Unexplained: the sensors contradict each other. {found} in the relation of pose to velocity, which "
        "no disturbance affects, but is not established as the cause: check the logs with undertow doctor."
        if compared
        else f"Unexplained: {found}, but is not established as the cause. No measured velocity can be "
        "compared with a pose: an error of the sensor and a missing force look alike."
    )
    return Judgement("unexplained", text, [], [], most.explained)


def with_contradiction(judgement: Judgement, contradiction: Judgement | None) -> Judgement:
    """A judgement on predictions of velocity, with what is wrong with the pose beside them."""
    said = "" if contradiction is None else contradiction.headline.removeprefix("Unexplained: the sensors ")
    if contradiction is None or said == contradiction.headline:  # one of them was not measured
        return judgement
    return replace(judgement, headline=f"{judgement.headline} Besides, the sensors {said}")


def _has_determined_parameter(finding: FoundEffect) -> bool:
    """Whether any parameter of an effect is known to differ from zero."""
    fit = finding.trial.fit
    own = [n for n in fit.model.free if base_name(n) in finding.parameters]
    return any(abs(fit.values[n]) > SIGNIFICANT_T * fit.standard_errors[n] for n in own)


def _doubt(share: float, left: Remainder, settings: Settings) -> str:
    """Why nothing can be named; empty if something can.

    The weak form leaves a small residual even for the true model if a force changes quickly between samples.
    If the residual clearly exceeds the noise, it has no say: simulation decides (see `selection`).
    """
    if not left.confirmed:
        return "makes the simulation of the validation runs worse, so it is not the missing effect"
    if not (left.nearly or left.residual_is_noise):
        return "leaves a residual above the noise"
    explained, least = share, settings.named_share
    if left.residual_is_noise:  # a model just above the limit of noise falls below it by chance
        explained, least = left.explained, settings.excess_share
    if explained >= least:
        return ""
    much = f"only {explained:.0%}" if explained > 0.0 else "none"
    return f"explains {much} of the excess over noise, too little to be named as the missing effect"


def _unexplained(winners: list[FoundEffect], share: float, reason: str) -> Judgement:
    names = " and ".join(unique_ids(winners))
    text = f"Unexplained: adding {names} fits the validation data significantly better, but {reason}."
    return Judgement("unexplained", text, [], [], share)


def _headline(
    winners: list[FoundEffect],
    helping: list[FoundEffect],
    sets: list[Indistinguishable],
    share: float,
    residual_is_noise: bool,
) -> str:
    rest = _share_in_words(len(unique_ids(winners)), share)
    if residual_is_noise:
        beside = " and ".join(unique_ids(helping))
        rest = f"with {beside} as well, only noise remains" if beside else "what remains is noise"
    names = " and ".join(established(unique_ids(winners), sets))
    if not sets:
        return f"Missing: {names}; {rest}."
    choice = "; ".join(" or ".join(s.effects) for s in sets)
    certain = f"Missing: {names}. In addition, these data cannot tell" if names else "These data cannot tell"
    alike = "Each reduces the error equally" if residual_is_noise else "Each achieves at least half of that"
    return f"{certain} which is missing: {choice}. {alike}; {rest}."


def _share_in_words(count: int, share: float) -> str:
    """Change of the force residual by effects, which fits to long simulations need not reduce."""
    if share <= 0.0:
        return ONLY_SIMULATIONS
    how = "it explains" if count == 1 else "together they explain"
    return f"{how} {share:.0%} of the excess over noise"


def unique_ids(findings: list[FoundEffect]) -> list[str]:
    """Ids in order; an effect may occur twice, if a second parameter is found only with others added."""
    return list(dict.fromkeys(f.id for f in findings))


def _indistinguishable_sets(found: Search) -> list[Indistinguishable]:
    return [
        Indistinguishable(effects=[best.id, *(c.findings[i].id for c in rivals)], reason=_reason(best))
        for i, (best, rivals) in enumerate(zip(found.winners, found.rivals, strict=True))
        if rivals
    ]


def _reason(best: FoundEffect) -> str:
    return (
        "their predictions of the validation data differ by less than the noise "
        f"(the best of them lowers the mean square by {best.evidence.mean:.3g})"
    )


def estimates(fit: Fitted, stated: Vehicle) -> list[Estimate]:
    """All free parameters of a fit."""
    return [estimate(fit, name, stated) for name in fit.model.free]


def estimate(fit: Fitted, name: str, stated: Vehicle) -> Estimate:
    """One free parameter of a fit; `stated` is the vehicle as the user gave it."""
    vehicle = fit.model.functions.vehicle
    parameter = vehicle.declaration(base_name(name))
    prior, error = stated.values.get(base_name(name)), fit.standard_errors[name]
    return Estimate(
        name=name,
        effect=_effect_of(vehicle, parameter.name),
        value=printed(parameter, fit.values[name], stated.signs),
        standard_error=error if error < UNDETERMINED else None,
        unit=parameter.shown_unit,
        about=parameter.about,
        prior=None if prior is None else printed(parameter, prior.value, stated.signs),
        prior_sigma=None if prior is None else prior.sigma,
    )


def values_by_run(fit: Fitted, stated: Vehicle) -> list[ValuesByRun]:
    """Parameters with a value in every run, in the signs of the vehicle as the user gave it."""
    return [
        _by_run(t, fit.model.functions.vehicle.declaration(t.parameter), stated) for t in fit.between_runs
    ]


def _by_run(table: BetweenRuns, parameter: Parameter, stated: Vehicle) -> ValuesByRun:
    return ValuesByRun(
        parameter=table.parameter,
        unit=parameter.shown_unit,
        values={run: printed(parameter, value, stated.signs) for run, value in table.values.items()},
        standard_errors=table.standard_errors,
        mean=printed(parameter, table.mean, stated.signs),
        spread=table.spread,
        q=table.q,
        chance=table.p_value,
    )


def _effect_of(vehicle: Vehicle, name: str) -> str:
    return next(e.id for e in vehicle.all_effects if any(p.name == name for p in e.parameters))


def changed_values(stated: Vehicle, fit: Fitted, freed: Mapping[str, Sequence[str]]) -> str:
    """The fitted values compared with those of the file, in its signs; empty if there are none."""
    return ", ".join(_value_in_words(stated, fit, name, alike) for name, alike in freed.items())


def _value_in_words(stated: Vehicle, fit: Fitted, name: str, alike: Sequence[str]) -> str:
    found = estimate(fit, name, stated)
    before = "" if found.prior is None else f" where the file has {found.prior:.4g}"
    same = f" ({' or '.join(alike)} would do the same)" if alike else ""
    return f"{found}{before}{same}"


def with_changed_values(judgement: Judgement, values: str, residual_is_noise: bool) -> str:
    """The headline of a verdict with the changed values."""
    headline = judgement.headline
    if not values:
        return headline
    if judgement.verdict == "adequate" and residual_is_noise:
        return (
            "No effect is missing, but fixed values in the vehicle file do not fit the logs. With these "
            f"values, only sensor noise remains: {values}."
        )
    if residual_is_noise and judgement.effects:
        return f"{headline} In addition, fixed values in the vehicle file do not fit the logs: {values}."
    return f"{headline} Fixed values in the vehicle file were fitted as well: {values}."


def equivalents(stated: Vehicle, bench: Bench, possible: Sequence[Candidate]) -> list[Equivalent]:
    """Effects that could explain parameters that the refit moved far from their stated values."""
    moved = moved_parameters(stated, bench.base, bench.settings)
    if not moved:
        return []
    found = [c.id for c in possible if c.parameters and _restores_stated_values(c, bench, moved)]
    if not found:
        return []
    words = {"reason": _equivalents_reason(moved), "separated_by": _separated_by(list(moved))}
    return [Equivalent(parameters=list(moved), effects=found, **words)]


def values_instead_of_effects(
    effect_set: EffectSet, vehicle: Vehicle, bench: Bench, residual_is_noise: IsNoise
) -> list[Equivalent]:
    """Other values of fixed parameters that leave as small a residual as one of the named effects."""
    found = []
    for finding in effect_set.findings:
        others = [f for f in effect_set.findings if f is not finding]
        without = replace(bench, base=fitted(vehicle, others, bench).fit) if others else bench
        found += _other_values_instead_of(finding.id, without, residual_is_noise)
    return found


def _other_values_instead_of(effect: str, bench: Bench, residual_is_noise: IsNoise) -> list[Equivalent]:
    found = other_values(bench)
    if found is None or not residual_is_noise(found.fit, bench.test):
        return []
    names = ", ".join(found.alike)
    words = {
        "reason": f"other values of {names}, which are fixed in the vehicle file, would leave only noise",
        "separated_by": f"To tell them apart, determine {names} by other means (a tank test, CFD)",
    }
    return [Equivalent(parameters=list(found.alike), effects=[effect], **words)]


def moved_parameters(stated: Vehicle, fit: WeakFit, settings: Settings = DEFAULT) -> dict[str, float]:
    """Change of the parameters that a fit moved far, in standard deviations of prior and fit."""
    changes = {}
    for name in (n for n in fit.model.values.names if n in fit.model.free):
        value, prior = fit.values[name], stated.value_of(name)
        if prior.sigma is not None:
            spread = float(np.hypot(prior.sigma, fit.standard_errors[name]))
            if abs(value - prior.value) > settings.far_from_prior * spread:
                changes[name] = value - prior.value
    return changes


def _restores_stated_values(candidate: Candidate, bench: Bench, moved: dict[str, float]) -> bool:
    """Whether the effect explains the data as well, with the moved parameters near their stated values.

    Values are stated only to within their standard deviations, and the effect need not be exactly equivalent
    to the change of the parameters: stated values have full weight here, and the sum of squares may not rise.
    """
    start = screen(candidate, bench)[0].start
    model, now = start.model, start.p[list(start.model.places)]
    centre, weight = prior_of(model)
    stiffness = PRIOR_WIDTH * weight
    bounds = within_limits(bounds_of(model), now, step_limits(model))
    step = bounded_step(start.at, now, bounds, (centre, stiffness))
    off = np.abs(stiffness * (now + step - centre))
    near_stated = all(off[model.free.index(n)] < bench.settings.near_prior for n in moved)
    left = np.sum((start.at.r + start.at.J @ step) ** 2)
    return bool(near_stated and left < np.sum(bench.base.at.r**2) + bench.settings.more_than_chance)


def _equivalents_reason(moved: dict[str, float]) -> str:
    names = ", ".join(moved)
    one = len(moved) == 1
    return (
        f"{names} {'is' if one else 'are'} far from the stated value; each of these effects would explain "
        "these data as well, and either explanation leaves only noise"
    )


def _separated_by(moved: list[str]) -> str:
    return (
        f"No manoeuvre tells them apart: determine {listed(moved)} by other means (weighing, a tank test, "
        "CFD), more precisely than the stated standard deviations"
    )


@dataclass(frozen=True)
class WarningSettings:
    """What warnings say of a parameter that has moved."""

    named_others: int = 2  # effects beside the best that bring it back
    on_bound: float = 1e-6  # relative distance up to which a value is on its bound


_WARNINGS = WarningSettings()


@dataclass(frozen=True)
class ImprovedModel:
    """The model with added effects that significantly reduce the validation error.

    effects: ids of the effects.
    values: fitted values of the parameters, SNAME signs.
    error: error on validation data.
    """

    effects: tuple[str, ...]
    values: Mapping[str, float]
    error: float

    @property
    def name(self) -> str:
        """The effects in words."""
        return " and ".join(self.effects)


@dataclass(frozen=True)
class _ShiftedParameter:
    """A parameter far from its stated value, in combined standard deviations of prior and fit."""

    name: str
    value: float
    prior: float
    distance: float
    bound: float | None

    @property
    def change(self) -> float:
        return self.value - self.prior


def improved_models(findings: Iterable[FoundEffect]) -> list[ImprovedModel]:
    """Changes of the parameters by candidates of a ranking; only significant ones count."""
    found = (f for f in findings if f.significant)
    return [ImprovedModel((f.id,), f.trial.fit.values, f.trial.score.error) for f in found]


def compensation_warnings(
    vehicle: Vehicle,
    fit: Fitted,
    improved: Sequence[ImprovedModel],
    alike: Mapping[str, Sequence[str]] | None = None,
    settings: Settings = DEFAULT,
) -> list[str]:
    """Warnings for parameters that a fit moved far from their stated values, or to impossible ones."""
    least = min((h.error for h in improved), default=0.0)
    leading = [h for h in improved if h.error <= settings.warning_error_ratio * least]
    lines = [
        _warning(
            vehicle,
            shifted,
            [h for h in leading if _returns(shifted, h, settings)],
            (alike or {}).get(shifted.name, ()),
        )
        for shifted in _shifted_parameters(vehicle, fit, settings)
    ]
    return [*lines, *_impossible(vehicle, fit.vehicle)]


def _shifted_parameters(vehicle: Vehicle, fit: Fitted, settings: Settings) -> list[_ShiftedParameter]:
    errors, found = fit.standard_errors, []
    for name in fit.model.values.names:
        value = fit.values[name]
        stated, bound = vehicle.value_of(name), _bound(vehicle, name, value)
        if (
            stated.sigma is None
            and bound is None
            and not _far_by_factor(value, stated.value, settings.far_factor)
        ):
            continue
        spread = float(np.hypot(stated.sigma or 0.0, errors[name]))
        distance = abs(value - stated.value) / spread if spread > 0 else np.inf
        if distance > settings.far_from_prior:
            found.append(_ShiftedParameter(name, value, stated.value, distance, bound))
    return found


def _far_by_factor(value: float, stated: float, factor: float) -> bool:
    ratio = value / stated if stated else 1.0
    return not 1.0 / factor < ratio < factor


def _bound(vehicle: Vehicle, name: str, value: float) -> float | None:
    """The physical bound that a value lies on or beyond, or None."""
    low, high = vehicle.declaration(name).bounds
    slack = _WARNINGS.on_bound * max(abs(vehicle.value_of(name).value), abs(value))
    return low if value <= low + slack else high if value >= high - slack else None


# --- words ------------------------------------------------------------------------------------
def _warning(
    vehicle: Vehicle, shifted: _ShiftedParameter, restoring: Sequence[ImprovedModel], alike: Sequence[str]
) -> str:
    owner = _effect_of(vehicle, vehicle.declaration(shifted.name).name)
    line = f"{owner.replace('_', ' ')}: {shifted.name} {_shift_in_words(vehicle, shifted)}"
    if not restoring:
        missing = " or ".join(alike) or "something that is missing"
        return f"{line}: either the prior is wrong, or it compensates for {missing}"
    best, after = restoring[0].name, restoring[0].values[shifted.name]
    others = [h.name for h in restoring[1:] if not {*restoring[0].effects} & {*h.effects}]
    back = (
        f"{after / shifted.prior:.3g} times its prior"
        if shifted.prior
        else _printed(vehicle, shifted.name, after)
    )
    names = " or ".join([best, *others[: _WARNINGS.named_others]])
    return f"{line}: it is absorbing {names}; with {best} it returns to {back}"


def _shift_in_words(vehicle: Vehicle, shifted: _ShiftedParameter) -> str:
    far = f"{shifted.distance:.1f} standard deviations"
    prior = _printed(vehicle, shifted.name, shifted.prior)
    if shifted.bound is not None:
        return f"is at its bound {_printed(vehicle, shifted.name, shifted.bound)}, {far} from {prior}"
    if shifted.prior and vehicle.value_of(shifted.name).sigma is None:
        return (
            f"is {shifted.value / shifted.prior:.3g} times its stated value (no standard deviation is stated)"
        )
    if shifted.prior:
        return f"is {shifted.value / shifted.prior:.3g} times its prior ({far})"
    return f"is {_printed(vehicle, shifted.name, shifted.value)} with a prior of 0 ({far})"


def _printed(vehicle: Vehicle, name: str, value: float) -> str:
    """A value in the sign convention of the vehicle file."""
    return f"{printed(vehicle.declaration(name), value, vehicle.signs):.3g}"


def _returns(shifted: _ShiftedParameter, helper: ImprovedModel, settings: Settings) -> bool:
    after = helper.values.get(shifted.name)
    if after is None or abs(after - shifted.prior) >= settings.return_share * abs(shifted.change):
        return False
    # From ten times the prior to a tenth of it, or to zero, is no return.
    return not shifted.prior or _factor_off(after, shifted.prior) < _factor_off(shifted.value, shifted.prior)


def _factor_off(value: float, prior: float) -> float:
    """Factor by which a value is larger or smaller than its prior; infinite if its sign differs."""
    ratio = value / prior
    return max(ratio, 1.0 / ratio) if ratio > 0.0 else inf


def _impossible(stated: Vehicle, fitted: Vehicle) -> list[str]:
    """Impossible properties of the fitted vehicle, such as a mass matrix that is not positive definite."""
    problem = _implausibility(fitted)
    return (
        [f"the refitted vehicle is impossible: {problem}"] if problem and not _implausibility(stated) else []
    )


def _implausibility(vehicle: Vehicle) -> str:
    try:
        check_vehicle(vehicle)
    except UndertowError as error:
        return str(error)
    return ""
