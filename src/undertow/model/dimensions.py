"""Dimensional analysis of SymPy expressions: what unit a formula has, and which term spoils it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import cache
from typing import TYPE_CHECKING

import sympy as sm

from undertow.errors import UndertowError

from .units import dimensionality

if TYPE_CHECKING:
    from pint.util import UnitsContainer as Dimension

# Zero fits any unit, so it has no dimension of its own.
ANY = None

_PLAIN_ARGUMENT = (
    *(sm.sin, sm.cos, sm.tan, sm.asin, sm.acos, sm.atan, sm.sinh, sm.cosh, sm.tanh, sm.exp, sm.log),
)
_FAMILIAR = ("N", "N m", "W", "m", "m/s", "m/s^2", "kg", "kg m", "kg m^2", "s", "rad/s^2")
_BASE = {"[length]": "m", "[mass]": "kg", "[time]": "s", "[temperature]": "K", "[current]": "A"}
_LONGEST_TERM = 70


@cache
def dimension(unit: str) -> Dimension:
    """Dimension of a unit text such as ``N/(m/s)^2``; angles are pure numbers, ``command`` stands for itself.

    Raises
    ------
    UndertowError
        If the unit is not understood.
    """
    return dimensionality(unit)


def unit_text(dim: Dimension | None) -> str:
    """A dimension in words: ``in N m``, ``without a unit``."""
    if dim is ANY:
        return "zero"
    return f"in {_unit_name(dim)}" if dim != dimension("1") else "without a unit"


def short_unit(unit: str) -> str:
    """A unit text as short as files have it: ``N/(m/s^2)`` gives ``kg``; plain ones stay as they are."""
    return _unit_name(dimension(unit)) if "(" in unit else unit


def _unit_name(dim: Dimension) -> str:
    familiar = [u for u in _FAMILIAR if dimension(u) == dim]
    if familiar:
        return familiar[0]
    powers = sorted((_BASE.get(str(n), str(n).strip("[]")), float(str(p))) for n, p in dim.items())
    above, below = ([(n, abs(p)) for n, p in powers if (p > 0) == side] for side in (True, False))
    over = " ".join(_factor(*f) for f in above) or "1"
    under = " ".join(_factor(*f) for f in below)
    return f"{over}/({under})" if len(below) > 1 else f"{over}/{under}" if under else over


def _factor(name: str, power: float) -> str:
    return name if power == 1 else f"{name}^{power:g}"


def dimension_of(expression: sm.Expr, units: Mapping[sm.Symbol, str]) -> Dimension | None:
    """Dimension of an expression.

    Parameters
    ----------
    expression : Expr
        Built from sums, products, powers, the elementary functions, Abs, sign, Min, Max and Piecewise.
    units : mapping
        Unit text of every symbol in it.

    Returns
    -------
    Dimension or None
        None for zero, which fits any unit.

    Raises
    ------
    UndertowError
        If terms of different units are added or compared, a function that needs a pure number gets another
        unit, or something in the expression has no rule or no unit; the term and both units are named.
    """
    return _Analysis(units).of(sm.sympify(expression, strict=True))


def require_unit(expression: sm.Expr, unit: str, units: Mapping[sm.Symbol, str]) -> None:
    """Make sure that an expression is in `unit`.

    Raises
    ------
    UndertowError
        As `dimension_of`, and if the whole has another unit; the first term of it is named.
    """
    for term in sm.Add.make_args(sm.sympify(expression, strict=True)):
        found = dimension_of(term, units)
        if found is not ANY and found != dimension(unit):
            raise UndertowError(f"the term {_short(term)} is {unit_text(found)} where {unit} is wanted")


class _Analysis:
    """One walk over an expression; equal subexpressions are looked at once."""

    def __init__(self, units: Mapping[sm.Symbol, str]) -> None:
        self._units = units
        self._seen: dict[sm.Basic, Dimension | None] = {}

    def of(self, e: sm.Basic) -> Dimension | None:
        if e not in self._seen:
            self._seen[e] = self._rule(e)(e)
        return self._seen[e]

    def _rule(self, e: sm.Basic) -> Callable[[sm.Basic], Dimension | None]:
        rules: tuple[tuple[tuple[type, ...], Callable[[sm.Basic], Dimension | None]], ...] = (
            ((sm.Symbol,), self._symbol),
            ((sm.Number, sm.NumberSymbol), lambda x: ANY if x.is_zero else dimension("1")),
            ((sm.Add, sm.Min, sm.Max), lambda x: self._common(x.args, x)),
            ((sm.Mul,), self._product),
            # exp is a power in SymPy's eyes, so plain functions come first.
            (_PLAIN_ARGUMENT, self._plain),
            ((sm.Pow,), self._power),
            ((sm.Abs,), lambda x: self.of(x.args[0])),
            ((sm.sign,), self._sign),
            ((sm.atan2,), self._sign),
            ((sm.Piecewise,), self._piecewise),
        )
        for kinds, rule in rules:
            if isinstance(e, kinds):
                return rule
        raise UndertowError(
            f"{_short(e)} has no rule for units: use elementary functions, Abs, sign, Min, Max, Piecewise"
        )

    def _symbol(self, e: sm.Basic) -> Dimension | None:
        if e not in self._units:
            raise UndertowError(f"the symbol {e} has no unit: it is no signal and no parameter of the effect")
        return dimension(self._units[e])

    def _common(self, args: Iterable[sm.Basic], whole: sm.Basic) -> Dimension | None:
        first: tuple[sm.Basic, Dimension] | None = None
        for arg in args:
            found = self.of(arg)
            if first is None and found is not ANY:
                first = (arg, found)
            elif first is not None and found not in (ANY, first[1]):
                raise UndertowError(
                    f"in {_short(whole)} the term {_short(first[0])} is {unit_text(first[1])} "
                    f"but {_short(arg)} is {unit_text(found)}"
                )
        return first[1] if first else ANY

    def _product(self, e: sm.Basic) -> Dimension | None:
        factors = [self.of(arg) for arg in e.args]
        result = dimension("1")
        for factor in factors:
            if factor is ANY:
                return ANY
            result = result * factor
        return result

    def _power(self, e: sm.Basic) -> Dimension | None:
        base, exponent = e.args
        found = self.of(base)
        self._require_plain(exponent, e)
        if found in (ANY, dimension("1")):
            return found
        if not exponent.is_Rational:
            raise UndertowError(f"{_short(e)} raises a term {unit_text(found)} to a power that is no number")
        return found ** (int(exponent) if exponent.is_Integer else float(exponent))

    def _plain(self, e: sm.Basic) -> Dimension | None:
        self._require_plain(e.args[0], e)
        return dimension("1")

    def _require_plain(self, arg: sm.Basic, whole: sm.Basic) -> None:
        found = self.of(arg)
        if found not in (ANY, dimension("1")):
            raise UndertowError(
                f"{_short(whole)} needs a pure number but {_short(arg)} is {unit_text(found)}"
            )

    def _sign(self, e: sm.Basic) -> Dimension | None:
        self._common(e.args, e)
        return dimension("1")

    def _piecewise(self, e: sm.Basic) -> Dimension | None:
        for relation in e.atoms(sm.core.relational.Relational):
            self._common(relation.args, relation)
        return self._common([value for value, _ in e.args], e)


def _short(e: sm.Basic) -> str:
    text = str(e)
    return f"'{text if len(text) <= _LONGEST_TERM else text[:_LONGEST_TERM] + '...'}'"
