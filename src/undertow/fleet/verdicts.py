"""What may be said of changes when many were looked for at once, as plain data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import combinations
from typing import Any, Literal

import numpy as np
from scipy.special import stdtrit

from .changes import FEWEST_DAYS, KINDS, Change, Changes, Span

#: Chance of a single false statement in a whole report.
ALPHA = 0.01
# A change of this size that would not have been seen leaves everything open.
_WORTH = 0.25
# Share of the growth of drag in one motion below which another motion contradicts fouling.
_CONTRADICTS = 0.3
# Causes that a line has room for.
_SHOWN = 4
Answer = Literal["grew", "none seen", "cannot tell"]


@dataclass(frozen=True)
class Statement:
    """What the days say.

    Attributes
    ----------
    answer : str
        "grew" (something changed, and which is told), "none seen" or "cannot tell".
    effects : tuple of str
        What changed, by name: "fouling", "thruster wear", "drag", "thrust", "added mass"; where it cannot
        be told which, all that it may be.
    words : str
        One line.
    """

    answer: Answer
    effects: tuple[str, ...]
    words: str


@dataclass(frozen=True)
class Asked:
    """A span with its changes."""

    of: Changes
    span: Span
    changes: tuple[Change, ...]


def statements(asked: Sequence[Asked]) -> list[Statement]:
    """A statement for every span; all of them together are wrong in one report of a hundred.

    Chances are held against each other by Holm's rule over all that was looked for in all spans, beside
    other directions and alone: twice as many as there are changes.
    """
    every = [c.p_value for a in asked for c in a.changes] + [c.alone for a in asked for c in a.changes]
    limit = holm(every, ALPHA)
    return [_statement(a, limit) for a in asked]


def holm(chances: Sequence[float], alpha: float) -> float:
    """Largest chance that is still significant when all of these were looked at; less than any if none is.

    Step-down: the k-th smallest of m is held against alpha / (m - k + 1), until one fails.
    """
    ordered = np.sort(chances)
    bounds = alpha / np.arange(len(ordered), 0, -1)
    failed = np.flatnonzero(ordered > bounds)
    passed = int(failed[0]) if len(failed) else len(ordered)
    return float(bounds[passed]) if passed < len(ordered) else alpha


def _statement(asked: Asked, limit: float) -> Statement:
    if not asked.span.enough:
        return Statement("cannot tell", (), f"cannot tell: {_lacking(asked.span)}")
    found = [c for c in asked.changes if c.alone <= limit]
    if not found:
        return _nothing(asked, limit)
    causes = _causes(asked, limit)
    if not causes:
        return Statement("cannot tell", (), "something changed, and no cause that was tried explains it all")
    common = tuple(name for name in causes[0] if all(name in cause for cause in causes))
    if not common:
        return _open(causes)
    said = _named(common, asked, limit)
    rest = [tuple(n for n in cause if n not in common) for cause in causes]
    if not all(rest):
        return said
    return replace(said, words=f"{said.words}; beside it {_listed(rest)}: cannot tell which")


def _open(causes: Sequence[tuple[str, ...]]) -> Statement:
    names = tuple(dict.fromkeys(_READING.get(name, name) for cause in causes for name in cause))
    return Statement("cannot tell", names, f"something changed; cannot tell which: {_listed(causes)}")


def _listed(causes: Sequence[tuple[str, ...]]) -> str:
    told = [" with ".join(_READING.get(n, n) for n in cause) for cause in causes]
    more = [f"{len(told) - _SHOWN} more"] if len(told) > _SHOWN else []
    return " or ".join([*told[:_SHOWN], *more])


def _causes(asked: Asked, limit: float) -> list[tuple[str, ...]]:
    """The fewest kinds, or the effects of the catalogue, whose change explains all; all that do so.

    A single cause that explains all goes before two that happened to come together. A cause is out when
    something stands out beside it that would do so in one of a hundred cases were it the true one.
    """
    of, span, out = asked.of, asked.span, ALPHA / max(len(asked.changes), 1)
    kinds = [k for k in KINDS if any(c.alone <= limit for c in asked.changes if c.direction.kind == k)]
    single: list[tuple[str, ...]] = [(k,) for k in kinds if of.suffices(span, of.of(k), "", out)]
    single += [(e,) for e in of.rivals() if of.suffices(span, [], e, out)]
    if single:
        return single
    pairs = list(combinations(KINDS, 2))
    return [pair for pair in pairs if of.suffices(span, of.of(*pair), "", out)]


def _lacking(span: Span) -> str:
    first, last = span.groups
    told = f"{first} days" if not last else f"{first} days before and {last} in it"
    return f"{told}, at least {FEWEST_DAYS} are needed to know the scatter from day to day"


def _nothing(asked: Asked, limit: float) -> Statement:
    """Nothing stands out: because nothing changed, or because it would not have shown."""
    kinds = [k for k in KINDS if k != "inertia" and any(c.direction.kind == k for c in asked.changes)]
    halves = {k: _halves(asked, k, limit) for k in kinds}
    seen = {n: v for own in halves.values() for n, v in own.items() if v <= _WORTH}
    told = ", ".join(f"{n} {100 * v:.2g}" for n, v in seen.items())
    open_ = [_unseen(kind, own) for kind, own in halves.items() if min(own.values()) > _WORTH]
    likely = [c for c in asked.changes if min(c.p_value, c.alone) <= ALPHA]
    if seen and not open_ and not likely:
        return Statement("none seen", (), f"no change seen; would have shown from, %: {told}")
    words = _perhaps(likely) + open_
    if not words:
        return Statement("cannot tell", (), "cannot tell: these days determine neither drag nor thrust")
    rest = f"; otherwise no change seen; would have shown from, %: {told}" if seen else ""
    return Statement("cannot tell", (), f"cannot tell: {'; '.join(words)}{rest}")


def _perhaps(likely: Sequence[Change]) -> list[str]:
    """What may have changed: what stands out beside the other kinds, else what would if it were alone."""
    beside = [c for c in likely if c.p_value <= ALPHA]
    if beside or not likely:
        return [f"{_told(c)} may be a change, but is not sure enough" for c in beside]
    names = " or ".join(c.direction.name for c in likely)
    return [f"something may have changed ({names}), but is not sure enough"]


def _halves(asked: Asked, kind: str, limit: float) -> dict[str, float]:
    """From which size a change of each direction of a kind would have been seen."""
    return {c.direction.name: _half(c, limit) for c in asked.changes if c.direction.kind == kind}


def _unseen(kind: str, halves: dict[str, float]) -> str:
    name, least = min(halves.items(), key=lambda pair: pair[1])
    if not np.isfinite(least):
        return f"these days do not determine {kind}"
    return f"a change of {name} below {least:.0%} would not show"


_READING = {"drag": "fouling", "thrust": "thruster wear", "inertia": "added mass"}


def _named(cause: tuple[str, ...], asked: Asked, limit: float) -> Statement:
    names, words = [], []
    for name in cause:
        every = [c for c in asked.changes if c.direction.kind == name]
        sure = [c for c in every if c.p_value <= limit]
        if not every:
            names.append(name)
            words.append(f"a change of {name} explains all, and none of drag, thrust or added mass does")
        elif not sure:
            told = f"something changed; {_READING[name]} would explain it, but no single motion is sure"
            return Statement("cannot tell", (_READING[name],), told)
        else:
            found, told = _SAID[name](sure, every, limit)
            names.append(found)
            words.append(told)
    return Statement("grew", tuple(names), "; ".join(words))


def _drag(sure: Sequence[Change], every: Sequence[Change], limit: float) -> tuple[str, str]:
    told = ", ".join(map(_told, sure))
    if any(c.value < 0 for c in sure):
        return "drag", f"drag changed: {told}; less of it is no fouling (cleaned? another trim?)"
    least = _CONTRADICTS * min(c.value for c in sure)
    against = [c.direction.of for c in every if c.value + _half(c, limit) < least]
    if against:
        return "drag", f"drag grew: {told}, not in {', '.join(against)}, which fouling would have raised, too"
    if len(sure) == 1 and len(every) > 1:
        return "drag", f"drag grew: {told}; that of other motions is not known well enough to call it fouling"
    return "fouling", f"fouling: {told}"


def _thrust(sure: Sequence[Change], every: Sequence[Change], limit: float) -> tuple[str, str]:
    told = ", ".join(map(_told, sure))
    if any(c.value > 0 for c in sure):
        return "thrust", f"thrust changed: {told}; more of it is no wear (another propeller, another supply?)"
    return "thruster wear", f"thruster wear: {told}"


def _inertia(sure: Sequence[Change], every: Sequence[Change], limit: float) -> tuple[str, str]:
    return "added mass", f"added mass changed: {', '.join(map(_told, sure))}"


def _told(change: Change) -> str:
    error = f"{100 * change.error:.2g}"
    return f"{change.direction.name} {100 * change.value:+.3g} ± {error} %"


_SAID = {"drag": _drag, "thrust": _thrust, "inertia": _inertia}


def _half(change: Change, limit: float) -> float:
    """Half the width of the interval that goes with a chance."""
    if not (np.isfinite(change.error) and change.freedom > 0):
        return np.inf
    return float(-stdtrit(change.freedom, max(limit, 1e-300) / 2) * change.error)


@dataclass(frozen=True)
class Parameter:
    """A parameter over some days.

    Attributes
    ----------
    value, error : float or None
        Estimate and standard error, SI, in the sign convention of the vehicle's file; None where the days do
        not determine it.
    """

    name: str
    unit: str
    value: float | None
    error: float | None


@dataclass(frozen=True)
class Shift:
    """How much something changed against the first month, or over all days.

    Attributes
    ----------
    of : str
        "drag in surge", "thrust of f1" ...
    percent, error : float or None
        Change and standard error, %; None where the days do not determine it.
    p_value : float
        Chance of so much by the scatter of the days, before what many tests ask for.
    """

    of: str
    percent: float | None
    error: float | None
    p_value: float


@dataclass(frozen=True)
class Period:
    """A month of one vehicle, or all its days.

    Attributes
    ----------
    name : str
        Month, or "all".
    days, samples : int
        How many.
    seconds : float
        Time that the logs cover, s.
    misfit : float
        Root mean square of what the parameters of these days leave, in units of what was counted as noise.
    parameters : tuple of Parameter
        Estimates.
    changes : tuple of Shift
        Against the first month; over all days for "all".
    statement : Statement, optional
        What is said of the changes; None for the first month.
    """

    name: str
    days: int
    samples: int
    seconds: float
    misfit: float
    parameters: tuple[Parameter, ...]
    changes: tuple[Shift, ...]
    statement: Statement | None


@dataclass(frozen=True)
class Score:
    """What one linear step of an effect that the model lacks would take off what the model leaves.

    Attributes
    ----------
    effect : str
        Id.
    share : float
        Share of the squares.
    p_value : float
        Chance of its most certain parameter by the scatter of the days, times the number of parameters that
        were looked at.
    """

    effect: str
    share: float
    p_value: float


@dataclass(frozen=True)
class Of:
    """All that is said of one vehicle.

    Attributes
    ----------
    vehicle : str
        Name.
    whole : Period
        All its days.
    months : tuple of Period
        Its months.
    scores : tuple of Score
        What its model lacks, the best first.
    remarks : tuple of str
        What speaks against the numbers.
    """

    vehicle: str
    whole: Period
    months: tuple[Period, ...]
    scores: tuple[Score, ...]
    remarks: tuple[str, ...]


@dataclass(frozen=True)
class Fleet:
    """The report of a fleet.

    Attributes
    ----------
    vehicles : tuple of Of
        By name.
    failed : dict of str
        Files that nothing is known of, and why.
    twins : dict of str
        Files that were left out because another one has the same content, and that one.
    done, found : int
        Partitions that the report stands on, and that there are.
    worked : int
        Partitions that were worked out in this run; the others were known.
    unscored : tuple of str
        Effects that one linear step says nothing of.
    """

    vehicles: tuple[Of, ...]
    failed: dict[str, str] = field(default_factory=dict)
    twins: dict[str, str] = field(default_factory=dict)
    done: int = 0
    found: int = 0
    worked: int = 0
    unscored: tuple[str, ...] = ()

    @property
    def whole(self) -> bool:
        """Whether nothing is missing."""
        return not self.failed

    def plain(self) -> dict[str, Any]:
        """As JSON takes it."""
        return asdict(self)
