"""Effects that could be missing: what each would add to a vehicle, and the starting values of its fit."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
import sympy as sm

from undertow.codegen.functions import Functions
from undertow.identification.estimation.data import WeakData
from undertow.identification.estimation.fitted import stated_by_run
from undertow.identification.estimation.residual import (
    WeakModel,
    base_name,
    origins,
    run_of,
    with_values_by_run,
)
from undertow.identification.estimation.weak_form import free_parameters
from undertow.model.catalogue import Catalogue
from undertow.model.effect import Effect, Measurement
from undertow.model.parameter import Parameter
from undertow.model.vehicle import Value, Vehicle
from undertow.typing import Array

from .settings import DEFAULT, Settings


@dataclass(frozen=True)
class Candidate:
    """One effect that the model may lack, or lacks some parameters of.

    effect: the effect.
    base: the model without it.
    runs: names of the runs that it is fitted to, for what has a value in each.
    redundant: parameters that free ones of the model reproduce exactly (see `trial.without_redundant`), or of
    a sensor that was absent.
    """

    effect: type[Effect]
    base: Vehicle
    runs: tuple[str, ...] = ()
    redundant: tuple[str, ...] = ()

    @property
    def id(self) -> str:
        """Id of the effect."""
        return self.effect.id

    @cached_property
    def vehicle(self) -> Vehicle:
        """The model with the effect at its neutral values."""
        return self.base.with_effect(self.effect, {})

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters that the effect adds to the equations and that have to be estimated."""
        stated = (self.base.parameter_of(n) for n in self.base.values)
        known = {p.name for p in stated if p is not None}
        names = set(self.vehicle.parameter_names) - {*self.redundant}
        own = next(e for e in self.vehicle.effects if e.id == self.id).parameters
        return tuple(p for p in own if p.name in names and p.name not in known and self._is_estimated(p))

    def _is_estimated(self, parameter: Parameter) -> bool:
        """Whether it has to be estimated: no known value of a present effect, and no asymmetry of a hull."""
        if parameter.asymmetric:
            return False
        if parameter.default is None:
            return True
        sought = not parameter.assumed or bool(parameter.starts)
        return sought and all(e.id != self.id for e in self.base.effects)

    @property
    def adds_nothing(self) -> bool:
        """Whether the model already contains all of the effect that its degrees of freedom can show."""
        present = any(e.id == self.id for e in self.base.effects)
        return not self.parameters and (present or self.vehicle.residual == self.base.residual)

    @property
    def sizes(self) -> tuple[str, ...]:
        """Parameters that make up the effect.

        A time constant with gains of the same effect means nothing by itself: the gains decide.
        """
        linear = tuple(p.name for p in self.parameters if p.linear)
        return linear or tuple(p.name for p in self.parameters)

    @property
    def removable(self) -> tuple[str, ...]:
        """Those that may be left out if they turn out to be zero: no part of a horizontal vector."""
        alone = {p.name for p in self.parameters if not p.earth_axis}
        return tuple(n for n in self.sizes if n in alone)

    def made_up_by(self, kept: Collection[str]) -> bool:
        """Whether these parameters of the effect alone, with all others zero, still make up the effect."""
        return any(p.alone for p in self.parameters if p.name in kept)

    def free(self) -> tuple[str, ...]:
        """Free parameters of the model with the effect."""
        own = free_parameters(self.base)
        base = with_values_by_run(own, stated_by_run(self.base, own), self.runs)
        return (*base, *(p.name for p in self.parameters))

    @cached_property
    def _functions(self) -> Functions:
        return Functions(self.vehicle)

    @cached_property
    def _models(self) -> dict[tuple[str, ...], WeakModel]:
        return {}

    def model(self, free: tuple[str, ...] | None = None) -> WeakModel:
        """The model with the effect for a choice of free parameters, by default all of them; made once."""
        names = self.free() if free is None else free
        if names not in self._models:
            self._models[names] = WeakModel(self._functions, names)
        return self._models[names]

    def model_from(self, start: Mapping[str, float]) -> WeakModel:
        """The model with all free parameters, with values by run of those that the start has by run."""
        own = {p.name for p in self.parameters}
        names = {base_name(n) for n in start if run_of(n)} & own
        return self.model(with_values_by_run(self.free(), sorted(names), self.runs))

    def for_model(self, base: Vehicle) -> Candidate:
        """The same effect as a candidate for another model."""
        return replace(self, base=base)

    def starts(
        self, command_scale: float, ranges: Mapping[str, tuple[float, float]] | None = None
    ) -> list[dict[str, float]]:
        """Starting points of the search: one for each combination of the shape parameters' starts, unless the
        effect provides better ones for the observed poses.
        """
        shaped = [p for p in self.parameters if p.starts]
        if ranges and (near := self.effect.starts_near(ranges)):
            wanted = {p.name for p in shaped}
            points = ({n: v for n, v in point.items() if n in wanted} for point in near)
            return [dict(point) for point in dict.fromkeys(tuple(p.items()) for p in points)]
        grids = [[_start(p, s, command_scale) for s in p.starts] for p in shaped]
        return [
            dict(zip((p.name for p in shaped), combination, strict=True)) for combination in product(*grids)
        ]

    def vehicle_with(self, values: Mapping[str, float]) -> Vehicle:
        """The model with the effect added permanently: its parameters as found, all others as stated."""
        by_run = {base_name(n) for n in values if run_of(n)}
        found = {
            p.name: Value(values[p.name], estimate=True, per_run=True if p.name in by_run else None)
            for p in self.parameters
            if p.name in values
        }
        return self.base.with_effect(self.effect, found)


def _start(parameter: Parameter, start: float, command_scale: float) -> float:
    return start * command_scale if parameter.unit == "command" else start


def candidates(vehicle: Vehicle, known: Catalogue) -> list[Candidate]:
    """All effects of the catalogue that would add something to a vehicle (see `possible`)."""
    return [c for c in possible(vehicle, known) if not c.adds_nothing]


def possible(
    vehicle: Vehicle,
    known: Catalogue,
    *,
    derived: Collection[str] = (),
    without_pose: Collection[str] = (),
    runs: tuple[str, ...] = (),
) -> list[Candidate]:
    """All effects of the catalogue that could be added to a vehicle, also those that add nothing to it.

    derived: velocities that were taken from the pose. Errors of their sensors are not tried: a rate that no
    gyro measured has no scale error and no bias.
    without_pose: velocities whose pose coordinate was not measured. Their scale is not tried:
    it is equivalent to a scale of inertia and drag, whatever their errors.
    """
    fitting = [c for c in known.values() if not (c.built_in or c.of_shape or vehicle.lacks(c))]
    fitting = [c for c in fitting if c.id not in vehicle.excluded_effects]
    fitting = [c for c in fitting if c.observable_in(vehicle.degrees_of_freedom)]
    made = (Candidate(c, vehicle, runs) for c in fitting)
    marked = (replace(c, redundant=_unmeasured_parameters(c, derived, without_pose)) for c in made)
    return [c for c in marked if c.parameters or not c.redundant]


def possible_in(data: WeakData, vehicle: Vehicle, known: Catalogue) -> list[Candidate]:
    """The same as `possible`, for some logs."""
    measured = {"derived": data.derived_names, "without_pose": data.names_without_pose}
    return possible(vehicle, known, **measured, runs=origins(data.runs))


def _unmeasured_parameters(
    candidate: Candidate, derived: Collection[str], without_pose: Collection[str]
) -> tuple[str, ...]:
    """Parameters of a velocity sensor that change no velocity but those that none measured or can show it."""
    effect = candidate.effect
    if not (issubclass(effect, Measurement) and effect.of_velocity_sensor):
        return ()
    out = {*derived, *(without_pose if effect.by_pose else ())}
    if not out:
        return ()
    vehicle = candidate.vehicle
    rows = sm.Matrix.hstack(
        vehicle.composition.reported[1], vehicle.composition.report_age[-len(vehicle.velocity_names) :, :]
    )
    measured = [i for i, name in enumerate(vehicle.velocity_names) if name not in out]
    used = {str(x) for i in measured for entry in rows[i, :] for x in entry.free_symbols}
    return tuple(p.name for p in candidate.parameters if p.name not in used)


def dominant_frequency(r: Array, data: WeakData, settings: Settings = DEFAULT) -> tuple[float, float] | None:
    """Least and greatest angular frequency around the sharpest line in a residual, rad/s.

    r: (m,), whitened residual. None if the runs are too short for three periods.
    """
    cell = 2 * np.pi / max(float(s.t[-1] - s.t[0]) for s in data.segments)
    # A segment between two gaps may hold a single test function.
    spacings = [float(np.median(np.diff(s.functions.centre))) for s in data.segments if s.functions.count > 1]
    if not spacings:
        return None
    spacing = max(spacings)
    grid = np.arange(settings.line_periods * cell, 0.5 * np.pi / spacing, cell / settings.line_grid)
    neighbours = settings.line_neighbours * settings.line_grid
    if len(grid) <= 2 * neighbours:
        return None
    slow = np.arange(0.0, settings.line_periods + 0.5) * cell
    power = _power(_in_earth_axes(_without_slow_part(r, data, slow), data), data, grid)
    best = float(grid[np.argmax(power / _running_median(power, neighbours))])
    half_width = settings.line_half_width * cell
    return max(best - half_width, 0.5 * cell), best + half_width


def _without_slow_part(r: Array, data: WeakData, slow: Array) -> Array:
    """The residual without slow oscillations in body axes, which turning modulates in earth axes."""
    table, kept, first = r.reshape(-1, len(data.rows)), [], 0
    for s in data.segments:
        part = table[first : first + s.functions.count]
        first += s.functions.count
        phase = np.outer(s.functions.centre, slow)
        trend = np.hstack([np.cos(phase), np.sin(phase[:, 1:])])
        kept.append(part - trend @ np.linalg.lstsq(trend, part, rcond=None)[0])
    return np.vstack(kept).ravel()


def _in_earth_axes(r: Array, data: WeakData) -> Array:
    """The residual with its horizontal part in earth axes: waves do not turn with the vehicle."""
    half = len(data.names) // 2
    places = [data.names.index(n) for n in ("u", "v", "psi") if n in data.names]
    if len(places) < 3:
        return r
    ahead, across, heading = places[0] - half, places[1] - half, places[2]
    psi = np.concatenate([np.interp(s.functions.centre, s.t, s.measured[:, heading]) for s in data.segments])
    table = r.copy().reshape(len(psi), -1)
    x, y = (table[:, data.rows.index(i)].copy() for i in (ahead, across))
    table[:, data.rows.index(ahead)] = np.cos(psi) * x - np.sin(psi) * y
    table[:, data.rows.index(across)] = np.sin(psi) * x + np.cos(psi) * y
    return np.asarray(table.ravel())


def _power(r: Array, data: WeakData, grid: Array) -> Array:
    """Power at each frequency, summed over segments and equations of motion."""
    table, power, first = r.reshape(-1, len(data.rows)), np.zeros(len(grid)), 0
    forces = [k for k, row in enumerate(data.rows) if row < len(data.names) // 2]
    for s in data.segments:
        part = table[first : first + s.functions.count, forces]
        first += s.functions.count
        power += np.sum(np.abs(np.exp(-1j * np.outer(grid, s.functions.centre)) @ part) ** 2, axis=1)
    return power


def _running_median(power: Array, half: int) -> Array:
    """Median power around each frequency, over this many on either side."""
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(power, half, mode="reflect"), 2 * half + 1)
    return np.asarray(np.median(windows, axis=1))
