"""A description of one simulated tank: what the hull, the water, the thrusters and the sensors do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from .drawing import COLUMNS, ROWS, Vehicle


@dataclass(slots=True)
class Moment:
    """All that is known at one instant of R simultaneous runs (last axis).

    eta, nu, nu_r : (6, R) pose, velocity over ground, velocity relative to the water (body axes)
    turn : (3, 3, R) body to NED; thrust : (n, R) N; drag : (6, R) wrench of the hull's damping
    """

    t: float
    eta: np.ndarray
    nu: np.ndarray
    nu_r: np.ndarray
    turn: np.ndarray
    thrust: np.ndarray
    drag: np.ndarray


Wrench = Callable[[Moment], np.ndarray]
ThrustStage = Callable[[np.ndarray, float], np.ndarray]
InflowStage = Callable[[np.ndarray, np.ndarray], np.ndarray]
Flow = Callable[[float, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
Sensor = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Memory:
    """`size` further states s with ds/dt = rate(moment, s) that press on the hull with wrench(moment, s)."""

    size: int
    rate: Callable[[Moment, np.ndarray], np.ndarray]
    wrench: Callable[[Moment, np.ndarray], np.ndarray]


@dataclass
class World:
    """A vehicle and its surroundings, which the hidden effects change before the simulation starts.

    M_RB nu_dot + b C_RB(nu) nu + M_A nu_r_dot + c C_A(nu_r) nu_r = D(nu_r) + G k + B f + wrenches + memories
    with D = L nu_r + Q |nu_r| nu_r + K nu_r^3 + T nu_r nu_r, k = unit vector downwards in body axes,
    b = `rigid_coriolis` and c = `added_coriolis`, 1 or 0.

    Commands become forces f: `command_delay`, `stages` (f, t), `lag` (first order), `inflow` (f, nu_r).
    States become readings: `velocity_delay` (u, v, w only), then `sensors` in their order, then noise.
    """

    vehicle: Vehicle
    rigid_mass: np.ndarray
    added_mass: np.ndarray
    linear: np.ndarray
    quadratic: np.ndarray
    cubic: np.ndarray
    products: np.ndarray
    gravity_wrench: np.ndarray
    allocation: np.ndarray
    added_coriolis: float = 1.0
    rigid_coriolis: float = 1.0
    command_delay: float = 0.0
    velocity_delay: float = 0.0
    lag: float = 0.0
    stages: list[ThrustStage] = field(default_factory=list)
    inflow: list[InflowStage] = field(default_factory=list)
    flows: list[Flow] = field(default_factory=list)
    wrenches: list[Wrench] = field(default_factory=list)
    memories: list[Memory] = field(default_factory=list)
    sensors: list[Sensor] = field(default_factory=list)
    left_out: set[str] = field(default_factory=set)
    misjudged: dict[str, float] = field(default_factory=dict)

    @property
    def dofs(self) -> tuple[int, ...]:
        """Indices of the degrees of freedom."""
        return self.vehicle.dofs


def skew(vector: np.ndarray) -> np.ndarray:
    """S(a) with S(a) b = a x b."""
    x, y, z = vector
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=float)


def rigid_mass(mass: float, inertia: np.ndarray, r_g: np.ndarray) -> np.ndarray:
    """M_RB = [[m 1, -m S(r_g)], [m S(r_g), I]] about the body origin (kg, kg m, kg m^2)."""
    arm = mass * skew(r_g)
    return np.block([[mass * np.eye(3), -arm], [arm, np.diag(inertia)]])


def gravity_wrench(weight: float, buoyancy: float, r_g: np.ndarray, r_b: np.ndarray) -> np.ndarray:
    """(6, 3) G with wrench = G k: force (W - B) k, moment (W r_g - B r_b) x k."""
    return np.vstack([(weight - buoyancy) * np.eye(3), skew(weight * r_g - buoyancy * r_b)])


def plain_world(vehicle: Vehicle) -> World:
    """The world without any hidden effect: what the prior model describes, with the true numbers."""
    return World(
        vehicle=vehicle,
        rigid_mass=rigid_mass(vehicle.mass, vehicle.inertia, vehicle.r_g),
        added_mass=-np.diag(vehicle.added),
        linear=np.diag(vehicle.linear),
        quadratic=np.diag(vehicle.quadratic),
        cubic=np.zeros((6, 6)),
        products=np.zeros((6, 6, 6)),
        gravity_wrench=gravity_wrench(vehicle.weight, vehicle.weight, vehicle.r_g, vehicle.r_b),
        allocation=vehicle.allocation.copy(),
    )


def derivative(row: int, *columns: int, mark: str = "") -> str:
    """SNAME name: derivative(0, 0, mark="dot") is X_udot, derivative(5, 1) N_v, derivative(1, 0, 1) Y_uv."""
    return f"{ROWS[row]}_{''.join(COLUMNS[c] for c in columns)}{mark}"


def quadratic_name(index: int) -> str:
    """X_uabsu, Y_vabsv, ..."""
    return f"{ROWS[index]}_{COLUMNS[index]}abs{COLUMNS[index]}"


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a x b of (3, ...) arrays."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def to_body(turn: np.ndarray, ned: np.ndarray) -> np.ndarray:
    """NED vector (3, R) in body axes: R^T a."""
    return turn[0] * ned[0] + turn[1] * ned[1] + turn[2] * ned[2]


def to_ned(turn: np.ndarray, body: np.ndarray) -> np.ndarray:
    """Body vector (3, R) in NED: R a."""
    shares = turn * body
    return shares[:, 0] + shares[:, 1] + shares[:, 2]


def force_at(point: np.ndarray, force: np.ndarray) -> np.ndarray:
    """(6, R) wrench of a body-axes force (3, R) at a body point (3,)."""
    return np.concatenate([force, cross(point[:, None], force)])


def velocity_at(point: np.ndarray, nu: np.ndarray) -> np.ndarray:
    """(3, R) velocity of a body point (3,): v + omega x r."""
    return nu[:3] + cross(nu[3:], point[:, None])
