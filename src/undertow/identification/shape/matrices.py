"""Inertia matrices of six motions in other axes and at other places."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from undertow.errors import UndertowError
from undertow.typing import Array


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
    both = transformation(rotation, np.zeros(3))
    return both @ matrix @ both.T


def moved(matrix: Array, offset: ArrayLike) -> Array:
    """A 6 × 6 inertia or added-mass matrix about an origin from which its own lies at `offset`.

    Parameters
    ----------
    matrix : (6, 6) array
        About its own origin.
    offset : (3,) array
        Where that origin lies, m, along the same axes.
    """
    arm = transformation(np.eye(3), offset)
    return arm @ matrix @ arm.T


def transformation(rotation: ArrayLike, offset: ArrayLike) -> Array:
    """What takes forces and moments of a body into those in other axes, about another origin, shape (6, 6).

    A matrix M of forces per motion becomes T M T^T, and its errors E at most |T| E |T|^T.

    Parameters
    ----------
    rotation : (3, 3) array
        Takes components along the axes of the body into components along the new ones.
    offset : (3,) array
        Where the body's origin lies from the new one, m, along the new axes.

    Raises
    ------
    UndertowError
        If `rotation` is none, or `offset` no place.

    Notes
    -----
    The velocity of the old origin is nu_1 + nu_2 × offset: M' = H^T M H with H = [[I, S(offset)^T], [0, I]]
    (Fossen 2021, chapter 3, transformation between points).
    """
    R, place = np.asarray(rotation, dtype=float), np.asarray(offset, dtype=float)
    if R.shape != (3, 3) or not np.allclose(R @ R.T, np.eye(3), atol=1e-9) or np.linalg.det(R) < 0:
        raise UndertowError("rotation is no right-handed rotation matrix: its rows must be orthonormal")
    if place.shape != (3,):
        raise UndertowError(f"offset has shape {place.shape}: give x, y and z in m")
    x, y, z = place
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.block([[R, np.zeros((3, 3))], [skew @ R, R]])
