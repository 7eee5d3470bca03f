"""Partitions combined, effects that grew over time, and the verdicts on them, as plain data."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import date
from functools import cached_property
from itertools import combinations
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr, stdtrit

from undertow.identification.estimation.step import prior_of
from undertow.typing import Array

from .reduction import Panel, Reduced


@dataclass(frozen=True)
class EstimationLimits:
    """Thresholds from which parameters, and their scatter from day to day, are determined."""

    singular: float = 1e-7  # singular value of the scaled factor, relative to the greatest
    eigen: float = 1e-13  # eigenvalue of products of columns: their rounding is that much coarser
    share: float = 1e-3  # share of a parameter that may lie in what is not determined
    fewest_days: int = 3  # on either side of a comparison, from which scatter can be estimated


_LIMITS = EstimationLimits()


@dataclass(frozen=True)
class Day:
    """All partitions of a vehicle and day."""

    day: date  # of which day
    factor: Array  # (q, k + 1): their factors stacked in the order of their files
    # samples, entries: rows of the logs and of the regression
    samples: int
    entries: int
    seconds: float  # time that they cover, s

    @cached_property
    def gram(self) -> Array:
        """Products of the columns."""
        return self.factor.T @ self.factor

    @property
    def month(self) -> str:
        """Year and month."""
        return f"{self.day:%Y-%m}"


def days_of(parts: Iterable[tuple[date, Reduced]]) -> list[Day]:
    """Days in order, whatever order the partitions of each came in."""
    found: dict[date, list[Reduced]] = {}
    for day, reduced in parts:
        found.setdefault(day, []).append(reduced)
    return [
        Day(
            day,
            np.vstack([r.factor for r in own]),
            sum(r.samples for r in own),
            sum(r.entries for r in own),
            sum(r.seconds for r in own),
        )
        for day, own in sorted(found.items())
    ]


@dataclass(frozen=True)
class Prior:
    """Prior on the unknowns: rows of weight (unknown - centre)."""

    centre: Array = field(default_factory=lambda: np.zeros(0))
    weight: Array = field(default_factory=lambda: np.zeros(0))

    def beside(self, count: int) -> Prior:
        """The same, and `count` more unknowns of which nothing is known."""
        return Prior(np.pad(self.centre, (0, count)), np.pad(self.weight, (0, count)))


@dataclass(frozen=True)
class LeastSquares:
    """Least squares over days."""

    theta: Array  # (m,): unknowns
    covariance: Array  # (m, m): of the noise alone
    determined: NDArray[np.bool_]  # (m,): whether the days determine each
    shifts: Array  # (days, m): what leaving out each day does to the unknowns
    reduction: float  # how much less the sum of squares is than at zero

    def variance_of(self, days: Sequence[int] | slice = slice(None)) -> Array:
        """Jackknife variance by these days; they count as independent of each other."""
        count = len(self.shifts)
        return np.asarray(np.sum(self.shifts[days] ** 2, axis=0) * (count - 1) / max(count, 1))

    @property
    def errors(self) -> Array:
        """Standard errors: the scatter from day to day, and never less than noise alone gives."""
        least = np.diag(self.covariance)
        error = np.sqrt(np.maximum(self.variance_of(), least))
        return np.where(self.determined, error, np.inf)


def solve(days: Sequence[Day], designs: Sequence[Array], prior: Prior) -> LeastSquares:
    """Least squares for unknowns that stand for the columns of every day.

    `prior`: of the unknowns, shape (m,).
    """
    wide = [_widened(design) for design in designs]
    rows = [day.factor @ w for day, w in zip(days, wide, strict=True)]
    known = np.column_stack([np.diag(prior.weight), prior.weight * prior.centre])
    factor = np.asarray(np.linalg.qr(np.vstack([*rows, known]), mode="r"))
    H, target = factor[:, :-1], factor[:, -1]
    size = np.linalg.norm(H, axis=0)
    scale = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0)
    U, s, V = np.linalg.svd(H * scale, full_matrices=False)
    kept = s > _LIMITS.singular * s.max(initial=0.0)
    theta = scale * (V[kept].T @ ((U.T @ target)[kept] / s[kept]))
    covariance = np.outer(scale, scale) * (V[kept].T @ (V[kept] / s[kept, None] ** 2))
    determined = (size > 0) & (np.linalg.norm(V[~kept], axis=0) < _LIMITS.share)
    grams = np.array([row.T @ row for row in rows])
    whole = np.sum(grams, axis=0) + known.T @ known
    shifts = _without(whole - grams, scale) - theta
    reduction = float(2 * theta @ whole[:-1, -1] - theta @ whole[:-1, :-1] @ theta)
    return LeastSquares(theta, covariance, determined, shifts, reduction)


def _widened(design: Array) -> Array:
    k, m = design.shape
    wide = np.zeros((k + 1, m + 1))
    wide[:k, :m], wide[k, m] = design, 1.0
    return wide


def _without(grams: Array, scale: Array) -> Array:
    """Unknowns by the products of the columns with one day left out, for every day."""
    value, vector = np.linalg.eigh(grams[:, :-1, :-1] * np.outer(scale, scale))
    kept = value > _LIMITS.eigen * value.max(axis=1, keepdims=True, initial=0.0)
    along = np.einsum("dji,dj->di", vector, scale * grams[:, :-1, -1])
    solution = np.divide(along, value, out=np.zeros_like(along), where=kept)
    return np.asarray(scale * np.einsum("dij,dj->di", vector, solution))


def selection(names: Sequence[str], wanted: Sequence[str]) -> Array:
    """Selection matrix: the unknowns are the coefficients of some of the columns."""
    table = np.zeros((len(names), len(wanted)))
    table[[names.index(n) for n in wanted], np.arange(len(wanted))] = 1.0
    return table


def by_month(days: Sequence[Day]) -> Mapping[str, list[Day]]:
    """Days of every month, in order."""
    found: dict[str, list[Day]] = {}
    for day in days:
        found.setdefault(day.month, []).append(day)
    return found


Profile = Callable[[Day], float]
Kind = Literal["drag", "thrust", "inertia"]
KINDS: tuple[Kind, ...] = ("drag", "thrust", "inertia")
_MOTIONS = {"X": "surge", "Y": "sway", "Z": "heave", "K": "roll", "M": "pitch", "N": "yaw"}
_GAIN = "gain_error_"


@dataclass(frozen=True, eq=False)
class Direction:
    """One way in which a vehicle may change."""

    kind: Kind  # "drag", "thrust" or "inertia"
    of: str  # motion, or thruster
    # (k,): change of the columns' parameters for a change of one: drag or added mass as a whole by 100%
    coefficients: Array

    @property
    def name(self) -> str:
        """What reports call it."""
        kind = {"thrust": "thrust of", "drag": "drag in", "inertia": "added mass in"}[self.kind]
        return f"{kind} {self.of}"


@dataclass(frozen=True)
class Change:
    """Size of a change."""

    direction: Direction
    # relative change over the whole span: 0.1 is ten per cent more. Drag and thrust are free side by side,
    # inertia being as it was; inertia is free by itself
    value: float
    error: float  # its standard error; inf where the days do not determine it
    freedom: float  # degrees of freedom of the standard error
    alone: float  # p-value if nothing but its own kind may have changed

    @property
    def p_value(self) -> float:
        """p-value by the scatter of the days, drag and thrust being free side by side."""
        return two_sided_p(self.value, self.error, self.freedom)


@dataclass(frozen=True)
class Span:
    """Days that are compared."""

    days: tuple[Day, ...]
    profile: Profile  # for a day its place from 0 (as at first) to 1 (as at last)
    groups: tuple[int, int]  # days at the beginning and at the end; for a trend, all days and none

    @property
    def enough(self) -> bool:
        """Whether there are days enough to distinguish a change from scatter."""
        first, last = self.groups
        return min(first, last or first) >= _LIMITS.fewest_days

    def freedom(self, found: LeastSquares, places: slice) -> Array:
        """Degrees of freedom of the standard errors, by Welch and Satterthwaite where two groups are held
        against each other.
        """
        first, last = self.groups
        if not last:
            return np.full(places.stop - places.start, float(first - 2))
        a, b = (found.variance_of(s)[places] for s in (slice(0, first), slice(first, None)))
        spread = a**2 / (first - 1) + b**2 / (last - 1)
        free = np.divide((a + b) ** 2, spread, out=np.full(len(a), 1.0), where=spread > 0)
        return np.clip(free, 1.0, first + last - 2)


def trend(days: Sequence[Day]) -> Span:
    """All days, with a change that is proportional to time."""
    first, last = days[0].day, days[-1].day
    length = max((last - first).days, 1)
    return Span(tuple(days), lambda day: (day.day - first).days / length, (len(days), 0))


def shift(before: Sequence[Day], after: Sequence[Day]) -> Span:
    """Later days against earlier ones."""
    border = after[0].day
    return Span((*before, *after), lambda day: float(day.day >= border), (len(before), len(after)))


class ChangeTests:
    """Tests of one vehicle."""

    def __init__(self, panel: Panel) -> None:
        self.panel, self.names = panel, panel.names
        self.directions = (*self._of_kind("drag"), *self._thrust(), *self._of_kind("inertia"))
        gains = [n for n in self.names if n.startswith(_GAIN) and n not in panel.free]
        self._constant = [*panel.free, *gains]

    # --- what may change ----------------------------------------------------------------------
    def _of_kind(self, kind: Literal["drag", "inertia"]) -> list[Direction]:
        """One direction for each motion: all its coefficients grow by the same share."""
        owned = {p.name for e in self.panel.vehicle.effects if e.scales_with == kind for p in e.parameters}
        found: dict[str, Array] = {}
        for name in self.panel.free:
            if self.panel.vehicle.declaration(name).name in owned:
                row = found.setdefault(name[0], np.zeros(len(self.names)))
                row[self.names.index(name)] = self.panel.vehicle.value_of(name).value
        return [Direction(kind, _MOTIONS[n], row) for n, row in found.items() if n in _MOTIONS and row.any()]

    def _thrust(self) -> list[Direction]:
        found = []
        for thruster in self.panel.vehicle.thrusters:
            name = f"{_GAIN}{thruster.name}"
            if name in self.names:
                row = np.zeros(len(self.names))
                stated = self.panel.vehicle.value_of(name).value if name in self.panel.free else 0.0
                row[self.names.index(name)] = 1.0 + stated
                found.append(Direction("thrust", thruster.name, row))
        return found

    @property
    def unseen(self) -> list[str]:
        """Kinds of change that cannot be estimated, because the file marks no parameter for it."""
        kinds = {d.kind for d in self.directions}
        names = {"drag": "drag (no damping coefficient is marked with estimate)", "thrust": "thrust"}
        return [words for kind, words in names.items() if kind not in kinds]

    # --- tests --------------------------------------------------------------------------------
    def over(self, span: Span) -> list[Change]:
        """Change of every direction."""
        if not span.enough:
            return []
        alone = {d: c for kind in KINDS for d, c in self._changed_together(span, self.of(kind)).items()}
        beside = alone | self._changed_together(span, self.of("drag", "thrust"))
        return [Change(d, *beside[d], two_sided_p(*alone[d])) for d in self.directions]

    def of(self, *kinds: Kind) -> list[Direction]:
        """Directions of some kinds."""
        return [d for d in self.directions if d.kind in kinds]

    def explains_all(self, span: Span, moving: Sequence[Direction], effect: str, limit: float) -> bool:
        """Whether changes of these directions, or of an effect of the catalogue, explain all: the effect is
        significant, and given them nothing else is, one direction or one kind at a time.
        """
        own = self.panel.own.get(effect, ())
        if own and len(own) * min(two_sided_p(*one) for one in self._estimates(span, [], own)) > limit:
            return False
        kinds = {d.kind for d in moving}
        beside = [[d] for d in self.directions if d not in moving]
        # With all three kinds free, drag, thrust and inertia that all grow alike could not be seen.
        beside += [self.of(k) for k in KINDS if k not in kinds and len(kinds) < 2]
        return all(self._smallest_p(span, moving, group, own) > limit for group in beside)

    def _smallest_p(
        self, span: Span, moving: Sequence[Direction], group: Sequence[Direction], own: Sequence[str]
    ) -> float:
        """Smallest p-value of some directions beside others, times how many they are (Bonferroni)."""
        found = self._changed_together(span, [*moving, *group], own)
        return len(group) * min((two_sided_p(*found[d]) for d in group), default=1.0)

    def rivals(self) -> list[str]:
        """Effects of the catalogue whose change is neither drag nor thrust nor added mass by another name."""
        drag = {c.id for c in self.panel.candidates if c.effect.scales_with == "drag"}
        return [
            effect
            for effect, own in self.panel.own.items()
            if effect not in drag and not set(own) & set(self._constant)
        ]

    def _changed_together(
        self, span: Span, moving: Sequence[Direction], beside: Sequence[str] = ()
    ) -> dict[Direction, tuple[float, float, float]]:
        """Value, standard error and degrees of freedom of directions that change together."""
        return dict(zip(moving, self._estimates(span, moving, beside), strict=False)) if moving else {}

    def _estimates(
        self, span: Span, moving: Sequence[Direction], beside: Sequence[str]
    ) -> list[tuple[float, float, float]]:
        """The same of directions, then of parameters of an effect beside them; unknowns are what is the same
        on all days, then what changes.
        """
        still = selection(self.names, self._constant)
        other = selection(self.names, list(beside))
        change = np.column_stack([*(d.coefficients for d in moving), other])
        wide = [np.column_stack([still, span.profile(day) * change, other]) for day in span.days]
        solved = solve(span.days, wide, self.prior.beside(wide[0].shape[1] - len(self.panel.free)))
        places = slice(len(self._constant), len(self._constant) + change.shape[1])
        numbers = (solved.theta[places], solved.errors[places], span.freedom(solved, places))
        return list(zip(*(n.tolist() for n in numbers), strict=True))

    @property
    def prior(self) -> Prior:
        """What the vehicle file states of the free parameters, counted from its values."""
        centre, weight = prior_of(self.panel.base)
        stated = np.array([self.panel.vehicle.value_of(n).value for n in self.panel.free])
        return Prior(centre - stated, weight)


def two_sided_p(value: float, error: float, freedom: float) -> float:
    """Two-sided p-value of an estimate by Student's t; 1 where its standard error says nothing."""
    if not (np.isfinite(error) and error > 0 and freedom > 0):
        return 1.0
    return float(2 * stdtr(freedom, -abs(value) / error))


# --- verdicts ------------------------------------------------------------------------------------------
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
    """Conclusion from the days."""

    answer: Answer  # "grew" (something changed, and it is known what), "none seen" or "cannot tell"
    # what changed, by name: "fouling", "thruster wear", "drag", "thrust", "added mass"; where it cannot be
    # told which, all that it may be
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

    p-values are corrected by Holm's rule over all tests in all spans, jointly with other directions and
    alone: twice as many as there are changes.
    """
    every = [c.p_value for a in asked for c in a.changes] + [c.alone for a in asked for c in a.changes]
    limit = holm(every, CRITERIA.alpha)
    return [_statement(a, limit) for a in asked]


def holm(p_values: Sequence[float], alpha: float) -> float:
    """Largest p-value that is still significant after correction for all; less than any if none is.

    Step-down: the k-th smallest of m is held against alpha / (m - k + 1), until one fails.
    """
    ordered = np.sort(p_values)
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
        return Statement(
            "cannot tell", (), "something changed, but no cause that was tried explains all of it"
        )
    common = tuple(name for name in causes[0] if all(name in cause for cause in causes))
    if not common:
        names = tuple(dict.fromkeys(_CAUSES.get(name, name) for cause in causes for name in cause))
        return Statement("cannot tell", names, f"something changed; cannot tell which: {_listed(causes)}")
    text = _named(common, asked, limit)
    rest = [tuple(n for n in cause if n not in common) for cause in causes]
    if not all(rest):
        return text
    return replace(text, words=f"{text.words}; or {_listed(rest)}: cannot tell which")


def _listed(causes: Sequence[tuple[str, ...]]) -> str:
    text = [" with ".join(_CAUSES.get(n, n) for n in cause) for cause in causes]
    more = [f"{len(text) - CRITERIA.shown} more"] if len(text) > CRITERIA.shown else []
    return " or ".join([*text[: CRITERIA.shown], *more])


def _causes(asked: SpanTest, limit: float) -> list[tuple[str, ...]]:
    """The fewest kinds, or the effects of the catalogue, whose change explains all; all that do so.

    A single cause that explains all is preferred to two. A cause is excluded if, given it, something else is
    significant at 1%.
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
    text = f"{first} days" if not last else f"{first} days before and {last} in this month"
    return f"{text}, at least {_LIMITS.fewest_days} are needed to estimate the day-to-day scatter"


def _nothing(asked: SpanTest, limit: float) -> Statement:
    """Nothing significant: because nothing changed, or because it would not have been detected."""
    kinds = [k for k in KINDS if k != "inertia" and any(c.direction.kind == k for c in asked.changes)]
    halves = {k: _half_widths(asked, k, limit) for k in kinds}
    seen = {n: v for own in halves.values() for n, v in own.items() if v <= CRITERIA.worth}
    text = ", ".join(f"{n} {100 * v:.2g}" for n, v in seen.items())
    open_ = [_unseen(kind, own) for kind, own in halves.items() if min(own.values()) > CRITERIA.worth]
    likely = [c for c in asked.changes if min(c.p_value, c.alone) <= CRITERIA.alpha]
    if seen and not open_ and not likely:
        return Statement("none seen", (), f"no change seen; smallest detectable changes, %: {text}")
    words = _possible(likely) + open_
    if not words:
        return Statement("cannot tell", (), "cannot tell: these days determine neither drag nor thrust")
    rest = f"; otherwise no change seen; smallest detectable changes, %: {text}" if seen else ""
    return Statement("cannot tell", (), f"cannot tell: {'; '.join(words)}{rest}")


def _possible(likely: Sequence[Change]) -> list[str]:
    """Possible changes: those significant given the other kinds, else those significant alone."""
    beside = [c for c in likely if c.p_value <= CRITERIA.alpha]
    if beside or not likely:
        return [f"{_with_error(c)} may be a change, but is not significant" for c in beside]
    names = " or ".join(c.direction.name for c in likely)
    return [f"something may have changed ({names}), but it is not significant"]


def _half_widths(asked: SpanTest, kind: str, limit: float) -> dict[str, float]:
    """Smallest detectable change of each direction of a kind."""
    return {c.direction.name: _half_width(c, limit) for c in asked.changes if c.direction.kind == kind}


def _unseen(kind: str, halves: dict[str, float]) -> str:
    name, least = min(halves.items(), key=lambda pair: pair[1])
    if not np.isfinite(least):
        return f"these days do not determine {kind}"
    return f"a change of {name} below {least:.0%} would not be detected"


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
            text = f"something changed; {_CAUSES[name]} would explain it, but no single motion is significant"
            return Statement("cannot tell", (_CAUSES[name],), text)
        else:
            found, text = _WORDING[name](sure, every, limit)
            names.append(found)
            words.append(text)
    return Statement("grew", tuple(names), "; ".join(words))


def _drag(sure: Sequence[Change], every: Sequence[Change], limit: float) -> tuple[str, str]:
    text = ", ".join(map(_with_error, sure))
    if any(c.value < 0 for c in sure):
        return "drag", f"drag changed: {text}; less drag is not fouling (cleaned? different trim?)"
    least = CRITERIA.contradicts * min(c.value for c in sure)
    against = [c.direction.of for c in every if c.value + _half_width(c, limit) < least]
    if against:
        return "drag", f"drag grew: {text}, not in {', '.join(against)}, which fouling would also have raised"
    if len(sure) == 1 and len(every) > 1:
        return "drag", f"drag grew: {text}; that of other motions is not known well enough to call it fouling"
    return "fouling", f"fouling: {text}"


def _thrust(sure: Sequence[Change], every: Sequence[Change], limit: float) -> tuple[str, str]:
    text = ", ".join(map(_with_error, sure))
    if any(c.value > 0 for c in sure):
        return ("thrust", f"thrust changed: {text}; more thrust is not wear (new propeller, new battery?)")
    return "thruster wear", f"thruster wear: {text}"


def _inertia(sure: Sequence[Change], every: Sequence[Change], limit: float) -> tuple[str, str]:
    return "added mass", f"added mass changed: {', '.join(map(_with_error, sure))}"


def _with_error(change: Change) -> str:
    error = f"{100 * change.error:.2g}"
    return f"{change.direction.name} {100 * change.value:+.3g} ± {error}%"


_WORDING = {"drag": _drag, "thrust": _thrust, "inertia": _inertia}


def _half_width(change: Change, limit: float) -> float:
    """Half-width of the confidence interval at a level."""
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
    """Change relative to the first month, or over all days."""

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
    """Reduction of the residual by one linear step of an effect that the model lacks."""

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
