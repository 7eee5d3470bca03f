"""Conditions over all attitudes: by algebra where J is orthogonal, else by intervals over boxes of angles."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import sympy as sm
from scipy.optimize import minimize

from undertow.control.plant import Plant
from undertow.model.composition import function_of
from undertow.model.symbols import POSE, body_rates, column, rotation, skew, symbol
from undertow.typing import Array, Flags, Index

_EPS = float(np.finfo(float).eps)
_STEP = 2 * _EPS  # a rounding is a quarter of this at most, relative,
_TINY = 2.0**-1000  # or far below this where numbers underflow


class Interval:
    """An array of closed intervals; every operation contains all results that its operands allow."""

    __array_ufunc__ = None  # so that array * Interval comes here

    def __init__(self, lo: Any, hi: Any) -> None:
        self.lo, self.hi = np.asarray(lo, dtype=float), np.asarray(hi, dtype=float)

    def __len__(self) -> int:
        return len(self.lo)

    def __getitem__(self, place: Any) -> Interval:
        """Some of the intervals, by an index as NumPy has them."""
        return Interval(self.lo[place], self.hi[place])

    def reshape(self, *shape: int) -> Interval:
        """The same in another shape."""
        return Interval(self.lo.reshape(*shape), self.hi.reshape(*shape))

    @property
    def middle(self) -> Array:
        """A point of each interval near its middle."""
        return 0.5 * (self.lo + self.hi)

    @property
    def radius(self) -> Array:
        """At least the distance from the middle to either end; zero where there is no width."""
        middle = self.middle
        return np.asarray(np.maximum(self.hi - middle, middle - self.lo) * (1 + 2 * _EPS))

    def __add__(self, other: Any) -> Interval:
        o = enclose(other)
        return _rounded_outward(self.lo + o.lo, self.hi + o.hi)

    __radd__ = __add__

    def __neg__(self) -> Interval:
        return Interval(-self.hi, -self.lo)

    def __sub__(self, other: Any) -> Interval:
        return self + -enclose(other)

    def __rsub__(self, other: Any) -> Interval:
        return -self + other

    def __mul__(self, other: Any) -> Interval:
        if isinstance(other, float):  # the same numbers in half the time
            ends = self.lo * other, self.hi * other
            return _rounded_outward(*ends) if other >= 0 else _rounded_outward(*ends[::-1])
        o = enclose(other)
        products = [self.lo * o.lo, self.lo * o.hi, self.hi * o.lo, self.hi * o.hi]
        return _rounded_outward(np.minimum.reduce(products), np.maximum.reduce(products))

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Interval:
        return self * enclose(other).reciprocal()

    def __rtruediv__(self, other: Any) -> Interval:
        return enclose(other) * self.reciprocal()

    def __pow__(self, power: int) -> Interval:
        if power < 0:
            return self.reciprocal() ** -power
        result = enclose(np.ones_like(self.lo))
        for _ in range(power):
            result = result * self
        return result

    def __abs__(self) -> Interval:
        least = np.where((self.lo <= 0) & (self.hi >= 0), 0.0, np.minimum(np.abs(self.lo), np.abs(self.hi)))
        return Interval(least, self.magnitude)

    @property
    def magnitude(self) -> Array:
        """The largest magnitude in each interval."""
        return np.maximum(np.abs(self.lo), np.abs(self.hi))

    def reciprocal(self) -> Interval:
        """One over each; everything where an interval contains zero."""
        safe = (self.lo > 0) | (self.hi < 0)
        with np.errstate(divide="ignore"):
            lo, hi = np.where(safe, 1 / self.hi, -np.inf), np.where(safe, 1 / self.lo, np.inf)
        return _rounded_outward(lo, hi)

    def __matmul__(self, other: Any) -> Interval:
        """Product of matrices by middle and radius (Rump 1999, Fast and parallel interval arithmetic)."""
        o = enclose(other)
        a, b, ra, rb = self.middle, o.middle, self.radius, o.radius
        middle, size_b, rounding = a @ b, np.abs(b), (a.shape[-1] + 4) * _EPS
        radius = np.abs(a) @ (rb + rounding * size_b)
        if ra.any():
            radius += ra @ (size_b + rb)
        radius = radius * (1 + 4 * rounding) + _TINY
        return _rounded_outward(middle - radius, middle + radius)

    def __rmatmul__(self, other: Any) -> Interval:
        return enclose(other) @ self

    @property
    def T(self) -> Interval:
        """Transposes of the matrices along the last two axes."""
        return Interval(np.swapaxes(self.lo, -1, -2), np.swapaxes(self.hi, -1, -2))


def _rounded_outward(lo: Array, hi: Array) -> Interval:
    """Numbers outside by more than one rounding, which `nextafter` takes four times as long to find."""
    return Interval(lo - (_STEP * np.abs(lo) + _TINY), hi + (_STEP * np.abs(hi) + _TINY))


def enclose(value: Any) -> Interval:
    """A number or an array as intervals of no width."""
    return value if isinstance(value, Interval) else Interval(value, value)


def plus_minus(size: Any) -> Interval:
    """Everything up to a magnitude, either way."""
    return Interval(-size, size)


def transposed(matrix: Any) -> Any:
    """Transposes of matrices, numbers or intervals, along the last two axes."""
    return matrix.T if isinstance(matrix, Interval) else np.swapaxes(matrix, -1, -2)


def sin(x: Any) -> Interval:
    """Sine of an interval: its ends, and the extremes 1 and -1 where a quarter turn lies between them."""
    x = enclose(x)
    ends = np.sin(x.lo), np.sin(x.hi)
    # Library sines are off by an ulp or so: a margin of four, and a hair's breadth more for the extremes.
    lo, hi = np.minimum(*ends) - 4 * _EPS, np.maximum(*ends) + 4 * _EPS
    top, bottom = _contains(x, np.pi / 2), _contains(x, -np.pi / 2)
    return Interval(np.where(bottom, -1.0, np.maximum(lo, -1.0)), np.where(top, 1.0, np.minimum(hi, 1.0)))


def cos(x: Any) -> Interval:
    """Cosine of an interval."""
    return sin(enclose(x) + Interval(np.nextafter(np.pi / 2, 0), np.nextafter(np.pi / 2, 2)))


def tan(x: Any) -> Interval:
    """Tangent of an interval."""
    return sin(x) * cos(x).reciprocal()


def _contains(x: Interval, place: float) -> Flags:
    """Whether an interval may contain `place` plus whole turns."""
    slack = BOUNDS.slack
    first = np.ceil((x.lo - place - slack) / (2 * np.pi))
    return place + 2 * np.pi * first <= x.hi + slack


FUNCTIONS: dict[str, Callable[..., Interval]] = {"sin": sin, "cos": cos, "tan": tan}
"""For `model.composition.function_of`."""


def block(rows: Sequence[Sequence[Any]]) -> Any:
    """A matrix of blocks, of intervals where one of them is."""
    cells = [cell for row in rows for cell in row]
    shape = np.broadcast_shapes(*(_shape(c)[:-2] for c in cells))
    if not any(isinstance(c, Interval) for c in cells):
        return np.block([[np.broadcast_to(c, shape + _shape(c)[-2:]) for c in row] for row in rows])
    sides = (
        np.block(
            [[np.broadcast_to(getattr(enclose(c), s), shape + _shape(c)[-2:]) for c in row] for row in rows]
        )
        for s in ("lo", "hi")
    )
    return Interval(*sides)


def _shape(cell: Any) -> tuple[int, ...]:
    return np.shape(cell.lo if isinstance(cell, Interval) else cell)


def least_eigenvalue(matrix: Any) -> Array:
    """Smallest eigenvalue of the symmetric part, or a number that is certainly below it for intervals."""
    if not isinstance(matrix, Interval):
        if np.shape(matrix)[-1] == 1:
            return np.asarray(matrix)[..., 0, 0]
        return np.linalg.eigvalsh(0.5 * (matrix + transposed(matrix)))[..., 0]
    symmetric = 0.5 * (matrix + matrix.T)
    middle, radius = symmetric.middle, symmetric.radius
    usable = np.asarray(np.isfinite(radius).all(axis=(-1, -2)))
    middle = np.where(usable[..., None, None], middle, 0.0)
    n = middle.shape[-1]
    # x'Ex >= -sum_i (sum_j |E_ij| s_i/s_j) x_i^2 for a symmetric change E and any s > 0: sizes of the states,
    # so that a large axis takes nothing from a small one. The solver is backward stable.
    diagonal = np.einsum("...ii->...i", middle)
    s = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    spread = np.where(usable[..., None], s * (radius / s[..., None, :]).sum(axis=-1) * (1 + n * _EPS), 0.0)
    lowered = middle - spread[..., None] * np.eye(n)
    rounding = 8 * n * _EPS * np.linalg.norm(lowered, axis=(-1, -2))
    return np.where(usable, np.linalg.eigvalsh(lowered)[..., 0] - rounding, -np.inf)


ANGLES = ("phi", "theta", "psi")


@dataclass(frozen=True)
class BoundSettings:
    """How finely attitudes are sampled and cut into boxes."""

    # A bound that is not positive by then counts as not proved; it limits time and memory.
    max_boxes: int = 40_000
    max_pairs: int = 200_000  # the same of boxes with their cases
    # Boxes after which a proof that would take more than those is given up: the first ones are so large that
    # they say little of it.
    first_boxes: int = 2000
    batch: int = 8000  # boxes that are bounded at a time: memory
    share: float = 0.1  # of the least margin found, up to which a bound is refined: its sign is what counts
    grid: int = 9  # points for each angle from which the least margin is searched for
    heading_cuts: int = 36  # boxes of a whole turn where a bound is not refined
    tilt_cuts: int = 8  # the same of roll and of pitch
    # Search for the least margin near the lowest point: accuracy of angles, rad, and of the margin; rounds.
    polish: tuple[float, float, int] = (1e-6, 1e-12, 200)
    slack: float = 1e-12  # rad by which an extreme of a sine may lie beside an interval and counts as inside


BOUNDS = BoundSettings()


@dataclass(frozen=True)
class Certificate:
    """What is known of a number over all attitudes."""

    bound: float  # the number is nowhere below this
    least: float  # the least value found at a point
    worst: dict[str, float]  # angles of that point, rad
    proof: str  # why the bound holds, in words


class Attitudes:
    """The attitudes of a plant, J^-1 as numbers and as intervals, with roll and pitch up to `tilt`, rad.

    `isotropic` says that every gain is the same for x, y and z. With J^-1 = diag(I, W) diag(R', I) the
    rotation R of the translations then changes no eigenvalue, and J^-1 stands for diag(I, W) here.

    With `rates` J^-1 is followed, below it, by its rate of change at a unit of each velocity and, where R is
    left out of it, by diag(R, I), so that it has the shape (k, (n + 1) n, n) or (k, (n + 2) n, n).
    """

    def __init__(self, plant: Plant, tilt: float, isotropic: bool = False, rates: bool = False) -> None:
        self._plant, self.tilt, self._rates = plant, tilt, rates
        self._isotropic_gains = isotropic
        self._isotropic = isotropic and len(plant.nu) == 6

    @cached_property
    def orthogonal(self) -> bool:
        """Whether J J' = I, proved symbolically: then M_q = J M J' has the eigenvalues of M."""
        J, places = self._plant.J, self.box(ANGLES) * 0.37  # no place of special values
        there = self.forward({a: enclose(ends) for a, ends in zip(ANGLES, places, strict=True)}).middle
        if not np.allclose(there @ np.swapaxes(there, -1, -2), np.eye(J.rows)):
            return False  # simplifying it would take seconds to say so
        return (J * J.T).applyfunc(sm.trigsimp) == sm.eye(J.rows)

    @cached_property
    def heading_factors_out(self) -> bool:
        """Whether J(psi) = Z(psi) J(0) with Z orthogonal, proved: then psi does not change eigenvalues."""
        psi = symbol("psi")
        if psi not in self._plant.J.free_symbols:
            return True
        turn = self._yaw_rotation
        rest = turn * self._plant.J.xreplace({psi: sm.Integer(0)}) - self._plant.J
        return rest.applyfunc(lambda e: sm.trigsimp(sm.expand(e))).is_zero_matrix is True

    @cached_property
    def _yaw_rotation(self) -> sm.Matrix:
        names = self._plant.vehicle.pose_names
        turn, psi = sm.eye(len(names)), symbol("psi")
        if "x" in names and "y" in names:
            i, j = names.index("x"), names.index("y")
            turn[i, i] = turn[j, j] = sm.cos(psi)
            turn[i, j], turn[j, i] = -sm.sin(psi), sm.sin(psi)
        return turn

    def angles(self, yaw_invariant: bool) -> tuple[str, ...]:
        """Angles that a matrix can depend on; the heading only if it is not `yaw_invariant` out."""
        found = [a for a in ANGLES if symbol(a) in self._plant.J.free_symbols]
        return tuple(a for a in found if not (a == "psi" and yaw_invariant and self.heading_factors_out))

    def box(self, angles: tuple[str, ...]) -> Array:
        """Range of these angles, shape (n, 2), rad; of headings half a turn.

        The other half turns x and y round, which changes no eigenvalue, as gains are diagonal.
        """
        heading = 0.5 * np.pi if self.heading_factors_out else np.pi
        ends = [heading if a == "psi" else self.tilt for a in angles]
        return np.array([[-e, e] for e in ends])

    def invariant(self, yaw_invariant: bool) -> bool:
        """Whether no attitude changes an eigenvalue: J J' = I, and every gain commutes with J."""
        if not self.angles(yaw_invariant):
            return True
        return yaw_invariant and (self._isotropic_gains or self.angles(False) == ("psi",)) and self.orthogonal

    @cached_property
    def _J_inverse(self) -> sm.Matrix:
        whole = self._plant.J_inverse
        inverse = sm.diag(sm.eye(3), body_rates(column(POSE[3:]))) if self._isotropic else whole
        if not self._rates:
            return inverse
        turn = [sm.diag(rotation(column(POSE[3:])), sm.eye(3))] if self._isotropic else []
        return sm.Matrix.vstack(inverse, *self._slopes(inverse), *turn)

    def _slopes(self, inverse: sm.Matrix) -> Iterator[sm.Matrix]:
        """How J^-1 changes at a unit of each velocity; where R is left out of it, seen from the body."""
        eta, J = self._plant.eta, self._plant.J
        for k in range(J.cols):
            rate = sum((inverse.diff(a) * v for a, v in zip(eta, J[:, k], strict=True)), 0 * inverse)
            if self._isotropic:  # d(R')/dt = -S(omega) R'
                omega = sm.Matrix([int(i == k) for i in range(3, 6)])
                rate -= sm.diag(skew(omega), sm.zeros(3, 3))
            yield rate

    @cached_property
    def _J_inverse_enclosed(self) -> Callable[..., Any]:
        return enclosing([symbol(a) for a in ANGLES], self._J_inverse)

    @cached_property
    def _J_inverse_numeric(self) -> Callable[..., Any]:
        functions = {name: getattr(np, name) for name in FUNCTIONS}
        return function_of([symbol(a) for a in ANGLES], self._J_inverse.tolist(), functions)

    @cached_property
    def _J_enclosed(self) -> Callable[..., Any]:
        return enclosing([symbol(a) for a in ANGLES], self._plant.J)

    def inverse(self, values: dict[str, Interval]) -> Interval:
        """J^-1 for intervals of angles of shape (k,), zero where not given, shape (k, n, n)."""
        return self._J_inverse_enclosed(*self.every_angle(values))

    def forward(self, values: dict[str, Interval]) -> Interval:
        """J itself for intervals of angles, shape (k, n, n); the heading is never left out of it."""
        return self._J_enclosed(*self.every_angle(values))

    def every_angle(self, values: dict[str, Interval]) -> list[Interval]:
        """Roll, pitch and heading, zero where not given."""
        zero = enclose(np.zeros(count_of(values)))
        return [values.get(a, zero) for a in ANGLES]

    def boxes(self, reach: dict[str, float]) -> dict[str, Interval]:
        """Intervals that cover |angle| <= reach for roll and pitch, and every heading, shape (k,)."""
        found = self.angles(False)
        ends = [np.pi if a == "psi" else min(reach.get(a, self.tilt), self.tilt) for a in found]
        cuts = [
            np.linspace(-e, e, 1 + (BOUNDS.heading_cuts if a == "psi" else BOUNDS.tilt_cuts))
            for a, e in zip(found, ends, strict=True)
        ]
        low = np.meshgrid(*[c[:-1] for c in cuts]) if cuts else []
        high = np.meshgrid(*[c[1:] for c in cuts]) if cuts else []
        return {a: Interval(lo.ravel(), hi.ravel()) for a, lo, hi in zip(found, low, high, strict=True)}

    def at(self, values: dict[str, float]) -> Array:
        """J^-1 at one attitude, shape (n, n)."""
        return self.numbers({a: np.array([v]) for a, v in values.items()})[0]

    def numbers(self, values: dict[str, Array]) -> Array:
        """J^-1 in floating point for angles of shape (k,), zero where not given, shape (k, n, n)."""
        k = count_of(values)
        return _stacked(self._J_inverse_numeric(*(values.get(a, np.zeros(k)) for a in ANGLES)), (k,))


def count_of(values: Mapping[str, Interval | Array]) -> int:
    """How many attitudes, or boxes of them, there are: one where nothing depends on angles."""
    return len(next(iter(values.values()))) if values else 1


def enclosing(names: Sequence[sm.Symbol], matrix: sm.Matrix) -> Callable[..., Interval]:
    """A matrix of expressions as a function of intervals of shape (k,), its values of shape (k, m, n)."""
    function = function_of(names, matrix.tolist(), FUNCTIONS)

    def evaluate(*values: Interval) -> Interval:
        k = np.broadcast_shapes(*(v.lo.shape for v in values)) if values else (1,)
        cells = [[enclose(c) for c in row] for row in function(*values)]
        return Interval(*(_stacked([[getattr(c, s) for c in row] for row in cells], k) for s in ("lo", "hi")))

    return evaluate


def _stacked(cells: Sequence[Sequence[Any]], shape: tuple[int, ...]) -> Array:
    """A stack of matrices from its cells, each a number or an array of that shape."""
    found = np.empty((*shape, len(cells), len(cells[0]) if cells else 0))
    for i, row in enumerate(cells):
        for j, cell in enumerate(row):
            found[..., i, j] = cell
    return found


def margin_bound(
    margin: Callable[[Any], Array], attitudes: Attitudes, yaw_invariant: bool, depends: bool = True
) -> Certificate:
    """Bound a margin from below over all attitudes: by algebra, or by branch and bound on boxes of angles.

    The bound is refined until it is above a share of the least value that is found at a point, which is all
    that its sign needs; where that value is not positive, the point is a counterexample, without a bound.

    `margin` leads from J^-1, an array or an interval array of shape (k, n, n), to the margin or a bound below
    it. `yaw_invariant` says that it is the same at every heading, `depends` that it contains J at all.
    """
    return margin_bound_over_cases(
        lambda J, place, _: margin(J)[place], attitudes, yaw_invariant, depends=depends
    )


Cases = Callable[[Any, Index, Index], Array]
"""Leads from J^-1 at some attitudes to margins, or bounds below them, of pairs: place in J^-1 and case."""


def margin_bound_over_cases(
    margin: Cases, attitudes: Attitudes, yaw_invariant: bool, cases: int = 1, *, depends: bool = True
) -> Certificate:
    """As `margin_bound`, over cases, too: a box of attitudes is cut for those cases that need it."""
    angles = attitudes.angles(yaw_invariant)
    if not depends or attitudes.invariant(yaw_invariant):
        value = float(margin(attitudes.at({})[None], np.zeros(cases, dtype=int), np.arange(cases)).min())
        return Certificate(value, value, {}, _algebraic_proof(attitudes) if depends else "gains alone")
    best, worst = _least_sampled(margin, attitudes, angles, cases)
    place = dict(zip(angles, map(float, worst), strict=True))
    if best <= 0:
        return Certificate(best, best, place, "fails there")
    bound, count = _branch_and_bound(margin, attitudes, angles, cases, best)
    tilted = [a for a in angles if a != "psi"]
    ranges = f"|{'|, |'.join(tilted)}| <= {np.degrees(attitudes.tilt):.4g} deg, " if tilted else ""
    claim = f"certainly above {bound:.4g}" if bound > 0 else "NOT proved"
    return Certificate(
        bound, best, place, f"{claim} for {ranges}all headings: interval arithmetic on {count} boxes"
    )


def _least_sampled(
    margin: Cases, attitudes: Attitudes, angles: tuple[str, ...], cases: int
) -> tuple[float, Array]:
    """The least margin on a grid, polished from there."""
    box = attitudes.box(angles)
    axes = [np.linspace(low, high, BOUNDS.grid) for low, high in box]
    grid = np.stack([g.ravel() for g in np.meshgrid(*axes)], axis=1)

    def at(points: Array, place: Index, case: Index) -> Array:
        return margin(attitudes.numbers(dict(zip(angles, points.T, strict=True))), place, case)

    place, case = (m.ravel() for m in np.indices((len(grid), cases)))
    candidates = [
        (float(values.min()), k + int(values.argmin()))
        for k in range(0, len(place), BOUNDS.batch)
        for values in [at(grid, place[k : k + BOUNDS.batch], case[k : k + BOUNDS.batch])]
    ]
    lowest, first = min(candidates)
    one = np.zeros(1, dtype=int)
    close, level, rounds = BOUNDS.polish
    found = minimize(
        lambda x: float(at(np.clip(x, box[:, 0], box[:, 1])[None], one, case[[first]])[0]),
        grid[place[first]], method="Nelder-Mead", options={"xatol": close, "fatol": level, "maxiter": rounds},
    )  # fmt: skip
    worst = np.clip(found.x, box[:, 0], box[:, 1])
    polished = float(at(worst[None], one, case[[first]])[0])
    return (polished, worst) if polished <= lowest else (lowest, grid[place[first]])


def _branch_and_bound(
    margin: Cases, attitudes: Attitudes, angles: tuple[str, ...], cases: int, best: float
) -> tuple[float, int]:
    boxes, case = np.repeat(attitudes.box(angles)[None], cases, axis=0), np.arange(cases)
    done, count, limit = np.inf, 0, BOUNDS.max_boxes if cases == 1 else BOUNDS.max_pairs
    while len(boxes):
        count += len(boxes)
        bounds = _bounds_of_pairs(margin, attitudes, angles, boxes, case)
        enough = bounds >= BOUNDS.share * best
        if count > BOUNDS.first_boxes:
            middles = dict(zip(angles, boxes[~enough].mean(axis=-1).T, strict=True))
            J, place = attitudes.numbers(middles), np.arange(int(np.sum(~enough)))
            inside = margin(J, place, case[~enough])
            # What a bound is below the value inside shrinks with the box, so that each has to be cut into
            # about so many.
            more = float(np.sum((inside - bounds[~enough]) / (inside - BOUNDS.share * best)))
            enough |= count + more > limit
        done = min(done, float(bounds[enough].min(initial=np.inf)))
        boxes, case = _halved(boxes[~enough]), np.tile(case[~enough], 2)
    return min(done, best), count


def _bounds_of_pairs(
    margin: Cases, attitudes: Attitudes, angles: tuple[str, ...], boxes: Array, case: Index
) -> Array:
    """Bounds of each box with its case; what boxes have in common is worked out once."""
    found = np.empty(len(boxes))
    for k in range(0, len(boxes), BOUNDS.batch):
        own = slice(k, k + BOUNDS.batch)
        every, place = np.unique(boxes[own].reshape(len(boxes[own]), -1), axis=0, return_inverse=True)
        ends = every.reshape(len(every), -1, 2)
        J = attitudes.inverse({a: Interval(*ends[:, i].T) for i, a in enumerate(angles)})
        found[own] = margin(J, place.ravel(), case[own])
    return found


def _halved(boxes: Array) -> Array:
    """Every box cut across its longest side."""
    if not len(boxes):
        return boxes
    rows = np.arange(len(boxes))
    axis = (boxes[..., 1] - boxes[..., 0]).argmax(axis=1)
    middle = boxes[rows, axis].mean(axis=1)
    first, second = boxes.copy(), boxes.copy()
    first[rows, axis, 1] = middle
    second[rows, axis, 0] = middle
    return np.concatenate([first, second])


def _algebraic_proof(attitudes: Attitudes) -> str:
    if attitudes.angles(False):
        return "all headings: J J' = I, so M_q = J M J' has the eigenvalues of M"
    return "J is constant"
