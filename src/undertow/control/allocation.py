"""Thrust allocation: the commands that give a wanted force, and who takes over where one is at its limit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from undertow.codegen.functions import solve_symmetric
from undertow.errors import UndertowError
from undertow.model.units import to_si
from undertow.model.vehicle_schema import Quantity

from .gains import GainSet

_INF = float("inf")
# Of the mean of the diagonal: free thrusters may be too few for all directions, then least squares is meant.
_DAMPING = 1e-8


@dataclass(frozen=True)
class Allocation:
    """The inverse of B f = tau for the degrees of freedom that the thrusters push in.

    Without limits f = W^-1 B' (B W^-1 B')^-1 tau, the solution with the least f' W f. With limits the same
    step is made as far as the first thruster that reaches its limit; that one stays there, and the free ones
    take over what is left of tau, in the least-squares sense where they are too few. So commands never exceed
    their limits, no round leaves more of tau than the one before, and within the limits the result is that of
    the pseudo-inverse.

    Attributes
    ----------
    matrix : ndarray, shape (n, m)
        Body-frame force of a unit of each command, N and N m.
    rows : tuple of int
        Degrees of freedom that are allocated; the others are left out.
    weights : ndarray, shape (m,)
        Price of the squared command of each.
    limits : ndarray, shape (m,)
        Largest magnitude of each command; infinite where there is none.
    """

    matrix: np.ndarray
    rows: tuple[int, ...]
    weights: np.ndarray
    limits: np.ndarray

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

    def commands(self, force: ca.SX) -> ca.SX:
        """Commands for a wanted force in all degrees of freedom, shape (n, 1) to (m, 1)."""
        wanted = force[list(self.rows)]
        first = ca.sparsify(ca.SX(ca.DM(self.pseudo_inverse))) @ wanted
        return self._within_limits(wanted, first) if self.limited else first

    def delivered(self, commands: ca.SX) -> ca.SX:
        """Force of commands in all degrees of freedom, shape (m, 1) to (n, 1)."""
        return ca.sparsify(ca.SX(ca.DM(self.matrix))) @ commands

    def __call__(self, force: Sequence[float]) -> np.ndarray:
        """Commands for a wanted force as numbers."""
        wanted = ca.SX.sym("force", len(self.matrix))
        found = ca.Function("allocate", [wanted], [self.commands(wanted)])(force)
        return np.asarray(ca.densify(found)).ravel()

    # --- with limits --------------------------------------------------------------------------
    def _within_limits(self, wanted: ca.SX, step: ca.SX) -> ca.SX:
        b = ca.sparsify(ca.SX(ca.DM(self.acting)))
        commands, free = ca.SX.zeros(len(self.limits), 1), ca.SX.ones(len(self.limits), 1)
        short: ca.SX = ca.SX(1)
        for _ in range(int(np.isfinite(self.limits).sum()) + 1):
            ratios = [self._room(commands[i], step[i], i) for i in range(len(self.limits))]
            share = ca.fmin(1, _least(ratios))
            limits = ca.DM(self.limits)
            commands = ca.fmax(-limits, ca.fmin(limits, commands + share * step))
            short = short * (share < 1)
            free = free * (ca.vertcat(*ratios) > share)
            step = short * self._step(b, free, wanted - b @ commands)
        return commands

    def _room(self, command: ca.SX, step: ca.SX, i: int) -> ca.SX:
        """Which part of a step a command can make before it is at its limit."""
        room = self.limits[i] - ca.sign(step) * command
        return (
            ca.if_else(step == 0, _INF, room / ca.fabs(step)) if np.isfinite(self.limits[i]) else ca.SX(_INF)
        )

    def _step(self, b: ca.SX, free: ca.SX, left: ca.SX) -> ca.SX:
        """Change of the free commands that brings the rest of the force, or as much of it as they can."""
        cheap = free / ca.DM(self.weights)
        gram = b @ ca.diag(cheap) @ b.T
        damping = _DAMPING * np.trace(self.acting @ (self.acting / self.weights).T) / len(self.rows)
        multipliers = solve_symmetric(gram + damping * ca.SX.eye(len(self.rows)), left)
        return cheap * (b.T @ multipliers)


def _least(values: list[ca.SX]) -> ca.SX:
    least = values[0]
    for value in values[1:]:
        least = ca.fmin(least, value)
    return least


def allocation_of(gains: GainSet) -> Allocation:
    """The allocation that a gain set asks for on the vehicle that it knows.

    Raises
    ------
    UndertowError
        If a limit is none, or the thrusters push in nothing that the law uses, or not independently.
    """
    plant, vehicle = gains.plant, gains.plant.vehicle
    matrix = np.array(plant.B.xreplace(plant.numbers).tolist(), dtype=float).reshape(plant.B.shape)
    dofs = vehicle.degrees_of_freedom
    rows = tuple(i for i, d in enumerate(dofs) if d not in gains.unactuated)
    if not rows:
        raise UndertowError(
            f"a controller has nothing to command: no thruster of '{vehicle.name}' pushes in "
            f"{', '.join(dofs)}; add [[thrusters]] to the vehicle file"
        )
    if np.linalg.matrix_rank(matrix[list(rows)]) < len(rows):
        raise UndertowError(
            f"thrusters of '{vehicle.name}' cannot push in {', '.join(dofs[i] for i in rows)} independently: "
            "name in unactuated, in the gain file, what is to be left out"
        )
    own = {t.name: t.limit for t in vehicle.thrusters}
    stated = {name: _limit(name, limit) for name, limit in gains.allocation.limits.items()}
    names = vehicle.command_names
    limits = [stated.get(n, own.get(n)) for n in names]
    weights = np.array([gains.allocation.weights.get(n, 1.0) for n in names])
    return Allocation(matrix, rows, weights, np.array([_INF if v is None else v for v in limits]))


def _limit(name: str, stated: Quantity) -> float:
    """A limit as vehicle files state it: in N where the command is the thrust itself."""
    try:
        value = to_si(stated, "N" if isinstance(stated, str) and "N" in stated else "command")
    except UndertowError as error:
        raise UndertowError(f"[allocation] limit of thruster '{name}': {error}") from error
    if value <= 0:
        raise UndertowError(f"[allocation] limit of thruster '{name}' is {stated}: give one above zero")
    return value
