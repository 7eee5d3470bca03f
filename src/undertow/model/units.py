"""Physical units at the file border; inside undertow every number is in SI.

Unit texts come from files of other people: they must match a small grammar before pint
sees them, so that ``9^9^9^9`` or a Python expression is refused and never worked out.
"""

from __future__ import annotations

import math
import re
from functools import cache
from typing import TYPE_CHECKING, Any

from undertow.errors import UndertowError

if TYPE_CHECKING:
    from pint import Unit, UnitRegistry
    from pint.util import UnitsContainer

_NUMBER = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)(.*)", re.DOTALL | re.ASCII)
# Names, products, quotients, parentheses and one-digit exponents: nothing that could be a large computation.
_UNIT = re.compile(
    r"(?:1(?= ?/|$))?(?:[A-Za-z\u00b5\u03bc\u03a9\u00b0%_]|\^[+-]?\d(?![\d.^])|[*/() ])*", re.ASCII
)
_LONGEST = 80
_PLAIN = str.maketrans({"²": "^2", "³": "^3", "·": " ", "⋅": " "})
_HOW = "write it like 'kg m^2' or 'N/(m/s)^2'"


@cache
def registry() -> UnitRegistry:
    """Return the one pint registry of the program; pint is slow to import and comes in on first use."""
    import pint

    units: UnitRegistry = pint.UnitRegistry()
    # What a command is measured in is the thruster's own affair: it cancels only against itself.
    units.define("command = [command]")
    return units


def to_si(value: str | float, unit: str) -> float:
    """Convert a value from a file to a number in the SI unit wanted.

    Parameters
    ----------
    value : str or float
        ``"7.5 kg"``, or a plain number, which is taken to be in `unit` already.
    unit : str
        The SI unit wanted, such as ``"kg m^2"``; ``"1"`` for a pure number.

    Returns
    -------
    float
        The value in `unit`.

    Raises
    ------
    UndertowError
        If the text is not a finite number with a unit, or the unit has another dimension than `unit`.
    """
    if isinstance(value, str):
        number, found = _split(value, unit)
        scale, offset = scale_offset(found, unit, of=f"{value!r}")
        return _finite(scale * number + offset, value, unit)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise UndertowError(f"{value!r} is not a quantity: write a number or a text such as '1.5 {unit}'")
    return _finite(value, value, unit)


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
    """Return the unit text of a quantity as it is written: ``"7.5 kg"`` gives ``" kg"``.

    Raises
    ------
    UndertowError
        If the text does not begin with a number.
    """
    return _split(value, "m")[1].rstrip()


def scale_offset(unit_from: str, unit_to: str, of: str = "") -> tuple[float, float]:
    """Return `scale` and `offset` such that ``in_unit_to = scale * in_unit_from + offset``.

    Parameters
    ----------
    unit_from, unit_to : str
        Unit texts, such as ``"deg"`` and ``"rad"``.
    of : str
        What the unit was found in, for the error message.

    Raises
    ------
    UndertowError
        If a unit is not understood, or the two have different dimensions.
    """
    if unit_from.strip() == unit_to.strip():
        return 1.0, 0.0
    source, target = _unit(unit_from), _unit(unit_to)
    if source.dimensionality != target.dimensionality:
        found = "no unit" if source.dimensionless else f"the dimension {source.dimensionality}"
        wanted = "a pure number" if unit_to.strip() in ("", "1") else f"{unit_to} ({target.dimensionality})"
        raise UndertowError(
            f"{of or repr(unit_from)} has {found}, but {wanted} is wanted: use a fitting unit"
        )
    return _affine(unit_from, unit_to)


def si_unit(unit: str) -> str:
    """Return the SI base unit that a unit converts to: ``"rpm"`` gives ``"rad/s"``, ``"%"`` gives ``"1"``.

    Raises
    ------
    UndertowError
        If the unit is not understood.
    """
    base = registry().Quantity(1.0, _unit(unit)).to_base_units().units
    return f"{base:~C}".replace("**", "^") or "1"


def dimensionality(unit: str) -> UnitsContainer:
    """Return the dimension of a unit text, with `*`, `/`, `**` like a unit; a pure number has an empty one.

    Raises
    ------
    UndertowError
        If the unit is not understood.
    """
    return _unit(unit).dimensionality


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
    if len(plain) > _LONGEST or not _UNIT.fullmatch(plain):
        raise UndertowError(f"unit {text[:_LONGEST]!r} is not understood: {_HOW}")
    plain = re.sub(r"^(?:1|$)", "dimensionless", plain)
    try:
        return registry().parse_units(plain)
    except Exception as error:  # pint raises a dozen kinds: undefined names, parentheses, assertions …
        raise UndertowError(f"unit {text!r} is not understood: {_HOW}") from error


def _split(text: str, wanted: str) -> tuple[float, str]:
    plain = text.strip()
    match = _NUMBER.fullmatch(plain) if len(plain) <= 2 * _LONGEST else None
    if match is None:
        raise UndertowError(f"{text[:_LONGEST]!r} is not a number with a unit: write it like '1.5 {wanted}'")
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
        raise UndertowError(f"{str(shown)[:_LONGEST]!r} is not a finite quantity: give {wanted}")
    return result
