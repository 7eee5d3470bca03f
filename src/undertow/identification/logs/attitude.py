"""Roll, pitch and yaw of the quaternions that vehicles log, and which columns of a table are one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from undertow.typing import Array

ANGLES = ("phi", "theta", "psi")
_ROUNDED = 1e-2  # how far the length of a quaternion may be from one


def angles(w: Array, x: Array, y: Array, z: Array) -> dict[str, Array]:
    """Roll, pitch and yaw, rad, of rotations from body axes to those of the earth (Fossen 2021, section 2.2).

    Parameters
    ----------
    w, x, y, z : (n,) arrays
        Quaternions of any length; one of no length gives NaN.
    """
    square = w**2 + x**2 + y**2 + z**2
    length = np.where(square > 0.0, square, np.nan)
    phi = np.arctan2(2.0 * (w * x + y * z) / length, 1.0 - 2.0 * (x**2 + y**2) / length)
    theta = np.arcsin(np.clip(2.0 * (w * y - z * x) / length, -1.0, 1.0))
    psi = np.arctan2(2.0 * (w * z + x * y) / length, 1.0 - 2.0 * (y**2 + z**2) / length)
    return dict(zip(ANGLES, (phi, theta, psi), strict=True))


def quaternion_in(data: Mapping[str, Array]) -> tuple[str, ...]:
    """Columns w, x, y, z of a quaternion: alike but for these letters, and of length one; none: ()."""
    for name in data:
        letters = {"w": "wxyz", "W": "WXYZ"}.get(name[-1:], "")
        found = tuple(name[:-1] + letter for letter in letters)
        if found and all(n in data for n in found) and _is_unit([data[n] for n in found]):
            return found
    return ()


def _is_unit(columns: Sequence[Array]) -> bool:
    length = np.sqrt(sum(c**2 for c in columns))
    there = np.isfinite(length)
    return bool(there.any() and np.all(np.abs(length[there] - 1.0) < _ROUNDED))


def formulas(names: Sequence[str]) -> dict[str, str]:
    """Roll, pitch and yaw, rad, from columns w, x, y, z, as a mapping file computes them."""
    w, x, y, z = (n if n.isidentifier() else f'column("{n}")' for n in names)
    ahead, across = f"1 - 2*({y}**2 + {z}**2)", f"2*({w}*{z} + {x}*{y})"
    return {
        "phi": f"atan2(2*({w}*{x} + {y}*{z}), 1 - 2*({x}**2 + {y}**2))",
        "theta": f"atan2(2*({w}*{y} - {z}*{x}), hypot({ahead}, {across}))",
        "psi": f"atan2({across}, {ahead})",
    }
