"""Verdicts on changes when many are tested at once, as plain data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import combinations
from typing import Any, Literal

import numpy as np
from scipy.special import stdtrit

from .changes import FEWEST_DAYS, KINDS, Change, ChangeTests, Span


@dataclass(frozen=True)
class ChangeCriteria:
    """When a change is stated."""

    alpha: float = 0.01  # chance of a single false statement in a whole report
    worth: float = 0.25  # relative change that leaves everything open if it would not have been seen
    # share of the growth of drag in one motion below which another contradicts fouling
    contradicts: float = 0.3
    shown: int = 4  # causes that a line has room for


CRITERIA = ChangeCriteria()


Answer = Literal["grew", "none seen", "cannot tell"]


@dataclass(frozen=True)
class Statement:
    """What the days say."""

    answer: Answer  # "grew" (something changed, and it is known what), "none seen" or "cannot tell"
    # what changed, by name: "fouling", "thruster wear", "drag", "thrust", "added mass"; where it cannot be
    # text which, all that it may be
    effects: tuple[str, ...]
    words: str  # one line


@dataclass(frozen=True)
class SpanTest:
    """A span with its changes."""

    of: ChangeTests
    span: Span
    changes: tuple[Change, ...]


def statements(asked: Sequence[SpanTest]) -> list[Statement]:
    """A statement for every span; all of them together are wrong in one report of a hundred.

    Chances are held against each other by Holm's rule over all that was looked for in all spans, beside
    other directions and alone: twice as many as there are changes.
    """
    every = [c.p_value for a in asked for c in a.changes] + [c.alone for a in asked for c in a.changes]
    limit = holm(every, CRITERIA.alpha)
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


def _statement(asked: SpanTest, limit: float) -> Statement:
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
    text = _named(common, asked, limit)
    rest = [tuple(n for n in cause if n not in common) for cause in causes]
    if not all(rest):
        return text
    return replace(text, words=f"{text.words}; beside it {_listed(rest)}: cannot tell which")


def _open(causes: Sequence[tuple[str, ...]]) -> Statement:
    names = tuple(dict.fromkeys(_CAUSES.get(name, name) for cause in causes for name in cause))
    return Statement("cannot tell", names, f"something changed; cannot tell which: {_listed(causes)}")


def _listed(causes: Sequence[tuple[str, ...]]) -> str:
    text = [" with ".join(_CAUSES.get(n, n) for n in cause) for cause in causes]
    more = [f"{len(text) - CRITERIA.shown} more"] if len(text) > CRITERIA.shown else []
    return " or ".join([*text[: CRITERIA.shown], *more])


def _causes(asked: SpanTest, limit: float) -> list[tuple[str, ...]]:
    """The fewest kinds, or the effects of the catalogue, whose change explains all; all that do so.

    A single cause that explains all goes before two that happened to come together. A cause is out when
    something stands out beside it that would do so in one of a hundred cases were it the true one.
    """
    of, span, out = asked.of, asked.span, CRITERIA.alpha / max(len(asked.changes), 1)
    kinds = [k for k in KINDS if any(c.alone <= limit for c in asked.changes if c.direction.kind == k)]
    single: list[tuple[str, ...]] = [(k,) for k in kinds if of.explains_all(span, of.of(k), "", out)]
    single += [(e,) for e in of.rivals() if of.explains_all(span, [], e, out)]
    if single:
        return single
    pairs = list(combinations(KINDS, 2))
    return [pair for pair in pairs if of.explains_all(span, of.of(*pair), "", out)]


def _lacking(span: Span) -> str:
    first, last = span.groups
    text = f"{first} days" if not last else f"{first} days before and {last} in it"
    return f"{text}, at least {FEWEST_DAYS} are needed to know the scatter from day to day"


def _nothing(asked: SpanTest, limit: float) -> Statement:
    """Nothing stands out: because nothing changed, or because it would not have shown."""
    kinds = [k for k in KINDS if k != "inertia" and any(c.direction.kind == k for c in asked.changes)]
    halves = {k: _half_widths(asked, k, limit) for k in kinds}
    seen = {n: v for own in halves.values() for n, v in own.items() if v <= CRITERIA.worth}
    text = ", ".join(f"{n} {100 * v:.2g}" for n, v in seen.items())
    open_ = [_unseen(kind, own) for kind, own in halves.items() if min(own.values()) > CRITERIA.worth]
    likely = [c for c in asked.changes if min(c.p_value, c.alone) <= CRITERIA.alpha]
    if seen and not open_ and not likely:
        return Statement("none seen", (), f"no change seen; would have shown from, %: {text}")
    words = _possible(likely) + open_
    if not words:
        return Statement("cannot tell", (), "cannot tell: these days determine neither drag nor thrust")
    rest = f"; otherwise no change seen; would have shown from, %: {text}" if seen else ""
    return Statement("cannot tell", (), f"cannot tell: {'; '.join(words)}{rest}")


def _possible(likely: Sequence[Change]) -> list[str]:
    """What may have changed: what stands out beside the other kinds, else what would if it were alone."""
    beside = [c for c in likely if c.p_value <= CRITERIA.alpha]
    if beside or not likely:
        return [f"{_with_error(c)} may be a change, but is not sure enough" for c in beside]
    names = " or ".join(c.direction.name for c in likely)
    return [f"something may have changed ({names}), but is not sure enough"]


def _half_widths(asked: SpanTest, kind: str, limit: float) -> dict[str, float]:
    """From which size a change of each direction of a kind would have been seen."""
    return {c.direction.name: _half_width(c, limit) for c in asked.changes if c.direction.kind == kind}


def _unseen(kind: str, halves: dict[str, float]) -> str:
    name, least = min(halves.items(), key=lambda pair: pair[1])
    if not np.isfinite(least):
        return f"these days do not determine {kind}"
    return f"a change of {name} below {least:.0%} would not show"


_CAUSES = {"drag": "fouling", "thrust": "thruster wear", "inertia": "added mass"}


def _named(cause: tuple[str, ...], asked: SpanTest, limit: float) -> Statement:
    names, words = [], []
    for name in cause:
        every = [c for c in asked.changes if c.direction.kind == name]
        sure = [c for c in every if c.p_value <= limit]
        if not every:
            names.append(name)
            words.append(f"a change of {name} explains all, and none of drag, thrust or added mass does")
        elif not sure:
            text = f"something changed; {_CAUSES[name]} would explain it, but no single motion is sure"
            return Statement("cannot tell", (_CAUSES[name],), text)
        else:
            found, text = _WORDING[name](sure, every, limit)
            names.append(found)
            words.append(text)
    return Statement("grew", tuple(names), "; ".join(words))


def _drag(sure: Sequence[Change], every: Sequence[Change], limit: float) -> tuple[str, str]:
    text = ", ".join(map(_with_error, sure))
    if any(c.value < 0 for c in sure):
        return "drag", f"drag changed: {text}; less drag is not fouling (cleaned? another trim?)"
    least = CRITERIA.contradicts * min(c.value for c in sure)
    against = [c.direction.of for c in every if c.value + _half_width(c, limit) < least]
    if against:
        return "drag", f"drag grew: {text}, not in {', '.join(against)}, which fouling would have raised, too"
    if len(sure) == 1 and len(every) > 1:
        return "drag", f"drag grew: {text}; that of other motions is not known well enough to call it fouling"
    return "fouling", f"fouling: {text}"


def _thrust(sure: Sequence[Change], every: Sequence[Change], limit: float) -> tuple[str, str]:
    text = ", ".join(map(_with_error, sure))
    if any(c.value > 0 for c in sure):
        return (
            "thrust",
            f"thrust changed: {text}; more thrust is not wear (another propeller, another supply?)",
        )
    return "thruster wear", f"thruster wear: {text}"


def _inertia(sure: Sequence[Change], every: Sequence[Change], limit: float) -> tuple[str, str]:
    return "added mass", f"added mass changed: {', '.join(map(_with_error, sure))}"


def _with_error(change: Change) -> str:
    error = f"{100 * change.error:.2g}"
    return f"{change.direction.name} {100 * change.value:+.3g} ± {error} %"


_WORDING = {"drag": _drag, "thrust": _thrust, "inertia": _inertia}


def _half_width(change: Change, limit: float) -> float:
    """Half the width of the interval that goes with a chance."""
    if not (np.isfinite(change.error) and change.freedom > 0):
        return np.inf
    return float(-stdtrit(change.freedom, max(limit, 1e-300) / 2) * change.error)


@dataclass(frozen=True)
class Parameter:
    """A parameter over some days."""

    name: str
    unit: str
    # value, error: estimate and standard error, SI, in the sign convention of the vehicle's file; None where
    # the days do not determine it
    value: float | None
    error: float | None


@dataclass(frozen=True)
class Shift:
    """How much something changed against the first month, or over all days."""

    of: str  # "drag in surge", "thrust of f1"
    # percent, error: change and standard error, %; None where the days do not determine it
    percent: float | None
    error: float | None
    p_value: float  # chance of so much by the scatter of the days, before what many tests ask for


@dataclass(frozen=True)
class Period:
    """A month of one vehicle, or all its days."""

    name: str  # month, or "all"
    # days, samples: how many
    days: int
    samples: int
    seconds: float  # time that the logs cover, s
    # root mean square of what the parameters of these days leave, in units of what was counted as noise
    misfit: float
    parameters: tuple[Parameter, ...]
    changes: tuple[Shift, ...]  # against the first month; over all days for "all"
    statement: Statement | None  # the verdict on the changes; None for the first month


@dataclass(frozen=True)
class Score:
    """What one linear step of an effect that the model lacks would take off what the model leaves."""

    effect: str
    share: float  # share of the squares
    # chance of its most certain parameter by the scatter of the days, times the number of parameters that
    # were looked at
    p_value: float


@dataclass(frozen=True)
class VehicleReport:
    """All results for one vehicle."""

    vehicle: str
    whole: Period  # all its days
    months: tuple[Period, ...]
    scores: tuple[Score, ...]  # what its model lacks, the best first
    remarks: tuple[str, ...]  # what speaks against the numbers


@dataclass(frozen=True)
class FleetReport:
    """The report of a fleet."""

    vehicles: tuple[VehicleReport, ...]  # by name
    failed: dict[str, str] = field(default_factory=dict)  # files that nothing is known of, and why
    # files that were left out because another one has the same content, and that one
    twins: dict[str, str] = field(default_factory=dict)
    # done, found: partitions that the report stands on, and that there are
    done: int = 0
    found: int = 0
    worked: int = 0  # partitions that were worked out in this run; the others were known
    unscored: tuple[str, ...] = ()  # effects that one linear step says nothing of

    @property
    def whole(self) -> bool:
        """Whether nothing is missing."""
        return not self.failed

    def plain(self) -> dict[str, Any]:
        """As JSON takes it."""
        return asdict(self)
