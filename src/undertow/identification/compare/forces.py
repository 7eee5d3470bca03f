"""What a model leaves unexplained, as a force: the weak residual in N and N m, and the motion beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from scipy.sparse import bsr_array, csr_array

from undertow.codegen.engine import mapped
from undertow.codegen.functions import Functions
from undertow.identification.estimation.data import Segment, WeakData, prepare
from undertow.identification.estimation.inputs import ActuatorStates, Memory
from undertow.identification.estimation.pointwise import Pointwise
from undertow.identification.estimation.residual import SensorDelay, WeakModel, value_name, whitened
from undertow.identification.estimation.weak_form import of_each_run
from undertow.identification.logs.run import Run
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Index


@dataclass(frozen=True)
class Forces:
    """Force that the motion needs and the model lacks, averaged with K test functions."""

    run: Index  # (K,) run that a test function belongs to
    segment: Index  # (K,) stretch without gaps that it belongs to
    t: Array  # (K,) its middle, s
    missing: Array  # (K, n) force to be added to the model, body axes, N and N m
    noise: Array  # (K, n) standard deviation of `missing` from the noise of the channels alone
    # (K, n) `missing` in units of its noise, free of the correlation that the noise brings in
    whitened: Array
    pose: Array  # (K, n) measured motion, averaged likewise
    velocity: Array
    commands: Array  # (K, n_commands) commands, averaged likewise
    wrenches: dict[str, Array]  # Force of every effect along the measured motion, by effect id, N and N m

    def __len__(self) -> int:
        return len(self.t)

    @property
    def drive(self) -> Array:
        """Force of thrusters, control surfaces and known forces, shape (K, n)."""
        driving = ("thrusters", "propellers", "control_surfaces", "generalised_force")
        parts = [self.wrenches[i] for i in driving if i in self.wrenches]
        return np.asarray(sum(parts, np.zeros_like(self.missing)))


def residual_forces(
    model: Vehicle | Functions,
    runs: Sequence[Run],
    data: WeakData | None = None,
    vehicles: Sequence[Vehicle] | None = None,
) -> Forces:
    """Forces that logs show and a model lacks.

    `data` are the same logs if they are prepared already; `vehicles` the model with its values in each run,
    where these differ.
    """
    functions = model if isinstance(model, Functions) else Functions(model)
    data = prepare(runs, functions.vehicle) if data is None else data
    return _Evaluation(functions, data, vehicles or [functions.vehicle] * len(data.runs)).forces()


class _Evaluation:
    """One model along prepared logs."""

    def __init__(self, functions: Functions, data: WeakData, vehicles: Sequence[Vehicle]) -> None:
        self.functions, self.data = functions, data
        self.size = len(functions.vehicle.dof_indices)
        self.p = np.array(functions.values(), dtype=float)
        known = {
            value_name(name, run.origin): vehicle.value_of(name).value
            for run, vehicle in zip(data.runs, vehicles, strict=True)
            for name in of_each_run(vehicle)
        }
        self._weak = WeakModel(functions, (), known=known)
        self._own = [self._weak.values.own(self.p, run) for run in data.runs]
        self._points = Pointwise(functions, ())
        self._chain = ActuatorStates(functions, ())
        self._sensor_delay = SensorDelay(functions)
        self._memory = Memory(functions, (), self._points.measured, self._points.true_motion)

    def forces(self) -> Forces:
        self._weak.require_defined(self.data, self.p)
        parts = self._weak.linearise(self.data, self.p)
        noise = self._weak.whitening(self.data, self.p)
        white = self._by_segment(-whitened(parts, noise).r)
        commands = [r.matrix(self.data.commands) for r in self.data.runs]
        actuation = [
            self._chain.along(r.t, u, p).value
            for r, u, p in zip(self.data.runs, commands, self._own, strict=True)
        ]
        pieces = []
        for i, reported in enumerate(self.data.segments):
            p = self._own[reported.run]
            s = self._sensor_delay.in_time(reported, p)
            mass, along = self._along(s, actuation[s.run][s.samples], p)
            # The weak residual is the acceleration of the model minus the measured one.
            acceleration = -self._table(parts[i].r) / _weight(s)[:, None]
            along["missing"] = np.einsum("kij,kj->ki", mass, acceleration)
            along["noise"] = self._spread(noise[i].covariance, mass) / _weight(s)[:, None]
            pieces.append(along | {"whitened": white[i]} | _places(i, s))
        return _joined(pieces)

    def _by_segment(self, r: Array) -> list[Array]:
        ends = np.cumsum([s.functions.count * len(self.data.rows) for s in self.data.segments])
        return [self._table(part) for part in np.split(r, ends[:-1])]

    def _table(self, r: Array) -> Array:
        """Entries of the force equations, shape (K, n)."""
        return r.reshape(-1, len(self.data.rows))[:, : self.size]

    def _spread(self, covariance: csr_array, mass: Array) -> Array:
        """Standard deviation of the force times the weight of the test function, shape (K, n)."""
        count, rows = len(mass), len(self.data.rows)
        blocks = np.concatenate([mass, np.zeros((count, self.size, rows - self.size))], axis=2)
        to_force = bsr_array((blocks, np.arange(count), np.arange(count + 1)))
        variance = (to_force @ covariance).multiply(to_force).sum(axis=1)
        return np.sqrt(np.asarray(variance).reshape(-1, self.size))

    def _along(self, s: Segment, actuation: Array, p: Array) -> tuple[Array, dict[str, Any]]:
        """Mass matrix at every test function, shape (K, n, n), and averages of all else."""
        memory = self._memory.along(s.t, s.measured, actuation, s.u, p).value
        (motion,) = mapped(self._points.true_motion_at, [s.measured, actuation, memory, s.u], p, s.t)
        smooth, held = (_rows_to_one(w) for w in (s.functions.value, s.functions.held))
        mean = smooth @ motion[:, :, 0]
        rate = -(s.functions.rate @ motion[:, self.size :, 0]) / _weight(s)[:, None]
        columns = [mean, rate, held @ actuation, smooth @ memory, held @ s.u]
        mass, *values = mapped(self._wrenches, columns, p, s.functions.centre)
        measured = smooth @ s.measured
        return mass, {
            "pose": measured[:, : self.size],
            "velocity": measured[:, self.size :],
            "commands": held @ s.u,
            "wrenches": {k: v[:, :, 0] for k, v in zip(self.functions.wrenches, values, strict=True)},
        }

    @cached_property
    def _wrenches(self) -> ca.Function:
        f = self.functions
        inputs = [ca.vertcat(f.eta, f.nu), f.nu_dot, f.actuation, f.memory, f.u, f.p, f.t]
        outputs = [f.mass_matrix, *f.wrenches.values()]
        return ca.Function("wrenches", inputs, [ca.densify(w) for w in outputs])


def _weight(s: Segment) -> Array:
    """Integral of every test function, s."""
    return np.asarray(s.functions.held.sum(axis=1)).ravel()


def _rows_to_one(weights: csr_array) -> csr_array:
    """Weights that average a signal with each test function."""
    return csr_array(weights.multiply(1.0 / weights.sum(axis=1)[:, None]))


def _places(index: int, s: Segment) -> dict[str, Any]:
    count = s.functions.count
    return {"run": np.full(count, s.run), "segment": np.full(count, index), "t": s.functions.centre}


def _joined(pieces: list[dict[str, Any]]) -> Forces:
    columns: dict[str, Any] = {}
    for name in pieces[0]:
        values = [piece[name] for piece in pieces]
        if name == "wrenches":
            columns[name] = {k: np.concatenate([v[k] for v in values]) for k in values[0]}
        else:
            columns[name] = np.concatenate(values)
    return Forces(**columns)
