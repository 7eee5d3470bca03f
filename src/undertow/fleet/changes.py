"""Partitions put together, and which effect grew from day to day."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr

from undertow.identification.estimation.step import prior_of
from undertow.typing import Array

from .reduction import Panel, Reduced


@dataclass(frozen=True)
class RankLimits:
    """From where on days do not determine a parameter."""

    singular: float = 1e-7  # singular value of the scaled factor, relative to the greatest
    eigen: float = 1e-13  # eigenvalue of products of columns: their rounding is that much coarser
    share: float = 1e-3  # share of a parameter that may lie in what is not determined


_RANK = RankLimits()


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
    """What is known of unknowns beforehand: rows of weight (unknown - centre)."""

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
    fall: float  # how much less the sum of squares is than at zero

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
    kept = s > _RANK.singular * s.max(initial=0.0)
    theta = scale * (V[kept].T @ ((U.T @ target)[kept] / s[kept]))
    covariance = np.outer(scale, scale) * (V[kept].T @ (V[kept] / s[kept, None] ** 2))
    determined = (size > 0) & (np.linalg.norm(V[~kept], axis=0) < _RANK.share)
    grams = np.array([row.T @ row for row in rows])
    whole = np.sum(grams, axis=0) + known.T @ known
    shifts = _without(whole - grams, scale) - theta
    fall = float(2 * theta @ whole[:-1, -1] - theta @ whole[:-1, :-1] @ theta)
    return LeastSquares(theta, covariance, determined, shifts, fall)


def _widened(design: Array) -> Array:
    k, m = design.shape
    wide = np.zeros((k + 1, m + 1))
    wide[:k, :m], wide[k, m] = design, 1.0
    return wide


def _without(grams: Array, scale: Array) -> Array:
    """Unknowns by the products of the columns with one day left out, for every day."""
    value, vector = np.linalg.eigh(grams[:, :-1, :-1] * np.outer(scale, scale))
    kept = value > _RANK.eigen * value.max(axis=1, keepdims=True, initial=0.0)
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
#: Days on either side of a comparison from which scatter can be estimated.
FEWEST_DAYS = 3
_MOTIONS = {"X": "surge", "Y": "sway", "Z": "heave", "K": "roll", "M": "pitch", "N": "yaw"}
_GAIN = "gain_error_"


@dataclass(frozen=True, eq=False)
class Direction:
    """One way in which a vehicle may change."""

    kind: Kind  # "drag", "thrust" or "inertia"
    of: str  # motion, or thruster
    # (k,): change of the columns' parameters for a change of one: drag or added mass as a whole by 100 %
    coefficients: Array

    @property
    def name(self) -> str:
        """What reports call it."""
        kind = {"thrust": "thrust of", "drag": "drag in", "inertia": "added mass in"}[self.kind]
        return f"{kind} {self.of}"


@dataclass(frozen=True)
class Change:
    """How much something changed."""

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
        return min(first, last or first) >= FEWEST_DAYS

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
        alone = {d: c for kind in KINDS for d, c in self._moved(span, self.of(kind)).items()}
        beside = alone | self._moved(span, self.of("drag", "thrust"))
        return [Change(d, *beside[d], two_sided_p(*alone[d])) for d in self.directions]

    def of(self, *kinds: Kind) -> list[Direction]:
        """Directions of some kinds."""
        return [d for d in self.directions if d.kind in kinds]

    def explains_all(self, span: Span, moving: Sequence[Direction], effect: str, limit: float) -> bool:
        """Whether changes of these directions, or of an effect of the catalogue, explain all: the effect
        stands out, and nothing else does beside them, one direction or one kind at a time.
        """
        own = self.panel.own.get(effect, ())
        if own and self._p_value_of(span, own) > limit:
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
        found = self._moved(span, [*moving, *group], own)
        return len(group) * min((two_sided_p(*found[d]) for d in group), default=1.0)

    def _p_value_of(self, span: Span, own: Sequence[str]) -> float:
        """The same of the parameters of an effect that changes by itself."""
        return len(own) * min(two_sided_p(*one) for one in self._estimates(span, [], own))

    def rivals(self) -> list[str]:
        """Effects of the catalogue whose change is neither drag nor thrust nor added mass by another name."""
        drag = {c.id for c in self.panel.candidates if c.effect.scales_with == "drag"}
        return [
            effect
            for effect, own in self.panel.own.items()
            if effect not in drag and not set(own) & set(self._constant)
        ]

    def _moved(
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
