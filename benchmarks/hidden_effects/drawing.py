"""What is known of a vehicle: the numbers on its drawing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

ROWS = "XYZKMN"
COLUMNS = "uvwpqr"
MOTIONS = ("surge", "sway", "heave", "roll", "pitch", "yaw")
GRAVITY = 9.81


@dataclass(frozen=True)
class Vehicle:
    """A vehicle in SNAME signs and SI units; vectors of six run over X, Y, Z, K, M, N.

    Attributes
    ----------
    name : str
    dofs : indices of the degrees of freedom it has
    mass : kg
    inertia : (3,) kg m^2, diagonal, about the body origin
    r_g, r_b : (3,) m, centres of gravity and buoyancy in body axes; weight equals buoyancy
    added, linear, quadratic : (6,) diagonal derivatives (X_udot ..., X_u ..., X_uabsu ...), zero or negative
    allocation : (6, n) N and N m per unit of command
    command_limit : N
    depth : m, where a run starts
    reach : (6,) N and N m, largest wrench that a manoeuvre asks for
    pace : (6,) m/s and rad/s, typical speeds, used to size effects
    length : m, from bow to stern
    tether : (3,) m, where a tether is made fast, body axes
    """

    name: str
    dofs: tuple[int, ...]
    mass: float
    inertia: np.ndarray
    r_g: np.ndarray
    r_b: np.ndarray
    added: np.ndarray
    linear: np.ndarray
    quadratic: np.ndarray
    allocation: np.ndarray
    command_limit: float
    depth: float
    reach: np.ndarray
    pace: np.ndarray
    length: float
    tether: np.ndarray

    @property
    def thrusters(self) -> tuple[str, ...]:
        """Names of the commands: f1, f2, ..."""
        return tuple(f"f{i + 1}" for i in range(self.allocation.shape[1]))

    @property
    def weight(self) -> float:
        """Weight in air, N."""
        return round(self.mass * GRAVITY, 6)

    @property
    def mixer(self) -> np.ndarray:
        """(n, 6) commands per wrench: pseudo-inverse of the allocation over the vehicle's own motions."""
        own = np.zeros((6, 6))
        own[self.dofs, self.dofs] = 1.0
        return np.linalg.pinv(own @ self.allocation)

    @property
    def peak_command(self) -> float:
        """Largest command a manoeuvre can ask for, N."""
        return float(min(np.max(np.abs(self.mixer) @ self.reach), self.command_limit))

    @property
    def main(self) -> int:
        """Row of the motion that forces and speeds are measured by: surge, or heave without surge."""
        return 0 if 0 in self.dofs else 2

    @property
    def couplings(self) -> list[tuple[int, int]]:
        """Pairs (force row, velocity column) that a hull with port-starboard symmetry can couple."""
        return [pair for pair in ((1, 5), (0, 4), (1, 3), (2, 4)) if set(pair) <= set(self.dofs)]

    @property
    def tilts(self) -> bool:
        """Whether it rolls or pitches."""
        return 3 in self.dofs or 4 in self.dofs

    def drag_at_pace(self, row: int) -> float:
        """Size of the diagonal drag at the typical speed, N or N m."""
        speed = self.pace[row]
        return float(-self.linear[row] * speed - self.quadratic[row] * speed**2)


def rotor_column(position: tuple[float, float, float], direction: tuple[float, float, float]) -> np.ndarray:
    """(6,) wrench of one newton along `direction` at `position` (m): [d; r x d], as a file prints it."""
    return np.round(np.concatenate([direction, np.cross(position, direction)]), 6) + 0.0
