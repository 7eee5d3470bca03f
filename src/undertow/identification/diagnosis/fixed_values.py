"""Values that the vehicle file holds fixed: where one is wrong, what is left looks like a missing effect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from ..fitted import MORE_THAN_CHANCE
from ..weak.fit import WeakFit
from ..weak.residual import Linearised, WeakModel, whitened
from ..weak.step import PRIOR_WIDTH, inverse_of, normal_equations, prior_cost, prior_of
from .evidence import as_good
from .rounds import Round
from .second_look import Quiet
from .trial import Bench, Score

# Fall of the sum of squares, in units of the noise, from which another value is worth a fit.
_WORTH = 20.0


@dataclass(frozen=True)
class OtherValues:
    """The model with other values in place of some that the vehicle file holds fixed.

    Attributes
    ----------
    alike : dict
        Names of those values, each with fixed values that would do the same in its place.
    fit : WeakFit
        The fit with them free.
    score : Score
        How it does on the kept-aside data.
    """

    alike: dict[str, tuple[str, ...]]
    fit: WeakFit
    score: Score


def freed(vehicle: Vehicle, names: Sequence[str]) -> Vehicle:
    """The vehicle with these values to be estimated."""
    return vehicle.with_values({n: replace(vehicle.value_of(n), estimate=True) for n in names})


def values_to_free(current: Round, quiet: Quiet) -> dict[str, tuple[str, ...]]:
    """Fixed values whose change explains more than the best effect, or as much with less strain on the rest.

    Parameters
    ----------
    current : Round
        What every effect does for the model as given.
    quiet : callable
        Whether a model leaves only noise of the kept-aside data.

    Returns
    -------
    dict
        Names of the values, each with fixed values that would do the same in its place; empty where an
        effect, or the model as it is, is to be preferred.
    """
    bench = current.bench
    if not _fixed(bench) or quiet(bench.base, bench.test):
        return {}
    found = other_values(bench)
    if found is None or as_good(found.score, bench.base_score, bench.test):
        return {}
    winner = current.winner
    if winner is not None and not _preferred(found, winner.trial.fit, winner.trial.score, bench, quiet):
        return {}
    return found.alike


def other_values(bench: Bench) -> OtherValues | None:
    """The model with those fixed values free that the data want to be others; None where they want none."""
    alike = _wanted(bench)
    if not alike:
        return None
    model = WeakModel(bench.base.model.functions, (*bench.base.model.free, *alike))
    fit = bench.fit(model, start=bench.base.values)
    return OtherValues(alike, fit, bench.judge(fit))


def _unlikely(fit: WeakFit, score: Score) -> float:
    """Twice the negative logarithm of the likelihood of what is left, if that is noise, and of the values.

    Stated priors have their full weight here.
    """
    strain = PRIOR_WIDTH**2 * prior_cost(prior_of(fit.model), fit.p[list(fit.model.places)])
    return float(np.sum(score.r**2)) + strain


def _preferred(found: OtherValues, fit: WeakFit, score: Score, bench: Bench, quiet: Quiet) -> bool:
    """Whether other values are the better explanation than an effect."""
    sound, effect_sound = quiet(found.fit, bench.test), quiet(fit, bench.test)
    if sound and effect_sound:
        return _unlikely(found.fit, found.score) + MORE_THAN_CHANCE < _unlikely(fit, score)
    return sound or (not effect_sound and not as_good(found.score, score, bench.test))


# --- which values ---------------------------------------------------------------------------------
def _fixed(bench: Bench) -> tuple[str, ...]:
    """Fixed values that the file states and no effect stands for: all but what is weighed and measured."""
    vehicle = bench.base.model.functions.vehicle
    own = {p.name for e in vehicle.all_effects if not (e.weighed or e.built_in) for p in e.parameters}
    return tuple(n for n in _held(bench) if n in vehicle.values and vehicle.declaration(n).name in own)


def _held(bench: Bench) -> tuple[str, ...]:
    """All values of the equations that a fit may not change."""
    model = bench.base.model
    names = model.functions.parameter_names
    vehicle = model.functions.vehicle
    held = (n for n in names if n not in model.free and vehicle.parameter_of(n) is not None)
    return tuple(n for n in held if np.isfinite(bench.base.p[names.index(n)]))


def _wanted(bench: Bench) -> dict[str, tuple[str, ...]]:
    """Fixed values that bring the error down in the linearised problem, one after the other, each with those
    that would do the same in its place.
    """
    fixed = _fixed(bench)
    if not fixed:
        return {}
    names, count = _held(bench), len(bench.base.model.free)
    gram, slope = _normal(bench, names)
    open_to_change = [count + names.index(n) for n in fixed]
    chosen: list[int] = []
    own = list(range(count))
    while rest := [k for k in open_to_change if k not in chosen]:
        falls = [_fall(gram, slope, [*own, *chosen, k]) for k in rest]
        if max(falls) < _fall(gram, slope, [*own, *chosen]) + _WORTH:
            break
        chosen.append(rest[int(np.argmax(falls))])
    least = _fall(gram, slope, [*own, *chosen]) - MORE_THAN_CHANCE

    def does_as_well(k: int, other: int) -> bool:
        columns = [*own, *(c for c in chosen if c != k), other]
        return other not in chosen and _fall(gram, slope, columns) > least

    others = range(count, count + len(names))
    return {names[k - count]: tuple(names[i - count] for i in others if does_as_well(k, i)) for k in chosen}


def _normal(bench: Bench, names: tuple[str, ...]) -> tuple[Array, Array]:
    """Information and slope of the model's own parameters and of these values, in their order."""
    base = bench.base
    held = WeakModel(base.model.functions, names)
    at = whitened(held.linearise(bench.train, base.p), bench.train_whitening)
    both = Linearised(base.at.r, np.hstack([base.at.J, at.J]), at.start)
    prior = prior_of(WeakModel(base.model.functions, (*base.model.free, *names)))
    return normal_equations(both, base.p[[*base.model.places, *held.places]], prior)


def _fall(gram: Array, slope: Array, columns: list[int]) -> float:
    """Fall of the sum of squares when these columns are fitted."""
    if not columns:
        return 0.0
    own = slope[columns]
    return float(own @ inverse_of(gram[np.ix_(columns, columns)]) @ own)
