"""What a vehicle file states in one table and needs in two: one mass, one centre of gravity."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import inf, isclose
from typing import Any

import sympy as sm

from undertow.errors import UndertowError

from .effect import Effect
from .parameter import Taken, printed
from .symbols import symbol
from .units import si_of
from .vehicle_schema import ParameterTable

# Below this, m or N, two numbers that should be zero are.
_NOTHING = 1e-9


@dataclass(frozen=True)
class Statements:
    """The numbers that the effect tables of a vehicle file state.

    Attributes
    ----------
    effects : sequence of Effect
        The effects of the file.
    tables : mapping
        Their tables by id, as they stand in the file.
    environment : mapping
        `rho`, kg/m^3, and `g`, m/s^2.
    signs : str
        Convention of the file.
    """

    effects: Sequence[Effect]
    tables: Mapping[str, Mapping[str, Any]]
    environment: Mapping[str, float]
    signs: str

    @cached_property
    def _own(self) -> dict[str, dict[str, float]]:
        """Numbers that hold for the whole vehicle, SI and SNAME signs, by effect and key."""
        return {e.id: self._numbers(e) for e in self.effects if e.id in self.tables}

    def _numbers(self, effect: Effect) -> dict[str, float]:
        parameters = {p.name: p for p in effect.parameters}
        units = {n: p.unit for n, p in parameters.items()} | effect.file_units()
        found = {}
        for key, entry in self.tables[effect.id].items():
            raw = field_of(entry, "value")
            if key in units and raw is not None and not field_of(entry, "override"):
                number = si_of(f"[effects.{effect.id}] {key}", raw, units[key])
                found[key] = printed(parameters[key], number, self.signs) if key in parameters else number
        return found

    def taken(self, effect: Effect) -> dict[str, float]:
        """What other tables tell of an effect and its own leaves open, by key, SI."""
        own = self.tables.get(effect.id, {})
        told = {t.key: self._told(t) for t in effect.taken if not {t.key, *t.unless} & own.keys()}
        return {k: v for k, v in told.items() if v is not None}

    def completed(self) -> dict[str, dict[str, Any]]:
        """The tables with what each takes from others."""
        return {e.id: {**self.tables[e.id], **self._entries(e)} for e in self.effects}

    def _entries(self, effect: Effect) -> dict[str, ParameterTable]:
        owners = {t.key: t.owner for t in effect.taken}
        return {
            key: ParameterTable(value=value, source=f"taken from [effects.{owners[key]}]")
            for key, value in self.taken(effect).items()
        }

    def _told(self, taken: Taken) -> float | None:
        stated = self._own.get(taken.owner)
        if stated is None:
            return None
        known = {symbol(n): sm.Float(v) for n, v in {**self.environment, **stated}.items()}
        for formula in taken.formulas:
            if formula.free_symbols <= known.keys():
                return float(formula.subs(known))
        return None

    def differing(self) -> Iterator[str]:
        """One line for every value that another table tells otherwise, unless it says that it overrides.

        Raises
        ------
        UndertowError
            If two differ by more than can be, or an override has nothing to override.
        """
        for effect in self.effects:
            for key, entry in self.tables[effect.id].items():
                yield from self._difference(effect, key, entry)

    def _difference(self, effect: Effect, key: str, entry: Any) -> Iterator[str]:
        place = f"[effects.{effect.id}] {key}"
        taken = next((t for t in effect.taken if t.key == key), None)
        meant = bool(field_of(entry, "override"))
        if taken is None or taken.only_where_silent:
            if meant:
                raise UndertowError(f"{place} overrides nothing, no other table tells it: remove 'override'")
            return
        told, raw = self._told(taken), field_of(entry, "value")
        if meant or told is None or raw is None:
            return
        value = si_of(place, raw, taken.unit)
        if not isclose(value, told, rel_tol=taken.rounding, abs_tol=_NOTHING):
            fitted = bool(field_of(entry, "estimate")) or self._fitted(taken)
            yield _differs(place, value, told, taken, most=inf if fitted else taken.most)

    def _fitted(self, taken: Taken) -> bool:
        """Whether a fit may have moved what the owner tells; what it found must fit into a file."""
        names = {str(x) for formula in taken.formulas for x in formula.free_symbols}
        owner = self.tables.get(taken.owner, {})
        return any(field_of(owner[n], "estimate") for n in names & owner.keys())


def _differs(place: str, value: float, told: float, taken: Taken, most: float) -> str:
    other = f"{taken.words or taken.key} = {told:g} {taken.unit} by [effects.{taken.owner}]"
    line = f"{place} = {value:g} {taken.unit}, but {other}"
    how = "remove it to use the latter, or write { value = ..., override = true } if both are meant"
    if max(abs(value), abs(told)) > most * min(abs(value), abs(told)):
        raise UndertowError(f"{line}: no vehicle has both (limit: a factor of {most:g}); {how}")
    return f"{line}: {how}"


def field_of(entry: Any, name: str) -> Any:
    """A field of a parameter's entry, which is a quantity or a table; a plain quantity is its value."""
    if isinstance(entry, ParameterTable):
        return getattr(entry, name)
    if isinstance(entry, Mapping):
        return entry.get(name)
    return entry if name == "value" else None
