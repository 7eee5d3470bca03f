"""Roll, pitch and yaw of the quaternions that vehicles log."""

from __future__ import annotations

import numpy as np

from undertow.typing import Array

ANGLES = ("phi", "theta", "psi")


def angles(w: Array, x: Array, y: Array, z: Array) -> dict[str, Array]:
    """Roll, pitch and yaw, rad, of quaternions from body to earth axes (Fossen 2021, section 2.2).

    Quaternions may have any length; one of no length gives NaN.
    """
    square = w**2 + x**2 + y**2 + z**2
    length = np.where(square > 0.0, square, np.nan)
    phi = np.arctan2(2.0 * (w * x + y * z) / length, 1.0 - 2.0 * (x**2 + y**2) / length)
    theta = np.arcsin(np.clip(2.0 * (w * y - z * x) / length, -1.0, 1.0))
    psi = np.arctan2(2.0 * (w * z + x * y) / length, 1.0 - 2.0 * (y**2 + z**2) / length)
    return dict(zip(ANGLES, (phi, theta, psi), strict=True))
