"""Models to be told apart: the vehicle with each of the effects that may be missing, at typical sizes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError

from undertow.codegen.functions import Functions
from undertow.errors import UndertowError
from undertow.files import read_json
from undertow.identification.diagnosis.candidates import Candidate
from undertow.identification.diagnosis.trial import Bench, open_bench, screen
from undertow.identification.estimation.data import prepare
from undertow.identification.estimation.residual import WeakModel
from undertow.identification.estimation.weak_form import WeakFit, free_parameters, settled
from undertow.identification.logs.run import Run
from undertow.model.catalogue import Catalogue, lookup
from undertow.model.parameter import Parameter, printed
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .flight import Airspace, Flight, Knowledge, Plant, knowledge_of, stated
from .manoeuvres import MULTISINE, Design, Family, allocation

# An effect of typical size makes this share of the force of the actuators, or of the velocities.
TYPICAL = 0.1
_UNFELT = 0.1
_STATES = 300
_TILT = 0.1
_ROUNDS = 5
_FIRST = 1e-3
_DIVERGED = 1e3
_NOTHING = 1e-9


def typical_values(
    candidate: Candidate, space: Airspace, families: Sequence[Family], command_scale: float
) -> dict[str, float]:
    """Values with which each parameter of an effect would be felt, SNAME signs.

    A force is 10 % of what the actuators give in a multisine, at speeds that are alike in all directions.
    What acts otherwise (sensors, delays, dead bands) changes the velocities of that multisine by 10 %; what
    does not change them is 0.1 in its unit. A parameter that cannot be zero (a time constant, a saturation)
    takes its default, or the middle one of the starting points of its declaration.

    Parameters
    ----------
    candidate : Candidate
        The effect and the model that it is added to.
    space : Airspace
        Where it is flown; its first model is the one without the effect.
    families : sequence of Family
        Manoeuvres that can be flown.
    command_scale : float
        Size of the commands, for parameters in their unit.
    """
    own = candidate.parameters
    fixed = {p.name: _middle(p, command_scale) for p in own if p.neutral != 0.0}
    plant = Plant.of(candidate.vehicle)
    for name, value in fixed.items():
        plant.p[plant.functions.parameter_names.index(name)] = value
    wide = space.without_drift()
    flight = _multisine(wide, families)
    forces, responses = _Forces(plant.functions, wide, flight), _Responses(plant, wide, flight)
    share = TYPICAL / np.sqrt(max(len(own) - len(fixed), 1))
    sized = {
        p.name: forces.size(p, plant.p, share) or responses.size(p, share) or _UNFELT * _sign(p)
        for p in own
        if p.neutral == 0.0
    }
    return {name: float(value) for name, value in (fixed | sized).items()}


def _middle(parameter: Parameter, command_scale: float) -> float:
    if parameter.default is not None:
        return parameter.default
    start = parameter.starts[len(parameter.starts) // 2] if parameter.starts else 1.0
    return start * command_scale if parameter.unit == "command" else start


def _sign(parameter: Parameter) -> float:
    """Drag and added mass are negative; what may be either is positive."""
    low, high = parameter.bounds
    return -1.0 if high <= 0 or (low < 0 and parameter.on_left_side) else 1.0


def _multisine(space: Airspace, families: Sequence[Family]) -> Flight:
    """A middling manoeuvre of everything at once, not the same on all axes."""
    family = next(f for f in families if MULTISINE in f.shapes and not f.in_turn)
    return space.fly(Design(family, 0.5 + 0.3 * np.sin(7.0 * np.arange(family.size))))


def _linear(space: Airspace) -> NDArray[np.bool_]:
    """Which degrees of freedom are translations."""
    return np.array([n in "uvw" for n in space.vehicle.velocity_names])


def _rms(columns: Array) -> float:
    with np.errstate(over="ignore", invalid="ignore"):
        return float(np.sqrt(np.mean(np.sum(columns**2, axis=1)))) + 1e-12


class _Forces:
    """Forces that parameters make at random motions as large as those of a flight, whatever the direction."""

    def __init__(self, functions: Functions, space: Airspace, flight: Flight) -> None:
        self._functions, self._space, self._flight = functions, space, flight

    @cached_property
    def _drive(self) -> Array:
        """Force and moment of the actuators, rms; where there are none, the largest of the same kind."""
        push = (self._flight.u - self._flight.u.mean(axis=0)) @ allocation(self._space.vehicle).T
        drive, linear = np.sqrt(np.mean(push**2, axis=0)), _linear(self._space)
        for kind in (linear, ~linear):
            largest = np.max(drive[kind], initial=0.0) or np.max(drive)
            drive[kind & (drive <= 0)] = largest
        return np.asarray(drive)

    @cached_property
    def _inputs(self) -> tuple[Array, Array, Array]:
        """States, accelerations and commands, with the random states in columns."""
        f, linear = self._functions, _linear(self._space)
        rng, count, size = np.random.default_rng(0), _STATES, len(linear)
        y = self._flight.y[0][:, size:]
        dt = float(self._flight.t[1])
        scale, jerk = np.ones(size), np.ones(size)
        for kind in (linear, ~linear):
            if kind.any():
                scale[kind], jerk[kind] = _rms(y[:, kind]), _rms(np.diff(y[:, kind], axis=0)) / dt
        pose = np.zeros((size, count))
        for name in {"phi", "theta"} & set(self._space.vehicle.pose_names):
            pose[self._space.vehicle.pose_names.index(name)] = _TILT * rng.standard_normal(count)
        u = self._flight.u[rng.integers(len(self._flight.u), size=count)].T
        own = np.zeros((len(f.state_names) - 2 * size, count))
        own[: f.memory.numel()] = float(np.max(scale)) * rng.standard_normal((f.memory.numel(), count))
        x = np.vstack([pose, scale[:, None] * rng.standard_normal((size, count)), own])
        return x, jerk[:, None] * rng.standard_normal((size, count)), u

    def size(self, parameter: Parameter, p: Array, share: float) -> float:
        """Value whose force is a share of the actuators', in the degree of freedom that feels it most."""
        f = self._functions
        if not parameter.linear:
            return 0.0
        column = f.parameter_names.index(parameter.name)
        x, nu_dot, u = self._inputs
        table = np.array(f.regressor.map(_STATES)(x, nu_dot, u, np.tile(p[:, None], _STATES), 0.0))
        slopes = table.reshape(len(self._drive), _STATES, -1)[:, :, column]
        felt = np.sqrt(np.mean(slopes**2, axis=1)) / self._drive
        largest = float(np.max(felt))
        return _sign(parameter) * share / largest if largest > _NOTHING else 0.0


class _Responses:
    """Changes of a flight that parameters make."""

    def __init__(self, plant: Plant, space: Airspace, flight: Flight) -> None:
        self._plant, self._space, self._flight = plant, space, flight
        self._without = self._velocities(plant.p)

    def _velocities(self, p: Array) -> Array:
        y = self._space.predicted(self._plant, self._space.t, [self._flight.u], p)[0]
        return np.asarray(y[:, len(self._space.names) // 2 :])

    def _change(self, place: int, value: float) -> float:
        """Change of the velocities as a share of the speed, and of the rates; the larger of the two."""
        p = self._plant.p.copy()
        p[place] = value
        moved, linear = self._velocities(p) - self._without, _linear(self._space)
        shares = [_rms(moved[:, g]) / _rms(self._without[:, g]) for g in (linear, ~linear) if g.any()]
        return max(shares) if np.isfinite(shares).all() else _DIVERGED

    def size(self, parameter: Parameter, share: float) -> float:
        """Value that changes the velocities by a share; zero if none does."""
        place = self._plant.functions.parameter_names.index(parameter.name)
        value = _sign(parameter) * _FIRST
        for _ in range(_ROUNDS):
            change = self._change(place, value)
            if change <= _NOTHING:
                return 0.0
            value = float(np.clip(value * np.clip(share / change, 1e-3, 1e3), *parameter.bounds))
        return value


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
    screened = screen(candidate, bench)[0].values
    # Values that make up for what is missing may lead astray, and so may those of the file.
    starts = [screened, {n: v for n, v in screened.items() if n in own}]
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
