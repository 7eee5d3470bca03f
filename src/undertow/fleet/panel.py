"""The columns that every partition is reduced to: derivatives of the weak residual at the stated model."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from undertow.codegen.functions import Functions
from undertow.errors import UndertowError
from undertow.identification.diagnosis.candidates import Candidate, candidates
from undertow.identification.logs import Run
from undertow.identification.weak.data import WeakData, prepare
from undertow.identification.weak.disturbance import disturbed, first_guess, matched_disturbance
from undertow.identification.weak.fit import free_parameters, opened
from undertow.identification.weak.noise import Whitening
from undertow.identification.weak.residual import Linearised, WeakModel, whitened
from undertow.model.catalogue import Catalogue
from undertow.model.effect import Effect, Measurement
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

#: Effects that differ from day to day and tell nothing of the vehicle: water, ballast, payload.
DAILY = ("ocean_current", "net_buoyancy", "constant_force")


class Panel:
    """What is worked out of every log of a vehicle.

    The model is linearised where its file has it, with every effect of the catalogue at the value at which
    it changes nothing. The columns are those of the effects that differ from day to day, then the free
    parameters of the model, then what other effects would add: their score test needs no fit.

    Parameters
    ----------
    vehicle : Vehicle
        The model.
    known : mapping
        Effects by id.
    daily : sequence of str
        Ids of the effects that every log has a value of its own for.

    Raises
    ------
    UndertowError
        If nothing is to be estimated, or `daily` names what cannot have a value for each log.
    """

    def __init__(self, vehicle: Vehicle, known: Catalogue, daily: Sequence[str] = DAILY) -> None:
        self.vehicle = vehicle
        self.free = free_parameters(vehicle)
        if not self.free:
            raise UndertowError(
                f"no parameter of '{vehicle.name}' is to be estimated: write, for instance, "
                "X_u = { value = ..., estimate = true }"
            )
        simple = {name: effect for name, effect in known.items() if _has_a_score(effect)}
        scored = candidates(vehicle, simple)
        _refuse_unknown(daily, known, scored)
        self.candidates = (
            *(c for c in scored if c.id in daily),
            *(c for c in scored if c.id not in daily),
        )
        self.unscored = tuple(n for n, effect in known.items() if n not in simple and self._could_be(effect))
        self.daily = tuple(n for c in scored if c.id in daily for n in _names(c))

    def _could_be(self, effect: type[Effect]) -> bool:
        vehicle = self.vehicle
        present = any(e.id == effect.id for e in vehicle.all_effects)
        possible = not (effect.built_in or present or vehicle.lacks(effect))
        return possible and effect.suits(vehicle.degrees_of_freedom)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the columns that are kept, free parameters first."""
        rest = (n for c in self.candidates for n in _names(c))
        return tuple(dict.fromkeys((*self.free, *(n for n in rest if n not in self.daily))))

    @cached_property
    def own(self) -> dict[str, tuple[str, ...]]:
        """Columns of every effect that is scored, those that differ from day to day left out."""
        return {c.id: _names(c) for c in self.candidates if not set(_names(c)) & set(self.daily)}

    @cached_property
    def base(self) -> WeakModel:
        """The model as it is."""
        return WeakModel(Functions(self.vehicle), self.free)

    @cached_property
    def _extended(self) -> list[WeakModel]:
        """Models with effects added: forces all at once, sensors one by one, where equations stay short."""
        sensors = [c for c in self.candidates if issubclass(c.effect, Measurement)]
        forces = [c for c in self.candidates if c not in sensors]
        together = self.vehicle
        for c in forces:
            together = together.with_effect(c.effect, {})
        own = tuple(dict.fromkeys((*self.free, *(n for c in forces for n in _names(c)))))
        return [WeakModel(Functions(together), own), *(c.model(_names(c)) for c in sensors)]

    @property
    def models(self) -> tuple[WeakModel, ...]:
        """The models that the columns are made from, the one as it is first."""
        return (self.base, *self._extended)

    def table(self, run: Run) -> Linearised:
        """Rows of a log in units of their noise; the columns that differ from day to day come first.

        Raises
        ------
        UndertowError
            If a channel is missing, or no stretch is long enough.
        """
        data = prepare([run], self.vehicle)
        p = _values(self.base)
        noise = self._noise(data, p)
        columns = self._columns(data)
        parts = self.base.linearise(data, p)
        wide = [Linearised(a.r, c, a.start, a.known) for a, c in zip(parts, columns, strict=True)]
        return whitened(wide, noise)

    def _noise(self, data: WeakData, p: Array) -> list[Whitening]:
        """Noise of the sensors, and on top what the model leaves after one step of its own."""
        first = first_guess(self.base, data, p)
        quiet = self.base.whitening(data, p)
        fit = opened(self.base, data, {}, disturbed(quiet, first, data), first, steps=1)
        return disturbed(quiet, matched_disturbance(fit, quiet), data)

    def _columns(self, data: WeakData) -> list[Array]:
        found: list[dict[str, Array]] = [{} for _ in data.segments]
        for model in self._extended:
            for known, part in zip(found, model.linearise(data, _values(model)), strict=True):
                known.update(zip(model.free, part.J.T, strict=True))
        order = (*self.daily, *self.names)
        return [np.column_stack([known[n] for n in order]) for known in found]


def _values(model: WeakModel) -> Array:
    return np.array(model.functions.values(), dtype=float)


def _names(candidate: Candidate) -> tuple[str, ...]:
    """Parameters that one step can find; those that need a search are as the catalogue has them."""
    return tuple(p.name for p in candidate.parameters if not p.assumed)


def _has_a_score(effect: type[Effect]) -> bool:
    """Whether one step from where an effect vanishes says what it is worth.

    Not so for what has to be looked for (a delay, a dead band), and for states of its own.
    """
    own = effect.specimen()
    sought = [p for p in own.parameters if not p.assumed]
    return not own.states and all(p.linear or set(p.starts) == {0.0} for p in sought)


def _refuse_unknown(daily: Sequence[str], known: Catalogue, scored: Sequence[Candidate]) -> None:
    for name in daily:
        if name not in known:
            raise UndertowError(f"'{name}' is no effect of the catalogue: undertow effects lists them")
        if name not in {c.id for c in scored} and name not in DAILY:
            raise UndertowError(
                f"'{name}' cannot have a value for each day: the model has it already, its degrees of "
                f"freedom do not show it, or it has to be searched for; possible are "
                f"{', '.join(c.id for c in scored)}"
            )
