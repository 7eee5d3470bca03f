"""What tests of files for other programs compare with: forces of effects, rotations."""

from __future__ import annotations

from collections.abc import Callable, Collection

import casadi as ca
import numpy as np

from undertow.codegen import Functions
from undertow.model.vehicle import Vehicle

Force = Callable[[np.ndarray, np.ndarray], np.ndarray]


def cross(r: np.ndarray) -> np.ndarray:
    return np.cross(np.eye(3), -r).T  # S(r) with S(r) a = r x a


def force_of(vehicle: Vehicle, ids: Collection[str]) -> Force:
    """Sum of the wrenches of effects at (x, nu_dot), without commands."""
    f = Functions(vehicle)
    total = sum((f.wrenches[e] for e in {*ids} & {*f.wrenches}), ca.SX(f.nu.numel(), 1))
    total = ca.substitute(total, f.actuation, 0 * f.actuation)
    made = ca.Function("force", [f.x, f.nu_dot, f.p, f.t], [ca.densify(total)])
    return lambda x, nu_dot: made(x, nu_dot, f.values(), 0).full().ravel()


def rotation(phi: float, theta: float, psi: float) -> np.ndarray:
    """Rz(psi) Ry(theta) Rx(phi)."""
    (c1, s1), (c2, s2), (c3, s3) = ((np.cos(a), np.sin(a)) for a in (phi, theta, psi))
    rx = np.array([[1, 0, 0], [0, c1, -s1], [0, s1, c1]])
    ry = np.array([[c2, 0, s2], [0, 1, 0], [-s2, 0, c2]])
    return np.array([[c3, -s3, 0], [s3, c3, 0], [0, 0, 1]]) @ ry @ rx
