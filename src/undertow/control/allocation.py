"""How a wanted force is shared among the thrusters, in numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from undertow.errors import UndertowError
from undertow.model.tables import Quantity
from undertow.model.units import si_of

from .gains import GainSet


@dataclass(frozen=True)
class Allocation:
    """The inverse of B f = tau for the degrees of freedom that the thrusters push in."""

    matrix: np.ndarray  # (n, m): body-frame force of a unit of each command, N and N m
    rows: tuple[int, ...]  # degrees of freedom that are allocated; the others are left out
    weights: np.ndarray  # (m,): price of the squared command of each
    limits: np.ndarray  # (m,): largest magnitude of each command; infinite where there is none

    @property
    def limited(self) -> bool:
        """Whether any command has a limit."""
        return bool(np.isfinite(self.limits).any())

    @property
    def acting(self) -> np.ndarray:
        """Rows of the matrix that are allocated, shape (k, m)."""
        return self.matrix[list(self.rows)]

    @property
    def pseudo_inverse(self) -> np.ndarray:
        """Commands of a unit of each allocated force without limits, shape (m, k)."""
        b, cheap = self.acting, 1 / self.weights[:, None]
        inverse = cheap * b.T @ np.linalg.inv(b @ (cheap * b.T))
        return np.where(np.abs(inverse) < 1e-14 * np.abs(inverse).max(), 0.0, inverse)

    @property
    def share(self) -> np.ndarray:
        """The same for the forces in all degrees of freedom, shape (m, n)."""
        share = np.zeros(self.matrix.T.shape)
        share[:, list(self.rows)] = self.pseudo_inverse
        return share

    @property
    def given(self) -> np.ndarray:
        """Force that the thrusters give, without limits, for a unit of each wanted one, shape (n, n).

        The identity in the rows that are allocated; what is left out may be pushed along with them.
        """
        return self.matrix @ self.share


def allocation_of(gains: GainSet) -> Allocation:
    """The allocation that a gain set asks for on the vehicle that it knows."""
    vehicle = gains.plant.vehicle
    matrix = gains.plant.thrust_matrix
    dofs = vehicle.degrees_of_freedom
    rows = tuple(i for i, d in enumerate(dofs) if d not in gains.unactuated)
    if not rows:
        raise UndertowError(
            f"a controller has no actuators: no thruster of '{vehicle.name}' pushes in "
            f"{', '.join(dofs)}; add [[thrusters]] to the vehicle file"
        )
    if np.linalg.matrix_rank(matrix[list(rows)]) < len(rows):
        raise UndertowError(
            f"thrusters of '{vehicle.name}' cannot push in {', '.join(dofs[i] for i in rows)} independently: "
            "list under unactuated in the gain file what is not to be controlled"
        )
    own, units = vehicle.command_limits, vehicle.command_units
    stated = {name: _limit(name, limit, units[name]) for name, limit in gains.allocation.limits.items()}
    names = vehicle.command_names
    limits = [stated.get(n, own.get(n, np.inf)) for n in names]
    weights = np.array([gains.allocation.weights.get(n, 1.0) for n in names])
    return Allocation(matrix, rows, weights, np.array(limits))


def _limit(name: str, stated: Quantity, unit: str) -> float:
    """A limit as vehicle files state it: an angle, or in N where the command is the thrust itself."""
    newtons = isinstance(stated, str) and "N" in stated
    counted = "rad" if unit == "rad" else "N" if newtons else "command"
    value = si_of(f"[allocation] limit of '{name}'", stated, counted)
    if value <= 0:
        raise UndertowError(f"[allocation] limit of '{name}' is {stated}: give one above zero")
    return value
