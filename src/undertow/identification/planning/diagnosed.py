"""Rivals out of a diagnosis: the effects that it could not tell apart, or those that lead its ranking."""

from __future__ import annotations

from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from undertow.errors import UndertowError
from undertow.files import read_json
from undertow.model.catalogue import Catalogue, lookup
from undertow.model.parameter import printed
from undertow.model.vehicle import Vehicle

from .rivals import AND, NONE, RivalSpec, parts_of

_MOST = 3


class _Estimate(BaseModel):
    model_config = ConfigDict(allow_inf_nan=False)

    name: str
    value: float


class _Ranked(BaseModel):
    effect: str
    significant: bool
    parameters: list[_Estimate]


class _Set(BaseModel):
    effects: list[str]


class Diagnosed(BaseModel):
    """What a plan needs of a diagnosis; all else in the file is passed over."""

    schema_id: str
    vehicle: str
    signs: str
    verdict: str
    effects: list[str]
    ranking: list[_Ranked]
    indistinguishable: list[_Set]
    parameters: list[_Estimate]

    @property
    def rivals(self) -> list[str]:
        """Effects to be told apart, at most three; "none" stands for the model without any."""
        found = self.indistinguishable[0].effects if self.indistinguishable else self._leading()
        named = list(dict.fromkeys(found))[:_MOST]
        return named if len(named) > 1 else [*named, NONE]

    def _leading(self) -> list[str]:
        tried = [r.effect for r in self.ranking if r.parameters]
        sure = [r.effect for r in self.ranking if r.significant]
        return list(dict.fromkeys([*self.effects[:1], *(sure if len(sure) > 1 else tried[:2])]))

    @property
    def settled(self) -> list[str]:
        """Effects that were named beside those in question, and so are in every rival."""
        if not self.indistinguishable:
            return []
        return [e for e in self.effects if all(e not in s.effects for s in self.indistinguishable)]

    def values(self, effect: str) -> dict[str, float]:
        """Values in the file's sign convention: those of the last model, and the effect's own."""
        own = next((r.parameters for r in self.ranking if r.effect == effect), [])
        return {e.name: e.value for e in [*self.parameters, *own]}


def read_diagnosis(path: Path) -> Diagnosed:
    """Read what `undertow diagnose --json` wrote.

    Raises
    ------
    UndertowError
        If the file cannot be read, or is no diagnosis.
    """
    try:
        found = Diagnosed.model_validate_json(read_json(path, "diagnosis"))
    except ValidationError as failure:
        first = failure.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the whole"
        raise UndertowError(
            f"'{path}' is no diagnosis ({where}: {first['msg'].lower()}): give the file that "
            "'undertow diagnose --json' wrote"
        ) from failure
    if not found.schema_id.startswith("undertow/diagnosis/"):
        raise UndertowError(
            f"'{path}' holds '{found.schema_id}', not a diagnosis: give the file of diagnose --json"
        )
    return found


def specs_of(diagnosed: Diagnosed, vehicle: Vehicle, known: Catalogue) -> list[RivalSpec]:
    """The rivals that a diagnosis leaves, with the values that it found.

    Raises
    ------
    UndertowError
        If an effect is unknown or the diagnosis is of another vehicle.
    """
    if diagnosed.vehicle != vehicle.name:
        raise UndertowError(
            f"the diagnosis is of '{diagnosed.vehicle}', the vehicle file of '{vehicle.name}': give those "
            "that belong together"
        )
    rivals = diagnosed.rivals
    if rivals == [NONE]:
        raise UndertowError(
            f"the diagnosis ({diagnosed.verdict}) names no effect to tell apart: name some with --between"
        )
    return [_spec(diagnosed, vehicle, known, effect) for effect in rivals]


def _spec(diagnosed: Diagnosed, vehicle: Vehicle, known: Catalogue, effect: str) -> RivalSpec:
    parts = [*diagnosed.settled, *parts_of(effect)]
    for part in parts:
        vehicle = vehicle.with_effect(lookup(part, known), {})
    values = {
        name: printed(parameter, value, diagnosed.signs)
        for name, value in diagnosed.values(effect).items()
        if (parameter := vehicle.parameter_of(name)) is not None
    }
    return RivalSpec(AND.join(parts) if parts else NONE, values)
