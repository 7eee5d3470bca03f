"""The three vehicles of the benchmark: what is known of them, and how a real one differs from the drawing."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

ROWS = "XYZKMN"
COLUMNS = "uvwpqr"
MOTIONS = ("surge", "sway", "heave", "roll", "pitch", "yaw")
GRAVITY = 9.81
#: Largest relative difference of the drawn truth from the nominal value, and of a guess from the truth.
TRUTH_SPREAD, GUESS_SPREAD = 0.2, 0.15


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

    def drag_at_pace(self, row: int) -> float:
        """Size of the diagonal drag at the typical speed, N or N m."""
        speed = self.pace[row]
        return float(-self.linear[row] * speed - self.quadratic[row] * speed**2)


def rotor_column(position: tuple[float, float, float], direction: tuple[float, float, float]) -> np.ndarray:
    """(6,) wrench of one newton along `direction` at `position` (m): [d; r x d], as a file prints it."""
    return np.round(np.concatenate([direction, np.cross(position, direction)]), 6) + 0.0


def _mini_auv() -> Vehicle:
    """A small AUV with two vertical (f1, f3) and two forward (f2, f4) thrusters; sway has none."""
    arm = 0.16
    columns = [rotor_column((0, -arm, 0), (0, 0, 1)), rotor_column((0, -arm, 0), (1, 0, 0)),
               rotor_column((0, arm, 0), (0, 0, 1)), rotor_column((0, arm, 0), (1, 0, 0))]  # fmt: skip
    allocation = np.column_stack(columns)
    allocation[[1, 3, 4]] = 0.0  # roll and pitch are held by the hull's stiffness and are not modelled
    return Vehicle(
        name="mini-auv", dofs=(0, 1, 2, 5), mass=7.5,
        inertia=np.array([0.11, 0.199, 0.251]), r_g=np.zeros(3), r_b=np.zeros(3),
        added=-np.array([1.63, 3.3, 2.6, 0, 0, 0.0237]),
        linear=-np.array([0.55, 2.7, 6.2, 0, 0, 0.065]),
        quadratic=-np.array([5.3, 0, 0, 0, 0, 0]),
        allocation=allocation, command_limit=6.0, depth=8.0,
        reach=np.array([2.4, 0, 2.0, 0, 0, 0.15]), pace=np.array([0.45, 0.2, 0.2, 0.1, 0.1, 0.7]),
    )  # fmt: skip


def _rov() -> Vehicle:
    """An open-frame ROV with four horizontal thrusters at 45 degrees (f1-f4) and four vertical (f5-f8)."""
    diagonal = float(np.sqrt(0.5))
    flat = [rotor_column((0.156, s * 0.111, 0.0), (diagonal, -s * diagonal, 0)) for s in (1, -1)]
    flat += [rotor_column((-0.156, s * 0.111, 0.0), (diagonal, s * diagonal, 0)) for s in (1, -1)]
    upright = [rotor_column((x, y, 0), (0, 0, -1)) for x in (0.12, -0.12) for y in (0.218, -0.218)]
    return Vehicle(
        name="rov", dofs=(0, 1, 2, 3, 4, 5), mass=11.5,
        inertia=np.array([0.20, 0.21, 0.19]), r_g=np.array([0.0, 0.0, 0.06]), r_b=np.zeros(3),
        added=-np.array([5.5, 12.7, 14.57, 0.12, 0.12, 0.12]),
        linear=-np.array([4.03, 6.22, 5.18, 0.07, 0.07, 0.07]),
        quadratic=-np.array([18.18, 21.66, 36.99, 1.55, 1.55, 1.55]),
        allocation=np.column_stack(flat + upright), command_limit=12.0, depth=10.0,
        reach=np.array([16.0, 16.0, 14.0, 1.2, 1.2, 1.8]), pace=np.array([0.45, 0.45, 0.35, 0.3, 0.3, 0.7]),
    )  # fmt: skip


def _usv() -> Vehicle:
    """A model ship: surge force (f1), bow force 0.35 m ahead of the origin (f2), yaw moment (f3)."""
    columns = [rotor_column((0, 0, 0), (1, 0, 0)), rotor_column((0.35, 0, 0), (0, 1, 0)), np.eye(6)[5]]
    return Vehicle(
        name="usv", dofs=(0, 1, 5), mass=23.8,
        inertia=np.array([1.0, 1.0, 1.76]), r_g=np.array([0.046, 0.0, 0.0]), r_b=np.array([0.046, 0.0, 0.0]),
        added=-np.array([2.0, 10.0, 0, 0, 0, 1.0]),
        linear=-np.array([0.72, 0.89, 0, 0, 0, 1.9]),
        quadratic=-np.array([1.33, 36.5, 0, 0, 0, 0.75]),
        allocation=np.column_stack(columns), command_limit=2.0, depth=0.0,
        reach=np.array([1.6, 1.2, 0, 0, 0, 0.6]), pace=np.array([0.35, 0.12, 0.1, 0.1, 0.1, 0.2]),
    )  # fmt: skip


NOMINAL: dict[str, Vehicle] = {v.name: v for v in (_mini_auv(), _rov(), _usv())}


def real_vehicle(name: str, rng: np.random.Generator) -> Vehicle:
    """The vehicle as built: each nominal hydrodynamic value times 1 +- 20 %, the rest as on the drawing."""
    nominal = NOMINAL[name]
    low, high = 1 - TRUTH_SPREAD, 1 + TRUTH_SPREAD
    added, linear, quadratic = (v * rng.uniform(low, high, 6) for v in
                                (nominal.added, nominal.linear, nominal.quadratic))  # fmt: skip
    return replace(nominal, added=added, linear=linear, quadratic=quadratic)
