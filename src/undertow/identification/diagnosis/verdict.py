"""From the search to a verdict, in words that claim no more than was shown."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from undertow.errors import UndertowError
from undertow.identification.estimation.fitted import MORE_THAN_CHANCE, Fitted
from undertow.identification.estimation.step import (
    NOTHING_SAID,
    PRIOR_WIDTH,
    bounded_step,
    bounds_of,
    prior_of,
    step_limits,
    within_limits,
)
from undertow.identification.estimation.weak_form import WeakFit
from undertow.model.parameter import Parameter, printed
from undertow.model.plausibility import check_vehicle
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .candidates import Candidate
from .evidence import Chain, FoundEffect, Quiet, explained, fitted
from .result import Equivalent, Estimate, Indistinguishable, Verdict
from .rounds import other_values
from .search import Search
from .trial import Bench, Score, scout, told_apart

# An effect is named only where it (with those named before it) explains this share of what exceeds the noise:
# a wrong effect often takes half of a residual, seldom four fifths of it.
NAMED_SHARE = 0.8
# Of more effects than this that do equally well, none is in evidence.
_MANY = 4


@dataclass(frozen=True)
class Judgement:
    """The verdict with its reasons.

    Attributes
    ----------
    verdict : str
        One of `Verdict`.
    headline : str
        One sentence.
    effects : list of Finding
        The effects that are named.
    sets : list of Indistinguishable
        Effects that the data cannot tell apart.
    share : float
        Share of the excess over the noise that the added effects explain.
    """

    verdict: Verdict
    headline: str
    effects: list[FoundEffect]
    sets: list[Indistinguishable]
    share: float


@dataclass(frozen=True)
class Left:
    """What the final model leaves, and what speaks against it.

    Attributes
    ----------
    quiet : bool
        Whether the noise explains what is left.
    confirmed : bool
        Whether the model does not simulate the kept-aside runs worse than the incomplete one.
    nearly : bool
        Whether less than twice the noise is left in every equation.
    change : str
        How the size of the effect would have to change in the course of the kept-aside data, if it would.
    """

    quiet: bool
    confirmed: bool
    nearly: bool = False
    change: str = ""


def judge(found: Search, scores: tuple[Score, Score], noise: Array, left: Left) -> Judgement:
    """Decide.

    Parameters
    ----------
    found : Search
        What the search did.
    scores : (Score, Score)
        The incomplete and the final model under the final noise model.
    noise : (2n,) array
        Mean square that the noise of the sensors has under that noise model.
    left : Left
        What the final model leaves.
    """
    winners = found.winners
    share = explained(*told_apart(*scores, found.bench.test), noise)
    sets = _sets(found)
    if not winners:
        return _without_effect(left.quiet, share)
    if doubt := _doubt(winners, share, left):
        return _unexplained(winners, share, doubt)
    verdict: Verdict = "indistinguishable" if sets else "missing_effect"
    if any(len(s.effects) > _MANY for s in sets):
        verdict = "not_identifiable"
    return Judgement(verdict, _named(winners, sets, share, left.quiet), winners, sets, share)


def _without_effect(quiet: bool, share: float) -> Judgement:
    if quiet:
        text = "Nothing is missing: what the refitted model leaves is the noise of the sensors."
        return Judgement("adequate", text, [], [], share)
    text = (
        "Unexplained: the refitted model leaves more than the noise of the sensors, and for no effect "
        "of the catalogue is there enough evidence on kept-aside data."
    )
    return Judgement("unexplained", text, [], [], share)


def _doubt(winners: list[FoundEffect], share: float, left: Left) -> str:
    """Why nothing can be named, or nothing where it can.

    Where more than noise is left, a later effect may only make up for an earlier one that is wrong or poorly
    fitted: several are named together only where they explain all but very little.
    """
    if not left.confirmed:
        return "makes the simulation of the kept-aside runs worse, so it is not what is missing"
    if left.quiet:
        return ""
    if share < NAMED_SHARE:
        much = f"only {share:.0%}" if share > 0.0 else "none"
        return f"explains {much} of what exceeds the noise, too little to be named as what is missing"
    if len(unique_ids(winners)) > 1 and not left.nearly:
        return "leaves more than noise, and several effects are named only where next to nothing else is left"
    if left.change:
        return f"leaves more than noise, and {left.change} in the course of the kept-aside data"
    return ""


def _unexplained(winners: list[FoundEffect], share: float, reason: str) -> Judgement:
    names = " and ".join(unique_ids(winners))
    text = f"Unexplained: adding {names} fits the kept-aside data better by more than chance, but {reason}."
    return Judgement("unexplained", text, [], [], share)


def _named(winners: list[FoundEffect], sets: list[Indistinguishable], share: float, quiet: bool) -> str:
    open_ = {e for s in sets for e in s.effects}
    how = "it explains" if len(unique_ids(winners)) == 1 else "together they explain"
    rest = "what remains is noise" if quiet else f"{how} {share:.0%} of what exceeds the noise"
    names = " and ".join(n for n in unique_ids(winners) if n not in open_)
    if not sets:
        return f"Missing: {names}; {rest}."
    choice = "; ".join(" or ".join(s.effects) for s in sets)
    certain = f"Missing: {names}. Beside it these data cannot tell" if names else "These data cannot tell"
    return f"{certain}: {choice}. Any of them brings the error down alike; {rest}."


def unique_ids(findings: list[FoundEffect]) -> list[str]:
    """Ids in order; an effect may come twice, when a second parameter of it shows only once others are in."""
    return list(dict.fromkeys(f.id for f in findings))


def _sets(found: Search) -> list[Indistinguishable]:
    return [
        Indistinguishable(effects=[best.id, *(c.findings[i].id for c in rivals)], reason=_reason(best))
        for i, (best, rivals) in enumerate(zip(found.winners, found.rivals, strict=True))
        if rivals
    ]


def _reason(best: FoundEffect) -> str:
    return (
        "their predictions of the kept-aside data differ by less than the noise lets one see "
        f"(the best of them improves the mean square by {best.evidence.mean:.3g})"
    )


def estimates(fit: Fitted, stated: Vehicle) -> list[Estimate]:
    """All free parameters of a fit."""
    return [estimate(fit, name, stated) for name in fit.model.free]


def estimate(fit: Fitted, name: str, stated: Vehicle) -> Estimate:
    """One free parameter of a fit; `stated` is the vehicle as the user gave it."""
    vehicle = fit.model.functions.vehicle
    parameter = vehicle.declaration(name)
    prior = stated.values.get(name)
    return Estimate(
        name=name,
        effect=_owner(vehicle, parameter.name),
        value=printed(parameter, fit.values[name], stated.signs),
        standard_error=_known(fit.standard_errors[name]),
        unit=_unit(parameter),
        about=parameter.about,
        prior=None if prior is None else printed(parameter, prior.value, stated.signs),
        prior_sigma=None if prior is None else prior.sigma,
    )


def _owner(vehicle: Vehicle, name: str) -> str:
    return next(e.id for e in vehicle.all_effects if any(p.name == name for p in e.parameters))


def _unit(parameter: Parameter) -> str:
    return "" if parameter.unit == "1" else parameter.unit


def _known(standard_error: float) -> float | None:
    """A standard error, unless the data say nothing at all of the parameter."""
    return standard_error if standard_error < NOTHING_SAID else None


def changed_values(stated: Vehicle, fit: Fitted, freed: Mapping[str, Sequence[str]]) -> str:
    """The values as fitted beside those of the file, in its signs; empty where there are none.

    Parameters
    ----------
    stated : Vehicle
        The vehicle as the user gave it.
    fit : Fitted
        The fit with these values free.
    freed : mapping
        Their names, each with fixed values that would do the same in its place.
    """
    return ", ".join(_value(stated, fit, name, alike) for name, alike in freed.items())


def _value(stated: Vehicle, fit: Fitted, name: str, alike: Sequence[str]) -> str:
    found = estimate(fit, name, stated)
    error = "" if found.standard_error is None else f" ± {found.standard_error:.1g}"
    unit = f" {found.unit}" if found.unit else ""
    before = "" if found.prior is None else f" where it has {found.prior:.4g}"
    same = f" ({' or '.join(alike)} would do the same)" if alike else ""
    return f"{name} = {found.value:.4g}{error}{unit}{before}{same}"


def with_values(judgement: Judgement, values: str, quiet: bool) -> str:
    """The headline of a verdict with what is to be said of the values.

    Parameters
    ----------
    judgement : Judgement
        The verdict on effects.
    values : str
        The values, as `changed_values` tells them.
    quiet : bool
        Whether nothing but noise is left with them.
    """
    said = judgement.headline
    if not values:
        return said
    if judgement.verdict == "adequate":
        return (
            "No effect is missing, but values that the vehicle file holds fixed do not fit. With others what "
            f"is left is the noise of the sensors: {values}."
        )
    if quiet and judgement.effects:
        return f"{said} Beside it, values that the vehicle file holds fixed do not fit: {values}."
    return f"{said} Values that the vehicle file holds fixed were fitted with the rest: {values}."


# Standard deviations from which a parameter has moved away from what was stated.
_MOVED = 3.0
# ... and within which it is where it was stated.
_HOME = 2.0


def equivalents(stated: Vehicle, bench: Bench, possible: Sequence[Candidate]) -> list[Equivalent]:
    """What could stand behind parameters that the refit of the model moved far from their stated values.

    Parameters
    ----------
    stated : Vehicle
        The model with its stated values and their standard deviations.
    bench : Bench
        Data, noise model and the refitted model.
    possible : sequence of Candidate
        Effects that it lacks.

    Returns
    -------
    list of Equivalent
        One entry with all effects that do what the moved parameters do, or none.
    """
    moved = moved_parameters(stated, bench.base)
    if not moved:
        return []
    found = [c.id for c in possible if c.parameters and _brings_back(c, bench, moved)]
    if not found:
        return []
    told = {"reason": _equivalents_reason(moved), "separated_by": _separating(list(moved))}
    return [Equivalent(parameters=list(moved), effects=found, **told)]


def instead_of_effects(chain: Chain, vehicle: Vehicle, bench: Bench, quiet: Quiet) -> list[Equivalent]:
    """Other values of what the vehicle file holds fixed that leave as little as one of the effects named.

    Parameters
    ----------
    chain : Chain
        Effects with which nothing but noise is left.
    vehicle : Vehicle
        The model without them.
    bench : Bench
        Data and noise model.
    quiet : callable
        Whether a model leaves only noise of the kept-aside data.
    """
    found = []
    for finding in chain.findings:
        others = [f for f in chain.findings if f is not finding]
        without = replace(bench, base=fitted(vehicle, others, bench).fit) if others else bench
        found += _instead_of(finding.id, without, quiet)
    return found


def _instead_of(effect: str, bench: Bench, quiet: Quiet) -> list[Equivalent]:
    found = other_values(bench)
    if found is None or not quiet(found.fit, bench.test):
        return []
    names = ", ".join(found.alike)
    told = {
        "reason": f"other values of {names}, which the vehicle file holds fixed, would leave only noise, too",
        "separated_by": f"What tells them apart is to know {names} from elsewhere (a tank test, CFD)",
    }
    return [Equivalent(parameters=list(found.alike), effects=[effect], **told)]


def moved_parameters(stated: Vehicle, fit: WeakFit) -> dict[str, float]:
    """Change of the parameters that a fit moved by more than three standard deviations of prior and fit."""
    changes = {}
    for name, value in fit.values.items():
        prior = stated.value_of(name)
        if prior.sigma is not None:
            spread = float(np.hypot(prior.sigma, fit.standard_errors[name]))
            if abs(value - prior.value) > _MOVED * spread:
                changes[name] = value - prior.value
    return changes


def _brings_back(candidate: Candidate, bench: Bench, moved: dict[str, float]) -> bool:
    """Whether the data are as well explained by the effect, with all that moved near its stated value.

    Values are only stated to within their standard deviations, and the effect need not act like exactly what
    the parameters moved by: stated values have full weight here, and the sum of squares may not rise.
    """
    start = scout(candidate, bench).start
    model, now = start.model, start.p[list(start.model.places)]
    centre, weight = prior_of(model)
    stiffness = PRIOR_WIDTH * weight
    bounds = within_limits(bounds_of(model), now, step_limits(model))
    step = bounded_step(start.at, now, bounds, (centre, stiffness))
    off = np.abs(stiffness * (now + step - centre))
    home = all(off[model.free.index(n)] < _HOME for n in moved)
    left = np.sum((start.at.r + start.at.J @ step) ** 2)
    return bool(home and left < np.sum(bench.base.at.r**2) + MORE_THAN_CHANCE)


def _equivalents_reason(moved: dict[str, float]) -> str:
    names = ", ".join(moved)
    one = len(moved) == 1
    return (
        f"{names} {'is' if one else 'are'} far from what was stated; each of these effects would do the same "
        "to these data, and either explanation leaves only noise"
    )


def _separating(moved: list[str]) -> str:
    names = " and ".join([", ".join(moved[:-1]), moved[-1]] if len(moved) > 1 else moved)
    return (
        "No manoeuvre tells them apart: what does is to know "
        f"{names} from elsewhere (a weighing, a tank test, CFD) better than the standard deviations stated"
    )


# Standard deviations of prior and fit together from which a value is far from what was stated.
_FAR = 3.0
# Share of its way that a parameter must come back.
_BACK = 0.5
# Times the error of the leading candidate up to which another does as well.
_AS_GOOD = 1.05
_SHOWN_OTHERS = 2
_ON_BOUND = 1e-6
# Factor from which a value is far from one that was stated without a standard deviation.
_MANY_TIMES = 3.0


@dataclass(frozen=True)
class Relief:
    """The model with effects added that lower the kept-aside error by more than chance.

    Attributes
    ----------
    effects : tuple of str
        Ids of the effects.
    values : mapping
        Fitted values of the parameters, SNAME signs.
    error : float
        Kept-aside error.
    """

    effects: tuple[str, ...]
    values: Mapping[str, float]
    error: float

    @property
    def name(self) -> str:
        """The effects in words."""
        return " and ".join(self.effects)


@dataclass(frozen=True)
class _Pushed:
    """A parameter far from what was stated, in standard deviations of prior and fit together."""

    name: str
    value: float
    prior: float
    distance: float
    bound: float | None

    @property
    def change(self) -> float:
        return self.value - self.prior


def reliefs(findings: Iterable[FoundEffect]) -> list[Relief]:
    """What candidates of a ranking would do to the parameters; only those that are held to be there count."""
    found = (f for f in findings if f.significant)
    return [Relief((f.id,), f.trial.fit.values, f.trial.score.error) for f in found]


def absorbing(
    vehicle: Vehicle, fit: Fitted, helpers: Sequence[Relief], alike: Mapping[str, Sequence[str]] | None = None
) -> list[str]:
    """Warnings for parameters that a fit pushed far from what was stated, or to where they cannot be.

    Parameters
    ----------
    vehicle : Vehicle
        The model as the user gave it; `sigma` of its values are the stated priors.
    fit : Fitted
        The refitted model without further effects.
    helpers : sequence of Relief
        Models with effects added.
    alike : mapping, optional
        For parameters, ids of effects that the data cannot tell from what these were changed by.

    Returns
    -------
    list of str
        One line for each parameter. An effect is only named where it, or one that does as well, leads the
        ranking and the parameter comes back with it.
    """
    least = min((h.error for h in helpers), default=0.0)
    leading = [h for h in helpers if h.error <= _AS_GOOD * least]
    lines = [
        _line(vehicle, pushed, leading, (alike or {}).get(pushed.name, ()))
        for pushed in _pushed(vehicle, fit)
    ]
    return [*lines, *_impossible(vehicle, fit.vehicle)]


def _pushed(vehicle: Vehicle, fit: Fitted) -> list[_Pushed]:
    errors, found = fit.standard_errors, []
    for name, value in fit.values.items():
        stated, bound = vehicle.value_of(name), _bound(vehicle, name, value)
        if stated.sigma is None and bound is None and not _many_times(value, stated.value):
            continue
        spread = float(np.hypot(stated.sigma or 0.0, errors[name]))
        distance = abs(value - stated.value) / spread if spread > 0 else np.inf
        if distance > _FAR:
            found.append(_Pushed(name, value, stated.value, distance, bound))
    return found


def _many_times(value: float, stated: float) -> bool:
    ratio = value / stated if stated else 1.0
    return not 1.0 / _MANY_TIMES < ratio < _MANY_TIMES


def _bound(vehicle: Vehicle, name: str, value: float) -> float | None:
    """The physical bound that a value lies on or beyond, or None."""
    low, high = vehicle.declaration(name).bounds
    slack = _ON_BOUND * max(abs(vehicle.value_of(name).value), abs(value))
    return low if value <= low + slack else high if value >= high - slack else None


# --- words ------------------------------------------------------------------------------------
def _line(vehicle: Vehicle, pushed: _Pushed, leading: Sequence[Relief], alike: Sequence[str]) -> str:
    bare = vehicle.declaration(pushed.name).name
    owner = next(e.id for e in vehicle.all_effects if any(p.name == bare for p in e.parameters))
    line = f"{owner.replace('_', ' ')}: {pushed.name} {_where(vehicle, pushed)}"
    helping = [h for h in leading if _comes_back(pushed, h)]
    if not helping:
        missing = " or ".join(alike) or "something that is missing"
        return f"{line}: either the prior is wrong, or it makes up for {missing}"
    best, after = helping[0].name, helping[0].values[pushed.name]
    others = [h.name for h in helping[1:] if not {*helping[0].effects} & {*h.effects}][:_SHOWN_OTHERS]
    back = f"{after / pushed.prior:.3g} times" if pushed.prior else _number(vehicle, pushed.name, after)
    return f"{line}: it is absorbing {' or '.join([best, *others])}; with {best} it returns to {back}"


def _where(vehicle: Vehicle, pushed: _Pushed) -> str:
    far = f"{pushed.distance:.1f} standard deviations"
    prior = _number(vehicle, pushed.name, pushed.prior)
    if pushed.bound is not None:
        return f"is at its bound {_number(vehicle, pushed.name, pushed.bound)}, {far} from {prior}"
    if pushed.prior and vehicle.value_of(pushed.name).sigma is None:
        return (
            f"is {pushed.value / pushed.prior:.3g} times its stated value (no standard deviation is stated)"
        )
    if pushed.prior:
        return f"is {pushed.value / pushed.prior:.3g} times its prior ({far})"
    return f"is {_number(vehicle, pushed.name, pushed.value)} against a prior of 0 ({far})"


def _number(vehicle: Vehicle, name: str, value: float) -> str:
    """A value in the sign convention of the vehicle file."""
    return f"{printed(vehicle.declaration(name), value, vehicle.signs):.3g}"


def _comes_back(pushed: _Pushed, helper: Relief) -> bool:
    after = helper.values.get(pushed.name)
    return after is not None and abs(after - pushed.prior) < _BACK * abs(pushed.change)


def _impossible(stated: Vehicle, fitted: Vehicle) -> list[str]:
    """What the fit did that no vehicle can be, such as a mass matrix that is not positive definite."""
    complaint = _complaint(fitted)
    return [f"the refitted vehicle cannot be: {complaint}"] if complaint and not _complaint(stated) else []


def _complaint(vehicle: Vehicle) -> str:
    try:
        check_vehicle(vehicle)
    except UndertowError as error:
        return str(error)
    return ""
