"""Models to be told apart: the vehicle with each of the effects that may be missing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from undertow.errors import UndertowError
from undertow.model.catalogue import Catalogue, lookup
from undertow.model.vehicle import Vehicle

from ..diagnosis.candidates import Candidate
from ..diagnosis.scouting import scout
from ..diagnosis.trial import Bench, open_bench
from ..logs import Run
from ..weak.data import prepare
from ..weak.fit import WeakFit, free_parameters, settled
from ..weak.residual import WeakModel
from .families import Family
from .flight import Airspace, Plant
from .information import Knowledge, knowledge_of, stated
from .sizes import typical_values

NONE = "none"
"""Stands for the model as it is."""
AND = "+"
"""Joins effects that one model has together."""


@dataclass(frozen=True)
class RivalModel:
    """A model that could be the true one.

    Attributes
    ----------
    name : str
        Ids of its effects joined by +, or "none".
    plant : Plant
        The model at its values.
    known : Knowledge
        What priors and logs say of its free parameters.
    model : WeakModel
        Its weak residual, with the free parameters.
    own : tuple of str
        Parameters of the effects that it has beyond the others.
    source : str
        Where their values come from.
    """

    name: str
    plant: Plant
    known: Knowledge
    model: WeakModel
    own: tuple[str, ...]
    source: str

    @property
    def parts(self) -> frozenset[str]:
        """Ids of its effects."""
        return frozenset(parts_of(self.name))


def parts_of(name: str) -> list[str]:
    """Ids of the effects in the name of a rival."""
    return [] if name == NONE else [part.strip() for part in name.split(AND)]


@dataclass(frozen=True)
class RivalSpec:
    """A model to be told apart as it is asked for.

    Attributes
    ----------
    name : str
        Ids of effects joined by +, or "none".
    values : mapping
        Values of parameters as far as known, SNAME signs.
    """

    name: str
    values: Mapping[str, float]

    def candidate(self, vehicle: Vehicle, known: Catalogue) -> Candidate | None:
        """The last of its effects, added to the vehicle with the others; None for the model as it is.

        Raises
        ------
        UndertowError
            If an effect is unknown, or adds nothing to the vehicle.
        """
        if self.name == NONE:
            return None
        *others, last = parts_of(self.name)
        for effect in others:
            first = _checked(effect, vehicle, known)
            vehicle = first.adopted({**beginning(first), **self.values})
        return _checked(last, vehicle, known)


def beginning(candidate: Candidate) -> dict[str, float]:
    """Values with which an effect does nothing yet, as far as its parameters can be such."""
    return {
        p.name: p.neutral if p.neutral is not None else (p.starts[0] if p.starts else 1.0)
        for p in candidate.parameters
    }


def _checked(effect: str, vehicle: Vehicle, known: Catalogue) -> Candidate:
    cls = lookup(effect, known)
    if cls.built_in:
        raise UndertowError(f"'{effect}' comes with the actuators and is in every model: name another effect")
    candidate = Candidate(cls, vehicle)
    if not candidate.parameters:
        raise UndertowError(
            f"effect '{effect}' adds no parameter to '{vehicle.name}': leave it out; 'none' stands for the "
            "model as it is"
        )
    return candidate


def rival_models(
    vehicle: Vehicle,
    specs: Sequence[RivalSpec],
    known: Catalogue,
    runs: Sequence[Run],
    ground: tuple[Airspace, Sequence[Family]],
    *,
    compiled: bool | None = None,
) -> list[RivalModel]:
    """The rivals with values: fitted to the logs, else as stated, else of typical size.

    Parameters
    ----------
    vehicle : Vehicle
        The model without any of the effects.
    specs : sequence of RivalSpec
        The rivals.
    known : Catalogue
        Effects by id.
    runs : sequence of Run
        Logs, may be none.
    ground : (Airspace, sequence of Family)
        For typical sizes.
    compiled : bool, optional
        As for `Simulator`.

    Raises
    ------
    UndertowError
        If an effect is unknown or adds nothing, or the logs do not fit the vehicle.
    """
    bench = _bench(vehicle, runs) if runs else None
    scale = float(np.median(ground[0].limits)) / 2
    before = free_parameters(vehicle)
    made = []
    for spec in specs:
        if bench is not None:
            candidate = spec.candidate(vehicle, known)
            fit = bench.base if candidate is None else _fitted(candidate, bench, spec.values)
            known_of, source = knowledge_of(fit, runs), "fitted to the logs"
        else:
            valued, source = _valued(vehicle, spec, known, ground, scale)
            known_of = stated(valued, free_parameters(valued))
        plant = Plant.of(known_of.vehicle, compiled=compiled)
        own = tuple(n for n in known_of.free if n not in before)
        made.append(
            RivalModel(spec.name, plant, known_of, WeakModel(plant.functions, known_of.free), own, source)
        )
    return made


def _bench(vehicle: Vehicle, runs: Sequence[Run]) -> Bench:
    data = prepare(runs, vehicle)
    return open_bench(vehicle, data, data)


def _fitted(candidate: Candidate, bench: Bench, values: Mapping[str, float]) -> WeakFit:
    """The best of the fits from the effect's most promising start, or from values found before."""
    own = {p.name for p in candidate.parameters}
    found = {n: v for n, v in values.items() if n in own}
    scouted = scout(candidate, bench).values
    # Values that make up for what is missing may lead astray, and so may those of the file.
    starts = [scouted, {n: v for n, v in scouted.items() if n in own}]
    starts += [found, bench.base.values | found] if found else []
    fits = [bench.fit(candidate.vehicle, candidate.free(), start) for start in starts]
    return settled(min(fits, key=lambda fit: fit.cost))


def _valued(
    vehicle: Vehicle,
    spec: RivalSpec,
    known: Catalogue,
    ground: tuple[Airspace, Sequence[Family]],
    scale: float,
) -> tuple[Vehicle, str]:
    """A rival without logs, and where its values come from."""
    source = "vehicle file"
    for effect in parts_of(spec.name):
        candidate = _checked(effect, vehicle, known)
        own = {p.name for p in candidate.parameters}
        found = {n: v for n, v in spec.values.items() if n in own}
        source = "diagnosis" if found else "typical size"
        values = {**beginning(candidate), **found} if found else typical_values(candidate, *ground, scale)
        vehicle = candidate.adopted(values)
    return _with(vehicle, {n: v for n, v in spec.values.items() if n in vehicle.values}), source


def _with(vehicle: Vehicle, values: Mapping[str, float]) -> Vehicle:
    return vehicle.with_values({n: replace(vehicle.value_of(n), value=v) for n, v in values.items()})
