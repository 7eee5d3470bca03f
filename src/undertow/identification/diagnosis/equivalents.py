"""Effects that act like changed parameters of the model, so that no data of this kind tell them apart."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from undertow.model.vehicle import Vehicle

from ..weak.fit import WeakFit
from ..weak.step import inverse_of
from .candidates import Candidate
from .result import Equivalent
from .scouting import scout
from .trial import Bench

Array = NDArray[np.float64]
# Standard deviations from which a parameter has moved away from what was stated.
_MOVED = 3.0
# Mean square, in units of the noise, that an equivalent may leave of the change.
_UNSEEN = 0.02


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
    found = [c.id for c in possible if c.parameters and _acts_alike(c, bench, moved)]
    return [Equivalent(parameters=list(moved), effects=found, reason=_reason(moved))] if found else []


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


def _acts_alike(candidate: Candidate, bench: Bench, moved: dict[str, float]) -> bool:
    """Whether the effect, with the other parameters where they may be, changes the residual just as much."""
    start = scout(candidate, bench).start
    names = start.model.free
    shift = start.at.J[:, [names.index(n) for n in moved]] @ np.array(list(moved.values()))
    own = {p.name for p in candidate.parameters}
    columns = start.at.J[:, [k for k, n in enumerate(names) if n not in moved]]
    model = start.at.J[:, [k for k, n in enumerate(names) if n not in moved and n not in own]]
    return _left(shift, model) > _UNSEEN > _left(shift, columns)


def _left(change: Array, columns: Array) -> float:
    """Mean square of what columns cannot make of a change."""
    gram = columns.T @ columns
    rest = change - columns @ (inverse_of(gram) @ (columns.T @ change))
    return float(np.mean(rest**2))


def _reason(moved: dict[str, float]) -> str:
    names = ", ".join(moved)
    one = len(moved) == 1
    return (
        f"{names} {'is' if one else 'are'} far from what was stated; each of these effects would do the same "
        "to these data, and either explanation leaves only noise"
    )
