"""What the weak form needs of a model at one sample, as CasADi functions mapped over all samples."""

from __future__ import annotations

from functools import cached_property, lru_cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from undertow.codegen.functions import Functions, solve_symmetric

Array = NDArray[np.float64]




class Pointwise:
    """Terms of the weak form at a sample, for one vehicle.

    The measured pose and velocity are first turned back into the true ones (inverse of the measurement effects).
    Rows: velocity, acceleration by all forces but the commands, pose, pose rate, acceleration by the commands; n rows
    each. The equations of motion are divided by the mass matrix: their noise then hardly depends on the parameters,
    and least squares is not drawn to small inertia, as it is where the noise is multiplied by what is estimated.

    Parameters
    ----------
    functions : Functions
        The model.
    free : tuple of int
        Places in p of the parameters that derivatives are taken in.
    """

    def __init__(self, functions: Functions, free: tuple[int, ...]) -> None:
        self.functions, self.free = functions, free
        self.size = len(functions.vehicle.dof_indices)
        self.measured = ca.SX.sym("measured", 2 * self.size)

    @cached_property
    def _rows(self) -> ca.SX:
        f = self.functions
        still = ca.substitute(f.forcing, self._drive, ca.SX.zeros(self._drive.shape))
        accelerations = solve_symmetric(f.mass_matrix, ca.horzcat(still, self._by_commands))
        rows = ca.vertcat(f.nu, accelerations[:, 0], f.eta, f.pose_rate, accelerations[:, 1])
        return ca.cse(ca.substitute(rows, ca.vertcat(f.eta, f.nu), self.true_motion))

    @cached_property
    def _drive(self) -> ca.SX:
        f = self.functions
        return ca.vertcat(f.actuation, f.u[f.actuation.shape[0] :])

    @cached_property
    def _by_commands(self) -> ca.SX:
        """Part of the forcing that the commands bring in."""
        f = self.functions
        slope = ca.jacobian(f.forcing, self._drive)
        if not ca.depends_on(slope, ca.vertcat(self._drive, f.eta, f.nu)):
            return slope @ self._drive
        return f.forcing - ca.substitute(f.forcing, self._drive, ca.SX.zeros(self._drive.shape))

    @cached_property
    def true_motion(self) -> ca.SX:
        """Pose and velocity from what the sensors report; the report is affine in them."""
        f = self.functions
        motion = ca.vertcat(f.eta, f.nu)
        slope = ca.jacobian(f.reported, motion)
        if slope.is_eye():
            return self.measured - ca.substitute(f.reported, motion, ca.SX.zeros(motion.shape))
        zero = ca.SX.zeros(motion.shape)
        flat = ca.substitute(ca.densify(slope), motion, zero)
        offset = ca.substitute(f.reported, motion, zero)
        return ca.solve(flat, self.measured - offset)

    @cached_property
    def _inputs(self) -> list[ca.SX]:
        f = self.functions
        return [self.measured, f.actuation, f.memory, f.u, f.p, f.t]

    @cached_property
    def value(self) -> ca.Function:
        """The rows, shape (5n,)."""
        return ca.Function("weak", self._inputs, [ca.densify(self._rows)])

    @cached_property
    def value_and_derivatives(self) -> ca.Function:
        """The rows, and their derivatives in the free parameters, the actuation and the memory states."""
        f = self.functions
        free = ca.vertcat(*[f.p[i] for i in self.free])
        derivatives = [ca.jacobian(self._rows, v) for v in (free, f.actuation, f.memory)]
        return ca.Function("weak_derivatives", self._inputs, [ca.densify(v) for v in (self._rows, *derivatives)])

    @cached_property
    def noise(self) -> ca.Function:
        """Derivative of the rows in the measured pose and velocity, shape (5n, 2n)."""
        return ca.Function("weak_noise", self._inputs, [ca.densify(ca.jacobian(self._rows, self.measured))])

    @cached_property
    def held_depends_on_motion(self) -> bool:
        """Whether the force of the commands depends on the motion."""
        motion = ca.vertcat(self.functions.eta, self.functions.nu)
        return bool(ca.depends_on(ca.vertcat(self._by_commands, ca.vec(self.functions.mass_matrix)), motion))


def mapped(function: ca.Function, columns: list[Array], p: Array, t: Array) -> list[Array]:
    """Evaluate at N samples: `columns` are (N, k) arrays; results have shape (N, rows, columns)."""
    count = len(t)
    arguments = [*columns, np.tile(p, (count, 1)), t[:, None]]
    flat = call(_map(function, count), arguments)
    shapes = [function.size_out(i) for i in range(function.n_out())]
    # CasADi is column-major: a sample's matrix lies transposed in the flat result.
    return [f.reshape(count, c, r).transpose(0, 2, 1) for f, (r, c) in zip(flat, shapes, strict=True)]


def call(function: ca.Function, arguments: list[Array]) -> list[Array]:
    """Call a function through its buffers; arguments and results are flat, column-major, without copies by CasADi."""
    buffer, evaluate = function.buffer()
    inputs = [np.ascontiguousarray(a, dtype=float) for a in arguments]
    results = [np.zeros(function.numel_out(i)) for i in range(function.n_out())]
    for i, array in enumerate(inputs):
        buffer.set_arg(i, memoryview(array.ravel()))
    for i, array in enumerate(results):
        buffer.set_res(i, memoryview(array))
    evaluate()
    return results


@lru_cache(maxsize=256)
def _map(function: ca.Function, count: int) -> ca.Function:
    return function.map(count)
