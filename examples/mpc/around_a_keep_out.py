"""Model predictive control of CyberShip II to a berth, around a circle that it must keep out of.

The model is the vehicle's own: `Functions.dynamics`, the same expressions that are simulated and exported.
Multiple shooting with steps of Runge-Kutta, thruster limits as bounds, the circle as a constraint with a
slack that costs. Every sample takes a few steps of sequential quadratic programming with the Gauss-Newton
matrix, started from the last solution moved on by a sample.

    python examples/mpc/around_a_keep_out.py                 # prints times, writes mpc.png
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import casadi as ca
import numpy as np

from undertow.codegen.functions import Functions
from undertow.codegen.simulate import runge_kutta
from undertow.model.loading import load_vehicle


@dataclass(frozen=True)
class Problem:
    """What is asked; SI, NED."""

    goal: tuple[float, float, float] = (10.0, 0.0, 0.0)  # x, y, psi
    centre: tuple[float, float] = (5.0, 0.3)  # of the circle
    radius: float = 2.0  # with half the length of the ship in it
    limit: float = 2.0  # N, of every thruster: that of the tunnel thruster of the model
    dt: float = 0.5  # sampling interval, s
    horizon: int = 30  # samples
    # Prices of squared errors of x, y, psi and of u, v, r, and of squared thrust: a metre is worth 1 N.
    errors: tuple[float, ...] = (1.0, 1.0, 2.0, 1.0, 1.0, 1.0)
    thrust: float = 0.2
    final: float = 20.0  # price of the last error over that of the others
    # Price of a metre inside the circle. It is not squared: above the price that the constraint has by itself
    # (its multiplier) such a slack stays zero as long as anything else can be done.
    slack: float = 50.0
    margin: float = 0.05  # kept besides at the samples, for the way in between, m
    first: int = 20  # steps of sequential quadratic programming before it starts
    steps: int = 3  # of sequential quadratic programming for each sample
    # On the diagonal of the Gauss-Newton matrix: shorter steps, which the turning of the thrust with the ship
    # needs while its limits are met; it does not change where they lead.
    damping: float = 2.0


@dataclass
class Run:
    """States and thrusts over time, and what a sample took, s."""

    x: list[np.ndarray] = field(default_factory=list)
    u: list[np.ndarray] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)


class Mpc:
    """The controller: one quadratic program, its matrices as functions of the last solution."""

    def __init__(self, problem: Problem) -> None:
        self.problem, self.functions = problem, Functions(load_vehicle("cybership2"))
        self.values = ca.DM(self.functions.values())
        self.nx, self.nu = self.functions.x.numel(), self.functions.u.numel()
        self.step = self._step()
        n = problem.horizon
        z = ca.SX.sym("z", n * (self.nx + self.nu) + self.nx + n)
        begin = ca.SX.sym("x", self.nx)
        residual, equal, clear = self._stages(z, begin)
        slope = ca.jacobian(residual, z)
        hessian = slope.T @ slope + problem.damping * ca.SX.eye(z.numel())
        limits = ca.vertcat(equal, clear)
        gradient = slope.T @ residual
        gradient[-n:] += problem.slack
        outputs = [hessian, gradient, ca.jacobian(limits, z), limits]
        self._matrices = ca.Function("matrices", [z, begin], outputs)
        self._equal, self._clear = equal.numel(), clear.numel()
        shapes = {"h": hessian.sparsity(), "a": outputs[2].sparsity()}
        self._solve = ca.conic("qp", "osqp", shapes, _OPTIONS)
        self._low, self._high = self._bounds()
        self.z = np.zeros(z.numel())

    def _step(self) -> ca.Function:
        """One sample of the vehicle, commands held."""
        x, u, dt = ca.SX.sym("x", self.nx), ca.SX.sym("u", self.nu), self.problem.dt
        (after,) = runge_kutta(lambda at, _: [self.functions.dynamics(*at, u, self.values, 0.0)], [x], [dt])
        return ca.Function("step", [x, u], [after])

    def _stages(self, z: ca.SX, begin: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Weighted errors, what has to be zero, and what may not be below zero."""
        p, n, size = self.problem, self.problem.horizon, self.nx + self.nu
        goal, price = ca.DM([*p.goal, 0, 0, 0]), ca.sqrt(ca.DM(p.errors))
        states = [z[k * size : k * size + self.nx] for k in range(n + 1)]
        thrusts = [z[k * size + self.nx : (k + 1) * size] for k in range(n)]
        slacks = z[-n:]
        equal, residual, clear = [states[0] - begin], [], []
        for k in range(n):
            equal.append(states[k + 1] - self.step(states[k], thrusts[k]))
            residual += [price * (states[k] - goal), np.sqrt(p.thrust) * thrusts[k]]
            away = states[k + 1][:2] - ca.DM(p.centre)
            clear.append(ca.sqrt(ca.sumsqr(away)) - p.radius - p.margin + slacks[k])
        residual += [np.sqrt(p.final) * price * (states[n] - goal)]
        return ca.vertcat(*residual), ca.vertcat(*equal), ca.vertcat(*clear)

    def _bounds(self) -> tuple[np.ndarray, np.ndarray]:
        n, size, limit = self.problem.horizon, self.nx + self.nu, self.problem.limit
        high = np.full(self.z_size, np.inf)
        for k in range(n):
            high[k * size + self.nx : (k + 1) * size] = limit
        low = -high
        low[-n:] = 0.0
        return low, high

    @property
    def z_size(self) -> int:
        """Number of unknowns."""
        return self.problem.horizon * (self.nx + self.nu + 1) + self.nx

    def start(self, x: np.ndarray) -> None:
        """A first guess: straight to the goal, without thrust."""
        n, size = self.problem.horizon, self.nx + self.nu
        for k in range(n + 1):
            share = k / n
            self.z[k * size : k * size + 3] = (1 - share) * x[:3] + share * np.array(self.problem.goal)
        self.command(x, self.problem.first)

    def command(self, x: np.ndarray, steps: int = 0) -> np.ndarray:
        """Thrusts for the next sample."""
        zero, free = np.zeros(self._equal), np.full(self._clear, np.inf)
        for _ in range(steps or self.problem.steps):
            h, g, a, limits = self._matrices(self.z, x)
            now = np.asarray(limits).ravel()
            found = self._solve(
                h=h,
                g=g,
                a=a,
                lba=-now,
                uba=np.concatenate([zero, free]) - now,
                lbx=self._low - self.z,
                ubx=self._high - self.z,
            )
            self.z = self.z + np.asarray(found["x"]).ravel()
        limit = self.problem.limit
        return np.clip(self.z[self.nx : self.nx + self.nu], -limit, limit)

    def move_on(self) -> None:
        """The solution of the next sample is guessed to be the rest of this one; its last stage stays."""
        size, n = self.nx + self.nu, self.problem.horizon
        stages = self.z[: n * size]
        self.z[: (n - 1) * size] = stages[size:].copy()
        self.z[(n - 1) * size : (n - 1) * size + self.nx] = self.z[n * size : n * size + self.nx]
        self.z[-n:-1] = self.z[-n + 1 :].copy()


_OPTIONS = {
    "osqp": {"verbose": False, "eps_abs": 1e-6, "eps_rel": 1e-6, "max_iter": 2000, "polish": True},
    "warm_start_primal": True,
    "warm_start_dual": True,
    "error_on_fail": False,
}


def run(problem: Problem, seconds: float = 60.0) -> Run:
    """Drive the ship from rest at the origin."""
    mpc, found, x = Mpc(problem), Run(), np.zeros(6)
    mpc.start(x)
    for _ in range(round(seconds / problem.dt)):
        begin = time.perf_counter()
        u = mpc.command(x)
        mpc.move_on()
        found.seconds.append(time.perf_counter() - begin)
        found.x.append(x)
        found.u.append(u)
        x = np.asarray(mpc.step(x, u)).ravel()
    found.x.append(x)
    return found


def draw(problem: Problem, found: Run, names: Sequence[str], path: Path) -> None:
    """The track with the circle, and the thrusts."""
    import matplotlib.pyplot as plt

    x, u = np.array(found.x), np.array(found.u)
    t = problem.dt * np.arange(len(u))
    figure, (plane, thrust) = plt.subplots(1, 2, figsize=(10, 4.4), layout="constrained")
    plane.add_patch(plt.Circle(problem.centre[::-1], problem.radius, color="0.85", label="keep-out"))
    plane.plot(x[:, 1], x[:, 0], label="track")
    plane.plot(*problem.goal[1::-1], "k+", markersize=10, label="goal")
    plane.set(
        xlabel="east y [m]", ylabel="north x [m]", aspect="equal", title="CyberShip II around a keep-out"
    )
    plane.set_xlim(-6, 6)
    plane.legend(loc="lower right")
    for i in range(u.shape[1]):
        # Dashed, as the two side thrusters are told the same.
        thrust.step(t, u[:, i], "--" if i == u.shape[1] - 1 else "-", where="post", label=names[i])
    for side in (-1, 1):
        thrust.axhline(side * problem.limit, color="0.5", linestyle=":")
    thrust.set(xlabel="time [s]", ylabel="thrust [N]", title="Commands; dotted: limits")
    thrust.legend(loc="upper right")
    for axis in (plane, thrust):
        axis.grid(alpha=0.4)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main(path: Path) -> None:
    """Run it, print what came of it, and draw it."""
    problem = Problem()
    found = run(problem)
    x, spent = np.array(found.x), 1e3 * np.array(found.seconds)
    away = np.hypot(x[:, 0] - problem.centre[0], x[:, 1] - problem.centre[1])
    error = np.hypot(x[-1, 0] - problem.goal[0], x[-1, 1] - problem.goal[1])
    print(f"horizon {problem.horizon} samples of {problem.dt} s, {problem.steps} steps for each sample")
    print(f"time for a sample: median {np.median(spent):.1f} ms, largest {spent.max():.1f} ms")
    print(
        f"nearest to the centre {away.min():.4f} m (radius {problem.radius} m), {error:.4f} m from the goal"
    )
    print(f"largest thrust {np.abs(found.u).max():.3f} N of {problem.limit} N")
    draw(problem, found, load_vehicle("cybership2").command_names, path)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "mpc.png"))
