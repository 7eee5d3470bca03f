"""Inertia matrices of six motions in other axes and at other places."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from undertow.errors import UndertowError

Array = NDArray[np.float64]


def turned(matrix: Array, rotation: ArrayLike) -> Array:
    """A 6 × 6 inertia or added-mass matrix in other axes with the same origin.

    Parameters
    ----------
    matrix : (6, 6) array
        In the axes of the body; forces and moments per linear and angular acceleration.
    rotation : (3, 3) array
        Takes components along the axes of the body into components along the new ones.

    Raises
    ------
    UndertowError
        If `rotation` is none.
    """
    R = np.asarray(rotation, dtype=float)
    if R.shape != (3, 3) or not np.allclose(R @ R.T, np.eye(3), atol=1e-9) or np.linalg.det(R) < 0:
        raise UndertowError("rotation is no right-handed rotation matrix: its rows must be orthonormal")
    both = np.kron(np.eye(2), R)
    return both @ matrix @ both.T


def moved(matrix: Array, offset: ArrayLike) -> Array:
    """A 6 × 6 inertia or added-mass matrix about an origin from which its own lies at `offset`.

    Parameters
    ----------
    matrix : (6, 6) array
        About its own origin.
    offset : (3,) array
        Where that origin lies, m, along the same axes.

    Notes
    -----
    The velocity of the old origin is nu_1 + nu_2 × offset: M' = H^T M H with H = [[I, S(offset)^T], [0, I]]
    (Fossen 2021, chapter 3, transformation between points).
    """
    place = np.asarray(offset, dtype=float)
    if place.shape != (3,):
        raise UndertowError(f"offset has shape {place.shape}: give x, y and z in m")
    x, y, z = place
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    H = np.block([[np.eye(3), skew.T], [np.zeros((3, 3)), np.eye(3)]])
    return H.T @ matrix @ H
