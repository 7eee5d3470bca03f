"""Physical units of files, and dimensional analysis of expressions."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import sympy as sm

from undertow.errors import UndertowError

if TYPE_CHECKING:
    from pint import Unit, UnitRegistry
    from pint.util import UnitsContainer as Dimension


_NUMBER = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)(.*)", re.DOTALL | re.ASCII)
# Names, products, quotients, parentheses and one-digit exponents: nothing that could be a large computation.
_UNIT = re.compile(
    r"(?:1(?= ?/|$))?(?:[A-Za-z\u00b5\u03bc\u03a9\u00b0%_]|\^[+-]?\d(?![\d.^])|[*/() ])*", re.ASCII
)


@dataclass(frozen=True)
class TextSettings:
    """How much text is read as a unit, and shown in errors."""

    longest_unit: int = 80  # characters of a unit; a number with its unit may have twice as many
    longest_term: int = 70  # characters of a term that an error shows


_TEXT = TextSettings()


@dataclass(frozen=True)
class PulseSettings:
    """Pulses of common servos and motor controllers, 1100 to 1900 us."""

    neutral: float = 1500.0  # without thrust, us
    span: float = 400.0  # from there to full thrust, us


PULSES = PulseSettings()
_PLAIN = str.maketrans({"²": "^2", "³": "^3", "·": " ", "⋅": " "})
_HOW = "write it like 'kg m^2' or 'N/(m/s)^2'"


@cache
def registry() -> UnitRegistry:
    """Return the one pint registry of the program; pint is slow to import and comes in on first use."""
    import pint

    units: UnitRegistry = pint.UnitRegistry()
    # What a command is measured in is the thruster's own affair: it cancels only against itself.
    units.define("command = [command]")
    units.define("@alias revolution = rev")  # rev/s, as vehicle files spell it
    return units


def to_si(value: str | float, unit: str) -> float:
    """A value from a file (``"7.5 kg"``, or a number in `unit` already) as a number in the SI unit `unit`."""
    if isinstance(value, str):
        number, found = _split(value, unit)
        scale, offset = scale_offset(found, unit, of=f"{value!r}")
        return _finite(scale * number + offset, value, unit)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise UndertowError(f"{value!r} is not a quantity: write a number or a text such as '1.5 {unit}'")
    return _finite(value, value, unit)


def magnitude(value: str | float, unit: str, of: str) -> float:
    """A size from a file, which is more than zero, in the SI unit `unit`."""
    found = si_of(of, value, unit)
    if found <= 0:
        raise UndertowError(f"{of} is {value!r}: give a value above zero, such as '0.1 {unit}'")
    return found


def si_of(place: str, raw: Any, unit: str) -> float:
    """A quantity in SI; what is counted in commands may be written as a plain number or in "command"."""
    texts = [unit, _without_command(unit)] if isinstance(raw, str) else [_without_command(unit)]
    for text in dict.fromkeys(texts):
        try:
            return to_si(raw, text)
        except UndertowError as error:
            complaint = error
    raise UndertowError(f"{place}: {complaint}") from complaint


def _without_command(unit: str) -> str:
    plain = re.sub(r"\s*/\s*command|\bcommand\b\s*", "", unit).strip()
    return f"1{plain}" if plain.startswith("/") else plain or "1"


def unit_of(value: str) -> str:
    """Return the unit text of a quantity as it is written: ``"7.5 kg"`` gives ``" kg"``."""
    return _split(value, "m")[1].rstrip()


def scale_offset(unit_from: str, unit_to: str, of: str = "") -> tuple[float, float]:
    """Return `scale` and `offset` such that ``in_unit_to = scale * in_unit_from + offset``."""
    if unit_from.strip() == unit_to.strip():
        return 1.0, 0.0
    source, target = _unit(unit_from), _unit(unit_to)
    if source.dimensionality != target.dimensionality:
        found = "no unit" if source.dimensionless else f"the dimension {source.dimensionality}"
        wanted = "a pure number" if unit_to.strip() in ("", "1") else f"{unit_to} ({target.dimensionality})"
        raise UndertowError(
            f"{of or repr(unit_from)} has {found}, but {wanted} is needed: use a matching unit"
        )
    return _affine(unit_from, unit_to)


def si_unit(unit: str) -> str:
    """Return the SI base unit that a unit converts to: ``"rpm"`` gives ``"rad/s"``, ``"%"`` gives ``"1"``."""
    base = registry().Quantity(1.0, _unit(unit)).to_base_units().units
    return f"{base:~C}".replace("**", "^") or "1"


def same_unit(one: str, other: str) -> bool:
    """Tell whether a number means the same in two units."""
    return dimension(one) == dimension(other) and scale_offset(one, other) == (1.0, 0.0)


def is_unit(text: str) -> bool:
    """Tell whether a text is a unit that can be converted."""
    try:
        _unit(text)
    except UndertowError:
        return False
    return True


def base_exponents(unit: str) -> tuple[float, dict[str, int]]:
    """Scale to the SI base units, and their exponents: ``"kN/rad"`` gives 1000 and kg, m, s, rad."""
    units = registry()
    found = units.Quantity(1.0, _unit(re.sub(r"\brev\b", "turn", unit))).to_base_units()
    # A turn is 2 pi radians: pint gives the number, and keeps rad as a base unit of its own.
    exponents = {f"{units.Unit(name):~C}": round(float(str(e))) for name, e in found.units._units.items()}
    return float(found.m), exponents


@cache
def _affine(unit_from: str, unit_to: str) -> tuple[float, float]:
    try:
        zero, one, two = (
            float(registry().Quantity(number, _unit(unit_from)).m_as(_unit(unit_to)))
            for number in (0.0, 1.0, 2.0)
        )
    except Exception as error:  # offset units in products: pint has several kinds of complaint
        raise UndertowError(f"unit {unit_from!r} cannot be converted: give it in {unit_to}") from error
    # An offset unit (degC) moves zero; any other scale is taken without the rounding of a difference.
    scale = one - zero if zero else one
    if not math.isclose(two, 2 * scale + zero, rel_tol=1e-9):
        raise UndertowError(f"unit {unit_from!r} is not proportional to {unit_to}: give it in {unit_to}")
    return scale, zero


@cache
def _unit(text: str) -> Unit:
    plain = re.sub(r"\s*(?:\^|\*\*)\s*", "^", text.strip().translate(_PLAIN))
    plain = re.sub(r"\bNm\b", "N m", plain)  # pint reads Nm as a textile unit; every log means newton metre
    if len(plain) > _TEXT.longest_unit or not _UNIT.fullmatch(plain):
        raise UndertowError(f"unit {text[: _TEXT.longest_unit]!r} is not understood: {_HOW}")
    plain = re.sub(r"^(?:1|$)", "dimensionless", plain)
    try:
        return registry().parse_units(plain)
    except Exception as error:  # pint raises a dozen kinds: undefined names, parentheses, assertions …
        raise UndertowError(f"unit {text!r} is not understood: {_HOW}") from error


def _split(text: str, wanted: str) -> tuple[float, str]:
    plain = text.strip()
    match = _NUMBER.fullmatch(plain) if len(plain) <= 2 * _TEXT.longest_unit else None
    if match is None:
        raise UndertowError(
            f"{text[: _TEXT.longest_unit]!r} is not a number with a unit: write it like '1.5 {wanted}'"
        )
    return float(match[1]), match[2]


def _finite(number: float, value: object, unit: str) -> float:
    wanted = "a pure number" if unit.strip() in ("", "1") else f"a number in {unit}"
    try:
        result = float(number)
    except OverflowError:
        result = math.inf
    if not math.isfinite(result):
        # An integer of thousands of digits cannot even be printed.
        shown = value if isinstance(value, str | float) else f"{type(value).__name__} out of range"
        raise UndertowError(f"{str(shown)[: _TEXT.longest_unit]!r} is not a finite quantity: give {wanted}")
    return result


# Zero fits any unit, so it has no dimension of its own.
ANY = None

_PLAIN_ARGUMENT = (
    sm.sin, sm.cos, sm.tan, sm.asin, sm.acos, sm.atan, sm.sinh, sm.cosh, sm.tanh, sm.exp, sm.log
)  # fmt: skip
_FAMILIAR = ("N", "N m", "W", "m", "m/s", "m/s^2", "kg", "kg m", "kg m^2", "s", "rad/s^2")
_BASE = {"[length]": "m", "[mass]": "kg", "[time]": "s", "[temperature]": "K", "[current]": "A"}


@cache
def dimension(unit: str) -> Dimension:
    """Dimension of a unit text such as ``N/(m/s)^2``; angles are pure numbers, ``command`` is its own."""
    return _unit(unit).dimensionality


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
    """Dimension of an expression; None for zero, which fits any unit."""
    return _Analysis(units).of(sm.sympify(expression, strict=True))


def require_unit(expression: sm.Expr, unit: str, units: Mapping[sm.Symbol, str]) -> None:
    """Make sure that an expression is in `unit`."""
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
            (_PLAIN_ARGUMENT, lambda x: self._require_number(x.args[0], x)),
            ((sm.Pow,), self._power),
            ((sm.Abs,), lambda x: self.of(x.args[0])),
            ((sm.sign, sm.atan2), self._sign),
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
            raise UndertowError(
                f"the symbol {e} has no unit: it is neither a signal nor a parameter of the effect"
            )
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
        self._require_number(exponent, e)
        if found in (ANY, dimension("1")):
            return found
        if not exponent.is_Rational:
            raise UndertowError(
                f"{_short(e)} raises a term {unit_text(found)} to a power that is not a number"
            )
        return found ** (int(exponent) if exponent.is_Integer else float(exponent))

    def _require_number(self, arg: sm.Basic, whole: sm.Basic) -> Dimension:
        found = self.of(arg)
        if found not in (ANY, dimension("1")):
            raise UndertowError(
                f"{_short(whole)} needs a pure number but {_short(arg)} is {unit_text(found)}"
            )
        return dimension("1")

    def _sign(self, e: sm.Basic) -> Dimension | None:
        self._common(e.args, e)
        return dimension("1")

    def _piecewise(self, e: sm.Basic) -> Dimension | None:
        for relation in e.atoms(sm.core.relational.Relational):
            self._common(relation.args, relation)
        return self._common([value for value, _ in e.args], e)


def _short(e: sm.Basic) -> str:
    text = str(e)
    return f"'{text if len(text) <= _TEXT.longest_term else text[: _TEXT.longest_term] + '...'}'"
