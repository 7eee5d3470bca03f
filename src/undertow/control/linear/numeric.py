"""A vehicle evaluated numerically: functions of its model, and their failures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property

import casadi as ca
import control as ct
import numpy as np

from undertow.codegen.compiler import Evaluator
from undertow.codegen.functions import Functions
from undertow.codegen.manifest import describe
from undertow.errors import UndertowError, of_stated_kinds
from undertow.model.effect import Actuation
from undertow.model.symbols import VELOCITY
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

_DIRECTIONS = {1: "forward", -1: "backward"}


class Numeric:
    """The functions of a vehicle and their derivatives at a point."""

    def __init__(self, vehicle: Vehicle) -> None:
        self.vehicle, self.functions = vehicle, Functions(vehicle)
        self.states = self.functions.state_names  # of the entries of x; commands those of u, outputs of y
        self.commands = vehicle.command_names
        self.outputs = (*vehicle.pose_names, *vehicle.velocity_names)
        self.p = np.array(self.functions.values())  # parameters, SI and SNAME signs

    @cached_property
    def units(self) -> dict[str, str]:
        """Unit of every state and command by name."""
        manifest = describe(self.functions)
        units = {e.name: e.unit for e in (*manifest.states, *manifest.inputs)}
        return units | {t.name: t.unit for t in self.vehicle.thrusters}

    @cached_property
    def time_varying(self) -> bool:
        """Whether the forces depend explicitly on time."""
        f = self.functions
        return bool(ca.jacobian(ca.vertcat(f.x_dot, f.reported), f.t).nnz())

    # --- values and slopes --------------------------------------------------------------------
    @cached_property
    def _rate(self) -> Evaluator:
        return Evaluator(self.functions.dynamics)

    @cached_property
    def _slopes(self) -> Evaluator:
        return Evaluator(self.functions.jacobians)

    @cached_property
    def _report(self) -> Evaluator:
        return Evaluator(self.functions.outputs)

    @cached_property
    def _report_slopes(self) -> Evaluator:
        f = self.functions
        slopes = [ca.densify(ca.jacobian(f.reported, v)) for v in (f.x, f.u)]
        return Evaluator(ca.Function("report_slopes", [f.x, f.u, f.p, f.t], slopes))

    def rate(self, t: float, x: Array, u: Array, p: Array | None = None) -> Array:
        """Time derivative of the state, shape (nx,)."""
        return self._rate(x, u, self._or_stated(p), t)[0][:, 0]

    def report(self, t: float, x: Array, u: Array, p: Array | None = None) -> Array:
        """Reported pose and velocity, shape (2n,)."""
        return self._report(x, u, self._or_stated(p), t)[0][:, 0]

    def reports(self, x: Array, u: Array, p: Array | None = None) -> dict[str, float]:
        """Reported pose and velocity by name."""
        return dict(zip(self.outputs, map(float, self.report(0.0, x, u, p)), strict=True))

    def slopes(self, x: Array, u: Array, p: Array | None = None) -> tuple[Array, Array, Array, Array]:
        """Time derivative of the state, and its slopes A, B, P in state, command and parameters."""
        rate, a, b, by_p = self._slopes(x, u, self._or_stated(p), 0.0)
        return rate[:, 0], a, b, by_p

    def report_slopes(self, x: Array, u: Array, p: Array | None = None) -> tuple[Array, Array]:
        """Slopes C, D of the reported pose and velocity in state and command."""
        c, d = self._report_slopes(x, u, self._or_stated(p), 0.0)
        return c, d

    def _or_stated(self, p: Array | None) -> Array:
        return self.p if p is None else p


# --- vehicles made ready ------------------------------------------------------------------------
@of_stated_kinds
def in_direction(vehicle: Vehicle, direction: Mapping[str, int]) -> Vehicle:
    """The vehicle with the parameters of one direction of motion for both.

    Parameters
    ----------
    vehicle : Vehicle
        The model.
    direction : mapping
        1 (forward, or the positive way of the axis) or -1 (backward) by velocity u, v, w, p, q or r.

    Raises
    ------
    UndertowError
        If a velocity is none of the vehicle's, or a direction is neither 1 nor -1.
    """
    for name, sign in direction.items():
        if name not in vehicle.velocity_names or sign not in _DIRECTIONS:
            raise UndertowError(
                f"direction {name}={sign} is impossible: give 1 or -1 for one of "
                f"{', '.join(vehicle.velocity_names)}"
            )
    chosen = {}
    for name in vehicle.values:
        motion = motion_of(vehicle, name) or ""
        if motion in direction and name in vehicle.sides:
            parameter, _ = vehicle.sides[name]
            chosen[name] = vehicle.values[f"{parameter.name}_{_DIRECTIONS[direction[motion]]}"]
    return vehicle.with_values(chosen)


def reversing(vehicle: Vehicle) -> tuple[str, ...]:
    """Velocities whose sign chooses among the parameters of the vehicle."""
    found = {motion_of(vehicle, name) for name in vehicle.values if name in vehicle.sides}
    return tuple(v for v in vehicle.velocity_names if v in found)


def motion_of(vehicle: Vehicle, name: str) -> str | None:
    """The velocity whose sign chooses between this parameter and its other direction."""
    declared = vehicle.parameter_of(name)
    return None if declared is None or declared.motion is None else VELOCITY[declared.motion]


def with_ideal_thrust(vehicle: Vehicle) -> Vehicle:
    """The vehicle with ideal thrusters: instantaneous and proportional to the command."""
    return replace(vehicle, effects=tuple(e for e in vehicle.effects if not isinstance(e, Actuation)))


_REMEDY = "look for a value in the vehicle, the gains or the options that is wrong by powers of ten"


@contextmanager
def as_input_error(
    what: str = "linear algebra fails on these numbers", remedy: str = _REMEDY, *more: type[Exception]
) -> Iterator[None]:
    """Report failures of NumPy, SciPy and python-control (and `more` exceptions) as an error in the input."""
    try:
        yield
    except (np.linalg.LinAlgError, ct.ControlArgument, *more) as failure:
        raise UndertowError(f"{what}: {str(failure).rstrip('.')}; {remedy}") from failure
