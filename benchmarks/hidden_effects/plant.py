"""The equations of motion of a `World`, stepped by RK4 for several runs at once (plain NumPy)."""

from __future__ import annotations

import numpy as np

from .world import Moment, World, cross, to_body, to_ned

RATE = 20  # Hz, samples and commands
SUBSTEPS = 4  # RK4 steps per sample: 80 Hz
STEP = 1.0 / (RATE * SUBSTEPS)


def coriolis_products(mass: np.ndarray) -> np.ndarray:
    """(6, 36) tensor H with C(nu) nu = H (nu x nu), for any symmetric 6x6 mass (Fossen 2021, eq. 3.60).

    With momentum [p; h] = M nu: force = omega x p, moment = v x p + omega x h. Column 6 j + k: nu_j nu_k.
    """
    swap = np.zeros((3, 3, 3))
    swap[[0, 1, 2], [1, 2, 0], [2, 0, 1]], swap[[0, 2, 1], [2, 1, 0], [1, 0, 2]] = 1.0, -1.0
    turning = np.zeros((6, 6, 6))
    turning[:3, 3:] = turning[3:, :3] = np.einsum("iab,bk->iak", swap, mass[:3])
    turning[3:, 3:] = np.einsum("iab,bk->iak", swap, mass[3:])
    return turning.reshape(6, 36)


def rotation(angles: np.ndarray) -> np.ndarray:
    """(3, 3, R) body to NED for (3, R) roll, pitch, yaw (rad)."""
    (cf, ct, cp), (sf, st, sp) = np.cos(angles), np.sin(angles)
    sfst, cfst = sf * st, cf * st
    return np.array([[cp * ct, cp * sfst - sp * cf, sp * sf + cp * cfst],
                     [sp * ct, cp * cf + sp * sfst, sp * cfst - cp * sf],
                     [-st, ct * sf, ct * cf]])  # fmt: skip


def euler_rates(turn: np.ndarray, omega: np.ndarray) -> np.ndarray:
    """(3, R) rates of roll, pitch and yaw from body rates (rad/s).

    The last row of the rotation, (-sin theta, cos theta sin phi, cos theta cos phi), holds all it needs.
    """
    (p, q, r), (ahead, right, below) = omega, turn[2]
    square = 1.0 - ahead * ahead  # cos(theta)^2
    around = (right * q + below * r) / square
    return np.array([p - ahead * around, (below * q - right * r) / np.sqrt(square), around])


def level_rotation(yaw: np.ndarray) -> np.ndarray:
    """(3, 3, R) what `rotation` gives for (R,) yaw without roll and pitch."""
    turn = np.zeros((3, 3, len(yaw)))
    turn[0, 0] = turn[1, 1] = np.cos(yaw)
    turn[1, 0] = np.sin(yaw)
    np.negative(turn[1, 0], out=turn[0, 1])
    turn[2, 2] = 1.0
    return turn


class Plant:
    """A `World` with its constant matrices made ready; `step` moves the state (12 + extra, R) by 1/80 s."""

    def __init__(self, world: World) -> None:
        self.world = world
        total = world.rigid_mass + world.added_mass
        own = np.ix_(world.dofs, world.dofs)
        self.inverse = np.zeros((6, 6))
        if np.linalg.eigvalsh(total[own]).min() <= 0:
            raise ValueError("the mass matrix is not positive definite: lower the strength of the effects")
        self.inverse[own] = np.linalg.inv(total[own])
        self.rigid = world.rigid_coriolis * coriolis_products(world.rigid_mass)
        self.added = world.added_coriolis * coriolis_products(world.added_mass)
        self.damping = np.concatenate(
            [world.linear, world.quadratic, world.cubic, world.products.reshape(6, 36)], 1
        )
        self.locked = np.array([i for i in range(6) if i not in world.dofs], dtype=int)
        # What cannot tilt starts level and stays so: half of the kinematics would turn it by nothing.
        self.level = not world.vehicle.tilts
        self.lagged = world.allocation.shape[1] if world.lag else 0

    @property
    def extra(self) -> int:
        """Number of states beyond pose and velocity."""
        return self.lagged + sum(memory.size for memory in self.world.memories)

    def step(self, t: float, y: np.ndarray, command: np.ndarray) -> np.ndarray:
        """One classical Runge-Kutta step under a constant command (n, R)."""
        h = STEP
        k1 = self.rates(t, y, command)
        k2 = self.rates(t + h / 2, y + h / 2 * k1, command)
        k3 = self.rates(t + h / 2, y + h / 2 * k2, command)
        k4 = self.rates(t + h, y + h * k3, command)
        return y + h / 6 * (k1 + 2 * (k2 + k3) + k4)

    def rates(self, t: float, y: np.ndarray, command: np.ndarray) -> np.ndarray:
        """dy/dt: kinematics, Newton-Euler, thruster lag, memories."""
        eta, nu = y[:6], y[6:12]
        turn = level_rotation(y[5]) if self.level else rotation(y[3:6])
        over_ground = to_ned(turn, nu[:3])
        nu_r, push = self._relative(t, eta, nu, turn, over_ground)
        thrust, lag_rate = self._thrust(t, y, command, nu_r)
        moment = Moment(t, eta, nu, nu_r, turn, thrust, np.zeros(nu.shape))
        force = self._force(moment) + push
        states, rest = [lag_rate], y[12 + self.lagged :]
        for memory in self.world.memories:
            own, rest = rest[: memory.size], rest[memory.size :]
            force = force + memory.wrench(moment, own)
            states.append(memory.rate(moment, own))
        pose_rate = np.concatenate([over_ground, nu[3:] if self.level else euler_rates(turn, nu[3:])])
        pose_rate[self.locked] = 0.0  # a ship that rolls as it turns would pitch a little otherwise
        return np.concatenate([pose_rate, self.inverse @ force, *states])

    def _relative(
        self, t: float, eta: np.ndarray, nu: np.ndarray, turn: np.ndarray, over_ground: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Velocity relative to the water, and M_A times the water's rate of change seen in body axes."""
        if not self.world.flows:
            return nu, np.zeros(nu.shape)
        velocities, rates = zip(*(flow(t, eta, over_ground) for flow in self.world.flows), strict=True)
        still = np.zeros((3, 1))
        water, rate = to_body(turn, sum(velocities, still)), to_body(turn, sum(rates, still))
        nu_r = nu.copy()
        nu_r[:3] -= water
        nu_r[self.locked] = 0.0
        # d(R^T V)/dt = R^T dV/dt - omega x (R^T V)
        seen = np.concatenate([rate - cross(nu[3:], water), np.zeros_like(water)])
        seen[self.locked] = 0.0
        return nu_r, self.world.added_mass @ seen

    def _thrust(
        self, t: float, y: np.ndarray, command: np.ndarray, nu_r: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Force of each thruster (n, R) and the rates of the lag states (0 or n, R)."""
        for stage in self.world.stages:
            command = stage(command, t)
        thrust, lag_rate = command, y[12:12]
        if self.lagged:
            thrust = y[12 : 12 + self.lagged]
            lag_rate = (command - thrust) / self.world.lag
        for loss in self.world.inflow:
            thrust = loss(thrust, nu_r)
        return thrust, lag_rate

    def _force(self, moment: Moment) -> np.ndarray:
        """Sum of all wrenches that contain no acceleration; fills in `moment.drag` on the way."""
        world, nu, nu_r = self.world, moment.nu, moment.nu_r
        runs = nu.shape[1]
        pairs = (nu_r[:, None] * nu_r[None]).reshape(36, runs)
        ground_pairs = pairs if nu_r is nu else (nu[:, None] * nu[None]).reshape(36, runs)
        quadratic = np.abs(nu_r) * nu_r
        powers = np.concatenate([nu_r, quadratic, np.abs(quadratic) * nu_r, pairs])
        moment.drag = self.damping @ powers
        force = moment.drag - self.rigid @ ground_pairs - self.added @ pairs
        force += world.gravity_wrench @ moment.turn[2] + world.allocation @ moment.thrust
        for wrench in world.wrenches:
            force += wrench(moment)
        return force
