"""Typical sizes for the parameters of an effect of which nothing is known yet."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from undertow.codegen.functions import Functions
from undertow.model.parameter import Parameter
from undertow.typing import Array

from ..diagnosis.candidates import Candidate
from .axes import allocation
from .families import Design, Family
from .flight import Airspace, Flight, Plant
from .shapes import MULTISINE

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
