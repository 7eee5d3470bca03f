"""Random points at which laws are tried, and identities proved or refuted there; standard library only."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from random import Random

import sympy as sm

from .evaluation import function_of
from .parameter import Parameter
from .statement import Statement

Point = dict[sm.Symbol, float]

_SEED = 20210405
_TOLERANCE = 1e-9
# Far apart in size, so that a kink or a saturation is met on both sides.
_DECADES = (-2.0, 1.0)
_PARAMETER_DECADES = (-2.0, 2.0)


class Probe:
    """Draws points for the symbols of a statement: signals of every size, parameters within their bounds.

    Parameters
    ----------
    statement : Statement
        Whose symbols to draw.
    seed : int
        The same seed draws the same points.
    """

    def __init__(self, statement: Statement, seed: int = _SEED) -> None:
        self._random = Random(seed)
        self._inputs = statement.inputs
        self._parameters = statement.parameters

    def point(self) -> Point:
        """A value for every symbol."""
        return {x: self.draw(x) for x in (*self._inputs, *self._parameters)}

    def moved(self, point: Point, symbols: Iterable[sm.Symbol]) -> Point:
        """The point with new values for some symbols."""
        return point | {x: self.draw(x) for x in symbols}

    def draw(self, x: sm.Symbol) -> float:
        """A value for one symbol."""
        if x in self._parameters:
            return self._within(self._parameters[x])
        unit, name = self._inputs[x], str(x)
        if name in ("rho", "g"):
            return 1000.0 if name == "rho" else 9.81
        if unit == "rad":  # clear of the singularity of the Euler angles
            return self._random.uniform(-1.4, 1.4)
        return abs(self._any_size(_DECADES)) if unit == "s" else self._any_size(_DECADES)

    def _any_size(self, decades: tuple[float, float]) -> float:
        return self._random.choice((-1.0, 1.0)) * 10 ** self._random.uniform(*decades)

    def _within(self, parameter: Parameter) -> float:
        low, high = parameter.bounds
        step = self._any_size(_PARAMETER_DECADES)
        if math.isinf(low) and math.isinf(high):
            return step
        if math.isinf(high):
            return low + abs(step)
        if math.isinf(low):
            return high - abs(step)
        # Bounds may be far wider than any value of interest: half of the draws are of ordinary size.
        ordinary = self._random.random() < 0.5 and low <= step <= high
        return step if ordinary else self._random.uniform(low, high)


def compiled(expressions: Sequence[sm.Expr]) -> Callable[[Mapping[sm.Symbol, float]], list[float]]:
    """A function from a point to the values of expressions; NaN where they are not defined."""
    rows = [sm.sympify(e, strict=True) for e in expressions]
    names = sorted({x for e in rows for x in e.free_symbols}, key=str)
    function = function_of(names, rows)

    def values(point: Mapping[sm.Symbol, float]) -> list[float]:
        try:
            return [float(v) for v in function(*(point[x] for x in names))]
        except (ArithmeticError, ValueError):
            return [math.nan] * len(rows)

    return values


def nonzero_row(matrix: sm.Matrix, statement: Statement, trials: int = 12) -> int | None:
    """Index of the first row that is not identically zero, or None.

    Expansion proves most identities; what it leaves is tried at random points.
    """
    for i, row in enumerate(matrix):
        expanded = sm.expand(row)
        if expanded != 0 and not _vanishes(expanded, statement, trials):
            return i
    return None


def _vanishes(expression: sm.Expr, statement: Statement, trials: int) -> bool:
    values = compiled([expression, *sm.Add.make_args(expression)])
    probe = Probe(statement)
    for _ in range(trials):
        whole, *terms = values(probe.point())
        if not math.isnan(whole) and abs(whole) > _TOLERANCE * sum(map(abs, terms)):
            return False
    return True


def bent_row(
    matrix: sm.Matrix, along: Sequence[sm.Symbol], statement: Statement, trials: int = 40
) -> int | None:
    """Index of the first row that is not affine in the symbols `along` taken together, or None.

    Affine means that the value half-way between any two points is the mean of the values there, so
    that a kink (dead band, dry friction) counts as bent although its second derivative is zero.
    """
    values, probe = compiled(list(matrix)), Probe(statement)
    for _ in range(trials):
        start = probe.point()
        end = probe.moved(start, along)
        middle = start | {x: (start[x] + end[x]) / 2 for x in along}
        for i, (a, b, half) in enumerate(zip(*map(values, (start, end, middle)), strict=True)):
            if abs(half - (a + b) / 2) > _TOLERANCE * (abs(a) + abs(b) + abs(half)):
                return i
    return None
