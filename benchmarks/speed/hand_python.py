"""The closed loop of `hand_rollout.c` in Python, with NumPy's arrays."""

from __future__ import annotations

from math import pi

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
