"""A gain set on its vehicle, in numbers that conditions can be evaluated on, uncertainty included."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
import sympy as sm
from scipy.optimize import brentq
from scipy.special import chdtri, ndtri

from undertow.control.gains import GainSet
from undertow.control.plant import Plant
from undertow.errors import UndertowError
from undertow.model.composition import function_of
from undertow.model.parameter import printed
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Flags, number_array

from .attitude import Attitudes, Certificate, Interval, margin_bound, transposed
from .by_law import CONDITIONS, Condition, Quantities


@dataclass(frozen=True)
class SearchSettings:
    """How finely conditions are searched through and sampled."""

    low: float = 1e-9  # least iota, 1/s, or gain, SI, that is looked at; what holds there holds down to zero
    high: float = 1e9  # largest one; what holds there holds without end
    points: int = 19  # points in between at first, one for each power of ten
    refined_points: int = 9  # points between the neighbours of the best one, again and again
    tolerance: float = 1e-8  # relative distance of neighbours that is close enough
    edge_tolerance: float = 1e-14  # the same of the ends of a range, absolute and relative, of the logarithm
    rounding: float = 1e-12  # of margins, relative to the largest at any attitude
    singular: float = 1e-12  # least eigenvalue of a mass matrix, relative to the largest, that is none
    flat: float = 1e-14  # the same of a covariance: the parameters do not move along its vector
    unchanged: float = 1e-9  # relative change of a parameter that is not mentioned
    heading_step: int = 10  # between headings of the loop at rest, degrees
    headings: int = 7  # samples of half a turn, after which J M J' is the same: every 30 degrees
    tilts: int = 7  # samples of roll and of pitch: every 20 degrees at the range of conditions unless stated
    max_corners: int = 12  # of more parameters than this the corners (two to this power) are not tried
    # Largest roll and pitch that are covered unless stated, and that can be, degrees: at 90 of pitch J has no
    # inverse.
    tilt: float = 60.0
    tilt_range: tuple[float, float] = (1.0, 85.0)
    confidence: float = 0.95  # of intervals and ellipsoids unless stated, and
    confidence_range: tuple[float, float] = (0.5, 0.9999)  # what can be
    sides: int = 96  # sides of the polygon around an ellipse of parameters: 0.05% larger than the ellipse


SEARCH = SearchSettings()


@dataclass(frozen=True)
class Affine:
    """A matrix that depends on parameters: constant + sum of theta_j slopes_j."""

    constant: Any  # shape (n, n), numbers or intervals
    slopes: Array  # derivative in each parameter, shape (n_parameters, n, n)

    def at(self, theta: Array) -> Array:
        """The matrix for parameters of shape (..., n_parameters)."""
        return self.constant + np.tensordot(theta, self.slopes, axes=1)


@dataclass(frozen=True)
class SignSet:
    """The plant at rest while every velocity that switches parameters keeps one sign."""

    name: str  # "forward", "backward", or the signs of the velocities where they are mixed
    signs: Mapping[sm.Symbol, int]  # 1 or -1 by velocity
    names: tuple[str, ...]  # parameters that M and D depend on here
    theta: Array  # their values, SI, SNAME signs, shape (n_parameters,)
    M: Affine  # inertia, body frame, shape (n, n)
    D: Affine  # damping at rest, body frame, shape (n, n)

    @property
    def inertia(self) -> Array:
        """M with the values of the file."""
        return self.M.at(self.theta)

    @property
    def damping(self) -> Array:
        """D at rest with the values of the file."""
        return self.D.at(self.theta)


def sign_sets(plant: Plant) -> list[SignSet]:
    """All sign sets of a plant: all forward and all backward first, then the mixed ones."""
    cases = [
        dict(zip(plant.reversing, w, strict=True)) for w in product((1, -1), repeat=len(plant.reversing))
    ]
    cases.sort(key=lambda signs: len(set(signs.values())) > 1)
    at_rest = _at_rest(plant)
    found = [_sign_set(plant, signs, *at_rest) for signs in cases]
    for sign_set in found:
        of = f" ({sign_set.name})" if sign_set.name else ""
        dofs = plant.vehicle.degrees_of_freedom
        if not np.isfinite(sign_set.damping).all():
            raise UndertowError(f"damping at rest{of} is not finite: conditions need it; check [effects]")
        values, vectors = np.linalg.eigh(sign_set.inertia)
        if values[0] <= SEARCH.singular * max(values[-1], 1e-300):
            worst = dofs[int(np.argmax(np.abs(vectors[:, 0])))]
            raise UndertowError(
                f"the mass matrix of '{plant.vehicle.name}'{of} is singular or not positive definite, about "
                f"{worst}: give {worst} inertia in [effects.rigid_body] or leave it out"
            )
    return found


def _at_rest(plant: Plant) -> tuple[list[sm.Symbol], Callable[..., Any]]:
    """The parameters of M and D at rest, and both with all of their slopes as a function of the signs."""
    rest = dict.fromkeys(plant.nu, sm.Integer(0))
    signs = {sm.sign(v): sm.Symbol(f"sign_{v}") for v in plant.reversing}
    both = sm.Matrix.hstack(*(m.xreplace(signs).xreplace(rest) for m in (plant.M, plant.D)))
    names = sorted(both.free_symbols & set(plant.numbers), key=str)
    every = [
        _substituted(m, plant.numbers, set(signs.values())) for m in (both, *(both.diff(x) for x in names))
    ]
    return names, function_of([*signs.values()], [m.tolist() for m in every])


def _substituted(matrix: sm.Matrix, numbers: Mapping[sm.Symbol, sm.Expr], known: set[sm.Symbol]) -> sm.Matrix:
    filled = matrix.xreplace(numbers)
    if filled.free_symbols - known:
        names = ", ".join(sorted(map(str, filled.free_symbols - known)))
        raise UndertowError(f"inertia or damping at rest depends on {names}: conditions need constant ones")
    return filled


def _sign_set(
    plant: Plant, signs: Mapping[sm.Symbol, int], names: list[sm.Symbol], values: Callable[..., Any]
) -> SignSet:
    """Parameters enter linearly nearly always, else this is the tangent at the values of the file."""
    found = np.array(values(*map(float, signs.values())), dtype=float)
    used = [k for k in range(len(names)) if found[k + 1].any()]
    theta, n = np.array([float(plant.numbers[names[k]]) for k in used]), len(plant.nu)
    slopes = found[1:][used]
    constant = found[0] - np.tensordot(theta, slopes, 1)
    M, D = (Affine(constant[:, p], slopes[:, :, p]) for p in (slice(n), slice(n, None)))
    return SignSet(_name(signs), signs, tuple(str(names[k]) for k in used), theta, M, D)


def _name(signs: Mapping[sm.Symbol, int]) -> str:
    distinct = set(signs.values())
    if len(distinct) > 1:
        return ", ".join(f"{v} {'>' if s > 0 else '<'} 0" for v, s in signs.items())
    return {1: "forward", -1: "backward"}.get(next(iter(distinct), 0), "")


def _hull(sets: Sequence[SignSet]) -> SignSet:
    """Every inertia and damping between those of some sets, entry by entry, with the values of the file."""
    fixed = np.zeros((0, *sets[0].inertia.shape))
    M, D = (
        Affine(Interval(np.min(own, axis=0), np.max(own, axis=0)), fixed)
        for own in ([sign_set.inertia for sign_set in sets], [sign_set.damping for sign_set in sets])
    )
    return SignSet("", {}, (), np.zeros(0), M, D)


def _stacked(sets: Sequence[SignSet]) -> SignSet:
    """The matrices of some sets along a first axis, before those of iotas and attitudes."""
    M, D = (
        Affine(np.array(own)[:, None, None], np.zeros((0, 1, 1)))
        for own in ([sign_set.inertia for sign_set in sets], [sign_set.damping for sign_set in sets])
    )
    return SignSet("", {}, (), np.zeros(0), M, D)


Span = tuple[float, float]
ParameterBox = Mapping[sm.Symbol, Span]
"""Intervals of parameters, SI and SNAME signs."""
EXACT_PARAMETERS: ParameterBox = {}

Margins = Callable[[Array], Array]
"""Margins of many values at once: of one positive number, or of parameters, which they are concave in."""


def where_positive(margins: Margins, concave: bool = True) -> Span | None:
    """The interval on which a margin of one positive number is positive, or None.

    The margin rises and then falls (either part may be missing). Where it is concave, as conditions are in
    iota, the search ends as soon as three points say that it is positive nowhere. An interval that reaches an
    end of the range is open there; 0 or infinity is returned for it.
    """
    low, high = math.log(SEARCH.low), math.log(SEARCH.high)

    def decided(x: Array, values: Array, best: int) -> bool:
        return bool(values[best] > 0) or (concave and _nowhere_positive(x, values, best))

    peak, value = _peak(margins, decided)
    if not value > 0:
        return None
    return _edge(margins, peak, low, 0.0), _edge(margins, peak, high, math.inf)


def best_iota(margins: Margins) -> float:
    """Where such a margin is largest."""
    return math.exp(_peak(margins)[0])


def _peak(
    margins: Margins, decided: Callable[[Array, Array, int], bool] = lambda *_: False
) -> tuple[float, float]:
    """Logarithm and value of the largest margin: between the neighbours of the best point of a grid."""
    low, high, count = math.log(SEARCH.low), math.log(SEARCH.high), SEARCH.points
    while True:
        grid = np.linspace(low, high, count)
        values = margins(np.exp(grid))
        best = int(np.argmax(values))
        low, high = float(grid[max(best - 1, 0)]), float(grid[min(best + 1, count - 1)])
        if high - low < SEARCH.tolerance or decided(np.exp(grid), values, best):
            return float(grid[best]), float(values[best])
        count = SEARCH.refined_points


def _nowhere_positive(x: Array, values: Array, best: int) -> bool:
    """Whether the chords beside the best point, prolonged, keep a concave margin below zero."""
    if not 0 < best < len(x) - 1:
        return False
    steps, rises = np.diff(x[best - 1 : best + 2]), np.diff(values[best - 1 : best + 2])
    most = max(-rises[1] * steps[0] / steps[1], rises[0] * steps[1] / steps[0])
    return bool(values[best] + most < 0)


def _edge(margins: Margins, peak: float, end: float, beyond: float) -> float:
    def margin(x: float) -> float:
        return float(margins(np.exp([x]))[0])

    close = SEARCH.edge_tolerance
    return beyond if margin(end) > 0 else math.exp(brentq(margin, end, peak, xtol=close, rtol=close))


def interior_point(span: Span) -> float:
    """A number well within an interval."""
    low, high = span
    if low == 0.0 and math.isinf(high):
        return 1.0
    if low == 0.0:
        return high / 2
    return 2 * low if math.isinf(high) else math.sqrt(low * high)


class Problem:
    """The margins of every condition of a law, for roll and pitch up to `tilt`, rad.

    A region has to hold for every parameter in `parameter_box`; conditions have the values of the file.
    """

    def __init__(
        self,
        gains: GainSet,
        tilt: float = math.radians(SEARCH.tilt),
        parameter_box: ParameterBox = EXACT_PARAMETERS,
    ) -> None:
        low, high = SEARCH.tilt_range
        degrees = round(math.degrees(tilt), 9)
        if not low <= degrees <= high:
            raise UndertowError(
                f"conditions cannot cover roll and pitch up to {degrees:g} deg: give {low:g} to {high:g}"
            )
        self.gains, self.plant, self.parameter_box = gains, gains.plant, parameter_box
        self.coordinates = gains.signals.coordinates
        self.conditions: tuple[Condition, ...] = CONDITIONS[gains.law.id]
        self.sets: list[SignSet] = sign_sets(gains.plant)
        self.values = {
            g.name: np.array([gains.values[str(g.symbol(c))] for c in self.coordinates])
            for g in type(gains.law).gains
        }
        self.attitudes = Attitudes(gains.plant, tilt, self.equal_gains(("x", "y", "z")))

    def with_gains(self, values: dict[str, Array]) -> Problem:
        """The same with other gains."""
        other = object.__new__(Problem)
        other.__dict__.update(self.__dict__)
        other.values = values
        return other

    def with_forms(self, forms: Sequence[str]) -> Problem:
        """The same with the conditions of some forms only; with all where none is named."""
        other = self.with_gains(self.values)
        other.conditions = tuple(c for c in self.conditions if not forms or c.form in forms)
        if not other.conditions:
            raise UndertowError(
                f"law '{self.gains.law.id}' has no conditions of the form {' or '.join(forms)}: it has "
                f"{' and '.join(dict.fromkeys(c.form for c in self.conditions))}"
            )
        return other

    @property
    def size(self) -> int:
        """Number of pose coordinates."""
        return len(self.coordinates)

    @property
    def driven(self) -> list[int]:
        """Coordinates that the law drives: unactuated axes have gains only if the file states them."""
        return [i for i in range(self.size) if all(v[i] for v in self.values.values())]

    @cached_property
    def relevant_sets(self) -> list[SignSet]:
        """The sign sets that matter: where no axis meets another the mixed ones add nothing to the first two.

        Diagonal M and D are not enough: an attitude that gains do not commute with mixes the axes.
        """
        return self.sets[:2] if self.decoupled and self.attitudes.invariant(self.yaw_invariant) else self.sets

    @cached_property
    def decoupled(self) -> bool:
        """Whether M and D are diagonal, so that every axis is a channel of its own at rest."""
        matrices = [m for signs in self.sets for m in (signs.inertia, signs.damping)]
        return all(np.array_equal(m, np.diag(np.diag(m))) for m in matrices)

    @property
    def yaw_invariant(self) -> bool:
        """Whether no gain tells north from east, so that the heading changes no eigenvalue."""
        return self.equal_gains(("x", "y")) or not {"x", "y"} & set(self.coordinates)

    @property
    def heading_matters(self) -> bool:
        """Whether the loop at rest can differ between headings: gains tell north from east, and it turns."""
        return not self.yaw_invariant and {"x", "y", "psi"} <= set(self.coordinates)

    @cached_property
    def headings(self) -> list[tuple[float, Array]]:
        """Headings to try, degrees, with J on an even keel; the loop at rest repeats after half a turn."""
        degrees = map(float, range(0, 180, SEARCH.heading_step) if self.heading_matters else [0])
        inverses = ((d, self.attitudes.at({"psi": float(np.radians(d))})) for d in degrees)
        return [(d, np.asarray(np.linalg.inv(inverse), dtype=float)) for d, inverse in inverses]

    @property
    def channels(self) -> list[tuple[int, int, str]]:
        """Coordinate, axis and name of each channel; x and y change axes for a vehicle that heads east."""
        own = [(i, i, self.coordinates[i]) for i in self.driven]
        if not self.heading_matters:
            return own
        x, y = (self.coordinates.index(c) for c in ("x", "y"))
        return [*own, (x, y, "x heading east"), (y, x, "y heading east")]

    def equal_gains(self, coordinates: tuple[str, ...]) -> bool:
        """Whether the vehicle has these coordinates, and every gain is the same for all of them."""
        if not set(coordinates) <= set(self.coordinates):
            return False
        places = [self.coordinates.index(c) for c in coordinates]
        return all(len({float(v[i]) for i in places}) == 1 for v in self.values.values())

    @cached_property
    def sampled_attitudes(self) -> list[tuple[dict[str, float], Array]]:
        """Attitudes spread over the range with J^-1, to choose iota by and to estimate the region at."""
        angles = self.attitudes.angles(self.yaw_invariant)
        if self.attitudes.invariant(self.yaw_invariant):
            return [({}, self.attitudes.at({}))]
        pairs = zip(angles, self.attitudes.box(angles), strict=True)
        axes = [
            np.linspace(-np.pi / 2, np.pi / 2, SEARCH.headings)
            if a == "psi"
            else np.linspace(low, high, SEARCH.tilts)
            for a, (low, high) in pairs
        ]
        rows = np.stack([g.ravel() for g in np.meshgrid(*axes)], axis=1)
        points = [dict(zip(angles, map(float, row), strict=True)) for row in rows]
        return [(point, self.attitudes.at(point)) for point in points]

    @cached_property
    def _sampled_inverses(self) -> Array:
        return np.array([inverse for _, inverse in self.sampled_attitudes])

    @property
    def few_inverses(self) -> Array:
        """Some attitudes for what has to be tried with many parameters, shape (k, n, n)."""
        return self._sampled_inverses[:: max(1, len(self._sampled_inverses) // 8)]

    # --- margins ------------------------------------------------------------------------------
    def quantities(
        self, signs: SignSet, inverse: Any, iota: float | Array | None, theta: Array | None = None
    ) -> Quantities:
        """All quantities in the pose coordinates that are driven, for J^-1 as numbers or intervals."""
        theta = signs.theta if theta is None else theta
        driven = self.driven
        gains = {name: np.diag(v[driven]) for name, v in self.values.items()}
        columns = inverse[..., driven]
        M, D = (transposed(columns) @ m.at(theta) @ columns for m in (signs.M, signs.D))
        return Quantities({**gains, "M": M, "D": D, "iota": iota})

    def channel_quantities(
        self, signs: SignSet, i: int, iota: Any, theta: Array | None = None, axis: int | None = None
    ) -> Quantities:
        """The quantities of one channel at rest on an even keel, shape (..., 1, 1).

        A coordinate acts on its own axis (heading north) unless another one is given.
        """
        theta = signs.theta if theta is None else theta
        k = i if axis is None else axis
        gains = {name: v[i].reshape(1, 1) for name, v in self.values.items()}
        M, D = (m.at(theta)[..., k : k + 1, k : k + 1] for m in (signs.M, signs.D))
        return Quantities({**gains, "M": M, "D": D, "iota": iota})

    def margins(
        self,
        condition: Condition,
        signs: SignSet,
        iotas: Array,
        channel: int | None = None,
        few: bool = False,
    ) -> Array:
        """Margins of a condition for many iotas: of a channel, or as matrices the least over attitudes."""
        if channel is not None:
            quantities = self.channel_quantities(signs, channel, iotas[:, None, None])
            return np.broadcast_to(condition.margin(quantities), len(iotas))
        inverses = self.few_inverses if few else self._sampled_inverses
        return self._margins_by_iota(condition, signs, iotas, inverses).min(axis=1)

    def _margins_by_iota(self, condition: Condition, signs: SignSet, iotas: Array, inverses: Array) -> Array:
        """Margins for every iota at every attitude, shape (iotas, attitudes)."""
        found = condition.margin(self.quantities(signs, inverses, iotas[:, None, None, None]))
        return np.broadcast_to(found, (len(iotas), len(inverses)))

    def margin(
        self, condition: Condition, signs: SignSet, iota: float | None, channel: int | None = None
    ) -> float:
        """The margin for one iota; any where the condition has none."""
        return float(self.margins(condition, signs, np.array([1.0 if iota is None else iota]), channel)[0])

    def certificate(self, condition: Condition, signs: SignSet, iota: float | None) -> Certificate:
        """The margin over all attitudes in one sign set, with its proof."""

        def margins(inverse: Any) -> Array:
            return self._margins_at(condition, signs, inverse, iota)

        return margin_bound(margins, self.attitudes, self.yaw_invariant, bool(condition.uses))

    def proved(self, condition: Condition, sets: Sequence[SignSet], iota: float | None) -> bool:
        """Whether a condition is proved over all attitudes in all of these sets.

        There may be two to the power of the velocities that switch parameters. What holds for every inertia
        and damping between those of the sets holds in each of them, and is one matrix at most attitudes.
        """
        hull = _hull(sets)
        for group in ([hull], sets):

            def margins(inverse: Any, group: Sequence[SignSet] = group) -> Array:
                if isinstance(inverse, Interval):
                    return self._bounds_over_sets(condition, hull, sets, inverse, iota)
                return np.min([self._margins_at(condition, signs, inverse, iota) for signs in group], axis=0)

            certificate = margin_bound(margins, self.attitudes, self.yaw_invariant, bool(condition.uses))
            if certificate.least > 0:
                return certificate.bound > 0
        return False

    def _bounds_over_sets(
        self,
        condition: Condition,
        hull: SignSet,
        sets: Sequence[SignSet],
        inverse: Interval,
        iota: float | None,
    ) -> Array:
        """Bounds at boxes of attitudes: of the hull, or where that has none, of the sets.

        These one after the other, as long as they have a bound: a box where one has none has to be cut.
        """
        bounds = self._margins_at(condition, hull, inverse, iota)
        left = np.flatnonzero(bounds <= 0)
        bounds[left] = np.inf
        for signs in sets:
            if not len(left):
                break
            bounds[left] = np.minimum(bounds[left], self._margins_at(condition, signs, inverse[left], iota))
            left = left[bounds[left] > 0]
        return bounds

    def _margins_at(self, condition: Condition, signs: SignSet, inverse: Any, iota: float | None) -> Array:
        """Margins for J^-1 at attitudes, or bounds below them at boxes of attitudes, shape (k,)."""
        found = condition.margin(self.quantities(signs, inverse, iota))
        return np.array(np.broadcast_to(found, len(inverse)))

    def with_damping(self, damping: Array) -> SignSet:
        """The first sign set with other damping at rest, whatever the parameters."""
        signs = self.sets[0]
        return replace(signs, D=Affine(damping, np.zeros_like(signs.D.slopes)))

    # --- iota ---------------------------------------------------------------------------------
    def iota_interval(
        self, conditions: Sequence[Condition], sets: list[SignSet], channel: int | None = None
    ) -> Span | None:
        """The values of iota for which conditions hold together in all of these sets, or None."""
        pairs = [(c, signs) for c in conditions for signs in distinct_for(c, sets)]
        if channel is None:
            return self._matrix_iota_interval(pairs)
        return where_positive(
            lambda iotas: np.min([self.margins(c, signs, iotas, channel) for c, signs in pairs], axis=0)
        )

    def _matrix_iota_interval(self, pairs: Sequence[tuple[Condition, SignSet]]) -> Span | None:
        """From a few attitudes, and then from those at which the ends of the interval fail."""
        conditions = dict.fromkeys(c for c, _ in pairs)
        stacks = [(c, _stacked([signs for own, signs in pairs if own is c])) for c in conditions]

        def at_few(iotas: Array) -> Array:
            column, shape = iotas[:, None, None, None], (1, len(iotas), len(self.few_inverses))
            each = (c.margin(self.quantities(own, self.few_inverses, column)) for c, own in stacks)
            whole = (np.broadcast_to(m, np.broadcast_shapes(np.shape(m), shape)) for m in each)
            return np.min([m.min(axis=(0, 2)) for m in whole], axis=0)

        span = where_positive(at_few)
        active: dict[int, set[int]] = {}  # attitudes by pair

        def least(iotas: Array) -> Array:
            each = (
                self._margins_by_iota(*pairs[k], iotas, self._sampled_inverses[sorted(own)]).min(axis=1)
                for k, own in active.items()
            )
            return np.min([*each], axis=0)

        while span is not None:
            probes = np.clip([span[0], interior_point(span), span[1]], SEARCH.low, SEARCH.high)
            found = np.array([self._margins_by_iota(*pair, probes, self._sampled_inverses) for pair in pairs])
            rounding = SEARCH.rounding * np.abs(found).max(axis=(0, 2))
            if active and (found.min(axis=(0, 2)) >= least(probes) - rounding).all():
                return span
            for margins in found.swapaxes(0, 1):
                k, worst = np.unravel_index(int(margins.argmin()), margins.shape)
                active.setdefault(int(k), set()).add(int(worst))
            span = where_positive(least)
        return None


def distinct_for(condition: Condition, sets: Sequence[SignSet]) -> list[SignSet]:
    """Of sets that are the same to a condition, the first."""
    found: dict[bytes, SignSet] = {}
    for signs in sets:
        used = b"".join(
            m.tobytes() for n, m in (("M", signs.inertia), ("D", signs.damping)) if n in condition.uses
        )
        found.setdefault(used, signs)
    return list(found.values())


ALL, SOME, NOMINAL, OPEN = "holds for all", "fails for some", "fails at the values of the file", "undecided"
SAMPLED, NO_IOTA_THERE = "undecided (attitudes sampled)", "no iota at the values of the file"


@dataclass(frozen=True)
class RobustVerdict:
    """A verdict over a set of parameter values."""

    verdict: str  # ALL, SOME, NOMINAL, NO_IOTA_THERE, or OPEN or SAMPLED (neither proved nor refuted)
    margin: float  # the least found at a point of the set
    counterexample: dict[str, float]  # values that it fails with, SI, in the signs of the vehicle file


def _require_covariance(names: Sequence[str], matrix: Array) -> None:
    size = len(names)
    if matrix.shape != (size, size):
        raise UndertowError(
            f"the covariance of {size} parameters has shape {matrix.shape}: give ({size}, {size})"
        )
    for name, row, variance in zip(names, matrix, np.diag(matrix), strict=True):
        if not (np.isfinite(row).all() and variance >= 0):
            raise UndertowError(
                f"the covariance of {name} is not finite, or its variance is negative: correct the matrix"
            )


class Uncertainty:
    """Uncertainty of the parameters of a vehicle.

    `confidence` is the probability of the interval of each parameter, and of the ellipsoid of all of them.
    `covariance` (names, matrix) is that of an identification, SI, SNAME signs; without it the standard
    deviations of the vehicle count alone.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        confidence: float = SEARCH.confidence,
        covariance: tuple[Sequence[str], Any] = ((), ()),
    ) -> None:
        low, high = SEARCH.confidence_range
        if not low <= confidence <= high:
            raise UndertowError(
                f"confidence {confidence:g} is no probability from {low:g} to {high:g}: give one"
            )
        self.vehicle, self.confidence = vehicle, confidence
        self._names, self._matrix = list(covariance[0]), number_array("covariance", covariance[1])
        if self._names:
            _require_covariance(self._names, self._matrix)

    @property
    def source(self) -> str:
        """Where the uncertainty is from."""
        return "covariance of the last fit" if self._names else "standard deviations of the vehicle file"

    def covariance(self, names: Sequence[str]) -> Array:
        """Covariance of some parameters, shape (n, n)."""
        sigmas = [self.vehicle.value_of(n).sigma or 0.0 for n in names]
        result = np.diag(np.square(sigmas))
        known = [i for i, n in enumerate(names) if n in self._names]
        rows = [self._names.index(names[i]) for i in known]
        if known:
            result[np.ix_(known, known)] = self._matrix[np.ix_(rows, rows)]
        return result

    def over_box(self, margins: Margins, signs: SignSet, relevant: Flags) -> RobustVerdict:
        """Over every value of what `relevant` within its own interval and its physical bounds."""
        if np.count_nonzero(relevant) > SEARCH.max_corners:
            return self._robust_verdict(margins(signs.theta[None]), signs.theta[None], signs, proved=False)
        corners = self._corners(signs, relevant, float(ndtri(0.5 + self.confidence / 2)))
        return self._robust_verdict(margins(corners), corners, signs, margins(signs.theta[None])[0])

    def over_ellipsoid(self, margins: Margins, signs: SignSet, features: Array) -> RobustVerdict:
        """Over the ellipsoid of all uncertain parameters together.

        `features` are the linear combinations of parameters that the margin depends on, shape
        (m, n_parameters); with two of them the verdict is practically exact, with more the bound is that of a
        box around the ellipsoid.
        """
        covariance = self.covariance(signs.names)
        count = int(np.count_nonzero(np.diag(covariance)))
        if count == 0:
            return self._robust_verdict(margins(signs.theta[None]), signs.theta[None], signs)
        reach = float(np.sqrt(chdtri(count, 1 - self.confidence)))
        feature_covariance = features @ covariance @ features.T
        values, vectors = np.linalg.eigh(feature_covariance)
        kept = values > SEARCH.flat * max(values[-1], 1e-300)
        # Columns: how the parameters move along each axis of the ellipse of the features.
        axes = reach * (covariance @ features.T @ vectors[:, kept]) / np.sqrt(values[kept])
        around, on_ball = _polytope(axes.shape[1])
        if around is None:
            return self._robust_verdict(
                margins(signs.theta + on_ball @ axes.T), signs.theta + on_ball @ axes.T, signs, proved=False
            )
        points = np.concatenate([signs.theta[None], signs.theta + on_ball @ axes.T])
        physical = self._physical_points(points, covariance, reach, signs)
        found = self._robust_verdict(margins(physical), physical, signs)
        if found.verdict != ALL:
            return found
        # Concave margins are least at a corner of any polytope around the set: of two, either will do.
        if float(margins(signs.theta + around @ axes.T).min()) > 0:
            return found
        box = self._corners(signs, np.any(features != 0, axis=0), reach)
        return found if float(margins(box).min()) > 0 else RobustVerdict(OPEN, found.margin, {})

    def _physical_points(self, points: Array, covariance: Array, reach: float, signs: SignSet) -> Array:
        """Points moved to physical values, those of them that are still in the ellipsoid."""
        bounds = self._bounds(signs.names)
        moved = np.clip(points, bounds[:, 0], bounds[:, 1])
        offsets = moved - signs.theta
        distance = np.einsum("ij,jk,ik->i", offsets, np.linalg.pinv(covariance, hermitian=True), offsets)
        return moved[distance <= reach**2 * (1 + 1e-9)]

    def _corners(self, signs: SignSet, relevant: Flags, reach: float) -> Array:
        """Corners of the box of all physical values within `reach` standard deviations."""
        low, high = self._interval_ends(signs.names, signs.theta, reach)
        free = [j for j in np.flatnonzero(relevant) if high[j] > low[j]]
        corners = np.tile(signs.theta, (2 ** len(free), 1))
        for row, choice in zip(corners, product(*[(low[j], high[j]) for j in free]), strict=True):
            row[free] = choice
        return corners

    def intervals(self, names: Sequence[str]) -> list[Span]:
        """The interval of each parameter, cut at its physical bounds."""
        values = np.array([self.vehicle.value_of(n).value for n in names])
        low, high = self._interval_ends(names, values, float(ndtri(0.5 + self.confidence / 2)))
        return list(zip(map(float, low), map(float, high), strict=True))

    def _interval_ends(self, names: Sequence[str], theta: Array, reach: float) -> tuple[Array, Array]:
        half_width, bounds = reach * np.sqrt(np.diag(self.covariance(names))), self._bounds(names)
        return np.maximum(theta - half_width, bounds[:, 0]), np.minimum(theta + half_width, bounds[:, 1])

    def _bounds(self, names: Sequence[str]) -> Array:
        """Physical bounds of the parameters, shape (n_parameters, 2)."""
        declared = map(self.vehicle.parameter_of, names)
        return np.array([p.bounds if p else (-np.inf, np.inf) for p in declared]).reshape(-1, 2)

    def _robust_verdict(
        self, values: Array, points: Array, signs: SignSet, nominal: float | None = None, proved: bool = True
    ) -> RobustVerdict:
        worst = int(np.argmin(values))
        least = float(values[worst])
        if least > 0:
            return RobustVerdict(ALL if proved else OPEN, least, {})
        if nominal is not None and nominal <= 0:
            return RobustVerdict(NOMINAL, least, {})
        # The parameters that differ from the file's, as the file would write them.
        vehicle, triples = self.vehicle, zip(signs.names, points[worst], signs.theta, strict=True)
        changed = {n: v for n, v, own in triples if abs(v - own) > SEARCH.unchanged * max(abs(own), 1e-9)}
        return RobustVerdict(
            SOME,
            least,
            {n: printed(vehicle.declaration(n), float(v), vehicle.signs) for n, v in changed.items()},
        )


def _polytope(size: int) -> tuple[Array | None, Array]:
    """Corners of a polytope around the unit ball, and points on the ball, shape (k, size)."""
    if size == 1:
        ends = np.array([[-1.0], [1.0]])
        return ends, ends
    if size == 2:
        angle = 2 * np.pi * np.arange(SEARCH.sides) / SEARCH.sides
        circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return circle / np.cos(np.pi / SEARCH.sides), circle
    on_ball = np.concatenate([np.eye(size), -np.eye(size)])
    if size > SEARCH.max_corners:
        return None, on_ball
    corners = np.array(list(product((-1.0, 1.0), repeat=size)))
    return corners, np.concatenate([on_ball, corners / np.sqrt(size)])
