"""SymPy expressions to CasADi expressions, sharing what they have in common."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import reduce

import casadi as ca
import sympy as sm

from undertow.errors import UndertowError

_FUNCTIONS: dict[type[sm.Basic], Callable[..., ca.SX]] = {
    sm.sin: ca.sin,
    sm.cos: ca.cos,
    sm.tan: ca.tan,
    sm.asin: ca.asin,
    sm.acos: ca.acos,
    sm.atan: ca.atan,
    sm.atan2: ca.atan2,
    sm.sinh: ca.sinh,
    sm.cosh: ca.cosh,
    sm.tanh: ca.tanh,
    sm.exp: ca.exp,
    sm.log: ca.log,
    sm.Abs: ca.fabs,
    sm.sign: ca.sign,
    sm.Min: lambda *a: reduce(ca.fmin, a),
    sm.Max: lambda *a: reduce(ca.fmax, a),
}


# CasADi's operators try one type of operand after the other, which takes ten times as long.
def plus(a: ca.SX, b: ca.SX) -> ca.SX:
    """a + b."""
    return ca.SX.binary(ca.OP_ADD, a, b)


def times(a: ca.SX, b: ca.SX) -> ca.SX:
    """The product of a and b, entry by entry."""
    return ca.SX.binary(ca.OP_MUL, a, b)


class Converter:
    """Turns SymPy expressions into CasADi ones; equal subexpressions become one node."""

    def __init__(self, symbols: Mapping[sm.Symbol, ca.SX]) -> None:
        self._known: dict[sm.Basic, ca.SX] = dict(symbols)

    def define(self, symbols: Mapping[sm.Symbol, sm.Expr]) -> None:
        """Let symbols stand for expressions in the symbols known so far."""
        converted = {s: self(e) for s, e in symbols.items()}
        self._known.update(converted)

    def matrix(self, matrix: sm.Matrix) -> ca.SX:
        """Convert a matrix; entries that are zero stay structurally zero."""
        result = ca.SX(matrix.rows, matrix.cols)
        for (i, j), entry in matrix.todok().items():
            converted = self(entry)
            if not converted.is_zero():
                result[i, j] = converted
        return result

    def __call__(self, expression: sm.Expr) -> ca.SX:
        found = self._known.get(expression)
        if found is None:
            found = self._known[expression] = self._convert(sm.sympify(expression, strict=True))
        return found

    def _convert(self, e: sm.Expr) -> ca.SX:
        if e.is_Number or e.is_NumberSymbol:
            return ca.SX(float(e))
        if e.is_Add:
            return reduce(plus, map(self, e.args))
        if e.is_Mul:
            return self._product(e)
        if e.is_Pow:
            return self._power(*e.args)
        if isinstance(e, sm.Piecewise):
            return self._piecewise(e)
        if e.func not in _FUNCTIONS:
            raise UndertowError(
                f"'{e}' has no C counterpart: use one of {', '.join(sorted(map(str, _FUNCTIONS)))}"
            )
        return _FUNCTIONS[e.func](*map(self, e.args))

    def _product(self, e: sm.Expr) -> ca.SX:
        numerator, denominator = sm.fraction(e, exact=True)
        if denominator != 1 and denominator != e:
            return self(numerator) / self(denominator)
        return reduce(times, map(self, e.args))

    def _power(self, base: sm.Expr, exponent: sm.Expr) -> ca.SX:
        if exponent == sm.Rational(1, 2):
            return ca.sqrt(self(base))
        if exponent.is_Integer and 0 < abs(exponent) <= 6:
            power = reduce(times, [self(base)] * int(abs(exponent)))
            return power if exponent > 0 else 1 / power
        return self(base) ** self(exponent)

    def _piecewise(self, e: sm.Piecewise) -> ca.SX:
        result = ca.SX(0)
        for value, condition in reversed(e.args):
            result = (
                self(value)
                if condition == sm.true
                else ca.if_else(self._relation(condition), self(value), result)
            )
        return result

    def _relation(self, condition: sm.Basic) -> ca.SX:
        left, right = map(self, condition.args)
        relations = {
            sm.StrictLessThan: ca.lt,
            sm.LessThan: ca.le,
            sm.StrictGreaterThan: ca.gt,
            sm.GreaterThan: ca.ge,
        }
        return relations[condition.func](left, right)
