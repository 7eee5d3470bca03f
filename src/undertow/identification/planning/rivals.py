"""Models to be told apart: the vehicle with each of the effects that may be missing, at typical sizes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from pydantic import BaseModel

from undertow.errors import UndertowError
from undertow.identification.diagnosis.bench import Bench, open_bench
from undertow.identification.diagnosis.candidates import Candidate
from undertow.identification.diagnosis.trial import screen
from undertow.identification.estimation.data import prepare
from undertow.identification.estimation.residual import WeakModel
from undertow.identification.estimation.weak_form import WeakFit, free_parameters, with_reestimated_noise
from undertow.model.catalogue import Catalogue, lookup
from undertow.model.parameter import Parameter, printed
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .manoeuvres import MULTISINE, Design
from .problem import Knowledge, Manoeuvre, PlanningProblem, Plant, knowledge_from_fit, stated_knowledge


@dataclass(frozen=True)
class RivalSettings:
    """How sizes of effects are chosen if nothing is known of them."""

    typical: float = 0.1  # share of the force of the actuators, or of the velocities
    without_response: float = 0.1  # value, in its unit, of a parameter that changes nothing
    states: int = 300  # random states at which forces are compared
    tilt: float = 0.1  # standard deviation of roll and pitch among them, rad
    rounds: int = 5  # of the search for a value
    first_value: float = 1e-3  # value that it begins with
    factors: tuple[float, float] = (1e-3, 1e3)  # that a step of it stays within
    diverged: float = 1e3  # change of the velocities that stands for a diverged simulation
    negligible: float = 1e-9  # change of the velocities, or share of the force, that is none
    most_rivals: int = 3  # that are taken from a diagnosis


SETTINGS = RivalSettings()


def typical_values(candidate: Candidate, problem: PlanningProblem) -> dict[str, float]:
    """Values with which each parameter of an effect would be noticeable, SNAME signs.

    A force is 10% of that of the actuators in a multisine, at speeds of equal size in all directions.
    What acts otherwise (sensors, delays, dead bands) changes the velocities of that multisine by 10%; what
    does not change them is 0.1 in its unit. A parameter that cannot be zero (a time constant, a saturation)
    takes its default, or the middle one of the starting points of its declaration.
    """
    parameters, command_scale = candidate.parameters, float(np.median(problem.limits.value)) / 2
    fixed = {p.name: _default_or_middle_start(p, command_scale) for p in parameters if p.neutral != 0.0}
    plant = Plant.of(candidate.vehicle)
    for name, value in fixed.items():
        plant.p[plant.functions.parameter_names.index(name)] = value
    problem = problem.without_drift()
    # A manoeuvre of medium size on all axes at once, different on each.
    family = next(f for f in problem.families if MULTISINE in f.shapes and not f.in_turn)
    manoeuvre = problem.simulated(Design(family, 0.5 + 0.3 * np.sin(7.0 * np.arange(family.size))))
    sizes = _TypicalSizes(plant, problem, manoeuvre)
    share = SETTINGS.typical / np.sqrt(max(len(parameters) - len(fixed), 1))
    sized = {p.name: sizes.of(p, share) for p in parameters if p.neutral == 0.0}
    return {name: float(value) for name, value in (fixed | sized).items()}


def _default_or_middle_start(parameter: Parameter, command_scale: float) -> float:
    if parameter.default is not None:
        return parameter.default
    start = parameter.starts[len(parameter.starts) // 2] if parameter.starts else 1.0
    return start * command_scale if parameter.unit == "command" else start


def _sign(parameter: Parameter) -> float:
    """Drag and added mass are negative; what may be either is positive."""
    low, high = parameter.bounds
    return -1.0 if high <= 0 or (low < 0 and parameter.on_left_side) else 1.0


def _rms(columns: Array) -> float:
    with np.errstate(over="ignore", invalid="ignore"):
        return float(np.sqrt(np.mean(np.sum(columns**2, axis=1)))) + 1e-12


class _TypicalSizes:
    """Values of parameters by the force that they make, or by the change of a manoeuvre."""

    # Forces are those at random motions as large as in the manoeuvre, in all directions.

    def __init__(self, plant: Plant, problem: PlanningProblem, manoeuvre: Manoeuvre) -> None:
        self._plant, self._problem, self._manoeuvre = plant, problem, manoeuvre
        self._linear = np.array([n in "uvw" for n in problem.vehicle.velocity_names])
        self._without = self._velocities(plant.p)

    def of(self, parameter: Parameter, share: float) -> float:
        """Value that makes a share of the force or, where it makes none, of the velocities."""
        found = self._by_force(parameter, share) or self._by_response(parameter, share)
        return found or SETTINGS.without_response * _sign(parameter)

    @cached_property
    def _actuator_force(self) -> Array:
        """Force and moment of the actuators, rms; where there are none, the largest of the same kind."""
        u = self._manoeuvre.u
        force = np.sqrt(np.mean(((u - u.mean(axis=0)) @ self._problem.effectiveness.T) ** 2, axis=0))
        for kind in (self._linear, ~self._linear):
            force[kind & (force <= 0)] = np.max(force[kind], initial=0.0) or np.max(force)
        return np.asarray(force)

    @cached_property
    def _inputs(self) -> tuple[Array, Array, Array]:
        """States, accelerations and commands, with the random states in columns."""
        f, linear, names = self._plant.functions, self._linear, self._problem.vehicle.pose_names
        rng, count, size = np.random.default_rng(0), SETTINGS.states, len(linear)
        y = self._manoeuvre.y[0][:, size:]
        dt = float(self._manoeuvre.t[1])
        scale, jerk = np.ones(size), np.ones(size)
        for kind in (linear, ~linear):
            if kind.any():
                scale[kind], jerk[kind] = _rms(y[:, kind]), _rms(np.diff(y[:, kind], axis=0)) / dt
        pose = np.zeros((size, count))
        for name in {"phi", "theta"} & set(names):
            pose[names.index(name)] = SETTINGS.tilt * rng.standard_normal(count)
        u = self._manoeuvre.u[rng.integers(len(self._manoeuvre.u), size=count)].T
        internal = np.zeros((len(f.state_names) - 2 * size, count))
        internal[: f.memory.numel()] = float(np.max(scale)) * rng.standard_normal((f.memory.numel(), count))
        x = np.vstack([pose, scale[:, None] * rng.standard_normal((size, count)), internal])
        return x, jerk[:, None] * rng.standard_normal((size, count)), u

    def _by_force(self, parameter: Parameter, share: float) -> float:
        """Value whose force is a share of the actuators', in the degree of freedom where it is largest."""
        if not parameter.linear:
            return 0.0
        f, count, force = self._plant.functions, SETTINGS.states, self._actuator_force
        x, nu_dot, u = self._inputs
        table = np.array(f.regressor.map(count)(x, nu_dot, u, np.tile(self._plant.p[:, None], count), 0.0))
        slopes = table.reshape(len(force), count, -1)[:, :, f.parameter_names.index(parameter.name)]
        largest = float(np.max(np.sqrt(np.mean(slopes**2, axis=1)) / force))
        return _sign(parameter) * share / largest if largest > SETTINGS.negligible else 0.0

    def _velocities(self, p: Array) -> Array:
        y = self._problem.predicted(self._plant, self._problem.t, [self._manoeuvre.u], p)[0]
        return np.asarray(y[:, len(self._linear) :])

    def _change(self, place: int, value: float) -> float:
        """Change of the velocities as a share of the speed, and of the rates; the larger of the two."""
        p = self._plant.p.copy()
        p[place] = value
        change, kinds = self._velocities(p) - self._without, (self._linear, ~self._linear)
        shares = [_rms(change[:, kind]) / _rms(self._without[:, kind]) for kind in kinds if kind.any()]
        return max(shares) if np.isfinite(shares).all() else SETTINGS.diverged

    def _by_response(self, parameter: Parameter, share: float) -> float:
        """Value that changes the velocities by a share; zero if none does."""
        place = self._plant.functions.parameter_names.index(parameter.name)
        value = _sign(parameter) * SETTINGS.first_value
        for _ in range(SETTINGS.rounds):
            change = self._change(place, value)
            if change <= SETTINGS.negligible:
                return 0.0
            value = float(np.clip(value * np.clip(share / change, *SETTINGS.factors), *parameter.bounds))
        return value


NONE = "none"
"""Name of the model as it is."""
AND = "+"
"""Joins the effects of one model."""


@dataclass(frozen=True)
class RivalModel:
    """A model that could be the true one."""

    name: str  # ids of its effects joined by +, or "none"
    plant: Plant  # the model at its values
    known: Knowledge  # of its free parameters, from priors and logs
    model: WeakModel  # its weak residual, with the free parameters
    added: tuple[str, ...]  # parameters of the effects that it adds to the vehicle
    source: str  # where their values come from

    @property
    def parts(self) -> frozenset[str]:
        """Ids of its effects."""
        return frozenset(parts_of(self.name))


def parts_of(name: str) -> list[str]:
    """Ids of the effects in the name of a rival."""
    return [] if name == NONE else [part.strip() for part in name.split(AND)]


@dataclass(frozen=True)
class RivalSpec:
    """The request for a model to be told apart from others."""

    name: str  # ids of effects joined by +, or "none"
    values: Mapping[str, float]  # values of parameters as far as known, SNAME signs

    def candidate(self, vehicle: Vehicle, known: Catalogue) -> Candidate | None:
        """The last of its effects, added to the vehicle with the others; None for the model as it is."""
        if self.name == NONE:
            return None
        *others, last = parts_of(self.name)
        for effect in others:
            other = _addable(effect, vehicle, known)
            vehicle = other.vehicle_with({**neutral_values(other), **self.values})
        return _addable(last, vehicle, known)


def neutral_values(candidate: Candidate) -> dict[str, float]:
    """Neutral values of an effect, as far as its parameters have them."""
    return {
        p.name: p.neutral if p.neutral is not None else (p.starts[0] if p.starts else 1.0)
        for p in candidate.parameters
    }


def _addable(effect: str, vehicle: Vehicle, known: Catalogue) -> Candidate:
    cls = lookup(effect, known)
    if cls.built_in:
        raise UndertowError(f"'{effect}' belongs to the actuators and is in every model: name another effect")
    candidate = Candidate(cls, vehicle)
    if not candidate.parameters:
        raise UndertowError(
            f"effect '{effect}' adds no parameter to '{vehicle.name}': leave it out; 'none' is the model as "
            "given"
        )
    return candidate


def rival_models(
    vehicle: Vehicle, specs: Sequence[RivalSpec], known: Catalogue, problem: PlanningProblem
) -> list[RivalModel]:
    """The rivals with values: fitted to the logs of a problem, else as stated, else of typical size."""
    # Without values by run: the run that is planned is none of those that the logs hold.
    differing = [n for n in free_parameters(vehicle) if vehicle.differs_between_runs(n)]
    vehicle = vehicle.with_values({n: replace(vehicle.value_of(n), per_run=False) for n in differing})
    runs, before = problem.runs, free_parameters(vehicle)
    data = prepare(runs, vehicle) if runs else None
    bench = None if data is None else open_bench(vehicle, data, data)
    rivals = []
    for spec in specs:
        if bench is not None:
            candidate = spec.candidate(vehicle, known)
            fit = bench.base if candidate is None else _fitted(candidate, bench, spec.values)
            knowledge, source = knowledge_from_fit(fit, runs), "fitted to the logs"
        else:
            rival, source = _with_values(vehicle, spec, known, problem)
            knowledge = stated_knowledge(rival, free_parameters(rival))
        plant = Plant.of(knowledge.vehicle, compiled=problem.request.compiled)
        added = tuple(n for n in knowledge.free if n not in before)
        model = WeakModel(plant.functions, knowledge.free)
        rivals.append(RivalModel(spec.name, plant, knowledge, model, added, source))
    return rivals


def _fitted(candidate: Candidate, bench: Bench, values: Mapping[str, float]) -> WeakFit:
    """The best of the fits from the effect's most promising start, or from values found before."""
    names = {p.name for p in candidate.parameters}
    found = {n: v for n, v in values.items() if n in names}
    screened = screen(candidate, bench)[0].values
    # Values that compensate for a missing effect may lead to a local minimum, and so may those of the file.
    starts = [screened, {n: v for n, v in screened.items() if n in names}]
    starts += [found, bench.base.values | found] if found else []
    fits = [bench.fit(candidate.vehicle, candidate.free(), start) for start in starts]
    return with_reestimated_noise(min(fits, key=lambda fit: fit.cost))


def _with_values(
    vehicle: Vehicle, spec: RivalSpec, known: Catalogue, problem: PlanningProblem
) -> tuple[Vehicle, str]:
    """A rival without logs, and where its values come from."""
    source = "vehicle file"
    for effect in parts_of(spec.name):
        candidate = _addable(effect, vehicle, known)
        names = {p.name for p in candidate.parameters}
        found = {n: v for n, v in spec.values.items() if n in names}
        source = "diagnosis" if found else "typical size"
        values = {**neutral_values(candidate), **found} if found else typical_values(candidate, problem)
        vehicle = candidate.vehicle_with(values)
    stated_values = {n: v for n, v in spec.values.items() if n in vehicle.values}
    changed = {n: replace(vehicle.value_of(n), value=v) for n, v in stated_values.items()}
    return vehicle.with_values(changed), source


class _Estimate(BaseModel):
    name: str
    value: float


class _Ranked(BaseModel):
    effect: str
    significant: bool
    parameters: list[_Estimate]


class _Set(BaseModel):
    effects: list[str]


class Diagnosed(BaseModel):
    """The parts of a diagnosis used for a plan; all else in the file is ignored."""

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
        fitted = [r.effect for r in self.ranking if r.parameters]
        significant = [r.effect for r in self.ranking if r.significant]
        found = [*self.effects[:1], *(significant if len(significant) > 1 else fitted[:2])]
        found = self.indistinguishable[0].effects if self.indistinguishable else found
        named = list(dict.fromkeys(found))[: SETTINGS.most_rivals]
        return named if len(named) > 1 else [*named, NONE]

    @property
    def in_every_rival(self) -> list[str]:
        """Effects that were named in addition to those in question, and so are in all of the rivals."""
        sets = [s.effects for s in self.indistinguishable]
        return [e for e in self.effects if sets and all(e not in effects for effects in sets)]

    def values(self, effect: str) -> dict[str, float]:
        """Values in the file's sign convention: those of the last model, and the effect's own."""
        of_effect = next((r.parameters for r in self.ranking if r.effect == effect), [])
        return {e.name: e.value for e in [*self.parameters, *of_effect]}


def specs_of(diagnosed: Diagnosed, vehicle: Vehicle, known: Catalogue) -> list[RivalSpec]:
    """The rivals that a diagnosis leaves, with the values that it found."""
    if diagnosed.vehicle != vehicle.name:
        raise UndertowError(
            f"the diagnosis is of '{diagnosed.vehicle}', the vehicle file is of '{vehicle.name}': give "
            "those that belong together"
        )
    rivals = diagnosed.rivals
    if rivals == [NONE]:
        raise UndertowError(
            f"the diagnosis ({diagnosed.verdict}) names no effects to tell apart: name some with --between"
        )
    return [_spec(diagnosed, vehicle, known, effect) for effect in rivals]


def _spec(diagnosed: Diagnosed, vehicle: Vehicle, known: Catalogue, effect: str) -> RivalSpec:
    parts = [*diagnosed.in_every_rival, *parts_of(effect)]
    for part in parts:
        vehicle = vehicle.with_effect(lookup(part, known), {})
    values = {
        name: printed(parameter, value, diagnosed.signs)
        for name, value in diagnosed.values(effect).items()
        if (parameter := vehicle.parameter_of(name)) is not None
    }
    return RivalSpec(AND.join(parts) if parts else NONE, values)
