"""From the days of every vehicle to tables per month and statements that hold together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from undertow.identification.weak.step import bounds_of
from undertow.model.dimensions import short_unit
from undertow.model.parameter import printed

from .changes import Change, Changes, Span, chance, shift, trend
from .combine import Day, Solved, by_month, choosing, joined, no_prior, solve
from .panel import Panel
from .result import Fleet, Of, Parameter, Period, Score, Shift
from .verdicts import Asked, Statement, statements

Vehicles = Mapping[str, tuple[Panel, Sequence[Day]]]
# Relative change of an added mass from which one linear step is not exact enough.
_FAR = 0.25
_SCORES = 5


@dataclass(frozen=True)
class _Draft:
    """A vehicle with all that is asked of it, before anything is said."""

    name: str
    changes: Changes
    days: Sequence[Day]
    asked: tuple[Asked, ...]


def summarised(vehicles: Vehicles) -> Fleet:
    """Tables and statements of all vehicles; what is said of one takes into account how many were looked at.

    Parameters
    ----------
    vehicles : mapping
        Columns and days of every vehicle, by name.
    """
    drafts = [_draft(name, Changes(panel), days) for name, (panel, days) in vehicles.items()]
    said = iter(statements([a for d in drafts for a in d.asked]))
    told = tuple(_told(d, list(islice(said, len(d.asked)))) for d in drafts)
    unscored = dict.fromkeys(n for d in drafts for n in d.changes.panel.unscored)
    return Fleet(told, unscored=tuple(unscored))


def _draft(name: str, changes: Changes, days: Sequence[Day]) -> _Draft:
    months = list(by_month(days).values())
    spans = [trend(days), *(shift(months[0], later) for later in months[1:])]
    return _Draft(name, changes, days, tuple(_asked(changes, span) for span in spans))


def _asked(changes: Changes, span: Span) -> Asked:
    return Asked(changes, span, tuple(changes.over(span)))


def _told(draft: _Draft, said: Sequence[Statement]) -> Of:
    months = by_month(draft.days)
    rest: list[tuple[Sequence[Change], Statement | None]] = [((), None)]
    rest += [(a.changes, s) for a, s in zip(draft.asked[1:], said[1:], strict=True)]
    periods = [
        _period(draft.changes, name, own, changes, statement)
        for (name, own), (changes, statement) in zip(months.items(), rest, strict=True)
    ]
    whole = _period(draft.changes, "all", draft.days, draft.asked[0].changes, said[0])
    scores = _scores(draft.changes, draft.days)
    return Of(draft.name, whole, tuple(periods), scores, tuple(_remarks(draft)))


def _period(
    changes: Changes,
    name: str,
    days: Sequence[Day],
    found: Sequence[Change],
    statement: Statement | None,
) -> Period:
    panel = changes.panel
    solved = _fitted(changes, days)
    total, entries = sum(float(d.gram[-1, -1]) for d in days), sum(d.entries for d in days)
    return Period(
        name=name,
        days=len(days),
        samples=sum(d.samples for d in days),
        seconds=sum(d.seconds for d in days),
        misfit=float(np.sqrt(max(total - solved.fall, 0.0) / entries)),
        parameters=tuple(_parameter(panel, i, solved) for i in range(len(panel.free))),
        # Inertia is free by itself there, which only says how wear would look as added mass.
        changes=tuple(_shift(c) for c in found if c.direction.kind != "inertia"),
        statement=statement,
    )


def _fitted(changes: Changes, days: Sequence[Day], beside: Sequence[str] = ()) -> Solved:
    """The free parameters of some days, and those of an effect beside them."""
    wanted = [*changes.panel.free, *beside]
    prior = joined(changes.prior, no_prior(len(beside)))
    design = choosing(changes.names, wanted)
    return solve(days, [design] * len(days), prior)


def _parameter(panel: Panel, place: int, solved: Solved) -> Parameter:
    name, vehicle = panel.free[place], panel.vehicle
    declared = vehicle.declaration(name)
    error = float(solved.errors[place])
    unit = short_unit(declared.unit)
    if not np.isfinite(error):
        return Parameter(name, unit, None, None)
    value = vehicle.value_of(name).value + float(solved.theta[place])
    return Parameter(name, unit, printed(declared, value, vehicle.signs), error)


def _shift(change: Change) -> Shift:
    if not np.isfinite(change.error):
        return Shift(change.direction.name, None, None, 1.0)
    return Shift(change.direction.name, 100 * change.value, 100 * change.error, change.p_value)


def _scores(changes: Changes, days: Sequence[Day]) -> tuple[Score, ...]:
    """What effects that the model lacks would take off, one by one."""
    panel = changes.panel
    plain = _fitted(changes, days)
    left = sum(float(d.gram[-1, -1]) for d in days) - plain.fall
    count, found = sum(len(own) for own in panel.own.values()), []
    for effect, own in panel.own.items():
        solved = _fitted(changes, days, own)
        places = range(len(panel.free), len(panel.free) + len(own))
        chances = [chance(solved.theta[i], solved.errors[i], len(days) - 1) for i in places]
        share = max(solved.fall - plain.fall, 0.0) / max(left, 1e-300)
        found.append(Score(effect, float(share), min(1.0, count * min(chances, default=1.0))))
    return tuple(sorted(found, key=lambda s: -s.share)[:_SCORES])


def _remarks(draft: _Draft) -> list[str]:
    panel, found = draft.changes.panel, []
    solved = _fitted(draft.changes, draft.days)
    low, high = bounds_of(panel.base)
    inertial = {n for d in draft.changes.directions if d.kind == "inertia" for n in panel.names
                if d.coefficients[panel.names.index(n)]}  # fmt: skip
    for i, name in enumerate(panel.free):
        stated, moved = panel.vehicle.value_of(name).value, float(solved.theta[i])
        if not low[i] <= stated + moved <= high[i]:
            found.append(f"{name} comes out beyond what is physical: something else is missing in the model")
        elif name in inertial and abs(moved) > _FAR * abs(stated):
            found.append(
                f"{name} is {moved / stated:+.0%} from the file's value, far for one linear step: --passes 2"
            )
    return [*found, *(f"no change of {what} can be told" for what in draft.changes.unseen)]
