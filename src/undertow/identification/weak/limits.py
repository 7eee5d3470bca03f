"""Matrices that have to be positive for a model to be physical, as cuts on the parameters.

A mass matrix is affine in the parameters, so that v' M(p) v is as well for every direction v: each direction
that a step would make negative is one linear inequality, and M > 0 is all of them together.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from undertow.codegen.functions import Functions
from undertow.model.effect import Wrench
from undertow.typing import Array

from .mapping import call

# Least eigenvalue of the mass matrix, as a share of the stated inertia of each motion.
_LEAST_MASS = 1e-3
# Share of the scale of a matrix by which a least eigenvalue may miss its limit, and still counts as at it.
ROUNDING, _AT_LIMIT = 1e-7, 1e-5


@dataclass(frozen=True)
class Cut:
    """Linear inequality slope' step >= lacking on a step of the free parameters."""

    slope: Array
    lacking: float


class Limits:
    """Which parameters a model can have together.

    Parameters
    ----------
    functions : Functions
        The model.
    places : sequence of int
        Places in p of the free parameters.
    dissipative : bool
        Whether linear damping has to take energy from every motion, D + D' >= 0. It is not asked for by
        itself: at speed, the coefficients of a hull hold lift and the Munk moment too, which need not.
    """

    def __init__(self, functions: Functions, places: Sequence[int], *, dissipative: bool = False) -> None:
        self._places = list(places)
        free = ca.vertcat(*[functions.p[i] for i in places]) if places else ca.SX(0, 1)
        stated = np.array(functions.values(), dtype=float)
        found = [
            _Matrix("mass matrix M > 0", m, free, functions, stated, _LEAST_MASS) for m in _masses(functions)
        ]
        if dissipative and (damping := _linear_damping(functions)) is not None:
            found.append(_Matrix("linear damping D + D' >= 0", damping, free, functions, stated, 0.0))
        self._all, self._matrices = found, [matrix for matrix in found if matrix.felt]

    def cuts(self, p: Array) -> list[Cut]:
        """What a step from p has to do for every matrix to be positive; nothing where all are."""
        return [cut for matrix in self._matrices for cut in matrix.cuts(p)]

    def broken(self, p: Array) -> bool:
        """Whether a matrix is not positive at p."""
        return any(matrix.least(p) < -ROUNDING for matrix in self._matrices)

    def impossible(self, p: Array) -> list[str]:
        """Names of all matrices that are not positive at p, those that no free parameter changes too."""
        return [matrix.told(p) for matrix in self._all if matrix.least(p) < -ROUNDING]

    def moved(self, p: Array, step: Array) -> Array:
        """All parameters after a step of the free ones."""
        found = p.copy()
        found[self._places] += step
        return found

    def active(self, p: Array) -> list[str]:
        """Names of the limits that hold the parameters back, with the motions that they concern."""
        return [matrix.told(p) for matrix in self._matrices if matrix.least(p) < _AT_LIMIT]


class _Matrix:
    """One symmetric matrix with the least eigenvalue that it may have, relative to its stated diagonal."""

    def __init__(
        self, name: str, expression: ca.SX, free: ca.SX, functions: Functions, stated: Array, least: float
    ) -> None:
        self.name, self._least = name, least
        self._motions = functions.vehicle.degrees_of_freedom
        self._size = expression.shape[0]
        symmetric = ca.densify((expression + expression.T) / 2)
        slope = ca.jacobian(ca.vec(symmetric), free)
        self.felt = slope.nnz() > 0
        self._function = ca.Function("limit", [functions.p], [symmetric, ca.densify(slope)])
        diagonal = np.diag(self._values(stated)[0])
        self._scale = 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))

    def _values(self, p: Array) -> tuple[Array, Array]:
        matrix, slope = call(self._function, [p])
        return matrix.reshape(self._size, self._size), slope.reshape(-1, self._size, self._size)

    def _directions(self, p: Array) -> tuple[Array, Array]:
        matrix = self._values(p)[0]
        weights, vectors = np.linalg.eigh(matrix * np.outer(self._scale, self._scale))
        return weights - self._least, vectors

    def least(self, p: Array) -> float:
        """Least eigenvalue above its limit, in shares of the stated inertia or damping."""
        return float(self._directions(p)[0][0])

    def cuts(self, p: Array) -> Iterator[Cut]:
        over, vectors = self._directions(p)
        if over[0] >= -ROUNDING:
            return
        slope = self._values(p)[1]
        for excess, vector in zip(over, vectors.T, strict=True):
            if excess < -ROUNDING:
                motion = vector * self._scale
                yield Cut(np.einsum("i,kij,j->k", motion, slope, motion), -float(excess))

    def told(self, p: Array) -> str:
        direction = self._directions(p)[1][:, 0]
        part = np.abs(direction) > 0.1 * np.max(np.abs(direction))
        return f"{self.name} ({', '.join(m for m, there in zip(self._motions, part, strict=True) if there)})"


def _masses(functions: Functions) -> list[ca.SX]:
    """The mass matrix at rest, or ahead and astern where it depends on the motion."""
    f, mass = functions, functions.mass_matrix
    around = ca.vertcat(f.eta, f.nu, f.memory, f.actuation, f.t)
    if not ca.depends_on(ca.vec(mass), around):
        return [mass]
    others = ca.SX.zeros(around.shape[0] - f.nu.shape[0])
    rest = ca.vertcat(f.eta, f.memory, f.actuation, f.t)
    still = ca.substitute(ca.densify(mass), rest, others)
    return [ca.substitute(still, f.nu, sign * ca.SX.ones(f.nu.shape)) for sign in (1.0, -1.0)]


def _linear_damping(functions: Functions) -> ca.SX | None:
    """Matrix of linear damping at a standstill; None for a vehicle without coupling between motions."""
    f = functions
    stating = {e.id: e.damping_matrix for e in f.vehicle.effects if isinstance(e, Wrench)}
    # The diagonal first, whatever the order in the file: a sum of the same terms in the same order.
    parts = [f.wrenches[i] for kind in ("diagonal", "coupling") for i, own in stating.items() if own == kind]
    if "coupling" not in stating.values():
        return None
    damping = -ca.jacobian(sum(parts[1:], parts[0]), f.nu)
    around = ca.vertcat(f.eta, f.nu, f.memory, f.actuation, f.t)
    return ca.substitute(ca.densify(damping), around, ca.SX.zeros(around.shape))
