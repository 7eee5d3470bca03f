"""A parameter's entry in a vehicle file: a number, a text with a unit or a small table, kept in its style."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import isclose
from typing import Any

import tomlkit
from tomlkit.items import InlineTable

from .tomltext import safe
from .units import si_of, si_unit, unit_of

# Ten significant digits are written, which is half of this at worst.
_SAME = 1e-9
_ORDER = (
    *("value", "forward", "backward", "assumed", "estimate"),
    *("sigma", "sigma_forward", "sigma_backward", "allow_sign", "override", "source"),
)
# Files say "kg m^2" where an effect declares "N m/((rad/s)^2)".
_RADIANS = re.compile(r"/rad(\^\d)?")
_QUANTITIES = ("value", "forward", "backward", "sigma", "sigma_forward", "sigma_backward")


@dataclass(frozen=True)
class Wanted:
    """What an entry is to say, SI and in the signs of the file.

    Attributes
    ----------
    numbers : mapping
        The value by its key: "value", or "forward" and "backward".
    sigmas : mapping
        Standard deviations by the same keys.
    unit : str
        SI unit of the parameter.
    override : bool
        Whether it has to say that another table tells something else.
    """

    numbers: Mapping[str, float]
    sigmas: Mapping[str, float]
    unit: str
    estimate: bool = False
    assumed: bool = False
    override: bool = False
    source: str = ""

    def fitted(self, source: str) -> Wanted:
        """The same with a new source, which is no assumption."""
        return replace(self, source=source, assumed=False)

    def quantities(self) -> dict[str, float]:
        """Numbers and standard deviations by their keys in the file."""
        if len({*self.sigmas.values()}) == 1 and len(self.sigmas) == len(self.numbers):
            return {**self.numbers, "sigma": next(iter(self.sigmas.values()))}
        own = {"sigma" if key == "value" else f"sigma_{key}": v for key, v in self.sigmas.items()}
        return {**self.numbers, **own}

    def differs(self, raw: Any, place: str) -> bool:
        """Whether an entry of the file says other numbers."""
        old, new = _fields(raw), self.quantities()
        present = {k for k in _QUANTITIES if k in old}
        return present != set(new) or not all(_same(old[k], new[k], self.unit, place) for k in new)


def update_entry(raw: Any, wanted: Wanted, place: str) -> Any:
    """The new entry for what stands in the file (None: nothing stands there), or None where it can stay.

    A table is changed in place and keeps whatever else it says.
    """
    old, changed = _fields(raw), wanted.differs(raw, place)
    fields = _changed_fields(old, wanted, place) if changed else {}
    if wanted.estimate != bool(old.get("estimate", False)):
        fields["estimate"] = wanted.estimate or None
    if raw is not None and not fields:
        return None
    if isinstance(raw, Mapping):
        return _updated(raw, fields)
    fields = {k: v for k, v in (old | fields).items() if v is not None}
    return fields["value"] if set(fields) == {"value"} else _inline(fields)


def _changed_fields(old: Mapping[str, Any], wanted: Wanted, place: str) -> dict[str, Any]:
    """Keys with their new values, None for those that go."""
    like = _like(old, wanted.unit)
    new = wanted.quantities()
    gone = {k: None for k in _QUANTITIES if k in old and k not in new}
    written = {
        k: stated(number, wanted.unit, old.get(k, like))
        for k, number in new.items()
        if k not in old or not _same(old[k], number, wanted.unit, place)
    }
    numbers = {k: v for k, v in written.items() if k in wanted.numbers}
    told = {"estimate": True} if wanted.estimate else {}
    sigmas = {k: v for k, v in written.items() if k not in numbers}
    source = {"source": wanted.source} if wanted.source else {}
    assumed = {"assumed": True if wanted.assumed else None} if wanted.assumed or "assumed" in old else {}
    override = {"override": True} if wanted.override else {}
    return gone | numbers | told | sigmas | source | assumed | override


def _fields(raw: Any) -> dict[str, Any]:
    if raw is None:
        return {}
    return dict(raw) if isinstance(raw, Mapping) else {"value": raw}


def _same(raw: Any, number: float, unit: str, place: str) -> bool:
    return isclose(si_of(place, raw, unit), number, rel_tol=_SAME / 2)


def _like(old: Mapping[str, Any], unit: str) -> Any:
    """A quantity whose style a new one follows: one of the same entry, or the SI unit."""
    first = next((old[k] for k in _QUANTITIES if k in old), None)
    if first is not None:
        return first
    if unit == "1" or "command" in unit:
        return 1.0
    return f"1 {_RADIANS.sub('', si_unit(unit)).replace('*', ' ') if '(' in unit else unit}"


def stated(number: float, unit: str, like: Any) -> str | float:
    """A number in the SI unit `unit` with ten digits, as the quantity `like` is written.

    Parameters
    ----------
    number : float
        The value in `unit`.
    unit : str
        Unit of the parameter.
    like : str or float
        ``"120 g"`` asks for grams and for text, a plain number for a plain number in `unit`.
    """
    if not isinstance(like, str):
        return float(f"{number:.10g}")
    found = unit_of(like)
    return f"{number / si_of(like, f'1{found}', unit):.10g}{found}"


def _updated(entry: Any, fields: Mapping[str, Any]) -> Any:
    if isinstance(entry, InlineTable):  # made anew: taking keys out of one leaves its spaces behind
        return _inline({k: v for k, v in {**entry, **fields}.items() if v is not None})
    for key, value in fields.items():
        if value is not None:
            entry[key] = safe(value)
        elif key in entry:
            entry.remove(key)
    return entry


def _inline(fields: Mapping[str, Any]) -> Any:
    ordered = sorted(fields, key=lambda k: _ORDER.index(k) if k in _ORDER else len(_ORDER))
    return tomlkit.value("{ " + ", ".join(f"{k} = {_text(fields[k])}" for k in ordered) + " }")


def _text(value: Any) -> str:
    return tomlkit.item(safe(value)).as_string()
