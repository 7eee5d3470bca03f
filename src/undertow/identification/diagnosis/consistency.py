"""Whether an effect is consistent: the same everywhere in the logs, and determined by them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
import sympy as sm
from scipy.stats import chi2, norm

from undertow.identification.estimation.data import WeakData, inverse_of
from undertow.identification.estimation.fitted import Fitted, heterogeneity
from undertow.identification.estimation.pointwise import added_mass_at_zero_frequency
from undertow.identification.estimation.residual import base_name
from undertow.identification.estimation.step import at_bounds
from undertow.model.effect import Flow, Measurement, Parameter
from undertow.model.symbols import MOTION_UNITS
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Flags, Index

from .bench import Bench
from .candidates import Candidate
from .evidence import FoundEffect, fitted
from .prediction_gain import PredictionGain, best_in_resamples, compared_channels, gain_of_effects
from .settings import DEFAULT, Settings
from .validation import SimulationValidator


# --- whether its size is the same everywhere ------------------------------------------------------
@dataclass(frozen=True)
class SizeByPart:
    """Size of an effect in parts of the logs, in units of the fitted one.

    division: kind of parts: runs, parts of a run, levels of a signal.
    value, error: (k,), size in every part, and its standard error, robust to correlation within blocks.
    """

    division: str
    value: Array
    error: Array

    @property
    def spread(self) -> float:
        """Standard deviation between the parts beyond that of chance."""
        return heterogeneity(self.value, self.error**2)[1]

    def absent(self, settings: Settings = DEFAULT, among: int = 1) -> Flags:
        """Whether the effect is absent from a part: zero is possible there, and half its size is not.

        Sizes scatter if a law is approximate; a zero is not scatter.
        """
        margin = norm.isf(settings.comparison_level / (among * len(self.value))) * self.error
        return (self.value - margin <= 0.0) & (self.value + margin < 1.0 - settings.size_spread)

    def doubt(self, settings: Settings = DEFAULT, among: int = 1) -> str:
        """How the parts disagree, in words; empty if they agree, given the number of divisions tested."""
        q, _ = heterogeneity(self.value, self.error**2)
        by_chance = among * chi2.sf(q, len(self.value) - 1) > settings.comparison_level
        differs = self.spread >= settings.size_spread or self.absent(settings, among).any()
        if by_chance or not differs:
            return ""
        low, high = self.value.min(), self.value.max()
        return (
            f"its size would have to vary from {low:.0%} to {high:.0%} of the fitted value between "
            f"{self.division}"
        )


def sizes_by_part(finding: FoundEffect, bench: Bench) -> list[SizeByPart]:
    """Size of an effect by run, by time within the runs, and by the level of every signal, over all logs."""
    pairs = [(bench.base.at.r, bench.train), (bench.base_score.r, bench.test)]
    fit = finding.trial.fit
    after = [bench.on_train(fit).r, finding.trial.score.r]
    change = np.concatenate([a - r for a, (r, _) in zip(after, pairs, strict=True)])
    before = np.concatenate([r for r, _ in pairs])
    block = _unique_numbers([data.block for _, data in pairs])
    kinds = {
        "runs": _unique_numbers([data.run_of for _, data in pairs]),
        "parts of a run": np.concatenate([_part_of_run(data, bench.settings) for _, data in pairs]),
    }
    kinds |= {
        f"levels of {name}": _quantile_level(np.concatenate(values), bench.settings)
        for name, values in _signals([data for _, data in pairs]).items()
    }
    found = [_size_by_part(name, before, change, part, block, bench.settings) for name, part in kinds.items()]
    return [a for a in found if len(a.value) > 1]


def size_inconsistency(finding: FoundEffect, bench: Bench, later: Sequence[FoundEffect] = ()) -> str:
    """How the size of an effect differs between parts of the logs, in words; empty if it does not.

    Other missing effects shift it: an effect is consistent if it is so with later effects in the model.
    """
    words = _inconsistency(finding, bench)
    vehicle = bench.base.model.functions.vehicle
    present = {e.id for e in vehicle.effects} | {finding.id}
    others = [f for f in later if f.id not in present]
    if not words or not others:
        return words
    without, both = (fitted(vehicle, more, bench) for more in (others, [finding, *others]))
    grown = replace(finding, trial=replace(finding.trial, fit=both.fit, score=both.score))
    return _inconsistency(grown, replace(bench, base=without.fit))


def _inconsistency(finding: FoundEffect, bench: Bench) -> str:
    parts = sizes_by_part(finding, bench)
    if not parts:
        return "no single part of the logs determines its size"
    return next(filter(None, (a.doubt(bench.settings, len(parts)) for a in parts)), "")


def _size_by_part(
    division: str, before: Array, change: Array, part: Index, block: Index, settings: Settings
) -> SizeByPart:
    """Sizes by part: the fraction of the change that minimises the residual there."""
    power = np.bincount(part, change**2)
    size = -np.bincount(part, before * change) / np.maximum(power, 1e-300)
    score = (before + size[part] * change) * change
    table = np.zeros((int(part.max()) + 1, int(block.max()) + 1))
    np.add.at(table, (part, block), score)
    error = np.sqrt(np.maximum(np.sum(table**2, axis=1), power)) / np.maximum(power, 1e-300)
    known = (power > 0.0) & (error < settings.part_error)
    return SizeByPart(division, size[known], error[known])


def _unique_numbers(parts: Sequence[Index]) -> Index:
    """Numbers of several tables, made unique."""
    first = np.cumsum([0, *(int(p.max(initial=-1)) + 1 for p in parts)])
    return np.concatenate([p + start for p, start in zip(parts, first, strict=False)])


def _by_row(data: WeakData, values: Sequence[Array]) -> Array:
    """Values at the test functions of every segment as values of the rows."""
    return np.concatenate([np.repeat(v, len(data.rows)) for v in values])


def _part_of_run(data: WeakData, settings: Settings) -> Index:
    shares = []
    for s in data.segments:
        t = data.runs[s.run].t
        share = (s.functions.centre - t[0]) / (t[-1] - t[0])
        shares.append(np.clip((share * settings.size_parts).astype(np.intp), 0, settings.size_parts - 1))
    return _by_row(data, shares).astype(np.intp)


def _signals(data: Sequence[WeakData]) -> dict[str, list[Array]]:
    """Motion and commands, and the speed in units of each velocity's scatter, in the rows of each data."""
    names, commands = data[0].names, data[0].commands
    half = len(names) // 2
    spread = np.nanstd(np.vstack([s.measured[:, half:] for d in data for s in d.segments]), axis=0)
    found: dict[str, list[Array]] = {}
    for d in data:
        rows: dict[str, list[Array]] = {}
        for s in d.segments:
            table = np.column_stack([s.measured, s.u])
            speed = np.sqrt(np.nansum((s.measured[:, half:] / np.maximum(spread, 1e-300)) ** 2, axis=1))
            for name, values in (*zip((*names, *commands), table.T, strict=True), ("the speed", speed)):
                if name not in ("x", "y") and np.isfinite(values).all():
                    rows.setdefault(name, []).append(np.interp(s.functions.centre, s.t, values))
        for name, values in rows.items():
            if len(values) == len(d.segments):
                found.setdefault(name, []).append(_by_row(d, values))
    return {name: values for name, values in found.items() if len(values) == len(data)}


def _quantile_level(values: Array, settings: Settings) -> Index:
    edges = np.quantile(values, np.arange(1, settings.size_parts) / settings.size_parts)
    return np.digitize(values, edges).astype(np.intp)


# --- whether it keeps its size with another force in the model --------------------------------------
class Kept(NamedTuple):
    """Size and improvement of effects with another one in the model, relative to those without it.

    size: of their parameters.
    gain: of their improvement of predictions.
    """

    size: float
    gain: float


def kept_with(
    effect: FoundEffect, other: FoundEffect, before: Fitted, bench: Bench, validator: SimulationValidator
) -> Kept:
    """Size and gain that an effect keeps with another one in the model.

    All of both if predictions are clearly worse with the other one alone: a proxy predicts no better than
    what it stands for; or if in the model with both the effect keeps its size and the other one does not. All
    of its size if the other one does not improve predictions in addition to it.

    before: the model without either, fitted like the final result.
    """
    vehicle, settings = bench.base.model.functions.vehicle, bench.settings

    def final(findings: Sequence[FoundEffect]) -> Fitted:
        return validator.final(fitted(vehicle, findings, bench).fit)

    def gain_of(without: Mapping[float, Array], with_it: Mapping[float, Array]) -> PredictionGain:
        return gain_of_effects(without, with_it, [effect], validator)

    given, instead = final([effect]), final([other])
    ahead, rival = validator.squares_ahead(given), validator.squares_ahead(instead)
    pair = [compared_channels(each, [effect], validator) for each in (ahead, rival)]
    if best_in_resamples(pair, settings)[0] >= settings.best_share:
        return Kept(1.0, 1.0)
    both = final([other, effect])
    size, size_of_other = _size(effect, given, both), _size(other, instead, both)
    if size >= 1.0 - settings.size_spread > size_of_other:
        return Kept(1.0, 1.0)
    joint = validator.squares_ahead(both)
    alone = gain_of(validator.squares_ahead(before), ahead).log_fall
    gain = gain_of(rival, joint).log_fall / alone if alone > 0.0 else 1.0
    return Kept(size if gain_of(ahead, joint).suffices(settings.worth) else 1.0, gain)


def _size(effect: FoundEffect, given: Fitted, both: Fitted) -> float:
    """Parameters of an effect in a second fit relative to those in the first, weighted by their precision.

    Only those in which the force is linear, if there are any.
    """
    linear = {p.name: p.linear for p in effect.trial.candidate.parameters}
    names, errors = [n for n in given.model.free if base_name(n) in linear], given.standard_errors
    names = [n for n in names if linear[base_name(n)]] or names
    own = [n for n in names if errors[n] > 0.0 and np.isfinite(errors[n])]
    weight = np.array([given.values[n] / errors[n] ** 2 for n in own])
    first, second = (np.array([f.values[n] for n in own]) for f in (given, both))
    return float(weight @ second / max(weight @ first, 1e-300))


# --- whether the logs determine its characteristic parameters ---------------------------------------
def undetermined(
    parameters: Sequence[Parameter],
    values: Mapping[str, float],
    covariance: Array,
    settings: Settings = DEFAULT,
    *,
    has_states: bool = False,
) -> str:
    """Which characteristic parameter of an effect these logs do not determine, in words; empty if none.

    A memory without a determined time constant is a spring or a damper, and so is one at a limit of its
    range. A command limit that is not determined may leave all of the thrust, or none. A parameter at its
    bound does not confirm the effect. If an effect is significant but none of its factors is determined, only
    a product is, which may belong to another effect: a soft spring to a far point is a constant force. A size
    need not be one of those that are determined: of drag that fades with the distance from a boundary which
    the vehicle never reaches, only the fading is.

    parameters: those that the effect adds to the model; what the vehicle file states of it is no finding.
    values, covariance: of the free parameters of a model, these among them, in the same order.
    has_states: whether the effect has states of its own.
    """
    own = [p for p in parameters if p.name in values]
    words = _printed(own, values, covariance)
    differ = partial(_differ_from_zero, values, covariance, settings)
    known = {n for group in _jointly_tested(own) if differ(group) for n in group}
    for p in own:
        own_time = has_states and p.unit in ("s", "rad/s")
        if own_time and not (p.name in known and values[p.name] > 0.0):
            which = "time constant" if p.unit == "s" else "frequency"
            return f"its {which} {words[p.name]} is not determined by these logs"
        ends = p.bounds if own_time else p.bounds[1:]
        if np.isclose(values[p.name], ends, rtol=1e-6).any():
            return f"{p.name} = {values[p.name]:.3g} is at its bound"
    sizes = [p.name for p in own if p.linear]
    if own and not sizes and not known and not differ([*words]):
        return (
            f"{' and '.join(words.values())} {'is' if len(own) == 1 else 'are'} not determined by these logs"
        )
    # A force of a direction that is estimated, too, is a vector.
    angles = [p.name for p in own if p.unit == "rad" and not p.linear]
    if sizes and angles and not differ(sizes, further=len(angles)):
        size = ", ".join(words[name] for name in sizes)
        return f"its size {size} is not determined by these logs: any direction was possible"
    factors = {*sizes, *(p.name for p in own if _is_factor(p))}
    if sizes and len(own) > len(sizes) and not known & factors and not differ(sizes):
        size = ", ".join(words[name] for name in sizes)
        return f"its size {size} is not determined by these logs, only its product with other parameters"
    return ""


def _is_factor(parameter: Parameter) -> bool:
    """Whether a parameter that differs from zero gives the force a course that no factor of it has.

    A lever arm does not, it only divides the force among the motions, nor does a direction; and one whose
    range excludes zero differs from it in any log.
    """
    low, high = parameter.bounds
    return not (parameter.arm_of or parameter.unit == "rad") and low <= 0.0 <= high


def _printed(own: Sequence[Parameter], values: Mapping[str, float], covariance: Array) -> dict[str, str]:
    """Parameters with standard error and unit, by name."""
    errors = dict(zip(values, np.sqrt(np.diag(covariance)).tolist(), strict=True))
    return {
        p.name: f"{p.name} = {values[p.name]:.3g} ± {errors[p.name]:.2g} {p.shown_unit}".strip() for p in own
    }


def _jointly_tested(own: Sequence[Parameter]) -> list[list[str]]:
    """Parameters that differ from zero each for itself, or as the vector of which they are components.

    North and east are not axes of the vehicle: a vector along them may be determined in any direction.
    """
    vector = [p.name for p in own if p.earth_axis]
    return [[p.name] for p in own if not p.earth_axis] + [vector] * bool(vector)


def _differ_from_zero(
    values: Mapping[str, float],
    covariance: Array,
    settings: Settings,
    names: Sequence[str],
    further: int = 0,
) -> bool:
    """Whether parameters differ from zero as a whole (Wald test), at the level of one at its limit.

    further: other components of a vector, which are zero by the choice of its axes.
    """
    places = [list(values).index(n) for n in names]
    estimate = np.array([values[n] for n in names])
    distance = estimate @ inverse_of(covariance[np.ix_(places, places)]) @ estimate
    return bool(distance > chi2.isf(2.0 * norm.sf(settings.time_constant_t), len(names) + further))


def undetermined_by_fit(finding: FoundEffect, fit: Fitted, settings: Settings) -> str:
    """Which parameter of an effect a fit leaves undetermined or impossible, in words; empty if none."""
    candidate = finding.trial.candidate
    free = {n: fit.values[n] for n in fit.model.free}
    states = bool(candidate.effect(()).states)
    words = undetermined(candidate.parameters, free, fit.covariance, settings, has_states=states)
    return words or _arm_at_bound(candidate.parameters, fit)


def with_effect_zero(finding: FoundEffect, fit: Fitted) -> Fitted | None:
    """A fit with the effect set to zero and all else as it is; None if the effect has values by run.

    If it predicts as well, the fit has only reached another local minimum: the effect improves nothing.
    """
    own = [p for p in finding.trial.candidate.parameters if p.name in fit.model.values.names]
    sizes = [p for p in own if p.linear] or own
    neutral = {p.name: p.neutral for p in sizes if p.neutral is not None}
    if not neutral or any(p.name in fit.model.values.by_run for p in own):
        return None
    values = np.array(fit.p)
    for name, place in zip(fit.model.free, fit.model.places, strict=True):
        values[place] = neutral.get(name, values[place])
    return fit.with_parameters(values)


def _arm_at_bound(parameters: Sequence[Parameter], fit: Fitted) -> str:
    """Which place is as far off as anything aboard the vehicle can be, in words; empty if none.

    A moment without a force acts at infinity: no wind turns a hull that it does not push. Such a fit does not
    confirm the effect, even if it leaves only noise.
    """
    places = {p.name: p.unit for p in parameters if p.arm_of}
    if not places:
        return ""
    allowed = dict(zip(fit.model.free, fit.model.largest.tolist(), strict=True))
    for name, end in at_bounds(fit.model, fit.p).items():
        if base_name(name) in places and abs(end) >= allowed[name]:
            value = f"{name} = {fit.values[name]:.3g} {places[base_name(name)]}"
            return f"{value} is at the bound for a vehicle of this mass and inertia"
    return ""


def step_wider_than_motion(finding: FoundEffect, bench: Bench) -> str:
    """Which smoothed step of an effect is wider than the motion, in words; empty if none.

    Friction that is fully developed only at speeds that the logs hardly reach is ordinary damping.
    """
    fit = finding.trial.fit
    for p in finding.trial.candidate.parameters:
        if (
            p.step_width
            and p.name in fit.model.free
            and fit.values[p.name] > _largest_velocity_rms(p.unit, bench.train)
        ):
            return (
                f"{p.name} = {fit.values[p.name]:.2g} {p.unit} exceeds the rms of the motion, so it is "
                "not a step"
            )
    return ""


def _largest_velocity_rms(unit: str, data: WeakData) -> float:
    """The largest rms of the velocities in a unit."""
    half = len(data.names) // 2
    moved = np.vstack([s.measured[:, half:] for s in data.segments])
    rms = np.sqrt(np.nanmean(moved**2, axis=0))
    moving = zip(data.names[half:], rms.tolist(), strict=True)
    return max((size for name, size in moving if MOTION_UNITS[name] == unit), default=0.0)


def is_spring(finding: FoundEffect) -> bool:
    """Whether a fluid memory would remove more inertia from slow motion than the added mass.

    A memory due to waves cannot do that, a stiffness does; drag that lags the motion can.
    """
    fit = finding.trial.fit
    slow = added_mass_at_zero_frequency(fit.model.functions, fit.p[: fit.model.values.size])
    return slow is not None and bool(np.any(np.diag(slow) < 0.0))


SPRING = "in slow motion it would remove more inertia than the added mass, as a stiffness does"


def vanished_inertia(before: Fitted, after: Fitted, stated: Vehicle) -> dict[str, float]:
    """Inertias that are zero with an effect, with the value that they have without it, or as stated.

    One that the model is fitted without, too, is no sign of the effect; but whatever is fitted to a vehicle
    without inertia is no cause either.

    before, after: fits of the model without and with it.
    """
    known = {str(symbol) for symbol in after.vehicle.mass_matrix.free_symbols}
    zero = [n for n in after.model.free if base_name(n) in known and after.values[n] == 0.0]
    # An inertia that the effect itself brings is none that it could replace.
    values = {n: before.values.get(n, 0.0) or stated.values[n].value for n in zero if n in stated.values}
    return {n: value for n, value in values.items() if value}


def constant_heading(finding: FoundEffect, bench: Bench) -> str:
    """Why these logs cannot tell a current from a body-fixed force; empty if they can.

    For a sensor of speed through the water they always can: no force acts between pose and velocity.
    """
    if finding.of_sensors or not issubclass(finding.trial.candidate.effect, Flow):
        return ""
    runs = [r for data in (bench.train, bench.test) for r in data.runs]
    headings = [r.channels["psi"] for r in runs if r.has("psi")] or [np.zeros(1)]
    # If every run has a current of its own, headings of other runs carry no information on it.
    by_run = any(base_name(name) != name for name in finding.trial.fit.model.free)
    turned = max(map(_heading_range, headings)) if by_run else _heading_range(np.concatenate(headings))
    if turned >= bench.settings.least_turn:
        return ""
    return f"the heading turns by only {turned:.2g} rad: a body-fixed force may explain the same"


def _heading_range(heading: Array) -> float:
    """Range of directions, rad."""
    direction = np.exp(1j * heading[np.isfinite(heading)])
    return float(np.ptp(np.angle(direction / np.sum(direction))))


# --- whether a function of its own variables would do much better ----------------------------------
def _added_symbols(candidate: Candidate, base: Vehicle, grown: Vehicle) -> set[str]:
    # An effect that the file states in part is in the equations, its other coefficients at zero.
    neutral = {p.name: p.neutral for p in candidate.parameters if p.neutral is not None}
    zero = {s: sm.Float(neutral[str(s)]) for s in base.residual.free_symbols if str(s) in neutral}
    return {str(s) for s in (grown.residual - base.residual.xreplace(zero)).free_symbols}


def depends_on_time(candidate: Candidate, base: Vehicle, grown: Vehicle) -> bool:
    """Whether an effect depends explicitly on time, as waves do."""
    return "t" in _added_symbols(candidate, base, grown)


def may_depend_on_time(candidate: Candidate, base: Vehicle, grown: Vehicle) -> bool:
    """Whether an effect may depend explicitly on time; all actuator effects may."""
    return depends_on_time(candidate, base, grown) or candidate.effect.family == "actuation"


def own_variables(candidate: Candidate, base: Vehicle, grown: Vehicle) -> tuple[str, ...]:
    """Velocities, pose and commands on which the terms of an effect depend.

    For a measurement effect these are the velocities, for actuator effects the commands. A constant force
    depends on none.
    """
    symbols = _added_symbols(candidate, base, grown) - {*grown.parameter_names}
    names = symbols | {s.partition("_")[2] for s in symbols}  # actuation_prop, memory_u
    present = (*base.velocity_names, *base.pose_names, *base.command_names)
    if found := tuple(n for n in present if n in names):
        return found
    if issubclass(candidate.effect, Measurement):
        return base.velocity_names
    return base.command_names if candidate.effect.family == "actuation" else ()
