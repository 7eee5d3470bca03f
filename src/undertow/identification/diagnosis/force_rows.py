"""The force that a fitted model lacks in each equation of motion, along logs, with the noise in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from scipy.sparse import bsr_array, csr_array, diags_array

from undertow.codegen.engine import mapped
from undertow.identification.estimation.data import Segment, WeakData
from undertow.identification.estimation.fitted import Fitted
from undertow.identification.estimation.inputs import ActuatorStates
from undertow.identification.estimation.pointwise import Pointwise
from undertow.identification.estimation.residual import Linearised, SensorDelay, whitened
from undertow.identification.estimation.test_functions import Whitening, banded, overlap
from undertow.identification.estimation.weak_form import matching_factor
from undertow.typing import Array

from .associations import Column, Trajectory
from .settings import DEFAULT


@dataclass(frozen=True)
class ForceSettings:
    """When a residual force counts as noise, and how long it is averaged to exceed it."""

    # Mean square, in units of the noise, up to which there is no disturbance.
    noise_limit: float = DEFAULT.equation_noise_limit
    matching_steps: int = 12  # steps in which the intensity of a disturbance is matched; converged
    widths: tuple[int, ...] = (1, 2, 4, 8, 16)  # numbers of test functions to average over, tried in turn
    detectable_ratio: float = 1.5  # mean square over that of noise from which the force is detectable


SETTINGS = ForceSettings()


@dataclass(frozen=True)
class ForceRow:
    """One force equation of a fitted model along logs.

    parts: for every segment the force of the model in excess of that required by the motion, and its
    derivative with respect to the free parameters, times the weight of the test functions, N s or N m s.
    sensor_noise: noise of the channels in it.
    weight: mean integral of a test function, s.
    """

    parts: list[Linearised]
    sensor_noise: list[Whitening]
    weight: float

    def whitened(self, disturbance: float, columns: Sequence[Array] | None = None) -> Linearised:
        """Residual and derivatives in units of the noise, with further columns behind those of the model.

        columns: (K, q), further derivatives, one table for each segment.
        """
        counts = [len(p.r) for p in self.parts]
        noise = [
            w.with_disturbance(np.full(n, disturbance))
            for w, n in zip(self.sensor_noise, counts, strict=True)
        ]
        return whitened(self.parts if columns is None else _with_columns(self.parts, columns), noise)

    @property
    def ratio(self) -> float:
        """Mean square in units of the noise of the channels alone."""
        return float(np.mean(self.whitened(0.0).r ** 2))

    @property
    def rms(self) -> float:
        """Rms of the force averaged under the test functions, N or N m."""
        return float(np.sqrt(np.mean(np.concatenate([p.r for p in self.parts]) ** 2))) / self.weight

    @property
    def noise_rms(self) -> float:
        """Rms of its channel noise, N or N m."""
        variance = np.concatenate([w.covariance.diagonal() for w in self.sensor_noise])
        return float(np.sqrt(np.mean(variance))) / self.weight

    @property
    def excess_rms(self) -> float:
        """Rms of the force above the noise, averaged over the shortest time in which it exceeds it."""
        for width in SETTINGS.widths:
            total, noise = self._mean_squares(width)
            if total > SETTINGS.detectable_ratio * noise:
                break
        return float(np.sqrt(max(total - noise, 0.0)))

    def averaged(self, width: int) -> list[tuple[Array, Array]]:
        """Mean force over every `width` neighbouring test functions and its variance by the noise.

        N and N^2 (N m), in every segment shape (max(K - width + 1, 0),).
        """
        whole, found = self.weight * width, []
        for part, noise in zip(self.parts, self.sensor_noise, strict=True):
            groups = sliding_sums(len(part.r), width)
            variance = (groups @ csr_array(noise.covariance) @ groups.T).diagonal()
            found.append((groups @ part.r / whole, variance / whole**2))
        return found

    def _mean_squares(self, width: int) -> tuple[float, float]:
        """Mean square of the force over `width` test functions, and that of its noise."""
        force, variance = (np.concatenate(c) for c in zip(*self.averaged(width), strict=True))
        return (float(np.mean(force**2)), float(np.mean(variance))) if len(force) else (0.0, 0.0)

    @cached_property
    def is_noise(self) -> bool:
        """Whether channel noise explains it."""
        return self.ratio < SETTINGS.noise_limit

    @cached_property
    def disturbance(self) -> float:
        """Intensity that makes the whitened mean square one, N^2 s; zero where noise explains it."""
        if self.is_noise:
            return 0.0
        level = self.rms**2 * self.weight
        for _ in range(SETTINGS.matching_steps):
            square = float(np.mean(self.whitened(level).r ** 2))
            level *= float(matching_factor(square))
        return level


def sliding_sums(count: int, width: int) -> csr_array:
    """Sums over every `width` consecutive rows of `count`, shape (max(count - width + 1, 0), count)."""
    if count < width:  # a segment too short for any
        return csr_array((0, count))
    shape = count - width + 1, count
    return csr_array(diags_array([np.ones(shape[0])] * width, offsets=range(width), shape=shape))


def _with_columns(parts: Sequence[Linearised], columns: Sequence[Array]) -> list[Linearised]:
    pairs = zip(parts, columns, strict=True)
    return [Linearised(p.r, np.column_stack([p.J, c]), p.start, p.known) for p, c in pairs]


class ForceRows:
    """Force equations of a fitted model along logs; a force missing in one does not affect the others."""

    def __init__(self, fit: Fitted, data: WeakData) -> None:
        self._fit, self.data = fit, data
        self._size = len(fit.model.functions.vehicle.dof_indices)

    def row(self, dof: int) -> ForceRow:
        """The equation of one degree of freedom, by its place among those of the vehicle."""
        rows = len(self.data.rows)
        parts, sensor_noise = [], []
        segments = zip(self.data.segments, self._residual, self._noise, self.mass, strict=True)
        for s, part, noise, mass in segments:
            to_force = self._to_force(mass[:, dof])
            known = None if part.known is None else part.known // rows
            parts.append(Linearised(to_force @ part.r, to_force @ part.J, to_force @ part.start, known))
            covariance = banded(csr_array(to_force @ noise.covariance @ to_force.T))
            sensor_noise.append(Whitening(covariance, overlap(s.functions, s.t, 1), np.zeros(len(mass))))
        weights = np.concatenate([s.functions.held.sum(axis=1) for s in self.data.segments])
        return ForceRow(parts, sensor_noise, float(np.mean(weights)))

    def _to_force(self, mass: Array) -> csr_array:
        """From accelerations of all equations to the force in one, shape (K, K rows)."""
        count, rows = len(mass), len(self.data.rows)
        blocks = np.concatenate([mass, np.zeros((count, rows - self._size))], axis=1)[:, None, :]
        return csr_array(bsr_array((blocks, np.arange(count), np.arange(count + 1))))

    @cached_property
    def _residual(self) -> list[Linearised]:
        return self._fit.model.linearise(self.data, self._fit.p)

    @cached_property
    def _noise(self) -> list[Whitening]:
        return self._fit.model.whitening(self.data, self._fit.p)

    @cached_property
    def mass(self) -> list[Array]:
        """Mass matrix under every test function, shape (K, n, n)."""
        return [self._mean(s, mass) for s, _, mass in self.trajectories]

    def _mean(self, s: Segment, mass: Array) -> Array:
        weight = s.functions.value.sum(axis=1)[:, None]
        mean = (s.functions.value @ mass.reshape(len(s.t), -1)) / weight
        return np.asarray(mean.reshape(-1, self._size, self._size))

    # --- further forces -----------------------------------------------------------------------
    def columns(self, columns: Sequence[Column]) -> list[Array]:
        """Contribution of columns with unit coefficients to a row, shape (K, columns) in every segment."""
        return [weak_integrals(s, trajectory, columns) for s, trajectory, _ in self.trajectories]

    def waves(self, frequency: float) -> list[Array]:
        """The same for a cosine and a sine of unit amplitude in time, shape (K, 2); frequency in Hz."""
        phases = [(s, 2 * np.pi * frequency * s.t) for s, _, _ in self.trajectories]
        return [s.functions.value @ np.column_stack([np.cos(a), np.sin(a)]) for s, a in phases]

    @cached_property
    def trajectories(self) -> list[tuple[Segment, Trajectory, Array]]:
        """Every segment with motion and commands at its samples, and its mass matrix (N, n, n)."""
        model, data = self._fit.model, self.data
        own = [model.values.of_run(self._fit.p, run) for run in data.runs]
        actuators, motion = ActuatorStates(model.functions, ()), self._motion
        delay, each = SensorDelay(model.functions), zip(data.runs, data.held, own, strict=True)
        actuation_of_run = [actuators.along(r.t, u, p).value for r, u, p in each]
        found = []
        for s in (delay.in_time(s, own[s.run]) for s in data.segments):
            pose, velocity, mass = mapped(motion, [s.measured], own[s.run], s.t)
            actuation = actuation_of_run[s.run][s.samples]
            reached = np.column_stack([actuation, s.u[:, actuation.shape[1] :]])
            found.append((s, self._values(s.t, pose[:, :, 0], velocity[:, :, 0], reached), mass))
        return found

    def _values(self, t: Array, pose: Array, velocity: Array, commands: Array) -> Trajectory:
        vehicle = self._fit.model.functions.vehicle
        names = (*vehicle.pose_names, *vehicle.velocity_names, "t")
        values = dict(zip(names, np.column_stack([pose, velocity, t]).T, strict=True))
        return Trajectory(values, dict(zip(self.data.commands, commands.T, strict=True)))

    @property
    def _motion(self) -> ca.Function:
        """Pose, velocity through the water and mass matrix, from what is measured."""
        f = self._fit.model.functions
        points = Pointwise(f, ())
        relative = f.vehicle.composition.signals.nu_r.extract(list(f.vehicle.dof_indices), [0])
        outputs = (f.eta, f.convert.matrix(relative), f.mass_matrix)
        true = [ca.densify(ca.substitute(e, ca.vertcat(f.eta, f.nu), points.true_motion)) for e in outputs]
        return ca.Function("motion", [points.measured, f.p, f.t], true)


def weak_integrals(s: Segment, trajectory: Trajectory, columns: Sequence[Column]) -> Array:
    """Integrals of columns times the test functions of a segment, (K, columns)."""
    smooth, held = np.zeros((2, len(s.t), len(columns)))
    for k, column in enumerate(columns):
        motion, commands = trajectory.motion_product(column), trajectory.command_product(column)
        if commands is None:
            smooth[:, k] = motion
        else:
            # The command is held over an interval, the motion is taken at both of its ends.
            held[:, k] = commands * np.append(0.5 * (motion[1:] + motion[:-1]), motion[-1])
    return np.asarray(s.functions.value @ smooth + s.functions.held @ held)
