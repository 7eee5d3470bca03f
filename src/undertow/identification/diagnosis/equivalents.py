"""Effects that act like changed parameters of the model, so that no data of this kind tell them apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from undertow.model.vehicle import Vehicle

from ..fitted import MORE_THAN_CHANCE
from ..weak.fit import WeakFit
from ..weak.step import PRIOR_WIDTH, bounded_step, bounds_of, prior_of, reach_of, within_reach
from .candidates import Candidate
from .chain import Chain, fitted
from .fixed_values import other_values
from .result import Equivalent
from .scouting import scout
from .second_look import Quiet
from .trial import Bench

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
    told = {"reason": _reason(moved), "separated_by": _separating(list(moved))}
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
    bounds = within_reach(bounds_of(model), now, reach_of(model))
    step = bounded_step(start.at, now, bounds, (centre, stiffness))
    off = np.abs(stiffness * (now + step - centre))
    home = all(off[model.free.index(n)] < _HOME for n in moved)
    left = np.sum((start.at.r + start.at.J @ step) ** 2)
    return bool(home and left < np.sum(bench.base.at.r**2) + MORE_THAN_CHANCE)


def _reason(moved: dict[str, float]) -> str:
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
