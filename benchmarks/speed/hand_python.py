"""The closed loop of `hand_rollout.c` in Python: with NumPy's arrays, and number by number for numba."""

from __future__ import annotations

from collections.abc import Callable
from math import cos, floor, pi, sin
from typing import Any

import numpy as np

from . import loops


def unpacked(p: np.ndarray) -> dict[str, np.ndarray]:
    """`HandParameters` as matrices."""
    sizes = {"mass": 6, "inverse": 6, "damping": 6, "allocation": 8}
    found: dict[str, np.ndarray] = {}
    at = 0
    for name, columns in sizes.items():
        found[name] = np.ascontiguousarray(p[at : at + 8 * columns].reshape(columns, 8)[:, :6].T)
        at += 8 * columns
    found["quadratic"] = p[at : at + 6]
    found["moment"] = p[at + 8 : at + 11]
    found["weight"] = p[at + 12]
    found["current"] = p[at + 13 : at + 16]
    return found


# --- NumPy, as one writes it ----------------------------------------------------------------------
def _rotation(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    sf, st, ss = np.sin(x[3:6])
    cf, ct, cs = np.cos(x[3:6])
    r = np.array(
        [
            [cs * ct, cs * st * sf - ss * cf, cs * st * cf + ss * sf],
            [ss * ct, ss * st * sf + cs * cf, ss * st * cf - cs * sf],
            [-st, ct * sf, ct * cf],
        ]
    )
    return r, np.array([[1, sf * st / ct, cf * st / ct], [0, cf, -sf], [0, sf / ct, cf / ct]])


def numpy_dynamics(x: np.ndarray, u: np.ndarray, p: dict[str, np.ndarray]) -> np.ndarray:
    """x_dot."""
    r, t = _rotation(x)
    nu, w = x[6:], x[9:]
    water = r.T @ p["current"]
    relative = nu.copy()
    relative[:3] -= water
    h = p["mass"] @ relative
    coriolis = np.concatenate([np.cross(w, h[:3]), np.cross(relative[:3], h[:3]) + np.cross(w, h[3:])])
    restoring = np.concatenate([p["weight"] * r[2], np.cross(p["moment"], r[2])])
    drag = p["damping"] @ relative + p["quadratic"] * np.abs(relative) * relative
    rate = p["inverse"] @ (p["allocation"] @ u + drag + restoring - coriolis)
    rate[:3] -= np.cross(w, water)
    return np.concatenate([r @ nu[:3], t @ w, rate])


def numpy_control(
    x: np.ndarray, total: np.ndarray, p: dict[str, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Commands and error."""
    r, t = _rotation(x)
    error = np.array(loops.TO) - x[:6]
    error[3:] -= 2 * pi * np.floor((error[3:] + pi) / (2 * pi))
    rate = np.concatenate([r @ x[6:9], t @ x[9:]])
    y = np.array(loops.K_P) * error - np.array(loops.K_V) * rate + np.array(loops.K_I) * total
    restoring = np.concatenate([p["weight"] * r[2], np.cross(p["moment"], r[2])])
    force = np.concatenate([r.T @ y[:3], t.T @ y[3:]]) - restoring
    return loops.allocation() @ force, error


def numpy_rollout(duration: float, p: dict[str, np.ndarray]) -> np.ndarray:
    """The last state, by Runge-Kutta in a loop."""
    x, total, dt = np.zeros(12), np.zeros(6), loops.DT
    for _ in range(round(duration / dt)):
        u, error = numpy_control(x, total, p)
        total = total + dt * error
        k1 = numpy_dynamics(x, u, p)
        k2 = numpy_dynamics(x + dt / 2 * k1, u, p)
        k3 = numpy_dynamics(x + dt / 2 * k2, u, p)
        k4 = numpy_dynamics(x + dt * k3, u, p)
        x = x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return x


def scipy_rollout(duration: float, p: dict[str, np.ndarray]) -> np.ndarray:
    """The last state, by solve_ivp from sample to sample; tolerances as the accuracy of the others asks."""
    from scipy.integrate import solve_ivp

    x, total, dt = np.zeros(12), np.zeros(6), loops.DT
    for _ in range(round(duration / dt)):
        u, error = numpy_control(x, total, p)
        total = total + dt * error
        held = solve_ivp(lambda t, z, u=u: numpy_dynamics(z, u, p), (0, dt), x, rtol=1e-10, atol=1e-12)
        x = held.y[:, -1]
    return x


# --- numba: scalars and loops ---------------------------------------------------------------------
def _cross(a: Any, b: Any, c: Any) -> None:
    c[0] = a[1] * b[2] - a[2] * b[1]
    c[1] = a[2] * b[0] - a[0] * b[2]
    c[2] = a[0] * b[1] - a[1] * b[0]


def _turn(x: Any, r: Any) -> None:
    sf, cf, st, ct, ss, cs = sin(x[3]), cos(x[3]), sin(x[4]), cos(x[4]), sin(x[5]), cos(x[5])
    r[0, 0], r[0, 1], r[0, 2] = cs * ct, cs * st * sf - ss * cf, cs * st * cf + ss * sf
    r[1, 0], r[1, 1], r[1, 2] = ss * ct, ss * st * sf + cs * cf, ss * st * cf - cs * sf
    r[2, 0], r[2, 1], r[2, 2] = -st, ct * sf, ct * cf
    r[3, 0], r[3, 1], r[3, 2] = sf, cf, 1 / ct


def numba_rollout() -> Callable[..., None]:
    """The loop compiled by numba; arguments are those of `hand_rollout`, matrices as `unpacked` has them."""
    import numba

    jit = numba.njit(fastmath=False, error_model="numpy")
    cross, turn = jit(_cross), jit(_turn)

    @jit
    def dynamics(x, u, mass, inverse, damping, allocation, quadratic, moment, weight, current, work, out):
        r, water, nu, h, force, a, b, c, d = work
        turn(x, r)
        for i in range(3):
            out[i] = r[i, 0] * x[6] + r[i, 1] * x[7] + r[i, 2] * x[8]
            water[i] = r[0, i] * current[0] + r[1, i] * current[1] + r[2, i] * current[2]
            nu[i], nu[i + 3] = x[6 + i] - water[i], x[9 + i]
        sf, cf, inverse_ct, st = r[3, 0], r[3, 1], r[3, 2], -r[2, 0]
        out[4] = cf * x[10] - sf * x[11]
        out[5] = (sf * x[10] + cf * x[11]) * inverse_ct
        out[3] = x[9] + st * out[5]
        for i in range(6):
            h[i] = 0.0
            for j in range(6):
                h[i] += mass[i, j] * nu[j]
        for i in range(6):
            f = quadratic[i] * abs(nu[i]) * nu[i]
            for j in range(6):
                f += damping[i, j] * nu[j]
            for j in range(8):
                f += allocation[i, j] * u[j]
            force[i] = f
        cross(nu[3:], h[:3], a)
        cross(nu[:3], h[:3], b)
        cross(nu[3:], h[3:], c)
        cross(moment, r[2], d)
        for i in range(3):
            force[i] += weight * r[2, i] - a[i]
            force[3 + i] += d[i] - b[i] - c[i]
        cross(x[9:], water, a)
        for i in range(6):
            f = 0.0
            for j in range(6):
                f += inverse[i, j] * force[j]
            out[6 + i] = f - a[i] if i < 3 else f

    @jit
    def control(x, total, k_p, k_v, k_i, desired, moment, weight, share, work, u, error):
        r, righting, y, force = work[0], work[1], work[2], work[3]
        turn(x, r)
        sf, cf, inverse_ct, st = r[3, 0], r[3, 1], r[3, 2], -r[2, 0]
        rate5 = (sf * x[10] + cf * x[11]) * inverse_ct
        for i in range(6):
            error[i] = desired[i] - x[i]
            if i > 2:
                error[i] -= 2 * pi * floor((error[i] + pi) / (2 * pi))
            rate = rate5
            if i < 3:
                rate = r[i, 0] * x[6] + r[i, 1] * x[7] + r[i, 2] * x[8]
            elif i == 3:
                rate = x[9] + st * rate5
            elif i == 4:
                rate = cf * x[10] - sf * x[11]
            y[i] = k_p[i] * error[i] - k_v[i] * rate + k_i[i] * total[i]
        cross(moment, r[2], righting)
        for i in range(3):
            force[i] = r[0, i] * y[0] + r[1, i] * y[1] + r[2, i] * y[2] - weight * r[2, i]
        lever = (st * y[3] + y[5]) * inverse_ct
        force[3] = y[3] - righting[0]
        force[4] = sf * lever + cf * y[4] - righting[1]
        force[5] = cf * lever - sf * y[4] - righting[2]
        for i in range(8):
            u[i] = 0.0
            for j in range(6):
                u[i] += share[i, j] * force[j]

    @jit
    def rollout(samples, dt, desired, k_p, k_v, k_i, share, mass, inverse, damping, allocation, quadratic,
                moment, weight, current, stride, log):  # fmt: skip
        a, b, c, d = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
        work = (np.zeros((4, 3)), np.zeros(3), np.zeros(6), np.zeros(6), np.zeros(6), a, b, c, d)
        model = (mass, inverse, damping, allocation, quadratic, moment, weight, current)
        x, total, u, error = np.zeros(12), np.zeros(6), np.zeros(8), np.zeros(6)
        f, sums, stage = np.zeros(12), np.zeros(12), np.zeros(12)
        for n in range(samples):
            if n % stride == 0:
                log[n // stride] = x
            control(x, total, k_p, k_v, k_i, desired, moment, weight, share, work, u, error)
            for i in range(6):
                total[i] += dt * error[i]
            dynamics(x, u, *model, work, f)
            for i in range(12):
                sums[i], stage[i] = f[i], x[i] + 0.5 * dt * f[i]
            for ahead in (0.5, 1.0):
                dynamics(
                    stage, u, mass, inverse, damping, allocation, quadratic, moment, weight, current, work, f
                )
                for i in range(12):
                    sums[i] += 2 * f[i]
                    stage[i] = x[i] + ahead * dt * f[i]
            dynamics(
                stage, u, mass, inverse, damping, allocation, quadratic, moment, weight, current, work, f
            )
            for i in range(12):
                x[i] += dt / 6 * (sums[i] + f[i])

    return rollout
