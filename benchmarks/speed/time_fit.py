"""Output error: sixty seconds at 20 Hz, twenty parameters and the first state; one problem for everybody.

The model, its Runge-Kutta steps (one for each sample), the weights and the starting values are the same.
Others have to agree with IPOPT in the parameters, each relative to its size or to a thousandth.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
from scipy.optimize import least_squares

from undertow.codegen import Functions, Simulator
from undertow.identification.estimation.output_error import Descent, channel_weights
from undertow.identification.estimation.residual import WeakModel
from undertow.identification.estimation.windows import Windows, cut
from undertow.identification.logs.run import Run
from undertow.model.vehicle import Vehicle

from . import vehicle
from .conftest import Speed
from .goals import FIT, OURS

FREE = (
    *("X_udot", "Y_vdot", "Z_wdot", "K_pdot", "M_qdot", "N_rdot", "X_u", "Y_v", "Z_w", "K_p", "M_q", "N_r"),
    *("X_uabsu", "Y_vabsv", "Z_wabsw", "K_pabsp", "M_qabsq", "N_rabsr", "S_z", "W"),
)
STEP, SECONDS, OFF, LIMIT = 0.05, 60.0, 0.2, 1e-6
# Noise of pose (m, rad) and velocity (m/s, rad/s).
NOISE = np.repeat([0.02, 0.01, 0.01, 0.01], 3)


@cache
def functions() -> Functions:
    """The model of the speed measurements without stated errors, which would be priors."""
    known = vehicle.vehicle()
    values = {n: replace(v, sigma=None) for n, v in known.values.items()}
    return Functions(Vehicle(**{**vars_of(known), "values": values}))


def vars_of(known: Vehicle) -> dict[str, Any]:
    """Fields of a vehicle."""
    return {name: getattr(known, name) for name in known.__dataclass_fields__}


@cache
def truth() -> np.ndarray:
    """All parameters."""
    return np.array(functions().values(), dtype=float)


def places() -> list[int]:
    """Where the free parameters are."""
    return [functions().parameter_names.index(n) for n in FREE]


@cache
def log() -> Run:
    """A simulated log: sums of sines as commands, noise on all that is measured."""
    rng = np.random.default_rng(5)
    t = np.arange(0.0, SECONDS + STEP / 2, STEP)
    commands = vehicle.vehicle().command_names
    frequency, phase = rng.uniform(0.03, 0.5, (2, 4, len(commands))), rng.uniform(0, 6, (4, len(commands)))
    size = rng.uniform(1.0, 3.5, (4, len(commands)))
    u = np.sum(size * np.sin(2 * np.pi * frequency[0] * t[:, None, None] + phase), axis=1)
    x = Simulator(functions(), compiled=True).run(np.zeros(12), t, u, truth())
    measured = x + NOISE * rng.standard_normal(x.shape)
    columns = np.column_stack([measured, u])
    names = (*functions().state_names, *commands)
    sigma = dict(zip(functions().state_names, NOISE.tolist(), strict=True))
    return Run("sines", t, dict(zip(names, columns.T, strict=True)), sigma=sigma)


@cache
def windows() -> Windows:
    """The whole log as one window."""
    return cut([log()], functions().vehicle, None)


@cache
def start() -> np.ndarray:
    """Starting values: the free ones are wrong by up to a fifth."""
    p = truth().copy()
    p[places()] *= 1 + OFF * np.random.default_rng(6).uniform(-1, 1, len(FREE))
    return p


def first() -> np.ndarray:
    """The first state as measured."""
    return windows().measured[0, 0]


@cache
def descent() -> Descent:
    """Our search, until the sum of squares falls by no more than is negligible."""
    return Descent(WeakModel(functions(), FREE), windows(), compiled=True)


def ours() -> np.ndarray:
    """Free parameters by `Descent`."""
    return descent().minimise(start(), first()[None]).p[places()]


# --- peers --------------------------------------------------------------------------------------


@cache
def solver() -> tuple[ca.Function, np.ndarray]:
    """Multiple shooting for IPOPT, a node at each sample, Gauss-Newton Hessian; and where it starts."""
    f, n = functions(), len(log().t)
    x, u, free = ca.SX.sym("x", 12), ca.SX.sym("u", f.u.numel()), ca.SX.sym("free", len(FREE))
    p = ca.SX(ca.DM(truth()))
    for k, place in enumerate(places()):
        p[place] = free[k]
    stage, total = x, ca.SX.zeros(12)
    for weight, reach in ((1, 0.5), (2, 0.5), (2, 1.0), (1, 0.0)):
        rate = f.dynamics(stage, u, p, 0.0)
        total, stage = total + weight * rate, x + reach * STEP * rate
    step = ca.Function("step", [x, u, free], [x + STEP / 6 * total])
    nodes, theta = ca.MX.sym("nodes", 12, n), ca.MX.sym("theta", len(FREE))
    scale = ca.DM(np.maximum(np.abs(start()[places()]), 1e-3))
    # The sequence of samples and the parameters, scaled, are the unknowns.
    ends = step.map(n - 1)(nodes[:, :-1], ca.DM(commands()[:-1].T), ca.repmat(theta * scale, 1, n - 1))
    error = ca.vec((nodes - ca.DM(windows().measured[0].T)) * ca.DM(channel_weights(windows())))
    unknown = ca.veccat(theta, nodes)
    problem = {"x": unknown, "f": 0.5 * ca.dot(error, error), "g": ca.vec(nodes[:, 1:] - ends)}
    slope = ca.jacobian(error, unknown)
    hessian = ca.triu(ca.mtimes(slope.T, slope))
    sigma, multipliers = ca.MX.sym("sigma"), ca.MX.sym("lam", problem["g"].numel())
    options = {
        "hess_lag": ca.Function("h", [unknown, ca.MX(0, 1), sigma, multipliers], [sigma * hessian]),
        "ipopt": {"print_level": 0, "tol": 1e-10, "sb": "yes"},
        "print_time": False,
    }
    guess = np.concatenate([start()[places()] / np.array(scale).ravel(), windows().measured[0].ravel()])
    return ca.nlpsol("fit", "ipopt", problem, options), np.append(guess, np.array(scale).ravel())


def commands() -> np.ndarray:
    """Commands of the log, shape (n, 8)."""
    return log().matrix(functions().vehicle.command_names)


def by_ipopt() -> np.ndarray:
    """Free parameters by multiple shooting."""
    solve, known = solver()
    guess, scale = known[: -len(FREE)], known[-len(FREE) :]
    found = solve(x0=guess, lbg=0, ubg=0)
    assert solve.stats()["success"]
    return np.asarray(found["x"]).ravel()[: len(FREE)] * scale


@cache
def reference() -> np.ndarray:
    """What IPOPT finds."""
    return by_ipopt()


def by_scipy(jacobian: str = "2-point") -> np.ndarray:
    """Free parameters by SciPy, which differentiates our compiled simulation by differences."""
    simulator, chosen, w = Simulator(functions(), compiled=True), places(), windows()
    weight, u, p = channel_weights(w), commands(), start().copy()

    def error(unknown: np.ndarray) -> np.ndarray:
        p[chosen] = unknown[: len(FREE)]
        x = simulator.run(unknown[len(FREE) :], log().t, u, p)
        return ((x - w.measured[0]) * weight).ravel()

    begin = np.concatenate([start()[chosen], first()])
    found = least_squares(
        error, begin, jacobian, method="trf", x_scale="jac", ftol=1e-12, xtol=1e-12, gtol=1e-12
    )
    return np.asarray(found.x[: len(FREE)])


def apart(found: np.ndarray) -> float:
    """Largest distance to IPOPT's parameters, relative."""
    return float(np.max(np.abs(found - reference()) / np.maximum(np.abs(reference()), 1e-3)))


# --- measurements -------------------------------------------------------------------------------


def time_ours(speed: Speed) -> None:
    speed(FIT, OURS, ours, apart=apart(ours()), limit=LIMIT, rounds=15)


def time_ipopt(speed: Speed) -> None:
    reference()
    speed(FIT, "IPOPT multiple shooting, virtual machine", by_ipopt, rounds=1)


def time_scipy(speed: Speed) -> None:
    found = by_scipy()
    # Differences of a simulation leave it a little off.
    speed(FIT, "SciPy, finite differences on the same simulation", by_scipy, apart=apart(found), rounds=3)
