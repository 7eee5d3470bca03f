"""The force that a motion needs, and what the commands and the rest give, as means over test functions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Protocol

import casadi as ca
import numpy as np

from undertow.codegen.engine import at_samples
from undertow.codegen.functions import Functions
from undertow.identification.estimation.inputs import ActuatorStates, without_gaps
from undertow.identification.estimation.test_functions import TestFunctions, knot_spacing
from undertow.identification.logs.run import Run
from undertow.model.hardware import Curve, Propeller
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .kinematics import most_active, weights_over


class TableSettings(Protocol):
    """How much of a log is looked at, and how closely."""

    @property
    def samples(self) -> int:
        """Samples that are looked at, all runs together."""

    @property
    def width(self) -> float:
        """Width of test functions, in the narrowest that the sampling allows."""


def allocation(vehicle: Vehicle) -> Array:
    """Wrench of one unit of every command in the vehicle's degrees of freedom, shape (n, k), nominal.

    Of a thruster with a curve: of one newton on its curve.
    """
    rows = list(vehicle.dof_indices)
    # What a propeller by revolutions gives depends on the flow, too.
    gains = [0.0 if isinstance(t.law, Propeller) else t.thrust_per_command.value for t in vehicle.thrusters]
    columns = [np.array(t.wrench)[rows] * k for t, k in zip(vehicle.thrusters, gains, strict=True)]
    # What a surface gives depends on the flow, and an input such as the wind is no force.
    columns += [np.zeros(len(rows))] * len(vehicle.surfaces)
    columns += [np.eye(6)["XYZKMN".index(channel[-1])][rows] for channel in vehicle.force_channels]
    columns += [np.zeros(len(rows))] * len(vehicle.inputs)
    return np.array(columns).T.reshape(len(rows), -1)


def on_curve(curve: Curve, command: Array) -> Array:
    """Thrust of a curve at commands (N,), N."""
    pieces = ((np.clip(command, begin, end) - begin, (0.0, *c)) for begin, end, c in curve.pieces)
    return np.asarray(curve.start + sum(np.polynomial.polynomial.polyval(x, c) for x, c in pieces))


@dataclass(frozen=True)
class ForceTable:
    """Means over test functions: inertial force (K, n), of each command (K, n, c), and the rest (K, k)."""

    force: Array
    commanded: Array
    beside: Array


class Forces:
    """Inertial force and that of the commands along logs; actuation that depends on the motion is refused."""

    def __init__(self, vehicle: Vehicle) -> None:
        self.vehicle, self.functions = vehicle, Functions(vehicle)
        self.p = np.array(self.functions.values(), dtype=float)
        self.mass = _mass_matrix(self.functions, self.p)
        self.chain = ActuatorStates(self.functions, ())

    def table(self, runs: Sequence[Run], settings: TableSettings) -> ForceTable | None:
        """The table of logs; None where they are too short."""
        parts = [part for i, run in enumerate(runs) for part in self._parts(run, i, len(runs), settings)]
        return ForceTable(*(np.concatenate(c) for c in zip(*parts, strict=True))) if parts else None

    def _parts(
        self, run: Run, index: int, count: int, settings: TableSettings
    ) -> Iterator[tuple[Array, Array, Array]]:
        velocities, commands = self.vehicle.velocity_names, self.vehicle.command_names
        angles = [n for n in ("phi", "theta") if n in self.vehicle.pose_names and run.has(n)]
        active, force = most_active(run, velocities, settings.samples // count), self.commanded(run)
        for piece in run.segments([*velocities, *commands, *angles]):
            part = slice(max(piece.start, active.start), min(piece.stop, active.stop))
            t = run.t[part]
            functions = weights_over(t, settings.width * knot_spacing(t)) if len(t) > 2 else None
            if functions is not None:
                motion = run.matrix([*velocities, *angles])[part]
                yield _tested(functions, motion, len(velocities), force[part], self.mass, (index, count))

    def commanded(self, run: Run) -> Array:
        """Force of every command at every sample, (N, n, n_commands); NaN where a command is missing."""
        u = run.matrix(self.vehicle.command_names)
        missing = np.isnan(u)
        actuation = self.chain.along(run.t, without_gaps(u), self.p).value.copy()
        for k, thruster in enumerate(self.vehicle.thrusters):
            if isinstance(thruster.law, Curve):
                actuation[:, k] = on_curve(thruster.law, actuation[:, k])
        table = np.column_stack([actuation, u[:, len(self.vehicle.actuator_names) :]])
        table = np.where(missing, np.nan, table)
        return np.einsum("Nc,nc->Nnc", table, allocation(self.vehicle))


class StatedForces(Forces):
    """The same with what the whole model says that every command gives: propellers, surfaces, curves, too."""

    def commanded(self, run: Run) -> Array:
        """Force of every command beside those before it, (N, n, n_commands); all inputs count as the last.

        Surfaces come first, in the slipstream that there is: what that does to a rudder is the rudder's.
        """
        u, vehicle = run.matrix(self.vehicle.command_names), self.vehicle
        first, last = len(vehicle.thrusters), len(vehicle.actuator_names)
        own = u.shape[1] - len(vehicle.inputs)
        groups = [[k] for k in (*range(first, last), *range(first), *range(last, own))]
        groups += [list(range(own, u.shape[1]))] if vehicle.inputs else []
        present = without_gaps(u)
        actuation = self.chain.along(run.t, present, self.p).value.copy()
        given = np.zeros((len(u), len(vehicle.dof_indices), u.shape[1]))
        before = self._forcing(run, present, actuation)
        for group in groups:
            present[:, group] = 0.0
            actuation[:, [k for k in group if k < last]] = 0.0
            after = self._forcing(run, present, actuation)
            given[:, :, group[-1]], before = before - after, after
        given[~np.isfinite(u).all(axis=1)] = np.nan
        return given

    def _forcing(self, run: Run, u: Array, actuation: Array) -> Array:
        """Force at rest of the acceleration, (N, n); pose that the log lacks is zero."""
        pose, velocity = run.known(self.vehicle.pose_names), run.matrix(self.vehicle.velocity_names)
        memory = np.zeros((len(run.t), self.functions.memory.shape[0]))
        columns = [pose, velocity, memory, u, self.p, run.t[:, None], actuation]
        return at_samples(self._evaluated, columns, len(run.t))[0]

    @cached_property
    def _evaluated(self) -> ca.Function:
        f = self.functions
        arguments = [f.eta, f.nu, f.memory, f.u, f.p, f.t, f.actuation]
        return ca.Function("forcing", arguments, [ca.densify(f.forcing)])


def _tested(
    functions: TestFunctions, motion: Array, n: int, force: Array, mass: Array, run: tuple[int, int]
) -> tuple[Array, Array, Array]:
    """One stretch: inertial force, force of the commands, and what else may act."""
    length = np.asarray(functions.value.sum(axis=1)).ravel()
    some = length > 0.0  # with a sample within
    length = length[some, None]
    velocity = motion[:, :n]
    inertial = -(functions.rate @ velocity)[some] / length @ mass.T
    commanded = (functions.held @ force.reshape(len(force), -1))[some] / length
    products = [velocity[:, i] * velocity[:, j] for i, j in combinations(range(n), 2)]
    columns = np.column_stack([motion, np.abs(velocity) * velocity, *products])
    steady = np.zeros((len(length), run[1]))
    steady[:, run[0]] = 1.0
    beside = np.column_stack([(functions.value @ columns)[some] / length, steady])
    return inertial, commanded.reshape(len(length), *force.shape[1:]), beside


def without(beside: Array, columns: Array) -> Array:
    """What columns have beside others."""
    size = np.linalg.norm(beside, axis=0)
    scaled = beside[:, size > 0] / size[size > 0]
    return np.asarray(columns - scaled @ np.linalg.lstsq(scaled, columns, rcond=1e-10)[0])


def _mass_matrix(functions: Functions, p: Array) -> Array:
    """M at the values of the file, in the vehicle's upright pose where it depends on that."""
    arguments = [functions.x, functions.u, functions.p, functions.t, functions.actuation]
    evaluate = ca.Function("mass", arguments, [functions.mass_matrix], {"allow_free": False})
    zeros = [np.zeros(a.shape) for a in arguments]
    zeros[2] = p
    return np.array(evaluate(*zeros), dtype=float)
