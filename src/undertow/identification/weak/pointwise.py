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

    The measured pose and velocity are first turned back into the true ones (inverse of the measurement
    effects). Rows: velocity, acceleration by all forces but the commands, pose, pose rate, acceleration
    by the
    commands; n rows each. The equations of motion are divided by the mass matrix: their noise then
    hardly depends on the
    parameters, and least squares is not drawn to small inertia, as it is where the noise is multiplied
    by what is
    estimated.

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
    def inverse(self) -> ca.SX:
        """Inverse of the mass matrix: a number from outside where it does not depend on the motion."""
        if self.mass_is_constant:
            return ca.SX.sym("inverse", self.size, self.size)
        return solve_symmetric(self._true(self.functions.mass_matrix), ca.SX.eye(self.size))

    @cached_property
    def mass_is_constant(self) -> bool:
        """Whether the mass matrix is the same at all samples."""
        f = self.functions
        return not ca.depends_on(ca.vec(f.mass_matrix), ca.vertcat(f.eta, f.nu, f.t))

    def mass_inverse(self, p: Array) -> Array:
        """Value of `inverse` at parameters p, column-major, shape (n * n,); empty where it varies."""
        if not self.mass_is_constant:
            return np.zeros(0)
        (mass,) = call(self._mass, [p])
        return np.asarray(np.linalg.inv(mass.reshape(self.size, self.size)), dtype=float).ravel()

    @cached_property
    def _mass(self) -> ca.Function:
        return ca.Function("mass", [self.functions.p], [ca.densify(self.functions.mass_matrix)])

    def _true(self, expression: ca.SX) -> ca.SX:
        f = self.functions
        return ca.substitute(expression, ca.vertcat(f.eta, f.nu), self.true_motion)

    @cached_property
    def _forces(self) -> tuple[ca.SX, ca.SX]:
        """Forcing without the commands, and by the commands."""
        f = self.functions
        still = ca.substitute(f.forcing, self._drive, ca.SX.zeros(self._drive.shape))
        return self._true(still), self._true(self._by_commands)

    @cached_property
    def _rows(self) -> ca.SX:
        f = self.functions
        still, driven = self._forces
        velocity, pose, rate = self._true(f.nu), self._true(f.eta), self._true(f.pose_rate)
        return ca.cse(ca.vertcat(velocity, self.inverse @ still, pose, rate, self.inverse @ driven))

    def _slope(self, variables: ca.SX) -> ca.SX:
        """Derivative of the rows: that of an acceleration M^-1 h is M^-1 (dh - dM M^-1 h)."""
        n = self.size
        mass = self._true(self.functions.mass_matrix)
        kinematic = ca.jacobian(self._rows, variables)
        parts = []
        for force in self._forces:
            acceleration = ca.SX.sym("acceleration", n)
            slope = ca.jacobian(force - mass @ acceleration, variables)
            parts.append(self.inverse @ ca.substitute(slope, acceleration, self.inverse @ force))
        return ca.vertcat(kinematic[:n, :], parts[0], kinematic[2 * n : 4 * n, :], parts[1])

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
        constant = ca.vec(self.inverse) if self.mass_is_constant else ca.SX(0, 1)
        return [self.measured, f.actuation, f.memory, f.u, constant, f.p, f.t]

    @cached_property
    def value(self) -> ca.Function:
        """The rows, shape (5n,)."""
        return ca.Function("weak", self._inputs, [ca.densify(self._rows)])

    @cached_property
    def value_and_derivatives(self) -> ca.Function:
        """The rows, and their derivatives in the free parameters, the actuation and the memory states."""
        f = self.functions
        free = ca.vertcat(*[f.p[i] for i in self.free])
        derivatives = [self._slope(v) for v in (free, f.actuation, f.memory)]
        results = ca.cse([self._rows, *derivatives])
        return ca.Function("weak_derivatives", self._inputs, [ca.densify(v) for v in results])

    @cached_property
    def noise(self) -> ca.Function:
        """Derivative of the rows in the measured pose and velocity, shape (5n, 2n)."""
        return ca.Function("weak_noise", self._inputs, [ca.densify(self._slope(self.measured))])

    @cached_property
    def held_depends_on_motion(self) -> bool:
        """Whether the force of the commands depends on the motion."""
        motion = ca.vertcat(self.functions.eta, self.functions.nu)
        return bool(ca.depends_on(ca.vertcat(self._by_commands, ca.vec(self.functions.mass_matrix)), motion))


def mapped(function: ca.Function, columns: list[Array], p: Array, t: Array) -> list[Array]:
    """Evaluate at N samples: `columns` are (N, k) arrays; results have shape (N, rows, columns)."""
    count = len(t)
    arguments = [*columns, np.tile(p, (count, 1)), t[:, None]]
    flat = call(map_over(function, count), arguments)
    shapes = [function.size_out(i) for i in range(function.n_out())]
    # CasADi is column-major: a sample's matrix lies transposed in the flat result.
    return [f.reshape(count, c, r).transpose(0, 2, 1) for f, (r, c) in zip(flat, shapes, strict=True)]


def call(function: ca.Function, arguments: list[Array]) -> list[Array]:
    """Call a function through its buffers; arguments and results are flat, column-major, without copies by
    CasADi.
    """
    buffer, evaluate = function.buffer()
    inputs = [np.ascontiguousarray(a, dtype=float) for a in arguments]
    results = [np.zeros(function.numel_out(i)) for i in range(function.n_out())]
    for i, array in enumerate(inputs):
        buffer.set_arg(i, memoryview(array.ravel().data))
    for i, array in enumerate(results):
        buffer.set_res(i, memoryview(array.data))
    evaluate()
    return results


@lru_cache(maxsize=256)
def map_over(function: ca.Function, count: int) -> ca.Function:
    """The function over `count` samples in one call; made once."""
    return function.map(count)
