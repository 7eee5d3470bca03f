"""What the weak form needs of a model at one sample, as CasADi functions mapped over all samples."""

from __future__ import annotations

from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from undertow.codegen.functions import Functions

Array = NDArray[np.float64]




class Pointwise:
    """Terms of the weak form at a sample, for one vehicle.

    The measured pose and velocity are first turned back into the true ones (inverse of the measurement effects).
    Rows: momentum M nu, forcing without commands, pose, pose rate, forcing by the commands; n rows each.

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
        inputs = ca.vertcat(f.actuation, f.u[f.actuation.shape[0] :])
        zero = ca.SX.zeros(inputs.shape)
        still = ca.substitute(f.forcing, inputs, zero)
        rows = ca.vertcat(f.mass_matrix @ f.nu, still, f.eta, f.pose_rate, f.forcing - still)
        return ca.cse(ca.substitute(rows, ca.vertcat(f.eta, f.nu), self._true_motion))

    @cached_property
    def _true_motion(self) -> ca.SX:
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
        slope = ca.jacobian(self._rows[4 * self.size :], self.measured)
        return bool(slope.nnz())


def mapped(function: ca.Function, columns: list[Array], p: Array, t: Array) -> list[Array]:
    """Evaluate at N samples: `columns` are (N, k) arrays; results have shape (N, rows, columns)."""
    count = len(t)
    arguments = [ca.DM(c.T) if c.size else ca.DM.zeros(c.shape[1], count) for c in columns]
    results = function.map(count)(*arguments, p, t[None, :]) if count else []
    shapes = [function.size_out(i) for i in range(function.n_out())]
    found = results if isinstance(results, tuple | list) else [results]
    return [_stacked(np.asarray(r), shape, count) for r, shape in zip(found, shapes, strict=True)]


def _stacked(flat: Array, shape: tuple[int, int], count: int) -> Array:
    rows, columns = shape
    return flat.reshape(rows, count, columns).transpose(1, 0, 2) if columns else np.zeros((count, rows, 0))
